"""From guesses to gaits: Newton's last steps, error bounds, more digits where needed,
and whether steps happen.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gaitsweep.tasks.gaits.multipliers import characteristic
from gaitsweep.tasks.gaits.newton import curvature, newton_step, relative_sizes
from gaitsweep.tasks.gaits.rounding import (
    characteristic_scale,
    reported,
    reported_sizes,
    rounding,
    rounding_std,
    sensitivity,
)
from gaitsweep.tasks.gaits.step_check import verify_steps
from gaitsweep.tasks.mechanics.arrays import (
    Marks,
    Numbers,
    PerLane,
    Sections,
    Slopes,
    States,
    Times,
    Unknowns,
)
from gaitsweep.tasks.mechanics.sums import matvec, total
from gaitsweep.tasks.step import extended_precision
from gaitsweep.tasks.step.extended_precision import Start
from gaitsweep.tasks.step.iterate import Ended, iterate
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
#: Size of a Newton step in doubles from which it is not trusted.
_TRUSTED = 1e-4
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

    y: Sections
    state: States
    times: Times
    scale: PerLane
    stride: AnyStride
    bound: PerLane
    doubles: PerLane
    change: np.ndarray
    error: np.ndarray
    converged: Marks
    step: Marks
    doubt: Marks
    leg_passes: np.ndarray

    @property
    def w(self) -> Unknowns:
        """Similarity coordinates and event times."""
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

    w: Unknowns
    slope: Slopes
    lipschitz: PerLane
    gradient: np.ndarray
    rounding_std: np.ndarray
    leg_passes: np.ndarray


def unmeasured(problem: Problem, w: Unknowns, slope: Slopes) -> Guesses:
    """Guesses of which nothing is known: what their bounds need is measured at the
    gaits.
    """
    n = len(slope)
    measured = not_measured(problem.m, problem.phases, n, problem.steps)
    return Guesses(w, slope, *measured, np.full(n, UNKNOWN))


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

    Returns
    -------
    Polished
    """
    near = _Approach.begin(problem, guesses, SAMPLES if sampled else 0)
    iterate(near, len(guesses.slope), MAX_STEPS)
    last = newton_step(near.stride, near.w)
    eta = np.abs(last).max(axis=0)
    measured = _measured(guesses, near, eta)

    # The states at the impacts are corrected to the fixed point, as the times are.
    near.stride.move_impacts()
    gaits = _in_doubles(measured, near, eta)
    doubles = gaits.bound.copy()

    refined = _in_more_digits(guesses, near, gaits, eta, accuracy)
    if len(refined):
        # What describes the step and its derivative is taken at the better gait.
        _evaluate_at_gaits(near, gaits, refined)
        last[:, refined] = 0.0

    step, doubt, leg_passes = _happen(guesses, near, gaits)
    change, error = _characteristic_changes(measured, near, last, gaits.bound)

    return Polished(
        gaits.y,
        gaits.state,
        gaits.times,
        near.scale,
        near.stride,
        gaits.bound,
        doubles,
        change,
        error,
        gaits.converged,
        step,
        doubt,
        leg_passes,
    )


@dataclass
class _Approach:
    """Newton's iteration from guesses to steps at which one more Newton step is exact
    to rounding.

    Lanes that are near enough are not evaluated again, so a lane's bits do not depend
    on the others.
    """

    problem: Problem
    slope: Slopes
    lipschitz: PerLane
    samples: int
    w: Unknowns
    stride: AnyStride
    scale: PerLane
    eta: PerLane

    @classmethod
    def begin(cls, problem: Problem, guesses: Guesses, samples: int) -> _Approach:
        """Evaluate the steps at guesses."""
        slope, w = guesses.slope, guesses.w.copy()
        stride, scale = problem.stride(w, np.log(slope))
        if samples:
            # Few guesses are gaits already; the motion of those is in doubt, and they
            # are integrated again.
            stride.one.motion = [
                np.full((samples + 1, *phase.shape[1:]), np.nan)
                for phase in stride.one.motion
            ]

        eta = np.full(len(slope), np.inf)
        return cls(problem, slope, guesses.lipschitz, samples, w, stride, scale, eta)

    def step(self, lanes: Numbers, taken: int) -> np.ndarray:
        """Move those of some lanes that are far by Newton's step."""
        step = newton_step(self.stride, self.w)[:, lanes]
        eta = np.abs(step).max(axis=0)
        is_near = ~self._is_far(lanes, eta)
        ended = np.select(
            [~np.isfinite(eta), is_near, eta >= 0.1, eta >= 0.5 * self.eta[lanes]],
            [Ended.SINGULAR, Ended.CONVERGED, Ended.DIVERGED, Ended.STALLED],
            Ended.RUNNING,
        )

        moves = ended == Ended.RUNNING
        lanes = lanes[moves]
        if len(lanes):
            self.w[:, lanes] += step[:, moves]
            self.eta[lanes] = eta[moves]
            moved, self.scale[lanes] = self.problem.some(lanes).stride(
                self.w[:, lanes], np.log(self.slope[lanes]), samples=self.samples
            )
            replace_lanes(self.stride, lanes, moved)

        return ended

    # Where nothing is measured, its product with a step of 0 decides nothing.
    @np.errstate(invalid="ignore")
    def _is_far(self, lanes: Numbers, eta: PerLane) -> Marks:
        """Whether Newton's next step, of size eta, would leave an error, or the
        multipliers of this step would show the distance.
        """
        of_rounding = rounding(self.stride).max(axis=0)[lanes]
        left = self.lipschitz[lanes] * eta**2
        near = _NEAR if self.problem.steps == 1 else _NEAR_SEVERAL
        return (left > np.maximum(1e-16, 0.01 * of_rounding)) | (eta > near)


@np.errstate(invalid="ignore")
def _measured(guesses: Guesses, near: _Approach, eta: PerLane) -> Guesses:
    """Guesses with what their bounds need, measured at the point itself where there is
    nothing or it does not suffice.

    At a fold the map at fixed slope is singular, and ever less so beside it: the
    estimate at that node says nothing of the segment. So it is beside strikes that turn
    tangential, where derivatives grow without bound.
    """
    problem, w, log_slope = near.problem, near.w, np.log(guesses.slope)
    lipschitz, gradient = guesses.lipschitz.copy(), guesses.gradient.copy()
    serves = 2 * lipschitz * eta <= _MAX_CONTRACTION
    serves &= np.isfinite(gradient).all(axis=(0, 1)) & ~_is_grazing(near.stride)
    lanes = np.flatnonzero(~serves)
    if len(lanes):
        lipschitz[lanes], gradient[..., lanes] = curvature(
            problem.some(lanes), w[:, lanes], log_slope[lanes]
        )

    std = guesses.rounding_std.copy()
    lanes = np.flatnonzero(np.isnan(std).any(axis=0))
    if len(lanes):
        found = rounding_std(
            problem.some(lanes), w[:, lanes], log_slope[lanes], near=_NEAR_STATES
        )
        std[:, lanes] = np.nan_to_num(found, nan=np.inf)

    return replace(guesses, lipschitz=lipschitz, gradient=gradient, rounding_std=std)


def _is_grazing(stride: AnyStride) -> Marks:
    """Whether a strike of a gait is nearly tangential."""
    singles = stride.singles
    slowest = np.min([np.abs(rate / singles.y[0]) for rate in singles.closing], axis=0)
    return np.asarray((slowest < _GRAZING).reshape(stride.steps, -1).any(axis=0))


@dataclass
class _Gaits:
    """Gaits and bounds of their errors; `amplification` is the relative change of what
    is reported with a Newton step.
    """

    y: Sections
    times: Times
    state: States
    bound: PerLane
    amplification: PerLane
    converged: Marks


def _in_doubles(measured: Guesses, near: _Approach, eta: PerLane) -> _Gaits:
    """Gaits after one more Newton step, with what rounding and that step may leave."""
    problem, stride = near.problem, near.stride
    y, times = stride.y + stride.newton, stride.newton_times.copy()
    parameters = problem.parameters(measured.slope, near.scale)
    state, values, by_unknowns = reported(problem, y, times, parameters)
    sizes = reported_sizes(values)

    std = measured.rounding_std[: len(values)]
    error = sensitivity(stride, values, by_unknowns) * (SAFETY_FACTOR * std + EPS / 2)
    # How far the values move if the unknowns move by 1, each in its unit.
    moves = matvec(np.abs(by_unknowns), joint_sizes(y, problem.phases))
    error += moves * 2 * measured.lipschitz * eta**2
    bound = (error / sizes).max(axis=0) + 2 * EPS

    converges = (2 * measured.lipschitz * eta < 1) & (eta < _TRUSTED)
    amplification = (moves / sizes).max(axis=0)

    return _Gaits(
        y, times, state, bound, amplification, converges & (bound < _MAX_BOUND)
    )


def _in_more_digits(
    guesses: Guesses, near: _Approach, gaits: _Gaits, eta: PerLane, accuracy: float
) -> Numbers:
    """Solve again, in place, for the gaits whose bounds ask for more digits.

    Where doubles do not show that Newton converges, the shrinking of its steps in more
    digits does.
    """
    enough = 0.9 * accuracy or extended_precision.ESCALATE
    unsure = np.flatnonzero(~(gaits.converged & (gaits.bound <= enough)))
    _begin_again_where_lost(guesses, near, gaits, eta)
    for lane in unsure.tolist():
        start = Start(
            near.problem,
            lane,
            near.stride,
            gaits.y[:, lane],
            gaits.times[:, lane],
            guesses.slope[lane],
            near.scale[lane],
        )
        gait = extended_precision.refine(
            start, gaits.bound[lane], gaits.amplification[lane], 0.9 * accuracy
        )
        gaits.y[:, lane], gaits.times[:, lane] = gait.y, gait.times
        gaits.state[:, lane] = gait.state
        near.stride.one.impact[..., lane] = gait.impact
        gaits.bound[lane] = gait.error
        gaits.converged[lane] = gait.error < extended_precision.ESCALATE_AGAIN

    return unsure


def _begin_again_where_lost(
    guesses: Guesses, near: _Approach, gaits: _Gaits, eta: PerLane
) -> None:
    """Put the guesses in the place of gaits where Newton's steps in doubles are not
    trusted.
    """
    is_trusted = (eta < _TRUSTED) & (gaits.bound < extended_precision.UNTRUSTED)
    lost = np.flatnonzero(~is_trusted)
    y, scale = near.problem.section(guesses.w[:, lost])
    gaits.y[:, lost] = y * (scale / near.scale[lost])
    gaits.times[:, lost] = guesses.w[near.problem.m :, lost]


def _evaluate_at_gaits(near: _Approach, gaits: _Gaits, lanes: Numbers) -> None:
    """Replace the steps of some lanes by those at their gaits, whose impacts stay."""
    problem = near.problem.some(lanes)
    parameters = problem.parameters(near.slope[lanes], near.scale[lanes])
    better = problem.map(
        gaits.y[:, lanes], gaits.times[:, lanes], parameters, samples=near.samples
    )
    better.one.impact = near.stride.one.impact[..., lanes]
    replace_lanes(near.stride, lanes, better)


def _happen(
    guesses: Guesses, near: _Approach, gaits: _Gaits
) -> tuple[Marks, Marks, np.ndarray]:
    """Whether gaits are steps, whether that is in doubt, and how often their legs pass:
    verified where the atlas does not know it.
    """
    step = strikes_fall_in_order(near.stride.closing, gaits.times)
    doubt = np.zeros(len(step), bool)
    leg_passes = guesses.leg_passes.copy()
    lanes = np.flatnonzero(leg_passes == UNKNOWN)
    if len(lanes):
        sampled = lanes_of(near.stride, lanes) if near.samples else None
        log_slope = np.log(guesses.slope[lanes])
        _, check = verify_steps(
            near.problem.some(lanes), near.w[:, lanes], log_slope, sampled
        )
        step[lanes] = check.step & ~check.doubt
        doubt[lanes] = check.step & check.doubt
        leg_passes[lanes] = check.leg_passes

    return step, doubt, leg_passes


def _characteristic_changes(
    measured: Guesses, near: _Approach, last: Unknowns, bound: PerLane
) -> tuple[np.ndarray, np.ndarray]:
    """Changes with the last Newton step, and bounds of the errors, of the coefficients
    of the derivative's characteristic polynomial.

    The derivative is that before the last step, and rounds on its way.
    """
    stride, gradient = near.stride, measured.gradient
    unit = characteristic_scale(stride)
    change = total((gradient * last).swapaxes(0, 1)) * unit

    relative = relative_sizes(near.w, near.problem.m)
    distance = (np.abs(last) / relative).max(axis=0) + bound
    of_state = total((np.abs(gradient) * relative).swapaxes(0, 1)) * distance
    of_rounding = SAFETY_FACTOR * measured.rounding_std[-len(unit) :]
    rounded = _EIGENVALUES * characteristic(np.abs(stride.jacobian), 1.0)
    return change, (of_state + of_rounding) * unit + rounded
