"""The atlas of a line: every branch of gaits over slope, so dense that one Newton step
from it solves any point.

Nodes hold similarity coordinates, event times and q = ln slope, with exact tangents.
Between them a Hermite polynomial of degree seven through four nodes interpolates, in a
coordinate that is monotone there. The atlas depends on the walker and on how fine it is
alone, never on a study's grid, so points that start from it are independent of each
other.

Lines are surveyed in blocks, side by side (`tasks.continuation.lockstep`); a line's
atlas does not depend on its block.
"""

from __future__ import annotations

from collections.abc import Container, Iterator, Sequence
from dataclasses import replace

import numpy as np

from gaitsweep.tasks.continuation.branch import MIN_NODES, Branch
from gaitsweep.tasks.continuation.checks import checked
from gaitsweep.tasks.continuation.conditions import CONDITIONS
from gaitsweep.tasks.continuation.ends import BranchEnd, locate_end
from gaitsweep.tasks.continuation.flips import begun_at_flips
from gaitsweep.tasks.continuation.joint import Evaluation, evaluate
from gaitsweep.tasks.continuation.locate import (
    correct_at,
    is_step,
    locate_root,
    narrow_segment,
    sharpened_fold,
    value_of,
)
from gaitsweep.tasks.continuation.lockstep import Call, Procedure, side_by_side
from gaitsweep.tasks.continuation.pseudo_arclength import CLOSED, Point, Track, joined
from gaitsweep.tasks.continuation.refine import (
    FINE,
    densify,
    locate_gaps,
    measure,
    without_jumps,
)
from gaitsweep.tasks.continuation.tracking import MIN_SLOPE, check_steps, follow
from gaitsweep.tasks.fixed_points.search import (
    VANISHING,
    lattice_size,
    periods,
    search_lines,
)
from gaitsweep.tasks.kinds import KINDS
from gaitsweep.tasks.mechanics.sums import norm
from gaitsweep.tasks.step.problem import Lanes, Problem
from gaitsweep.tasks.step.sameness import ON_BRANCH
from gaitsweep.tasks.step.several_steps import distance
from gaitsweep.tasks.walkers.walker import Walker

#: Slopes at which gaits to follow are searched for [rad], so close that short branches
#: have one, in an order that samples the range evenly; of the lattice of guesses each
#: takes one in `_SHARES`, its neighbours the others.
ANCHORS = (
    *(0.01, 0.15, 0.0022, 0.033, 0.48, 0.007, 0.1, 0.0015, 0.022),
    *(0.33, 0.0048, 0.07, 0.001, 0.015, 0.22, 0.0033, 0.048, 0.0007),
)
_SHARES = 3
#: Nodes nearer than this are the same but for rounding, which at a fold moves them
#: along the branch.
_TWIN = 1e-10
#: Fewer gaits than this are refined all at once; more, one per line, since the next may
#: lie on its branch.
_FEW = 8


def _join(problem: Problem, down: Track, up: Track) -> tuple[Branch, int]:
    """Join the tracks down and up to one branch; also the index of their start on it."""
    Z, tangent = joined(down, up)
    n, why = Z.shape[1], (down.stop_reason, up.stop_reason)
    return Branch(
        problem.m, Z, tangent, np.zeros(n), why, steps=problem.steps
    ), down.Z.shape[1] - 1


def branches_along(
    problem: Problem,
    down: Track,
    up: Track,
    tolerance: float,
    flips: Sequence[Evaluation] = (),
) -> Procedure[list[Branch]]:
    """Join both directions, keep the parts that are steps up to their located ends,
    refine and measure them.

    Parameters
    ----------
    problem : Problem
    down, up : Track
    tolerance : float
        FINE or COARSE.
    flips : sequence of Evaluation
        Of gaits of half as many steps: where branches of several steps begin.
    """
    raw, start = _join(problem, down, up)
    if len(raw.q) < 4:
        return []
    check = yield Call(check_steps, (raw.Z,))
    steps, gait = check.step, raw.Z[:, start]
    if not steps[start]:
        return []
    if is_closed := down.stop_reason == CLOSED:
        order = _loop(down.Z.shape[1], steps, raw.tangent[-1])
        # A loop of steps alone is cut at a fold, where it begins and ends; any other
        # where a gait is no step.
        raw, steps = (
            replace(raw.part(order), why=("", ""), end_errors=(0.0, 0.0)),
            steps[order],
        )
    branches: list[Branch] = []
    for first, last in _runs(steps):
        branch = yield from _with_ends(raw, first, last)
        if branch is not None:
            branch = yield from _with_folds(branch)
            if is_closed and steps.all():
                branch = _cut_at_fold(branch)
            branch = begun_at_flips(branch, flips)
            branch = yield from densify(branch, tolerance)
            branch = yield from without_jumps(branch.in_order(gait), gait)
            branch = yield from checked(branch, gait)
            if len(branch.q) >= MIN_NODES:
                branches += yield from _without_gaps(branch, gait, tolerance)
    return branches


def _loop(n: int, steps: np.ndarray, slope_rate: np.ndarray) -> np.ndarray:
    """Order of the nodes of a closed branch, from one that is no step and back to it,
    or from just before a fold.

    Parameters
    ----------
    n : int
        Number of points of the track down, of which the last lies beyond the first.
    steps : ndarray of bool, shape (k,)
        Whether the nodes of both tracks, joined, are steps.
    slope_rate : ndarray, shape (k,)
        Derivatives of ln slope along the branch.

    Returns
    -------
    ndarray of int
    """
    # The track down is joined in reverse; its last point, the first of all, lies beyond
    # its start, the n-th.
    own, count = np.arange(1, n), n - 1
    turns = np.flatnonzero(np.diff(np.sign(slope_rate[own])) != 0)
    outside = np.flatnonzero(~steps[own])
    first = int(outside[0] if len(outside) else turns[0])
    return own[(first + np.arange(count + (1 if len(outside) else 2))) % count]


def _cut_at_fold(branch: Branch) -> Branch:
    """A closed branch, which overlaps itself beside a fold, from that fold around to
    it.
    """
    folds = branch.folds()
    cut = branch.part(np.arange(folds[0], folds[-1] + 1))
    return replace(cut, why=("fold", "fold"))


def _runs(true: np.ndarray) -> list[tuple[int, int]]:
    """First and last index of every run of true values."""
    edges = np.diff(np.concatenate([[0], true.astype(int), [0]]))
    return list(
        zip(
            np.nonzero(edges == 1)[0].tolist(),
            (np.nonzero(edges == -1)[0] - 1).tolist(),
            strict=True,
        )
    )


def _with_ends(raw: Branch, first: int, last: int) -> Procedure[Branch | None]:
    """Branch of a run of nodes that are steps, with its located ends; None where fewer
    than three nodes remain.
    """
    whole = first == 0, last == len(raw.q) - 1
    ends: dict[int, BranchEnd] = {}
    if not whole[1]:
        raw, last = yield from narrow_segment(raw, last, is_step)
        ends[1] = yield from locate_end(raw, last, last + 1)
    if not whole[0]:
        before = len(raw.q)
        raw, segment = yield from narrow_segment(raw, first - 1, _is_no_step)
        first, last = segment + 1, last + len(raw.q) - before
        ends[0] = yield from locate_end(raw, first, segment)

    for side in (0, 1):
        passed = (yield from _passed_limit(raw, side)) if whole[side] else None
        if passed is not None:
            ends[side] = passed
            first += side == 0
            last -= side == 1

    # Of a run of only the node beyond a fall, none remains.
    if last - first + 1 + len(ends) < MIN_NODES:
        return None
    branch = raw.part(np.arange(first, last + 1))
    for side, end in ends.items():
        Z, direction = end.point.Z[:, 0], end.point.direction[:, 0]
        branch = branch.insert(side * len(branch.q), Z, direction)
        branch = branch.ending(side, end.kind, end.error)
    branch = _without_twins(branch, ends)
    return branch if len(branch.q) >= MIN_NODES else None


def _passed_limit(raw: Branch, side: int) -> Procedure[BranchEnd | None]:
    """The end at the limit to which gaits are followed, where a branch's last node on
    one side lies beyond it.
    """
    kind = raw.why[side]
    if kind not in KINDS or KINDS[kind].ends != "following":
        return None
    condition = CONDITIONS[kind]
    last = yield Call(evaluate, (raw.Z[:, [-side]],))
    if condition.residual(last)[0] * condition.walking >= 0:
        return None
    segment = len(raw.q) - 2 if side else 0
    point = yield from locate_root(raw, segment, value_of(condition))
    return BranchEnd(kind, point, raw.end_errors[side])


def _without_twins(branch: Branch, ends: Container[int]) -> Branch:
    """Branch without nodes that equal an end beside them but for rounding: between them
    there is no polynomial.
    """
    twins = norm(np.diff(branch.Z)) < _TWIN
    kept = np.ones(len(branch.q), bool)
    kept[1] &= not (twins[0] and 0 in ends)
    kept[-2] &= not (twins[-1] and 1 in ends)
    return branch.part(np.flatnonzero(kept))


def _is_no_step(point: Point) -> Procedure[bool]:
    return not (yield from is_step(point))


def _without_gaps(
    branch: Branch, gait: np.ndarray, tolerance: float
) -> Procedure[list[Branch]]:
    """Measure the branch that began at a gait; where an earlier strike interrupts it,
    keep the parts on either side.
    """
    distance, check = yield from measure(branch, tolerance)
    steps = check.step
    steps[[0, -1]] = True
    gaps = yield from locate_gaps(branch, distance, check)
    if steps.all() and not gaps:
        return [branch]
    whole = branch
    for place in sorted(gaps, reverse=True):
        segment = int(place)
        a, b = whole.ends_of(np.array(segment)).tolist()
        point = yield from correct_at(whole, segment, a + (b - a) * (place - segment))
        branch = branch.insert(segment + 1, point.Z[:, 0], point.direction[:, 0])
        steps = np.insert(steps, segment + 1, False)
    branches = []
    for first, last in _runs(steps):
        part = yield from _with_ends(branch, first, last)
        if part is not None:
            part = yield from densify(part, tolerance)
            part = yield from checked(part, gait)
            if len(part.q) >= MIN_NODES:
                yield from measure(part, tolerance)
                branches.append(part)
    return branches


def _with_folds(branch: Branch) -> Procedure[Branch]:
    """Put a node on every fold, where the slope turns."""

    def slope_rate(point: Point) -> float:
        return float(point.direction[-1, 0])

    for segment in np.nonzero(np.diff(np.sign(branch.tangent[-1])) != 0)[0][::-1]:
        sign = np.sign(branch.tangent[-1, segment])

        def is_before(point: Point, sign: float = sign) -> bool:
            return bool(slope_rate(point) * sign > 0)

        branch, at = yield from narrow_segment(branch, int(segment), is_before)
        point = yield from locate_root(branch, at, slope_rate)
        point = yield from sharpened_fold(point)
        # A node may equal the fold to all but the last digits: between them there is no
        # polynomial.
        if norm(branch.Z[:, at : at + 2] - point.Z).min() > _TWIN:
            branch = branch.insert(at + 1, point.Z[:, 0], point.direction[:, 0])
    return branch


#: Guesses on the lattices of a survey, by whether there are knees and the number of
#: periods.
_GUESSES: dict[tuple[bool, int], int] = {}


def searched(walker: Walker) -> str:
    """Describe how many initial guesses a survey of the walker's line takes from its
    lattice, and how far they reach.
    """
    times = periods(walker) * walker.time_unit
    kind = (walker.knees, len(times))
    if kind not in _GUESSES:
        _GUESSES[kind] = lattice_size(walker, ANCHORS, _SHARES)
    slopes = f"{len(ANCHORS)} slopes from {min(ANCHORS):g} to {max(ANCHORS):g}"
    reach = f"periods from {times[0]:.3g} to {times[-1]:.3g}{' s' * walker.si}"
    return f"{_GUESSES[kind]} initial guesses at {slopes}, with {reach}"


def survey(problem: Problem, tolerance: float = FINE) -> list[Branch]:
    """Find every branch of one walker's anthropomorphic gaits: the atlas of its line,
    as `survey_lines` does.
    """
    return survey_lines(Lanes([problem.walker]), tolerance)[0]


def survey_lines(problem: Lanes, tolerance: float = FINE) -> list[list[Branch]]:
    """Find every branch of anthropomorphic gaits that the anchors lead to, for a block
    of lines.

    Parameters
    ----------
    problem : Lanes
        Of one lane for each line.
    tolerance : float
        FINE or COARSE.

    Returns
    -------
    list of list of Branch
        For each line, its branches in the order of their numbers.
    """
    branches: list[list[Branch]] = [[] for _ in problem.lanes]
    for Z, lines in _gaits_at_anchors(problem):
        new = [
            i for i, line in enumerate(lines) if not is_known(branches[line], Z[:, i])
        ]
        if not new:
            continue
        Z, lines = Z[:, new], lines[new]
        pairs = follow(problem.some(lines), Z)
        turn = np.arange(len(lines)) - np.searchsorted(lines, lines)
        if len(lines) < _FEW:
            turn[:] = 0
        for k in range(turn.max() + 1):
            chosen = [
                i
                for i in np.flatnonzero(turn == k)
                if not is_known(branches[lines[i]], Z[:, i])
            ]
            parts = side_by_side(
                problem,
                lines[chosen],
                [branches_along(problem, *pairs[i], tolerance) for i in chosen],
            )
            for i, part in zip(chosen, parts, strict=True):
                if is_known(branches[lines[i]], Z[:, i]):
                    continue
                for branch in part:
                    if not is_known(
                        branches[lines[i]], branch.Z[:, len(branch.q) // 2]
                    ):
                        branches[lines[i]].append(branch)
    return [ranked(each) for each in branches]


def _gaits_at_anchors(problem: Lanes) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Anthropomorphic gaits of several lines that the search finds, for each anchor Z
    (c, n) and their lines.
    """
    slopes = (*ANCHORS, VANISHING)
    gaits = search_lines(problem, slopes, _SHARES)
    counts = np.array([[w.shape[1] for w in each] for each in gaits])
    q = np.log(slopes)
    lines, at = (
        np.repeat(np.tile(np.arange(counts.shape[1]), len(q)), counts.ravel()),
        counts.sum(axis=1),
    )
    if not len(lines):
        return
    Z = np.vstack([np.hstack([w for each in gaits for w in each]), np.repeat(q, at)])
    check = check_steps(problem.some(lines), Z)
    for k, end in enumerate(np.cumsum(at).tolist()):
        kept = end - at[k] + np.flatnonzero(check.anthropomorphic[end - at[k] : end])
        yield Z[:, kept], lines[kept]


def ranked(branches: list[Branch]) -> list[Branch]:
    """Sort branches in the order of their numbers: by their lowest ln slope, then by ln
    angle there.

    How far below `MIN_SLOPE` a branch was followed is arbitrary: those that reach it
    are equal in the first.
    """

    def place(branch: Branch) -> tuple[float, float]:
        lowest = int(branch.q.argmin())
        q = max(float(branch.q[lowest]), np.log(MIN_SLOPE))
        angles = (float(Z[0, 0]) for _, Z, _ in branch.guesses(np.array([q])))
        return q, min(angles, default=float(branch.Z[0, lowest]))

    return sorted(branches, key=place)


def is_known(branches: list[Branch], gait: np.ndarray) -> bool:
    """True where a gait (c,) lies on a branch already followed."""
    for branch in branches:
        for _, Z, _ in branch.guesses(gait[-1:]):
            if distance(Z[:-1, 0], gait[:-1], branch.m, branch.steps) < ON_BRANCH:
                return True
    return False


def to_arrays(branches: list[Branch]) -> dict[str, np.ndarray]:
    """Return branches as plain arrays, to be stored and passed between processes.

    Returns
    -------
    dict of ndarray
        `lengths`, `why` and `end_errors` of the branches, `m`, and the nodes' arrays of
        all branches one after another.
    """
    lengths = np.array([len(b.q) for b in branches], dtype=np.int64)
    if not branches:
        return {"lengths": lengths}
    return {
        "lengths": lengths,
        "m": np.array([branches[0].m]),
        "steps": np.array([branches[0].steps]),
        "why": np.array([b.why for b in branches]),
        "end_errors": np.array([b.end_errors for b in branches]),
        **{
            name: np.concatenate([getattr(b, name) for b in branches], axis=-1)
            for name in _BY_NODE
        },
    }


_BY_NODE = (
    "Z",
    "tangent",
    "lipschitz",
    "gradient",
    "rounding_std",
    "ratio",
    "leg_passes",
    "safe",
)


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
            steps=int(arrays["steps"][0]),
            why=(str(arrays["why"][i][0]), str(arrays["why"][i][1])),
            end_errors=(
                float(arrays["end_errors"][i][0]),
                float(arrays["end_errors"][i][1]),
            ),
            **{name: arrays[name][..., a:b] for name in _BY_NODE},
        )
        for i, (a, b) in enumerate(zip(ends - arrays["lengths"], ends, strict=True))
    ]
