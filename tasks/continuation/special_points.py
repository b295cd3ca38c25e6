"""Special points of a branch, each the root of a smooth test function that is evaluated at corrected points.

Folds, flips, Neimark-Sacker and branch points; the ends of walking, where heelstrike meets kneestrike, heelstrike turns
tangential or an earlier strike occurs; and the hyperextension of the released knee, beyond which the branch continues.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tasks.continuation.branch import Branch
from tasks.continuation.lockstep import Call, Procedure, side_by_side
from tasks.continuation.root import root_search
from tasks.continuation.tracking import Point, branch_point_determinant, correct
from tasks.fixed_points.rounding import rounding
from tasks.fixed_points.step_check import verify_steps
from tasks.step.problem import EPS, Problem
from tasks.step.step_map import SAMPLES, Stride
from tasks.step.verify_step import StepCheck, strike_distance

TestFunction = Callable[[Point, np.ndarray], float | bool]
#: Splits of a segment on which an end or a fold lies, and the largest error of its polynomial over its length.
_MAX_SPLITS, _MAX_PREDICTION_ERROR = 12, 1e-3
#: Spacing, over the segment, of the points from which a tangential end is extrapolated.
SPACING = 4e-3


@dataclass(frozen=True)
class BranchEnd:
    """Where walking ends on a branch: its kind, the point, the branch's direction there, and the error of ln slope."""

    kind: str
    point: Point
    direction: np.ndarray
    error: float


def oriented_tangent(point: Point, direction: np.ndarray) -> np.ndarray:
    """Return the tangent of X at a point, turned along the branch.

    Parameters
    ----------
    point : Point
        Of one lane.
    direction : ndarray, shape (m + 1,)
        Of the branch there.

    Returns
    -------
    ndarray, shape (m + 1,)
    """
    tangent = point.tangent[:, 0]
    return tangent if tangent @ direction >= 0 else -tangent


def correct_at(branch: Branch, segment: int, x: float) -> Procedure[tuple[Point, np.ndarray]]:
    """Correct the point at coordinate x of a segment.

    Returns
    -------
    point : Point
        Of one lane.
    direction : ndarray, shape (m + 1,)
        Of the branch there.
    """
    m = branch.m
    Z = branch.evaluate(np.array([segment]), np.array([x]))
    direction = branch.tangent[segment, : m + 1] + branch.tangent[segment + 1, : m + 1]
    direction = direction / np.linalg.norm(direction)
    point = yield Call(_correct_and_evaluate, (Z[:, : m + 1].T, Z[:, m + 1 :].T, direction[:, None]))
    return point, direction


def _correct_and_evaluate(problem: Problem, X: np.ndarray, times: np.ndarray, border: np.ndarray) -> Point:
    """Correct points; the corrector's derivative is that before its last step, this one's that at the point itself."""
    point = correct(problem, X, times, border)
    at_point = correct(problem, point.X, point.times, border, max_iterations=1)
    at_point.ok = point.ok
    return at_point


def _search(
    search: Generator[float, float, float], branch: Branch, segment: int, test: Callable[..., Any]
) -> Procedure[float]:
    """Send a search for a root the values of a test function, or of a procedure, at corrected points of a segment."""
    x = next(search)
    while True:
        value = test(*(yield from correct_at(branch, segment, x)))
        if isinstance(value, Generator):
            value = yield from value
        try:
            x = search.send(value)
        except StopIteration as end:
            return float(end.value)


def locate_root(branch: Branch, segment: int, test: TestFunction) -> Procedure[tuple[Point, np.ndarray]]:
    """Locate the root of a test function on a segment over which it changes sign, to rounding.

    Returns
    -------
    point : Point
        Of one lane.
    direction : ndarray, shape (m + 1,)
        Of the branch there.
    """
    axis = branch.axis[segment]
    a, b = branch.Z[segment, axis], branch.Z[segment + 1, axis]

    try:
        root = yield from _search(root_search(a, b, 1e-15 * max(1.0, abs(a))), branch, segment, test)
    except ValueError:
        # The values at the nodes differ in sign by rounding only: the end nearer zero is the root.
        at_a, at_b = (yield from correct_at(branch, segment, a)), (yield from correct_at(branch, segment, b))
        root = a if abs(test(*at_a)) < abs(test(*at_b)) else b
    return (yield from correct_at(branch, segment, root))


def _tangential_end(branch: Branch, segment: int) -> Procedure[BranchEnd]:
    """Locate where heelstrike turns tangential on a segment.

    At the point itself the event time has no derivative, though the branch is smooth. So it is interpolated by
    polynomials through six points beside it; those through the inner four bound their error, a hundred times too wide.
    """
    kind = "end_tangential_heelstrike"
    test = _ENDS[kind]
    axis = branch.axis[segment]
    a, b = branch.Z[segment, axis], branch.Z[segment + 1, axis]
    middle = yield from _search(root_search(a, b, 1e-3 * abs(b - a)), branch, segment, test)
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


def row(point: Point) -> np.ndarray:
    """Return a corrected point as a node of a branch.

    Returns
    -------
    ndarray, shape (m + 1 + k,)
        A row of Z.
    """
    return np.concatenate([point.X[:, 0], point.times[:, 0]])


def row_tangent(point: Point, direction: np.ndarray) -> np.ndarray:
    """Return the tangent of a corrected point as that of a node.

    Parameters
    ----------
    point : Point
        Of one lane.
    direction : ndarray, shape (m + 1,)
        Of the branch there.

    Returns
    -------
    ndarray, shape (m + 1 + k,)
        Pointing along the branch.
    """
    tangent = np.concatenate([point.tangent[:, 0], point.times_tangent[:, 0]])
    return tangent if point.tangent[:, 0] @ direction >= 0 else -tangent


def check_steps(problem: Problem, X: np.ndarray, times: np.ndarray) -> StepCheck:
    """Verify that points of a branch are steps: `verify_steps` at X (m + 1, n) and times (k, n)."""
    _, check = verify_steps(problem, np.vstack([X[: problem.m], times]), X[problem.m])
    return check


def is_step(point: Point) -> Procedure[bool]:
    """Whether a corrected point is a step that happens."""
    check = yield Call(check_steps, (point.X, point.times))
    return bool(check.step[0])


#: Test functions of the ends of walking.
_ENDS: dict[str, TestFunction] = {
    "end_kneestrike_at_heelstrike": lambda point, direction: float(point.times[-1, 0] - point.times[0, 0]),
    "end_tangential_heelstrike": lambda point, direction: float(point.stride.closing[0] / point.stride.y[0, 0]),
}


def narrow_segment(
    branch: Branch, segment: int, like_left: Callable[[Point, np.ndarray], bool | Procedure[bool]]
) -> Procedure[tuple[Branch, int]]:
    """Split a segment on which a property changes until its polynomial leads to this branch and to no other.

    Parameters
    ----------
    like_left : callable
        Whether a point, with the branch's direction there, has the property of the segment's left node; it may be a
        procedure.

    Returns
    -------
    branch : Branch
        With the new nodes.
    segment : int
        Number of its segment on which the change lies.
    """
    for _ in range(_MAX_SPLITS):
        alone = branch.part(segment, segment + 1)
        # By all four nodes around; by its own two where the others mislead.
        for part, at, share in ((branch, segment, 0.5), (alone, 0, 0.5), (alone, 0, 0.25), (alone, 0, 0.75)):
            x = float(part.Z[at : at + 2, part.axis[at]] @ [1 - share, share])
            guess = part.evaluate(np.array([at]), np.array([x]))[0, : branch.m + 1]
            point, direction = yield from correct_at(part, at, x)
            chord = np.linalg.norm(np.diff(part.Z[at : at + 2, : branch.m + 1], axis=0))
            near = bool(np.linalg.norm(point.X[:, 0] - guess) < _MAX_PREDICTION_ERROR * chord)
            if point.ok[0] and part.lies_between(np.array([at]), point.X, point.times)[0]:
                break
        else:
            return branch, segment
        if near and part is branch:
            break
        branch = branch.insert(segment + 1, row(point), row_tangent(point, direction))
        is_left = like_left(point, direction)
        segment += (yield from is_left) if isinstance(is_left, Generator) else is_left
    return branch, segment


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


def strike_distances(problem: Problem, X: np.ndarray, times: np.ndarray, samples: int) -> np.ndarray:
    """Distances of the steps at points of branches from an earlier strike: `strike_distance` at X (m + 1, n)."""
    return sampled_steps(problem, X, times, samples)[1]


def sampled_steps(problem: Problem, X: np.ndarray, times: np.ndarray, samples: int) -> tuple[Stride, np.ndarray]:
    """Evaluate steps with samples of their motion, and their `strike_distance`, at X (m + 1, n) and times (k, n)."""
    stride, _ = problem.stride(np.vstack([X[: problem.m], times]), X[problem.m], samples=samples)
    return stride, strike_distance(stride.scaled_motion(), stride.times)


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
        root = yield from _search(root_search(a, b, 1e-15 * max(1.0, abs(a))), branch, segment, distance)
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


def _eigen_products(A: np.ndarray) -> np.ndarray:
    """Product over i < j of (lambda_i lambda_j - 1), shape (n,): zero where a pair lies on the unit circle."""
    # Where heelstrike is tangential to the last digit the map has no derivative.
    finite = np.isfinite(A).all(axis=(-2, -1))
    values = np.full(A.shape[:-1], np.nan, complex)
    values[finite] = np.linalg.eigvals(A[finite])
    m = A.shape[-1]
    out = np.ones(A.shape[:-2], complex)
    for i in range(m):
        for j in range(i + 1, m):
            out *= values[..., i] * values[..., j] - 1
    return out.real


def _jacobians(point: Point) -> np.ndarray:
    """Jacobians of the step map, shape (n, m, m)."""
    return np.moveaxis(point.stride.jacobian, -1, 0)


def _release_rate(point: Point) -> np.ndarray:
    """Rate of the knee's flexion just after its release, over the stance angle, shape (n,)."""
    return (point.stride.start[4] - point.stride.start[5]) / point.stride.y[0]


# Where heelstrike is tangential to the last digit the map has no derivative.
@np.errstate(invalid="ignore")
def special_points(problem: Problem, branch: Branch) -> list[dict[str, float | str]]:
    """Locate every special point of a branch, in order along it, its ends included.

    Returns
    -------
    list of dict
        `kind`, `slope` [rad], `stance_angle` [rad], `period` [sqrt(leg/g)], `error_bound` (relative, of the slope).
    """
    m = branch.m
    X, times = branch.Z[:, : m + 1].T, branch.Z[:, m + 1 :].T
    nodes = correct(
        problem, X, times, branch.tangent[:, : m + 1].T / np.linalg.norm(branch.tangent[:, : m + 1], axis=1)
    )
    direction = branch.tangent[:, : m + 1].T
    A = _jacobians(nodes)
    tests: dict[str, tuple[np.ndarray, TestFunction]] = {
        "fold": (branch.tangent[:, m], lambda p, w: float(oriented_tangent(p, w)[m])),
        "flip": (np.linalg.det(A + np.eye(m)), lambda p, w: float(np.linalg.det(_jacobians(p) + np.eye(m))[0])),
        "neimark_sacker": (_eigen_products(A), lambda p, w: float(_eigen_products(_jacobians(p))[0])),
        "branch_point": (
            branch_point_determinant(nodes, direction),
            lambda p, w: float(branch_point_determinant(p, w[:, None])[0]),
        ),
    }
    if problem.phases == 2:
        tests["release_hyperextension"] = (_release_rate(nodes), lambda p, w: float(_release_rate(p)[0]))
    records: list[tuple[float, dict[str, float | str]]] = []
    crossed: list[tuple[str, int, Procedure[tuple[Point, np.ndarray]]]] = []
    for kind, (values, test) in tests.items():
        crosses = np.sign(values[1:]) != np.sign(values[:-1])
        if kind == "fold":
            # Folds have nodes of their own, where the sign of the tangent is that of rounding.
            crosses = np.zeros(len(values) - 1, bool)
            for first, _ in branch.pieces()[1:]:
                records.append((float(first), _record("fold", problem, nodes, first)))
        if kind in ("flip", "neimark_sacker", "branch_point"):
            # The derivative has a pole where heelstrike turns tangential: that sign change is no root.
            for i in (0, -1):
                crosses[i] &= branch.why[i] != "end_tangential_heelstrike"
        crossed += [
            (kind, int(i), locate_root(branch, int(i), test))
            for i in np.nonzero(crosses & np.isfinite(values[1:]) & np.isfinite(values[:-1]))[0]
        ]
    located = side_by_side(problem, [0] * len(crossed), [procedure for *_, procedure in crossed])
    for (kind, segment, _), (point, _) in zip(crossed, located, strict=True):
        if point.ok[0] and _is_genuine(kind, point):
            records.append((segment + 0.5, _record(kind, problem, point, 0)))
    for index, kind, error in zip((0, len(branch.Z) - 1), branch.why, branch.end_errors, strict=True):
        record = _record(END_NAMES.get(kind, kind), problem, nodes, index)
        if kind == "end_tangential_heelstrike":
            # The point is interpolated: the map has no derivative there that could bound its error.
            record["error_bound"] = error + 64 * EPS
        records.append((float(index), record))
    return [record for _, record in sorted(records, key=lambda entry: entry[0])]


#: Names among special points of the reasons for which a branch is followed no further.
END_NAMES = {
    "zero step length": "end_zero_step",
    "end of the window": "window",
    "no further point": "lost",
    "a fall": "end_fall",
}


def _is_genuine(kind: str, point: Point) -> bool:
    """Whether a sign change of the test function is a special point of its kind."""
    if not np.isfinite(_jacobians(point)).all():
        return False
    values = np.linalg.eigvals(_jacobians(point)[0])
    if kind == "flip":
        return bool(np.abs(values + 1).min() < 1e-6)
    if kind == "neimark_sacker":
        pair = values[np.abs(np.abs(values) - 1) < 1e-6]
        return len(pair) == 2 and bool(np.abs(pair.imag).min() > 1e-6)
    return True


def _fold_error(point: Point, lane: int) -> float:
    """Error of ln slope at a fold: rounding of the residual along the singular direction of I - DP."""
    derivative = point.derivative[..., lane]
    least = np.linalg.svd(derivative[:, :-1])[0][:, -1]
    rounded = 3 * EPS * np.abs(np.vstack([point.stride.y[:, lane], point.stride.image[:, lane]])).sum(axis=0)
    return float(np.abs(least) @ rounded / point.stride.y[0, lane] / abs(least @ derivative[:, -1]))


def _record(kind: str, problem: Problem, point: Point, lane: int) -> dict[str, float | str]:
    if kind == "fold":
        error = _fold_error(point, lane)
    else:
        error = float(np.nan_to_num(rounding(point.stride)[:, lane], nan=np.inf).max())
    return {
        "kind": kind,
        "slope": float(np.exp(point.X[problem.m, lane])),
        "stance_angle": float(np.exp(point.X[0, lane])),
        "period": float(point.times[-1, lane]),
        "error_bound": error + 8 * EPS,
    }
