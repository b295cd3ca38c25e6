"""Every value of `status`: outcomes of a solve, and of a worker that did not finish."""

from gaitsweep.pipeline import outcomes
from gaitsweep.tasks.contract.registry import STATUSES

#: Points whose worker did not finish; outcomes of a solve are in `tasks.contract.registry`.
ENDINGS = {
    "worker_died": 4,
    "timed_out": 5,
    "out_of_memory": 6,
    "not_attempted": 7,
    "raised": 8,
}
#: Every value of `status`.
ALL_STATUSES = dict(sorted({**STATUSES, **ENDINGS}.items(), key=lambda item: item[1]))
STATUS_NAMES = {code: name for name, code in ALL_STATUSES.items()}
#: Statuses that are answers.
ANSWERS = tuple(STATUSES[name] for name in outcomes.ANSWERS)
#: Statuses of gaits that were found.
FOUND = tuple(ALL_STATUSES[name] for name in ("converged", "less_accurate"))
#: Statuses of gaits that there are, found or not.
OF_GAITS = tuple(code for name, code in STATUSES.items() if name != "no_gait")
#: Reason of points that nobody has computed.
NOT_ATTEMPTED = "The run has not reached it."


def of_atlas(reason: str) -> str:
    """Reason of a failed atlas, for results that need it."""
    return f"The atlas of the line: {reason[:1].lower()}{reason[1:]}"
