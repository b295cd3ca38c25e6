"""Values of measures as conditions on gaits: a gait of a given speed, clearance or cost
is a point where the measure has that value.
"""

from __future__ import annotations

import numpy as np

from gaitsweep.tasks.branches.conditions import Condition
from gaitsweep.tasks.branches.joint import Evaluation
from gaitsweep.tasks.contract.registry import VARIABLES
from gaitsweep.tasks.measures.gaits import Steps, of_all_steps
from gaitsweep.tasks.measures.kinematics import TRAVEL, travel
from gaitsweep.tasks.step.several_steps import side_by_side

#: Variables that say how well a gait is known, not what it is.
_OF_THE_SOLVE = (
    "residual",
    "error_bound",
    "multiplier_error_bound",
    "energy_imbalance",
)
#: Measured of the step map's derivative.
_RADIUS = "spectral_radius"


def measures(knees: bool) -> list[str]:
    """Return the names of the measures whose value may be asked for.

    Parameters
    ----------
    knees : bool
        Whether the walker has them.
    """
    return [
        name
        for name, about in VARIABLES.items()
        if about.dims == ("gait",)
        and about.dtype == "f8"
        and about.group != "proofs"
        and name not in _OF_THE_SOLVE
        and (knees or not about.is_of_knees)
    ]


def level(name: str, value: float) -> Condition:
    """Return the condition that a measure has a value.

    Parameters
    ----------
    name : str
        Of `measures`.
    value : float
        In the walker's units.
    """

    def measured(at: Evaluation) -> np.ndarray:
        return measure_at(name, at)

    return Condition("level", measured, target=value)


# Beside the ends of walking some measures have no value.
@np.errstate(invalid="ignore", divide="ignore", over="ignore")
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
    if name == _RADIUS:
        return np.abs(at.multipliers).max(axis=1)
    problem, slope = at.problem, np.exp(at.q)
    needed = ["step_length", "period"] if name in TRAVEL else [name]
    of_steps = _steps_at(at).measure(needed)
    measured = of_all_steps(of_steps, problem.steps)
    if name in TRAVEL:
        length, period = measured["step_length"], measured["period"]
        walkers = problem.every_walker
        measured |= travel(walkers, slope, length, period, problem.steps)
    return np.asarray(measured[name], float)


def _steps_at(at: Evaluation) -> Steps:
    """The single steps of evaluated gaits: the first steps of all, then the second
    ones.
    """
    problem, s, n = at.problem, at.problem.steps, at.Z.shape[1]
    single = problem.of_steps(1)
    if s > 1:
        single = single.some(np.tile(np.arange(n), s))
    scale = np.tile(problem.section(at.w)[1], s)
    slope = np.tile(np.exp(at.q), s)
    y = side_by_side(at.stride.y, s)
    parameters = single.parameters(slope, scale)
    state = problem.step.start(y, parameters)[: problem.step.start_size]

    ends = at.times.reshape(s, -1, n)[:, -1]
    begins = np.vstack([np.zeros((1, n)), ends[:-1]]).ravel()
    times = side_by_side(at.times, s) - begins
    after = np.roll(np.arange(s * n), -n)
    return Steps(
        single,
        single.every_walker,
        at.stride.singles,
        y * scale,
        state * scale,
        times,
        scale,
        slope,
        after,
    )
