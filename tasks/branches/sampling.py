"""Points of a branch chosen to a tolerance: as few as a figure needs, from the atlas
alone.

A place on a branch is the number of a segment plus a fraction of it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy import ndarray

from gaitsweep.tasks.branches.branch import Branch
from gaitsweep.tasks.gaits.multipliers import multipliers
from gaitsweep.tasks.mechanics.arrays import Coordinates, Numbers
from gaitsweep.tasks.mechanics.sums import norm, total
from gaitsweep.tasks.step.problem import Problem

#: Rounds in which points are added where the spectral radius bends or stability
#: changes.
_MAX_ROUNDS = 16
#: Distance of places that are the same but for rounding.
_SAME_PLACE = 1e-9
#: Fractions of the distance between two points at which the spectral radius is
#: evaluated.
_PROBES = np.array([[0.33], [0.67]])


def chosen(
    problem: Problem, branch: Branch, low: float, high: float, tolerance: float
) -> ndarray:
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
    samples = np.ceil(0.25 / np.sqrt(tolerance))
    samples = int(np.clip(samples, 4, 512))
    place, Z = within(branch, np.log(low), np.log(high), samples)
    if not len(place):
        return Z

    points = plane(Z)
    is_fold = np.isin(place, branch.turns())
    # A branch may leave the window and re-enter it: no line crosses the gap.
    gaps = np.flatnonzero(np.diff(place) > 1.0)
    runs = np.split(np.arange(len(place)), gaps + 1)
    parts = []
    for run in runs:
        few = _thinned(points[run], is_fold[run], tolerance)
        with_bends = _with_radius(problem, branch, place[run][few], tolerance)
        parts.append(with_bends)

    return branch.at(np.concatenate(parts))


def _radius(problem: Problem, Z: Coordinates) -> ndarray:
    """Spectral radius at points; infinite where heelstrike is tangential and the map
    has no derivative.
    """
    stride, _ = problem.stride(Z[:-1], Z[-1])
    jacobian = stride.jacobian
    magnitudes = np.abs(multipliers(jacobian, len(jacobian)))
    return np.nan_to_num(magnitudes.max(axis=1), nan=np.inf)


def within(
    branch: Branch, low: float, high: float, parts: int
) -> tuple[ndarray, ndarray]:
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
    place, Z = _samples(branch, low, high, parts)
    inside = (Z[-1] >= low) & (Z[-1] <= high)
    places = [place[inside]]
    points = [Z[:, inside]]
    for _, edge, segment in branch.guesses(np.array([low, high])):
        # The branch crosses the window's edges here.
        x = edge[branch.axis[segment], np.arange(len(segment))]
        a, b = branch.ends_of(segment)
        places.append(segment + (x - a) / (b - a))
        points.append(edge)

    place = np.concatenate(places)
    order = np.argsort(place, kind="stable")
    # A node on an edge is that edge.
    advance = np.diff(place[order], prepend=-1.0)
    kept = order[advance > _SAME_PLACE]
    return place[kept], np.hstack(points)[:, kept]


def _samples(
    branch: Branch, low: float, high: float, parts: int
) -> tuple[ndarray, Coordinates]:
    """Places and points of the segments that may come between two values of ln slope,
    and of the last node.
    """
    ends = np.array([branch.q[:-1], branch.q[1:]])
    least, largest = np.sort(ends, axis=0)
    # A polynomial stays near the range of its segment's nodes.
    near = (2 * least - largest <= high) & (2 * largest - least >= low)
    near = np.flatnonzero(near)

    segments = np.repeat(near, parts)
    share = np.tile(np.arange(parts) / parts, len(near))
    a, b = branch.ends_of(segments)
    inner = branch.evaluate(segments, a + (b - a) * share)
    place = np.append(segments + share, len(branch.q) - 1.0)
    return place, np.hstack([inner, branch.Z[:, -1:]])


def plane(Z: Coordinates) -> ndarray:
    """Return ln slope, ln angle and ln period of points.

    Parameters
    ----------
    Z : ndarray, shape (c, n)

    Returns
    -------
    ndarray, shape (n, 3)
    """
    log_slope, log_angle, period = Z[-1], Z[0], Z[-2]
    return np.column_stack([log_slope, log_angle, np.log(period)])


def apart(points: ndarray, start: ndarray, end: ndarray) -> ndarray:
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
    square = max(float(along @ along), 1e-300)
    from_start = points - start
    share = total((from_start * along).T) / square
    share = np.clip(share, 0.0, 1.0)[:, None]
    return norm((from_start - share * along).T)


def _thinned(points: ndarray, fixed: ndarray, tolerance: float) -> ndarray:
    """Indices of as few points as lines to the tolerance need, from the first on; ends
    and fixed ones included.
    """
    last = len(points) - 1
    stops = fixed.copy()
    stops[last] = True
    kept = [0]
    for stop in np.flatnonzero(stops).tolist():
        while kept[-1] < stop:
            farthest = _farthest(points, kept[-1], stop, 0.8 * tolerance)
            kept.append(farthest)

    return np.array(kept)


def _farthest(points: ndarray, start: int, stop: int, tolerance: float) -> int:
    """The last point up to `stop` to which a line is found to be accurate: one twice as
    long each time, until it is not; then half way back.
    """

    def is_accurate(end: int) -> bool:
        between = points[start + 1 : end]
        off = apart(between, points[start], points[end])
        return bool(off.max() <= tolerance)

    good = start + 1
    length = 2
    bad = stop + 1
    while good < stop:
        end = min(start + length, stop)
        if not is_accurate(end):
            bad = end
            break
        good = end
        length *= 2

    while bad - good > 1:
        end = (good + bad) // 2
        if is_accurate(end):
            good = end
        else:
            bad = end

    return good


def _with_radius(
    problem: Problem, branch: Branch, places: ndarray, tolerance: float
) -> ndarray:
    """Add places where the spectral radius bends or the stability of the gaits changes."""
    chosen = _sampled(problem, branch, places)
    segments = np.arange(len(places) - 1)
    for _ in range(_MAX_ROUNDS):
        # Points nearer than the tolerance show no bend, not even that of a corner.
        chord = np.diff(chosen.points, axis=0)[segments]
        segments = segments[norm(chord.T) > tolerance]
        if not len(segments):
            break

        # Two places between any two: at one alone a corner and a bend may cancel.
        length = np.diff(chosen.places)[segments]
        between = chosen.places[segments] + _PROBES * length
        probed = _sampled(problem, branch, between)
        off = _off_line(chosen, segments, probed)
        is_stable = chosen.radius < 1
        changes = is_stable[segments] != is_stable[segments + 1]
        is_bent = off.max(axis=0) > 0.5 * tolerance

        split = np.flatnonzero(is_bent | changes)
        after = segments[split] + 1
        worse = off.argmax(axis=0)[split], split
        chosen = chosen.with_more(after, probed, worse)
        left = after - 1 + np.arange(len(after))
        segments = np.column_stack([left, left + 1]).ravel()

    return chosen.places


@dataclass(frozen=True)
class _Sampled:
    """Places of a branch, (k,) or (2, k); their points as `plane` has them, (..., 3);
    and the spectral radii there.
    """

    places: ndarray
    points: ndarray
    radius: ndarray

    def with_more(self, before: Numbers, more: _Sampled, chosen: Any) -> _Sampled:
        """Return these and some of others, each before the one of its number."""
        return _Sampled(
            np.insert(self.places, before, more.places[chosen]),
            np.insert(self.points, before, more.points[chosen], axis=0),
            np.insert(self.radius, before, more.radius[chosen]),
        )


def _sampled(problem: Problem, branch: Branch, places: ndarray) -> _Sampled:
    Z = branch.at(places.ravel())
    points = plane(Z).reshape(*places.shape, 3)
    radius = _radius(problem, Z).reshape(places.shape)
    return _Sampled(places, points, radius)


def _off_line(chosen: _Sampled, segments: Numbers, probed: _Sampled) -> ndarray:
    """How far the spectral radii between the ends of segments (k,) are from straight
    lines, over the larger of 1 and themselves, shape (2, k).
    """
    from_left = probed.points - chosen.points[segments]
    from_right = probed.points - chosen.points[segments + 1]
    to_left = norm(np.moveaxis(from_left, 2, 0))
    to_right = norm(np.moveaxis(from_right, 2, 0))
    length = np.maximum(to_left + to_right, 1e-300)
    with np.errstate(invalid="ignore"):
        weighted = chosen.radius[segments] * to_right
        weighted += chosen.radius[segments + 1] * to_left
        off = np.abs(probed.radius - weighted / length)
        off /= np.maximum(1.0, probed.radius)

    return np.nan_to_num(off, nan=np.inf)
