"""Flips, at which gaits of twice as many steps begin.

On the new branch the sections of the two halves differ from the flip's by +-a v, with v
the eigenvector of -1, and ln slope by a multiple of a^2: the branch passes the flip and
repeats itself, its halves exchanged.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy import ndarray

from gaitsweep.tasks.branches.branch import Branch
from gaitsweep.tasks.branches.conditions import CONDITIONS
from gaitsweep.tasks.branches.equations import slope_error
from gaitsweep.tasks.branches.joint import Evaluation
from gaitsweep.tasks.branches.pseudo_arclength import NO_FURTHER, Point
from gaitsweep.tasks.branches.tracking import HALVED, correct
from gaitsweep.tasks.gaits.newton import similarity
from gaitsweep.tasks.mechanics.arrays import Coordinates, Gait, Unknowns
from gaitsweep.tasks.mechanics.sums import matvec, total
from gaitsweep.tasks.step.several_steps import begun_at, joined, sections

#: Newton steps to the first gait beside a flip, where the derivative is nearly
#: singular.
_MAX_ITERATIONS = 15
#: First distance from the flip over the root of the branch's length, how often it is
#: changed, and the first step over it.
_FIRST_DISTANCE, _MAX_DISTANCES, _FIRST_STEP = 0.01, 6, 0.3
#: Shares of that length, in ln slope, between which the first gait may lie, and that
#: which is wanted.
_NEAREST, _FARTHEST, _WANTED = 0.02, 0.3, 0.1
#: Farthest that a branch may end from the flip at which it begins, in similarity
#: coordinates.
_NEAR = 0.05
#: Distance from the flip up to which points of the branch are known worse than the flip
#: itself, or as a share of their largest distance: across the branch the equations are
#: all but singular there.
_CLEAR, _CLEAR_SHARE = 1e-3, 0.1


def doubled(flip: Evaluation, expected: float) -> tuple[Point, ndarray, float] | None:
    """Begin the branch of twice as many steps over the slope at a flip, as
    `doubled_over` does.
    """
    problem = flip.problem.of_steps(2 * flip.problem.steps)

    def corrected(guess: Coordinates, border: Coordinates) -> Point:
        return correct(problem, guess, border, _MAX_ITERATIONS)

    return doubled_over(flip, float(flip.q[0]), expected, corrected)


def doubled_over(
    flip: Evaluation,
    last: float,
    expected: float,
    corrected: Callable[[Coordinates, Coordinates], Point],
) -> tuple[Point, ndarray, float] | None:
    """Begin the curve of twice as many steps at a flip, over what is the last unknown.

    Parameters
    ----------
    flip : Evaluation
        Of one lane, with a multiplier of -1.
    last : float
        Its last unknown: ln slope, or a key at a fixed slope.
    expected : float
        Rough length in that of the curve up to its own flip.
    corrected : callable
        Corrects points of the curve (c, 1) across a direction (c, 1).

    Returns
    -------
    tuple or None
        A point of the curve, the direction (c,) away from the flip and the length of a
        first step along it, as `points_along` takes them; None where no point is found.

    Notes
    -----
    The first point is solved for at fixed a, where the branch of fewer steps has no point.
    """
    twice = _twice(flip)
    Z = np.append(twice[:, 0], last)
    direction = _along_doubled(flip, Z)
    expected = abs(expected)

    distance = np.sqrt(expected) * _FIRST_DISTANCE
    found, found_at = None, 0.0
    for _ in range(_MAX_DISTANCES):
        guess = Z + distance * direction
        point = corrected(guess[:, None], direction[:, None])
        apart = abs(float(point.Z[-1, 0] - last))
        if point.ok[0] and apart:
            found, found_at = point, distance
            if _NEAREST * expected < apart < _FARTHEST * expected:
                break
            distance *= np.sqrt(_WANTED * expected / apart)
        elif found_at > distance:
            # Newton's steps are rounding this near the flip: between here and the last
            # point.
            distance *= np.sqrt(found_at / distance)
        else:
            distance *= _FARTHEST

    if found is None:
        return None

    return found, direction, _FIRST_STEP * found_at


def _along_doubled(flip: Evaluation, Z: Gait) -> ndarray:
    """Unit direction (c,) of the branch of twice as many steps at a flip, there Z (c,):
    the eigenvector of -1, carried through the steps, with both signs.
    """
    values, vectors = np.linalg.eig(flip.stride.jacobian[..., 0])
    critical = np.argmin(np.abs(values + 1))
    v = np.real(vectors[:, [critical]])

    jacobians = flip.stride.singles.jacobian
    half = []
    for i in range(flip.problem.steps):
        half.append(v)
        v = matvec(jacobians[:, :, [i]], v)

    other_half = [-part for part in half]
    both_halves = np.concatenate([*half, *other_half])
    change = both_halves / flip.stride.y[0]

    m = len(change)
    along = similarity(_relative(Z, m), change)
    direction = np.zeros(len(Z))
    direction[:m] = along[:, 0]
    return direction / np.linalg.norm(direction)


def _relative(w: Unknowns, m: int) -> ndarray:
    """Sections of similarity coordinates (m + k,) over the first angle, shape (m, 1)."""
    return np.append(1.0, w[1:m])[:, None]


def _twice(flip: Evaluation) -> ndarray:
    """A flip as gaits of twice as many steps, begun at each of its own: similarity
    coordinates (2 (m + k), steps).
    """
    m = flip.m
    steps = flip.problem.steps
    y, durations = sections(flip.w, m, steps)
    y = np.tile(y, (2, 1, 1))
    durations = np.tile(durations, (2, 1, 1))
    w = joined(flip.w[:1], y, durations)
    w = np.repeat(w, steps, axis=1)
    return begun_at(w, 2 * m, 2 * steps, np.arange(steps))


def begun_at_flips(branch: Branch, flips: Sequence[Evaluation]) -> Branch:
    """Branch of several steps with the flips of half as many as its ends, where its
    halves meet.

    Parameters
    ----------
    branch : Branch
    flips : sequence of Evaluation
        Of gaits of half as many steps.
    """
    for side in (0, 1):
        if branch.why[side] == HALVED:
            branch = _begun_at_a_flip(branch, side, flips)
    return branch


def _begun_at_a_flip(branch: Branch, side: int, flips: Sequence[Evaluation]) -> Branch:
    """Branch with the nearest of the flips as its end on one side, if one is near."""
    last = branch.Z[:-1, [-side]]
    found = _nearest_flip(flips, last)
    if found is None:
        return branch.ending(side, NO_FURTHER)

    flip, w = found
    Z = np.append(w, flip.q[0])
    clear = _nodes_clear_of(branch, Z, side)
    branch = branch.part(clear)
    along = _away_from_flip(branch, w, last)
    to_node = branch.Z[:, -side] - Z
    forward = np.sign(total(to_node * along))
    if side:
        forward = -forward
    end = side * len(branch.q)
    branch = branch.insert(end, Z, forward * along)
    error = slope_error(flip.problem, CONDITIONS["flip"], flip.Z[:, 0])
    return branch.ending(side, "branch_point", error)


def _nearest_flip(
    flips: Sequence[Evaluation], w: Unknowns
) -> tuple[Evaluation, Unknowns] | None:
    """The flip nearest to a gait of twice as many steps, if one is near, and its gait
    begun at the step that is nearest.
    """
    found = None
    nearest = _NEAR
    for flip in flips:
        twice = _twice(flip)
        apart = np.abs(twice - w).max(axis=0)
        if apart.min() < nearest:
            nearest = apart.min()
            found = flip, twice[:, apart.argmin()]

    return found


def _away_from_flip(branch: Branch, flip: ndarray, w: Unknowns) -> ndarray:
    """Unit direction (c,) in which the branch leaves a flip (m + k,), by a gait (m + k,
    1) near it.

    The halves leave it to opposite sides; all else changes by the square of the
    distance.
    """
    m = branch.m
    half = branch.steps // 2
    y, durations = sections(w, m, branch.steps)
    other_y = np.roll(y, half, axis=0)
    other_durations = np.roll(durations, half, axis=0)
    apart = (y - other_y).reshape(m, 1)

    change = similarity(_relative(flip, m), apart)
    times = np.cumsum(durations - other_durations)
    along = np.concatenate([change[:, 0], times, [0.0]])
    return along / np.linalg.norm(along)


def _nodes_clear_of(branch: Branch, Z: Gait, side: int) -> ndarray:
    """Nodes (k,) from the first that is not known worse than a flip Z (c,) on one side
    of the branch.
    """
    apart = np.abs(branch.Z - Z[:, None]).max(axis=0)
    enough = min(_CLEAR, _CLEAR_SHARE * apart.max())
    clear = np.flatnonzero(apart > enough)
    if side == 0:
        return np.arange(clear[0], len(apart))
    return np.arange(clear[-1] + 1)
