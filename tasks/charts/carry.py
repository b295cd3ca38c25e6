"""Points carried over the keys of a box in steps, each from a prediction along the
last.

The keys are given all the way, and end at given designs: each point keeps to its own
walkers, so that many go side by side and no derivative by keys is needed. Curves
(`tasks.branches.curves`) have keys among their unknowns: they pass the turns at which
points are lost here, and take five to twenty times as many evaluations to come as far.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

#: By how much steps grow and shrink, and the shortest.
_LONGER = 1.5
_SHORTER = 0.4
_SHORTEST = 1 / 256


class Carried:
    """Points Z (c, n) on their way, with the length of the next step of each, (n,)."""

    def __init__(self, Z: np.ndarray, stride: float):
        self.Z = Z.copy()
        self.stride = np.full(Z.shape[1], stride)
        # Of the last steps: a parabola would lead to the other sheet beside a turn.
        self.rate = np.zeros_like(Z)

    def advance(
        self,
        active: np.ndarray,
        step: np.ndarray,
        correct: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]],
    ) -> np.ndarray:
        """Carry some points by steps.

        Parameters
        ----------
        active : ndarray of int, shape (k,)
        step : ndarray, shape (k,)
        correct : callable
            From predictions (c, k) the points there, and which of them are accepted,
            (k,).

        Returns
        -------
        ndarray of bool, shape (k,)
            Those that are accepted; the others have not moved.
        """
        Z, fair = correct(self.Z[:, active] + step * self.rate[:, active])
        some = active[fair]
        self.rate[:, some] = (Z[:, fair] - self.Z[:, some]) / step[fair]
        self.Z[:, some] = Z[:, fair]
        self.stride[active] *= np.where(fair, _LONGER, _SHORTER)
        return fair

    def carry(
        self,
        correct: Callable[
            [np.ndarray, np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]
        ],
    ) -> np.ndarray:
        """Carry all points over ways of length 1, and return whether they arrived, bool
        (n,).

        Parameters
        ----------
        correct : callable
            As `advance` has it, with the numbers of the points and how far along their
            ways they are before it.
        """
        share = np.zeros(len(self.stride))
        active = np.arange(len(self.stride))
        while len(active):
            step = np.minimum(self.stride[active], 1 - share[active])
            fair = self.advance(
                active, step, partial(correct, active, share[active] + step)
            )
            share[active[fair]] += step[fair]
            active = active[
                (share[active] < 1 - 1e-12) & (self.stride[active] > _SHORTEST)
            ]

        return np.asarray(share >= 1 - 1e-12)
