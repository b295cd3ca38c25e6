"""Fixed points without a known gait to begin with: a lattice of initial guesses over the section."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tasks.fixed_points.newton import newton
from tasks.fixed_points.step_check import verify_steps
from tasks.step.problem import Problem
from tasks.step.step_map import Stride
from tasks.step.verify_step import StepCheck

#: Guesses whose first, second, ... Newton step is larger are given up: hardly one converges, and others reach its gait.
_MAX_STEP_BY_ITERATION = (20.0, 6.0, 4.0, 3.0)
#: Guesses in one cell of this size after three steps converge to one gait: the nearest to it continues.
_MERGE_CELL = 0.1


def starts(problem: Problem, slope: float) -> np.ndarray:
    """Return a fixed lattice of initial guesses over step length, period and swing rate.

    Parameters
    ----------
    slope : float [rad]

    Returns
    -------
    ndarray, shape (m + phases, n)
        In similarity coordinates.

    Notes
    -----
    Stance angles run from the linear (slope) to the cube-root scaling; the stance rate is that of an inverted
    pendulum that crosses from +angle to -angle in the period.
    """
    top = np.log(min(2.0 * slope ** (1 / 3), 0.7))
    bottom = np.log(max(1.5 * slope, 0.02 * slope ** (1 / 3)))
    angles = np.linspace(bottom, top, 9)
    periods = np.array([2.0, 2.5, 3.0, 3.5, 4.0])
    swing, knee = [1.0, 0.5], [1.0]
    if problem.phases == 2:
        swing, knee = [-0.9, -0.3, 0.3], [0.55, 0.75]
    elif problem.m == 2:
        swing = [1.0]
    grid = np.meshgrid(angles, periods, swing, knee, indexing="ij")
    log_angle, period, ratio, fraction = (g.ravel() for g in grid)
    rate = -1.0 / np.tanh(period / 2)
    rows = [log_angle, rate]
    if problem.m == 3:
        rows.append(-ratio * rate if problem.phases == 2 else ratio * rate)
    if problem.phases == 2:
        rows.append(fraction * period)
    return np.vstack([*rows, period])


def search(problem: Problem, slope: float) -> tuple[np.ndarray, Stride | None, StepCheck | None]:
    """Find the distinct fixed points that the lattice of guesses leads to at one slope, in order of the stance angle.

    Parameters
    ----------
    slope : float [rad]

    Returns
    -------
    w : ndarray, shape (m + phases, n)
        In similarity coordinates.
    stride : Stride or None
        Their steps; None where there is no fixed point.
    check : StepCheck or None
        Whether these happen.
    """
    w = search_slopes(problem, [slope])[0]
    if not w.shape[1]:
        return w, None, None
    return w, *verify_steps(problem, w, np.full(w.shape[1], np.log(slope)))


def search_slopes(problem: Problem, slopes: Sequence[float]) -> list[np.ndarray]:
    """Find the distinct fixed points that the lattice of guesses leads to, whether they are steps or not.

    Parameters
    ----------
    slopes : sequence of float [rad]

    Returns
    -------
    list of ndarray, shape (m + phases, n)
        In similarity coordinates, one array a slope.
    """
    lattice = [starts(problem, slope) for slope in slopes]
    at = np.repeat(np.arange(len(slopes)), [w.shape[1] for w in lattice])
    w, log_slope = np.hstack(lattice), np.log(np.asarray(slopes))
    if problem.phases == 2:
        # Three links are expensive: only what converges with coarse integration is integrated exactly.
        coarse = newton(
            problem, w, log_slope[at], coarse=True, max_step_by_iteration=_MAX_STEP_BY_ITERATION, merge_cell=_MERGE_CELL
        )
        w, at = _distinct(coarse.w[:, coarse.converged], at[coarse.converged], 1e-3)
    exact = newton(problem, w, log_slope[at])
    w, at = _distinct(exact.w[:, exact.converged], at[exact.converged], 1e-5)
    return [w[:, at == i] for i in range(len(slopes))]


def _distinct(w: np.ndarray, at: np.ndarray, apart: float) -> tuple[np.ndarray, np.ndarray]:
    """Columns of w in a fixed order, without those nearer than `apart` to one that is kept and shares their `at`."""
    order = np.lexsort([*np.round(w, 6)[::-1], at])
    w, at = w[:, order], at[order]
    keep: list[int] = []
    for i in range(w.shape[1]):
        if all(at[i] != at[j] or np.abs(w[:, i] - w[:, j]).max() > apart for j in keep):
            keep.append(i)
    return w[:, keep], at[keep]
