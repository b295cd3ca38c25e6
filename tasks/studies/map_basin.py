"""The task `basin`: initial conditions of a plane by the gait they converge to or their
fall.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from gaitsweep.tasks.branches.branch import Branch
from gaitsweep.tasks.contract import registry
from gaitsweep.tasks.contract.status import over
from gaitsweep.tasks.contract.tables import Arrays, nothing, stacked, table
from gaitsweep.tasks.orbits.attractors import Neighbourhoods, attractors
from gaitsweep.tasks.orbits.initial_states import NO_START, gaits_at
from gaitsweep.tasks.orbits.stable_manifold import saddle_at, stable_manifold
from gaitsweep.tasks.orbits.walk import Walk
from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.studies.solve_driven import (
    PointsOnBranches,
    joined,
    points_on_branches,
)

#: Default ranges, as multiples of the long gait's angle and rate.
_AROUND = (0.4, 2.0)
#: Columns of points of the section, and of areas.
_POINTS = ("slope", "gait", "stance_angle", "stance_rate", "swing_rate")
_AREAS = ("slope", "outcome", "area", "standard_error", "share", "starts")
_Row = tuple[Any, ...]


def basin(params: Mapping[str, Any], inputs: list[Arrays]) -> Arrays:
    """Map a grid of initial conditions to their outcomes.

    Parameters
    ----------
    params : mapping
        `line`; `along`, the key that drives at the line's slope, if it is not the slope
        that does; `slope`, ndarray, shape (n,) [rad], or values of that key [the
        walker's units]; and the study's options: `size` of the grid along each side,
        `steps` after which an orbit counts as walking, `stance_angle` and `stance_rate`
        (from, to).
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
        What drives stands in the place of the slope.

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
    parts = []
    for points in points_on_branches(params, inputs[0]):
        parts.append(_basins(points, options))
    return joined(parts)


def _basins(points: PointsOnBranches, options: Mapping[str, Any]) -> Arrays:
    """The tables of points of a line whose gaits lie on the same branches."""
    problem, walker = points.problem, points.problem.walker
    rows = _Rows(walker.time_unit)
    for drive in points.drive:
        gaits = _gaits(problem, points.branches, drive)
        if "long" not in gaits:
            rows.areas.append((drive, NO_START, 0.0, 0.0, np.nan, 0))
            continue

        grid = _grid(gaits["long"], options, walker.time_unit)
        for label, y in gaits.items():
            rows.add_gait(drive, label, y)
            rows.add_manifold(drive, label, _manifold(problem, y, drive, grid))

        outcome, taken = _outcomes(problem, gaits, drive, grid, int(options["steps"]))
        rows.add_outcomes(drive, grid, outcome, taken)

    tables = rows.tables(problem.m)
    if not rows.basins:
        tables |= nothing(over("long gait", points.asked, points.key))
    return points.named(tables)


def _gaits(
    problem: Problem,
    branches: list[Branch],
    drive: float,
) -> dict[str, np.ndarray]:
    """The long and the short gait at a value of what drives, shape (m,) each, as far as
    there are.
    """
    gaits = {}
    for label in ("long", "short"):
        known, y = gaits_at(problem, branches, np.array([drive]), label)
        if len(known):
            gaits[label] = y[:, 0]
    return gaits


class _Grid(NamedTuple):
    """Initial conditions at the centres of cells.

    Attributes
    ----------
    y : ndarray, shape (m, size, size) [rad, rad/sqrt(leg/g)]
        Section coordinates, the angle along the first side, the rate along the second.
    cell : float
        Area of a cell.
    """

    y: np.ndarray
    cell: float


def _grid(gait: np.ndarray, options: Mapping[str, Any], time_unit: float) -> _Grid:
    """The grid over the ranges of a study, by default those around the long gait."""
    size = int(options["size"])
    angles = _range(options["stance_angle"], 1.0, gait[0])
    rates = _range(options["stance_rate"], time_unit, gait[1])

    number = np.arange(size) + 0.5
    sides = [low + (high - low) * number / size for low, high in (angles, rates)]
    angle, rate = np.meshgrid(*sides, indexing="ij")

    # Other rates keep the ratio to the stance rate that they have in the gait.
    others = [own / gait[1] * rate for own in gait[2:]]
    cell = np.prod([(high - low) / size for low, high in (angles, rates)])
    return _Grid(np.stack([angle, rate, *others]), float(cell))


def _range(limits: Sequence[float], unit: float, of_gait: float) -> np.ndarray:
    """From and to, rising, of a coordinate: as the study has them, in some unit, or
    around the gait's.
    """
    if limits:
        return np.array(limits, float) * unit
    # Rates are negative.
    return np.sort(np.array(_AROUND) * of_gait)


def _manifold(
    problem: Problem,
    y: np.ndarray,
    drive: float,
    grid: _Grid,
) -> np.ndarray | None:
    """Points of a gait's stable manifold on the grid, shape (m, k); None if it is no
    saddle.
    """
    saddle = saddle_at(problem, y, float(drive))
    if saddle is None:
        return None
    points = stable_manifold(problem, saddle, float(drive), grid.y)
    # To seven digits, as the steps simulated there are accurate; an archive packs these
    # well.
    return points.astype(np.float32).astype(float)


def _outcomes(
    problem: Problem,
    gaits: Mapping[str, np.ndarray],
    drive: float,
    grid: _Grid,
    steps: int,
) -> tuple[np.ndarray, np.ndarray]:
    """What becomes of every initial condition, and the steps that it takes, at most so
    many, shape (size^2,) each.
    """
    starts = grid.y.reshape(problem.m, -1)
    n = starts.shape[1]
    homes = {}
    for label, y in gaits.items():
        home = Neighbourhoods(problem, y[:, None], np.array([drive]))
        if home.radius[0]:
            homes[label] = home.some(np.zeros(n, int))

    walk = Walk(problem, starts, np.full(n, drive))
    outcome = attractors(walk, homes, steps)
    return outcome, np.minimum(walk.taken, steps)


class _Rows:
    """Rows of the task's tables, in the walker's units."""

    def __init__(self, time_unit: float):
        self._time_unit = time_unit
        self.basins: list[_Row] = []
        self.gaits: list[_Row] = []
        self.manifolds: list[_Row] = []
        self.areas: list[_Row] = []

    def add_gait(self, drive: float, label: str, y: np.ndarray) -> None:
        """Add a gait, shape (m,)."""
        self.gaits.append((drive, label, *self._on_section(y[:, None])))

    def add_manifold(self, drive: float, label: str, points: np.ndarray | None) -> None:
        """Add points, shape (m, k), of a gait's stable manifold, if it has one."""
        if points is not None:
            self.manifolds.append((drive, label, *self._on_section(points)))

    def add_outcomes(
        self,
        drive: float,
        grid: _Grid,
        outcome: np.ndarray,
        taken: np.ndarray,
    ) -> None:
        """Add what becomes of the initial conditions, shape (size^2,), and its areas."""
        size = grid.y.shape[1]
        n, unit = len(outcome), self._time_unit
        angle, *rates = grid.y.reshape(-1, n)
        in_units = [rate / unit for rate in rates]
        self.basins.append((np.full(n, drive), angle, *in_units, outcome, taken))

        for name, area, error in _areas(outcome.reshape(size, size), grid.cell):
            share = np.mean(outcome == name)
            self.areas.append((drive, name, area / unit, error / unit, share, n))

    def tables(self, m: int) -> Arrays:
        """The tables, of m coordinates."""
        columns = ("slope", *_POINTS[2 : 2 + m], "outcome", "steps")
        basins = stacked("basin", self.basins, columns) if self.basins else {}
        gaits = stacked("fixed_points", self.gaits, _POINTS)
        manifolds = stacked("stable_manifold", self.manifolds, _POINTS)
        if m == 2:
            del manifolds["stable_manifold/swing_rate"]

        # Points of a slope are numbered across saddles.
        _, first, place = np.unique(
            manifolds["stable_manifold/slope"], return_index=True, return_inverse=True
        )
        manifolds["stable_manifold/point"] = np.arange(len(place)) - first[place]
        return basins | gaits | manifolds | table("areas", self.areas, _AREAS)

    def _on_section(self, y: np.ndarray) -> list[Any]:
        """Angle and both rates of points of the section, shape (m, n)."""
        angle, *rates = y
        in_units = [rate / self._time_unit for rate in rates]
        return [angle, *in_units, np.nan][:3]


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

        area = inside.sum() * cell
        error = cell * np.sqrt(boundary.sum() / 12)
        areas.append((str(name), float(area), float(error)))

    return areas
