"""Gaits on level ground and uphill, where a push-off or a torque between the thighs
drives.

Branches are followed over the drive at one slope, and the walker's own drive is a point
on them.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy import ndarray

from gaitsweep.tasks.branches import atlas as atlases
from gaitsweep.tasks.branches.branch import Branch
from gaitsweep.tasks.branches.refine import COARSE
from gaitsweep.tasks.contract.tables import Arrays
from gaitsweep.tasks.mechanics.kernel import is_compact
from gaitsweep.tasks.step.drive import HIP_TORQUE, PUSH_OFF, SLOPE, Drive
from gaitsweep.tasks.step.problem import Lanes, Problem
from gaitsweep.tasks.studies.follow_cycles import cycle_branches
from gaitsweep.tasks.studies.followed import followed_over
from gaitsweep.tasks.walkers.walker import Walker

#: Lines whose branches are remembered: those of one walker and slope, whatever the
#: drive.
_REMEMBERED = 32
#: The slope from which those of all grounds are counted, and one at which gaits are
#: followed from downhill to level ground [rad].
LOWEST, _GENTLE = -1.0, 1e-5


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
    if walker.is_driven and not walker.pushes_off:
        # The torque that holds a spring that rests at an angle with the legs together,
        # so that what drives is all that turns them.
        drive, torque = Drive(HIP_TORQUE, slope), walker.forward_torque
        held = walker.having("hip_torque", 0.0 - walker.hip_stiffness * walker.hip_rest)
        return Problem(held, steps, drive), torque / drive.unit(walker)

    drive = Drive(PUSH_OFF, slope)
    return Problem(walker.having(PUSH_OFF, 0.0), steps, drive), drive.of(walker)


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


def branches_over_any_slope(
    walker: Walker, downhill: Sequence[Branch], levels: Sequence[float] = (0.0,)
) -> tuple[Problem, list[Branch]]:
    """Return branches of a driven walker's gaits over slopes that lead downhill, level
    and uphill, and their problem: those that go on from downhill, and those through its
    gaits at some slopes of 0 and below.

    Parameters
    ----------
    walker : Walker
    downhill : sequence of Branch
        Its branches over slopes above 0, through which these go on below.
    levels : sequence of float [rad]
        The slopes of 0 and below at which its gaits are searched for.
    """
    drive = Drive(SLOPE, LOWEST)
    line = Lanes([walker], drive.structure(walker), drive)
    Z = [*_counted(downhill, _GENTLE, _GENTLE)]
    for slope in levels:
        problem, driving = driven(walker, slope)
        if driving:
            Z += _counted(branches_of(problem), driving, slope)

    found: list[list[Branch]] = [[]]
    if Z:
        numbers = np.zeros(len(Z), int)
        atlases.follow_gaits(line, found, numbers, np.array(Z).T, COARSE)

    return Problem(walker, drive=drive), atlases.ranked(found[0])


def _counted(
    branches: Sequence[Branch], drive: float, slope: float
) -> Iterator[ndarray]:
    """Gaits (c,) of branches at a value of what drives, with their slope counted from the
    lowest.
    """
    for branch in branches:
        for _, Z, _ in branch.guesses(np.log([drive])):
            yield np.append(Z[:-1, 0], np.log(slope - LOWEST))


def searched(problem: Problem) -> str:
    """Say how gaits over the drive were searched for."""
    drive, walker = problem.drive, problem.walker
    values = np.array(atlases.driven_anchors(drive, walker)) * drive.unit(walker)
    return (
        f"searched from initial guesses at {len(values)} values of `{drive.key}` from "
        f"{values.min():.3g} to {values.max():.3g}, at slope {drive.base:g}"
    )


def in_units(
    problem: Problem, pieces: Sequence[tuple[float, float]]
) -> list[tuple[float, float]]:
    """Return ranges of the drive in the walker's units."""
    unit = problem.drive.unit(problem.walker)
    return [(low * unit, high * unit) for low, high in pieces]


@dataclass(frozen=True)
class PointsOnBranches:
    """Points of a line whose gaits lie on the same branches.

    Attributes
    ----------
    problem : Problem
    branches : list of Branch
    drive : ndarray, shape (n,)
        Slopes [rad], or values of what else drives, as the problem counts them.
    asked : ndarray, shape (n,)
        What was asked for, in the walker's units: slopes [rad], or values of `key`.
    key : str
    """

    problem: Problem
    branches: list[Branch]
    drive: ndarray
    asked: ndarray
    key: str = SLOPE

    def named(self, tables: Arrays) -> Arrays:
        """Return tables of values of the drive as those of what was asked for."""
        order = np.argsort(self.drive)
        named: Arrays = {}
        for name, column in tables.items():
            group, _, own = name.rpartition("/")
            if own == SLOPE:
                name = f"{group}/{self.key}"
                places = order[np.searchsorted(self.drive[order], column)]
                column = self.asked[places]
            named[name] = column

        return named


def points_on_branches(
    params: Mapping[str, Any], atlas: Arrays
) -> list[PointsOnBranches]:
    """Return the points of a line by the branches on which their gaits lie: those of
    slopes above 0, or of a drive, and of every slope of 0 and below what drives there.

    Parameters
    ----------
    params : mapping
        `line`, `slope` and perhaps `along`, as for `followed_over`.
    atlas : dict
        Of the line.
    """
    problem, unit = followed_over(params)
    values = np.asarray(params["slope"], float)
    branches = atlases.from_arrays(atlas)
    if "along" in params:
        key = str(params["along"])
        return [PointsOnBranches(problem, branches, values / unit, values, key)]

    leads = values > 0
    parts = [PointsOnBranches(problem, branches, values[leads], values[leads])]
    for slope in values[~leads].tolist():
        own, drive = driven(problem.walker, slope)
        found = branches_of(own) if drive else []
        parts.append(PointsOnBranches(own, found, np.array([drive]), np.array([slope])))

    parts = [part for part in parts if len(part.drive)]
    # Rows are in the order in which their slopes were asked for.
    order = values.tolist()
    return sorted(parts, key=lambda part: order.index(part.asked[0]))


def joined(parts: Sequence[Arrays]) -> Arrays:
    """Return the tables of several points as those of their line, which has nothing
    only where none has anything.
    """
    names = dict.fromkeys(name for part in parts for name in part)
    some = [part for part in parts if "nothing/reason" not in part]
    if some and len(some) < len(parts):
        names.pop("nothing/reason", None)

    return {
        name: np.concatenate([part[name] for part in parts if name in part])
        for name in names
    }
