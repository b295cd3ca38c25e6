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
from gaitsweep.tasks.continuation.conditions import Condition
from gaitsweep.tasks.continuation.lockstep import Call, Procedure, run
from gaitsweep.tasks.continuation.pseudo_arclength import Point
from gaitsweep.tasks.continuation.root import root_search
from gaitsweep.tasks.continuation.tracking import check_steps, correct_and_evaluate
from gaitsweep.tasks.fixed_points.polish import Guesses, Polished, settle
from gaitsweep.tasks.mechanics.sums import total
from gaitsweep.tasks.step import extended_precision
from gaitsweep.tasks.step.lanes import lanes_of, replace_lanes
from gaitsweep.tasks.step.problem import EPS, Problem
from gaitsweep.tasks.step.several_steps import (
    AnyStride,
    distances_of_steps,
    from_largest,
)
from gaitsweep.tasks.step.verify_step import strike_distance

TestFunction = Callable[[Point], float | bool]


#: Splits of a segment on which an end or a fold lies, and the largest error of its
#: polynomial over its length.
_MAX_SPLITS, _MAX_PREDICTION_ERROR = 12, 1e-3
#: Farthest that Newton's method may move a guess of a branch, commonly by less than
#: 1e-5: beyond lie others' gaits.
_MAX_MOVE = 1e-4
#: Least distance of a gait's steps from each other, over that of its guess, and over
#: the first angle, that of rounding: nearer ones are those of a gait of fewer steps,
#: beside whose flip it lies.
_LEAST_SHARE, _LEAST_APART = 0.5, 1e-10
#: Error of a fold's ln slope up to which doubles locate it well enough.
_SHARP = 1e-13


def value_of(condition: Condition) -> Callable[[Point], float]:
    """Return how far a condition is from being fulfilled, as a test function."""
    return lambda point: float(condition.residual(point.at)[0])


def correct_at(branch: Branch, segment: int, x: float) -> Procedure[Point]:
    """Correct the point at coordinate x of a segment.

    Returns
    -------
    point : Point
        Of one lane, its tangent along the branch.
    """
    at = np.array([segment])
    direction = branch.between(at)
    point = yield Call(
        correct_and_evaluate, (branch.evaluate(at, np.array([x])), direction)
    )
    return point.oriented(direction)


def search_segment(
    search: Generator[float, float, float],
    branch: Branch,
    segment: int,
    test: Callable[..., Any],
) -> Procedure[float]:
    """Send a search for a root the values of a test function, or of a procedure, at
    corrected points of a segment.
    """
    x = next(search)
    while True:
        value = test((yield from correct_at(branch, segment, x)))
        if isinstance(value, Generator):
            value = yield from value
        try:
            x = search.send(value)
        except StopIteration as end:
            return float(end.value)


def locate_root(branch: Branch, segment: int, test: TestFunction) -> Procedure[Point]:
    """Locate the root of a test function on a segment over which it changes sign, to
    rounding.

    Returns
    -------
    point : Point
        Of one lane, its tangent along the branch.
    """
    a, b = branch.ends_of(np.array(segment)).tolist()
    try:
        root = yield from search_segment(
            root_search(a, b, 1e-15 * max(1.0, abs(a))), branch, segment, test
        )
    except ValueError:
        # The values at the nodes differ in sign by rounding only: the end nearer zero
        # is the root.
        at_a, at_b = (
            (yield from correct_at(branch, segment, a)),
            (yield from correct_at(branch, segment, b)),
        )
        root = a if abs(test(at_a)) < abs(test(at_b)) else b
    return (yield from correct_at(branch, segment, root))


def settle_on_branches(
    problem: Problem,
    guesses: Guesses,
    places: Sequence[tuple[Problem, Branch, np.ndarray]],
    accuracy: float = 0.0,
) -> Polished:
    """Settle guesses that lie on branches; those that Newton's method loses are first
    located along their branches.

    Steps that almost end in a fall make so much of a guess's error that at a fixed
    slope Newton's method diverges, or leads to another gait.

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
        # By all four nodes around; by its own two where the others mislead, as where
        # two of them all but coincide.
        for part, own in (
            (branch, segment),
            (branch.part(np.array([segment, segment + 1])), 0),
        ):
            point = run(walker, locate_root(part, own, beyond))
            if point.ok[0] and part.lies_between(np.array([own]), point.Z)[0]:
                again.w[:, i] = from_largest(point.at.w, branch.m, branch.steps)[:, 0]
                break
    located = settle(problem.some(lost), again, accuracy=accuracy)
    located.converged &= _is_near(problem, located, again.w)
    replace_lanes(gaits, lost, located)
    return gaits


@np.errstate(invalid="ignore", divide="ignore")
def _is_near(problem: Problem, at: Polished, w: np.ndarray) -> np.ndarray:
    """Whether gaits lie where Newton's method began and repeat no sooner, shape (n,)."""
    near = np.abs(at.w - w).max(axis=0) < _MAX_MOVE
    apart, guessed = (
        distances_of_steps(each, problem.m, problem.steps) for each in (at.w, w)
    )
    return np.asarray(
        near & (apart > np.maximum(_LEAST_SHARE * guessed, _LEAST_APART)).all(axis=0)
    )


def _beyond(q: float, point: Point) -> float:
    return float(point.at.q[0]) - q


def is_step(point: Point) -> Procedure[bool]:
    """Whether a corrected point is a step that happens."""
    check = yield Call(check_steps, (point.Z,))
    return bool(check.step[0])


def narrow_segment(
    branch: Branch, segment: int, like_left: Callable[[Point], bool | Procedure[bool]]
) -> Procedure[tuple[Branch, int]]:
    """Split a segment on which a property changes until its polynomial leads to this
    branch and to no other.

    Parameters
    ----------
    like_left : callable
        Whether a point has the property of the segment's left node; it may be a
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
        for part, at, share in (
            (branch, segment, 0.5),
            (alone, 0, 0.5),
            (alone, 0, 0.25),
            (alone, 0, 0.75),
        ):
            low, high = part.ends_of(np.array(at))
            x = float(low * (1 - share) + high * share)
            guess = part.evaluate(np.array([at]), np.array([x]))[:, 0]
            point = yield from correct_at(part, at, x)
            chord = np.linalg.norm(part.Z[:, at + 1] - part.Z[:, at])
            near = bool(
                np.linalg.norm(point.Z[:, 0] - guess) < _MAX_PREDICTION_ERROR * chord
            )
            if point.ok[0] and part.lies_between(np.array([at]), point.Z)[0]:
                break
        else:
            return branch, segment
        if near and part is branch:
            break
        branch = branch.insert(segment + 1, point.Z[:, 0], point.direction[:, 0])
        is_left = like_left(point)
        segment += (yield from is_left) if isinstance(is_left, Generator) else is_left
    return branch, segment


def sampled_steps(
    problem: Problem, Z: np.ndarray, samples: int
) -> tuple[AnyStride, np.ndarray]:
    """Evaluate the steps at points of branches with samples of their motion.

    Parameters
    ----------
    Z : ndarray, shape (c, n)
    samples : int
        Intervals of each phase.

    Returns
    -------
    stride : Stride
    distance : ndarray, shape (n,)
        From an earlier strike, as `strike_distance` has it.
    """
    stride, _ = problem.stride(Z[:-1], Z[-1], samples=samples)
    each = stride.singles
    distance = strike_distance(each.scaled_motion(), each.times)
    return stride, distance.reshape(stride.steps, -1).min(axis=0)


def sharpened_fold(point: Point) -> Procedure[Point]:
    """Correct the slope of a fold by its residual in more digits, where doubles leave
    it uncertain.

    Parameters
    ----------
    point : Point
        Of one lane.
    """
    derivative, stride = point.at.derivative[..., 0], point.at.stride
    # How far residuals of the joint equations, over the stance angle, move the ln slope
    # of a fold.
    least = np.linalg.svd(derivative[:, :-1])[0][:, -1]
    by_residual = -least / total(least * derivative[:, -1])
    y, image = np.abs([stride.y[:, 0], stride.image[:, 0]])
    rounded = (
        3 * EPS * np.append(y + image, np.full(len(derivative) - len(y), 2 * y[0]))
    )
    if total(np.abs(by_residual) * rounded) / y[0] < _SHARP:
        return point
    residual = yield Call(extended_precision.residual, (point.Z,))
    Z = point.Z.copy()
    Z[-1, 0] += total(by_residual * residual[:, 0])
    return replace(point, Z=Z)
