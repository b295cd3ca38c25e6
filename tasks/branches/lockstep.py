"""Many procedures side by side: each is written for one branch, and all of them are
computed in common batches.

A procedure is a generator. Where it needs the step map it yields a `Call`, and goes on
with the call's result. What many procedures ask for at the same time is computed in one
batch, each lane with the walker of its procedure; a lane's bits do not depend on the
others, so neither does what a procedure returns.
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


Procedure = Generator[Call, Any, Result]


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
    results: dict[int, Result] = {}
    pending: dict[int, Call] = {}

    def advance(number: int, value: Any) -> None:
        try:
            pending[number] = procedures[number].send(value)
        except StopIteration as end:
            results[number] = end.value

    for number in range(len(procedures)):
        advance(number, None)
    while pending:
        alike: dict[tuple[Any, ...], list[int]] = {}
        for number, call in pending.items():
            alike.setdefault((call.function, call.options), []).append(number)
        calls, pending = pending, {}
        for numbers in alike.values():
            of_lines = [lines[number] for number in numbers]
            parts = _in_one_batch(
                problem, of_lines, [calls[number] for number in numbers]
            )
            for number, part in zip(numbers, parts, strict=True):
                advance(number, part)

    return [results[number] for number in range(len(procedures))]


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
