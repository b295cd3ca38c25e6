"""Curves of special points in two parameters: folds, flips and ends of walking in slope
and one walker key.

A point is (Z, key): that of a gait, then the key over its range. It solves the defining
equations (`tasks.continuation.defining`) with the key as a further unknown. Nothing is
singular where strikes turn tangential or coincide, so ends are followed as folds and
flips are.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from gaitsweep.tasks.continuation import pseudo_arclength as engine
from gaitsweep.tasks.continuation.defining import joint_derivative
from gaitsweep.tasks.continuation.joint import but_times
from gaitsweep.tasks.continuation.pseudo_arclength import CLOSED, Track, joined
from gaitsweep.tasks.continuation.root import OnCurve, bracketed_root, hermite
from gaitsweep.tasks.mechanics.lumped import structure_of
from gaitsweep.tasks.mechanics.sums import norm, total
from gaitsweep.tasks.step.problem import Lanes, Problem
from gaitsweep.tasks.step.simulate import STRUCK
from gaitsweep.tasks.step.simulate import stride as simulate_step
from gaitsweep.tasks.walkers.walker import Walker, WalkerError

#: Step of the central differences by Z and by the key over its range.
DIFFERENCE = 1e-5
_NEWTON = engine.Newton(max_iterations=14, max_step=0.5, small=1e-8, shrinking=0.3)
#: Newton step that is rounding.
_ROUNDING_STEP = 1e-14
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


@dataclass
class _AtPoint:
    """The equations at a point, to first order, in arrays of one lane."""

    residual: np.ndarray
    derivative: np.ndarray


class Curve:
    """The equations of special points over slope and a key.

    Parameters
    ----------
    kind : str
        Of `defining.SCALARS`.
    walker_at : callable
        The walker at a value of the key.
    value : float
        An ordinary value: constants that vanish only at special ones stay parameters.
    limits : tuple of float
        Least and largest value of the key; its unit in Z is their difference, `scale`.
    """

    def __init__(
        self,
        kind: str,
        walker_at: Callable[[float], Walker],
        value: float,
        limits: tuple[float, float],
    ):
        self.kind, self.walker_at, self.limits, self.scale = (
            kind,
            walker_at,
            limits,
            limits[1] - limits[0],
        )
        self.structure = structure_of(walker_at(value))
        self.m = self.structure.dimension

    def value(self, Z: np.ndarray) -> float:
        """Return the key's value at a point Z (c,), or its limit where the point lies
        beyond.
        """
        return float(np.clip(Z[-1] * self.scale, *self.limits))

    def problem(self, Z: np.ndarray) -> Problem:
        """Return the step map at a point Z (c,)."""
        # At a special value the walker alone would have a map of fewer dimensions.
        return Lanes([self.walker_at(self.value(Z))], self.structure).alone(0)

    def _lanes(self, values: np.ndarray) -> Lanes:
        """The step map at values of the key (n,); beyond its limits, where there may be
        no walker, continued linearly.

        It is the constants that are continued.
        """
        inner = np.clip(values, *self.limits)
        lanes = Lanes([self.walker_at(v) for v in inner.tolist()], self.structure)
        if (inner != values).any():
            mirrored = Lanes(
                [self.walker_at(v) for v in (2 * inner - values).tolist()],
                self.structure,
            )
            lanes.constants = 2 * lanes.constants - mirrored.constants
        return lanes

    def system(
        self, Z: np.ndarray, h: float = DIFFERENCE
    ) -> tuple[np.ndarray, np.ndarray]:
        """Evaluate the equations at one point.

        Parameters
        ----------
        Z : ndarray, shape (c,)
        h : float
            Step of the central differences.

        Returns
        -------
        residual : ndarray, shape (c - 1,)
        derivative : ndarray, shape (c - 1, c)
        """
        lanes = self._lanes((Z[-1] + h * np.array([0.0, 1.0, -1.0])) * self.scale)
        return joint_derivative(lanes, self.kind, Z[:-1], np.array([h]), h=h)

    def correct(self, Z: np.ndarray, border: np.ndarray) -> engine.Point:
        """Correct a point of the curve in the plane through Z normal to `border`, both
        (c,) or (c, 1), by Newton.
        """
        Z, border = Z.reshape(-1, 1), border.reshape(-1, 1)
        sized = [*but_times(self.m)[:-1], -2, -1]
        return engine.bordered_newton(
            self._linearise, lambda *_: _ROUNDING_STEP, _NEWTON, Z, border, sized
        )

    def _linearise(self, lanes: np.ndarray, Z: np.ndarray) -> _AtPoint:
        """The equations at one point, as a lane; NaN where there is no such walker."""
        try:
            residual, derivative = self.system(Z[:, 0])
        except WalkerError:
            residual, derivative = (
                np.full(len(Z) - 1, np.nan),
                np.full((len(Z) - 1, len(Z)), np.nan),
            )
        return _AtPoint(residual[:, None], derivative[..., None])

    def walks(self, Z: np.ndarray) -> bool:
        """Whether a point's step happens, or at an end of walking is the limit of steps
        that do.
        """
        problem, w, q = self.problem(Z), Z[:-2, None], Z[-2:-1]
        times = w[self.m :]
        if self.kind.startswith("end_"):
            # Kneestrike is not late, and the foot does not rise as it strikes.
            stride, _ = problem.stride(w, q)
            early = (times > 0).all() and (np.diff(times[:, 0]) > -1e-6).all()
            return bool(early and stride.closing[-1, 0] < 1e-6 * stride.y[0, 0])
        y = np.exp(w[:1]) * np.vstack([np.ones((1, 1)), w[1 : self.m]])
        step = simulate_step(problem, y, np.exp(q), exact=False)
        return bool(
            step.outcome[0] == STRUCK and np.abs(step.times - times).max() < 1e-3
        )


class _Followed(engine.Tracks):
    """One curve in progress in a window of ln slope and key, whose edges are (2, 2).

    `end` is the last point that it has within the window, and the tangent there, both
    (c, 1): that on the border. Where the curve begins on the border and leaves there is
    none, both (c, 0).
    """

    def __init__(
        self, curve: Curve, first: engine.Point, direction: float, edges: np.ndarray
    ):
        self.curve, self.edges = curve, edges
        tangent = first.direction * (np.sign(first.direction[-1, 0]) or 1.0) * direction
        super().__init__(_CONTROL, first.Z, tangent, _FIRST_STEP)
        self.end = self.Z[:, :0], self.tangent[:, :0]

    def correct(
        self, tracks: np.ndarray, guess: np.ndarray, border: np.ndarray
    ) -> engine.Point:
        return self.curve.correct(guess, border)

    def judge(
        self,
        tracks: np.ndarray,
        point: engine.Point,
        guess: np.ndarray,
        error: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        # Beyond the window a step is fair if it leads to a point on the border: a
        # shorter one may.
        fair = not point.ok[0] or self._is_inside(point.Z) or self._ends(point)
        return np.array([fair]), error / self.step

    def reasons(
        self, tracks: np.ndarray, point: engine.Point, last: np.ndarray
    ) -> np.ndarray:
        return np.array(["" if self._is_inside(point.Z) else BORDER])

    def _inside(self, Z: np.ndarray) -> np.ndarray:
        """The nearest ln slope and key within the window, shape (2, 1)."""
        return np.clip(Z[-2:], self.edges[:, :1], self.edges[:, 1:])

    def _is_inside(self, Z: np.ndarray) -> bool:
        return bool((self._inside(Z) == Z[-2:]).all())

    def _ends(self, beyond: engine.Point) -> bool:
        """Whether the curve's point on the border is found, between its last point and
        one beyond the window.
        """
        edge, tangent = self._inside(beyond.Z), beyond.oriented(self.tangent).direction
        out = np.flatnonzero(edge != beyond.Z[-2:])
        shares = ((edge - self.Z[-2:]) / (beyond.Z - self.Z)[-2:])[out, 0]
        share, component = min(zip(shares.tolist(), (out - 2).tolist(), strict=True))
        if share < 1e-9:  # it begins there
            return True
        length = norm(beyond.Z - self.Z)
        guess = hermite((self.Z, self.tangent), (beyond.Z, tangent), length, share)
        guess[component] = edge[component]
        at = self.curve.correct(guess, np.eye(len(guess))[component])
        if at.ok[0]:
            self.end = at.Z, at.oriented(self.tangent).direction
        return bool(at.ok[0])


def follow(
    curve: Curve,
    first: engine.Point,
    direction: float,
    window: Mapping[str, tuple[float, float]],
) -> Track:
    """Follow a curve from a point on it up to the window's border, or until it closes.

    Parameters
    ----------
    first : Point
        Where it begins.
    direction : float
        1 towards increasing values of the key, -1 towards decreasing ones.
    window : mapping
        `q` (ln slope) and `key`: least and largest value of each.
    """
    tracks = _Followed(
        curve,
        first,
        direction,
        np.array([window["q"], np.array(window["key"]) / curve.scale]),
    )
    (track,) = tracks.follow(_MAX_POINTS)
    if track.stop_reason == CLOSED:  # at its start, beyond which the last point lies
        track.Z[:, -1], track.tangent[:, -1] = track.Z[:, 0], track.tangent[:, 0]
    if track.stop_reason != BORDER:
        return track
    # The last point lies beyond the window: that on the border takes its place.
    Z, tangent = (
        np.hstack([each[:, :-1], end])
        for each, end in zip((track.Z, track.tangent), tracks.end, strict=True)
    )
    return Track(Z, tangent, BORDER)


def follow_both_directions(
    curve: Curve, first: engine.Point, window: Mapping[str, tuple[float, float]]
) -> tuple[np.ndarray, np.ndarray, tuple[str, str]]:
    """Follow a curve from a point on it in both directions, or once round.

    Returns
    -------
    Z, tangent : ndarray, shape (p, c)
        Points in the order of increasing arclength, and the tangents there.
    stopped : tuple of str
        Why it was followed no further at the first and at the last.
    """
    up = follow(curve, first, 1.0, window)
    if up.stop_reason == CLOSED:
        return up.Z.T, up.tangent.T, (CLOSED, CLOSED)
    down = follow(curve, first, -1.0, window)
    Z, tangent = joined(down, up)
    return Z.T, tangent.T, (down.stop_reason, up.stop_reason)


def turning(
    curve: Curve, a: OnCurve, b: OnCurve, component: int
) -> tuple[np.ndarray, float] | None:
    """Locate where a component of the curve's tangent vanishes between two points; None
    where it keeps its sign.

    Parameters
    ----------
    a, b : OnCurve

    Returns
    -------
    Z : ndarray, shape (c,)
    error : float
        Of ln slope: Newton's last step, how far the tangent shows that the turning lies
        from the point, and how far it moves when the tangent's differences are taken
        over twice the step.

    Notes
    -----
    Where the key turns along a curve of folds, two branches of gaits touch and exchange their halves; where the slope
    turns as well, two folds annihilate (a cusp).
    """
    if a[1][component] * b[1][component] >= 0:
        return None
    chord = b[0] - a[0]
    length = float(np.linalg.norm(chord))
    chord /= length

    def at(share: float) -> engine.Point:
        return curve.correct(hermite(a, b, length, share), chord).oriented(
            chord[:, None]
        )

    try:
        share = bracketed_root(
            lambda share: float(at(share).direction[component, 0]), 0.0, 1.0, 1e-11
        )
    except ValueError:  # corrected anew, both points have it on one side: rounding, and the nearer one is the turning
        share = float(abs(a[1][component]) > abs(b[1][component]))
    turn = at(share)
    if not turn.ok[0]:
        return None
    Z, tangent = turn.Z[:, 0], turn.direction[:, 0]
    derivative = curve.system(Z, 2 * DIFFERENCE)[1]
    coarse = np.linalg.svd(derivative)[2][-1]
    coarse *= np.sign(total(coarse * tangent))
    off = abs(coarse[component] - tangent[component]) + abs(tangent[component])
    moved = off * length / abs(b[1][component] - a[1][component])
    moved += 1e-11 * length
    return Z, float(turn.last_step[0] + moved * abs(tangent[-2])) + 8 * np.finfo(
        float
    ).eps
