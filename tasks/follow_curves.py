"""The task `curve`: folds, flips and ends of branches, continued in slope and one key of the walker."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from tasks import registry
from tasks.continuation import atlas as atlases
from tasks.continuation.branch import Branch
from tasks.continuation.codimension_one import (
    CLOSED,
    DIFFERENCE,
    ENDS,
    SCALARS,
    Curve,
    End,
    Point,
    follow,
    turning,
)
from tasks.continuation.defining import slope_error
from tasks.continuation.special_points import special_points
from tasks.step.problem import EPS, Lanes, Problem
from tasks.walkers.resolve import is_one_link, resolve
from tasks.walkers.walker import ONE_LINK, Walker, WalkerError

Arrays = dict[str, np.ndarray]
#: Columns of the tables.
_CURVES = ("curve", "kind", "slope", "key", "value", "stance_angle", "period", "error_bound", "walks", "stopped")
_TURNINGS = ("curve", "kind", "turn", "slope", "key", "value", "stance_angle", "period", "error_bound")


def curve(params: Mapping[str, Any], inputs: list[Arrays]) -> Arrays:
    """Continue a line's special points as one key varies.

    Parameters
    ----------
    params : mapping
        `line`, at which the curves begin if its value of the key lies in the range and it has such points, else at an
        end of the range, the nearer first; `slope`, ndarray [rad], whose ends are the window; and the study's options:
        `key` (a walker key, `detuning` or `foot_mass_ratio`), `from` and `to`, its range in the walker's units, and
        `kinds` of points.
    inputs : list
        The line's atlas.

    Returns
    -------
    dict
        Tables `curves` (curve, kind, slope, key, value, stance_angle, period, error_bound, walks, and at its ends
        `stopped`: why it was followed no further) and `turnings` (turning points of key or slope along a curve: curve,
        kind, turn, slope, key, value, stance_angle, period, error_bound), in the walker's units.

    Raises
    ------
    WalkerError
        If the walker has no such key, or the range is empty.
    """
    line, options = params["line"], registry.options("curve", params)
    key, low, high = str(options["key"]), float(options["from"]), float(options["to"])
    if not low < high:
        raise WalkerError("from", low, f"must be less than `to` = {high!r}")

    def walker_at(value: float) -> Walker:
        return resolve(line["walker"], {**line.get("set", {}), key: value})

    # Away from any special value: the equations that hold there hold throughout the range.
    usual = low + 0.4871 * (high - low)
    walker_at(usual)
    own = _own_value(line, key)
    slope = np.asarray(params["slope"], float)
    window = {"q": (np.log(slope.min()), np.log(slope.max())), "key": (low, high)}
    rows: dict[str, list[Any]] = {k: [] for k in _CURVES}
    turns: dict[str, list[Any]] = {k: [] for k in _TURNINGS}
    for begin in _beginnings(own, low, high):
        beside = np.clip(begin + DIFFERENCE * (high - low) * np.array([-1.0, 0.0, 1.0]), low, high)
        if not _is_ordinary(walker_at, beside.tolist(), usual):
            begin += 1e-3 * (usual - begin)
        problem = Problem(walker_at(begin))
        branches = atlases.from_arrays(inputs[0]) if begin == own else atlases.survey(problem)
        seeds = _seeds(problem, branches, options["kinds"], window)
        seen: list[tuple[str, np.ndarray]] = []
        for kind, U, times in seeds:
            equations = (End if kind in ENDS else Curve)(kind, walker_at, usual, (low, high))
            U = equations.begin(U, times, begin)
            border = np.zeros(len(U))
            border[-1] = 1.0
            first = equations.correct(U, times, border)
            if not first.ok or any(k == kind and np.abs(first.U - p).max() < 1e-3 for k, p in seen):
                continue
            points = _follow_both_directions(equations, first, window)
            # A curve that returns to the line it began on passes through another of its points.
            seen += [(kind, p.U) for p in _returns(equations, points, first)]
            number = len(set(rows["curve"]))
            for p in points:
                place = *_place(equations, p, key, window), _error(equations, p, window)
                _add(rows, (number, kind, *place, int(equations.walks(p)), p.stopped))
            for component, turn in ((-1, "key"), (-2, "slope")):
                for a, b in itertools.pairwise(points):
                    point = turning(equations, a, b, component)
                    if point is not None and point.ok:
                        _add(turns, (number, kind, turn, *_place(equations, point, key, window), point.error))
        if seen:
            break
    return {f"curves/{k}": np.array(v) for k, v in rows.items()} | {
        f"turnings/{k}": np.array(v) for k, v in turns.items()
    }


def _beginnings(own: float, low: float, high: float) -> list[float]:
    """Values at which curves may begin: the walker's own, or the nearest in the range; then the ends of the range."""
    return list(dict.fromkeys([min(max(own, low), high), *sorted((low, high), key=lambda end: abs(end - own))]))


def _is_ordinary(walker_at: Callable[[float], Walker], values: list[float], usual: float) -> bool:
    """Whether a curve can begin among neighbouring values: walkers exist, and their maps have the usual dimension."""
    try:
        return all(walker_at(v).point_foot == walker_at(usual).point_foot for v in values)
    except WalkerError:
        return False


def _add(table: dict[str, list[Any]], row: tuple[Any, ...]) -> None:
    for column, value in zip(table.values(), row, strict=True):
        column.append(value)


def _place(equations: Curve, p: Point, key: str, window: Mapping[str, tuple[float, float]]) -> tuple[Any, ...]:
    """Slope, key, its value, stance angle and period of a point, in the walker's units."""
    walker = equations.walker(p.U)
    slope, value = np.exp(np.clip(p.U[-2], *window["q"])), np.clip(p.U[-1] * equations.scale, *window["key"])
    period = p.times[-1] * np.sqrt(walker.leg / walker.g)
    return float(slope), key, float(value), float(np.exp(p.U[0])), float(period)


def _error(equations: Curve, p: Point, window: Mapping[str, tuple[float, float]]) -> float:
    """Bound on the relative error of a point's slope, at its value of the key; infinite where the key turns."""
    # At a special value the walker alone would have a map of fewer dimensions.
    problem = Lanes([equations.walker(p.U)], equations.structure).alone(0)
    Z = np.concatenate([p.U[: equations.m], [np.clip(p.U[-2], *window["q"])], p.times])
    return slope_error(problem, equations.kind, Z) + 8 * EPS


def _own_value(line: Mapping[str, Any], key: str) -> float:
    """The line's value of a key."""
    walker, settings = resolve(line["walker"], line.get("set")), line.get("set", {})
    # A walker's table may be detuned too.
    table = line["walker"] if isinstance(line["walker"], Mapping) else {}
    derived = {"detuning": table.get("detuning", 0.0), "foot_mass_ratio": walker.m_s / walker.total_mass}
    derived |= {own: table.get(own, 0.0) for own in ONE_LINK if is_one_link(table)}
    return float(settings[key] if key in settings else derived[key] if key in derived else getattr(walker, key))


def _seeds(
    problem: Problem, branches: list[Branch], kinds: Any, window: Mapping[str, tuple[float, float]]
) -> list[tuple[str, np.ndarray, np.ndarray]]:
    """Special points of a line's branches at which curves begin: kind, (w, q) and event times."""
    seeds = []
    m = problem.m
    for branch in branches:
        for point in special_points(problem, branch):
            q = np.log(float(point["slope"]))
            if point["kind"] not in kinds or point["kind"] not in (*SCALARS, *ENDS):
                continue
            if not window["q"][0] <= q <= window["q"][1]:
                continue
            # Folds are nodes; between nodes the branch's polynomial is accurate enough as a guess.
            angle = np.log(float(point["stance_angle"]))
            near = [branch.Z[np.argmin(np.abs(branch.Z[:, [0, m]] - [angle, q]).max(axis=1))]]
            near += [Z[0] for _, Z, _ in branch.guesses(np.array([q]))]
            Z = min(near, key=lambda z: abs(z[0] - angle) + abs(z[m] - q))
            seeds.append((str(point["kind"]), Z[: m + 1], Z[m + 1 :]))
    return seeds


def _follow_both_directions(equations: Curve, first: Point, window: Mapping[str, tuple[float, float]]) -> list[Point]:
    """The curve through a point, from the end with decreasing to that with increasing arclength; or once round."""
    up = follow(equations, replace(first), 1.0, window)
    if up[-1].stopped == CLOSED:
        up[0].stopped = CLOSED
        return up
    down = follow(equations, replace(first), -1.0, window)
    for p in down:
        p.tangent = -p.tangent
    up[0].stopped = up[0].stopped or down[0].stopped  # where either is its only point
    return down[:0:-1] + up


def _returns(equations: Curve, points: list[Point], first: Point) -> list[Point]:
    """Points of a curve at the value of the key at which it began."""
    border = np.zeros(len(first.U))
    border[-1] = 1.0
    value = first.U[-1]
    # One that began at the border of the range ends there.
    returns = [first, *(p for p in (points[0], points[-1]) if abs(p.U[-1] - value) < 1e-9)]
    for a, b in itertools.pairwise(points):
        if (a.U[-1] - value) * (b.U[-1] - value) < 0:
            h = (value - a.U[-1]) / (b.U[-1] - a.U[-1])
            p = equations.correct((1 - h) * a.U + h * b.U, (1 - h) * a.times + h * b.times, border)
            returns += [p] if p.ok else []
    return returns
