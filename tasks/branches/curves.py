"""Curves of points that solve equations with one freedom left, in a window of the
unknowns beside state and event times: folds, flips and ends of walking over slope and a
key, or over two keys; gaits at a fixed slope over a key.

A point is X (`tasks.branches.equations`), whose last unknowns are ln slope, unless
it is fixed, and keys over their ranges. Nothing is singular where strikes turn
tangential or coincide, so ends are followed as folds and flips are.
"""

from __future__ import annotations

import numpy as np
from numpy import ndarray

from gaitsweep.tasks.branches import pseudo_arclength as engine
from gaitsweep.tasks.branches.equations import (
    DIFFERENCE,
    Equations,
    correct_on_curve,
)
from gaitsweep.tasks.branches.pseudo_arclength import CLOSED, Track, joined
from gaitsweep.tasks.branches.root import OnCurve, bracketed_root, hermite
from gaitsweep.tasks.branches.tracking import HALVED, keeps_apart
from gaitsweep.tasks.mechanics.arrays import Coordinates, Gait, Numbers, PerLane
from gaitsweep.tasks.mechanics.sums import norm, total
from gaitsweep.tasks.step.lanes import lanes_of
from gaitsweep.tasks.step.problem import EPS
from gaitsweep.tasks.step.simulate import STRUCK
from gaitsweep.tasks.step.simulate import stride as simulate_step

#: Steps grow where the predictor's error over their length is below the target, and are
#: kept elsewhere.
_CONTROL = engine.StepControl(
    shortest=5e-4,
    longest=0.1,
    min_cosine=0.95,
    target=0.03,
    power=np.inf,
    growth=(1.0, 1.5),
    reduction=0.4,
    max_bend=0.1,
)
#: Length of the first step, and most points of a curve.
_FIRST_STEP, _MAX_POINTS = 0.02, 5000
#: Why a curve is followed no further within its window.
BORDER = "border"
#: Least ln angle at which a curve is followed: steps shrink for ever where a gait
#: vanishes at a value of a key, as of the push-off against a slope.
VANISHING, _LEAST_LOG_ANGLE = "vanishing step", -21.0
#: Largest difference of event times from those of a simulated step.
_SAME_TIMES = 1e-3
#: Rounding of rates and durations at an end of walking.
_AT_END = 1e-6
#: Distance of the last unknown from a value that is rounding.
_AT_VALUE = 1e-9
#: Distance of a point from a border that is rounding.
AT_BORDER = 1e-10
#: Share of the way to a border at which a curve begins on it; and that of a segment to
#: which a turning is located.
_BEGINS_THERE, _TURNING = 1e-9, 1e-11


def walks(equations: Equations, X: Gait) -> bool:
    """Return whether a point's step happens, or at an end of walking is the limit of
    steps that do.

    Parameters
    ----------
    equations : Equations
    X : ndarray, shape (u,)
    """
    problem = equations.problem_at(X[:, None])
    Z, _ = equations.split(X[:, None])
    times = Z[problem.m : -1]
    if any(condition.walking for condition in equations.conditions):
        # Kneestrike is not late, and the foot does not rise as it strikes.
        stride, _ = problem.stride(Z[:-1], Z[-1])
        is_in_order = (times > 0).all()
        is_in_order &= (np.diff(times[:, 0]) > -_AT_END).all()
        falls = stride.closing[-1, 0] < _AT_END * stride.y[0, 0]
        return bool(is_in_order and falls)

    y = np.exp(Z[:1]) * np.vstack([np.ones((1, 1)), Z[1 : problem.m]])
    step = simulate_step(problem, y, np.exp(Z[-1]), exact=False)
    has_struck = step.outcome[0] == STRUCK
    return bool(has_struck and np.abs(step.times - times).max() < _SAME_TIMES)


class _Followed(engine.Tracks):
    """A curve in progress from one point in several directions (n,), side by side, in a
    window of its f last unknowns, whose edges are (f, 2).

    `ends` are the last points that the directions have within the window, with the
    tangents there, each (u, 1): those on the border. One that begins on the border and
    leaves there has none, both (u, 0).
    """

    def __init__(
        self,
        equations: Equations,
        first: engine.Point,
        directions: PerLane,
        edges: ndarray,
    ):
        self.equations, self.edges = equations, edges
        upward = first.direction * (np.sign(first.direction[-1, 0]) or 1.0)
        n = len(directions)
        super().__init__(
            _CONTROL, np.repeat(first.Z, n, axis=1), upward * directions, _FIRST_STEP
        )
        self.ends = [(self.Z[:, :0], self.tangent[:, :0])] * n

    def correct(
        self,
        tracks: Numbers,
        guess: Coordinates,
        border: Coordinates,
    ) -> engine.Point:
        equations = self.equations.some(np.zeros(len(tracks), int))
        return correct_on_curve(equations, guess, border)

    def judge(
        self,
        tracks: Numbers,
        point: engine.Point,
        guess: Coordinates,
        error: PerLane,
    ) -> tuple[ndarray, ndarray]:
        # A step beyond the window is taken if it shows where the curve crosses the
        # border; otherwise a shorter one is tried.
        fair = ~point.ok | self._is_inside(point.Z)
        for lane in np.flatnonzero(~fair).tolist():
            beyond = lanes_of(point, slice(lane, lane + 1))
            fair[lane] = self._finds_border(int(tracks[lane]), beyond)
        return fair, error / self.step[tracks]

    def reasons(
        self,
        tracks: Numbers,
        point: engine.Point,
        last: Coordinates,
    ) -> ndarray:
        reasons = np.where(self._is_inside(point.Z), "", BORDER).astype(object)
        reasons[~keeps_apart(last, point.Z, self.equations.problem)] = HALVED
        reasons[point.Z[0] < _LEAST_LOG_ANGLE] = VANISHING
        return reasons

    def _nearest_within(self, Z: Coordinates) -> ndarray:
        """The nearest values of the last unknowns within the window, (f, n)."""
        low = self.edges[:, :1]
        high = self.edges[:, 1:]
        return np.clip(Z[-len(self.edges) :], low, high)

    def _is_inside(self, Z: Coordinates) -> ndarray:
        within = self._nearest_within(Z) == Z[-len(self.edges) :]
        return np.asarray(within.all(axis=0))

    def _finds_border(
        self, track: int, beyond: engine.Point, is_second: bool = False
    ) -> bool:
        """Find a track's point on the border, between its last point and one beyond the
        window, as its end; and whether there is one.
        """
        last, tangent = self.Z[:, [track]], self.tangent[:, [track]]
        share, component, value = self._crossing(last, beyond.Z)
        if share < _BEGINS_THERE:
            return True

        after = beyond.oriented(tangent).direction
        length = norm(beyond.Z - last)
        guess = hermite((last, tangent), (beyond.Z, after), length, share)
        guess[component] = value
        border = np.eye(len(guess))[:, [component]]
        found = correct_on_curve(self.equations, guess, border)
        if not found.ok[0]:
            return False

        nearest = self._nearest_within(found.Z)
        beside = np.abs(found.Z[-len(nearest) :] - nearest).max()
        if beside > AT_BORDER:  # another edge comes first
            return not is_second and self._finds_border(track, found, True)
        # Beside the border there may be no walker.
        found.Z[-len(nearest) :] = nearest
        self.ends[track] = found.Z, found.oriented(tangent).direction
        return True

    def _crossing(
        self, last: Coordinates, beyond: Coordinates
    ) -> tuple[float, int, float]:
        """The edge that the chord from a point (u, 1) to one beyond the window crosses
        first: at which share of it, which component, from the last, and its value there.
        """
        f = len(self.edges)
        nearest = self._nearest_within(beyond)
        out = np.flatnonzero(nearest != beyond[-f:])
        shares = (nearest - last[-f:])[out, 0] / (beyond - last)[-f:][out, 0]
        share, component = min(zip(shares.tolist(), (out - f).tolist(), strict=True))
        return share, component, float(nearest[component, 0])


def _ended(track: Track, end: OnCurve) -> Track:
    """A track up to the border, or once round. One that meets a flip of half as many
    steps keeps its first point beyond it, so that its last segment spans the flip.
    """
    if track.stop_reason == CLOSED:  # at its start, beyond which the last point lies
        track.Z[:, -1] = track.Z[:, 0]
        track.tangent[:, -1] = track.tangent[:, 0]

    if track.stop_reason != BORDER:
        return track

    # The last point lies beyond the window: that on the border takes its place.
    X, tangent = end

    return Track(
        np.hstack([track.Z[:, :-1], X]),
        np.hstack([track.tangent[:, :-1], tangent]),
        BORDER,
    )


def follow_both_directions(
    equations: Equations,
    first: engine.Point,
    window: ndarray,
) -> tuple[ndarray, ndarray, tuple[str, str]]:
    """Follow a curve from a point on it in both directions, side by side, up to the
    window's border, or once round.

    Parameters
    ----------
    equations : Equations
        One fewer than unknowns.
    first : Point
        Where it begins.
    window : ndarray, shape (f, 2)
        Least and largest value of each of the f last unknowns, those beside state and
        event times, as X counts them.

    Returns
    -------
    X, tangent : ndarray, shape (p, u)
        Points in the order of increasing arclength, and the tangents there.
    stopped : tuple of str
        Why it was followed no further at the first and at the last.
    """
    tracks = _Followed(equations, first, np.array([1.0, -1.0]), window)
    up, down = map(_ended, tracks.follow(_MAX_POINTS), tracks.ends)
    if up.stop_reason == CLOSED:
        return up.Z.T, up.tangent.T, (CLOSED, CLOSED)
    X, tangent = joined(down, up)
    return X.T, tangent.T, (down.stop_reason, up.stop_reason)


def at_value(equations: Equations, points: ndarray, value: float) -> list[Gait]:
    """Return the points at which a curve passes a value of the last unknown.

    Parameters
    ----------
    equations : Equations
        One fewer than unknowns.
    points : ndarray, shape (p, u)
        Of the curve, in order, as `follow_both_directions` returns them.
    value : float

    Returns
    -------
    list of ndarray, shape (u,)
        Its own points among them.
    """
    off = points[:, -1] - value
    is_at = np.abs(off) < _AT_VALUE
    found = [*points[is_at]]

    across = across_last(points.shape[1])
    passes = (off[1:] * off[:-1] < 0) & ~is_at[1:] & ~is_at[:-1]
    for k in np.flatnonzero(passes).tolist():
        share = off[k] / (off[k] - off[k + 1])
        guess = (1 - share) * points[k] + share * points[k + 1]
        passed = correct_on_curve(equations, guess[:, None], across)
        if passed.ok[0]:
            found.append(passed.Z[:, 0])

    return found


def across_last(unknowns: int) -> Coordinates:
    """Return the direction (u, 1) of the last unknown."""
    return np.eye(unknowns)[:, [-1]]


def turning(
    equations: Equations,
    a: OnCurve,
    b: OnCurve,
    component: int,
) -> tuple[ndarray, float] | None:
    """Locate where a component of the curve's tangent vanishes between two points or at
    one of them; None where it keeps its sign.

    Parameters
    ----------
    equations : Equations
    a, b : OnCurve
    component : int
        -1 for the last unknown, -2 for the one before.

    Returns
    -------
    X : ndarray, shape (u,)
    error : float
        Of the last unknown but one: Newton's last step, how far the tangent shows that
        the turning lies from the point, and how far it moves when the tangent's
        differences are taken over twice the step.

    Notes
    -----
    Where the key turns along a curve of folds, two branches of gaits touch and exchange
    their halves; where the slope turns as well, two folds annihilate (a cusp).
    """
    at_a = a[1][component]
    at_b = b[1][component]
    if at_a * at_b > 0 or at_a == at_b:
        return None

    length = float(np.linalg.norm(b[0] - a[0]))
    chord = ((b[0] - a[0]) / length)[:, None]

    def corrected(share: float) -> engine.Point:
        guess = hermite(a, b, length, share)[:, None]
        return correct_on_curve(equations, guess, chord).oriented(chord)

    def rate(share: float) -> float:
        return float(corrected(share).direction[component, 0])

    try:
        share = bracketed_root(rate, 0.0, 1.0, _TURNING)
    except ValueError:
        # Corrected anew, both points have the component on one side by rounding: the
        # nearer one is the turning.
        share = float(abs(at_a) > abs(at_b))

    turn = corrected(share)
    if not turn.ok[0]:
        return None

    rates = abs(at_b - at_a) / length
    moved = _off(equations, turn, component) / rates + _TURNING * length
    error = turn.last_step[0] + moved * abs(turn.direction[-2, 0])
    return turn.Z[:, 0], float(error) + 8 * EPS


def _off(equations: Equations, turn: engine.Point, component: int) -> float:
    """How far a component of the tangent is from zero at a turning, and from what it is
    by differences over twice the step.
    """
    tangent = turn.direction[:, 0]
    derivative = equations.at(turn.Z, 2 * DIFFERENCE).derivative[..., 0]
    coarse = np.linalg.svd(derivative)[2][-1]
    coarse = coarse * np.sign(total(coarse * tangent))
    change = abs(coarse[component] - tangent[component])
    return float(change + abs(tangent[component]))
