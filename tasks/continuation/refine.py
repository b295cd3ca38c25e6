"""Nodes between those that following a branch gave, what is measured at them, and checks of the whole branch.

All are procedures, which run side by side (`tasks.continuation.lockstep`).
"""

from __future__ import annotations

import numpy as np

from gaitsweep.tasks.continuation.branch import Branch
from gaitsweep.tasks.continuation.locate import check_steps, sampled_steps, strike_distances
from gaitsweep.tasks.continuation.lockstep import Call, Procedure
from gaitsweep.tasks.continuation.tracking import MAX_CROSSING_STEP, branch_point_determinant, correct
from gaitsweep.tasks.fixed_points.newton import curvature
from gaitsweep.tasks.fixed_points.polish import not_measured
from gaitsweep.tasks.fixed_points.rounding import rounding, rounding_std
from gaitsweep.tasks.fixed_points.step_check import gait_ratio
from gaitsweep.tasks.step.step_map import SAMPLES
from gaitsweep.tasks.step.verify_step import StepCheck, verify

#: Largest change Newton may still make at a segment's middle before the segment is split: in a fine atlas points take
#: one step each, and what their bounds need is measured at the nodes; in a coarse one, for few points, at each of them.
FINE, COARSE = 2e-13, 1e-6


#: Beside a fold two gaits must be distinguished: share of the distance in ln slope by which a middle may move.
_FOLD_SHARE = 1e-3
_MAX_ROUNDS = 5


#: A change below this multiple of the estimated rounding is rounding; with 8, branches have up to 2 % fewer nodes.
_ROUNDING_MARGIN = 7
#: A split that leaves more than this share of the change may show rounding: one more is tried, and no other.
_MIN_IMPROVEMENT = 0.25


#: Nodes on either side over which a segment's measured rounding is averaged.
_ROUNDING_WINDOW = 4


def _refine(
    branch: Branch, segments: np.ndarray, before: np.ndarray, tolerance: float
) -> Procedure[tuple[Branch, np.ndarray, np.ndarray]]:
    """Correct the middles of some segments and split those that moved.

    `before` (n - 1,) is how far the middle of the segment moved from which each was split, 0 where it is split for the
    last time. Returned are the branch, its segments that changed, and `before` for all segments.
    """
    m = branch.m
    x = 0.5 * (branch.Z[segments, branch.axis[segments]] + branch.Z[segments + 1, branch.axis[segments]])
    # Near a singular node the polynomial may lead anywhere.
    a, b = branch.Z[segments], branch.Z[segments + 1]
    apart = np.abs(b - a).max(axis=1, keepdims=True)
    Z = np.clip(branch.evaluate(segments, x), np.minimum(a, b) - apart, np.maximum(a, b) + apart)
    border = branch.direction[segments] + branch.direction[segments + 1]
    border /= np.linalg.norm(border, axis=1, keepdims=True)
    point = yield Call(correct, (Z[:, : m + 1].T, Z[:, m + 1 :].T, border.T))
    # Newton may have jumped to another branch: a middle that is not between its neighbours is discarded.
    ok = point.ok & branch.lies_between(segments, point.Z)
    moved = np.abs(point.X.T - Z[:, : m + 1]).max(axis=1)
    # Event times need only lead to their own roots of the guards.
    late = np.abs(point.times.T - Z[:, m + 1 :]).max(axis=1)
    moved = np.where(ok, np.where(late > COARSE, np.maximum(moved, late), moved), np.inf)
    sign = np.sign((point.direction.T * border).sum(axis=1))[:, None]
    new_Z, new_T = point.Z.T, point.direction.T * sign
    # Below the rounding of the fixed point no split helps: by estimate, or because the last split did not.
    allowed = np.clip(_FOLD_SHARE * branch.distance_from_fold()[segments], FINE, tolerance)
    keep = ok & (moved > np.maximum(allowed, _ROUNDING_MARGIN * rounding(point.stride).max(axis=0)))
    keep &= before[segments] > 0
    at = segments[keep] + 1
    moved_from = np.where(moved < _MIN_IMPROVEMENT * before[segments], moved, 0.0)[keep]
    before[segments[keep]] = moved_from
    before = np.insert(before, at, moved_from)
    is_new = np.insert(np.zeros(len(branch.Z), bool), at, True)
    branch = branch.insert(at, new_Z[keep], new_T[keep])
    return branch, np.nonzero(is_new[branch.window].any(axis=1))[0], before


def densify(branch: Branch, tolerance: float) -> Procedure[Branch]:
    """Add nodes until Newton moves the middles of segments by less than the tolerance, or than rounding."""
    segments = np.arange(len(branch.Z) - 1)
    before = np.full(len(segments), np.inf)
    for _ in range(_MAX_ROUNDS):
        branch, segments, before = yield from _refine(branch, segments, before, tolerance)
        if not len(segments):
            break
    return branch


def without_jumps(branch: Branch, gait: np.ndarray) -> Procedure[Branch]:
    """Check the branch as a whole: where Newton jumped to another branch, only the part that has a gait is kept.

    Parameters
    ----------
    gait : ndarray, shape (c,)
        Where the branch began, a row of Z.
    """
    m = branch.m
    Z, border = branch.Z.T, branch.direction.T
    point = yield Call(correct, (Z[: m + 1], Z[m + 1 :], border), (("max_iterations", 1),))
    side = np.sign(branch_point_determinant(point, border))
    jumps = (side[1:] * side[:-1] < 0) & (np.linalg.norm(np.diff(Z, axis=1), axis=0) > MAX_CROSSING_STEP)
    jumps[[0, -1]] &= np.array(branch.why) != "branch_point"
    return branch.part_of(gait, np.flatnonzero(jumps)) if jumps.any() else branch


def locate_gaps(branch: Branch, distance: np.ndarray, check: StepCheck) -> Procedure[list[float]]:
    """Places of a branch, segment plus fraction, where an earlier strike occurs between nodes that are steps.

    Parameters
    ----------
    distance : ndarray, shape (n,)
        Distances of the nodes from an earlier strike.
    check : StepCheck
        Of the nodes: `measure`.
    """
    gaps: list[float] = []
    with np.errstate(invalid="ignore"):
        bend = distance[:-2] - 2 * distance[1:-1] + distance[2:]
        distance = np.where(check.step, distance, np.nan)
        inner = distance[1:-1]
        least = (inner <= distance[:-2]) & (inner <= distance[2:]) & ~(inner > bend)
    for i in np.nonzero(least & np.isfinite(inner) & ~(branch.safe[:-2] & branch.safe[1:-1]))[0] + 1:
        low, high = i - 1.0, i + 1.0
        for _ in range(_MAX_ROUNDS):
            place = np.linspace(low, high, 9)
            fine = yield Call(strike_distances, _at(branch, place), _FINER)
            k = int(np.argmin(fine[1:-1])) + 1
            if (yield from _is_interrupted(branch, place[k], fine[k])):
                gaps.append(float(place[k]))
                break
            if fine[k] > max(fine[k - 1], fine[k + 1]) - fine[k]:
                break
            low, high = place[k - 1], place[k + 1]
    # Where the released knee begins to move against its stop it may strike at once, with no extremum of its guard at
    # either node to show it.
    for i in np.flatnonzero(np.diff(check.hyperextends) & check.step[1:] & check.step[:-1]):
        low, high = i + 0.0, i + 1.0
        for _ in range(_MAX_ROUNDS):
            place = np.linspace(low, high, 9)
            stride, fine = yield Call(sampled_steps, _at(branch, place), _FINER)
            k = int(np.argmin(fine[1:-1])) + 1
            if (yield from _is_interrupted(branch, place[k], fine[k])):
                gaps.append(float(place[k]))
                break
            against = stride.start[4] < stride.start[5]
            k = int(np.diff(against.reshape(stride.steps, -1).any(axis=0)).argmax())
            low, high = place[k], place[k + 1]
    return sorted(set(gaps))


_FINER = (("samples", 8 * SAMPLES),)


def _at(branch: Branch, place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """X (m + 1, n) and event times (k, n) of places along a branch, shape (n,)."""
    rows = branch.at(place)
    return rows[:, : branch.m + 1].T, rows[:, branch.m + 1 :].T


def _is_interrupted(branch: Branch, place: float, distance: float) -> Procedure[bool]:
    """Whether a place, at a distance from an earlier strike, is no step."""
    if not distance < 0:
        return False
    check = yield Call(check_steps, _at(branch, np.array([place])))
    return not check.step[0]


def measure(branch: Branch, tolerance: float) -> Procedure[tuple[np.ndarray, StepCheck]]:
    """Set gait ratios, where every gait is a step, and in a fine atlas Lipschitz estimates and rounding.

    Returns
    -------
    distance : ndarray, shape (n,)
        Distances of the nodes from an earlier strike (`strike_distance`).
    check : StepCheck
        Whether they are steps.
    """
    m = branch.m
    X, times = branch.Z[:, : m + 1].T, branch.Z[:, m + 1 :].T
    folds = branch.folds()
    if tolerance == FINE:
        measured = yield from _roughness(X, times, folds)
    else:
        measured = not_measured(m, len(times), len(X.T), branch.steps)
    branch.lipschitz, branch.gradient, branch.rounding_std = (np.moveaxis(each, -1, 0) for each in measured)
    stride, distance = yield Call(sampled_steps, (X, times), _FINER)
    branch.ratio = gait_ratio(stride)
    n, each = len(branch.Z), stride.singles
    motion = each.scaled_motion()
    margin = np.zeros((stride.steps, n))
    phases = [part.reshape(*part.shape[:2], stride.steps, n) for part in motion]
    apart = np.max([np.abs(np.diff(part, axis=-1)).max(axis=(0, 1)) for part in phases], axis=0)
    # A guard adds two angles, and a gait between two nodes is no farther from one of them than they are apart.
    margin[:, :-1] = 2 * apart
    margin[:, 1:] = np.maximum(margin[:, 1:], 2 * apart)
    check = verify(motion, each.closing / each.y[0], each.times, margin.ravel()).of_all(stride.steps)
    clear = check.step & ~check.doubt
    branch.leg_passes = check.leg_passes
    branch.safe = np.append(clear[1:] & clear[:-1] & (check.leg_passes[1:] == check.leg_passes[:-1]), False)
    return distance, check


def _roughness(X: np.ndarray, times: np.ndarray, folds: np.ndarray) -> Procedure[tuple[np.ndarray, ...]]:
    """What `curvature` gives at a branch's n nodes, and `rounding_std` after each.

    Measured at every other node. A node between two takes the larger Lipschitz estimate of them and the mean gradient;
    rounding is random, and a segment takes the mean square of the nodes near it. At a fold the map at fixed slope is
    singular, its estimate infinite.
    """
    m, n = len(X) - 1, X.shape[1]
    # At the branch's ends they may change by orders of magnitude from node to node.
    beside = np.clip(np.r_[folds - 1, folds, folds + 1], 0, n - 1)
    nodes = np.unique(np.r_[0 : min(n, 4), 0:n:2, max(0, n - 4) : n, beside])
    lipschitz, gradient = yield Call(curvature, (X[:, nodes], times[:, nodes]))
    lipschitz[np.isin(nodes, folds)] = np.inf
    # Of every node the measured ones around it: itself, or its neighbours.
    left, right = np.searchsorted(nodes, np.arange(n), side="right") - 1, np.searchsorted(nodes, np.arange(n))
    lipschitz = np.maximum(lipschitz[left], lipschitz[right])
    gradient = (gradient[..., left] + gradient[..., right]) / 2
    # The ends themselves are left out: at a tangential one the map has no derivative to measure by.
    inner = nodes[(nodes > 0) & (nodes < n - 1)]
    measured = yield Call(rounding_std, (np.vstack([X[:m], times])[:, inner], X[m, inner]))
    square = np.full((len(measured), n + 2 * _ROUNDING_WINDOW), np.nan)
    square[:, _ROUNDING_WINDOW + inner] = measured**2
    around = np.lib.stride_tricks.sliding_window_view(square, 2 * _ROUNDING_WINDOW + 1, axis=1)
    known = np.isfinite(around)
    with np.errstate(invalid="ignore"):
        mean = np.sqrt(np.where(known, around, 0.0).sum(axis=-1) / known.sum(axis=-1))
    return lipschitz, gradient, np.nan_to_num(mean, nan=np.inf)
