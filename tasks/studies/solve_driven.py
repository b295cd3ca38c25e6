"""Gaits on level ground and uphill, where a push-off or a torque between the thighs
drives.

Branches are followed over the drive at one slope, and the walker's own drive is a point
on them.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence

import numpy as np

from gaitsweep.tasks.branches import atlas as atlases
from gaitsweep.tasks.branches.branch import Branch
from gaitsweep.tasks.branches.refine import COARSE
from gaitsweep.tasks.mechanics.kernel import is_compact
from gaitsweep.tasks.step.drive import HIP_TORQUE, PUSH_OFF, Drive
from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.studies.follow_cycles import cycle_branches
from gaitsweep.tasks.walkers.walker import Walker

#: Lines whose branches are remembered: those of one walker and slope, whatever the
#: drive.
_REMEMBERED = 32


def driven(walker: Walker, slope: float, steps: int = 1) -> tuple[Problem, float]:
    """Return the problem of a walker that its push-off drives, or else the torque
    between its thighs, and that drive: 0 where nothing does.

    Parameters
    ----------
    walker : Walker
    slope : float [rad]
    steps : int
        After which gaits repeat.

    Returns
    -------
    Problem
    float
        In units of the leg, the walker's mass and g; a torque over the swing leg's
        inertia, too.
    """
    # A spring that rests at an angle is one that rests with the legs together, and a
    # constant torque.
    torque = walker.hip_torque + walker.hip_stiffness * walker.hip_rest
    turns = torque > 0 and not walker.massless_leg
    if turns and not walker.push_off:
        walker = walker.having("hip_rest", 0.0).having("hip_torque", torque)
    key = HIP_TORQUE if turns and not walker.push_off else PUSH_OFF
    drive = Drive(key, slope)
    problem = Problem(walker.having(key, 0.0), steps, drive)
    return problem, drive.of(walker)


def branches_of(problem: Problem) -> list[Branch]:
    """Return all branches of gaits over the drive, of a walker at one slope."""
    return _branches(problem.walker, problem.drive, problem.steps, is_compact())


@functools.lru_cache(maxsize=_REMEMBERED)
def _branches(walker: Walker, drive: Drive, steps: int, compact: bool) -> list[Branch]:
    """Branches by the code that computes them now, which is told to be remembered."""
    problem = Problem(walker, drive=drive)
    single = atlases.survey(problem, COARSE)
    if steps == 1:
        return single
    return cycle_branches(problem, single, steps)


def searched(problem: Problem) -> str:
    """Say how gaits over the drive were searched for."""
    drive, walker = problem.drive, problem.walker
    values = np.array(atlases.driven_anchors(drive, walker)) * drive.unit(walker)
    return (
        f"searched from initial guesses at {len(values)} values of `{drive.key}` from "
        f"{values.min():.3g} to {values.max():.3g}, at slope {drive.at_slope:g}"
    )


def in_units(
    problem: Problem, pieces: Sequence[tuple[float, float]]
) -> list[tuple[float, float]]:
    """Return ranges of the drive in the walker's units."""
    unit = problem.drive.unit(problem.walker)
    return [(low * unit, high * unit) for low, high in pieces]
