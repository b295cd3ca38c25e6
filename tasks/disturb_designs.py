"""What becomes of walkers beside their long gait at one slope: attractors, and steps of the ground they survive."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from tasks.map_step import section_problem, to_section
from tasks.simulate_steps import simulate_steps
from tasks.step.problem import Lanes, sizes
from tasks.step.simulate import STRUCK, stride
from tasks.walkers.resolve import resolve

#: Relative displacement of initial states from the gait, steps that are dropped, and the longest period told apart.
_DISPLACED, _DROPPED, _MAX_PERIOD = 1e-3, 2000, 32
#: Relative change after a period up to which an orbit repeats; steps over which it must.
_REPEATS, _COMPARED = 1e-5, 64
#: Relative change over a step from which on the state no longer changes.
_AT_REST = 1e-11
#: Resolution of steps of the ground, over the leg, and how many are tried at once.
STEP_RESOLUTION, _AT_ONCE = 1e-3, 16
#: Steps after which a walker must be back at its gait, and how near, relative.
_RECOVERY, _BACK = 200, 1e-3


def attractors(problem: Lanes, y: np.ndarray, slope: float) -> list[str]:
    """Find what attracts walkers that start beside a gait.

    Parameters
    ----------
    problem : Lanes
        Of n lanes.
    y : ndarray, shape (m, n) [rad, rad/sqrt(leg/g)]
        Section coordinates of their gaits.
    slope : float [rad]

    Returns
    -------
    list of str
        `period k`, with k up to 32, `chaotic` for all that repeats less often, or `falls`.
    """
    names = ["falls"] * y.shape[1]
    y, lanes = y * (1 + _DISPLACED), np.arange(y.shape[1])
    for _ in range(_DROPPED // _COMPARED):
        y, kept = _walk(problem.some(lanes), y, slope, _COMPARED - 1, np.arange(len(lanes)))
        lanes, before = lanes[kept], y
        y, kept = _walk(problem.some(lanes), y, slope, 1, np.arange(len(lanes)))
        still = (np.abs(y - before[:, kept]) < _AT_REST * np.abs(y).max(axis=0)).all(axis=0)
        for lane in lanes[kept][still].tolist():
            names[lane] = "period 1"
        y, lanes = y[:, ~still], lanes[kept][~still]
    orbits = [y]
    for _ in range(_COMPARED + _MAX_PERIOD):
        y, kept = _walk(problem.some(lanes), y, slope, 1, np.arange(len(lanes)))
        lanes, orbits = lanes[kept], [each[:, kept] for each in orbits] + [y]
    orbit = np.array(orbits)
    for k in range(len(lanes)):
        off = [
            np.abs(orbit[p : p + _COMPARED, :, k] - orbit[:_COMPARED, :, k]).max() for p in range(1, _MAX_PERIOD + 1)
        ]
        repeats = np.flatnonzero(np.array(off) < _REPEATS * np.abs(orbit[0, :, k]).max())
        names[lanes[k]] = f"period {repeats[0] + 1}" if len(repeats) else "chaotic"
    return names


def _walk(problem: Lanes, y: np.ndarray, slope: float, steps: int, lanes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """States (m, k) after some steps of those lanes that do not fall, and their numbers (k,)."""
    for _ in range(steps):
        if not len(lanes):
            break
        result = stride(problem.some(lanes), y, np.full(len(lanes), slope), exact=False)
        walks = result.outcome == STRUCK
        y, lanes = result.image[:, walks], lanes[walks]
    return y, lanes


def largest_steps(line: Mapping[str, Any], slope: float, state: np.ndarray, limit: float) -> tuple[float, float]:
    """Find the largest steps of the ground, down and up, that a walker survives at its stable gait.

    Parameters
    ----------
    line : mapping
        `walker` and `set`.
    slope : float [rad]
    state : ndarray, shape (3,)
        Of the gait just after heelstrike: stance angle [rad], rates of stance leg and thigh in the walker's units.
    limit : float
        Largest step tried, over the leg.

    Returns
    -------
    down, up : float
        Over the leg: a thousandth less than the smallest step, in thousandths, that is not survived, or `limit`.

    Notes
    -----
    A step of the gait ends on ground that is lower or higher than its plane, and those after it on ground parallel to
    that. It is survived if after 200 steps the walker is back within a thousandth of its gait.
    """
    walker = resolve(line["walker"], line.get("set"))
    problem, time_unit = section_problem(walker), np.sqrt(walker.leg / walker.g)
    scale = np.exp2(np.floor(np.log2(state[0])))
    parameters = problem.parameters(np.array([slope]), np.array([scale]))

    def section(each: np.ndarray) -> np.ndarray:
        return to_section(problem, each * [1.0, time_unit, time_unit] / scale, parameters) * scale

    gait, most = section(state), round(limit / STEP_RESOLUTION)
    found = []
    for sign in (-1, 1):
        largest = most
        for first in range(1, most + 1, _AT_ONCE):
            tried = range(first, min(first + _AT_ONCE, most + 1))
            after = [_after(line, slope, state, sign * k * STEP_RESOLUTION * walker.leg) for k in tried]
            lanes = np.flatnonzero([each is not None for each in after])
            y = np.concatenate([section(each) for each in after if each is not None] or [np.zeros((3, 0))], axis=1)
            y, kept = _walk(problem.some(np.zeros(len(lanes), int)), y, slope, _RECOVERY - 2, np.arange(len(lanes)))
            back = (np.abs(y - gait) < _BACK * sizes(gait)).all(axis=0)
            survived = np.zeros(len(tried), bool)
            survived[lanes[kept]] = back
            if not survived.all():
                largest = first + int(np.argmin(survived)) - 1
                break
        found.append(round(largest * STEP_RESOLUTION, 9))
    return found[0], found[1]


def _after(line: Mapping[str, Any], slope: float, state: np.ndarray, height: float) -> np.ndarray | None:
    """State (3,) after a step onto ground that is higher by `height` and one more; None after a fall."""
    params = {**line, "slope": slope, "state": state, "steps": 2, "ground": {0: height}}
    result = simulate_steps(params)
    if result["steps_taken"] < 2 or not 0 < result["stance_angle"][2] < 1.2:
        return None
    return np.array([result[name][2] for name in ("stance_angle", "stance_rate", "thigh_rate")])
