"""Sheets: charts that give gaits to a wanted accuracy, over a piece of branches or a
part of one, and over 0 to 2 keys.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gaitsweep.tasks.charts.box import tensor_nodes
from gaitsweep.tasks.charts.chart import Chart, more_nodes
from gaitsweep.tasks.charts.span import Span

#: Factor by which the bound exceeds the largest error at the points drawn.
_SAFETY = 8.0
#: Nodes along each dimension from which on the last two coefficients count for the
#: bound, not the last alone: of a function that is even or odd every other one
#: vanishes.
_TWO_FROM = 6
#: Share of the first drawn point's distance from a fold within which errors are
#: unknown.
_UNMEASURED = 0.25


@dataclass(frozen=True)
class Sampled:
    """Gaits at the nodes of a span and, after them, at points drawn to check
    polynomials through the former.

    `values` and `size`, (c, n), are smooth quantities and the sizes over which their
    errors count; `bound` is that of the errors, infinite unless all gaits were found
    and their legs pass as often, which is `passes`.
    """

    values: np.ndarray
    size: np.ndarray
    bound: float
    passes: int

    def chart(self, sizes: tuple[int, ...], points: np.ndarray) -> Chart | None:
        """Return the chart through the nodes, if the gaits are all there.

        Its error is the bound that the other points, the last coefficients and the
        gaits' own bounds give.

        Parameters
        ----------
        sizes : tuple of int
            Nodes along each dimension.
        points : ndarray, shape (n, len(sizes))
        """
        if not np.isfinite(self.bound):
            return None

        nodes = math.prod(sizes)
        chart = Chart.through(sizes, self.values[:, :nodes], self.size.min(axis=1))
        off, tails = self._errors(chart, points[nodes:])
        error = _SAFETY * off.max() + tails.max(axis=1).sum() + self.bound
        return replace(chart, error=float(error))

    def served(self, chart: Chart, points: np.ndarray, good: float) -> np.ndarray:
        """Return which values a chart gives to an accuracy, bool (c,): also those that
        no gait has.

        Parameters
        ----------
        chart : Chart
            Through the nodes.
        points : ndarray, shape (n, len(sizes))
        good : float
        """
        off, tails = self._errors(chart, points[len(chart.coefficients) :])
        is_good = _SAFETY * off + tails.sum(axis=0) + self.bound <= good
        return np.asarray(is_good | np.isnan(self.values).all(axis=1))

    def _errors(self, chart: Chart, drawn: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Largest errors of values at the points drawn, (c,), and their last
        coefficients along each dimension, (d, c), over their sizes.
        """
        nodes = len(chart.coefficients)
        off = np.abs(chart(drawn) - self.values[:, nodes:])
        tails = chart.tails(2 if min(chart.sizes) >= _TWO_FROM else 1)
        return (off / self.size[:, nodes:]).max(axis=1), tails


@dataclass(frozen=True)
class Sheet:
    """Polynomials that give the gaits on a span.

    Attributes
    ----------
    span : Span
    chart : Chart or None
        Of smooth quantities, with the bound of their errors; None where none serves.
    passes : int
        How often the legs pass.
    unmeasured : (float, float)
        How near both ends of the span, in its position, errors are not known; -1 where
        they are known up to the end.
    served : ndarray of bool, shape (c,), optional
        Which values the chart gives, where it does not give all.
    """

    span: Span
    chart: Chart | None = None
    passes: int = 0
    unmeasured: tuple[float, float] = (-1.0, -1.0)
    served: np.ndarray | None = None

    @classmethod
    def of(
        cls,
        span: Span,
        chart: Chart,
        passes: int,
        drawn: np.ndarray,
    ) -> Sheet:
        """Return the sheet of a chart that was checked at some positions: nearer to a
        fold nothing is known.

        Parameters
        ----------
        span : Span
        chart : Chart
        passes : int
        drawn : ndarray, shape (n,)
        """
        nearest = 1 + drawn.min(), 1 - drawn.max()
        unmeasured = [0.0 if vanishing else -1.0 for vanishing in span.vanishing]
        for end, edge in enumerate((0, 1)):
            if span.folds[end] and span.part[end] == edge:
                unmeasured[end] = _UNMEASURED * nearest[end]
        return cls(span, chart, passes, (unmeasured[0], unmeasured[1]))

    def is_measured(self, points: np.ndarray) -> np.ndarray:
        """Whether errors are known at points of the span.

        Parameters
        ----------
        points : ndarray, shape (n, 1 + d)

        Returns
        -------
        ndarray of bool, shape (n,)
        """
        low, high = self.unmeasured
        position = points[:, 0]
        inside = np.abs(position) <= 1
        return np.asarray(inside & (1 + position > low) & (1 - position > high))


@dataclass(frozen=True)
class Asked:
    """A sheet that is to be fitted.

    Attributes
    ----------
    number : int
        Of the piece or the patch that it is for.
    span : Span
    sizes, most : tuple of int
        Nodes along each dimension to begin with, and the most.
    drawn : ndarray, shape (k, 1 + d), optional
        Points that check it; by default the span draws them.
    """

    number: int
    span: Span
    sizes: tuple[int, ...]
    most: tuple[int, ...]
    drawn: np.ndarray | None = None

    @property
    def points(self) -> np.ndarray:
        """The nodes, and after them the points that check polynomials through them."""
        drawn = self.span.drawn(self.sizes[0]) if self.drawn is None else self.drawn
        return np.vstack([tensor_nodes(self.sizes), drawn])

    def fitted(
        self,
        chart: Chart,
        passes: int,
        points: np.ndarray,
    ) -> Sheet:
        """Return the sheet of a chart that is good enough."""
        return Sheet.of(self.span, chart, passes, points[math.prod(self.sizes) :, 0])

    def halves(
        self,
        chart: Chart | None,
        bound: float,
        good: float,
    ) -> list[Asked]:
        """Return both halves, if they may be better where a chart is not good enough,
        or there is none.
        """
        # Gaits themselves are no better in halves, but beside folds.
        if chart and bound > good and not any(self.span.folds):
            return []
        return [replace(self, span=half) for half in self.span.halves()]


Solve = Callable[[Sequence[Asked], Sequence[np.ndarray]], Iterable[Sampled]]


def fit_sheets(
    asked: Sequence[Asked],
    solve: Solve,
    good: float,
    is_needed: Callable[[Span], bool],
    by_value: bool = False,
) -> list[tuple[int, Sheet]]:
    """Fit sheets, with more nodes, or in halves, where they do not reach an accuracy.

    Parameters
    ----------
    asked : sequence of Asked
    solve : callable
        Solves the gaits of several at points of their spans, (n, 1 + d) of each.
    good : float
        Largest error bound wanted.
    is_needed : callable
        Whether half of a span is needed.
    by_value : bool
        Whether a chart that does not reach the accuracy gives those values in which it
        does.

    Returns
    -------
    list of (int, Sheet)
        Those needed and the numbers of their pieces; without a chart where the accuracy
        is not reached.
    """
    done: list[tuple[int, Sheet]] = []
    while asked:
        points = [sheet.points for sheet in asked]
        again: list[Asked] = []
        for sheet, x, sampled in zip(asked, points, solve(asked, points), strict=True):
            chart = sampled.chart(sheet.sizes, x)
            if chart and chart.error <= good:
                done.append((sheet.number, sheet.fitted(chart, sampled.passes, x)))
            elif chart and (sizes := more_nodes(chart, sheet.most, good)):
                again.append(replace(sheet, sizes=sizes))
            else:
                halves = sheet.halves(chart, sampled.bound, good)
                needed = [half for half in halves if is_needed(half.span)]
                again += needed
                if chart and by_value and not needed:
                    whole = sheet.fitted(chart, sampled.passes, x)
                    served = sampled.served(chart, x, good)
                    done.append((sheet.number, replace(whole, served=served)))
                elif not halves:
                    done.append((sheet.number, Sheet(sheet.span)))

        asked = again

    return done
