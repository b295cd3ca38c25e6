"""The stable manifold of a saddle in a plane of initial conditions: the states from
which orbits tend to the saddle.

It separates initial conditions that leave the saddle to either side, and is the edge of
a basin of attraction where one side leads to the gait and the other to a fall.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy import ndarray

from gaitsweep.tasks.mechanics.sums import norm, total
from gaitsweep.tasks.orbits.walk import Walk
from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.step.simulate import STRUCK, stride

#: Distance from the saddle along its unstable direction, over its norm, at which an
#: orbit has left it; steps within which the orbits of a bracket come near the saddle,
#: before which leaving does not count; and the longest stay.
_LEFT, _APPROACH, _MAX_STEPS = 0.02, 4, 60
#: Rounds in which a bracket closes, and the largest distance to which an orbit on the
#: manifold approaches the saddle.
_ROUNDS, _REACHED = 16, 1e-3


class Saddle(NamedTuple):
    """A gait with one multiplier above 1, all others inside the unit circle.

    Attributes
    ----------
    y : ndarray, shape (m,) [rad, rad/sqrt(leg/g)]
    along : ndarray, shape (m,)
        Left eigenvector of the unstable multiplier: its product with a deviation from y
        is the coordinate along the unstable direction, over the norm of y.
    multiplier : float
        The unstable one.
    """

    y: ndarray
    along: ndarray
    multiplier: float


def saddle_at(problem: Problem, y: ndarray, slope: float) -> Saddle | None:
    """A gait as a saddle; None if not one.

    Parameters
    ----------
    problem : Problem
    y : ndarray, shape (m,) [rad, rad/sqrt(leg/g)]
    slope : float [rad]

    Returns
    -------
    Saddle or None
    """
    at = stride(problem, y[:, None], np.array([slope]))
    if at.outcome[0] != STRUCK:
        return None

    values, vectors = np.linalg.eig(at.jacobian[:, :, 0])
    is_outside = np.abs(values) > 1
    if is_outside.sum() != 1 or values[is_outside][0].real < 1:
        return None

    left = np.linalg.inv(vectors)[is_outside][0].real
    multiplier = float(values[is_outside][0].real)
    return Saddle(y, left / np.linalg.norm(y), multiplier)


def stable_manifold(
    problem: Problem,
    saddle: Saddle,
    slope: float,
    grid: ndarray,
) -> ndarray:
    """Points of a saddle's stable manifold on the lines of a grid of initial
    conditions.

    Parameters
    ----------
    problem : Problem
    saddle : Saddle
    slope : float [rad]
    grid : ndarray, shape (m, p, q) [rad, rad/sqrt(leg/g)]

    Returns
    -------
    ndarray, shape (m, k)
        Where lines between neighbours of the grid cross it, in no order.

    Notes
    -----
    Between neighbours whose orbits leave the saddle to different sides a root is sought by the Illinois algorithm (M.
    Dowell and P. Jarratt, BIT 11 (1971) 168-174). It is on the manifold if the orbit
    from there approaches the saddle, which one from an edge of falling does not.
    """
    a, b, at_a, at_b = _brackets(problem, saddle, slope, grid)
    best = a
    nearest = np.full(a.shape[1], np.inf)
    if not a.shape[1]:
        return best

    for _ in range(_ROUNDS):
        x = (a * at_b - b * at_a) / (at_b - at_a)
        at_x, near = _leave(problem, saddle, slope, x)
        best = np.where(near < nearest, x, best)
        nearest = np.minimum(nearest, near)

        changes = at_x * at_b < 0
        # An end kept twice counts half, else it would stay for ever.
        a = np.where(changes, b, a)
        at_a = np.where(changes, at_b, 0.5 * at_a)
        b, at_b = x, at_x

    return best[:, nearest < _REACHED]


def _brackets(
    problem: Problem,
    saddle: Saddle,
    slope: float,
    grid: ndarray,
) -> tuple[ndarray, ndarray, ndarray, ndarray]:
    """Neighbours of a grid whose orbits leave the saddle to different sides.

    Returns
    -------
    a, b : ndarray, shape (m, k)
    at_a, at_b : ndarray, shape (k,)
        Where along the unstable direction their orbits leave it.
    """
    m, *shape = grid.shape
    leaves = _leave(problem, saddle, slope, grid.reshape(m, -1))[0].reshape(shape)

    down = (grid[:, :-1], grid[:, 1:], leaves[:-1], leaves[1:])
    across = (grid[:, :, :-1], grid[:, :, 1:], leaves[:, :-1], leaves[:, 1:])
    parts = []
    for pair in (down, across):
        *_, at_a, at_b = pair
        is_parted = at_a * at_b < 0
        parts.append([each[..., is_parted] for each in pair])

    a, b, at_a, at_b = (
        np.concatenate(part, axis=-1) for part in zip(*parts, strict=True)
    )
    return a, b, at_a, at_b


def _leave(
    problem: Problem,
    saddle: Saddle,
    slope: float,
    y: ndarray,
) -> tuple[ndarray, ndarray]:
    """Where along the unstable direction orbits leave the saddle, and how near they
    come to it.

    Parameters
    ----------
    y : ndarray, shape (m, n)
        Initial states.

    Returns
    -------
    leaves : ndarray, shape (n,)
        Coordinate along it, reduced by the growth of the steps taken; NaN where the
        first step is a fall.
    nearest : ndarray, shape (n,)
        Least distance from the saddle over its norm.
    """
    n = y.shape[1]
    leaves = np.full(n, np.nan)
    nearest = np.full(n, np.inf)
    walk = Walk(problem, y, np.full(n, slope))
    for taken in walk.steps(_MAX_STEPS):
        lanes = walk.lanes
        off = walk.y[:, lanes] - saddle.y[:, None]
        along = total(saddle.along[:, None] * off)
        leaves[lanes] = along / saddle.multiplier**taken

        distance = norm(off) / np.linalg.norm(saddle.y)
        nearest[lanes] = np.minimum(nearest[lanes], distance)
        walk.lanes = lanes[(np.abs(along) < _LEFT) | (taken < _APPROACH)]

    return leaves, nearest
