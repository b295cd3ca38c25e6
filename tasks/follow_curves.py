"""The task `curve`: folds, flips and ends of branches, continued in slope and one key
of the walker.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from gaitsweep.tasks import registry
from gaitsweep.tasks.continuation import atlas as atlases
from gaitsweep.tasks.continuation.branch import Branch
from gaitsweep.tasks.continuation.codimension_one import (
    DIFFERENCE,
    Curve,
    follow_both_directions,
    turning,
)
from gaitsweep.tasks.continuation.defining import slope_error
from gaitsweep.tasks.continuation.special_points import RATES, special_points
from gaitsweep.tasks.step.problem import EPS, Problem
from gaitsweep.tasks.tables import Arrays, nothing, table
from gaitsweep.tasks.walkers.resolve import is_one_link, resolve, walker_of_line
from gaitsweep.tasks.walkers.walker import ONE_LINK, Walker, WalkerError

#: Why a line has no curve.
_NO_START = "No point to start a curve from was found, neither at the value of the walker nor at the ends of the range."
#: Columns of the tables.
_PLACE = ("slope", "key", "value", "stance_angle", *RATES, "period", "error_bound")
_CURVES = ("curve", "kind", *_PLACE, "walks", "stopped")
_TURNINGS = ("curve", "kind", "turn", *_PLACE)


def curve(params: Mapping[str, Any], inputs: list[Arrays]) -> Arrays:
    """Continue a line's special points as one key varies.

    Parameters
    ----------
    params : mapping
        `line`, at which the curves begin if its value of the key lies in the range and
        it has such points, else at an end of the range, the nearer first; `slope`,
        ndarray [rad], whose ends are the window; and the study's options: `key` (a
        walker key, `detuning` or `foot_mass_ratio`), `from` and `to`, its range in the
        walker's units, and `kinds` of points.
    inputs : list
        The line's atlas.

    Returns
    -------
    dict
        Tables `curves` (curve, kind, slope, key, value, stance_angle, stance_rate,
        thigh_rate, shank_rate, period, error_bound, walks, and at its ends `stopped`:
        why it was followed no further) and `turnings` (turning points of key or slope
        along a curve: curve, kind, turn, and from slope to error_bound the same), in
        the walker's units.

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

    # Away from any special value: the equations that hold there hold throughout the
    # range.
    usual = low + 0.4871 * (high - low)
    walker_at(usual)
    own = _own_value(line, key)
    slope = np.asarray(params["slope"], float)
    window = {"q": (np.log(slope.min()), np.log(slope.max())), "key": (low, high)}
    rows: list[tuple[Any, ...]] = []
    turns: list[tuple[Any, ...]] = []
    for begin in _beginnings(own, low, high):
        beside = np.clip(
            begin + DIFFERENCE * (high - low) * np.array([-1.0, 0.0, 1.0]), low, high
        )
        if not _is_ordinary(walker_at, beside.tolist(), usual):
            begin += 1e-3 * (usual - begin)
        problem = Problem(walker_at(begin))
        branches = (
            atlases.from_arrays(inputs[0]) if begin == own else atlases.survey(problem)
        )
        seen: list[tuple[str, np.ndarray]] = []
        for kind, Z in _seeds(problem, branches, options["kinds"], window):
            equations = Curve(kind, walker_at, usual, (low, high))
            first = equations.correct(
                np.append(Z, begin / equations.scale), np.eye(len(Z) + 1)[-1]
            )
            if not first.ok[0] or any(
                k == kind and np.abs(first.Z[:, 0] - p).max() < 1e-3 for k, p in seen
            ):
                continue
            points, tangents, stopped = follow_both_directions(equations, first, window)
            # A curve that returns to the line it began on passes through another of its
            # points.
            seen += [(kind, p) for p in _returns(equations, points, first.Z[:, 0])]
            number = len({row[0] for row in rows})
            why = (
                [stopped[0], *[""] * (len(points) - 2), stopped[1]]
                if len(points) > 1
                else [stopped[1]]
            )
            for p, reason in zip(points, why, strict=True):
                row = (
                    *_place(equations, p, key, window),
                    _error(equations, p, window),
                    int(equations.walks(p)),
                    reason,
                )
                rows.append((number, kind, *row))
            for component, turn in ((-1, "key"), (-2, "slope")):
                for a, b in itertools.pairwise(zip(points, tangents, strict=True)):
                    found = turning(equations, a, b, component)
                    if found is not None:
                        turns.append(
                            (
                                number,
                                kind,
                                turn,
                                *_place(equations, found[0], key, window),
                                found[1],
                            )
                        )
        if seen:
            break
    return (
        table("curves", rows, _CURVES)
        | table("turnings", turns, _TURNINGS)
        | ({} if rows else nothing(_NO_START))
    )


def _beginnings(own: float, low: float, high: float) -> list[float]:
    """Values at which curves may begin: the walker's own, or the nearest in the range;
    then the ends of the range.
    """
    return list(
        dict.fromkeys(
            [
                min(max(own, low), high),
                *sorted((low, high), key=lambda end: abs(end - own)),
            ]
        )
    )


def _is_ordinary(
    walker_at: Callable[[float], Walker], values: list[float], usual: float
) -> bool:
    """Whether a curve can begin among neighbouring values: walkers exist, and their
    maps have the usual dimension.
    """
    try:
        return all(
            walker_at(v).point_foot == walker_at(usual).point_foot for v in values
        )
    except WalkerError:
        return False


def _place(
    equations: Curve, Z: np.ndarray, key: str, window: Mapping[str, tuple[float, float]]
) -> tuple[Any, ...]:
    """Slope, key, its value, state at the start of the step and period of a point, in
    the walker's units.
    """
    time_unit = equations.walker_at(equations.value(Z)).time_unit
    slope = float(np.exp(np.clip(Z[-2], *window["q"])))
    value = float(np.clip(Z[-1] * equations.scale, *window["key"]))

    problem = equations.problem(Z)
    y, scale = problem.section(Z[:-2, None])
    angle, *rates = problem.start(y * scale, np.array([slope]))[:, 0].tolist()
    return (
        slope,
        key,
        value,
        angle,
        *(rate / time_unit for rate in rates),
        float(Z[-3]) * time_unit,
    )


def _error(
    equations: Curve, Z: np.ndarray, window: Mapping[str, tuple[float, float]]
) -> float:
    """Bound on the relative error of a point's slope, at its value of the key; infinite
    where the key turns.
    """
    at_slope = np.append(Z[:-2], np.clip(Z[-2], *window["q"]))
    return slope_error(equations.problem(Z), equations.kind, at_slope) + 8 * EPS


def _own_value(line: Mapping[str, Any], key: str) -> float:
    """The line's value of a key."""
    walker, settings = walker_of_line(line), line.get("set", {})
    # A walker's table may be detuned too.
    table = line["walker"] if isinstance(line["walker"], Mapping) else {}
    derived = {
        "detuning": table.get("detuning", 0.0),
        "foot_mass_ratio": walker.m_s / walker.total_mass,
    }
    derived |= {own: table.get(own, 0.0) for own in ONE_LINK if is_one_link(table)}
    return float(
        settings[key]
        if key in settings
        else derived[key]
        if key in derived
        else getattr(walker, key)
    )


def _seeds(
    problem: Problem,
    branches: list[Branch],
    kinds: Any,
    window: Mapping[str, tuple[float, float]],
) -> list[tuple[str, np.ndarray]]:
    """Special points of a line's branches at which curves begin: kind, and Z (c,)
    without a key.
    """
    found = [
        (str(p["kind"]), np.array(p["Z"]))
        for branch in branches
        for p in special_points(problem, branch)
    ]
    return [
        (kind, Z)
        for kind, Z in found
        if kind in kinds and window["q"][0] <= Z[-1] <= window["q"][1]
    ]


def _returns(
    equations: Curve, points: np.ndarray, first: np.ndarray
) -> list[np.ndarray]:
    """Points of a curve at the value of the key at which it began."""
    border, value = np.eye(len(first))[-1], first[-1]
    # One that began at the border of the range ends there.
    returns = [
        first,
        *(p for p in (points[0], points[-1]) if abs(p[-1] - value) < 1e-9),
    ]
    for a, b in itertools.pairwise(points):
        if (a[-1] - value) * (b[-1] - value) < 0:
            h = (value - a[-1]) / (b[-1] - a[-1])
            at = equations.correct((1 - h) * a + h * b, border)
            returns += [at.Z[:, 0]] if at.ok[0] else []
    return returns
