"""Tables of the branches of gaits of period n over a window of slopes, with their special points."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from tasks.continuation.cycle_events import slope_error
from tasks.continuation.cycles import RATES, Cycle, Path, correct, flip_test, largest, system
from tasks.fixed_points.step_check import gait_ratio
from tasks.follow_cycles import CycleBranch, cubic
from tasks.solve_cycles import solve_cycle
from tasks.step.problem import EPS, Problem

Arrays = dict[str, np.ndarray]
#: Largest number of points between two gaits of a branch.
_MAX_PARTS = 1024
#: Shortest part of a segment that is sampled: an edge of the window may be at a gait.
_MIN_PIECE = 1e-9
#: Distance of the ends of a branch along it to what ends it.
_END_DISTANCE = 1e-6
#: Columns of the tables `branches` and `special_points`.
COLUMNS = (
    *("branch", "slope", "stance_angle", *RATES),
    *("period", "kneestrike_time", "spectral_radius", "stable", "gait"),
)
SPECIAL = ("branch", "kind", "slope", "stance_angle", *RATES, "period", "error_bound")


def sample_cycles(problem: Problem, branches: list[CycleBranch], params: Mapping[str, Any]) -> Arrays:
    """Sample the branches of gaits of period n, continued through folds.

    Parameters
    ----------
    problem : Problem
    branches : list of CycleBranch
    params : mapping
        `slope_from`, `slope_to` [rad], the window, and `n`, the least number of points of a branch in it.

    Returns
    -------
    dict
        The tables of `tasks.follow_branches.branch`: state, knee strike and label are those of the step with the
        largest stance angle, the period is that of all steps, the spectral radius that of their product.
    """
    low, high = float(params["slope_from"]), float(params["slope_to"])
    rows: list[dict[str, Any]] = []
    points: list[dict[str, Any]] = []
    for number, branch in enumerate(branches):
        nodes = [_evaluated(problem, cycle) for cycle in branch.cycles]
        sampled = _sample(problem, branch, nodes, low, high, int(params["n"]))
        # An edge of the window is known to rounding, which ln of the slope is not.
        slopes = np.clip([cycle.slope for cycle in sampled], low, high)
        rows += [
            {"branch": number, **_describe(problem, cycle), "slope": slope}
            for cycle, slope in zip(sampled, slopes.tolist(), strict=True)
        ]
        points += [
            {"branch": number, **point}
            for point in _special_points(problem, replace(branch, cycles=nodes))
            if low <= point["slope"] <= high and point["kind"] != "window"
        ]
    tables = {f"branches/{key}": np.array([row[key] for row in rows]) for key in COLUMNS}
    return tables | {f"special_points/{key}": np.array([point[key] for point in points]) for key in SPECIAL}


def _evaluated(problem: Problem, cycle: Cycle) -> Cycle:
    """A gait with the Jacobians of its steps, which stored branches do not have."""
    _, _, A, _ = system(problem, cycle.Y, cycle.times, cycle.q)
    return replace(cycle, A=A)


def _sample(
    problem: Problem, branch: CycleBranch, nodes: list[Cycle], low: float, high: float, least: int
) -> list[Cycle]:
    """Gaits of a branch in the window: its nodes, as many between as `least` needs, and where it crosses the edges."""
    inside = [low <= cycle.slope <= high for cycle in nodes]
    at = [(float(i), nodes[i]) for i in np.flatnonzero(inside).tolist()]
    places = [place for place, _ in at]
    for edge in (low, high):
        for guess in branch.guesses(float(np.log(edge))):
            if not guess.room or any(abs(guess.place - place) < _MIN_PIECE for place in places):
                continue  # a gait of the branch lies on the edge, or a fold
            places.append(guess.place)
            cycle = solve_cycle(problem, guess, edge)
            at += [(guess.place, cycle)] if cycle.ok else []
    # Parts of segments in the window, which may lie between two gaits of the branch.
    pieces = [(a, b) for a, b in itertools.pairwise(sorted(places)) if a + _MIN_PIECE < b <= int(a) + 1]
    parts = min(_MAX_PARTS, 1 + max(0, least - len(at)) // max(1, len(pieces)))
    for start, end in pieces:
        i = int(start)
        a, b = nodes[i], nodes[i + 1]
        point = cubic(a, b)
        for h in (start - i + (end - start) * np.arange(1, parts + 1) / (parts + 1)).tolist():
            Z = point(h)
            if np.log(low) <= Z[-1] <= np.log(high):
                direction = point(h + 1e-3) - point(h - 1e-3)
                times = a.times * (1 - h) + b.times * h
                cycle = correct(problem, Z, times, direction / np.linalg.norm(direction))
                at += [(i + h, cycle)] if cycle.ok else []
    return [cycle for _, cycle in sorted(at, key=lambda one: one[0])]


def _describe(problem: Problem, cycle: Cycle) -> dict[str, Any]:
    """Row of a gait, in the walker's units."""
    walker, k = problem.walker, int(cycle.Y[0].argmax())
    time_unit, scale = np.sqrt(walker.leg / walker.g), np.exp2(np.floor(np.log2(cycle.Y[0])))
    step = problem.map(cycle.Y / scale, cycle.times, problem.parameters(np.full(cycle.period, cycle.slope), scale))
    radius = float(np.abs(replace(cycle, A=step.jacobian).multipliers()[0]))
    return {
        **largest(problem, cycle),
        "period": float(cycle.times[-1].sum()) * time_unit,
        "kneestrike_time": float(cycle.times[0, k]) * time_unit if walker.knees else np.nan,
        "spectral_radius": radius,
        "stable": np.int8(radius < 1),
        "gait": "long" if gait_ratio(step)[k] < 0.5 else "short",
    }


def _special_points(problem: Problem, branch: CycleBranch) -> list[dict[str, Any]]:
    """Ends, folds and flips of a branch, in order along it."""
    first, *_, last = branch.cycles
    records = [_record(problem, branch.ends[0], first, _end_error(problem, branch.ends[0], first))]
    for i, (a, b) in enumerate(itertools.pairwise(branch.cycles)):
        if i in branch.folds:
            records.append(_record(problem, "fold", a, a.error))
        if flip_test(a) * flip_test(b) < 0:
            path = Path(problem, a, a.tangent, 1.0)
            path.points.append(b)
            cycle = path.locate_root(flip_test)
            if cycle.ok:
                records.append(_record(problem, "flip", cycle, slope_error(problem, cycle, "flip")))
    return [*records, _record(problem, branch.ends[1], last, _end_error(problem, branch.ends[1], last))]


def _end_error(problem: Problem, kind: str, cycle: Cycle) -> float:
    """Relative error of the slope of an end: of a branch's birth that of the flip, of an end of walking its bracket."""
    if kind == "branch_point":
        n = cycle.period // 2
        half = replace(cycle, Y=cycle.Y[:, :n], times=cycle.times[:, :n], A=cycle.A[..., :n])
        return slope_error(problem, half, "flip")
    return abs(float(cycle.tangent[-1])) * _END_DISTANCE if kind.startswith("end_") else 64 * EPS


def _record(problem: Problem, kind: str, cycle: Cycle, error: float) -> dict[str, Any]:
    time_unit = np.sqrt(problem.walker.leg / problem.walker.g)
    return {
        "kind": kind,
        "slope": cycle.slope,
        **largest(problem, cycle),
        "period": float(cycle.times[-1].sum()) * time_unit,
        "error_bound": error,
    }
