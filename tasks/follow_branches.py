"""The task `branch`: solution branches over a window of slopes, with their special
points.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from gaitsweep.tasks.continuation import atlas as atlases
from gaitsweep.tasks.continuation.branch import Branch
from gaitsweep.tasks.continuation.locate import locate_root
from gaitsweep.tasks.continuation.lockstep import run
from gaitsweep.tasks.continuation.sampling import chosen, within
from gaitsweep.tasks.continuation.special_points import RATES, record, special_points
from gaitsweep.tasks.continuation.tracking import correct
from gaitsweep.tasks.fixed_points.multipliers import multipliers
from gaitsweep.tasks.fixed_points.step_check import LONG_BELOW, gait_ratio
from gaitsweep.tasks.measures import violations
from gaitsweep.tasks.status import over
from gaitsweep.tasks.step.problem import EPS, Problem
from gaitsweep.tasks.step.several_steps import from_largest
from gaitsweep.tasks.tables import nothing, stacked, table
from gaitsweep.tasks.walkers.resolve import walker_of_line

#: Columns of the tables `branches` and `special_points`.
COLUMNS = (
    *("branch", "slope", "stance_angle", *RATES),
    *("period", "kneestrike_time", "spectral_radius", "stable", "gait"),
)
SPECIAL = ("branch", "kind", "slope", "stance_angle", *RATES, "period", "error_bound")
#: Largest number of points between two nodes; a window that needs more is too narrow.
_MAX_PARTS = 65536
#: Least share of ln slope in a branch's direction for points to be corrected at their
#: slopes.
_STEEP = 1e-2


def branch(
    params: Mapping[str, Any], inputs: list[dict[str, np.ndarray]]
) -> dict[str, np.ndarray]:
    """Sample a line's branches, continued through folds to their ends.

    Parameters
    ----------
    params : mapping
        `line`; `slope_from`, `slope_to` [rad], the window; `n`, the least number of
        points of a branch in it, or `adaptive`, the tolerance of linear interpolation
        between them; `steps` after which the gaits repeat.
    inputs : list
        The line's atlas, of the same `steps`.

    Returns
    -------
    dict
        Tables `branches` (branch, slope, stance_angle, stance_rate, thigh_rate,
        shank_rate, period, kneestrike_time, spectral_radius, stable, gait) and
        `special_points` (branch, kind, slope, stance_angle, stance_rate, thigh_rate,
        shank_rate, period, error_bound), in the walker's units.
    """
    walker = walker_of_line(params["line"])
    problem = Problem(walker, int(params.get("steps", 1)))
    time_unit = walker.time_unit
    low, high, least = (
        float(params["slope_from"]),
        float(params["slope_to"]),
        int(params.get("n", 2)),
    )
    tolerance = float(params.get("adaptive", 0.0))
    parts: list[tuple[Any, ...]] = []
    points: list[tuple[Any, ...]] = []
    for number, curve in enumerate(atlases.from_arrays(inputs[0])):
        Z = (
            chosen(problem, curve, low, high, tolerance)
            if tolerance
            else _dense(problem, curve, low, high, least)
        )
        if not Z.shape[1]:
            continue
        w, q, m = from_largest(Z[:-1], curve.m, problem.steps), Z[-1], curve.m
        stride, scale = problem.stride(w, q)
        rates = problem.start(stride.y * scale, np.exp(q))[1:] / time_unit
        radius = np.abs(multipliers(stride.jacobian, len(stride.jacobian))).max(axis=1)
        times = w[m:] * time_unit
        knee = times[0] if walker.knees else np.nan
        label = np.where(gait_ratio(stride) < LONG_BELOW, "long", "short")
        parts.append(
            (
                number,
                np.exp(q),
                np.exp(w[0]),
                *rates,
                times[-1],
                knee,
                radius,
                (radius < 1).astype("i1"),
                label,
            )
        )

        found = special_points(problem, curve) + contact_lost(problem, curve, low, high)
        found = [
            point
            for point in found
            if low <= point["slope"] <= high and point["kind"] != "window"
        ]
        for point in found + _leaves_window(problem, curve, low, high):
            state = point["stance_angle"], *(np.array(point["rates"]) / time_unit)
            period, error = point["period"] * time_unit, point["error_bound"]
            points.append(
                (number, point["kind"], point["slope"], *state, period, error)
            )
    tables = stacked("branches", parts, COLUMNS) | table(
        "special_points", points, SPECIAL
    )
    gait = f"gait of {problem.steps} steps" if problem.steps > 1 else "gait"
    return tables if parts else tables | nothing(over(gait, np.array([low, high])))


def contact_lost(
    problem: Problem, branch: Branch, low: float, high: float
) -> list[dict[str, Any]]:
    """Locate the points at which the least normal force over a step vanishes, so that
    the foot would lift off.

    Parameters
    ----------
    problem : Problem
    branch : Branch
    low, high : float [rad]
        Window of slopes.

    Returns
    -------
    list of dict
        As `special_points`, of kind `end_contact_lost`. The step map does not model it,
        and the branch continues.
    """

    def least(Z: np.ndarray, samples: int = violations.SAMPLES) -> np.ndarray:
        stride, scale = problem.stride(Z[:-1], Z[-1], samples=samples)
        each, (scale, slope) = (
            stride.singles,
            np.tile([scale, np.exp(Z[-1])], stride.steps),
        )
        # A step begins with the heelstrike that ends the one before it.
        impact, motion = (
            np.roll(each.impact, Z.shape[1], axis=1) * scale,
            [part * scale for part in each.motion],
        )
        force = violations.measure(problem.walker, motion, impact, each.times, slope)[
            "least_normal_force"
        ]
        return force.reshape(stride.steps, -1).min(axis=0)

    ends = np.sort([branch.q[1:], branch.q[:-1]], axis=0)
    meets = (ends[0] <= np.log(high)) & (
        ends[1] >= np.log(low)
    )  # segments: a window may lie within one
    near = np.nonzero(np.convolve(meets, np.ones(2)))[0]
    if not len(near):
        return []
    force = np.full(len(branch.q), np.nan)
    force[near] = least(branch.Z[:, near])
    records: list[dict[str, Any]] = []
    for segment in np.nonzero(force[1:] * force[:-1] < 0)[0]:
        point = run(
            problem,
            locate_root(branch, int(segment), lambda point: float(least(point.Z)[0])),
        )
        # Closer samples show the error of the minimum of a sampled force.
        error = least(point.Z, 2 * violations.SAMPLES)[0] / (
            force[segment + 1] - force[segment]
        )
        slope_error = abs(float(error * (branch.q[segment + 1] - branch.q[segment])))
        records.append(record("end_contact_lost", point.at, 0, slope_error + 64 * EPS))
    return records


def _leaves_window(
    problem: Problem, branch: Branch, low: float, high: float
) -> list[dict[str, Any]]:
    """Find the points at which a branch goes on beyond a window of slopes.

    Parameters
    ----------
    problem : Problem
    branch : Branch
    low, high : float [rad]
        The window.

    Returns
    -------
    list of dict
        As `special_points`, of kind `window`, at the slopes of its edges. Nothing
        happens to the gaits there.
    """
    edges = np.array([low, high])
    records: list[dict[str, Any]] = []
    for index, Z, _ in branch.guesses(np.log(edges)):
        point = correct(problem, Z, None)
        for lane in np.flatnonzero(point.ok).tolist():
            edge = {"slope": float(edges[index[lane]])}
            records.append(record("window", point.at, lane, 8 * EPS) | edge)
    return records


def _dense(
    problem: Problem, branch: Branch, low: float, high: float, least: int
) -> np.ndarray:
    """Points of the branch within the window, its nodes and as many between as `least`
    points need.
    """
    parts = 1
    while True:
        place, Z = within(branch, np.log(low), np.log(high), parts)
        if not len(place) or len(place) >= least or parts >= _MAX_PARTS:
            break
        parts *= 2
    # The polynomials of gaits of several steps are coarse. Beside folds, slopes do not
    # tell gaits apart.
    between = np.flatnonzero(place % 1 > 0) if branch.steps > 1 else np.zeros(0, int)
    if len(between):
        border = branch.direction[:, place[between].astype(int)]
        border[:, np.abs(border[-1]) > _STEEP] = np.eye(len(border))[:, [-1]]
        point = correct(problem, Z[:, between], border)
        Z[:, between[point.ok]] = point.Z[:, point.ok]
    return Z
