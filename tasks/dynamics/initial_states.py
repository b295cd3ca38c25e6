"""Initial states of orbits: a line's gaits at given slopes, and a low-discrepancy sequence to distribute states."""

from __future__ import annotations

import numpy as np

from gaitsweep.tasks.continuation.branch import Branch
from gaitsweep.tasks.continuation.locate import settle_on_branches
from gaitsweep.tasks.fixed_points.labels import places
from gaitsweep.tasks.fixed_points.step_check import gait_ratio
from gaitsweep.tasks.registry import GAITS
from gaitsweep.tasks.step.problem import Problem

#: What is said of a slope without a gait that was found and verified.
NO_START = "no gait to start from"
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
        Indices of the slopes at which one was found and verified to be a step, rising.
    y : ndarray, shape (m, k) [rad, rad/sqrt(leg/g)]
        Their section coordinates.
    """
    # Of each piece of a branch ln angle, ratio of rates and section of the gaits.
    pieces: list[np.ndarray] = []
    for branch in branches:
        for index, Z, segment in branch.guesses(np.log(slope)):
            at = settle_on_branches(
                problem, branch.known_guesses(Z, segment, slope[index]), [(problem, branch, segment)]
            )
            converged = at.converged & at.step
            # As in `points`, one that is lost still counts for the labels of the others, as its branch's gait.
            nodes = 0.5 * (branch.ratio[segment] + branch.ratio[segment + 1])
            piece = np.full((problem.m + 2, len(slope)), np.nan)
            piece[0, index] = np.where(~at.step | (at.leg_passes == 1), Z[0], np.nan)
            piece[1, index] = np.where(converged, gait_ratio(at.stride), nodes)
            piece[2:, index] = np.where(converged, at.y * at.scale, np.nan)
            pieces.append(piece)
    angle, ratio, sections = np.split(np.array(pieces).reshape(len(pieces), problem.m + 2, len(slope)), [1, 2], axis=1)
    has_label = (places(angle[:, 0], ratio[:, 0]) == GAITS.index(label)) & np.isfinite(sections).all(axis=1)
    index, row = np.nonzero(has_label.T)
    return index, sections[row, :, index].T
