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
    norms = _adjugate_norms(jacobian, values.T[:m])
    for i in range(m):
        gap = np.ones(len(error))
        for k in set(range(m)) - {i}:
            gap = gap * np.abs(values[:, i] - values[:, k])
        worst = np.fmax(worst, np.fmin(m * error * norms[i] / gap, elsner))
    return np.asarray(worst + np.where(np.isfinite(size), 0.0, np.nan))


def _adjugate_norms(jacobian: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Frobenius norms (m, n) of the adjugates of z - J at its m eigenvalues (m, n), for m = 2 and 3.

    The adjugate is the product of J less each of the other eigenvalues; its norm follows from scalar products.
    """
    m = len(jacobian)
    trace, square = np.einsum("iin->n", jacobian), (jacobian**2).sum(axis=(0, 1))
    if m == 2:
        other = values[::-1]
        norm = square - 2 * other.real * trace + 2 * np.abs(other) ** 2
        largest = square
    else:
        twice = np.einsum("ijn,jkn->ikn", jacobian, jacobian)
        total, product = values.sum(axis=0) - values, np.stack([values[k - 2] * values[k - 1] for k in range(3)])
        largest = (twice**2).sum(axis=(0, 1))
        norm = largest - 2 * total.real * (twice * jacobian).sum(axis=(0, 1))
        norm += 2 * product.real * np.einsum("iin->n", twice) + np.abs(total) ** 2 * square
        norm += 3 * np.abs(product) ** 2 - 2 * (total * product.conj()).real * trace
    # Terms that cancel are known to the root of rounding.
    return np.sqrt(np.maximum(norm, 0.0) + 1e-14 * largest)


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
