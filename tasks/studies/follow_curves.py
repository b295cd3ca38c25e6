"""The task `curve`: folds, flips and ends of branches, gaits at which a measure has a
value, and those at which a violation begins, continued in slope and one key of the
walker.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy import ndarray

from gaitsweep.tasks.branches import atlas as atlases
from gaitsweep.tasks.branches.branch import Branch
from gaitsweep.tasks.branches.conditions import CONDITIONS, Condition
from gaitsweep.tasks.branches.curves import (
    across_last,
    at_value,
)
from gaitsweep.tasks.branches.equations import (
    DIFFERENCE,
    Equations,
    Keys,
    correct_on_curve,
)
from gaitsweep.tasks.branches.meetings import Followed, followed, met
from gaitsweep.tasks.branches.special_points import RATES, special_points
from gaitsweep.tasks.contract import registry
from gaitsweep.tasks.contract.status import ranges
from gaitsweep.tasks.contract.tables import Arrays, lacking, table
from gaitsweep.tasks.measures.levels import LEVEL, level
from gaitsweep.tasks.measures.names import check_measure, never_begin
from gaitsweep.tasks.measures.onsets import ONSET, onsets
from gaitsweep.tasks.measures.passed import Curve, Sampled
from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.step.sameness import SAME_POINT, same
from gaitsweep.tasks.studies.check_curve import walker_inside
from gaitsweep.tasks.studies.curve_rows import (
    FORM,
    rows,
    start_and_period,
    walkers_of,
)
from gaitsweep.tasks.studies.follow_over_keys import curves_over_keys
from gaitsweep.tasks.walkers.resolve import value_of_key, walkers_over
from gaitsweep.tasks.walkers.walker import Walker, WalkerError

#: Share of the way to an ordinary value of the key at which a curve begins that cannot
#: at a special one.
_BESIDE = 1e-3
#: Distance of a ln slope from an end of the window that is rounding.
_ROUNDING = 1e-10
#: Columns of the tables.
_PLACE = (
    "slope",
    "key",
    "value",
    "stance_angle",
    *RATES,
    "period",
    "error_bound",
)
_CURVES = ("curve", "kind", *_PLACE, *FORM, "walks", "stopped")
_TURNINGS = ("curve", "kind", "turn", *_PLACE)
_MEETINGS = ("curve", "kind", "point", "meets", *_PLACE, "value_error")


def curve(params: Mapping[str, Any], inputs: list[Arrays]) -> Arrays:
    """Continue a line's special points as one key varies.

    Parameters
    ----------
    params : mapping
        `line`, at which the curves of a kind begin if its value of the key lies in the
        range and it has such points, else at an end of the range, the nearer first;
        `slope`, ndarray [rad], whose ends are the window; and the study's options: `key` (a
        walker key, `detuning` or `foot_mass_ratio`), `from` and `to`, its range in the
        walker's units, or `plane`, the ranges of two keys, `kinds` of points, `levels`,
        measures with their values, and `onsets`, names of violations, with
        `violation_limits`.
    inputs : list
        The line's atlas.

    Returns
    -------
    dict
        Tables `curves` (curve, kind, slope, key, value, stance_angle, stance_rate,
        thigh_rate, shank_rate, period, error_bound, normal_form, normal_form_error,
        criticality, walks, and at its ends `stopped`:
        why it was followed no further; over a `plane` at fixed slopes also `other_key`
        and `other_value`), `turnings` (turning points of key or slope
        along a curve: curve, kind, turn, and from slope to error_bound the same),
        `meetings` (codimension-two points along a curve: curve, kind, point, its name,
        meets, the other condition, the same, and value_error, the bound on the key's
        error; over a `plane` without error_bound, and with other_value_error too) and
        `curve_walkers` (value, other_value, and all numbers of the walkers there), in
        the walker's units.

    Raises
    ------
    WalkerError
        If the walker has no such key or measure, or the range is empty.
    """
    line, options = params["line"], registry.options("curve", params)
    slope = np.asarray(params["slope"], float)
    walker = walker_inside(line, options)
    conditions = _conditions(options, walker)
    absent = [*never_begin(options["onsets"], walker)]
    if options["plane"]:
        return curves_over_keys(line, slope, options["plane"], conditions, absent)

    key = str(options["key"])
    keys = _keys(line, key, float(options["from"]), float(options["to"]))
    window = _Window((slope.min(), slope.max()), keys)
    tables = _from_beginnings(value_of_key(line, key), inputs[0], conditions, window)
    found = table("curves", tables.curves, _CURVES)
    found |= table("turnings", tables.turnings, _TURNINGS)
    found |= table("meetings", tables.meetings, _MEETINGS)
    found |= walkers_of(keys, found)
    return found | lacking([*absent, *tables.absent], bool(tables.curves))


def _from_beginnings(
    value: float,
    atlas: Arrays,
    conditions: Mapping[str, Condition],
    window: _Window,
) -> _Tables:
    """Follow the curves of each condition from the first beginning that has points of
    it; `atlas` is that of the line, at its own value of the key.
    """
    tables = _Tables([], [], [], [])
    missing = dict(conditions)
    known: dict[str, list[tuple[float, float]]] = {name: [] for name in conditions}
    beginnings = []
    for begin in _beginnings(value, window.keys):
        beginnings.append(begin)
        problem = Problem(window.keys.walker_at(begin))
        if begin == value:
            branches = atlases.from_arrays(atlas)
        else:
            branches = atlases.survey(problem)

        seeds = list(_seeds(problem, branches, missing, window, known))

        begun = _follow_all(seeds, conditions, begin, window, tables)
        missing = {kind: missing[kind] for kind in missing if kind not in begun}
        if not missing:
            break

    where = window.words(beginnings)
    for name, condition in missing.items():
        tables.absent.append(_why_none(name, condition, known[name], where))

    return tables


def _why_none(
    name: str, condition: Condition, known: Sequence[tuple[float, float]], where: str
) -> str:
    """Say that there is no curve of a condition, and what there is: slopes of such
    points elsewhere, or values of the measure.
    """
    sentence = f"No point of `{name}` to start a curve from was found {where}"
    if not known:
        return f"{sentence}."
    if condition.name == LEVEL:
        return f"{sentence}: values of the measure are {ranges(known)}."
    if condition.name == ONSET:
        limit = float(condition.target)
        is_passed = any(low <= limit <= high for low, high in known)
        side = "" if is_passed else ": all gaits are on one side of the limit"
        return f"{sentence}{side}."
    return f"{sentence}: such points are at slopes {ranges(known)}."


def _keys(line: Mapping[str, Any], key: str, low: float, high: float) -> Keys:
    """A line's key as an unknown, over its range."""
    if not low < high:
        raise WalkerError("from", low, f"must be less than `to` = {high!r}")
    return Keys.of_one(key, walkers_over(line, key), low, high)


@dataclass(frozen=True)
class _Window:
    """The ends of slopes [rad], and the key with its range."""

    slopes: tuple[float, float]
    keys: Keys

    @property
    def edges(self) -> ndarray:
        """Least and largest ln slope and key, as points count them, shape (2, 2)."""
        log_slopes = np.log(self.slopes)
        ends = np.hstack([self.keys.low, self.keys.high])
        return np.array([log_slopes, ends / self.keys.scale])

    def words(self, values: Sequence[float]) -> str:
        """The slopes, and values of the key at which curves were to begin."""
        low, high = self.slopes
        key = self.keys.names[0]
        shown = ", ".join(f"{value:.6g}" for value in values)
        return f"at `{key}` = {shown} and slopes from {low:.6g} to {high:.6g}"

    def holds(self, log_slope: float) -> bool:
        """Whether a ln slope lies in the window, or beyond it by rounding."""
        low, high = np.log(self.slopes)
        return bool(low - _ROUNDING <= log_slope <= high + _ROUNDING)

    def inside(self, X: ndarray) -> ndarray:
        """A point (u,) whose ln slope is moved to the window's edge if it lies beyond
        by rounding.
        """
        moved = X.copy()
        moved[-2] = np.clip(X[-2], *np.log(self.slopes))
        return moved


class _Tables(NamedTuple):
    """Rows of the tables, and sentences on conditions of which there is no curve."""

    curves: list[tuple[Any, ...]]
    turnings: list[tuple[Any, ...]]
    meetings: list[tuple[Any, ...]]
    absent: list[str]


def _conditions(options: Mapping[str, Any], walker: Walker) -> dict[str, Condition]:
    """What curves fulfil, by what tables call them: kinds of special points, measures at
    their values, and amounts of violations at their limits.
    """
    conditions = {kind: CONDITIONS[kind] for kind in options["kinds"]}
    for measure, value in options["levels"].items():
        check_measure(measure, walker, "levels")
        conditions[f"{measure} = {value:g}"] = level(measure, value)
    limits = options["violation_limits"]
    return conditions | onsets(options["onsets"], walker, limits)


def _follow_all(
    seeds: list[tuple[str, ndarray]],
    conditions: Mapping[str, Condition],
    begin: float,
    window: _Window,
    tables: _Tables,
) -> set[str]:
    """Follow the curves through points at one value of the key, each once; and what
    tables call those that there are.
    """
    seen: list[tuple[str, ndarray]] = []
    others = met(conditions, window.keys.structure.kneed)
    for kind, Z in seeds:
        equations = Equations(window.keys, [conditions[kind]])
        guess = np.append(Z, begin / window.keys.scale)[:, None]
        first = correct_on_curve(equations, guess, across_last(len(guess)))
        if not first.ok[0] or _is_among(seen, kind, first.Z[:, 0]):
            continue

        curve = followed(equations, kind, first, window.edges, others)
        # A curve that returns to the line it began on passes through another of its
        # points.
        returns = at_value(equations, curve.points, first.Z[-1, 0])
        seen += [(kind, X) for X in (first.Z[:, 0], *returns)]
        number = len({row[0] for row in tables.curves})
        tables.curves.extend(_curve_rows(number, curve, window))
        tables.turnings.extend(_turning_rows(number, curve, window))
        tables.meetings.extend(_meeting_rows(number, curve, window))

    return {kind for kind, _ in seen}


def _is_among(seen: list[tuple[str, ndarray]], kind: str, X: ndarray) -> bool:
    """Whether a point lies on a curve of its kind that was followed."""
    return any(kind == other and same(X, Y, SAME_POINT) for other, Y in seen)


def _curve_rows(
    number: int, curve: Followed, window: _Window
) -> Iterator[tuple[Any, ...]]:
    """Rows of the points of a curve."""

    def place(X: ndarray) -> tuple[Any, ...]:
        return _place(curve.equations, X, window)

    return rows(number, curve, place)


def _turning_rows(
    number: int, curve: Followed, window: _Window
) -> Iterator[tuple[Any, ...]]:
    """Rows of the turning points of a curve."""
    names = {-1: "key", -2: "slope"}
    for each in curve.turnings:
        head = number, curve.kind, names[each.component]
        place = _place(curve.equations, each.X, window)
        yield (*head, *place, each.error)


def _meeting_rows(
    number: int, curve: Followed, window: _Window
) -> Iterator[tuple[Any, ...]]:
    """Rows of the codimension-two points of a curve."""
    units = np.hstack([1.0, window.keys.scale])
    for each in curve.meetings:
        head = number, curve.kind, each.name, each.meets
        place = _place(curve.equations, each.X, window)
        yield (*head, *place, *(each.error * units).tolist())


def _beginnings(value: float, keys: Keys) -> Iterator[float]:
    """Values at which curves may begin, moved where they are not ordinary: the walker's
    own, or the nearest in the range; then the ends of the range, the nearer one first.
    """
    (low,), (high,), (ordinary,) = keys.low, keys.high, keys.ordinary
    nearest = min(max(value, low), high)
    ends = [low, high]
    ends.sort(key=lambda end: abs(end - value))
    for begin in dict.fromkeys([nearest, *ends]):
        beside = begin + DIFFERENCE * (high - low) * np.array([-1.0, 0.0, 1.0])
        beside = np.clip(beside, low, high)
        if not _is_ordinary(keys.walker_at, beside.tolist(), ordinary):
            begin += _BESIDE * (ordinary - begin)
        yield begin


def _is_ordinary(
    walker_at: Callable[[float], Walker], values: list[float], ordinary: float
) -> bool:
    """Whether a curve can begin among neighbouring values: walkers exist, and their
    maps have the usual dimension.
    """
    point_foot = walker_at(ordinary).point_foot
    try:
        return all(walker_at(value).point_foot == point_foot for value in values)
    except WalkerError:
        return False


def _place(equations: Equations, X: ndarray, window: _Window) -> tuple[Any, ...]:
    """Slope, key, its value, state at the start of the step and period of a point, in
    the walker's units.
    """
    slope = float(np.exp(window.inside(X)[-2]))
    ((value,),) = window.keys.values(X[-1:, None]).tolist()
    time_unit = window.keys.walker_at(value).time_unit

    problem = equations.problem_at(X[:, None])
    gait = start_and_period(problem, window.inside(X)[:-1], time_unit)
    return (slope, window.keys.names[0], value, *gait)


def _seeds(
    problem: Problem,
    branches: list[Branch],
    conditions: Mapping[str, Condition],
    window: _Window,
    known: Mapping[str, list[tuple[float, float]]],
) -> Iterator[tuple[str, ndarray]]:
    """Points of a line's branches at which curves begin: what tables call them, and Z
    (c,). What there is of each condition, slopes of points or values of a measure in the
    window, is added to what is `known`.
    """
    measured = {
        name: condition
        for name, condition in conditions.items()
        if condition.name in (LEVEL, ONSET)
    }
    for branch in branches:
        for point in special_points(problem, branch):
            kind, Z = str(point["kind"]), np.array(point["Z"])
            if kind not in conditions:
                continue
            slope = float(np.exp(Z[-1]))
            known[kind].append((slope, slope))
            if window.holds(Z[-1]):
                yield kind, Z

        samples = Sampled.of_each(
            Curve.of_branch(problem, branch), [*measured.values()]
        )
        for name, sampled in zip(measured, samples, strict=True):
            known[name].extend(filter(None, [sampled.reached(*window.edges[0])]))
            for Z in sampled.passes_target().X.T:
                if window.holds(Z[-1]):
                    yield name, Z
