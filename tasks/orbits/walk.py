"""Walkers that take steps side by side: orbits, basins, crises, manifolds and
attractors all consist of these.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy import ndarray

from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.step.simulate import STRUCK, stride


class Walk:
    """Walkers on their way from n states, each in a lane, until they fall or are left
    behind.

    Arrays are of all n walkers, whichever still walk, so what is known of one keeps its
    place. Whoever needs a walker no longer drops its number from `lanes`.

    Attributes
    ----------
    lanes : ndarray of int, shape (k,)
        Numbers of those that walk on.
    y : ndarray, shape (m, n) [rad, rad/sqrt(leg/g)]
        Section coordinates after the last step of each, NaN after a fall.
    times : ndarray, shape (phases, n) [sqrt(leg/g)]
        Of the strikes of the last step of each.
    before : ndarray, shape (m, k) [rad, rad/sqrt(leg/g)]
        Section coordinates before the last step, of those that walk on.
    jacobian : ndarray, shape (m, m, k)
        Of the last step, of those that walk on; empty where it was not exact.
    closing : ndarray, shape (m + phases, phases, k)
        As `SimulatedSteps` has it, of the last step of those that walk on.
    taken : ndarray of int, shape (n,)
        Steps that did not end in a fall.
    outcome : ndarray of int, shape (n,)
        Of the last step of each, index of CAUSES.
    """

    def __init__(self, problem: Problem, y: ndarray, slope: ndarray):
        n = y.shape[1]
        self.problem = problem
        self.slope = slope
        self.lanes = np.arange(n)
        self.y = y.copy()
        self.times = np.full((problem.phases, n), np.nan)
        self.before = y
        self.jacobian = self.closing = np.empty((0, 0, n))
        self.taken = np.zeros(n, int)
        self.outcome = np.full(n, STRUCK)

    def steps(self, count: int, exact: bool = False) -> Iterator[int]:
        """Take steps while anyone walks, and count them from 1; the last may be a fall
        of all.

        Parameters
        ----------
        count : int
        exact : bool
            As for `stride`.
        """
        for number in range(1, count + 1):
            lanes = self.lanes
            before = self.y[:, self.lanes]
            if not len(lanes):
                return

            step = stride(self.problem.some(lanes), before, self.slope[lanes], exact)
            self.y[:, lanes] = step.image
            self.times[:, lanes] = step.times
            self.outcome[lanes] = step.outcome
            walks = step.outcome == STRUCK
            self.lanes = lanes[walks]
            self.before = before[:, walks]
            self.jacobian = step.jacobian[:, :, walks]
            self.closing = step.closing[:, :, walks]
            self.taken[self.lanes] += 1
            yield number


def change(before: ndarray, after: ndarray) -> ndarray:
    """Largest change of states (..., m, n) over the largest of their coordinates, shape
    (..., n).
    """
    return np.asarray(np.abs(after - before).max(axis=-2) / np.abs(before).max(axis=-2))
