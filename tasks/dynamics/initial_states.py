"""Initial states of orbits: a line's gaits at given slopes, and a low-discrepancy sequence to distribute states."""

from __future__ import annotations

import numpy as np

from tasks.continuation.branch import Branch
from tasks.fixed_points.labels import places
from tasks.fixed_points.newton import newton_step
from tasks.fixed_points.step_check import gait_ratio
from tasks.registry import GAITS
from tasks.step.problem import Problem

#: Generalised golden ratios: the roots of x^(m + 1) = x + 1, by the dimension m.
_GOLDEN_RATIO = {2: 1.32471795724474602596, 3: 1.22074408460575947536}


def r_sequence(m: int, count: int) -> np.ndarray:
    """Return the first points of a low-discrepancy sequence in the unit cube.

    Returns
    -------
    ndarray, shape (m, count)

    Notes
    -----
    The R sequence, an additive recurrence by powers of the generalised golden ratio (M. Roberts, "The unreasonable
    effectiveness of quasirandom sequences", 2018). A longer sequence begins with the shorter one.
    """
    steps = np.array([_GOLDEN_RATIO[m] ** -(i + 1) for i in range(m)])
    return (0.5 + steps[:, None] * np.arange(1, count + 1)) % 1


def gaits_at(problem: Problem, branches: list[Branch], slope: np.ndarray, label: str) -> tuple[np.ndarray, np.ndarray]:
    """Find a line's gaits of one label at given slopes.

    Parameters
    ----------
    branches : list of Branch
        The line's atlas.
    slope : ndarray, shape (n,) [rad]
    label : str
        Of GAITS.

    Returns
    -------
    index : ndarray of int, shape (k,)
        Indices of the slopes that have one, rising.
    y : ndarray, shape (m, k) [rad, rad/sqrt(leg/g)]
        Their section coordinates.
    """
    m, n = problem.m, len(slope)
    # ln angle, ratio of rates and section of the gaits, a row for each piece of a branch.
    angle, ratio, sections = np.zeros((0, n)), np.zeros((0, n)), np.zeros((0, m, n))
    for branch in branches:
        for index, Z, segment in branch.guesses(np.log(slope)):
            passes_once = branch.leg_passes[segment] == 1
            if not passes_once.any():
                continue
            index, w = index[passes_once], np.delete(Z[passes_once], m, axis=1).T
            for _ in range(3):
                stride, _ = problem.stride(w, np.log(slope[index]))
                w = w + newton_step(stride, w)
            piece = np.full((m + 2, n), np.nan)
            piece[:, index] = np.vstack([w[:1], gait_ratio(stride)[None], np.exp(w[:1]), np.exp(w[0]) * w[1:m]])
            angle, ratio = np.vstack([angle, piece[:1]]), np.vstack([ratio, piece[1:2]])
            sections = np.concatenate([sections, piece[None, 2:]])
    index, row = np.nonzero((places(angle, ratio) == GAITS.index(label)).T)
    return index, sections[row, :, index].T
