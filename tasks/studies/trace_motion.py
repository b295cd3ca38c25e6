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
    parts: list[tuple[Any, ...]] = []
    slope = np.unique(np.asarray(params["slope"], float))
    slope = slope[
        np.unique(np.linspace(0, len(slope) - 1, MAX_SLOPES).round().astype(int))
    ]
    wanted = [GAITS.index(label) for label in params.get("gaits") or GAITS]
    for index, place, at in labelled(problem, atlases.from_arrays(inputs[0]), slope):
        stride = problem.map(
            at.y, at.times, problem.parameters(slope[index], at.scale), samples=SAMPLES
        )
        for lane in np.flatnonzero(np.isin(place, wanted)).tolist():
            times, angles = _cycle(stride.one.motion, at.times[:, lane], lane)
            a, b, c = angles * at.scale[lane]
            parts.append(
                (
                    GAITS[place[lane]],
                    slope[index[lane]],
                    times * walker.time_unit,
                    a,
                    b,
                    c,
                    -walker.R * a,
                )
            )

    return stacked("trace", parts, COLUMNS)


def _cycle(
    motion: list[np.ndarray], ends: np.ndarray, lane: int
) -> tuple[np.ndarray, np.ndarray]:
    """Times, shape (n,), and the three angles, shape (3, n), of one lane over its step."""
    times, angles, begin = [], [], 0.0
    for phase, end in zip(motion, ends, strict=True):
        times.append(np.linspace(begin, end, len(phase)))
        is_knee_free = phase.shape[1] == 6
        angles.append(phase[:, [0, 1, 2 if is_knee_free else 1], lane].T)
        begin = end
    return np.concatenate(times), np.concatenate(angles, axis=1)
