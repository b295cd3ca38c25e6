"""The atlas of a line: every branch of gaits over slope, dense enough that one Newton step finishes any point.

Nodes carry similarity coordinates, event times and q = ln slope, with exact tangents. Between them stands a Hermite
polynomial of degree seven through four nodes, in whichever coordinate runs monotonely there. The atlas depends on the
walker alone, never on a study's grid, so points that start from it are independent of each other.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tasks.gait.branch import Branch
from tasks.gait.continuation import Track, correct, fallen, follow, lipschitz
from tasks.gait.fixed_point import Problem, found_at, gait_ratio, judged, noise, rounding
from tasks.gait.special_points import end_of, located, oriented, row, row_tangent
from tasks.gait.stride import SAMPLES
from tasks.gait.verify import verify

#: Slopes searched from nothing for gaits to follow [rad].
ANCHORS = (0.01, 0.03, 0.1, 0.001, 0.2)
#: Largest change Newton may still make at a segment's middle before the segment is split.
TOLERANCE = 2e-13
MOST_ROUNDS = 5
#: A split that leaves more than this of the change may show rounding: one more is tried, and no other.
HELPED = 0.25
#: Nodes either way whose rounding speaks for a segment's.
NEAR_BY = 4


def _insert(problem: Problem, branch: Branch, segments: np.ndarray,
            before: np.ndarray) -> tuple[Branch, np.ndarray, np.ndarray]:
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
    point = correct(problem, Z[:, : m + 1].T, Z[:, m + 1:].T, border.T)
    moved = np.where(point.ok, np.abs(point.X.T - Z[:, : m + 1]).max(axis=1), np.inf)
    sign = np.sign((point.tangent.T * border).sum(axis=1))[:, None]
    new_Z = np.vstack([point.X, point.times]).T
    new_T = np.vstack([point.tangent, point.times_tangent]).T * sign
    # Below the rounding of the fixed point itself no split helps: by its estimate, or where the last one has not.
    keep = point.ok & (moved > np.maximum(TOLERANCE, 7 * rounding(point.stride).max(axis=0)))
    keep &= before[segments] > 0
    at = segments[keep] + 1
    part = np.where(moved < HELPED * before[segments], moved, 0.0)[keep]
    before[segments[keep]] = part
    before = np.insert(before, at, part)
    fresh = np.insert(np.zeros(len(branch.Z), bool), at, True)
    branch = replace(branch, Z=np.insert(branch.Z, at, new_Z[keep], axis=0),
                     tangent=np.insert(branch.tangent, at, new_T[keep], axis=0))
    return branch, np.nonzero(fresh[branch.window].any(axis=1))[0], before


def _joined(m: int, pair: list[Track]) -> tuple[Branch, int]:
    """Both directions as one branch, and the index of the start on it."""
    down, up = pair
    X = np.array(down.X[:0:-1] + up.X)
    times = np.array(down.times[:0:-1] + up.times)
    tangent = np.array([-t for t in down.tangent[:0:-1]] + up.tangent)
    times_tangent = np.array([-t for t in down.times_tangent[:0:-1]] + up.times_tangent)
    Z, T = np.hstack([X, times]), np.hstack([tangent, times_tangent])
    return Branch(m, Z, T, np.zeros(len(Z)), (down.stopped, up.stopped)), len(down.X) - 1


def _from_tracks(problem: Problem, pair: list[Track]) -> Branch | None:
    """Join both directions, keep what are steps up to the located ends, refine, and measure."""
    m = problem.m
    raw, start = _joined(m, pair)
    if len(raw.Z) < 4:
        return None
    X, times = raw.Z[:, : m + 1].T, raw.Z[:, m + 1:].T
    _, verdict = judged(problem, np.vstack([X[:m], times]), X[m])
    good = verdict.step
    if not good[start]:
        return None
    low = start - np.argmin(np.append(good[start::-1], False)) + 1
    high = start + np.argmin(np.append(good[start:], False)) - 1
    Z, T, why, errors = raw.Z[low:high + 1].copy(), raw.tangent[low:high + 1].copy(), list(raw.why), [0.0, 0.0]
    if low > 0:
        why[0], point, way, errors[0] = end_of(problem, raw, low - 1, start)
        Z, T = np.vstack([row(point), Z]), np.vstack([row_tangent(point, way), T])
    if high < len(raw.Z) - 1:
        why[1], point, way, errors[1] = end_of(problem, raw, high, start)
        Z, T = np.vstack([Z, row(point)]), np.vstack([T, row_tangent(point, way)])
    if len(Z) < 4:
        return None
    for end, segment in ((0, 0), (-1, len(raw.Z) - 2)):
        if why[end] == "a fall":
            point, way = located(problem, raw, segment, lambda point, way: fallen(point.X[:, 0], point.times[:, 0]))
            Z[end], T[end] = row(point), row_tangent(point, way)
    branch = _with_folds(problem, Branch(m, Z, T, np.zeros(len(Z)), (why[0], why[1]), (errors[0], errors[1])))
    segments = np.arange(len(branch.Z) - 1)
    before = np.full(len(segments), np.inf)
    for _ in range(MOST_ROUNDS):
        branch, segments, before = _insert(problem, branch, segments, before)
        if not len(segments):
            break
    return _measured(problem, branch)


def _measured(problem: Problem, branch: Branch) -> Branch:
    """The branch with its Lipschitz estimates, gait ratios, and which segments need no verdict of their own."""
    m = branch.m
    X, times = branch.Z[:, : m + 1].T, branch.Z[:, m + 1:].T
    branch.lipschitz, branch.noise = _roughness(problem, X, times)
    stride, scale = problem.stride(np.vstack([X[:m], times]), X[m], samples=8 * SAMPLES)
    branch.ratio = gait_ratio(stride)
    assert stride.motion is not None
    # Angles and rates over the stance angle, so that neighbours' motions may be compared.
    motion = [part / stride.y[0] for part in stride.motion]
    n = len(branch.Z)
    stray = np.zeros(n)
    apart = np.max([np.abs(np.diff(part, axis=-1)).max(axis=(0, 1)) for part in motion], axis=0)
    # A guard adds two angles, and a stride between two nodes lies within their distance of one of them.
    stray[:-1] = 2 * apart
    stray[1:] = np.maximum(stray[1:], 2 * apart)
    verdict = verify(motion, stride.closing / stride.y[0], stride.times, stray)
    calm = verdict.step & ~verdict.doubt
    branch.passes = verdict.passes
    branch.safe = np.append(calm[1:] & calm[:-1] & (verdict.passes[1:] == verdict.passes[:-1]), False)
    return branch


def _roughness(problem: Problem, X: np.ndarray, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lipschitz estimates at a branch's nodes (n,), and the noise of the strides after each (n, o).

    Measured at every other node. Between two of them Newton's map is as rough as at the rougher; noise is chance, and
    that of a segment the mean square of the nodes near by.
    """
    m, n = problem.m, X.shape[1]
    # At its ends they may change by orders of magnitude from node to node.
    some = np.unique(np.r_[0:min(n, 4), 0:n:2, max(0, n - 4):n])
    rough = np.full(n, -np.inf)
    rough[some] = lipschitz(problem, X[:, some], times[:, some])
    left, right = np.append(rough[:1], rough[:-1]), np.append(rough[1:], rough[-1:])
    # The ends themselves are left out: at a tangential one the map has no derivative to measure by.
    inner = some[(some > 0) & (some < n - 1)]
    measured = noise(problem, np.vstack([X[:m], times])[:, inner], X[m, inner])
    square = np.full((len(measured), n + 2 * NEAR_BY), np.nan)
    square[:, NEAR_BY + inner] = measured**2
    around = np.lib.stride_tricks.sliding_window_view(square, 2 * NEAR_BY + 1, axis=1)
    known = np.isfinite(around)
    with np.errstate(invalid="ignore"):
        mean = np.sqrt(np.where(known, around, 0.0).sum(axis=-1) / known.sum(axis=-1))
    return np.where(np.isneginf(rough), np.maximum(left, right), rough), np.nan_to_num(mean, nan=np.inf).T


def _with_folds(problem: Problem, branch: Branch) -> Branch:
    """Put a node on every fold, where the slope turns."""
    m = branch.m
    for segment in np.nonzero(np.diff(np.sign(branch.tangent[:, m])) != 0)[0][::-1]:
        point, way = located(problem, branch, segment, lambda point, way: oriented(point, way)[m])
        branch = replace(branch, Z=np.insert(branch.Z, segment + 1, row(point), axis=0),
                         tangent=np.insert(branch.tangent, segment + 1, row_tangent(point, way), axis=0))
    return branch


def survey(problem: Problem) -> list[Branch]:
    """Every branch of a walker's anthropomorphic gaits that the anchors lead to."""
    branches: list[Branch] = []
    m = problem.m
    for slope, w in zip(ANCHORS, found_at(problem, ANCHORS)):
        if not w.shape[1]:
            continue
        _, verdict = judged(problem, w, np.full(w.shape[1], np.log(slope)))
        fresh = [i for i in np.nonzero(verdict.anthropomorphic)[0] if not _known(branches, m, w[:, i], np.log(slope))]
        if not fresh:
            continue
        for pair in follow(problem, w[:, fresh], np.full(len(fresh), np.log(slope))):
            branch = _from_tracks(problem, pair)
            start = np.append(pair[0].X[0][:m], pair[0].times[0])
            if branch is not None and not _known(branches, m, start, np.log(slope)):
                branches.append(branch)
    return branches


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
    return {"lengths": lengths, "m": np.array([branches[0].m]), "why": np.array([b.why for b in branches]),
            "end_errors": np.array([b.end_errors for b in branches]),
            **{name: np.concatenate([getattr(b, name) for b in branches]) for name in _BY_NODE}}


_BY_NODE = ("Z", "tangent", "lipschitz", "noise", "ratio", "passes", "safe")


def from_arrays(arrays: dict[str, np.ndarray]) -> list[Branch]:
    """Branches from the arrays of `to_arrays`."""
    ends = np.cumsum(arrays["lengths"])
    return [Branch(m=int(arrays["m"][0]), why=(str(arrays["why"][i][0]), str(arrays["why"][i][1])),
                   end_errors=(float(arrays["end_errors"][i][0]), float(arrays["end_errors"][i][1])),
                   **{name: arrays[name][a:b] for name in _BY_NODE})
            for i, (a, b) in enumerate(zip(ends - arrays["lengths"], ends, strict=True))]
