"""Where the guard of the next strike falls through zero between time steps."""

from __future__ import annotations

import numpy as np


def guard(
    free: bool, x: np.ndarray, ground: np.ndarray | None = None
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
    mean, apart = 0.5 * scale * (x[0] + x[1]), 0.5 * scale * (x[1] - x[0])
    mean_rate, apart_rate = 0.5 * scale * (x[2] + x[3]), 0.5 * scale * (x[3] - x[2])
    rate = (
        np.cos(mean) * np.sin(apart) * mean_rate
        + np.sin(mean) * np.cos(apart) * apart_rate
    )
    return 2 * np.sin(mean) * np.sin(apart) - height, 2 * rate


def crossing(
    free: bool, X: np.ndarray, h: float, ground: np.ndarray | None = None
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
    g, dg = guard(free, X.swapaxes(0, 1), ground)
    dg = h * dg
    a, b, da, db = g[:-1], g[1:], dg[:-1], dg[1:]
    with np.errstate(invalid="ignore"):
        crosses = ((a > 0) | ((a == 0) & (da > 0))) & ((b <= 0) | ((da < 0) & (db > 0)))
        if not free:
            crosses &= (X[1:, 0] < 0) & ((ground is None) | (X[1:, 1] > X[1:, 0]))
    fraction = np.full(a.shape, -1.0)
    lanes = np.nonzero(crosses)
    if not len(lanes[0]):
        return fraction
    a, b, da, db = a[lanes], b[lanes], da[lanes], db[lanes]
    s = np.linspace(0.0, 1.0, 17)[:, None]
    value = (
        a * (1 + 2 * s) * (1 - s) ** 2
        + da * s * (1 - s) ** 2
        + b * s * s * (3 - 2 * s)
        + db * s * s * (s - 1)
    )
    below = (value <= 0) & (s > 0)
    first = np.argmax(below, axis=0)
    column = np.arange(len(a))
    high, low = value[np.maximum(first - 1, 0), column], value[first, column]
    with np.errstate(divide="ignore", invalid="ignore"):
        at = (first - 1 + high / (high - low)) / 16
    falls = below.any(axis=0)
    if not free:
        stance, after = X[:-1, 0][lanes], X[1:, 0][lanes]
        falls &= stance + at * (after - stance) < 0
    fraction[lanes] = np.where(falls, at, -1.0)
    return fraction
