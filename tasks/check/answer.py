"""What is said of states, as `check_states` returns it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from gaitsweep.tasks.branches.branch import Branch
from gaitsweep.tasks.branches.nearest import between_nodes
from gaitsweep.tasks.check.case import Case
from gaitsweep.tasks.check.rows import State
from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.step.several_steps import begun_at


def answer(case: Case) -> dict[str, Any]:
    """What is said, in the walker's units."""
    flown = case.flown & (case.verdict == "gait")
    case.reason[flown] = "A gait, in the middle of a step."

    curves: list[dict[str, np.ndarray]] = []
    for problem, branch in _pictured(case):
        curves += _curves(problem, branch)
    judged = _columns(case, case.rows.state)
    nearest = _columns(case, case.nearest.state)
    nearest = {f"nearest_{name}": values for name, values in nearest.items()}
    return {**_said(case), **judged, **nearest, "curves": curves}


def _columns(case: Case, state: State) -> dict[str, np.ndarray]:
    """Coordinates of states, by name, in the walker's units."""
    angle, stance_rate, thigh_rate = state
    unit = case.walker.time_unit
    return {
        "stance_angle": angle,
        "stance_rate": stance_rate / unit,
        "thigh_rate": thigh_rate / unit,
    }


def _said(case: Case) -> dict[str, np.ndarray]:
    """What is said of the rows."""
    is_slope = np.isin(case.verdict, ("slope", "below_ground"))
    has_nearest = np.isfinite(case.distance)
    return {
        "verdict": case.verdict.astype(str),
        "reason": case.reason.astype(str),
        "is_gait": case.verdict == "gait",
        "slope": case.rows.slope,
        "gait": case.label.astype(str),
        "steps": np.where(has_nearest, case.nearest.steps, 0),
        "distance": np.where(has_nearest, case.distance, np.nan),
        "missed": case.missed,
        "spectral_radius": case.nearest.radius,
        "belongs_to_slope": np.where(is_slope, case.belongs, np.nan),
        "walker": case.other.astype(str),
        "flown": case.flown,
    }


def _pictured(case: Case) -> Iterator[tuple[Problem, Branch]]:
    """Branches with their problem: of gaits of all steps that are tried over slopes above
    0 and, where rows are on other ground, of one step over all.
    """
    slope = case.rows.slope
    followed = [*case.grounds.downhill] if (slope > 0).any() else []
    if (slope <= 0).any() and case.grounds.is_driven:
        followed.append(case.grounds.over_any_slope)
    for problem, branches in followed:
        for branch in branches:
            yield problem, branch


def _curves(problem: Problem, branch: Branch) -> Iterator[dict[str, np.ndarray]]:
    """Points along a branch for a picture, several between its nodes, which are where it
    bends: a curve for each of the steps at which its gaits may begin.
    """
    Z = np.hstack([*between_nodes(branch)])
    slope = problem.slopes(np.exp(Z[-1]))
    for first in range(problem.steps):
        w = begun_at(Z[:-1], problem.m, problem.steps, first)
        yield {"slope": slope, "stance_angle": np.exp(w[0])}
