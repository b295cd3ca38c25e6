"""Ends of walking on a branch: heelstrike meets kneestrike or turns tangential, or an
earlier strike occurs.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from gaitsweep.tasks.continuation.branch import Branch
from gaitsweep.tasks.continuation.conditions import CONDITIONS
from gaitsweep.tasks.continuation.locate import (
    correct_at,
    is_step,
    locate_root,
    sampled_steps,
    search_segment,
    value_of,
)
from gaitsweep.tasks.continuation.lockstep import Call, Procedure
from gaitsweep.tasks.continuation.pseudo_arclength import Point
from gaitsweep.tasks.continuation.root import root_search
from gaitsweep.tasks.continuation.tracking import check_steps, correct
from gaitsweep.tasks.fixed_points.step_check import verified
from gaitsweep.tasks.step.step_map import SAMPLES

#: Shares of the way to an end at which gaits must still be steps.
_SHARES = 1 - 0.1 ** np.arange(1, 7)
#: Value of an end's test function below which rounding may decide whether a gait is a
#: step.
_MIN_DISTANCE = 1e-6
#: At time 0 the knee's guard has a root that is no strike: one closer than this cannot
#: be distinguished from it [sqrt(leg/g)].
_EARLIEST_KNEESTRIKE = 2e-6


@dataclass(frozen=True)
class BranchEnd:
    """Where walking ends on a branch: its kind, the point, and the error of ln slope."""

    kind: str
    point: Point
    error: float


#: The ends of walking that equations define.
_ENDS = [each for each in CONDITIONS.values() if each.kind.ends == "walking"]


def locate_end(branch: Branch, good: int, bad: int) -> Procedure[BranchEnd]:
    """Locate the end of walking between two neighbouring nodes, of which `good` is a
    step and `bad` is not.
    """
    segment = min(good, bad)
    axis = branch.axis[segment]
    at_good = yield from correct_at(branch, segment, branch.Z[axis, good])
    at_bad = yield from correct_at(branch, segment, branch.Z[axis, bad])
    ends: list[tuple[float, BranchEnd]] = []
    for condition in _ENDS:
        if condition.kind.needs_knee and not len(at_good.at.stride.one.knee):
            continue
        test = value_of(condition)
        if test(at_good) * test(at_bad) < 0:
            point = yield from locate_root(branch, segment, test)
            # In the coordinate in which the segment is monotone: all others turn where
            # kneestrike is tangential.
            apart = abs(float(point.Z[axis, 0] - branch.Z[axis, good]))
            ends.append((apart, BranchEnd(condition.name, point, 0.0)))
    if ends:
        end = min(ends, key=lambda end: end[0])[1]
        if (yield from _walks_up_to(branch, good, segment, end)):
            return (yield from _with_a_kneestrike(branch, segment, end))
    return (yield from _earlier_strike_end(branch, segment, good, bad))


def _with_a_kneestrike(
    branch: Branch, segment: int, end: BranchEnd
) -> Procedure[BranchEnd]:
    """Where the knee strikes as soon as it is released, the end at the earliest
    kneestrike that rounding resolves.
    """
    if (
        end.kind != "end_tangential_kneestrike"
        or _earliest_kneestrike(end.point) > _EARLIEST_KNEESTRIKE
    ):
        return end
    earliest = yield from locate_root(
        branch,
        segment,
        lambda point: _earliest_kneestrike(point) - _EARLIEST_KNEESTRIKE,
    )
    return BranchEnd(
        end.kind, earliest, abs(float(earliest.at.q[0] - end.point.at.q[0]))
    )


def _earliest_kneestrike(point: Point) -> float:
    """Shortest time to kneestrike of a gait's steps [sqrt(leg/g)]."""
    return float(np.diff(point.at.times[:, 0], prepend=0)[::2].min())


def _walks_up_to(
    branch: Branch, good: int, segment: int, end: BranchEnd
) -> Procedure[bool]:
    """Whether gaits ever nearer an end are steps, so that no earlier strike comes
    before it.
    """
    axis, segments = branch.axis[segment], np.full(len(_SHARES), segment)
    a, b = branch.Z[axis, good], end.point.Z[axis, 0]
    points = yield Call(
        correct,
        (branch.evaluate(segments, a + (b - a) * _SHARES), branch.between(segments)),
    )
    check = yield Call(check_steps, (points.Z,))
    values = CONDITIONS[end.kind].residual(points.at)
    # Corrected points lie slightly off the polynomial; those beyond the end do not
    # count.
    before = (np.sign(values) == np.sign(values[0])) & (np.abs(values) > _MIN_DISTANCE)
    return bool((check.step | ~points.ok | ~before).all())


def _earlier_strike_end(
    branch: Branch, segment: int, good: int, bad: int
) -> Procedure[BranchEnd]:
    """Locate where an earlier strike occurs on a segment: a minimum of a guard touches
    zero.
    """
    axis = branch.axis[segment]
    a, b = branch.Z[axis, good], branch.Z[axis, bad]

    def distance(point: Point, samples: int = 16 * SAMPLES) -> Procedure[float]:
        _, distances = yield Call(sampled_steps, (point.Z,), (("samples", samples),))
        return float(distances[0])

    def bisect(
        a: float,
        b: float,
        rounds: int,
        happens: Callable[[Point], Procedure[bool]] = is_step,
    ) -> Procedure[tuple[float, float]]:
        for _ in range(rounds):
            middle = 0.5 * (a + b)
            point = yield from correct_at(branch, segment, middle)
            if point.ok[0] and (yield from happens(point)):
                a = middle
            else:
                b = middle
        return a, b

    # Bisection by whether the step happens brackets the point; the guard's minimum is
    # smooth only near it.
    nodes = a, b
    a, b = yield from bisect(*nodes, 8)
    at_a = yield from distance((yield from correct_at(branch, segment, a)))
    at_b = yield from distance((yield from correct_at(branch, segment, b)))
    if np.isfinite([at_a, at_b]).all() and at_a * at_b < 0:
        root = yield from search_segment(
            root_search(a, b, 1e-15 * max(1.0, abs(a))), branch, segment, distance
        )
        point = yield from correct_at(branch, segment, root)
        # The value at half as many samples shows the error of the cubic's minimum.
        error = abs((yield from distance(point, 8 * SAMPLES)) / (at_b - at_a) * (b - a))
    else:
        # Only samples locate it: as many as points are verified with, and finer ones to
        # show the error.
        a, _ = yield from bisect(a, b, 40)
        fine, _ = yield from bisect(*nodes, 48, _is_step_finely)
        point = yield from correct_at(branch, segment, a)
        error = 2 * (fine - a)
    tangent = point.direction[:, 0]
    return BranchEnd(
        "end_earlier_strike", point, abs(error * float(tangent[-1] / tangent[axis]))
    )


def _is_step_finely(point: Point) -> Procedure[bool]:
    """Whether a corrected point is a step that happens, by four times as many samples
    as settle a doubt.
    """
    stride, _ = yield Call(sampled_steps, (point.Z,), (("samples", 64 * SAMPLES),))
    return bool(verified(stride).step[0])
