"""Curves over two keys of the walker at fixed slopes: folds, flips and ends, and gaits at
which a measure has a value.

Gaits at the slope are followed over either key at some values of the other. Where a
condition is passed along one of these, a curve of it begins, and is followed in both
directions to the borders of the plane, or until it closes.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np

from gaitsweep.tasks.branches.conditions import Condition
from gaitsweep.tasks.branches.equations import (
    Equations,
    Keys,
    correct_on_curve,
)
from gaitsweep.tasks.branches.meetings import Followed, followed, met
from gaitsweep.tasks.branches.special_points import RATES
from gaitsweep.tasks.contract.status import ranges
from gaitsweep.tasks.contract.tables import Arrays, lacking, table
from gaitsweep.tasks.measures.levels import LEVEL
from gaitsweep.tasks.measures.passed import Curve, Sampled
from gaitsweep.tasks.step.sameness import SAME_POINT, same
from gaitsweep.tasks.studies.curve_rows import (
    FORM,
    rows,
    start_and_period,
    walkers_of,
)
from gaitsweep.tasks.studies.gaits_over_key import (
    SURVEYED,
    gaits_over_key,
    is_on,
    survey_together,
)
from gaitsweep.tasks.walkers.resolve import walkers_over
from gaitsweep.tasks.walkers.walker import Walker

_KEYS = ("key", "value", "other_key", "other_value")
_PLACE = ("slope", *_KEYS, "stance_angle", *RATES, "period")
_CURVES = ("curve", "kind", *_PLACE, "error_bound", *FORM, "walks", "stopped")
_ERRORS = ("value_error", "other_value_error")
_MEETINGS = ("curve", "kind", "point", "meets", *_PLACE, *_ERRORS)


@dataclass(frozen=True)
class _Plane:
    """Two keys of a line's walker with their ranges, at a slope.

    Attributes
    ----------
    line : mapping
    names : pair of str
    low, high : pair of float
    slope : float [rad]
    """

    line: Mapping[str, Any]
    names: tuple[str, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    slope: float

    def walker_at(self, *values: float) -> Walker:
        """The walker at values of both keys."""
        return walkers_over(self.line, *self.names)(*values)

    @cached_property
    def keys(self) -> Keys:
        """Both keys as unknowns."""
        one_by_one = [self.along(number, 0.5).keys for number in (0, 1)]
        ordinary = [keys.ordinary[0] for keys in one_by_one if keys]
        return Keys(self.names, self.walker_at, self.low, self.high, tuple(ordinary))

    def value(self, number: int, share: float) -> float:
        """Value of a key at a share of its range."""
        return self.low[number] + share * (self.high[number] - self.low[number])

    def along(self, number: int, share: float) -> Equations:
        """Equations of gaits over one key, the other at a share of its range."""
        fixed = self.value(1 - number, share)

        def walker_at(value: float) -> Walker:
            values = (value, fixed) if number == 0 else (fixed, value)
            return self.walker_at(*values)

        ends = self.low[number], self.high[number]
        keys = Keys.of_one(self.names[number], walker_at, *ends)
        return Equations(keys, [], self.slope)

    @cached_property
    def window(self) -> np.ndarray:
        """Least and largest unknowns of the keys, shape (2, 2)."""
        ends = np.array([self.low, self.high]).T
        return np.asarray(ends / self.keys.scale[:, None])

    def curves(self) -> Iterator[tuple[int, float, Curve]]:
        """Yield the curves of gaits over each key: its number, the unknown of the other
        key, and the curve.
        """
        surveyed = itertools.product(SURVEYED, SURVEYED)
        ends = [(self.value(0, a), self.value(1, b)) for a, b in surveyed]
        if self.slope > 0:
            survey_together([self.walker_at(*each) for each in ends])
        for number in (0, 1):
            scale = self.keys.scale[1 - number]
            for share in SURVEYED:
                gaits = self.along(number, share)
                fixed = self.value(1 - number, share) / scale
                for points, tangents in gaits_over_key(gaits):
                    yield number, fixed, Curve.of_points(gaits, points, tangents)


def curves_over_keys(
    line: Mapping[str, Any],
    slopes: np.ndarray,
    ranges: Mapping[str, Sequence[float]],
    conditions: Mapping[str, Condition],
    lacks: Sequence[str] = (),
) -> Arrays:
    """Follow curves over two keys at fixed slopes.

    Parameters
    ----------
    line : mapping
    slopes : ndarray, shape (n,) [rad]
    ranges : mapping
        Least and largest value of both keys [the walker's units].
    conditions : mapping
        What curves fulfil, by what the table calls them.
    lacks : sequence of str
        What is asked for and has no condition, in sentences.

    Returns
    -------
    dict
        The tables `curves`, `meetings` and `curve_walkers`, as `tasks.studies.follow_curves:curve` has
        them over a plane.

    Raises
    ------
    WalkerError
        If the walker has no such keys.
    """
    low, high = zip(*ranges.values(), strict=True)
    found: list[tuple[Any, ...]] = []
    met_there: list[tuple[Any, ...]] = []
    absent = [*lacks]
    for slope in slopes.tolist():
        plane = _Plane(line, tuple(ranges), low, high, slope)
        along = list(plane.curves())
        others = met(conditions, plane.keys.structure.kneed)
        for kind, condition in conditions.items():
            equations = Equations(plane.keys, [condition], plane.slope)
            curves = list(_curves(plane, kind, equations, along, others))
            for curve in curves:
                number = len({row[0] for row in found})
                found += _curve_rows(number, plane, curve)
                met_there += _meeting_rows(number, plane, curve)
            if not curves:
                absent.append(_why_none(plane, kind, condition, along))

    tables = table("curves", found, _CURVES)
    tables |= table("meetings", met_there, _MEETINGS)
    # Both keys, and with them the walkers, are the same at every slope.
    tables |= walkers_of(plane.keys, tables)
    return tables | lacking(absent, bool(found))


def _why_none(
    plane: _Plane,
    kind: str,
    condition: Condition,
    along: Sequence[tuple[int, float, Curve]],
) -> str:
    """Say that there is no curve of a condition in a plane, and which values of the
    measure there are.
    """
    keys = " or ".join(f"`{name}`" for name in plane.names)
    sentence = (
        f"No point of `{kind}` to start a curve from was found at slope "
        f"{plane.slope:.6g} along gaits over {keys}, at five values of the other"
    )
    if condition.name != LEVEL:
        return f"{sentence}."

    samples = [Sampled.of(curve, condition) for _, _, curve in along]
    reached = [sampled.reached(-np.inf, np.inf) for sampled in samples]
    values = ranges([each for each in reached if each]) or "none"
    return f"{sentence}: values of the measure are {values}."


def _curves(
    plane: _Plane,
    kind: str,
    equations: Equations,
    along: Sequence[tuple[int, float, Curve]],
    others: Mapping[str, Condition],
) -> Iterator[Followed]:
    """Curves of a condition, each once."""
    (condition,) = equations.conditions
    seen: list[np.ndarray] = []
    for guess, fixed in _starts(condition, along):
        border = np.eye(len(guess))[:, [fixed]]
        first = correct_on_curve(equations, guess[:, None], border)
        if not first.ok[0] or not same(first.Z[:, 0], guess, SAME_POINT):
            continue
        if is_on(equations, seen, first.Z[:, 0]):
            continue
        if not _is_genuine(condition, first.at.gait.jacobians[0]):
            continue

        curve = followed(equations, kind, first, plane.window, others)
        seen.append(curve.points)
        yield curve


def _is_genuine(condition: Condition, jacobian: np.ndarray) -> bool:
    """Whether a point is of its kind."""
    if not np.isfinite(jacobian).all():
        return not condition.is_genuine
    return condition.is_genuine is None or condition.is_genuine(
        np.linalg.eigvals(jacobian)
    )


def _starts(
    condition: Condition, along: Sequence[tuple[int, float, Curve]]
) -> Iterator[tuple[np.ndarray, int]]:
    """Points (u,) at which gaits over a key pass a condition, and the number of the other
    key among the unknowns.
    """
    for number, fixed, curve in along:
        for X in Sampled.of(curve, condition).passes_target().X.T:
            keys = [X[-1], fixed] if number == 0 else [fixed, X[-1]]
            yield np.append(X[:-1], keys), -1 - number


def _place(plane: _Plane, equations: Equations, X: np.ndarray) -> tuple[Any, ...]:
    """Slope, both keys with their values, state at the start of the step and period of
    a point, in the walker's units.
    """
    value, other = plane.keys.values(X[-2:, None])[:, 0].tolist()
    time_unit = plane.walker_at(value, other).time_unit
    problem = equations.problem_at(X[:, None]).alone(0)
    Z, _ = equations.split(X[:, None])
    gait = start_and_period(problem, Z[:, 0], time_unit)
    return (plane.slope, plane.names[0], value, plane.names[1], other, *gait)


def _curve_rows(
    number: int, plane: _Plane, curve: Followed
) -> Iterator[tuple[Any, ...]]:
    """Rows of the points of a curve."""
    return rows(number, curve, partial(_place, plane, curve.equations))


def _meeting_rows(
    number: int, plane: _Plane, curve: Followed
) -> Iterator[tuple[Any, ...]]:
    """Rows of the codimension-two points of a curve."""
    for each in curve.meetings:
        errors = (each.error * plane.keys.scale).tolist()
        place = _place(plane, curve.equations, each.X)
        yield (number, curve.kind, each.name, each.meets, *place, *errors)
