"""The task `lines` over a plane of keys: gaits predicted by the patches of a cell and solved by their own steps."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np

from tasks import status
from tasks.accuracy import always, is_interpolated
from tasks.continuation.lockstep import lanes_of
from tasks.costs import PANEL
from tasks.families.box import Box
from tasks.families.cell import Block, Cell, Family
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
    wanted = Wanted(want, set(params.get("gaits") or GAITS), params.get("violation_limits"), accuracy)
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
            solved, accepted[inside] = solve(family, part, keys[inside], slope[at_panel], wanted, made)
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


@dataclass(frozen=True)
class Wanted:
    """What is wanted of gaits.

    Attributes
    ----------
    names : list of str
        Of variables.
    labels : set of str
    limits : mapping, optional
        Limits of violations other than the registry's.
    accuracy : float
        Largest error bound wanted, 0 for any.
    """

    names: list[str]
    labels: set[str]
    limits: Mapping[str, float] | None = None
    accuracy: float = 0.0


def solve(
    family: Family, cell: Cell, keys: np.ndarray, slope: np.ndarray, wanted: Wanted, made: Sequence[Sheet] = ()
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
        Polynomials that give the gaits to an accuracy; where there are none the gaits are integrated.

    Returns
    -------
    out : dict of ndarray, shape (n, s, len(GAITS)[, multipliers])
        In the walkers' units.
    accepted : ndarray of bool, shape (n,)
        Lines all of whose gaits are accepted; what `out` has of the others is void.
    """
    n, s = len(keys), len(slope)
    out = nothing_solved(wanted.names, n * s, 4 if cell.structure.kneed else 3)
    accepted = np.full(n, bool(not cell.why))
    lines = max(1, (_INTERPOLATED_BLOCK if made else _BLOCK) // s)
    for k in range(0, n if not cell.why else 0, lines):
        some = slice(k, k + lines)
        block, part = (
            Block(family, cell, keys[some], slope),
            {name: v[k * s : (k + lines) * s] for name, v in out.items()},
        )
        integrated = accepted[some] = _away_from_events(block)
        if made:
            parts, sure = interpolate(block, made, wanted.names, wanted.accuracy)
            store(part, parts, wanted.labels)
            integrated = integrated & ~sure
        accepted[some] &= _solve_block(block, wanted, part, integrated)
    return {name: value.reshape(n, s, *value.shape[1:]) for name, value in out.items()}, accepted


def _away_from_events(block: Block) -> np.ndarray:
    """Whether all slopes of lines are farther from the ends of pieces than their errors, shape (n,).

    A piece goes on beyond the end at which it is cut. The cut lies at one distance from the event at the other, which
    beside the border of the box may be less than where the panel ends: there is no prediction.
    """
    away = np.ones(len(block.unit), bool)
    for patch in block.cell.patches:
        low, high = patch.span.ends(block.unit)[:, :, None]
        inwards = block.q - low, high - block.q
        for off, error, is_event in zip(inwards, patch.end_errors, patch.events, strict=True):
            near = PREDICTED_WITHIN * max(error, _MIN_END_ERROR)
            away &= (np.abs(off) > near if is_event else off >= 0).all(axis=1)
    return away


def _solve_block(block: Block, wanted: Wanted, out: Arrays, integrated: np.ndarray) -> np.ndarray:
    """Store the gaits of lines that are to be `integrated` in `out`, and return which of all are accepted, (n,)."""
    patches, s = block.cell.patches, len(block.slope)
    accepted = np.ones(len(block.unit), bool)
    indices = [index[integrated[index // s]] for index in map(block.on, patches)]
    if not sum(map(len, indices)):
        return accepted
    guesses = join(
        [
            patch.guesses(block.unit[index // s], block.slope[index % s])
            for patch, index in zip(patches, indices, strict=True)
        ]
    )
    line = np.concatenate(indices) // s
    walkers = block.walkers.some(line)
    problem = Lanes(walkers, block.cell.structure)
    at = settle(problem, guesses, sampled=True, accuracy=wanted.accuracy)
    counts = [len(index) for index in indices]
    error, side = np.repeat([(patch.gaits.error, patch.side) for patch in patches], counts, axis=0).T
    np.logical_and.at(accepted, line, are_predicted(at, guesses, error, side))
    gaits = _describe(problem, walkers, at, guesses.slope, wanted)
    parts, of_part = (
        [],
        [slice(end - count, end) for count, end in zip(counts, np.cumsum(counts).tolist(), strict=True)],
    )
    for patch, index, part in zip(patches, indices, of_part, strict=True):
        own = {name: value[part] for name, value in gaits.items()}
        own["branch"], own["piece"] = patch.numbers_at(block.unit[index // s]).T
        angle = np.where(own["anthropomorphic"], guesses.w[0, part], np.nan)
        parts.append(Part(index, angle, own["heelstrike_rate_ratio"], own))
    store(out, parts, wanted.labels)
    w = similarity(at)
    for i, j in combinations(range(len(parts)), 2):
        both, a, b = np.intersect1d(indices[i], indices[j], assume_unique=True, return_indices=True)
        alike = np.abs(w[:, of_part[i]][:, a] - w[:, of_part[j]][:, b]).max(axis=0, initial=0.0) < _APART
        accepted[both[alike] // s] = False
    return accepted


def _describe(problem: Lanes, walkers: WalkerArray, at: Polished, slope: np.ndarray, wanted: Wanted) -> Arrays:
    """Measure the gaits: all at once, or walker by walker where violations are wanted."""
    want, limits = wanted.names, wanted.limits
    if not any(VARIABLES[name].group == "violations" for name in want):
        return describe(problem, walkers, at, slope, want, limits)
    each = []
    for i in range(len(slope)):
        one = slice(i, i + 1)
        each.append(describe(problem.some(np.array([i])), walkers[i], lanes_of(at, one), slope[one], want, limits))
    return {name: np.concatenate([gait[name] for gait in each]) for name in each[0]}
