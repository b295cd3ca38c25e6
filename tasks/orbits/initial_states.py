"""Initial states of orbits: a line's gaits at given slopes, and a low-discrepancy
sequence to distribute states.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy import ndarray

from gaitsweep.tasks.branches.branch import Branch
from gaitsweep.tasks.branches.settling import settle_on_branches
from gaitsweep.tasks.contract.registry import GAITS
from gaitsweep.tasks.gaits.labels import places
from gaitsweep.tasks.gaits.polish import Polished
from gaitsweep.tasks.gaits.step_check import gait_ratio
from gaitsweep.tasks.step.lanes import join_lanes, lanes_of, slices
from gaitsweep.tasks.step.problem import Problem

#: What is said of a slope without a gait that was found and verified.
NO_START = "no gait to start from"
#: Generalised golden ratios: the roots of x^(m + 1) = x + 1, by the dimension m.
_GOLDEN_RATIO = {2: 1.32471795724474602596, 3: 1.22074408460575947536}


def r_sequence(m: int, count: int) -> ndarray:
    """Return the first points of a low-discrepancy sequence in the unit cube.

    Returns
    -------
    ndarray, shape (m, count)

    Notes
    -----
    The R sequence, an additive recurrence by powers of the generalised golden ratio (M. Roberts, "The unreasonable
    effectiveness of quasirandom sequences", 2018). A longer sequence begins with the
    shorter one.
    """
    steps = np.array([_GOLDEN_RATIO[m] ** -(i + 1) for i in range(m)])
    return (0.5 + steps[:, None] * np.arange(1, count + 1)) % 1


def labelled(
    problem: Problem,
    branches: list[Branch],
    slope: ndarray,
) -> list[tuple[ndarray, ndarray, Polished]]:
    """Find a line's gaits at given slopes, piece by piece.

    Parameters
    ----------
    branches : list of Branch
        The line's atlas.
    slope : ndarray, shape (n,) [rad]

    Returns
    -------
    list of (index, place, gaits)
        Of each piece of a branch the indices of the slopes that it covers; the labels
        of the gaits there as `places` has them, -1 where none was found and verified to
        be a step; and these gaits.
    """
    found = []
    keys = []
    for branch, index, Z, segment, at in _settled(problem, branches, slope):
        found.append((index, at.converged & at.step, at))
        key = np.full((2, len(slope)), np.nan)
        key[:, index] = _angles_and_ratios(at, Z, branch.ratio_on(segment))
        keys.append(key)

    angles, ratios = np.reshape(keys, (-1, 2, len(slope))).swapaxes(0, 1)
    parts = []
    for place, part in zip(places(angles, ratios), found, strict=True):
        index, verified, at = part
        parts.append((index, np.where(verified, place[index], -1), at))

    return parts


def _settled(
    problem: Problem, branches: list[Branch], slope: ndarray
) -> Iterator[tuple[Branch, ndarray, ndarray, ndarray, Polished]]:
    """Of each piece of a branch the indices of the slopes that it covers, its points
    there, their segments, and the gaits settled from these, all side by side.
    """
    pieces = []
    guesses = []
    for branch in branches:
        for index, Z, segment in branch.guesses(np.log(slope)):
            pieces.append((branch, index, Z, segment))
            guesses.append(branch.known_guesses(Z, segment, slope[index]))

    if not pieces:
        return

    spots = [(problem, branch, segment) for branch, *_, segment in pieces]
    settled = settle_on_branches(problem, join_lanes(guesses), spots)
    lanes = slices([len(index) for _, index, *_ in pieces])
    for piece, some in zip(pieces, lanes, strict=True):
        yield *piece, lanes_of(settled, some)


def _angles_and_ratios(at: Polished, Z: ndarray, ratio: ndarray) -> ndarray:
    """What labels gaits, shape (2, k), by their branch's points (c, k) and ratios (k,).

    As in `points`, one that is lost still counts for the labels of the others, as its
    branch's gait.
    """
    is_anthropomorphic = ~at.step | (at.leg_passes == 1)
    verified = at.converged & at.step
    return np.stack(
        [
            np.where(is_anthropomorphic, Z[0], np.nan),
            np.where(verified, gait_ratio(at.stride), ratio),
        ]
    )


def gaits_at(
    problem: Problem,
    branches: list[Branch],
    slope: ndarray,
    label: str,
) -> tuple[ndarray, ndarray]:
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
    sections = np.full((problem.m, len(slope)), np.nan)
    for index, place, at in labelled(problem, branches, slope):
        is_labelled = place == GAITS.index(label)
        sections[:, index[is_labelled]] = (at.y * at.scale)[:, is_labelled]

    known = np.flatnonzero(np.isfinite(sections).all(axis=0))
    return known, sections[:, known]
