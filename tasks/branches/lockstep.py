"""Many procedures side by side: each is written for one branch, and all of them are
computed in common batches.

A procedure is a generator. Where it needs the step map it yields a `Call`, and goes on
with the call's result; where several others can do parts of its work at the same time it
yields a list of these, and goes on with the list of what they return. What many
procedures ask for at the same time is computed in one batch, each lane with the walker
of its procedure; a lane's bits do not depend on the others, so neither does what a
procedure returns.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Sequence
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy import ndarray

from gaitsweep.tasks.step.lanes import lanes_of, slices
from gaitsweep.tasks.step.problem import Problem

Result = TypeVar("Result")


class Call(NamedTuple):
    """A call of `function(problem, *arrays, **options)`, of arrays and for results
    whose last axis counts lanes.
    """

    function: Callable[..., Any]
    arrays: tuple[ndarray, ...]
    options: tuple[tuple[str, Any], ...] = ()


#: What it yields is a `Call`, or a list of procedures.
Procedure = Generator[Call | list[Any], Any, Result]


def run(problem: Problem, procedure: Procedure[Result]) -> Result:
    """Run one procedure for the walker of `problem`."""
    return side_by_side(problem, [0], [procedure])[0]


# Lanes beside an end may be lost.
@np.errstate(invalid="ignore", divide="ignore", over="ignore")
def side_by_side(
    problem: Problem,
    lines: Sequence[int] | ndarray,
    procedures: Sequence[Procedure[Result]],
) -> list[Result]:
    """Run procedures side by side.

    Parameters
    ----------
    problem : Problem
        Of a lane for each line.
    lines : sequence or ndarray of int
        The line of each procedure.
    procedures : sequence of Procedure

    Returns
    -------
    list
        What each returns.
    """
    running = _Running(procedures)
    while pending := running.pending:
        running.pending = {}
        alike: dict[tuple[Any, ...], list[_Place]] = {}
        for place, call in pending.items():
            alike.setdefault((call.function, call.options), []).append(place)

        for places in alike.values():
            of_lines = [lines[first] for first, *_ in places]
            calls = [pending[place] for place in places]
            parts = _in_one_batch(problem, of_lines, calls)
            for place, part in zip(places, parts, strict=True):
                running.advance(place, part)

    return running.returned


#: Where a procedure stands: its number in the outermost list, then in each list yielded
#: within.
_Place = tuple[int, ...]


class _Running:
    """Procedures on their way, by their places, and the calls that they wait for."""

    def __init__(self, procedures: Sequence[Procedure[Any]]):
        self.pending: dict[_Place, Call] = {}
        self.returned: list[Any] = []
        self._procedures: dict[_Place, Procedure[Any]] = {}
        self._results: dict[_Place, list[Any]] = {}
        self._left: dict[_Place, int] = {}
        self._begin((), procedures)

    def advance(self, place: _Place, value: Any) -> None:
        """Go on with a procedure, by what it waited for."""
        try:
            asked = self._procedures[place].send(value)
        except StopIteration as end:
            self._finish(place, end.value)
            return

        if isinstance(asked, Call):
            self.pending[place] = asked
        else:
            self._begin(place, asked)

    def _begin(self, place: _Place, procedures: Sequence[Procedure[Any]]) -> None:
        """Begin the procedures for which that at a place waits."""
        n = len(procedures)
        self._results[place], self._left[place] = [None] * n, n
        if not n:
            self._go_on(place)
        for number, procedure in enumerate(procedures):
            self._procedures[*place, number] = procedure
            self.advance((*place, number), None)

    def _finish(self, place: _Place, result: Any) -> None:
        *within, number = place
        parent = tuple(within)
        self._results[parent][number] = result
        self._left[parent] -= 1
        if not self._left[parent]:
            self._go_on(parent)

    def _go_on(self, place: _Place) -> None:
        """Go on where all have returned that a procedure waited for."""
        results = self._results.pop(place)
        if place:
            self.advance(place, results)
        else:
            self.returned = results


def _in_one_batch(
    problem: Problem, lines: list[int], calls: list[Call]
) -> Iterator[Any]:
    """Results of calls of one function with the same options, each for its line."""
    counts = [call.arrays[0].shape[-1] for call in calls]
    of_argument = zip(*(call.arrays for call in calls), strict=True)
    arrays = [np.concatenate(parts, axis=-1) for parts in of_argument]
    of_lanes = problem.some(np.repeat(lines, counts))
    result = calls[0].function(of_lanes, *arrays, **dict(calls[0].options))
    for lanes in slices(counts):
        yield lanes_of(result, lanes)
