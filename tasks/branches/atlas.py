"""The atlas of a line: every branch of gaits over slope, so dense that one Newton step
from it solves any point.

Nodes hold similarity coordinates, event times and q = ln slope, with exact tangents.
Between them a Hermite polynomial of degree seven through four nodes interpolates, in a
coordinate that is monotone there. The atlas depends on the walker and on how fine it is
alone, never on a study's grid, so points that start from it are independent of each
other.

Lines are surveyed in blocks, side by side (`tasks.branches.lockstep`); a line's
atlas does not depend on its block.
"""

from __future__ import annotations

import itertools
from collections.abc import Container, Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy import ndarray

from gaitsweep.tasks.branches.branch import FOLD, MIN_NODES, Branch
from gaitsweep.tasks.branches.checks import checked
from gaitsweep.tasks.branches.conditions import CONDITIONS
from gaitsweep.tasks.branches.ends import BranchEnd, locate_end
from gaitsweep.tasks.branches.flips import begun_at_flips
from gaitsweep.tasks.branches.joint import Evaluation, evaluate
from gaitsweep.tasks.branches.lockstep import Call, Procedure, side_by_side
from gaitsweep.tasks.branches.pseudo_arclength import CLOSED, Point, Track, joined
from gaitsweep.tasks.branches.refine import (
    FINE,
    densify,
    locate_gaps,
    measure,
    without_jumps,
)
from gaitsweep.tasks.branches.segment import (
    correct_at,
    is_step,
    locate_root,
    narrow_segment,
    sharpened_fold,
    value_of,
)
from gaitsweep.tasks.branches.tracking import (
    MIN_SLOPE,
    check_steps,
    follow,
    refine_and_check,
)
from gaitsweep.tasks.contract.kinds import kind_of
from gaitsweep.tasks.gaits.search import (
    VANISHING,
    lattice_size,
    periods,
    search_lines,
)
from gaitsweep.tasks.mechanics.arrays import Coordinates, Gait
from gaitsweep.tasks.mechanics.sums import norm
from gaitsweep.tasks.step.drive import Drive
from gaitsweep.tasks.step.lanes import slices
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
#: Slopes whose steps are as short as those of the weakest drives that are searched.
_GENTLE = (1e-4, 1e-6)
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
    why = down.stop_reason, up.stop_reason
    unmeasured = np.zeros(Z.shape[1])
    branch = Branch(problem.m, Z, tangent, unmeasured, why, steps=problem.steps)
    return branch, down.Z.shape[1] - 1


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

    point, check = yield Call(refine_and_check, (raw.Z, raw.direction))
    raw = replace(raw, Z=point.Z, tangent=point.direction)
    steps = check.step
    gait = raw.Z[:, start]
    if not steps[start]:
        return []

    is_closed = down.stop_reason == CLOSED
    if is_closed:
        # A loop of steps alone is cut at a fold, where it begins and ends; any other
        # where a gait is no step.
        order = _loop(down.Z.shape[1], steps, raw.tangent[-1])
        raw = replace(raw.part(order), why=("", ""), end_errors=(0.0, 0.0))
        steps = steps[order]

    is_loop = is_closed and bool(steps.all())
    parts = yield [
        _part_along(raw, run, gait, tolerance, is_loop, flips) for run in _runs(steps)
    ]
    return list(itertools.chain(*parts))


def _part_along(
    raw: Branch,
    run: tuple[int, int],
    gait: Gait,
    tolerance: float,
    is_loop: bool,
    flips: Sequence[Evaluation],
) -> Procedure[list[Branch]]:
    """The branches made of one run of nodes that are steps, of a branch that began at a
    gait; the run of a loop is a whole closed branch.
    """
    branch = yield from _with_ends(raw, *run)
    if branch is None:
        return []

    branch = yield from _with_folds(branch)
    if is_loop:
        branch = _cut_at_fold(branch)
    branch = begun_at_flips(branch, flips)

    branch = yield from densify(branch, tolerance)
    branch = yield from without_jumps(branch.in_order(gait), gait)
    branch = yield from checked(branch, gait)
    if len(branch.q) < MIN_NODES:
        return []
    return (yield from _without_gaps(branch, gait, tolerance))


def _loop(n: int, steps: ndarray, slope_rate: ndarray) -> ndarray:
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
    once_round = np.arange(1, n)
    count = n - 1
    outside = np.flatnonzero(~steps[once_round])
    if len(outside):
        first, repeated = outside[0], 1
    else:
        turns = np.flatnonzero(np.diff(np.sign(slope_rate[once_round])) != 0)
        first, repeated = turns[0], 2

    return once_round[(first + np.arange(count + repeated)) % count]


def _cut_at_fold(branch: Branch) -> Branch:
    """A closed branch, which overlaps itself beside a fold, from that fold around to
    it.
    """
    folds = branch.folds()
    cut = branch.part(np.arange(folds[0], folds[-1] + 1))
    return replace(cut, why=(FOLD, FOLD))


def _runs(true: ndarray) -> list[tuple[int, int]]:
    """First and last index of every run of true values."""
    edges = np.diff(np.concatenate([[0], true.astype(int), [0]]))
    firsts = np.flatnonzero(edges == 1)
    lasts = np.flatnonzero(edges == -1) - 1
    return list(zip(firsts.tolist(), lasts.tolist(), strict=True))


def _with_ends(raw: Branch, first: int, last: int) -> Procedure[Branch | None]:
    """Branch of a run of nodes that are steps, with its located ends; None where fewer
    than three nodes remain.
    """
    raw, first, last, ends = yield from _located_ends(raw, first, last)
    # Of a run of only the node beyond a fall, none remains.
    if last - first + 1 + len(ends) < MIN_NODES:
        return None

    branch = raw.part(np.arange(first, last + 1))
    for side, end in ends.items():
        Z = end.point.Z[:, 0]
        direction = end.point.direction[:, 0]
        branch = branch.insert(side * len(branch.q), Z, direction)
        branch = branch.ending(side, end.kind, end.error)

    branch = _without_twins(branch, ends)
    return branch if len(branch.q) >= MIN_NODES else None


def _located_ends(
    raw: Branch, first: int, last: int
) -> Procedure[tuple[Branch, int, int, dict[int, BranchEnd]]]:
    """The branch with the nodes that locating the ends of a run of steps adds, the run's
    first and last node between these ends, and the ends, by its sides, 0 and 1.
    """
    raw, first, last, ends = yield from _cut_ends(raw, first, last)
    # An end may have been narrowed on the segment on which a limit is passed.
    whole = [side for side in (0, 1) if side not in ends]
    limits = yield [_passed_limit(raw, side) for side in whole]
    passed = {side: end for side, end in zip(whole, limits, strict=True) if end}
    first += 0 in passed
    last -= 1 in passed
    return raw, first, last, ends | passed


def _cut_ends(
    raw: Branch, first: int, last: int
) -> Procedure[tuple[Branch, int, int, dict[int, BranchEnd]]]:
    """What `_located_ends` returns, of the ends beyond which there are nodes that are no
    steps.
    """
    # On each side the run's outermost node, and that beyond, if there is one.
    sides = (first, first - 1), (last, last + 1)
    cut = [side for side in (0, 1) if sides[side][1] in range(len(raw.q))]
    located = yield [_cut_end(raw, *sides[side]) for side in cut]

    ends: dict[int, BranchEnd] = {}
    narrowed = []
    for side, (branch, inner, end) in zip(cut, located, strict=True):
        ends[side] = end
        narrowed.append((min(sides[side]), branch))
        more = len(branch.q) - len(raw.q)
        if side == 0:
            first, last = inner, last + more
        else:
            last += inner - sides[1][0]

    return raw.with_nodes_of(narrowed), first, last, ends


def _cut_end(
    raw: Branch, good: int, bad: int
) -> Procedure[tuple[Branch, int, BranchEnd]]:
    """The end between two neighbouring nodes, of which one is a step; the branch with
    the nodes that locating it adds, and the number of the last node that is a step.
    """
    is_last = good < bad
    like_left = is_step if is_last else _is_no_step
    raw, left = yield from narrow_segment(raw, min(good, bad), like_left)
    good, bad = (left, left + 1) if is_last else (left + 1, left)
    end = yield from locate_end(raw, good, bad)
    return raw, good, end


def _passed_limit(raw: Branch, side: int) -> Procedure[BranchEnd | None]:
    """The end at the limit to which gaits are followed, where a branch's last node on
    one side lies beyond it.
    """
    kind = raw.why[side]
    if kind_of(kind).ends != "following":
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
    branch: Branch, gait: Gait, tolerance: float
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
        branch = branch.with_points(segment, point)
        steps = np.insert(steps, segment + 1, False)

    parts = yield [_beside_gaps(branch, run, gait, tolerance) for run in _runs(steps)]
    return [part for part in parts if part is not None]


def _beside_gaps(
    branch: Branch, run: tuple[int, int], gait: Gait, tolerance: float
) -> Procedure[Branch | None]:
    """The branch of a run of nodes that are steps, measured; None where too few nodes
    remain.
    """
    part = yield from _with_ends(branch, *run)
    if part is None:
        return None

    part = yield from densify(part, tolerance)
    part = yield from checked(part, gait)
    if len(part.q) < MIN_NODES:
        return None

    yield from measure(part, tolerance)
    return part


def _with_folds(branch: Branch) -> Procedure[Branch]:
    """Put a node on every fold, where the slope turns."""
    turning = np.flatnonzero(np.diff(np.sign(branch.tangent[-1])) != 0).tolist()
    with_fold = yield [_with_fold(branch, segment) for segment in turning]
    return branch.with_nodes_of([*zip(turning, with_fold, strict=True)])


def _with_fold(branch: Branch, segment: int) -> Procedure[Branch]:
    """Put a node on the fold of a segment."""
    sign = np.sign(branch.tangent[-1, segment])

    def slope_rate(point: Point) -> float:
        return float(point.direction[-1, 0])

    def is_before(point: Point) -> bool:
        return bool(slope_rate(point) * sign > 0)

    branch, left = yield from narrow_segment(branch, segment, is_before)
    point = yield from locate_root(branch, left, slope_rate)
    point = yield from sharpened_fold(point)
    # A node may equal the fold to all but the last digits: between them there is no
    # polynomial.
    if norm(branch.Z[:, left : left + 2] - point.Z).min() > _TWIN:
        branch = branch.with_points(left, point)
    return branch


#: Guesses on the lattices of a survey, by whether there are knees and the number of
#: periods.
_GUESSES: dict[tuple[bool, int], int] = {}


def searched(walker: Walker) -> str:
    """Describe how many initial guesses a survey of the walker's line takes from its
    lattice, and how far they reach.
    """
    return searched_in(walker, [walker.time_unit])[0]


def searched_in(walker: Walker, time_units: Sequence[float]) -> list[str]:
    """Describe a survey as `searched` does, for walkers that differ from one by their
    units of time.
    """
    over_unit = periods(walker)
    kind = (walker.knees, len(over_unit))
    if kind not in _GUESSES:
        _GUESSES[kind] = lattice_size(walker, ANCHORS, _SHARES)
    slopes = f"{len(ANCHORS)} slopes from {min(ANCHORS):g} to {max(ANCHORS):g}"
    guesses = f"{_GUESSES[kind]} initial guesses at {slopes}"
    words = []
    for unit in time_units:
        first, last = (over_unit * unit)[[0, -1]]
        reach = f"periods from {first:.3g} to {last:.3g}{' s' * walker.si}"
        words.append(f"{guesses}, with {reach}")

    return words


def driven_anchors(drive: Drive, walker: Walker) -> tuple[float, ...]:
    """Return the values of a drive other than the slope at which gaits to follow are
    searched for.
    """
    return drive.anchors(walker, (*ANCHORS, *_GENTLE))


def survey(problem: Problem, tolerance: float = FINE) -> list[Branch]:
    """Find every branch of one walker's anthropomorphic gaits: the atlas of its line,
    as `survey_lines` does.
    """
    line = Lanes([problem.walker], problem.structure, problem.drive)
    return survey_lines(line, tolerance)[0]


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
        new = _unknown(branches, lines, Z)
        if len(new):
            follow_gaits(problem, branches, lines[new], Z[:, new], tolerance)
    return [ranked(of_line) for of_line in branches]


def follow_gaits(
    problem: Lanes,
    branches: list[list[Branch]],
    lines: ndarray,
    Z: Coordinates,
    tolerance: float,
) -> None:
    """Follow gaits, and add to the branches of their lines those not yet known.

    Parameters
    ----------
    problem : Lanes
        Of one lane for each line.
    branches : list of list of Branch
        Of each line.
    lines : ndarray of int, shape (n,)
        The gaits' lines, in order.
    Z : ndarray, shape (c, n)
    tolerance : float
        FINE or COARSE.
    """
    tracks = follow(problem.some(lines), Z)
    turn = np.arange(len(lines)) - np.searchsorted(lines, lines)
    if len(lines) < _FEW:
        turn[:] = 0

    for k in range(turn.max() + 1):
        in_turn = np.flatnonzero(turn == k)
        chosen = in_turn[_unknown(branches, lines[in_turn], Z[:, in_turn])]
        refined = []
        for i in chosen:
            down, up = tracks[i]
            refined.append(branches_along(problem, down, up, tolerance))

        found = side_by_side(problem, lines[chosen], refined)
        for i, parts in zip(chosen, found, strict=True):
            of_line = branches[lines[i]]
            if is_known(of_line, Z[:, i]):
                continue
            for branch in parts:
                middle = branch.Z[:, len(branch.q) // 2]
                if not is_known(of_line, middle):
                    of_line.append(branch)


def _unknown(branches: list[list[Branch]], lines: ndarray, Z: Coordinates) -> ndarray:
    """Numbers of the gaits Z (c, n) that lie on no branch of their lines (n,)."""
    known = [is_known(branches[line], Z[:, i]) for i, line in enumerate(lines)]
    return np.flatnonzero(~np.array(known, bool))


def _gaits_at_anchors(problem: Lanes) -> Iterator[tuple[ndarray, ndarray]]:
    """Anthropomorphic gaits of several lines that the search finds, for each anchor Z
    (c, n) and their lines.
    """
    slopes: tuple[float, ...] = (*ANCHORS, VANISHING)
    if problem.drive.base is not None:
        slopes = driven_anchors(problem.drive, problem.walker)
    gaits = search_lines(problem, slopes, _SHARES)
    counts = np.array([[w.shape[1] for w in of_lines] for of_lines in gaits])
    at_slope = counts.sum(axis=1)
    lines = np.tile(np.arange(counts.shape[1]), len(slopes))
    lines = np.repeat(lines, counts.ravel())
    if not len(lines):
        return

    w = np.hstack(list(itertools.chain(*gaits)))
    Z = np.vstack([w, np.repeat(np.log(slopes), at_slope)])
    check = check_steps(problem.some(lines), Z)
    for lanes in slices(at_slope.tolist()):
        kept = lanes.start + np.flatnonzero(check.anthropomorphic[lanes])
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


def is_known(branches: list[Branch], gait: Gait) -> bool:
    """True where a gait (c,) lies on a branch already followed."""
    for branch in branches:
        for _, Z, _ in branch.guesses(gait[-1:]):
            if distance(Z[:-1, 0], gait[:-1], branch.m, branch.steps) < ON_BRANCH:
                return True
    return False


def to_arrays(branches: list[Branch]) -> dict[str, ndarray]:
    """Return branches as plain arrays, to be stored and passed between processes.

    Returns
    -------
    dict of ndarray
        `lengths`, `why` and `end_errors` of the branches, `m`, and the nodes' arrays of
        all branches one after another.
    """
    arrays = {"lengths": np.array([len(b.q) for b in branches], dtype=np.int64)}
    if not branches:
        return arrays

    arrays["m"] = np.array([branches[0].m])
    arrays["steps"] = np.array([branches[0].steps])
    arrays["why"] = np.array([b.why for b in branches])
    arrays["end_errors"] = np.array([b.end_errors for b in branches])
    for name in _BY_NODE:
        arrays[name] = np.concatenate([getattr(b, name) for b in branches], axis=-1)
    return arrays


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


def from_arrays(arrays: dict[str, ndarray]) -> list[Branch]:
    """Return the branches of stored arrays.

    Parameters
    ----------
    arrays : dict of ndarray
        As `to_arrays` returns them.
    """
    branches = []
    for i, nodes in enumerate(slices(arrays["lengths"].tolist())):
        low, high = arrays["why"][i].tolist()
        low_error, high_error = arrays["end_errors"][i].tolist()
        branch = Branch(
            m=int(arrays["m"][0]),
            steps=int(arrays["steps"][0]),
            why=(low, high),
            end_errors=(low_error, high_error),
            **{name: arrays[name][..., nodes] for name in _BY_NODE},
        )
        branches.append(branch)

    return branches
