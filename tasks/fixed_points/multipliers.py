"""Stability of a gait: the eigenvalues of its step map."""

from __future__ import annotations

import math

import numpy as np

from gaitsweep.tasks.kinds import KINDS
from gaitsweep.tasks.mechanics.sums import norm, polynomial

#: Radius around an eigenvalue that is tried, over that which a linear change would
#: need.
_ROUCHE = 1.25
#: Largest move of an eigenvalue, over its distance from the next, that is found to
#: first order.
_SIMPLE = 1e-3


def multipliers(jacobian: np.ndarray, width: int) -> np.ndarray:
    """Eigenvalues of the step map, largest magnitude first, its exact zeros last.

    Parameters
    ----------
    jacobian : ndarray, shape (m, m, n)
        Derivative of the map on its section.
    width : int
        Number of multipliers, at least m; those beyond the section's dimension are
        exactly zero (paper, section 2.2).

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
        values[finite, :m] = np.linalg.eigvals(
            np.moveaxis(jacobian[:, :, finite], -1, 0)
        )
    order = np.lexsort(
        (-values[:, :m].imag, -values[:, :m].real, -np.abs(values[:, :m])), axis=-1
    )
    values[:, :m] = np.take_along_axis(values[:, :m], order, axis=1)
    return values


def characteristic(jacobian: np.ndarray, sign: float = -1.0) -> np.ndarray:
    """Coefficients of the characteristic polynomial: c of z^m - c_1 z^(m-1) + c_2
    z^(m-2) - ...

    Parameters
    ----------
    jacobian : ndarray, shape (m, m, n)
        m is 2 or 3.
    sign : float
        That of odd permutations: 1 for permanents, which of absolute values show how
        the coefficients round.

    Returns
    -------
    ndarray, shape (m, n)
        Sums of the principal minors of order 1 to m.
    """

    def minor(i: int, j: int) -> np.ndarray:
        return np.asarray(
            jacobian[i, i] * jacobian[j, j] + sign * jacobian[i, j] * jacobian[j, i]
        )

    if len(jacobian) == 2:
        return np.stack([jacobian[0, 0] + jacobian[1, 1], minor(0, 1)])
    (a, b, c), (d, e, f), (g, h, i) = jacobian
    determinant = (
        a * (e * i + sign * f * h)
        + b * (f * g + sign * d * i)
        + c * (d * h + sign * e * g)
    )
    return np.stack([a + e + i, minor(0, 1) + minor(0, 2) + minor(1, 2), determinant])


def characteristic_errors(jacobian: np.ndarray, error: np.ndarray) -> np.ndarray:
    """Bounds of the errors of the coefficients, for an error of the derivative.

    Parameters
    ----------
    jacobian : ndarray, shape (m, m, n)
    error : ndarray, shape (n,)
        Bound of the Frobenius norm of its error.

    Returns
    -------
    ndarray, shape (m, n)

    Notes
    -----
    A trace is at most sqrt(m) times a norm, so the derivatives of c_1, c_2 = (tr(J)^2 - tr(J^2))/2 and c_3 = det(J) are
    at most sqrt(m), (m + 1) |J| (for m = 2, |J|) and |J|^2.
    """
    m = len(jacobian)
    largest = norm(np.concatenate(jacobian)) + error
    factors = [np.sqrt(2.0), 1.0] if m == 2 else [np.sqrt(3.0), 4.0, 1.0]
    powers = [np.ones_like(largest), largest, largest * largest][:m]
    return np.stack(
        [factor * power * error for factor, power in zip(factors, powers, strict=True)]
    )


@np.errstate(divide="ignore", invalid="ignore", over="ignore")
def multiplier_changes(values: np.ndarray, change: np.ndarray) -> np.ndarray:
    """How eigenvalues move with the coefficients of the characteristic polynomial, to
    first order.

    Parameters
    ----------
    values : ndarray of complex, shape (n, m)
    change : ndarray, shape (m, n)
        Of the coefficients.

    Returns
    -------
    ndarray of complex, shape (n, m)
        Zero where eigenvalues are too near each other for that.
    """
    m = len(change)
    alternating = change * (-1.0) ** np.arange(m)[:, None]
    moved = np.zeros(values.shape, complex)
    for i in range(m):
        z = values[:, i]
        gaps = np.array([z - values[:, k] for k in range(m) if k != i])
        moved[:, i] = polynomial(alternating, z) / math.prod(gaps)
        moved[~(np.abs(moved[:, i]) < _SIMPLE * np.abs(gaps).min(axis=0)), i] = 0.0
    moved.imag[values.imag == 0] = 0.0  # which rounds beside a complex pair
    return moved


@np.errstate(divide="ignore", invalid="ignore", over="ignore")
def multiplier_bounds(values: np.ndarray, error: np.ndarray) -> np.ndarray:
    """Bound of the error of every eigenvalue, for errors of the coefficients of the
    characteristic polynomial.

    Parameters
    ----------
    values : ndarray of complex, shape (n, width)
        The eigenvalues, as `multipliers` gives them.
    error : ndarray, shape (m, n)

    Returns
    -------
    ndarray, shape (n,)
        Absolute.

    Notes
    -----
    At an eigenvalue the true polynomial, a product of distances from its zeros, is no larger than the polynomial's
    change d there: one zero lies within d^(1/m). By Rouche's theorem one lies within r
    if on that circle the product of the distances from all eigenvalues exceeds the
    change; if eigenvalues are simple, an r little above d over the product of the
    distances of the others.
    """
    m = len(error)
    worst = np.zeros(error.shape[1])
    for i in range(m):
        size = np.abs(values[:, i])
        change = polynomial(error, size)
        gaps = np.array(
            [np.abs(values[:, i] - values[:, k]) for k in range(m) if k != i]
        )
        radius = _ROUCHE * change / math.prod(gaps)
        on_circle = radius * math.prod(gaps - radius)
        is_simple = (radius < gaps.min(axis=0)) & (
            on_circle >= polynomial(error, size + radius)
        )
        worst = np.fmax(worst, np.where(is_simple, radius, change ** (1 / m)))
    return np.asarray(worst + np.where(np.isfinite(values[:, 0]), 0.0, np.nan))


def other_multipliers(kind: str, jacobian: np.ndarray) -> np.ndarray:
    """Return the largest magnitude of the multipliers that do not define a special
    point.

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
    critical = KINDS[kind].critical if kind in KINDS else None
    sizes = np.abs(values)
    if isinstance(critical, float):
        sizes[lanes, np.abs(values - critical).argmin(axis=1)] = 0.0
    elif critical == "pair":
        pair = np.argsort(-np.abs(values.imag), axis=1)[:, :2]
        real = np.abs(values.imag).max(axis=1) < 1e-9
        sizes[lanes[:, None], pair] = 0.0
        sizes[real] = np.inf
    return np.asarray(sizes.max(axis=1))
