"""Branches of gaits that repeat after n steps: from the flips of gaits of n/2 steps, and from a search."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from tasks.continuation.branch import Branch
from tasks.continuation.cycles import MAX_POINTS, Cycle, Path, at_slope, correct, doubled, flip_test, really_walks
from tasks.continuation.root import bracketed_root, hermite
from tasks.locate_cascade import search_cycles
from tasks.step.problem import Problem

Arrays = dict[str, np.ndarray]
#: Slopes of the search for gaits that no flip begins, over the slope of the first flip, and initial states at each.
_SEARCHED, _STARTS = np.linspace(0.8, 1.4, 9), 300
#: Largest slope [rad], first step along a branch in ln slope, and the step at which its end is located.
_MAX_SLOPE, _FIRST_STEP, _MIN_STEP = 0.5, 2e-3, 1e-6
#: Largest multiplier up to which branches are followed.
MAX_MULTIPLIER = 20.0
#: Length in ln slope that a doubled branch is taken to have: its first point is near enough to its flip for a cubic.
_EXPECTED = 5e-4
#: Distance of sections, over the angle, within which two gaits are the same.
_SAME = 1e-7
#: Intervals of a segment in which its gaits at a slope are bracketed.
_INTERVALS = 8


@dataclass
class CycleBranch:
    """One branch of gaits of period n: its corrected gaits, between which cubic polynomials run, and its flips."""

    cycles: list[Cycle]
    flips: list[Cycle]

    @functools.cached_property
    def rises(self) -> list[bool]:
        """Whether the slope rises along the branch at each gait; at the flip that begins it, as after it."""
        return [
            (c.tangent[-1] or after.tangent[-1]) > 0
            for c, after in zip(self.cycles, [*self.cycles[1:], self.cycles[-1]], strict=True)
        ]

    def guesses(self, log_slope: float) -> Iterator[tuple[int, np.ndarray, np.ndarray]]:
        """Guesses of the gaits at one slope.

        Parameters
        ----------
        log_slope : float

        Yields
        ------
        piece : int
            Number of the piece between folds.
        Y, times : ndarray, shape (m, n) and (k, n)
            Sections [rad, rad/sqrt(leg/g)] and event times [sqrt(leg/g)].
        """
        piece = 0
        for i in range(len(self.cycles) - 1):
            a, b, rises = self.cycles[i], self.cycles[i + 1], self.rises[i]
            length = float(np.linalg.norm(b.Z - a.Z))
            point = functools.partial(hermite, a.Z, a.tangent, b.Z, b.tangent, length)
            # Near a fold the slope leaves the interval of the ends, by less than the segment's length.
            if min(a.q, b.q) - length <= log_slope <= max(a.q, b.q) + length:
                h = np.linspace(0.0, 1.0, _INTERVALS + 1)
                off = np.array([point(x)[-1] for x in h]) - log_slope
                for j in np.flatnonzero((off[:-1] < 0) != (off[1:] < 0)).tolist():
                    root = bracketed_root(functools.partial(_slope_off, point, log_slope), h[j], h[j + 1])
                    Y = point(root)[:-1].reshape(a.period, -1).T * np.sqrt(a.period)
                    beyond_fold = (off[j + 1] > off[j]) != rises
                    yield piece + beyond_fold, Y, a.times * (1 - root) + b.times * root
            piece += rises != self.rises[i + 1]


def _slope_off(point: Callable[[float], np.ndarray], log_slope: float, h: float) -> float:
    """Distance in ln slope of a segment's point at the fraction h."""
    return float(point(h)[-1]) - log_slope


def to_arrays(branches: list[CycleBranch]) -> Arrays:
    """Branches as arrays, without their flips.

    Parameters
    ----------
    branches : list of CycleBranch

    Returns
    -------
    dict of ndarray
        By the number of the branch: `Y`, shape (gaits, m, n), `times`, (gaits, k, n), `q`, (gaits,), and `tangent`.
    """
    names = ("Y", "times", "q", "tangent")
    return {
        f"{i}/{name}": np.array([getattr(c, name) for c in b.cycles]) for i, b in enumerate(branches) for name in names
    }


def from_arrays(arrays: Arrays) -> list[CycleBranch]:
    """Branches from the arrays of `to_arrays`.

    Parameters
    ----------
    arrays : dict of ndarray

    Returns
    -------
    list of CycleBranch
        Whose gaits have no Jacobians.
    """
    branches = []
    for i in range(len({name.partition("/")[0] for name in arrays})):
        columns = (arrays[f"{i}/{name}"] for name in ("Y", "times", "q", "tangent"))
        cycles = [Cycle(Y, t, float(q), np.empty(0), T, True, 0.0) for Y, t, q, T in zip(*columns, strict=True)]
        branches.append(CycleBranch(cycles, []))
    return branches


def cycle_branches(problem: Problem, branches: list[Branch], n: int) -> list[CycleBranch]:
    """Follow every branch of gaits of period n that a flip begins or a search finds.

    Parameters
    ----------
    problem : Problem
    branches : list of Branch
        The line's atlas.
    n : int
        Number of steps after which the gaits repeat, at least 2.

    Returns
    -------
    list of CycleBranch
        By their lowest slopes.
    """
    single = [flip for branch in branches for flip in _flips(problem, branch)]
    flips, period, doublings = single, 1, list[CycleBranch]()
    while n % (2 * period) == 0:
        period *= 2
        doublings = [branch for flip in flips for branch in [_from_flip(problem, flip)] if branch]
        flips = [flip for branch in doublings for flip in branch.flips]
    followed = _distinct(problem, doublings if period == n else [])
    if n > 2 and single:
        followed += _searched(problem, branches, n, min(flip.slope for flip in single), followed)
    return sorted(followed, key=lambda branch: min(c.q for c in branch.cycles))


def _flips(problem: Problem, branch: Branch) -> Iterator[Cycle]:
    """Flips of a branch of gaits of one step."""
    m, q = problem.m, branch.q
    w = np.delete(branch.Z, m, axis=1).T
    angle = np.exp(w[0])
    Y, times = np.vstack([angle, angle * w[1:m]]), w[m:]
    step, _ = problem.stride(w, q)
    sign = np.sign([np.linalg.det(np.eye(m) + step.jacobian[:, :, i]) for i in range(len(q))])
    for i in np.flatnonzero((sign[:-1] * sign[1:] < 0) & (branch.leg_passes[:-1] == 1)).tolist():
        ends = [np.append(Y[:, k], q[k]) for k in (i, i + 1)]
        chord = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
        a, b = (correct(problem, Z, times[:, [k]], chord) for Z, k in zip(ends, (i, i + 1), strict=True))
        if a.ok and b.ok and flip_test(a) * flip_test(b) < 0:
            path = Path(problem, a, chord, 1.0)
            path.points.append(b if b.tangent @ chord > 0 else _reversed(b))
            flip = path.locate_root(flip_test)
            if flip.ok:
                yield flip


def _reversed(cycle: Cycle) -> Cycle:
    cycle.tangent = -cycle.tangent
    return cycle


def _from_flip(problem: Problem, flip: Cycle) -> CycleBranch | None:
    """The branch of twice the period that begins at a flip, the flip itself its first gait."""
    path = doubled(problem, flip, _EXPECTED)
    if path is None:
        return None
    first = path.points[0]
    cycles, flips = _continue(problem, path)
    Y, times = np.tile(flip.Y, 2), np.tile(flip.times, 2)
    # The halves leave the flip to opposite sides; all else changes by the square of the distance.
    tangent = np.append((first.Y - np.roll(first.Y, flip.period, axis=1)).T.ravel(), 0.0)
    begin = Cycle(Y, times, flip.q, np.tile(flip.A, 2), tangent / np.linalg.norm(tangent), True, flip.error)
    return CycleBranch([begin, *cycles], flips) if cycles else None


def _continue(problem: Problem, path: Path) -> tuple[list[Cycle], list[Cycle]]:
    """Gaits along a path while they walk and keep their period, and the flips that it passes."""
    if not really_walks(problem, path.points[0]):
        return [], []
    flips: list[Cycle] = []
    for _ in range(MAX_POINTS):
        step = path.step
        if not path.advance():
            break
        before, after = path.points[-2:]
        if abs(after.multipliers()[0]) > MAX_MULTIPLIER:
            break
        if after.slope < _MAX_SLOPE and _keeps_period(before, after) and really_walks(problem, after):
            if flip_test(before) * flip_test(after) < 0:
                flips.append(path.locate_root(flip_test))
            continue
        # The end lies between the two: approach it by ever shorter steps.
        path.points.pop()
        path.step = 0.25 * min(step, float(np.linalg.norm(after.Z - before.Z)))
        if path.step < _MIN_STEP:
            break
    return path.points, [flip for flip in flips if flip.ok]


def _keeps_period(before: Cycle, after: Cycle) -> bool:
    """Whether a branch has not passed a flip of half its period between two gaits, where its halves change sides."""
    n = before.period
    if n % 2:
        return True
    halves = [c.Y - np.roll(c.Y, n // 2, axis=1) for c in (before, after)]
    return float((halves[0] * halves[1]).sum()) > 0


def _searched(
    problem: Problem, branches: list[Branch], n: int, flip: float, known: list[CycleBranch]
) -> list[CycleBranch]:
    """Branches of gaits of period n that a search near the first flip finds besides the known ones."""
    followed: list[CycleBranch] = []
    for slope in flip * _SEARCHED:
        for cycle in search_cycles(problem, branches, float(slope), n, _STARTS):
            is_far = abs(cycle.multipliers()[0]) > MAX_MULTIPLIER
            if is_far or any(_holds(problem, branch, cycle) for branch in (*known, *followed)):
                continue
            up = np.zeros(cycle.Y.size + 1)
            up[-1] = 1.0
            sides = [_continue(problem, Path(problem, cycle, sign * up, _FIRST_STEP)) for sign in (-1, 1)]
            (back, back_flips), (ahead, ahead_flips) = sides
            begin = [_reversed(c) for c in back[:0:-1]]
            followed.append(CycleBranch([*begin, *ahead], [*back_flips[::-1], *ahead_flips]))
    return followed


def _holds(problem: Problem, branch: CycleBranch, cycle: Cycle) -> bool:
    """Whether a gait lies on a branch."""
    others = (at_slope(problem, Y, times, cycle.slope) for _, Y, times in branch.guesses(cycle.q))
    return any(other.ok and is_same(cycle, other) for other in others)


def is_same(a: Cycle, b: Cycle) -> bool:
    """Whether two gaits at one slope are the same, begun at any of their steps."""
    near = _SAME * float(a.Y[0].max())
    return any(float(np.abs(a.Y - np.roll(b.Y, k, axis=1)).max()) < near for k in range(b.period))


def _distinct(problem: Problem, branches: list[CycleBranch]) -> list[CycleBranch]:
    """Branches without those that end at the flip at which an earlier one begins: they are the same."""
    kept: list[CycleBranch] = []
    for branch in branches:
        middle = branch.cycles[len(branch.cycles) // 2]
        if not any(_holds(problem, other, middle) for other in kept):
            kept.append(branch)
    return kept
