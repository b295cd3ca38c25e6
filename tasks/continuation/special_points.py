"""Special points of a branch, each the root of a smooth test function with the corrector in the loop.

Folds, flips, Neimark-Sacker and branch points; the ends of walking: heelstrike meets kneestrike, heelstrike turns
tangential, an earlier strike cuts in; and the release of the knee, where the branch goes on.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from tasks.continuation.branch import Branch
from tasks.continuation.root import bracketed_root
from tasks.continuation.tracking import Point, branch_point_determinant, correct
from tasks.fixed_points.rounding import rounding
from tasks.fixed_points.step_check import verify_steps
from tasks.step.problem import EPS, Problem
from tasks.step.step_map import SAMPLES
from tasks.step.verify_step import strike_distance

Test = Callable[[Point, np.ndarray], float | bool]
#: Splits of a segment on which an end or a fold lies, and how far off, over its length, the branch may be predicted.
MAX_SPLITS, LED = 12, 1e-3
#: Distance, over the segment, of the points a tangential end is read off.
SPACING = 4e-3


def oriented(point: Point, way: np.ndarray) -> np.ndarray:
    """The point's tangent, pointing along the branch."""
    tangent = point.tangent[:, 0]
    return tangent if tangent @ way >= 0 else -tangent


def correct_at(problem: Problem, branch: Branch, segment: int, x: float) -> tuple[Point, np.ndarray]:
    """The point of the branch at place x of a segment, and the branch's direction there."""
    m = branch.m
    Z = branch.evaluate(np.array([segment]), np.array([x]))
    way = branch.tangent[segment, : m + 1] + branch.tangent[segment + 1, : m + 1]
    way = way / np.linalg.norm(way)
    point = correct(problem, Z[:, : m + 1].T, Z[:, m + 1 :].T, way[:, None])
    # The corrector's stride is that before its last step; a test function wants the derivative at the point itself.
    again = correct(problem, point.X, point.times, way[:, None], most=1)
    again.ok = point.ok
    return again, way


def locate_root(problem: Problem, branch: Branch, segment: int, test: Test) -> tuple[Point, np.ndarray]:
    """The root of a test function on a segment over which it changes sign, to rounding."""
    axis = branch.axis[segment]
    a, b = branch.Z[segment, axis], branch.Z[segment + 1, axis]

    def value(x: float) -> float:
        return test(*correct_at(problem, branch, segment, x))

    try:
        root = bracketed_root(value, a, b, 1e-15 * max(1.0, abs(a)))
    except ValueError:
        # The nodes' own values differ in sign by rounding only: the end nearer zero is the root.
        root = a if abs(value(a)) < abs(value(b)) else b
    return correct_at(problem, branch, segment, root)


def _at_tangency(problem: Problem, branch: Branch, segment: int) -> tuple[Point, np.ndarray, float]:
    """Where heelstrike turns tangential on a segment, the branch's direction there, and the error of ln slope.

    At the point itself the event time has no derivative, though the branch is smooth. So it is read off polynomials
    through six points beside it; those through the inner four bound their error, a hundred times too wide.
    """
    test = ENDS["end_tangential_heelstrike"]
    axis = branch.axis[segment]
    a, b = branch.Z[segment, axis], branch.Z[segment + 1, axis]
    middle = bracketed_root(lambda x: test(*correct_at(problem, branch, segment, x)), a, b, 1e-3 * abs(b - a))
    h = SPACING * (b - a)
    places = np.array([-2.5, -1.5, -0.5, 0.5, 1.5, 2.5])
    points = [correct_at(problem, branch, segment, middle + h * p) for p in places]
    values = np.array([np.concatenate([row(p), row_tangent(p, way), [test(p, way)]]) for p, way in points])

    def at_root(among: slice) -> np.ndarray:
        coefficients = np.linalg.solve(np.vander(places[among]), values[among])
        roots = np.roots(coefficients[:, -1])
        root = roots[np.argmin(np.abs(roots))].real
        return np.vander([root], len(coefficients))[0] @ coefficients

    found, inner = at_root(slice(None)), at_root(slice(1, -1))
    point, way = points[2]
    m, k = branch.m, len(point.times)
    size = m + 1 + k
    found_point = replace(
        point,
        X=found[: m + 1, None],
        times=found[m + 1 : size, None],
        tangent=found[size : size + m + 1, None],
        times_tangent=found[size + m + 1 : -1, None],
    )
    return found_point, way, abs(float(inner[m] - found[m]))


def row(point: Point) -> np.ndarray:
    """One corrected point as a node of a branch."""
    return np.concatenate([point.X[:, 0], point.times[:, 0]])


def row_tangent(point: Point, way: np.ndarray) -> np.ndarray:
    """Its tangent, pointing along the branch."""
    tangent = np.concatenate([point.tangent[:, 0], point.times_tangent[:, 0]])
    return tangent if point.tangent[:, 0] @ way >= 0 else -tangent


def is_step(problem: Problem, point: Point) -> bool:
    """True where a corrected point is a step that really happens."""
    m = problem.m
    _, verdict = verify_steps(problem, np.vstack([point.X[:m], point.times]), point.X[m])
    return bool(verdict.step[0])


#: Test functions of the ends of walking.
ENDS: dict[str, Test] = {
    "end_kneestrike_at_heelstrike": lambda point, way: float(point.times[-1, 0] - point.times[0, 0]),
    "end_tangential_heelstrike": lambda point, way: float(point.stride.closing[0] / point.stride.y[0, 0]),
}


def narrowed(problem: Problem, branch: Branch, segment: int, like_left: Test) -> tuple[Branch, int]:
    """Split a segment where something changes until its polynomial leads to the branch and to no other.

    Parameters
    ----------
    like_left : callable
        Of a point and the branch's direction there: true where it is like the segment's left node.

    Returns
    -------
    Branch, int
        The branch with the nodes put in, and the segment of it on which the change lies.
    """
    for _ in range(MAX_SPLITS):
        alone = branch.part(segment, segment + 1)
        # By all four nodes around; by its own two, where those farther off lead astray.
        for part, at, share in ((branch, segment, 0.5), (alone, 0, 0.5), (alone, 0, 0.25), (alone, 0, 0.75)):
            x = part.Z[at : at + 2, part.axis[at]] @ [1 - share, share]
            guess = part.evaluate(np.array([at]), np.array([x]))[0, : branch.m + 1]
            point, way = correct_at(problem, part, at, x)
            chord = np.linalg.norm(np.diff(part.Z[at : at + 2, : branch.m + 1], axis=0))
            near = bool(np.linalg.norm(point.X[:, 0] - guess) < LED * chord)
            if point.ok[0] and part.lies_between(np.array([at]), point.X, point.times)[0]:
                break
        else:
            return branch, segment
        if near and part is branch:
            break
        branch = branch.inserted(segment + 1, row(point), row_tangent(point, way))
        segment += bool(like_left(point, way))
    return branch, segment


def end_of(problem: Problem, branch: Branch, good: int, bad: int) -> tuple[str, Point, np.ndarray, float]:
    """What ends walking between two neighbouring nodes, one a step and one none, and where.

    Returns
    -------
    kind : str
    point : Point
    way : ndarray
        Direction of the branch there.
    error : float
        Of ln slope, beyond rounding.
    """
    segment = min(good, bad)
    axis = branch.axis[segment]
    nodes = [correct_at(problem, branch, segment, branch.Z[i, axis]) for i in (good, bad)]
    found: list[tuple[float, str, Point, np.ndarray, float]] = []
    for kind, test in ENDS.items():
        if kind == "end_kneestrike_at_heelstrike" and problem.phases == 1:
            continue
        if test(*nodes[0]) * test(*nodes[1]) < 0:
            error = 0.0
            if kind == "end_tangential_heelstrike":
                point, way, error = _at_tangency(problem, branch, segment)
            else:
                point, way = locate_root(problem, branch, segment, test)
            apart = float(np.linalg.norm(point.X[:, 0] - branch.Z[good, : branch.m + 1]))
            found.append((apart, kind, point, way, error))
    if found:
        return min(found, key=lambda f: f[0])[1:]
    return "end_earlier_strike", *_at_earlier_strike(problem, branch, segment, good, bad)


def _at_earlier_strike(
    problem: Problem, branch: Branch, segment: int, good: int, bad: int
) -> tuple[Point, np.ndarray, float]:
    """Where an earlier strike cuts in on a segment: a guard's minimum on the way touches zero."""
    axis = branch.axis[segment]
    a, b = branch.Z[good, axis], branch.Z[bad, axis]

    def away(point: Point, way: np.ndarray, samples: int = 16 * SAMPLES) -> float:
        m = problem.m
        stride, _ = problem.stride(np.vstack([point.X[:m], point.times]), point.X[m], samples=samples)
        return float(strike_distance(stride.scaled_motion(), stride.times)[0])

    # The verdict tells where; near there the guard's minimum tells how near.
    for _ in range(8):
        middle = 0.5 * (a + b)
        point, way = correct_at(problem, branch, segment, middle)
        if point.ok[0] and is_step(problem, point):
            a = middle
        else:
            b = middle
    ends = [away(*correct_at(problem, branch, segment, x)) for x in (a, b)]
    if np.isfinite(ends).all() and ends[0] * ends[1] < 0:
        root = bracketed_root(lambda x: away(*correct_at(problem, branch, segment, x)), a, b, 1e-15 * max(1.0, abs(a)))
        point, way = correct_at(problem, branch, segment, root)
        # Half as many samples tell how far off the cubic's minimum is.
        error = abs(away(point, way, 8 * SAMPLES) / (ends[1] - ends[0]) * (b - a))
    else:
        for _ in range(40):
            middle = 0.5 * (a + b)
            point, way = correct_at(problem, branch, segment, middle)
            if point.ok[0] and is_step(problem, point):
                a = middle
            else:
                b = middle
        point, way = correct_at(problem, branch, segment, a)
        error = 0.0
    tangent = oriented(point, way)
    return point, way, abs(error * float(tangent[branch.m] / tangent[axis])) if axis <= branch.m else error


def _eigen_products(A: np.ndarray) -> np.ndarray:
    """Product over i < j of (lambda_i lambda_j - 1), shape (n,): zero where a pair lies on the unit circle."""
    # Where heelstrike is tangential to the last digit the map has no derivative.
    good = np.isfinite(A).all(axis=(-2, -1))
    values = np.full(A.shape[:-1], np.nan, complex)
    values[good] = np.linalg.eigvals(A[good])
    m = A.shape[-1]
    out = np.ones(A.shape[:-2], complex)
    for i in range(m):
        for j in range(i + 1, m):
            out *= values[..., i] * values[..., j] - 1
    return out.real


def _matrix(point: Point) -> np.ndarray:
    return np.moveaxis(point.stride.jacobian, -1, 0)


def _release(point: Point) -> np.ndarray:
    return (point.stride.start[4] - point.stride.start[5]) / point.stride.y[0]


# Where heelstrike is tangential to the last digit the map has no derivative.
@np.errstate(invalid="ignore")
def special_points(problem: Problem, branch: Branch) -> list[dict[str, float | str]]:
    """Every special point of a branch in its order, ends included.

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
    way = branch.tangent[:, : m + 1].T
    A = _matrix(nodes)
    tests: dict[str, tuple[np.ndarray, Test]] = {
        "fold": (branch.tangent[:, m], lambda p, w: float(oriented(p, w)[m])),
        "flip": (np.linalg.det(A + np.eye(m)), lambda p, w: float(np.linalg.det(_matrix(p) + np.eye(m))[0])),
        "neimark_sacker": (_eigen_products(A), lambda p, w: float(_eigen_products(_matrix(p))[0])),
        "branch_point": (
            branch_point_determinant(nodes, way),
            lambda p, w: float(branch_point_determinant(p, w[:, None])[0]),
        ),
    }
    if problem.phases == 2:
        tests["release_hyperextension"] = (_release(nodes), lambda p, w: float(_release(p)[0]))
    found: list[tuple[float, dict[str, float | str]]] = []
    for kind, (values, test) in tests.items():
        turned = np.sign(values[1:]) != np.sign(values[:-1])
        if kind == "fold":
            # Folds have nodes of their own, whose tangent's sign is rounding.
            turned = np.zeros(len(values) - 1, bool)
            for first, _ in branch.pieces()[1:]:
                found.append((float(first), _record("fold", problem, nodes, first)))
        if kind in ("flip", "neimark_sacker", "branch_point"):
            # The derivative has a pole where heelstrike turns tangential: that sign change is no root.
            turned[
                [i for i, why in ((0, branch.why[0]), (-1, branch.why[1])) if why == "end_tangential_heelstrike"]
            ] = False
        for segment in np.nonzero(turned & np.isfinite(values[1:]) & np.isfinite(values[:-1]))[0]:
            point, _ = locate_root(problem, branch, int(segment), test)
            if point.ok[0] and _is(kind, point):
                found.append((segment + 0.5, _record(kind, problem, point, 0)))
    for index, kind, error in zip((0, len(branch.Z) - 1), branch.why, branch.end_errors):
        record = _record(END_NAMES.get(kind, kind), problem, nodes, index)
        if kind == "end_tangential_heelstrike":
            # The point is read off its neighbours: the map's own derivative says nothing there.
            record["error_bound"] = error + 64 * EPS
        found.append((float(index), record))
    return [record for _, record in sorted(found, key=lambda f: f[0])]


#: How the ways a search can stop are named among special points.
END_NAMES = {
    "zero step length": "end_zero_step",
    "end of the window": "window",
    "no further point": "lost",
    "a fall": "end_fall",
}


def _is(kind: str, point: Point) -> bool:
    """True where a sign change of the test function is the point it stands for."""
    if not np.isfinite(_matrix(point)).all():
        return False
    values = np.linalg.eigvals(_matrix(point)[0])
    if kind == "flip":
        return bool(np.abs(values + 1).min() < 1e-6)
    if kind == "neimark_sacker":
        pair = values[np.abs(np.abs(values) - 1) < 1e-6]
        return len(pair) == 2 and bool(np.abs(pair.imag).min() > 1e-6)
    return True


def _at_fold(point: Point, lane: int) -> float:
    """Error of ln slope at a fold: rounding of the residual, seen along the only direction no section's change
    undoes."""
    by = point.derivative[lane]
    least = np.linalg.svd(by[:, :-1])[0][:, -1]
    rounded = 3 * EPS * np.abs(np.vstack([point.stride.y[:, lane], point.stride.image[:, lane]])).sum(axis=0)
    return float(np.abs(least) @ rounded / point.stride.y[0, lane] / abs(least @ by[:, -1]))


def _record(kind: str, problem: Problem, point: Point, lane: int) -> dict[str, float | str]:
    rounding_std = (
        _at_fold(point, lane)
        if kind == "fold"
        else float(np.nan_to_num(rounding(point.stride)[:, lane], nan=np.inf).max())
    )
    return {
        "kind": kind,
        "slope": float(np.exp(point.X[problem.m, lane])),
        "stance_angle": float(np.exp(point.X[0, lane])),
        "period": float(point.times[-1, lane]),
        "error_bound": rounding_std + 8 * EPS,
    }
