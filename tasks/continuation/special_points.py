"""Special points of a branch, each the root of a smooth test function that is evaluated at corrected points.

Folds, flips, Neimark-Sacker and branch points; the ends of walking, where heelstrike meets kneestrike, heelstrike turns
tangential or an earlier strike occurs; and the hyperextension of the released knee, beyond which the branch continues.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from tasks.continuation.branch import Branch
from tasks.continuation.root import bracketed_root
from tasks.continuation.tracking import Point, branch_point_determinant, correct
from tasks.fixed_points.rounding import rounding
from tasks.fixed_points.step_check import verify_steps
from tasks.step.problem import EPS, Problem
from tasks.step.step_map import SAMPLES
from tasks.step.verify_step import strike_distance

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


def correct_at(problem: Problem, branch: Branch, segment: int, x: float) -> tuple[Point, np.ndarray]:
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
    point = correct(problem, Z[:, : m + 1].T, Z[:, m + 1 :].T, direction[:, None])
    # The corrector's derivative is that before its last step; a test function needs it at the point itself.
    at_point = correct(problem, point.X, point.times, direction[:, None], max_iterations=1)
    at_point.ok = point.ok
    return at_point, direction


def locate_root(problem: Problem, branch: Branch, segment: int, test: TestFunction) -> tuple[Point, np.ndarray]:
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

    def value(x: float) -> float:
        return test(*correct_at(problem, branch, segment, x))

    try:
        root = bracketed_root(value, a, b, 1e-15 * max(1.0, abs(a)))
    except ValueError:
        # The values at the nodes differ in sign by rounding only: the end nearer zero is the root.
        root = a if abs(value(a)) < abs(value(b)) else b
    return correct_at(problem, branch, segment, root)


def _tangential_end(problem: Problem, branch: Branch, segment: int) -> BranchEnd:
    """Locate where heelstrike turns tangential on a segment.

    At the point itself the event time has no derivative, though the branch is smooth. So it is interpolated by
    polynomials through six points beside it; those through the inner four bound their error, a hundred times too wide.
    """
    kind = "end_tangential_heelstrike"
    test = _ENDS[kind]
    axis = branch.axis[segment]
    a, b = branch.Z[segment, axis], branch.Z[segment + 1, axis]
    middle = bracketed_root(lambda x: test(*correct_at(problem, branch, segment, x)), a, b, 1e-3 * abs(b - a))
    h = SPACING * (b - a)
    offsets = np.array([-2.5, -1.5, -0.5, 0.5, 1.5, 2.5])
    points = [correct_at(problem, branch, segment, float(middle + h * offset)) for offset in offsets]
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


def is_step(problem: Problem, point: Point) -> bool:
    """Whether a corrected point is a step that happens."""
    m = problem.m
    _, check = verify_steps(problem, np.vstack([point.X[:m], point.times]), point.X[m])
    return bool(check.step[0])


#: Test functions of the ends of walking.
_ENDS: dict[str, TestFunction] = {
    "end_kneestrike_at_heelstrike": lambda point, direction: float(point.times[-1, 0] - point.times[0, 0]),
    "end_tangential_heelstrike": lambda point, direction: float(point.stride.closing[0] / point.stride.y[0, 0]),
}


def narrow_segment(problem: Problem, branch: Branch, segment: int, like_left: TestFunction) -> tuple[Branch, int]:
    """Split a segment on which a property changes until its polynomial leads to this branch and to no other.

    Parameters
    ----------
    like_left : callable
        Whether a point, with the branch's direction there, has the property of the segment's left node.

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
            point, direction = correct_at(problem, part, at, x)
            chord = np.linalg.norm(np.diff(part.Z[at : at + 2, : branch.m + 1], axis=0))
            near = bool(np.linalg.norm(point.X[:, 0] - guess) < _MAX_PREDICTION_ERROR * chord)
            if point.ok[0] and part.lies_between(np.array([at]), point.X, point.times)[0]:
                break
        else:
            return branch, segment
        if near and part is branch:
            break
        branch = branch.insert(segment + 1, row(point), row_tangent(point, direction))
        segment += bool(like_left(point, direction))
    return branch, segment


def locate_end(problem: Problem, branch: Branch, good: int, bad: int) -> BranchEnd:
    """Locate the end of walking between two neighbouring nodes, of which `good` is a step and `bad` is none."""
    segment = min(good, bad)
    axis = branch.axis[segment]
    nodes = [correct_at(problem, branch, segment, branch.Z[i, axis]) for i in (good, bad)]
    ends: list[tuple[float, BranchEnd]] = []
    for kind, test in _ENDS.items():
        if kind == "end_kneestrike_at_heelstrike" and problem.phases == 1:
            continue
        if test(*nodes[0]) * test(*nodes[1]) < 0:
            if kind == "end_tangential_heelstrike":
                end = _tangential_end(problem, branch, segment)
            else:
                end = BranchEnd(kind, *locate_root(problem, branch, segment, test), 0.0)
            distance = float(np.linalg.norm(end.point.X[:, 0] - branch.Z[good, : branch.m + 1]))
            ends.append((distance, end))
    if ends:
        return min(ends, key=lambda end: end[0])[1]
    return _earlier_strike_end(problem, branch, segment, good, bad)


def _earlier_strike_end(problem: Problem, branch: Branch, segment: int, good: int, bad: int) -> BranchEnd:
    """Locate where an earlier strike occurs on a segment: a minimum of a guard touches zero."""
    axis = branch.axis[segment]
    a, b = branch.Z[good, axis], branch.Z[bad, axis]

    def distance(point: Point, direction: np.ndarray, samples: int = 16 * SAMPLES) -> float:
        m = problem.m
        stride, _ = problem.stride(np.vstack([point.X[:m], point.times]), point.X[m], samples=samples)
        return float(strike_distance(stride.scaled_motion(), stride.times)[0])

    def bisect(a: float, b: float, rounds: int) -> tuple[float, float]:
        for _ in range(rounds):
            middle = 0.5 * (a + b)
            point, _ = correct_at(problem, branch, segment, middle)
            if point.ok[0] and is_step(problem, point):
                a = middle
            else:
                b = middle
        return a, b

    # Bisection by whether the step happens brackets the point; the guard's minimum is smooth only near it.
    a, b = bisect(a, b, 8)
    ends = [distance(*correct_at(problem, branch, segment, x)) for x in (a, b)]
    if np.isfinite(ends).all() and ends[0] * ends[1] < 0:
        root = bracketed_root(
            lambda x: distance(*correct_at(problem, branch, segment, x)), a, b, 1e-15 * max(1.0, abs(a))
        )
        point, direction = correct_at(problem, branch, segment, root)
        # The value at half as many samples shows the error of the cubic's minimum.
        error = abs(distance(point, direction, 8 * SAMPLES) / (ends[1] - ends[0]) * (b - a))
    else:
        a, b = bisect(a, b, 40)
        point, direction = correct_at(problem, branch, segment, a)
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
        for segment in np.nonzero(crosses & np.isfinite(values[1:]) & np.isfinite(values[:-1]))[0]:
            point, _ = locate_root(problem, branch, int(segment), test)
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
    derivative = point.derivative[lane]
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
