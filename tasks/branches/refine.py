"""Nodes between those that following a branch gave, what is measured at them, and
checks of the whole branch.

All are procedures, which run side by side (`tasks.branches.lockstep`).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy import ndarray

from gaitsweep.tasks.branches.branch import Branch
from gaitsweep.tasks.branches.joint import but_times
from gaitsweep.tasks.branches.lockstep import Call, Procedure
from gaitsweep.tasks.branches.pseudo_arclength import Point
from gaitsweep.tasks.branches.segment import sampled_steps
from gaitsweep.tasks.branches.tracking import (
    MAX_CROSSING_STEP,
    ONE_STEP,
    branch_point_determinant,
    check_steps,
    correct,
)
from gaitsweep.tasks.contract.kinds import kind_of
from gaitsweep.tasks.gaits.newton import curvature
from gaitsweep.tasks.gaits.polish import not_measured
from gaitsweep.tasks.gaits.rounding import rounding, rounding_std
from gaitsweep.tasks.gaits.step_check import gait_ratio
from gaitsweep.tasks.mechanics.arrays import Gait, Numbers, PerLane
from gaitsweep.tasks.mechanics.sums import norm
from gaitsweep.tasks.step.several_steps import AnyStride
from gaitsweep.tasks.step.step_map import SAMPLES
from gaitsweep.tasks.step.verify_step import (
    StepCheck,
    hyperextends_at_release,
    verify,
)

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
    branch: Branch, segments: Numbers, before: PerLane, tolerance: float
) -> Procedure[tuple[Branch, ndarray, ndarray]]:
    """Correct the middles of some segments and split those that moved.

    `before` (n - 1,) is how far the middle of the segment moved from which each was
    split, 0 where it is split for the last time. Returned are the branch, its segments
    that changed, and `before` for all segments.
    """
    Z = _middles(branch, segments)
    border = branch.between(segments)
    point = yield Call(correct, (Z, border))
    # Newton may have jumped to another branch: a middle that is not between its
    # neighbours is discarded.
    ok = point.ok & branch.lies_between(segments, point.Z)
    moved = _moved_by(point.Z - Z, branch.m)
    moved[~ok] = np.inf

    moved_before = before[segments]
    split = ok & (moved_before > 0)
    split &= moved > _allowed(branch, segments, point, tolerance)
    improves = moved < _MIN_IMPROVEMENT * moved_before
    moved_from = np.where(improves, moved, 0.0)[split]
    after = segments[split] + 1
    before[after - 1] = moved_from
    before = np.insert(before, after, moved_from)
    is_old = np.ones(len(branch.q), bool)
    is_new = ~np.insert(is_old, after, False)

    direction = point.oriented(border).direction
    branch = branch.insert(after, point.Z[:, split], direction[:, split])
    changed = is_new[branch.window].any(axis=0)
    return branch, np.flatnonzero(changed), before


def _allowed(
    branch: Branch, segments: Numbers, point: Point, tolerance: float
) -> PerLane:
    """How far Newton's method may move the middles of segments, to points, that are not
    split.
    """
    from_fold = branch.distance_from_fold()[segments]
    allowed = np.clip(_FOLD_SHARE * from_fold, FINE, tolerance)
    # Below the rounding of the fixed point no split helps: by estimate, or because the
    # last split did not.
    rounded = _ROUNDING_MARGIN * rounding(point.at.stride).max(axis=0)
    return np.maximum(allowed, rounded)


def _middles(branch: Branch, segments: Numbers) -> ndarray:
    """Points (c, k) of the polynomials in the middles of segments, no farther from
    their nodes than these are apart.
    """
    # Near a singular node the polynomial may lead anywhere.
    a = branch.Z[:, segments]
    b = branch.Z[:, segments + 1]
    apart = np.abs(b - a).max(axis=0)
    low = np.minimum(a, b) - apart
    high = np.maximum(a, b) + apart
    x = branch.ends_of(segments).mean(axis=0)
    return np.clip(branch.evaluate(segments, x), low, high)


def _moved_by(change: ndarray, m: int) -> ndarray:
    """How far Newton's method moved points, by the changes (c, n) of their coordinates:
    event times need only lead to their own roots of the guards.
    """
    change = np.abs(change)
    moved = change[but_times(m)].max(axis=0)
    late = change[m:-1].max(axis=0)
    return np.where(late > COARSE, np.maximum(moved, late), moved)


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


def without_jumps(branch: Branch, gait: Gait) -> Procedure[Branch]:
    """Check the branch as a whole: where Newton jumped to another branch, only the part
    that has a gait is kept.

    Parameters
    ----------
    gait : ndarray, shape (c,)
        Where the branch began.
    """
    border = branch.direction
    point = yield Call(correct, (branch.Z, border), ONE_STEP)
    side = np.sign(branch_point_determinant(point, border))
    changes = side[1:] * side[:-1] < 0
    jumps = changes & (norm(np.diff(branch.Z)) > MAX_CROSSING_STEP)
    for end, why in zip((0, -1), branch.why, strict=True):
        jumps[end] &= not kind_of(why).is_crossing
    if not jumps.any():
        return branch

    return branch.part_of(gait, np.flatnonzero(jumps))


def locate_gaps(
    branch: Branch, distance: ndarray, check: StepCheck
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
    near = _least_distances(branch, distance, check.step)
    searched: list[tuple[float, float, _Narrow]] = [
        (i - 1.0, i + 1.0, _beside_the_least) for i in near
    ]
    # Where the released knee begins to move against its stop it may strike at once,
    # with no extremum of its guard at either node to show it.
    between_steps = check.step[1:] & check.step[:-1]
    turns = np.flatnonzero(np.diff(check.hyperextends) & between_steps)
    searched += [(float(i), i + 1.0, _where_the_knee_turns) for i in turns]

    gaps = yield [_gap_between(branch, *each) for each in searched]
    return sorted({gap for gap in gaps if gap is not None})


def _least_distances(branch: Branch, distance: ndarray, steps: ndarray) -> ndarray:
    """Nodes beside which an earlier strike may occur: their distance from it is less
    than their neighbours' are, and than it bends over them.
    """
    with np.errstate(invalid="ignore"):
        bend = distance[:-2] - 2 * distance[1:-1] + distance[2:]
        distance = np.where(steps, distance, np.nan)
        before = distance[:-2]
        inner = distance[1:-1]
        after = distance[2:]
        least = (inner <= before) & (inner <= after)
        least &= ~(inner > bend)

    safe = branch.safe[:-2] & branch.safe[1:-1]
    least &= np.isfinite(inner) & ~safe
    return np.flatnonzero(least) + 1


#: Numbers of the two of several places between which the search for a gap goes on, if
#: it does: by the steps there, their distances from an earlier strike, and the number
#: of the least of these.
_Narrow = Callable[[AnyStride, ndarray, int], "tuple[int, int] | None"]


def _beside_the_least(
    stride: AnyStride, fine: ndarray, k: int
) -> tuple[int, int] | None:
    before, least, after = fine[k - 1 : k + 2]
    rise = max(before, after) - least
    if least > rise:
        return None
    return k - 1, k + 1


def _where_the_knee_turns(stride: AnyStride, fine: ndarray, k: int) -> tuple[int, int]:
    singles = stride.singles
    free = singles.motion[0]
    intervals = len(free) - 1
    interval = singles.times[0] / intervals
    against = hyperextends_at_release(free, interval)
    in_any_step = against.reshape(stride.steps, -1).any(axis=0)
    turn = int(np.diff(in_any_step).argmax())
    return turn, turn + 1


def _gap_between(
    branch: Branch, low: float, high: float, narrow: _Narrow
) -> Procedure[float | None]:
    """A place between two where an earlier strike occurs, ever more closely searched
    for; None where none is found.
    """
    for _ in range(_MAX_ROUNDS):
        place = np.linspace(low, high, 9)
        Z = branch.at(place)
        stride, fine = yield Call(sampled_steps, (Z,), _FINER)
        k = 1 + int(np.argmin(fine[1:-1]))
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
    Z = branch.at(np.array([place]))
    check = yield Call(check_steps, (Z,))
    return not check.step[0]


def measure(branch: Branch, tolerance: float) -> Procedure[tuple[ndarray, StepCheck]]:
    """Set gait ratios, where every gait is a step, and in a fine atlas Lipschitz
    estimates and rounding.

    Returns
    -------
    distance : ndarray, shape (n,)
        Distances of the nodes from an earlier strike (`strike_distance`).
    check : StepCheck
        Whether they are steps.
    """
    if tolerance == FINE:
        measured = yield from _roughness(branch)
    else:
        unknowns, n = branch.Z.shape
        phases = unknowns - 1 - branch.m
        measured = not_measured(branch.m, phases, n, branch.steps)
    branch.lipschitz, branch.gradient, branch.rounding_std = measured

    stride, distance = yield Call(sampled_steps, (branch.Z,), _FINER)
    branch.ratio = gait_ratio(stride)
    singles = stride.singles
    motion = singles.scaled_motion()
    closing = singles.closing / singles.y[0]
    margin = _margins(motion, stride.steps)
    of_single = verify(motion, closing, singles.times, margin)
    check = of_single.of_all(stride.steps)

    passes = check.leg_passes
    branch.leg_passes = passes
    clear = check.step & ~check.doubt
    safe = passes[1:] == passes[:-1]
    safe &= clear[1:] & clear[:-1]
    branch.safe = np.append(safe, False)
    return distance, check


def _margins(motion: list[ndarray], steps: int) -> ndarray:
    """How much nearer zero guards may be than at the nodes, of every step of each gait,
    by the motion of all of them, so that gaits between the nodes are verified too.
    """
    farthest = []
    for part in motion:
        samples, links, _ = part.shape
        of_steps = part.reshape(samples, links, steps, -1)
        change = np.abs(np.diff(of_steps, axis=-1))
        farthest.append(change.max(axis=(0, 1)))

    # A guard adds two angles, and a gait between two nodes is no farther from one of
    # them than they are apart.
    apart = 2 * np.max(farthest, axis=0)
    margin = np.zeros((steps, apart.shape[1] + 1))
    margin[:, :-1] = apart
    margin[:, 1:] = np.maximum(margin[:, 1:], apart)
    return margin.ravel()


def _roughness(branch: Branch) -> Procedure[tuple[ndarray, ...]]:
    """What `curvature` gives at a branch's n nodes, and `rounding_std` after each.

    Measured at every other node. A node between two takes the larger Lipschitz estimate
    of them and the mean gradient; rounding is random, and a segment takes the mean
    square of the nodes near it. At a fold the map at fixed slope is singular, its
    estimate infinite.
    """
    w, q = branch.Z[:-1], branch.q
    n = len(q)
    folds = branch.folds()
    nodes = _measured_nodes(n, folds)
    lipschitz, gradient = yield Call(curvature, (w[:, nodes], q[nodes]))
    lipschitz[np.isin(nodes, folds)] = np.inf

    # Of every node the measured ones around it: itself, or its neighbours.
    every_node = np.arange(n)
    left = np.searchsorted(nodes, every_node, side="right") - 1
    right = np.searchsorted(nodes, every_node)
    lipschitz = np.maximum(lipschitz[left], lipschitz[right])
    gradient = (gradient[..., left] + gradient[..., right]) / 2

    # The ends themselves are left out: at a tangential one the map has no derivative to
    # measure by.
    inner = nodes[(nodes > 0) & (nodes < n - 1)]
    measured = yield Call(rounding_std, (w[:, inner], q[inner]))
    return lipschitz, gradient, _mean_around(measured, inner, n)


def _measured_nodes(n: int, folds: Numbers) -> Numbers:
    """Every other of n nodes, and those beside folds and ends."""
    every_node = np.arange(n)
    beside = np.concatenate([folds - 1, folds, folds + 1])
    # At the branch's ends it may change by orders of magnitude from node to node.
    ends = np.concatenate([every_node[:4], every_node[-4:]])
    chosen = np.concatenate([every_node[::2], ends, beside])
    return np.unique(np.clip(chosen, 0, n - 1))


def _mean_around(values: ndarray, nodes: Numbers, n: int) -> ndarray:
    """Root of the mean square of values (o, k) that were measured at some nodes (k,),
    over those near each of n nodes; infinite where there are none.
    """
    both_sides = 2 * _ROUNDING_WINDOW
    square = np.full((len(values), n + both_sides), np.nan)
    square[:, _ROUNDING_WINDOW + nodes] = values**2
    around = np.lib.stride_tricks.sliding_window_view(square, both_sides + 1, axis=1)
    is_measured = np.isfinite(around)
    summed = np.where(is_measured, around, 0.0).sum(axis=-1)
    with np.errstate(invalid="ignore"):
        mean = np.sqrt(summed / is_measured.sum(axis=-1))
    return np.nan_to_num(mean, nan=np.inf)
