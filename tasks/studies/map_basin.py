"""The task `basin`: initial conditions of a plane by the gait they converge to or their
fall.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from gaitsweep.tasks.branches import atlas as atlases
from gaitsweep.tasks.contract import registry
from gaitsweep.tasks.contract.status import over
from gaitsweep.tasks.contract.tables import Arrays, nothing, stacked, table
from gaitsweep.tasks.orbits.attractors import Neighbourhoods, attractors
from gaitsweep.tasks.orbits.initial_states import NO_START, gaits_at
from gaitsweep.tasks.orbits.stable_manifold import saddle_at, stable_manifold
from gaitsweep.tasks.orbits.walk import Walk
from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.walkers.resolve import walker_of_line

#: Default ranges, as multiples of the long gait's angle and rate.
_AROUND = (0.4, 2.0)
#: Columns of points of the section, and of areas.
_POINTS = ("slope", "gait", "stance_angle", "stance_rate", "swing_rate")
_AREAS = ("slope", "outcome", "area", "standard_error", "share", "starts")


def basin(params: Mapping[str, Any], inputs: list[Arrays]) -> Arrays:
    """Map a grid of initial conditions to their outcomes.

    Parameters
    ----------
    params : mapping
        `line`; `slope`, ndarray, shape (n,) [rad]; and the study's options: `size` of
        the grid along each side, `steps` after which an orbit counts as walking,
        `stance_angle` and `stance_rate` (from, to).
    inputs : list
        The line's atlas.

    Returns
    -------
    dict
        Tables `basin` (slope, stance_angle, stance_rate[, swing_rate], outcome, steps),
        a row per initial condition; `fixed_points` (slope, gait, stance_angle,
        stance_rate, swing_rate, NaN for point feet), the gaits in the same coordinates,
        `stable_manifold` (likewise, and point, a number), points of those of saddles,
        and `areas` (slope, outcome, area, standard_error, share, starts), in the
        walker's units; an area is of angles and rates; of slopes without a long gait
        only a row of `areas`, which says so; of a line without any `nothing` (reason).

    Notes
    -----
    The section of point-foot walkers is two-dimensional, and the grid covers it. That of other walkers is
    three-dimensional, and the grid is its plane through origin and long gait in which
    swing and stance rate keep the gait's ratio. The rates of kneed walkers are those of
    the two locked legs just before heelstrike, those of straight-legged walkers just
    after. Initial conditions lie at the centres of cells, so areas are counts of cells;
    the standard error takes the error of each boundary cell as uniform over the cell
    and independent of the others.
    """
    options = registry.options("basin", params)
    walker = walker_of_line(params["line"])
    problem = Problem(walker)
    time_unit = walker.time_unit
    areas, basins, gaits, manifolds = (list[tuple[Any, ...]]() for _ in range(4))
    branches = atlases.from_arrays(inputs[0])
    slopes = np.asarray(params["slope"], float)
    for slope in slopes:
        targets = {}
        for label in ("long", "short"):
            known, y = gaits_at(problem, branches, np.array([slope]), label)
            if len(known):
                targets[label] = y[:, 0]
        if "long" not in targets:
            areas.append((slope, NO_START, 0.0, 0.0, np.nan, 0))
            continue
        starts, cell = _starts(problem, targets["long"], options, time_unit)
        grid = starts.reshape(problem.m, int(options["size"]), -1)
        for label, y in targets.items():
            gaits.append((slope, label, *_section(y[:, None], time_unit)))
            saddle = saddle_at(problem, y, float(slope))
            if saddle:
                edge = stable_manifold(problem, saddle, float(slope), grid)
                # To seven digits, as the steps simulated there are accurate; an archive
                # packs these well.
                manifolds.append(
                    (
                        slope,
                        label,
                        *_section(edge.astype(np.float32).astype(float), time_unit),
                    )
                )
        n = starts.shape[1]
        neighbourhoods = {
            label: Neighbourhoods(problem, y[:, None], np.array([slope]))
            for label, y in targets.items()
        }
        homes = {
            label: home.some(np.zeros(n, int))
            for label, home in neighbourhoods.items()
            if home.radius[0]
        }
        walk = Walk(problem, starts, np.full(n, slope))
        outcome = attractors(walk, homes, int(options["steps"]))
        taken = np.minimum(walk.taken, int(options["steps"]))
        basins.append(
            (walk.slope, starts[0], *(starts[1:] / time_unit), outcome, taken)
        )
        for name, area, error in _areas(
            outcome.reshape(int(options["size"]), -1), cell
        ):
            share = np.mean(outcome == name)
            areas.append(
                (slope, name, area / time_unit, error / time_unit, share, len(outcome))
            )
    columns = ("slope", *_POINTS[2 : 2 + problem.m], "outcome", "steps")
    tables = stacked("basin", basins, columns) if basins else {}
    tables |= stacked("fixed_points", gaits, _POINTS)
    edges = stacked("stable_manifold", manifolds, _POINTS)
    if problem.m == 2:
        del edges["stable_manifold/swing_rate"]
    # Points of a slope are numbered across saddles.
    _, first, place = np.unique(
        edges["stable_manifold/slope"], return_index=True, return_inverse=True
    )
    edges["stable_manifold/point"] = np.arange(len(place)) - first[place]
    return (
        tables
        | edges
        | table("areas", areas, _AREAS)
        | ({} if basins else nothing(over("long gait", slopes)))
    )


def _section(y: np.ndarray, time_unit: float) -> list[Any]:
    """Angle and both rates of points of the section, shape (m, n)."""
    return [y[0], *(y[1:] / time_unit), np.nan][:3]


def _starts(
    problem: Problem, gait: np.ndarray, options: Mapping[str, Any], time_unit: float
) -> tuple[np.ndarray, float]:
    """Centres of the grid's cells, shape (m, size^2), angle outermost, and the area of
    a cell.
    """
    size = int(options["size"])
    ranges = []
    for i, (key, unit) in enumerate(
        (("stance_angle", 1.0), ("stance_rate", time_unit))
    ):
        limits = options[key]
        ranges.append(
            np.sort(
                np.array(limits, float) * unit
                if limits
                else np.array(_AROUND) * gait[i]
            )
        )
    sides = [
        low + (high - low) * (np.arange(size) + 0.5) / size for low, high in ranges
    ]
    angle, rate = (g.ravel() for g in np.meshgrid(*sides, indexing="ij"))
    y = np.vstack([angle, rate, *(g / gait[1] * rate for g in gait[2:])])
    return y, float(np.prod([(high - low) / size for low, high in ranges]))


def _areas(outcome: np.ndarray, cell: float) -> list[tuple[str, float, float]]:
    """Area of every outcome on a grid, with its standard error."""
    areas = []
    for name in np.unique(outcome):
        inside = outcome == name
        padded = np.pad(inside, 1, "edge")
        boundary = np.zeros_like(inside)
        for neighbour in (
            padded[2:, 1:-1],
            padded[:-2, 1:-1],
            padded[1:-1, 2:],
            padded[1:-1, :-2],
        ):
            boundary |= neighbour != inside
        areas.append(
            (
                str(name),
                float(inside.sum() * cell),
                float(cell * np.sqrt(boundary.sum() / 12)),
            )
        )
    return areas
