"""Feigenbaum's scaling of a cascade: ratios of its intervals and the slope of
accumulation.
"""

from __future__ import annotations

import numpy as np

#: Feigenbaum's constant (M. J. Feigenbaum, J. Stat. Phys. 19, 1978), to the digits a
#: double holds.
DELTA = 4.669201609102990


def ratios(flips: np.ndarray) -> np.ndarray:
    """Compute the ratios (s_(k-1) - s_(k-2)) / (s_k - s_(k-1)) of successive flips.

    Parameters
    ----------
    flips : ndarray, shape (n,) [rad]

    Returns
    -------
    ndarray, shape (n,)
        NaN for the first two.
    """
    intervals = np.diff(np.asarray(flips, float))
    result = np.full(len(flips), np.nan)
    result[2:] = intervals[:-1] / intervals[1:]
    return result


def accumulation(flips: np.ndarray) -> tuple[float, float, float]:
    """Extrapolate the slope at which flips accumulate, with an interval.

    Parameters
    ----------
    flips : ndarray, shape (n,) [rad]

    Returns
    -------
    value, low, high : float [rad]
        NaN below three flips.

    Notes
    -----
    The remaining intervals form a geometric series of ratio DELTA up to corrections that shrink from flip to flip, so
    the difference of the last two extrapolations exceeds the error of the last one.
    """
    flips = np.asarray(flips, float)
    if len(flips) < 3:
        return np.nan, np.nan, np.nan
    estimate = flips[1:] + np.diff(flips) / (DELTA - 1)
    width = abs(estimate[-1] - estimate[-2])
    return float(estimate[-1]), float(estimate[-1] - width), float(estimate[-1] + width)
