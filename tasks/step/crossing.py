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
def crossings(
    free: bool,
    X: np.ndarray,
    h: float,
    ground: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Find the time steps in which the guard falls through zero.

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
    step, lane : ndarray of int, shape (k,)
        In the order of time steps.
    fraction : ndarray, shape (k,)
        Of the time step, at which it does.

    Notes
    -----
    At a strike the guard, once positive, falls to zero; at the start it is exactly zero, which is no strike. Within a
    time step the guard is its cubic Hermite polynomial, so that a dip below zero and
    back is detected too. Heelstrikes count only with the stance leg behind.
    """
    before = X[:-1, 0]
    after = X[1:, 0]
    counts = np.ones(after.shape, bool) if free else after < 0
    if ground is not None:
        counts &= X[1:, 1] > after
    if not counts.any():
        return _NOWHERE

    g, rate = guard(free, X.swapaxes(0, 1), ground)
    counts &= _may_fall(g, rate)
    step, lane = np.divmod(np.flatnonzero(counts), counts.shape[1])
    if not len(step):
        return _NOWHERE

    begin = step, lane
    end = step + 1, lane
    at = _first_zero(g[begin], g[end], h * rate[begin], h * rate[end])
    falls = at >= 0
    if not free:
        angle = before[begin]
        falls &= angle + at * (after[begin] - angle) < 0

    return step[falls], lane[falls], at[falls]


_NOWHERE = np.empty(0, int), np.empty(0, int), np.empty(0)


def _may_fall(g: np.ndarray, rate: np.ndarray) -> np.ndarray:
    """Whether a guard, given with its rates, may fall through zero in each time step."""
    a = g[:-1]
    b = g[1:]
    falls_back = rate < 0
    may_fall = (rate[1:] > 0) & falls_back[:-1]
    may_fall |= b <= 0
    may_fall &= (a > 0) | ((a == 0) & (rate[:-1] > 0))
    return may_fall


#: Places at which cubics are taken, and what multiplies the values and rates at both
#: ends there.
_AT = np.linspace(0.0, 1.0, _SAMPLES + 1)[:, None]
_LEFT = (1 - _AT) ** 2


def _first_zero(
    a: np.ndarray,
    b: np.ndarray,
    da: np.ndarray,
    db: np.ndarray,
) -> np.ndarray:
    """Fraction at which cubics of given values and rates at both ends first fall to
    zero, between samples; -1 where they do not.
    """
    value = a * (1 + 2 * _AT)
    value *= _LEFT
    term = da * _AT
    term *= _LEFT
    value += term

    for end, factor in ((b, 3 - 2 * _AT), (db, _AT - 1)):
        np.multiply(end, _AT, out=term)
        term *= _AT
        term *= factor
        value += term

    below = value <= 0
    below[0] = False
    lanes = np.arange(len(a))
    first = np.argmax(below, axis=0)
    high = value[np.maximum(first - 1, 0), lanes]
    low = value[first, lanes]
    at = (first - 1 + high / (high - low)) / _SAMPLES
    return np.where(below[first, lanes], at, -1.0)
