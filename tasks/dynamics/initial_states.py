"""Where orbits begin: a line's gaits at given slopes, and low-discrepancy points to scatter starts with."""

from __future__ import annotations

import numpy as np

from tasks.continuation.branch import Branch
from tasks.fixed_points.labels import places
from tasks.fixed_points.newton import newton_step
from tasks.fixed_points.step_check import gait_ratio
from tasks.registry import GAITS
from tasks.step.problem import Problem

#: Generalised golden ratios: the roots of x^(m + 1) = x + 1, by the dimension m.
_RATIO = {2: 1.32471795724474602596, 3: 1.22074408460575947536}


def r_sequence(m: int, count: int) -> np.ndarray:
    """Points that fill the unit cube evenly, always the same, shape (m, count).

    Notes
    -----
    The additive recurrence of the generalised golden ratio's powers: the first points of a longer sequence are the
    shorter one's.
    """
    steps = np.array([_RATIO[m] ** -(i + 1) for i in range(m)])
    return (0.5 + steps[:, None] * np.arange(1, count + 1)) % 1


def gaits_at(problem: Problem, branches: list[Branch], slope: np.ndarray, label: str) -> tuple[np.ndarray, np.ndarray]:
    """A line's gaits of one label at given slopes.

    Returns
    -------
    index : ndarray of int
        Slopes that have one, rising.
    y : ndarray, shape (m, len(index))
        Their section coordinates [rad, rad/sqrt(leg/g)].
    """
    m, n = problem.m, len(slope)
    # ln angle, ratio of rates and section of every piece's gaits, a row a piece.
    angle, ratio, sections = np.zeros((0, n)), np.zeros((0, n)), np.zeros((0, m, n))
    for branch in branches:
        for index, Z, segment in branch.guesses(np.log(slope)):
            once = branch.leg_passes[segment] == 1
            if not once.any():
                continue
            index, w = index[once], np.delete(Z[once], m, axis=1).T
            for _ in range(3):
                at, _ = problem.stride(w, np.log(slope[index]))
                w = w + newton_step(at, w)
            row = np.full((m + 2, n), np.nan)
            row[:, index] = np.vstack([w[:1], gait_ratio(at)[None], np.exp(w[:1]), np.exp(w[0]) * w[1:m]])
            angle, ratio = np.vstack([angle, row[:1]]), np.vstack([ratio, row[1:2]])
            sections = np.concatenate([sections, row[None, 2:]])
    index, row = np.nonzero((places(angle, ratio) == GAITS.index(label)).T)
    return index, sections[row, :, index].T
