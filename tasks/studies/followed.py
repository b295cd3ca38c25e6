"""What the gaits of a line are followed over: slopes, or what drives at one slope."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from gaitsweep.tasks.step.drive import SLOPE, Drive
from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.walkers.resolve import walker_of_line


def followed_over(params: Mapping[str, Any], steps: int = 1) -> tuple[Problem, float]:
    """Return the problem of a line over what its gaits are followed along, and the unit
    of that: 1 of slopes.

    Parameters
    ----------
    params : mapping
        `line` and, if the slope does not drive, `along`: the key that does, at the
        `slope` of the line.
    steps : int
        After which gaits repeat.

    Returns
    -------
    Problem
    float
        In the walker's units.
    """
    walker, key = walker_of_line(params["line"]), params.get("along", SLOPE)
    if key == SLOPE:
        return Problem(walker, steps), 1.0

    drive = Drive(key, float(params["line"]["slope"]))
    return Problem(walker.having(key, 0.0), steps, drive), drive.unit(walker)


def columns_along(problem: Problem, columns: Sequence[str]) -> tuple[str, ...]:
    """Return names of columns with what gaits are followed along in the place of the
    slope.
    """
    along = problem.drive.key
    return tuple(along if column == "slope" else column for column in columns)
