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
from gaitsweep.tasks.studies.solve_driven import branches_over_any_slope


@dataclass(frozen=True)
class Grounds:
    """A walker's gaits on any ground: those of branches over slopes above 0 and, where it
    is level or leads uphill, of branches of the driven walker that lead there. Both
    depend on the walker alone, so that no row of a table changes what is said of others.
    """

    problem: Problem
    branches: list[Branch]

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

    def gaits_at(self, slope: Slopes) -> list[Gaits]:
        """The gaits at slopes (n,), in as many sets as there are pieces of branches."""
        found: list[Gaits] = []
        for lanes, problem, branches, counted in self.of(slope):
            for number, gaits in enumerate(gaits_at(problem, branches, counted)):
                if number == len(found):
                    found.append(Gaits.none(len(slope)))
                found[number].put(lanes, gaits)
        return found
