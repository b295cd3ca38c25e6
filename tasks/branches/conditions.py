"""Conditions that a point of a branch may satisfy besides the equations of a gait: the
scalar that vanishes at each kind of special point, or at gaits of a given speed.

A new kind of point is named in `tasks/contract/kinds.toml`, whose flags say where it is
looked for, and has its row in the table at the end of this module. In shapes, n counts
lanes, c the unknowns Z of a gait (`tasks.branches.joint`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy import ndarray

from gaitsweep.tasks.branches.joint import Evaluation, determinants
from gaitsweep.tasks.branches.pseudo_arclength import bordered_matrix
from gaitsweep.tasks.branches.tracking import MOST_RATE, fall_margin, rate_of_steps
from gaitsweep.tasks.contract.kinds import KINDS, Kind
from gaitsweep.tasks.gaits.step_check import LONG_BELOW, gait_ratio
from gaitsweep.tasks.mechanics.arrays import Coordinates, Numbers, PerLane
from gaitsweep.tasks.mechanics.contact import Chain
from gaitsweep.tasks.mechanics.sums import total
from gaitsweep.tasks.step.problem import Problem

#: Scalars of evaluated steps, shape (n,), and their derivatives by Z, shape (c, n).
Scalar = Callable[[Evaluation], ndarray]
#: Whether the multipliers (m,) of a point are those of its kind.
Genuine = Callable[[ndarray], bool]
#: Distance of a multiplier from where it is at a special point, and of a pair from the
#: real axis.
_CRITICAL = 1e-6


@dataclass(frozen=True)
class Condition:
    """A condition beside the equations of a gait: that a scalar has a value.

    Attributes
    ----------
    name : str
        Of `KINDS`, or of a codimension-two point.
    value : callable
        The scalar at evaluated steps.
    by_Z : callable or None
        Its derivatives by Z where a formula has them; otherwise they are differences.
    target : float or ndarray, shape (n,)
        The value that it has at the point, or at that of each lane.
    walking : int
        On which side gaits are steps, where the condition is an end: 1 where the scalar
        is greater than the target, -1 where it is less, 0 elsewhere.
    is_genuine : callable or None
        Whether a change of sign is a point of the kind, by its multipliers.
    is_met_at_end : bool
        Whether it is fulfilled at the ends of branches that have its name.
    """

    name: str
    value: Scalar
    by_Z: Scalar | None = None
    target: float | ndarray = 0.0
    walking: int = 0
    is_genuine: Genuine | None = None
    is_met_at_end: bool = False

    @property
    def kind(self) -> Kind:
        """What is known of points of this name."""
        return KINDS[self.name]

    def equal_to(self, target: float | ndarray) -> Condition:
        """Return the condition that the scalar has another value."""
        return replace(self, target=target)

    def some(self, lanes: Numbers) -> Condition:
        """Return the condition of some lanes."""
        if isinstance(self.target, ndarray):
            return self.equal_to(self.target[lanes])
        return self

    # Where heelstrike is tangential to the last digit the map has no derivative.
    @np.errstate(invalid="ignore", over="ignore", divide="ignore")
    def residual(self, at: Evaluation) -> ndarray:
        """Return how far the scalar is from its target, shape (n,)."""
        return self.value(at) - self.target


def foot_radius(problem: Problem) -> ndarray:
    """Return the radius of the foot over the leg, of n lanes (n,), of one walker ()."""
    walkers = problem.every_walker
    return np.asarray(walkers.R / walkers.leg)


def log_froude(Z: Coordinates, radius: PerLane) -> ndarray:
    """Return the logarithm of the mean speed over sqrt(g leg).

    Parameters
    ----------
    Z : ndarray, shape (c, n)
    radius : ndarray, shape (n,) or ()
        Of the foot, over the leg.

    Returns
    -------
    ndarray, shape (n,)
    """
    angle = np.exp(Z[0])
    half_step = (1 - radius) * np.sin(angle) + radius * angle
    return np.asarray(np.log(2 * half_step / Z[-2]))


def log_froude_by_Z(Z: Coordinates, radius: PerLane) -> ndarray:
    """Return the derivatives of `log_froude` by Z.

    Parameters
    ----------
    Z : ndarray, shape (c, n)
    radius : ndarray, shape (n,) or ()
        Of the foot, over the leg.

    Returns
    -------
    ndarray, shape (c, n)
    """
    angle = np.exp(Z[0])
    half_step = (1 - radius) * np.sin(angle) + radius * angle

    by_Z = np.zeros_like(Z)
    by_Z[0] = angle * ((1 - radius) * np.cos(angle) + radius) / half_step
    by_Z[-2] = -1 / Z[-2]
    return by_Z


def _log_speed(at: Evaluation) -> ndarray:
    """Logarithm of the mean speed in the walkers' units."""
    walkers = at.problem.every_walker
    in_unit = 0.5 * np.log(walkers.g * walkers.leg)
    return log_froude(at.Z, foot_radius(at.problem)) + in_unit


def _log_speed_by_Z(at: Evaluation) -> ndarray:
    return log_froude_by_Z(at.Z, foot_radius(at.problem))


def _log_slope_by_Z(at: Evaluation) -> ndarray:
    by_Z = np.zeros_like(at.Z)
    by_Z[-1] = 1.0
    return by_Z


def _log_angle(at: Evaluation) -> ndarray:
    """Logarithm of the stance angle."""
    return at.Z[0]


def _log_angle_by_Z(at: Evaluation) -> ndarray:
    by_Z = np.zeros_like(at.Z)
    by_Z[0] = 1.0
    return by_Z


def _fold(at: Evaluation) -> ndarray:
    """Determinant of the joint equations at a fixed slope."""
    return determinants(at.derivative[:, :-1].transpose(2, 0, 1))


def _flip(at: Evaluation) -> ndarray:
    """Determinant of I + DP."""
    return determinants(at.jacobians + np.eye(at.jacobians.shape[-1]))


_PAIRS = ((0, 1), (0, 2), (1, 2))


def _neimark_sacker(at: Evaluation) -> ndarray:
    """Product over i < j of (lambda_i lambda_j - 1): the determinant of the second
    compound matrix less one.
    """
    A = at.jacobians
    if A.shape[-1] == 2:
        return determinants(A) - 1

    def minor(rows: tuple[int, int], columns: tuple[int, int]) -> ndarray:
        i, j = rows
        k, q = columns
        return np.asarray(A[:, i, k] * A[:, j, q] - A[:, i, q] * A[:, j, k])

    compound = np.empty((3, 3, len(A)))
    for place, rows in enumerate(_PAIRS):
        for other, columns in enumerate(_PAIRS):
            compound[place, other] = minor(rows, columns)

    return determinants(np.moveaxis(compound, -1, 0) - np.eye(3))


def _pair_sum(at: Evaluation) -> ndarray:
    """Sum of the two multipliers whose product is 1, at Neimark-Sacker points: twice
    the cosine of the pair's angle. A third multiplier is the determinant there.
    """
    A = at.jacobians
    trace = np.trace(A, axis1=1, axis2=2)
    if A.shape[-1] == 2:
        return np.asarray(trace)
    return np.asarray(trace - determinants(A))


def _is_flip(multipliers: ndarray) -> bool:
    return bool(np.abs(multipliers + 1).min() < _CRITICAL)


def _is_neimark_sacker(multipliers: ndarray) -> bool:
    pair = multipliers[np.abs(np.abs(multipliers) - 1) < _CRITICAL]
    return len(pair) == 2 and bool(np.abs(pair.imag).min() > _CRITICAL)


def _nearest_zero(values: ndarray, at: Evaluation) -> ndarray:
    """Of the values at each step of gaits, (s, n) or (s n,), those nearest zero, shape
    (n,).
    """
    values = values.reshape(at.stride.steps, -1)
    nearest = np.nan_to_num(np.abs(values)).argmin(axis=0)
    return np.take_along_axis(values, nearest[None], axis=0)[0]


def _closing_at(strike: int) -> Scalar:
    """Rate of the guard of a step's first (0) or last (-1) strike, over the stance
    angle.
    """

    def closing(at: Evaluation) -> ndarray:
        return _nearest_zero(at.stride.singles.closing[strike], at) / at.stride.y[0]

    return closing


def _last_phase(at: Evaluation) -> ndarray:
    """Duration of a step's last phase."""
    durations = np.diff(at.times, axis=0, prepend=0)
    of_steps = durations.reshape(at.stride.steps, -1, durations.shape[1])
    return _nearest_zero(of_steps[:, -1], at)


def _foot_at_kneestrike(at: Evaluation) -> ndarray:
    """Height of the foot as the knee strikes, in angles over the stance angle."""
    stance, thigh = at.stride.one.knee[0], at.stride.one.knee[1]
    return _nearest_zero(stance + thigh, at) / at.stride.y[0]


def _knee_rate(at: Evaluation) -> ndarray:
    """Rate at which the released knee begins to bend, over the stance angle; its
    acceleration where it was locked during heelstrike and begins without a rate.
    """
    if at.problem.structure.locks_trailing_knee:
        bending = _knee_acceleration(at)
    else:
        thigh_rate, shank_rate = at.stride.one.start[4], at.stride.one.start[5]
        bending = thigh_rate - shank_rate
    return _nearest_zero(bending, at) / at.stride.y[0]


def _knee_acceleration(at: Evaluation) -> ndarray:
    """Acceleration with which the released knee begins to bend, as angles are scaled."""
    s = at.stride.steps
    start = at.stride.singles.start
    scale = np.exp(at.Z[0]) / at.stride.y[0]
    slope = at.problem.slopes(np.exp(at.q))
    scale, slope = np.tile(np.stack([scale, slope]), s)
    links = [0, 0, 1, 2]
    q, rate = start[:3][links] * scale, start[3:][links] * scale

    driven, _ = at.problem.lanes_at(np.exp(at.q))
    walkers = driven.every_walker.some(np.tile(np.arange(len(at.q)), s))
    *_, thigh, shank = Chain(walkers).accelerations(q, rate, slope, True)
    return np.asarray((thigh - shank) / scale)


def _foot_rise(at: Evaluation) -> ndarray:
    """Rate at which the released foot leaves the ground, over the stance angle: where it
    is negative the foot would sink.
    """
    singles = at.stride.singles
    half = len(singles.start) // 2
    links = [0, 0, 1, half - 1]
    scale = np.tile(np.exp(at.Z[0]) / at.stride.y[0], at.stride.steps)
    angles = singles.start[:half][links] * scale
    rates = singles.start[half:][links]

    chain = Chain(at.problem.every_walker)
    rise = total(chain.rise(angles) * rates)
    return _nearest_zero(rise, at) / at.stride.y[0]


def _stationary(at: Evaluation, by_Z: Coordinates) -> ndarray:
    """Determinant that vanishes where a quantity is stationary along the branch, by its
    derivatives (c, n).
    """
    return determinants(bordered_matrix(at.derivative, by_Z))


def _fastest(at: Evaluation) -> ndarray:
    return _stationary(at, _log_speed_by_Z(at))


def _exponent_two_thirds(at: Evaluation) -> ndarray:
    """Vanishes where ln angle - 2/3 ln slope is stationary: there the angle grows with
    that power of slope.
    """
    by_Z = np.zeros_like(at.Z)
    by_Z[0], by_Z[-1] = 1.0, -2 / 3
    return _stationary(at, by_Z)


def _label(at: Evaluation) -> ndarray:
    return gait_ratio(at.stride) - LONG_BELOW


def _log_slope(at: Evaluation) -> ndarray:
    return at.q


def _fall(at: Evaluation) -> ndarray:
    return fall_margin(at.Z, at.stride.steps)


def _zero_step(at: Evaluation) -> ndarray:
    return rate_of_steps(at.Z, at.m, at.stride.steps) - MOST_RATE


_TABLE = (
    Condition("fold", _fold),
    Condition("flip", _flip, is_genuine=_is_flip),
    Condition("neimark_sacker", _neimark_sacker, is_genuine=_is_neimark_sacker),
    Condition(
        "end_kneestrike_at_heelstrike",
        _last_phase,
        walking=1,
        is_met_at_end=True,
    ),
    Condition(
        "end_tangential_heelstrike",
        _closing_at(-1),
        walking=-1,
        is_met_at_end=True,
    ),
    Condition(
        "end_tangential_kneestrike",
        _closing_at(0),
        walking=-1,
        is_met_at_end=True,
    ),
    Condition(
        "end_fall",
        _fall,
        walking=-1,
        is_met_at_end=True,
    ),
    # Where steps vanish before rates have grown so large, they may have any size.
    Condition(
        "end_zero_step",
        _zero_step,
        walking=-1,
    ),
    Condition("foot_at_kneestrike", _foot_at_kneestrike),
    Condition("release_hyperextension", _knee_rate),
    Condition("release_penetration", _foot_rise),
    Condition("fastest", _fastest),
    Condition("exponent_two_thirds", _exponent_two_thirds),
    Condition("label", _label),
    Condition("window", _log_slope, _log_slope_by_Z),
    Condition("speed", _log_speed, _log_speed_by_Z),
    Condition("small_step", _log_angle, _log_angle_by_Z),
)
#: The condition of each kind that equations define, by its name.
CONDITIONS: dict[str, Condition] = {each.name: each for each in _TABLE}


#: Conditions that hold at codimension-two points of curves of one kind and are no kind
#: of point by themselves: by that kind, and by the names of these points.
DEGENERATE: dict[str, dict[str, Condition]] = {
    "neimark_sacker": {
        "resonance 1:3": Condition("resonance 1:3", _pair_sum, target=-1.0),
        "resonance 1:4": Condition("resonance 1:4", _pair_sum, target=0.0),
    },
}


def is_located(kind: str) -> bool:
    """Return whether points of a kind are solved for: there is a condition, and it is
    no mere limit to how far gaits are followed.
    """
    return kind in CONDITIONS and KINDS[kind].ends != "following"
