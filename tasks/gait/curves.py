"""Curves of special points in two parameters: folds, flips and ends of walking in slope and one walker key.

A point is U = (w, q, k): similarity coordinates of the section, q = ln slope and the key over its scale. It solves
P(y) = y together with one smooth scalar g: det(I - A) for a fold, det(I + A) for a flip, the gap between the strikes or
the closing rate of the heel for an end. Both are zero along the curve, which is followed by pseudo-arclength;
derivatives of P by y and slope are exact, all others are central differences, flown as further lanes of one call.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from tasks.gait.continuation import linearised
from tasks.gait.fixed_point import Problem
from tasks.gait.stride import Stride, StrideMap, stride_map
from tasks.gait.strides import STRUCK
from tasks.gait.strides import stride as flown
from tasks.mechanics.lumped import constants_of, structure_of
from tasks.walkers.parameters import Walker, WalkerError

#: Relative step of the central differences, and acceptance of a step along a curve.
DIFFERENCE, MOST_BEND = 1e-5, 0.1
SHORTEST, MOST_POINTS = 5e-4, 300


def _shifted_det(sign: float) -> Callable[[Stride], np.ndarray]:
    def value(stride: Stride) -> np.ndarray:
        A = np.moveaxis(stride.jacobian, -1, 0)
        good = np.isfinite(A).all(axis=(1, 2))
        out = np.full(len(A), np.nan)
        out[good] = np.linalg.det(np.eye(A.shape[1]) + sign * A[good])
        return out

    return value


#: The scalar that vanishes with each kind of point.
SCALARS: dict[str, Callable[[Stride], np.ndarray]] = {
    "fold": _shifted_det(-1.0),
    "flip": _shifted_det(1.0),
    "end_kneestrike_at_heelstrike": lambda stride: stride.times[-1] - stride.times[0],
    "end_tangential_heelstrike": lambda stride: stride.closing / stride.y[0],
}


@dataclass
class Point:
    """A point of a curve: U (m + 2,), its event times (k,), the curve's tangent there, and whether it was found."""

    U: np.ndarray
    times: np.ndarray
    tangent: np.ndarray
    ok: bool
    error: float


class Curve:
    """The equations of one kind of point over slope and a key."""

    def __init__(self, kind: str, walker_at: Callable[[float], Walker], value: float, scale: float):
        self.kind, self.walker_at, self.scale, self.scalar = kind, walker_at, scale, SCALARS[kind]
        # A value off any special one: constants that vanish only there stay parameters.
        self.structure = structure_of(walker_at(value + 1e-3 * scale))
        self.map: StrideMap = stride_map(self.structure)
        self.m = self.map.m

    def walker(self, U: np.ndarray) -> Walker:
        """The walker at a point."""
        return self.walker_at(float(U[-1] * self.scale))

    def _strides(self, U: np.ndarray, times: np.ndarray) -> Stride:
        """Strides at points U (m + 2, n), each with a walker of its own."""
        m = self.m
        angle = np.exp(U[0])
        size = np.full(U.shape[1], np.exp2(np.floor(np.log2(angle[0]))))
        constants = np.array([constants_of(self.walker(u), self.structure) for u in U.T]).T
        parameters = np.vstack([np.exp(U[m]), size, constants.reshape(-1, U.shape[1])])
        y = np.vstack([angle, angle * U[1:m]]) / size
        # The Jacobian is as good as the times it is taken at: each lane first finds its own.
        own = self.map(y, np.repeat(times[:, None], U.shape[1], axis=1), parameters, slope=True).times
        return self.map(y, own, parameters, slope=True)

    def system(self, U: np.ndarray, times: np.ndarray) -> tuple[np.ndarray, np.ndarray, Stride]:
        """Residual (m + 1,) and derivative (m + 1, m + 2) at one point, and its strides."""
        m = self.m
        lanes = [U]
        for i in range(m + 2):
            step = np.zeros(m + 2)
            step[i] = DIFFERENCE
            lanes += [U + step, U - step]
        at = self._strides(np.array(lanes).T, times)
        residual, derivative = linearised(at, np.array(lanes).T[: m + 1])
        g = self.scalar(at)
        full = np.zeros((m + 1, m + 2))
        full[:m, : m + 1] = derivative[0]
        full[:m, m + 1] = (residual[-2] - residual[-1]) / (2 * DIFFERENCE)
        full[m] = (g[1::2] - g[2::2]) / (2 * DIFFERENCE)
        return np.append(residual[0], g[0]), full, at

    def correct(self, U: np.ndarray, times: np.ndarray, border: np.ndarray, most: int = 14) -> Point:
        """The curve's point in the plane through U normal to `border`."""
        start, last, size = U.copy(), np.inf, np.inf
        lost = Point(U * np.nan, times, border, False, np.inf)
        for _ in range(most):
            try:
                residual, derivative, at = self.system(U, times)
            except WalkerError:
                return lost
            matrix = np.vstack([derivative, border])
            if not (np.isfinite(matrix).all() and np.isfinite(residual).all()):
                return lost
            try:
                dU = np.linalg.solve(matrix, np.append(-residual, border @ (start - U)))
                tangent = np.linalg.solve(matrix, np.append(np.zeros(self.m + 1), 1.0))
            except np.linalg.LinAlgError:
                return lost
            size = float(np.abs(dU).max())
            if size > 0.5:
                return lost
            U = U + dU
            by_y = at.times_by_y[:, :, 0]
            dy = np.append(dU[0] * at.y[0, 0], at.y[0, 0] * dU[1:self.m] + dU[0] * at.y[1:, 0])
            times = at.times[:, 0] + by_y @ dy + at.times_by_slope[:, 0] * np.exp(U[self.m]) * dU[self.m]
            if size < 1e-14 or (size < 1e-8 and size > 0.3 * last):
                return Point(U, times, tangent / np.linalg.norm(tangent), True, size)
            last = size
        return lost

    def walks(self, point: Point) -> bool:
        """True where the strikes solved for are the first ones; an end itself lies on the edge and counts."""
        problem = Problem(self.walker(point.U))
        w = point.U
        y = np.append(np.exp(w[0]), np.exp(w[0]) * w[1:self.m])[:, None]
        now = flown(problem, y, np.exp(w[self.m:self.m + 1]), exact=False)
        if self.kind.startswith("end"):
            return bool((point.times > 0).all() and (np.diff(point.times) > -1e-6).all())
        return bool(now.outcome[0] == STRUCK and np.abs(now.times[:, 0] - point.times).max() < 1e-3)


def follow(curve: Curve, first: Point, way: float, window: Mapping[str, tuple[float, float]],
           step: float = 0.02) -> list[Point]:
    """A curve from a point on it, towards rising (`way` = 1) or falling keys, to the window's edge.

    Parameters
    ----------
    window : mapping
        `q` and `key`: least and largest value of each.
    """
    sign = np.sign(first.tangent[-1] or 1.0) * way
    first.tangent = first.tangent * sign
    points = [first]
    while len(points) < MOST_POINTS and step > SHORTEST:
        here = points[-1]
        guess, times = here.U + step * here.tangent, here.times
        if len(points) > 1:
            back = np.linalg.norm(here.U - points[-2].U)
            guess += 0.5 * step**2 * (here.tangent - points[-2].tangent) / back
            times = times + (here.times - points[-2].times) * step / back
        new = curve.correct(guess, times, here.tangent)
        bend = np.linalg.norm(new.U - guess) / step if new.ok else np.inf
        if bend < MOST_BEND and new.tangent @ here.tangent > 0.95:
            points.append(new)
            key = new.U[-1] * curve.scale
            if not (window["q"][0] <= new.U[curve.m] <= window["q"][1] and window["key"][0] <= key <= window["key"][1]):
                break
            step = min(0.1, step * (1.5 if bend < 0.3 * MOST_BEND else 1.0))
        else:
            step *= 0.4
    return points


def turning(curve: Curve, a: Point, b: Point, component: int) -> Point | None:
    """Where one component of the curve's tangent vanishes between two points; None where it keeps its sign.

    Notes
    -----
    Where the key turns along a curve of folds, two branches of gaits touch and re-pair; where the slope turns as well,
    two folds annihilate (a cusp).
    """
    if a.tangent[component] * b.tangent[component] >= 0:
        return None
    length = np.linalg.norm(b.U - a.U)
    way = (b.U - a.U) / length

    def at(s: float) -> Point:
        h = s / length
        U = (a.U * (1 + 2 * h) * (1 - h) ** 2 + length * a.tangent * h * (1 - h) ** 2
             + b.U * h * h * (3 - 2 * h) + length * b.tangent * h * h * (h - 1))
        point = curve.correct(U, a.times * (1 - h) + b.times * h, way)
        if point.tangent @ way < 0:
            point.tangent = -point.tangent
        return point

    ends = [at(0.0), at(length)]
    if not all(p.ok for p in ends) or ends[0].tangent[component] * ends[1].tangent[component] >= 0:
        return None
    return at(brentq(lambda s: at(s).tangent[component], 0.0, length, xtol=1e-11 * length, maxiter=50))
