"""Gaits on level ground and uphill, where a push-off drives.

Branches are followed over the impulse of the push-off at one slope, and the walker's own
impulse is a point on them.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gaitsweep.tasks.branches import atlas as atlases
from gaitsweep.tasks.branches.branch import Branch
from gaitsweep.tasks.branches.refine import COARSE
from gaitsweep.tasks.step.drive import Drive, unit_of_impulse
from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.studies.follow_cycles import cycle_branches
from gaitsweep.tasks.walkers.walker import Walker

#: Lines whose branches are remembered: those of one walker and slope, whatever the
#: impulse.
_REMEMBERED = 32


def driven(walker: Walker, slope: float, steps: int = 1) -> tuple[Problem, float]:
    """Return the problem of a walker whose push-off drives it, and the impulse.

    Parameters
    ----------
    walker : Walker
    slope : float [rad]
    steps : int
        After which gaits repeat.

    Returns
    -------
    Problem
    float [mass sqrt(g leg)]
    """
    at_rest = replace(walker, push_off=0.0)
    problem = Problem(at_rest, steps, Drive(slope))
    return problem, walker.push_off / unit_of_impulse(walker)


def branches_of(problem: Problem) -> list[Branch]:
    """Return all branches of gaits over the push-off, of a walker at one slope."""
    assert problem.drive.at_slope is not None
    return _branches(problem.walker, problem.drive.at_slope, problem.steps)


@functools.lru_cache(maxsize=_REMEMBERED)
def _branches(walker: Walker, slope: float, steps: int) -> list[Branch]:
    problem = Problem(walker, drive=Drive(slope))
    single = atlases.survey(problem, COARSE)
    if steps == 1:
        return single
    return cycle_branches(problem, single, steps)


def searched(problem: Problem) -> str:
    """Say how gaits over the push-off were searched for."""
    impulses = np.array(atlases.OF_PUSH) * unit_of_impulse(problem.walker)
    slope = problem.drive.at_slope
    return (
        f"searched from initial guesses at {len(impulses)} values of `push_off` from "
        f"{impulses.min():.3g} to {impulses.max():.3g}, at slope {slope:g}"
    )


def in_units(
    problem: Problem, pieces: Sequence[tuple[float, float]]
) -> list[tuple[float, float]]:
    """Return ranges of impulses in the walker's units."""
    unit = unit_of_impulse(problem.walker)
    return [(low * unit, high * unit) for low, high in pieces]
