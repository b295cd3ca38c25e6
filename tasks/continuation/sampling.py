"""Points of a branch chosen to a tolerance: as few as a figure needs, from the atlas
alone.

A place on a branch is the number of a segment plus a fraction of it.
"""

from __future__ import annotations

import numpy as np

from gaitsweep.tasks.continuation.branch import Branch
from gaitsweep.tasks.fixed_points.multipliers import multipliers
from gaitsweep.tasks.mechanics.sums import norm, total
from gaitsweep.tasks.step.problem import Problem

#: Rounds in which points are added where the spectral radius bends or stability
#: changes.
_MAX_ROUNDS = 16
#: Distance of places that are the same but for rounding.
_SAME_PLACE = 1e-9
#: Fractions of the distance between two points at which the spectral radius is
#: evaluated.
_PROBES = (0.33, 0.67)


def chosen(
    problem: Problem, branch: Branch, low: float, high: float, tolerance: float
) -> np.ndarray:
    """Choose points of a branch in a window of slopes, between which straight lines are
    accurate to a tolerance.

    Parameters
    ----------
    low, high : float [rad]
        The window.
    tolerance : float
        Greatest distance of the branch from the lines, in ln slope, ln angle and ln
        period, and of the spectral radius over the larger of 1 and itself; a change of
        stability lies between points as near as that in ln slope.

    Returns
    -------
    ndarray, shape (c, k)

    Notes
    -----
    Candidates lie on the atlas's polynomials so densely that they bend by less than the tolerance; lines as long as it
    allows are drawn through them one after another, ends and folds kept. Steps are
    evaluated only at the chosen points and at two between any two.
    """
    place, Z = within(
        branch,
        np.log(low),
        np.log(high),
        int(np.clip(np.ceil(0.25 / np.sqrt(tolerance)), 4, 512)),
    )
    if not len(place):
        return Z
    # A branch may leave the window and re-enter it: no line crosses the gap.
    runs = np.split(np.arange(len(place)), np.nonzero(np.diff(place) > 1.0)[0] + 1)
    parts = [
        _with_radius(
            problem,
            branch,
            place[run][
                _thinned(
                    plane(Z[:, run]), np.isin(place[run], branch.turns()), tolerance
                )
            ],
            tolerance,
        )
        for run in runs
    ]
    return branch.at(np.concatenate(parts))


def _radius(problem: Problem, Z: np.ndarray) -> np.ndarray:
    """Spectral radius at points; infinite where heelstrike is tangential and the map
    has no derivative.
    """
    stride, _ = problem.stride(Z[:-1], Z[-1])
    return np.nan_to_num(
        np.abs(multipliers(stride.jacobian, len(stride.jacobian))).max(axis=1),
        nan=np.inf,
    )


def within(
    branch: Branch, low: float, high: float, parts: int
) -> tuple[np.ndarray, np.ndarray]:
    """Sample a branch within a window of ln slope, its edges included.

    Parameters
    ----------
    low, high : float
        Bounds of ln slope.
    parts : int
        Samples a segment.

    Returns
    -------
    place : ndarray, shape (k,)
        Rising.
    Z : ndarray, shape (c, k)
        The points there.
    """
    q = np.sort([branch.q[:-1], branch.q[1:]], axis=0)
    # A polynomial stays near the range of its segment's nodes.
    near = np.flatnonzero((2 * q[0] - q[1] <= high) & (2 * q[1] - q[0] >= low))
    segments, part = (
        np.repeat(near, parts),
        np.tile(np.arange(parts) / parts, len(near)),
    )
    a, b = branch.ends_of(segments)
    Z = np.hstack([branch.evaluate(segments, a + (b - a) * part), branch.Z[:, -1:]])
    place = np.append(segments + part, len(branch.q) - 1.0)
    inside = (Z[-1] >= low) & (Z[-1] <= high)
    place, Z = place[inside], Z[:, inside]
    for _, edge, segment in branch.guesses(np.array([low, high])):
        # The branch crosses the window's edges here.
        at = edge[branch.axis[segment], np.arange(len(segment))]
        a, b = branch.ends_of(segment)
        place, Z = np.append(place, segment + (at - a) / (b - a)), np.hstack([Z, edge])
    order = np.argsort(place, kind="stable")
    place, Z = place[order], Z[:, order]
    # A node on an edge is that edge.
    kept = np.diff(place, prepend=-1.0) > _SAME_PLACE
    return place[kept], Z[:, kept]


def plane(Z: np.ndarray) -> np.ndarray:
    """Return ln slope, ln angle and ln period of points.

    Parameters
    ----------
    Z : ndarray, shape (c, n)

    Returns
    -------
    ndarray, shape (n, 3)
    """
    return np.column_stack([Z[-1], Z[0], np.log(Z[-2])])


def apart(points: np.ndarray, start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Distance of points from the line segment between two.

    Parameters
    ----------
    points : ndarray, shape (n, d)
    start, end : ndarray, shape (d,)

    Returns
    -------
    ndarray, shape (n,)
    """
    along = end - start
    part = np.clip(
        total(((points - start) * along).T) / max(float(along @ along), 1e-300),
        0.0,
        1.0,
    )
    return norm((points - start - part[:, None] * along).T)


def _thinned(points: np.ndarray, fixed: np.ndarray, tolerance: float) -> np.ndarray:
    """Indices of as few points as lines to the tolerance need, from the first on; ends
    and fixed ones included.
    """
    stops = np.unique(np.concatenate([[0], np.nonzero(fixed)[0], [len(points) - 1]]))
    kept = [0]
    for stop in stops[1:]:
        while kept[-1] < stop:
            i, bad = kept[-1], None
            good, length = i + 1, 2
            # Twice as far each time, until a line is too long; then by halves.
            while good < stop and (bad is None or bad - good > 1):
                j = min(i + length, int(stop)) if bad is None else (good + bad) // 2
                if (
                    apart(points[i + 1 : j], points[i], points[j]).max()
                    <= 0.8 * tolerance
                ):
                    good, length = j, 2 * length
                else:
                    bad = j
            kept.append(good)
    return np.array(kept)


def _with_radius(
    problem: Problem, branch: Branch, places: np.ndarray, tolerance: float
) -> np.ndarray:
    """Add places where the spectral radius bends or the stability of the gaits changes."""
    points = plane(branch.at(places))
    radius = _radius(problem, branch.at(places))
    segments = np.arange(len(places) - 1)
    for _ in range(_MAX_ROUNDS):
        # Points nearer than the tolerance show no bend, not even that of a corner.
        segments = segments[
            norm((points[segments + 1] - points[segments]).T) > tolerance
        ]
        if not len(segments):
            break
        # Two places between any two: at one alone a corner and a bend may cancel.
        pair = segments[None] + np.zeros((2, 1), int)
        middle = places[pair] + np.array(_PROBES)[:, None] * (
            places[pair + 1] - places[pair]
        )
        Z = branch.at(middle.ravel())
        middle_radius = _radius(problem, Z).reshape(middle.shape)
        middle_points = plane(Z).reshape(*middle.shape, 3)
        near, far = (
            norm(np.moveaxis(middle_points - points[pair + i], 2, 0)) for i in (0, 1)
        )
        with np.errstate(invalid="ignore"):
            line = (radius[pair] * far + radius[pair + 1] * near) / np.maximum(
                near + far, 1e-300
            )
            off = np.nan_to_num(
                np.abs(middle_radius - line) / np.maximum(1.0, middle_radius),
                nan=np.inf,
            )
        worse = off.argmax(axis=0), np.arange(len(segments))
        is_split = (off[worse] > 0.5 * tolerance) | (
            (radius[segments] < 1) != (radius[segments + 1] < 1)
        )
        after = segments[is_split] + 1
        places = np.insert(places, after, middle[worse][is_split])
        radius = np.insert(radius, after, middle_radius[worse][is_split])
        points = np.insert(points, after, middle_points[worse][is_split], axis=0)
        segments = ((after - 1 + np.arange(len(after)))[:, None] + [0, 1]).ravel()
    return places
