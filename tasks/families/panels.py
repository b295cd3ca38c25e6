"""Panels: polynomials of the gaits on one piece of a branch over ranges of ln slope.

A panel's content is a function of the line, the range and the accuracy alone; the slopes determine which are made.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.polynomial.chebyshev import chebval

from tasks.families.box import roots
from tasks.families.patch import along, basis, coordinate, fit

#: Widest range of ln slope; pieces of branches are cut at its multiples.
_WIDTH = 1.0
#: Narrowest part of such a range, in its coordinate from 0 to 1.
_NARROWEST = 2.0**-12
#: Factor by which the bound exceeds the largest error at the points drawn.
_SAFETY = 8.0
#: Share of the first drawn point's distance from a fold within which errors are unknown.
_UNMEASURED = 0.25


@dataclass(frozen=True)
class Panel:
    """Polynomials of smooth quantities over a part of a range of ln slope of one piece of a branch.

    Attributes
    ----------
    piece : int
        Number of the piece.
    low, high : float
        Range of ln slope of which it is a part.
    folds : (bool, bool)
        Whether that range begins and ends at a fold.
    part : (float, float)
        The part, in the coordinate of `along`.
    coefficients : ndarray, shape (nodes, c)
        Of Chebyshev polynomials; empty where no polynomials serve.
    error : float
        Bound of their errors, each relative to the size of its quantity.
    passes : int
        How often the legs of its gaits pass.
    """

    piece: int
    low: float
    high: float
    folds: tuple[bool, bool]
    part: tuple[float, float] = (0.0, 1.0)
    coefficients: np.ndarray = field(default_factory=lambda: np.empty((0, 0)), repr=False)
    error: float = np.inf
    passes: int = 0

    def log_slope(self, x: np.ndarray) -> np.ndarray:
        """Ln slopes of points.

        Parameters
        ----------
        x : ndarray, shape (n,)
            From -1 to 1.

        Returns
        -------
        ndarray, shape (n,)
        """
        start, stop = self.part
        return self.low + (self.high - self.low) * along(start + (stop - start) * (x + 1) / 2, self.folds)

    def point(self, log_slope: np.ndarray) -> np.ndarray:
        """Points of ln slopes, the inverse of `log_slope`.

        Parameters
        ----------
        log_slope : ndarray, shape (n,)

        Returns
        -------
        ndarray, shape (n,)
            From -1 to 1.
        """
        start, stop = self.part
        share = coordinate((log_slope - self.low) / (self.high - self.low), self.folds)
        return np.clip(2 * (share - start) / (stop - start) - 1, -1, 1)

    @property
    def bounds(self) -> tuple[float, float]:
        """Least and largest ln slope."""
        low, high = self.log_slope(np.array([-1.0, 1.0]))
        return float(low), float(high)

    def samples(self, nodes: int) -> np.ndarray:
        """Chebyshev nodes, and between them and beyond points drawn by a hash of the panel.

        Returns
        -------
        ndarray, shape (2 nodes + 1,)
            From -1 to 1: the nodes first.
        """
        numbers = np.array([self.low, self.high, *self.folds, *self.part])
        seed = int.from_bytes(hashlib.sha256(numbers.tobytes()).digest()[:8], "little")
        angle = np.arange(nodes + 1) + np.random.default_rng(seed).random(nodes + 1) - 0.5
        # Beyond the outermost nodes there is only half a gap, and very near its end a gait beside a fold is rounding.
        angle[0], angle[-1] = 0.4 * angle[0] + 0.3, nodes - 0.3 + 0.4 * (angle[-1] - nodes)
        return np.concatenate([roots(nodes), -np.cos(np.pi * angle / nodes)])

    def halves(self) -> Iterator[Panel]:
        """Yield both halves of the panel, unless they are too narrow."""
        start, stop = self.part
        middle = 0.5 * (start + stop)
        if middle - start >= _NARROWEST:
            yield replace(self, part=(start, middle))
            yield replace(self, part=(middle, stop))

    def evaluate(self, x: np.ndarray, column: int) -> np.ndarray:
        """Evaluate a polynomial.

        Parameters
        ----------
        x : ndarray, shape (n,)
            Points from -1 to 1.
        column : int

        Returns
        -------
        ndarray, shape (n,)
        """
        return np.asarray(chebval(x, self.coefficients[:, column]))

    def is_measured(self, x: np.ndarray) -> np.ndarray:
        """Whether points are as far from a fold as those whose errors were measured.

        Parameters
        ----------
        x : ndarray, shape (n,)
            From -1 to 1.

        Returns
        -------
        ndarray of bool, shape (n,)
        """
        inside = np.ones(len(x), bool)
        if any(self.folds):
            first, last = np.sort(self.samples(len(self.coefficients)))[[0, -1]]
            if self.folds[0] and self.part[0] == 0:
                inside &= x + 1 > _UNMEASURED * (first + 1)
            if self.folds[1] and self.part[1] == 1:
                inside &= 1 - x > _UNMEASURED * (1 - last)
        return inside

    def range_of(self, column: int) -> tuple[float, float]:
        """Bounds of the values of a polynomial."""
        return value_bounds(self.coefficients[:, column])


def panels_over(piece: int, low: float, high: float, folds: tuple[bool, bool], log_slope: np.ndarray) -> list[Panel]:
    """Widest panels of a piece that hold some slopes.

    Parameters
    ----------
    piece : int
        Its number.
    low, high : float
        Its range of ln slope.
    folds : (bool, bool)
        Whether it begins and ends at a fold.
    log_slope : ndarray, shape (n,)

    Returns
    -------
    list of Panel
    """
    cuts = np.arange(np.floor(low / _WIDTH) + 1, np.ceil(high / _WIDTH)) * _WIDTH
    edges = np.concatenate([[low], cuts, [high]])
    inside = np.clip(np.searchsorted(edges, log_slope, side="right") - 1, 0, len(edges) - 2)
    holds = np.flatnonzero(np.bincount(inside, minlength=1))
    return [
        Panel(piece, float(edges[k]), float(edges[k + 1]), (folds[0] and k == 0, folds[1] and k == len(edges) - 2))
        for k in holds.tolist()
    ]


def value_bounds(coefficients: np.ndarray) -> tuple[float, float]:
    """Least and largest value that a sum of Chebyshev polynomials may have.

    Parameters
    ----------
    coefficients : ndarray, shape (n,)
        The first is that of the constant.
    """
    first, *others = coefficients.tolist()
    spread = sum(map(abs, others))
    return first - spread, first + spread


@dataclass(frozen=True)
class Sampled:
    """Solutions at nodes and, after them, at points drawn to check the polynomials.

    `values` and `size`, (n, c), are quantities and the sizes over which their errors count; `bound` is that of the
    errors; `passes` is how often the legs pass; `good` is whether all were found, with as many passes.
    """

    values: np.ndarray
    size: np.ndarray
    bound: float
    passes: int
    good: bool

    def fit(self, drawn: np.ndarray, sizes: tuple[int, ...]) -> tuple[np.ndarray, float]:
        """Fit polynomials to the values at the nodes, and check them at the other points.

        Parameters
        ----------
        drawn : ndarray, shape (j, d)
            The other points, in the cube from -1 to 1.
        sizes : tuple of int
            Nodes along each dimension.

        Returns
        -------
        coefficients : ndarray, shape (product of sizes, c)
        error : float
            By how much they may err, as far as the other points show.
        """
        nodes = len(self.values) - len(drawn)
        coefficients = fit(self.values[:nodes], sizes)
        off = np.abs(basis(drawn, sizes) @ coefficients - self.values[nodes:]) / self.size[nodes:]
        return coefficients, float(_SAFETY * off.max())


def fit_panels(
    panels: list[Panel],
    nodes: int,
    accuracy: float,
    solve: Callable[[list[Panel], list[np.ndarray]], list[Sampled]],
    is_needed: Callable[[Panel], bool],
) -> list[Panel]:
    """Fit polynomials to panels, and to halves of those that do not reach an accuracy.

    Parameters
    ----------
    panels : list of Panel
    nodes : int
        Number of nodes of each.
    accuracy : float
        Largest error bound wanted.
    solve : callable
        Solves panels at ln slopes, (2 nodes + 1,) of each.
    is_needed : callable
        Whether a panel holds a slope asked for.

    Returns
    -------
    list of Panel
        Those needed, in the order of their pieces and slopes; of no coefficients where the accuracy is not reached.
    """
    done: list[Panel] = []
    while panels:
        points = [panel.samples(nodes) for panel in panels]
        slopes = [panel.log_slope(x) for panel, x in zip(panels, points, strict=True)]
        further: list[Panel] = []
        for panel, x, sampled in zip(panels, points, solve(panels, slopes), strict=True):
            fitted = _fit(panel, x, sampled, nodes)
            halves = list(panel.halves()) if not fitted.error <= accuracy else []
            if fitted.error <= accuracy:
                done.append(fitted)
            elif not halves or (sampled.good and sampled.bound > accuracy and not any(panel.folds)):
                done.append(panel)
            else:
                further += [half for half in halves if is_needed(half)]
        panels = further
    return sorted(done, key=lambda panel: (panel.piece, *panel.bounds))


def _fit(panel: Panel, x: np.ndarray, sampled: Sampled, nodes: int) -> Panel:
    """Panel with polynomials through its nodes, and the bound that the other points and the last coefficients give."""
    if not sampled.good:
        return panel
    coefficients, off = sampled.fit(x[nodes:, None], (nodes,))
    tail = (np.abs(coefficients[-2:]).sum(axis=0) / sampled.size.min(axis=0)).max()
    return replace(panel, coefficients=coefficients, error=float(off + tail + sampled.bound), passes=sampled.passes)
