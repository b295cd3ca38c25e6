"""Solving: the atlas of a line, the points on it, and every gait at one point."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from tasks import status
from tasks.gait import atlas as atlases
from tasks.gait import extended
from tasks.gait.branch import Branch
from tasks.gait.fixed_point import EPS, Problem, gait_ratio, judged, newton_step, rounding, starts
from tasks.gait.stability import multipliers
from tasks.gait.stride import Stride, apply
from tasks.measures import violations
from tasks.measures.energy import heelstrike_losses, kneestrike_loss
from tasks.measures.motion import step_length, travel
from tasks.registry import ALWAYS, GAITS, VARIABLES
from tasks.walkers.parameters import Walker, resolve

Arrays = dict[str, np.ndarray]
#: Lanes solved at a time: enough to hide the calls, few enough for the cache.
BLOCK = 4096
#: Where the atlas cannot vouch for a point's verdict.
UNKNOWN = -1
#: Newton steps a point may take from the atlas; nearly all take one.
MOST_STEPS = 8
#: Relative distance from the fixed point at which multipliers are as good as at it.
NEAR = 2e-12


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
    out: Arrays = {}
    for name in want:
        shape = (n, len(GAITS), width) if "multiplier" in VARIABLES[name].dims else (n, len(GAITS))
        kind = VARIABLES[name].dtype
        out[name] = np.full(shape, np.nan if kind == "f8" else 0, kind)
    spans = [(float(np.exp(b.q[[i, j]].min())), float(np.exp(b.q[[i, j]].max())))
             for b in branches for i, j in b.pieces()]
    searched = (f"{starts(problem, atlases.ANCHORS[0]).shape[1]} starts at each of the slopes "
                + ", ".join(f"{s:g}" for s in atlases.ANCHORS))
    reasons = [status.SETTLED, status.outside(spans, searched), status.NO_FURTHER, status.NEWTON_LOST,
               status.NOT_A_STEP]
    if "status" in out:
        out["status"][:] = status.NO_GAIT
        out["reason"][:, :2], out["reason"][:, 2:] = 1, 2
    free = np.ones((n, len(GAITS)), bool)
    q = np.log(slope)
    for branch in branches:
        for index, Z, segment in branch.guesses(q):
            asked = _asked(branch, segment, wanted)
            index, Z, segment = index[asked], Z[asked], segment[asked]
            lipschitz = np.maximum(branch.lipschitz[segment], branch.lipschitz[segment + 1])
            passes = np.where(branch.safe[segment], branch.passes[segment], UNKNOWN)
            for k in range(0, len(index), BLOCK):
                part = slice(k, k + BLOCK)
                block = index[part]
                solved = solve(problem, Z[part].T, slope[block], lipschitz[part], want, passes[part],
                               params.get("friction_limit", violations.FRICTION_LIMIT))
                label = (~(solved["heelstrike_rate_ratio"] < 0.5)).astype(int)
                slot = np.where(free[block, label], label, np.where(free[block, 2], 2, 3))
                keep = np.array([GAITS[s] in wanted for s in slot], bool) & solved["anthropomorphic"]
                free[block[keep], slot[keep]] = False
                for name in want:
                    out[name][block[keep], slot[keep]] = solved[name][keep]
    out["reasons"] = np.array(reasons)
    return out


def _walker(line: Mapping[str, Any]) -> Walker:
    return resolve(line["walker"], line.get("set"))


def _asked(branch: Branch, segment: np.ndarray, wanted: set[str]) -> np.ndarray:
    """Segments that may hold a gait the study asks for; a gait under a label already taken may be any."""
    if wanted & set(GAITS[2:]):
        return np.ones(len(segment), bool)
    low = np.fmin(branch.ratio[segment], branch.ratio[segment + 1])
    high = np.fmax(branch.ratio[segment], branch.ratio[segment + 1])
    return ((low < 0.6) & ("long" in wanted)) | ((high > 0.4) & ("short" in wanted))


def solve(problem: Problem, Z: np.ndarray, slope: np.ndarray, lipschitz: np.ndarray, want: Sequence[str],
          passes: np.ndarray, friction_limit: float = violations.FRICTION_LIMIT) -> Arrays:
    """Polish guesses, verify them and measure what is wanted; every array has the lane first.

    Parameters
    ----------
    Z : ndarray, shape (m + 1 + phases, n)
        Guesses as a branch's nodes hold them.
    slope, lipschitz : ndarray, shape (n,)
    want : sequence of str
    passes : ndarray, shape (n,)
        How often the legs pass, where the atlas has shown the stride to be a step; elsewhere UNKNOWN.
    """
    m = problem.m
    n = len(slope)
    stride, scale, w = _polish(problem, np.delete(Z, m, axis=0), slope, lipschitz)
    eta = np.abs(newton_step(stride, np.vstack([np.zeros((m, n)), stride.times]))).max(axis=0)
    y = stride.y + stride.newton
    times = stride.times + apply(stride.times_by_y, stride.newton)
    # What is measured at the impacts is carried to the fixed point, as the times are.
    stride.impact = stride.impact + apply(stride.impact_by_y, stride.newton)
    if stride.knee is not None and stride.knee_by_y is not None:
        stride.knee = stride.knee + apply(stride.knee_by_y, stride.newton)
    bound = _bound(problem, stride, y, times, slope, scale, lipschitz, eta)
    converged = np.isfinite(bound) & (2 * lipschitz * eta < 1) & (eta < 1e-4)
    for lane in np.nonzero((bound > extended.ESCALATE) & (bound < 1e-3))[0]:
        y[:, lane], times[:, lane], stride.impact[:, lane], bound[lane] = extended.refine(
            problem, lane, stride, y[:, lane], times[:, lane], slope[lane], scale[lane], bound[lane])
        converged[lane] = bound[lane] < extended.ESCALATE_AGAIN
    begin = problem.map.start(y, problem.parameters(slope, scale))
    state = begin[: problem.map.start_size]
    step = (stride.closing < 0) & (np.diff(stride.times, axis=0, prepend=0) > 0).all(axis=0)
    lanes = np.nonzero(passes == UNKNOWN)[0]
    if len(lanes):
        _, verdict = judged(problem, w[:, lanes], np.log(slope[lanes]))
        step[lanes], passes = verdict.step, passes.copy()
        passes[lanes] = verdict.passes
    code = np.where(converged & step, status.CONVERGED, status.NOT_CONVERGED)
    found = {"status": code, "reason": np.where(converged, np.where(step, 0, 4), 3),
             "residual": np.abs((stride.image - stride.y) / stride.y).max(axis=0), "error_bound": bound,
             "anthropomorphic": ~step | (passes == 1), "passes": passes}
    found |= _measure(problem, stride, y * scale, state * scale, times, scale, slope, want, friction_limit)
    bad = code != status.CONVERGED
    for name, value in found.items():
        if value.dtype == float and name not in ("residual", "heelstrike_rate_ratio"):
            value[bad] = np.nan
    return found


def _bound(problem: Problem, stride: Stride, y: np.ndarray, times: np.ndarray, slope: np.ndarray, scale: np.ndarray,
           lipschitz: np.ndarray, eta: np.ndarray) -> np.ndarray:
    """Bound on the largest relative error of angle, rates and period, shape (n,).

    Rounding of the stride map carried to the fixed point, and what Newton's last step leaves (Newton-Kantorovich).
    """
    m, n = y.shape
    size = problem.map.start_size
    begin = problem.map.start(y, problem.parameters(slope, scale))
    state, by_y = begin[:size], np.abs(begin[size:].reshape(size, m, n))
    error = (rounding(stride) + 2 * lipschitz * eta**2) * np.abs(y)
    rows = [0, *range(size // 2, size)]
    relative = list(apply(by_y[rows], error) / np.abs(state[rows]) + EPS)
    guard = 4 * EPS * np.abs(y[0]) / np.abs(stride.closing)
    relative.append((apply(np.abs(stride.times_by_y[-1:]), error)[0] + guard) / times[-1] + EPS)
    return np.max(relative, axis=0)


def _polish(problem: Problem, w: np.ndarray, slope: np.ndarray, lipschitz: np.ndarray
            ) -> tuple[Stride, np.ndarray, np.ndarray]:
    """Strides at guesses close enough that one more Newton step is exact to rounding.

    Lanes that are close already are not touched again, so a lane's bits do not depend on the others.
    """
    q = np.log(slope)
    w, before = w.copy(), np.full(len(q), np.inf)
    stride, scale = problem.stride(w, q)
    for _ in range(MOST_STEPS):
        step = newton_step(stride, w)
        eta = np.abs(step).max(axis=0)
        # Far: Newton's next step would still leave an error, or what is measured on this stride would show it.
        far = (lipschitz * eta**2 > np.maximum(1e-16, 0.3 * rounding(stride).max(axis=0))) | (eta > NEAR)
        lanes = np.nonzero(far & np.isfinite(eta) & (eta < 0.1) & (eta < 0.5 * before))[0]
        if not len(lanes):
            break
        before = np.zeros(len(q))
        before[lanes] = eta[lanes]
        w[:, lanes] += step[:, lanes]
        again, scale[lanes] = problem.stride(w[:, lanes], q[lanes])
        stride.put(lanes, again)
    return stride, scale, w


def _measure(problem: Problem, stride: Stride, y: np.ndarray, state: np.ndarray, times: np.ndarray, scale: np.ndarray,
             slope: np.ndarray, want: Sequence[str], friction_limit: float) -> Arrays:
    """Wanted variables in the walker's units."""
    walker = problem.walker
    second = np.sqrt(walker.leg / walker.g)
    half = problem.map.start_size // 2
    angle, period = y[0], times[-1] * second
    rates = state[half:] / second
    found = {"stance_angle": angle, "stance_rate": rates[0], "thigh_rate": rates[1], "shank_rate": rates[-1],
             "period": period, "heelstrike_rate_ratio": gait_ratio(stride),
             "kneestrike_time": times[0] * second if walker.knees else np.full(len(slope), np.nan)}
    if {"multiplier_real", "multiplier_imag", "spectral_radius"} & set(want):
        values = multipliers(stride.jacobian, 4 if walker.knees else 3)
        found |= {"multiplier_real": values.real.copy(), "multiplier_imag": values.imag.copy(),
                  "spectral_radius": np.abs(values).max(axis=1)}
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
        found |= violations.measure(walker, [m * scale for m in fine.motion], fine.impact * scale, times, slope,
                                    friction_limit)
    return {k: np.array(v) for k, v in found.items()}
