"""Where walking is lost: the slope beyond which orbits from an attractor's remains fall, or settle elsewhere.

The last attractor of a cascade does not end at a fold or a flip but in a crisis: it touches the edge of its basin.
That slope has no equation of its own here; it is bracketed by strides themselves, many starts at many slopes side by
side. Starts that leave at once were not in the basin and say nothing; of those that stay, at a bracket's lower slope
all walk on to the end, at its upper slope some do not.
"""

from __future__ import annotations

import numpy as np

from tasks.step.problem import Problem
from tasks.step.simulate import STRUCK, stride

#: An orbit whose last stride changes it by less than this has settled on a gait of period one.
SETTLED = 1e-8
#: Strides in which a start may leave without its slope being given up.
TRANSIENT = 60


def surviving_slopes(problem: Problem, starts: np.ndarray, slope: np.ndarray, strides: int) -> np.ndarray:
    """Slopes at which the starts that outlast the transient all walk on, on no gait of period one; shape (n,).

    Parameters
    ----------
    starts : ndarray, shape (m, k)
        Section coordinates [rad, rad/sqrt(leg/g)], the same at every slope.
    slope : ndarray, shape (n,) [rad]
    strides : int
        After the transient.
    """
    number = np.repeat(np.arange(len(slope)), starts.shape[1])
    y, last = np.tile(starts, (1, len(slope))), np.ones(len(slope), bool)
    for k in range(TRANSIENT + strides):
        now = stride(problem, y, slope[number], exact=False)
        stays = now.outcome == STRUCK
        if k == TRANSIENT + strides - 1:
            stays[stays] = np.abs(now.image - y)[:, stays].max(axis=0) > SETTLED
        if k >= TRANSIENT:
            # From here one start decides for its slope.
            last[number[~stays]] = False
            stays = last[number]
        y, number = now.image[:, stays], number[stays]
        if not len(number):
            break
    last[np.setdiff1d(np.arange(len(slope)), number)] = False
    return last


def lost(
    problem: Problem, starts: np.ndarray, low: float, high: float, strides: int, at_once: int = 4, rounds: int = 3
) -> tuple[float, float]:
    """The slopes between which an attractor is lost.

    Parameters
    ----------
    starts : ndarray, shape (m, k)
        On the attractor at `low`.
    low, high : float [rad]
        The bracket to begin with, cut into `at_once` + 1 parts each of the `rounds`.

    Returns
    -------
    low, high
        Neighbours of the last round. NaN for `low` where the starts do not last there either, and for `high` where
        nothing is lost.
    """
    ends = surviving_slopes(problem, starts, np.array([low, high]), strides)
    if not ends[0]:
        return np.nan, low
    if ends[1]:
        return high, np.nan
    for _ in range(rounds):
        slope = np.linspace(low, high, at_once + 2)
        last = np.append(surviving_slopes(problem, starts, slope[1:-1], strides), False)
        k = int(np.argmin(last))
        low, high = float(slope[k]), float(slope[k + 1])
    return low, high
