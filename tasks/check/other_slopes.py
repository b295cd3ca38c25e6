"""Rules of gaits of other slopes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from gaitsweep.tasks.branches.nearest import Gaits, nearest_on_branches
from gaitsweep.tasks.check.case import CHANGED, Case, some_gaits
from gaitsweep.tasks.check.one_step import judge_shanks
from gaitsweep.tasks.check.rows import magnitudes
from gaitsweep.tasks.mechanics.arrays import Numbers, Slopes
from gaitsweep.tasks.mechanics.sums import total

#: By how much more than states the sections of knees may differ, which are those before
#: the impact.
_BEFORE_IMPACT = 5.0
#: Change of ln slope over which branches count as straight.
_STRAIGHT = 0.02


@dataclass
class _OnBranch:
    """The gaits (3, n) of a branch nearest to n states, NaN of none: at which slope, how
    they change by its ln, and how much further along it is nearest by the tolerances.
    """

    slope: Slopes
    gaits: Gaits
    changes: np.ndarray
    along: np.ndarray


def judge_rounded_slopes(case: Case) -> None:
    """Tell rows that are gaits of the slope that was rounded to theirs, of one above 0
    that was rounded to 0 too.
    """
    rounding, slope = case.rows.slope_rounding, case.rows.slope
    lanes = case.steppable
    is_rounded = rounding[lanes] > case.rows.tolerance * slope[lanes]
    lanes = lanes[is_rounded & (slope[lanes] + rounding[lanes] > 0)]
    with np.errstate(invalid="ignore", divide="ignore"):
        low = np.log(np.maximum(slope - rounding, 0.0))
        high = np.log(slope + rounding)
    for found in _on_branches(case, lanes):
        q = np.log(found.slope)
        along = np.clip(q + found.along, low[lanes], high[lanes]) - q
        are = _are(case, found, along, lanes, 1.0)
        case.set_nearest(lanes[are], some_gaits(found.gaits, np.flatnonzero(are)))
        if case.claimed > 1:
            case.say_period(lanes[are])
            continue
        case.say("gait", lanes[are])
        _tell_slopes(case, lanes[are], np.exp(q + along)[are])
        judge_shanks(case, lanes[are])


def _tell_slopes(case: Case, lanes: Numbers, belong: np.ndarray) -> None:
    """Say of gaits from which slope theirs may have been rounded."""
    for lane, to in zip(lanes, belong, strict=True):
        digits = f"{case.rows.slope[lane]:.6g}, which may have been {to:.6g}"
        case.reason[lane] = f"A gait to the digits of its slope, {digits}."


def judge_slopes(case: Case) -> None:
    """Tell rows that are gaits of another slope."""
    lanes = case.steppable
    for found in _on_branches(case, lanes):
        are = _are(case, found, found.along, lanes, CHANGED)
        slope = found.slope * np.exp(found.along)
        case.say_slope(lanes[are], slope[are])
    _judge_level(case, lanes)


def _are(
    case: Case, found: _OnBranch, along: np.ndarray, lanes: Numbers, factor: float
) -> np.ndarray:
    """Which of some rows without a verdict are the gaits found, so far along."""
    is_straight = np.abs(along) <= _STRAIGHT
    gait = found.gaits.state + along * found.changes
    are = case.within(case.states(lanes), gait, lanes, factor)
    return np.asarray(are & is_straight & (case.verdict[lanes] == ""))


def _on_branches(case: Case, lanes: Numbers) -> Iterator[_OnBranch]:
    """The gaits nearest to some rows on each branch, at any slope."""
    if not len(lanes):
        return
    state = case.states(lanes)
    y = case.sections(lanes, state)[: case.problem.m]
    within = CHANGED * case.relative_tolerance(lanes)
    if case.walker.knees:
        within *= _BEFORE_IMPACT
    allowed = case.rows.tolerance * magnitudes(state) + case.rows.table_digit[:, lanes]
    for slope, gaits, changes in nearest_on_branches(
        case.problem, case.branches, y, within
    ):
        moves = changes / allowed
        with np.errstate(invalid="ignore", divide="ignore"):
            products = moves * (state - gaits.state) / allowed
            along = total(products) / total(moves**2)
        yield _OnBranch(slope, gaits, changes, along)


def _judge_level(case: Case, lanes: Numbers) -> None:
    """Tell rows that are gaits of level ground."""
    lanes = lanes[case.slopes(lanes) != 0]
    if "drive" not in case.walker.features or not len(lanes):
        return
    level = np.zeros(len(lanes))
    for gaits in case.grounds.gaits_at(level):
        are = case.within(case.states(lanes), gaits.state, lanes, CHANGED)
        are &= case.verdict[lanes] == ""
        case.say_slope(lanes[are], level[are])
