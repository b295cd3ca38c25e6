"""A patch: polynomials of one piece of the gaits of a family, over slope and keys."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial.chebyshev import chebvander

from tasks.families.box import roots
from tasks.step.step_map import Stride

#: Points at which polynomials are evaluated at a time.
_ROWS = 64
#: Logarithm of the share of the way to an end at zero step length up to which gaits are predicted.
_VANISHING = np.log(1e2)


def along(share: np.ndarray, folds: tuple[bool, bool], vanishing: tuple[bool, bool] = (False, False)) -> np.ndarray:
    """Return the share of the range of ln slope at a coordinate from 0 to 1 in which gaits are smooth.

    Parameters
    ----------
    share : ndarray
    folds : (bool, bool)
        Whether the piece begins and ends at a fold, where gaits depend on the root of the distance in ln slope.
    vanishing : (bool, bool)
        Whether it begins and ends where steps vanish, and gaits depend on the distance's logarithm: up to 1e-2 of it.

    Returns
    -------
    ndarray
        From 0 to 1.
    """
    if vanishing[0]:
        return 1 - along(1 - share, folds[::-1], vanishing[::-1])
    low, high = folds
    if vanishing[1]:
        return -np.expm1(-_VANISHING * (share**2 if low else share))
    if low and high:
        return 0.5 * (1 - np.cos(np.pi * share))
    return share**2 if low else 1 - (1 - share) ** 2 if high else share


def coordinate(
    share: np.ndarray, folds: tuple[bool, bool], vanishing: tuple[bool, bool] = (False, False)
) -> np.ndarray:
    """Return the coordinate at a share of the range of ln slope, the inverse of `along`.

    Parameters
    ----------
    share : ndarray
    folds, vanishing : (bool, bool)

    Returns
    -------
    ndarray
        From 0 to 1.
    """
    if vanishing[0]:
        return 1 - coordinate(1 - share, folds[::-1], vanishing[::-1])
    share = np.clip(share, 0.0, 1.0)
    low, high = folds
    if vanishing[1]:
        way = np.minimum(-np.log1p(-np.minimum(share, 1 - 1e-9)) / _VANISHING, 1.0)
        return np.sqrt(way) if low else way
    if low and high:
        return np.arccos(1 - 2 * share) / np.pi
    return np.sqrt(share) if low else 1 - np.sqrt(1 - share) if high else share


def fit(values: np.ndarray, sizes: tuple[int, ...]) -> np.ndarray:
    """Chebyshev coefficients of values at tensor nodes.

    Parameters
    ----------
    values : ndarray, shape (product of sizes, c)
        At `roots(size)` along each dimension, the last fastest.
    sizes : tuple of int

    Returns
    -------
    ndarray, shape (product of sizes, c)
    """
    coefficients = values.reshape(*sizes, -1)
    for axis, n in enumerate(sizes):
        inverse = 2.0 / n * chebvander(roots(n), n - 1).T
        inverse[0] *= 0.5
        coefficients = np.moveaxis(np.tensordot(inverse, coefficients, axes=(1, axis)), 0, axis)
    return coefficients.reshape(len(values), -1)


def basis(points: np.ndarray, sizes: tuple[int, ...]) -> np.ndarray:
    """Products of Chebyshev polynomials.

    Parameters
    ----------
    points : ndarray, shape (n, d)
        Of the cube from -1 to 1.
    sizes : tuple of int
        Number of polynomials in each dimension.

    Returns
    -------
    ndarray, shape (n, product of sizes)
    """
    product = np.ones((len(points), 1))
    for x, n in zip(points.T, sizes, strict=True):
        product = (product[:, :, None] * chebvander(x, n - 1)[:, None, :]).reshape(len(points), product.shape[1] * n)
    return product


def evaluate(points: np.ndarray, sizes: tuple[int, ...], coefficients: np.ndarray) -> np.ndarray:
    """Evaluate polynomials at points, each by itself: the bits of one do not depend on the others.

    Parameters
    ----------
    points : ndarray, shape (n, d)
        Of the cube from -1 to 1.
    sizes : tuple of int
        Number of polynomials in each dimension.
    coefficients : ndarray, shape (product of sizes, c)

    Returns
    -------
    ndarray, shape (n, c)
    """
    # A matrix product rounds differently for another number of rows: it gets blocks of one shape.
    n, rows = len(points), np.zeros((len(points) + -len(points) % _ROWS, len(coefficients)))
    rows[:n] = basis(points, sizes)
    return (rows.reshape(-1, _ROWS, len(coefficients)) @ coefficients).reshape(len(rows), coefficients.shape[1])[:n]


def tails(coefficients: np.ndarray, sizes: tuple[int, ...]) -> np.ndarray:
    """Sums of the sizes of the coefficients of highest degree in each dimension, the largest of all values.

    Parameters
    ----------
    coefficients : ndarray, shape (product of sizes, c)
    sizes : tuple of int

    Returns
    -------
    ndarray, shape (len(sizes),)
    """
    c = np.abs(coefficients).reshape(*sizes, -1)
    return np.array([np.take(c, -1, axis=k).reshape(-1, c.shape[-1]).sum(axis=0).max() for k in range(len(sizes))])


def side_of_fold(stride: Stride) -> np.ndarray:
    """Return a sign that changes where gaits pass a fold: that of the determinant of the equations' derivative.

    Parameters
    ----------
    stride : Stride
        Of n lanes.

    Returns
    -------
    ndarray, shape (n,)
        0 where the derivative is singular or not finite.
    """
    with np.errstate(invalid="ignore"):
        return np.asarray(np.sign(np.linalg.det(np.nan_to_num(stride.inverse).transpose(2, 0, 1))))


@dataclass
class Patch:
    """The gaits on one piece of a family's branches, in a box of keys and a range of slopes.

    Attributes
    ----------
    lines, numbers : ndarray, shape (l, d) and (l, 2)
        Coordinates of keys of surveyed lines, and on each the numbers of the branch and of the piece on it.
    folds, vanishing : (bool, bool)
        Whether the piece begins and ends at a fold, and at zero step length.
    events : (bool, bool)
        Whether it ends at an event, whose slope depends on the keys; elsewhere it is cut.
    sizes : tuple of int
        Nodes along the piece and along each key.
    ends : ndarray, shape (product of sizes[1:], 2)
        Coefficients of the ln slopes of both ends over the keys.
    end_errors : ndarray, shape (2,)
        Their errors.
    gaits : ndarray, shape (product of sizes, m + k)
        Coefficients of the gaits in similarity coordinates.
    error : float
        Largest error of a prediction that was measured.
    lipschitz : ndarray, shape (p,)
        Largest Lipschitz estimates of the Newton map at `roots(p)` along the piece.
    gradient : ndarray, shape (p, m, m + k)
        Mean gradients of the characteristic polynomial there.
    rounding_std : ndarray, shape (p, o + m)
        Standard deviations of rounding there, as `Branch` has them.
    side : float
        Of `side_of_fold`, the same on the whole piece.
    """

    lines: np.ndarray
    numbers: np.ndarray
    folds: tuple[bool, bool]
    events: tuple[bool, bool]
    sizes: tuple[int, ...]
    ends: np.ndarray
    end_errors: np.ndarray
    gaits: np.ndarray
    error: float
    lipschitz: np.ndarray
    gradient: np.ndarray
    rounding_std: np.ndarray
    side: float
    vanishing: tuple[bool, bool] = (False, False)

    def ends_at(self, unit: np.ndarray) -> np.ndarray:
        """Return the ln slopes of both ends.

        Parameters
        ----------
        unit : ndarray, shape (n, d)
            Coordinates of keys.

        Returns
        -------
        ndarray, shape (n, 2)
        """
        return evaluate(unit, self.sizes[1:], self.ends)

    def numbers_at(self, unit: np.ndarray) -> np.ndarray:
        """Return the numbers of branch and piece on the nearest surveyed line.

        Parameters
        ----------
        unit : ndarray, shape (n, d)
            Coordinates of keys.

        Returns
        -------
        ndarray of int, shape (n, 2)
        """
        return self.numbers[np.abs(unit[:, None] - self.lines).max(axis=2).argmin(axis=1)]

    def reaches(self, q: np.ndarray, ends: np.ndarray) -> np.ndarray:
        """Whether gaits lie on the part of the piece that the polynomials describe, not nearer to vanishing steps.

        Parameters
        ----------
        q : ndarray, shape (n,)
            Values of ln slope, between the ends.
        ends : ndarray, shape (n, 2)
            Of `ends_at`.

        Returns
        -------
        ndarray of bool, shape (n,)
        """
        share = (q - ends[:, 0]) / (ends[:, 1] - ends[:, 0])
        low, high = (np.exp(-_VANISHING) * vanishes for vanishes in self.vanishing)
        return (share >= low) & (share <= 1 - high)

    def predict(self, unit: np.ndarray, q: np.ndarray, ends: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Predict gaits.

        Parameters
        ----------
        unit : ndarray, shape (n, d)
            Coordinates of keys.
        q : ndarray, shape (n,)
            Values of ln slope.
        ends : ndarray, shape (n, 2)
            Of `ends_at`.

        Returns
        -------
        w : ndarray, shape (m + k, n)
        node : ndarray of int, shape (n,)
            The nearest of the places along the piece at which rounding is measured.
        """
        s = coordinate((q - ends[:, 0]) / (ends[:, 1] - ends[:, 0]), self.folds, self.vanishing)
        x = 2 * s - 1
        w = evaluate(np.column_stack([x, unit]), self.sizes, self.gaits).T
        return w, np.abs(x[:, None] - roots(max(1, len(self.lipschitz)))).argmin(axis=1)
