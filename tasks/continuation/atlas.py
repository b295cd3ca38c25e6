"""The atlas of a line: every branch of gaits over slope, dense enough that one Newton step finishes any point.

Nodes carry similarity coordinates, event times and q = ln slope, with exact tangents. Between them stands a Hermite
polynomial of degree seven through four nodes, in whichever coordinate runs monotonely there. The atlas depends on the
walker alone, never on a study's grid, so points that start from it are independent of each other.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tasks.continuation.branch import Branch
from tasks.continuation.special_points import (
    correct_at,
    end_of,
    is_step,
    locate_root,
    narrowed,
    oriented,
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

#: Slopes searched from nothing for gaits to follow [rad].
ANCHORS = (0.01, 0.03, 0.1, 0.001, 0.2)
#: Largest change Newton may still make at a segment's middle before the segment is split.
TOLERANCE = 2e-13
MAX_ROUNDS = 5
#: A split that leaves more than this of the change may show rounding: one more is tried, and no other.
MIN_IMPROVEMENT = 0.25
#: Nodes either way whose rounding speaks for a segment's.
ROUNDING_WINDOW = 4


def _refine(
    problem: Problem, branch: Branch, segments: np.ndarray, before: np.ndarray
) -> tuple[Branch, np.ndarray, np.ndarray]:
    """Correct the middles of some segments and split those that moved.

    `before` (n - 1,) is how far the middle moved of the segment that each was split from, 0 where it is split for the
    last time. Returned are the branch, its segments that changed, and `before` for them all.
    """
    m = branch.m
    x = 0.5 * (branch.Z[segments, branch.axis[segments]] + branch.Z[segments + 1, branch.axis[segments]])
    # Where a node is all but singular its polynomial may lead anywhere.
    a, b = branch.Z[segments], branch.Z[segments + 1]
    apart = np.abs(b - a).max(axis=1, keepdims=True)
    Z = np.clip(branch.evaluate(segments, x), np.minimum(a, b) - apart, np.maximum(a, b) + apart)
    border = branch.tangent[segments][:, : m + 1] + branch.tangent[segments + 1][:, : m + 1]
    border /= np.linalg.norm(border, axis=1, keepdims=True)
    point = correct(problem, Z[:, : m + 1].T, Z[:, m + 1 :].T, border.T)
    # Newton may have jumped to another branch: a middle lies between its neighbours, or is none.
    point.ok &= branch.lies_between(segments, point.X, point.times)
    moved = np.where(point.ok, np.abs(point.X.T - Z[:, : m + 1]).max(axis=1), np.inf)
    sign = np.sign((point.tangent.T * border).sum(axis=1))[:, None]
    new_Z = np.vstack([point.X, point.times]).T
    new_T = np.vstack([point.tangent, point.times_tangent]).T * sign
    # Below the rounding of the fixed point itself no split helps: by its estimate, or where the last one has not.
    keep = point.ok & (moved > np.maximum(TOLERANCE, 7 * rounding(point.stride).max(axis=0)))
    keep &= before[segments] > 0
    at = segments[keep] + 1
    part = np.where(moved < MIN_IMPROVEMENT * before[segments], moved, 0.0)[keep]
    before[segments[keep]] = part
    before = np.insert(before, at, part)
    fresh = np.insert(np.zeros(len(branch.Z), bool), at, True)
    branch = branch.inserted(at, new_Z[keep], new_T[keep])
    return branch, np.nonzero(fresh[branch.window].any(axis=1))[0], before


def _joined(m: int, pair: list[BranchTrace]) -> tuple[Branch, int]:
    """Both directions as one branch, and the index of the start on it."""
    down, up = pair
    X = np.array(down.X[:0:-1] + up.X)
    times = np.array(down.times[:0:-1] + up.times)
    tangent = np.array([-t for t in down.tangent[:0:-1]] + up.tangent)
    times_tangent = np.array([-t for t in down.times_tangent[:0:-1]] + up.times_tangent)
    Z, T = np.hstack([X, times]), np.hstack([tangent, times_tangent])
    return Branch(m, Z, T, np.zeros(len(Z)), (down.stopped, up.stopped)), len(down.X) - 1


def _from_tracks(problem: Problem, pair: list[BranchTrace]) -> list[Branch]:
    """Join both directions, keep what are steps up to the located ends, refine, and measure."""
    raw, start = _joined(problem.m, pair)
    if len(raw.Z) < 4:
        return []
    steps = _steps_at(problem, raw)
    if not steps[start]:
        return []
    branches: list[Branch] = []
    for first, last in _runs(steps):
        branch = _with_ends(problem, raw, first, last)
        if branch is not None:
            branches += _without_gaps(problem, _refined(problem, _with_folds(problem, branch)))
    return branches


def _steps_at(problem: Problem, branch: Branch) -> np.ndarray:
    """Which nodes are steps, shape (n,)."""
    m = branch.m
    X, times = branch.Z[:, : m + 1].T, branch.Z[:, m + 1 :].T
    _, verdict = verify_steps(problem, np.vstack([X[:m], times]), X[m])
    return verdict.step


def _runs(true: np.ndarray) -> list[tuple[int, int]]:
    """First and last index of every run of true values."""
    edges = np.diff(np.concatenate([[0], true.astype(int), [0]]))
    return list(zip(np.nonzero(edges == 1)[0].tolist(), (np.nonzero(edges == -1)[0] - 1).tolist(), strict=True))


def _with_ends(problem: Problem, raw: Branch, first: int, last: int) -> Branch | None:
    """A run of nodes that are steps, up to where it ends between nodes; None where that leaves no branch."""
    why, errors, nodes = list(raw.why), list(raw.end_errors), len(raw.Z)
    whole, ends = (first == 0, last == nodes - 1), {}
    if not whole[1]:
        raw, last = narrowed(problem, raw, last, lambda point, way: is_step(problem, point))
        why[1], *ends[1], errors[1] = end_of(problem, raw, last, last + 1)
    if not whole[0]:
        before = len(raw.Z)
        raw, segment = narrowed(problem, raw, first - 1, lambda point, way: not is_step(problem, point))
        first, last = segment + 1, last + len(raw.Z) - before
        why[0], *ends[0], errors[0] = end_of(problem, raw, first, segment)
    for side, segment in ((0, 0), (1, len(raw.Z) - 2)):
        if whole[side] and why[side] == "a fall":
            ends[side] = locate_root(
                problem, raw, segment, lambda point, way: fall_margin(point.X[:, 0], point.times[:, 0])
            )
            first, last = first + (side == 0), last - (side == 1)
    branch = raw.part(first, last)
    if 0 in ends:
        branch = branch.inserted(0, row(ends[0][0]), row_tangent(*ends[0]))
    if 1 in ends:
        branch = branch.inserted(len(branch.Z), row(ends[1][0]), row_tangent(*ends[1]))
    if len(branch.Z) < 3:
        return None
    return replace(branch, why=(why[0], why[1]), end_errors=(errors[0], errors[1]))


def _refined(problem: Problem, branch: Branch) -> Branch:
    """The branch with so many nodes that its polynomials lead Newton to rounding in one step."""
    segments = np.arange(len(branch.Z) - 1)
    before = np.full(len(segments), np.inf)
    for _ in range(MAX_ROUNDS):
        branch, segments, before = _refine(problem, branch, segments, before)
        if not len(segments):
            break
    return branch


def _without_gaps(problem: Problem, branch: Branch) -> list[Branch]:
    """The measured branch; where an earlier strike cuts in on the way, what lies on either side of it."""
    near, steps = _measured(problem, branch)
    steps[[0, -1]] = True
    gaps = _gaps(problem, branch, near, steps)
    if steps.all() and not gaps:
        return [branch]
    for place in sorted(gaps, reverse=True):
        segment = int(place)
        a, b = branch.Z[segment : segment + 2, branch.axis[segment]]
        point, way = correct_at(problem, branch, segment, a + (b - a) * (place - segment))
        branch = branch.inserted(segment + 1, row(point), row_tangent(point, way))
        steps = np.insert(steps, segment + 1, False)
    parts = [_with_ends(problem, branch, first, last) for first, last in _runs(steps)]
    branches = [_refined(problem, part) for part in parts if part is not None]
    for part in branches:
        _measured(problem, part)
    return branches


def _gaps(problem: Problem, branch: Branch, near: np.ndarray, steps: np.ndarray) -> list[float]:
    """Places of a branch, segment and part of it, where an earlier strike cuts in between nodes that are steps.

    Parameters
    ----------
    near, steps : ndarray, shape (n,)
        How far the nodes are from an earlier strike, and whether they are steps: `_measured`.
    """
    m, found = branch.m, []
    with np.errstate(invalid="ignore"):
        bend = near[:-2] - 2 * near[1:-1] + near[2:]
        near = np.where(steps, near, np.nan)
        least = (near[1:-1] <= near[:-2]) & (near[1:-1] <= near[2:]) & ~(near[1:-1] > bend)
    for i in np.nonzero(least & np.isfinite(near[1:-1]) & ~(branch.safe[:-2] & branch.safe[1:-1]))[0] + 1:
        low, high = i - 1.0, i + 1.0
        for _ in range(MAX_ROUNDS):
            place = np.linspace(low, high, 9)
            rows = branch.at(place)
            w = np.delete(rows, m, axis=1).T
            stride, _ = problem.stride(w, rows[:, m], samples=8 * SAMPLES)
            away = strike_distance(stride.scaled_motion(), stride.times)
            k = int(np.argmin(away[1:-1])) + 1
            if away[k] < 0 and not verify_steps(problem, w[:, k : k + 1], rows[k : k + 1, m])[1].step[0]:
                found.append(float(place[k]))
                break
            if away[k] > max(away[k - 1], away[k + 1]) - away[k]:
                break
            low, high = place[k - 1], place[k + 1]
    return found


def _measured(problem: Problem, branch: Branch) -> tuple[np.ndarray, np.ndarray]:
    """Measure Lipschitz estimates, gait ratios, and which segments need no verdict of their own.

    Returns
    -------
    near, steps : ndarray, shape (n,)
        How far the nodes are from an earlier strike (`margin`), and whether they are steps.
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
    # A guard adds two angles, and a stride between two nodes lies within their distance of one of them.
    margin[:-1] = 2 * apart
    margin[1:] = np.maximum(margin[1:], 2 * apart)
    verdict = verify(motion, stride.closing / stride.y[0], stride.times, margin)
    calm = verdict.step & ~verdict.doubt
    branch.leg_passes = verdict.leg_passes
    branch.safe = np.append(calm[1:] & calm[:-1] & (verdict.leg_passes[1:] == verdict.leg_passes[:-1]), False)
    return strike_distance(motion, stride.times), verdict.step


def _roughness(problem: Problem, X: np.ndarray, times: np.ndarray, folds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lipschitz estimates at a branch's nodes (n,), and the noise of the strides after each (n, o).

    Measured at every other node. Between two of them Newton's map is as rough as at the rougher; noise is chance, and
    that of a segment the mean square of the nodes near by. At a fold the map at fixed slope is singular, its estimate
    infinite.
    """
    m, n = problem.m, X.shape[1]
    # At its ends they may change by orders of magnitude from node to node.
    nodes = np.unique(np.r_[0 : min(n, 4), 0:n:2, max(0, n - 4) : n, folds - 1, folds + 1])
    lipschitz_at_nodes = np.full(n, -np.inf)
    lipschitz_at_nodes[nodes] = lipschitz(problem, X[:, nodes], times[:, nodes])
    lipschitz_at_nodes[folds] = np.inf
    left, right = (
        np.append(lipschitz_at_nodes[:1], lipschitz_at_nodes[:-1]),
        np.append(lipschitz_at_nodes[1:], lipschitz_at_nodes[-1:]),
    )
    # The ends themselves are left out: at a tangential one the map has no derivative to measure by.
    inner = nodes[(nodes > 0) & (nodes < n - 1)]
    measured = rounding_std(problem, np.vstack([X[:m], times])[:, inner], X[m, inner])
    square = np.full((len(measured), n + 2 * ROUNDING_WINDOW), np.nan)
    square[:, ROUNDING_WINDOW + inner] = measured**2
    around = np.lib.stride_tricks.sliding_window_view(square, 2 * ROUNDING_WINDOW + 1, axis=1)
    known = np.isfinite(around)
    with np.errstate(invalid="ignore"):
        mean = np.sqrt(np.where(known, around, 0.0).sum(axis=-1) / known.sum(axis=-1))
    return np.where(np.isneginf(lipschitz_at_nodes), np.maximum(left, right), lipschitz_at_nodes), np.nan_to_num(
        mean, nan=np.inf
    ).T


def _with_folds(problem: Problem, branch: Branch) -> Branch:
    """Put a node on every fold, where the slope turns."""
    m = branch.m

    def direction(point: Point, way: np.ndarray) -> float:
        return float(oriented(point, way)[m])

    for segment in np.nonzero(np.diff(np.sign(branch.tangent[:, m])) != 0)[0][::-1]:
        sign = np.sign(branch.tangent[segment, m])
        branch, at = narrowed(
            problem, branch, int(segment), lambda point, way, sign=sign: direction(point, way) * sign > 0
        )
        point, way = locate_root(problem, branch, at, direction)
        branch = branch.inserted(at + 1, row(point), row_tangent(point, way))
    return branch


def survey(problem: Problem) -> list[Branch]:
    """Every branch of a walker's anthropomorphic gaits that the anchors lead to."""
    branches: list[Branch] = []
    m = problem.m
    for slope, w in zip(ANCHORS, search_slopes(problem, ANCHORS)):
        if not w.shape[1]:
            continue
        _, verdict = verify_steps(problem, w, np.full(w.shape[1], np.log(slope)))
        fresh = [i for i in np.nonzero(verdict.anthropomorphic)[0] if not _known(branches, m, w[:, i], np.log(slope))]
        if not fresh:
            continue
        for pair in follow(problem, w[:, fresh], np.full(len(fresh), np.log(slope))):
            if not _known(branches, m, np.append(pair[0].X[0][:m], pair[0].times[0]), np.log(slope)):
                for branch in _from_tracks(problem, pair):
                    middle = branch.Z[len(branch.Z) // 2]
                    if not _known(branches, m, np.delete(middle, m), middle[m]):
                        branches.append(branch)
    return ranked(branches)


def ranked(branches: list[Branch]) -> list[Branch]:
    """Branches in the order of their numbers: by their lowest ln slope, then by ln angle there.

    How far below `LEAST_SLOPE` a branch was followed is chance: those that come to it are equal in the first.
    """

    def place(branch: Branch) -> tuple[float, float]:
        lowest = int(branch.q.argmin())
        q = max(float(branch.q[lowest]), np.log(MIN_SLOPE))
        there = (float(Z[0, 0]) for _, Z, _ in branch.guesses(np.array([q])))
        return q, min(there, default=float(branch.Z[lowest, 0]))

    return sorted(branches, key=place)


def _known(branches: list[Branch], m: int, w: np.ndarray, q: float) -> bool:
    """True where a gait lies on a branch already followed."""
    for branch in branches:
        for _, Z, _ in branch.guesses(np.array([q])):
            if np.abs(np.delete(Z[0], m) - w).max() < 1e-6:
                return True
    return False


def to_arrays(branches: list[Branch]) -> dict[str, np.ndarray]:
    """Branches as plain arrays, to be kept and passed between processes."""
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
    """Branches from the arrays of `to_arrays`."""
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
