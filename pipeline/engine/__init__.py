"""How plans are executed.

`runner` runs studies from their locks to their archives; `study_jobs` lays out the jobs of one study and records their
results; `scheduler` orders the jobs of all; `executors` and `cluster` provide the places where they run;
`worker_process` guards a worker, `worker_main` is the program of the worker and `wire` carries messages between them;
`progress` and `estimates` report how far a run is; `locks` and `signals` keep other runs and interruptions out.
"""
