"""Points of a segment of a branch, and where a property changes on it.

All are procedures, which run side by side (`tasks.continuation.lockstep`).
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Generator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from gaitsweep.tasks.continuation.branch import Branch
from gaitsweep.tasks.continuation.defining import scalar
from gaitsweep.tasks.continuation.lockstep import Call, Procedure, lanes_of, run
from gaitsweep.tasks.continuation.root import root_search
from gaitsweep.tasks.continuation.tracking import Point, correct_and_evaluate
from gaitsweep.tasks.fixed_points.polish import Guesses, Polished, settle
from gaitsweep.tasks.fixed_points.step_check import verify_steps
from gaitsweep.tasks.step import extended_precision
from gaitsweep.tasks.step.problem import EPS, Problem
from gaitsweep.tasks.step.several_steps import AnyStride, distances_of_steps, from_largest
from gaitsweep.tasks.step.verify_step import StepCheck, strike_distance

TestFunction = Callable[[Point, np.ndarray], float | bool]


#: Splits of a segment on which an end or a fold lies, and the largest error of its polynomial over its length.
_MAX_SPLITS, _MAX_PREDICTION_ERROR = 12, 1e-3
#: Farthest that Newton's method may move a guess of a branch, commonly by less than 1e-5: beyond lie others' gaits.
_MAX_MOVE = 1e-4
#: Least distance of a gait's steps from each other, over that of its guess, and over the first angle, that of rounding:
#: nearer ones are those of a gait of fewer steps, beside whose flip it lies.
_LEAST_SHARE, _LEAST_APART = 0.5, 1e-10
#: Error of a fold's ln slope up to which doubles locate it well enough.
_SHARP = 1e-13


def test_function(kind: str) -> Callable[[Point, np.ndarray], float]:
    """Return the scalar of a kind of special point as a test function."""
    return lambda point, direction: float(scalar(kind, point)[0])


def oriented_tangent(point: Point, direction: np.ndarray) -> np.ndarray:
    """Return the tangent of X at a point, turned along the branch.

    Parameters
    ----------
    point : Point
        Of one lane.
    direction : ndarray, shape (m + 1 + k,)
        Of the branch there.

    Returns
    -------
    ndarray, shape (m + 1,)
    """
    return row_tangent(point, direction)[: len(point.X)]


def correct_at(branch: Branch, segment: int, x: float) -> Procedure[tuple[Point, np.ndarray]]:
    """Correct the point at coordinate x of a segment.

    Returns
    -------
    point : Point
        Of one lane.
    direction : ndarray, shape (m + 1 + k,)
        Of the branch there.
    """
    m = branch.m
    Z = branch.evaluate(np.array([segment]), np.array([x]))
    direction = branch.direction[segment] + branch.direction[segment + 1]
    direction = direction / np.linalg.norm(direction)
    point = yield Call(correct_and_evaluate, (Z[:, : m + 1].T, Z[:, m + 1 :].T, direction[:, None]))
    return point, direction


def search_segment(
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
    direction : ndarray, shape (m + 1 + k,)
        Of the branch there.
    """
    axis = branch.axis[segment]
    a, b = branch.Z[segment, axis], branch.Z[segment + 1, axis]

    try:
        root = yield from search_segment(root_search(a, b, 1e-15 * max(1.0, abs(a))), branch, segment, test)
    except ValueError:
        # The values at the nodes differ in sign by rounding only: the end nearer zero is the root.
        at_a, at_b = (yield from correct_at(branch, segment, a)), (yield from correct_at(branch, segment, b))
        root = a if abs(test(*at_a)) < abs(test(*at_b)) else b
    return (yield from correct_at(branch, segment, root))


def settle_on_branches(
    problem: Problem, guesses: Guesses, places: Sequence[tuple[Problem, Branch, np.ndarray]], accuracy: float = 0.0
) -> Polished:
    """Settle guesses that lie on branches; those that Newton's method loses are first located along their branches.

    Steps that almost end in a fall make so much of a guess's error that at a fixed slope Newton's method diverges, or
    leads to another gait.

    Parameters
    ----------
    problem : Problem
        Of the lanes of all guesses.
    guesses : Guesses
    places : sequence of (Problem, Branch, ndarray of int)
        Walkers, branches and the segments of their guesses, one after another.
    accuracy : float
        As for `settle`.
    """
    gaits = settle(problem, guesses, accuracy=accuracy)
    lost = np.flatnonzero(~(gaits.converged & _is_near(problem, gaits, guesses.w)))
    if not len(lost):
        return gaits
    again = lanes_of(guesses, lost)
    ends = np.cumsum([len(segment) for *_, segment in places])
    for i, lane in enumerate(lost.tolist()):
        number = int(np.searchsorted(ends, lane, side="right"))
        walker, branch, segments = places[number]
        segment = int(segments[lane - ends[number] + len(segments)])
        beyond = functools.partial(_beyond, np.log(guesses.slope[lane]))
        # By all four nodes around; by its own two where the others mislead, as where two of them all but coincide.
        for part, own in ((branch, segment), (branch.part(np.array([segment, segment + 1])), 0)):
            point, _ = run(walker, locate_root(part, own, beyond))
            if point.ok[0] and part.lies_between(np.array([own]), point.Z)[0]:
                again.w[:, i] = from_largest(point.w, branch.m, branch.steps)[:, 0]
                break
    located = settle(problem.some(lost), again, accuracy=accuracy)
    located.converged &= _is_near(problem, located, again.w)
    gaits.assign(lost, located)
    return gaits


@np.errstate(invalid="ignore", divide="ignore")
def _is_near(problem: Problem, at: Polished, w: np.ndarray) -> np.ndarray:
    """Whether gaits lie where Newton's method began and repeat no sooner, shape (n,)."""
    reached = np.vstack([np.log(at.y[:1] * at.scale), at.y[1:] / at.y[0], at.times])
    near = np.abs(reached - w).max(axis=0) < _MAX_MOVE
    apart, guessed = (distances_of_steps(each, problem.m, problem.steps) for each in (reached, w))
    return np.asarray(near & (apart > np.maximum(_LEAST_SHARE * guessed, _LEAST_APART)).all(axis=0))


def _beyond(q: float, point: Point, _: np.ndarray) -> float:
    return float(point.X[-1, 0]) - q


def row(point: Point) -> np.ndarray:
    """Return a corrected point as a node of a branch.

    Returns
    -------
    ndarray, shape (m + 1 + k,)
        A row of Z.
    """
    return point.Z[:, 0]


def row_tangent(point: Point, direction: np.ndarray) -> np.ndarray:
    """Return the tangent of a corrected point as that of a node.

    Parameters
    ----------
    point : Point
        Of one lane.
    direction : ndarray, shape (m + 1 + k,)
        Of the branch there.

    Returns
    -------
    ndarray, shape (m + 1 + k,)
        Pointing along the branch.
    """
    tangent = point.direction[:, 0]
    return tangent if tangent @ direction >= 0 else -tangent


def check_steps(problem: Problem, X: np.ndarray, times: np.ndarray) -> StepCheck:
    """Verify that points of branches are steps.

    Parameters
    ----------
    X, times : ndarray, shape (m + 1, n) and (k, n)
    """
    _, check = verify_steps(problem, np.vstack([X[: problem.m], times]), X[problem.m])
    return check


def is_step(point: Point) -> Procedure[bool]:
    """Whether a corrected point is a step that happens."""
    check = yield Call(check_steps, (point.X, point.times))
    return bool(check.step[0])


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
        alone = branch.part(np.array([segment, segment + 1]))
        # By all four nodes around; by its own two where the others mislead.
        for part, at, share in ((branch, segment, 0.5), (alone, 0, 0.5), (alone, 0, 0.25), (alone, 0, 0.75)):
            x = float(part.Z[at : at + 2, part.axis[at]] @ [1 - share, share])
            guess = part.evaluate(np.array([at]), np.array([x]))[0]
            point, direction = yield from correct_at(part, at, x)
            chord = np.linalg.norm(part.Z[at + 1] - part.Z[at])
            near = bool(np.linalg.norm(point.Z[:, 0] - guess) < _MAX_PREDICTION_ERROR * chord)
            if point.ok[0] and part.lies_between(np.array([at]), point.Z)[0]:
                break
        else:
            return branch, segment
        if near and part is branch:
            break
        branch = branch.insert(segment + 1, row(point), row_tangent(point, direction))
        is_left = like_left(point, direction)
        segment += (yield from is_left) if isinstance(is_left, Generator) else is_left
    return branch, segment


def strike_distances(problem: Problem, X: np.ndarray, times: np.ndarray, samples: int) -> np.ndarray:
    """Distances of the steps at points of branches from an earlier strike, as `strike_distance` has them.

    Parameters
    ----------
    X, times : ndarray, shape (m + 1, n) and (k, n)
    samples : int
        Intervals of each phase.

    Returns
    -------
    ndarray, shape (n,)
    """
    return sampled_steps(problem, X, times, samples)[1]


def sampled_steps(problem: Problem, X: np.ndarray, times: np.ndarray, samples: int) -> tuple[AnyStride, np.ndarray]:
    """Evaluate the steps at points of branches with samples of their motion.

    Parameters
    ----------
    X, times : ndarray, shape (m + 1, n) and (k, n)
    samples : int
        Intervals of each phase.

    Returns
    -------
    stride : Stride
    distance : ndarray, shape (n,)
        From an earlier strike, as `strike_distance` has it.
    """
    stride, _ = problem.stride(np.vstack([X[: problem.m], times]), X[problem.m], samples=samples)
    each = stride.singles
    distance = strike_distance(each.scaled_motion(), each.times)
    return stride, distance.reshape(stride.steps, -1).min(axis=0)


def _fold_covector(point: Point, lane: int) -> np.ndarray:
    """How far residuals of the joint equations, over the stance angle, move the ln slope of a fold, shape (m + k,)."""
    derivative, m = point.derivative[..., lane], len(point.X) - 1
    least = np.linalg.svd(np.delete(derivative, m, axis=1))[0][:, -1]
    return np.asarray(-least / (least @ derivative[:, m]))


def fold_error(point: Point, lane: int) -> float:
    """Error of ln slope at a fold: rounding of the residual along the singular direction of I - DP.

    Parameters
    ----------
    point : Point
        Of n lanes.
    lane : int
    """
    y, image = np.abs([point.stride.y[:, lane], point.stride.image[:, lane]])
    rounded = 3 * EPS * np.append(y + image, np.full(len(point.derivative) - len(y), 2 * y[0]))
    return float(np.abs(_fold_covector(point, lane)) @ rounded / y[0])


def sharpened_fold(point: Point) -> Procedure[Point]:
    """Correct the slope of a fold by its residual in more digits, where doubles leave it uncertain.

    Parameters
    ----------
    point : Point
        Of one lane.
    """
    if fold_error(point, 0) < _SHARP:
        return point
    residual = yield Call(extended_precision.residual, (point.X, point.times))
    X = point.X.copy()
    X[-1, 0] += _fold_covector(point, 0) @ residual[:, 0]
    return replace(point, X=X)
