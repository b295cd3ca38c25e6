"""Labels of the gaits at one slope."""

from __future__ import annotations

import numpy as np

from gaitsweep.tasks.gaits.step_check import LONG_BELOW


def places(angle: np.ndarray, ratio: np.ndarray) -> np.ndarray:
    """Label of each gait, as its index in `GAITS`.

    Parameters
    ----------
    angle : ndarray, shape (k, n)
        Stance angles [rad], or any increasing function of them, of up to k gaits at
        each of n slopes; NaN for none.
    ratio : ndarray, shape (k, n)
        (thigh rate - stance rate)/|stance rate| just before heelstrike.

    Returns
    -------
    ndarray of int, shape (k, n)
        0 (`long`) or 1 (`short`) for the largest angle of each, from 2 on for the
        others by decreasing angle, -1 where there is no gait.
    """
    exists, long = np.isfinite(angle), ratio < LONG_BELOW
    labels = np.where(exists, np.where(long, 0, 1), -1)
    crowded = np.flatnonzero(
        ((exists & long).sum(axis=0) > 1) | ((exists & ~long).sum(axis=0) > 1)
    )
    order = np.argsort(-angle[:, crowded], axis=0, kind="stable")
    place = np.take_along_axis(labels[:, crowded], order, axis=0)
    first = np.zeros(place.shape, bool)
    for label in (0, 1):
        first |= (place == label) & (np.cumsum(place == label, axis=0) == 1)
    place = np.where(first | (place < 0), place, 1 + np.cumsum(~first, axis=0))
    labels[order, crowded] = place
    return labels
