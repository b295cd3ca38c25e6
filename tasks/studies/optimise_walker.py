"""The task `optimum`: the walker and slope, within ranges of keys, at which a measure of
gaits is least or largest.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy import ndarray

from gaitsweep.tasks.branches.conditions import CONDITIONS
from gaitsweep.tasks.branches.curves import walks
from gaitsweep.tasks.branches.equations import Equations, Keys, slope_error, solve
from gaitsweep.tasks.contract import registry
from gaitsweep.tasks.contract.kinds import kind_of
from gaitsweep.tasks.contract.status import over, ranges
from gaitsweep.tasks.contract.tables import Arrays, lacking, nothing, table
from gaitsweep.tasks.gaits.polish import settle, unmeasured
from gaitsweep.tasks.measures.levels import measures_at
from gaitsweep.tasks.measures.programme import SPECIAL, Optimum, Programme
from gaitsweep.tasks.mechanics.arrays import Coordinates, Gait
from gaitsweep.tasks.step.problem import Lanes, Problem
from gaitsweep.tasks.step.sameness import ON_BRANCH, same
from gaitsweep.tasks.studies.check_optimum import check
from gaitsweep.tasks.studies.pose_optimum import SLOPE, Box, Question, candidates
from gaitsweep.tasks.walkers.walker import NUMBERS, Walker, WalkerError

#: How much a missed constraint counts beside the objective where starts are chosen.
_MISSED = 10.0
#: Relative difference of two starts' objectives that is the same optimum; largest
#: magnitude of multipliers that is 1, which at a fold is known to half as many digits.
_SAME, _ON_CIRCLE = 1e-7, 1 + 1e-4
#: Part of the gradient that is not balanced where iterations stopped before an optimum.
_STATIONARY = 1e-4
#: Derivatives that are rounding, and distances from an end over the range.
_NO_CHANGE, _ROUNDING = 1e-8, 1e-10


def optimum(params: Mapping[str, Any], inputs: list[Arrays]) -> Arrays:
    """Find the best of a line's walkers over some of their keys.

    Parameters
    ----------
    params : mapping
        `line`; `slope`, ndarray [rad], whose ends are a window in which it is free, or
        one value; `gaits`, labels wanted; and the study's options: `minimise` or
        `maximise`, a measure, "slope" or a free key; `free`, keys with their ranges;
        `stable`, `within`, ranges of measures, `without`, violations, all of which
        gaits must fulfil; `tradeoff`, a measure with values, each of which it is made
        to have; and `starts`, the number of walkers at which iterations begin.
    inputs : list
        None.

    Returns
    -------
    dict
        Tables `optimum` (a row for each value of the trade-off, or one), `optimum_limits` (what
        is active there: limit, and the derivative of the objective by it), `searches`
        (where each start led), `search_paths` (on what way) and `optimal_walkers` (all
        their keys), in the walker's units.

    Raises
    ------
    WalkerError
        If there is no walker in the ranges, or nothing depends on a key.
    """
    check({**params["line"], "options": params})
    free = {key: tuple(ends) for key, ends in params["free"].items()}
    options = registry.options("optimum", params)
    slopes = np.asarray(params["slope"], float)
    question = Question(Box(params["line"], free), slopes, options, params["gaits"])
    begins = candidates(question)
    if not begins:
        why = over("gait of the walkers of the starts", slopes)
        return nothing(f"{question.nothing_found}. {why}")

    tables = _Tables(question)
    missing = []
    for case, values in enumerate(question.cases):
        search = _Search(question, question.programme(values), case)
        search.run(begins)
        tables.add(search)
        if search.best is None:
            missing.append(search.nothing_found(begins))

    return tables.arrays() | lacking(missing, bool(tables.optimum))


@dataclass(frozen=True)
class _Verified:
    """A gait at which iterations ended, solved anew for keys that are doubles.

    Attributes
    ----------
    X : ndarray, shape (u,)
    slope : float [rad]
    walker : Walker
    values : dict of float
        Its measures and the free keys, by name, in the walker's units.
    error_bound, slope_error : float
        Of the gait at its slope, NaN where it is the last one before a fold or an end;
        and of the slope, where a special point sets it.
    """

    X: Gait
    slope: float
    walker: Walker
    values: Mapping[str, float]
    error_bound: float
    slope_error: float


_NO_STEP = "the solution there is no step: another event comes before"


class _Verification:
    """Solves a gait at which iterations ended anew, and verifies it as any gait.

    Attributes
    ----------
    question : Question
    found : Optimum
    keys : dict of float
    walker : Walker
    problem : Problem
    Z : ndarray, shape (c, 1)
        The gait, as far as it is solved.
    x : ndarray, shape (k, 1)
        The unknowns of the keys.
    """

    def __init__(self, question: Question, programme: Programme, found: Optimum):
        keys = programme.equations.keys
        assert keys is not None
        self.question = question
        self.found = found
        self.Z, self.x = programme.equations.split(found.X[:, None])
        values = _without_rounding(keys, keys.values(self.x)[:, 0])

        self.keys = dict(zip(keys.names, values.tolist(), strict=True))
        self.walker = keys.walker_at(*self.keys.values())

        ordinary = programme.equations.problem
        self.problem = Problem(self.walker, drive=ordinary.drive)
        if not _are_alike(self.problem, ordinary):
            # At the end of a range the walker may be special, with fewer coordinates,
            # or nothing between its thighs.
            self.problem = Lanes([self.walker], keys.structure, ordinary.drive)

    def verified(self) -> _Verified | str:
        """The gait, or why there is none."""
        special = _special(self.question, self.found)
        is_last = kind_of(special).turns_slope
        if special:
            is_last |= CONDITIONS[special].walking != 0
        slope_bound = 0.0
        bound = np.nan
        if is_last or (special and self.question.window is not None):
            at_point = Equations(self.problem, [CONDITIONS[special]])
            if not self._locate(at_point):
                return f"Newton's method does not lead to the {special} there"
            if is_last and not walks(at_point, self.Z[:, 0]):
                return _NO_STEP
            condition = CONDITIONS[special]
            slope_bound = slope_error(self.problem, condition, self.Z[:, 0])

        if not is_last:
            bound = self._settle()
            if np.isnan(bound):
                return _NO_STEP

        return self._measured(bound, slope_bound)

    def _locate(self, at_point: Equations) -> bool:
        """Solve for the special point that the gait is; whether there is one."""
        located = solve(at_point, self.Z)
        is_near = same(located.Z, self.Z, ON_BRANCH)
        self.Z = located.Z
        return bool(located.ok[0] and is_near[0])

    def _settle(self) -> float:
        """Solve the gait at its slope; its error bound, NaN where it is no step."""
        guess = unmeasured(self.problem, self.Z[:-1], np.exp(self.Z[-1]))
        settled = settle(self.problem, guess)
        is_gait = settled.converged & settled.step & (settled.leg_passes == 1)
        is_near = same(settled.w, self.Z[:-1], ON_BRANCH)
        self.Z = np.vstack([settled.w, self.Z[-1:]])
        return float(settled.bound[0]) if is_gait[0] and is_near[0] else np.nan

    def _measured(self, bound: float, slope_bound: float) -> _Verified | str:
        """The gait with its measures; or why it is not wanted."""
        at = Equations(self.problem).evaluate(self.Z)
        values = {
            name: float(of_gait[0])
            for name, of_gait in measures_at(self.question.told, at).items()
        }
        is_stable = values["spectral_radius"] < _ON_CIRCLE
        if self.question.options["stable"] and not is_stable:
            return "the gait there is not stable"

        w = self.Z if self.question.window is not None else self.Z[:-1]
        X = np.concatenate([w[:, 0], self.x[:, 0]])
        slope = float(self.problem.slopes(np.exp(self.Z[-1]))[0])
        values |= self.keys
        return _Verified(X, slope, self.walker, values, bound, slope_bound)


def _are_alike(problem: Problem, other: Problem) -> bool:
    """Whether gaits have as many coordinates, and the same measures."""
    return problem.m == other.m and problem.features == other.features


def _without_rounding(keys: Keys, values: ndarray) -> ndarray:
    """Values of keys (k,), those that are an end of their range but for rounding moved
    there.
    """
    for ends in (np.array(keys.low), np.array(keys.high)):
        is_there = np.abs(values - ends) < _ROUNDING * keys.scale
        values = np.where(is_there, ends, values)
    return values


def _special(question: Question, found: Optimum) -> str:
    """The special point that an optimum is; empty where it is none."""
    active = [limit.name for limit in found.limits]
    for name in active:
        if name in SPECIAL:
            return name
    # Where no other limit ends the slopes, gaits turn back.
    is_of_slope = question.name == SLOPE and SLOPE not in active
    return "fold" if is_of_slope else ""


class _Search:
    """Iterations of one case of a question from several starts.

    Attributes
    ----------
    question : Question
    programme : Programme
    case : int
    ends : list of Optimum
        Of each start.
    verified : list of _Verified or str
        The gait of each, or why there is none.
    best : int or None
        The start that led to the best gait.
    """

    def __init__(self, question: Question, programme: Programme, case: int):
        self.question = question
        self.programme = programme
        self.case = case
        self.ends: list[Optimum] = []
        self.verified: list[_Verified | str] = []
        self.best: int | None = None

    def run(self, candidates: Sequence[Coordinates]) -> None:
        """Begin at the most promising of each start's gaits X (u, n)."""
        guesses = self._promising(candidates)
        _check_keys(self.programme, guesses)
        for guess in guesses:
            end = self.programme.improve(guess)
            self.ends.append(end)
            self.verified.append(self._verify(end))

        gaits = [
            start
            for start, gait in enumerate(self.verified)
            if isinstance(gait, _Verified)
        ]
        finished = [start for start in gaits if self._is_finished(start)]
        if gaits:
            best_first = sorted(
                finished or gaits,
                key=lambda k: self.ends[k].value,
            )
            self.best = best_first[0]

    def _promising(self, candidates: Sequence[Coordinates]) -> list[Gait]:
        """One of each start's gaits, which miss constraints by little and are good."""
        judged = [self.programme.judge(gaits) for gaits in candidates]
        sizes = np.abs(np.concatenate([value for value, _ in judged]))
        size = float(np.median(sizes[np.isfinite(sizes)])) or 1.0
        objective = self.programme.objective
        if objective.scalar is not None:
            self.programme.objective = replace(objective, scale=size)

        guesses = []
        for gaits, (value, missed) in zip(candidates, judged, strict=True):
            merit = value / size + _MISSED * missed
            guesses.append(gaits[:, int(np.nan_to_num(merit, nan=np.inf).argmin())])

        return guesses

    def _verify(self, end: Optimum) -> _Verified | str:
        if end.is_met:
            return _Verification(self.question, self.programme, end).verified()
        missed = self.programme.worst(end.X)
        return f"`{missed.name}` is not met" if missed else "no gait is reached"

    def _is_finished(self, start: int) -> bool:
        return self.ends[start].stationarity < _STATIONARY

    def _is_best(self, start: int) -> bool:
        """Whether a start led to the best gait."""
        if self.best is None or isinstance(self.verified[start], str):
            return False
        # Objectives are of order one, also where the best of all is 0.
        best = self.ends[self.best].value
        size = max(1.0, abs(best))
        return abs(self.ends[start].value - best) <= _SAME * size

    def outcome(self, start: int) -> str:
        """Where a start led, in words."""
        gait = self.verified[start]
        if isinstance(gait, str):
            return gait
        if not self._is_finished(start):
            best = "the best found, " if self._is_best(start) else ""
            return f"{best}stopped before an optimum"
        return "the optimum" if self._is_best(start) else "another optimum"

    @property
    def hits(self) -> int:
        """How many starts led to the best gait."""
        return sum(map(self._is_best, range(len(self.ends))))

    def nothing_found(self, candidates: Sequence[Coordinates]) -> str:
        """Return why there is no optimum, by the start that came nearest, and what the
        gaits have at which iterations could begin.
        """
        case = "".join(
            f" with `{name}` = {value:g}"
            for name, value in self.question.cases[self.case].items()
        )
        nearest = min(range(len(self.ends)), key=lambda k: self.ends[k].missed)
        sentence = (
            f"{self.question.nothing_found}{case}: where iterations from "
            f"{len(self.ends)} starts came nearest, {self.outcome(nearest)}."
        )

        missed = None
        if not self.ends[nearest].is_met:
            missed = self.programme.worst(self.ends[nearest].X)
        asked = self.question.asked_by(missed) if missed else None
        if asked is None:
            return sentence

        reached = self.programme.reached(asked, candidates)
        known = f"{ranges(reached) or 'nowhere known'} at the walkers of the starts"
        unit = self.question.unit_of(asked.name)
        return f"{sentence} `{asked.name}` must be {asked.bound}{unit}: it is {known}."


def _check_keys(programme: Programme, guesses: Sequence[Gait]) -> None:
    """Check that something depends on each key.

    Raises
    ------
    WalkerError
        If nothing does at any start.
    """
    keys = programme.equations.keys
    assert keys is not None
    count = len(keys.names)
    changes = np.zeros(count)
    for guess in guesses:
        at = programme.linear(guess)
        columns = np.vstack([at.gradient, at.derivative])[:, -count:]
        changes = np.maximum(changes, np.abs(columns).max(axis=0))

    each_key = zip(keys.names, keys.low, keys.high, changes, strict=True)
    for key, low, high, change in each_key:
        if change < _NO_CHANGE:
            why = "is free and changes neither gaits nor what is asked of them"
            raise WalkerError(key, [low, high], why)


class _Tables:
    """Rows of the tables of a question."""

    def __init__(self, question: Question):
        self.question = question
        self.optimum: list[dict[str, Any]] = []
        self.limits: list[dict[str, Any]] = []
        self.searches: list[dict[str, Any]] = []
        self.paths: list[dict[str, Any]] = []
        self.walkers: list[dict[str, Any]] = []

    def add(self, search: _Search) -> None:
        """Add the rows of one case."""
        for start, end in enumerate(search.ends):
            own = {"case": search.case, "start": start}
            places = self._places(search.programme, end.path)
            outcome = search.outcome(start)
            self.searches.append({**own, "outcome": outcome, **places[-1]})
            for number, place in enumerate(places):
                self.paths.append({**own, "iteration": number, **place})

        if search.best is not None:
            self._add_best(search, search.best)

    def _add_best(self, search: _Search, start: int) -> None:
        end, gait = search.ends[start], search.verified[start]
        assert isinstance(gait, _Verified)
        own = {"case": search.case}
        (place,) = self._places(search.programme, gait.X[None])
        told = {
            "hits": search.hits,
            "begun": len(search.ends),
            "stationarity": end.stationarity,
            "slope_error": gait.slope_error,
            "error_bound": gait.error_bound,
        }
        measured = {**place, **gait.values, "slope": gait.slope}
        self.optimum.append({**own, **measured, **told})

        walker = {key: float(getattr(gait.walker, key)) for key in NUMBERS}
        self.walkers.append({**own, **walker})
        for name, limit, multiplier in end.limits:
            row = {"limited_by": name, "limit": limit, "multiplier": multiplier}
            self.limits.append({**own, **row})

    def _places(self, programme: Programme, points: ndarray) -> list[dict[str, float]]:
        """Slope, keys and objective of points (p, u)."""
        keys = programme.equations.keys
        assert keys is not None
        Z, x = programme.equations.split(points.T)
        slopes = programme.equations.problem.slopes(np.exp(Z[-1]))
        columns = {SLOPE: slopes} | dict(zip(keys.names, keys.values(x), strict=True))
        if self.question.name not in columns:
            values, _ = programme.judge(points.T)
            of_minimised = programme.objective.sign * programme.objective.scale
            columns[self.question.name] = of_minimised * values

        rows = zip(*(values.tolist() for values in columns.values()), strict=True)
        return [dict(zip(columns, row, strict=True)) for row in rows]

    def arrays(self) -> Arrays:
        """All tables."""
        found = table("optimum", self.optimum) | table("optimum_limits", self.limits)
        found |= table("searches", self.searches) | table("search_paths", self.paths)
        return found | table("optimal_walkers", self.walkers)
