"""The task `branch`: solution branches over a window of slopes, or of what else drives,
with their special points.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy import ndarray

from gaitsweep.tasks.branches import atlas as atlases
from gaitsweep.tasks.branches.branch import Branch
from gaitsweep.tasks.branches.conditions import CONDITIONS, Condition
from gaitsweep.tasks.branches.equations import slope_error
from gaitsweep.tasks.branches.joint import evaluate
from gaitsweep.tasks.branches.lockstep import run
from gaitsweep.tasks.branches.normal_forms import normal_form
from gaitsweep.tasks.branches.pseudo_arclength import Point
from gaitsweep.tasks.branches.sampling import chosen, within
from gaitsweep.tasks.branches.segment import locate_root
from gaitsweep.tasks.branches.special_points import RATES, record, special_points
from gaitsweep.tasks.branches.tracking import correct
from gaitsweep.tasks.contract import registry
from gaitsweep.tasks.contract.kinds import kind_of
from gaitsweep.tasks.contract.status import over
from gaitsweep.tasks.contract.tables import Arrays, lacking, nothing, stacked, table
from gaitsweep.tasks.contract.variables import units_of
from gaitsweep.tasks.gaits.multipliers import multipliers
from gaitsweep.tasks.gaits.step_check import LONG_BELOW, gait_ratio
from gaitsweep.tasks.measures import violations
from gaitsweep.tasks.measures.names import never_begin
from gaitsweep.tasks.measures.onsets import onsets
from gaitsweep.tasks.measures.passed import Curve, Sampled
from gaitsweep.tasks.measures.sensitivities import slope_by_keys
from gaitsweep.tasks.mechanics.arrays import Coordinates, Numbers, PerLane
from gaitsweep.tasks.step.drive import HIP_TORQUE
from gaitsweep.tasks.step.problem import EPS, Problem
from gaitsweep.tasks.step.several_steps import from_largest
from gaitsweep.tasks.studies.curve_rows import FORM, form_columns
from gaitsweep.tasks.studies.followed import columns_along, followed_over
from gaitsweep.tasks.walkers.walker import KEYS, Walker
from gaitsweep.tasks.walkers.walker_array import WalkerArray

#: Columns of the tables `branches` and `special_points`, with the slope where it
#: drives.
COLUMNS = (
    *("branch", "slope", "stance_angle", *RATES),
    *("period", "kneestrike_time", "spectral_radius", "stable", "gait"),
)
SPECIAL = (
    *("branch", "kind", "slope", "stance_angle", *RATES, "period", "error_bound"),
    *FORM,
)
#: Columns of the table `special_sensitivities`.
DERIVATIVES = ("branch", "kind", "slope", "key", "key_units", "slope_by_key")
#: Largest number of points between two nodes; a window that needs more is too narrow.
_MAX_PARTS = 65536
#: Walkers of different torques that are measured at once.
_AT_ONCE = 128
#: Least share of ln slope in a branch's direction for points to be corrected at their
#: slopes.
_STEEP = 1e-2
#: A special point, after the number of its branch.
_Numbered = tuple[int, Mapping[str, Any]]


def branch(
    params: Mapping[str, Any], inputs: list[dict[str, ndarray]]
) -> dict[str, ndarray]:
    """Sample a line's branches, continued through folds to their ends.

    Parameters
    ----------
    params : mapping
        `line`; `along`, the key that drives at the line's slope, if it is not the slope
        that does; `slope_from`, `slope_to`, the window of slopes [rad] or of that key
        [the walker's units]; `n`, the least number of points of a branch in it, or
        `adaptive`, the tolerance of linear interpolation between them; `steps` after
        which the gaits repeat; `sensitivities`, whether the slopes of special points are
        differentiated.
    inputs : list
        The line's atlas, of the same `steps`.

    Returns
    -------
    dict
        Tables `branches` (branch, slope, stance_angle, stance_rate, thigh_rate,
        shank_rate, period, kneestrike_time, spectral_radius, stable, gait) and
        `special_points` (branch, kind, slope, stance_angle, stance_rate, thigh_rate,
        shank_rate, period, error_bound, normal_form, normal_form_error, criticality), in
        the walker's units; `along` takes the place of the slope. Where these are wanted
        `special_sensitivities` (branch, kind, slope, key, key_units, slope_by_key).
        `partly/reason` names violations without an onset, since the walker cannot have
        them.
    """
    problem, unit = followed_over(params, int(params.get("steps", 1)))
    window = np.array([params["slope_from"], params["slope_to"]], float)
    low, high = _within_reach(problem, window / unit)
    begins, never = _begins(params, problem, high)
    parts: list[tuple[Any, ...]] = []
    special: list[_Numbered] = []
    for number, curve in enumerate(atlases.from_arrays(inputs[0])):
        Z = _sampled(problem, curve, low, high, params)
        if Z.shape[1]:
            parts.append((number, *_columns(problem, Z, unit)))
            points = _special_within(problem, curve, low, high)
            points += _onsets_within(problem, curve, begins, low, high)
            special += [(number, point) for point in points]

    tables = stacked("branches", parts, columns_along(problem, COLUMNS))
    tables |= _special_table(problem, special, unit)
    if params.get("sensitivities"):
        tables |= _sensitivities(problem, special)
    if not parts:
        return tables | _none(problem, window, unit)
    return tables | lacking(never, has_others=True)


def _begins(
    params: Mapping[str, Any], problem: Problem, drive: float
) -> tuple[dict[str, Condition], list[str]]:
    """The conditions at which the violations begin whose onsets are located, and what is
    to say of those that the walker, driven, cannot have.
    """
    walker = problem.driven_by(drive).walker
    options = registry.options("branch", params)
    names = options["onsets"]
    begins = onsets(names, walker, options["violation_limits"])
    return begins, [*never_begin(names, walker)]


def _within_reach(problem: Problem, window: PerLane) -> tuple[float, float]:
    """The part of a window in which branches are followed, beyond which they go on; of
    no width where that is none.
    """
    low, high = np.clip(window, *problem.drive.window(problem.walker)).tolist()
    return low, high


def _sampled(
    problem: Problem, branch: Branch, low: float, high: float, params: Mapping[str, Any]
) -> Coordinates:
    """Points of a branch within a window, as many as are asked for."""
    if not low < high:
        return branch.Z[:, :0]
    if "adaptive" in params:
        return chosen(problem, branch, low, high, float(params["adaptive"]))
    return _dense(problem, branch, low, high, int(params.get("n", 2)))


def _none(problem: Problem, window: PerLane, unit: float) -> Arrays:
    """That there is no gait in a window, of which branches may reach a part only."""
    gait = "gait" if problem.steps == 1 else f"gait of {problem.steps} steps"
    key = problem.drive.key
    sentence = over(gait, window, key)
    least, largest = problem.drive.window(problem.walker)
    if not least <= window[0] / unit < window[1] / unit <= largest:
        ends = f"from {unit * least:.6g} to {unit * largest:.6g}"
        sentence += f" Branches are followed over `{key}` {ends}."

    return nothing(sentence)


def _columns(problem: Problem, Z: Coordinates, unit: float) -> tuple[Any, ...]:
    """Columns of the table `branches` after the first, of points of a branch; `unit` is
    that of what drives.
    """
    walker = problem.walker
    w = from_largest(Z[:-1], problem.m, problem.steps)
    stride, scale = problem.stride(w, Z[-1])
    drive = np.exp(Z[-1])
    state = problem.start(stride.y * scale, drive)
    rates = state[1:] / walker.time_unit
    jacobian = stride.jacobian
    magnitudes = np.abs(multipliers(jacobian, len(jacobian)))
    radius = magnitudes.max(axis=1)
    times = w[problem.m :] * walker.time_unit
    kneestrike = times[0] if walker.knees else np.nan

    return (
        unit * drive,
        np.exp(w[0]),
        *rates,
        times[-1],
        kneestrike,
        radius,
        (radius < 1).astype("i1"),
        np.where(gait_ratio(stride) < LONG_BELOW, "long", "short"),
    )


def _special_within(
    problem: Problem, branch: Branch, low: float, high: float
) -> list[dict[str, Any]]:
    """Special points of a branch in a window, and where it leaves the window."""
    found = special_points(problem, branch)
    found += contact_lost(problem, branch, low, high)
    inside = []
    for point in found:
        is_inside = low <= point["slope"] <= high
        if is_inside and not kind_of(point["kind"]).is_edge:
            inside.append(point)
    return inside + _leaves_window(problem, branch, low, high)


def _onsets_within(
    problem: Problem,
    branch: Branch,
    begins: Mapping[str, Condition],
    low: float,
    high: float,
) -> list[dict[str, Any]]:
    """Points of a branch in a window at which violations begin, by what tables call
    their conditions.
    """
    near = _nodes_near(branch, low, high)
    if not len(near) or not begins:
        return []

    records = []
    ends = int(near[0]), int(near[-1])
    along = Curve.of_branch(problem, branch).between(*ends)
    samples = Sampled.of_each(along, [*begins.values()])
    for name, sampled in zip(begins, samples, strict=True):
        inside = sampled.passes_target().within(np.log(low), np.log(high)).X
        if not inside.size:
            continue
        points = evaluate(problem, inside)
        for lane, Z in enumerate(inside.T):
            error = slope_error(problem, sampled.condition, Z) + 8 * EPS
            records.append(record(name, points, lane, error))

    return records


def _special_row(
    problem: Problem, point: Mapping[str, Any], unit: float
) -> tuple[Any, ...]:
    """Row of the table `special_points` after the first column; `unit` is that of what
    drives.
    """
    time_unit = problem.walker.time_unit
    kind, error = str(point["kind"]), float(point["error_bound"])
    form = normal_form(problem, kind, np.array(point["Z"]), error)

    return (
        kind,
        unit * point["slope"],
        point["stance_angle"],
        *(np.array(point["rates"]) / time_unit),
        point["period"] * time_unit,
        error,
        *form_columns(kind, form),
    )


def _special_table(
    problem: Problem, special: Sequence[_Numbered], unit: float
) -> dict[str, ndarray]:
    """The table of special points; `unit` is that of what drives."""
    points = [
        (number, *_special_row(problem, point, unit)) for number, point in special
    ]
    return table("special_points", points, columns_along(problem, SPECIAL))


def _sensitivities(problem: Problem, special: Sequence[_Numbered]) -> Arrays:
    """The table of derivatives of the slopes of special points."""
    rows = [*_derivatives(problem, special)]
    return table("special_sensitivities", rows, DERIVATIVES)


def _derivatives(
    problem: Problem, special: Sequence[_Numbered]
) -> Iterator[tuple[Any, ...]]:
    """Rows of the table `special_sensitivities`."""
    for number, point in special:
        if point.get("condition"):
            condition = CONDITIONS[point["condition"]]
            by_keys = slope_by_keys(problem, condition, np.array(point["Z"]))
            for key, by_key in by_keys.items():
                units = units_of(KEYS[key], problem.walker.si)
                yield number, point["kind"], point["slope"], key, units, by_key


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

    def least(point: Point) -> float:
        return float(_least_force(problem, point.Z)[0])

    near = _nodes_near(branch, low, high)
    if not len(near):
        return []

    force = np.full(len(branch.q), np.nan)
    force[near] = _least_force(problem, branch.Z[:, near])
    records: list[dict[str, Any]] = []
    changes = force[1:] * force[:-1] < 0
    for segment in np.flatnonzero(changes).tolist():
        point = run(problem, locate_root(branch, segment, least))
        # Closer samples show the error of the minimum of a sampled force.
        finer = _least_force(problem, point.Z, 2 * violations.SAMPLES)[0]
        share = finer / (force[segment + 1] - force[segment])
        length = branch.q[segment + 1] - branch.q[segment]
        error = abs(float(share * length)) + 64 * EPS
        records.append(record("end_contact_lost", point.at, 0, error))

    return records


def _nodes_near(branch: Branch, low: float, high: float) -> Numbers:
    """Nodes of the segments that meet a window, which may lie within one."""
    left, right = branch.q[:-1], branch.q[1:]
    meets = np.minimum(left, right) <= np.log(high)
    meets &= np.maximum(left, right) >= np.log(low)
    beside = np.convolve(meets, np.ones(2))
    return np.flatnonzero(beside)


def _least_force(
    problem: Problem, Z: Coordinates, samples: int = violations.SAMPLES
) -> PerLane:
    """Least normal force over the steps of gaits, as `violations` measures it."""
    stride, scale = problem.stride(Z[:-1], Z[-1], samples=samples)
    singles = stride.singles
    scale, drive = np.tile([scale, np.exp(Z[-1])], stride.steps)
    motion = [part * scale for part in singles.motion]
    # A step begins with the heelstrike that ends the one before it.
    impact = np.roll(singles.impact, Z.shape[1], axis=1) * scale
    slope = problem.slopes(drive)

    force: PerLane = np.empty(len(drive))
    for walker, lanes in _walkers(problem, drive):
        measured = violations.measure(
            walker,
            [part[..., lanes] for part in motion],
            impact[:, lanes],
            singles.times[:, lanes],
            slope[lanes],
        )
        force[lanes] = measured["least_normal_force"]

    return force.reshape(stride.steps, -1).min(axis=0)


def _walkers(problem: Problem, drive: PerLane) -> Iterator[tuple[Walker, slice]]:
    """Yield the walkers that values of what drives make, as far as these act during the
    motion, and of which lanes they are.
    """
    if problem.drive.key != HIP_TORQUE:
        yield problem.walker, slice(None)
        return

    for k in range(0, len(drive), _AT_ONCE):
        lanes = slice(k, k + _AT_ONCE)
        own = []
        for value in drive[lanes].tolist():
            walker, _ = problem.drive.at(problem.walker, value)
            own.append(walker)
        yield WalkerArray.of(own), lanes


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
) -> Coordinates:
    """Points of the branch within the window, its nodes and as many between as `least`
    points need.
    """
    parts = 1
    window = np.log(low), np.log(high)
    place, Z = within(branch, *window, parts)
    while 0 < len(place) < least and parts < _MAX_PARTS:
        parts *= 2
        place, Z = within(branch, *window, parts)

    if branch.steps == 1:
        return Z

    # The polynomials of gaits of several steps are coarse. Beside folds, slopes do not
    # tell gaits apart.
    between = np.flatnonzero(place % 1 > 0)
    if len(between):
        border = branch.direction[:, place[between].astype(int)]
        along_slope = np.eye(len(border))[:, [-1]]
        border[:, np.abs(border[-1]) > _STEEP] = along_slope
        point = correct(problem, Z[:, between], border)
        Z[:, between[point.ok]] = point.Z[:, point.ok]

    return Z
