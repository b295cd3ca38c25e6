"""The task `charts` of a plane of keys, and `lines`: gaits predicted by charts and
solved by their own steps.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from itertools import combinations
from typing import Any

import numpy as np

from gaitsweep.tasks.charts.arrays import arrays_of, parts, under, value_of
from gaitsweep.tasks.charts.box import Box
from gaitsweep.tasks.charts.cell import Block, Cell, from_arrays, to_arrays
from gaitsweep.tasks.charts.division import Cells, make_cells
from gaitsweep.tasks.charts.family import Family
from gaitsweep.tasks.charts.patch import PREDICTED_WITHIN, Patch
from gaitsweep.tasks.charts.patch_ends import BEYOND, END, FOLD
from gaitsweep.tasks.charts.sheet import Sheet
from gaitsweep.tasks.contract import status
from gaitsweep.tasks.contract.accuracy import is_interpolated
from gaitsweep.tasks.contract.registry import GAITS
from gaitsweep.tasks.gaits.polish import Guesses, settle
from gaitsweep.tasks.gaits.step_check import verify_steps
from gaitsweep.tasks.measures.gaits import (
    Arrays,
    Wanted,
    nothing_solved,
    store,
    to_accuracy,
)
from gaitsweep.tasks.step.drive import SLOPE
from gaitsweep.tasks.step.lanes import lanes_of
from gaitsweep.tasks.studies.interpolate import interpolate, sheets
from gaitsweep.tasks.studies.request import Request
from gaitsweep.tasks.studies.solve_guesses import (
    Solved,
    block_size,
    solve_guesses,
    walkers_alone,
)
from gaitsweep.tasks.studies.solve_points import in_units_of, solve_lines
from gaitsweep.tasks.walkers.resolve import walker_of_line
from gaitsweep.tasks.walkers.scaling import plain_line, scaling
from gaitsweep.tasks.walkers.walker_array import WalkerArray

#: Smallest error assumed for the ends of pieces, in ln slope.
_MIN_END_ERROR = 1e-9
#: Gaits of two pieces closer than this could be identical.
_APART = 1e-7
#: Lines of a plane from which on its halves are jobs of their own: some seconds of work
#: where charts are hard to make.
_MANY_LINES = 256


@dataclass(frozen=True)
class Plane:
    """Lines over one or two keys, or some of them.

    Attributes
    ----------
    keys : tuple of str
    low, high : tuple of float
        Range of each key, in the walker's units.
    lines : float
        About how many there are.
    log : tuple of bool
        For each key, whether they are spread by its logarithm.
    origin, halved : tuple
        As `Box` has them.
    surveyed : float
        How many lines were surveyed for it in vain.
    """

    keys: tuple[str, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    lines: float
    log: tuple[bool, ...] = ()
    origin: tuple[float, ...] = ()
    halved: tuple[int, ...] = ()
    surveyed: float = 0.0

    @classmethod
    def of(cls, table: Mapping[str, Any]) -> Plane:
        """Return the plane that a table of its attributes describes."""
        values: dict[str, Any] = {}
        for field in fields(cls):
            if field.name in table:
                value = table[field.name]
                is_number = field.name in ("lines", "surveyed")
                values[field.name] = value if is_number else tuple(value)
        return cls(**values)

    @property
    def box(self) -> Box:
        """Its box, in whose coordinates gaits are smooth."""
        return Box(
            self.keys,
            self.low,
            self.high,
            log=True,
            origin=self.origin,
            halved=self.halved,
        )

    def lines_in(self, part: Box) -> float:
        """Return about how many of its lines lie in a part of its box."""
        spread = replace(self.box, log=self.log, origin=())
        return spread.share(part) * self.lines


def charts(params: Mapping[str, Any], inputs: list[Arrays]) -> Arrays:
    """Make the charts of gaits over a plane of keys and a window of slopes, or halve
    it.

    Parameters
    ----------
    params : mapping
        `line`, one of the plane; `plane`, with its `keys`, `low`, `high`, for each
        whether lines are spread by its logarithm, `log`, and about how many `lines` it
        is for, or a half of it as this task returns it; whether all charts are wanted
        at once, `whole`; `slope_from`, `slope_to` [rad] and about how many `slopes`;
        `want` and `accuracy` as `tasks.studies.solve_points:points` has them.
    inputs : list
        Empty.

    Returns
    -------
    dict
        The charts as arrays, which `lines` reads. They predict gaits, and give those
        that `accuracy` allows. `alone` has `low` and `high` of the boxes that they do
        not describe, whose lines are followed by themselves. A plane of many lines that
        charts do not describe whole has two `halves` instead, by name what differs from
        `plane` in each.
    """
    plane = Plane.of(params["plane"])
    wanted = Wanted.of(params)
    window = params["slope_from"], params["slope_to"]
    many = math.inf if params.get("whole") else _MANY_LINES
    family = Family.of(params["line"], plane.keys, params.get("along", ""))
    return make_charts(family, plane, wanted, window, params["slopes"], many)


def make_charts(
    family: Family,
    plane: Plane,
    wanted: Wanted,
    window: tuple[float, float],
    slopes: int,
    many: float = math.inf,
) -> Arrays:
    """Make the charts of gaits over a plane and a window of slopes, or halve it.

    Parameters
    ----------
    family : Family
        Of a line of the plane.
    plane : Plane
    wanted : Wanted
        Variables and accuracy.
    window : (float, float)
        Least and largest slope [rad], or value of what else drives, in the walker's
        units.
    slopes : int
        About how many there are.
    many : float
        Lines from which on a plane that charts do not describe whole is halved.

    Returns
    -------
    dict
        As `charts` has it.
    """
    units = family.drive.unit(family.walkers(plane.box.at(plane.box.corners(1.0))))
    low = float(np.log(window[0] / np.max(units)))
    high = float(np.log(window[1] / np.min(units)))
    cells = make_cells(
        family,
        plane.box,
        (low, high),
        plane.lines_in,
        slopes,
        plane.surveyed,
        many,
    )
    alone = [cell.box for cell in cells.made if cell.why]
    arrays = to_arrays(cells.made) | _boxes("alone", alone, ("low", "high"))
    if is_interpolated(wanted.names, wanted.accuracy):
        for i, cell in enumerate(cells.made):
            points = plane.lines_in(cell.box) * slopes
            made = sheets(family, cell, wanted, points)
            arrays |= arrays_of(made, f"{i}/sheets")

    if cells.halves:
        arrays |= _halves(plane, cells)
    return arrays


def _boxes(
    name: str,
    boxes: Sequence[Box],
    attributes: Sequence[str],
) -> dict[str, np.ndarray]:
    """Attributes of boxes as arrays."""
    return {
        f"{name}/{attribute}": np.array([getattr(box, attribute) for box in boxes])
        for attribute in attributes
    }


def _halves(plane: Plane, cells: Cells) -> Arrays:
    """What differs from a plane in each of its halves."""
    arrays = _boxes("halves", cells.halves, ("low", "high", "origin", "halved"))
    lines = np.array([plane.lines_in(half) for half in cells.halves])
    arrays["halves/lines"] = lines
    arrays["halves/surveyed"] = cells.surveyed * lines / plane.lines
    return arrays


def lines(
    params: Mapping[str, Any], inputs: list[Arrays]
) -> list[tuple[Arrays, Arrays]]:
    """Solve the gaits at the slopes of lines in a plane of keys.

    Parameters
    ----------
    params : mapping
        `lines`, the line of each; `plane` as `charts` has it; the others as
        `tasks.studies.solve_points:points` has them.
    inputs : list
        What `charts` returns, for boxes of the plane; lines that lie in none are
        followed by themselves.

    Returns
    -------
    list of (dict, dict)
        One pair for all lines: no atlas, and what `points` returns, line by line. The
        result of a point depends on its line, the charts and its slope alone: where its
        prediction is not accepted, that line is followed by itself.
    """
    plane = Plane.of(params["plane"])
    request = Request.of(params)
    return [({}, solve_plane(params["lines"], plane, request, inputs))]


def solve_plane(
    lines: Sequence[Mapping[str, Any]],
    plane: Plane,
    request: Request,
    charts: Sequence[Arrays],
) -> Arrays:
    """Solve the gaits of lines in a plane by charts, and those by themselves that
    charts do not describe.

    Parameters
    ----------
    lines : sequence of mapping
    plane : Plane
    request : Request
    charts : sequence of dict
        Of boxes of the plane, as `charts` returns them.

    Returns
    -------
    dict
        What `tasks.studies.solve_points:points` returns, line by line.
    """
    out, accepted = _by_charts(lines, plane, request, charts)
    given = _joined(out)
    to_accuracy(given, request.wanted.accuracy)
    out = _by_line(given, len(lines))

    reasons = _reasons(plane.box, request.along or SLOPE)
    sentences = dict[str, int]()
    for numbers, at in _not_accepted(accepted):
        out["reason"] = out["reason"].astype(np.int32)
        asked = replace(request, slope=request.slope[at])
        solved = solve_lines([lines[i] for i in numbers], asked)
        for i, (_, points) in zip(numbers, solved, strict=True):
            _number_anew(points, sentences, len(reasons))
            lacking = ~accepted[i, at]
            for name, values in out.items():
                values[i, at[lacking]] = points[name][lacking]

    return _joined(out) | {"reasons": np.array([*reasons, *sentences])}


def _not_accepted(accepted: np.ndarray) -> Iterator[tuple[list[int], np.ndarray]]:
    """Numbers of lines and indices of slopes of which all points are accepted, (n, s),
    but for these: those of lines without any that is, then those of others.
    """
    none = ~accepted.any(axis=1)
    for some in (none, ~none & ~accepted.all(axis=1)):
        if some.any():
            at = np.flatnonzero(~accepted[some].all(axis=0))
            yield np.flatnonzero(some).tolist(), at


def _number_anew(
    points: Arrays,
    sentences: dict[str, int],
    first: int,
) -> None:
    """Let a line's `reason` be numbers of `sentences`, from a `first` one on, to which
    its own are added.
    """
    numbers = []
    for sentence in points["reasons"].tolist():
        numbers.append(sentences.setdefault(sentence, first + len(sentences)))
    points["reason"] = np.array(numbers)[points["reason"]]


def _joined(out: Arrays) -> Arrays:
    """The points of lines one after another."""
    return {name: value.reshape(-1, *value.shape[2:]) for name, value in out.items()}


def _by_line(out: Arrays, n: int) -> Arrays:
    """The points of n lines, line by line."""
    return {name: v.reshape(n, -1, *v.shape[1:]) for name, v in out.items()}


def _by_charts(
    lines: Sequence[Mapping[str, Any]],
    plane: Plane,
    request: Request,
    charts: Sequence[Arrays],
) -> tuple[Arrays, np.ndarray]:
    """The gaits of lines that charts give, shape (n, s, ...), and which points of lines
    are accepted, (n, s). Lines that differ only in their units are solved once.
    """
    first = lines[0]
    scales: tuple[str, ...] = ()
    if request.is_converted and not request.along:
        scales = scaling(walker_of_line(first), first)
    varied = (*plane.keys, *scales)
    values = np.array([[line["set"][key] for key in varied] for line in lines])
    d = len(plane.keys)
    keys, which = np.unique(values[:, :d], axis=0, return_inverse=True)
    which = which.ravel()

    family = Family.of(plain_line(first, scales), plane.keys, request.along)
    out, accepted = _at_keys(family, keys, plane.box, request, charts)
    out = {name: of_line[which] for name, of_line in out.items()}
    if scales:
        _check_scales(first, scales, values[:, d:])
        walkers = Family.of(first, varied).walkers(values)
        out = in_units_of(walkers, out, family.walkers(keys[which]))

    return out, accepted[which]


def _check_scales(
    line: Mapping[str, Any], scales: Sequence[str], values: np.ndarray
) -> None:
    """Check that a line's walker can be with values of the keys that change only units,
    (n, k).

    Raises
    ------
    WalkerError
        If with some of them it cannot.
    """
    for combination in np.unique(values, axis=0).tolist():
        own = dict(zip(scales, combination, strict=True))
        walker_of_line({**line, "set": {**line["set"], **own}})


def _at_keys(
    family: Family,
    keys: np.ndarray,
    box: Box,
    request: Request,
    charts: Sequence[Arrays],
) -> tuple[Arrays, np.ndarray]:
    """The gaits at values of keys, (n, d), that charts give, shape (n, s, ...), and
    which points are accepted, (n, s).
    """
    walkers = family.walkers(keys)
    corners = family.walkers(np.array([box.low, box.high]))
    n = len(keys)
    s = len(request.slope)
    leads = np.flatnonzero(request.slope > 0)
    is_alike = _are_alike(walkers, corners)

    accepted = np.zeros((n, s), bool)
    out = _by_line(nothing_solved(request.wanted.names, n * s, walkers.knees), n)
    for cell, made in _cells(family, charts):
        inside = np.flatnonzero(_inside(cell.box, keys, box) & is_alike)
        if not cell.why and len(inside):
            values = request.slope[leads]
            at = np.ix_(inside, leads)
            solved, accepted[at] = solve(
                family, cell, keys[inside], values, request.wanted, made
            )
            for name, value in solved.items():
                out[name][at] = value

    return out, accepted


def _are_alike(walkers: WalkerArray, corners: WalkerArray) -> np.ndarray:
    """Whether each of some walkers (n,) has the variables that most of a box have, whose
    corners are others.

    A massless leg's steps are the limit of those of light ones; its losses have formulas
    of their own. What drives no walker leaves variables out.
    """
    acting = corners.acting.any(axis=1, keepdims=True)
    is_driven_alike = (walkers.acting == acting).all(axis=0)
    return np.asarray((walkers.massless_legs == corners.massless_leg) & is_driven_alike)


def _cells(
    family: Family, charts: Sequence[Arrays]
) -> Iterator[tuple[Cell, list[Sheet]]]:
    """Cells that charts hold, and the sheets of each."""
    for arrays in charts:
        cells = from_arrays(family, arrays)
        for cell, of_cell in zip(cells, parts(arrays), strict=True):
            of_sheets = parts(under("sheets", of_cell))
            yield cell, [value_of(Sheet, of_sheet) for of_sheet in of_sheets]


def _inside(
    part: Box,
    keys: np.ndarray,
    whole: Box,
) -> np.ndarray:
    """Whether lines, shape (n, d), lie in a part of a box; what two parts share belongs
    to the upper one.
    """
    top = np.array([b == end for b, end in zip(part.high, whole.high, strict=True)])
    return np.asarray(
        ((keys >= part.low) & ((keys < part.high) | (top & (keys <= part.high)))).all(
            axis=1
        )
    )


def _reasons(box: Box, drive: str) -> list[str]:
    """Sentences that `reason` indexes, of gaits over what drives."""
    sides = zip(box.keys, box.low, box.high, strict=True)
    where = ", ".join(f"{key} from {low:.6g} to {high:.6g}" for key, low, high in sides)
    return status.reasons(*(status.absent(label, where, drive) for label in GAITS[:2]))


def solve(
    family: Family,
    cell: Cell,
    keys: np.ndarray,
    slope: np.ndarray,
    wanted: Wanted,
    made: Sequence[Sheet] = (),
) -> tuple[Arrays, np.ndarray]:
    """Solve the gaits at the slopes of lines in a cell.

    Parameters
    ----------
    family : Family
    cell : Cell
    keys : ndarray, shape (n, d)
        Values of the free keys of n lines.
    slope : ndarray, shape (s,) [rad]
        Or values of what else drives, in the walker's units, within the range of the
        cell.
    wanted : Wanted
    made : sequence of Sheet
        Polynomials that give the gaits to an accuracy; where there are none the gaits
        are integrated.

    Returns
    -------
    out : dict of ndarray, shape (n, s, len(GAITS)[, multipliers])
        In the walkers' units.
    accepted : ndarray of bool, shape (n, s)
        Points all of whose gaits are accepted; what `out` has of the others is void.
    """
    n = len(keys)
    s = len(slope)
    out = nothing_solved(wanted.names, n * s, cell.structure.kneed)
    accepted = np.ones((n, s), bool)
    lines = max(1, block_size(bool(made)) // s)
    for k in range(0, n, lines):
        some = slice(k, k + lines)
        block = Block(family, cell, keys[some], slope)
        part = {name: v[k * s : (k + lines) * s] for name, v in out.items()}
        fine = _known_to_end(block) & _away_from_ends(block)
        integrated = fine.copy()
        if made:
            given, sure = interpolate(block, made, wanted)
            store(part, given, wanted.labels)
            integrated &= ~sure

        fine &= _solve_block(block, wanted, part, integrated)
        accepted[some] = fine.reshape(-1, s)

    return _by_line(out, n), accepted


def _away_from_ends(block: Block) -> np.ndarray:
    """Whether points are farther from the ends of pieces than their errors, shape (n
    s,).
    """
    away = np.ones(block.q.shape, bool)
    for patch in block.cell.patches:
        ends = patch.span.ends(block.unit)
        for end, error, kind in zip(ends, patch.end_errors, patch.kinds, strict=True):
            if kind in (FOLD, END):
                within = PREDICTED_WITHIN * max(error, _MIN_END_ERROR)
                away &= np.abs(block.q - end[:, None]) > within

    return away.ravel()


def _known_to_end(block: Block) -> np.ndarray:
    """Whether points beyond the ends of walking have no gait: the equations' solutions
    at these ends are none.
    """
    known = np.ones(block.q.shape, bool)
    for patch in block.cell.patches:
        ends = patch.span.ends(block.unit)
        for side, end, kind in zip((-1, 1), ends, patch.kinds, strict=True):
            beyond = side * (block.q - end[:, None]) > 0
            lines = np.flatnonzero(beyond.any(axis=1))
            if kind == BEYOND and len(lines):
                may_walk = _may_walk(block, patch, side, lines, end[lines])
                known[lines] &= ~(beyond[lines] & may_walk[:, None])

    return known.ravel()


def _may_walk(
    block: Block,
    patch: Patch,
    side: int,
    lines: np.ndarray,
    q: np.ndarray,
) -> np.ndarray:
    """Whether gaits of some lines, (k,), at an end of a patch may be steps, bool (k,)."""
    unit = block.unit[lines]
    points = np.column_stack([np.full(len(lines), float(side)), unit])
    problem = block.problem.some(lines)
    _, check = verify_steps(problem, patch.gaits(points), q)
    return np.asarray(check.step | check.doubt)


@dataclass(frozen=True)
class _Predicted:
    """Points on a patch that are to be solved: their `index`, coordinates of keys (n,
    d), ln slopes, and predictions.
    """

    patch: Patch
    index: np.ndarray
    unit: np.ndarray
    q: np.ndarray
    guesses: Guesses

    @classmethod
    def of(
        cls,
        block: Block,
        patch: Patch,
        index: np.ndarray,
    ) -> _Predicted:
        """Predict points of a block."""
        line, at = np.divmod(index, block.q.shape[1])
        unit = block.unit[line]
        guesses = patch.guesses(unit, block.drive[line, at])
        return cls(patch, index, unit, block.q[line, at], guesses)


def _solve_block(
    block: Block,
    wanted: Wanted,
    out: Arrays,
    integrated: np.ndarray,
) -> np.ndarray:
    """Store the gaits of points that are to be `integrated` in `out`, and return which
    of all are accepted, (n s,).
    """
    predicted = []
    for patch in block.cell.patches:
        index = block.on(patch)
        predicted.append(_Predicted.of(block, patch, index[integrated[index]]))

    accepted = np.ones(len(integrated), bool)
    if not any(len(on_patch.index) for on_patch in predicted):
        return accepted

    solved = _solve_predicted(block, predicted, wanted)
    given = []
    found = []
    for k, on_patch in enumerate(predicted):
        at = lanes_of(solved.at, solved.lanes[k])
        fine, is_step = on_patch.patch.judge(
            at, on_patch.guesses.w, on_patch.q, on_patch.unit
        )
        accepted[on_patch.index[~fine]] = False
        part = solved.part(
            k, on_patch.index, on_patch.patch.numbers_at(on_patch.unit).T
        )
        given.append(part.some(is_step))
        found.append((on_patch.index, at.w))

    store(out, given, wanted.labels)

    for one, other in combinations(found, 2):
        accepted[_met(one, other)] = False
    return accepted


def _solve_predicted(
    block: Block, predicted: Sequence[_Predicted], wanted: Wanted
) -> Solved:
    """The gaits of points that are predicted."""
    index = np.concatenate([on_patch.index for on_patch in predicted])
    line = index // block.q.shape[1]
    problem = block.problem.some(line)
    alone = walkers_alone(problem, line, wanted.names)
    to_accuracy = partial(settle, sampled=True, accuracy=wanted.accuracy)
    guesses = [on_patch.guesses for on_patch in predicted]
    return solve_guesses(problem, guesses, to_accuracy, wanted, alone)


def _met(
    one: tuple[np.ndarray, np.ndarray], other: tuple[np.ndarray, np.ndarray]
) -> np.ndarray:
    """Indices of the points at which gaits of two patches may be identical, of indices
    (n,) and gaits (c, n).
    """
    both, a, b = np.intersect1d(
        one[0], other[0], assume_unique=True, return_indices=True
    )
    apart = np.abs(one[1][:, a] - other[1][:, b]).max(axis=0, initial=0.0)
    return np.asarray(both[apart < _APART])
