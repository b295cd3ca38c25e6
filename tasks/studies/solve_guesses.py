"""From guesses to gaits: settled side by side, measured, and parts that are stored.

All gaits at given slopes are solved so, wherever their guesses come from: branches of
lines, patches of planes, nodes of polynomials, or a search.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from gaitsweep.tasks.contract.registry import SENSITIVITIES, VARIABLES
from gaitsweep.tasks.contract.tables import Arrays
from gaitsweep.tasks.gaits.polish import Guesses, Polished
from gaitsweep.tasks.measures.gaits import Part, Wanted, describe
from gaitsweep.tasks.measures.sensitivities import Measured, differentiated
from gaitsweep.tasks.step.lanes import join_lanes, lanes_of, slices
from gaitsweep.tasks.step.problem import Problem

#: Points solved at a time: enough to amortize the calls, few enough for the cache; and
#: where most are given by polynomials.
_BLOCK = 4096
_INTERPOLATED_BLOCK = 1 << 14

Settle = Callable[[Problem, Guesses], Polished]
#: What `differentiated` does.
Differentiate = Callable[[Problem, Polished, np.ndarray, Sequence[str]], Measured]


def block_size(is_interpolated: bool) -> int:
    """Return how many points are solved at a time."""
    return _INTERPOLATED_BLOCK if is_interpolated else _BLOCK


def blocks(n: int, is_interpolated: bool) -> Iterator[slice]:
    """Yield the parts of n points that are solved at a time."""
    size = block_size(is_interpolated)
    for first in range(0, n, size):
        yield slice(first, first + size)


@dataclass(frozen=True)
class Solved:
    """Gaits of several groups of guesses, whose lanes follow one another.

    Attributes
    ----------
    guesses : Guesses
        Of n lanes.
    at : Polished
        The settled gaits.
    gaits : dict of ndarray, shape (n[, multipliers])
        Their variables, in the walkers' units.
    lanes : list of slice
        Those of each group.
    """

    guesses: Guesses
    at: Polished
    gaits: Arrays
    lanes: list[slice]

    def part(
        self,
        group: int,
        index: np.ndarray,
        numbers: Any,
        lost_ratio: Any = None,
    ) -> Part:
        """Return the gaits of a group as they are stored.

        Parameters
        ----------
        group : int
        index : ndarray of int, shape (k,)
            The points of its guesses.
        numbers : pair of ndarray of int, shape (k,), or of int
            Those of their branches and pieces.
        lost_ratio : ndarray, shape (k,), optional
            Rate ratios of gaits that have not converged.
        """
        lanes = self.lanes[group]
        solved = {name: values[lanes] for name, values in self.gaits.items()}
        for name, number in zip(("branch", "piece"), numbers, strict=True):
            solved[name] = np.broadcast_to(number, len(index))

        # A gait that has not converged still counts as its branch's.
        angle = np.where(solved["anthropomorphic"], self.guesses.w[0, lanes], np.nan)
        ratio = solved["heelstrike_rate_ratio"]
        if lost_ratio is not None:
            converged = self.at.converged[lanes] & self.at.step[lanes]
            ratio = np.where(converged, ratio, lost_ratio)

        return Part(index, angle, ratio, solved)


def walkers_alone(
    problem: Problem, walker: np.ndarray, names: Sequence[str]
) -> list[tuple[Problem, int]]:
    """Return the walkers whose gaits are measured by themselves, as derivatives are, with
    the number of consecutive lanes of each; empty if none are.

    Walkers are differentiated one at a time: several gaits of one cost little more.

    Parameters
    ----------
    problem : Problem
        Of n lanes.
    walker : ndarray of int, shape (n,)
        The number of each lane's walker; equal ones follow one another.
    names : sequence of str
        Of the variables wanted.
    """
    if not any(VARIABLES[name].group == SENSITIVITIES for name in names):
        return []

    firsts = np.flatnonzero(np.diff(walker, prepend=-1))
    counts = np.diff(firsts, append=len(walker))
    walkers = map(problem.alone, firsts.tolist())
    return [*zip(walkers, counts.tolist(), strict=True)]


def solve_guesses(
    problem: Problem,
    guesses: Sequence[Guesses],
    settle: Settle,
    wanted: Wanted,
    alone: Sequence[tuple[Problem, int]] = (),
    differentiate: Differentiate = differentiated,
) -> Solved:
    """Settle groups of guesses side by side, and measure the gaits.

    Parameters
    ----------
    problem : Problem
        Of one walker, or of a walker for each guess.
    guesses : sequence of Guesses
        Those of each group.
    settle : callable
        Polishes and verifies them.
    wanted : Wanted
    alone : sequence of (Problem, int)
        Walkers whose gaits are measured each by themselves, and how many each has, one
        after another; without, all are measured at once.
    differentiate : callable
        Gives the wanted variables of the group `sensitivities`.
    """
    together: Guesses = join_lanes(guesses)
    lanes = slices([len(group.slope) for group in guesses])
    at = settle(problem, together)

    measured = []
    walkers = alone or [(problem, len(together.slope))]
    of_walkers = slices([n for _, n in walkers])
    for (walker, _), some in zip(walkers, of_walkers, strict=True):
        gaits = lanes_of(at, some) if alone else at
        slope = together.slope[some]
        of_walker = describe(walker, gaits, slope, wanted.names, wanted.limits)
        of_walker |= differentiate(walker, gaits, slope, wanted.names)
        measured.append(of_walker)

    variables = measured[0]
    if len(measured) > 1:
        for name in variables:
            values = [of_walker[name] for of_walker in measured]
            variables[name] = np.concatenate(values)

    return Solved(together, at, variables, lanes)
