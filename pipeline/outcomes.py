"""What the statuses of a point's gaits mean for the point; loads nothing of `tasks`, so
that a report may use it.
"""

from collections import Counter
from collections.abc import Mapping

import numpy as np

#: Statuses that are answers, the best first; all others are failures.
ANSWERS = ("converged", "fell", "no_gait")
#: Reason of lines whose results are tables.
FOLLOWED = "The line was followed; its results are in the groups."


def count_rows(status: np.ndarray) -> dict[tuple[int, ...], int]:
    """Count the distinct rows of statuses, shape (n, gait)."""
    base, code = 1 + int(status.max(initial=0)), np.zeros(len(status), np.intp)
    for column in status.T:
        code = code * base + column
    occurrences = np.bincount(code)
    powers = base ** np.arange(status.shape[1])[::-1]

    return {
        tuple((c // powers % base).tolist()): int(occurrences[c])
        for c in np.flatnonzero(occurrences)
    }


def count(
    rows: Mapping[tuple[int, ...], int], names: Mapping[int, str]
) -> Counter[str]:
    """Count points, given by their rows of statuses, by outcome: a failure of any gait,
    else the best answer of any.
    """
    counts = Counter[str]()
    for row, n in rows.items():
        known = [names.get(code, str(code)) for code in sorted(row)]
        failed = [name for name in known if name not in ANSWERS]
        counts[failed[-1] if failed else min(known, key=ANSWERS.index)] += n
    return counts
