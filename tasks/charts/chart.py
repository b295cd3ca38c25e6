"""Charts: polynomials with an error measured at points drawn, and the one rule by which
nodes are added to them.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.polynomial.chebyshev import chebvander

from gaitsweep.tasks.charts.box import Refused, roots

#: Points at which polynomials of several and of one dimension are evaluated at a time,
#: so that their sums stay in the cache; and rows of a matrix product.
_POINTS, _POINTS_OF_CURVE = 256, 1024
_ROWS = 8
#: Share of the error wanted, or of the largest if all are below, above which the last
#: coefficients along a dimension ask for more nodes there.
_UNRESOLVED = 0.1
#: Most and fewest nodes along a dimension after some are added, as multiples of those
#: before; at least two are.
_MOST_GROWN = 1.6
_LEAST_GROWN = 1.15


@dataclass(frozen=True)
class Chart:
    """Polynomials of several values over the cube from -1 to 1.

    Attributes
    ----------
    sizes : tuple of int
        Nodes along each dimension; of no dimension the values are constant.
    coefficients : ndarray, shape (product of sizes, c)
        Of products of Chebyshev polynomials, the last dimension fastest.
    error : float
        The largest error that was measured, or a bound: as `fit` was given it.
    size : ndarray, shape (c,), or float
        Of each value, over which its errors count.
    """

    sizes: tuple[int, ...]
    coefficients: np.ndarray
    error: float = np.inf
    size: np.ndarray | float = 1.0

    @classmethod
    def through(
        cls,
        sizes: tuple[int, ...],
        values: np.ndarray,
        size: np.ndarray | float = 1.0,
    ) -> Chart:
        """Return the chart of values (c, n) at `tensor_nodes(sizes)`, with no error
        measured.
        """
        coefficients = values.T.reshape(*sizes, -1)
        for axis, n in enumerate(sizes):
            inverse = 2.0 / n * chebvander(roots(n), n - 1).T
            inverse[0] *= 0.5
            coefficients = np.moveaxis(
                np.tensordot(inverse, coefficients, axes=(1, axis)), 0, axis
            )

        return cls(sizes, coefficients.reshape(values.shape[1], -1), size=size)

    @classmethod
    def of_corners(cls, unit: np.ndarray, values: np.ndarray) -> Chart:
        """Return the chart of values (c, 1 + 2^d) at points inside and near the corners
        of the cube (1 + 2^d, d).

        It is linear in each dimension but for squares, of which all have one
        coefficient.
        """
        d = unit.shape[1]
        basis = [chebvander(x, 2) for x in unit.T]
        linear = list(itertools.product((0, 1), repeat=d))
        squares = [tuple(2 * (k == axis) for k in range(d)) for axis in range(d)]

        def term(degrees: tuple[int, ...]) -> np.ndarray:
            powers = [basis[axis][:, degrees[axis]] for axis in range(d)]
            return np.prod(powers, axis=0)

        terms = np.column_stack([*map(term, linear), sum(map(term, squares))])
        *of_linear, of_squares = np.linalg.solve(terms, values.T)
        coefficients = np.zeros((*(3,) * d, len(values)))
        for degrees, solved in zip(linear, of_linear, strict=True):
            coefficients[degrees] = solved
        for degrees in squares:
            coefficients[degrees] = of_squares
        return cls((3,) * d, coefficients.reshape(-1, len(values)))

    def __call__(
        self, points: np.ndarray, columns: Sequence[int] | slice = slice(None)
    ) -> np.ndarray:
        """Evaluate some of the values at points, each by itself: the bits of one do not
        depend on the others.

        Parameters
        ----------
        points : ndarray, shape (n, len(sizes))
        columns : sequence of int, optional
            Those wanted.

        Returns
        -------
        ndarray, shape (c, n)
        """
        coefficients = self.coefficients[:, columns]
        if len(self.sizes) == 1:
            return _on_curve(points[:, 0], coefficients)

        values = np.empty((len(points), coefficients.shape[1]))
        # The last coordinate first: points that share their last ones are neighbours.
        order = np.lexsort(points.T) if self.sizes else np.arange(len(points))
        for k in range(0, len(order), _POINTS):
            some = order[k : k + _POINTS]
            values[some] = self._sums(points[some], coefficients)

        return values.T

    def _sums(self, points: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
        """Sum over one dimension after the other, the last first; what neighbours among
        the points share is summed once.
        """
        c = coefficients.shape[1]
        sums = coefficients[None]
        place = np.zeros(len(points), int)
        is_new = np.zeros(len(points), bool)
        is_new[0] = True
        last = len(self.sizes) - 1
        for k in range(last, -1, -1):
            is_new[1:] |= points[1:, k] != points[:-1, k]
            first = np.flatnonzero(is_new)
            n = self.sizes[k]
            basis = chebvander(points[first, k], n - 1)
            if k == last:
                by_node = sums.reshape(-1, n, c).swapaxes(0, 1)
                sums = _product(basis, by_node.reshape(n, -1))
            else:
                sums = _terms(basis, sums[place[first]].reshape(len(first), -1, n, c))

            sums = sums.reshape(len(first), -1, c)
            place = np.cumsum(is_new) - 1

        return sums[place, 0]

    def tails(self, last: int = 1) -> np.ndarray:
        """Return the sums of the sizes of the `last` coefficients in each dimension,
        over the sizes of the values.

        Returns
        -------
        ndarray, shape (len(sizes), c)
        """
        d = len(self.sizes)
        c = self.coefficients.shape[-1]
        sizes = np.abs(self.coefficients).reshape(*self.sizes, c)
        tails = np.zeros((d, c))
        for axis in range(d):
            ends = np.moveaxis(sizes, axis, 0)[-last:]
            tails[axis] = ends.reshape(-1, c).sum(axis=0)

        return tails / self.size

    def range_of(self, column: int) -> tuple[float, float]:
        """Return bounds of a value."""
        first, *others = self.coefficients[:, column].tolist()
        spread = sum(map(abs, others))
        return first - spread, first + spread


def _on_curve(places: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    """Values (c, n) of polynomials of one dimension at places (n,), which need not be
    searched for coordinates that they share.
    """
    n, c = coefficients.shape
    values = np.empty((len(places), c))
    for k in range(0, len(places), _POINTS_OF_CURVE):
        block = slice(k, k + _POINTS_OF_CURVE)
        basis = chebvander(places[block], n - 1)
        values[block] = _product(basis, coefficients)

    return values.T


def _terms(basis: np.ndarray, terms: np.ndarray) -> np.ndarray:
    """Sum terms (p, r, n, c) times a basis (p, n) over n, one by one: how a product of
    so small matrices rounds depends on where they lie.
    """
    sums = np.zeros((len(terms), *terms.shape[1::2]))
    for i in range(terms.shape[2]):
        sums += basis[:, i, None, None] * terms[:, :, i]
    return sums


def _product(rows: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """Rows times a matrix, in blocks of one shape: a product rounds differently for
    another number of rows.
    """
    n, k = rows.shape
    padded = np.zeros((n + -n % _ROWS, k))
    padded[:n] = rows
    products = padded.reshape(-1, _ROWS, k) @ matrix
    return np.asarray(products.reshape(len(padded), -1)[:n])


def fit(
    chart: Chart,
    attempt: Callable[[tuple[int, ...], Chart], Chart],
    most: Sequence[int],
    total: int,
    good: float,
    fair: float,
    keys: int,
    enough: float = math.inf,
) -> Chart:
    """Add nodes to a chart until it is good, along the dimensions that it does not
    resolve.

    Parameters
    ----------
    chart : Chart
        The first, with its error.
    attempt : callable
        The chart with given numbers of nodes, and its error, by the chart before.
    most : sequence of int
        Most nodes along each dimension, where the first chart has no more.
    total : int
        Nodes from which on no more are added.
    good, fair : float
        The error wanted, and the largest of a useful chart.
    keys : int
        How many of the dimensions, the last, are those of keys.
    enough : float
        Nodes from which on a chart need only be useful.

    Raises
    ------
    Refused
        If the error is not fair where no nodes are added any more.
    """
    while math.prod(chart.sizes) < total:
        wanted = fair if math.prod(chart.sizes) >= enough else good
        if chart.error <= wanted:
            break
        sizes = more_nodes(chart, most, wanted)
        if not sizes:
            break
        chart = attempt(sizes, chart)

    if not chart.error <= fair:
        tails = chart.tails().max(axis=1)
        why = f"predictions err by {chart.error:.1g}"
        raise Refused(why, int(np.argmax(tails[-keys:])))

    return chart


def more_nodes(
    chart: Chart,
    most: Sequence[int],
    good: float,
) -> tuple[int, ...] | None:
    """Return how many nodes a chart should have along each dimension, as far as it may
    have more.

    Parameters
    ----------
    chart : Chart
    most : sequence of int
        Most nodes along each dimension.
    good : float
        The error wanted.
    """
    if all(n >= limit for n, limit in zip(chart.sizes, most, strict=True)):
        return None

    tails = chart.tails().max(axis=1)
    goal = _UNRESOLVED * min(good, tails.max())
    sizes = list(chart.sizes)
    for axis, tail in enumerate(tails):
        if tail > goal:
            grown = min(_grown(sizes[axis], tail, goal), most[axis])
            sizes[axis] = max(sizes[axis], grown)

    return tuple(sizes) if tuple(sizes) != chart.sizes else None


def _grown(
    n: int,
    tail: float,
    goal: float,
) -> int:
    """Nodes with which the last coefficients would reach a goal, if they go on falling
    as they did from 1.
    """
    needed = np.log(goal) / np.log(tail) if tail < 1 else _MOST_GROWN
    return max(n + 2, math.ceil(n * min(max(needed, _LEAST_GROWN), _MOST_GROWN)))
