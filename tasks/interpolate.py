"""Gaits to a wanted accuracy that are not integrated: sheets over panels of a line's
branches, or over patches.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gaitsweep.tasks import status
from gaitsweep.tasks.accuracy import nodes_for
from gaitsweep.tasks.continuation.branch import Branch
from gaitsweep.tasks.families.box import Refused, tensor_nodes
from gaitsweep.tasks.families.cell import Block, Cell
from gaitsweep.tasks.families.chart import Chart, fit
from gaitsweep.tasks.families.family import Family
from gaitsweep.tasks.families.patch import Patch, measured
from gaitsweep.tasks.families.pieces import Piece, pieces_of
from gaitsweep.tasks.families.span import Span
from gaitsweep.tasks.fixed_points.polish import Guesses, Polished, settle
from gaitsweep.tasks.fixed_points.step_check import LONG_BELOW
from gaitsweep.tasks.measures.gaits import Part, Wanted, describe
from gaitsweep.tasks.measures.smooth import Smooth
from gaitsweep.tasks.step.lanes import join_lanes
from gaitsweep.tasks.step.problem import Lanes, Problem

#: Share of the accuracy that polynomials may use; numbers are also rounded.
_SHARE = 0.9
#: Factor by which the bound exceeds the largest error at the points drawn.
_SAFETY = 8.0
#: Nodes along each dimension from which on the last two coefficients count for the
#: bound, not the last alone: of a function that is even or odd every other one
#: vanishes.
_TWO_FROM = 6
#: Gaits of one label whose angles differ by fewer accuracies are integrated, and those
#: with ratios as near 1/2.
_TIE = 4.0
#: Share of the first drawn point's distance from a fold within which errors are
#: unknown.
_UNMEASURED = 0.25
#: Gaits nearer an end of their branch in ln slope are integrated, and so are those
#: whose errors reach it.
_NEAR_END, _END_SAFETY = 1e-9, 8.0
#: Widest range of ln slope of a panel; pieces of branches are cut at its multiples.
_WIDTH = 1.0
#: Samples of a panel at which rounding and Lipschitz constants are measured, where the
#: atlas has none, and the factor on the largest of these constants.
_MEASURED, _LIPSCHITZ_SAFETY = 3, 2.0
#: Most nodes of a sheet over a patch along each dimension, by those of the patch and
#: beyond, and points that check it.
_GROWN, _FURTHER, _DRAWN = 2, 8, 64

#: A panel: the number of its piece, and its span.
Panel = tuple[int, Span]


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

    def chart(self, sizes: tuple[int, ...], points: np.ndarray) -> Chart:
        """Return the chart through the nodes.

        Its error is the bound that the other points, the last coefficients and the
        gaits' own bounds give.

        Parameters
        ----------
        sizes : tuple of int
            Nodes along each dimension.
        points : ndarray, shape (n, len(sizes))

        Raises
        ------
        Refused
            If the gaits are not all there.
        """
        if not np.isfinite(self.bound):
            raise Refused("some gait is not found, or not one with others")
        nodes = math.prod(sizes)
        chart = Chart.through(sizes, self.values[:, :nodes], self.size.min(axis=1))
        off = (
            np.abs(chart(points[nodes:]) - self.values[:, nodes:])
            / self.size[:, nodes:]
        )
        tails = chart.tails(2 if min(sizes) >= _TWO_FROM else 1)
        error = _SAFETY * off.max() + tails.max(axis=1).sum() + self.bound
        return replace(chart, error=float(error))


def _sampled(
    problem: Problem, smooth: Smooth, at: Polished, slope: np.ndarray, fine: np.ndarray
) -> Iterator[Sampled]:
    """What the gaits of several spans give, of which `fine`, (spans, n), may be used."""
    solved = describe(problem, at, slope, smooth.want)
    values, size = smooth.columns(slope, solved, at.stride.jacobian)
    found = (
        np.isin(solved["status"], status.SOLVED)
        & np.isfinite(values).all(axis=0)
        & fine.ravel()
    )
    for own in np.split(np.arange(len(slope)), len(fine)):
        passes = solved["passes"][own]
        alike = bool((found[own] & (passes == passes[0])).all())
        bound = float(solved["error_bound"][own].max()) if alike else np.inf
        yield Sampled(values[:, own], size[:, own], bound, int(passes[0]))


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
    """

    span: Span
    chart: Chart | None = None
    passes: int = 0
    unmeasured: tuple[float, float] = (-1.0, -1.0)

    @classmethod
    def of(cls, span: Span, chart: Chart, passes: int, drawn: np.ndarray) -> Sheet:
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
        at_fold = (
            span.folds[0] and span.part[0] == 0,
            span.folds[1] and span.part[1] == 1,
        )
        low, high = (
            _UNMEASURED * distance if fold else 0.0 if vanishing else -1.0
            for distance, fold, vanishing in zip(
                nearest, at_fold, span.vanishing, strict=True
            )
        )
        return cls(span, chart, passes, (low, high))

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
        inside = np.abs(points[:, 0]) <= 1
        return np.asarray(inside & (1 + points[:, 0] > low) & (1 - points[:, 0] > high))


def _gaits(
    chart: Chart,
    points: np.ndarray,
    index: np.ndarray,
    slope: np.ndarray,
    smooth: Smooth,
    numbers: Any,
) -> tuple[Part, np.ndarray]:
    """Gaits of a chart at points of its span (n, 1 + d) of some `index`, with their
    slopes and pairs of numbers.

    Also returned is whether errors could change the label or stability of each, shape
    (n,).
    """
    names = smooth.names
    ratio = names.index("heelstrike_rate_ratio")
    low, high = chart.range_of(ratio)
    has_one_label = (
        low > LONG_BELOW + _TIE * chart.error or high < LONG_BELOW - _TIE * chart.error
    )
    needed = sorted({*smooth.needed, *([] if has_one_label else [ratio])})
    columns = dict(zip((names[k] for k in needed), chart(points, needed), strict=True))
    ratios = (
        np.full(len(index), 0.5 * (low + high))
        if has_one_label
        else columns[names[ratio]]
    )
    uncertain = np.abs(ratios - LONG_BELOW) <= _TIE * chart.error
    if smooth.entries:
        columns |= smooth.multipliers(columns, chart.error)
        # Whether a gait is stable does not depend on the accuracy.
        uncertain |= (
            np.abs(columns["spectral_radius"] - 1) <= columns["multiplier_error_bound"]
        )
    solved = smooth.gaits(slope, columns, chart.error, numbers)
    return Part(index, columns["stance_angle"], ratios, solved), uncertain


def _tied(parts: Sequence[Part], n: int, closest: float) -> np.ndarray:
    """Whether gaits of one label at one of n points are so near each other that errors
    may order them, shape (n,).
    """
    tied = np.zeros(n, bool)
    for label in (True, False):
        angles = np.full((len(parts), n), np.nan)
        for row, part in zip(angles, parts, strict=True):
            row[part.index] = np.where(
                (part.ratio < LONG_BELOW) == label, part.angle, np.nan
            )
        crowded = np.flatnonzero(np.isfinite(angles).sum(axis=0) > 1)
        if len(crowded):
            gaps = np.diff(np.sort(angles[:, crowded], axis=0), axis=0)
            tied[crowded] |= (gaps <= closest).any(axis=0)
    return tied


def panels_over(
    piece: int, low: float, high: float, folds: tuple[bool, bool], log_slope: np.ndarray
) -> list[Panel]:
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
    inside = np.clip(
        np.searchsorted(edges, log_slope, side="right") - 1, 0, len(edges) - 2
    )
    holds = np.flatnonzero(np.bincount(inside, minlength=1))
    return [
        (
            piece,
            Span.between(
                edges[k : k + 2],
                0,
                (folds[0] and k == 0, folds[1] and k == len(edges) - 2),
            ),
        )
        for k in holds.tolist()
    ]


def fit_panels(
    panels: list[Panel],
    nodes: int,
    accuracy: float,
    solve: Callable[[list[Panel], list[np.ndarray]], Iterator[Sampled]],
    is_needed: Callable[[Span], bool],
) -> list[tuple[int, Sheet]]:
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
        Whether a span holds a slope asked for.

    Returns
    -------
    list of (int, Sheet)
        Those needed and the numbers of their pieces, in the order of these and of
        slopes; without a chart where the accuracy is not reached.
    """
    done: list[tuple[int, Sheet]] = []
    while panels:
        points = [span.samples(nodes) for _, span in panels]
        slopes = [
            span.log_slope(x) for (_, span), x in zip(panels, points, strict=True)
        ]
        further: list[Panel] = []
        for (piece, span), x, sampled in zip(
            panels, points, solve(panels, slopes), strict=True
        ):
            found, halves = np.isfinite(sampled.bound), list(span.halves())
            chart = sampled.chart((nodes,), x) if found else None
            if chart and chart.error <= accuracy:
                done.append(
                    (piece, Sheet.of(span, chart, sampled.passes, x[nodes:, 0]))
                )
            elif not halves or (
                found and sampled.bound > accuracy and not any(span.folds)
            ):
                done.append((piece, Sheet(span)))
            else:
                further += [(piece, half) for half in halves if is_needed(half)]
        panels = further
    return sorted(done, key=lambda each: (each[0], each[1].span.bounds))


def _margins(piece: Piece) -> tuple[float, float]:
    """How far from both ends of a piece gaits are given by polynomials, in ln slope; at
    a fold anywhere.
    """
    low, high = (
        0.0 if is_fold else _NEAR_END + _END_SAFETY * error
        for is_fold, error in zip(piece.folds, piece.end_errors, strict=True)
    )
    return low, high


class Interpolation:
    """Gaits of one line to an accuracy, from polynomials where they reach it.

    Parameters
    ----------
    problem : Problem
    branches : list of Branch
    wanted : Wanted
    slope : ndarray, shape (n,) [rad]
        All slopes for which panels are to be made.
    """

    def __init__(
        self,
        problem: Problem,
        branches: list[Branch],
        wanted: Wanted,
        slope: np.ndarray,
    ):
        self.problem, self.accuracy = problem, wanted.accuracy
        self.smooth = Smooth.of(problem.walker, wanted.names, problem.m)
        self.pieces = pieces_of(branches)
        q = np.sort(np.log(slope))
        panels = [
            panel
            for k, piece in enumerate(self.pieces)
            for panel in panels_over(k, *piece.q, piece.folds, q[piece.covered(q)])
        ]

        def is_needed(span: Span) -> bool:
            low, high = span.bounds
            return bool(
                np.searchsorted(q, high, side="right") > np.searchsorted(q, low)
            )

        accuracy = _SHARE * self.accuracy
        fitted = fit_panels(
            panels, nodes_for(self.accuracy), accuracy, self._solve, is_needed
        )
        self.sheets = [
            [sheet for piece, sheet in fitted if piece == k]
            for k in range(len(self.pieces))
        ]

    def _solve(
        self, panels: list[Panel], slopes: list[np.ndarray]
    ) -> Iterator[Sampled]:
        """Solve the samples of panels, all side by side."""
        problem, q = self.problem, np.concatenate(slopes)
        guesses = join_lanes(
            [
                self.pieces[k].guesses(each)
                for (k, _), each in zip(panels, slopes, strict=True)
            ]
        )
        if np.isnan(guesses.rounding_std).any():
            guesses = self._measured(guesses, q, len(slopes[0]))
        at = settle(problem, guesses, accuracy=self.accuracy)
        return _sampled(
            problem,
            self.smooth,
            at,
            np.exp(q),
            np.ones((len(panels), len(slopes[0])), bool),
        )

    def _measured(self, guesses: Guesses, q: np.ndarray, samples: int) -> Guesses:
        """Guesses with rounding and Lipschitz constants that are measured at a few of
        the samples of each panel.
        """
        lanes = (
            np.arange(0, len(q), samples)[:, None]
            + np.linspace(0, samples - 1, _MEASURED).astype(int)
        ).ravel()
        lipschitz, gradient, std = measured(
            self.problem, guesses.w[:, lanes], q[lanes], _MEASURED
        )
        return replace(
            guesses,
            lipschitz=np.repeat(_LIPSCHITZ_SAFETY * lipschitz, samples),
            gradient=np.repeat(gradient, samples, axis=-1),
            rounding_std=np.repeat(std, samples, axis=-1),
        )

    def parts(
        self, slope: np.ndarray
    ) -> tuple[list[Part], dict[tuple[int, int], np.ndarray]]:
        """Gaits of the polynomials, and which gaits are to be integrated.

        Parameters
        ----------
        slope : ndarray, shape (n,) [rad]
            Of those for which panels were made.

        Returns
        -------
        parts : list of Part
            Without those that are to be integrated.
        integrated : dict of ndarray of int
            Indices of their slopes, by numbers of the branches and of the first nodes
            of their pieces.
        """
        q = np.log(slope)
        found: list[tuple[int, Part, np.ndarray]] = []
        integrated: list[list[np.ndarray]] = []
        for k, (piece, sheets) in enumerate(zip(self.pieces, self.sheets, strict=True)):
            index = piece.covered(q)
            (low, high), margins = piece.q, _margins(piece)
            inside = (q[index] - low > margins[0]) & (high - q[index] > margins[1])
            integrated.append([index[~inside]])
            index = index[inside]
            which = (
                np.searchsorted(
                    [sheet.span.bounds[0] for sheet in sheets], q[index], side="right"
                )
                - 1
            )
            for number in np.unique(np.maximum(which, 0)).tolist():
                sheet, own = sheets[number], index[np.maximum(which, 0) == number]
                if sheet.chart is None:
                    integrated[k].append(own)
                    continue
                points = sheet.span.points(q[own])
                known = sheet.is_measured(points)
                integrated[k].append(own[~known])
                if sheet.passes == 1:
                    own, numbers = own[known], (piece.number, piece.place)
                    found.append(
                        (
                            k,
                            *_gaits(
                                sheet.chart,
                                points[known],
                                own,
                                slope[own],
                                self.smooth,
                                numbers,
                            ),
                        )
                    )
        tied = _tied([part for _, part, _ in found], len(slope), _TIE * self.accuracy)
        parts = []
        for k, part, uncertain in found:
            lost = uncertain | tied[part.index]
            integrated[k].append(part.index[lost])
            parts.append(part.some(~lost))
        keys = [(piece.number, piece.first) for piece in self.pieces]
        return parts, {
            key: np.unique(np.concatenate(each))
            for key, each in zip(keys, integrated, strict=True)
        }


def sheets(family: Family, cell: Cell, wanted: Wanted, points: float) -> list[Sheet]:
    """Fit polynomials to the gaits of every patch of a cell.

    Parameters
    ----------
    family : Family
    cell : Cell
    wanted : Wanted
    points : float
        About how many points of the study the cell has.

    Returns
    -------
    list of Sheet
        Empty where a patch has none that reaches the accuracy with fewer gaits than
        points.
    """
    try:
        return [
            _over_patch(family, cell, patch, wanted, points) for patch in cell.patches
        ]
    except Refused:
        return []


def _over_patch(
    family: Family, cell: Cell, patch: Patch, wanted: Wanted, points: float
) -> Sheet:
    """The sheet of a patch, or Refused."""
    drawn = cell.box.draw(_DRAWN, 1 + len(family.keys), f"sheet {patch.numbers[0]}")
    span, passes = patch.inside, 0

    def attempt(sizes: tuple[int, ...], _: Chart | None) -> Chart:
        nonlocal passes
        if math.prod(sizes) + _DRAWN >= points:
            raise Refused("fewer points than gaits to solve")
        at = np.vstack([tensor_nodes(sizes), drawn])
        sampled = _over(family, cell, patch, at, wanted)
        passes = sampled.passes
        return sampled.chart(sizes, at)

    good, most = (
        _SHARE * wanted.accuracy,
        tuple(_GROWN * n + _FURTHER for n in patch.gaits.sizes),
    )
    chart = fit(
        attempt(patch.gaits.sizes, None),
        attempt,
        most,
        int(points),
        good,
        good,
        len(family.keys),
    )
    return Sheet.of(span, chart, passes, drawn[:, 0])


def _over(
    family: Family, cell: Cell, patch: Patch, points: np.ndarray, wanted: Wanted
) -> Sampled:
    """What was solved at points (n, 1 + d) of the span of a patch in which all gaits
    are steps.
    """
    unit, q = points[:, 1:], patch.inside.log_slope(points)
    walkers, slope = family.walkers(cell.box.at(unit)), np.exp(q)
    problem, guesses = Lanes(walkers, cell.structure), patch.guesses(unit, slope)
    at = settle(problem, guesses, sampled=True, accuracy=wanted.accuracy)
    fine, is_step = patch.judge(at, guesses.w, q, unit)
    smooth = Smooth.of(walkers, wanted.names, problem.m)
    (sampled,) = _sampled(problem, smooth, at, slope, (fine & is_step)[None])
    return sampled


def interpolate(
    block: Block, made: Sequence[Sheet], wanted: Wanted
) -> tuple[list[Part], np.ndarray]:
    """Gaits of lines in a cell by its polynomials.

    Parameters
    ----------
    block : Block
    made : sequence of Sheet
        One for each patch of the cell.
    wanted : Wanted

    Returns
    -------
    parts : list of Part
        With indices into the points of the lines that are sure.
    sure : ndarray of bool, shape (n,)
        Points whose labels and stability do not depend on errors, all of which are
        known; the others are to be integrated.
    """
    n, s = len(block.unit), len(block.slope)
    found, lost = [], np.zeros(n * s, bool)
    for sheet, patch in zip(made, block.cell.patches, strict=True):
        index = block.on(patch)
        if sheet.chart is None or sheet.passes != 1 or not len(index):
            lost[index] |= sheet.chart is None
            continue
        line, own = index // s, index % s
        unit = block.unit[line]
        points = sheet.span.points(block.q[own], unit)
        known = sheet.is_measured(points)
        lost[index[~known]] = True
        index, line, own, unit, points = (
            values[known] for values in (index, line, own, unit, points)
        )
        smooth = Smooth.of(
            block.walkers.some(line), wanted.names, block.cell.structure.dimension
        )
        part, uncertain = _gaits(
            sheet.chart,
            points,
            index,
            block.slope[own],
            smooth,
            patch.numbers_at(unit).T,
        )
        lost[index[uncertain]] = True
        found.append(part)
    sure = ~(lost | _tied(found, n * s, _TIE * wanted.accuracy))
    return [part.some(sure[part.index]) for part in found], sure
