"""Stability of a gait: the eigenvalues of its step map."""

from __future__ import annotations

import math

import numpy as np
from numpy import ndarray

from gaitsweep.tasks.contract.kinds import kind_of
from gaitsweep.tasks.mechanics.sums import norm, polynomial

#: Radius around an eigenvalue that is tried, over that which a linear change would
#: need.
_ROUCHE = 1.25
#: Largest move of an eigenvalue, over its distance from the next, that is found to
#: first order.
_SIMPLE = 1e-3


def multipliers(jacobian: ndarray, width: int) -> ndarray:
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
    m, _, n = jacobian.shape
    values = _of_two(jacobian) if m == 2 else _of_any(jacobian)
    # By magnitude, of a pair the upper one first.
    last_to_first = (-values.imag, -values.real, -np.abs(values))
    order = np.lexsort(last_to_first, axis=-1)
    padded = np.zeros((n, width), complex)
    padded[:, :m] = np.take_along_axis(values, order, axis=1)
    return padded


@np.errstate(divide="ignore", invalid="ignore")
def _of_two(jacobian: ndarray) -> ndarray:
    """Eigenvalues (n, 2) of matrices (2, 2, n)."""
    (a, b), (c, d) = jacobian
    middle = (a + d) / 2
    half = (a - d) / 2
    gap = half**2 + b * c
    root = np.sqrt(np.abs(gap))

    # The larger root without cancellation, the smaller from the determinant.
    outward = np.where(middle < 0, -root, root)
    large = middle + outward
    determinant = a * d - b * c
    quotient = determinant / large
    small = np.where(large != 0, quotient, 0.0)

    are_real = gap >= 0
    upper = middle + 1j * root
    lower = middle - 1j * root
    first = np.where(are_real, large, upper)
    second = np.where(are_real, small, lower)
    return np.stack([first, second], axis=1)


def _of_any(jacobian: ndarray) -> ndarray:
    """Eigenvalues (n, m) of matrices (m, m, n); NaN of those that are not finite."""
    matrices = np.moveaxis(jacobian, -1, 0)
    values = np.full(matrices.shape[:2], np.nan, complex)
    finite = np.isfinite(matrices).all(axis=(1, 2))
    values[finite] = np.linalg.eigvals(matrices[finite])
    return values


def characteristic(jacobian: ndarray, sign: float = -1.0) -> ndarray:
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
    if len(jacobian) == 2:
        (a, b), (c, d) = jacobian
        trace = a + d
        determinant = a * d + sign * b * c
        return np.stack([trace, determinant])

    (a, b, c), (d, e, f), (g, h, i) = jacobian
    trace = a + e + i

    # Without the third, second and first row and column.
    third = a * e + sign * b * d
    second = a * i + sign * c * g
    first = e * i + sign * f * h
    minors = third + second + first

    by_a = a * first
    by_b = b * (f * g + sign * d * i)
    by_c = c * (d * h + sign * e * g)
    determinant = by_a + by_b + by_c
    return np.stack([trace, minors, determinant])


def characteristic_errors(jacobian: ndarray, error: ndarray) -> ndarray:
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
    if m == 2:
        of_trace = np.sqrt(2.0) * error
        of_determinant = largest * error
        return np.stack([of_trace, of_determinant])

    of_trace = np.sqrt(3.0) * error
    of_minors = 4.0 * largest * error
    of_determinant = largest * largest * error
    return np.stack([of_trace, of_minors, of_determinant])


@np.errstate(divide="ignore", invalid="ignore", over="ignore")
def multiplier_changes(values: ndarray, change: ndarray) -> ndarray:
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
    signs = (-1.0) ** np.arange(m)
    alternating = change * signs[:, None]
    moved = np.zeros(values.shape, complex)
    for i in range(m):
        gaps = _gaps(values[:, :m], i)
        change_there = polynomial(alternating, values[:, i])
        by = change_there / math.prod(gaps)
        nearest = np.abs(gaps).min(axis=0)
        is_simple = np.abs(by) < _SIMPLE * nearest
        moved[:, i] = np.where(is_simple, by, 0.0)

    # Beside a complex pair that of a real one rounds.
    moved.imag[values.imag == 0] = 0.0
    return moved


def _gaps(values: ndarray, i: int) -> ndarray:
    """Differences of the eigenvalue i of (n, m) from all others, shape (m - 1, n)."""
    gaps = []
    for k in range(values.shape[1]):
        if k != i:
            gaps.append(values[:, i] - values[:, k])
    return np.array(gaps)


@np.errstate(divide="ignore", invalid="ignore", over="ignore")
def multiplier_bounds(values: ndarray, error: ndarray) -> ndarray:
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
        gaps = np.abs(_gaps(values[:, :m], i))
        product = math.prod(gaps)
        radius = _ROUCHE * change / product

        on_circle = radius * math.prod(gaps - radius)
        largest_change = polynomial(error, size + radius)
        is_larger = on_circle >= largest_change
        is_apart = radius < gaps.min(axis=0)
        of_any = change ** (1 / m)
        bound = np.where(is_apart & is_larger, radius, of_any)
        worst = np.fmax(worst, bound)

    worst[~np.isfinite(values[:, 0])] = np.nan
    return worst


def other_multipliers(kind: str, jacobian: ndarray) -> ndarray:
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
    values = _of_any(jacobian)
    sizes = np.abs(values)
    lanes = np.arange(len(values))
    critical = kind_of(kind).critical
    if isinstance(critical, float):
        nearest = np.abs(values - critical).argmin(axis=1)
        sizes[lanes, nearest] = 0.0
    elif critical == "pair":
        turning = np.abs(values.imag)
        pair = np.argsort(-turning, axis=1)[:, :2]
        sizes[lanes[:, None], pair] = 0.0
        sizes[turning.max(axis=1) < 1e-9] = np.inf

    sizes[np.isnan(values)] = np.inf
    return np.asarray(sizes.max(axis=1))
