"""Branches of gaits followed in slope, through folds, to their ends.

A point is X = (w, q): similarity coordinates of the section (ln angle, rates/angle) and q = ln slope; the event times
follow as functions of X. Bordered Newton with exact derivatives, tangents from the null vector, second-order
predictor, steps by predictor error and turning angle. Several branches advance side by side in SIMD lanes.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from tasks.fixed_points.newton import LONGEST_PERIOD
from tasks.fixed_points.step_check import verify_steps
from tasks.step.problem import EPS, Problem
from tasks.step.step_map import Stride, matvec

#: Slopes a branch is followed over [rad]; below, double precision no longer resolves a gait's tangent.
MIN_SLOPE, MAX_SLOPE = 1e-13, 0.7
#: Largest ln of a stance angle that is no fall.
HIGHEST = 0.5
LONGEST_STEP, SHORTEST_STEP = 0.5, 1e-7
#: Acceptance of a step: largest predictor error and turning angle.
MAX_ERROR, MAX_TURN = 0.02, 0.3
MAX_NODES = 1500
#: A change of side over a longer step than this is a jump to a branch nearby; over a shorter one branches cross.
CROSSING = 1e-4
#: Points after which a branch is asked whether it still describes steps.
CHECK_EVERY = 12


@dataclass
class Point:
    """Corrected points of n branches: X (m + 1, n), times (k, n), tangents of both, and whether Newton converged.

    `stride` is the last one flown, at the point or a Newton step away; `derivative` (n, m, m + 1) of its P(y) - y by X.
    """

    X: np.ndarray
    times: np.ndarray
    tangent: np.ndarray
    times_tangent: np.ndarray
    ok: np.ndarray
    stride: Stride
    derivative: np.ndarray


def linearised(stride: Stride, X: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Residual P(y) - y and its derivative by X, shapes (n, m) and (n, m, m + 1)."""
    m, n = stride.y.shape
    assert stride.by_slope is not None
    frame = np.zeros((m, m, n))
    frame[:, 0] = stride.y
    for i in range(1, m):
        frame[i, i] = stride.y[0]
    J = stride.jacobian - np.eye(m)[:, :, None]
    by_w = np.einsum("ijn,jkn->ikn", J, frame)
    by_q = stride.by_slope * np.exp(X[m])
    # Rows over the angle: of order one on any slope.
    full = np.concatenate([by_w, by_q[:, None]], axis=1) / stride.y[0]
    return ((stride.image - stride.y) / stride.y[0]).T, full.transpose(2, 0, 1)


def _times_by_X(stride: Stride, X: np.ndarray) -> np.ndarray:
    """Derivative of the event times by X, shape (k, m + 1, n)."""
    m = len(stride.y)
    assert stride.times_by_slope is not None
    by_first = matvec(stride.times_by_y, stride.y)[:, None]
    by_rest = stride.times_by_y[:, 1:] * stride.y[0]
    return np.concatenate([by_first, by_rest, (stride.times_by_slope * np.exp(X[m]))[:, None]], axis=1)


# Where heelstrike is tangential to the last digit the map has no derivative.
@np.errstate(invalid="ignore", over="ignore")
def correct(problem: Problem, X: np.ndarray, times: np.ndarray, border: np.ndarray | None, most: int = 8) -> Point:
    """Bordered Newton: the solution in the plane through X normal to `border` (None: at fixed slope).

    Parameters
    ----------
    X : ndarray, shape (m + 1, n)
    times : ndarray, shape (k, n)
    border : ndarray, shape (m + 1, n)
    """
    m, n = problem.m, X.shape[1]
    if border is None:
        border = np.zeros((m + 1, n))
        border[m] = 1
    X, times = X.copy(), times.copy()
    start = X.copy()
    ok, over, last = np.zeros(n, bool), np.zeros(n, bool), np.full(n, np.inf)
    for _ in range(most):
        stride, _ = problem.stride(np.vstack([X[:m], times]), X[m], slope=True)
        residual, derivative = linearised(stride, X)
        matrix = np.concatenate([derivative, border.T[:, None]], axis=1)
        right = np.concatenate([-residual, (border * (start - X)).sum(axis=0)[:, None]], axis=1)
        good = np.isfinite(matrix).all(axis=(1, 2)) & np.isfinite(right).all(axis=1)
        # Where heelstrike is tangential but for the last digits, the derivative is infinite or one row over and over.
        good[good] = np.linalg.det(matrix[good]) != 0
        matrix[~good], right[~good] = np.eye(m + 1), 0.0
        dX = np.linalg.solve(matrix, right[:, :, None])[:, :, 0].T
        size = np.abs(dX).max(axis=0)
        by_X = _times_by_X(stride, X)
        new_times = stride.times + matvec(by_X, dX)
        over |= ~good | (size > 1.0) | ~np.isfinite(new_times).all(axis=0)
        moving = ~over & ~ok
        X[:, moving] += dX[:, moving]
        times[:, moving] = new_times[:, moving]
        rounding_std = _noise(matrix, stride)
        ok |= moving & ((size < rounding_std) | ((size < 1e-9) & (size > 0.2 * last)))
        last = size
        if (ok | over).all():
            break
    _, _, V = np.linalg.svd(np.nan_to_num(derivative))
    tangent = V[:, -1].T
    by_X = np.nan_to_num(by_X)
    return Point(X, times, tangent, matvec(by_X, tangent), ok, stride, derivative)


def _noise(matrix: np.ndarray, stride: Stride) -> np.ndarray:
    """Size of a bordered Newton step that rounding alone makes, shape (n,)."""
    inverse = np.abs(np.linalg.inv(matrix))
    error = np.abs(stride.y) + matvec(np.abs(stride.jacobian), np.abs(stride.y))
    error = np.nan_to_num(np.vstack([error / stride.y[0], np.ones(error.shape[1])]))
    return 6 * EPS * np.einsum("nij,jn->in", inverse, error).max(axis=0)


@dataclass
class BranchTrace:
    """One branch followed in one direction: its points so far, and why it stopped."""

    X: list[np.ndarray] = field(default_factory=list)
    times: list[np.ndarray] = field(default_factory=list)
    tangent: list[np.ndarray] = field(default_factory=list)
    times_tangent: list[np.ndarray] = field(default_factory=list)
    step: float = 0.05
    side: float = 0.0
    stopped: str = ""

    def append(self, point: Point, lane: int, orientation: np.ndarray) -> None:
        sign = 1.0 if point.tangent[:, lane] @ orientation >= 0 else -1.0
        self.X.append(point.X[:, lane].copy())
        self.times.append(point.times[:, lane].copy())
        self.tangent.append(sign * point.tangent[:, lane])
        self.times_tangent.append(sign * point.times_tangent[:, lane])

    def predict(self) -> np.ndarray:
        """Next point: the tangent, bent by how it turned over the last step."""
        X, t, h = self.X[-1], self.tangent[-1], self.step
        if len(self.X) < 2:
            return X + h * t
        back = np.linalg.norm(X - self.X[-2])
        return X + h * t + 0.5 * h * h * (t - self.tangent[-2]) / back

    def predict_times(self) -> np.ndarray:
        return self.times[-1] + self.step * self.times_tangent[-1]

    def judge(self, m: int) -> str:
        """Why the branch stops here, or nothing."""
        X, times = self.X[-1], self.times[-1]
        if not np.log(MIN_SLOPE) < X[m] < np.log(MAX_SLOPE):
            return "end of the window"
        if X[0] < -40:
            return "zero step length"
        if fall_margin(X, times) > 0:
            return "a fall"
        if np.abs(X[1:m]).max() > 30:
            return "zero step length"
        if len(times) == 2 and times[1] < times[0] - 0.5:
            return "heelstrike before kneestrike"
        return "too many points" if len(self.X) > MAX_NODES else ""


def fall_margin(X: np.ndarray, times: np.ndarray) -> float:
    """Positive where a gait's angle or period is beyond those of a fall."""
    return float(max(X[0] - HIGHEST, times[-1] - LONGEST_PERIOD))


def follow(problem: Problem, w: np.ndarray, log_slope: np.ndarray) -> list[list[BranchTrace]]:
    """Follow branches both ways from solved gaits.

    Parameters
    ----------
    w : ndarray, shape (m + k, n)
        Gaits in similarity coordinates.
    log_slope : ndarray, shape (n,)

    Returns
    -------
    list of [Track down, Track up]
        One pair a start, in its order; both begin with the start itself.
    """
    m, n = problem.m, w.shape[1]
    first = correct(problem, np.vstack([w[:m], log_slope]), w[m:], None)
    upwards = np.zeros((m + 1, n))
    upwards[m] = 1.0
    sides = np.sign(branch_point_determinant(first, upwards))
    pairs: list[list[BranchTrace]] = []
    for lane in range(n):
        pair = [BranchTrace(), BranchTrace()]
        for track, way in zip(pair, (-1.0, 1.0)):
            orientation = np.zeros(m + 1)
            orientation[m] = way
            track.append(first, lane, orientation)
            track.side = sides[lane] * way
            if not first.ok[lane]:
                track.stopped = "no start"
        pairs.append(pair)
    tracks = [t for pair in pairs for t in pair]
    while True:
        active = [t for t in tracks if not t.stopped]
        if not active:
            return pairs
        guess = np.array([t.predict() for t in active]).T
        times = np.array([t.predict_times() for t in active]).T
        border = np.array([t.tangent[-1] for t in active]).T
        point = correct(problem, guess, times, border)
        sides = np.sign(branch_point_determinant(point, border))
        for lane, track in enumerate(active):
            error = np.linalg.norm(point.X[:, lane] - guess[:, lane])
            turn = abs(point.tangent[:, lane] @ track.tangent[-1])
            fair = point.ok[lane] and error < MAX_ERROR and turn > np.cos(MAX_TURN)
            if fair and not (track.side * sides[lane] < 0 and track.step > CROSSING):
                track.side = sides[lane]
                track.append(point, lane, track.tangent[-1])
                track.stopped = track.judge(m)
                if not track.stopped and len(track.X) % CHECK_EVERY == 0 and not _steps(problem, track):
                    track.stopped = "not a step"
                growth = (2e-3 / max(error, 1e-12)) ** (1 / 3)
                track.step = min(LONGEST_STEP, track.step * min(2.0, max(0.4, growth)))
            else:
                track.step *= 0.3
                if track.step < SHORTEST_STEP:
                    track.stopped = "no further point"


# Where heelstrike is tangential to the last digit the map has no derivative.
@np.errstate(invalid="ignore", over="ignore")
def branch_point_determinant(point: Point, way: np.ndarray) -> np.ndarray:
    """Determinant of [J - I; slope column | tangent], (n,), tangents pointing along `way`: zero where branches cross.

    Its sign is the same all along a branch, and another on one that almost touches it.
    """
    tangent = point.tangent * np.sign((point.tangent * way).sum(axis=0))
    return np.linalg.det(np.concatenate([point.derivative, tangent.T[:, None]], axis=1))


def _steps(problem: Problem, track: BranchTrace) -> bool:
    """True where the last points of a track are steps that really happen."""
    recent = slice(-CHECK_EVERY // 3, None)
    X, times = np.array(track.X[recent]).T, np.array(track.times[recent]).T
    _, verdict = verify_steps(problem, np.vstack([X[: problem.m], times]), X[problem.m])
    return bool(verdict.step.any())
