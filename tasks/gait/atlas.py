"""The atlas of a line: every branch of gaits over slope, dense enough that one Newton step finishes any point.

Nodes carry similarity coordinates, event times and q = ln slope, with exact tangents. Between them stands a Hermite
polynomial of degree seven through four nodes, in whichever coordinate runs monotonely there. The atlas depends on the
walker alone, never on a study's grid, so points that start from it are independent of each other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tasks.gait.continuation import Track, correct, follow, lipschitz
from tasks.gait.fixed_point import Problem, judged, rounding, search

#: Slopes searched from nothing for gaits to follow [rad].
ANCHORS = (0.01, 0.03, 0.1, 0.001)
#: Largest change Newton may still make at a segment's middle before the segment is split.
TOLERANCE = 3e-12
MOST_ROUNDS = 5


@dataclass
class Branch:
    """One branch: nodes Z (n, c) = (w, q, times reordered as (X, times)), tangents and Lipschitz estimates.

    `Z` holds X = (w of the section, q) in its first m + 1 columns, then the event times. `why` says how the search
    came to its two ends.
    """

    m: int
    Z: np.ndarray
    tangent: np.ndarray
    lipschitz: np.ndarray
    why: tuple[str, str]

    def __post_init__(self) -> None:
        self._segments()

    @property
    def q(self) -> np.ndarray:
        return self.Z[:, self.m]

    def _segments(self) -> None:
        """Divided differences of every segment's polynomial."""
        n = len(self.Z)
        count = min(4, n)
        left = np.clip(np.arange(n - 1) - 1, 0, n - count)
        window = left[:, None] + np.arange(count)
        Z, T = self.Z[window], self.tangent[window]
        unit = np.abs(T) / np.linalg.norm(T[..., : self.m + 1], axis=-1, keepdims=True)
        same = (np.sign(T) == np.sign(T[:, :1])).all(axis=1)
        worth = np.where(same, unit.min(axis=1), 0.0)[:, : self.m + 1]
        # Prefer the slope itself: then a slope's place on the segment needs no root.
        worth[:, self.m] *= 3
        self.axis = worth.argmax(axis=1)
        rows = np.arange(n - 1)[:, None]
        x = np.repeat(Z[rows, np.arange(count), self.axis[:, None]], 2, axis=1)
        slope = T / T[rows, np.arange(count), self.axis[:, None]][..., None]
        table = np.repeat(Z, 2, axis=1)
        coefficients = [table[:, 0]]
        for order in range(1, 2 * count):
            dx = (x[:, order:] - x[:, :-order])[..., None]
            with np.errstate(divide="ignore", invalid="ignore"):
                new = (table[:, 1:] - table[:, :-1]) / dx
            if order == 1:
                new[:, ::2] = slope
            table = new
            coefficients.append(table[:, 0])
        self.nodes, self.coefficients = x, np.stack(coefficients, axis=1)

    def evaluate(self, segment: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Z at places x of the segments' own coordinates, shape (n, c)."""
        nodes, c = self.nodes[segment], self.coefficients[segment]
        value = c[:, -1]
        for k in reversed(range(c.shape[1] - 1)):
            value = value * (x - nodes[:, k])[:, None] + c[:, k]
        return value

    def place(self, segment: np.ndarray, q: np.ndarray) -> np.ndarray:
        """Where on their segments the slopes lie, by bisection where the coordinate is not the slope itself."""
        direct = self.axis[segment] == self.m
        x = q.copy()
        if not direct.all():
            s, target = segment[~direct], q[~direct]
            a, b = self.Z[s, self.axis[s]], self.Z[s + 1, self.axis[s]]
            rising = self.q[s + 1] > self.q[s]
            for _ in range(60):
                middle = 0.5 * (a + b)
                above = self.evaluate(s, middle)[:, self.m] > target
                up = above == rising
                b, a = np.where(up, middle, b), np.where(up, a, middle)
            x[~direct] = 0.5 * (a + b)
        return x

    def pieces(self) -> list[tuple[int, int]]:
        """Runs of nodes over which the slope is monotone."""
        rising = np.sign(np.diff(self.q))
        cuts = [0, *(np.nonzero(np.diff(rising))[0] + 1).tolist(), len(self.q) - 1]
        return list(zip(cuts[:-1], cuts[1:]))

    def guesses(self, q: np.ndarray) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """For each piece, which slopes it covers: (index into q, Z there, Lipschitz estimate)."""
        found = []
        for first, last in self.pieces():
            nodes = self.q[first:last + 1]
            rising = nodes[-1] > nodes[0]
            ordered = nodes if rising else nodes[::-1]
            inside = np.nonzero((q >= ordered[0]) & (q <= ordered[-1]))[0]
            if not len(inside):
                continue
            k = np.clip(np.searchsorted(ordered, q[inside], side="right") - 1, 0, len(ordered) - 2)
            segment = first + (k if rising else len(ordered) - 2 - k)
            Z = self.evaluate(segment, self.place(segment, q[inside]))
            found.append((inside, Z, np.maximum(self.lipschitz[segment], self.lipschitz[segment + 1])))
        return found


def _insert(problem: Problem, branch: Branch, segments: np.ndarray, x: np.ndarray) -> tuple[Branch, np.ndarray]:
    """Correct points at places x of some segments; returns the branch with them and how far each moved."""
    m = branch.m
    Z = branch.evaluate(segments, x)
    border = branch.tangent[segments][:, : m + 1] + branch.tangent[segments + 1][:, : m + 1]
    border /= np.linalg.norm(border, axis=1, keepdims=True)
    point = correct(problem, Z[:, : m + 1].T, Z[:, m + 1:].T, border.T)
    moved = np.where(point.ok, np.abs(point.X.T - Z[:, : m + 1]).max(axis=1), np.inf)
    sign = np.sign((point.tangent.T * border).sum(axis=1))[:, None]
    new_Z = np.vstack([point.X, point.times]).T
    new_T = np.vstack([point.tangent, point.times_tangent]).T * sign
    # Below the rounding of the fixed point itself no split would help.
    keep = point.ok & (moved > np.maximum(TOLERANCE, 30 * rounding(point.stride).max(axis=0)))
    at = segments[keep] + 1
    return Branch(m, np.insert(branch.Z, at, new_Z[keep], axis=0), np.insert(branch.tangent, at, new_T[keep], axis=0),
                  np.zeros(len(branch.Z) + keep.sum()), branch.why), moved


def _with_folds(problem: Problem, branch: Branch) -> Branch:
    """Put a node on every fold, where the slope turns."""
    m = branch.m
    segments = np.nonzero(np.diff(np.sign(branch.tangent[:, m])) != 0)[0]
    for segment in segments[::-1]:
        s = np.array([segment])
        a, b = branch.Z[segment, branch.axis[segment]], branch.Z[segment + 1, branch.axis[segment]]
        h = 1e-4 * (b - a)
        rising = branch.tangent[segment, m] > 0
        for _ in range(50):
            middle = 0.5 * (a + b)
            ahead = branch.evaluate(s, np.array([middle + h]))[0, m] - branch.evaluate(s, np.array([middle - h]))[0, m]
            a, b = (middle, b) if (ahead > 0) == rising else (a, middle)
        branch, _ = _insert(problem, branch, s, np.array([0.5 * (a + b)]))
    return branch


def _from_tracks(problem: Problem, pair: list[Track]) -> Branch | None:
    """Join both directions, keep what are steps, refine, and measure."""
    m = problem.m
    down, up = pair
    X = np.array(down.X[:0:-1] + up.X)
    times = np.array(down.times[:0:-1] + up.times)
    tangent = np.array([-t for t in down.tangent[:0:-1]] + up.tangent)
    times_tangent = np.array([-t for t in down.times_tangent[:0:-1]] + up.times_tangent)
    Z, T = np.hstack([X, times]), np.hstack([tangent, times_tangent])
    _, verdict = judged(problem, np.vstack([X[:, :m].T, times.T]), X[:, m])
    start = len(down.X) - 1
    good = verdict.step
    if not good[start]:
        return None
    low = start - np.argmin(np.append(good[start::-1], False)) + 1
    high = start + np.argmin(np.append(good[start:], False))
    if high - low < 4:
        return None
    why = (down.stopped if low == 0 else "not a step", up.stopped if high == len(Z) else "not a step")
    branch = Branch(m, Z[low:high], T[low:high], np.zeros(high - low), why)
    branch = _with_folds(problem, branch)
    for _ in range(MOST_ROUNDS):
        segments = np.arange(len(branch.Z) - 1)
        x = 0.5 * (branch.Z[segments, branch.axis] + branch.Z[segments + 1, branch.axis])
        before = len(branch.Z)
        branch, _ = _insert(problem, branch, segments, x)
        if len(branch.Z) == before:
            break
    branch.lipschitz = lipschitz(problem, branch.Z[:, : m + 1].T, branch.Z[:, m + 1:].T)
    return branch


def survey(problem: Problem) -> list[Branch]:
    """Every branch of a walker's anthropomorphic gaits that the anchors lead to."""
    branches: list[Branch] = []
    m = problem.m
    for slope in ANCHORS:
        w, _, verdict = search(problem, slope)
        if verdict is None:
            continue
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
        return {"lengths": lengths, "Z": np.zeros((0, 0)), "tangent": np.zeros((0, 0)), "lipschitz": np.zeros(0),
                "why": np.zeros((0, 2), "U1"), "m": np.array([0])}
    return {"lengths": lengths, "Z": np.concatenate([b.Z for b in branches]),
            "tangent": np.concatenate([b.tangent for b in branches]),
            "lipschitz": np.concatenate([b.lipschitz for b in branches]),
            "why": np.array([b.why for b in branches]), "m": np.array([branches[0].m])}


def from_arrays(arrays: dict[str, np.ndarray]) -> list[Branch]:
    """Branches from the arrays of `to_arrays`."""
    ends = np.cumsum(arrays["lengths"])
    found = []
    for i, (a, b) in enumerate(zip(ends - arrays["lengths"], ends)):
        found.append(Branch(int(arrays["m"][0]), arrays["Z"][a:b], arrays["tangent"][a:b], arrays["lipschitz"][a:b],
                            (str(arrays["why"][i][0]), str(arrays["why"][i][1]))))
    return found
