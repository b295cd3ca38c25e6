"""Ends of walking on a branch: heelstrike meets kneestrike or turns tangential, or an
earlier strike occurs.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from gaitsweep.tasks.branches.branch import Branch
from gaitsweep.tasks.branches.conditions import CONDITIONS
from gaitsweep.tasks.branches.lockstep import Call, Procedure
from gaitsweep.tasks.branches.pseudo_arclength import Point
from gaitsweep.tasks.branches.segment import (
    Known,
    correct_all_at,
    correct_at,
    is_step,
    locate_root,
    sampled_steps,
    search_segment,
    value_of,
)
from gaitsweep.tasks.branches.tracking import check_steps, correct
from gaitsweep.tasks.gaits.step_check import verified
from gaitsweep.tasks.step.step_map import SAMPLES

#: Shares of the way to an end at which gaits must still be steps.
_SHARES = 1 - 0.1 ** np.arange(1, 7)
#: Value of an end's test function below which rounding may decide whether a gait is a
#: step.
_MIN_DISTANCE = 1e-6
#: At time 0 the knee's guard has a root that is no strike: one closer than this cannot
#: be distinguished from it [sqrt(leg/g)].
_EARLIEST_KNEESTRIKE = 2e-6
#: Samples of a phase by which an earlier strike is located: as many as settle a doubt.
_SAMPLES = 16 * SAMPLES


@dataclass(frozen=True)
class BranchEnd:
    """Where walking ends on a branch: its kind, the point, and the error of ln slope."""

    kind: str
    point: Point
    error: float


#: The ends of walking that equations define.
_ENDS = [
    condition for condition in CONDITIONS.values() if condition.kind.ends == "walking"
]


def locate_end(branch: Branch, good: int, bad: int) -> Procedure[BranchEnd]:
    """Locate the end of walking between two neighbouring nodes, of which `good` is a
    step and `bad` is not.
    """
    segment = min(good, bad)
    axis = branch.axis[segment]
    nodes = branch.Z[axis, [good, bad]].tolist()
    known: Known = {}
    at_good, at_bad = yield from correct_all_at(branch, segment, nodes, known)
    has_knee = len(at_good.at.stride.one.knee) > 0
    ends: list[tuple[float, BranchEnd]] = []
    for condition in _ENDS:
        if condition.kind.needs_knee and not has_knee:
            continue

        test = value_of(condition)
        if test(at_good) * test(at_bad) < 0:
            point = yield from locate_root(branch, segment, test, known)
            # In the coordinate in which the segment is monotone: all others turn where
            # kneestrike is tangential.
            apart = abs(float(point.Z[axis, 0] - branch.Z[axis, good]))
            ends.append((apart, BranchEnd(condition.name, point, 0.0)))

    if ends:
        _, end = min(ends, key=lambda located: located[0])
        if (yield from _walks_up_to(branch, good, segment, end)):
            return (yield from _with_a_kneestrike(branch, segment, end, known))

    return (yield from _earlier_strike_end(branch, segment, good, bad))


def _with_a_kneestrike(
    branch: Branch, segment: int, end: BranchEnd, known: Known
) -> Procedure[BranchEnd]:
    """Where the knee strikes as soon as it is released, the end at the earliest
    kneestrike that rounding resolves.
    """

    def beyond_earliest(point: Point) -> float:
        """Time to kneestrike beyond the earliest, of the step with the shortest."""
        phases = np.diff(point.at.times[:, 0], prepend=0)
        return float(phases[::2].min()) - _EARLIEST_KNEESTRIKE

    if end.kind != "end_tangential_kneestrike" or beyond_earliest(end.point) > 0:
        return end

    earliest = yield from locate_root(branch, segment, beyond_earliest, known)
    off = earliest.at.q[0] - end.point.at.q[0]
    return BranchEnd(end.kind, earliest, abs(float(off)))


def _walks_up_to(
    branch: Branch, good: int, segment: int, end: BranchEnd
) -> Procedure[bool]:
    """Whether gaits ever nearer an end are steps, so that no earlier strike comes
    before it.
    """
    axis = branch.axis[segment]
    a, b = branch.Z[axis, good], end.point.Z[axis, 0]
    segments = np.full(len(_SHARES), segment)
    Z = branch.evaluate(segments, a + (b - a) * _SHARES)
    points = yield Call(correct, (Z, branch.between(segments)))
    check = yield Call(check_steps, (points.Z,))
    values = CONDITIONS[end.kind].residual(points.at)
    # Corrected points lie slightly off the polynomial; those beyond the end do not
    # count.
    before = np.sign(values) == np.sign(values[0])
    before &= np.abs(values) > _MIN_DISTANCE
    return bool((check.step | ~points.ok | ~before).all())


def _earlier_strike_end(
    branch: Branch, segment: int, good: int, bad: int
) -> Procedure[BranchEnd]:
    """Locate where an earlier strike occurs on a segment: a minimum of a guard touches
    zero.
    """
    axis = branch.axis[segment]
    begin, end = branch.Z[axis, [good, bad]].tolist()
    # Bisection by whether the step happens brackets the point; the guard's minimum is
    # smooth only near it.
    a, b = yield from _bisect(branch, segment, begin, end, 8)
    known: Known = {}
    points = yield from correct_all_at(branch, segment, (a, b), known)
    at_a, at_b = yield [*map(_distance, points)]
    if np.isfinite(at_a - at_b) and at_a * at_b < 0:
        point = yield from search_segment(branch, segment, (a, b), _distance, known)
        # The value at half as many samples shows the error of the cubic's minimum.
        coarse = yield from _distance(point, _SAMPLES // 2)
        error = coarse / (at_b - at_a) * (b - a)
    else:
        # Only samples locate it: as many as points are verified with, and finer ones to
        # show the error.
        (a, _), (fine, _) = yield [
            _bisect(branch, segment, a, b, 40),
            _bisect(branch, segment, begin, end, 48, _is_step_finely),
        ]
        point = yield from correct_at(branch, segment, a)
        error = 2 * (fine - a)

    slope_rate = float(point.direction[-1, 0] / point.direction[axis, 0])
    return BranchEnd("end_earlier_strike", point, abs(error * slope_rate))


def _distance(point: Point, samples: int = _SAMPLES) -> Procedure[float]:
    """Distance of a corrected point from an earlier strike."""
    _, distances = yield Call(sampled_steps, (point.Z,), (("samples", samples),))
    return float(distances[0])


def _bisect(
    branch: Branch,
    segment: int,
    a: float,
    b: float,
    rounds: int,
    happens: Callable[[Point], Procedure[bool]] = is_step,
) -> Procedure[tuple[float, float]]:
    """Halve the interval between two coordinates of a segment, of which the step at the
    first happens.
    """
    for _ in range(rounds):
        middle = 0.5 * (a + b)
        point = yield from correct_at(branch, segment, middle)
        if point.ok[0] and (yield from happens(point)):
            a = middle
        else:
            b = middle

    return a, b


def _is_step_finely(point: Point) -> Procedure[bool]:
    """Whether a corrected point is a step that happens, by four times as many samples
    as settle a doubt.
    """
    finely = (("samples", 4 * _SAMPLES),)
    stride, _ = yield Call(sampled_steps, (point.Z,), finely)
    return bool(verified(stride).step[0])
