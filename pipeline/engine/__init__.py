"""How the missing nodes are computed.

`runner` takes a study from its lock to its archive; `loop` computes what all studies of
a command lack, node by node of their `work`, at a place (`places`, `cluster`), by
worker processes that are guarded (`worker_process`); `progress` listens.
"""
