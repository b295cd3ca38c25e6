"""The atlas of a line: every branch of gaits over slope, so dense that one Newton step from it solves any point.

Nodes hold similarity coordinates, event times and q = ln slope, with exact tangents. Between them a Hermite polynomial
of degree seven through four nodes interpolates, in a coordinate that is monotone there. The atlas depends on the walker
alone, never on a study's grid, so points that start from it are independent of each other.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tasks.continuation.branch import Branch
from tasks.continuation.special_points import (
    BranchEnd,
    correct_at,
    is_step,
    locate_end,
    locate_root,
    narrow_segment,
    oriented_tangent,
    row,
    row_tangent,
)
from tasks.continuation.tracking import MIN_SLOPE, BranchTrace, Point, correct, fall_margin, follow
from tasks.fixed_points.newton import lipschitz
from tasks.fixed_points.rounding import rounding, rounding_std
from tasks.fixed_points.search import search_slopes
from tasks.fixed_points.step_check import gait_ratio, verify_steps
from tasks.step.problem import Problem
from tasks.step.step_map import SAMPLES
from tasks.step.verify_step import strike_distance, verify

#: Slopes at which gaits to follow are searched for [rad].
ANCHORS = (0.01, 0.03, 0.1, 0.001, 0.2)
#: Largest change Newton may still make at a segment's middle before the segment is split.
_TOLERANCE = 2e-13
_MAX_ROUNDS = 5
#: A change of fewer times the estimated rounding is taken for rounding; with 8, branches have up to 2 % fewer nodes.
_ROUNDING_MARGIN = 7
#: A split that leaves more than this share of the change may show rounding: one more is tried, and no other.
_MIN_IMPROVEMENT = 0.25
#: Nodes to either side over whose measured rounding a segment's is averaged.
_ROUNDING_WINDOW = 4


def _refine(
    problem: Problem, branch: Branch, segments: np.ndarray, before: np.ndarray
) -> tuple[Branch, np.ndarray, np.ndarray]:
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
    border = branch.tangent[segments][:, : m + 1] + branch.tangent[segments + 1][:, : m + 1]
    border /= np.linalg.norm(border, axis=1, keepdims=True)
    point = correct(problem, Z[:, : m + 1].T, Z[:, m + 1 :].T, border.T)
    # Newton may have jumped to another branch: a middle that is not between its neighbours is discarded.
    point.ok &= branch.lies_between(segments, point.X, point.times)
    moved = np.where(point.ok, np.abs(point.X.T - Z[:, : m + 1]).max(axis=1), np.inf)
    sign = np.sign((point.tangent.T * border).sum(axis=1))[:, None]
    new_Z = np.vstack([point.X, point.times]).T
    new_T = np.vstack([point.tangent, point.times_tangent]).T * sign
    # Below the rounding of the fixed point no split helps, be it by estimate or because the last split did not.
    keep = point.ok & (moved > np.maximum(_TOLERANCE, _ROUNDING_MARGIN * rounding(point.stride).max(axis=0)))
    keep &= before[segments] > 0
    at = segments[keep] + 1
    moved_from = np.where(moved < _MIN_IMPROVEMENT * before[segments], moved, 0.0)[keep]
    before[segments[keep]] = moved_from
    before = np.insert(before, at, moved_from)
    is_new = np.insert(np.zeros(len(branch.Z), bool), at, True)
    branch = branch.insert(at, new_Z[keep], new_T[keep])
    return branch, np.nonzero(is_new[branch.window].any(axis=1))[0], before


def _join(m: int, pair: list[BranchTrace]) -> tuple[Branch, int]:
    """Join the traces down and up to one branch; also the index of their start on it."""
    down, up = pair
    X = np.array(down.X[:0:-1] + up.X)
    times = np.array(down.times[:0:-1] + up.times)
    tangent = np.array([-t for t in down.tangent[:0:-1]] + up.tangent)
    times_tangent = np.array([-t for t in down.times_tangent[:0:-1]] + up.times_tangent)
    Z, T = np.hstack([X, times]), np.hstack([tangent, times_tangent])
    return Branch(m, Z, T, np.zeros(len(Z)), (down.stop_reason, up.stop_reason)), len(down.X) - 1


def _from_tracks(problem: Problem, pair: list[BranchTrace]) -> list[Branch]:
    """Join both directions, keep the parts that are steps up to their located ends, refine and measure them."""
    raw, start = _join(problem.m, pair)
    if len(raw.Z) < 4:
        return []
    steps = _are_steps(problem, raw)
    if not steps[start]:
        return []
    branches: list[Branch] = []
    for first, last in _runs(steps):
        branch = _with_ends(problem, raw, first, last)
        if branch is not None:
            branches += _without_gaps(problem, _densify(problem, _with_folds(problem, branch)))
    return branches


def _are_steps(problem: Problem, branch: Branch) -> np.ndarray:
    """Whether the nodes are steps, shape (n,)."""
    m = branch.m
    X, times = branch.Z[:, : m + 1].T, branch.Z[:, m + 1 :].T
    _, check = verify_steps(problem, np.vstack([X[:m], times]), X[m])
    return check.step


def _runs(true: np.ndarray) -> list[tuple[int, int]]:
    """First and last index of every run of true values."""
    edges = np.diff(np.concatenate([[0], true.astype(int), [0]]))
    return list(zip(np.nonzero(edges == 1)[0].tolist(), (np.nonzero(edges == -1)[0] - 1).tolist(), strict=True))


def _with_ends(problem: Problem, raw: Branch, first: int, last: int) -> Branch | None:
    """Branch of a run of nodes that are steps, with its located ends; None where fewer than three nodes remain."""
    whole = first == 0, last == len(raw.Z) - 1
    ends: dict[int, BranchEnd] = {}
    if not whole[1]:
        raw, last = narrow_segment(problem, raw, last, lambda point, direction: is_step(problem, point))
        ends[1] = locate_end(problem, raw, last, last + 1)
    if not whole[0]:
        before = len(raw.Z)
        raw, segment = narrow_segment(problem, raw, first - 1, lambda point, direction: not is_step(problem, point))
        first, last = segment + 1, last + len(raw.Z) - before
        ends[0] = locate_end(problem, raw, first, segment)
    for side, segment in ((0, 0), (1, len(raw.Z) - 2)):
        if whole[side] and raw.why[side] == "a fall":
            fall = locate_root(
                problem, raw, segment, lambda point, direction: fall_margin(point.X[:, 0], point.times[:, 0])
            )
            ends[side] = BranchEnd(raw.why[side], *fall, raw.end_errors[side])
            first, last = first + (side == 0), last - (side == 1)
    branch = raw.part(first, last)
    why, errors = list(raw.why), list(raw.end_errors)
    for side, end in ends.items():
        branch = branch.insert(side * len(branch.Z), row(end.point), row_tangent(end.point, end.direction))
        why[side], errors[side] = end.kind, end.error
    if len(branch.Z) < 3:
        return None
    return replace(branch, why=(why[0], why[1]), end_errors=(errors[0], errors[1]))


def _densify(problem: Problem, branch: Branch) -> Branch:
    """Add nodes until one Newton step from the polynomials converges to rounding."""
    segments = np.arange(len(branch.Z) - 1)
    before = np.full(len(segments), np.inf)
    for _ in range(_MAX_ROUNDS):
        branch, segments, before = _refine(problem, branch, segments, before)
        if not len(segments):
            break
    return branch


def _without_gaps(problem: Problem, branch: Branch) -> list[Branch]:
    """Measure the branch; where an earlier strike interrupts it, keep the parts on either side."""
    distance, steps = _measure(problem, branch)
    steps[[0, -1]] = True
    gaps = _locate_gaps(problem, branch, distance, steps)
    if steps.all() and not gaps:
        return [branch]
    for place in sorted(gaps, reverse=True):
        segment = int(place)
        a, b = branch.Z[segment : segment + 2, branch.axis[segment]]
        point, direction = correct_at(problem, branch, segment, a + (b - a) * (place - segment))
        branch = branch.insert(segment + 1, row(point), row_tangent(point, direction))
        steps = np.insert(steps, segment + 1, False)
    parts = [_with_ends(problem, branch, first, last) for first, last in _runs(steps)]
    branches = [_densify(problem, part) for part in parts if part is not None]
    for part in branches:
        _measure(problem, part)
    return branches


def _locate_gaps(problem: Problem, branch: Branch, distance: np.ndarray, steps: np.ndarray) -> list[float]:
    """Places of a branch, segment plus fraction, where an earlier strike occurs between nodes that are steps.

    Parameters
    ----------
    distance, steps : ndarray, shape (n,)
        Distances of the nodes from an earlier strike, and whether they are steps: `_measure`.
    """
    m, gaps = branch.m, []
    with np.errstate(invalid="ignore"):
        bend = distance[:-2] - 2 * distance[1:-1] + distance[2:]
        distance = np.where(steps, distance, np.nan)
        inner = distance[1:-1]
        least = (inner <= distance[:-2]) & (inner <= distance[2:]) & ~(inner > bend)
    for i in np.nonzero(least & np.isfinite(inner) & ~(branch.safe[:-2] & branch.safe[1:-1]))[0] + 1:
        low, high = i - 1.0, i + 1.0
        for _ in range(_MAX_ROUNDS):
            place = np.linspace(low, high, 9)
            rows = branch.at(place)
            w = np.delete(rows, m, axis=1).T
            stride, _ = problem.stride(w, rows[:, m], samples=8 * SAMPLES)
            fine = strike_distance(stride.scaled_motion(), stride.times)
            k = int(np.argmin(fine[1:-1])) + 1
            if fine[k] < 0 and not verify_steps(problem, w[:, k : k + 1], rows[k : k + 1, m])[1].step[0]:
                gaps.append(float(place[k]))
                break
            if fine[k] > max(fine[k - 1], fine[k + 1]) - fine[k]:
                break
            low, high = place[k - 1], place[k + 1]
    return gaps


def _measure(problem: Problem, branch: Branch) -> tuple[np.ndarray, np.ndarray]:
    """Set Lipschitz estimates, rounding, gait ratios, and the segments on which every gait is a step.

    Returns
    -------
    distance, steps : ndarray, shape (n,)
        Distances of the nodes from an earlier strike (`strike_distance`), and whether they are steps.
    """
    m = branch.m
    X, times = branch.Z[:, : m + 1].T, branch.Z[:, m + 1 :].T
    folds = np.array([first for first, _ in branch.pieces()[1:]], int)
    branch.lipschitz, branch.rounding_std = _roughness(problem, X, times, folds)
    stride, _ = problem.stride(np.vstack([X[:m], times]), X[m], samples=8 * SAMPLES)
    branch.ratio = gait_ratio(stride)
    motion = stride.scaled_motion()
    n = len(branch.Z)
    margin = np.zeros(n)
    apart = np.max([np.abs(np.diff(part, axis=-1)).max(axis=(0, 1)) for part in motion], axis=0)
    # A guard adds two angles, and a gait between two nodes is no farther from one of them than they are apart.
    margin[:-1] = 2 * apart
    margin[1:] = np.maximum(margin[1:], 2 * apart)
    check = verify(motion, stride.closing / stride.y[0], stride.times, margin)
    clear = check.step & ~check.doubt
    branch.leg_passes = check.leg_passes
    branch.safe = np.append(clear[1:] & clear[:-1] & (check.leg_passes[1:] == check.leg_passes[:-1]), False)
    return strike_distance(motion, stride.times), check.step


def _roughness(problem: Problem, X: np.ndarray, times: np.ndarray, folds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lipschitz estimates at a branch's nodes (n,), and the standard deviation of rounding after each (n, o).

    Measured at every other node. A node between two takes the larger Lipschitz estimate of them; rounding is random,
    and a segment takes the mean square of the nodes near it. At a fold the map at fixed slope is singular, its
    estimate infinite.
    """
    m, n = problem.m, X.shape[1]
    # At the branch's ends they may change by orders of magnitude from node to node.
    nodes = np.unique(np.r_[0 : min(n, 4), 0:n:2, max(0, n - 4) : n, folds - 1, folds + 1])
    estimates = np.full(n, -np.inf)
    estimates[nodes] = lipschitz(problem, X[:, nodes], times[:, nodes])
    estimates[folds] = np.inf
    left, right = np.append(estimates[:1], estimates[:-1]), np.append(estimates[1:], estimates[-1:])
    estimates = np.where(np.isneginf(estimates), np.maximum(left, right), estimates)
    # The ends themselves are left out: at a tangential one the map has no derivative to measure by.
    inner = nodes[(nodes > 0) & (nodes < n - 1)]
    measured = rounding_std(problem, np.vstack([X[:m], times])[:, inner], X[m, inner])
    square = np.full((len(measured), n + 2 * _ROUNDING_WINDOW), np.nan)
    square[:, _ROUNDING_WINDOW + inner] = measured**2
    around = np.lib.stride_tricks.sliding_window_view(square, 2 * _ROUNDING_WINDOW + 1, axis=1)
    known = np.isfinite(around)
    with np.errstate(invalid="ignore"):
        mean = np.sqrt(np.where(known, around, 0.0).sum(axis=-1) / known.sum(axis=-1))
    return estimates, np.nan_to_num(mean, nan=np.inf).T


def _with_folds(problem: Problem, branch: Branch) -> Branch:
    """Put a node on every fold, where the slope turns."""
    m = branch.m

    def slope_rate(point: Point, direction: np.ndarray) -> float:
        return float(oriented_tangent(point, direction)[m])

    for segment in np.nonzero(np.diff(np.sign(branch.tangent[:, m])) != 0)[0][::-1]:
        sign = np.sign(branch.tangent[segment, m])

        def is_before(point: Point, direction: np.ndarray, sign: float = sign) -> bool:
            return bool(slope_rate(point, direction) * sign > 0)

        branch, at = narrow_segment(problem, branch, int(segment), is_before)
        point, direction = locate_root(problem, branch, at, slope_rate)
        branch = branch.insert(at + 1, row(point), row_tangent(point, direction))
    return branch


def survey(problem: Problem) -> list[Branch]:
    """Find every branch of a walker's anthropomorphic gaits that the anchors lead to.

    Returns
    -------
    list of Branch
        In the order of their numbers.
    """
    branches: list[Branch] = []
    m = problem.m
    for slope, w in zip(ANCHORS, search_slopes(problem, ANCHORS), strict=True):
        if not w.shape[1]:
            continue
        _, check = verify_steps(problem, w, np.full(w.shape[1], np.log(slope)))
        new = [i for i in np.nonzero(check.anthropomorphic)[0] if not _is_known(branches, m, w[:, i], np.log(slope))]
        if not new:
            continue
        for pair in follow(problem, w[:, new], np.full(len(new), np.log(slope))):
            if not _is_known(branches, m, np.append(pair[0].X[0][:m], pair[0].times[0]), np.log(slope)):
                for branch in _from_tracks(problem, pair):
                    middle = branch.Z[len(branch.Z) // 2]
                    if not _is_known(branches, m, np.delete(middle, m), middle[m]):
                        branches.append(branch)
    return _rank(branches)


def _rank(branches: list[Branch]) -> list[Branch]:
    """Sort branches in the order of their numbers: by their lowest ln slope, then by ln angle there.

    How far below `MIN_SLOPE` a branch was followed is arbitrary: those that reach it are equal in the first.
    """

    def place(branch: Branch) -> tuple[float, float]:
        lowest = int(branch.q.argmin())
        q = max(float(branch.q[lowest]), np.log(MIN_SLOPE))
        angles = (float(Z[0, 0]) for _, Z, _ in branch.guesses(np.array([q])))
        return q, min(angles, default=float(branch.Z[lowest, 0]))

    return sorted(branches, key=place)


def _is_known(branches: list[Branch], m: int, w: np.ndarray, q: float) -> bool:
    """True where a gait lies on a branch already followed."""
    for branch in branches:
        for _, Z, _ in branch.guesses(np.array([q])):
            if np.abs(np.delete(Z[0], m) - w).max() < 1e-6:
                return True
    return False


def to_arrays(branches: list[Branch]) -> dict[str, np.ndarray]:
    """Return branches as plain arrays, to be stored and passed between processes.

    Returns
    -------
    dict of ndarray
        `lengths`, `why` and `end_errors` of the branches, `m`, and the nodes' arrays of all branches one after another.
    """
    lengths = np.array([len(b.Z) for b in branches], dtype=np.int64)
    if not branches:
        return {"lengths": lengths}
    return {
        "lengths": lengths,
        "m": np.array([branches[0].m]),
        "why": np.array([b.why for b in branches]),
        "end_errors": np.array([b.end_errors for b in branches]),
        **{name: np.concatenate([getattr(b, name) for b in branches]) for name in _BY_NODE},
    }


_BY_NODE = ("Z", "tangent", "lipschitz", "rounding_std", "ratio", "leg_passes", "safe")


def from_arrays(arrays: dict[str, np.ndarray]) -> list[Branch]:
    """Return the branches of stored arrays.

    Parameters
    ----------
    arrays : dict of ndarray
        As `to_arrays` returns them.
    """
    ends = np.cumsum(arrays["lengths"])
    return [
        Branch(
            m=int(arrays["m"][0]),
            why=(str(arrays["why"][i][0]), str(arrays["why"][i][1])),
            end_errors=(float(arrays["end_errors"][i][0]), float(arrays["end_errors"][i][1])),
            **{name: arrays[name][a:b] for name in _BY_NODE},
        )
        for i, (a, b) in enumerate(zip(ends - arrays["lengths"], ends, strict=True))
    ]
