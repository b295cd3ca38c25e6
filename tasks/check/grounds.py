"""A walker's gaits on any ground."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from gaitsweep.tasks.branches.branch import Branch
from gaitsweep.tasks.branches.nearest import Gaits, gaits_at
from gaitsweep.tasks.mechanics.arrays import Slopes
from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.studies.solve_driven import (
    branches_of,
    branches_over_any_slope,
    driven,
)


@dataclass(frozen=True)
class Grounds:
    """A walker's gaits on any ground: those of branches over the slope and, where that is
    level or leads uphill, over what drives there.
    """

    problem: Problem
    branches: list[Branch]

    def of(
        self, slope: Slopes
    ) -> Iterator[tuple[np.ndarray, Problem, list[Branch], np.ndarray]]:
        """Yield the numbers of the slopes (n,) that have branches in common, with these
        and their problem, and the drive (k,) of each.
        """
        down = np.flatnonzero(slope > 0)
        yield down, self.problem, self.branches, slope[down]
        for level in np.unique(slope[slope <= 0]).tolist():
            lanes = np.flatnonzero(slope == level)
            problem, drive = driven(self.problem.walker, level)
            if drive:
                counted = np.full(len(lanes), drive)
                yield lanes, problem, branches_of(problem), counted

    @property
    def is_driven(self) -> bool:
        """Whether more than gravity drives the walker."""
        return "drive" in self.problem.walker.features

    def over_any_slope(self, slope: Slopes) -> tuple[Problem, list[Branch]]:
        """Branches of a driven walker over slopes that lead uphill, too: those that go on
        from downhill, and those through gaits at the steepest and gentlest of slopes (n,)
        of which some may be 0 or below.
        """
        levels = slope[slope <= 0]
        ends = {float(levels.min()), float(levels.max())} if len(levels) else {0.0}
        return branches_over_any_slope(self.problem.walker, self.branches, sorted(ends))

    def gaits_at(self, slope: Slopes) -> list[Gaits]:
        """The gaits at slopes (n,), in as many sets as there are pieces of branches."""
        found: list[Gaits] = []
        for lanes, problem, branches, drive in self.of(slope):
            for number, gaits in enumerate(gaits_at(problem, branches, drive)):
                if number == len(found):
                    found.append(Gaits.none(len(slope)))
                found[number].put(lanes, gaits)
        return found
