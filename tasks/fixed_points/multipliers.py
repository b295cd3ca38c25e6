"""Stability of a gait: the eigenvalues of its step map."""

from __future__ import annotations

import numpy as np


def multipliers(jacobian: np.ndarray, width: int) -> np.ndarray:
    """Eigenvalues of the step map, largest magnitude first, its exact zeros last.

    Parameters
    ----------
    jacobian : ndarray, shape (m, m, n)
        Derivative of the map on its section.
    width : int
        Number of multipliers, at least m; those beyond the section's dimension are exactly zero (paper, section 2.2).

    Returns
    -------
    ndarray of complex, shape (n, width)
        NaN where the derivative is not finite.
    """
    m, n = jacobian.shape[0], jacobian.shape[2]
    values = np.zeros((n, width), complex)
    if m == 2:
        (a, b), (c, d) = jacobian
        middle, gap = (a + d) / 2, ((a - d) / 2) ** 2 + b * c
        root = np.sqrt(np.abs(gap))
        # The larger root without cancellation, the smaller from the determinant.
        large = middle + np.where(middle < 0, -root, root)
        with np.errstate(divide="ignore", invalid="ignore"):
            small = np.where(large != 0, (a * d - b * c) / large, 0.0)
        values[:, 0] = np.where(gap >= 0, large, middle + 1j * root)
        values[:, 1] = np.where(gap >= 0, small, middle - 1j * root)
    else:
        finite = np.isfinite(jacobian).all(axis=(0, 1))
        values[:, :m] = np.nan
        values[finite, :m] = np.linalg.eigvals(np.moveaxis(jacobian[:, :, finite], -1, 0))
    order = np.lexsort((-values[:, :m].imag, -values[:, :m].real, -np.abs(values[:, :m])), axis=-1)
    values[:, :m] = np.take_along_axis(values[:, :m], order, axis=1)
    return values


@np.errstate(divide="ignore", invalid="ignore", over="ignore")
def multiplier_bounds(jacobian: np.ndarray, values: np.ndarray, error: np.ndarray) -> np.ndarray:
    """Bound of the error of every eigenvalue of the step map, for an error of its derivative.

    Parameters
    ----------
    jacobian : ndarray, shape (m, m, n)
    values : ndarray of complex, shape (n, width)
        Its eigenvalues, as `multipliers` gives them.
    error : ndarray, shape (n,)
        Bound of the Frobenius norm of the derivative's error.

    Returns
    -------
    ndarray, shape (n,)
        Absolute.

    Notes
    -----
    Of m zeros of a polynomial p one lies within m |p(z)|/|p'(z)| of z, and p(z) changes by the adjugate of z - J times
    the error. Where eigenvalues meet, Elsner's bound is smaller (Bhatia, Matrix Analysis, theorem VIII.1.1,
    doi:10.1007/978-1-4612-0653-8).
    """
    m = len(jacobian)
    size = np.sqrt((jacobian**2).sum(axis=(0, 1)))
    elsner = (2 * size + error) ** (1 - 1 / m) * error ** (1 / m)
    worst = np.zeros(len(error))
    for i in range(m):
        shifted = values[:, i, None, None] * np.eye(m) - np.moveaxis(jacobian, -1, 0)
        others = np.delete(values[:, :m], i, axis=1)
        gap = np.abs(values[:, i, None] - others).prod(axis=1)
        own = m * error * _adjugate_norm(shifted) / gap
        worst = np.fmax(worst, np.fmin(own, elsner))
    return np.asarray(worst + np.where(np.isfinite(size), 0.0, np.nan))


def _adjugate_norm(matrices: np.ndarray) -> np.ndarray:
    """Frobenius norms of the adjugates of matrices (n, m, m), m at most 3."""
    if matrices.shape[1] == 3:
        a, b, c = np.moveaxis(matrices, 1, 0)
        matrices = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=1)
    return np.asarray(np.sqrt((np.abs(matrices) ** 2).sum(axis=(1, 2))))


def other_multipliers(kind: str, jacobian: np.ndarray) -> np.ndarray:
    """Return the largest magnitude of the multipliers that do not define a special point.

    Parameters
    ----------
    kind : str
        Of a flip -1 is left out, of a fold 1, of a Neimark-Sacker point the pair.
    jacobian : ndarray, shape (m, m, n)

    Returns
    -------
    ndarray, shape (n,)
        Infinite where the derivative is not finite, and where a pair is real.
    """
    A = np.moveaxis(jacobian, -1, 0)
    finite = np.isfinite(A).all(axis=(1, 2))
    values = np.full(A.shape[:2], np.inf, complex)
    values[finite] = np.linalg.eigvals(A[finite])
    lanes = np.arange(len(A))
    left = {"flip": -1.0, "fold": 1.0}
    sizes = np.abs(values)
    if kind in left:
        sizes[lanes, np.abs(values - left[kind]).argmin(axis=1)] = 0.0
    if kind == "neimark_sacker":
        pair = np.argsort(-np.abs(values.imag), axis=1)[:, :2]
        real = np.abs(values.imag).max(axis=1) < 1e-9
        sizes[lanes[:, None], pair] = 0.0
        sizes[real] = np.inf
    return np.asarray(sizes.max(axis=1))
