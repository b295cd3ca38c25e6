"""Solving: the atlas of a line, the points on it, and every gait at one point."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from tasks import status
from tasks.continuation import atlas as atlases
from tasks.continuation.branch import Branch
from tasks.fixed_points.labels import places
from tasks.fixed_points.multipliers import multipliers
from tasks.fixed_points.polish import UNKNOWN, Polished, settle
from tasks.fixed_points.search import starts
from tasks.fixed_points.step_check import gait_ratio
from tasks.measures import violations
from tasks.measures.kinematics import step_length, travel
from tasks.measures.losses import heelstrike_losses, kneestrike_loss
from tasks.registry import ALWAYS, GAITS, PROVED, VARIABLES
from tasks.step.problem import Problem, sizes
from tasks.walkers.resolve import resolve
from tasks.walkers.walker import Walker

Arrays = dict[str, np.ndarray]
#: Lanes solved at a time: enough to hide the calls, few enough for the cache.
BLOCK = 4096
#: What a proof of a gait is held against, and the largest relative radius of its box.
PROVED_FROM = ("stance_angle", "stance_rate", "thigh_rate", "shank_rate", "period", "kneestrike_time", "error_bound")
PROOF_ACCURACY = 1e-12


def atlas(params: Mapping[str, Any], inputs: list[Arrays]) -> Arrays:
    """Every branch of one line's gaits.

    Parameters
    ----------
    params : mapping
        `line`: `{"walker": name or table, "set": {key: value}}`.
    inputs : list
        Nothing.
    """
    return atlases.to_arrays(atlases.survey(Problem(_walker(params["line"]))))


def points(params: Mapping[str, Any], inputs: list[Arrays]) -> Arrays:
    """Gaits at the slopes of one line, each from the line's atlas and nothing else.

    Parameters
    ----------
    params : mapping
        `line`; `slope`, ndarray, shape (n,) [rad]; `want`, names of variables; `gaits`, labels wanted;
        `friction_limit`, above which a gait is flagged for it.
    inputs : list
        The line's atlas.

    Returns
    -------
    dict
        Each wanted variable, shape (n, len(GAITS)[, multipliers]), and `reasons`, which `reason` indexes.
    """
    walker = _walker(params["line"])
    slope = np.asarray(params["slope"], float)
    want = [v for v in VARIABLES if v in params["want"] or v in ALWAYS]
    wanted = set(params.get("gaits") or GAITS)
    problem = Problem(walker)
    branches = atlases.from_arrays(inputs[0])
    n, width = len(slope), 4 if walker.knees else 3
    proofs = [name for name in want if VARIABLES[name].group == "proofs"]
    solved = [name for name in VARIABLES if name in want or (proofs and name in PROVED_FROM) if name not in proofs]
    out: Arrays = {}
    for name in (*solved, *proofs):
        shape = (n, len(GAITS), width) if "multiplier" in VARIABLES[name].dims else (n, len(GAITS))
        out[name] = np.full(shape, VARIABLES[name].absent, VARIABLES[name].dtype)
    searched = f"{starts(problem, atlases.ANCHORS[0]).shape[1]} starts at each of the slopes " + ", ".join(
        f"{s:g}" for s in atlases.ANCHORS
    )
    long, short = (
        status.outside(label, [s for b in branches for s in _spans(b, label)], searched) for label in GAITS[:2]
    )
    reasons = [status.SETTLED, long, status.NO_FURTHER, status.NEWTON_LOST, status.NOT_A_STEP, short]
    out["reason"][:] = [1, 5, 2, 2]
    for k in range(0, n, BLOCK):
        part = slice(k, k + BLOCK)
        _fill(
            {name: out[name][part] for name in solved},
            problem,
            branches,
            slope[part],
            wanted,
            params.get("friction_limit", violations.FRICTION_LIMIT),
        )
    if proofs:
        _prove(out, params["line"], slope)
    out = {name: out[name] for name in want}
    out["reasons"] = np.array(reasons)
    return out


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


def _fill(
    out: Arrays, problem: Problem, branches: list[Branch], slope: np.ndarray, wanted: set[str], friction_limit: float
) -> None:
    """Solve every gait at some slopes and put the wanted ones where their labels say, rows (n, len(GAITS)) of `out`."""
    q = np.log(slope)
    # Of every piece of a branch that comes to these slopes: angles, ratios, and where which variables are.
    angle, ratio, parts = [], [], []
    for number, branch in enumerate(branches):
        for index, Z, segment in branch.guesses(q):
            asked = _asked(branch, segment, wanted)
            if not asked.any():
                continue
            index, Z, segment = index[asked], Z[asked], segment[asked]
            lipschitz = np.maximum(branch.lipschitz[segment], branch.lipschitz[segment + 1])
            rounding_std = branch.rounding_std[segment]
            leg_passes = np.where(branch.safe[segment], branch.leg_passes[segment], UNKNOWN)
            solved = solve(
                problem, Z.T, slope[index], lipschitz, rounding_std.T, tuple(out), leg_passes, friction_limit
            )
            solved["branch"], solved["piece"] = np.full(len(index), number), branch.piece(segment)
            angle.append(np.full(len(slope), np.nan))
            angle[-1][index] = np.where(solved["anthropomorphic"], Z[:, 0], np.nan)
            # What has not converged still is the gait its branch has there.
            nodes = 0.5 * (branch.ratio[segment] + branch.ratio[segment + 1])
            ratio.append(np.full(len(slope), np.nan))
            ratio[-1][index] = np.where(solved["status"] == status.CONVERGED, solved["heelstrike_rate_ratio"], nodes)
            parts.append((index, solved))
    if not parts:
        return
    kept = np.array([gait in wanted for gait in GAITS] + [False])  # there may be more gaits than labels
    for (index, solved), place in zip(parts, places(np.array(angle), np.array(ratio))):
        slot = np.minimum(place[index], len(GAITS))
        keep = np.flatnonzero((slot >= 0) & kept[slot])
        row, slot = index[keep], slot[keep]
        for name, values in out.items():
            values[row, slot] = solved[name][keep]


def _spans(branch: Branch, label: str) -> Iterator[tuple[float, float]]:
    """Least and largest slopes of the runs of a branch's gaits of one label [rad]."""
    mine = ((branch.ratio < 0.5) == (label == "long")) & (branch.leg_passes == 1)
    for first, last in branch.pieces():
        nodes = np.arange(first, last + 1)
        for run in np.split(nodes, np.nonzero(np.diff(mine[nodes]))[0] + 1):
            if mine[run[0]]:
                slopes = np.exp(branch.q[run])
                yield float(slopes.min()), float(slopes.max())


def _walker(line: Mapping[str, Any]) -> Walker:
    return resolve(line["walker"], line.get("set"))


def _asked(branch: Branch, segment: np.ndarray, wanted: set[str]) -> np.ndarray:
    """Segments that may hold a gait the study asks for: which gait has a label depends on none of the other kind.

    The others are of either kind. Where heelstrike is tangential a node has no ratio, and its segments may hold any.
    """
    if wanted & set(GAITS[2:]):
        return np.ones(len(segment), bool)
    low = np.minimum(branch.ratio[segment], branch.ratio[segment + 1])
    high = np.maximum(branch.ratio[segment], branch.ratio[segment + 1])
    return (~(low > 0.6) & ("long" in wanted)) | (~(high < 0.4) & ("short" in wanted))


def solve(
    problem: Problem,
    Z: np.ndarray,
    slope: np.ndarray,
    lipschitz: np.ndarray,
    rounding_std: np.ndarray,
    want: Sequence[str],
    leg_passes: np.ndarray,
    friction_limit: float = violations.FRICTION_LIMIT,
) -> Arrays:
    """Polish guesses, verify them and measure what is wanted; every array has the lane first.

    Parameters
    ----------
    Z : ndarray, shape (m + 1 + phases, n)
        Guesses as a branch's nodes hold them.
    slope, lipschitz : ndarray, shape (n,)
    noise : ndarray, shape (o, n)
        Standard deviation that rounding gives angle, rates and period, over their `reach`.
    want : sequence of str
    passes : ndarray, shape (n,)
        How often the legs pass, where the atlas has shown the stride to be a step; elsewhere UNKNOWN.
    """
    at = settle(problem, Z, slope, lipschitz, rounding_std, leg_passes)
    code = np.where(at.converged & at.step, status.CONVERGED, status.NOT_CONVERGED)
    found = {
        "status": code,
        "reason": np.where(at.converged, np.where(at.step, 0, 4), 3),
        "residual": np.abs((at.stride.image - at.stride.y) / sizes(at.stride.y)).max(axis=0),
        "error_bound": at.bound,
        "anthropomorphic": ~at.step | (at.leg_passes == 1),
        "passes": at.leg_passes,
    }
    found |= _measure(problem, at, slope, want, friction_limit)
    bad = code != status.CONVERGED
    for name, value in found.items():
        if value.dtype == float and name not in ("residual", "heelstrike_rate_ratio"):
            value[bad] = np.nan
    return found


def _measure(problem: Problem, at: Polished, slope: np.ndarray, want: Sequence[str], friction_limit: float) -> Arrays:
    """Wanted variables in the walker's units."""
    walker, stride, scale = problem.walker, at.stride, at.scale
    y, state, times = at.y * scale, at.state * scale, at.times
    time_unit = np.sqrt(walker.leg / walker.g)
    half = problem.map.start_size // 2
    angle, period = y[0], times[-1] * time_unit
    rates = state[half:] / time_unit
    found = {
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
        found |= {
            "multiplier_real": values.real.copy(),
            "multiplier_imag": values.imag.copy(),
            "spectral_radius": np.abs(values).max(axis=1),
        }
    found |= travel(walker, slope, angle, period)
    if {"loss_normal", "loss_tangential", "loss_kneestrike", "energy_imbalance"} & set(want):
        unit = walker.total_mass * walker.g * walker.leg
        normal, tangential = heelstrike_losses(walker, angle, stride.impact * scale)
        found["loss_normal"], found["loss_tangential"] = normal * unit, tangential * unit
        knee = np.zeros(len(slope))
        if walker.knees:
            assert stride.knee is not None
            knee = kneestrike_loss(walker, stride.knee * scale)
        found["loss_kneestrike"] = knee * unit if walker.knees else np.full(len(slope), np.nan)
        drop = step_length(walker, angle) / walker.leg * np.sin(slope)
        found["energy_imbalance"] = (normal + tangential + knee - drop) / drop
    if any(VARIABLES[name].group == "violations" for name in want):
        # Extremes need closer samples than a verdict does: the step is flown once more, only for those who ask.
        fine = problem.map(y / scale, times, problem.parameters(slope, scale), samples=violations.SAMPLES)
        assert fine.motion is not None
        found |= violations.measure(
            walker, [m * scale for m in fine.motion], fine.impact * scale, times, slope, friction_limit
        )
    return {k: np.array(v) for k, v in found.items()}
