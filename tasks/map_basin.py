"""Basins of attraction: which starts of a plane end on which gait, and which fall."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from tasks.continuation import atlas as atlases
from tasks.dynamics.initial_states import gaits_at
from tasks.step.problem import Problem
from tasks.step.simulate import CAUSES, STRUCK, stride
from tasks.walkers.resolve import resolve

Arrays = dict[str, np.ndarray]
#: Options of a study of this kind. Ranges are in the walker's units; left out, they run around the long gait.
OPTIONS = {"size": 160, "strides": 200, "stance_angle": None, "stance_rate": None}
#: Default ranges, as multiples of the long gait's own angle and rate.
AROUND = (0.4, 2.0)
#: Lanes flown together; those that are settled leave the batch.
LANES = 16384
#: Distance from a stable gait, in its own eigenvectors and over its size, inside which a start counts as captured.
CAPTURED = 3e-3
#: Longest period told apart at the end, and how near an orbit must come back.
LONGEST, NEAR = 16, 1e-5


def basin(params: Mapping[str, Any], inputs: list[Arrays]) -> Arrays:
    """Map a grid of starts to what becomes of them.

    Parameters
    ----------
    params : mapping
        `line`; `slope`, ndarray, shape (n,) [rad]; and the study's options: `size` of the grid along each side,
        `strides` after which an orbit counts as walking, `stance_angle` and `stance_rate` (from, to).
    inputs : list
        The line's atlas.

    Returns
    -------
    dict
        Tables `basin` (slope, stance_angle, stance_rate[, swing_rate], outcome, steps), a row per start, and `areas`
        (slope, outcome, area, standard_error, share, starts).

    Notes
    -----
    Point feet have a section of two dimensions, and the grid is all of it. Other walkers have three, and the grid is
    the plane through the origin and the long gait in which the swing leg's rate keeps its ratio to the stance leg's:
    starts of that one family of postures, the gait's own posture scaled and thrown faster or slower. Kneed walkers'
    rates are those of the two locked legs just before heelstrike, straight walkers' those just after.
    Starts lie at the centres of cells, so areas are counts of cells; a cell on a boundary belongs to either side by
    an error uniform over the cell, independent of its neighbours', which gives the standard error.
    """
    options = {**OPTIONS, **{k: params[k] for k in OPTIONS if k in params}}
    walker = resolve(params["line"]["walker"], params["line"].get("set"))
    problem = Problem(walker)
    time_unit = np.sqrt(walker.leg / walker.g)
    tables: list[Arrays] = []
    areas: dict[str, list[Any]] = {k: [] for k in ("slope", "outcome", "area", "standard_error", "share", "starts")}
    branches = atlases.from_arrays(inputs[0])
    for slope in np.asarray(params["slope"], float):
        targets = {}
        for label in ("long", "short"):
            known, y = gaits_at(problem, branches, np.array([slope]), label)
            if len(known):
                targets[label] = y[:, 0]
        if "long" not in targets:
            continue
        starts, cell = _starts(problem, targets["long"], options, time_unit)
        outcome, steps = settle(problem, starts, float(slope), targets, int(options["strides"]))
        table = {
            "slope": np.full(starts.shape[1], slope),
            "stance_angle": starts[0],
            "stance_rate": starts[1] / time_unit,
        }
        if problem.m == 3:
            table["swing_rate"] = starts[2] / time_unit
        tables.append(table | {"outcome": outcome, "steps": steps})
        for name, area, error in _areas(outcome.reshape(int(options["size"]), -1), cell / time_unit):
            row = (slope, name, area, error, np.mean(outcome == name), len(outcome))
            for column, value in zip(areas.values(), row, strict=True):
                column.append(value)
    found = {f"basin/{k}": np.concatenate([t[k] for t in tables]) for k in (tables[0] if tables else {})}
    return found | {f"areas/{k}": np.array(v) for k, v in areas.items()}


def _starts(
    problem: Problem, gait: np.ndarray, options: Mapping[str, Any], time_unit: float
) -> tuple[np.ndarray, float]:
    """Centres of the grid's cells, shape (m, size^2), the angle running slowest, and the area of a cell."""
    size = int(options["size"])
    ranges = []
    for i, (key, unit) in enumerate((("stance_angle", 1.0), ("stance_rate", time_unit))):
        given = options[key]
        ranges.append(np.sort(np.array(given, float) * unit if given else np.array(AROUND) * gait[i]))
    sides = [low + (high - low) * (np.arange(size) + 0.5) / size for low, high in ranges]
    angle, rate = (g.ravel() for g in np.meshgrid(*sides, indexing="ij"))
    y = np.vstack([angle, rate, *(g / gait[1] * rate for g in gait[2:])])
    return y, float(np.prod([(high - low) / size for low, high in ranges]))


def settle(
    problem: Problem, starts: np.ndarray, slope: float, targets: Mapping[str, np.ndarray], strides: int
) -> tuple[np.ndarray, np.ndarray]:
    """What becomes of starts, and after how many strides that was plain.

    Parameters
    ----------
    starts : ndarray, shape (m, n)
    targets : mapping
        Gaits by name; only stable ones capture.
    strides : int
        Strides after which an orbit is said to walk; then its period is told.

    Returns
    -------
    outcome : ndarray of str, shape (n,)
        A gait's name, `period k`, `walks on`, or how it fell.
    steps : ndarray of int, shape (n,)
    """
    stable = {name: frame for name, y in targets.items() if (frame := _frame(problem, y, slope)) is not None}
    n = starts.shape[1]
    outcome, steps = np.full(n, "walks on", "U24"), np.zeros(n, int)
    for k in range(0, n, LANES):
        lanes, y = np.arange(k, min(n, k + LANES)), starts[:, k : k + LANES]
        for _ in range(strides):
            now = stride(problem, y, np.full(len(lanes), slope), exact=False)
            walks = now.outcome == STRUCK
            for cause in np.unique(now.outcome[~walks]):
                outcome[lanes[now.outcome == cause]] = CAUSES[cause]
            y, lanes = now.image[:, walks], lanes[walks]
            steps[lanes] += 1
            free = np.ones(len(lanes), bool)
            for name, (centre, inverse) in stable.items():
                caught = _distance(y, centre, inverse) < CAPTURED
                outcome[lanes[caught & free]] = name
                free &= ~caught
            y, lanes = y[:, free], lanes[free]
            if not len(lanes):
                break
        if len(lanes):
            outcome[lanes] = _periods(problem, y, slope)
    return outcome, steps


def _frame(problem: Problem, y: np.ndarray, slope: float) -> tuple[np.ndarray, np.ndarray] | None:
    """A gait and the inverse of its eigenvectors, or None where it is not stable."""
    at = stride(problem, y[:, None], np.array([slope]))
    if at.outcome[0] != STRUCK or at.jacobian is None:
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
    """Names of the attractors that orbits have come to: a period, or none short enough."""
    first, lanes = y, np.arange(y.shape[1])
    names = np.full(y.shape[1], "walks on", "U24")
    for k in range(1, LONGEST + 1):
        now = stride(problem, y, np.full(len(lanes), slope), exact=False)
        walks = now.outcome == STRUCK
        for cause in np.unique(now.outcome[~walks]):
            names[lanes[now.outcome == cause]] = CAUSES[cause]
        y, lanes, first = now.image[:, walks], lanes[walks], first[:, walks]
        back = np.abs(y - first).max(axis=0) < NEAR
        names[lanes[back]] = f"period {k}"
        y, lanes, first = y[:, ~back], lanes[~back], first[:, ~back]
        if not len(lanes):
            break
    return names


def _areas(outcome: np.ndarray, cell: float) -> list[tuple[str, float, float]]:
    """Area of every outcome on a grid, with its standard error."""
    found = []
    for name in np.unique(outcome):
        mine = outcome == name
        padded = np.pad(mine, 1, "edge")
        inner = padded[1:-1, 1:-1]
        edge = np.zeros_like(mine)
        for other in (padded[2:, 1:-1], padded[:-2, 1:-1], padded[1:-1, 2:], padded[1:-1, :-2]):
            edge |= other != inner
        found.append((str(name), float(mine.sum() * cell), float(cell * np.sqrt(edge.sum() / 12))))
    return found
