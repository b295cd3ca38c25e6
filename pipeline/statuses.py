"""Every value of `status`: how a solve ended, and how a point ended for its worker."""

from __future__ import annotations

from tasks.registry import STATUSES

#: How a point ended for its worker; how a solve ended is in `tasks.registry`.
ENDINGS = {"worker_died": 4, "timed_out": 5, "out_of_memory": 6, "not_attempted": 7, "raised": 8}
#: Every value of `status`.
ALL_STATUSES = {**STATUSES, **ENDINGS}
#: Statuses that answer the question; every other is a failure.
ANSWERS = tuple(STATUSES[name] for name in ("converged", "no_gait", "fell"))
