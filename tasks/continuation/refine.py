"""Nodes between those that following a branch gave, what is measured at them, and
checks of the whole branch.

All are procedures, which run side by side (`tasks.continuation.lockstep`).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from gaitsweep.tasks.continuation.branch import Branch
from gaitsweep.tasks.continuation.joint import but_times
from gaitsweep.tasks.continuation.locate import sampled_steps
from gaitsweep.tasks.continuation.lockstep import Call, Procedure
from gaitsweep.tasks.continuation.tracking import (
    MAX_CROSSING_STEP,
    branch_point_determinant,
    check_steps,
    correct,
)
from gaitsweep.tasks.fixed_points.newton import curvature
from gaitsweep.tasks.fixed_points.polish import not_measured
from gaitsweep.tasks.fixed_points.rounding import rounding, rounding_std
from gaitsweep.tasks.fixed_points.step_check import gait_ratio
from gaitsweep.tasks.mechanics.sums import norm
from gaitsweep.tasks.step.several_steps import AnyStride
from gaitsweep.tasks.step.step_map import SAMPLES
from gaitsweep.tasks.step.verify_step import StepCheck, verify

#: Largest change Newton may still make at a segment's middle before the segment is
#: split: in a fine atlas points take one step each, and what their bounds need is
#: measured at the nodes; in a coarse one, for few points, at each of them.
FINE, COARSE = 2e-13, 1e-6


#: Beside a fold two gaits must be distinguished: share of the distance in ln slope by
#: which a middle may move.
_FOLD_SHARE = 1e-3
_MAX_ROUNDS = 5


#: A change below this multiple of the estimated rounding is rounding; with 8, branches
#: have up to 2 % fewer nodes.
_ROUNDING_MARGIN = 7
#: A split that leaves more than this share of the change may show rounding: one more is
#: tried, and no other.
_MIN_IMPROVEMENT = 0.25


#: Nodes on either side over which a segment's measured rounding is averaged.
_ROUNDING_WINDOW = 4


def _refine(
    branch: Branch, segments: np.ndarray, before: np.ndarray, tolerance: float
) -> Procedure[tuple[Branch, np.ndarray, np.ndarray]]:
    """Correct the middles of some segments and split those that moved.

    `before` (n - 1,) is how far the middle of the segment moved from which each was
    split, 0 where it is split for the last time. Returned are the branch, its segments
    that changed, and `before` for all segments.
    """
    m, x = branch.m, branch.ends_of(segments).mean(axis=0)
    # Near a singular node the polynomial may lead anywhere.
    a, b = branch.Z[:, segments], branch.Z[:, segments + 1]
    apart = np.abs(b - a).max(axis=0)
    Z = np.clip(
        branch.evaluate(segments, x), np.minimum(a, b) - apart, np.maximum(a, b) + apart
    )
    border = branch.between(segments)
    point = yield Call(correct, (Z, border))
    # Newton may have jumped to another branch: a middle that is not between its
    # neighbours is discarded.
    ok = point.ok & branch.lies_between(segments, point.Z)
    off = np.abs(point.Z - Z)
    moved, late = off[but_times(m)].max(axis=0), off[m:-1].max(axis=0)
    # Event times need only lead to their own roots of the guards.
    moved = np.where(
        ok, np.where(late > COARSE, np.maximum(moved, late), moved), np.inf
    )
    new = point.oriented(border)
    # Below the rounding of the fixed point no split helps: by estimate, or because the
    # last split did not.
    allowed = np.clip(
        _FOLD_SHARE * branch.distance_from_fold()[segments], FINE, tolerance
    )
    keep = ok & (
        moved
        > np.maximum(allowed, _ROUNDING_MARGIN * rounding(point.at.stride).max(axis=0))
    )
    keep &= before[segments] > 0
    at = segments[keep] + 1
    moved_from = np.where(moved < _MIN_IMPROVEMENT * before[segments], moved, 0.0)[keep]
    before[segments[keep]] = moved_from
    before = np.insert(before, at, moved_from)
    is_new = np.insert(np.zeros(len(branch.q), bool), at, True)
    branch = branch.insert(at, new.Z[:, keep], new.direction[:, keep])
    return branch, np.nonzero(is_new[branch.window].any(axis=0))[0], before


def densify(branch: Branch, tolerance: float) -> Procedure[Branch]:
    """Add nodes until Newton moves the middles of segments by less than the tolerance,
    or than rounding.
    """
    segments = np.arange(len(branch.q) - 1)
    before = np.full(len(segments), np.inf)
    for _ in range(_MAX_ROUNDS):
        branch, segments, before = yield from _refine(
            branch, segments, before, tolerance
        )
        if not len(segments):
            break
    return branch


def without_jumps(branch: Branch, gait: np.ndarray) -> Procedure[Branch]:
    """Check the branch as a whole: where Newton jumped to another branch, only the part
    that has a gait is kept.

    Parameters
    ----------
    gait : ndarray, shape (c,)
        Where the branch began.
    """
    border = branch.direction
    point = yield Call(correct, (branch.Z, border), (("max_iterations", 1),))
    side = np.sign(branch_point_determinant(point, border))
    jumps = (side[1:] * side[:-1] < 0) & (norm(np.diff(branch.Z)) > MAX_CROSSING_STEP)
    jumps[[0, -1]] &= np.array(branch.why) != "branch_point"
    return branch.part_of(gait, np.flatnonzero(jumps)) if jumps.any() else branch


def locate_gaps(
    branch: Branch, distance: np.ndarray, check: StepCheck
) -> Procedure[list[float]]:
    """Places of a branch, segment plus fraction, where an earlier strike occurs between
    nodes that are steps.

    Parameters
    ----------
    distance : ndarray, shape (n,)
        Distances of the nodes from an earlier strike.
    check : StepCheck
        Of the nodes: `measure`.
    """
    with np.errstate(invalid="ignore"):
        bend = distance[:-2] - 2 * distance[1:-1] + distance[2:]
        distance = np.where(check.step, distance, np.nan)
        inner = distance[1:-1]
        least = (inner <= distance[:-2]) & (inner <= distance[2:]) & ~(inner > bend)
    near = (
        np.nonzero(
            least & np.isfinite(inner) & ~(branch.safe[:-2] & branch.safe[1:-1])
        )[0]
        + 1
    )
    searched: list[tuple[float, float, _Narrow]] = [
        (i - 1.0, i + 1.0, _beside_the_least) for i in near
    ]
    # Where the released knee begins to move against its stop it may strike at once,
    # with no extremum of its guard at either node to show it.
    turns = np.flatnonzero(
        np.diff(check.hyperextends) & check.step[1:] & check.step[:-1]
    )
    searched += [(i + 0.0, i + 1.0, _where_the_knee_turns) for i in turns]
    gaps: set[float] = set()
    for low, high, narrow in searched:
        gap = yield from _gap_between(branch, low, high, narrow)
        if gap is not None:
            gaps.add(gap)
    return sorted(gaps)


#: Numbers of the two of several places between which the search for a gap goes on, if
#: it does: by the steps there, their distances from an earlier strike, and the number
#: of the least of these.
_Narrow = Callable[[AnyStride, np.ndarray, int], "tuple[int, int] | None"]


def _beside_the_least(
    stride: AnyStride, fine: np.ndarray, k: int
) -> tuple[int, int] | None:
    return None if fine[k] > max(fine[k - 1], fine[k + 1]) - fine[k] else (k - 1, k + 1)


def _where_the_knee_turns(
    stride: AnyStride, fine: np.ndarray, k: int
) -> tuple[int, int]:
    against = stride.one.start[4] < stride.one.start[5]
    turn = int(np.diff(against.reshape(stride.steps, -1).any(axis=0)).argmax())
    return turn, turn + 1


def _gap_between(
    branch: Branch, low: float, high: float, narrow: _Narrow
) -> Procedure[float | None]:
    """A place between two where an earlier strike occurs, ever more closely searched
    for; None where none is found.
    """
    for _ in range(_MAX_ROUNDS):
        place = np.linspace(low, high, 9)
        stride, fine = yield Call(sampled_steps, (branch.at(place),), _FINER)
        k = int(np.argmin(fine[1:-1])) + 1
        if (yield from _is_interrupted(branch, place[k], fine[k])):
            return float(place[k])
        inner = narrow(stride, fine, k)
        if inner is None:
            break
        low, high = place[list(inner)].tolist()
    return None


_FINER = (("samples", 8 * SAMPLES),)


def _is_interrupted(branch: Branch, place: float, distance: float) -> Procedure[bool]:
    """Whether a place, at a distance from an earlier strike, is no step."""
    if not distance < 0:
        return False
    check = yield Call(check_steps, (branch.at(np.array([place])),))
    return not check.step[0]


def measure(
    branch: Branch, tolerance: float
) -> Procedure[tuple[np.ndarray, StepCheck]]:
    """Set gait ratios, where every gait is a step, and in a fine atlas Lipschitz
    estimates and rounding.

    Returns
    -------
    distance : ndarray, shape (n,)
        Distances of the nodes from an earlier strike (`strike_distance`).
    check : StepCheck
        Whether they are steps.
    """
    m, (c, n) = branch.m, branch.Z.shape
    if tolerance == FINE:
        measured = yield from _roughness(branch)
    else:
        measured = not_measured(m, c - 1 - m, n, branch.steps)
    branch.lipschitz, branch.gradient, branch.rounding_std = measured
    stride, distance = yield Call(sampled_steps, (branch.Z,), _FINER)
    branch.ratio, each = gait_ratio(stride), stride.singles
    motion = each.scaled_motion()
    margin = np.zeros((stride.steps, n))
    phases = [part.reshape(*part.shape[:2], stride.steps, n) for part in motion]
    apart = np.max(
        [np.abs(np.diff(part, axis=-1)).max(axis=(0, 1)) for part in phases], axis=0
    )
    # A guard adds two angles, and a gait between two nodes is no farther from one of
    # them than they are apart.
    margin[:, :-1] = 2 * apart
    margin[:, 1:] = np.maximum(margin[:, 1:], 2 * apart)
    check = verify(motion, each.closing / each.y[0], each.times, margin.ravel()).of_all(
        stride.steps
    )
    clear = check.step & ~check.doubt
    branch.leg_passes = check.leg_passes
    branch.safe = np.append(
        clear[1:] & clear[:-1] & (check.leg_passes[1:] == check.leg_passes[:-1]), False
    )
    return distance, check


def _roughness(branch: Branch) -> Procedure[tuple[np.ndarray, ...]]:
    """What `curvature` gives at a branch's n nodes, and `rounding_std` after each.

    Measured at every other node. A node between two takes the larger Lipschitz estimate
    of them and the mean gradient; rounding is random, and a segment takes the mean
    square of the nodes near it. At a fold the map at fixed slope is singular, its
    estimate infinite.
    """
    w, q, folds = branch.Z[:-1], branch.q, branch.folds()
    n = len(q)
    # At the branch's ends they may change by orders of magnitude from node to node.
    beside = np.clip(np.r_[folds - 1, folds, folds + 1], 0, n - 1)
    nodes = np.unique(np.r_[0 : min(n, 4), 0:n:2, max(0, n - 4) : n, beside])
    lipschitz, gradient = yield Call(curvature, (w[:, nodes], q[nodes]))
    lipschitz[np.isin(nodes, folds)] = np.inf
    # Of every node the measured ones around it: itself, or its neighbours.
    left, right = (
        np.searchsorted(nodes, np.arange(n), side="right") - 1,
        np.searchsorted(nodes, np.arange(n)),
    )
    lipschitz = np.maximum(lipschitz[left], lipschitz[right])
    gradient = (gradient[..., left] + gradient[..., right]) / 2
    # The ends themselves are left out: at a tangential one the map has no derivative to
    # measure by.
    inner = nodes[(nodes > 0) & (nodes < n - 1)]
    measured = yield Call(rounding_std, (w[:, inner], q[inner]))
    square = np.full((len(measured), n + 2 * _ROUNDING_WINDOW), np.nan)
    square[:, _ROUNDING_WINDOW + inner] = measured**2
    around = np.lib.stride_tricks.sliding_window_view(
        square, 2 * _ROUNDING_WINDOW + 1, axis=1
    )
    known = np.isfinite(around)
    with np.errstate(invalid="ignore"):
        mean = np.sqrt(np.where(known, around, 0.0).sum(axis=-1) / known.sum(axis=-1))
    return lipschitz, gradient, np.nan_to_num(mean, nan=np.inf)
