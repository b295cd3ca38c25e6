"""From guesses to settled gaits: Newton's last steps, the error bound, more digits where needed, and the verdict."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tasks.fixed_points.newton import lipschitz as lipschitz_at
from tasks.fixed_points.newton import newton_step
from tasks.fixed_points.rounding import apply_newton_step, rounding
from tasks.fixed_points.step_check import verify_steps
from tasks.step import extended_precision
from tasks.step.problem import EPS, Problem, sizes
from tasks.step.step_map import Stride, matvec

#: Where the atlas cannot vouch for a point's verdict.
UNKNOWN = -1
#: Newton steps a point may take from the atlas; nearly all take one.
MAX_STEPS = 8
#: Standard deviations of the measured rounding a gait may be off, besides half a rounding of its image: that of the
#: constants, which no change of units shows.
SAFETY_FACTOR = 16.0
#: Where not even the third digit is sure Newton's derivative leads more digits nowhere.
MAX_BOUND = 1e-3
#: Share of Newton's radius of convergence up to which the estimate of a segment's nodes serves its points.
VOUCHED = 0.1
#: Relative distance from the fixed point at which multipliers are as good as at it.
NEAR = 2e-12


@dataclass
class Polished:
    """Gaits of n lanes, scaled by `scale` (n,).

    `y` (m, n) section; `state` (a, n) just after heelstrike; `times` (phases, n) [sqrt(leg/g)]; `stride` the last one
    flown, its impacts carried to the fixed point; `bound` (n,) of the relative error of angle, rates and period, and
    `doubles` what it was before more digits were asked for;
    `converged`, `step` (n,) whether Newton settled, and on a step that really happens; `passes` (n,) of the legs.
    """

    y: np.ndarray
    state: np.ndarray
    times: np.ndarray
    scale: np.ndarray
    stride: Stride
    bound: np.ndarray
    doubles: np.ndarray
    converged: np.ndarray
    step: np.ndarray
    leg_passes: np.ndarray


def settle(
    problem: Problem,
    Z: np.ndarray,
    slope: np.ndarray,
    lipschitz: np.ndarray,
    rounding_std: np.ndarray,
    leg_passes: np.ndarray,
) -> Polished:
    """Polish guesses and verify them.

    Parameters
    ----------
    Z : ndarray, shape (m + 1 + phases, n)
        Guesses as a branch's nodes hold them.
    slope, lipschitz : ndarray, shape (n,)
    noise : ndarray, shape (o, n)
        Standard deviation that rounding gives angle, rates and period, over their `reach`.
    passes : ndarray, shape (n,)
        How often the legs pass, where the atlas has shown the stride to be a step; elsewhere UNKNOWN.
    """
    m, n = problem.m, len(slope)
    stride, scale, w = polish(problem, np.delete(Z, m, axis=0), slope, lipschitz)
    eta = np.abs(newton_step(stride, np.vstack([np.zeros((m, n)), stride.times]))).max(axis=0)
    lipschitz = _at_points(problem, w, slope, lipschitz, eta)
    # What is measured at the impacts is carried to the fixed point, as the times are.
    stride.impact = stride.impact + matvec(stride.impact_by_y, stride.newton)
    if stride.knee is not None and stride.knee_by_y is not None:
        stride.knee = stride.knee + matvec(stride.knee_by_y, stride.newton)
    at = apply_newton_step(problem, stride, problem.parameters(slope, scale))
    y, times, state, by_y = at.y, at.times, at.state, np.abs(at.by_y)
    error = at.sensitivity * (SAFETY_FACTOR * rounding_std + EPS / 2) + matvec(by_y, 2 * lipschitz * eta**2 * sizes(y))
    bound = (error / at.size).max(axis=0) + 2 * EPS
    doubles = bound.copy()
    converged = (bound < MAX_BOUND) & (2 * lipschitz * eta < 1) & (eta < 1e-4)
    golden_ratio_order = (matvec(by_y, sizes(y)) / at.size).max(axis=0)
    for lane in np.nonzero((bound > extended_precision.ESCALATE) & (bound < MAX_BOUND))[0]:
        wide = extended_precision.refine(
            problem, lane, stride, y[:, lane], times[:, lane], slope[lane], scale[lane], bound[lane]
        )
        y[:, lane], times[:, lane], stride.impact[:, lane], state[:, lane] = wide.y, wide.times, wide.impact, wide.state
        bound[lane] = wide.left * max(1.0, golden_ratio_order[lane]) + wide.rounding
        converged[lane] = bound[lane] < extended_precision.ESCALATE_AGAIN
    step = (stride.closing < 0) & (np.diff(stride.times, axis=0, prepend=0) > 0).all(axis=0)
    lanes = np.nonzero(leg_passes == UNKNOWN)[0]
    if len(lanes):
        _, verdict = verify_steps(problem.some(lanes), w[:, lanes], np.log(slope[lanes]))
        step[lanes], leg_passes = verdict.step, leg_passes.copy()
        leg_passes[lanes] = verdict.leg_passes
    return Polished(y, state, times, scale, stride, bound, doubles, converged, step, leg_passes)


def _at_points(
    problem: Problem, w: np.ndarray, slope: np.ndarray, lipschitz: np.ndarray, eta: np.ndarray
) -> np.ndarray:
    """Lipschitz estimates (n,), measured at the point itself where that of its segment's nodes does not vouch for it.

    At a fold the map at fixed slope is singular, and beside it ever less so: the node there says nothing of the
    segment.
    """
    lanes = np.nonzero(2 * lipschitz * eta > VOUCHED)[0]
    if len(lanes):
        X = np.vstack([w[: problem.m, lanes], np.log(slope[lanes])])
        lipschitz = lipschitz.copy()
        lipschitz[lanes] = lipschitz_at(problem.some(lanes), X, w[problem.m :, lanes])
    return lipschitz


def polish(
    problem: Problem, w: np.ndarray, slope: np.ndarray, lipschitz: np.ndarray
) -> tuple[Stride, np.ndarray, np.ndarray]:
    """Strides at guesses close enough that one more Newton step is exact to rounding.

    Lanes that are close already are not touched again, so a lane's bits do not depend on the others.
    """
    q = np.log(slope)
    w, before = w.copy(), np.full(len(q), np.inf)
    stride, scale = problem.stride(w, q)
    for _ in range(MAX_STEPS):
        step = newton_step(stride, w)
        eta = np.abs(step).max(axis=0)
        # Far: Newton's next step would still leave an error, or what is measured on this stride would show it.
        far = (lipschitz * eta**2 > np.maximum(1e-16, 0.01 * rounding(stride).max(axis=0))) | (eta > NEAR)
        lanes = np.nonzero(far & np.isfinite(eta) & (eta < 0.1) & (eta < 0.5 * before))[0]
        if not len(lanes):
            break
        before = np.zeros(len(q))
        before[lanes] = eta[lanes]
        w[:, lanes] += step[:, lanes]
        again, scale[lanes] = problem.some(lanes).stride(w[:, lanes], q[lanes])
        stride.put(lanes, again)
    return stride, scale, w
