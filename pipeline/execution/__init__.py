"""How a plan is executed.

`runner` runs a study from its lock to its archive; `scheduler` orders the jobs; `executors` and `cluster` provide the
places where they run; `worker_process` guards a worker, `worker_main` is the program of the worker and `wire` carries
messages between them; `progress` and `estimates` report how far a run is.
"""
