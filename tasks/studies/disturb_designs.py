"""Fate of walkers near their long gait at one slope: attractors, and steps of the
ground they survive.
"""

from __future__ import annotations

import numpy as np

from gaitsweep.tasks.orbits.attractors import WALKS_ON, Neighbourhoods, attractors
from gaitsweep.tasks.orbits.walk import Walk
from gaitsweep.tasks.step.problem import Lanes, sizes
from gaitsweep.tasks.step.simulate import STRUCK, step_onto

#: Relative displacement of initial states from the gait, and steps after which the
#: period of their orbits is told.
_DISPLACED = 1e-3
_DROPPED = 2000
#: Resolution of steps of the ground, over the leg, and how many are tried at once.
STEP_RESOLUTION = 1e-3
_AT_ONCE = 8
#: Steps after which a walker must be back at its gait, and how near, relative.
_RECOVERY = 200
_BACK = 1e-3


def attractors_beside(
    problem: Lanes,
    y: np.ndarray,
    slope: float,
) -> np.ndarray:
    """Find the attractors of walkers that start beside a gait.

    Parameters
    ----------
    problem : Lanes
        Of n lanes.
    y : ndarray, shape (m, n) [rad, rad/sqrt(leg/g)]
        Section coordinates of their gaits.
    slope : float [rad]

    Returns
    -------
    ndarray of str, shape (n,)
        `period k`, with k up to 32, `chaotic` for all that repeats less often, or
        `falls`.
    """
    slopes = np.full(y.shape[1], slope)
    walk = Walk(problem, y * (1 + _DISPLACED), slopes)
    found = attractors(walk, {"period 1": Neighbourhoods(problem, y, slopes)}, _DROPPED)
    found[found == WALKS_ON] = "chaotic"
    found[walk.outcome != STRUCK] = "falls"
    return found


def largest_steps(
    problem: Lanes,
    y: np.ndarray,
    slope: float,
    limit: float,
) -> np.ndarray:
    """Find the largest steps of the ground, down and up, that walkers survive at their
    stable gaits.

    Parameters
    ----------
    problem : Lanes
        Of n lanes.
    y : ndarray, shape (m, n) [rad, rad/sqrt(leg/g)]
        Section coordinates of the gaits.
    slope : float [rad]
    limit : float
        Largest step tried, over the leg.

    Returns
    -------
    ndarray, shape (2, n)
        Over the leg: a thousandth less than the smallest step, in thousandths, that is
        not survived, or `limit`.

    Notes
    -----
    A step of the gait ends on ground that is lower or higher than its plane, and those after it on ground parallel to
    that. It is survived if after 200 steps the walker is back within a thousandth of
    its gait.
    """
    n = y.shape[1]
    most = int(np.ceil(round(limit / STEP_RESOLUTION, 6)))
    largest = np.full((2, n), most)
    home = Neighbourhoods(problem, y, np.full(n, slope))
    for row, sign in zip(largest, (-1, 1), strict=True):
        left = np.arange(n)
        for first in range(1, most + 1, _AT_ONCE):
            numbers = np.arange(first, min(first + _AT_ONCE, most + 1))
            heights = np.minimum(STEP_RESOLUTION * numbers, limit)
            lanes = np.repeat(left, len(heights))
            height = sign * np.tile(heights, len(left))
            survived = _survive(
                problem.some(lanes), home.some(lanes), slope, height
            ).reshape(len(left), -1)

            failed = ~survived.all(axis=1)
            row[left[failed]] = first - 1 + survived[failed].argmin(axis=1)
            left = left[~failed]
            if not len(left):
                break

    return np.minimum((largest * STEP_RESOLUTION).round(9), limit)


def _survive(
    problem: Lanes,
    home: Neighbourhoods,
    slope: float,
    height: np.ndarray,
) -> np.ndarray:
    """Whether walkers survive steps of the ground (k,), over the leg, at their gaits."""
    walkers = problem.every_walker
    slopes = np.full(len(height), slope)
    after = step_onto(problem, home.y, slopes, height * walkers.leg / walkers.l)
    walk = Walk(problem, after.image, slopes)
    survived = np.zeros(len(height), bool)

    walk.lanes = np.flatnonzero(after.outcome == STRUCK)
    for _ in walk.steps(_RECOVERY - 2):
        back = home.hold(walk.y[:, walk.lanes], walk.lanes)
        survived[walk.lanes[back]] = True
        walk.lanes = walk.lanes[~back]

    off = np.abs(walk.y - home.y)[:, walk.lanes] < _BACK * sizes(home.y[:, walk.lanes])
    survived[walk.lanes[off.all(axis=0)]] = True
    return survived
