"""Gaits to a wanted accuracy that are not integrated: sheets of polynomials over panels
of a line's branches, or over patches.

A panel is a part of a piece of branches, so that its sheet is one over no keys.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from gaitsweep.tasks.branches.branch import Branch
from gaitsweep.tasks.charts.box import Refused
from gaitsweep.tasks.charts.cell import Block, Cell
from gaitsweep.tasks.charts.chart import Chart
from gaitsweep.tasks.charts.family import Family
from gaitsweep.tasks.charts.patch import Patch, measured
from gaitsweep.tasks.charts.pieces import Piece, pieces_of
from gaitsweep.tasks.charts.sheet import Asked, Sampled, Sheet, Solve, fit_sheets
from gaitsweep.tasks.charts.span import Span
from gaitsweep.tasks.contract import status
from gaitsweep.tasks.contract.accuracy import nodes_for
from gaitsweep.tasks.gaits.polish import Guesses, settle
from gaitsweep.tasks.gaits.step_check import LONG_BELOW
from gaitsweep.tasks.measures.gaits import Part, Wanted
from gaitsweep.tasks.measures.smooth import Smooth
from gaitsweep.tasks.step.lanes import join_lanes
from gaitsweep.tasks.step.problem import Lanes, Problem
from gaitsweep.tasks.studies.solve_guesses import Solved, solve_guesses

#: Share of the accuracy that polynomials may use; numbers are also rounded.
_SHARE = 0.9
#: Gaits of one label whose angles differ by fewer accuracies are integrated, and those
#: with ratios as near 1/2.
_TIE = 4.0
#: Gaits nearer an end of their branch in ln slope are integrated, and so are those
#: whose errors reach it.
_NEAR_END = 1e-9
_END_SAFETY = 8.0
#: Widest range of ln slope of a panel; pieces of branches are cut at its multiples.
_WIDTH = 1.0
#: Widest range, in a panel, of the logarithm of the distance from where steps vanish,
#: and how far that is followed: nearer, gaits are integrated.
_VANISHING = 4.0, 8.0
#: Samples of a panel at which rounding and Lipschitz constants are measured, where the
#: atlas has none, and the factor on the largest of these constants.
_MEASURED = 3
_LIPSCHITZ_SAFETY = 2.0
#: Most nodes of a sheet over a patch along each dimension, by those of the patch and
#: beyond, and points that check it.
_GROWN = 2
_FURTHER = 8
_DRAWN = 64


def _sampled(
    solved: Solved,
    smooth: Smooth,
    fine: np.ndarray,
    spans: int,
) -> Iterator[Sampled]:
    """What the gaits of several spans, as many of each, give; `fine`, shape (n,), may
    be used.
    """
    drive = solved.guesses.slope
    gaits = solved.gaits
    values, size = smooth.columns(drive, gaits, solved.at.stride.jacobian)
    found = np.isin(gaits["status"], status.SOLVED) & fine
    found &= np.isfinite(values).all(axis=0)

    for own in np.split(np.arange(len(drive)), spans):
        passes = gaits["passes"][own]
        alike = bool((found[own] & (passes == passes[0])).all())
        bound = float(gaits["error_bound"][own].max()) if alike else np.inf
        yield Sampled(values[:, own], size[:, own], bound, int(passes[0]))


@dataclass(frozen=True)
class _Places:
    """Points of a study on the span of a sheet: their `index`, the `points` of the span
    (n, 1 + d), their slopes or other drives, and the pair of numbers of branch and
    piece.
    """

    index: np.ndarray
    points: np.ndarray
    drive: np.ndarray
    numbers: Any

    def gaits(
        self,
        chart: Chart,
        smooth: Smooth,
        lost: np.ndarray,
    ) -> Part:
        """Gaits of a chart; those whose label or stability errors could change are
        marked as `lost`.
        """
        names = smooth.names
        within = _TIE * chart.error
        ratio = names.index("heelstrike_rate_ratio")
        low, high = chart.range_of(ratio)
        ratios = np.full(len(self.index), 0.5 * (low + high))
        has_one_label = low > LONG_BELOW + within or high < LONG_BELOW - within

        needed = smooth.needed
        if not has_one_label:
            needed = sorted({*needed, ratio})
        values = chart(self.points, needed)
        columns = dict(zip((names[k] for k in needed), values, strict=True))
        if not has_one_label:
            ratios = columns[names[ratio]]

        uncertain = np.abs(ratios - LONG_BELOW) <= within
        if smooth.entries:
            columns |= smooth.multipliers(columns, chart.error)
            # Whether a gait is stable does not depend on the accuracy.
            margin = np.abs(columns["spectral_radius"] - 1)
            uncertain |= margin <= columns["multiplier_error_bound"]

        lost[self.index[uncertain]] = True
        solved = smooth.gaits(self.drive, columns, chart.error, self.numbers)
        return Part(self.index, columns["stance_angle"], ratios, solved)


def _tied(
    parts: Sequence[Part],
    n: int,
    closest: float,
) -> np.ndarray:
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
    piece: int,
    low: float,
    high: float,
    folds: tuple[bool, bool],
    log_slope: np.ndarray,
    nodes: int,
    vanishing: tuple[float, float] = (0.0, 0.0),
) -> list[Asked]:
    """Ask for sheets over the widest panels of a piece that hold some slopes.

    Parameters
    ----------
    piece : int
        Its number.
    low, high : float
        Its range of ln slope.
    folds : (bool, bool)
        Whether it begins and ends at a fold.
    log_slope : ndarray, shape (n,)
    nodes : int
        Those of each panel: where they do not suffice it is halved.
    """
    edges = _edges(low, high, vanishing)
    last = len(edges) - 2
    inside = np.searchsorted(edges, log_slope, side="right") - 1

    panels = []
    for k in np.unique(np.clip(inside, 0, last)).tolist():
        at_ends = k == 0, k == last
        at_folds = at_ends[0] and folds[0], at_ends[1] and folds[1]
        share = (edges[k + 1] - edges[k]) / (high - low)
        depths = (
            _depth(vanishing[0], at_ends[0], share),
            _depth(vanishing[1], at_ends[1], share),
        )
        span = Span.between(edges[k : k + 2], 0, at_folds, depths)
        for part in span.toward_vanishing(*_VANISHING):
            panels.append(Asked(piece, part, (nodes,), (nodes,)))

    return panels


def _edges(low: float, high: float, vanishing: tuple[float, float]) -> np.ndarray:
    """Ln slopes at which panels of a piece begin and end, rising."""
    cuts = np.arange(np.floor(low / _WIDTH) + 1, np.ceil(high / _WIDTH)) * _WIDTH
    # Beside vanishing steps a narrow panel would not shield the next from them.
    least = [0.5 * _WIDTH if depth else 0.0 for depth in vanishing]
    cuts = cuts[(cuts > low + least[0]) & (cuts < high - least[1])]
    return np.concatenate([[low], cuts, [high]])


def _depth(depth: float, is_there: bool, share: float) -> float:
    """By how much the logarithm of the distance from vanishing steps grows over a share
    of a piece beside them, over all of which it grows by a `depth`.
    """
    return max(0.0, depth + math.log(share)) if is_there and depth else 0.0


def fit_panels(
    pieces: Sequence[Piece],
    log_slope: np.ndarray,
    solve: Solve,
    nodes: int,
    good: float,
    narrowest: float = 0.0,
    by_value: bool = False,
) -> list[list[Sheet]]:
    """Fit sheets over the panels of pieces that hold some slopes.

    Parameters
    ----------
    pieces : sequence of Piece
    log_slope : ndarray, shape (n,)
    solve, good
        As for `fit_sheets`.
    nodes : int
        Those of each panel: where they do not suffice it is halved.
    narrowest : float
        The least part of a panel.
    by_value : bool
        As for `fit_sheets`.

    Returns
    -------
    list of list of Sheet
        Those of each piece by rising slope.
    """
    q = np.sort(log_slope)

    def is_needed(span: Span) -> bool:
        low, high = span.bounds
        after = np.searchsorted(q, high, side="right")
        is_wide = span.part[1] - span.part[0] >= narrowest
        return bool(after > np.searchsorted(q, low)) and is_wide

    panels: list[Asked] = []
    for k, piece in enumerate(pieces):
        covered = q[piece.covered(q)]
        over = panels_over(k, *piece.q, piece.folds, covered, nodes, piece.vanishing)
        panels += [panel for panel in over if is_needed(panel.span)]

    sheets: list[list[Sheet]] = [[] for _ in pieces]
    for k, sheet in fit_sheets(panels, solve, good, is_needed, by_value):
        sheets[k].append(sheet)
    for of_piece in sheets:
        of_piece.sort(key=lambda sheet: sheet.span.bounds)
    return sheets


def on_sheets(
    sheets: Sequence[Sheet], q: np.ndarray
) -> Iterator[tuple[Sheet, np.ndarray]]:
    """Yield sheets of a piece, by rising slope, with the numbers of the ln slopes (n,)
    that are nearest to each from above.
    """
    edges = [sheet.span.bounds[0] for sheet in sheets]
    of_sheet = np.searchsorted(edges, q, side="right") - 1
    of_sheet = np.maximum(of_sheet, 0)
    for number in np.flatnonzero(np.bincount(of_sheet)).tolist():
        yield sheets[number], np.flatnonzero(of_sheet == number)


def _away_from_ends(piece: Piece, q: np.ndarray) -> np.ndarray:
    """Whether gaits of a piece at ln slopes (n,) are farther from its ends than their
    errors reach; at a fold all are.
    """
    away = np.ones(len(q), bool)
    distances = q - piece.q[0], piece.q[1] - q
    for end, distance in enumerate(distances):
        if piece.folds[end]:
            away &= distance > 0
        else:
            away &= distance > _NEAR_END + _END_SAFETY * piece.end_errors[end]

    return away


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
        self.problem = problem
        self.wanted = wanted
        self.smooth = Smooth.of(problem, wanted.names)
        self.pieces = pieces_of(branches)
        self.sheets = fit_panels(
            self.pieces,
            np.log(slope),
            self._solve,
            nodes_for(wanted.accuracy),
            _SHARE * wanted.accuracy,
        )

    def _solve(
        self, asked: Sequence[Asked], points: Sequence[np.ndarray]
    ) -> Iterator[Sampled]:
        """Solve the samples of panels, all side by side."""
        q = []
        of_panels = []
        for panel, x in zip(asked, points, strict=True):
            q.append(panel.span.log_slope(x))
            of_panels.append(self.pieces[panel.number].guesses(q[-1]))

        guesses = join_lanes(of_panels)
        if np.isnan(guesses.rounding_std).any():
            guesses = self._measured(guesses, np.concatenate(q), len(points[0]))

        to_accuracy = partial(settle, accuracy=self.wanted.accuracy)
        solved = solve_guesses(self.problem, [guesses], to_accuracy, self.wanted)
        fine = np.ones(len(guesses.slope), bool)
        return _sampled(solved, self.smooth, fine, len(asked))

    def _measured(
        self,
        guesses: Guesses,
        q: np.ndarray,
        samples: int,
    ) -> Guesses:
        """Guesses with rounding and Lipschitz constants that are measured at a few of
        the samples of each panel.
        """
        few = np.linspace(0, samples - 1, _MEASURED).astype(int)
        lanes = (np.arange(0, len(q), samples)[:, None] + few).ravel()
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
        lost = np.zeros((len(self.pieces), len(slope)), bool)
        given: list[tuple[np.ndarray, Part]] = []
        for of_piece, piece, sheets in zip(lost, self.pieces, self.sheets, strict=True):
            for part in self._of_piece(piece, sheets, slope, of_piece):
                given.append((of_piece, part))

        closest = _TIE * self.wanted.accuracy
        tied = _tied([part for _, part in given], len(slope), closest)
        parts = []
        for of_piece, part in given:
            of_piece[part.index] |= tied[part.index]
            parts.append(part.some(~of_piece[part.index]))

        integrated = {}
        for of_piece, piece in zip(lost, self.pieces, strict=True):
            integrated[piece.number, piece.first] = np.flatnonzero(of_piece)
        return parts, integrated

    def _of_piece(
        self,
        piece: Piece,
        sheets: list[Sheet],
        slope: np.ndarray,
        lost: np.ndarray,
    ) -> Iterator[Part]:
        """Gaits of the sheets of a piece at some slopes (n,); those are marked as
        `lost`, (n,), that are to be integrated.
        """
        q = np.log(slope)
        index = piece.covered(q)
        inside = _away_from_ends(piece, q[index])
        lost[index[~inside]] = True
        index = index[inside]

        numbers = piece.number, piece.place
        for sheet, on_sheet in on_sheets(sheets, q[index]):
            some = index[on_sheet]
            if sheet.chart is None:
                lost[some] = True
                continue

            points = sheet.span.points(q[some])
            known = sheet.is_measured(points)
            lost[some[~known]] = True
            if sheet.passes == 1:
                some = some[known]
                places = _Places(some, points[known], slope[some], numbers)
                yield places.gaits(sheet.chart, self.smooth, lost)


def sheets(
    family: Family,
    cell: Cell,
    wanted: Wanted,
    points: float,
) -> list[Sheet]:
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
    made = []
    for patch in cell.patches:
        sheet = _over_patch(family, cell, patch, wanted, points)
        if sheet is None:
            return []
        made.append(sheet)
    return made


def _over_patch(
    family: Family,
    cell: Cell,
    patch: Patch,
    wanted: Wanted,
    points: float,
) -> Sheet | None:
    """The sheet of a patch, if one reaches the accuracy with fewer gaits than points."""
    drawn = cell.box.draw(_DRAWN, 1 + len(family.keys), f"sheet {patch.numbers[0]}")
    sizes = patch.gaits.sizes
    most = tuple(_GROWN * n + _FURTHER for n in sizes)
    asked = Asked(0, patch.inside, sizes, most, drawn)

    def solve(_: Any, places: Sequence[np.ndarray]) -> list[Sampled]:
        if len(places[0]) >= points:
            raise Refused("fewer points than gaits to solve")
        return [_over(family, cell, patch, asked.span, places[0], wanted)]

    good = _SHARE * wanted.accuracy
    try:
        fitted = fit_sheets([asked], solve, good, is_needed=lambda half: False)
    except Refused:
        return None

    return fitted[0][1] if fitted else None


def _over(
    family: Family,
    cell: Cell,
    patch: Patch,
    span: Span,
    points: np.ndarray,
    wanted: Wanted,
) -> Sampled:
    """What was solved at points (n, 1 + d) of the span of a patch in which all gaits
    are steps.
    """
    unit = points[:, 1:]
    q = span.log_slope(points)
    walkers = family.walkers(cell.box.at(unit))
    problem = Lanes(walkers, cell.structure, family.drive)
    to_accuracy = partial(settle, sampled=True, accuracy=wanted.accuracy)
    guesses = patch.guesses(unit, np.exp(q))
    solved = solve_guesses(problem, [guesses], to_accuracy, wanted)

    fine, is_step = patch.judge(solved.at, guesses.w, q, unit)
    smooth = Smooth.of(problem, wanted.names)
    (sampled,) = _sampled(solved, smooth, fine & is_step, 1)
    return sampled


def interpolate(
    block: Block,
    made: Sequence[Sheet],
    wanted: Wanted,
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
    n = block.q.size
    given = []
    lost = np.zeros(n, bool)
    for sheet, patch in zip(made, block.cell.patches, strict=True):
        part = _of_patch(block, patch, sheet, wanted, lost)
        if part is not None:
            given.append(part)

    sure = ~(lost | _tied(given, n, _TIE * wanted.accuracy))
    return [part.some(sure[part.index]) for part in given], sure


def _of_patch(
    block: Block,
    patch: Patch,
    sheet: Sheet,
    wanted: Wanted,
    lost: np.ndarray,
) -> Part | None:
    """Gaits of the sheet of a patch that have a label; those points of the lines are
    marked as `lost`, (n,), that are to be integrated.
    """
    index = block.on(patch)
    if sheet.chart is None:
        lost[index] = True
        return None

    if sheet.passes != 1 or not len(index):
        return None

    line, own = np.divmod(index, block.q.shape[1])
    points = sheet.span.points(block.q[line, own], block.unit[line])
    known = sheet.is_measured(points)
    lost[index[~known]] = True
    line = line[known]
    index = index[known]

    smooth = Smooth.of(block.problem.some(line), wanted.names)
    numbers = patch.numbers_at(block.unit[line]).T
    places = _Places(index, points[known], block.drive[line, own[known]], numbers)
    return places.gaits(sheet.chart, smooth, lost)
