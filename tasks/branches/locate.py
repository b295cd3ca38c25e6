"""Points of a segment of a branch, and where a property changes on it.

All are procedures, which run side by side (`tasks.branches.lockstep`).
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy import ndarray

from gaitsweep.tasks.branches.branch import Branch
from gaitsweep.tasks.branches.conditions import Condition
from gaitsweep.tasks.branches.lockstep import Call, Procedure, run
from gaitsweep.tasks.branches.pseudo_arclength import Point
from gaitsweep.tasks.branches.root import root_search
from gaitsweep.tasks.branches.tracking import check_steps, correct_and_evaluate
from gaitsweep.tasks.gaits.polish import (
    Guesses,
    Polished,
    are_same,
    settle,
)
from gaitsweep.tasks.mechanics.arrays import Coordinates, Numbers, Unknowns
from gaitsweep.tasks.mechanics.sums import total
from gaitsweep.tasks.step import extended_precision
from gaitsweep.tasks.step.lanes import lanes_of, replace_lanes
from gaitsweep.tasks.step.problem import EPS, Problem
from gaitsweep.tasks.step.sameness import ON_BRANCH, same
from gaitsweep.tasks.step.several_steps import (
    AnyStride,
    distances_of_steps,
    from_largest,
)
from gaitsweep.tasks.step.verify_step import strike_distance

#: A number or a truth value of corrected points, or a procedure that returns one.
TestFunction = Callable[[Point], Any]


#: Splits of a segment on which an end or a fold lies, and the largest error of its
#: polynomial over its length.
_MAX_SPLITS, _MAX_PREDICTION_ERROR = 12, 1e-3

#: Least distance of a gait's steps from each other, over that of its guess, and over
#: the first angle, that of rounding: nearer ones are those of a gait of fewer steps,
#: beside whose flip it lies.
_LEAST_SHARE, _LEAST_APART = 0.5, 1e-10
#: Distance in ln slope from a fold within which both pieces may lead to one gait.
_BESIDE_FOLD = 1e-10
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
    segments = np.array([segment])
    Z = branch.evaluate(segments, np.array([x]))
    direction = branch.between(segments)
    point = yield Call(correct_and_evaluate, (Z, direction))
    return point.oriented(direction)


def search_segment(
    branch: Branch, segment: int, a: float, b: float, test: TestFunction
) -> Procedure[float]:
    """Find the root of a test function, or of a procedure, between two coordinates of a
    segment, to rounding.

    Raises
    ------
    ValueError
        Where it has the same sign at both.
    """
    search = root_search(a, b, 1e-15 * max(1.0, abs(a)))
    x = next(search)
    while True:
        point = yield from correct_at(branch, segment, x)
        value = yield from _outcome(test(point))
        try:
            x = search.send(value)
        except StopIteration as end:
            return float(end.value)


def _outcome(value: Any) -> Procedure[Any]:
    """The value of a test function; of one that is a procedure what it returns."""
    if isinstance(value, Generator):
        value = yield from value
    return value


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
        root = yield from search_segment(branch, segment, a, b, test)
    except ValueError:
        # The values at the nodes differ in sign by rounding only: the end nearer zero
        # is the root.
        at_a = yield from correct_at(branch, segment, a)
        at_b = yield from correct_at(branch, segment, b)
        root = a if abs(test(at_a)) < abs(test(at_b)) else b

    return (yield from correct_at(branch, segment, root))


def settle_on_branches(
    problem: Problem,
    guesses: Guesses,
    places: Sequence[tuple[Problem, Branch, ndarray]],
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
    settled = gaits.converged & _is_near(problem, gaits, guesses.w)
    lost = np.flatnonzero(~settled)
    if len(lost):
        again = _located_guesses(guesses, lost, places)
        located = settle(problem.some(lost), again, accuracy=accuracy)
        located.converged &= _is_near(problem, located, again.w)
        replace_lanes(gaits, lost, located)

    _lose_twins(gaits, guesses, places)
    return gaits


def _located_guesses(
    guesses: Guesses,
    lost: Numbers,
    places: Sequence[tuple[Problem, Branch, ndarray]],
) -> Guesses:
    """Guesses of some lanes (k,), located along their branches where these lead to them."""
    again = lanes_of(guesses, lost)
    ends = np.cumsum([len(segments) for *_, segments in places])
    for i, lane in enumerate(lost.tolist()):
        number = int(np.searchsorted(ends, lane, side="right"))
        walker, branch, segments = places[number]
        first = ends[number] - len(segments)
        segment = int(segments[lane - first])
        q = np.log(guesses.slope[lane])
        point = run(walker, _point_at_slope(branch, segment, q))
        if point is not None:
            w = from_largest(point.at.w, branch.m, branch.steps)
            again.w[:, i] = w[:, 0]

    return again


def _lose_twins(
    gaits: Polished,
    guesses: Guesses,
    places: Sequence[tuple[Problem, Branch, ndarray]],
) -> None:
    """Count as lost what Newton's method led to twice: within rounding of a fold the
    guesses of the two pieces that meet there may lead to one gait. The other one, whose
    guess was farther from it, is not found.
    """
    for lanes in _beside_folds(gaits, guesses, places):
        moved = np.abs(gaits.w[:, lanes] - guesses.w[:, lanes]).max(axis=0)
        kept: list[int] = []
        for lane in lanes[np.argsort(moved, kind="stable")].tolist():
            found = lanes_of(gaits, np.array([lane]))
            known = lanes_of(gaits, np.array(kept, int))
            if are_same(found, known).any():
                gaits.converged[lane] = False
            else:
                kept.append(lane)


def _beside_folds(
    gaits: Polished,
    guesses: Guesses,
    places: Sequence[tuple[Problem, Branch, ndarray]],
) -> list[ndarray]:
    """Lanes of the gaits of one branch and slope, within rounding of a fold, that have
    converged.
    """
    groups: dict[tuple[int, float], list[int]] = {}
    begin = 0
    for _, branch, segments in places:
        lanes = np.arange(begin, begin + len(segments))
        begin += len(segments)
        folds = branch.q[branch.folds()]
        apart = np.abs(np.log(guesses.slope[lanes])[:, None] - folds)
        near = (apart < _BESIDE_FOLD).any(axis=1) & gaits.converged[lanes]
        for lane in lanes[near].tolist():
            group = id(branch), float(guesses.slope[lane])
            groups.setdefault(group, []).append(lane)

    return [np.array(lanes) for lanes in groups.values()]


def _point_at_slope(branch: Branch, segment: int, q: float) -> Procedure[Point | None]:
    """The point of a segment at a value of ln slope, located along it; None where it
    leads off the branch.
    """

    def beyond(point: Point) -> float:
        return float(point.at.q[0]) - q

    for part, number in _polynomials(branch, segment):
        point = yield from locate_root(part, number, beyond)
        if _is_on(part, number, point):
            return point

    return None


def _polynomials(branch: Branch, segment: int) -> list[tuple[Branch, int]]:
    """Branches, and numbers of their segments, whose polynomials may lead to points of
    a segment: by all four nodes around; by its own two where the others mislead, as
    where two of them all but coincide.
    """
    alone = branch.part(np.array([segment, segment + 1]))
    return [(branch, segment), (alone, 0)]


def _is_on(branch: Branch, segment: int, point: Point) -> bool:
    """Whether a point was found, and lies on a segment."""
    is_between = branch.lies_between(np.array([segment]), point.Z)
    is_found = point.ok[0] and is_between[0]
    return bool(is_found)


@np.errstate(invalid="ignore", divide="ignore")
def _is_near(problem: Problem, at: Polished, w: Unknowns) -> ndarray:
    """Whether gaits lie where Newton's method began and repeat no sooner, shape (n,)."""
    return np.asarray(same(at.w, w, ON_BRANCH) & repeats_no_sooner(problem, at.w, w))


def repeats_no_sooner(problem: Problem, w: Unknowns, guess: Unknowns) -> ndarray:
    """Return whether gaits (m + k, n) of several steps repeat after no fewer, as their
    guesses do, shape (n,).
    """
    apart = distances_of_steps(w, problem.m, problem.steps)
    of_guess = distances_of_steps(guess, problem.m, problem.steps)
    least = np.maximum(_LEAST_SHARE * of_guess, _LEAST_APART)
    return np.asarray((apart > least).all(axis=0))


def is_step(point: Point) -> Procedure[bool]:
    """Whether a corrected point is a step that happens."""
    check = yield Call(check_steps, (point.Z,))
    return bool(check.step[0])


def narrow_segment(
    branch: Branch, segment: int, like_left: TestFunction
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
        point, is_predicted = yield from _point_within(branch, segment)
        if point is None or is_predicted:
            break
        branch = branch.with_points(segment, point)
        segment += yield from _outcome(like_left(point))
    return branch, segment


def _point_within(branch: Branch, segment: int) -> Procedure[tuple[Point | None, bool]]:
    """A corrected point on a segment, near its middle, or None; and whether the
    branch's own polynomial led to it closely.
    """
    whole, alone = _polynomials(branch, segment)
    tried = (
        (whole, 0.5),
        (alone, 0.5),
        (alone, 0.25),
        (alone, 0.75),
    )
    for (part, number), share in tried:
        low, high = part.ends_of(np.array(number))
        x = float(low * (1 - share) + high * share)
        point = yield from correct_at(part, number, x)
        if not _is_on(part, number, point):
            continue

        guess = part.evaluate(np.array([number]), np.array([x]))
        error = np.linalg.norm(point.Z - guess)
        a, b = part.Z[:, number : number + 2].T
        chord = np.linalg.norm(b - a)
        is_close = bool(error < _MAX_PREDICTION_ERROR * chord)
        return point, is_close and part is branch

    return None, False


def sampled_steps(
    problem: Problem, Z: Coordinates, samples: int
) -> tuple[AnyStride, ndarray]:
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
    singles = stride.singles
    distance = strike_distance(singles.scaled_motion(), singles.times)
    return stride, distance.reshape(stride.steps, -1).min(axis=0)


def sharpened_fold(point: Point) -> Procedure[Point]:
    """Correct the slope of a fold by its residual in more digits, where doubles leave
    it uncertain.

    Parameters
    ----------
    point : Point
        Of one lane.
    """
    derivative = point.at.derivative[..., 0]
    stride = point.at.stride
    # How far residuals of the joint equations, over the stance angle, move the ln slope
    # of a fold.
    left_vectors, *_ = np.linalg.svd(derivative[:, :-1])
    least = left_vectors[:, -1]
    by_residual = -least / total(least * derivative[:, -1])
    y = np.abs(stride.y[:, 0])
    image = np.abs(stride.image[:, 0])
    of_guards = np.full(len(derivative) - len(y), 2 * y[0])
    rounded = 3 * EPS * np.append(y + image, of_guards)
    uncertain = total(np.abs(by_residual) * rounded) / y[0]
    if uncertain < _SHARP:
        return point

    residual = yield Call(extended_precision.residual, (point.Z,))
    Z = point.Z.copy()
    Z[-1, 0] += total(by_residual * residual[:, 0])
    return replace(point, Z=Z)
