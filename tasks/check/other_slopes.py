"""Rules of gaits of other slopes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from gaitsweep.tasks.branches.branch import Branch
from gaitsweep.tasks.branches.nearest import Gaits, nearest_on_branches
from gaitsweep.tasks.check.case import CHANGED, Case
from gaitsweep.tasks.check.one_step import say_gaits
from gaitsweep.tasks.check.rows import magnitudes, relative_change, relative_distance
from gaitsweep.tasks.mechanics.arrays import Numbers, Slopes
from gaitsweep.tasks.mechanics.sums import total
from gaitsweep.tasks.step.problem import Problem

#: By how much more than states the sections of knees may differ, which are those before
#: the impact.
_BEFORE_IMPACT = 5.0
#: Change of ln slope, and relative one of states, over which branches count as straight.
_STRAIGHT = 0.02


@dataclass
class _OnBranch:
    """The gaits (3, n) of a branch nearest to n states, NaN of none: at which slope, as
    their problem counts it, how they change by its ln, and how much further along it is
    nearest by the tolerances.
    """

    problem: Problem
    counted: Slopes
    gaits: Gaits
    changes: np.ndarray
    along: np.ndarray

    def slopes(self, along: np.ndarray) -> Slopes:
        """Slopes (n,) [rad] so far along."""
        return self.problem.slopes(self.counted * np.exp(along))

    def clipped(self, low: Slopes, high: Slopes) -> np.ndarray:
        """How far along gaits are nearest among those of slopes (n,) from low to high."""
        first = self._up_to(low)
        first[np.isnan(first)] = -np.inf  # where the branch has no slope so low
        return np.clip(self.along, first, self._up_to(high))

    @np.errstate(invalid="ignore", divide="ignore")
    def _up_to(self, slope: Slopes) -> np.ndarray:
        """How far along slopes (n,) are; NaN where the branch has none such."""
        counted = self.problem.drive.counted(slope)
        return np.asarray(np.log(counted) - np.log(self.counted))


def judge_rounded_slopes(case: Case) -> None:
    """Tell rows that are gaits of the slope that was rounded to theirs, of one above 0
    that was rounded to 0 too.
    """
    rounding = case.rows.slope_rounding
    slope = case.rows.slope
    lanes = case.steppable
    is_rounded = rounding[lanes] > case.rows.tolerance * np.abs(slope[lanes])
    lanes = lanes[is_rounded]

    downhill = lanes[slope[lanes] + rounding[lanes] > 0]
    _judge_rounded(case, downhill, _on_branches(case, downhill))

    lanes = lanes[case.verdict[lanes] == ""]
    uphill = lanes[slope[lanes] - rounding[lanes] <= 0]
    _judge_rounded(case, uphill, _on_any_ground(case, uphill))


def _judge_rounded(case: Case, lanes: Numbers, every: Iterator[_OnBranch]) -> None:
    """Tell rows that are gaits of slopes that may have been rounded to theirs: the
    nearest to them among all gaits of that slope, which names it, too.
    """
    rounding = case.rows.slope_rounding[lanes]
    origin = _origins(case, lanes, every, 1.0, rounding)
    are = np.isfinite(origin)
    lanes, origin = lanes[are], origin[are]
    if not len(lanes):
        return

    # What is nearest at the slope that was given counts no more.
    case.distance[lanes] = np.inf
    case.take_nearest(lanes, case.grounds.gaits_at(origin))
    say_gaits(case, lanes)
    _tell_slopes(case, lanes, origin)


def _tell_slopes(case: Case, lanes: Numbers, belong: np.ndarray) -> None:
    """Say of gaits from which slope theirs may have been rounded."""
    for lane, to in zip(lanes, belong, strict=True):
        if case.verdict[lane] != "gait":
            continue
        digits = f"{case.rows.slope[lane]:.6g}, which may have been {to:.6g}"
        case.reason[lane] = f"A gait to the digits of its slope, {digits}."


def judge_slopes(case: Case) -> None:
    """Tell rows that are gaits of another slope."""
    lanes = case.steppable
    _judge_slopes(case, lanes, _on_branches(case, lanes))
    _judge_level(case, lanes)

    lanes = case.steppable
    own = case.nearest.state[:, lanes]
    is_own = case.within(case.states(lanes), own, lanes, CHANGED)
    others = lanes[~is_own]
    _judge_slopes(case, others, _on_any_ground(case, others))


def _judge_slopes(case: Case, lanes: Numbers, every: Iterator[_OnBranch]) -> None:
    """Tell rows that are the gaits nearest to them on branches, at any slope."""
    anywhere = np.full(len(lanes), np.inf)
    origin = _origins(case, lanes, every, CHANGED, anywhere)
    are = np.isfinite(origin)
    case.say_slope(lanes[are], origin[are])


def _origins(
    case: Case,
    lanes: Numbers,
    every: Iterator[_OnBranch],
    factor: float,
    reach: Slopes,
) -> Slopes:
    """Slopes (k,) of the gaits that some rows are, within reach of their own; of the
    nearest gait where several branches have one, NaN where none has.
    """
    state, slope = case.states(lanes), case.slopes(lanes)
    origin = np.full(len(lanes), np.nan)
    least = np.full(len(lanes), np.inf)
    for found in every:
        along = found.clipped(slope - reach, slope + reach)
        moved = along * found.changes
        gait = found.gaits.state + moved

        # Slopes counted from far below change less than states.
        way = np.fmax(np.abs(along), relative_change(moved, found.gaits.state))
        are = case.within(state, gait, lanes, factor) & (way <= _STRAIGHT)
        distance = relative_distance(state, gait)
        nearer = are & (distance < least)
        origin[nearer] = found.slopes(along)[nearer]
        least[nearer] = distance[nearer]

    return origin


def _on_branches(case: Case, lanes: Numbers) -> Iterator[_OnBranch]:
    """The gaits nearest to some rows on each branch over slopes above 0."""
    if len(lanes):
        for problem, branches in case.grounds.downhill:
            yield from _nearest(case, lanes, problem, branches)


def _on_any_ground(case: Case, lanes: Numbers) -> Iterator[_OnBranch]:
    """The gaits of driven walkers nearest to some rows on each branch over slopes that
    lead uphill, too.
    """
    if len(lanes) and case.grounds.is_driven:
        problem, branches = case.grounds.over_any_slope
        yield from _nearest(case, lanes, problem, branches)


def _nearest(
    case: Case, lanes: Numbers, problem: Problem, branches: list[Branch]
) -> Iterator[_OnBranch]:
    """The gaits nearest to some rows on each of some branches, at any slope."""
    state = case.states(lanes)
    y = case.sections(lanes, state)[: problem.step.m]
    within = CHANGED * case.relative_tolerance(lanes)
    if case.walker.knees:
        within *= _BEFORE_IMPACT

    digits = case.rows.table_digit[:, lanes]
    allowed = case.rows.tolerance * magnitudes(state) + digits
    for counted, gaits, changes in nearest_on_branches(problem, branches, y, within):
        moves = changes / allowed
        with np.errstate(invalid="ignore", divide="ignore"):
            products = moves * (state - gaits.state) / allowed
            along = total(products) / total(moves**2)
        yield _OnBranch(problem, counted, gaits, changes, along)


def _judge_level(case: Case, lanes: Numbers) -> None:
    """Tell rows that are gaits of level ground."""
    lanes = lanes[case.slopes(lanes) != 0]
    if not case.grounds.is_driven or not len(lanes):
        return

    level = np.zeros(len(lanes))
    for gaits in case.grounds.gaits_at(level):
        are = case.within(case.states(lanes), gaits.state, lanes, CHANGED)
        are &= case.verdict[lanes] == ""
        case.say_slope(lanes[are], level[are])
