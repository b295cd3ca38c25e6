"""How a plan is carried out.

`runner` runs a study from its lock to its archive; `scheduler` decides what is next; `executors` and `cluster` say
where jobs
run; `worker_process` guards a worker, `worker_main` is the worker's own program and `wire` carries messages between
them;
`progress` and `estimates` tell how far a run is.
"""
