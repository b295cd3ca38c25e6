"""From guesses to gaits: Newton's last steps, error bounds, more digits where needed,
and whether steps happen.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gaitsweep.tasks.fixed_points.multipliers import characteristic
from gaitsweep.tasks.fixed_points.newton import curvature, newton_step, relative_sizes
from gaitsweep.tasks.fixed_points.rounding import (
    characteristic_scale,
    reported,
    reported_sizes,
    rounding,
    rounding_std,
    sensitivity,
)
from gaitsweep.tasks.fixed_points.step_check import verify_steps
from gaitsweep.tasks.mechanics.sums import matvec, total
from gaitsweep.tasks.step import extended_precision
from gaitsweep.tasks.step.extended_precision import Start
from gaitsweep.tasks.step.lanes import lanes_of, replace_lanes
from gaitsweep.tasks.step.problem import EPS, Problem, joint_sizes
from gaitsweep.tasks.step.several_steps import AnyStride
from gaitsweep.tasks.step.step_map import SAMPLES
from gaitsweep.tasks.step.verify_step import strikes_fall_in_order

#: Leg passes where the atlas has not shown that a point's step happens.
UNKNOWN = -1
#: Newton steps a point may take from the atlas; nearly all take one.
MAX_STEPS = 8
#: Error bound in standard deviations of the measured rounding. Half a rounding of the
#: image is added for the constants, whose own rounding no change of units shows.
SAFETY_FACTOR = 16.0
#: Bound from which doubles alone show no gait.
_MAX_BOUND = 1e-3
#: Share of Newton's radius of convergence up to which the Lipschitz estimate of a
#: segment's nodes serves its points.
_MAX_CONTRACTION = 0.1
#: Rate of a guard over the angle below which its strike is nearly tangential
#: [sqrt(g/leg)].
_GRAZING = 0.01
#: States side by side by which the rounding of a gait alone is measured; a fine atlas
#: averages over its nodes.
_NEAR_STATES = 3
#: Rounding of the eigenvalues themselves, as that of the terms of the polynomial's
#: coefficients.
_EIGENVALUES = 8 * EPS
#: Relative distance from the fixed point up to which the multipliers there follow from
#: their derivatives.
_NEAR = 2e-12
#: The same of gaits of several steps, whose multipliers change faster.
_NEAR_SEVERAL = 2e-14


@dataclass
class Polished:
    """Gaits of n lanes.

    Attributes
    ----------
    y : ndarray, shape (m, n)
        Scaled section coordinates.
    state : ndarray, shape (angles, n)
        Scaled, just after the first heelstrike.
    times : ndarray, shape (phases, n) [sqrt(leg/g)]
    scale : ndarray, shape (n,)
        Power of two by which angles and rates are divided.
    stride : Stride or Strides
        The last step evaluated, its impacts corrected to the fixed point.
    bound, doubles : ndarray, shape (n,)
        Bound of the relative error of angle, rates and period; the same before any
        extended precision.
    change, error : ndarray, shape (d, n)
        What the last Newton step adds to the coefficients of the derivative's
        characteristic polynomial, and bounds of their errors.
    converged, step : ndarray of bool, shape (n,)
        Whether Newton converged, and to a step that happens.
    doubt : ndarray of bool, shape (n,)
        Whether it may be a step but could not be verified to be one: it counts as none.
    leg_passes : ndarray of int, shape (n,)
        How often the swing leg passes the stance leg.
    """

    y: np.ndarray
    state: np.ndarray
    times: np.ndarray
    scale: np.ndarray
    stride: AnyStride
    bound: np.ndarray
    doubles: np.ndarray
    change: np.ndarray
    error: np.ndarray
    converged: np.ndarray
    step: np.ndarray
    doubt: np.ndarray
    leg_passes: np.ndarray

    @property
    def w(self) -> np.ndarray:
        """Similarity coordinates and event times, shape (m + phases, n)."""
        return np.vstack(
            [np.log(self.y[:1] * self.scale), self.y[1:] / self.y[0], self.times]
        )


def are_same(a: Polished, b: Polished) -> np.ndarray:
    """Which of the gaits of two sets at one slope are one gait, as far as their error
    bounds can tell.

    Parameters
    ----------
    a, b : Polished
        Of i and of j lanes.

    Returns
    -------
    ndarray of bool, shape (i, j)
    """
    m = len(a.y)
    first, second = a.w[:, :, None], b.w[:, None, :]
    # Bounds are of angle, rates and period; from these all other times follow.
    bounded = [*range(m), -1]
    sizes = np.maximum(relative_sizes(first, m), relative_sizes(second, m))[bounded]
    first, second = first[bounded], second[bounded]

    # A rate over the angle has the errors of both.
    within = 2 * (a.bound[:, None] + b.bound[None]) * sizes
    rounding_of_w = 4 * EPS * np.maximum(np.abs(first), np.abs(second))
    return np.asarray((np.abs(first - second) <= within + rounding_of_w).all(axis=0))


@dataclass(frozen=True)
class Guesses:
    """Guesses of n gaits, with what the atlas knows of the steps around them.

    `w` (m + k, n) similarity coordinates and event times; `slope` (n,) [rad];
    `lipschitz` (n,) and `gradient` (d, m + k, n) what `curvature` measures, and
    `rounding_std` (o + d, n) what that function does, all NaN where they are to be
    measured at the gait; `leg_passes` (n,) how often the legs pass where the step is
    known to happen, elsewhere UNKNOWN.
    """

    w: np.ndarray
    slope: np.ndarray
    lipschitz: np.ndarray
    gradient: np.ndarray
    rounding_std: np.ndarray
    leg_passes: np.ndarray


def unmeasured(problem: Problem, w: np.ndarray, slope: np.ndarray) -> Guesses:
    """Guesses of which nothing is known: what their bounds need is measured at the
    gaits.

    Parameters
    ----------
    w : ndarray, shape (m + k, n)
    slope : ndarray, shape (n,) [rad]
    """
    n = len(slope)
    return Guesses(
        w,
        slope,
        *not_measured(problem.m, problem.phases, n, problem.steps),
        np.full(n, UNKNOWN),
    )


def not_measured(
    m: int, phases: int, n: int, steps: int = 1
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Curvatures and rounding of n gaits, as `Guesses` has them, that are to be
    measured at the gaits.
    """
    d = m // steps
    return (
        np.full(n, np.nan),
        np.full((d, m + phases, n), np.nan),
        np.full((3 + phases // steps + d, n), np.nan),
    )


def settle(
    problem: Problem, guesses: Guesses, sampled: bool = False, accuracy: float = 0.0
) -> Polished:
    """Polish guesses and verify that they are steps.

    Parameters
    ----------
    problem : Problem
        Of one walker, or of a walker for each guess.
    guesses : Guesses
    sampled : bool
        Sample every motion that is integrated: cheaper where no guess's step is known
        to happen.
    accuracy : float
        Bound that nearly suffices; 0 for as good a bound as doubles give.
    """
    slope, leg_passes = guesses.slope, guesses.leg_passes
    stride, scale, w = _polish(
        problem, guesses.w, slope, guesses.lipschitz, SAMPLES if sampled else 0
    )
    last, relative = newton_step(stride, w), relative_sizes(w, problem.m)
    eta = np.abs(last).max(axis=0)
    lipschitz, gradient = _curvature_at_points(problem, w, guesses, eta, stride)
    std, of_polynomial = np.split(
        _rounding_at_points(problem, w, slope, guesses.rounding_std),
        [-problem.structure.dimension],
    )
    # The states at the impacts are corrected to the fixed point, as the times are.
    stride.move_impacts()
    y, times = stride.y + stride.newton, stride.newton_times.copy()
    state, values, by_unknowns = reported(
        problem, y, times, problem.parameters(slope, scale)
    )
    # How far the values move if the unknowns move by 1, each in its unit.
    moves = matvec(np.abs(by_unknowns), joint_sizes(y, problem.phases))
    error = (
        sensitivity(stride, values, by_unknowns) * (SAFETY_FACTOR * std + EPS / 2)
        + moves * 2 * lipschitz * eta**2
    )
    bound = (error / reported_sizes(values)).max(axis=0) + 2 * EPS
    doubles = bound.copy()
    near = eta < 1e-4
    converged = (bound < _MAX_BOUND) & (2 * lipschitz * eta < 1) & near
    amplification = (moves / reported_sizes(values)).max(axis=0)
    # Where doubles do not show that Newton converges, the shrinking of its steps in
    # more digits does.
    enough = 0.9 * accuracy or extended_precision.ESCALATE
    # Where Newton's steps in doubles are not trusted it begins again.
    lost = np.flatnonzero(~(near & (bound < extended_precision.UNTRUSTED)))
    first, unit = problem.section(guesses.w[:, lost])
    y[:, lost], times[:, lost] = (
        first * (unit / scale[lost]),
        guesses.w[problem.m :, lost],
    )
    unsure = np.flatnonzero(~(converged & (bound <= enough)))
    for lane in unsure.tolist():
        start = Start(
            problem, lane, stride, y[:, lane], times[:, lane], slope[lane], scale[lane]
        )
        (
            y[:, lane],
            times[:, lane],
            stride.one.impact[..., lane],
            state[:, lane],
            bound[lane],
        ) = extended_precision.refine(
            start, bound[lane], amplification[lane], 0.9 * accuracy
        )
        converged[lane] = bound[lane] < extended_precision.ESCALATE_AGAIN
    if len(unsure):
        # What describes the step and its derivative is taken at the better gait.
        some, samples = problem.some(unsure), SAMPLES if sampled else 0
        parameters = some.parameters(slope[unsure], scale[unsure])
        better = some.map(y[:, unsure], times[:, unsure], parameters, samples=samples)
        better.one.impact = stride.one.impact[..., unsure]
        replace_lanes(stride, unsure, better)
        last[:, unsure] = 0.0
    step, doubt = (
        strikes_fall_in_order(stride.closing, times),
        np.zeros(len(slope), bool),
    )
    lanes = np.nonzero(leg_passes == UNKNOWN)[0]
    if len(lanes):
        known = lanes_of(stride, lanes) if sampled else None
        _, check = verify_steps(
            problem.some(lanes), w[:, lanes], np.log(slope[lanes]), known
        )
        step[lanes], doubt[lanes] = check.step & ~check.doubt, check.step & check.doubt
        leg_passes = leg_passes.copy()
        leg_passes[lanes] = check.leg_passes
    # The derivative is that before the last step, and rounds on its way.
    distance = (np.abs(last) / relative).max(axis=0) + bound
    of_state = total((np.abs(gradient) * relative).swapaxes(0, 1)) * distance
    unit = characteristic_scale(stride)
    change = total((gradient * last).swapaxes(0, 1)) * unit
    rounded = _EIGENVALUES * characteristic(np.abs(stride.jacobian), 1.0)
    error = (of_state + SAFETY_FACTOR * of_polynomial) * unit + rounded
    return Polished(
        y,
        state,
        times,
        scale,
        stride,
        bound,
        doubles,
        change,
        error,
        converged,
        step,
        doubt,
        leg_passes,
    )


def _curvature_at_points(
    problem: Problem,
    w: np.ndarray,
    guesses: Guesses,
    eta: np.ndarray,
    stride: AnyStride,
) -> tuple[np.ndarray, ...]:
    """What `curvature` gives, measured at the point itself where there is nothing or it
    does not suffice.

    At a fold the map at fixed slope is singular, and ever less so beside it: the
    estimate at that node says nothing of the segment. So it is beside strikes that turn
    tangential, where derivatives grow without bound.
    """
    lipschitz, gradient = guesses.lipschitz, guesses.gradient
    singles = stride.singles
    grazing = (
        np.min([np.abs(rate / singles.y[0]) for rate in singles.closing], axis=0)
        < _GRAZING
    )
    grazing = grazing.reshape(problem.steps, -1).any(axis=0)
    known = np.isfinite(gradient).all(axis=(0, 1)) & ~grazing
    lanes = np.nonzero(~((2 * lipschitz * eta <= _MAX_CONTRACTION) & known))[0]
    if len(lanes):
        lipschitz, gradient, q = (
            lipschitz.copy(),
            gradient.copy(),
            np.log(guesses.slope[lanes]),
        )
        lipschitz[lanes], gradient[..., lanes] = curvature(
            problem.some(lanes), w[:, lanes], q
        )
    return lipschitz, gradient


def _rounding_at_points(
    problem: Problem, w: np.ndarray, slope: np.ndarray, std: np.ndarray
) -> np.ndarray:
    """Standard deviations of rounding (o + m, n), measured at the point itself where
    they are not known.
    """
    lanes = np.nonzero(np.isnan(std).any(axis=0))[0]
    if len(lanes):
        std = std.copy()
        measured = rounding_std(
            problem.some(lanes), w[:, lanes], np.log(slope[lanes]), near=_NEAR_STATES
        )
        std[:, lanes] = np.nan_to_num(measured, nan=np.inf)
    return std


def _polish(
    problem: Problem,
    w: np.ndarray,
    slope: np.ndarray,
    lipschitz: np.ndarray,
    samples: int,
) -> tuple[AnyStride, np.ndarray, np.ndarray]:
    """Steps near enough to the fixed points that one more Newton step is exact to
    rounding, their scales and w.

    Lanes that are near enough are not evaluated again, so a lane's bits do not depend
    on the others.
    """
    q = np.log(slope)
    w, before, near = (
        w.copy(),
        np.full(len(q), np.inf),
        _NEAR if problem.steps == 1 else _NEAR_SEVERAL,
    )
    stride, scale = problem.stride(w, q)
    if samples:
        # Few guesses are gaits already; the motion of those is in doubt, and they are
        # integrated again.
        stride.one.motion = [
            np.full((samples + 1, *phase.shape[1:]), np.nan)
            for phase in stride.one.motion
        ]
    for _ in range(MAX_STEPS):
        step = newton_step(stride, w)
        eta = np.abs(step).max(axis=0)
        # Far: Newton's next step would leave an error, or the multipliers of this step
        # would show the distance.
        far = (
            lipschitz * eta**2 > np.maximum(1e-16, 0.01 * rounding(stride).max(axis=0))
        ) | (eta > near)
        lanes = np.nonzero(far & np.isfinite(eta) & (eta < 0.1) & (eta < 0.5 * before))[
            0
        ]
        if not len(lanes):
            break
        before = np.zeros(len(q))
        before[lanes] = eta[lanes]
        w[:, lanes] += step[:, lanes]
        update, scale[lanes] = problem.some(lanes).stride(
            w[:, lanes], q[lanes], samples=samples
        )
        replace_lanes(stride, lanes, update)
    return stride, scale, w
