"""What is measured of gaits, and how it is stored by their labels."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from gaitsweep.tasks.contract import status
from gaitsweep.tasks.contract.accuracy import MANTISSA, computed, significant_bits
from gaitsweep.tasks.contract.registry import GAITS, VARIABLES
from gaitsweep.tasks.contract.tables import Arrays
from gaitsweep.tasks.gaits.labels import places
from gaitsweep.tasks.gaits.multipliers import (
    multiplier_bounds,
    multiplier_changes,
    multipliers,
)
from gaitsweep.tasks.gaits.polish import Polished
from gaitsweep.tasks.gaits.step_check import gait_ratio
from gaitsweep.tasks.measures import violations
from gaitsweep.tasks.measures.drive import (
    PushOff,
    damping_loss,
    hip_torque_work,
    push_off,
)
from gaitsweep.tasks.measures.kinematics import step_length, travel
from gaitsweep.tasks.measures.losses import (
    heelstrike_losses,
    kneestrike_loss,
    velocity_ratio,
)
from gaitsweep.tasks.mechanics.sums import total
from gaitsweep.tasks.step.drive import OVER_SLOPE, SLOPE
from gaitsweep.tasks.step.problem import Problem, residual_sizes
from gaitsweep.tasks.step.several_steps import AnyStride, Strides, side_by_side
from gaitsweep.tasks.step.step_map import Stride
from gaitsweep.tasks.walkers.walker import DIFFERENTIATED, Walker
from gaitsweep.tasks.walkers.walker_array import WalkerArray

#: Significant bits in which bounds are kept that need not be exact.
_BOUND_BITS = 4
#: What a gait loses of its energy.
_LOSSES = "loss_normal", "loss_tangential", "loss_kneestrike", "loss_damping"
#: Number of multipliers of a gait, by whether there are knees (paper, section 2.2).
_MULTIPLIERS = {False: 3, True: 4}


@dataclass(frozen=True)
class Wanted:
    """What is wanted of gaits.

    Attributes
    ----------
    names : sequence of str
        Of variables.
    labels : set of str
    limits : mapping, optional
        Limits of violations other than the registry's.
    accuracy : float
        Largest error bound wanted, 0 for any.
    """

    names: Sequence[str]
    labels: set[str]
    limits: Mapping[str, float] | None = None
    accuracy: float = 0.0

    @classmethod
    def of(cls, params: Mapping[str, Any]) -> Wanted:
        """Return what a request wants, with what is archived in any case; `params` as
        `tasks.studies.solve_points` has them.
        """
        names, accuracy = params["want"], params.get("accuracy", 0.0)
        labels = set(params.get("gaits") or GAITS)
        limits = params.get("violation_limits")
        return cls(computed(names, accuracy), labels, limits, accuracy)


def nothing_solved(names: Sequence[str], n: int, kneed: bool) -> Arrays:
    """Return arrays of variables at points without a gait.

    Parameters
    ----------
    names : sequence of str
        Of variables.
    n : int
        Number of points.
    kneed : bool

    Returns
    -------
    dict of ndarray, shape (n, len(GAITS)[, multipliers])
    """
    out: Arrays = {}
    for name in names:
        inner = {"multiplier": _MULTIPLIERS[kneed], "key": len(DIFFERENTIATED)}
        sizes = [inner[dim] for dim in VARIABLES[name].dims[1:]]
        # The gaits of a label lie together in memory: they are stored and rounded so.
        shape = (len(GAITS), n, *sizes)
        values = np.full(shape, VARIABLES[name].absent, VARIABLES[name].dtype)
        out[name] = values.swapaxes(0, 1)

    out["reason"][:] = [
        status.NO_LONG,
        status.NO_SHORT,
        status.NO_FURTHER,
        status.NO_FURTHER,
    ]
    return out


@dataclass(frozen=True)
class Part:
    """Gaits of one piece of a branch: their points, what labels them, and what was
    solved.

    `angle` and `ratio` are those by which labels are given; `angle` is NaN where a gait
    has none.
    """

    index: np.ndarray
    angle: np.ndarray
    ratio: np.ndarray
    solved: Arrays

    def some(self, keep: np.ndarray) -> Part:
        """Part of some of its gaits: those that a mask, bool (n,), keeps."""
        if keep.all():
            return self
        solved = {name: value[keep] for name, value in self.solved.items()}
        return Part(self.index[keep], self.angle[keep], self.ratio[keep], solved)


def store(out: Arrays, parts: Sequence[Part], wanted: set[str]) -> None:
    """Store gaits by label; where there are more gaits than labels, the reason of the
    last label's says so.

    Parameters
    ----------
    out : dict of ndarray, shape (n, len(GAITS)[, multipliers])
        Changed in place.
    parts : sequence of Part
        With indices into the n points.
    wanted : set of str
        Labels to store.

    Raises
    ------
    LookupError
        If a part lacks a variable that walkers of its kind have: nothing computes it.
    """
    n = len(out["status"])
    angle, ratio = np.full((2, len(parts), n), np.nan)
    for k, part in enumerate(parts):
        angle[k, part.index] = part.angle
        ratio[k, part.index] = part.ratio

    place_of_part = places(angle, ratio)
    # There may be more gaits than labels.
    is_wanted = np.array([gait in wanted for gait in GAITS] + [False])
    for part, place in zip(parts, place_of_part, strict=True):
        slot = np.minimum(place[part.index], len(GAITS))
        keep = np.flatnonzero((slot >= 0) & is_wanted[slot])
        _store_some(out, part, keep, slot[keep])

    last = len(GAITS) - 1
    is_last = out["status"][:, last] == status.CONVERGED
    has_more = (place_of_part > last).any(axis=0) & is_last
    out["reason"][has_more, last] = status.UNLABELLED


def _store_some(out: Arrays, part: Part, keep: np.ndarray, slot: np.ndarray) -> None:
    """Store those gaits of a part that are numbered in `keep`, each in a slot."""
    where = _as_slices(part.index[keep], slot)
    for name, values in out.items():
        if name not in part.solved:
            raise LookupError(f"Nothing computes the variable `{name}`.")
        solved = part.solved[name]
        values[where] = solved if len(keep) == len(solved) else solved[keep]


def _as_slices(row: np.ndarray, slot: np.ndarray) -> tuple[Any, Any]:
    """Indices of some rows and slots; of successive rows of one slot those that store
    several times as fast.
    """
    if not len(row) or row[-1] - row[0] != len(row) - 1:
        return row, slot
    if (slot != slot[0]).any() or (np.diff(row) != 1).any():
        return row, slot
    return slice(row[0], row[-1] + 1), slot[0]


def to_accuracy(out: Arrays, accuracy: float) -> None:
    """Round gaits to the digits that an accuracy leaves them, and mark those whose
    error bound exceeds it.

    Parameters
    ----------
    out : dict of ndarray, shape (n, len(GAITS)[, multipliers])
        Changed in place; bounds count the rounding.
    accuracy : float
        Largest error bound wanted; 0 for as good as doubles give, which changes
        nothing.
    """
    if not accuracy:
        return

    out = _of_used_labels(out)
    bits = significant_bits(accuracy)
    unit = 0.5 ** (bits + 1) if bits < MANTISSA else 0.0
    bound = out["error_bound"] + unit

    coarse = (out["status"] == status.CONVERGED) & (bound > accuracy)
    out["status"][coarse] = status.LESS_ACCURATE
    out["reason"][coarse] = status.TOO_COARSE
    for name, values in out.items():
        if name == "error_bound":
            rounded = _round_up(bound)
            values[:] = np.where(coarse, rounded, np.minimum(rounded, accuracy))
        elif name == "multiplier_error_bound":
            largest = _largest_multipliers(out, values.shape)
            values[:] = _round_up(values + 2 * unit * largest)
        elif values.dtype == float:
            rounded = round_bits(values, bits)
            if name == "spectral_radius":
                # Rounding makes no stable gait unstable.
                rounded = np.where(values < 1, np.minimum(rounded, 1 - unit), rounded)
            values[:] = rounded


def _of_used_labels(out: Arrays) -> Arrays:
    """Views of the labels up to the last that a gait has: others need no rounding."""
    has_gait = np.isin(out["status"], status.SOLVED).any(axis=0)
    last = int(np.flatnonzero(has_gait).max(initial=0))
    return {name: values[:, : last + 1] for name, values in out.items()}


def _largest_multipliers(out: Arrays, shape: tuple[int, ...]) -> np.ndarray:
    """Sum of the largest sizes of what is known of each gait's multipliers."""
    largest = np.zeros(shape)
    for name in ("multiplier_real", "multiplier_imag", "spectral_radius"):
        if name in out:
            sizes = np.abs(out[name]).reshape(*shape, -1)
            largest = largest + sizes.max(axis=-1)
    return largest


def _round_up(values: np.ndarray) -> np.ndarray:
    """Bounds, in few bits."""
    return round_bits(values * (1 + 0.5**_BOUND_BITS), _BOUND_BITS)


def round_bits(values: np.ndarray, bits: int) -> np.ndarray:
    """Round doubles to a number of significant bits after the first, ties to even.

    Parameters
    ----------
    values : ndarray of float
    bits : int

    Returns
    -------
    ndarray of float
    """
    drop = MANTISSA - bits
    if drop <= 0:
        return values

    whole = np.array(values, order="C").view(np.uint64)
    is_odd = (whole >> np.uint64(drop)) & np.uint64(1)
    # In place: millions of values are rounded, and new memory is dear.
    whole += np.uint64((1 << (drop - 1)) - 1)
    whole += is_odd
    whole &= np.uint64(0xFFFFFFFFFFFFFFFF ^ ((1 << drop) - 1))
    return whole.view(float)


def describe(
    problem: Problem,
    at: Polished,
    slope: np.ndarray,
    want: Sequence[str],
    limits: Mapping[str, float] | None = None,
) -> Arrays:
    """Measure the wanted variables of gaits.

    Parameters
    ----------
    problem : Problem
        Of one walker, or of one for each gait.
    at : Polished
        The gaits.
    slope : ndarray, shape (n,)
        The slopes [rad], or another drive of a problem over that.
    want : sequence of str
        Names of variables.
    limits : mapping, optional
        Limits of violations other than the registry's.

    Returns
    -------
    dict of ndarray, shape (n[, multipliers])
        In the walker's units; NaN where the guess is not converged to a step.
    """
    if problem.drive.key != SLOPE:
        lanes, own = problem.lanes_at(slope)
        return describe(lanes, at, own, want, limits)

    slope = problem.slopes(slope)
    problem = problem.over(OVER_SLOPE)
    stride, walker = at.stride, problem.every_walker
    solved = _outcomes(problem, at)
    code = solved["status"]
    of_steps = _steps(problem, walker, at, slope).measure(want, limits)
    of_gaits = _of_gaits(walker, slope, of_steps, problem.steps, want)
    solved |= without_features(want, problem.features, len(slope)) | of_gaits
    if any(VARIABLES[name].group == "multipliers" for name in want):
        solved |= measured_multipliers(
            stride.jacobian, at.change, at.error, walker.knees
        )

    solved = {name: np.array(value) for name, value in solved.items()}
    for name, value in solved.items():
        if value.dtype == float and name not in ("residual", "heelstrike_rate_ratio"):
            value[code != status.CONVERGED] = np.nan

    return solved


def _of_gaits(
    walker: Walker,
    slope: np.ndarray,
    of_steps: Arrays,
    steps: int,
    want: Sequence[str],
) -> Arrays:
    """What is measured of gaits by what is of their steps."""
    of_gaits = of_all_steps(of_steps, steps)
    of_gaits |= of_travel(walker, slope, of_gaits, steps)
    if "energy_imbalance" in want:
        off = energy_imbalance(walker, slope, of_gaits, steps)
        of_gaits["energy_imbalance"] = off
    return of_gaits


def _outcomes(problem: Problem, at: Polished) -> Arrays:
    """How the gaits were solved, and whether they are steps."""
    stride = at.stride
    residual = stride.residual / residual_sizes(stride.y, problem.phases)
    return {
        "status": np.where(
            at.converged & at.step, status.CONVERGED, status.NOT_CONVERGED
        ),
        "reason": np.select(
            [~at.converged, at.step, at.doubt],
            [status.NEWTON_LOST, status.SETTLED, status.UNVERIFIED],
            status.NOT_A_STEP,
        ),
        "residual": np.abs(residual).max(axis=0),
        "error_bound": at.bound,
        "anthropomorphic": ~at.step | (at.leg_passes == 1),
        "passes": at.leg_passes,
    }


def _steps(problem: Problem, walker: Walker, at: Polished, slope: np.ndarray) -> Steps:
    """The single steps of settled gaits."""
    steps = steps_of(problem, walker, at.stride, at.y, at.scale, at.times, slope)
    # That of the first step is known better.
    steps.state[:, : len(slope)] = at.state * at.scale
    return steps


def steps_of(
    problem: Problem,
    walker: Walker,
    stride: AnyStride,
    y: np.ndarray,
    scale: np.ndarray,
    times: np.ndarray,
    slope: np.ndarray,
) -> Steps:
    """Return the single steps of gaits: the first steps of all, then the second ones.

    Parameters
    ----------
    problem : Problem
        Of one walker, or of one for each gait.
    walker : Walker
        That walker, or an array of them.
    stride : Stride or Strides
    y : ndarray, shape (m, n)
        Sections over `scale`, shape (n,).
    times : ndarray, shape (k, n) [sqrt(leg/g)]
        Of the strikes, from the start of the first step.
    slope : ndarray, shape (n,) [rad]
    """
    s, n = problem.steps, len(slope)
    lanes = np.tile(np.arange(n), s)
    single = problem.of_steps(1).some(lanes)
    if s > 1 and isinstance(walker, WalkerArray):
        walker = walker.some(lanes)

    scale, slope = np.tile([scale, slope], s)
    y = side_by_side(y, s)
    state = problem.step.start(y, single.parameters(slope, scale))
    state = state[: problem.step.start_size]

    ends = times.reshape(s, -1, n)[:, -1]
    begins = np.vstack([np.zeros((1, n)), ends[:-1]]).ravel()

    return Steps(
        single,
        walker,
        stride.singles,
        y * scale,
        state * scale,
        side_by_side(times, s) - begins,
        scale,
        slope,
        after=np.roll(np.arange(s * n), -n),
    )


def of_all_steps(measured: Arrays, steps: int) -> Arrays:
    """Return what gaits have of the variables of their steps, as the registry's
    `over_steps` says.

    Parameters
    ----------
    measured : dict of ndarray, shape (steps n,)
        Of the first steps of all gaits, then of the second ones.
    steps : int

    Returns
    -------
    dict of ndarray, shape (n,)
    """
    measured = {name: values.reshape(steps, -1) for name, values in measured.items()}
    if (
        "unlocking_torque_time" in measured
    ):  # of the step with the worst torque, after those before it
        begins = np.cumsum(measured["period"], axis=0) - measured["period"]
        worst = measured["unlocking_torque"].argmax(axis=0)[None]
        measured["unlocking_torque_time"] = np.take_along_axis(
            begins + measured["unlocking_torque_time"], worst, 0
        )

    return {
        name: _OVER_STEPS[VARIABLES[name].over_steps](values)
        for name, values in measured.items()
    }


#: What a gait has of its steps' values, shape (s, n).
_OVER_STEPS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "first": lambda values: values[0],
    "sum": total,
    "mean": lambda values: total(values) / len(values),
    "greatest": lambda values: values.max(axis=0),
    "least": lambda values: np.fmin.reduce(values),
    "any": lambda values: np.bitwise_or.reduce(values),
}


def without_features(names: Sequence[str], features: Sequence[str], n: int) -> Arrays:
    """NaN for those of some variables that are only of what the walker has not.

    Parameters
    ----------
    names : sequence of str
    features : sequence of str
        What it has.
    n : int

    Returns
    -------
    dict of ndarray, shape (n,)
    """
    lacking = [name for name in names if VARIABLES[name].only_of not in ("", *features)]
    return {name: np.full(n, np.nan) for name in lacking}


@dataclass(frozen=True)
class Steps:
    """Steps of a walker, or of one for each, in lanes.

    Parameters
    ----------
    problem : Problem
    walker : Walker
        That walker, or an array of them.
    stride : Stride
        Of sections over `scale`.
    y, state : ndarray, shape (m, n) and (angles, n) [rad, sqrt(g/leg)]
        Sections, and states just after the heelstrike with which each step begins.
    times : ndarray, shape (phases, n) [sqrt(leg/g)]
    scale : ndarray, shape (n,)
    slope : ndarray, shape (n,) [rad]
    after : ndarray of int, shape (n,)
        The step after each: of gaits of one step, itself.
    """

    problem: Problem
    walker: Walker
    stride: Stride
    y: np.ndarray
    state: np.ndarray
    times: np.ndarray
    scale: np.ndarray
    slope: np.ndarray
    after: np.ndarray

    def measure(
        self, want: Sequence[str], limits: Mapping[str, float] | None = None
    ) -> Arrays:
        """Variables of the single steps.

        Parameters
        ----------
        want : sequence of str
            Names of variables; what costs little is measured in any case.
        limits : mapping, optional
            Limits of violations other than the registry's.

        Returns
        -------
        dict of ndarray, shape (n,)
            In the walker's units.
        """
        measured = self._states_and_times() | self._work_of_drive()
        groups = {VARIABLES[name].group for name in want}
        if "energy" in groups:
            measured |= self._losses()
        if "violations" in groups:
            measured |= self._violations(limits)

        # What other packages add may be made of all that is measured.
        for name in want:
            function = VARIABLES[name].measure
            if function is not None:
                values = np.asarray(function(self, measured), float)
                of_lanes = np.broadcast_to(values, self.slope.shape)
                measured[name] = np.array(of_lanes)

        return measured

    def _states_and_times(self) -> Arrays:
        """What costs little: states, times and lengths of the steps."""
        walker = self.walker
        time_unit = walker.time_unit
        angle = self.y[0]
        end = angle[self.after]
        rates = self.state[self.problem.map.start_size // 2 :] / time_unit
        ratio = gait_ratio(self.stride)
        measured = {
            "stance_angle": angle,
            "stance_rate": rates[0],
            "thigh_rate": rates[1],
            "shank_rate": rates[-1],
            "period": self.times[-1] * time_unit,
            "step_length": step_length(walker, angle, end),
            "heelstrike_rate_ratio": ratio,
            "velocity_ratio": velocity_ratio(walker, end, ratio),
        }
        if walker.knees:
            measured["kneestrike_time"] = self.times[0] * time_unit
        return measured

    @cached_property
    def _push_off(self) -> PushOff | None:
        """The push-off at the end of each step; None of a walker without one."""
        if "push_off" not in self.problem.features:
            return None
        end = self.y[0][self.after]
        return push_off(self.walker, end, self.problem.impulses(len(self.slope)))

    def _work_of_drive(self) -> Arrays:
        """Work of push-off and hip over each step, of a walker that has them."""
        walker, work = self.walker, {}
        unit = walker.total_mass * walker.g * walker.leg
        if self._push_off is not None:
            work["push_off_work"] = self._push_off.work * unit
        if walker.has_hip_torque:
            begin, end = self.y[0], self.y[0][self.after]
            of_hip = hip_torque_work(walker, begin, end)
            work["hip_torque_work"] = of_hip * unit

        return work

    def _losses(self) -> Arrays:
        """Energy lost in each step."""
        walker, stride, scale = self.walker, self.stride, self.scale
        unit = walker.total_mass * walker.g * walker.leg
        end = self.y[0][self.after]
        impact = stride.impact * scale
        normal, tangential = heelstrike_losses(walker, end, impact, self._push_off)
        losses = {"loss_normal": normal * unit, "loss_tangential": tangential * unit}
        if walker.knees:
            knee = kneestrike_loss(walker, stride.knee * scale)
            losses["loss_kneestrike"] = knee * unit

        if walker.has_hip_torque:
            damped = np.zeros(len(end))
            if np.any(walker.hip_damping):
                damped = damping_loss(walker, self._dissipation())
            losses["loss_damping"] = damped * unit

        return losses

    def motion(self) -> list[np.ndarray]:
        """Samples of the motion from heelstrike to heelstrike.

        Returns
        -------
        list of ndarray, shape (samples + 1, 2 angles, n) [rad, sqrt(g/leg)]
            Of each phase: angles of the links, then their rates, at times at equal
            distances.
        """
        return [part * self.scale for part in self._fine.one.motion]

    def _dissipation(self) -> np.ndarray:
        """Integral over each step of the square of the rate at which thighs open."""
        parameters = self.problem.parameters(self.slope, self.scale)
        of_scaled = self.problem.step.dissipation(
            self.y / self.scale, self.times, parameters
        )
        return of_scaled * self.scale**2

    @cached_property
    def _fine(self) -> Stride | Strides:
        # Extremes need closer samples than the verification of a step: it is integrated
        # again with those, unless it has them.
        if len(self.stride.motion[0]) == violations.SAMPLES + 1:
            return self.stride
        parameters = self.problem.parameters(self.slope, self.scale)
        return self.problem.map(
            self.y / self.scale, self.times, parameters, samples=violations.SAMPLES
        )

    def _violations(self, limits: Mapping[str, float] | None) -> Arrays:
        # A step begins with the heelstrike that ends the one before it.
        before = (self._fine.one.impact * self.scale)[:, np.argsort(self.after)]
        begun = np.argsort(self.after)
        push = None if self._push_off is None else self._push_off.some(begun)
        return violations.measure(
            self.walker, self.motion(), before, self.times, self.slope, limits, push
        )


def energy_imbalance(
    walker: Walker, slope: np.ndarray, measured: Mapping[str, np.ndarray], steps: int
) -> np.ndarray:
    """What the energy lost in a gait's steps exceeds that which the drop of potential
    energy, push-off and hip supply, over the sum of their sizes.

    Parameters
    ----------
    walker : Walker
    slope : ndarray, shape (n,) [rad]
    measured : mapping
        The losses and works of all steps and the mean step length, in the walker's
        units.
    steps : int

    Returns
    -------
    ndarray, shape (n,)
    """
    losses = sum(measured[name] for name in _LOSSES if name in measured)
    drop = (
        walker.total_mass * walker.g * steps * measured["step_length"] * np.sin(slope)
    )
    supplied = [drop, *_supplied(measured).values()]
    sizes = sum(np.abs(work) for work in supplied)
    return np.asarray((losses - sum(supplied)) / sizes)


def _supplied(measured: Mapping[str, np.ndarray]) -> Arrays:
    """The work that drives a walker beside gravity, as far as it is measured."""
    names = "push_off_work", "hip_torque_work"
    return {name: measured[name] for name in names if name in measured}


def of_travel(
    walker: Walker, slope: np.ndarray, measured: Mapping[str, np.ndarray], steps: int
) -> Arrays:
    """Return what `kinematics.travel` computes, and the costs of transport of a walker
    that more than gravity drives.

    Parameters
    ----------
    walker : Walker
    slope : ndarray, shape (n,) [rad]
    measured : mapping
        The mean step length, the period and what drives all steps, in the walker's
        units.
    steps : int

    Returns
    -------
    dict of ndarray, shape (n,)
    """
    length = measured["step_length"]
    of_gaits = travel(walker, slope, length, measured["period"], steps)
    supplied = _supplied(measured)
    if supplied:
        distance = walker.total_mass * walker.g * steps * length
        by_drive = total(supplied.values()) / distance
        of_gaits["cost_of_transport"] = of_gaits["cost_of_transport"] + by_drive
        of_gaits["mechanical_cost_of_transport"] = by_drive

    return of_gaits


def measured_multipliers(
    jacobian: np.ndarray, change: np.ndarray | float, error: np.ndarray, kneed: bool
) -> Arrays:
    """Variables of the group `multipliers`.

    Parameters
    ----------
    jacobian : ndarray, shape (d, d, n)
        Derivative of all steps.
    change, error : ndarray, shape (d, n)
        What is to be added to the coefficients of its characteristic polynomial, and
        bounds of their errors.
    kneed : bool

    Returns
    -------
    dict of ndarray, shape (n[, multipliers])
    """
    values = multipliers(jacobian, _MULTIPLIERS[kneed])
    values[:, : len(jacobian)] += multiplier_changes(
        values[:, : len(jacobian)], np.broadcast_to(change, error.shape)
    )
    return {
        "multiplier_real": values.real.copy(),
        "multiplier_imag": values.imag.copy(),
        "spectral_radius": np.abs(values).max(axis=1),
        "multiplier_error_bound": multiplier_bounds(values, error),
    }
