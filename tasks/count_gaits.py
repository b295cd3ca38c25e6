"""The task `census`: gaits found by Newton's method from initial guesses over the whole
admissible section.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from gaitsweep.tasks import registry
from gaitsweep.tasks.dynamics.initial_states import r_sequence
from gaitsweep.tasks.fixed_points.multipliers import multipliers
from gaitsweep.tasks.fixed_points.newton import newton
from gaitsweep.tasks.fixed_points.search import distinct
from gaitsweep.tasks.fixed_points.step_check import LONG_BELOW, gait_ratio, verify_steps
from gaitsweep.tasks.mechanics.small_angles import SmallAngles
from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.step.simulate import STRUCK, stride
from gaitsweep.tasks.tables import Arrays, stacked, table
from gaitsweep.tasks.walkers.resolve import walker_of_line

#: Largest admissible stance angle [rad], and the smallest one over the slope: half that
#: of the linear law.
_MAX_ANGLE, _MIN_ANGLE_RATIO = 1.0, 0.5
#: Stance rate from barely crossing the vertical, over the angle to it, to much faster,
#: over the stance angle.
_SLOWEST, _FASTEST = -0.7, -4.0
#: Largest swing rate over the stance rate, of a leg that swings in pi sqrt(leg/g); of
#: faster ones in proportion.
_SWING_RATIO = 1.6
#: Solutions closer than this in similarity coordinates are the same, and after a coarse
#: iteration.
_SAME, _SAME_COARSE = 1e-5, 1e-3
#: Newton steps of a guess, by the number of phases of a step: with a free knee they are
#: dear, and few converge late.
_MAX_STEPS = {1: 25, 2: 15}
#: Deflated Newton: iterations of a guess, passes over all guesses, and largest last
#: step of a converging guess.
_MAX_ITERATIONS, _PASSES, _CONVERGING = 15, 3, 1e-3
_GAIT_COLUMNS = (
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


def census(params: Mapping[str, Any], inputs: list[Arrays]) -> Arrays:
    """Search a line for period-one gaits by Newton's method from initial guesses spread
    over its section.

    Parameters
    ----------
    params : mapping
        `line`; `slope`, ndarray, shape (n,) [rad]; and the study's option `starts`,
        initial guesses at each slope.
    inputs : list
        Empty.

    Returns
    -------
    dict
        Tables `census` (a row per distinct gait, in the walker's units: slope, gait,
        anthropomorphic, passes, stance_angle, stance_rate, period, spectral_radius,
        hits) and `coverage` (slope, starts, struck, converged, gaits, anthropomorphic,
        non_anthropomorphic, not_steps, found_once, unseen, deflated, found_deflated).

    Notes
    -----
    Guesses fill the section in stance angle (uniformly in its logarithm), stance rate between bounds for that angle,
    and swing rate over stance rate by an additive recurrence. The step from each guess
    is simulated to its strikes, whose times are guesses too. `unseen` is the
    Good-Turing estimate of the fraction of converging guesses that would lead to a gait
    not found: solutions found exactly once, over guesses that converged (at least one
    is assumed, so it is never zero). Then all guesses that strike are used again
    (`deflated`, counted each time) with the residual multiplied by 1 + 1/r^2, r the
    distance to each known solution (deflation; Farrell, Birkisson and Funke, SIAM J.
    Sci. Comput. 37, 2015), which repels them from known solutions and leads some to
    others (`found_deflated`; such a gait has no `hits`). A guess that never strikes is
    not used: its gait, if any, is not covered.
    """
    walker = walker_of_line(params["line"])
    problem = Problem(walker)
    parts: list[list[np.ndarray]] = []
    cover: list[dict[str, Any]] = []
    for slope in np.asarray(params["slope"], float):
        y = starts(
            problem, float(slope), int(registry.options("census", params)["starts"])
        )
        first = stride(problem, y, np.full(y.shape[1], slope), exact=False)
        struck = first.outcome == STRUCK
        guesses = np.vstack([np.log(y[0]), y[1:] / y[0], first.times])[:, struck]
        w, hits, converged = _solve(problem, guesses, float(slope))
        w, hits, tried, added = _deflate(problem, guesses, w, hits, float(slope))
        walks = anthropomorphic = np.zeros(0, bool)
        if w.shape[1]:
            at, verdict = verify_steps(problem, w, np.full(w.shape[1], np.log(slope)))
            walks = verdict.step & ~verdict.doubt
            anthropomorphic = walks & verdict.anthropomorphic
            section = np.multiply(*problem.section(w))
            columns = (
                np.full(len(walks), slope),
                np.where(gait_ratio(at) < LONG_BELOW, "long", "short"),
                anthropomorphic.astype(int),
                verdict.leg_passes.astype(int),
                np.exp(w[0]),
                problem.start(section, np.full(len(walks), slope))[1]
                / walker.time_unit,
                w[-1] * walker.time_unit,
                np.abs(multipliers(at.jacobian, problem.m)).max(axis=1),
                hits,
            )
            parts.append([column[walks] for column in columns])
        once = int((hits == 1).sum())
        cover.append(
            {
                "slope": slope,
                "starts": y.shape[1],
                "struck": int(struck.sum()),
                "converged": converged,
                "gaits": int(walks.sum()),
                "anthropomorphic": int(anthropomorphic.sum()),
                "non_anthropomorphic": int((walks & ~anthropomorphic).sum()),
                "not_steps": int((~walks).sum()),
                "found_once": once,
                "unseen": max(once, 1) / max(converged, 1),
                "deflated": tried,
                "found_deflated": added,
            }
        )
    return stacked("census", parts, _GAIT_COLUMNS) | table("coverage", cover)


def starts(problem: Problem, slope: float, count: int) -> np.ndarray:
    """Spread initial guesses over the admissible section by a low-discrepancy sequence.

    Parameters
    ----------
    problem : Problem
    slope : float [rad]
    count : int

    Returns
    -------
    ndarray, shape (m, count) [rad, sqrt(g/leg)]
        Stance angle and rates just after heelstrike.
    """
    unit = r_sequence(problem.m, count)
    low, high = np.log(_MIN_ANGLE_RATIO * slope), np.log(_MAX_ANGLE)
    angle = np.exp(low + (high - low) * unit[0])
    # The vertical lies nearer than the ground's normal by the slope: steep gaits are
    # slow for their angle.
    fastest, slowest = _FASTEST * angle, _SLOWEST * np.maximum(angle - slope, 0.0)
    rate = fastest + (slowest - fastest) * unit[1]
    if problem.m == 2:
        return np.vstack([angle, rate])
    largest = _SWING_RATIO * max(1.0, np.pi / SmallAngles(problem.walker).swing)
    return np.vstack([angle, rate, -rate * largest * (2 * unit[2] - 1)])


def _solve(
    problem: Problem, w: np.ndarray, slope: float
) -> tuple[np.ndarray, np.ndarray, int]:
    """Distinct fixed points, how many guesses led to each, and how many converged at
    all.
    """
    q = np.log(slope)
    # All guesses are iterated coarsely, and only distinct results exactly.
    w, near = newton(
        problem,
        w,
        np.full(w.shape[1], q),
        coarse=True,
        max_iterations=_MAX_STEPS[problem.phases],
    )
    w, hits = _merge(w[:, near], np.ones(near.sum(), int), _SAME_COARSE)
    w, converged = newton(problem, w, np.full(w.shape[1], q))
    return *_merge(w[:, converged], hits[converged], _SAME), int(near.sum())


def _deflate(
    problem: Problem,
    guesses: np.ndarray,
    known: np.ndarray,
    hits: np.ndarray,
    slope: float,
) -> tuple[np.ndarray, np.ndarray, int, int]:
    """Known solutions with those that deflation adds, their hits, the number of
    guesses, and of solutions added.
    """
    first, tried = known.shape[1], 0
    for _ in range(_PASSES):
        before = known.shape[1]
        if not before or not guesses.shape[1]:
            break
        tried += guesses.shape[1]
        w, near = deflated(problem, guesses, known, slope)
        w, converged = newton(problem, w[:, near], np.full(near.sum(), np.log(slope)))
        both = np.hstack([known, w[:, converged]])
        counts = np.concatenate([hits, np.zeros(both.shape[1] - before, int)])
        known, hits = _merge(both, counts, _SAME)
        if known.shape[1] == before:
            break
    return known, hits, tried, known.shape[1] - first


def deflated(
    problem: Problem, guesses: np.ndarray, known: np.ndarray, slope: float
) -> tuple[np.ndarray, np.ndarray]:
    """Improve guesses at one slope that known solutions repel.

    Parameters
    ----------
    problem : Problem
    guesses, known : ndarray, shapes (m + k, n) and (m + k, j)
    slope : float [rad]

    Returns
    -------
    w : ndarray, shape (m + k, n)
        Coarse iterates.
    converged : ndarray of bool, shape (n,)
        Whether each is near another solution.
    """
    q = np.full(guesses.shape[1], np.log(slope))
    return newton(
        problem,
        guesses,
        q,
        coarse=True,
        enough=_CONVERGING,
        max_iterations=_MAX_ITERATIONS,
        known=known,
    )


def _merge(
    w: np.ndarray, hits: np.ndarray, tolerance: float
) -> tuple[np.ndarray, np.ndarray]:
    """Merge columns of w closer than a tolerance, in order of their angle, and add up
    their hits.
    """
    kept, same = distinct(w, np.zeros(w.shape[1], int), tolerance)
    return w[:, kept], np.bincount(same, hits, len(kept)).astype(int)
