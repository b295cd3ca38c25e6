"""Every gait of walkers at which a measure has wanted values: by varying the slope, or a
key at a fixed slope.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from gaitsweep.tasks.branches import atlas as atlases
from gaitsweep.tasks.branches.branch import Branch
from gaitsweep.tasks.branches.conditions import Condition
from gaitsweep.tasks.branches.equations import Equations, Keys
from gaitsweep.tasks.branches.refine import COARSE
from gaitsweep.tasks.branches.settling import repeats_no_sooner, settle_on_branches
from gaitsweep.tasks.contract import status
from gaitsweep.tasks.contract.registry import GAITS, SLOPES, VARIABLES, VARIED
from gaitsweep.tasks.gaits.polish import Guesses, Polished, settle, unmeasured
from gaitsweep.tasks.gaits.step_check import LONG_BELOW
from gaitsweep.tasks.measures.gaits import (
    Arrays,
    Part,
    Wanted,
    nothing_solved,
    store,
    to_accuracy,
)
from gaitsweep.tasks.measures.levels import level
from gaitsweep.tasks.measures.names import check_measure
from gaitsweep.tasks.measures.passed import Curve, Passed, Sampled
from gaitsweep.tasks.measures.sensitivities import KeyOfWalker
from gaitsweep.tasks.step.drive import SLOPE
from gaitsweep.tasks.step.lanes import lanes_of, slices
from gaitsweep.tasks.step.problem import Lanes, Problem
from gaitsweep.tasks.studies.gaits_over_key import SURVEYED, gaits_over_key
from gaitsweep.tasks.studies.solve_at_slope import (
    WANT,
    answer,
    end_of_first_step,
    record,
)
from gaitsweep.tasks.studies.solve_driven import LOWEST, branches_over_any_slope
from gaitsweep.tasks.studies.solve_guesses import Solved, solve_guesses
from gaitsweep.tasks.studies.solve_points import atlas, survey
from gaitsweep.tasks.walkers.properties import check
from gaitsweep.tasks.walkers.resolve import (
    value_of_key,
    walker_of_line,
    walkers_over,
)
from gaitsweep.tasks.walkers.walker import ORDINARY, Walker, WalkerError

#: Window of slopes that is searched by default [rad].
_WINDOW = (1e-6, SLOPES[1])
#: Relative change of a measure over a key that is rounding.
_UNCHANGED = 1e-10


@dataclass(frozen=True, eq=False)
class _Target:
    """The values wanted of a measure (v,), what is varied, its range, and the number of
    steps after which gaits repeat.
    """

    measure: str
    values: np.ndarray
    vary: str
    low: float
    high: float
    steps: int = 1

    @property
    def condition(self) -> Condition:
        """That gaits have a value of the measure."""
        return level(self.measure, 0.0)

    @property
    def where(self) -> str:
        """Over what gaits are searched, in words."""
        return f"for `{self.vary}` from {self.low:.6g} to {self.high:.6g}"

    @property
    def is_any_slope(self) -> bool:
        """Whether slopes are varied of which some are level, or lead uphill."""
        return self.vary == SLOPE and self.low <= 0

    @property
    def edges(self) -> tuple[float, float]:
        """Range of the last unknown of curves; that of a key has its own ends."""
        if self.vary != SLOPE:
            return -np.inf, np.inf
        base = LOWEST if self.is_any_slope else 0.0
        return float(np.log(self.low - base)), float(np.log(self.high - base))


@dataclass(frozen=True, eq=False)
class _Found:
    """Gaits of one line.

    Attributes
    ----------
    solved : Solved or None
        In groups, those of a curve each; None without any.
    groups : list of Passed
        Of each curve.
    numbers : list of pair
        Those of their branches and of their pieces, or of curves.
    varied, slope : ndarray, shape (n,)
        What was varied of all gaits, and their slopes.
    samples : list of Sampled
        The measure along every curve.
    log : list of str
        How gaits were searched for, in sentences.
    """

    solved: Solved | None
    groups: list[Passed]
    numbers: list[tuple[Any, Any]]
    varied: np.ndarray
    slope: np.ndarray
    samples: list[Sampled]
    log: list[str]

    @property
    def value(self) -> np.ndarray:
        """Numbers of the values that the gaits have, shape (n,)."""
        return np.concatenate([np.empty(0, int), *(one.value for one in self.groups)])

    def sizes(self, target: _Target) -> np.ndarray:
        """Sizes of the values that the gaits have, shape (n,): of 0, those of the
        measure along their curves.
        """
        wanted = np.abs(target.values[self.value])
        counts = [len(passed.value) for passed in self.groups]
        along = [sampled.size for sampled in self.samples]
        return np.where(wanted == 0, np.repeat(along, counts), wanted)

    def reached(
        self, low: float, high: float, label: str = ""
    ) -> list[tuple[float, float]]:
        """Ranges of the measure on the curves, where the last unknown is within a
        range.
        """
        ranges = [sampled.reached(low, high, label) for sampled in self.samples]
        return sorted(each for each in ranges if each)


def lines(
    params: Mapping[str, Any], inputs: list[Arrays]
) -> list[tuple[Arrays, Arrays]]:
    """Solve the gaits of several lines at which a measure has wanted values.

    Parameters
    ----------
    params : mapping
        `lines`, the line of each, with its `slope` if a key is varied; `at`, with
        `measure`, `vary` ("slope" or a key) and perhaps `between`, its least and
        largest value; `steps` after which gaits repeat (1 if omitted); `slope`,
        ndarray, shape (v,), the values [the walker's units]; the others as
        `tasks.studies.solve_points:points` has them.
    inputs : list
        Empty.

    Returns
    -------
    list of (dict, dict)
        For each line no atlas, and what `points` returns, with a row for each value;
        `varied` is what gives the gait this value.
    """
    values = np.asarray(params["slope"], float)
    wanted = Wanted.of(params)
    asked = {**params["at"], "values": values, "steps": params.get("steps", 1)}
    return [({}, _solve_line(line, asked, wanted)) for line in params["lines"]]


def points(params: Mapping[str, Any], inputs: list[Arrays]) -> Arrays:
    """Solve the gaits of one `line`, as `lines` does those of several."""
    ((_, solved),) = lines({**params, "lines": [params["line"]]}, inputs)
    return solved


def check_target(params: Mapping[str, Any]) -> dict[str, Any]:
    """Check that gaits of a walker can be sought at values of a measure.

    Parameters
    ----------
    params : mapping
        `walker` and `set`; `measure`, `values`, `vary` and perhaps `between`.

    Returns
    -------
    dict
        What `tasks.walkers.properties:check` returns, with `sought`, the keys of the
        walker that are varied or move with what is.

    Raises
    ------
    WalkerError
        If the walker, the measure, a value, the key or the range is invalid.
    """
    line = {"walker": params["walker"], "set": params.get("set") or {}}
    target = _target(line, params, walker_of_line(line))
    checked = check(line)
    if target.vary == SLOPE:
        return {**checked, "sought": ()}

    value = target.low + ORDINARY * (target.high - target.low)
    middle = check({**line, "set": {**line["set"], target.vary: value}})
    moved = [key for key, movers in middle["varied"].items() if target.vary in movers]
    high = check({**line, "set": {**line["set"], target.vary: target.high}})
    features = dict.fromkeys((*checked["features"], *middle["features"]))

    return {
        **checked,
        "sought": (target.vary, *moved),
        "features": tuple(features),
        "driven": any(each["driven"] for each in (checked, middle, high)),
        "keys": max(checked["keys"], middle["keys"]),
    }


def solve_at_value(params: Mapping[str, Any]) -> dict[str, Any]:
    """Solve every gait of a walker at which a measure has a value.

    Parameters
    ----------
    params : mapping
        `walker` (name or table) and `set` (keys to change); `measure`, the name of a
        variable, and `value`, in the walker's units; `vary`, "slope" or a key of the
        walker, and perhaps `between`, its least and largest value; `slope` [rad] where
        a key is varied; `steps` after which gaits repeat (1 if omitted);
        `violation_limits`, those that are not the registry's.

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
    target = _target(line, {**params, "values": [params["value"]]}, walker)
    wanted = Wanted(WANT, set(GAITS), params.get("violation_limits"))
    found = _search(line | {"slope": params.get("slope")}, target, wanted)

    records = list(_records(line, found, target))
    absent = [] if records else [_missed(found, target)]
    result = answer(records, walker, found.log, absent)
    if target.vary != SLOPE:
        result["columns"] = [target.vary, *result["columns"]]
    return result


def _target(
    line: Mapping[str, Any], asked: Mapping[str, Any], walker: Walker
) -> _Target:
    """What is asked for of a line's gaits, checked."""
    measure, values = str(asked["measure"]), np.asarray(asked["values"], float)
    check_measure(measure, walker, "at")
    infinite = values[~np.isfinite(values)]
    if len(infinite):
        raise WalkerError("at", float(infinite[0]), "must be finite")

    vary = str(asked.get("vary") or SLOPE)
    changes = line.get("set") or {}
    if vary in changes:
        raise WalkerError(vary, changes[vary], "is varied and cannot be set too")

    between = asked.get("between") or _range(line, vary)
    low, high = map(float, between)
    if not low < high:
        raise WalkerError("between", (low, high), "must rise")
    if vary != SLOPE:
        for end in (low, high):
            _check_end(line, vary, end)
    elif low <= 0 and "drive" not in walker.features:
        bound = "must be slopes above 0, as nothing but gravity drives the walker"
        raise WalkerError("between", (low, high), bound)

    return _Target(
        measure=measure,
        values=values,
        vary=vary,
        low=low,
        high=high,
        steps=int(asked.get("steps", 1)),
    )


def _check_end(line: Mapping[str, Any], vary: str, end: float) -> None:
    """Check that there is a walker at an end of the range of a key.

    Raises
    ------
    WalkerError
        Of the key, or of the range where another key is at fault with it.
    """
    try:
        walkers_over(line, vary)(end)
    except WalkerError as error:
        if error.key == vary or error.bound.startswith("is set by"):
            raise
        bound = f"leaves no walker at `{vary}` = {end:.6g}: `{error.key}` {error.bound}"
        raise WalkerError("between", error.value, bound) from error


def _range(line: Mapping[str, Any], vary: str) -> tuple[float, float]:
    """The range of what is varied where none is given."""
    if vary == SLOPE:
        return _WINDOW
    value = value_of_key(line, vary)
    return KeyOfWalker(vary, value, walkers_over(line, vary)).range


def _solve_line(
    line: Mapping[str, Any], asked: Mapping[str, Any], wanted: Wanted
) -> Arrays:
    """Gaits of a line at all values, as `points` returns them."""
    walker = walker_of_line(line)
    target = _target(line, asked, walker)
    found = _search(line, target, wanted)

    out = nothing_solved(wanted.names, len(target.values), walker.knees)
    store(out, list(_parts(found)), wanted.labels)
    to_accuracy(out, wanted.accuracy)

    edges = target.edges
    searched = "; ".join(found.log)
    sought = f"this {target.measure}"
    long, short = (
        status.unreached(
            label, sought, target.where, found.reached(*edges, label), searched
        )
        for label in GAITS[:2]
    )
    reasons = status.reasons(long, short, target.measure)
    return out | {"reasons": np.array(reasons)}


def _search(line: Mapping[str, Any], target: _Target, wanted: Wanted) -> _Found:
    """Gaits of a line that have the values of a target."""
    names = [name for name in VARIABLES if name in {*wanted.names, target.measure}]
    wanted = replace(wanted, names=names)
    along = _along_slope if target.vary == SLOPE else _along_key
    found = along(line, target, wanted)
    if found.solved:
        gaits = found.solved.gaits
        gaits[VARIED] = found.varied
        off = np.abs(gaits[target.measure] - target.values[found.value])
        # What a gait's measure lacks of its value counts as an error of the gait.
        gaits["error_bound"] = gaits["error_bound"] + off / found.sizes(target)

    return found


def _along_slope(line: Mapping[str, Any], target: _Target, wanted: Wanted) -> _Found:
    """Gaits of a line's branches, at any slope in a window."""
    walker = walker_of_line(line)
    problem, branches, log = _branches(line, walker, target)
    curves = [Curve.of_branch(problem, branch) for branch in branches]
    samples = [Sampled.of(curve, target.condition) for curve in curves]
    groups = _passed(samples, target, np.array(target.edges))

    guessed = list(map(_OnBranch.of, branches, groups))
    counted = np.concatenate([np.empty(0), *(one.counted for one in guessed)])
    slope = problem.slopes(counted)
    solved = None
    if len(slope):
        places = [(problem, one.branch, one.segment) for one in guessed]
        settle_there = partial(
            settle_on_branches, places=places, accuracy=wanted.accuracy
        )
        guesses = [one.guesses for one in guessed]
        solved = solve_guesses(problem, guesses, settle_there, wanted)

    pieces = [one.branch.piece(one.segment) for one in guessed]

    return _Found(
        solved=solved,
        groups=groups,
        numbers=[*enumerate(pieces)],
        varied=slope,
        slope=slope,
        samples=samples,
        log=[log],
    )


def _branches(
    line: Mapping[str, Any], walker: Walker, target: _Target
) -> tuple[Problem, list[Branch], str]:
    """A walker's branches over the slopes of a target, their problem, and how they were
    searched for: where some are level, or lead uphill, of what drives there, too.
    """
    if target.steps > 1:
        arrays = atlas({"line": line, "steps": target.steps}, [])
        branches = atlases.from_arrays(arrays)
        log = f"{len(branches)} branches of gaits of {target.steps} steps searched"
        return Problem(walker, target.steps), branches, log

    problem = Problem(walker)
    (branches,) = survey([walker], problem.structure, COARSE)
    if not target.is_any_slope:
        return problem, branches, f"searched from {atlases.searched(walker)}"

    span = target.high - target.low
    values = [target.low + share * span for share in SURVEYED]
    levels = [value for value in values if value <= 0]
    problem, branches = branches_over_any_slope(walker, branches, levels)
    return problem, branches, f"{len(branches)} branches of gaits over slopes searched"


def _passed(
    samples: Sequence[Sampled], target: _Target, edges: np.ndarray
) -> list[Passed]:
    """Gaits at which curves have the values of a target, between edges (2,) of the last
    unknown.
    """
    low, high = edges.tolist()
    return [sampled.passes(target.values).within(low, high) for sampled in samples]


@dataclass(frozen=True, eq=False)
class _OnBranch:
    """Guesses of gaits on a branch, with their segments and slopes (n,), as it counts
    them.
    """

    branch: Branch
    segment: np.ndarray
    counted: np.ndarray
    guesses: Guesses

    @classmethod
    def of(cls, branch: Branch, passed: Passed) -> _OnBranch:
        """Those of the gaits at which it passes values."""
        segment = np.minimum(passed.place.astype(int), len(branch.q) - 2)
        counted = np.exp(passed.X[-1])
        guesses = branch.known_guesses(passed.X, segment, counted)
        return cls(branch, segment, counted, guesses)


def _along_key(line: Mapping[str, Any], target: _Target, wanted: Wanted) -> _Found:
    """Gaits of a line's slope, at any value of a key in its range."""
    walker_at = walkers_over(line, target.vary)
    keys = Keys.of_one(target.vary, walker_at, target.low, target.high)
    gaits = Equations(keys, [], float(line["slope"])).of_steps(target.steps)
    curves = [Curve.of_points(gaits, *each) for each in gaits_over_key(gaits)]
    samples = [Sampled.of(curve, target.condition) for curve in curves]
    of_steps = f" of {target.steps} steps" if target.steps > 1 else ""
    log = [f"{len(samples)} curves of gaits{of_steps} over `{target.vary}` searched"]
    groups: list[Passed] = []
    if _is_unchanged(samples):
        log.append(f"{target.measure} does not change with `{target.vary}`")
    else:
        edges = np.array([target.low, target.high]) / keys.scale
        groups = _passed(samples, target, edges)

    found = _solve_at_keys(gaits, groups, wanted)
    return _Found(*found, samples, log)


def _solve_at_keys(
    gaits: Equations, groups: list[Passed], wanted: Wanted
) -> tuple[Solved | None, list[Passed], list[tuple[Any, Any]], np.ndarray, np.ndarray]:
    """Solve gaits, each of a walker of its own, from those at which curves pass values;
    what `_Found` has, but for the samples and the log.
    """
    keys, slope = gaits.keys, gaits.slope
    assert keys is not None and slope is not None
    numbers = [(number, 0) for number in range(len(groups))]
    X = np.hstack([passed.X for passed in groups]) if groups else np.empty((1, 0))
    (values,) = keys.values(X[-1:])
    slopes = np.full(len(values), slope)
    if not len(values):
        return None, groups, numbers, values, slopes

    lanes, guesses = _guesses_at(gaits, keys, X)
    of_groups = slices([len(passed.value) for passed in groups])
    in_groups = [lanes_of(guesses, some) for some in of_groups]

    alone = [(lanes.alone(lane), 1) for lane in range(len(values))]
    to_bound = partial(_settle, accuracy=wanted.accuracy)
    solved = solve_guesses(lanes, in_groups, to_bound, wanted, alone)
    return solved, groups, numbers, values, slopes


def _guesses_at(gaits: Equations, keys: Keys, X: np.ndarray) -> tuple[Problem, Guesses]:
    """The walkers at points X (u, n) of curves of gaits over a key, and guesses there."""
    (values,) = keys.values(X[-1:])
    walkers = [keys.walker_at(value) for value in values.tolist()]
    single = Lanes(walkers, keys.structure, gaits.problem.drive)
    lanes = single.of_steps(gaits.problem.steps)
    Z, _ = gaits.split(X)
    return lanes, unmeasured(lanes, Z[:-1], np.exp(Z[-1]))


def _settle(problem: Problem, guesses: Guesses, accuracy: float) -> Polished:
    gaits = settle(problem, guesses, accuracy=accuracy)
    # Beside a flip Newton's method may lead to the gait of half as many steps.
    gaits.converged &= repeats_no_sooner(problem, gaits.w, guesses.w)
    return gaits


def _is_unchanged(samples: Sequence[Sampled]) -> bool:
    """Whether a measure is constant along all curves but for rounding."""
    spans = [np.ptp(sampled.values[np.isfinite(sampled.values)]) for sampled in samples]
    sizes = [sampled.size for sampled in samples]
    return bool(samples) and all(
        span <= _UNCHANGED * size for span, size in zip(spans, sizes, strict=True)
    )


def _missed(found: _Found, target: _Target) -> str:
    """Say that no gait has the one value of a target, by the values that there are."""
    (value,) = target.values.tolist()
    sought = f"{target.measure} = {value:.6g}"
    reached = found.reached(*target.edges)
    return status.unreached("", sought, target.where, reached, "")


def _parts(found: _Found) -> Iterator[Part]:
    """Gaits of each curve, those of one value in different parts."""
    if found.solved is None:
        return
    for k, (passed, numbers) in enumerate(
        zip(found.groups, found.numbers, strict=True)
    ):
        part = found.solved.part(k, passed.value, numbers)
        # The gaits of a value follow one another.
        first = np.searchsorted(passed.value, passed.value)
        rank = np.arange(len(passed.value)) - first
        for number in range(int(rank.max(initial=-1)) + 1):
            yield part.some(rank == number)


def _records(
    line: Mapping[str, Any], found: _Found, target: _Target
) -> Iterator[dict[str, Any]]:
    """Each gait as `solve_one` describes it, by what is varied."""
    if found.solved is None:
        return

    gaits, is_of_key = found.solved.gaits, target.vary != SLOPE
    for lane in np.argsort(found.varied, kind="stable").tolist():
        values = {name: array[lane] for name, array in gaits.items()}
        if values["status"] != status.CONVERGED or not values["anthropomorphic"]:
            continue

        values |= {"branch": np.int16(-1), "piece": np.int16(-1)}
        is_long = values["heelstrike_rate_ratio"] < LONG_BELOW
        label = "long" if is_long else "short"
        key = {target.vary: float(found.varied[lane])} if is_of_key else {}
        slope = float(found.slope[lane])
        own = {**line, "set": {**line["set"], **key}}
        if target.steps > 1:
            values |= end_of_first_step(own, slope, values)
        yield key | record(label, slope, values, walker_of_line(own))
