"""Values of measures as conditions on gaits: a gait of a given speed, clearance or cost
is a point where the measure has that value.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gaitsweep.tasks.branches.conditions import Condition
from gaitsweep.tasks.branches.joint import Evaluation
from gaitsweep.tasks.measures.gaits import (
    Arrays,
    of_all_steps,
    of_travel,
    steps_of,
)
from gaitsweep.tasks.measures.kinematics import TRAVEL
from gaitsweep.tasks.measures.names import measures as measures

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
        return measure_at(name, at)

    return Condition("level", measured, target=value)


def measure_at(name: str, at: Evaluation) -> np.ndarray:
    """Measure gaits where they are evaluated.

    Parameters
    ----------
    name : str
        Of `measures`.
    at : Evaluation

    Returns
    -------
    ndarray, shape (n,) [the walker's units]
    """
    return measures_at([name], at)[name]


# Beside the ends of walking some measures have no value.
@np.errstate(invalid="ignore", divide="ignore", over="ignore")
def measures_at(names: Sequence[str], at: Evaluation) -> Arrays:
    """Measure gaits where they are evaluated, as `measure_at` does.

    Parameters
    ----------
    names : sequence of str
        Of `measures`.
    at : Evaluation

    Returns
    -------
    dict of ndarray, shape (n,) [the walker's units]
    """
    problem, slope = at.problem, at.problem.slopes(np.exp(at.q))
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
