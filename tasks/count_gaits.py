"""How many gaits are there? Newton from low-discrepancy starts over the whole admissible section."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from tasks.dynamics.initial_states import r_sequence
from tasks.fixed_points.multipliers import multipliers
from tasks.fixed_points.newton import newton, newton_step
from tasks.fixed_points.step_check import gait_ratio, verify_steps
from tasks.step.problem import Problem
from tasks.step.simulate import STRUCK, stride
from tasks.walkers.resolve import resolve

Arrays = dict[str, np.ndarray]
#: Starts at each slope where a study is silent.
OPTIONS = {"starts": 2000}
#: Widest admissible stance angle [rad]; the narrowest is this share of the slope: half the linear law's.
WIDEST, NARROWEST = 0.8, 0.5
#: Stance rate over angle: from a walker that barely crosses the vertical to one that runs over it.
CROSSING = (-4.0, -0.7)
#: Swing rate over the stance rate's size.
SWING = (-1.6, 1.6)
#: Solutions nearer than this in similarity coordinates are one.
SAME = 1e-5
#: Deflated Newton: steps a start may take, passes over all starts, and how near and how far from known solutions an
#: end must lie to be polished.
MAX_STEPS, PASSES, NEAR, AWAY = 15, 3, 1e-3, 1e-2
GAITS = (
    "slope",
    "gait",
    "anthropomorphic",
    "passes",
    "stance_angle",
    "stance_rate",
    "period",
    "spectral_radius",
    "hits",
)
COVER = (
    "slope",
    "starts",
    "struck",
    "converged",
    "gaits",
    "anthropomorphic",
    "non_anthropomorphic",
    "not_steps",
    "found_once",
    "unseen",
    "deflated",
    "found_deflated",
)


def census(params: Mapping[str, Any], inputs: list[Arrays]) -> Arrays:
    """Every period-one gait of a line that Newton finds from starts all over its section.

    Parameters
    ----------
    params : mapping
        `line`; `slope`, ndarray, shape (n,) [rad]; and the study's option `starts` at each slope.
    inputs : list
        Nothing.

    Returns
    -------
    dict
        Tables `census` (a row per distinct gait: slope, gait, anthropomorphic, passes, stance_angle, stance_rate,
        period, spectral_radius, hits) and `coverage` (slope, starts, struck, converged, gaits, anthropomorphic,
        non_anthropomorphic, not_steps, found_once, unseen, deflated, found_deflated).

    Notes
    -----
    Starts fill the box of stance angle (evenly in its logarithm), stance rate over angle and swing rate over stance
    rate by an additive recurrence. A start is flown to its strikes, which gives Newton its event times. `unseen` is
    Good's and Turing's estimate of the share of converging starts that would lead to a gait not found yet: solutions
    found exactly once, over starts that converged (at least one is assumed, so it is never zero). Then all starts that
    struck go again (`deflated`, counted each time) by Newton on the residual times 1 + 1/r^2 for the distance r to
    each known
    solution (Farrell, Birkisson and Funke 2015), which keeps them from those and leads some elsewhere
    (`found_deflated`; such a gait has no `hits`). A start that never strikes is not tried: its gait, if any, is not
    covered.
    """
    walker = resolve(params["line"]["walker"], params["line"].get("set"))
    problem = Problem(walker)
    time_unit = np.sqrt(walker.leg / walker.g)
    rows: dict[str, list[Any]] = {k: [] for k in GAITS}
    cover: dict[str, list[Any]] = {k: [] for k in COVER}
    for slope in np.asarray(params["slope"], float):
        y = starts(problem, float(slope), int(params.get("starts", OPTIONS["starts"])))
        flown = stride(problem, y, np.full(y.shape[1], slope), exact=False)
        struck = flown.outcome == STRUCK
        begin = np.vstack([np.log(y[0]), y[1:] / y[0], flown.times])[:, struck]
        w, hits, converged = _solved(problem, begin, float(slope))
        w, hits, tried, more = _deflated(problem, begin, w, hits, float(slope))
        counts = {"anthropomorphic": 0, "non_anthropomorphic": 0, "not_steps": 0}
        if w.shape[1]:
            at, verdict = verify_steps(problem, w, np.full(w.shape[1], np.log(slope)))
            radius = np.abs(multipliers(at.jacobian, problem.m)).max(axis=1)
            human = verdict.anthropomorphic
            counts = {
                "anthropomorphic": int(human.sum()),
                "non_anthropomorphic": int((verdict.step & ~human).sum()),
                "not_steps": int((~verdict.step).sum()),
            }
            for i in np.nonzero(verdict.step)[0]:
                values = (
                    slope,
                    "long" if gait_ratio(at)[i] < 0.5 else "short",
                    int(human[i]),
                    int(verdict.leg_passes[i]),
                    np.exp(w[0, i]),
                    np.exp(w[0, i]) * w[1, i] / time_unit,
                    w[-1, i] * time_unit,
                    radius[i],
                    int(hits[i]),
                )
                for key, value in zip(GAITS, values, strict=True):
                    rows[key].append(value)
        once = int((hits == 1).sum())
        values = (
            slope,
            y.shape[1],
            int(struck.sum()),
            converged,
            w.shape[1] - counts["not_steps"],
            *counts.values(),
            once,
            max(once, 1) / max(converged, 1),
            tried,
            more,
        )
        for key, value in zip(COVER, values, strict=True):
            cover[key].append(value)
    found = {f"census/{k}": np.array(v) for k, v in rows.items()}
    return found | {f"coverage/{k}": np.array(v) for k, v in cover.items()}


def starts(problem: Problem, slope: float, count: int) -> np.ndarray:
    """Low-discrepancy starts over the admissible section, shape (m, count) [rad, rad/sqrt(leg/g)]."""
    unit = r_sequence(problem.m, count)
    low, high = np.log(NARROWEST * slope), np.log(WIDEST)
    angle = np.exp(low + (high - low) * unit[0])
    rate = angle * (CROSSING[0] + (CROSSING[1] - CROSSING[0]) * unit[1])
    if problem.m == 2:
        return np.vstack([angle, rate])
    return np.vstack([angle, rate, -rate * (SWING[0] + (SWING[1] - SWING[0]) * unit[2])])


def _solved(problem: Problem, w: np.ndarray, slope: float) -> tuple[np.ndarray, np.ndarray, int]:
    """Distinct fixed points, how many starts led to each, and how many converged at all."""
    q = np.log(slope)
    if problem.phases == 2:
        # Three links are dear: every start flies roughly, and only distinct ends are flown exactly.
        near = newton(problem, w, np.full(w.shape[1], q), coarse=True)
        w, hits = _distinct(near.w[:, near.converged], np.ones(int(near.converged.sum()), int), 1e-3)
        converged = int(near.converged.sum())
    else:
        hits, converged = np.ones(w.shape[1], int), -1
    exact = newton(problem, w, np.full(w.shape[1], q))
    if converged < 0:
        converged = int(exact.converged.sum())
    w, hits = _distinct(exact.w[:, exact.converged], hits[exact.converged], SAME)
    return w, hits, converged


def _deflated(
    problem: Problem, begin: np.ndarray, known: np.ndarray, hits: np.ndarray, slope: float
) -> tuple[np.ndarray, np.ndarray, int, int]:
    """Known solutions with what deflated Newton adds, their hits, how many starts it tried, and how many it added."""
    first, tried = known.shape[1], 0
    for _ in range(PASSES):
        before = known.shape[1]
        if not before or not begin.shape[1]:
            break
        tried += begin.shape[1]
        ends = deflated(problem, begin, known, slope)
        found = newton(problem, ends, np.full(ends.shape[1], np.log(slope)))
        both = np.hstack([known, found.w[:, found.converged]])
        counts = np.concatenate([hits, np.zeros(both.shape[1] - before, int)])
        known, hits = _distinct(both, counts, SAME)
        if known.shape[1] == before:
            break
    return known, hits, tried, known.shape[1] - first


def deflated(problem: Problem, begin: np.ndarray, known: np.ndarray, slope: float) -> np.ndarray:
    """Where Newton leads that is kept from known solutions, shape (m + phases, n); only ends near a solution.

    Notes
    -----
    With M the product of 1 + 1/r^2 over the known solutions, Newton's step for M F is its step s for F over
    1 - s.grad ln M (Sherman and Morrison), so it costs nothing.
    """
    w, q = begin.copy(), np.log(slope)
    active, arrived = np.arange(w.shape[1]), np.zeros(w.shape[1], bool)
    for _ in range(MAX_STEPS):
        if not len(active):
            break
        here = w[:, active]
        at, _ = problem.stride(here, np.full(len(active), q), coarse=problem.phases == 2)
        step = newton_step(at, here)
        away = here[:, None] - known[:, :, None]
        square = (away**2).sum(axis=0)
        with np.errstate(all="ignore"):
            towards = (-2 * away * step[:, None]).sum(axis=0) / (square**2 + square)
            size = np.abs(step).max(axis=0)
            new = size < NEAR
            arrived[active[new & (square.min(axis=0) > AWAY**2)]] = True
            step = step / (1 - towards.sum(axis=0))
            longest = np.abs(step).max(axis=0)
            w[:, active] = here + step * np.minimum(1.0, 0.5 / np.maximum(longest, 1e-300))
        sane = np.isfinite(w[:, active]).all(axis=0) & (np.abs(w[1 : problem.m, active]) < 50).all(axis=0)
        sane &= (w[problem.m :, active] > 0.05).all(axis=0) & (w[-1, active] < 12) & (w[0, active] < 0.4)
        active = active[sane & ~new]
    return w[:, arrived]


def _distinct(w: np.ndarray, hits: np.ndarray, apart: float) -> tuple[np.ndarray, np.ndarray]:
    """Columns of w nearer than `apart` taken together, in order of their angle, with the sum of their hits."""
    order = np.lexsort(np.round(w, 6)[::-1])
    kept: list[int] = []
    count: list[int] = []
    for i in order:
        for k, j in enumerate(kept):
            if np.abs(w[:, i] - w[:, j]).max() <= apart:
                count[k] += int(hits[i])
                break
        else:
            kept.append(int(i))
            count.append(int(hits[i]))
    return w[:, kept], np.array(count, int)
