"""Branches of gaits continued in slope, through folds, to their ends.

A point is X = (w, q): similarity coordinates of the section (ln angle, rates/angle) and q = ln slope; the event times
follow as functions of X. Pseudo-arclength continuation: bordered Newton with exact derivatives, tangents from the null
vector, a second-order predictor, and step lengths by predictor error and turning angle. Several branches advance side
by side in SIMD lanes. In shapes, n counts lanes.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from tasks.fixed_points.newton import LONGEST_PERIOD
from tasks.fixed_points.step_check import verify_steps
from tasks.step.problem import EPS, Problem
from tasks.step.step_map import Stride, matvec

#: Slopes over which branches are followed [rad]; below, double precision no longer resolves a gait's tangent.
MIN_SLOPE, MAX_SLOPE = 1e-13, 0.7
#: Largest ln of a stance angle that is no fall.
_MAX_LOG_ANGLE = 0.5
_MAX_STEP, _MIN_STEP = 0.5, 1e-7
#: Acceptance of a continuation step: largest predictor error and turning angle [rad].
_MAX_ERROR, _MAX_TURN = 0.02, 0.3
_MAX_NODES = 1500
#: Where the sign of the branch point determinant changes over a longer step than this, Newton has jumped to a branch
#: nearby; over a shorter one branches cross.
_MAX_CROSSING_STEP = 1e-4
#: Number of points after which it is checked that a branch still consists of steps.
_CHECK_EVERY = 12


@dataclass
class Point:
    """Corrected points of n branches.

    Attributes
    ----------
    X, tangent : ndarray, shape (m + 1, n)
        The points and the branches' unit tangents there.
    times, times_tangent : ndarray, shape (k, n) [sqrt(leg/g)]
        Event times, and their derivatives along the branches.
    ok : ndarray of bool, shape (n,)
        Whether Newton converged.
    stride : Stride
        The last one evaluated, at the point or a Newton step away.
    derivative : ndarray, shape (n, m, m + 1)
        Of its P(y) - y by X.
    """

    X: np.ndarray
    times: np.ndarray
    tangent: np.ndarray
    times_tangent: np.ndarray
    ok: np.ndarray
    stride: Stride
    derivative: np.ndarray


def linearised(stride: Stride, X: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Residual and derivative of the fixed-point equations P(y) - y = 0, both over the stance angle.

    Parameters
    ----------
    stride : Stride
        Differentiated by the slope too.
    X : ndarray, shape (m + 1, n)
        Where it was evaluated.

    Returns
    -------
    residual : ndarray, shape (n, m)
    derivative : ndarray, shape (n, m, m + 1)
        By X.
    """
    m, n = stride.y.shape
    frame = np.zeros((m, m, n))
    frame[:, 0] = stride.y
    for i in range(1, m):
        frame[i, i] = stride.y[0]
    J = stride.jacobian - np.eye(m)[:, :, None]
    by_w = np.einsum("ijn,jkn->ikn", J, frame)
    by_q = stride.by_slope * np.exp(X[m])
    # Rows over the angle are of order one on any slope.
    derivative = np.concatenate([by_w, by_q[:, None]], axis=1) / stride.y[0]
    return ((stride.image - stride.y) / stride.y[0]).T, derivative.transpose(2, 0, 1)


def _times_by_X(stride: Stride, X: np.ndarray) -> np.ndarray:
    """Derivative of the event times by X, shape (k, m + 1, n)."""
    m = len(stride.y)
    by_first = matvec(stride.times_by_y, stride.y)[:, None]
    by_rest = stride.times_by_y[:, 1:] * stride.y[0]
    return np.concatenate([by_first, by_rest, (stride.times_by_slope * np.exp(X[m]))[:, None]], axis=1)


# Where heelstrike is tangential to the last digit the map has no derivative.
@np.errstate(invalid="ignore", over="ignore")
def correct(
    problem: Problem, X: np.ndarray, times: np.ndarray, border: np.ndarray | None, max_iterations: int = 8
) -> Point:
    """Correct points by bordered Newton: the solutions in the plane through X normal to `border`.

    Parameters
    ----------
    X : ndarray, shape (m + 1, n)
        Predicted points.
    times : ndarray, shape (k, n) [sqrt(leg/g)]
        Their event times.
    border : ndarray, shape (m + 1, n), or None
        None for solutions at fixed slope.
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
    X, times = X.copy(), times.copy()
    start = X.copy()
    ok, failed, last = np.zeros(n, bool), np.zeros(n, bool), np.full(n, np.inf)
    for _ in range(max_iterations):
        stride, _ = problem.stride(np.vstack([X[:m], times]), X[m], slope=True)
        residual, derivative = linearised(stride, X)
        matrix = np.concatenate([derivative, border.T[:, None]], axis=1)
        right = np.concatenate([-residual, (border * (start - X)).sum(axis=0)[:, None]], axis=1)
        solvable = np.isfinite(matrix).all(axis=(1, 2)) & np.isfinite(right).all(axis=1)
        # Where heelstrike is tangential but for the last digits, the derivative is infinite or its rows are equal.
        solvable[solvable] = np.linalg.det(matrix[solvable]) != 0
        matrix[~solvable], right[~solvable] = np.eye(m + 1), 0.0
        dX = np.linalg.solve(matrix, right[:, :, None])[:, :, 0].T
        size = np.abs(dX).max(axis=0)
        by_X = _times_by_X(stride, X)
        new_times = stride.times + matvec(by_X, dX)
        failed |= ~solvable | (size > 1.0) | ~np.isfinite(new_times).all(axis=0)
        moving = ~failed & ~ok
        X[:, moving] += dX[:, moving]
        times[:, moving] = new_times[:, moving]
        ok |= moving & ((size < _rounding_step(matrix, stride)) | ((size < 1e-9) & (size > 0.2 * last)))
        last = size
        if (ok | failed).all():
            break
    _, _, V = np.linalg.svd(np.nan_to_num(derivative))
    tangent = V[:, -1].T
    by_X = np.nan_to_num(by_X)
    return Point(X, times, tangent, matvec(by_X, tangent), ok, stride, derivative)


def _rounding_step(matrix: np.ndarray, stride: Stride) -> np.ndarray:
    """Size of a bordered Newton step that rounding alone makes, shape (n,)."""
    inverse = np.abs(np.linalg.inv(matrix))
    error = np.abs(stride.y) + matvec(np.abs(stride.jacobian), np.abs(stride.y))
    error = np.nan_to_num(np.vstack([error / stride.y[0], np.ones(error.shape[1])]))
    return 6 * EPS * np.einsum("nij,jn->in", inverse, error).max(axis=0)


@dataclass
class BranchTrace:
    """One branch followed in one direction: its points so far, and why it stops.

    Attributes
    ----------
    X, tangent : list of ndarray, shape (m + 1,)
        Points and unit tangents.
    times, times_tangent : list of ndarray, shape (k,)
        Event times, and their derivatives along the branch.
    step : float
        Length of the next continuation step.
    side : float
        Sign of the branch point determinant.
    stop_reason : str
        Empty while the branch continues.
    """

    X: list[np.ndarray] = field(default_factory=list)
    times: list[np.ndarray] = field(default_factory=list)
    tangent: list[np.ndarray] = field(default_factory=list)
    times_tangent: list[np.ndarray] = field(default_factory=list)
    step: float = 0.05
    side: float = 0.0
    stop_reason: str = ""

    def append(self, point: Point, lane: int, orientation: np.ndarray) -> None:
        """Add the point of a lane.

        Parameters
        ----------
        point : Point
        lane : int
        orientation : ndarray, shape (m + 1,)
            The side to which the tangent is turned.
        """
        sign = 1.0 if point.tangent[:, lane] @ orientation >= 0 else -1.0
        self.X.append(point.X[:, lane].copy())
        self.times.append(point.times[:, lane].copy())
        self.tangent.append(sign * point.tangent[:, lane])
        self.times_tangent.append(sign * point.times_tangent[:, lane])

    def predict(self) -> np.ndarray:
        """Predict the next point along the tangent, bent as it turned over the last step.

        Returns
        -------
        ndarray, shape (m + 1,)
        """
        X, t, h = self.X[-1], self.tangent[-1], self.step
        if len(self.X) < 2:
            return X + h * t
        back = np.linalg.norm(X - self.X[-2])
        return X + h * t + 0.5 * h * h * (t - self.tangent[-2]) / back

    def predict_times(self) -> np.ndarray:
        """Predict the next point's event times.

        Returns
        -------
        ndarray, shape (k,) [sqrt(leg/g)]
        """
        return self.times[-1] + self.step * self.times_tangent[-1]

    def reason_to_stop(self, m: int) -> str:
        """Return why the branch stops at its last point; empty where it continues."""
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
        return "too many points" if len(self.X) > _MAX_NODES else ""


def fall_margin(X: np.ndarray, times: np.ndarray) -> float:
    """Return a number that is positive where a gait's angle or period exceeds those of walking.

    Parameters
    ----------
    X : ndarray, shape (m + 1,)
        Similarity coordinates and ln slope.
    times : ndarray, shape (k,) [sqrt(leg/g)]
        Event times.
    """
    return float(max(X[0] - _MAX_LOG_ANGLE, times[-1] - LONGEST_PERIOD))


def follow(problem: Problem, w: np.ndarray, log_slope: np.ndarray) -> list[list[BranchTrace]]:
    """Follow branches in both directions from solved gaits.

    Parameters
    ----------
    w : ndarray, shape (m + k, n)
        Gaits in similarity coordinates.
    log_slope : ndarray, shape (n,)
        ln of the slope in rad.

    Returns
    -------
    list of [BranchTrace, BranchTrace]
        For each gait the traces towards lower and higher slopes; both begin with the gait itself.
    """
    m, n = problem.m, w.shape[1]
    first = correct(problem, np.vstack([w[:m], log_slope]), w[m:], None)
    upwards = np.zeros((m + 1, n))
    upwards[m] = 1.0
    sides = np.sign(branch_point_determinant(first, upwards))
    pairs: list[list[BranchTrace]] = []
    for lane in range(n):
        pair = [BranchTrace(), BranchTrace()]
        for trace, sign in zip(pair, (-1.0, 1.0), strict=True):
            trace.append(first, lane, sign * upwards[:, lane])
            trace.side = sides[lane] * sign
            if not first.ok[lane]:
                trace.stop_reason = "no start"
        pairs.append(pair)
    traces = [trace for pair in pairs for trace in pair]
    while True:
        active = [trace for trace in traces if not trace.stop_reason]
        if not active:
            return pairs
        guess = np.array([trace.predict() for trace in active]).T
        times = np.array([trace.predict_times() for trace in active]).T
        border = np.array([trace.tangent[-1] for trace in active]).T
        point = correct(problem, guess, times, border)
        sides = np.sign(branch_point_determinant(point, border))
        for lane, trace in enumerate(active):
            error = float(np.linalg.norm(point.X[:, lane] - guess[:, lane]))
            turn = abs(point.tangent[:, lane] @ trace.tangent[-1])
            is_fair = point.ok[lane] and error < _MAX_ERROR and turn > np.cos(_MAX_TURN)
            if is_fair and not (trace.side * sides[lane] < 0 and trace.step > _MAX_CROSSING_STEP):
                trace.side = sides[lane]
                trace.append(point, lane, trace.tangent[-1])
                trace.stop_reason = trace.reason_to_stop(m)
                if not trace.stop_reason and len(trace.X) % _CHECK_EVERY == 0 and not _are_steps(problem, trace):
                    trace.stop_reason = "not a step"
                growth = (2e-3 / max(error, 1e-12)) ** (1 / 3)
                trace.step = min(_MAX_STEP, trace.step * min(2.0, max(0.4, growth)))
            else:
                trace.step *= 0.3
                if trace.step < _MIN_STEP:
                    trace.stop_reason = "no further point"


# Where heelstrike is tangential to the last digit the map has no derivative.
@np.errstate(invalid="ignore", over="ignore")
def branch_point_determinant(point: Point, direction: np.ndarray) -> np.ndarray:
    """Determinant that vanishes where branches cross, of the derivative by X and the tangent as its last row.

    Parameters
    ----------
    point : Point
        Of n branches.
    direction : ndarray, shape (m + 1, n)
        The side on which the tangents are taken to point.

    Returns
    -------
    ndarray, shape (n,)
        Its sign is the same all along a branch, and the opposite on one that almost touches it.
    """
    tangent = point.tangent * np.sign((point.tangent * direction).sum(axis=0))
    return np.linalg.det(np.concatenate([point.derivative, tangent.T[:, None]], axis=1))


def _are_steps(problem: Problem, trace: BranchTrace) -> bool:
    """Whether any of the last points of a trace is a step that happens."""
    recent = slice(-_CHECK_EVERY // 3, None)
    X, times = np.array(trace.X[recent]).T, np.array(trace.times[recent]).T
    _, check = verify_steps(problem, np.vstack([X[: problem.m], times]), X[problem.m])
    return bool(check.step.any())
