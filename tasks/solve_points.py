"""The tasks `atlas`, every branch of a line, `points`, the gaits at its slopes, and `lines`, both for several lines."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tasks import status
from tasks.continuation import atlas as atlases
from tasks.continuation.branch import Branch
from tasks.continuation.lockstep import lanes_of
from tasks.continuation.refine import COARSE, FINE
from tasks.fixed_points.labels import places
from tasks.fixed_points.multipliers import multipliers
from tasks.fixed_points.polish import Guesses, Polished, join, settle
from tasks.fixed_points.step_check import gait_ratio
from tasks.follow_cycles import cycle_branches, from_arrays, to_arrays
from tasks.measures import violations
from tasks.measures.kinematics import step_length, travel
from tasks.measures.losses import heelstrike_losses, kneestrike_loss
from tasks.mechanics.lumped import Structure, structures_of
from tasks.registry import ALWAYS, GAITS, PROVED, VARIABLES
from tasks.solve_cycles import cycle_points
from tasks.step.problem import Lanes, Problem, residual_sizes
from tasks.walkers.resolve import resolve
from tasks.walkers.walker import Walker

Arrays = dict[str, np.ndarray]
#: Lanes solved at a time: enough to amortize the calls, few enough for the cache.
_BLOCK = 4096
#: What a proof of a gait is held against, and the largest relative radius of its box.
PROVED_FROM = ("stance_angle", "stance_rate", "thigh_rate", "shank_rate", "period", "kneestrike_time", "error_bound")
PROOF_ACCURACY = 1e-12


def atlas(params: Mapping[str, Any], inputs: list[Arrays]) -> Arrays:
    """Compute every branch of one line's gaits.

    Parameters
    ----------
    params : mapping
        `line`: `{"walker": name or table, "set": {key: value}}`; `coarse`: whether for few points; `steps` after which
        the gaits repeat (1 if omitted).
    inputs : list
        Empty, or for gaits of several steps the atlas, not coarse, of those of one step; it is computed otherwise.

    Returns
    -------
    dict
        The branches as arrays, which `tasks.continuation.atlas.from_arrays` reads; of gaits of several steps
        `tasks.follow_cycles.from_arrays`.
    """
    problem = Problem(_walker(params["line"]))
    steps = int(params.get("steps", 1))
    if steps > 1:
        # They are followed far from the branches where they begin.
        single = atlases.from_arrays(inputs[0]) if inputs else atlases.survey(problem, FINE)
        return to_arrays(cycle_branches(problem, single, steps))
    return atlases.to_arrays(atlases.survey(problem, COARSE if params.get("coarse") else FINE))


def points(params: Mapping[str, Any], inputs: list[Arrays]) -> Arrays:
    """Solve the gaits at the slopes of one line, each from the line's atlas alone.

    Parameters
    ----------
    params : mapping
        `line`; `slope`, ndarray, shape (n,) [rad]; `want`, names of variables; `gaits`, labels wanted;
        `friction_limit`, the coefficient above which a gait is flagged; `steps` after which the gaits repeat.
    inputs : list
        The line's atlas, of the same `steps`.

    Returns
    -------
    dict
        Each wanted variable in the walker's units, shape (n, len(GAITS)[, multipliers]), and `reasons`, the sentences
        that `reason` indexes.
    """
    problem = Problem(_walker(params["line"]))
    if int(params.get("steps", 1)) > 1:
        return cycle_points(problem, from_arrays(inputs[0]), params)
    (solved,) = _solve_lines(problem, [params["line"]], [atlases.from_arrays(inputs[0])], params)
    return solved


def lines(params: Mapping[str, Any], inputs: list[Arrays]) -> list[tuple[Arrays, Arrays]]:
    """Compute the atlases of several lines side by side, for few points, and solve the gaits at their slopes.

    Parameters
    ----------
    params : mapping
        `lines`, the line of each; the others as `points` has them.
    inputs : list
        Empty.

    Returns
    -------
    list of (dict, dict)
        For each line what `atlas`, coarse, and `points` return; it does not depend on the other lines.
    """
    walkers = [_walker(line) for line in params["lines"]]
    alike: dict[Structure, list[int]] = {}
    for i, structure in enumerate(structures_of(walkers)):
        alike.setdefault(structure, []).append(i)
    results: list[tuple[Arrays, Arrays]] = [({}, {})] * len(walkers)
    for structure, numbers in alike.items():
        problem = Lanes([walkers[i] for i in numbers], structure)
        surveyed = atlases.survey_lines(problem, COARSE)
        solved = _solve_lines(problem, [params["lines"][i] for i in numbers], surveyed, params)
        for i, branches, one in zip(numbers, surveyed, solved, strict=True):
            results[i] = atlases.to_arrays(branches), one
    return results


def _solve_lines(
    problem: Problem, lines: Sequence[Mapping[str, Any]], atlas: Sequence[list[Branch]], params: Mapping[str, Any]
) -> list[Arrays]:
    """Solve the gaits at the slopes of several lines of one structure; `problem` has a lane for each."""
    slope = np.asarray(params["slope"], float)
    want = [v for v in VARIABLES if v in params["want"] or v in ALWAYS]
    wanted = set(params.get("gaits") or GAITS)
    friction_limit = params.get("friction_limit", violations.FRICTION_LIMIT)
    n, width = len(slope), 4 if problem.phases == 2 else 3
    proofs = [name for name in want if VARIABLES[name].group == "proofs"]
    solved = [name for name in VARIABLES if name in want or (proofs and name in PROVED_FROM) if name not in proofs]
    problems = [problem.alone(i) for i in range(len(lines))]
    searched = f"searched from {atlases.searched(problem.walker)}"
    results = [
        {**nothing_solved((*solved, *proofs), n, width), "reasons": np.array(_reasons(branches, searched))}
        for branches in atlas
    ]
    for k in range(0, n, _BLOCK):
        part = slice(k, k + _BLOCK)
        pieces = [_pieces(branches, slope[part], wanted) for branches in atlas]
        here = [i for i, each in enumerate(pieces) if each]
        if not here:
            continue
        guesses = [join([piece.guesses for piece in pieces[i]]) for i in here]
        counts = [len(each.slope) for each in guesses]
        at = settle(problem.some(np.repeat(here, counts)), join(guesses))
        for i, each, count, end in zip(here, guesses, counts, np.cumsum(counts).tolist(), strict=True):
            gaits = describe(
                problems[i],
                problems[i].walker,
                lanes_of(at, slice(end - count, end)),
                each.slope,
                tuple(solved),
                friction_limit,
            )
            store({name: results[i][name][part] for name in solved}, _parts(pieces[i], gaits), wanted)
    if proofs:
        for line, out in zip(lines, results, strict=True):
            _prove(out, line, slope)
    return [{name: out[name] for name in (*want, "reasons")} for out in results]


def nothing_solved(names: Sequence[str], n: int, multipliers: int) -> Arrays:
    """Return arrays of variables at points without a gait.

    Parameters
    ----------
    names : sequence of str
        Of variables.
    n, multipliers : int
        Number of points, and of multipliers of a gait.

    Returns
    -------
    dict of ndarray, shape (n, len(GAITS)[, multipliers])
    """
    out: Arrays = {}
    for name in names:
        shape = (n, len(GAITS), multipliers) if "multiplier" in VARIABLES[name].dims else (n, len(GAITS))
        out[name] = np.full(shape, VARIABLES[name].absent, VARIABLES[name].dtype)
    out["reason"][:] = [1, 5, 2, 2]
    return out


def _reasons(branches: list[Branch], searched: str) -> list[str]:
    """Sentences that `reason` indexes."""
    long, short = (
        status.outside(label, [s for b in branches for s in _spans(b, label)], searched) for label in GAITS[:2]
    )
    return [status.SETTLED, long, status.NO_FURTHER, status.NEWTON_LOST, status.NOT_A_STEP, short]


def _prove(out: Arrays, line: Mapping[str, Any], slope: np.ndarray) -> None:
    """Prove every converged gait of `out`, rows (n, len(GAITS)); each takes a second or so."""
    from tasks.proofs.records import prove_stored  # needs the extra `proof`

    for i, g in np.argwhere(out["status"] == status.CONVERGED).tolist():
        asked = {"walker": line["walker"], "set": line.get("set"), "slope": float(slope[i]), "gait": GAITS[g]}
        values = {name: float(out[name][i, g]) for name in PROVED_FROM}
        proof = prove_stored({**asked, "accuracy": PROOF_ACCURACY, "values": values})
        if "proved" in out:
            out["proved"][i, g] = PROVED["proved" if proof["proved"] else "not_proved"]
        if "proved_radius" in out and proof["proved"]:
            out["proved_radius"][i, g] = proof["radius"]


@dataclass(frozen=True)
class _Piece:
    """Guesses on one piece of a branch: indices of their slopes, their segments, and the branch with its number."""

    index: np.ndarray
    segment: np.ndarray
    guesses: Guesses
    branch: Branch
    number: int


def _pieces(branches: list[Branch], slope: np.ndarray, wanted: set[str]) -> list[_Piece]:
    """Guesses of the gaits at some slopes that may have a wanted label."""
    pieces = []
    for number, branch in enumerate(branches):
        for index, Z, segment in branch.guesses(np.log(slope)):
            may_hold = _may_hold(branch, segment, wanted)
            if may_hold.any():
                index, Z, segment = index[may_hold], Z[may_hold], segment[may_hold]
                guesses = branch.known_guesses(Z, segment, slope[index])
                pieces.append(_Piece(index, segment, guesses, branch, number))
    return pieces


@dataclass(frozen=True)
class Part:
    """Gaits of one piece of a branch: their points, what labels them, and what was solved.

    `angle` and `ratio` are those by which labels are given; `angle` is NaN where a gait has none.
    """

    index: np.ndarray
    angle: np.ndarray
    ratio: np.ndarray
    solved: Arrays


def _parts(pieces: list[_Piece], gaits: Arrays) -> list[Part]:
    """Parts of the pieces, whose `gaits` follow one another."""
    parts = []
    ends = np.cumsum([len(piece.index) for piece in pieces])
    for piece, end in zip(pieces, ends.tolist(), strict=True):
        count, branch = len(piece.index), piece.branch
        solved = {name: value[end - count : end] for name, value in gaits.items()}
        solved |= {"branch": np.full(count, piece.number), "piece": branch.piece(piece.segment)}
        angle = np.where(solved["anthropomorphic"], piece.guesses.w[0], np.nan)
        # A lane that has not converged still counts as its branch's gait.
        nodes = 0.5 * (branch.ratio[piece.segment] + branch.ratio[piece.segment + 1])
        ratio = np.where(solved["status"] == status.CONVERGED, solved["heelstrike_rate_ratio"], nodes)
        parts.append(Part(piece.index, angle, ratio, solved))
    return parts


def store(out: Arrays, parts: Sequence[Part], wanted: set[str]) -> None:
    """Store gaits by label.

    Parameters
    ----------
    out : dict of ndarray, shape (n, len(GAITS)[, multipliers])
        Changed in place.
    parts : sequence of Part
        With indices into the n points.
    wanted : set of str
        Labels to store.
    """
    n = len(out["status"])
    angle, ratio = np.full((2, len(parts), n), np.nan)
    for k, part in enumerate(parts):
        angle[k, part.index], ratio[k, part.index] = part.angle, part.ratio
    is_wanted = np.array([gait in wanted for gait in GAITS] + [False])  # there may be more gaits than labels
    for part, place in zip(parts, places(angle, ratio), strict=True):
        slot = np.minimum(place[part.index], len(GAITS))
        keep = np.flatnonzero((slot >= 0) & is_wanted[slot])
        row, slot = part.index[keep], slot[keep]
        for name, values in out.items():
            values[row, slot] = part.solved[name][keep]


def _spans(branch: Branch, label: str) -> Iterator[tuple[float, float]]:
    """Least and largest slope of each run of a branch's gaits with one label [rad]."""
    has_label = ((branch.ratio < 0.5) == (label == "long")) & (branch.leg_passes == 1)
    for first, last in branch.pieces():
        nodes = np.arange(first, last + 1)
        for run in np.split(nodes, np.nonzero(np.diff(has_label[nodes]))[0] + 1):
            if has_label[run[0]]:
                slopes = np.exp(branch.q[run])
                yield float(slopes.min()), float(slopes.max())


def _walker(line: Mapping[str, Any]) -> Walker:
    return resolve(line["walker"], line.get("set"))


def _may_hold(branch: Branch, segment: np.ndarray, wanted: set[str]) -> np.ndarray:
    """Whether segments may hold a wanted gait, shape (n,).

    The label `long` does not depend on short gaits, nor `short` on long ones; all other labels may depend on either.
    Where heelstrike is tangential a node has no ratio, and its segments may hold any gait.
    """
    if wanted & set(GAITS[2:]):
        return np.ones(len(segment), bool)
    low = np.minimum(branch.ratio[segment], branch.ratio[segment + 1])
    high = np.maximum(branch.ratio[segment], branch.ratio[segment + 1])
    return (~(low > 0.6) & ("long" in wanted)) | (~(high < 0.4) & ("short" in wanted))


def solve(
    problem: Problem,
    guesses: Guesses,
    want: Sequence[str],
    friction_limit: float = violations.FRICTION_LIMIT,
) -> Arrays:
    """Polish guesses of one walker, verify that they are steps and measure the wanted variables, as `describe` does."""
    return describe(problem, problem.walker, settle(problem, guesses), guesses.slope, want, friction_limit)


def describe(
    problem: Problem,
    walker: Walker,
    at: Polished,
    slope: np.ndarray,
    want: Sequence[str],
    friction_limit: float = violations.FRICTION_LIMIT,
) -> Arrays:
    """Measure the wanted variables of gaits.

    Parameters
    ----------
    problem : Problem
        Of one walker, or of one for each gait.
    walker : Walker
        That walker, or an array of them, for which violations cannot be measured.
    at : Polished
        The gaits.
    slope : ndarray, shape (n,) [rad]
    want : sequence of str
        Names of variables.
    friction_limit : float

    Returns
    -------
    dict of ndarray, shape (n[, multipliers])
        In the walker's units; NaN where the guess is not converged to a step.
    """
    code = np.where(at.converged & at.step, status.CONVERGED, status.NOT_CONVERGED)
    solved = {
        "status": code,
        "reason": np.where(at.converged, np.where(at.step, 0, 4), 3),
        "residual": np.abs(at.stride.residual / residual_sizes(at.stride.y, problem.phases)).max(axis=0),
        "error_bound": at.bound,
        "anthropomorphic": ~at.step | (at.leg_passes == 1),
        "passes": at.leg_passes,
    }
    solved |= _measure(problem, walker, at, slope, want, friction_limit)
    for name, value in solved.items():
        if value.dtype == float and name not in ("residual", "heelstrike_rate_ratio"):
            value[code != status.CONVERGED] = np.nan
    return solved


def _measure(
    problem: Problem, walker: Walker, at: Polished, slope: np.ndarray, want: Sequence[str], friction_limit: float
) -> Arrays:
    """Variables of the groups wanted, in the walker's units."""
    stride, scale = at.stride, at.scale
    y, state, times = at.y * scale, at.state * scale, at.times
    time_unit = np.sqrt(walker.leg / walker.g)
    half = problem.map.start_size // 2
    angle, period = y[0], times[-1] * time_unit
    rates = state[half:] / time_unit
    measured = {
        "stance_angle": angle,
        "stance_rate": rates[0],
        "thigh_rate": rates[1],
        "shank_rate": rates[-1],
        "period": period,
        "heelstrike_rate_ratio": gait_ratio(stride),
        "kneestrike_time": times[0] * time_unit if walker.knees else np.full(len(slope), np.nan),
    }
    if {"multiplier_real", "multiplier_imag", "spectral_radius"} & set(want):
        values = multipliers(stride.jacobian, 4 if walker.knees else 3)
        measured |= {
            "multiplier_real": values.real.copy(),
            "multiplier_imag": values.imag.copy(),
            "spectral_radius": np.abs(values).max(axis=1),
        }
    measured |= travel(walker, slope, angle, period)
    if {"loss_normal", "loss_tangential", "loss_kneestrike", "energy_imbalance"} & set(want):
        unit = walker.total_mass * walker.g * walker.leg
        normal, tangential = heelstrike_losses(walker, angle, stride.impact * scale)
        measured["loss_normal"], measured["loss_tangential"] = normal * unit, tangential * unit
        knee = np.zeros(len(slope))
        if walker.knees:
            assert stride.knee is not None
            knee = kneestrike_loss(walker, stride.knee * scale)
        measured["loss_kneestrike"] = knee * unit if walker.knees else np.full(len(slope), np.nan)
        drop = step_length(walker, angle) / walker.leg * np.sin(slope)
        measured["energy_imbalance"] = (normal + tangential + knee - drop) / drop
    if any(VARIABLES[name].group == "violations" for name in want):
        # Extremes need closer samples than the verification of a step: it is integrated again with those.
        fine = problem.map(y / scale, times, problem.parameters(slope, scale), samples=violations.SAMPLES)
        assert fine.motion is not None
        measured |= violations.measure(
            walker, [m * scale for m in fine.motion], fine.impact * scale, times, slope, friction_limit
        )
    return {k: np.array(v) for k, v in measured.items()}
