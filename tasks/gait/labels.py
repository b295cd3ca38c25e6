"""Labels of the gaits at one slope: `long` or `short`, and `other1`, ... for all but the one of each with the largest angle."""

from __future__ import annotations

import numpy as np

#: A gait is long if its rate ratio just before heelstrike lies below.
LONG_BELOW = 0.5


def places(angle: np.ndarray, ratio: np.ndarray) -> np.ndarray:
    """Which label each gait has, as its place in `GAITS`.

    Parameters
    ----------
    angle : ndarray, shape (k, n)
        Stance angles, or anything that rises with them, of up to k gaits at each of n slopes; NaN where there is none.
    ratio : ndarray, shape (k, n)
        (thigh rate - stance rate)/|stance rate| just before heelstrike.

    Returns
    -------
    ndarray of int, shape (k, n)
        0 (`long`) or 1 (`short`) for the largest angle of each, 2 and on for the others by falling angle, -1 where
        there is no gait.
    """
    order = np.argsort(-angle, axis=0, kind="stable")
    there = np.isfinite(np.take_along_axis(angle, order, axis=0))
    long = np.take_along_axis(ratio, order, axis=0) < LONG_BELOW
    first = np.zeros_like(there)
    for mine in (there & long, there & ~long):
        first |= mine & (np.cumsum(mine, axis=0) == 1)
    place = np.where(first, (~long).astype(int), 1 + np.cumsum(there & ~first, axis=0))
    found = np.empty_like(place)
    np.put_along_axis(found, order, np.where(there, place, -1), axis=0)
    return found
