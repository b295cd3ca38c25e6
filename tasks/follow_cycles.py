"""Branches of gaits that repeat after n steps: from the flips of gaits of n/2 steps, and from a search."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tasks.continuation.branch import Branch
from tasks.continuation.cycle_events import slope_error
from tasks.continuation.cycles import (
    MAX_POINTS,
    Cycle,
    Path,
    at_slope,
    correct,
    doubled,
    flip_test,
    fold_test,
    really_walks,
)
from tasks.continuation.root import bracketed_root, hermite
from tasks.locate_cascade import search_cycles
from tasks.registry import SLOPES
from tasks.step.problem import Problem

Arrays = dict[str, np.ndarray]
#: Slopes of the search for gaits that no flip begins, over the slope of the first flip, and initial states at each.
_SEARCHED, _STARTS = np.linspace(0.8, 1.4, 9), 300
#: First step along a branch in ln slope, and the step at which its end is located.
_FIRST_STEP, _MIN_STEP = 2e-3, 1e-6
#: Largest multiplier up to which branches are followed.
MAX_MULTIPLIER = 20.0
#: Length in ln slope that a doubled branch is taken to have: its first point is near enough to its flip for a cubic.
_EXPECTED = 5e-4
#: Least fraction of a step between two strikes that do not coincide.
_NEAR_STRIKE = 1e-4
#: Distance of sections, over the angle, within which two gaits are the same.
_SAME = 1e-7


class Guess(NamedTuple):
    """A point of a branch of cycles, from which one is corrected.

    Attributes
    ----------
    place : float
        Number of the segment plus the fraction of it.
    piece : int
        Number of the piece between folds.
    Y, times : ndarray, shape (m, n) and (k, n)
        Sections [rad, rad/sqrt(leg/g)] and event times [sqrt(leg/g)].
    room : float
        Farthest that sections may move: half the distance from a fold, beyond which lies the other gait beside it. 0
        where rounding of the fold's slope leaves open whether there are gaits.
    """

    place: float
    piece: int
    Y: np.ndarray
    times: np.ndarray
    room: float


@dataclass
class CycleBranch:
    """One branch of gaits of period n: its corrected gaits, between which cubic polynomials run, and its flips.

    Among the gaits are all folds, between which the slope is monotone; their `error` is that of ln slope.

    `ends` say what the first and the last gait are: a `branch_point` (a flip of n/2 steps), an end of walking
    (`end_…`), or where the branch is followed no further (`multiplier_limit`, `window`, `lost`).
    """

    cycles: list[Cycle]
    flips: list[Cycle]
    ends: tuple[str, str] = ("lost", "lost")

    @functools.cached_property
    def folds(self) -> set[int]:
        """Numbers of the gaits at which the slope turns; at the flips that bound a branch it only begins to change."""
        return {i for i, cycle in enumerate(self.cycles[1:-1], 1) if cycle.tangent[-1] == 0}

    def guesses(self, log_slope: float) -> Iterator[Guess]:
        """Yield a guess of each gait at one slope; within the error of a fold's slope, the fold for both its sides."""
        for i, (a, b) in enumerate(itertools.pairwise(self.cycles)):
            piece = sum(fold <= i for fold in self.folds)
            turns = [self.cycles[k] for k in (i, i + 1) if k in self.folds]
            undecided = [fold for fold in turns if abs(fold.q - log_slope) <= fold.error]
            if undecided:
                yield Guess(float(i), piece, undecided[0].Y, undecided[0].times, 0.0)
            elif (a.q < log_slope) != (b.q < log_slope):
                point = cubic(a, b)
                root = bracketed_root(functools.partial(_slope_off, point, log_slope), 0.0, 1.0)
                Y = point(root)[:-1].reshape(a.period, -1).T * np.sqrt(a.period)
                room = min((0.5 * float(np.abs(Y - fold.Y).max()) for fold in turns), default=np.inf)
                yield Guess(i + root, piece, Y, a.times * (1 - root) + b.times * root, room)


def cubic(a: Cycle, b: Cycle) -> Callable[[float], np.ndarray]:
    """Polynomial of a branch between two of its gaits.

    Parameters
    ----------
    a, b : Cycle

    Returns
    -------
    callable
        From the fraction of the way to Z, shape (m n + 1,).

    Notes
    -----
    Beside a flip or a fold, where the slope changes by the square of the distance, its parameter is that distance, at a
    flip of the halves; in arclength the curve would bend too much.
    """
    for turn in (a, b):
        if turn.tangent[-1] == 0:
            along = turn.tangent
            length = float((b.Z - a.Z) @ along)
            return functools.partial(
                hermite, a.Z, a.tangent / (a.tangent @ along), b.Z, b.tangent / (b.tangent @ along), length
            )
    return functools.partial(hermite, a.Z, a.tangent, b.Z, b.tangent, float(np.linalg.norm(b.Z - a.Z)))


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
        By the number of the branch: `Y`, shape (gaits, m, n), `times`, (gaits, k, n), `q`, (gaits,), `tangent`,
        `error`, (gaits,), and `ends`.
    """
    names = ("Y", "times", "q", "tangent", "error")
    gaits = {
        f"{i}/{name}": np.array([getattr(c, name) for c in b.cycles]) for i, b in enumerate(branches) for name in names
    }
    return gaits | {f"{i}/ends": np.array(b.ends) for i, b in enumerate(branches)}


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
        columns = (arrays[f"{i}/{name}"] for name in ("Y", "times", "q", "tangent", "error"))
        cycles = [Cycle(Y, t, float(q), np.empty(0), T, True, float(e)) for Y, t, q, T, e in zip(*columns, strict=True)]
        first, last = arrays[f"{i}/ends"].tolist()
        branches.append(CycleBranch(cycles, [], (first, last)))
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
    period = n // (n & -n)  # its odd part
    followed = _searched(problem, branches, period, single, [])
    flips = [flip for branch in followed for flip in branch.flips] if period > 1 else single
    while period < n:
        period *= 2
        followed = _distinct(problem, [branch for flip in flips if (branch := _from_flip(problem, flip, flips))])
        followed += _searched(problem, branches, period, single, followed)
        flips = [flip for branch in followed for flip in branch.flips]
    return sorted(followed, key=lambda branch: min(c.q for c in branch.cycles))


def _flips(problem: Problem, branch: Branch) -> Iterator[Cycle]:
    """Flips of a branch of gaits of one step."""
    m, q = problem.m, branch.q
    w = np.delete(branch.Z, m, axis=1).T
    angle = np.exp(w[0])
    Y, times = np.vstack([angle, angle * w[1:m]]), w[m:]
    sign = _flip_sign(problem, branch)
    crosses = (sign[:-1] * sign[1:] < 0) & (branch.leg_passes[:-1] == 1)
    # The derivative has a pole where a strike turns tangential: that sign change is no flip.
    for segment, why in zip((slice(1), slice(-1, None)), branch.why, strict=True):
        crosses[segment] &= not why.startswith("end_tangential")
    for i in np.flatnonzero(crosses).tolist():
        ends = [np.append(Y[:, k], q[k]) for k in (i, i + 1)]
        chord = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
        a, b = (correct(problem, Z, times[:, [k]], chord) for Z, k in zip(ends, (i, i + 1), strict=True))
        if a.ok and b.ok and flip_test(a) * flip_test(b) < 0:
            path = Path(problem, a, chord, 1.0)
            path.points.append(b if b.tangent @ chord > 0 else _reversed(b))
            flip = path.locate_root(flip_test)
            if flip.ok:
                yield flip


# Where heelstrike is tangential to the last digit the map has no derivative.
@np.errstate(invalid="ignore")
def _flip_sign(problem: Problem, branch: Branch) -> np.ndarray:
    """Sign of det(I + A) at the nodes of a branch, shape (n,): negative with an odd number of multipliers below -1."""
    m = branch.m
    step, _ = problem.stride(np.delete(branch.Z, m, axis=1).T, branch.q)
    return np.sign([np.linalg.det(np.eye(m) + step.jacobian[:, :, i]) for i in range(len(branch.q))])


def _beyond_flips(problem: Problem, branches: list[Branch]) -> np.ndarray:
    """Slopes at which gaits have doubled already, as those of heavy feet at vanishing slopes, shape (n,) [rad]."""
    doubled = [b.q[(_flip_sign(problem, b) < 0) & (b.leg_passes == 1)] for b in branches]
    return np.array([np.exp(np.median(q)) for q in doubled if len(q)])


def _reversed(cycle: Cycle) -> Cycle:
    cycle.tangent = -cycle.tangent
    return cycle


def _from_flip(problem: Problem, flip: Cycle, others: list[Cycle]) -> CycleBranch | None:
    """The branch of twice the period from a flip, its first gait, to where it is lost or to one of the others."""
    path = doubled(problem, flip, _EXPECTED)
    if path is None:
        return None
    trace = _continue(problem, path, others)
    begin = _at_flip(flip, path.points[0], 1.0)
    return CycleBranch([begin, *trace.cycles], trace.flips, ("branch_point", trace.end)) if trace.cycles else None


def _at_flip(flip: Cycle, beside: Cycle, sign: float) -> Cycle:
    """A flip as a gait of twice its period, with its tangent to (sign 1) or from (-1) a gait beside it."""
    # The halves leave the flip to opposite sides; all else changes by the square of the distance.
    tangent = np.append((beside.Y - np.roll(beside.Y, flip.period, axis=1)).T.ravel(), 0.0)
    along = sign * tangent / np.linalg.norm(tangent)
    # The gait beside it may begin at another step.
    offset = min(
        range(flip.period), key=lambda k: float(np.abs(beside.Y - np.tile(np.roll(flip.Y, k, axis=1), 2)).max())
    )
    Y, times, A = (np.roll(np.tile(x, 2), offset, axis=-1) for x in (flip.Y, flip.times, flip.A))
    return Cycle(Y, times, flip.q, A, along, True, flip.error)


class _Trace(NamedTuple):
    """Gaits along a path, the flips that it passes, and what the last gait is."""

    cycles: list[Cycle]
    flips: list[Cycle]
    end: str


def _continue(problem: Problem, path: Path, closing: list[Cycle]) -> _Trace:
    """Gaits along a path while they walk and keep their period, and the flips that it passes.

    Where the period is halved the branch ends at the nearest of the `closing` flips.
    """
    if not really_walks(problem, path.points[0]):
        return _Trace([], [], "lost")
    flips: list[Cycle] = []
    folds: dict[int, Cycle] = {}
    end = "lost"
    for _ in range(MAX_POINTS):
        step = path.step
        if not path.advance():
            break
        before, after = path.points[-2:]
        if abs(after.multipliers()[0]) > MAX_MULTIPLIER:
            end = "multiplier_limit"
            break
        if _keeps_period(before, after) and really_walks(problem, after):
            if flip_test(before) * flip_test(after) < 0:
                flip = path.locate_root(flip_test)
                flips += [flip] if flip.ok else []
            if fold_test(before) * fold_test(after) < 0:
                folds[len(path.points) - 1] = _fold(problem, path)
            if SLOPES[0] < after.slope < SLOPES[1]:
                continue
            end = "window"
            break
        # The end lies between the two: approach it by ever shorter steps.
        path.points.pop()
        if not _keeps_period(before, after) and closing:
            flip = min(closing, key=lambda flip: abs(flip.q - before.q))
            if abs(flip.q - before.q) < 0.2 * _EXPECTED:
                return _Trace([*_joined(path.points, folds), _at_flip(flip, before, -1.0)], flips, "branch_point")
        path.step = 0.25 * min(step, float(np.linalg.norm(after.Z - before.Z)))
        if path.step < _MIN_STEP:
            end = _end(before, after)
            break
    return _Trace(_joined(path.points, folds), flips, end)


def _fold(problem: Problem, path: Path) -> Cycle:
    """The fold between the last two points of a path, with the error of its ln slope."""
    fold = path.locate_root(fold_test)
    fold.tangent[-1] = 0.0
    fold.error = slope_error(problem, fold, "fold")
    return fold


def _joined(points: list[Cycle], folds: dict[int, Cycle]) -> list[Cycle]:
    """Points of a path with the folds, each before the point of its number."""
    return [cycle for i, point in enumerate(points) for cycle in ((folds[i], point) if i in folds else (point,))]


def _end(before: Cycle, after: Cycle) -> str:
    """What ends a branch between two gaits as close as branches are followed."""
    if not _keeps_period(before, after):
        return "lost"
    knee = before.times[0] / before.times[-1]
    is_last = len(before.times) == 2 and knee.max() > 1 - _NEAR_STRIKE
    return "end_kneestrike_at_heelstrike" if is_last else "end_earlier_strike"


def _keeps_period(before: Cycle, after: Cycle) -> bool:
    """Whether a branch has not passed a flip of half its period between two gaits, where its halves change sides."""
    n = before.period
    if n % 2:
        return True
    halves = [c.Y - np.roll(c.Y, n // 2, axis=1) for c in (before, after)]
    return float((halves[0] * halves[1]).sum()) > 0


def _searched(
    problem: Problem, branches: list[Branch], n: int, flips: list[Cycle], known: list[CycleBranch]
) -> list[CycleBranch]:
    """Branches of gaits of period n that a search near the first flip of one step finds besides the known ones.

    If there is no flip, gaits of two steps are searched for at slopes at which those of one step have doubled.
    """
    followed: list[CycleBranch] = []
    slopes = np.zeros(0)
    if flips and n > 2:
        slopes = min(flip.slope for flip in flips) * _SEARCHED
    elif not flips and n == 2:
        slopes = _beyond_flips(problem, branches)
    for slope in slopes:
        for cycle in search_cycles(problem, branches, float(slope), n, _STARTS):
            is_far = abs(cycle.multipliers()[0]) > MAX_MULTIPLIER
            if is_far or any(_holds(problem, branch, cycle) for branch in (*known, *followed)):
                continue
            up = np.zeros(cycle.Y.size + 1)
            up[-1] = 1.0
            sides = [_continue(problem, Path(problem, cycle, sign * up, _FIRST_STEP), []) for sign in (-1, 1)]
            back, ahead = sides
            cycles = [*(_reversed(c) for c in back.cycles[:0:-1]), *ahead.cycles]
            followed.append(CycleBranch(cycles, [*back.flips[::-1], *ahead.flips], (back.end, ahead.end)))
    return followed


def _holds(problem: Problem, branch: CycleBranch, cycle: Cycle) -> bool:
    """Whether a gait lies on a branch."""
    others = (at_slope(problem, guess.Y, guess.times, cycle.slope) for guess in branch.guesses(cycle.q))
    return any(other.ok and is_same(cycle, other) for other in others)


def is_same(a: Cycle, b: Cycle, room: float = np.inf) -> bool:
    """Whether two gaits at one slope are the same, begun at any of their steps: nearer than `room`."""
    near = min(_SAME * float(a.Y[0].max()), room)
    return any(float(np.abs(a.Y - np.roll(b.Y, k, axis=1)).max()) < near for k in range(b.period))


def _distinct(problem: Problem, branches: list[CycleBranch]) -> list[CycleBranch]:
    """Branches without those that end at the flip at which an earlier one begins: they are the same."""
    kept: list[CycleBranch] = []
    for branch in branches:
        # Beside folds gaits at a slope are hardly known.
        middle = max(branch.cycles, key=lambda cycle: abs(cycle.tangent[-1]))
        if not any(_holds(problem, other, middle) for other in kept):
            kept.append(branch)
    return kept
