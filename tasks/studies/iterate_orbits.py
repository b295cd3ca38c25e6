"""The task `orbit`: steps from many initial conditions at many slopes, or values of what
else drives, their attractors and falls.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from gaitsweep.tasks.contract import registry
from gaitsweep.tasks.contract.status import over
from gaitsweep.tasks.contract.tables import Arrays, nothing, table
from gaitsweep.tasks.gaits.polish import SAFETY_FACTOR
from gaitsweep.tasks.mechanics.sums import matvec
from gaitsweep.tasks.orbits.initial_states import NO_START, gaits_at, r_sequence
from gaitsweep.tasks.orbits.lyapunov import Exponents, estimate
from gaitsweep.tasks.orbits.walk import Walk
from gaitsweep.tasks.step.problem import EPS, scale_of, sizes
from gaitsweep.tasks.step.simulate import CAUSES, STRUCK
from gaitsweep.tasks.studies.solve_driven import (
    PointsOnBranches,
    joined,
    points_on_branches,
)

#: Steps over which the directions of growth align before exponents are averaged, and
#: blocks of the average.
_ALIGNMENT, _BLOCKS = 16, 8
#: Columns of a row.
_SHOWN = (
    "stance_angle",
    "stance_rate",
    "thigh_rate",
    "shank_rate",
    "period",
    "error_bound",
)
_EXPONENTS = ("slope", "index", "exponent", "standard_error", "strides", "reason")
#: Unit, over that of a step, in which it is integrated again.
_OTHER_UNIT = 0.75
#: Longest period at which an orbit is tested for repetition.
_MAX_PERIOD = 64


def orbit(params: Mapping[str, Any], inputs: list[Arrays]) -> Arrays:
    """Iterate the step map from initial conditions near a gait, at every slope.

    Parameters
    ----------
    params : mapping
        `line`; `along`, the key that drives at the line's slope, if it is not the slope
        that does; `slope`, ndarray, shape (n,) [rad], or values of that key [the
        walker's units]; and the study's options: `gait` around which the initial
        conditions lie, `starts` (their number at each slope), `spread` (their relative
        distance), `transient` (steps dropped), `steps` (kept, over which exponents are
        averaged), `shown` (the last of them, tabulated).
    inputs : list
        The line's atlas.

    Returns
    -------
    dict
        Tables `orbits` (slope, start, stride; angle and rates just after the heelstrike
        that begins the step, its period, and the error bound of its image; repeats_to,
        how closely the orbit repeats), `lyapunov` (slope, index, exponent,
        standard_error, strides, reason), `falls` (slope, start, steps, cause) and
        `survival` (slope, starts, falls, strides, lifetime: steps per fall), in the
        walker's units. Exponents are per step; only orbits that walk to the end are in
        the first two. What drives stands in the place of the slope.

    Notes
    -----
    Transients are integrated to about 1e-8, kept steps to full precision. Exponents are those of the map on its
    section; the superficial zero multipliers (paper, section 2.2) would add minus
    infinities.
    """
    options = registry.options("orbit", params)
    parts = []
    for points in points_on_branches(params, inputs[0]):
        parts.append(_orbits_of(points, options))
    return joined(parts)


def _orbits_of(points: PointsOnBranches, options: Mapping[str, Any]) -> Arrays:
    """The tables of points of a line whose gaits lie on the same branches."""
    problem, slope = points.problem, points.drive
    walker = problem.walker
    known, gaits = gaits_at(problem, points.branches, slope, str(options["gait"]))
    starts = _starts(gaits, slope[known], options)
    walk = Walk(problem, starts.y, starts.slope)
    strides = int(options["steps"])
    _settle(walk, int(options["transient"]))
    rows, means = _keep(walk, strides, min(int(options["shown"]), strides))

    walks = walk.outcome == STRUCK
    tables = _orbits(rows[:, :, walks], starts.some(walks), strides, walker.time_unit)
    tables |= _falls(walk, starts, ~walks, np.delete(slope, known))
    if not len(known):
        gait = f"{options['gait']} gait"
        tables |= nothing(over(gait, points.asked, points.key))

    tables |= _survival(starts.slope, walk.taken, ~walks)
    tables |= _exponents(means[:, :, walks], starts.slope[walks], strides)
    return points.named(tables)


class _Starts(NamedTuple):
    """Initial conditions of n orbits.

    Attributes
    ----------
    y : ndarray, shape (m, n) [rad, rad/sqrt(leg/g)]
    slope : ndarray, shape (n,) [rad]
    number : ndarray of int, shape (n,)
        Their numbers at each slope.
    """

    y: np.ndarray
    slope: np.ndarray
    number: np.ndarray

    def some(self, lanes: np.ndarray) -> _Starts:
        """Those of some orbits."""
        return _Starts(self.y[:, lanes], self.slope[lanes], self.number[lanes])


def _starts(
    gaits: np.ndarray,
    slope: np.ndarray,
    options: Mapping[str, Any],
) -> _Starts:
    """Initial conditions around gaits, shape (m, k), at k slopes."""
    m, k = gaits.shape
    count = int(options["starts"])
    spread = float(options["spread"])
    # The same offsets at every slope, so that an orbit does not depend on the study's
    # other slopes.
    offsets = np.tile(2 * r_sequence(m, count) - 1, (1, k))
    y = np.repeat(gaits, count, axis=1) * (1 + spread * offsets)
    return _Starts(y, np.repeat(slope, count), np.tile(np.arange(count), k))


def _orbits(
    rows: np.ndarray,
    starts: _Starts,
    strides: int,
    time_unit: float,
) -> Arrays:
    """The table of the last of some strides of n orbits, from their rows, shape (shown,
    len(_SHOWN), n), in the walker's units.
    """
    shown, _, n = rows.shape
    rate = 1 / time_unit
    kept = rows * np.array([1, rate, rate, rate, time_unit, 1])[:, None]
    columns = {f"orbits/{name}": kept[:, i].T.ravel() for i, name in enumerate(_SHOWN)}

    return {
        "orbits/slope": np.repeat(starts.slope, shown),
        "orbits/start": np.repeat(starts.number, shown),
        "orbits/stride": np.tile(np.arange(strides - shown, strides), n),
        **columns,
        "orbits/repeats_to": np.repeat(_repeats(kept[:, 0]), shown),
    }


def _falls(
    walk: Walk,
    starts: _Starts,
    fell: np.ndarray,
    without: np.ndarray,
) -> Arrays:
    """The table of the orbits that `fell`, and of the slopes without a gait to start
    from.
    """
    causes = [CAUSES[number] for number in walk.outcome[fell]]
    none = np.zeros(len(without), int)
    return {
        "falls/slope": np.concatenate([starts.slope[fell], without]),
        "falls/start": np.concatenate([starts.number[fell], none - 1]),
        "falls/steps": np.concatenate([walk.taken[fell], none]),
        "falls/cause": np.array(causes + [NO_START] * len(without), "U24"),
    }


def _repeats(angles: np.ndarray) -> np.ndarray:
    """Largest relative change of each orbit's angles (steps, n) after the period that
    changes them least.
    """
    periods = range(1, min(_MAX_PERIOD, len(angles) // 2) + 1)
    if not periods:
        return np.full(angles.shape[1], np.nan)

    changes = [np.abs(angles[p:] / angles[:-p] - 1).max(axis=0) for p in periods]
    return np.min(changes, axis=0)


def _survival(lane_slope: np.ndarray, steps: np.ndarray, fell: np.ndarray) -> Arrays:
    """Survival times at every slope: all steps over all falls."""
    slopes, which = np.unique(lane_slope, return_inverse=True)
    strides = np.bincount(which, steps, len(slopes))
    falls = np.bincount(which, fell, len(slopes))
    with np.errstate(divide="ignore"):
        lifetime = strides / falls

    return {
        "survival/slope": slopes,
        "survival/starts": np.bincount(which, minlength=len(slopes)),
        "survival/falls": falls.astype(int),
        "survival/strides": strides.astype(int),
        "survival/lifetime": lifetime,
    }


def _exponents(means: np.ndarray, lane_slope: np.ndarray, strides: int) -> Arrays:
    """The table of exponents, averaged over each slope's orbits; NaN, with a reason,
    where steps are too few.
    """
    reason = ""
    averaged = strides - _ALIGNMENT
    if averaged < _BLOCKS:
        reason = f"Exponents need at least {_ALIGNMENT + _BLOCKS} steps; these orbits have {strides}."
        means = np.full_like(means, np.nan)
        averaged = 0

    rows = []
    for slope in np.unique(lane_slope):
        at_slope = lane_slope == slope
        value, error = estimate(means[:, :, at_slope])
        count = averaged * int(at_slope.sum())
        falling = np.argsort(-value, kind="stable").tolist()
        for i, k in enumerate(falling):
            rows.append((slope, i, value[k], error[k], count, reason))

    return table("lyapunov", rows, _EXPONENTS)


def _settle(walk: Walk, transient: int) -> None:
    """Walk through the transient.

    Notes
    -----
    An orbit that settles on a gait repeats in the end to the last bit, for the state after a step depends on nothing
    but the state before it. Of an orbit found to repeat whole periods are left out.
    Each state is compared with the one after the last power of two steps (R. P. Brent,
    BIT 20 (1980) 176-184).
    """
    last = np.full(len(walk.lanes), transient)
    seen = walk.y.copy()
    seen_at = 0
    for k in walk.steps(transient):
        lanes = walk.lanes
        is_same = (walk.y[:, lanes] == seen[:, lanes]).all(axis=0)
        repeats = lanes[is_same & (last[lanes] == transient)]
        last[repeats] = k + (transient - k) % (k - seen_at)

        walk.lanes = lanes[last[lanes] > k]
        if k == max(1, 2 * seen_at):
            seen = walk.y.copy()
            seen_at = k

    walk.lanes = np.flatnonzero(walk.outcome == STRUCK)
    walk.taken[walk.lanes] = transient


def _keep(walk: Walk, strides: int, shown: int) -> tuple[np.ndarray, np.ndarray]:
    """Rows of the last of some steps, shape (shown, len(_SHOWN), n), and means of the
    growth over them.
    """
    m, n = walk.y.shape
    rows = np.full((shown, len(_SHOWN), n), np.nan)
    growth = Exponents.begin(m, n, _BLOCKS)
    for k in walk.steps(strides, exact=True):
        block = None
        if k > _ALIGNMENT:
            block = (k - 1 - _ALIGNMENT) * _BLOCKS // (strides - _ALIGNMENT)
        growth.step(walk.jacobian, walk.lanes, block)
        if k > strides - shown and len(walk.lanes):
            rows[k - 1 - strides + shown][:, walk.lanes] = _row(walk)

    return rows, growth.means()


def _row(walk: Walk) -> np.ndarray:
    """Columns of the last steps of those that walk on, shape (len(_SHOWN), k).

    Notes
    -----
    The step is integrated again in another unit, in which every operation rounds differently; the bound is the change
    times the factor that a gait's bound takes of its standard deviation. Without
    derivatives: what guards are off there is closed by those of the step itself.
    """
    lanes, problem = walk.lanes, walk.problem
    y = walk.before
    image = walk.y[:, lanes]
    times = walk.times[:, lanes]
    slope = walk.slope[lanes]
    unit = _OTHER_UNIT * scale_of(y[0])
    again = problem.map.without_derivatives(
        y / unit, times, problem.parameters(slope, unit)
    )
    m = len(y)
    guards = again.residual[m:]
    image_again = again.image + matvec(walk.closing[:m], guards)
    later = matvec(walk.closing[m:], _OTHER_UNIT * guards)

    of_image = np.abs(image_again * unit - image) / sizes(image)
    of_period = np.abs(later[-1] / times[-1])
    error = np.vstack([of_image, of_period]).max(axis=0)
    bound = SAFETY_FACTOR * (error + EPS)
    return np.vstack([problem.start(y, slope), times[-1], bound])
