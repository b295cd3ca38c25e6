"""One loop for all iterations: many lanes side by side, each of which ends by itself.

A lane that has ended is stepped no more, so its last bits are its own, whatever its
neighbours still do.
"""

from __future__ import annotations

import enum
from typing import Protocol

import numpy as np

from gaitsweep.tasks.mechanics.arrays import Numbers


class Ended(enum.IntEnum):
    """Why an iteration ended in a lane."""

    RUNNING = 0
    #: The step is as small as is asked for, or as rounding allows.
    CONVERGED = 1
    #: The step is too large, or leads where there is no gait.
    DIVERGED = 2
    #: There is no step: the derivative is singular, or the walker fell.
    SINGULAR = 3
    #: Steps do not shrink as they should.
    STALLED = 4
    #: It leads to a solution that is known already, or that another lane goes on to.
    KNOWN = 5
    OUT_OF_STEPS = 6


class Rule(Protocol):
    """An iteration of n lanes, which holds what they have come to."""

    def step(self, lanes: Numbers, taken: int) -> np.ndarray:
        """Step once more in some lanes (j,), in which `taken` steps were taken before.

        Returns
        -------
        ndarray of int, shape (j,)
            Of `Ended`: why each ends here, or RUNNING.
        """
        ...


def iterate(rule: Rule, n: int, max_steps: int) -> np.ndarray:
    """Step in n lanes until each has ended.

    Parameters
    ----------
    rule : Rule
    n : int
    max_steps : int
        Of a lane.

    Returns
    -------
    ndarray of int, shape (n,)
        Of `Ended`: why each lane ended.
    """
    ended = np.full(n, Ended.RUNNING)
    lanes = np.arange(n)
    for taken in range(max_steps):
        if not len(lanes):
            break
        ended[lanes] = rule.step(lanes, taken)
        lanes = np.flatnonzero(ended == Ended.RUNNING)

    ended[lanes] = Ended.OUT_OF_STEPS
    return ended
