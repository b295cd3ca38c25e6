"""The task `census`: gaits found by Newton's method from initial guesses over the whole
admissible section.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy import ndarray

from gaitsweep.tasks.branches.special_points import RATES
from gaitsweep.tasks.contract import registry
from gaitsweep.tasks.contract.tables import Arrays, stacked, table
from gaitsweep.tasks.gaits.multipliers import multipliers
from gaitsweep.tasks.gaits.newton import newton
from gaitsweep.tasks.gaits.search import distinct
from gaitsweep.tasks.gaits.step_check import LONG_BELOW, gait_ratio, verify_steps
from gaitsweep.tasks.mechanics.arrays import Sections, Unknowns
from gaitsweep.tasks.mechanics.small_angles import SmallAngles
from gaitsweep.tasks.orbits.initial_states import r_sequence
from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.step.sameness import SAME_GAIT, SAME_POINT
from gaitsweep.tasks.step.simulate import STRUCK, stride
from gaitsweep.tasks.studies.followed import columns_along, followed_over

#: Largest admissible stance angle [rad], and the smallest one over the slope: half that
#: of the linear law.
_MAX_ANGLE, _MIN_ANGLE_RATIO = 1.0, 0.5
#: Stance rate from barely crossing the vertical, over the angle to it, to much faster,
#: over the stance angle.
_SLOWEST, _FASTEST = -0.7, -4.0
#: Largest swing rate over the stance rate, of a leg that swings in pi sqrt(leg/g); of
#: faster ones in proportion.
_SWING_RATIO = 1.6

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
    *RATES,
    "period",
    "spectral_radius",
    "hits",
)
_COVERAGE = (
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
    """Search a line for period-one gaits by Newton's method from initial guesses spread
    over its section.

    Parameters
    ----------
    params : mapping
        `line`; `slope`, ndarray, shape (n,) [rad], or values of the key `along` which
        drives at the line's slope; and the study's option `starts`, initial guesses at
        each.
    inputs : list
        Empty.

    Returns
    -------
    dict
        Tables `census` (a row per distinct gait, in the walker's units: slope, gait,
        anthropomorphic, passes, stance_angle, stance_rate, thigh_rate, shank_rate,
        period, spectral_radius, hits) and `coverage` (slope, starts, struck, converged, gaits, anthropomorphic,
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
    problem, unit = followed_over(params)
    count = int(registry.options("census", params)["starts"])
    parts: list[tuple[ndarray, ...]] = []
    cover: list[tuple[Any, ...]] = []

    for asked in np.asarray(params["slope"], float).tolist():
        columns, row = _searched(problem, asked / unit, count)
        if columns:
            columns["slope"] = np.full(row["gaits"], asked)
            parts.append(tuple(columns.values()))
        row["slope"] = asked
        cover.append(tuple(row[name] for name in _COVERAGE))

    found = stacked("census", parts, columns_along(problem, _GAIT_COLUMNS))
    return found | table("coverage", cover, columns_along(problem, _COVERAGE))


def _searched(
    problem: Problem, drive: float, count: int
) -> tuple[dict[str, ndarray], dict[str, Any]]:
    """Columns of the table `census` at a value of the drive, none without solutions, and
    a row of `coverage`.
    """
    guesses = _struck(problem, starts(problem, drive, count), drive)
    w, hits, converged = _solve(problem, guesses, drive)
    w, hits, tried, added = _deflate(problem, guesses, w, hits, drive)

    gaits: dict[str, ndarray] = {}
    walking = anthropomorphic = 0
    if w.shape[1]:
        gaits = _gaits(problem, w, hits, drive)
        walking = len(gaits["slope"])
        anthropomorphic = int(gaits["anthropomorphic"].sum())

    row: dict[str, Any] = {"starts": count, "struck": guesses.shape[1]}
    row |= {"converged": converged, "gaits": walking}
    row |= _kinds(w.shape[1], walking, anthropomorphic)
    row |= _unseen(hits, converged)
    row |= {"deflated": tried, "found_deflated": added}
    return gaits, row


def _kinds(solutions: int, walking: int, anthropomorphic: int) -> dict[str, int]:
    """Columns of the table `coverage`: how many solutions are gaits of which kind."""
    return {
        "anthropomorphic": anthropomorphic,
        "non_anthropomorphic": walking - anthropomorphic,
        "not_steps": solutions - walking,
    }


def _unseen(hits: ndarray, converged: int) -> dict[str, float]:
    """Columns of the table `coverage`: the Good-Turing estimate, and what it is of."""
    once = int((hits == 1).sum())
    return {"found_once": once, "unseen": max(once, 1) / max(converged, 1)}


def _struck(problem: Problem, y: Sections, drive: float) -> Unknowns:
    """Guesses of gaits whose first step, simulated, ends in a strike, with its times."""
    first = stride(problem, y, np.full(y.shape[1], drive), exact=False)
    guesses = np.vstack([np.log(y[0]), y[1:] / y[0], first.times])
    return guesses[:, first.outcome == STRUCK]


def _gaits(
    problem: Problem, w: Unknowns, hits: ndarray, drive: float
) -> dict[str, ndarray]:
    """Columns of the table `census`, of those solutions that are steps."""
    time_unit = problem.walker.time_unit
    drives = np.full(w.shape[1], drive)
    at, verdict = verify_steps(problem, w, np.log(drives))
    walks = verdict.step & ~verdict.doubt
    state = problem.start(np.multiply(*problem.section(w)), drives)
    columns = (
        drives,
        np.where(gait_ratio(at) < LONG_BELOW, "long", "short"),
        (walks & verdict.anthropomorphic).astype(int),
        verdict.leg_passes.astype(int),
        np.exp(w[0]),
        *(state[1:] / time_unit),
        w[-1] * time_unit,
        np.abs(multipliers(at.jacobian, problem.m)).max(axis=1),
        hits,
    )
    walking = [column[walks] for column in columns]
    return dict(zip(_GAIT_COLUMNS, walking, strict=True))


def starts(problem: Problem, drive: float, count: int) -> ndarray:
    """Spread initial guesses over the admissible section by a low-discrepancy sequence.

    Parameters
    ----------
    problem : Problem
    drive : float
        The slope [rad], or what else drives as the problem counts it.
    count : int

    Returns
    -------
    ndarray, shape (m, count) [rad, sqrt(g/leg)]
        Stance angle and rates just after heelstrike.
    """
    unit = r_sequence(problem.m, count)
    (slope,) = problem.slopes(np.array([drive])).tolist()
    least = _MIN_ANGLE_RATIO * problem.drive.like_slope(problem.walker, drive)
    low = np.log(least)
    high = np.log(_MAX_ANGLE)
    angle = np.exp(low + (high - low) * unit[0])
    # The vertical lies nearer than the ground's normal by the slope: steep gaits are
    # slow for their angle.
    fastest = _FASTEST * angle
    slowest = _SLOWEST * np.maximum(angle - slope, 0.0)
    rate = fastest + (slowest - fastest) * unit[1]
    if problem.m == 2:
        return np.vstack([angle, rate])

    largest = _SWING_RATIO * max(1.0, np.pi / SmallAngles(problem.walker).swing)
    return np.vstack([angle, rate, -rate * largest * (2 * unit[2] - 1)])


def _solve(problem: Problem, w: ndarray, drive: float) -> tuple[ndarray, ndarray, int]:
    """Distinct fixed points, how many guesses led to each, and how many converged at
    all.
    """
    # All guesses are iterated coarsely, and only distinct results exactly.
    q = np.full(w.shape[1], np.log(drive))
    rounds = _MAX_STEPS[problem.phases]
    w, near = newton(problem, w, q, coarse=True, max_iterations=rounds)
    n_near = int(near.sum())
    w, hits = _merge(w[:, near], np.ones(n_near, int), SAME_POINT)
    w, converged = newton(problem, w, q[: w.shape[1]])
    w, hits = _merge(w[:, converged], hits[converged], SAME_GAIT)
    return w, hits, n_near


def _deflate(
    problem: Problem,
    guesses: ndarray,
    known: ndarray,
    hits: ndarray,
    drive: float,
) -> tuple[ndarray, ndarray, int, int]:
    """Known solutions with those that deflation adds, their hits, the number of
    guesses, and of solutions added.
    """
    q = np.full(guesses.shape[1], np.log(drive))
    first = known.shape[1]
    tried = 0
    for _ in range(_PASSES):
        before = known.shape[1]
        if not before or not len(q):
            break

        tried += len(q)
        w, near = deflated(problem, guesses, known, drive)
        w, converged = newton(problem, w[:, near], q[near])
        both = np.hstack([known, w[:, converged]])
        none_yet = np.zeros(both.shape[1] - before, int)
        known, hits = _merge(both, np.append(hits, none_yet), SAME_GAIT)
        if known.shape[1] == before:
            break

    return known, hits, tried, known.shape[1] - first


def deflated(
    problem: Problem, guesses: ndarray, known: ndarray, drive: float
) -> tuple[ndarray, ndarray]:
    """Improve guesses at one value of the drive that known solutions repel.

    Parameters
    ----------
    problem : Problem
    guesses, known : ndarray, shapes (m + k, n) and (m + k, j)
    drive : float
        As for `starts`.

    Returns
    -------
    w : ndarray, shape (m + k, n)
        Coarse iterates.
    converged : ndarray of bool, shape (n,)
        Whether each is near another solution.
    """
    q = np.full(guesses.shape[1], np.log(drive))
    return newton(
        problem,
        guesses,
        q,
        coarse=True,
        enough=_CONVERGING,
        max_iterations=_MAX_ITERATIONS,
        known=known,
    )


def _merge(w: ndarray, hits: ndarray, tolerance: float) -> tuple[ndarray, ndarray]:
    """Merge columns of w closer than a tolerance, in order of their angle, and add up
    their hits.
    """
    kept, same = distinct(w, np.zeros(w.shape[1], int), tolerance)
    return w[:, kept], np.bincount(same, hits, len(kept)).astype(int)
