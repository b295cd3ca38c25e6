"""When two gaits are the same: one distance, and how near is near enough for what.

Gaits are compared in similarity coordinates, which are of order one over decades of
slope; the distance is the largest difference of a coordinate.
"""

from __future__ import annotations

import numpy as np

#: Two gaits that Newton's method solved at one slope.
SAME_GAIT = 1e-6
#: A solved gait and the polynomial of a branch, also a coarse one near a fold.
ON_BRANCH = 1e-4
#: Special points that were located from two sides, or in two ways.
SAME_POINT = 1e-3
#: A special point and a guess of it between nodes: farther away it may be another.
NEAR_POINT = 1e-2


def same(a: np.ndarray, b: np.ndarray, within: float) -> np.ndarray:
    """Return whether points are the same.

    Parameters
    ----------
    a, b : ndarray, shape (c,) or (c, n)
    within : float
        Largest difference of a coordinate: one of those of this module.

    Returns
    -------
    ndarray of bool, shape () or (n,)
    """
    return np.asarray(np.abs(a - b).max(axis=0) < within)
