"""Values of measures as conditions on gaits: a gait of a given speed, clearance or cost
is a point where the measure has that value.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gaitsweep.tasks.branches.conditions import Condition, Scalar
from gaitsweep.tasks.branches.joint import Evaluation
from gaitsweep.tasks.measures.gaits import (
    Arrays,
    of_all_steps,
    of_travel,
    steps_of,
)
from gaitsweep.tasks.measures.kinematics import TRAVEL
from gaitsweep.tasks.measures.names import measures as measures
from gaitsweep.tasks.step.drive import OVER_SLOPE, SLOPE
from gaitsweep.tasks.step.lanes import lanes_of

#: How tables call the condition of this module.
LEVEL = "level"
#: Measured of the step map's derivative.
_RADIUS = "spectral_radius"


def level(name: str, value: float | np.ndarray) -> Condition:
    """Return the condition that a measure has a value.

    Parameters
    ----------
    name : str
        Of `measures`.
    value : float or ndarray, shape (n,)
        In the walker's units; an array has that of each lane.

    Notes
    -----
    Its derivatives are differences. Over designs, where gaits of one speed are sought a
    million times, the condition `speed` has a formula instead.
    """

    def measured(at: Evaluation) -> np.ndarray:
        return measures_at([name], at)[name]

    return Condition(LEVEL, measured, target=value)


class Measures:
    """Several measures of evaluated steps, all taken at once, the last ones kept."""

    def __init__(self, names: Sequence[str]):
        self.names = list(dict.fromkeys(names))
        self._last: tuple[Evaluation, Arrays] | None = None

    def scalar(self, name: str) -> Scalar:
        """Return one of them as a function of evaluated steps, shape (n,)."""

        def measured(at: Evaluation) -> np.ndarray:
            if self._last is None or self._last[0] is not at:
                self._last = at, measures_at(self.names, at)
            return self._last[1][name]

        return measured


# Beside the ends of walking some measures have no value.
@np.errstate(invalid="ignore", divide="ignore", over="ignore")
def measures_at(names: Sequence[str], at: Evaluation) -> Arrays:
    """Measure gaits where they are evaluated.

    Parameters
    ----------
    names : sequence of str
        Of `measures`.
    at : Evaluation

    Returns
    -------
    dict of ndarray, shape (n,) [the walker's units]
    """
    if at.problem.drive.key != SLOPE:
        return _measures_by_drive(names, at)

    slope = at.problem.slopes(np.exp(at.q))
    problem = at.problem.over(OVER_SLOPE)
    walkers = problem.every_walker
    has_travel = any(name in TRAVEL for name in names)
    needed = [name for name in names if name not in TRAVEL and name != _RADIUS]
    if has_travel:
        needed += ["step_length", "period"]
    # Where rounding is measured, steps are evaluated in other units.
    y = at.stride.y
    scale = np.exp(at.w[0]) / y[0]
    steps = steps_of(problem, walkers, at.stride, y, scale, at.times, slope)
    measured = of_all_steps(steps.measure(needed), problem.steps)
    if has_travel:
        measured |= of_travel(walkers, slope, measured, problem.steps)
    if _RADIUS in names:
        measured[_RADIUS] = np.abs(at.multipliers).max(axis=1)
    return {name: np.asarray(measured[name], float) for name in names}


def _measures_by_drive(names: Sequence[str], at: Evaluation) -> Arrays:
    """Measure gaits as `measures_at` does, of the walkers that values of what drives
    make.
    """
    found = {name: np.full(len(at.q), np.nan) for name in names}
    for lanes, driven, slope in at.problem.at_slopes(np.exp(at.q)):
        Z = np.vstack([at.w[:, lanes], np.log(slope)])
        there = Evaluation(Z, lanes_of(at.stride, lanes), driven)
        for name, values in measures_at(names, there).items():
            found[name][lanes] = values
    return found
