"""Branches of gaits continued in slope, through folds, to their ends.

A point is Z = (w, q): similarity coordinates of the section (ln angle, rates/angle) and
event times, then q = ln slope. In Z a branch is smooth and nothing is singular where a
strike turns tangential or the walker almost stops; lengths and angles are those of Z.
Pseudo-arclength continuation: bordered Newton with exact derivatives, tangents from the
null vector, a second-order predictor, and step lengths by predictor error and turning
angle. Any number of branches, of any number of walkers, advance side by side in SIMD
lanes. In shapes, n counts lanes.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy import ndarray

from gaitsweep.tasks.branches.joint import (
    Evaluation,
    but_times,
    evaluate,
    rounding_step,
)
from gaitsweep.tasks.branches.pseudo_arclength import (
    Newton,
    Point,
    StepControl,
    Track,
    Tracks,
    bordered_matrix,
    bordered_newton,
)
from gaitsweep.tasks.contract.registry import SLOPES
from gaitsweep.tasks.gaits.newton import LONGEST_PERIOD
from gaitsweep.tasks.gaits.step_check import verify_steps
from gaitsweep.tasks.mechanics.arrays import Coordinates, Gait, Numbers, PerLane
from gaitsweep.tasks.mechanics.sums import norm, total
from gaitsweep.tasks.step.lanes import lanes_of
from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.step.several_steps import sections
from gaitsweep.tasks.step.simulate import MAX_LOG_ANGLE
from gaitsweep.tasks.step.step_map import SAMPLES
from gaitsweep.tasks.step.verify_step import StepCheck

#: Slopes over which branches are followed [rad]: at the least, rounding changes
#: tangents by parts in a thousand.
MIN_SLOPE, MAX_SLOPE = SLOPES[0], 0.7
_NEWTON = Newton(max_iterations=8, max_step=1.0, small=1e-9, shrinking=0.2)
#: Newton step after which a point of a track is accurate enough: the next, about its
#: square, is taken for all points together. Before a fall, where the duration grows
#: without bound, a larger bound would leave errors for which steps must be short.
_ENOUGH = 1e-10
#: Steps of branches turn by at most 0.3 rad; what is kept near its target is the
#: distance from the predicted point.
_CONTROL = StepControl(
    shortest=1e-7,
    longest=2.0,
    min_cosine=np.cos(0.3),
    target=2e-3,
    power=1 / 3,
    growth=(0.4, 2.0),
    reduction=0.3,
    max_error=0.02,
)
#: Gaits of several steps that flips begin lie near each other.
_CONTROL_OF_SEVERAL = replace(_CONTROL, shortest=1e-12, max_bend=0.2)
#: Of these the largest multiplier up to which branches are followed; the largest change
#: of the multipliers' sum over a continuation step, and the sum from which on that is
#: one of its logarithm: there no flip is near.
MAX_MULTIPLIER, _MAX_CHANGE, _LARGE_SUM = 20.0, 0.6, 2.0
#: Largest error of predicted event times.
_MAX_TIME_ERROR = 0.1
_MAX_NODES = 1500
#: Where the sign of the branch point determinant changes over a longer step than this,
#: Newton has jumped to a branch nearby; over a shorter one branches cross.
MAX_CROSSING_STEP = 1e-4
#: Number of points after which it is checked that a branch still consists of steps.
_CHECK_EVERY = 12


#: Options of a call of `correct` that evaluates points and takes one Newton step.
ONE_STEP = (("max_iterations", 1),)


def correct(
    problem: Problem,
    Z: Coordinates,
    border: Coordinates | None,
    max_iterations: int = 8,
    enough: float = 0.0,
    samples: int = 0,
) -> Point:
    """Correct points by bordered Newton: the solutions in the plane through them normal
    to `border`.

    Parameters
    ----------
    Z : ndarray, shape (c, n)
        Predicted points.
    border : ndarray, shape (c, n), or None
        None for solutions at fixed slope.
    max_iterations : int
        Newton steps.
    enough : float
        Size of a Newton step after which a point that only leads to others is accurate
        enough.
    samples : int
        Of the motion, as for `evaluate`.

    Returns
    -------
    Point
    """
    if border is None:
        border = np.zeros(Z.shape)
        border[-1] = 1

    def linearise(lanes: Numbers, Z: Coordinates) -> Evaluation:
        return evaluate(problem.some(lanes), Z, samples)

    limits = replace(_NEWTON, max_iterations=max_iterations, enough=enough)
    found = bordered_newton(
        linearise, rounding_step, limits, Z, border, but_times(problem.m)
    )
    # The equations are those before the last step; only the point is after it.
    return replace(found, at=replace(found.at, Z=found.Z))


def refine_and_check(
    problem: Problem, Z: Coordinates, border: Coordinates
) -> tuple[Point, StepCheck]:
    """Correct points of tracks by one Newton step more, and verify that they are steps.

    Parameters
    ----------
    problem : Problem
    Z, border : ndarray, shape (c, n)
        As for `correct`.

    Returns
    -------
    point : Point
        The corrected points; those given where the step is larger than points of tracks
        may be off, or has no solution.
    check : StepCheck
        Of those given.
    """
    point = correct(problem, Z, border, max_iterations=1, samples=SAMPLES)
    _, check = verify_steps(problem, Z[:-1], Z[-1], point.at.stride)
    is_better = point.last_step < _ENOUGH
    refined = point.oriented(border)
    refined.Z = np.where(is_better, point.Z, Z)
    refined.direction = np.where(is_better, refined.direction, border)
    return refined, check


def _stop_reasons(point: Point) -> ndarray:
    """Why tracks stop at their points; empty where they go on."""
    q, angle = point.at.q, point.Z[0]
    problem = point.at.problem
    least, largest = np.log(problem.drive.window(problem.walker))
    beyond = (q <= least) | (q >= largest)
    vanished = rate_of_steps(point.Z, point.at.m, point.at.stride.steps) > MOST_RATE
    early = np.diff(point.at.times, axis=0).min(axis=0, initial=0.0) < -0.5
    # By the laws of vanishing slopes angles are hardly smaller than slopes.
    no_step = angle < np.minimum(-40, q - 10)
    if problem.drive.base is not None:
        no_step |= _leave_the_drive(point)
    tests = {
        "window": beyond,
        "end_fall": ~no_step & (fall_margin(point.Z, point.at.stride.steps) > 0),
        "end_zero_step": no_step | vanished,
        "heelstrike before kneestrike": early,
    }
    why = np.full(len(q), "", object)
    # Of several reasons the first counts.
    for name, holds in reversed(tests.items()):
        why[holds] = name
    return why


def _leave_the_drive(point: Point) -> PerLane:
    """Whether steps vanish at a finite drive: it changes no more with their angle.

    Notes
    -----
    An impulse acts on legs that stand apart: over the angle, steps of vanishing angle
    repeat at that impulse at which a multiplier of standing still is 1.
    """
    by_angle, by_drive = np.abs(point.direction[[0, -1]])
    is_small: PerLane = point.Z[0] < _SMALL_ANGLE
    return is_small & (by_drive < _UNCHANGED * by_angle)


#: Ln angle and change of the drive's logarithm with it below which steps vanish at a
#: finite drive; rounding changes it a hundred times less.
_SMALL_ANGLE, _UNCHANGED = -10.0, 1e-11
#: Norm of rates over angle at which a branch ends at zero step length [sqrt(g/leg)].
MOST_RATE = 36.0
#: Why a track of several steps stops that passes the flip of half as many: beyond, it
#: repeats itself; and why any stops whose last points are no steps.
HALVED, NOT_A_STEP = "halved", "not a step"


def rate_of_steps(Z: Coordinates, m: int, steps: int = 1) -> ndarray:
    """Return the norm (n,) of the rates over angle of gaits Z (c, n): steps vanish
    where it has no bound.

    Rates are in sqrt(g/leg); of steps shorter than pi, as of legs that swing fast,
    relative to those of their duration.
    """
    brevity = np.minimum(1.0, Z[-2] / (np.pi * steps))
    return np.asarray(brevity * norm(Z[1:m]))


def fall_margin(Z: Coordinates, steps: int = 1) -> ndarray:
    """Return a number that is positive where a gait's angle or mean step's duration
    exceeds those of walking.

    Parameters
    ----------
    Z : ndarray, shape (c, n)
    steps : int

    Returns
    -------
    ndarray, shape (n,)
    """
    return np.maximum(Z[0] - MAX_LOG_ANGLE, Z[-2] - steps * LONGEST_PERIOD)


def follow(
    problem: Problem, Z: Coordinates, step: float | PerLane = 0.05
) -> list[tuple[Track, Track]]:
    """Follow branches in both directions from solved gaits.

    Parameters
    ----------
    problem : Problem
        Of n lanes.
    Z : ndarray, shape (c, n)
        Gaits.
    step : float, or ndarray, shape (n,)
        Length of the first steps.

    Returns
    -------
    list of (Track, Track)
        For each gait the tracks towards lower and higher slopes; both begin with the
        gait itself.
    """
    n = Z.shape[1]
    first = correct(problem, Z, None)
    # Tracks of n lanes: down, then up.
    lanes = np.tile(np.arange(n), 2)
    orientation = np.zeros((len(Z), 2 * n))
    orientation[-1] = np.repeat([-1.0, 1.0], n)
    starts = lanes_of(first, lanes)
    steps = np.broadcast_to(step, n)[lanes]
    several = problem.steps > 1
    tracks = _Branches(problem.some(lanes), starts, orientation, steps, several)
    tracks.stop[~starts.ok] = "no start"

    followed = [_without_last_halved(track) for track in tracks.follow(_MAX_NODES)]
    return list(zip(followed[:n], followed[n:], strict=True))


def _without_last_halved(track: Track) -> Track:
    """The track; without its last point where that lies beyond the flip that it meets."""
    if track.stop_reason != HALVED:
        return track
    return Track(track.Z[:, :-1], track.tangent[:, :-1], HALVED)


def _tests(point: Point, direction: Coordinates) -> ndarray:
    """What shows that other branches are near (2, n): the sign of the determinant that
    vanishes where branches cross, and the sum of the multipliers; of a large sum the
    logarithm.
    """
    side = np.sign(branch_point_determinant(point, direction))
    multipliers = np.trace(point.at.jacobians, axis1=1, axis2=2)
    return np.array([side, _LARGE_SUM * np.arcsinh(multipliers / _LARGE_SUM)])


def keeps_apart(before: Coordinates, after: Coordinates, problem: Problem) -> ndarray:
    """Return whether the halves of gaits have not changed sides between two points of
    their curves: where they do, a flip of half as many steps lies between.

    Parameters
    ----------
    before, after : ndarray, shape (m + k or more, n)
        Similarity coordinates, and whatever follows them.
    problem : Problem
        Of all steps.

    Returns
    -------
    ndarray of bool, shape (n,)
    """
    if problem.steps % 2:
        return np.ones(before.shape[1], bool)

    joint = problem.m + problem.phases

    def apart(Z: Coordinates) -> ndarray:
        y, _ = sections(Z[:joint], problem.m, problem.steps)
        return np.asarray(y - np.roll(y, problem.steps // 2, axis=0))

    return total(np.concatenate(apart(before) * apart(after))) > 0


def points_along(
    problem: Problem, first: Point, direction: Gait, step: float
) -> Iterator[Point]:
    """Yield the points of a branch in one direction, for what lies soon on it, as long
    as another can be found.

    Parameters
    ----------
    problem : Problem
    first : Point
        Of one lane, which is yielded first.
    direction : ndarray, shape (c,)
    step : float
        Length of the first step.
    """
    tracks = _Branches(problem, first, direction[:, None], step, several=True)
    yield first.oriented(tracks.tangent)
    only = np.array([0])
    while tracks.step[0] > tracks.control.shortest:
        point, fair = tracks.advance(only)
        if fair[0]:
            tracks.record(only)
            yield point.oriented(tracks.tangent)


class _Branches(Tracks):
    """Branches in progress from n points, along the tangents on the side of an
    orientation (c, n).

    With `several`, as beside flips, steps are so short that no flip is passed unseen.
    `passed` and `tried` (2, n) are, at the last points and at those tried after them,
    the sign of the determinant that vanishes where branches cross and the sum of the
    multipliers, as `_tests` has them.
    """

    def __init__(
        self,
        problem: Problem,
        first: Point,
        orientation: Coordinates,
        step: float | PerLane,
        several: bool,
    ):
        first = first.oriented(orientation)
        self.problem = problem
        self.several = several
        self.recent = np.zeros((_CHECK_EVERY // 3, *first.Z.shape))
        self.passed = _tests(first, orientation)
        self.tried = self.passed.copy()
        control = _CONTROL_OF_SEVERAL if several else _CONTROL
        super().__init__(control, first.Z, first.direction, step)

    def correct(
        self, tracks: Numbers, guess: Coordinates, border: Coordinates
    ) -> Point:
        problem = self.problem.some(tracks)
        return correct(problem, guess, border, enough=_ENOUGH)

    def judge(
        self, tracks: Numbers, point: Point, guess: Coordinates, error: PerLane
    ) -> tuple[ndarray, ndarray]:
        self.tried[:, tracks] = _tests(point, self.tangent[:, tracks])
        side, trace = self.passed[:, tracks]
        new_side, new_trace = self.tried[:, tracks]
        # Another root of a guard is another solution, even if the gait is nearly the
        # same.
        late = np.abs(point.Z - guess)[self.problem.m : -1]
        fair = (late < _MAX_TIME_ERROR).all(axis=0)
        fair &= (side * new_side >= 0) | (self.step[tracks] <= MAX_CROSSING_STEP)
        if not self.several:
            return fair, error

        change = np.abs(new_trace - trace)
        share = (2 * change / _MAX_CHANGE) ** (1 / self.control.power)
        measure = np.maximum(error, self.control.target * share)
        return fair & (change < _MAX_CHANGE), measure

    def reasons(self, tracks: Numbers, point: Point, last: Coordinates) -> ndarray:
        why = _stop_reasons(point)
        if self.problem.steps > 1:
            is_unstable = np.abs(point.at.multipliers[:, 0]) > MAX_MULTIPLIER
            why[is_unstable] = "multiplier_limit"
            why[~keeps_apart(last, point.Z, self.problem)] = HALVED

        due = np.flatnonzero((why == "") & (self.count[tracks] % _CHECK_EVERY == 0))
        if len(due):
            why[due[~self._are_steps(tracks[due])]] = NOT_A_STEP
        return why

    def record(self, tracks: Numbers) -> None:
        self.passed[:, tracks] = self.tried[:, tracks]
        place = self.count[tracks] % len(self.recent)
        self.recent[place, :, tracks] = self.Z[:, tracks].T
        super().record(tracks)

    def _are_steps(self, tracks: Numbers) -> ndarray:
        """Whether any of the last points of some tracks is a step that happens, shape
        (j,).
        """
        Z = self.recent[:, :, tracks]
        check = check_steps(self.problem.some(np.tile(tracks, len(Z))), np.hstack([*Z]))
        return np.asarray(check.step.reshape(len(Z), -1).any(axis=0))


# Where heelstrike is tangential to the last digit the map has no derivative.
@np.errstate(invalid="ignore", over="ignore")
def branch_point_determinant(point: Point, direction: Coordinates) -> ndarray:
    """Determinant that vanishes where branches cross, of the joint derivative and the
    tangent as its last row.

    Parameters
    ----------
    point : Point
        Of n branches.
    direction : ndarray, shape (c, n)
        The side on which the tangents are taken to point.

    Returns
    -------
    ndarray, shape (n,)
        Its sign is the same all along a branch, and the opposite on one that almost
        touches it.
    """
    tangent = point.direction * np.sign(total(point.direction * direction))
    return np.linalg.det(bordered_matrix(point.at.derivative, tangent))


def check_steps(problem: Problem, Z: Coordinates) -> StepCheck:
    """Verify that points of branches (c, n) are steps."""
    return verify_steps(problem, Z[:-1], Z[-1])[1]
