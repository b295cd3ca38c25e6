"""Points of a segment of a branch, between two nodes, and where a property changes on
it.

All are procedures, which run side by side (`tasks.branches.lockstep`).
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy import ndarray

from gaitsweep.tasks.branches.branch import Branch
from gaitsweep.tasks.branches.conditions import Condition
from gaitsweep.tasks.branches.lockstep import Call, Procedure
from gaitsweep.tasks.branches.pseudo_arclength import Point
from gaitsweep.tasks.branches.root import root_search
from gaitsweep.tasks.branches.tracking import ONE_STEP, check_steps, correct
from gaitsweep.tasks.mechanics.arrays import Coordinates
from gaitsweep.tasks.mechanics.sums import norm, total
from gaitsweep.tasks.step import extended_precision
from gaitsweep.tasks.step.problem import EPS, Problem
from gaitsweep.tasks.step.several_steps import AnyStride
from gaitsweep.tasks.step.verify_step import strike_distance

#: A number or a truth value of corrected points, or a procedure that returns one.
TestFunction = Callable[[Point], Any]

#: Splits of a segment on which an end or a fold lies, and the largest error of its
#: polynomial over its length.
_MAX_SPLITS, _MAX_PREDICTION_ERROR = 12, 1e-3
#: Error of a fold's ln slope up to which doubles locate it well enough.
_SHARP = 1e-13


#: Last Newton step of a point, event times apart, up to which the equations before it
#: serve as those at the point.
_SETTLED = 1e-11
#: Corrected points of a segment, by their coordinates on it.
Known = dict[float, Point]


def value_of(condition: Condition) -> Callable[[Point], float]:
    """Return how far a condition is from being fulfilled, as a test function."""
    return lambda point: float(condition.residual(point.at)[0])


def correct_at(
    branch: Branch,
    segment: int,
    x: float,
    known: Mapping[float, Point] = MappingProxyType({}),
) -> Procedure[Point]:
    """Correct the point at coordinate x of a segment.

    Parameters
    ----------
    known : mapping, optional
        Points of the segment: the polynomial is as far off as at the nearest of those
        that have settled.

    Returns
    -------
    point : Point
        Of one lane, its tangent along the branch.
    """
    segments = np.array([segment])
    Z = branch.evaluate(segments, np.array([x]))
    settled = [other for other, point in known.items() if _is_settled(point)]
    if settled:
        nearest = min(settled, key=lambda other: abs(other - x))
        off = known[nearest].Z - branch.evaluate(segments, np.array([nearest]))
        length = norm(branch.Z[:, segments + 1] - branch.Z[:, segments])
        # One on another branch is no guide.
        Z += np.where(norm(off) < length, off, 0.0)

    direction = branch.between(segments)
    point = yield Call(correct, (Z, direction))
    if not _is_settled(point):
        # Where branches cross Newton's method comes slowly near, and the equations that
        # the point has are those before its last step.
        again = yield Call(correct, (point.Z, direction), ONE_STEP)
        again.ok = point.ok
        point = again

    return point.oriented(direction)


def _is_settled(point: Point) -> bool:
    """Whether a point was corrected so quickly that the equations it has, those before
    its last step, serve as those at the point.
    """
    return bool(point.ok[0] and point.last_step[0] <= _SETTLED)


def search_segment(
    branch: Branch,
    segment: int,
    between: tuple[float, float],
    test: TestFunction,
    known: Known,
) -> Procedure[Point]:
    """Find the root of a test function, or of a procedure, between two coordinates of a
    segment, to rounding.

    Parameters
    ----------
    known : dict
        Points that are corrected already, to which those of the search are added.

    Raises
    ------
    ValueError
        Where it has the same sign at both.
    """
    a, b = between
    yield from correct_all_at(branch, segment, between, known)
    search = root_search(a, b, 1e-15 * max(1.0, abs(a)))
    x = next(search)
    while True:
        if x not in known:
            known[x] = yield from correct_at(branch, segment, x, known)
        value = yield from _outcome(test(known[x]))
        try:
            x = search.send(value)
        except StopIteration as end:
            return known[float(end.value)]


def correct_all_at(
    branch: Branch, segment: int, places: Sequence[float], known: Known
) -> Procedure[list[Point]]:
    """Correct the points at some coordinates of a segment: those that are not yet known
    side by side, and add them to the known ones.
    """
    new = [x for x in places if x not in known]
    found = yield [correct_at(branch, segment, x) for x in new]
    known.update(zip(new, found, strict=True))
    return [known[x] for x in places]


def _outcome(value: Any) -> Procedure[Any]:
    """The value of a test function; of one that is a procedure what it returns."""
    if isinstance(value, Generator):
        value = yield from value
    return value


def locate_root(
    branch: Branch, segment: int, test: TestFunction, known: Known | None = None
) -> Procedure[Point]:
    """Locate the root of a test function on a segment over which it changes sign, to
    rounding.

    Returns
    -------
    point : Point
        Of one lane, its tangent along the branch.
    """
    a, b = branch.ends_of(np.array(segment)).tolist()
    known = {} if known is None else known
    try:
        return (yield from search_segment(branch, segment, (a, b), test, known))
    except ValueError:
        # The values at the nodes differ in sign by rounding only: the end nearer zero
        # is the root.
        at_a = yield from _outcome(test(known[a]))
        at_b = yield from _outcome(test(known[b]))
        return known[a] if abs(at_a) < abs(at_b) else known[b]


def point_at_slope(branch: Branch, segment: int, q: float) -> Procedure[Point | None]:
    """Locate the point of a segment at a value of ln slope, along it; None where it
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
