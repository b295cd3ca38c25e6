"""The task `lines` over a plane of keys: gaits predicted by the patches of a cell and solved by their own steps."""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import Any

import numpy as np

from tasks import status
from tasks.continuation.lockstep import lanes_of
from tasks.families.box import Box
from tasks.families.cell import PANEL, Cell, Family, make
from tasks.families.patch import Patch, side_of_fold
from tasks.fixed_points.polish import UNKNOWN, Guesses, Polished, join, settle
from tasks.measures import violations
from tasks.measures.gaits import Arrays, Part, describe, nothing_solved, store, to_accuracy
from tasks.registry import GAITS, VARIABLES, always
from tasks.solve_points import lines as lines_side_by_side
from tasks.step.problem import Lanes
from tasks.walkers.walker_array import WalkerArray

#: A gait may lie this many times farther from its prediction than any that was measured.
_SAFETY = 8.0
#: Errors of the ends of pieces are taken to be no smaller, in ln slope.
_LEAST_END_ERROR = 1e-9
#: Lipschitz estimates of the nodes around, times this, serve a point.
_LIPSCHITZ_SAFETY = 4.0
#: Gaits of two pieces nearer than this could be one.
_APART = 1e-7
_BLOCK = 4096


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
        One pair for all lines: no atlas, and what `points` returns, line by line. What it has of a line depends on the
        line and the cell alone.
    """
    all_lines, slope = params["lines"], np.asarray(params["slope"], float)
    cell = params["cell"]
    family = Family.of(all_lines[0], cell["keys"])
    box = Box(family.keys, tuple(cell["low"]), tuple(cell["high"]))
    values = tuple(tuple(map(float, each)) for each in cell["values"])
    accuracy = params.get("accuracy", 0.0)
    want = [v for v in VARIABLES if v in params["want"] or v in always(accuracy)]
    wanted = set(params.get("gaits") or GAITS)
    friction_limit = params.get("friction_limit", violations.FRICTION_LIMIT)
    keys = np.array([[line["set"][key] for key in family.keys] for line in all_lines])
    accepted = np.ones(len(keys), bool)
    width = 4 if family.walkers(keys[:1]).knees else 3
    out = {
        name: value.reshape(len(keys), len(slope), *value.shape[1:])
        for name, value in nothing_solved(want, len(keys) * len(slope), width).items()
    }
    panels = np.floor(np.log(slope) / PANEL) * PANEL
    for low in np.unique(panels).tolist():
        at_panel = np.flatnonzero(panels == low)
        for part in _cells(family, box, low, values):
            inside = np.flatnonzero(_inside(part.box, keys, box) & accepted)
            if not len(inside):
                continue
            solved, accepted[inside] = solve(
                family, part, keys[inside], slope[at_panel], want, wanted, friction_limit, accuracy
            )
            for name, value in solved.items():
                out[name][np.ix_(inside, at_panel)] = value
    to_accuracy(out, accuracy)
    reasons = _reasons(family, box)
    others = np.flatnonzero(~accepted).tolist()
    if others:
        surveyed = lines_side_by_side({**params, "lines": [all_lines[i] for i in others]}, [])
        for i, (_, points) in zip(others, surveyed, strict=True):
            for name in out:
                out[name][i] = points[name]
            out["reason"][i] += len(reasons)
            reasons += points["reasons"].tolist()
    joined = {name: value.reshape(-1, *value.shape[2:]) for name, value in out.items()}
    return [({}, joined | {"reasons": np.array(reasons)})]


@functools.lru_cache(256)
def _cells(family: Family, box: Box, low: float, values: tuple[tuple[float, ...], ...]) -> list[Cell]:
    """Cells of a box for the panel from `low` on, for the lines at some values of its keys."""

    def count(part: Box) -> int:
        inside = (np.array(each) for each in values)
        sides = zip(inside, part.low, part.high, strict=True)
        return int(np.prod([((v >= a) & (v <= b)).sum() for v, a, b in sides]))

    return make(family, box, low, count)


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
    friction_limit: float = violations.FRICTION_LIMIT,
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
    friction_limit : float
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
    lines = max(1, _BLOCK // s)
    for k in range(0, n if not cell.why else 0, lines):
        some = slice(k, k + lines)
        part = {name: value[k * s : (k + lines) * s] for name, value in out.items()}
        accepted[some] = _solve_block(family, cell, keys[some], slope, solved, wanted, part, friction_limit, accuracy)
    return {name: value.reshape(n, s, *value.shape[1:]) for name, value in out.items()}, accepted


def _solve_block(
    family: Family,
    cell: Cell,
    keys: np.ndarray,
    slope: np.ndarray,
    solved: list[str],
    wanted: set[str],
    out: Arrays,
    friction_limit: float,
    accuracy: float,
) -> np.ndarray:
    """Store the gaits of a few lines in `out`, shape (n s, ...), and return which lines are accepted."""
    n, s = len(keys), len(slope)
    unit, q = cell.box.unit(keys), np.log(slope)
    accepted = np.ones(n, bool)
    indices, predictions = [], []
    for patch in cell.patches:
        ends = patch.ends_at(unit)
        index = np.arange(n * s).reshape(n, s)
        off = (ends[:, :1] - q, q - ends[:, 1:])
        for end in (0, 1):
            if patch.events[end]:
                accepted &= (np.abs(off[end]) > _SAFETY * max(patch.end_errors[end], _LEAST_END_ERROR)).all(axis=1)
        index = index[(off[0] <= 0) & (off[1] <= 0)]
        line = index // s
        w, node = patch.predict(unit[line], q[index % s], ends[line])
        indices.append(index)
        predictions.append(_guesses(patch, w, node, slope[index % s]))
    if not sum(map(len, indices)):
        return accepted
    guesses = join(predictions)
    line = np.concatenate(indices) // s
    walkers = family.walkers(keys).some(line)
    problem = Lanes(walkers, cell.structure)
    at = settle(problem, guesses, sampled=True, accuracy=accuracy)
    fine = _are_predicted(at, guesses, np.repeat([p.error for p in cell.patches], [len(i) for i in indices]))
    fine &= side_of_fold(at.stride) == np.repeat([p.side for p in cell.patches], [len(i) for i in indices])
    np.logical_and.at(accepted, line, fine)
    gaits = _describe(problem, walkers, at, guesses.slope, solved, friction_limit)
    parts, ends_of = [], np.cumsum([len(i) for i in indices]).tolist()
    for patch, index, end in zip(cell.patches, indices, ends_of, strict=True):
        own = {name: value[end - len(index) : end] for name, value in gaits.items()}
        own["branch"], own["piece"] = patch.numbers_at(unit[index // s]).T
        angle = np.where(own["anthropomorphic"], guesses.w[0, end - len(index) : end], np.nan)
        parts.append(Part(index, angle, own["heelstrike_rate_ratio"], own))
    store(out, parts, wanted)
    w = _similarity(at)
    for i, j in combinations(range(len(parts)), 2):
        _, a, b = np.intersect1d(indices[i], indices[j], assume_unique=True, return_indices=True)
        a, b = a + ends_of[i] - len(indices[i]), b + ends_of[j] - len(indices[j])
        alike = np.abs(w[:, a] - w[:, b]).max(axis=0, initial=0.0) < _APART
        accepted[line[a[alike]]] = False
    return accepted


def _guesses(patch: Patch, w: np.ndarray, node: np.ndarray, slope: np.ndarray) -> Guesses:
    last = len(patch.lipschitz) - 1
    around = [np.clip(node + i, 0, last) for i in (-1, 0, 1)]
    lipschitz = _LIPSCHITZ_SAFETY * np.max([patch.lipschitz[k] for k in around], axis=0)
    std = np.max([patch.rounding_std[k] for k in around], axis=0).T
    return Guesses(w, slope, lipschitz, std, np.full(len(slope), UNKNOWN))


def _similarity(at: Polished) -> np.ndarray:
    return np.vstack([np.log(at.y[:1] * at.scale), at.y[1:] / at.y[0], at.times])


def _are_predicted(at: Polished, guesses: Guesses, error: np.ndarray) -> np.ndarray:
    """Whether gaits are converged steps as near their predictions as they should be, shape (n,)."""
    with np.errstate(invalid="ignore"):
        moved = np.abs(_similarity(at) - guesses.w).max(axis=0)
    return at.converged & at.step & (moved < _SAFETY * error)


def _describe(
    problem: Lanes, walkers: WalkerArray, at: Polished, slope: np.ndarray, want: list[str], friction_limit: float
) -> Arrays:
    """Measure the gaits: all at once, or walker by walker where violations are wanted."""
    if not any(VARIABLES[name].group == "violations" for name in want):
        return describe(problem, walkers, at, slope, want, friction_limit)
    each = []
    for i in range(len(slope)):
        one = slice(i, i + 1)
        each.append(
            describe(problem.some(np.array([i])), walkers[i], lanes_of(at, one), slope[one], want, friction_limit)
        )
    return {name: np.concatenate([gait[name] for gait in each]) for name in each[0]}
