"""Stability of a gait: the eigenvalues of its stride map."""

from __future__ import annotations

import numpy as np


def multipliers(jacobian: np.ndarray, width: int) -> np.ndarray:
    """Eigenvalues of the stride map, largest magnitude first, its exact zeros last.

    Parameters
    ----------
    jacobian : ndarray, shape (m, m, n)
        Of the map on its section.
    width : int
        Multipliers to report; those the section has no room for are exactly zero (paper, section 2.2).

    Returns
    -------
    ndarray of complex, shape (n, width)
    """
    m, n = jacobian.shape[0], jacobian.shape[2]
    found = np.zeros((n, width), complex)
    if m == 2:
        (a, b), (c, d) = jacobian
        middle, gap = (a + d) / 2, ((a - d) / 2) ** 2 + b * c
        root = np.sqrt(np.abs(gap))
        # The larger root without cancellation, the smaller from the determinant.
        large = middle + np.where(middle < 0, -root, root)
        with np.errstate(divide="ignore", invalid="ignore"):
            small = np.where(large != 0, (a * d - b * c) / large, 0.0)
        found[:, 0] = np.where(gap >= 0, large, middle + 1j * root)
        found[:, 1] = np.where(gap >= 0, small, middle - 1j * root)
    else:
        good = np.isfinite(jacobian).all(axis=(0, 1))
        found[:, :m] = np.nan
        values = np.linalg.eigvals(np.moveaxis(jacobian[:, :, good], -1, 0))
        found[good, :m] = values
    order = np.lexsort((-found[:, :m].imag, -found[:, :m].real, -np.abs(found[:, :m])), axis=-1)
    found[:, :m] = np.take_along_axis(found[:, :m], order, axis=1)
    return found
