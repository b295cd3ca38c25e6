"""Points of a branch chosen to a tolerance: as few as a figure needs, from the atlas alone."""

from __future__ import annotations

import numpy as np

from tasks.continuation.branch import Branch
from tasks.fixed_points.multipliers import multipliers
from tasks.step.problem import Problem

#: Rounds in which points are added where stability bends or changes.
MAX_ROUNDS = 16
#: Places between two points, in parts of their distance, at which the spectral radius is looked at.
PROBES = (0.33, 0.67)


def chosen(problem: Problem, found: Branch, low: float, high: float, tolerance: float) -> np.ndarray:
    """Rows (X, times) of a branch within a window of slopes, between which straight lines are good to a tolerance.

    Parameters
    ----------
    low, high : float [rad]
        The window.
    tolerance : float
        Greatest distance of the branch from the lines, in ln slope, ln angle and ln period, and of the spectral
        radius over the larger of 1 and itself; a change of stability lies between points as near as that in ln slope.

    Notes
    -----
    Candidates lie on the atlas's polynomials so densely that they bend by less than the tolerance; lines as long as it
    allows are drawn through them one after another, ends and folds kept. Strides are flown only for those chosen and
    for two between any two.
    """
    place, rows = within(found, np.log(low), np.log(high), int(np.clip(np.ceil(0.25 / np.sqrt(tolerance)), 4, 512)))
    if not len(rows):
        return rows
    # A branch may leave the window and come back: lines do not cross the gap.
    runs = np.split(np.arange(len(rows)), np.nonzero(np.diff(place) > 1.0)[0] + 1)
    parts = [
        _with_radius(
            problem,
            found,
            place[run][_thinned(plane(rows[run], found.m), np.isin(place[run], _turns(found)), tolerance)],
            tolerance,
        )
        for run in runs
    ]
    return found.at(np.concatenate(parts))


def _radius(problem: Problem, rows: np.ndarray) -> np.ndarray:
    """Spectral radius at rows; infinite where heelstrike is tangential and the map has no derivative."""
    m = problem.m
    stride, _ = problem.stride(np.delete(rows, m, axis=1).T, rows[:, m])
    return np.nan_to_num(np.abs(multipliers(stride.jacobian, m)).max(axis=1), nan=np.inf)


def within(found: Branch, low: float, high: float, parts: int) -> tuple[np.ndarray, np.ndarray]:
    """Places along the branch (segment and part of it) within a window of ln slope, its edges too, and the rows
    there."""
    segments = np.repeat(np.arange(len(found.Z) - 1), parts)
    part = np.tile(np.arange(parts) / parts, len(found.Z) - 1)
    a, b = (found.Z[segments + i, found.axis[segments]] for i in (0, 1))
    rows = np.vstack([found.evaluate(segments, a + (b - a) * part), found.Z[-1:]])
    place = np.append(segments + part, len(found.Z) - 1.0)
    inside = (rows[:, found.m] >= low) & (rows[:, found.m] <= high)
    place, rows = place[inside], rows[inside]
    for _, Z, segment in found.guesses(np.array([low, high])):
        # Where the branch crosses the window's edges.
        at = Z[np.arange(len(Z)), found.axis[segment]]
        a, b = (found.Z[segment + i, found.axis[segment]] for i in (0, 1))
        place, rows = np.append(place, segment + (at - a) / (b - a)), np.vstack([rows, Z])
    place, order = np.unique(place, return_index=True)
    return place, rows[order]


def _turns(found: Branch) -> np.ndarray:
    """Places of the folds."""
    return np.array([float(first) for first, _ in found.pieces()[1:]])


def plane(rows: np.ndarray, m: int) -> np.ndarray:
    """(ln slope, ln angle, ln period) of rows, shape (n, 3)."""
    return np.column_stack([rows[:, m], rows[:, 0], np.log(rows[:, -1])])


def apart(points: np.ndarray, start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Distance of points from the line between two, shape (n,)."""
    along = end - start
    part = np.clip((points - start) @ along / max(float(along @ along), 1e-300), 0.0, 1.0)
    return np.linalg.norm(points - start - part[:, None] * along, axis=1)


def _thinned(points: np.ndarray, fixed: np.ndarray, tolerance: float) -> np.ndarray:
    """Indices of as few points as lines to the tolerance need, from the first on; ends and fixed ones among them."""
    stops = np.unique(np.concatenate([[0], np.nonzero(fixed)[0], [len(points) - 1]]))
    kept = [0]
    for stop in stops[1:]:
        while kept[-1] < stop:
            i = kept[-1]
            good, bad = i + 1, None
            sensitivity = 2
            while good < stop and bad is None:
                j = min(i + sensitivity, int(stop))
                if apart(points[i + 1 : j], points[i], points[j]).max() <= 0.8 * tolerance:
                    good, sensitivity = j, 2 * sensitivity
                else:
                    bad = j
            while bad is not None and bad - good > 1:
                j = (good + bad) // 2
                if apart(points[i + 1 : j], points[i], points[j]).max() <= 0.8 * tolerance:
                    good = j
                else:
                    bad = j
            kept.append(good)
    return np.array(kept)


def _with_radius(problem: Problem, found: Branch, places: np.ndarray, tolerance: float) -> np.ndarray:
    """Places with those added that the spectral radius asks for, where it bends or a gait's stability changes."""
    points = plane(found.at(places), problem.m)
    radius = _radius(problem, found.at(places))
    asked = np.arange(len(places) - 1)
    for _ in range(MAX_ROUNDS):
        # Points as near as the tolerance show no bend, not even a corner's.
        asked = asked[np.linalg.norm(points[asked + 1] - points[asked], axis=1) > tolerance]
        if not len(asked):
            break
        # Two places between any two: at one alone a corner and a bend may cancel.
        pair = asked[None] + np.zeros((2, 1), int)
        middle = places[pair] + np.array(PROBES)[:, None] * (places[pair + 1] - places[pair])
        rows = found.at(middle.ravel())
        at, there = _radius(problem, rows).reshape(middle.shape), plane(rows, problem.m).reshape(*middle.shape, 3)
        near, far = (np.linalg.norm(there - points[pair + i], axis=2) for i in (0, 1))
        with np.errstate(invalid="ignore"):
            line = (radius[pair] * far + radius[pair + 1] * near) / np.maximum(near + far, 1e-300)
            off = np.nan_to_num(np.abs(at - line) / np.maximum(1.0, at), nan=np.inf)
        worse = off.argmax(axis=0), np.arange(len(asked))
        middle, at, there = middle[worse], at[worse], there[worse]
        wanted = (off[worse] > 0.5 * tolerance) | ((radius[asked] < 1) != (radius[asked + 1] < 1))
        after = asked[wanted] + 1
        places, radius = np.insert(places, after, middle[wanted]), np.insert(radius, after, at[wanted])
        points = np.insert(points, after, there[wanted], axis=0)
        asked = (asked[wanted] + np.arange(len(after)))[:, None] + [0, 1]
        asked = asked.ravel()
    return places
