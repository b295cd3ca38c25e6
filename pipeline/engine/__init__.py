"""How the missing nodes are computed.

`runner` takes a study from its lock to its archive; `loop` computes what all studies of
a command lack, node by node of their `work`, at a place (`places`, `cluster`), by
worker processes that are guarded (`worker_process`); `progress` listens (`listener`)
and `display` shows it. `request` is what a worker is asked and answers, `division`
answers it as a whole or in parts. `locks` keeps a second run from an archive, `signals`
has what a run does when told to stop, `account` what its processes spent.
"""
