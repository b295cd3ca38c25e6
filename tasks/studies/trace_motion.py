"""The task `trace`: the motion of gaits over one step, sampled for drawing."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from gaitsweep.tasks.branches import atlas as atlases
from gaitsweep.tasks.contract.registry import GAITS
from gaitsweep.tasks.contract.tables import stacked
from gaitsweep.tasks.orbits.initial_states import labelled
from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.walkers.resolve import walker_of_line
from gaitsweep.tasks.walkers.walker import Walker

#: Intervals of each phase.
SAMPLES = 48
#: Largest number of slopes of a line that are drawn, spread over those of the study.
MAX_SLOPES = 6
COLUMNS = ("gait", "slope", "time", "theta_st", "theta_th", "theta_sh", "foot_x")


def trace(
    params: Mapping[str, Any], inputs: list[dict[str, np.ndarray]]
) -> dict[str, np.ndarray]:
    """Compute joint coordinates of every gait of a line at a few of the given slopes,
    with the labels of `points`.

    Parameters
    ----------
    params : mapping
        `line`; `slope`, ndarray, shape (n,) [rad]; `gaits`, labels wanted.
    inputs : list
        The line's atlas.

    Returns
    -------
    dict
        Table `trace`: gait, slope, time, theta_st, theta_th, theta_sh [rad] and foot_x
        (stance foot's centre from its position at angle zero), in the walker's units.
    """
    walker = walker_of_line(params["line"])
    problem = Problem(walker)
    branches = atlases.from_arrays(inputs[0])
    slope = _evenly_chosen(np.asarray(params["slope"], float))
    wanted = [GAITS.index(label) for label in params.get("gaits") or GAITS]
    parts: list[tuple[Any, ...]] = []
    for index, place, at in labelled(problem, branches, slope):
        parameters = problem.parameters(slope[index], at.scale)
        stride = problem.map(at.y, at.times, parameters, samples=SAMPLES)
        for lane in np.flatnonzero(np.isin(place, wanted)).tolist():
            label = GAITS[place[lane]]
            at_slope = slope[index[lane]]
            ends = at.times[:, lane]
            times, scaled = _cycle(stride.one.motion, ends, lane)
            drawn = _in_units(walker, times, scaled * at.scale[lane])
            parts.append((label, at_slope, *drawn))

    return stacked("trace", parts, COLUMNS)


def _in_units(
    walker: Walker, times: np.ndarray, angles: np.ndarray
) -> tuple[np.ndarray, ...]:
    """Times (n,), three angles and the place of the foot, in the walker's units, by times
    in the solver's and angles (3, n).
    """
    stance, thigh, shank = angles
    foot = -walker.R * stance
    return times * walker.time_unit, stance, thigh, shank, foot


def _evenly_chosen(slope: np.ndarray) -> np.ndarray:
    """The slopes that are drawn, of all (n,)."""
    slope = np.unique(slope)
    places = np.linspace(0, len(slope) - 1, MAX_SLOPES)
    return slope[np.unique(places.round().astype(int))]


def _cycle(
    motion: list[np.ndarray], ends: np.ndarray, lane: int
) -> tuple[np.ndarray, np.ndarray]:
    """Times, shape (n,), and the three angles, shape (3, n), of one lane over its step."""
    times = []
    angles = []
    begin = 0.0
    for phase, end in zip(motion, ends, strict=True):
        times.append(np.linspace(begin, end, len(phase)))
        links = phase.shape[1] // 2
        # The shank of a locked knee turns with the thigh.
        shank = links - 1
        of_lane = phase[:, [0, 1, shank], lane]
        angles.append(of_lane.T)
        begin = end

    return np.concatenate(times), np.concatenate(angles, axis=1)
