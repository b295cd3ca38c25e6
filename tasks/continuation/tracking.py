"""Branches of gaits continued in slope, through folds, to their ends.

A point is X = (w, q): similarity coordinates of the section (ln angle, rates/angle) and q = ln slope. The corrector
solves for X and the event times together, Z = (X, times), in which a branch is smooth and nothing is singular where a
strike turns tangential or the walker almost stops; lengths and angles are those of Z. Pseudo-arclength continuation:
bordered Newton with exact derivatives, tangents from the null vector, a second-order predictor, and step lengths by
predictor error and turning angle. Any number of branches, of any number of walkers, advance side by side in SIMD lanes.
In shapes, n counts lanes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from gaitsweep.tasks.continuation.joint import joint, joint_by_X, rounding_step
from gaitsweep.tasks.continuation.pseudo_arclength import (
    Linearisation,
    Newton,
    StepControl,
    Tracks,
    bordered_newton,
    root_between,
)
from gaitsweep.tasks.continuation.root import passes
from gaitsweep.tasks.fixed_points.multipliers import multipliers
from gaitsweep.tasks.fixed_points.newton import LONGEST_PERIOD
from gaitsweep.tasks.fixed_points.step_check import verify_steps
from gaitsweep.tasks.registry import SLOPES
from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.step.several_steps import AnyStride, sections
from gaitsweep.tasks.step.simulate import MAX_LOG_ANGLE

#: Slopes over which branches are followed [rad]: at the least, rounding changes tangents by parts in a thousand.
MIN_SLOPE, MAX_SLOPE = SLOPES[0], 0.7
_NEWTON = Newton(max_iterations=8, max_step=1.0, small=1e-9, shrinking=0.2)
#: Steps of branches turn by at most 0.3 rad; what is kept near its target is the distance from the predicted point.
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
#: Of these the largest multiplier up to which branches are followed, and the largest change of the multipliers' sum
#: over a continuation step, so that no flip is passed unseen.
MAX_MULTIPLIER, _MAX_CHANGE = 20.0, 0.6
#: Largest error of predicted event times.
_MAX_TIME_ERROR = 0.1
_MAX_NODES = 1500
#: Distance from a root at which it is located, over the distance of the points between which it lies.
_LOCATED = 3e-13
#: Where the sign of the branch point determinant changes over a longer step than this, Newton has jumped to a branch
#: nearby; over a shorter one branches cross.
MAX_CROSSING_STEP = 1e-4
#: Number of points after which it is checked that a branch still consists of steps.
_CHECK_EVERY = 12


@dataclass
class Point:
    """Corrected points of n branches.

    Attributes
    ----------
    X, tangent : ndarray, shape (m + 1, n)
        The points and their derivatives along the branches.
    times, times_tangent : ndarray, shape (k, n) [sqrt(leg/g)]
        Event times, and their derivatives along the branches; with `tangent` a unit vector.
    ok : ndarray of bool, shape (n,)
        Whether Newton converged.
    stride : Stride or Strides
        The last one evaluated, at the point or a Newton step away.
    derivative : ndarray, shape (m + k, m + 1 + k, n)
        Of its joint equations by X and the durations of the phases.
    """

    X: np.ndarray
    times: np.ndarray
    tangent: np.ndarray
    times_tangent: np.ndarray
    ok: np.ndarray
    stride: AnyStride
    derivative: np.ndarray

    @property
    def m(self) -> int:
        """Number of section coordinates."""
        return len(self.X) - 1

    @property
    def jacobians(self) -> np.ndarray:
        """Jacobians of all steps of a gait, shape (n, d, d)."""
        return np.moveaxis(self.stride.jacobian, -1, 0)

    @property
    def multipliers(self) -> np.ndarray:
        """Multipliers, largest magnitude first, shape (n, d); NaN where there are none."""
        return multipliers(self.stride.jacobian, self.stride.jacobian.shape[0])

    @property
    def Z(self) -> np.ndarray:
        """The points with their event times, shape (m + 1 + k, n)."""
        return np.vstack([self.X, self.times])

    @property
    def direction(self) -> np.ndarray:
        """Unit tangents of Z, shape (m + 1 + k, n)."""
        return np.vstack([self.tangent, self.times_tangent])

    @property
    def q(self) -> np.ndarray:
        """Values of ln slope, shape (n,)."""
        return self.X[-1]

    @property
    def w(self) -> np.ndarray:
        """Similarity coordinates and event times, shape (m + k, n)."""
        return np.vstack([self.X[:-1], self.times])

    def oriented(self, direction: np.ndarray) -> Point:
        """Return the points with their tangents turned to the side of some directions (m + 1 + k, n)."""
        sign = np.where((self.direction * direction).sum(axis=0) < 0, -1.0, 1.0)
        return replace(self, tangent=sign * self.tangent, times_tangent=sign * self.times_tangent)


def correct(
    problem: Problem, X: np.ndarray, times: np.ndarray, border: np.ndarray | None, max_iterations: int = 8
) -> Point:
    """Correct points by bordered Newton: the solutions in the plane through them normal to `border`.

    Parameters
    ----------
    X : ndarray, shape (m + 1, n)
        Predicted points.
    times : ndarray, shape (k, n) [sqrt(leg/g)]
        Their event times.
    border : ndarray, shape (m + 1 + k, n) or (m + 1, n), or None
        In Z, or in X whatever the times; None for solutions at fixed slope.
    max_iterations : int
        Newton steps.

    Returns
    -------
    Point
    """
    m, n = problem.m, X.shape[1]
    if border is None:
        border = np.zeros((m + 1, n))
        border[m] = 1
    border = np.pad(border, ((0, m + 1 + len(times) - len(border)), (0, 0)))

    def linearise(lanes: np.ndarray, Z: np.ndarray) -> Linearisation:
        x = Z[: m + 1]
        stride, _ = problem.some(lanes).stride(np.vstack([x[:m], Z[m + 1 :]]), x[m], slope=True)
        residual, derivative = joint(stride, x)
        return Linearisation(residual, derivative, joint_by_X(stride.times_by, stride, x), stride)

    limits = replace(_NEWTON, max_iterations=max_iterations)
    at = bordered_newton(linearise, _rounding, limits, np.vstack([X, times]), border)
    (X, times), (tangent, times_tangent) = np.split(at.Z, [m + 1]), np.split(at.direction, [m + 1])
    return Point(X, times, tangent, times_tangent, at.ok, at.at.evaluation, at.at.derivative.transpose(1, 2, 0))


def correct_and_evaluate(problem: Problem, X: np.ndarray, times: np.ndarray, border: np.ndarray) -> Point:
    """Correct points; the corrector's derivative is that before its last step, this one's that at the point itself.

    Parameters
    ----------
    problem : Problem
    X : ndarray, shape (m + 1, n)
    times : ndarray, shape (k, n) [sqrt(leg/g)]
    border : ndarray, shape (m + 1 + k, n)
        Directions along which the points may not move.

    Returns
    -------
    Point
    """
    point = correct(problem, X, times, border)
    at_point = correct(problem, point.X, point.times, border, max_iterations=1)
    at_point.ok = point.ok
    return at_point


def _rounding(matrix: np.ndarray, at: Linearisation) -> np.ndarray:
    """Size of a bordered Newton step that rounding alone makes, shape (n,)."""
    return rounding_step(matrix, at.evaluation)


@dataclass(frozen=True)
class Track:
    """A branch followed in one direction from a gait.

    Attributes
    ----------
    Z, tangent : ndarray, shape (p, m + 1 + k)
        Its points X with their event times, in order, and their derivatives along the track.
    stop_reason : str
        Why it stops at its last point.
    """

    Z: np.ndarray
    tangent: np.ndarray
    stop_reason: str


def _stop_reasons(X: np.ndarray, times: np.ndarray, count: np.ndarray, steps: int) -> np.ndarray:
    """Why tracks stop at their points, X (m + 1, n), of which they have `count`: indices into `_STOP_REASONS`."""
    slope = (X[-1] <= np.log(MIN_SLOPE)) | (X[-1] >= np.log(MAX_SLOPE))
    vanished = rate_of_steps(X[1:-1]) > MOST_RATE
    early = np.diff(times, axis=0).min(axis=0, initial=0.0) < -0.5
    # By the laws of vanishing slopes angles are hardly smaller than slopes.
    no_step = X[0] < np.minimum(-40, X[-1] - 10)
    tests = (slope, no_step, fall_margin(X, times, steps) > 0, vanished, early, count > _MAX_NODES)
    return np.select(tests, [1, 2, 3, 2, 4, 5], 0)


#: Norm of rates over angle at which a branch ends at zero step length [sqrt(g/leg)].
MOST_RATE = 36.0
#: Why a track that returns to its start stops, and one of several steps that passes the flip of half as many.
CLOSED, HALVED = "closed", "halved"
_STOP_REASONS = (
    "",
    "end of the window",
    "zero step length",
    "a fall",
    "heelstrike before kneestrike",
    "too many points",
    "not a step",
    "no further point",
    "no start",
    CLOSED,
    HALVED,
    "multiplier_limit",
)


def rate_of_steps(rates: np.ndarray) -> np.ndarray:
    """Return the norm (n,) of rates over angle, (m - 1, n) [sqrt(g/leg)]: steps vanish where it has no bound."""
    return np.asarray(np.sqrt((rates**2).sum(axis=0)))


def fall_margin(X: np.ndarray, times: np.ndarray, steps: int = 1) -> np.ndarray:
    """Return a number that is positive where a gait's angle or mean step's duration exceeds those of walking.

    Parameters
    ----------
    X : ndarray, shape (m + 1, n)
        Similarity coordinates and ln slope.
    times : ndarray, shape (k, n) [sqrt(leg/g)]
        Event times.
    steps : int

    Returns
    -------
    ndarray, shape (n,)
    """
    return np.maximum(X[0] - MAX_LOG_ANGLE, times[-1] - steps * LONGEST_PERIOD)


def follow(problem: Problem, w: np.ndarray, log_slope: np.ndarray, step: float = 0.05) -> list[tuple[Track, Track]]:
    """Follow branches in both directions from solved gaits.

    Parameters
    ----------
    problem : Problem
        Of n lanes.
    w : ndarray, shape (m + k, n)
        Gaits in similarity coordinates.
    log_slope : ndarray, shape (n,)
        ln of the slope in rad.
    step : float
        Length of the first steps.

    Returns
    -------
    list of (Track, Track)
        For each gait the tracks towards lower and higher slopes; both begin with the gait itself.
    """
    m, n = problem.m, w.shape[1]
    first = correct(problem, np.vstack([w[:m], log_slope]), w[m:], None)
    upwards = np.zeros((len(first.Z), n))
    upwards[m] = 1.0
    # Tracks of n lanes: down, then up.
    lanes, sign = np.tile(np.arange(n), 2), np.repeat([-1.0, 1.0], n)
    problem = problem.some(lanes)
    tracks = _Branches(first, lanes, sign * upwards[:, lanes], step)
    tracks.side = sign * np.sign(branch_point_determinant(first, upwards))[lanes]
    tracks.stop[~first.ok[lanes]] = _STOP_REASONS.index("no start")
    while len(active := np.flatnonzero(tracks.stop == 0)):
        border, side = tracks.tangent[:, active], np.zeros(len(active))

        def correct_active(guess: np.ndarray, border: np.ndarray, active: np.ndarray = active) -> Point:
            return correct(problem.some(active), guess[: m + 1], guess[m + 1 :], border)

        def judge(
            point: Point,
            guess: np.ndarray,
            error: np.ndarray,
            active: np.ndarray = active,
            border: np.ndarray = border,
            side: np.ndarray = side,
        ) -> tuple[np.ndarray, np.ndarray]:
            # Another root of a guard is another solution, even if the gait is nearly the same.
            fair = (np.abs(point.times - guess[m + 1 :]) < _MAX_TIME_ERROR).all(axis=0)
            side[:] = np.sign(branch_point_determinant(point, border))
            fair &= (tracks.side[active] * side >= 0) | (tracks.step[active] <= MAX_CROSSING_STEP)
            return (fair, error) if problem.steps == 1 else _of_several(fair, error, point, tracks.trace[active])

        before = tracks.Z[:, active], tracks.tangent[:, active]
        point, fair = tracks.advance(active, correct_active, judge)
        new, refused = active[fair], active[~fair]
        tracks.side[new], tracks.trace[new] = side[fair], _trace(point)[fair]
        tracks.stop[new] = _stop_reasons(point.X[:, fair], point.times[:, fair], tracks.count[new], problem.steps)
        if problem.steps > 1:
            too_large = np.abs(point.multipliers[fair, 0]) > MAX_MULTIPLIER
            tracks.stop[new[too_large]] = _STOP_REASONS.index("multiplier_limit")
            halved = ~_keeps_apart(before[0][:, fair], point.Z[:, fair], problem)
            tracks.stop[new[halved]] = _STOP_REASONS.index(HALVED)
        # Beyond the flip of half its steps a branch repeats itself.
        tracks.record(new[tracks.stop[new] != _STOP_REASONS.index(HALVED)])
        closed = tracks.pass_start(new, *(each[:, fair] for each in before))
        tracks.stop[new[closed]] = _STOP_REASONS.index(CLOSED)
        tracks.stop[refused[tracks.step[refused] < tracks.control.shortest]] = _STOP_REASONS.index("no further point")
        checked = new[(tracks.stop[new] == 0) & (tracks.count[new] % _CHECK_EVERY == 0)]
        if len(checked):
            tracks.stop[checked[~_are_steps(problem, tracks, checked)]] = _STOP_REASONS.index("not a step")
    return tracks.pairs()


def _trace(point: Point) -> np.ndarray:
    """Sum of the multipliers, shape (n,)."""
    return np.trace(point.jacobians, axis1=1, axis2=2)


def _of_several(fair: np.ndarray, error: np.ndarray, point: Point, trace: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Which points of gaits of several steps are fair, and a measure of their errors that counts multipliers too."""
    change = np.abs(_trace(point) - trace)
    worth = _CONTROL.target * (2 * change / _MAX_CHANGE) ** (1 / _CONTROL.power)
    return fair & (change < _MAX_CHANGE), np.maximum(error, worth)


def _keeps_apart(before: np.ndarray, after: np.ndarray, problem: Problem) -> np.ndarray:
    """Whether the halves of gaits Z (c, n) have not changed sides between two points of their branches, shape (n,)."""
    if problem.steps % 2:
        return np.ones(before.shape[1], bool)
    halves = [sections(np.delete(Z, problem.m, axis=0), problem.m, problem.steps)[0] for Z in (before, after)]
    apart = [y - np.roll(y, problem.steps // 2, axis=0) for y in halves]
    return (apart[0] * apart[1]).sum(axis=(0, 1)) > 0


class Path:
    """A branch followed in one direction, a point at each call of `advance`, for what lies soon on it.

    Parameters
    ----------
    problem : Problem
    first : Point
        Of one lane.
    direction : ndarray, shape (c,)
    step : float
        Length of the first step.
    """

    def __init__(self, problem: Problem, first: Point, direction: np.ndarray, step: float):
        self.problem, self.points = problem, [first.oriented(direction[:, None])]
        self._tracks = Tracks(_CONTROL_OF_SEVERAL, first.Z, self.points[0].direction, step)

    @property
    def step(self) -> float:
        """Length of the next step."""
        return float(self._tracks.step[0])

    def advance(self) -> bool:
        """Add a point; False where none can be found."""
        tracks, last = self._tracks, self.points[-1]

        def judge(point: Point, guess: np.ndarray, error: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            return _of_several(np.ones(1, bool), error, point, _trace(last))

        while tracks.step[0] > tracks.control.shortest:
            point, fair = tracks.advance(np.array([0]), self._correct, judge)
            if fair[0]:
                self.points.append(point.oriented(tracks.tangent))
                return True
        return False

    def _correct(self, guess: np.ndarray, border: np.ndarray) -> Point:
        return correct(self.problem, guess[: self.problem.m + 1], guess[self.problem.m + 1 :], border)

    def locate_root(self, test: Callable[[Point], float]) -> Point:
        """Locate the root of a test function between the last two points, where it changes sign."""
        ends = self.points[-2:]
        a, b = ((point.Z[:, 0], point.direction[:, 0]) for point in ends)

        def corrected(guess: np.ndarray, along: np.ndarray) -> Point:
            X, times = np.split(guess[:, None], [self.problem.m + 1])
            return correct_and_evaluate(self.problem, X, times, along[:, None]).oriented(along[:, None])

        return root_between(a, b, (test(ends[0]), test(ends[1])), len(a[0]), corrected, test, _LOCATED)


class _Branches(Tracks):
    """Branches in progress: their last points, all points in the order they were found, and why they stopped."""

    def __init__(self, first: Point, lanes: np.ndarray, orientation: np.ndarray, step: float):
        tangent = first.direction[:, lanes]
        tangent = np.where((tangent * orientation).sum(axis=0) >= 0, tangent, -tangent)
        control = _CONTROL if first.stride.steps == 1 else _CONTROL_OF_SEVERAL
        super().__init__(control, first.Z[:, lanes], tangent, step)
        self.trace = _trace(first)[lanes]
        n, self.first = len(lanes), (self.Z.copy(), self.tangent.copy())
        self.count, self.side, self.stop = np.zeros(n, int), np.zeros(n), np.zeros(n, int)
        self.recent = np.zeros((_CHECK_EVERY // 3, *self.Z.shape))
        self.log: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
        self.record(np.arange(n))

    def record(self, tracks: np.ndarray) -> None:
        """Add the last points of tracks to what was found."""
        Z = self.Z[:, tracks]
        self.recent[self.count[tracks] % len(self.recent), :, tracks] = Z.T
        self.count[tracks] += 1
        self.log.append((tracks, Z, self.tangent[:, tracks]))

    def pass_start(self, tracks: np.ndarray, Z: np.ndarray, tangent: np.ndarray) -> np.ndarray:
        """Whether tracks pass their own starts, in their directions there, on their last steps.

        Parameters
        ----------
        tracks : ndarray of int, shape (j,)
        Z, tangent : ndarray, shape (c, j)
            The points before the last ones, and the tangents there.

        Returns
        -------
        ndarray of bool, shape (j,)
        """
        start, ahead = (each[:, tracks] for each in self.first)
        closes = passes(start, ahead, Z, tangent, self.Z[:, tracks], self.tangent[:, tracks])
        return np.asarray(closes & (self.count[tracks] > 3))

    def pairs(self) -> list[tuple[Track, Track]]:
        """Tracks down and up of each gait."""
        owner = np.concatenate([tracks for tracks, _, _ in self.log])
        order = np.argsort(owner, kind="stable")
        bounds = np.cumsum(self.count)[:-1]
        Z, tangent = (np.split(np.hstack([e[i] for e in self.log]).T[order], bounds) for i in (1, 2))
        tracks = [Track(*each) for each in zip(Z, tangent, (_STOP_REASONS[i] for i in self.stop), strict=True)]
        n = len(tracks) // 2
        return list(zip(tracks[:n], tracks[n:], strict=True))


# Where heelstrike is tangential to the last digit the map has no derivative.
@np.errstate(invalid="ignore", over="ignore")
def branch_point_determinant(point: Point, direction: np.ndarray) -> np.ndarray:
    """Determinant that vanishes where branches cross, of the joint derivative and the tangent of X as its last row.

    Parameters
    ----------
    point : Point
        Of n branches.
    direction : ndarray, shape (m + 1 + k, n)
        The side on which the tangents are taken to point.

    Returns
    -------
    ndarray, shape (n,)
        Its sign is the same all along a branch, and the opposite on one that almost touches it.
    """
    tangent = point.tangent * np.sign((point.direction * direction).sum(axis=0))
    row = np.pad(tangent, ((0, len(point.times)), (0, 0)))
    return np.linalg.det(np.concatenate([point.derivative, row[None]]).transpose(2, 0, 1))


def _are_steps(problem: Problem, tracks: _Branches, which: np.ndarray) -> np.ndarray:
    """Whether any of the last points of some tracks is a step that happens, shape (len(which),)."""
    Z = tracks.recent[:, :, which]
    lanes = np.tile(which, len(Z))
    Z = Z.transpose(1, 0, 2).reshape(len(Z[0]), -1)
    _, check = verify_steps(problem.some(lanes), np.delete(Z, problem.m, axis=0), Z[problem.m])
    return np.asarray(check.step.reshape(-1, len(which)).any(axis=0))
