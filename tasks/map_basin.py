"""The task `basin`: initial conditions of a plane by the gait they converge to or their fall."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from tasks import registry
from tasks.continuation import atlas as atlases
from tasks.dynamics.initial_states import NO_START, gaits_at
from tasks.dynamics.stable_manifold import saddle_at, stable_manifold
from tasks.step.problem import Problem
from tasks.step.simulate import CAUSES, STRUCK, stride
from tasks.walkers.resolve import resolve

Arrays = dict[str, np.ndarray]
#: Default ranges, as multiples of the long gait's angle and rate.
_AROUND = (0.4, 2.0)
#: Columns of points of the section.
_POINTS = ("slope", "gait", "stance_angle", "stance_rate", "swing_rate")
#: Lanes advanced together: their states stay in the cache.
LANES = 16384
#: Distance from a stable gait, in its eigenvector coordinates and over its norm, inside which it captures an orbit.
_CAPTURE_DISTANCE = 3e-3
#: Longest period identified at the end, and the relative distance at which an orbit counts as repeating.
_MAX_PERIOD, _REPEAT_DISTANCE = 16, 5e-5


def basin(params: Mapping[str, Any], inputs: list[Arrays]) -> Arrays:
    """Map a grid of initial conditions to their outcomes.

    Parameters
    ----------
    params : mapping
        `line`; `slope`, ndarray, shape (n,) [rad]; and the study's options: `size` of the grid along each side,
        `steps` after which an orbit counts as walking, `stance_angle` and `stance_rate` (from, to).
    inputs : list
        The line's atlas.

    Returns
    -------
    dict
        Tables `basin` (slope, stance_angle, stance_rate[, swing_rate], outcome, steps), a row per initial condition;
        `fixed_points` (slope, gait, stance_angle, stance_rate, swing_rate, NaN for point feet), the gaits in the same
        coordinates, `stable_manifold` (likewise, and point, a number), points of those of saddles, and `areas`
        (slope, outcome, area, standard_error, share, starts), in the walker's units; an area is of angles and rates;
        of slopes without a long gait only a row of `areas`, which says so.

    Notes
    -----
    The section of point-foot walkers is two-dimensional, and the grid covers it. That of other walkers is
    three-dimensional, and the grid is its plane through origin and long gait in which swing and stance rate keep
    the gait's ratio. The rates of kneed walkers are those of the two locked legs just before heelstrike, those
    of straight-legged walkers just after. Initial conditions lie at the centres of cells, so areas are counts of cells;
    the standard error takes the error of each boundary cell as uniform over the cell and independent of the others.
    """
    options = registry.options("basin", params)
    walker = resolve(params["line"]["walker"], params["line"].get("set"))
    problem = Problem(walker)
    time_unit = np.sqrt(walker.leg / walker.g)
    tables: list[Arrays] = []
    areas: dict[str, list[Any]] = {k: [] for k in ("slope", "outcome", "area", "standard_error", "share", "starts")}
    gaits, manifolds = ({name: list[Any]() for name in _POINTS} for _ in range(2))
    branches = atlases.from_arrays(inputs[0])
    for slope in np.asarray(params["slope"], float):
        targets = {}
        for label in ("long", "short"):
            known, y = gaits_at(problem, branches, np.array([slope]), label)
            if len(known):
                targets[label] = y[:, 0]
        if "long" not in targets:
            _append_row(areas, (slope, NO_START, 0.0, 0.0, np.nan, 0))
            continue
        starts, cell = _starts(problem, targets["long"], options, time_unit)
        grid = starts.reshape(problem.m, int(options["size"]), -1)
        for label, y in targets.items():
            _append(gaits, float(slope), label, y[:, None], time_unit)
            saddle = saddle_at(problem, y, float(slope))
            if saddle:
                edge = stable_manifold(problem, saddle, float(slope), grid)
                # To seven digits, as the steps simulated there are accurate; an archive packs these well.
                _append(manifolds, float(slope), label, edge.astype(np.float32).astype(float), time_unit)
        outcome, steps = _classify(problem, starts, float(slope), targets, int(options["steps"]))
        table = {
            "slope": np.full(starts.shape[1], slope),
            "stance_angle": starts[0],
            "stance_rate": starts[1] / time_unit,
        }
        if problem.m == 3:
            table["swing_rate"] = starts[2] / time_unit
        tables.append(table | {"outcome": outcome, "steps": steps})
        for name, area, error in _areas(outcome.reshape(int(options["size"]), -1), cell):
            row = (slope, name, area / time_unit, error / time_unit, np.mean(outcome == name), len(outcome))
            _append_row(areas, row)
    basins = {f"basin/{k}": np.concatenate([t[k] for t in tables]) for k in (tables[0] if tables else {})}
    fixed = {f"fixed_points/{k}": np.array(v) for k, v in gaits.items()}
    edges = {f"stable_manifold/{k}": np.array(v) for k, v in manifolds.items() if problem.m == 3 or k != "swing_rate"}
    # Points of a slope are numbered across saddles.
    _, first, place = np.unique(manifolds["slope"], return_index=True, return_inverse=True)
    edges["stable_manifold/point"] = np.arange(len(place)) - first[place]
    return basins | fixed | edges | {f"areas/{k}": np.array(v) for k, v in areas.items()}


def _append_row(table: dict[str, list[Any]], row: tuple[Any, ...]) -> None:
    for column, value in zip(table.values(), row, strict=True):
        column.append(value)


def _append(table: dict[str, list[Any]], slope: float, label: str, y: np.ndarray, time_unit: float) -> None:
    """Append points of the section, shape (m, n), to a table of `_POINTS`."""
    rates = [*(y[1:] / time_unit), np.full(y.shape[1], np.nan)][:2]
    for name, values in zip(_POINTS, ([slope] * y.shape[1], [label] * y.shape[1], y[0], *rates), strict=True):
        table[name] += list(values)


def _starts(
    problem: Problem, gait: np.ndarray, options: Mapping[str, Any], time_unit: float
) -> tuple[np.ndarray, float]:
    """Centres of the grid's cells, shape (m, size^2), angle outermost, and the area of a cell."""
    size = int(options["size"])
    ranges = []
    for i, (key, unit) in enumerate((("stance_angle", 1.0), ("stance_rate", time_unit))):
        limits = options[key]
        ranges.append(np.sort(np.array(limits, float) * unit if limits else np.array(_AROUND) * gait[i]))
    sides = [low + (high - low) * (np.arange(size) + 0.5) / size for low, high in ranges]
    angle, rate = (g.ravel() for g in np.meshgrid(*sides, indexing="ij"))
    y = np.vstack([angle, rate, *(g / gait[1] * rate for g in gait[2:])])
    return y, float(np.prod([(high - low) / size for low, high in ranges]))


def _classify(
    problem: Problem, starts: np.ndarray, slope: float, targets: Mapping[str, np.ndarray], strides: int
) -> tuple[np.ndarray, np.ndarray]:
    """Outcomes of initial conditions, and the number of steps after which each is known.

    Parameters
    ----------
    starts : ndarray, shape (m, n) [rad, sqrt(g/leg)]
    slope : float [rad]
    targets : mapping
        Gaits by name, shape (m,); only stable ones capture.
    strides : int
        Steps after which an orbit counts as walking; its period is then identified.

    Returns
    -------
    outcome : ndarray of str, shape (n,)
        A gait's name, `period k`, `walks on`, or how it fell.
    steps : ndarray of int, shape (n,)
    """
    stable = {name: frame for name, y in targets.items() if (frame := _frame(problem, y, slope)) is not None}
    n = starts.shape[1]
    outcome, steps = np.full(n, "walks on", "U24"), np.zeros(n, int)
    lanes, y = np.arange(n), starts
    for _ in range(strides):
        y, lanes, _ = _advance(problem, y, lanes, slope, outcome)
        steps[lanes] += 1
        free = np.ones(len(lanes), bool)
        for name, (centre, inverse) in stable.items():
            is_captured = _distance(y, centre, inverse) < _CAPTURE_DISTANCE
            outcome[lanes[is_captured & free]] = name
            free &= ~is_captured
        y, lanes = y[:, free], lanes[free]
        if not len(lanes):
            break
    if len(lanes):
        outcome[lanes] = _periods(problem, y, slope)
    return outcome, steps


def _advance(
    problem: Problem, y: np.ndarray, lanes: np.ndarray, slope: float, outcome: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Take one step: the images and lanes that walk, and a mask of them; the others' falls go into `outcome`."""
    blocks = [y[:, k : k + LANES] for k in range(0, max(1, len(lanes)), LANES)]
    steps = [stride(problem, block, np.full(block.shape[1], slope), exact=False) for block in blocks]
    image, ends = np.concatenate([s.image for s in steps], axis=1), np.concatenate([s.outcome for s in steps])
    walks = ends == STRUCK
    for cause in np.unique(ends[~walks]):
        outcome[lanes[ends == cause]] = CAUSES[cause]
    return image[:, walks], lanes[walks], walks


def _frame(problem: Problem, y: np.ndarray, slope: float) -> tuple[np.ndarray, np.ndarray] | None:
    """A gait and the inverse of its eigenvectors, or None where it is not stable."""
    at = stride(problem, y[:, None], np.array([slope]))
    if at.outcome[0] != STRUCK:
        return None
    values, vectors = np.linalg.eig(at.jacobian[:, :, 0])
    if np.abs(values).max() >= 1:
        return None
    return y, np.linalg.inv(vectors / np.linalg.norm(vectors, axis=0)) / np.linalg.norm(y)


def _distance(y: np.ndarray, centre: np.ndarray, inverse: np.ndarray) -> np.ndarray:
    """Largest coordinate of y - centre in the gait's eigenvectors, shape (n,)."""
    d = y - centre[:, None]
    total = inverse[:, :1] * d[0]
    for i in range(1, len(d)):
        total = total + inverse[:, i : i + 1] * d[i]
    return np.abs(total).max(axis=0)


def _periods(problem: Problem, y: np.ndarray, slope: float) -> np.ndarray:
    """Attractors of orbits by name: a period, or none up to the longest."""
    first, lanes = y, np.arange(y.shape[1])
    names = np.full(y.shape[1], "walks on", "U24")
    for k in range(1, _MAX_PERIOD + 1):
        y, lanes, walks = _advance(problem, y, lanes, slope, names)
        first = first[:, walks]
        repeats = np.abs(y - first).max(axis=0) < _REPEAT_DISTANCE * np.abs(first).max(axis=0)
        names[lanes[repeats]] = f"period {k}"
        y, lanes, first = y[:, ~repeats], lanes[~repeats], first[:, ~repeats]
        if not len(lanes):
            break
    return names


def _areas(outcome: np.ndarray, cell: float) -> list[tuple[str, float, float]]:
    """Area of every outcome on a grid, with its standard error."""
    areas = []
    for name in np.unique(outcome):
        inside = outcome == name
        padded = np.pad(inside, 1, "edge")
        boundary = np.zeros_like(inside)
        for neighbour in (padded[2:, 1:-1], padded[:-2, 1:-1], padded[1:-1, 2:], padded[1:-1, :-2]):
            boundary |= neighbour != inside
        areas.append((str(name), float(inside.sum() * cell), float(cell * np.sqrt(boundary.sum() / 12))))
    return areas
