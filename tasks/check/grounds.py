"""A walker's gaits on any ground."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gaitsweep.tasks.branches.branch import Branch
from gaitsweep.tasks.branches.nearest import Gaits, gaits_at
from gaitsweep.tasks.mechanics.arrays import Numbers, Slopes
from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.studies.follow_cycles import cycle_branches
from gaitsweep.tasks.studies.solve_driven import branches_over_any_slope

#: Branches, and the problem whose gaits they are of.
Followed = tuple[Problem, list[Branch]]


@dataclass(frozen=True)
class Grounds:
    """A walker's gaits on any ground: those of branches over slopes above 0 and, where it
    is level or leads uphill, of branches of the driven walker that lead there. Both
    depend on the walker alone, so that no row of a table changes what is said of others.

    `problem` and `branches` are those of one step. Gaits are claimed to repeat after
    `claimed` steps, whose branches are followed when they are first asked for.
    """

    problem: Problem
    branches: list[Branch]
    claimed: int = 1

    def of(
        self, slope: Slopes
    ) -> Iterator[tuple[Numbers, Problem, list[Branch], np.ndarray]]:
        """Yield the numbers of the slopes (n,) that have branches in common, with these
        and their problem, and the slopes (k,) as that counts them.
        """
        down = np.flatnonzero(slope > 0)
        yield down, self.problem, self.branches, slope[down]

        others = np.flatnonzero(slope <= 0)
        if len(others) and self.is_driven:
            problem, branches = self.over_any_slope
            yield others, problem, branches, problem.drive.counted(slope[others])

    @property
    def is_driven(self) -> bool:
        """Whether more than gravity drives the walker."""
        return "drive" in self.problem.walker.features

    @cached_property
    def over_any_slope(self) -> tuple[Problem, list[Branch]]:
        """Branches of a driven walker over slopes that lead uphill, too."""
        return branches_over_any_slope(self.problem.walker, self.branches)

    @cached_property
    def downhill(self) -> list[Followed]:
        """Branches over slopes above 0 of gaits of one step, and of the claimed ones and
        their divisors.
        """
        return [(self.problem, self.branches), *self._cycles]

    @cached_property
    def _cycles(self) -> list[Followed]:
        """Branches over slopes above 0 of gaits of the claimed steps, and of fewer, not
        one, after which those that are claimed repeat too.
        """
        cycles = []
        for steps in range(2, self.claimed + 1):
            if self.claimed % steps == 0:
                followed = cycle_branches(self.problem, self.branches, steps)
                cycles.append((self.problem.of_steps(steps), followed))
        return cycles

    def gaits_at(self, slope: Slopes) -> list[Gaits]:
        """The gaits at slopes (n,) of one step and of those of `downhill`, in as many sets as
        there are pieces of branches and steps at which they may begin.
        """
        if not len(slope):
            return []

        found: list[Gaits] = []
        for lanes, problem, branches, counted in self.of(slope):
            for number, gaits in enumerate(gaits_at(problem, branches, counted)):
                if number == len(found):
                    found.append(Gaits.none(len(slope)))
                found[number].put(lanes, gaits)

        down = np.flatnonzero(slope > 0)
        for problem, branches in self._cycles if len(down) else []:
            for gaits in gaits_at(problem, branches, slope[down]):
                found.append(Gaits.none(len(slope)))
                found[-1].put(down, gaits)

        return found
