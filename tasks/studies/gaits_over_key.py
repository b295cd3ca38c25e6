"""Gaits as curves over a key of the walker at a fixed slope."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from gaitsweep.tasks.branches.curves import (
    across_last,
    follow_both_directions,
)
from gaitsweep.tasks.branches.equations import Equations, correct_on_curve
from gaitsweep.tasks.branches.refine import COARSE
from gaitsweep.tasks.mechanics.lumped import alike
from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.step.sameness import SAME_POINT, same
from gaitsweep.tasks.studies.solve_driven import branches_of, driven
from gaitsweep.tasks.studies.solve_points import survey
from gaitsweep.tasks.walkers.walker import Walker

#: Shares of a key's range at which gaits are searched for, from which curves over it
#: begin.
SURVEYED = (0.03, 0.25, 0.5, 0.75, 0.97)
#: Share of a segment by which the point beside another may lie beyond its nodes.
_AT_NODE = 0.05


def gaits_over_key(gaits: Equations) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield the curves of gaits at a fixed slope over the range of a key.

    They begin at the gaits of some walkers in the range, and each is followed once.

    Parameters
    ----------
    gaits : Equations
        Of gaits at the slope, with the key as an unknown.

    Yields
    ------
    points, tangents : ndarray, shape (p, u)
    """
    keys, slope = gaits.keys, gaits.slope
    assert keys is not None and slope is not None
    (scale,) = keys.scale
    (low,) = keys.low
    (high,) = keys.high

    values = [low + share * (high - low) for share in SURVEYED]
    walkers = [keys.walker_at(value) for value in values]
    if slope > 0:
        survey_together(walkers)

    def starts() -> Iterator[np.ndarray]:
        for value, walker in zip(values, walkers, strict=True):
            for w in gaits_at(walker, slope):
                yield np.append(w, value / scale)

    yield from _curves(gaits, starts(), (low / scale, high / scale))


def _curves(
    gaits: Equations, starts: Iterator[np.ndarray], window: tuple[float, float]
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Curves of gaits from points (u,) near them, each once, in a window of the last
    unknown: their points and tangents (p, u).
    """
    across = across_last(gaits.size)
    followed: list[np.ndarray] = []
    for guess in starts:
        first = correct_on_curve(gaits, guess[:, None], across)
        is_new = first.ok[0] and not is_on(gaits, followed, first.Z[:, 0])
        if not is_new:
            continue
        points, tangents, _ = follow_both_directions(gaits, first, np.array([window]))
        followed.append(points)
        yield points, tangents


def survey_together(walkers: Sequence[Walker]) -> None:
    """Survey walkers side by side, from which curves begin: they are remembered, and one
    by one take ten times as long.
    """
    for structure, numbers in alike(walkers).items():
        some = [walkers[number] for number in numbers]
        survey(some, structure, COARSE)


def gaits_at(walker: Walker, slope: float) -> Iterator[np.ndarray]:
    """Gaits w (c - 1,) of a walker at a slope, by the polynomials of its branches: over the
    slope or, on level ground and uphill, over what drives there.
    """
    if slope > 0:
        problem, drive = Problem(walker), slope
        (branches,) = survey([walker], problem.structure, COARSE)
    else:
        problem, drive = driven(walker, slope)
        branches = branches_of(problem) if drive else []

    for branch in branches:
        for _, Z, _ in branch.guesses(np.log([drive])):
            yield Z[:-1, 0]


def is_on(equations: Equations, curves: Sequence[np.ndarray], X: np.ndarray) -> bool:
    """Return whether a point (u,) lies on one of some curves (p, u) of equations: a
    curve's own point beside it, between its nearest node and a neighbour, is the same.
    """
    return any(_is_on(equations, points, X) for points in curves)


def _is_on(equations: Equations, points: np.ndarray, X: np.ndarray) -> bool:
    """Whether a point (u,) lies on a curve (p, u)."""
    nearest = int(np.linalg.norm(points - X, axis=1).argmin())
    for k in (nearest - 1, nearest):
        if not 0 <= k < len(points) - 1:
            continue

        chord = points[k + 1] - points[k]
        off = X - points[k]
        share = float(off @ chord / (chord @ chord))
        if not -_AT_NODE <= share <= 1 + _AT_NODE:
            continue

        guess = points[k] + share * chord
        beside = correct_on_curve(equations, guess[:, None], chord[:, None])
        is_corrected = bool(beside.ok[0])
        if is_corrected and same(beside.Z[:, 0], X, SAME_POINT):
            return True

    return False
