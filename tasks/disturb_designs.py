"""Fate of walkers near their long gait at one slope: attractors, and steps of the ground they survive."""

from __future__ import annotations

import numpy as np

from tasks.step.problem import Lanes, sizes
from tasks.step.simulate import STRUCK, step_onto, stride
from tasks.walkers.walker_array import WalkerArray

#: Relative displacement of initial states from the gait, steps that are dropped, and the longest period identified.
_DISPLACED, _DROPPED, _MAX_PERIOD = 1e-3, 2000, 32
#: Relative change after a period up to which an orbit repeats; steps over which it must.
_REPEATS, _COMPARED = 1e-5, 64
#: Relative change after a period from which on the orbit no longer changes.
_AT_REST = 1e-11
#: Resolution of steps of the ground, over the leg, and how many are tried at once.
STEP_RESOLUTION, _AT_ONCE = 1e-3, 8
#: Steps after which a walker must be back at its gait, and how near, relative; steps between checks that it will be.
_RECOVERY, _BACK, _BETWEEN = 200, 1e-3, 6
#: Distance from a stable gait, over its angle, within which walkers may be taken to return, and how much larger than
#: measured the curvature of the step map may be.
_NEAR, _SAFETY = 1e-5, 8.0
#: Lanes that walk side by side.
_LANES = 4096


class _Neighbourhoods:
    """Where walkers surely return to their gaits: balls in the norm in which the linear step map contracts.

    The norm is that of the P that solves P - J' P J = I; a step shortens it by at least c = sqrt(1 - 1/|P|) but for the
    curvature of the map, which is measured at a displaced state. Unstable gaits have none.
    """

    def __init__(self, problem: Lanes, y: np.ndarray, slope: float):
        m, n = y.shape
        self.y, slopes = y, np.full(n, slope)
        self.P, self.radius = np.zeros((n, m, m)), np.zeros(n)
        at = stride(problem, y, slopes)
        J = np.moveaxis(at.jacobian, -1, 0)
        lanes = np.flatnonzero(np.isfinite(J).all(axis=(1, 2)))
        radii = np.abs(np.linalg.eigvals(J[lanes])).max(axis=1)
        lanes = lanes[radii < 1 - 1e-6]
        J = J[lanes]
        product = np.einsum("nki,nlj->nijkl", J, J).reshape(-1, m * m, m * m)
        right = np.broadcast_to(np.eye(m).reshape(1, -1, 1), (len(lanes), m * m, 1))
        self.P[lanes] = np.linalg.solve(np.eye(m * m) - product, right).reshape(-1, m, m)
        size = np.linalg.eigvalsh(self.P[lanes])[:, -1]
        off = _DISPLACED * y[:, lanes]
        moved = stride(problem.some(lanes), y[:, lanes] + off, slopes[lanes], exact=False).image - at.image[:, lanes]
        rest = np.linalg.norm(moved - np.einsum("nij,jn->in", J, off), axis=0)
        curvature = _SAFETY * rest / (off**2).sum(axis=0)
        shortened = 1 - np.sqrt(1 - 1 / size)
        radius = 0.5 * shortened / (np.sqrt(size) * curvature)
        self.radius[lanes] = np.minimum(np.nan_to_num(radius), _NEAR * y[0, lanes])

    def hold(self, y: np.ndarray, lanes: np.ndarray) -> np.ndarray:
        """Whether states (m, k) of some lanes (k,) lie in them."""
        off = y - self.y[:, lanes]
        return np.asarray(np.einsum("in,nij,jn->n", off, self.P[lanes], off) < self.radius[lanes] ** 2)


def attractors(problem: Lanes, y: np.ndarray, slope: float) -> np.ndarray:
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
        `period k`, with k up to 32, `chaotic` for all that repeats less often, or `falls`.
    """
    parts = [
        _attractors(problem.some(np.arange(k, min(k + _LANES, y.shape[1]))), y[:, k : k + _LANES], slope)
        for k in range(0, y.shape[1], _LANES)
    ]
    return np.concatenate([np.zeros(0, "U32"), *parts])


def _attractors(problem: Lanes, y: np.ndarray, slope: float) -> np.ndarray:
    names, home = np.full(y.shape[1], "falls", "U32"), _Neighbourhoods(problem, y, slope)
    y, lanes = y * (1 + _DISPLACED), np.arange(y.shape[1])
    for taken in range(0, _DROPPED, _MAX_PERIOD):
        orbit, kept = _orbit(problem.some(lanes), y, slope, min(_MAX_PERIOD, _DROPPED - taken))
        lanes = lanes[kept]
        off = np.abs(orbit[-2::-1] - orbit[-1]).max(axis=1)
        still = off < _AT_REST * np.abs(orbit[-1]).max(axis=0)
        period = np.where(home.hold(orbit[-1], lanes), 1, np.where(still.any(axis=0), 1 + still.argmax(axis=0), 0))
        names[lanes] = [f"period {p}" if p else "falls" for p in period.tolist()]
        y, lanes = orbit[-1][:, period == 0], lanes[period == 0]
        if not len(lanes):
            return names
    orbit, kept = _orbit(problem.some(lanes), y, slope, _COMPARED + _MAX_PERIOD)
    for k, lane in enumerate(lanes[kept].tolist()):
        off = [np.abs(orbit[p:, :, k][:_COMPARED] - orbit[:_COMPARED, :, k]).max() for p in range(1, _MAX_PERIOD + 1)]
        repeats = np.flatnonzero(np.array(off) < _REPEATS * np.abs(orbit[0, :, k]).max())
        names[lane] = f"period {repeats[0] + 1}" if len(repeats) else "chaotic"
    return names


def _orbit(problem: Lanes, y: np.ndarray, slope: float, steps: int) -> tuple[np.ndarray, np.ndarray]:
    """States (steps + 1, m, k) at and after each step of those lanes that do not fall, and their numbers (k,)."""
    orbit, lanes = np.full((steps + 1, *y.shape), np.nan), np.arange(y.shape[1])
    orbit[0] = y
    for i in range(steps if len(lanes) else 0):
        result = stride(problem.some(lanes), orbit[i][:, lanes], np.full(len(lanes), slope), exact=False)
        orbit[i + 1][:, lanes] = result.image
        lanes = lanes[result.outcome == STRUCK]
        if not len(lanes):
            break
    return orbit[:, :, lanes], lanes


def largest_steps(problem: Lanes, y: np.ndarray, slope: float, limit: float) -> np.ndarray:
    """Find the largest steps of the ground, down and up, that walkers survive at their stable gaits.

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
        Over the leg: a thousandth less than the smallest step, in thousandths, that is not survived, or `limit`.

    Notes
    -----
    A step of the gait ends on ground that is lower or higher than its plane, and those after it on ground parallel to
    that. It is survived if after 200 steps the walker is back within a thousandth of its gait.
    """
    n, most = y.shape[1], int(np.ceil(round(limit / STEP_RESOLUTION, 6)))
    largest = np.full((2, n), most)
    for k in range(0, n, _LANES // _AT_ONCE):
        part = np.arange(k, min(k + _LANES // _AT_ONCE, n))
        own, home = problem.some(part), _Neighbourhoods(problem.some(part), y[:, part], slope)
        for row, sign in enumerate((-1, 1)):
            left = np.arange(len(part))
            for first in range(1, most + 1, _AT_ONCE):
                heights = np.minimum(STEP_RESOLUTION * np.arange(first, min(first + _AT_ONCE, most + 1)), limit)
                each = np.repeat(left, len(heights))
                survived = _survived(own, home, each, slope, sign * np.tile(heights, len(left)))
                survived = survived.reshape(len(left), -1)
                failed = ~survived.all(axis=1)
                largest[row, part[left[failed]]] = first - 1 + survived[failed].argmin(axis=1)
                left = left[~failed]
                if not len(left):
                    break
    return np.minimum((largest * STEP_RESOLUTION).round(9), limit)


def _survived(problem: Lanes, home: _Neighbourhoods, lanes: np.ndarray, slope: float, height: np.ndarray) -> np.ndarray:
    """Whether walkers survive steps of the ground (k,), over the leg, at the gaits of some lanes (k,)."""
    slopes, survived, gait = np.full(len(lanes), slope), np.zeros(len(lanes), bool), home.y[:, lanes]
    own = problem.some(lanes)
    assert isinstance(own.walkers, WalkerArray)
    walkers = own.walkers.some(own.lanes)
    after = step_onto(own, gait, slopes, height * walkers.leg / walkers.l)
    walking = np.flatnonzero((after.outcome == STRUCK) & (after.image[0] > 0))
    y = after.image[:, walking]
    for taken in range(2, _RECOVERY, _BETWEEN):
        orbit, kept = _orbit(problem.some(lanes[walking]), y, slope, min(_BETWEEN, _RECOVERY - taken))
        y, walking = orbit[-1], walking[kept]
        back = home.hold(y, lanes[walking])
        survived[walking[back]] = True
        y, walking = y[:, ~back], walking[~back]
    off = np.abs(y - gait[:, walking]) < _BACK * sizes(gait[:, walking])
    survived[walking[off.all(axis=0)]] = True
    return survived
