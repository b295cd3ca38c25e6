"""Feigenbaum's scaling of a cascade: ratios of its intervals and the slope they accumulate at."""

from __future__ import annotations

import numpy as np

#: Feigenbaum's constant (M. J. Feigenbaum, J. Stat. Phys. 19, 1978), to the digits a double holds.
DELTA = 4.669201609102990


def ratios(flips: np.ndarray) -> np.ndarray:
    """(s_k - s_(k-1)) / (s_(k+1) - s_k) of successive flips, shape (n,), NaN where there are no three."""
    flips = np.asarray(flips, float)
    found = np.full(len(flips), np.nan)
    step = np.diff(flips)
    found[2:] = step[:-1] / step[1:]
    return found


def accumulation(flips: np.ndarray) -> tuple[float, float, float]:
    """Where the flips accumulate, with an interval.

    Returns
    -------
    value, low, high

    Notes
    -----
    The remaining geometric series has the ratio DELTA up to corrections that shrink from flip to flip, so the
    difference of the last two extrapolations is more than what the last one still misses.
    """
    flips = np.asarray(flips, float)
    if len(flips) < 3:
        return np.nan, np.nan, np.nan
    estimate = flips[1:] + np.diff(flips) / (DELTA - 1)
    width = abs(estimate[-1] - estimate[-2])
    return float(estimate[-1]), float(estimate[-1] - width), float(estimate[-1] + width)
