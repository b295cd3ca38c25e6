"""Flips, at which gaits of twice as many steps begin.

On the new branch the sections of the two halves differ from the flip's by +-a v, with v
the eigenvector of -1, and ln slope by a multiple of a^2: the branch passes the flip and
repeats itself, its halves exchanged.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gaitsweep.tasks.continuation.branch import Branch
from gaitsweep.tasks.continuation.defining import slope_error
from gaitsweep.tasks.continuation.joint import Evaluation
from gaitsweep.tasks.continuation.pseudo_arclength import NO_FURTHER, Point
from gaitsweep.tasks.continuation.tracking import HALVED, correct
from gaitsweep.tasks.fixed_points.newton import similarity
from gaitsweep.tasks.mechanics.sums import matvec, total
from gaitsweep.tasks.step.several_steps import begun_at, joined, sections

#: Newton steps to the first gait beside a flip, where the derivative is nearly
#: singular.
_MAX_ITERATIONS = 15
#: Farthest that a branch may end from the flip at which it begins, in similarity
#: coordinates.
_NEAR = 0.05
#: Distance from the flip up to which points of the branch are known worse than the flip
#: itself, or as a share of their largest distance: across the branch the equations are
#: all but singular there.
_CLEAR, _CLEAR_SHARE = 1e-3, 0.1


def doubled(
    flip: Evaluation, expected: float
) -> tuple[Point, np.ndarray, float] | None:
    """Begin the branch of twice as many steps at a flip.

    Parameters
    ----------
    flip : Evaluation
        Of one lane, with a multiplier of -1.
    expected : float
        Rough length in ln slope of the branch up to its own flip.

    Returns
    -------
    tuple or None
        A point of the branch, the direction (c,) away from the flip and the length of a
        first step along it, as `points_along` takes them; None where no point is found.

    Notes
    -----
    The first point is solved for at fixed a, where the branch of fewer steps has no point.
    """
    steps = flip.problem.steps
    twice, q = flip.problem.of_steps(2 * steps), float(flip.q[0])
    base = _twice(flip)
    values, vectors = np.linalg.eig(flip.stride.jacobian[..., 0])
    v = np.real(vectors[:, [np.argmin(np.abs(values + 1))]])
    each, half = flip.stride.singles, []
    for i in range(steps):
        half.append(v)
        v = matvec(each.jacobian[:, :, [i]], v)
    change = np.concatenate([*half, *(-part for part in half)]) / flip.stride.y[0]
    direction = np.zeros(len(base) + 1)
    direction[: twice.m] = similarity(_relative(base[:, 0], twice.m), change)[:, 0]
    direction /= np.linalg.norm(direction)
    Z = np.append(base[:, 0], q)
    a, farther = np.sqrt(abs(expected)) * 0.01, list[tuple[float, Point]]()
    for _ in range(6):
        first = correct(
            twice, (Z + a * direction)[:, None], direction[:, None], _MAX_ITERATIONS
        )
        if first.ok[0] and first.at.q[0] != q:
            farther.append((a, first))
            distance = abs(float(first.at.q[0]) - q)
            if 0.02 * abs(expected) < distance < 0.3 * abs(expected):
                break
            a *= np.sqrt(0.1 * abs(expected) / distance)
        else:  # Newton's steps are rounding this near the flip: between here and the last point
            a *= np.sqrt(farther[-1][0] / a) if farther and farther[-1][0] > a else 0.3
    if not farther:
        return None
    a, first = farther[-1]
    return first, direction, 0.3 * a


def _relative(w: np.ndarray, m: int) -> np.ndarray:
    """Sections of similarity coordinates (m + k,) over the first angle, shape (m, 1)."""
    return np.append(1.0, w[1:m])[:, None]


def _twice(flip: Evaluation) -> np.ndarray:
    """A flip as gaits of twice as many steps, begun at each of its own: similarity
    coordinates (2 (m + k), steps).
    """
    m, steps = flip.m, flip.problem.steps
    y, durations = (np.tile(each, (2, 1, 1)) for each in sections(flip.w, m, steps))
    w = np.repeat(joined(flip.w[:1], y, durations), steps, axis=1)
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
    if HALVED not in branch.why:
        return branch
    m, steps = branch.m, branch.steps
    for side in (0, 1):
        if branch.why[side] != HALVED:
            continue
        w = branch.Z[:-1, -side]
        near = [(np.abs(_twice(flip) - w[:, None]).max(axis=0), flip) for flip in flips]
        apart, flip = min(
            near,
            key=lambda each: float(each[0].min()),
            default=(np.array([np.inf]), None),
        )
        if flip is None or apart.min() > _NEAR:
            branch = branch.ending(side, NO_FURTHER)
            continue
        at = _twice(flip)[:, int(apart.argmin())]
        # The halves leave the flip to opposite sides; all else changes by the square of
        # the distance.
        y, durations = (
            part - np.roll(part, steps // 2, axis=0)
            for part in sections(w[:, None], m, steps)
        )
        along = np.concatenate(
            [
                similarity(_relative(at, m), y.reshape(m, 1))[:, 0],
                np.cumsum(durations),
                [0.0],
            ]
        )
        Z = np.append(at, flip.q[0])
        apart = np.abs(branch.Z - Z[:, None]).max(axis=0)
        clear = np.flatnonzero(apart > min(_CLEAR, _CLEAR_SHARE * apart.max()))
        kept = np.arange(*((clear[0], len(apart)) if side == 0 else (0, clear[-1] + 1)))
        branch, node = branch.part(kept), branch.Z[:, kept[-side]]
        along *= (
            (1 - 2 * side) * np.sign(total((node - Z) * along)) / np.linalg.norm(along)
        )
        branch = branch.insert(side * len(branch.q), Z, along)
        branch = branch.ending(
            side, "branch_point", slope_error(flip.problem, "flip", flip.Z[:, 0])
        )
    return branch
