"""The task `charts` of a plane of keys, and `lines`: gaits predicted by charts and
solved by their own steps.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np

from gaitsweep.tasks import status
from gaitsweep.tasks.accuracy import is_interpolated
from gaitsweep.tasks.families.arrays import arrays_of, parts, under, value_of
from gaitsweep.tasks.families.box import Box
from gaitsweep.tasks.families.cell import Block, Cell, from_arrays, to_arrays
from gaitsweep.tasks.families.division import make_cells
from gaitsweep.tasks.families.family import Family
from gaitsweep.tasks.families.patch import PREDICTED_WITHIN
from gaitsweep.tasks.fixed_points.polish import Polished, settle
from gaitsweep.tasks.fixed_points.step_check import verify_steps
from gaitsweep.tasks.interpolate import Sheet, interpolate, sheets
from gaitsweep.tasks.measures.gaits import (
    Arrays,
    Part,
    Wanted,
    describe,
    nothing_solved,
    store,
    to_accuracy,
)
from gaitsweep.tasks.registry import GAITS, VARIABLES
from gaitsweep.tasks.solve_points import lines as lines_side_by_side
from gaitsweep.tasks.step.lanes import join_lanes, lanes_of, slices
from gaitsweep.tasks.step.problem import Lanes

#: Smallest error assumed for the ends of pieces, in ln slope.
_MIN_END_ERROR = 1e-9
#: Gaits of two pieces closer than this could be identical.
_APART = 1e-7
#: Lines of a plane from which on its halves are jobs of their own: some seconds of work
#: where charts are hard to make.
_MANY_LINES = 256
#: Points solved at a time, and where most are given by polynomials.
_BLOCK, _INTERPOLATED_BLOCK = 4096, 1 << 14


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
        `want` and `accuracy` as `tasks.solve_points:points` has them.
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
    plane, slopes = params["plane"], params["slopes"]
    family, box = _family(params["line"], plane)
    window = float(np.log(params["slope_from"])), float(np.log(params["slope_to"]))
    box = replace(
        box,
        **{name: tuple(plane[name]) for name in ("origin", "halved") if name in plane},
    )
    spread = replace(box, log=tuple(plane["log"]), origin=())

    def lines_in(part: Box) -> float:
        return spread.share(part) * plane["lines"]

    many = math.inf if params.get("whole") else _MANY_LINES
    cells = make_cells(
        family, box, window, lines_in, slopes, plane.get("surveyed", 0.0), many
    )
    wanted, arrays = Wanted.of(params), to_arrays(cells.made)
    alone = [cell.box for cell in cells.made if cell.why]
    arrays |= {
        f"alone/{name}": np.array([getattr(part, name) for part in alone])
        for name in ("low", "high")
    }
    if is_interpolated(wanted.names, wanted.accuracy):
        for i, cell in enumerate(cells.made):
            arrays |= arrays_of(
                sheets(family, cell, wanted, lines_in(cell.box) * slopes), f"{i}/sheets"
            )
    if cells.halves:
        for name in ("low", "high", "origin", "halved"):
            arrays[f"halves/{name}"] = np.array(
                [getattr(half, name) for half in cells.halves]
            )
        lines = np.array([lines_in(half) for half in cells.halves])
        arrays |= {
            "halves/lines": lines,
            "halves/surveyed": cells.surveyed * lines / plane["lines"],
        }
    return arrays


def _family(line: Mapping[str, Any], plane: Mapping[str, Any]) -> tuple[Family, Box]:
    """The family and the box of a plane."""
    family = Family.of(line, plane["keys"])
    return family, Box(family.keys, tuple(plane["low"]), tuple(plane["high"]), log=True)


def lines(
    params: Mapping[str, Any], inputs: list[Arrays]
) -> list[tuple[Arrays, Arrays]]:
    """Solve the gaits at the slopes of lines in a plane of keys.

    Parameters
    ----------
    params : mapping
        `lines`, the line of each; `plane` as `charts` has it; the others as
        `tasks.solve_points:points` has them.
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
    all_lines, slope = params["lines"], np.asarray(params["slope"], float)
    family, box = _family(all_lines[0], params["plane"])
    wanted = Wanted.of(params)
    keys = np.array([[line["set"][key] for key in family.keys] for line in all_lines])
    walkers, corners = (
        family.walkers(keys),
        family.walkers(np.array([box.low, box.high])),
    )
    n, s = len(keys), len(slope)
    # A massless leg's steps are the limit of those of light ones; its losses have
    # formulas of their own.
    is_alike = walkers.massless_legs == corners.massless_leg
    accepted = np.zeros((n, s), bool)
    void = nothing_solved(wanted.names, n * s, walkers.knees)
    out = {name: value.reshape(n, s, *value.shape[1:]) for name, value in void.items()}
    cells = (
        pair
        for each in inputs
        for pair in zip(from_arrays(family, each), parts(each), strict=True)
    )
    for cell, own in cells:
        inside = np.flatnonzero(_inside(cell.box, keys, box) & is_alike)
        if cell.why or not len(inside):
            continue
        made = [value_of(Sheet, each) for each in parts(under("sheets", own))]
        solved, accepted[inside] = solve(
            family, cell, keys[inside], slope, wanted, made
        )
        for name, value in solved.items():
            out[name][inside] = value
    to_accuracy(
        {name: value.reshape(-1, *value.shape[2:]) for name, value in out.items()},
        wanted.accuracy,
    )
    reasons = _reasons(family, box)
    sentences: dict[str, int] = {}
    # Lines that are not accepted at all, then others at the slopes that some of them
    # lack.
    none = ~accepted.any(axis=1)
    for some in (none, ~none & ~accepted.all(axis=1)):
        numbers, at = (
            np.flatnonzero(some).tolist(),
            np.flatnonzero(~accepted[some].all(axis=0)),
        )
        if not numbers:
            continue
        request = {
            **params,
            "lines": [all_lines[i] for i in numbers],
            "slope": slope[at],
        }
        out["reason"] = out["reason"].astype(np.int32)
        for i, (_, points) in zip(
            numbers, lines_side_by_side(request, []), strict=True
        ):
            lacking = ~accepted[i, at]
            of_line = points["reasons"].tolist()
            number = np.array(
                [
                    len(reasons) + sentences.setdefault(sentence, len(sentences))
                    for sentence in of_line
                ]
            )
            for name, every in out.items():
                every[i, at[lacking]] = (
                    number[points[name]] if name == "reason" else points[name]
                )[lacking]
    joined = {name: value.reshape(-1, *value.shape[2:]) for name, value in out.items()}
    return [({}, joined | {"reasons": np.array([*reasons, *sentences])})]


def _inside(part: Box, keys: np.ndarray, whole: Box) -> np.ndarray:
    """Whether lines, shape (n, d), lie in a part of a box; what two parts share belongs
    to the upper one.
    """
    top = np.array([b == end for b, end in zip(part.high, whole.high, strict=True)])
    return np.asarray(
        ((keys >= part.low) & ((keys < part.high) | (top & (keys <= part.high)))).all(
            axis=1
        )
    )


def _reasons(family: Family, box: Box) -> list[str]:
    """Sentences that `reason` indexes."""
    sides = zip(family.keys, box.low, box.high, strict=True)
    where = ", ".join(f"{key} from {low:.6g} to {high:.6g}" for key, low, high in sides)
    return status.reasons(*(status.absent(label, where) for label in GAITS[:2]))


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
        Within the range of the cell.
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
    n, s = len(keys), len(slope)
    out = nothing_solved(wanted.names, n * s, cell.structure.kneed)
    accepted = np.ones((n, s), bool)
    lines = max(1, (_INTERPOLATED_BLOCK if made else _BLOCK) // s)
    for k in range(0, n, lines):
        some = slice(k, k + lines)
        block = Block(family, cell, keys[some], slope)
        part = {name: v[k * s : (k + lines) * s] for name, v in out.items()}
        fine = _known_to_end(block) & _away_from_ends(block)
        integrated = fine.copy()
        if made:
            parts, sure = interpolate(block, made, wanted)
            store(part, parts, wanted.labels)
            integrated &= ~sure
        accepted[some] = (fine & _solve_block(block, wanted, part, integrated)).reshape(
            -1, s
        )
    return {
        name: value.reshape(n, s, *value.shape[1:]) for name, value in out.items()
    }, accepted


def _away_from_ends(block: Block) -> np.ndarray:
    """Whether points are farther from the ends of pieces than their errors, shape (n
    s,).
    """
    away = np.ones((len(block.unit), len(block.slope)), bool)
    for patch in block.cell.patches:
        for end, error, kind in zip(
            patch.span.ends(block.unit), patch.end_errors, patch.kinds, strict=True
        ):
            if kind in ("fold", "end"):
                away &= np.abs(block.q - end[:, None]) > PREDICTED_WITHIN * max(
                    error, _MIN_END_ERROR
                )
    return away.ravel()


def _known_to_end(block: Block) -> np.ndarray:
    """Whether points beyond the ends of walking have no gait: the equations' solutions
    at these ends are none.
    """
    known = np.ones((len(block.unit), len(block.slope)), bool)
    for patch in block.cell.patches:
        for k, (end, kind) in enumerate(
            zip(patch.span.ends(block.unit), patch.kinds, strict=True)
        ):
            beyond = (block.q < end[:, None]) if k == 0 else (block.q > end[:, None])
            lines = np.flatnonzero(beyond.any(axis=1))
            if kind == "beyond" and len(lines):
                points = np.column_stack(
                    [np.full(len(lines), (-1.0, 1.0)[k]), block.unit[lines]]
                )
                problem = Lanes(block.walkers.some(lines), block.cell.structure)
                _, check = verify_steps(problem, patch.gaits(points), end[lines])
                known[lines] &= ~(beyond[lines] & (check.step | check.doubt)[:, None])
    return known.ravel()


def _solve_block(
    block: Block, wanted: Wanted, out: Arrays, integrated: np.ndarray
) -> np.ndarray:
    """Store the gaits of points that are to be `integrated` in `out`, and return which
    of all are accepted, (n s,).
    """
    patches, s = block.cell.patches, len(block.slope)
    accepted = np.ones(len(integrated), bool)
    indices = [index[integrated[index]] for index in map(block.on, patches)]
    if not sum(map(len, indices)):
        return accepted
    guesses = join_lanes(
        [
            patch.guesses(block.unit[index // s], block.slope[index % s])
            for patch, index in zip(patches, indices, strict=True)
        ]
    )
    problem = Lanes(
        block.walkers.some(np.concatenate(indices) // s), block.cell.structure
    )
    at = settle(problem, guesses, sampled=True, accuracy=wanted.accuracy)
    gaits = _describe(problem, at, guesses.slope, wanted)
    parts, of_part, w = [], slices([len(each) for each in indices]), at.w
    for patch, own, part in zip(patches, indices, of_part, strict=True):
        unit = block.unit[own // s]
        fine, is_step = patch.judge(
            lanes_of(at, part), guesses.w[:, part], block.q[own % s], unit
        )
        accepted[own[~fine]] = False
        solved = {name: value[part] for name, value in gaits.items()}
        solved["branch"], solved["piece"] = patch.numbers_at(unit).T
        angle = np.where(solved["anthropomorphic"], guesses.w[0, part], np.nan)
        parts.append(
            Part(own, angle, solved["heelstrike_rate_ratio"], solved).some(is_step)
        )
    store(out, parts, wanted.labels)
    for i, j in combinations(range(len(parts)), 2):
        both, a, b = np.intersect1d(
            indices[i], indices[j], assume_unique=True, return_indices=True
        )
        alike = (
            np.abs(w[:, of_part[i]][:, a] - w[:, of_part[j]][:, b]).max(
                axis=0, initial=0.0
            )
            < _APART
        )
        accepted[both[alike]] = False
    return accepted


def _describe(
    problem: Lanes, at: Polished, slope: np.ndarray, wanted: Wanted
) -> Arrays:
    """Measure the gaits: all at once, or walker by walker where violations are wanted."""
    want, limits = wanted.names, wanted.limits
    if not any(VARIABLES[name].group == "violations" for name in want):
        return describe(problem, at, slope, want, limits)
    ones = enumerate(slices([1] * len(slope)))
    each = [
        describe(problem.alone(i), lanes_of(at, one), slope[one], want, limits)
        for i, one in ones
    ]
    return {name: np.concatenate([gait[name] for gait in each]) for name in each[0]}
