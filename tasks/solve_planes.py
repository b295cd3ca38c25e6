"""The task `lines` over a plane of keys: gaits predicted by the patches of a cell and solved by their own steps."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import Any

import numpy as np

from tasks import status
from tasks.accuracy import always, is_interpolated
from tasks.continuation.lockstep import lanes_of
from tasks.costs import PANEL
from tasks.families.box import Box
from tasks.families.cell import Cell, Family
from tasks.families.division import Cells
from tasks.families.patch import PREDICTED_WITHIN, are_predicted, similarity
from tasks.fixed_points.polish import Polished, join, settle
from tasks.interpolate import Sheet, interpolate, sheets
from tasks.measures.gaits import Arrays, Part, describe, nothing_solved, store, to_accuracy
from tasks.registry import GAITS, VARIABLES
from tasks.solve_points import lines as lines_side_by_side
from tasks.step.problem import Lanes
from tasks.walkers.walker_array import WalkerArray

#: Smallest error assumed for the ends of pieces, in ln slope.
_MIN_END_ERROR = 1e-9
#: Gaits of two pieces closer than this could be identical.
_APART = 1e-7
#: Points solved at a time, and where most are given by polynomials.
_BLOCK, _INTERPOLATED_BLOCK = 4096, 1 << 14


def lines(params: Mapping[str, Any], inputs: list[Arrays]) -> list[tuple[Arrays, Arrays]]:
    """Solve the gaits at the slopes of lines in one cell of a plane of keys.

    Parameters
    ----------
    params : mapping
        `lines`, the line of each; `cell`, with its `keys`, `low`, `high` and the `values` of each key that the study
        has in it; the others as `tasks.solve_points:points` has them.
    inputs : list
        Empty.

    Returns
    -------
    list of (dict, dict)
        One pair for all lines: no atlas, and what `points` returns, line by line. The result of a line depends on the
        line, the cell and the slopes alone: a line that is not accepted at one of them is followed by itself at all.
    """
    all_lines, slope = params["lines"], np.asarray(params["slope"], float)
    cell = params["cell"]
    family = Family.of(all_lines[0], cell["keys"])
    box = Box(family.keys, tuple(cell["low"]), tuple(cell["high"]))
    values = tuple(tuple(map(float, each)) for each in cell["values"])
    accuracy = params.get("accuracy", 0.0)
    want = [v for v in VARIABLES if v in params["want"] or v in always(accuracy)]
    wanted = set(params.get("gaits") or GAITS)
    limits = params.get("violation_limits")
    keys = np.array([[line["set"][key] for key in family.keys] for line in all_lines])
    walkers, corners = family.walkers(keys), family.walkers(np.array([box.low, box.high]))
    # A massless leg's steps are the limit of those of light ones; its losses have formulas of their own.
    accepted = walkers.massless_legs == corners.massless_leg
    width = 4 if walkers.knees else 3
    out = {
        name: value.reshape(len(keys), len(slope), *value.shape[1:])
        for name, value in nothing_solved(want, len(keys) * len(slope), width).items()
    }
    panels = np.floor(np.log(slope) / PANEL) * PANEL
    cells = _cells(family, box, tuple(np.unique(panels).tolist()), values)
    for part in itertools.chain(*cells.values()):
        if part.why:
            accepted &= ~_inside(part.box, keys, box)
    for low, parts in cells.items():
        at_panel = np.flatnonzero(panels == low)
        for part in parts:
            inside = np.flatnonzero(_inside(part.box, keys, box) & accepted)
            if not len(inside):
                continue
            made: list[Sheet] = []
            if is_interpolated(want, accuracy):
                made = _sheets(family, part, tuple(want), accuracy, part.box.count(values) * len(at_panel))
            of_part = part, keys[inside], slope[at_panel], want, wanted, limits
            solved, accepted[inside] = solve(family, *of_part, made, accuracy)
            for name, value in solved.items():
                out[name][np.ix_(inside, at_panel)] = value
    to_accuracy({name: value.reshape(-1, *value.shape[2:]) for name, value in out.items()}, accuracy)
    reasons = _reasons(family, box)
    others = np.flatnonzero(~accepted).tolist()
    if others:
        surveyed = lines_side_by_side({**params, "lines": [all_lines[i] for i in others]}, [])
        out["reason"] = out["reason"].astype(np.int32)
        sentences: dict[str, int] = {}
        for i, (_, points) in zip(others, surveyed, strict=True):
            of_line = points["reasons"].tolist()
            own = np.array([len(reasons) + sentences.setdefault(sentence, len(sentences)) for sentence in of_line])
            for name in out:
                out[name][i] = own[points[name]] if name == "reason" else points[name]
        reasons += sentences
    joined = {name: value.reshape(-1, *value.shape[2:]) for name, value in out.items()}
    return [({}, joined | {"reasons": np.array(reasons)})]


@functools.lru_cache(16)  # blocks of lines come cell by cell
def _cells(
    family: Family, box: Box, panels: tuple[float, ...], values: tuple[tuple[float, ...], ...]
) -> dict[float, list[Cell]]:
    """Cells of a box for each panel, for the lines at some values of its keys."""
    cells = Cells(family, box, values)
    return {low: cells.make(low) for low in panels}


#: Polynomials of a cell, made once for all blocks of its lines.
_sheets = functools.lru_cache(256)(sheets)


def _inside(part: Box, keys: np.ndarray, whole: Box) -> np.ndarray:
    """Whether lines, shape (n, d), lie in a part of a box; what two parts share belongs to the upper one."""
    top = np.array([b == end for b, end in zip(part.high, whole.high, strict=True)])
    return np.asarray(((keys >= part.low) & ((keys < part.high) | (top & (keys <= part.high)))).all(axis=1))


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
    want: Sequence[str],
    wanted: set[str],
    limits: Mapping[str, float] | None = None,
    made: Sequence[Sheet] = (),
    accuracy: float = 0.0,
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
    want : sequence of str
        Names of variables.
    wanted : set of str
        Labels.
    limits : mapping, optional
        Limits of violations other than the registry's.
    made : sequence of Sheet
        Polynomials that give the gaits to an accuracy; where there are none the gaits are integrated.
    accuracy : float
        Largest error bound wanted, 0 for any.

    Returns
    -------
    out : dict of ndarray, shape (n, s, len(GAITS)[, multipliers])
        In the walkers' units.
    accepted : ndarray of bool, shape (n,)
        Lines all of whose gaits are accepted; what `out` has of the others is void.
    """
    n, s = len(keys), len(slope)
    solved = [name for name in VARIABLES if name in want]
    out = nothing_solved(solved, n * s, 4 if cell.structure.kneed else 3)
    accepted = np.full(n, bool(not cell.why))
    lines = max(1, (_INTERPOLATED_BLOCK if made else _BLOCK) // s)
    for k in range(0, n if not cell.why else 0, lines):
        some = slice(k, k + lines)
        part = {name: value[k * s : (k + lines) * s] for name, value in out.items()}
        accepted[some] = _away_from_events(cell, keys[some], slope)
        integrated = np.ones(len(keys[some]), bool)
        if made:
            parts, sure = interpolate(family, cell, made, keys[some], slope, solved, accuracy)
            store(part, parts, wanted)
            integrated = ~sure
        shared = family, cell, keys[some], slope, solved, wanted, part
        accepted[some] &= _solve_block(*shared, limits, accuracy, np.flatnonzero(integrated & accepted[some]))
    return {name: value.reshape(n, s, *value.shape[1:]) for name, value in out.items()}, accepted


def _away_from_events(cell: Cell, keys: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """Whether all slopes of lines are farther from the ends of pieces than their errors, shape (n,).

    A piece goes on beyond the end at which it is cut. The cut lies at one distance from the event at the other, which
    beside the border of the box may be less than where the panel ends: there is no prediction.
    """
    unit, q = cell.box.unit(keys), np.log(slope)
    away = np.ones(len(keys), bool)
    for patch in cell.patches:
        ends = patch.span.ends(unit)[:, :, None]
        for inwards, error, is_event in zip((q - ends[0], ends[1] - q), patch.end_errors, patch.events, strict=True):
            near = PREDICTED_WITHIN * max(error, _MIN_END_ERROR)
            away &= (np.abs(inwards) > near if is_event else inwards >= 0).all(axis=1)
    return away


def _solve_block(
    family: Family,
    cell: Cell,
    keys: np.ndarray,
    slope: np.ndarray,
    solved: list[str],
    wanted: set[str],
    out: Arrays,
    limits: Mapping[str, float] | None,
    accuracy: float,
    lines: np.ndarray,
) -> np.ndarray:
    """Store the gaits of a few `lines` in `out`, shape (n s, ...), and return which of all n are accepted."""
    n, s = len(keys), len(slope)
    accepted = np.ones(n, bool)
    if not len(lines):
        return accepted
    unit, q = cell.box.unit(keys), np.log(slope)
    indices, predictions = [], []
    for patch in cell.patches:
        low, high = patch.span.ends(unit[lines])[:, :, None]
        index = lines[:, None] * s + np.arange(s)
        index = index[(low <= q) & (q <= high)]
        indices.append(index)
        predictions.append(patch.guesses(unit[index // s], slope[index % s]))
    if not sum(map(len, indices)):
        return accepted
    guesses = join(predictions)
    line = np.concatenate(indices) // s
    walkers = family.walkers(keys).some(line)
    problem = Lanes(walkers, cell.structure)
    at = settle(problem, guesses, sampled=True, accuracy=accuracy)
    counts = [len(index) for index in indices]
    error, side = np.repeat([(patch.gaits.error, patch.side) for patch in cell.patches], counts, axis=0).T
    np.logical_and.at(accepted, line, are_predicted(at, guesses, error, side))
    gaits = _describe(problem, walkers, at, guesses.slope, solved, limits)
    parts, ends_of = [], np.cumsum([len(i) for i in indices]).tolist()
    for patch, index, end in zip(cell.patches, indices, ends_of, strict=True):
        own = {name: value[end - len(index) : end] for name, value in gaits.items()}
        own["branch"], own["piece"] = patch.numbers_at(unit[index // s]).T
        angle = np.where(own["anthropomorphic"], guesses.w[0, end - len(index) : end], np.nan)
        parts.append(Part(index, angle, own["heelstrike_rate_ratio"], own))
    store(out, parts, wanted)
    w = similarity(at)
    for i, j in combinations(range(len(parts)), 2):
        _, a, b = np.intersect1d(indices[i], indices[j], assume_unique=True, return_indices=True)
        a, b = a + ends_of[i] - len(indices[i]), b + ends_of[j] - len(indices[j])
        alike = np.abs(w[:, a] - w[:, b]).max(axis=0, initial=0.0) < _APART
        accepted[line[a[alike]]] = False
    return accepted


def _describe(
    problem: Lanes,
    walkers: WalkerArray,
    at: Polished,
    slope: np.ndarray,
    want: list[str],
    limits: Mapping[str, float] | None,
) -> Arrays:
    """Measure the gaits: all at once, or walker by walker where violations are wanted."""
    if not any(VARIABLES[name].group == "violations" for name in want):
        return describe(problem, walkers, at, slope, want, limits)
    each = []
    for i in range(len(slope)):
        one = slice(i, i + 1)
        each.append(describe(problem.some(np.array([i])), walkers[i], lanes_of(at, one), slope[one], want, limits))
    return {name: np.concatenate([gait[name] for gait in each]) for name in each[0]}
