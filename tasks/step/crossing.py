"""Where the guard of the next strike falls through zero between time steps."""

from __future__ import annotations

import numpy as np

#: Intervals of a time step at whose ends its cubic is taken.
_SAMPLES = 16


def guard(
    free: bool,
    x: np.ndarray,
    ground: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Guard of the next strike and its rate: flexion of the knee, or the sum of the
    legs' angles.

    Parameters
    ----------
    free : bool
        To kneestrike with the knee free, or to heelstrike with it locked.
    x : ndarray, shape (size, ..., n)
        Scaled states.
    ground : ndarray, shape (2, n), optional
        The scale of the angles, and the height of the ground over l: the guard is the
        foot's height above it.

    Returns
    -------
    guard, rate : ndarray, shape (..., n)
    """
    if free:
        return x[1] - x[2], x[4] - x[5]
    if ground is None:
        return x[0] + x[1], x[2] + x[3]

    scale, height = ground
    half = 0.5 * scale
    mean = half * (x[0] + x[1])
    mean_rate = half * (x[2] + x[3])
    apart = half * (x[1] - x[0])
    apart_rate = half * (x[3] - x[2])

    by_mean = np.cos(mean) * np.sin(apart) * mean_rate
    by_apart = np.sin(mean) * np.cos(apart) * apart_rate
    height_of_foot = 2 * np.sin(mean) * np.sin(apart)
    return height_of_foot - height, 2 * (by_mean + by_apart)


# Motions that are lost cross nothing.
@np.errstate(divide="ignore", invalid="ignore")
def crossing(
    free: bool,
    X: np.ndarray,
    h: float,
    ground: np.ndarray | None = None,
) -> np.ndarray:
    """Fraction of each time step at which the guard falls through zero; -1 where it
    does not.

    Parameters
    ----------
    free : bool
        To kneestrike with the knee free, or to heelstrike with it locked.
    X : ndarray, shape (steps + 1, size, n)
        Scaled states before and after each time step.
    h : float [sqrt(leg/g)]
        Time step.
    ground : ndarray, shape (2, n), optional
        As `guard` has it.

    Returns
    -------
    ndarray, shape (steps, n)

    Notes
    -----
    At a strike the guard, once positive, falls to zero; at the start it is exactly zero, which is no strike. Within a
    time step the guard is its cubic Hermite polynomial, so that a dip below zero and
    back is detected too. Heelstrikes count only with the stance leg behind.
    """
    g, rate = guard(free, X.swapaxes(0, 1), ground)
    before = X[:-1, 0]
    after = X[1:, 0]
    rate = h * rate
    crosses = _may_fall(g, rate)
    if not free:
        crosses &= after < 0
    if ground is not None:
        crosses &= X[1:, 1] > after

    fraction = np.full(crosses.shape, -1.0)
    lanes = np.nonzero(crosses)
    if len(lanes[0]):
        steps = [values[lanes] for values in (g[:-1], g[1:], rate[:-1], rate[1:])]
        at = _first_zero(*steps)
        falls = at >= 0
        if not free:
            falls &= before[lanes] + at * (after[lanes] - before[lanes]) < 0
        fraction[lanes] = np.where(falls, at, -1.0)

    return fraction


def _may_fall(g: np.ndarray, rate: np.ndarray) -> np.ndarray:
    """Whether a guard, given with its rates per time step, may fall through zero in
    each time step.
    """
    a = g[:-1]
    b = g[1:]
    da = rate[:-1]
    db = rate[1:]
    was_up = (a > 0) | ((a == 0) & (da > 0))
    return np.asarray(was_up & ((b <= 0) | ((da < 0) & (db > 0))))


def _first_zero(
    a: np.ndarray,
    b: np.ndarray,
    da: np.ndarray,
    db: np.ndarray,
) -> np.ndarray:
    """Fraction at which cubics of given values and rates at both ends first fall to
    zero, between samples; -1 where they do not.
    """
    s = np.linspace(0.0, 1.0, _SAMPLES + 1)[:, None]
    value = (
        a * (1 + 2 * s) * (1 - s) ** 2
        + da * s * (1 - s) ** 2
        + b * s * s * (3 - 2 * s)
        + db * s * s * (s - 1)
    )
    below = (value <= 0) & (s > 0)
    lanes = np.arange(len(a))
    first = np.argmax(below, axis=0)
    high = value[np.maximum(first - 1, 0), lanes]
    low = value[first, lanes]
    at = (first - 1 + high / (high - low)) / _SAMPLES
    return np.where(below.any(axis=0), at, -1.0)
