"""The task `cascade`: gaits of period 1, 2, 4, ... and of other periods, from folds
through period doublings, over slopes or over what else drives.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy import ndarray

from gaitsweep.tasks.branches import atlas as atlases
from gaitsweep.tasks.branches.branch import Branch
from gaitsweep.tasks.branches.conditions import CONDITIONS
from gaitsweep.tasks.branches.equations import slope_error
from gaitsweep.tasks.branches.flips import doubled
from gaitsweep.tasks.branches.joint import Evaluation
from gaitsweep.tasks.branches.pseudo_arclength import Point
from gaitsweep.tasks.branches.special_points import RATES, passings, state_at
from gaitsweep.tasks.branches.tracking import check_steps, correct, points_along
from gaitsweep.tasks.contract import registry
from gaitsweep.tasks.contract.kinds import kind_of
from gaitsweep.tasks.contract.status import over
from gaitsweep.tasks.contract.tables import Arrays, nothing, table
from gaitsweep.tasks.fits import feigenbaum as scaling
from gaitsweep.tasks.gaits.newton import newton
from gaitsweep.tasks.mechanics.arrays import LogSlopes, Marks, Slopes, Unknowns
from gaitsweep.tasks.orbits.crisis import Attractor, lost
from gaitsweep.tasks.orbits.initial_states import gaits_at, r_sequence
from gaitsweep.tasks.orbits.walk import Walk
from gaitsweep.tasks.step.drive import SLOPE
from gaitsweep.tasks.step.lanes import lanes_of
from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.step.sameness import SAME_GAIT, SAME_POINT, SOONER
from gaitsweep.tasks.step.several_steps import (
    distance,
    distances_of_steps,
    joined,
    sections,
)
from gaitsweep.tasks.step.simulate import STRUCK, stride
from gaitsweep.tasks.studies.followed import columns_along, followed_over
from gaitsweep.tasks.walkers.resolve import walker_of_line

#: Orbits that locate the loss of walking, their relative distance from the last gait
#: (chaos separates them), and how far beyond the accumulation they search, relative to
#: its distance from the first flip.
_ORBITS, _SPREAD, _MAX_EXTENT = 640, 1e-9, 3.0
#: First step along a branch over the window, and the longest interval to the next flip,
#: in ln slope, that is expected: the first intervals of a cascade need not follow
#: Feigenbaum's law.
_FIRST_STEP, _MAX_INTERVAL = 0.01, 0.05
#: Largest first, second, ... step of Newton's method, and most steps: guesses beyond
#: either are dropped, of which hardly one converges. Of guesses in one cell of this size
#: after three steps, which lead to one gait, the nearest to it continues.
_MAX_STEP_BY_ITERATION = (1.0, 0.8, 0.4, 0.2, 0.1, 0.05)
_MAX_NEWTON, _MERGE_CELL = 12, 1e-2
#: Initial states at a slope that are polished: those that return closest to themselves.
_POLISHED = 60
#: Most points of a branch on which no event is found.
_MAX_POINTS = 400
#: Difference of the ln slopes of one fold.
_SAME_SLOPE = 1e-9
#: How far beyond the window a branch is followed, in ln slope.
_MARGIN = 0.05
#: Columns of the tables.
_CASCADE = (
    "family",
    "period",
    "kind",
    "slope",
    "error_bound",
    "ratio",
    "stance_angle",
    *RATES,
    "walks",
)
_ACCUMULATION = ("family", "flips", "slope", "low", "high", "ratio", "stopped")
_UNKNOWN = (np.nan,) * 4
_LOST = ("family", "low", "high", "starts", "strides", "reason")


@dataclass(frozen=True)
class _Event:
    """A fold or flip of a family, the relative error of its slope, and the gaits
    between which it lies.
    """

    kind: str
    gait: Evaluation
    error: float
    beside: tuple[Point, ...] = ()

    @property
    def q(self) -> float:
        """Its ln slope."""
        return float(self.gait.q[0])

    @property
    def slope(self) -> float:
        """Its slope [rad], or what else drives."""
        return float(np.exp(self.q))

    @property
    def doubles_steps(self) -> bool:
        """Whether gaits of twice as many steps begin there."""
        return kind_of(self.kind).doubles_steps


@dataclass(frozen=True)
class _Family:
    """A family of gaits: its events in order, and why no more follow."""

    events: list[_Event]
    stopped: str

    @property
    def flips(self) -> ndarray:
        """Slopes of its flips, shape (k,) [rad]."""
        return np.array([event.slope for event in self.events if event.doubles_steps])


def cascade(params: Mapping[str, Any], inputs: list[Arrays]) -> Arrays:
    """Locate the flips and folds of a line's families of period-n gaits within a window
    of slopes.

    Parameters
    ----------
    params : mapping
        `line`; `along`, the key that drives at the line's slope, if it is not the slope
        that does; `slope`, ndarray [rad], or values of that key [the walker's units],
        whose ends are the window and whose values are searched for families of other
        periods than one; and the study's options:
        `periods`, the longest; `families`, first periods; `starts`, initial conditions
        of the search at each slope; `steps`, that walking must last (0: its end is not
        located). Without slopes nothing is located. `near` may name another line, whose
        atlas is given, from whose gaits the first of this one's are sought.
    inputs : list
        The line's atlas, or that of the line `near`.

    Returns
    -------
    dict
        Tables `cascade` (family, period, kind, slope, error_bound, ratio, stance_angle,
        stance_rate, thigh_rate, shank_rate, walks), a row for each fold and flip, in
        the walker's units, `accumulation` (family, flips, slope, low, high, ratio,
        stopped: why no further flip was located), and `lost` (family, low, high,
        starts, strides, reason): the slopes [rad] between which the chaos beyond a
        family's doublings ends, in falls or a period-one gait; `reason` says why one of
        them is NaN. What drives stands in the place of the slope.
    """
    options = registry.options("cascade", params)
    problem, unit = followed_over(params)
    near = _near(problem, params)
    slope = np.sort(params["slope"]) / unit
    if not len(slope):
        return {}

    starts = int(options["starts"])
    longest = int(options["periods"])
    families: dict[str, _Family] = {}
    missing: list[str] = []
    rows: list[tuple[Any, ...]] = []
    for period in map(int, options["families"]):
        first = _first_gaits(problem, near, inputs[0], slope, period, starts)
        found = _families(problem, first, slope, period, longest)
        families |= found
        why = "" if found else _no_family(period, slope * unit, problem)
        missing.append(why)
        rows += _accumulation_rows(period, found, why, unit)

    tables = _event_table(families, problem)
    tables |= table("accumulation", rows, columns_along(problem, _ACCUMULATION))
    tables |= _lost_table(problem, families, slope, int(options["steps"]))
    if not families:
        tables |= nothing(" ".join(missing))
    return tables


def _near(problem: Problem, params: Mapping[str, Any]) -> Problem:
    """The problem of the walker from whose gaits the first are sought."""
    return Problem(walker_of_line(params["near"])) if "near" in params else problem


def _no_family(period: int, values: ndarray, problem: Problem) -> str:
    """Why there is no family of a period at values of what gaits are followed along."""
    gait = "long gait" if period == 1 else f"gait of period {period} was found"
    return over(gait, values, problem.drive.key)


def _families(
    problem: Problem, first: list[Point], slope: Slopes, period: int, longest: int
) -> dict[str, _Family]:
    """The families that begin with some gaits, each once, by their names."""
    window = float(np.log(slope[0])), float(np.log(slope[-1]))
    families: list[_Family] = []
    for gait in first:
        known = [family.events[0] for family in families if family.events]
        family = _follow_family(problem, gait, window, longest, known)
        if family is not None:
            families.append(family)

    names = [f"{period}-{number}" for number in range(1, len(families) + 1)]
    if len(families) == 1:
        names = [f"{period}"]
    return dict(zip(names, families, strict=True))


def _event_table(families: dict[str, _Family], problem: Problem) -> Arrays:
    """The table of the folds and flips of families, by their names."""
    rows: list[tuple[Any, ...]] = []
    for name, family in families.items():
        rows += _event_rows(name, family)
    return table("cascade", rows, columns_along(problem, _CASCADE))


def _event_rows(name: str, family: _Family) -> Iterator[tuple[Any, ...]]:
    """Rows of a family's folds and flips, in the walker's units."""
    ratio = iter(scaling.ratios(family.flips))
    for event in family.events:
        problem, state = event.gait.problem, state_at(event.gait, 0)
        walker = problem.walker
        rates = (np.array(state["rates"]) / walker.time_unit).tolist()
        is_step = int(check_steps(problem, event.gait.Z).step[0])
        yield (
            name,
            problem.steps,
            event.kind,
            event.slope * problem.drive.unit(walker),
            event.error,
            next(ratio) if event.doubles_steps else np.nan,
            state["stance_angle"],
            *rates,
            is_step,
        )


def _accumulation_rows(
    period: int, families: Mapping[str, _Family], why: str, unit: float
) -> list[tuple[Any, ...]]:
    """Rows of where flips of the families of a first period accumulate; that of none
    says why.
    """
    if not families:
        return [(f"{period}", 0, *_UNKNOWN, why)]
    return [_accumulation_row(*named, unit) for named in families.items()]


def _accumulation_row(name: str, family: _Family, unit: float) -> tuple[Any, ...]:
    """Row of where a family's flips accumulate, in a unit."""
    ratios = scaling.ratios(family.flips)
    last = float(ratios[-1]) if len(ratios) else np.nan
    bounds = [unit * bound for bound in scaling.accumulation(family.flips)]
    return (name, len(family.flips), *bounds, last, family.stopped)


def _lost_table(
    problem: Problem, families: dict[str, _Family], slope: Slopes, steps: int
) -> Arrays:
    """The table of where the chaos beyond the flips of families ends, of those whose
    flips accumulate.
    """
    attractors = _attractors(families, slope) if steps else {}
    brackets = lost(problem, [*attractors.values()], steps)
    rows: list[tuple[Any, ...]] = []
    for (name, attractor), bracket in zip(attractors.items(), brackets, strict=True):
        _, begin, end = attractor
        reason = _unbracketed(problem, *bracket, begin, end)
        # Doublings may lead to smaller slopes.
        rises = begin > families[name].flips[0]
        unit = problem.drive.unit(problem.walker)
        low, high = bracket if rises else bracket[::-1]
        rows.append((name, unit * low, unit * high, _ORBITS, steps, reason))
    return table("lost", rows, _LOST)


def _attractors(families: dict[str, _Family], slope: Slopes) -> dict[str, Attractor]:
    """Orbits on the attractors beyond the flips of families, of those that accumulate,
    and the slopes between which they are lost.
    """
    attractors: dict[str, Attractor] = {}
    for name, family in families.items():
        accumulation = scaling.accumulation(family.flips)[0]
        if np.isfinite(accumulation):
            reach = accumulation + _MAX_EXTENT * (accumulation - family.flips[0])
            end = float(np.clip(reach, slope[0], slope[-1]))
            orbits = _spread_around(family.events[-1])
            attractors[name] = orbits, accumulation, end

    return attractors


def _unbracketed(
    problem: Problem, low: float, high: float, accumulation: float, end: float
) -> str:
    """Why the loss of an attractor has no slope on one of its sides; empty where it has
    both.
    """
    if np.isnan(low):
        at = _in_words(problem, accumulation)
        return f"Orbits are lost at the accumulation point already, at {at}."
    if np.isnan(high):
        return f"Orbits persist to {_in_words(problem, end)}, where the search ends."
    return ""


def _in_words(problem: Problem, drive: float, of: str = "") -> str:
    """A slope in words, or a value of what else drives, in the walker's units."""
    key, unit = problem.drive.key, problem.drive.unit(problem.walker)
    return f"{key if key == SLOPE else f'`{key}`'}{of} {drive * unit:.6g}"


def _spread_around(event: _Event) -> ndarray:
    """Initial conditions near the steps of a gait, in turn, shape (m, _ORBITS)."""
    problem, w = event.gait.problem, event.gait.w
    n = problem.steps
    Y = np.exp(w[0]) * sections(w, problem.m, n)[0][:, :, 0].T
    steps = np.arange(_ORBITS) * n // _ORBITS if n > _ORBITS else np.arange(_ORBITS) % n
    return Y[:, steps] * (1 + _SPREAD * (2 * r_sequence(len(Y), _ORBITS) - 1))


def _is_same(a: _Event, b: _Event) -> bool:
    """Whether two folds are one."""
    if a.kind != b.kind or abs(a.q - b.q) >= _SAME_SLOPE:
        return False
    steps = a.gait.problem.steps
    return distance(a.gait.w[:, 0], b.gait.w[:, 0], a.gait.m, steps) < SAME_POINT


def _first_gaits(
    problem: Problem,
    near: Problem,
    atlas: Arrays,
    slope: Slopes,
    n: int,
    starts: int,
) -> list[Point]:
    """A gait of each family of period n, sought from those of a walker `near` and its
    atlas.
    """
    branches = atlases.from_arrays(atlas)
    if n == 1:
        return _first_long_gait(problem, near, branches, slope)

    for k in range(len(slope)):
        gaits = Orbits(problem, branches, slope[[k]], n, starts).cycles(n)
        if gaits:
            return gaits

    return []


def _first_long_gait(
    problem: Problem, near: Problem, branches: list[Branch], slope: Slopes
) -> list[Point]:
    """The long gait of one step at the lowest slope of a window at which those of a
    walker `near`, on its branches, lead to one.
    """
    low, high = slope[0], slope[-1]
    tried = [low]
    # A branch may begin above the window's lower edge: between nodes, for at a fold it
    # has no derivative.
    for branch in branches:
        between = np.exp(0.5 * (branch.q[1:] + branch.q[:-1]))
        tried.extend(between[(between > low) & (between < high)])

    slopes = np.unique(tried)
    known, y = gaits_at(near, branches, slopes, "long")
    for k, start in zip(known, y.T, strict=True):
        step = stride(problem, start[:, None], slopes[[k]])
        durations = np.diff(step.times, axis=0, prepend=0)
        guess = joined(0.0, start[None, :, None], durations[None])
        has_struck = step.outcome == STRUCK
        gaits = _solved(
            problem, guess[:, has_struck], np.full(has_struck.sum(), slopes[k])
        )
        if gaits:
            return gaits

    return []


def _solved(problem: Problem, w: Unknowns, slope: Slopes) -> list[Point]:
    """Distinct gaits, of exactly so many steps, to which Newton's method leads from
    guesses (m + k, n) at slopes (n,).
    """
    q = np.log(slope)
    # Most lead to gaits of fewer steps, or to the same ones, as coarse integration tells.
    for coarse, cell in ((True, _MERGE_CELL), (False, 0.0)):
        w, converged = newton(
            problem,
            w,
            q,
            coarse=coarse,
            max_iterations=_MAX_NEWTON,
            max_step_by_iteration=_MAX_STEP_BY_ITERATION,
            merge_cell=cell,
            group=q,
        )
        kept = _distinct(problem, w, q, converged)
        w, q = w[:, kept], q[kept]

    if not len(q):
        return []

    Z = np.vstack([w, q])
    gaits = correct(problem, Z, None)
    walking = gaits.ok & check_steps(problem, Z).step
    return [lanes_of(gaits, np.array([i])) for i in np.flatnonzero(walking)]


def _distinct(
    problem: Problem, w: Unknowns, q: LogSlopes, converged: Marks
) -> list[int]:
    """Which of the gaits (m + k, n) that have converged, at ln slopes (n,), repeat no
    sooner and are none of those before them.
    """
    m, n = problem.m, problem.steps
    exact = (distances_of_steps(w, m, n) > SOONER).all(axis=0)
    # The equations hold of steps backwards, too.
    forward = (sections(w, m, n)[0][:, 0] > 0).all(axis=0)
    kept: list[int] = []
    for i in np.flatnonzero(converged & exact & forward).tolist():
        beside = [k for k in kept if q[k] == q[i]]
        if all(distance(w[:, i], w[:, k], m, n) > SAME_GAIT for k in beside):
            kept.append(i)

    return kept


class Orbits:
    """Orbits at some slopes from initial conditions around the long gaits there, among
    which gaits of up to `longest` steps are searched for.

    Parameters
    ----------
    problem : Problem
    branches : list of Branch
        The line's atlas.
    slopes : ndarray, shape (k,) [rad]
    longest : int
    starts : int
        Initial states at each slope.

    Notes
    -----
    Initial conditions lie on a low-discrepancy lattice around the long gait, wide enough to hold every attractor of the
    paper's walkers.
    """

    def __init__(
        self,
        problem: Problem,
        branches: list[Branch],
        slopes: Slopes,
        longest: int,
        starts: int,
    ):
        self._problem = problem
        self._slopes = slopes
        walk = _around_long_gaits(problem, branches, slopes, starts)
        self._slope = walk.slope
        # The first step maps all initial conditions onto the strongly contracted image
        # of the map.
        self._after, self._times = [], []
        for _ in walk.steps(longest + 1):
            self._after.append(walk.y.copy())
            self._times.append(walk.times.copy())

        self._taken = walk.taken

    def cycles(self, n: int) -> list[Point]:
        """Return the distinct gaits of exact period n that are found: those of the first
        slope first, and of one slope in order of their largest multiplier.

        Notes
        -----
        Orbits that return close to themselves after n steps are polished by Newton on
        all n sections.
        """
        assert n < len(self._after), "no orbit is as long"
        lanes = self._nearly_returning(n)
        if not len(lanes):
            return []

        states = np.stack(self._after[:n])[..., lanes]
        strikes = np.stack(self._times[1 : n + 1])[..., lanes]
        durations = np.diff(strikes, axis=1, prepend=0)
        guesses = joined(0.0, states, durations)
        found = _solved(self._problem.of_steps(n), guesses, self._slope[lanes])

        def place(gait: Point) -> tuple[int, float]:
            nearest_slope = np.abs(np.log(self._slopes) - gait.Z[-1, 0]).argmin()
            return int(nearest_slope), _largest_multiplier(gait)

        return sorted(found, key=place)

    def _nearly_returning(self, n: int) -> ndarray:
        """Numbers (j,) of the orbits of each slope that return closest to themselves
        after n steps.
        """
        walking = np.flatnonzero(self._taken > n)
        if not len(walking):
            return walking

        off = np.abs(self._after[n] - self._after[0]).max(axis=0)
        nearest = []
        for slope in np.unique(self._slope[walking]):
            lanes = walking[self._slope[walking] == slope]
            nearest.append(lanes[np.argsort(off[lanes], kind="stable")[:_POLISHED]])

        return np.concatenate(nearest)


def _around_long_gaits(
    problem: Problem, branches: list[Branch], slopes: Slopes, starts: int
) -> Walk:
    """So many walkers around the long gait of each slope that has one."""
    known, y = gaits_at(problem, branches, slopes, "long")
    if not len(known):
        return Walk(problem, np.empty((problem.m, 0)), np.empty(0))
    lattice = 1 + 0.2 * (2 * r_sequence(problem.m, starts) - 1)
    states = y[:, :, None] * lattice[:, None]
    slope = np.repeat(slopes[known], starts)
    return Walk(problem, states.reshape(problem.m, -1), slope)


def _largest_multiplier(gait: Point) -> float:
    return float(np.abs(gait.at.multipliers[0, 0]))


def _follow_family(
    problem: Problem,
    start: Point,
    window: tuple[float, float],
    longest: int,
    known: Sequence[_Event] = (),
) -> _Family | None:
    """A family's fold, then its flips, switching at each to the branch of twice the
    period; None where its fold is one of those `known`, of which it is the other side.

    The window is of ln slope.
    """
    length = window[1] - window[0]
    problem = problem.of_steps(start.at.stride.steps)
    up = np.eye(len(start.Z))[-1]
    events: list[_Event] = []
    if problem.steps > 1:
        # Down to the fold at which the family is born; of its two sides the one nearer
        # stability cascades.
        down: _Begun = (start, -up, _FIRST_STEP * length)
        fold, _ = _first_event(problem, down, "fold", window)
        if fold is not None:
            if any(_is_same(fold, other) for other in known):
                return None
            events.append(fold)
            start = min(fold.beside, key=_largest_multiplier)

    flips_from: _Begun = (start, up, _FIRST_STEP * length)
    stopped = _follow_flips(problem, flips_from, window, longest, events)
    return _Family(events, stopped)


def _follow_flips(
    problem: Problem,
    begun: _Begun | None,
    window: tuple[float, float],
    longest: int,
    events: list[_Event],
) -> str:
    """Add to a family's events its flips, of ever twice the period, and return why no
    more follow.
    """
    interval = 0.02 * (window[1] - window[0])
    while begun is not None and problem.steps <= longest:
        flip, why = _first_event(problem, begun, "flip", window)
        if flip is None:
            return f"No flip of period {problem.steps}: {why}."
        if events:
            # The next interval by Feigenbaum's law from the last.
            interval = (flip.q - events[-1].q) / scaling.DELTA

        events.append(flip)
        problem = problem.of_steps(2 * problem.steps)
        begun = None
        if problem.steps <= longest:
            begun = doubled(flip.gait, min(_MAX_INTERVAL, interval))

    if problem.steps <= longest:
        return f"No gait of period {problem.steps} was found beside the flip."

    return f"The longest period of the search, {longest}, is reached."


#: Where a branch is followed from: what `points_along` takes besides the problem.
_Begun = tuple[Point, ndarray, float]


def _first_event(
    problem: Problem, begun: _Begun, kind: str, window: tuple[float, float]
) -> tuple[_Event | None, str]:
    """The first fold or flip along a branch inside a window of ln slope, or why there
    is none.
    """
    low, high = window
    points = points_along(problem, *begun)
    slope = float(np.exp(begun[0].at.q[0]))
    for number, (before, after) in enumerate(itertools.pairwise(points)):
        if number == _MAX_POINTS:
            why = f"none on {_MAX_POINTS} points of the branch, up to a"
            return None, _ends_at(problem, why, slope)

        slope = float(np.exp(after.at.q[0]))

        event, is_between = _event_between(problem, before, after, kind)
        if is_between and event is None:
            why = "the next one could not be located, near a"
            return None, _ends_at(problem, why, slope)

        if event is not None and not low <= event.q <= high:
            why = "the next one lies outside the window, at a"
            return None, _ends_at(problem, why, event.slope)

        if event is not None:
            return event, ""
        if not low - _MARGIN <= after.at.q[0] <= high + _MARGIN:
            edge = float(np.exp(np.clip(after.at.q[0], low, high)))
            return None, _ends_at(problem, "the branch leaves the window at a", edge)

    return None, _ends_at(problem, "the branch could not be continued beyond a", slope)


def _ends_at(problem: Problem, why: str, drive: float) -> str:
    """Why there is no event, and where its branch ends."""
    return f"{why} {_in_words(problem, drive, ' of')}"


def _event_between(
    problem: Problem, before: Point, after: Point, kind: str
) -> tuple[_Event | None, bool]:
    """The fold or flip between two points of a branch, None where it is not found; and
    whether there is one.
    """
    condition = CONDITIONS[kind]
    at_before = float(condition.residual(before.at)[0])
    at_after = float(condition.residual(after.at)[0])
    if not at_before * at_after < 0:
        return None, False

    segment = Branch(
        problem.m,
        np.hstack([before.Z, after.Z]),
        np.hstack([before.direction, after.direction]),
        lipschitz=np.zeros(2),
        why=("", ""),
        steps=problem.steps,
    )
    located = passings(problem, segment, condition)
    if not located:
        return None, True

    gait = located[0][1].at
    error = slope_error(problem, condition, gait.Z[:, 0])
    return _Event(kind, gait, error, (before, after)), True
