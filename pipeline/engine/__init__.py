"""How missing nodes are computed.

`runner` runs studies from their locks to their archives; `jobs` knows which nodes of
one study are ready, and records their results; `scheduler` orders the jobs of all;
`executors` and `cluster` provide the places where they run; `worker_process` guards a
worker, `worker_main` is its program and `request` what it is asked; `progress` reports
how far a run is and `account` what it took; `locks` keep other runs out, and `signals`
end a run between two results.
"""
