"""Curves of special points in two parameters: folds, flips and ends of walking in slope and one walker key.

A point of a fold or a flip is U = (w, q, k): similarity coordinates of the section, q = ln slope and the key over its
scale. It solves P(y) = y together with one smooth scalar g: det(I - A) for a fold, det(I + A) for a flip. Derivatives
of P by y and slope are exact, all others are central differences, flown as further lanes of one call.

Where walking ends heelstrike may be at no rate, and its time is no function of the rest. So there it is an unknown,
U = (w, T, q, k), beside the height of the foot, and g is that rate. Where heelstrike comes with kneestrike, the height
of the foot at kneestrike is g. Nothing is singular where the two ends meet. Curves are followed by pseudo-arclength.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from tasks.continuation.root import bracketed_root
from tasks.continuation.tracking import linearised
from tasks.mechanics.lumped import constants_of, structure_of
from tasks.step.problem import Problem
from tasks.step.simulate import STRUCK, scanner
from tasks.step.simulate import stride as flown
from tasks.step.step_map import Stride, StrideMap, stride_map
from tasks.walkers.walker import Walker, WalkerError

#: Relative step of the central differences, and acceptance of a step along a curve.
DIFFERENCE, MAX_BEND = 1e-5, 0.1
SHORTEST, MAX_POINTS = 5e-4, 300


def _shifted_det(sign: float) -> Callable[[Stride], np.ndarray]:
    def value(stride: Stride) -> np.ndarray:
        A = np.moveaxis(stride.jacobian, -1, 0)
        good = np.isfinite(A).all(axis=(1, 2))
        out = np.full(len(A), np.nan)
        out[good] = np.linalg.det(np.eye(A.shape[1]) + sign * A[good])
        return out

    return value


#: The scalar that vanishes with folds and flips.
SCALARS: dict[str, Callable[[Stride], np.ndarray]] = {"fold": _shifted_det(-1.0), "flip": _shifted_det(1.0)}
#: How much longer steps are flown that end at kneestrike, for a flight of some length.
SOME_TIME = 0.1
#: The ends of walking that can be followed.
ENDS = ("end_kneestrike_at_heelstrike", "end_tangential_heelstrike")


@dataclass
class Point:
    """A point of a curve: U, event times (k,), the curve's tangent, whether it was found, and Newton's last step."""

    U: np.ndarray
    times: np.ndarray
    tangent: np.ndarray
    ok: bool
    error: float


class Curve:
    """The equations of folds or flips over slope and a key."""

    def __init__(self, kind: str, walker_at: Callable[[float], Walker], value: float, scale: float):
        self.kind, self.walker_at, self.scale = kind, walker_at, scale
        self.structure = structure_of(walker_at(value))
        self.map: StrideMap = stride_map(self.structure)
        self.m = self.map.m

    def walker(self, U: np.ndarray) -> Walker:
        """The walker at a point."""
        return self.walker_at(float(U[-1] * self.scale))

    def begin(self, X: np.ndarray, times: np.ndarray, value: float) -> np.ndarray:
        """U of a line's point (w, q) at a value of the key."""
        return np.append(X, value / self.scale)

    def _section(self, U: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Section coordinates and parameters at points U (size, n), each with a walker of its own."""
        angle = np.exp(U[0])
        size = np.full(U.shape[1], np.exp2(np.floor(np.log2(angle[0]))))
        constants = np.array([constants_of(self.walker(u), self.structure) for u in U.T]).T
        parameters = np.vstack([np.exp(U[-2]), size, constants.reshape(-1, U.shape[1])])
        return np.vstack([angle, angle * U[1 : self.m]]) / size, parameters

    def system(
        self, U: np.ndarray, times: np.ndarray, h: float = DIFFERENCE
    ) -> tuple[np.ndarray, np.ndarray, Callable[[np.ndarray], np.ndarray]]:
        """Residual (r,) and derivative (r, r + 1) at one point, and its event times after a change of U."""
        m = self.m
        lanes = _beside(U, h)
        y, parameters = self._section(lanes)
        # The Jacobian is as good as the times it is taken at: each lane first finds its own.
        own = self.map(y, np.repeat(times[:, None], lanes.shape[1], axis=1), parameters, slope=True).times
        at = self.map(y, own, parameters, slope=True)
        residual, derivative = linearised(at, lanes[: m + 1])
        g = SCALARS[self.kind](at)
        full = np.zeros((m + 1, m + 2))
        full[:m, : m + 1] = derivative[0]
        full[:m, m + 1] = (residual[-2] - residual[-1]) / (2 * h)
        full[m] = (g[1::2] - g[2::2]) / (2 * h)
        by_y, by_slope = at.times_by_y[:, :, 0], at.times_by_slope
        assert by_slope is not None

        def times_after(dU: np.ndarray) -> np.ndarray:
            dy = np.append(dU[0] * at.y[0, 0], at.y[0, 0] * dU[1:m] + dU[0] * at.y[1:, 0])
            return at.times[:, 0] + by_y @ dy + by_slope[:, 0] * np.exp(U[m]) * dU[m]

        return np.append(residual[0], g[0]), full, times_after

    def correct(self, U: np.ndarray, times: np.ndarray, border: np.ndarray, most: int = 14) -> Point:
        """The curve's point in the plane through U normal to `border`."""
        start, last, size = U.copy(), np.inf, np.inf
        lost = Point(U * np.nan, times, border, False, np.inf)
        for _ in range(most):
            try:
                residual, derivative, times_after = self.system(U, times)
            except WalkerError:
                return lost
            matrix = np.vstack([derivative, border])
            if not (np.isfinite(matrix).all() and np.isfinite(residual).all()):
                return lost
            try:
                dU = np.linalg.solve(matrix, np.append(-residual, border @ (start - U)))
                tangent = _null(derivative, border)
            except np.linalg.LinAlgError:
                return lost
            size = float(np.abs(dU).max())
            if size > 0.5:
                return lost
            U, times = U + dU, times_after(dU)
            if size < 1e-14 or (size < 1e-8 and size > 0.3 * last):
                return Point(U, times, tangent, True, size)
            last = size
        return lost

    def walks(self, point: Point) -> bool:
        """True where the strikes solved for are the first ones."""
        problem = Problem(self.walker(point.U))
        w = point.U
        y = np.append(np.exp(w[0]), np.exp(w[0]) * w[1 : self.m])[:, None]
        now = flown(problem, y, np.exp(w[self.m : self.m + 1]), exact=False)
        return bool(now.outcome[0] == STRUCK and np.abs(now.times[:, 0] - point.times).max() < 1e-3)


class End(Curve):
    """The equations of an end of walking: a foot that strikes as the knee does, or that strikes at no rate."""

    def flown(self, U: np.ndarray, times: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Steps up to their end at points U (size, n).

        Returns
        -------
        y (m, n), final : ndarray, shape (4, n)
            Section at the start, and motion of the locked legs at the end.
        times (k, n), parameters
        """
        y, parameters = self._section(U)
        if len(times) == 1:
            at = self.map(y, U[self.m][None], parameters, samples=1)
            assert at.motion is not None
            return y, at.motion[-1][-1], U[self.m][None], parameters
        tangential = self.kind == "end_tangential_heelstrike"
        knee = np.full(U.shape[1], times[0])
        # What kneestrike's time is off by, squared each time, must not show in differences.
        for _ in range(3):
            heel = U[self.m] if tangential else knee + SOME_TIME
            at = self.map(y, np.vstack([knee, heel]), parameters, samples=int(tangential))
            knee = at.times[0]
        if tangential:
            assert at.motion is not None
            return y, at.motion[-1][-1], np.vstack([knee, heel]), parameters
        # Heelstrike is at kneestrike: the legs have just locked.
        assert at.knee is not None
        return y, scanner(self.structure).lock(at.knee, parameters), np.vstack([knee, knee]), parameters

    def begin(self, X: np.ndarray, times: np.ndarray, value: float) -> np.ndarray:
        heel = times[-1:] if self.kind == "end_tangential_heelstrike" else times[:0]
        return np.concatenate([X[:-1], heel, X[-1:], [value / self.scale]])

    def system(
        self, U: np.ndarray, times: np.ndarray, h: float = DIFFERENCE
    ) -> tuple[np.ndarray, np.ndarray, Callable[[np.ndarray], np.ndarray]]:
        y, final, own, parameters = self.flown(_beside(U, h), times)
        a, b, a_rate, b_rate = final
        image = final[1:] if self.structure.kneed else scanner(self.structure).strike(final, parameters)
        rate = [a_rate + b_rate] if self.kind == "end_tangential_heelstrike" else []
        G = np.vstack([*(image - y), a + b, *rate]) / y[0]
        full, by = ((v[:, 1::2] - v[:, 2::2]) / (2 * h) for v in (G, own))
        return G[:, 0], full, lambda dU: own[:, 0] + by @ dU

    def walks(self, point: Point) -> bool:
        """True on the edge of walking itself: kneestrike is not late, and the foot does not rise as it strikes."""
        y, final, times, _ = self.flown(point.U[:, None], point.times)
        early = (times > 0).all() and (np.diff(times[:, 0]) > -1e-6).all()
        return bool(early and final[2, 0] + final[3, 0] < 1e-6 * y[0, 0])


def equations_of(kind: str, walker_at: Callable[[float], Walker], value: float, scale: float) -> Curve:
    """The equations of a kind of point over slope and a key that runs over about `scale`.

    `value` lies off any special one: constants that vanish only there stay parameters.
    """
    return (End if kind in ENDS else Curve)(kind, walker_at, value, scale)


def _beside(U: np.ndarray, h: float) -> np.ndarray:
    """U, then U moved by h and by -h along each axis, shape (size, 1 + 2 size)."""
    lanes = [U]
    for step in h * np.eye(len(U)):
        lanes += [U + step, U - step]
    return np.array(lanes).T


def _null(derivative: np.ndarray, border: np.ndarray) -> np.ndarray:
    """Unit vector that the derivative takes to zero, on the side of `border`."""
    tangent = np.linalg.solve(np.vstack([derivative, border]), np.append(np.zeros(len(derivative)), 1.0))
    return tangent / np.linalg.norm(tangent)


def follow(
    curve: Curve, first: Point, way: float, window: Mapping[str, tuple[float, float]], step: float = 0.02
) -> list[Point]:
    """A curve from a point on it, towards rising (`way` = 1) or falling keys, up to the window's border.

    Parameters
    ----------
    window : mapping
        `q` and `key`: least and largest value of each.
    """
    sign = np.sign(first.tangent[-1] or 1.0) * way
    first.tangent = first.tangent * sign
    points = [first]
    while len(points) < MAX_POINTS and step > SHORTEST:
        here = points[-1]
        guess, times = here.U + step * here.tangent, here.times
        if len(points) > 1:
            back = np.linalg.norm(here.U - points[-2].U)
            guess += 0.5 * step**2 * (here.tangent - points[-2].tangent) / back
            times = times + (here.times - points[-2].times) * step / back
        new = curve.correct(guess, times, here.tangent)
        bend = np.linalg.norm(new.U - guess) / step if new.ok else np.inf
        good = bend < MAX_BEND and new.tangent @ here.tangent > 0.95
        if good and (left := _left(curve, here, new, window)) is not None:
            component, edge, share = left
            if share < 1e-9:
                break  # it begins on the border
            guess, times = here.U + share * (new.U - here.U), here.times + share * (new.times - here.times)
            guess[component] = edge
            new = curve.correct(guess, times, np.eye(len(guess))[component])
            if new.ok:
                new.tangent *= np.sign(new.tangent @ here.tangent) or 1.0
                return [*points, new]
            good = False
        if good:
            points.append(new)
            step = min(0.1, step * (1.5 if bend < 0.3 * MAX_BEND else 1.0))
        else:
            step *= 0.4
    return points


def _left(
    curve: Curve, here: Point, new: Point, window: Mapping[str, tuple[float, float]]
) -> tuple[int, float, float] | None:
    """Where a step leaves the window: component of U, its border, and part of the step; None where it stays inside."""
    found = []
    for component, (low, high) in ((-2, window["q"]), (-1, np.array(window["key"]) / curve.scale)):
        edge = float(np.clip(new.U[component], low, high))
        if edge != new.U[component]:
            found.append((component, edge, (edge - here.U[component]) / (new.U[component] - here.U[component])))
    return min(found, key=lambda one: one[2], default=None)


def turning(curve: Curve, a: Point, b: Point, component: int) -> Point | None:
    """Where one component of the curve's tangent vanishes between two points; None where it keeps its sign.

    Notes
    -----
    Where the key turns along a curve of folds, two branches of gaits touch and re-pair; where the slope turns as well,
    two folds annihilate (a cusp). `error` of the point is that of ln slope: Newton's last step, and how far along the
    curve the turning moves when the tangent's differences are taken over twice the step.
    """
    if a.tangent[component] * b.tangent[component] >= 0:
        return None
    length = np.linalg.norm(b.U - a.U)
    way = (b.U - a.U) / length

    def at(s: float) -> Point:
        h = s / length
        U = (
            a.U * (1 + 2 * h) * (1 - h) ** 2
            + length * a.tangent * h * (1 - h) ** 2
            + b.U * h * h * (3 - 2 * h)
            + length * b.tangent * h * h * (h - 1)
        )
        point = curve.correct(U, a.times * (1 - h) + b.times * h, way)
        if point.tangent @ way < 0:
            point.tangent = -point.tangent
        return point

    ends = [at(0.0), at(length)]
    if not all(p.ok for p in ends) or ends[0].tangent[component] * ends[1].tangent[component] >= 0:
        return None
    found = at(bracketed_root(lambda s: at(s).tangent[component], 0.0, length, 1e-11 * length))
    bends = abs(ends[1].tangent[component] - ends[0].tangent[component]) / length
    again = _null(curve.system(found.U, found.times, 2 * DIFFERENCE)[1], found.tangent)
    moved = abs(again[component] - found.tangent[component]) / bends + 1e-11 * length
    found.error += float(moved * abs(found.tangent[-2])) + 8 * np.finfo(float).eps
    return found
