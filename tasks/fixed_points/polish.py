"""From guesses to gaits: Newton's last steps, error bounds, more digits where needed, and whether steps happen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from tasks.fixed_points.newton import lipschitz as lipschitz_at
from tasks.fixed_points.newton import newton_step
from tasks.fixed_points.rounding import apply_newton_step, rounding, rounding_std
from tasks.fixed_points.step_check import verify_steps
from tasks.step import extended_precision
from tasks.step.problem import EPS, Problem, joint_sizes
from tasks.step.step_map import SAMPLES, Stride, matvec
from tasks.step.verify_step import strikes_fall_in_order

#: Leg passes where the atlas has not shown that a point's step happens.
UNKNOWN = -1
#: Newton steps a point may take from the atlas; nearly all take one.
MAX_STEPS = 8
#: Error bound in standard deviations of the measured rounding. Half a rounding of the image is added for the constants,
#: whose own rounding no change of units shows.
SAFETY_FACTOR = 16.0
#: Bound from which doubles alone show no gait.
_MAX_BOUND = 1e-3
#: Share of Newton's radius of convergence up to which the Lipschitz estimate of a segment's nodes serves its points.
_MAX_CONTRACTION = 0.1
#: States side by side by which the rounding of a gait alone is measured; a fine atlas averages over its nodes.
_NEAR_STATES = 3
#: Relative distance from the fixed point up to which multipliers are as accurate as there.
_NEAR = 2e-12


@dataclass
class Polished:
    """Gaits of n lanes.

    Attributes
    ----------
    y : ndarray, shape (m, n)
        Scaled section coordinates.
    state : ndarray, shape (angles, n)
        Scaled, just after heelstrike.
    times : ndarray, shape (phases, n) [sqrt(leg/g)]
    scale : ndarray, shape (n,)
        Power of two by which angles and rates are divided.
    stride : Stride
        The last step evaluated, its impacts corrected to the fixed point.
    bound, doubles : ndarray, shape (n,)
        Bound of the relative error of angle, rates and period; the same before any extended precision.
    jacobian_error : ndarray, shape (n,)
        Bound of the Frobenius norm of the error of the step map's derivative.
    converged, step : ndarray of bool, shape (n,)
        Whether Newton converged, and to a step that happens.
    leg_passes : ndarray of int, shape (n,)
        How often the swing leg passes the stance leg.
    """

    y: np.ndarray
    state: np.ndarray
    times: np.ndarray
    scale: np.ndarray
    stride: Stride
    bound: np.ndarray
    doubles: np.ndarray
    jacobian_error: np.ndarray
    converged: np.ndarray
    step: np.ndarray
    leg_passes: np.ndarray

    def assign(self, lanes: np.ndarray, other: Polished) -> None:
        """Replace some lanes by those of other gaits.

        Parameters
        ----------
        lanes : ndarray of int, shape (k,)
        other : Polished
            Of k lanes.
        """
        for name, values in vars(self).items():
            if isinstance(values, Stride):
                values.assign(lanes, other.stride)
            else:
                values[..., lanes] = getattr(other, name)


@dataclass(frozen=True)
class Guesses:
    """Guesses of n gaits, with what the atlas knows of the steps around them.

    `w` (m + k, n) similarity coordinates and event times; `slope` (n,) [rad]; `lipschitz` (n,) estimates of the Newton
    map and `rounding_std` (o, n) standard deviations that rounding gives angle, rates and period, over their
    `sensitivity`, both NaN where they are to be measured at the gait; `leg_passes` (n,) how often the legs pass where
    the step is known to happen, elsewhere UNKNOWN.
    """

    w: np.ndarray
    slope: np.ndarray
    lipschitz: np.ndarray
    rounding_std: np.ndarray
    leg_passes: np.ndarray


def join(parts: Sequence[Guesses]) -> Guesses:
    """Guesses of several parts, one after another."""
    return Guesses(*(np.concatenate([getattr(p, f.name) for p in parts], axis=-1) for f in fields(Guesses)))


def unmeasured(problem: Problem, w: np.ndarray, slope: np.ndarray) -> Guesses:
    """Guesses of which nothing is known: what their bounds need is measured at the gaits.

    Parameters
    ----------
    w : ndarray, shape (m + k, n)
    slope : ndarray, shape (n,) [rad]
    """
    n, outputs = len(slope), 2 + problem.map.start_size // 2
    return Guesses(w, slope, np.full(n, np.nan), np.full((outputs, n), np.nan), np.full(n, UNKNOWN))


def settle(problem: Problem, guesses: Guesses, sampled: bool = False, accuracy: float = 0.0) -> Polished:
    """Polish guesses and verify that they are steps.

    Parameters
    ----------
    problem : Problem
        Of one walker, or of a walker for each guess.
    guesses : Guesses
    sampled : bool
        Sample every motion that is integrated: cheaper where no guess's step is known to happen.
    accuracy : float
        Bound that nearly suffices; 0 for as good a bound as doubles give.
    """
    slope, leg_passes = guesses.slope, guesses.leg_passes
    stride, scale, w = _polish(problem, guesses.w, slope, guesses.lipschitz, SAMPLES if sampled else 0)
    eta = np.abs(newton_step(stride, w)).max(axis=0)
    lipschitz = _lipschitz_at_points(problem, w, slope, guesses.lipschitz, eta)
    std = _rounding_at_points(problem, w, slope, guesses.rounding_std)
    # The states at the impacts are corrected to the fixed point, as the times are.
    stride.impact = stride.impact + matvec(stride.impact_by_y, stride.newton)
    stride.knee = stride.knee + matvec(stride.knee_by_y, stride.newton)
    gait = apply_newton_step(problem, stride, problem.parameters(slope, scale))
    y, times, state = gait.y, gait.times, gait.state
    # How far the values move if the unknowns move by 1, each in its unit.
    moves = matvec(np.abs(gait.by_unknowns), joint_sizes(y, problem.phases))
    error = gait.sensitivity * (SAFETY_FACTOR * std + EPS / 2) + moves * 2 * lipschitz * eta**2
    bound = (error / gait.size).max(axis=0) + 2 * EPS
    doubles = bound.copy()
    near = eta < 1e-4
    converged = (bound < _MAX_BOUND) & (2 * lipschitz * eta < 1) & near
    amplification = (moves / gait.size).max(axis=0)
    # Where doubles do not show that Newton converges, the shrinking of its steps in more digits does.
    enough = 0.9 * accuracy or extended_precision.ESCALATE
    # Where Newton's steps in doubles are not trusted it begins again.
    lost = np.flatnonzero(~(near & (bound < extended_precision.UNTRUSTED)))
    first, unit = problem.section(guesses.w[:, lost])
    y[:, lost], times[:, lost] = first * (unit / scale[lost]), guesses.w[problem.m :, lost]
    for lane in np.flatnonzero(~(converged & (bound <= enough))).tolist():
        near_it = y[:, lane], times[:, lane], slope[lane], scale[lane]
        wide = extended_precision.refine(
            problem, lane, stride, *near_it, bound[lane], amplification[lane], 0.9 * accuracy
        )
        y[:, lane], times[:, lane], stride.impact[:, lane], state[:, lane] = wide.y, wide.times, wide.impact, wide.state
        bound[lane] = wide.bound
        converged[lane] = bound[lane] < extended_precision.ESCALATE_AGAIN
    step = strikes_fall_in_order(stride.closing, times)
    lanes = np.nonzero(leg_passes == UNKNOWN)[0]
    if len(lanes):
        known = stride.some(lanes) if sampled else None
        _, check = verify_steps(problem.some(lanes), w[:, lanes], np.log(slope[lanes]), known)
        step[lanes], leg_passes = check.step, leg_passes.copy()
        leg_passes[lanes] = check.leg_passes
    jacobian_error = _jacobian_error(problem.m, stride, lipschitz * (eta + doubles) + SAFETY_FACTOR * std.max(axis=0))
    return Polished(y, state, times, scale, stride, bound, doubles, jacobian_error, converged, step, leg_passes)


@np.errstate(divide="ignore", invalid="ignore", over="ignore")
def _jacobian_error(m: int, stride: Stride, error: np.ndarray) -> np.ndarray:
    """Bound of the error of dP/dy (n,), for a relative error (n,) of the derivative of the joint equations.

    That was integrated at the state before the last Newton step, and its integration rounds as the image does. dP/dy is
    what remains of it when the event times are eliminated, which divides by the rates of the guards.
    """
    size = np.sqrt((stride.derivative**2).sum(axis=(0, 1)))
    by_time = np.sqrt((stride.derivative[:m, m:-1] ** 2).sum(axis=(0, 1))) / np.abs(stride.closing).min(axis=0)
    times = np.sqrt((stride.times_by_y**2).sum(axis=(0, 1)))
    return np.asarray(size * (error + EPS) * (1 + by_time) * (1 + times))


def _lipschitz_at_points(
    problem: Problem, w: np.ndarray, slope: np.ndarray, lipschitz: np.ndarray, eta: np.ndarray
) -> np.ndarray:
    """Lipschitz estimates (n,), measured at the point itself where there is none or it does not suffice.

    At a fold the map at fixed slope is singular, and ever less so beside it: the estimate at that node says nothing of
    the segment.
    """
    lanes = np.nonzero(~(2 * lipschitz * eta <= _MAX_CONTRACTION))[0]
    if len(lanes):
        X = np.vstack([w[: problem.m, lanes], np.log(slope[lanes])])
        lipschitz = lipschitz.copy()
        lipschitz[lanes] = lipschitz_at(problem.some(lanes), X, w[problem.m :, lanes])
    return lipschitz


def _rounding_at_points(problem: Problem, w: np.ndarray, slope: np.ndarray, std: np.ndarray) -> np.ndarray:
    """Standard deviations of rounding (o, n), measured at the point itself where they are not known."""
    lanes = np.nonzero(np.isnan(std).any(axis=0))[0]
    if len(lanes):
        std = std.copy()
        measured = rounding_std(problem.some(lanes), w[:, lanes], np.log(slope[lanes]), near=_NEAR_STATES)
        std[:, lanes] = np.nan_to_num(measured, nan=np.inf)
    return std


def _polish(
    problem: Problem, w: np.ndarray, slope: np.ndarray, lipschitz: np.ndarray, samples: int
) -> tuple[Stride, np.ndarray, np.ndarray]:
    """Steps near enough to the fixed points that one more Newton step is exact to rounding, their scales and w.

    Lanes that are near enough are not evaluated again, so a lane's bits do not depend on the others.
    """
    q = np.log(slope)
    w, before = w.copy(), np.full(len(q), np.inf)
    stride, scale = problem.stride(w, q)
    if samples:
        # Few guesses are gaits already; the motion of those is in doubt, and they are integrated again.
        stride.motion = [np.full((samples + 1, *phase.shape[1:]), np.nan) for phase in stride.motion]
    for _ in range(MAX_STEPS):
        step = newton_step(stride, w)
        eta = np.abs(step).max(axis=0)
        # Far: Newton's next step would leave an error, or the multipliers of this step would show the distance.
        far = (lipschitz * eta**2 > np.maximum(1e-16, 0.01 * rounding(stride).max(axis=0))) | (eta > _NEAR)
        lanes = np.nonzero(far & np.isfinite(eta) & (eta < 0.1) & (eta < 0.5 * before))[0]
        if not len(lanes):
            break
        before = np.zeros(len(q))
        before[lanes] = eta[lanes]
        w[:, lanes] += step[:, lanes]
        update, scale[lanes] = problem.some(lanes).stride(w[:, lanes], q[lanes], samples=samples)
        stride.assign(lanes, update)
    return stride, scale, w
