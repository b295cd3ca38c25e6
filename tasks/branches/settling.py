"""Gaits at given slopes settled from guesses that lie on branches: where Newton's method
loses a guess it is first located on its branch, and no gait is found twice.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy import ndarray

from gaitsweep.tasks.branches.branch import Branch
from gaitsweep.tasks.branches.lockstep import run
from gaitsweep.tasks.branches.segment import point_at_slope
from gaitsweep.tasks.gaits.polish import (
    Guesses,
    Polished,
    are_same,
    settle,
)
from gaitsweep.tasks.mechanics.arrays import Numbers, Unknowns
from gaitsweep.tasks.step.lanes import lanes_of, replace_lanes
from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.step.sameness import ON_BRANCH, same
from gaitsweep.tasks.step.several_steps import distances_of_steps, from_largest

#: Least distance of a gait's steps from each other, over that of its guess, and over
#: the first angle, that of rounding: nearer ones are those of a gait of fewer steps,
#: beside whose flip it lies.
_LEAST_SHARE, _LEAST_APART = 0.5, 1e-10
#: Distance in ln slope from a fold within which both pieces may lead to one gait.
_BESIDE_FOLD = 1e-10


def settle_on_branches(
    problem: Problem,
    guesses: Guesses,
    places: Sequence[tuple[Problem, Branch, ndarray]],
    accuracy: float = 0.0,
) -> Polished:
    """Settle guesses that lie on branches; those that Newton's method loses are first
    located along their branches.

    Steps that almost end in a fall make so much of a guess's error that at a fixed
    slope Newton's method diverges, or leads to another gait.

    Parameters
    ----------
    problem : Problem
        Of the lanes of all guesses.
    guesses : Guesses
    places : sequence of (Problem, Branch, ndarray of int)
        Walkers, branches and the segments of their guesses, one after another.
    accuracy : float
        As for `settle`.
    """
    gaits = settle(problem, guesses, accuracy=accuracy)
    settled = gaits.converged & _is_near(problem, gaits, guesses.w)
    lost = np.flatnonzero(~settled)
    if len(lost):
        again = _located_guesses(guesses, lost, places)
        located = settle(problem.some(lost), again, accuracy=accuracy)
        located.converged &= _is_near(problem, located, again.w)
        replace_lanes(gaits, lost, located)

    _lose_twins(gaits, guesses, places)
    return gaits


def _located_guesses(
    guesses: Guesses,
    lost: Numbers,
    places: Sequence[tuple[Problem, Branch, ndarray]],
) -> Guesses:
    """Guesses of some lanes (k,), located along their branches where these lead to them."""
    again = lanes_of(guesses, lost)
    ends = np.cumsum([len(segments) for *_, segments in places])
    for i, lane in enumerate(lost.tolist()):
        number = int(np.searchsorted(ends, lane, side="right"))
        walker, branch, segments = places[number]
        first = ends[number] - len(segments)
        segment = int(segments[lane - first])
        q = np.log(guesses.slope[lane])
        point = run(walker, point_at_slope(branch, segment, q))
        if point is not None:
            w = from_largest(point.at.w, branch.m, branch.steps)
            again.w[:, i] = w[:, 0]

    return again


def _lose_twins(
    gaits: Polished,
    guesses: Guesses,
    places: Sequence[tuple[Problem, Branch, ndarray]],
) -> None:
    """Count as lost what Newton's method led to twice: within rounding of a fold the
    guesses of the two pieces that meet there may lead to one gait. The other one, whose
    guess was farther from it, is not found.
    """
    for lanes in _beside_folds(gaits, guesses, places):
        moved = np.abs(gaits.w[:, lanes] - guesses.w[:, lanes]).max(axis=0)
        kept: list[int] = []
        for lane in lanes[np.argsort(moved, kind="stable")].tolist():
            found = lanes_of(gaits, np.array([lane]))
            known = lanes_of(gaits, np.array(kept, int))
            if are_same(found, known).any():
                gaits.converged[lane] = False
            else:
                kept.append(lane)


def _beside_folds(
    gaits: Polished,
    guesses: Guesses,
    places: Sequence[tuple[Problem, Branch, ndarray]],
) -> list[ndarray]:
    """Lanes of the gaits of one branch and slope, within rounding of a fold, that have
    converged.
    """
    groups: dict[tuple[int, float], list[int]] = {}
    begin = 0
    for _, branch, segments in places:
        lanes = np.arange(begin, begin + len(segments))
        begin += len(segments)
        folds = branch.q[branch.folds()]
        apart = np.abs(np.log(guesses.slope[lanes])[:, None] - folds)
        near = (apart < _BESIDE_FOLD).any(axis=1) & gaits.converged[lanes]
        for lane in lanes[near].tolist():
            group = id(branch), float(guesses.slope[lane])
            groups.setdefault(group, []).append(lane)

    return [np.array(lanes) for lanes in groups.values()]


@np.errstate(invalid="ignore", divide="ignore")
def _is_near(problem: Problem, at: Polished, w: Unknowns) -> ndarray:
    """Whether gaits lie where Newton's method began and repeat no sooner, shape (n,)."""
    return np.asarray(same(at.w, w, ON_BRANCH) & repeats_no_sooner(problem, at.w, w))


def repeats_no_sooner(problem: Problem, w: Unknowns, guess: Unknowns) -> ndarray:
    """Return whether gaits (m + k, n) of several steps repeat after no fewer, shape (n,):
    their steps stay about as far apart as those of their guesses.
    """
    apart = distances_of_steps(w, problem.m, problem.steps)
    of_guess = distances_of_steps(guess, problem.m, problem.steps)
    least = np.maximum(_LEAST_SHARE * of_guess, _LEAST_APART)
    return np.asarray((apart > least).all(axis=0))
