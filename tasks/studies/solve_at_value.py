"""Every gait of a walker at which a measure has a value, for `gaitsweep solve --at`: by
varying the slope, or a key at a fixed slope.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from gaitsweep.tasks.branches import atlas as atlases
from gaitsweep.tasks.branches.branch import Branch
from gaitsweep.tasks.branches.conditions import Condition
from gaitsweep.tasks.branches.curves import (
    across_last,
    at_value,
    follow_both_directions,
)
from gaitsweep.tasks.branches.equations import (
    Equations,
    Keys,
    correct_on_curve,
    solve,
)
from gaitsweep.tasks.branches.refine import COARSE
from gaitsweep.tasks.branches.root import hermite
from gaitsweep.tasks.branches.special_points import passings
from gaitsweep.tasks.contract.registry import SLOPES
from gaitsweep.tasks.gaits.polish import settle, unmeasured
from gaitsweep.tasks.gaits.step_check import LONG_BELOW, gait_ratio
from gaitsweep.tasks.measures.gaits import describe
from gaitsweep.tasks.measures.levels import level, measure_at, measures
from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.step.sameness import SAME_POINT, same
from gaitsweep.tasks.studies.solve_at_slope import WANT, answer, record
from gaitsweep.tasks.walkers.resolve import walker_of_line, walkers_over
from gaitsweep.tasks.walkers.walker import Walker, WalkerError

#: What is varied if it is no key.
SLOPE = "slope"
#: Window of slopes that is searched by default [rad].
_WINDOW = (1e-6, SLOPES[1])
#: Shares of a key's range at which gaits are searched for, from which curves over it
#: begin.
_SURVEYED = (0.03, 0.25, 0.5, 0.75, 0.97)


@dataclass(frozen=True)
class _Target:
    """The value wanted of a measure, what is varied, and its range."""

    measure: str
    value: float
    vary: str
    low: float
    high: float

    @property
    def condition(self) -> Condition:
        """What its gaits fulfil."""
        return level(self.measure, self.value)

    def missed(self, reached: Sequence[tuple[float, float]]) -> str:
        """Say that no gait has the value, by the values that branches reach."""
        where = f"for `{self.vary}` from {self.low:.6g} to {self.high:.6g}"
        if not reached:
            return f"No gait was found {where}."
        ranges = "; ".join(f"{low:.6g} to {high:.6g}" for low, high in sorted(reached))
        return f"No gait has {self.measure} = {self.value:.6g} {where}: there are {ranges}."


def solve_at_value(params: Mapping[str, Any]) -> dict[str, Any]:
    """Solve every gait of a walker at which a measure has a value.

    Parameters
    ----------
    params : mapping
        `walker` (name or table) and `set` (keys to change); `measure`, the name of a
        variable, and `value`, in the walker's units; `vary`, "slope" or a key of the
        walker, and `between`, its least and largest value, which a slope may lack;
        `slope` [rad] where a key is varied; `violation_limits`, those that are not the registry's.

    Returns
    -------
    dict
        As `solve_one` has it. Gaits are sorted by what is varied; if that is a key,
        each has its value.

    Raises
    ------
    WalkerError
        If the walker, the measure, the key or the range is invalid.
    """
    line = {"walker": params["walker"], "set": params.get("set") or {}}
    walker = walker_of_line(line)
    target = _target(params, line["set"], walker)
    limits = params.get("violation_limits")
    records = []
    if target.vary == SLOPE:
        problem = Problem(walker)
        found, log, reached = _along_slope(problem, target)
        for w, q in found:
            gait = _described(problem, w, float(np.exp(q)), limits)
            records += [gait] if gait else []
    else:
        slope = float(params["slope"])
        keys = _keys(line, target)
        found, log, reached = _along_key(keys, slope, target)
        for w, value in found:
            problem = Problem(keys.walker_at(value))
            gait = _described(problem, w, slope, limits)
            records += [{target.vary: value, **gait}] if gait else []

    absent = [] if records else [target.missed(reached)]
    result = answer(records, walker, log, absent)
    if target.vary != SLOPE:
        result["columns"] = [target.vary, *result["columns"]]
    return result


def _target(
    params: Mapping[str, Any], changes: Mapping[str, Any], walker: Walker
) -> _Target:
    """What is asked for, checked."""
    measure, value = str(params["measure"]), float(params["value"])
    names = measures(walker)
    if measure not in names:
        known = ", ".join(names)
        raise WalkerError("at", measure, f"must be a measure of its gaits: {known}")
    if not np.isfinite(value):
        raise WalkerError("at", value, "must be finite")

    vary = str(params.get("vary", SLOPE))
    if vary in changes:
        raise WalkerError(vary, changes[vary], "is varied and cannot be set too")
    between = params.get("between")
    if between is None and vary != SLOPE:
        raise WalkerError("between", between, "must hold the range of a key")
    low, high = between or _WINDOW
    if not low < high:
        raise WalkerError("between", (low, high), "must rise")
    return _Target(measure, value, vary, float(low), float(high))


def _along_slope(
    problem: Problem, target: _Target
) -> tuple[list[tuple[np.ndarray, float]], list[str], list[tuple[float, float]]]:
    """Gaits w (m + k,) and ln slopes that fulfil a target on a walker's branches; how
    they were searched for; and the values that branches reach.
    """
    branches = atlases.survey(problem, COARSE)
    low, high = np.log([target.low, target.high])
    found, reached = [], []
    for branch in branches:
        for _, point in passings(problem, branch, target.condition):
            Z = point.Z[:, 0]
            if low <= Z[-1] <= high:
                found.append((Z[:-1], float(Z[-1])))
        reached += _reached(problem, branch, target, (low, high))
    found.sort(key=lambda gait: gait[1])
    log = [atlases.searched(problem.walker)]
    log.append(f"{len(branches)} branches searched for {target.measure}")
    return found, log, reached


def _reached(
    problem: Problem, branch: Branch, target: _Target, window: tuple[float, float]
) -> list[tuple[float, float]]:
    """Least and largest value of the measure at a branch's nodes in a window."""
    inside = (branch.q >= window[0]) & (branch.q <= window[1])
    if not inside.any():
        return []
    at = Equations(problem).evaluate(branch.Z[:, inside])
    values = measure_at(target.measure, at)
    values = values[np.isfinite(values)]
    return [(float(values.min()), float(values.max()))] if len(values) else []


def _keys(line: Mapping[str, Any], target: _Target) -> Keys:
    """The key that is varied, as an unknown."""
    walker_at = walkers_over(line, target.vary)
    return Keys.of_one(target.vary, walker_at, target.low, target.high)


def _along_key(
    keys: Keys, slope: float, target: _Target
) -> tuple[list[tuple[np.ndarray, float]], list[str], list[tuple[float, float]]]:
    """Gaits w (m + k,) and values of the key that fulfil a target at a slope; how they
    were searched for; and the values of the measure that there are.
    """
    gaits = Equations(keys, [], slope)
    found: list[tuple[np.ndarray, float]] = []
    reached: list[tuple[float, float]] = []
    curves = 0
    for points, tangents in _gaits_over_key(gaits):
        curves += 1
        values = measure_at(target.measure, gaits.evaluate(points.T))
        finite = values[np.isfinite(values)]
        if len(finite):
            reached.append((float(finite.min()), float(finite.max())))
        for X in _passings(keys, slope, target, points, tangents, values):
            ((value,),) = keys.values(X[-1:, None]).tolist()
            found.append((X[:-1], value))
    found.sort(key=lambda gait: gait[1])
    log = [f"{curves} curves of gaits over `{target.vary}` searched"]
    return found, log, reached


def _passings(
    keys: Keys,
    slope: float,
    target: _Target,
    points: np.ndarray,
    tangents: np.ndarray,
    values: np.ndarray,
) -> Iterator[np.ndarray]:
    """Points (u,) at which a curve of gaits, points and tangents (p, u), fulfils a
    target, by the values of the measure (p,).
    """
    equations = Equations(keys, [target.condition], slope)
    side = np.sign(values - target.value)
    for k in np.flatnonzero(side[1:] * side[:-1] < 0).tolist():
        before = points[k], tangents[k]
        after = points[k + 1], tangents[k + 1]
        share = (target.value - values[k]) / (values[k + 1] - values[k])
        length = float(np.linalg.norm(after[0] - before[0]))
        guess = hermite(before, after, length, share)[:, None]
        solved = solve(equations, guess)
        if solved.ok[0] and np.linalg.norm(solved.Z - guess) < length:
            yield solved.Z[:, 0]


def _gaits_over_key(gaits: Equations) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Curves of gaits at a fixed slope over the range of a key: points (p, u) and
    tangents.

    They begin at the gaits of some walkers in the range, and each is followed once.
    """
    assert gaits.keys is not None and gaits.log_slope is not None
    (scale,), (low,), (high,) = gaits.keys.scale, gaits.keys.low, gaits.keys.high
    window = np.array([[low / scale, high / scale]])
    across = across_last(gaits.size)
    followed: list[np.ndarray] = []
    for share in _SURVEYED:
        value = low + share * (high - low)
        for branch in atlases.survey(Problem(gaits.keys.walker_at(value)), COARSE):
            for _, Z, _ in branch.guesses(np.array([gaits.log_slope])):
                guess = np.append(Z[:-1, 0], value / scale)[:, None]
                first = correct_on_curve(gaits, guess, across)
                if not first.ok[0] or _is_on(gaits, followed, first.Z[:, 0]):
                    continue
                points, tangents, _ = follow_both_directions(gaits, first, window)
                followed.append(points)
                yield points, tangents


def _is_on(gaits: Equations, curves: list[np.ndarray], X: np.ndarray) -> bool:
    """Whether a gait (u,) lies on one of some curves (p, u)."""
    passed = [Y for points in curves for Y in at_value(gaits, points, X[-1])]
    return any(same(X, Y, SAME_POINT) for Y in passed)


def _described(
    problem: Problem, w: np.ndarray, slope: float, limits: Mapping[str, float] | None
) -> dict[str, Any] | None:
    """One gait near w (m + k,), settled, as `solve_one` describes it; None where it is
    no step whose legs pass once.
    """
    slopes = np.array([slope])
    settled = settle(problem, unmeasured(problem, w[:, None], slopes))
    if not (settled.converged & settled.step)[0] or settled.leg_passes[0] != 1:
        return None
    measured = describe(problem, settled, slopes, WANT, limits)
    values = {name: measured[name][0] for name in WANT if name in measured}
    values |= {"branch": np.int16(-1), "piece": np.int16(-1)}
    label = "long" if gait_ratio(settled.stride)[0] < LONG_BELOW else "short"
    return record(label, slope, values, problem.walker)
