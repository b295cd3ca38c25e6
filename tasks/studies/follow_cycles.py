"""Branches of gaits that repeat after n steps: from the flips of gaits of n/2 steps,
and from a search.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy import ndarray

from gaitsweep.tasks.branches.atlas import branches_along, is_known, ranked
from gaitsweep.tasks.branches.branch import Branch
from gaitsweep.tasks.branches.conditions import CONDITIONS
from gaitsweep.tasks.branches.flips import doubled
from gaitsweep.tasks.branches.joint import Evaluation
from gaitsweep.tasks.branches.lockstep import side_by_side
from gaitsweep.tasks.branches.pseudo_arclength import Point
from gaitsweep.tasks.branches.refine import COARSE
from gaitsweep.tasks.branches.special_points import corrected, flips
from gaitsweep.tasks.branches.tracking import MAX_MULTIPLIER, follow
from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.studies.locate_cascade import Orbits

#: Slopes of the search for gaits that no flip begins, over the slope of the first flip,
#: and initial states at each.
_SEARCHED, _STARTS = np.linspace(0.8, 1.4, 9), 300
#: First step along a branch that a search finds.
_FIRST_STEP = 2e-3
#: Length in ln slope that a doubled branch is taken to have: its first point is near
#: enough to its flip for a cubic.
_EXPECTED = 5e-4


def cycle_branches(problem: Problem, branches: list[Branch], n: int) -> list[Branch]:
    """Follow every branch of gaits of n steps that a flip begins or a search finds.

    Parameters
    ----------
    problem : Problem
        Of one step.
    branches : list of Branch
        The line's atlas.
    n : int
        Number of steps after which the gaits repeat, at least 2.

    Returns
    -------
    list of Branch
        By their lowest slopes. Nothing is measured on them but whether they walk: what
        points need is measured there.
    """
    single = _flips_of(problem, branches)
    steps = n // (n & -n)  # the odd part
    periods = [steps]
    while periods[-1] < n:
        periods.append(2 * periods[-1])

    found = _search(problem, branches, periods, single)
    followed = _follow_all(problem.of_steps(steps), [], found[steps])
    begins = single if steps == 1 else _flips_of(problem, followed)
    for steps in periods[1:]:
        followed = _follow_all(problem.of_steps(steps), begins, found[steps])
        if steps < n:
            begins = _flips_of(problem, followed)

    return ranked(followed)


def _flips_of(problem: Problem, branches: list[Branch]) -> list[Evaluation]:
    found: list[Evaluation] = []
    for branch in branches:
        found += flips(problem.of_steps(branch.steps), branch)
    return found


def _follow_all(
    problem: Problem, begins: Sequence[Evaluation], found: Sequence[Point]
) -> list[Branch]:
    """The branches of gaits of several steps that flips of half as many begin, and
    those through gaits that were found.
    """
    begun = [first for flip in begins if (first := doubled(flip, _EXPECTED))]
    starts = [(gait, step) for gait, _, step in begun]
    followed: list[Branch] = []
    while starts or found:
        # A search finds a branch at many slopes, most often none that a flip begins: one
        # gait at a time is followed, the first beside those of the flips.
        starts += [(gait, _FIRST_STEP) for gait in found[:1]]
        followed += _along(problem, starts, begins, followed)
        starts = []
        found = [gait for gait in found[1:] if not is_known(followed, gait.Z[:, 0])]

    return followed


def _along(
    problem: Problem,
    starts: Sequence[tuple[Point, float]],
    begins: Sequence[Evaluation],
    known: Sequence[Branch],
) -> list[Branch]:
    """The branches through gaits besides those known, each followed both ways side by
    side with the others from a first step of its own, in parts that walk.
    """
    Z = np.hstack([gait.Z for gait, _ in starts])
    steps = np.array([step for _, step in starts])
    of_starts = np.zeros(len(starts), int)
    tracks = follow(problem.some(of_starts), Z, steps)
    refined = [branches_along(problem, down, up, COARSE, begins) for down, up in tracks]
    parts = side_by_side(problem, of_starts, refined)

    followed: list[Branch] = []
    for gait, of_gait in zip(Z.T, parts, strict=True):
        # Two flips may be the ends of one branch.
        if not is_known([*known, *followed], gait):
            followed += of_gait

    return followed


def _beyond_flips(problem: Problem, branches: list[Branch]) -> ndarray:
    """Slopes at which gaits have doubled already, as those of heavy feet at vanishing
    slopes, shape (n,) [rad].
    """
    medians = []
    for branch in branches:
        nodes = corrected(problem, branch)
        is_beyond = CONDITIONS["flip"].residual(nodes.at) < 0
        q = branch.q[is_beyond & (branch.leg_passes == 1)]
        if len(q):
            medians.append(np.exp(np.median(q)))

    return np.array(medians)


def _search(
    problem: Problem,
    branches: list[Branch],
    periods: Sequence[int],
    flips: list[Evaluation],
) -> dict[int, list[Point]]:
    """Gaits of some periods that a search near the first flip of one step finds, up to
    the multiplier to which branches are followed.

    If there is no flip, gaits of two steps are searched for at slopes at which those of
    one step have doubled.
    """
    found: dict[int, list[Point]] = {n: [] for n in periods}
    sought = [n for n in periods if n > 2 or (n == 2 and not flips)]
    slopes = np.zeros(0)
    if flips:
        first = float(np.exp(min(flip.q[0] for flip in flips)))
        slopes = first * _SEARCHED
    elif 2 in sought:
        slopes = _beyond_flips(problem, branches)
        sought = [2]

    if not sought or not len(slopes):
        return found

    orbits = Orbits(problem, branches, slopes, max(sought), _STARTS)
    for n in sought:
        found[n] = [
            gait
            for gait in orbits.cycles(n)
            if abs(gait.at.multipliers[0, 0]) <= MAX_MULTIPLIER
        ]

    return found
