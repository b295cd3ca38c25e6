"""Ends of walking on a branch: heelstrike meets kneestrike or turns tangential, or an earlier strike occurs."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tasks.continuation.branch import Branch
from tasks.continuation.locate import (
    TestFunction,
    correct_at,
    is_step,
    locate_root,
    oriented_tangent,
    row,
    row_tangent,
    search_segment,
    strike_distances,
)
from tasks.continuation.lockstep import Call, Procedure
from tasks.continuation.root import root_search
from tasks.continuation.tracking import Point
from tasks.step.step_map import SAMPLES

#: Spacing, over the segment, of the points from which a tangential end is extrapolated.
SPACING = 4e-3


@dataclass(frozen=True)
class BranchEnd:
    """Where walking ends on a branch: its kind, the point, the branch's direction there, and the error of ln slope."""

    kind: str
    point: Point
    direction: np.ndarray
    error: float


#: Test functions of the ends of walking.
_ENDS: dict[str, TestFunction] = {
    "end_kneestrike_at_heelstrike": lambda point, direction: float(point.times[-1, 0] - point.times[0, 0]),
    "end_tangential_heelstrike": lambda point, direction: float(point.stride.closing[0] / point.stride.y[0, 0]),
}


def locate_end(branch: Branch, good: int, bad: int) -> Procedure[BranchEnd]:
    """Locate the end of walking between two neighbouring nodes, of which `good` is a step and `bad` is none."""
    segment = min(good, bad)
    axis = branch.axis[segment]
    at_good = yield from correct_at(branch, segment, branch.Z[good, axis])
    at_bad = yield from correct_at(branch, segment, branch.Z[bad, axis])
    ends: list[tuple[float, BranchEnd]] = []
    for kind, test in _ENDS.items():
        if kind == "end_kneestrike_at_heelstrike" and len(at_good[0].times) == 1:
            continue
        if test(*at_good) * test(*at_bad) < 0:
            if kind == "end_tangential_heelstrike":
                end = yield from _tangential_end(branch, segment)
            else:
                end = BranchEnd(kind, *(yield from locate_root(branch, segment, test)), 0.0)
            distance = float(np.linalg.norm(end.point.X[:, 0] - branch.Z[good, : branch.m + 1]))
            ends.append((distance, end))
    if ends:
        return min(ends, key=lambda end: end[0])[1]
    return (yield from _earlier_strike_end(branch, segment, good, bad))


def _tangential_end(branch: Branch, segment: int) -> Procedure[BranchEnd]:
    """Locate where heelstrike turns tangential on a segment.

    At the point itself the event time has no derivative, though the branch is smooth. So it is interpolated by
    polynomials through six points beside it; those through the inner four bound their error, a hundred times too wide.
    """
    kind = "end_tangential_heelstrike"
    test = _ENDS[kind]
    axis = branch.axis[segment]
    a, b = branch.Z[segment, axis], branch.Z[segment + 1, axis]
    middle = yield from search_segment(root_search(a, b, 1e-3 * abs(b - a)), branch, segment, test)
    h = SPACING * (b - a)
    offsets = np.array([-2.5, -1.5, -0.5, 0.5, 1.5, 2.5])
    points = []
    for offset in offsets:
        points.append((yield from correct_at(branch, segment, float(middle + h * offset))))
    values = np.array(
        [np.concatenate([row(p), row_tangent(p, direction), [test(p, direction)]]) for p, direction in points]
    )

    def at_root(among: slice) -> np.ndarray:
        coefficients = np.linalg.solve(np.vander(offsets[among]), values[among])
        roots = np.roots(coefficients[:, -1])
        root = roots[np.argmin(np.abs(roots))].real
        return np.vander([root], len(coefficients))[0] @ coefficients

    node, inner = at_root(slice(None)), at_root(slice(1, -1))
    point, direction = points[2]
    m, k = branch.m, len(point.times)
    size = m + 1 + k
    point = replace(
        point,
        X=node[: m + 1, None],
        times=node[m + 1 : size, None],
        tangent=node[size : size + m + 1, None],
        times_tangent=node[size + m + 1 : -1, None],
    )
    return BranchEnd(kind, point, direction, abs(float(inner[m] - node[m])))


def _earlier_strike_end(branch: Branch, segment: int, good: int, bad: int) -> Procedure[BranchEnd]:
    """Locate where an earlier strike occurs on a segment: a minimum of a guard touches zero."""
    axis = branch.axis[segment]
    a, b = branch.Z[good, axis], branch.Z[bad, axis]

    def distance(point: Point, direction: np.ndarray, samples: int = 16 * SAMPLES) -> Procedure[float]:
        distances = yield Call(strike_distances, (point.X, point.times), (("samples", samples),))
        return float(distances[0])

    def bisect(a: float, b: float, rounds: int) -> Procedure[tuple[float, float]]:
        for _ in range(rounds):
            middle = 0.5 * (a + b)
            point, _ = yield from correct_at(branch, segment, middle)
            if point.ok[0] and (yield from is_step(point)):
                a = middle
            else:
                b = middle
        return a, b

    # Bisection by whether the step happens brackets the point; the guard's minimum is smooth only near it.
    a, b = yield from bisect(a, b, 8)
    at_a = yield from distance(*(yield from correct_at(branch, segment, a)))
    at_b = yield from distance(*(yield from correct_at(branch, segment, b)))
    if np.isfinite([at_a, at_b]).all() and at_a * at_b < 0:
        root = yield from search_segment(root_search(a, b, 1e-15 * max(1.0, abs(a))), branch, segment, distance)
        point, direction = yield from correct_at(branch, segment, root)
        # The value at half as many samples shows the error of the cubic's minimum.
        error = abs((yield from distance(point, direction, 8 * SAMPLES)) / (at_b - at_a) * (b - a))
    else:
        a, b = yield from bisect(a, b, 40)
        point, direction = yield from correct_at(branch, segment, a)
        error = 0.0
    tangent = oriented_tangent(point, direction)
    if axis <= branch.m:
        error = abs(error * float(tangent[branch.m] / tangent[axis]))
    return BranchEnd("end_earlier_strike", point, direction, error)
