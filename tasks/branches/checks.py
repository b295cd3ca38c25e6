"""Checks of whole branches, besides those of order and orientation: lengths, held-out
points, folds and ends.

All are procedures, which run side by side (`tasks.branches.lockstep`).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy import ndarray

from gaitsweep.tasks.branches.branch import Branch
from gaitsweep.tasks.branches.conditions import CONDITIONS
from gaitsweep.tasks.branches.lockstep import Call, Procedure
from gaitsweep.tasks.branches.pseudo_arclength import NO_FURTHER
from gaitsweep.tasks.branches.tracking import ONE_STEP, correct
from gaitsweep.tasks.mechanics.arrays import Gait, Numbers
from gaitsweep.tasks.mechanics.sums import norm, total
from gaitsweep.tasks.step.lanes import lanes_of

#: Least length of a chord over that of the polynomial between two nodes, and parts in
#: which that is measured.
_MIN_CHORD, _PARTS = 0.5, 8
#: Segments of a branch whose polynomial is compared with a newly solved point, and
#: where on them.
_HELD_OUT, _PLACE = 8, 0.382
#: Share of the chord by which such a point may move, and the distance that may be
#: rounding.
_MAX_MOVE, _ROUNDING = 1e-2, 1e-7
#: Rounds in which segments that fail are split.
_MAX_ROUNDS = 4
#: Largest value of an end's own condition at its node.
_MAX_END = 1e-4
_GOLDEN = (np.sqrt(5) - 1) / 2


def checked(branch: Branch, gait: Gait) -> Procedure[Branch]:
    """Check a branch as a whole; split the segments that fail, and cut it where that
    does not help.

    Parameters
    ----------
    gait : ndarray, shape (c,)
        Where the branch began: of a branch that is cut the part with it remains.

    Returns
    -------
    Branch
        Of which every segment is at most twice as long as its chord, held-out points
        lie where the polynomials are, and the slope turns at folds alone. Where it was
        cut, and at a false end, there is NO_FURTHER.
    """
    if len(branch.q) == 1:
        return branch

    for _ in range(_MAX_ROUNDS):
        failing = yield from _failing(branch)
        if not failing.any():
            break
        split = yield from _split(branch, np.flatnonzero(failing))
        if len(split.q) == len(branch.q):
            break
        branch = split
    else:
        failing = yield from _failing(branch)

    if failing.any():
        branch = branch.part_of(gait, np.flatnonzero(failing))
    if len(branch.q) > 1:
        branch = yield from _with_consistent_ends(branch)
    return branch


def _split(branch: Branch, segments: Numbers) -> Procedure[Branch]:
    """The branch with nodes in the middles of segments, predicted by their own two
    nodes, where they lie on them.
    """
    middle = np.array([0.5])
    middles = []
    for segment in segments:
        alone = branch.part(np.array([segment, segment + 1]))
        middles.append(alone.at(middle))

    Z = np.hstack(middles)
    border = branch.between(segments)
    point = yield Call(correct, (Z, border))
    kept = point.ok & branch.lies_between(segments, point.Z)
    new = lanes_of(point.oriented(border), kept)
    return branch.with_points(segments[kept], new)


def _failing(branch: Branch) -> Procedure[ndarray]:
    """Which segments fail, shape (n - 1,)."""
    n = len(branch.q) - 1
    failing = _too_long(branch)
    for fold in branch.turns():
        # A node at which the slope turns is a fold: it falls on one side and rises on
        # the other.
        sides = branch.tangent[-1, [fold - 1, fold + 1]]
        failing[[fold - 1, fold]] |= sides.prod() > 0

    spread = _GOLDEN * np.arange(1, _HELD_OUT + 1) % 1
    held_out = np.unique((n * spread).astype(int))
    Z = branch.at(held_out + _PLACE)
    point = yield Call(correct, (Z, branch.between(held_out)))
    moved = norm(point.Z - Z)
    chord = norm(np.diff(branch.Z))
    allowed = np.maximum(_MAX_MOVE * chord[held_out], _ROUNDING)
    failing[held_out] |= ~(point.ok & (moved < allowed))
    # Nodes this close leave no room for another.
    failing[chord < _ROUNDING] = False
    return failing


def _too_long(branch: Branch) -> ndarray:
    """Which segments' polynomials are more than twice as long as their chords, shape (n
    - 1,).
    """
    Z = branch.Z
    n = len(branch.q) - 1
    shares = np.arange(1, _PARTS) / _PARTS
    place = np.arange(n)[:, None] + shares
    inner = branch.at(place.ravel()).reshape(len(Z), n, -1)
    ends = Z[:, :, None]
    points = np.concatenate([ends[:, :-1], inner, ends[:, 1:]], axis=2)
    length = total(norm(np.diff(points)).T)
    chord = norm(np.diff(Z))
    return np.asarray(~(chord >= _MIN_CHORD * length))


def _with_consistent_ends(branch: Branch) -> Procedure[Branch]:
    """The branch; ends whose own condition fails become NO_FURTHER."""
    Z = branch.Z[:, [0, -1]]
    direction = branch.direction[:, [0, -1]]
    point = yield Call(correct, (Z, direction), ONE_STEP)
    at_ends = replace(point.at, Z=Z)
    for side, kind in enumerate(branch.why):
        condition = CONDITIONS.get(kind)
        if condition is None or not condition.is_met_at_end:
            continue
        if not abs(condition.residual(at_ends)[side]) < _MAX_END:
            branch = branch.ending(side, NO_FURTHER, branch.end_errors[side])

    return branch
