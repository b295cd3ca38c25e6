"""The motion of gaits over one step, sampled for drawing."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from tasks.gait import atlas as atlases
from tasks.gait.fixed_point import Problem, gait_ratio, newton_step
from tasks.registry import GAITS
from tasks.walkers.parameters import resolve

#: Intervals each phase is drawn in.
SAMPLES = 48
#: Slopes of a line that are drawn, spread over those of the study.
MOST_SLOPES = 6


def trace(params: Mapping[str, Any], inputs: list[dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """Joint coordinates of every gait of a line at a few of the given slopes.

    Parameters
    ----------
    params : mapping
        `line`, `slope` (n,), `gaits`.
    inputs : list
        The line's atlas.

    Returns
    -------
    dict
        Table `trace`: gait, slope, time, theta_st, theta_th, theta_sh and foot_x (of the stance foot's centre from
        its place at angle zero), in the walker's units.
    """
    walker = resolve(params["line"]["walker"], params["line"].get("set"))
    problem = Problem(walker)
    wanted = set(params.get("gaits") or GAITS)
    second = np.sqrt(walker.leg / walker.g)
    columns: dict[str, list[np.ndarray]] = {k: [] for k in (
        "gait", "slope", "time", "theta_st", "theta_th", "theta_sh", "foot_x")}
    slope = np.unique(np.asarray(params["slope"], float))
    slope = slope[np.unique(np.linspace(0, len(slope) - 1, MOST_SLOPES).round().astype(int))]
    for branch in atlases.from_arrays(inputs[0]):
        for index, Z, _ in branch.guesses(np.log(slope)):
            w, q = np.delete(Z, problem.m, axis=1).T, np.log(slope[index])
            for _ in range(2):
                stride, _ = problem.stride(w, q)
                w = w + newton_step(stride, w)
            stride, scale = problem.stride(w, q, samples=SAMPLES)
            assert stride.motion is not None
            for lane in range(len(index)):
                gait = GAITS[int(not gait_ratio(stride)[lane] < 0.5)]
                if gait not in wanted:
                    continue
                times, angles = _cycle(stride.motion, stride.times[:, lane], lane)
                a, b, c = angles * scale[lane]
                n = len(times)
                for key, value in (("gait", np.full(n, gait)), ("slope", np.full(n, slope[index[lane]])),
                                   ("time", times * second), ("theta_st", a), ("theta_th", b), ("theta_sh", c),
                                   ("foot_x", -walker.R * a)):
                    columns[key].append(value)
    return {f"trace/{k}": np.concatenate(v) if v else np.zeros(0) for k, v in columns.items()}


def _cycle(motion: list[np.ndarray], ends: np.ndarray, lane: int) -> tuple[np.ndarray, np.ndarray]:
    """Times and the three angles of one lane over its step."""
    times, angles, begin = [], [], 0.0
    for phase, end in zip(motion, ends):
        times.append(np.linspace(begin, end, len(phase)))
        free = phase.shape[1] == 6
        angles.append(phase[:, [0, 1, 2 if free else 1], lane].T)
        begin = end
    return np.concatenate(times), np.concatenate(angles, axis=1)
