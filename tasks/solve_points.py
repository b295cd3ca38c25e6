"""The tasks `atlas`, every branch of a line, `points`, the gaits at its slopes, and
`lines`, both for several lines.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from gaitsweep.tasks import status
from gaitsweep.tasks.continuation import atlas as atlases
from gaitsweep.tasks.continuation.branch import Branch
from gaitsweep.tasks.continuation.locate import settle_on_branches
from gaitsweep.tasks.continuation.refine import COARSE, FINE
from gaitsweep.tasks.continuation.tracking import MAX_MULTIPLIER
from gaitsweep.tasks.families.pieces import Piece, pieces_of
from gaitsweep.tasks.fixed_points.polish import Guesses
from gaitsweep.tasks.fixed_points.step_check import LONG_BELOW
from gaitsweep.tasks.follow_cycles import cycle_branches
from gaitsweep.tasks.interpolate import Interpolation
from gaitsweep.tasks.measures.gaits import (
    Arrays,
    Part,
    Wanted,
    describe,
    nothing_solved,
    store,
    to_accuracy,
)
from gaitsweep.tasks.mechanics.lumped import Structure, alike
from gaitsweep.tasks.registry import GAITS, PROVED, VARIABLES
from gaitsweep.tasks.step.lanes import join_lanes, lanes_of, slices
from gaitsweep.tasks.step.problem import Lanes, Problem
from gaitsweep.tasks.walkers.resolve import walker_of_line
from gaitsweep.tasks.walkers.walker import Walker

#: Lanes solved at a time: enough to amortize the calls, few enough for the cache.
_BLOCK = 4096
#: The same where most lanes are those of polynomials.
_INTERPOLATED_BLOCK = 1 << 14
#: Variables that a gait's proof is compared with, and the largest relative radius of
#: its box.
PROVED_FROM = (
    "stance_angle",
    "stance_rate",
    "thigh_rate",
    "shank_rate",
    "period",
    "kneestrike_time",
    "error_bound",
)
PROOF_ACCURACY = 1e-12
#: Branches of the latest lines by walker and tolerance: studies of one command often
#: have lines in common. Nothing else decides them, so what a process has computed
#: before changes no bit.
_surveyed: OrderedDict[tuple[str, float], list[Branch]] = OrderedDict()
_MAX_SURVEYED = 128


def atlas(params: Mapping[str, Any], inputs: list[Arrays]) -> Arrays:
    """Compute every branch of one line's gaits.

    Parameters
    ----------
    params : mapping
        `line`: `{"walker": name or table, "set": {key: value}}`; `coarse`: whether for
        few points; `steps` after which the gaits repeat (1 if omitted).
    inputs : list
        Empty.

    Returns
    -------
    dict
        The branches as arrays, which `tasks.continuation.atlas.from_arrays` reads.
    """
    problem = Problem(walker_of_line(params["line"]))
    steps = int(params.get("steps", 1))
    if steps > 1:
        # They are followed far from the branches where they begin.
        (single,) = _survey([problem.walker], problem.structure, FINE)
        return atlases.to_arrays(cycle_branches(problem, single, steps))
    (branches,) = _survey(
        [problem.walker], problem.structure, COARSE if params.get("coarse") else FINE
    )
    return atlases.to_arrays(branches)


def points(params: Mapping[str, Any], inputs: list[Arrays]) -> Arrays:
    """Solve the gaits at the slopes of one line, each from the line's atlas alone.

    Parameters
    ----------
    params : mapping
        `line`; `slope`, ndarray, shape (n,) [rad]; `want`, names of variables; `gaits`,
        labels wanted; `violation_limits`, those of violations that are not the
        registry's; `steps` after which the gaits repeat; `accuracy`, the largest error
        bound wanted, 0 for as good a one as doubles give; `interpolated`, whether
        polynomials give the points where they reach it.
    inputs : list
        The line's atlas, of the same `steps`.

    Returns
    -------
    dict
        Each wanted variable in the walker's units, shape (n, len(GAITS)[,
        multipliers]), and `reasons`, the sentences that `reason` indexes.
    """
    problem = Problem(walker_of_line(params["line"]), int(params.get("steps", 1)))
    branches, slope, polynomials = (
        atlases.from_arrays(inputs[0]),
        np.asarray(params["slope"], float),
        None,
    )
    if params.get("interpolated", False):
        polynomials = Interpolation(problem, branches, Wanted.of(params), slope)
    (solved,) = _solve_lines(problem, [params["line"]], [branches], params, polynomials)
    return solved


def lines(
    params: Mapping[str, Any], inputs: list[Arrays]
) -> list[tuple[Arrays, Arrays]]:
    """Compute the atlases of several lines side by side, for few points, and solve the
    gaits at their slopes.

    Parameters
    ----------
    params : mapping
        `lines`, the line of each; the others as `points` has them.
    inputs : list
        Empty.

    Returns
    -------
    list of (dict, dict)
        For each line what `atlas`, coarse, and `points` return; it does not depend on
        the other lines.
    """
    walkers = [walker_of_line(line) for line in params["lines"]]
    results: list[tuple[Arrays, Arrays]] = [({}, {})] * len(walkers)
    for structure, numbers in alike(walkers).items():
        problem = Lanes([walkers[i] for i in numbers], structure)
        surveyed = _survey([walkers[i] for i in numbers], structure, COARSE)
        solved = _solve_lines(
            problem, [params["lines"][i] for i in numbers], surveyed, params
        )
        for i, branches, one in zip(numbers, surveyed, solved, strict=True):
            results[i] = atlases.to_arrays(branches), one
    return results


def _survey(
    walkers: Sequence[Walker], structure: Structure, tolerance: float
) -> list[list[Branch]]:
    """Branches of lines of one structure, reused for lines surveyed before."""
    keys = [(repr(walker), tolerance) for walker in walkers]
    new = [i for i, key in enumerate(keys) if key not in _surveyed]
    if new:
        problem = Lanes([walkers[i] for i in new], structure)
        for i, branches in zip(
            new, atlases.survey_lines(problem, tolerance), strict=True
        ):
            _surveyed[keys[i]] = branches
    results = [_surveyed[key] for key in keys]
    while len(_surveyed) > _MAX_SURVEYED:
        _surveyed.popitem(last=False)
    return results


def _solve_lines(
    problem: Problem,
    lines: Sequence[Mapping[str, Any]],
    atlas: Sequence[list[Branch]],
    params: Mapping[str, Any],
    polynomials: Interpolation | None = None,
) -> list[Arrays]:
    """Solve the gaits at the slopes of several lines of one structure; `problem` has a
    lane for each.

    With `polynomials`, of a single line, only gaits that these do not give are
    integrated.
    """
    slope, wanted = np.asarray(params["slope"], float), Wanted.of(params)
    n, names = len(slope), wanted.names
    proofs = [name for name in names if VARIABLES[name].group == "proofs"]
    solved = [
        name
        for name in VARIABLES
        if name in names or (proofs and name in PROVED_FROM)
        if name not in proofs
    ]
    problems = [problem.alone(i) for i in range(len(lines))]
    results = [
        nothing_solved((*solved, *proofs), n, problem.walker.knees) for _ in lines
    ]
    block = _INTERPOLATED_BLOCK if polynomials else _BLOCK
    for k in range(0, n, block):
        part = slice(k, k + block)
        interpolated, integrated = (
            polynomials.parts(slope[part]) if polynomials else ([], None)
        )
        pieces = [
            _pieces(branches, slope[part], wanted.labels, integrated)
            for branches in atlas
        ]
        parts = [interpolated for _ in lines]
        with_pieces = [i for i, each in enumerate(pieces) if each]
        guesses = [
            join_lanes([piece.guesses for piece in pieces[i]]) for i in with_pieces
        ]
        counts = [len(each.slope) for each in guesses]
        if with_pieces:
            places = [
                (problems[i], each.piece.branch, each.segment)
                for i in with_pieces
                for each in pieces[i]
            ]
            each = problem.some(np.repeat(with_pieces, counts))
            at = settle_on_branches(each, join_lanes(guesses), places, wanted.accuracy)
        for i, own, lanes in zip(with_pieces, guesses, slices(counts), strict=True):
            gaits = describe(
                problems[i], lanes_of(at, lanes), own.slope, solved, wanted.limits
            )
            parts[i] = [*interpolated, *_parts(pieces[i], gaits)]
        for out, gaits_of_line in zip(results, parts, strict=True):
            store(
                {name: out[name][part] for name in solved}, gaits_of_line, wanted.labels
            )
    if proofs:
        for line, out in zip(lines, results, strict=True):
            _prove(out, line, slope)
    for out in results:
        for k in range(0, n, block):
            to_accuracy(
                {name: out[name][k : k + block] for name in names}, wanted.accuracy
            )
    reasons = map(_reasons, problems, atlas)
    return [
        {name: out[name] for name in names} | {"reasons": np.array(why)}
        for out, why in zip(results, reasons, strict=True)
    ]


def _reasons(problem: Problem, branches: list[Branch]) -> list[str]:
    """Sentences that `reason` indexes, of one line."""
    if problem.steps > 1:
        outside = _outside(branches, problem.steps)
        return status.reasons(outside, outside)
    searched = f"searched from {atlases.searched(problem.walker)}"
    lost = sorted(slope for branch in branches for slope in branch.lost())
    long, short = (
        status.outside(label, list(spans(branches, label)), searched, lost)
        for label in GAITS[:2]
    )
    return status.reasons(long, short)


def _outside(branches: list[Branch], n: int) -> str:
    """Why no branch has a gait of n steps at some slope."""
    if not branches:
        return f"No gait of period {n} found: no flip of fewer steps begins one."
    spans = status.ranges(
        [(np.exp(branch.q.min()), np.exp(branch.q.max())) for branch in branches]
    )
    limit = f"followed up to multipliers of {MAX_MULTIPLIER:g}"
    return f"No gait of period {n} at this slope: the branches found span {spans} ({limit})."


def _prove(out: Arrays, line: Mapping[str, Any], slope: np.ndarray) -> None:
    """Prove every converged gait of `out`, rows (n, len(GAITS)); each takes a second or
    so.
    """
    from gaitsweep.tasks.proofs.records import prove_stored  # needs the extra `proof`

    for i, g in np.argwhere(np.isin(out["status"], status.SOLVED)).tolist():
        request = {
            "walker": line["walker"],
            "set": line.get("set"),
            "slope": float(slope[i]),
            "gait": GAITS[g],
        }
        values = {name: float(out[name][i, g]) for name in PROVED_FROM}
        proof = prove_stored({**request, "accuracy": PROOF_ACCURACY, "values": values})
        if "proved" in out:
            out["proved"][i, g] = PROVED["proved" if proof["proved"] else "not_proved"]
        if "proved_radius" in out and proof["proved"]:
            out["proved_radius"][i, g] = proof["radius"]


@dataclass(frozen=True)
class _Guessed:
    """Guesses on one piece of a branch: indices of their slopes, and their segments."""

    piece: Piece
    index: np.ndarray
    segment: np.ndarray
    guesses: Guesses


def _pieces(
    branches: list[Branch],
    slope: np.ndarray,
    wanted: set[str],
    integrated: Mapping[tuple[int, int], np.ndarray] | None = None,
) -> list[_Guessed]:
    """Guesses of the gaits at some slopes that may have a wanted label, or of those
    that are to be integrated.
    """
    guessed, q = [], np.log(slope)
    for piece in pieces_of(branches):
        index = (
            piece.covered(q)
            if integrated is None
            else integrated[piece.number, piece.first]
        )
        if len(index):
            Z, segment = piece.branch.on_piece(piece.first, piece.last, q[index])
            may_hold = _may_hold(piece.branch, segment, wanted)
            if may_hold.any():
                index, Z, segment = index[may_hold], Z[:, may_hold], segment[may_hold]
                guesses = piece.branch.known_guesses(Z, segment, slope[index])
                guessed.append(_Guessed(piece, index, segment, guesses))
    return guessed


def _parts(guessed: list[_Guessed], gaits: Arrays) -> list[Part]:
    """Parts of pieces, whose `gaits` follow one another."""
    parts = []
    for each, lanes in zip(
        guessed, slices([len(each.index) for each in guessed]), strict=True
    ):
        piece, solved = (
            each.piece,
            {name: value[lanes] for name, value in gaits.items()},
        )
        numbers = {"branch": piece.number, "piece": piece.place}
        solved |= {
            name: np.full(len(each.index), number) for name, number in numbers.items()
        }
        converged = np.isin(solved["status"], status.SOLVED)
        # A lane that has not converged still counts as its branch's gait.
        angle = np.where(solved["anthropomorphic"], each.guesses.w[0], np.nan)
        ratio = np.where(
            converged,
            solved["heelstrike_rate_ratio"],
            piece.branch.ratio_on(each.segment),
        )
        parts.append(Part(each.index, angle, ratio, solved))
    return parts


def spans(branches: list[Branch], label: str) -> Iterator[tuple[float, float]]:
    """Least and largest slope of each run of the gaits of branches with one label
    [rad].
    """
    for piece in pieces_of(branches):
        branch, nodes = piece.branch, np.arange(piece.first, piece.last + 1)
        has_label = ((branch.ratio < LONG_BELOW) == (label == "long")) & (
            branch.leg_passes == 1
        )
        for run in np.split(nodes, np.nonzero(np.diff(has_label[nodes]))[0] + 1):
            if has_label[run[0]]:
                slopes = np.exp(branch.q[run])
                yield float(slopes.min()), float(slopes.max())


def _may_hold(branch: Branch, segment: np.ndarray, wanted: set[str]) -> np.ndarray:
    """Whether segments may hold a wanted gait, shape (n,).

    The label `long` does not depend on short gaits, nor `short` on long ones; all other
    labels may depend on either. Where heelstrike is tangential a node has no ratio, and
    its segments may hold any gait.
    """
    if wanted & set(GAITS[2:]):
        return np.ones(len(segment), bool)
    low = np.minimum(branch.ratio[segment], branch.ratio[segment + 1])
    high = np.maximum(branch.ratio[segment], branch.ratio[segment + 1])
    return (~(low > 0.6) & ("long" in wanted)) | (~(high < 0.4) & ("short" in wanted))
