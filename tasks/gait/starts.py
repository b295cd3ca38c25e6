"""Where orbits begin: a line's gaits at given slopes, and low-discrepancy points to scatter starts with."""

from __future__ import annotations

import numpy as np

from tasks.gait.branch import Branch
from tasks.gait.fixed_point import Problem, gait_ratio, newton_step

#: Generalised golden ratios: the roots of x^(m + 1) = x + 1, by the dimension m.
_RATIO = {2: 1.32471795724474602596, 3: 1.22074408460575947536}


def scattered(m: int, count: int) -> np.ndarray:
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
    m = problem.m
    found: dict[int, np.ndarray] = {}
    for branch in branches:
        for index, Z, _ in branch.guesses(np.log(slope)):
            w, q = np.delete(Z, m, axis=1).T, np.log(slope[index])
            for _ in range(3):
                at, _ = problem.stride(w, q)
                w = w + newton_step(at, w)
            wanted = (gait_ratio(at) < 0.5) == (label == "long")
            y = np.vstack([np.exp(w[0]), np.exp(w[0]) * w[1:m]])
            for lane in np.nonzero(wanted & np.isfinite(y).all(axis=0))[0]:
                found.setdefault(int(index[lane]), y[:, lane])
    index = np.array(sorted(found), int)
    return index, np.array([found[i] for i in index]).T.reshape(m, len(index))
