"""Labels of the gaits at one slope."""

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
    there, long = np.isfinite(angle), ratio < LONG_BELOW
    found = np.where(there, np.where(long, 0, 1), -1)
    crowded = np.flatnonzero(((there & long).sum(axis=0) > 1) | ((there & ~long).sum(axis=0) > 1))
    order = np.argsort(-angle[:, crowded], axis=0, kind="stable")
    place = np.take_along_axis(found[:, crowded], order, axis=0)
    first = np.zeros(place.shape, bool)
    for label in (0, 1):
        first |= (place == label) & (np.cumsum(place == label, axis=0) == 1)
    place = np.where(first | (place < 0), place, 1 + np.cumsum(~first, axis=0))
    found[order, crowded] = place
    return found
