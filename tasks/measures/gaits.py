"""What is measured of gaits, and how it is stored by their labels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tasks import status
from tasks.accuracy import MANTISSA, significant_bits
from tasks.fixed_points.labels import places
from tasks.fixed_points.multipliers import multiplier_bounds, multipliers
from tasks.fixed_points.polish import Polished
from tasks.fixed_points.step_check import gait_ratio
from tasks.measures import violations
from tasks.measures.kinematics import step_length, travel
from tasks.measures.losses import heelstrike_losses, kneestrike_loss
from tasks.registry import GAITS, VARIABLES
from tasks.step.problem import Problem, residual_sizes
from tasks.walkers.walker import Walker

Arrays = dict[str, np.ndarray]
#: Significant bits in which bounds are kept that need not be exact.
_BOUND_BITS = 4


def nothing_solved(names: Sequence[str], n: int, multipliers: int) -> Arrays:
    """Return arrays of variables at points without a gait.

    Parameters
    ----------
    names : sequence of str
        Of variables.
    n, multipliers : int
        Number of points, and of multipliers of a gait.

    Returns
    -------
    dict of ndarray, shape (n, len(GAITS)[, multipliers])
    """
    out: Arrays = {}
    for name in names:
        shape = (n, len(GAITS), multipliers) if "multiplier" in VARIABLES[name].dims else (n, len(GAITS))
        out[name] = np.full(shape, VARIABLES[name].absent, VARIABLES[name].dtype)
    out["reason"][:] = [1, 5, 2, 2]
    return out


@dataclass(frozen=True)
class Part:
    """Gaits of one piece of a branch: their points, what labels them, and what was solved.

    `angle` and `ratio` are those by which labels are given; `angle` is NaN where a gait has none.
    """

    index: np.ndarray
    angle: np.ndarray
    ratio: np.ndarray
    solved: Arrays


def store(out: Arrays, parts: Sequence[Part], wanted: set[str]) -> None:
    """Store gaits by label.

    Parameters
    ----------
    out : dict of ndarray, shape (n, len(GAITS)[, multipliers])
        Changed in place.
    parts : sequence of Part
        With indices into the n points.
    wanted : set of str
        Labels to store.
    """
    n = len(out["status"])
    angle, ratio = np.full((2, len(parts), n), np.nan)
    for k, part in enumerate(parts):
        angle[k, part.index], ratio[k, part.index] = part.angle, part.ratio
    is_wanted = np.array([gait in wanted for gait in GAITS] + [False])  # there may be more gaits than labels
    for part, place in zip(parts, places(angle, ratio), strict=True):
        slot = np.minimum(place[part.index], len(GAITS))
        keep = np.flatnonzero((slot >= 0) & is_wanted[slot])
        row, slot = part.index[keep], slot[keep]
        where: tuple[Any, Any] = (row, slot)
        if len(row) and row[-1] - row[0] == len(row) - 1 and (slot == slot[0]).all() and (np.diff(row) == 1).all():
            where = slice(row[0], row[-1] + 1), slot[0]  # several times as fast
        for name, values in out.items():
            solved = part.solved[name]
            values[where] = solved if len(keep) == len(solved) else solved[keep]


def to_accuracy(out: Arrays, accuracy: float) -> None:
    """Round gaits to the digits that an accuracy leaves them, and mark those whose error bound exceeds it.

    Parameters
    ----------
    out : dict of ndarray, shape (n, len(GAITS)[, multipliers])
        Changed in place; bounds count the rounding.
    accuracy : float
        Largest error bound wanted; 0 for as good as doubles give, which changes nothing.
    """
    if not accuracy:
        return
    # Labels that no gait has need no rounding.
    used = slice(1 + int(np.flatnonzero(np.isin(out["status"], status.SOLVED).any(axis=0)).max(initial=0)))
    out = {name: values[:, used] for name, values in out.items()}
    bits = significant_bits(accuracy)
    unit = 0.5 ** (bits + 1) if bits < MANTISSA else 0.0
    bound = out["error_bound"] + unit
    coarse = (out["status"] == status.CONVERGED) & (bound > accuracy)
    out["status"][coarse], out["reason"][coarse] = status.LESS_ACCURATE, status.COARSE_REASON
    for name, values in out.items():
        if name == "error_bound":
            values[:] = np.where(coarse, _round_up(bound), np.minimum(_round_up(bound), accuracy))
        elif name == "multiplier_error_bound":
            names = ("multiplier_real", "multiplier_imag", "spectral_radius")
            sizes = [np.abs(out[k]).reshape(*values.shape, -1).max(axis=-1) for k in names if k in out]
            largest = sum(sizes, np.zeros(values.shape))
            values[:] = _round_up(values + 2 * unit * largest)
        elif values.dtype == float:
            rounded = round_bits(values, bits)
            if name == "spectral_radius":
                # Rounding makes no stable gait unstable.
                rounded = np.where(values < 1, np.minimum(rounded, 1 - unit), rounded)
            values[:] = rounded


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
    whole = np.ascontiguousarray(values).view(np.uint64)
    half = np.uint64((1 << (drop - 1)) - 1)
    even = (whole >> np.uint64(drop)) & np.uint64(1)
    mask = np.uint64(0xFFFFFFFFFFFFFFFF ^ ((1 << drop) - 1))
    return np.asarray(((whole + half + even) & mask).view(float))


def describe(
    problem: Problem,
    walker: Walker,
    at: Polished,
    slope: np.ndarray,
    want: Sequence[str],
    friction_limit: float = violations.FRICTION_LIMIT,
) -> Arrays:
    """Measure the wanted variables of gaits.

    Parameters
    ----------
    problem : Problem
        Of one walker, or of one for each gait.
    walker : Walker
        That walker, or an array of them, for which violations cannot be measured.
    at : Polished
        The gaits.
    slope : ndarray, shape (n,) [rad]
    want : sequence of str
        Names of variables.
    friction_limit : float

    Returns
    -------
    dict of ndarray, shape (n[, multipliers])
        In the walker's units; NaN where the guess is not converged to a step.
    """
    code = np.where(at.converged & at.step, status.CONVERGED, status.NOT_CONVERGED)
    solved = {
        "status": code,
        "reason": np.where(at.converged, np.where(at.step, 0, 4), 3),
        "residual": np.abs(at.stride.residual / residual_sizes(at.stride.y, problem.phases)).max(axis=0),
        "error_bound": at.bound,
        "anthropomorphic": ~at.step | (at.leg_passes == 1),
        "passes": at.leg_passes,
    }
    solved |= _measure(problem, walker, at, slope, want, friction_limit)
    for name, value in solved.items():
        if value.dtype == float and name not in ("residual", "heelstrike_rate_ratio"):
            value[code != status.CONVERGED] = np.nan
    return solved


def _measure(
    problem: Problem, walker: Walker, at: Polished, slope: np.ndarray, want: Sequence[str], friction_limit: float
) -> Arrays:
    """Variables of the groups wanted, in the walker's units."""
    stride, scale = at.stride, at.scale
    y, state, times = at.y * scale, at.state * scale, at.times
    time_unit = np.sqrt(walker.leg / walker.g)
    half = problem.map.start_size // 2
    angle, period = y[0], times[-1] * time_unit
    rates = state[half:] / time_unit
    measured = {
        "stance_angle": angle,
        "stance_rate": rates[0],
        "thigh_rate": rates[1],
        "shank_rate": rates[-1],
        "period": period,
        "heelstrike_rate_ratio": gait_ratio(stride),
        "kneestrike_time": times[0] * time_unit if walker.knees else np.full(len(slope), np.nan),
    }
    if any(VARIABLES[name].group == "multipliers" for name in want):
        measured |= measured_multipliers(stride.jacobian, at.jacobian_error, walker.knees)
    measured |= travel(walker, slope, angle, period)
    if {"loss_normal", "loss_tangential", "loss_kneestrike", "energy_imbalance"} & set(want):
        unit = walker.total_mass * walker.g * walker.leg
        normal, tangential = heelstrike_losses(walker, angle, stride.impact * scale)
        measured["loss_normal"], measured["loss_tangential"] = normal * unit, tangential * unit
        knee = np.zeros(len(slope))
        if walker.knees:
            knee = kneestrike_loss(walker, stride.knee * scale)
        measured["loss_kneestrike"] = knee * unit if walker.knees else np.full(len(slope), np.nan)
        drop = step_length(walker, angle) / walker.leg * np.sin(slope)
        measured["energy_imbalance"] = (normal + tangential + knee - drop) / drop
    if any(VARIABLES[name].group == "violations" for name in want):
        # Extremes need closer samples than the verification of a step: it is integrated again with those.
        fine = problem.map(y / scale, times, problem.parameters(slope, scale), samples=violations.SAMPLES)
        measured |= violations.measure(
            walker, [m * scale for m in fine.motion], fine.impact * scale, times, slope, friction_limit
        )
    return {k: np.array(v) for k, v in measured.items()}


def measured_multipliers(jacobian: np.ndarray, error: np.ndarray, kneed: bool) -> Arrays:
    """Variables of the group `multipliers`.

    Parameters
    ----------
    jacobian : ndarray, shape (m, m, n)
        Derivative of the step map.
    error : ndarray, shape (n,)
        Bound of the Frobenius norm of its error.
    kneed : bool

    Returns
    -------
    dict of ndarray, shape (n[, multipliers])
    """
    values = multipliers(jacobian, 4 if kneed else 3)
    return {
        "multiplier_real": values.real.copy(),
        "multiplier_imag": values.imag.copy(),
        "spectral_radius": np.abs(values).max(axis=1),
        "multiplier_error_bound": multiplier_bounds(jacobian, values, error),
    }
