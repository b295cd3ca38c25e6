"""Curves of special points in two parameters: folds, flips and ends of walking in slope and one walker key.

A point of a fold or a flip is U = (w, q, k): similarity coordinates of the section, q = ln slope and the key over its
scale. It solves P(y) = y together with one smooth scalar g: det(I - A) for a fold, det(I + A) for a flip. Derivatives
of P by y and slope are exact, all others are central differences, evaluated as further lanes of one call.

Where walking ends in a tangential heelstrike its time is no smooth function of the rest. So the time is an unknown,
U = (w, T, q, k), with the equation that the foot is on the ground, and g is the rate of the heelstrike guard. Where
heelstrike coincides with kneestrike, g is the height of the foot at kneestrike. Nothing is singular where both meet.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from tasks.continuation import pseudo_arclength as engine
from tasks.continuation.joint import determinants, linearised
from tasks.continuation.root import passes
from tasks.mechanics.lumped import constants_of, structure_of
from tasks.step.problem import Lanes
from tasks.step.simulate import STRUCK, scanner
from tasks.step.simulate import stride as simulate_step
from tasks.step.step_map import Stride, StrideMap, stride_map
from tasks.walkers.walker import Walker, WalkerError

#: Relative step of the central differences.
DIFFERENCE = 1e-5
_NEWTON = engine.Newton(max_iterations=14, max_step=0.5, small=1e-8, shrinking=0.3)
#: Steps grow where the predictor's error over their length is below the target, and are kept elsewhere.
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
_MAX_POINTS = 5000
#: Why a curve is followed no further.
BORDER, CLOSED, LOST, TOO_MANY = "border", "closed", "no further point", "too many points"


def _shifted_det(sign: float) -> Callable[[Stride], np.ndarray]:
    """Test function det(I + sign A) of a step's Jacobian A."""

    def value(stride: Stride) -> np.ndarray:
        A = np.moveaxis(stride.jacobian, -1, 0)
        return determinants(np.eye(A.shape[1]) + sign * A)

    return value


#: The scalar g that vanishes at folds and at flips.
SCALARS: dict[str, Callable[[Stride], np.ndarray]] = {"fold": _shifted_det(-1.0), "flip": _shifted_det(1.0)}
#: Time after kneestrike to which steps that end there are integrated; its value has no effect [sqrt(leg/g)].
_TIME_BEYOND = 0.1
#: The ends of walking that can be followed.
ENDS = ("end_kneestrike_at_heelstrike", "end_tangential_heelstrike")


@dataclass
class Point:
    """A point of a curve.

    Attributes
    ----------
    U, tangent : ndarray, shape (u,)
        The point and the curve's unit tangent.
    times : ndarray, shape (k,) [sqrt(leg/g)]
        Event times.
    ok : bool
        Whether Newton converged.
    error : float
        Size of the last Newton step.
    stopped : str
        Why the curve was followed no further; empty between its ends.
    """

    U: np.ndarray
    times: np.ndarray
    tangent: np.ndarray
    ok: bool
    error: float
    stopped: str = ""


class Curve:
    """The equations of folds or flips over slope and a key; `scale`, its range, is the key's unit in U.

    Parameters
    ----------
    kind : str
        Of SCALARS, or of ENDS for `End`.
    walker_at : callable
        The walker at a value of the key.
    value : float
        An ordinary value: constants that vanish only at special ones stay parameters.
    limits : tuple of float
        Least and largest value of the key.
    """

    def __init__(self, kind: str, walker_at: Callable[[float], Walker], value: float, limits: tuple[float, float]):
        self.kind, self.walker_at, self.limits, self.scale = kind, walker_at, limits, limits[1] - limits[0]
        self.structure = structure_of(walker_at(value))
        self.map: StrideMap = stride_map(self.structure)
        self.m = self.map.m

    def walker(self, U: np.ndarray) -> Walker:
        """Return the walker at a point, or at the limit of the key where it lies beyond.

        Parameters
        ----------
        U : ndarray, shape (u,)
        """
        return self.walker_at(float(np.clip(U[-1] * self.scale, *self.limits)))

    def begin(self, X: np.ndarray, times: np.ndarray, value: float) -> np.ndarray:
        """Return U for a line's point at a value of the key.

        Parameters
        ----------
        X : ndarray, shape (m + 1,)
            Similarity coordinates and ln slope.
        times : ndarray, shape (k,) [sqrt(leg/g)]
            Event times.
        value : float
            Of the key.

        Returns
        -------
        ndarray, shape (u,)
        """
        return np.append(X, value / self.scale)

    def _section(self, U: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Section coordinates and parameters at points U (u, n), each with a walker of its own."""
        angle = np.exp(U[0])
        size = np.full(U.shape[1], np.exp2(np.floor(np.log2(angle[0]))))
        parameters = np.vstack([np.exp(U[-2]), size, self._constants(U[-1] * self.scale)])
        return np.vstack([angle, angle * U[1 : self.m]]) / size, parameters

    def _constants(self, values: np.ndarray) -> np.ndarray:
        """Constants at values of the key (n,); beyond its limits, where there may be no walker, continued linearly."""
        inner = np.clip(values, *self.limits)
        places = [inner] if (inner == values).all() else [inner, 2 * inner - values]
        at = [constants_of([self.walker_at(v) for v in each.tolist()], self.structure) for each in places]
        return 2 * at[0] - at[1] if len(at) > 1 else at[0]

    def system(
        self, U: np.ndarray, times: np.ndarray, h: float = DIFFERENCE
    ) -> tuple[np.ndarray, np.ndarray, Callable[[np.ndarray], np.ndarray]]:
        """Evaluate the equations at one point.

        Parameters
        ----------
        U : ndarray, shape (u,)
        times : ndarray, shape (k,) [sqrt(leg/g)]
            Event times to begin with.
        h : float
            Step of the central differences.

        Returns
        -------
        residual : ndarray, shape (u - 1,)
        derivative : ndarray, shape (u - 1, u)
        times_after : callable
            Event times after a change of U.
        """
        m = self.m
        lanes = _neighbours(U, h)
        y, parameters = self._section(lanes)
        # The Jacobian is as accurate as the event times: each lane first corrects its own.
        own_times = self.map(y, np.repeat(times[:, None], lanes.shape[1], axis=1), parameters, slope=True).times
        steps = self.map(y, own_times, parameters, slope=True)
        residual, by_X = linearised(steps, lanes[: m + 1])
        g = SCALARS[self.kind](steps)
        derivative = np.zeros((m + 1, m + 2))
        derivative[:m, : m + 1] = by_X[0]
        derivative[:m, m + 1] = (residual[-2] - residual[-1]) / (2 * h)
        derivative[m] = (g[1::2] - g[2::2]) / (2 * h)
        by_y, by_slope = steps.times_by_y[:, :, 0], steps.times_by_slope[:, 0]

        def times_after(dU: np.ndarray) -> np.ndarray:
            y = steps.y[:, 0]
            dy = np.append(dU[0] * y[0], y[0] * dU[1:m] + dU[0] * y[1:])
            return steps.times[:, 0] + by_y @ dy + by_slope * np.exp(U[m]) * dU[m]

        return np.append(residual[0], g[0]), derivative, times_after

    def correct(self, U: np.ndarray, times: np.ndarray, border: np.ndarray) -> Point:
        """Correct a point of the curve in the plane through U normal to `border`, by Newton.

        Parameters
        ----------
        U, border : ndarray, shape (u,)
        times : ndarray, shape (k,) [sqrt(leg/g)]
            Event times to begin with.
        """
        normal = np.pad(border, (0, len(times)))[:, None]
        return self._point(self._correct_lanes(np.append(U, times)[:, None], normal, len(U)), border)

    def _correct_lanes(self, Z: np.ndarray, border: np.ndarray, u: int) -> engine.Corrected:
        """Correct n points Z = (U, times), shape (u + k, n), in the planes normal to `border`."""
        return engine.bordered_newton(lambda lanes, Z: self._linearise(Z, u), lambda *_: 1e-14, _NEWTON, Z, border, u)

    def _point(self, at: engine.Corrected, direction: np.ndarray) -> Point:
        """Return the one corrected point, its tangent on the side of a direction (u,)."""
        u = len(direction)
        if not at.ok[0]:
            return Point(np.full(u, np.nan), at.Z[u:, 0], direction, False, np.inf)
        tangent = at.direction[:u, 0] * (np.sign(at.direction[:u, 0] @ direction) or 1.0)
        return Point(at.Z[:u, 0], at.Z[u:, 0], tangent, True, float(at.error[0]))

    def _linearise(self, Z: np.ndarray, u: int) -> engine.Linearisation:
        """The equations at n points; NaN where there is no such walker."""
        k, n = len(Z) - u, Z.shape[1]
        residual, derivative = np.full((n, u - 1), np.nan), np.full((n, u - 1, u), np.nan)
        times_by, late = np.full((k, u, n), np.nan), np.full((k, n), np.nan)
        for i in range(n):
            try:
                residual[i], derivative[i], times_after = self.system(Z[:u, i], Z[u:, i])
            except WalkerError:
                continue
            own = times_after(np.zeros(u))
            times_by[..., i] = np.transpose([times_after(e) - own for e in np.eye(u)])
            late[:, i] = own - Z[u:, i]
        return engine.Linearisation(residual, derivative, times_by, late)

    def walks(self, point: Point) -> bool:
        """Whether the strikes solved for are the first ones of the step, by simulation."""
        U = point.U
        y = np.append(np.exp(U[0]), np.exp(U[0]) * U[1 : self.m])[:, None]
        # At a special value the walker alone would have a map of fewer dimensions.
        step = simulate_step(Lanes([self.walker(U)], self.structure), y, np.exp(U[self.m : self.m + 1]), exact=False)
        return bool(step.outcome[0] == STRUCK and np.abs(step.times[:, 0] - point.times).max() < 1e-3)


class End(Curve):
    """The equations of an end of walking: heelstrike coincides with kneestrike, or is tangential."""

    def _end_of_step(self, U: np.ndarray, times: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Integrate steps to their end at points U (u, n).

        Returns
        -------
        y : ndarray, shape (m, n)
            Section coordinates at the start.
        final : ndarray, shape (4, n)
            Scaled state of the locked legs at the end.
        times : ndarray, shape (k, n)
            Event times.
        parameters : ndarray, shape (n_parameters, n)
        """
        y, parameters = self._section(U)
        if len(times) == 1:
            step = self.map(y, U[self.m][None], parameters, samples=1)
            return y, step.motion[-1][-1], U[self.m][None], parameters
        tangential = self.kind == "end_tangential_heelstrike"
        knee = np.full(U.shape[1], times[0])
        # The error of kneestrike's time, squared each time, must not show in the differences.
        for _ in range(3):
            heel = U[self.m] if tangential else knee + _TIME_BEYOND
            step = self.map(y, np.vstack([knee, heel]), parameters, samples=int(tangential))
            knee = step.times[0]
        if tangential:
            return y, step.motion[-1][-1], np.vstack([knee, heel]), parameters
        # Heelstrike is at kneestrike: the knee has just locked.
        return y, scanner(self.structure).lock(step.knee, parameters), np.vstack([knee, knee]), parameters

    def begin(self, X: np.ndarray, times: np.ndarray, value: float) -> np.ndarray:
        """Return U, as `Curve.begin` does, with the time of a tangential heelstrike."""
        heel = times[-1:] if self.kind == "end_tangential_heelstrike" else times[:0]
        return np.concatenate([X[:-1], heel, X[-1:], [value / self.scale]])

    def system(
        self, U: np.ndarray, times: np.ndarray, h: float = DIFFERENCE
    ) -> tuple[np.ndarray, np.ndarray, Callable[[np.ndarray], np.ndarray]]:
        """Evaluate the equations at one point, as `Curve.system` does."""
        y, final, own_times, parameters = self._end_of_step(_neighbours(U, h), times)
        a, b, a_rate, b_rate = final
        image = final[1:] if self.structure.kneed else scanner(self.structure).strike(final, parameters)
        rate = [a_rate + b_rate] if self.kind == "end_tangential_heelstrike" else []
        G = np.vstack([*(image - y), a + b, *rate]) / y[0]
        derivative, times_by_U = ((v[:, 1::2] - v[:, 2::2]) / (2 * h) for v in (G, own_times))
        return G[:, 0], derivative, lambda dU: own_times[:, 0] + times_by_U @ dU

    def walks(self, point: Point) -> bool:
        """Whether walking ends here: kneestrike is not late, and the foot does not rise as it strikes."""
        y, final, times, _ = self._end_of_step(point.U[:, None], point.times)
        early = (times > 0).all() and (np.diff(times[:, 0]) > -1e-6).all()
        return bool(early and final[2, 0] + final[3, 0] < 1e-6 * y[0, 0])


def _neighbours(U: np.ndarray, h: float) -> np.ndarray:
    """U, then U + h and U - h along each axis, shape (u, 1 + 2 u)."""
    lanes = [U]
    for step in h * np.eye(len(U)):
        lanes += [U + step, U - step]
    return np.array(lanes).T


def follow(
    curve: Curve, first: Point, direction: float, window: Mapping[str, tuple[float, float]], step: float = 0.02
) -> list[Point]:
    """Follow a curve from a point on it up to the window's border, or until it closes.

    Parameters
    ----------
    first : Point
        Where it begins.
    direction : float
        1 towards increasing values of the key, -1 towards decreasing ones.
    window : mapping
        `q` (ln slope) and `key`: least and largest value of each.
    step : float
        Length of the first continuation step.
    """
    first.tangent = first.tangent * (np.sign(first.tangent[-1] or 1.0) * direction)
    points, u = [first], len(first.U)

    def judge(point: engine.Corrected, guess: np.ndarray, error: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.ones(1, bool), error / step

    while len(points) < _MAX_POINTS and step > _CONTROL.shortest:
        last = points[-1]
        track = engine.Tracks(
            _CONTROL, engine.column(last.U, last.times), engine.column(last.tangent, 0 * last.times), step, u
        )
        if len(points) > 1:
            back = np.linalg.norm(last.U - points[-2].U)
            track.turning = engine.column(last.tangent - points[-2].tangent, 0 * last.times) / back
            track.tangent[u:, 0] = (last.times - points[-2].times) / back
        corrected, fair = track.advance(np.array([0]), lambda Z, border: curve._correct_lanes(Z, border, u), judge)
        if fair[0]:
            new = curve._point(corrected, last.tangent)
            if (leaves := _exit(curve, last, new, window)) is None:
                if len(points) > 3 and passes(first.U, first.tangent, last.U, last.tangent, new.U, new.tangent):
                    return [*points, replace(first, stopped=CLOSED)]
                points.append(new)
                step = float(track.step[0])
                continue
            component, edge, share = leaves
            if share < 1e-9:  # it begins there
                return [*points[:-1], replace(last, stopped=BORDER)]
            guess = last.U + share * (new.U - last.U)
            guess[component] = edge
            new = curve.correct(guess, last.times + share * (new.times - last.times), np.eye(u)[component])
            if new.ok:
                new.tangent *= np.sign(new.tangent @ last.tangent) or 1.0
                return [*points, replace(new, stopped=BORDER)]
        step *= _CONTROL.reduction
    points[-1].stopped = LOST if len(points) < _MAX_POINTS else TOO_MANY
    return points


def _exit(
    curve: Curve, last: Point, new: Point, window: Mapping[str, tuple[float, float]]
) -> tuple[int, float, float] | None:
    """Component of U in which a continuation step leaves the window, the border, and the share of the step up to it."""
    exits = []
    for component, (low, high) in ((-2, window["q"]), (-1, np.array(window["key"]) / curve.scale)):
        edge = float(np.clip(new.U[component], low, high))
        if edge != new.U[component]:
            share = float((edge - last.U[component]) / (new.U[component] - last.U[component]))
            exits.append((component, edge, share))
    return min(exits, key=lambda each: each[2], default=None)


def turning(curve: Curve, a: Point, b: Point, component: int) -> Point | None:
    """Locate where one component of the curve's tangent vanishes between two points; None where it keeps its sign.

    Notes
    -----
    Where the key turns along a curve of folds, two branches of gaits touch and exchange their halves; where the slope
    turns as well, two folds annihilate (a cusp). `error` of the point is that of ln slope: Newton's last step, and how
    far the turning moves when the tangent's differences are taken over twice the step.
    """
    if a.tangent[component] * b.tangent[component] >= 0:
        return None
    u, length = len(a.U), float(np.linalg.norm(b.U - a.U))

    def at(Z: np.ndarray, direction: np.ndarray) -> Point:
        return curve.correct(Z[:u], Z[u:], direction[:u])

    ends = [curve.correct(p.U, p.times, (b.U - a.U) / length) for p in (a, b)]
    if not all(p.ok for p in ends) or ends[0].tangent[component] * ends[1].tangent[component] >= 0:
        return None
    one, other = ((np.append(p.U, p.times), np.append(p.tangent, 0 * p.times)) for p in (a, b))
    turn = engine.root_between(one, other, u, at, lambda point: float(point.tangent[component]), 1e-11)
    curvature = abs(ends[1].tangent[component] - ends[0].tangent[component]) / length
    coarse = np.linalg.svd(curve.system(turn.U, turn.times, 2 * DIFFERENCE)[1])[2][-1]
    coarse *= np.sign(coarse @ turn.tangent)
    moved = abs(coarse[component] - turn.tangent[component]) / curvature + 1e-11 * length
    turn.error += float(moved * abs(turn.tangent[-2])) + 8 * np.finfo(float).eps
    return turn
