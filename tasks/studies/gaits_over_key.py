"""Gaits as curves over a key of the walker at a fixed slope."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial

import numpy as np

from gaitsweep.tasks.branches.conditions import CONDITIONS
from gaitsweep.tasks.branches.curves import (
    across_last,
    follow_both_directions,
)
from gaitsweep.tasks.branches.equations import Equations, correct_on_curve
from gaitsweep.tasks.branches.flips import doubled_over
from gaitsweep.tasks.branches.joint import Evaluation, evaluate
from gaitsweep.tasks.branches.refine import COARSE
from gaitsweep.tasks.branches.settling import repeats_no_sooner
from gaitsweep.tasks.measures.passed import Curve, Sampled
from gaitsweep.tasks.mechanics.arrays import Coordinates
from gaitsweep.tasks.mechanics.lumped import alike
from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.step.sameness import SAME_POINT, same
from gaitsweep.tasks.step.several_steps import begun_at
from gaitsweep.tasks.studies.follow_cycles import cycle_branches
from gaitsweep.tasks.studies.solve_driven import branches_of, driven
from gaitsweep.tasks.studies.solve_points import survey
from gaitsweep.tasks.walkers.walker import Walker

#: Shares of a key's range at which gaits are searched for, from which curves over it
#: begin.
SURVEYED = (0.03, 0.25, 0.5, 0.75, 0.97)
#: Rough length over the key's range of a curve of gaits that a flip begins: its first
#: point is near the flip.
_EXPECTED = 5e-4
#: Share of a segment by which the point beside another may lie beyond its nodes.
_AT_NODE = 0.05


def gaits_over_key(gaits: Equations) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield the curves of gaits at a fixed slope over the range of a key.

    They begin at the gaits of some walkers in the range, those of several steps also at
    the flips of half as many over the key, and each is followed once.

    Parameters
    ----------
    gaits : Equations
        Of gaits at the slope, of any number of steps, with the key as an unknown.

    Yields
    ------
    points, tangents : ndarray, shape (p, u)
    """
    keys, slope, steps = gaits.keys, gaits.slope, gaits.problem.steps
    assert keys is not None and slope is not None
    (scale,) = keys.scale
    (low,) = keys.low
    (high,) = keys.high

    values = [low + share * (high - low) for share in SURVEYED]
    walkers = [keys.walker_at(value) for value in values]
    if slope > 0:
        survey_together(walkers)

    def starts() -> Iterator[np.ndarray]:
        if steps % 2 == 0:
            yield from _begun_at_flips(gaits)
        for value, walker in zip(values, walkers, strict=True):
            for w in gaits_at(walker, slope, steps):
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
        if not first.ok[0] or not _is_new(gaits, followed, first.Z, guess):
            continue
        points, tangents, _ = follow_both_directions(gaits, first, np.array([window]))
        if len(points) > 1:
            followed.append(points)
            yield points, tangents


def _is_new(
    gaits: Equations,
    curves: Sequence[np.ndarray],
    X: Coordinates,
    guess: np.ndarray,
) -> bool:
    """Whether a gait X (u, 1) repeats as its guess (u,) does, and lies on none of some
    curves (p, u), whichever of its steps is the first.
    """
    problem = gaits.problem
    joint = problem.m + problem.phases
    if not repeats_no_sooner(problem, X[:joint], guess[:joint, None]).all():
        return False

    for first in range(problem.steps):
        begun = begun_at(X[:joint], problem.m, problem.steps, np.array([first]))
        if is_on(gaits, curves, np.vstack([begun, X[joint:]])[:, 0]):
            return False

    return True


def _begun_at_flips(gaits: Equations) -> Iterator[np.ndarray]:
    """Gaits (u,) beside the flips of half as many steps over the key."""
    half = gaits.of_steps(gaits.problem.steps // 2)
    corrected = partial(correct_on_curve, gaits)
    for points, tangents in gaits_over_key(half):
        for flip, value in _flips_along(Curve.of_points(half, points, tangents)):
            begun = doubled_over(flip, value, _EXPECTED, corrected)
            if begun:
                yield begun[0].Z[:, 0]


def _flips_along(curve: Curve) -> Iterator[tuple[Evaluation, float]]:
    """Yield the flips of gaits along a curve of them over a key, and the unknown of the
    key there.
    """
    condition = CONDITIONS["flip"]
    assert condition.is_genuine is not None
    for X in Sampled.of(curve, condition).passes_target().X.T:
        there = X[:, None]
        walker = curve.equations.problem_at(there).alone(0)
        flip = evaluate(walker, curve.equations.split(there)[0])
        if condition.is_genuine(flip.multipliers[0]):
            yield flip, float(X[-1])


def survey_together(walkers: Sequence[Walker]) -> None:
    """Survey walkers side by side, from which curves begin: they are remembered, and one
    by one take ten times as long.
    """
    for structure, numbers in alike(walkers).items():
        some = [walkers[number] for number in numbers]
        survey(some, structure, COARSE)


def gaits_at(walker: Walker, slope: float, steps: int = 1) -> Iterator[np.ndarray]:
    """Gaits w (c - 1,) of a walker at a slope that repeat after some steps, by the
    polynomials of its branches: over the slope or, on level ground and uphill, over what
    drives there.
    """
    if slope > 0:
        problem, drive = Problem(walker), slope
        (branches,) = survey([walker], problem.structure, COARSE)
        if steps > 1:
            branches = cycle_branches(problem, branches, steps)
    else:
        problem, drive = driven(walker, slope, steps)
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
