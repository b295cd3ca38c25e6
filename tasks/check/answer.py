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


def answer(case: Case) -> dict[str, Any]:
    """What is said, in the walker's units."""
    flown = case.flown & (case.verdict == "gait")
    case.reason[flown] = "A gait, in the middle of a step."

    curves = [_curve(problem, branch) for problem, branch in _pictured(case)]
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
    """Branches with their problem: over slopes above 0 and, where rows are on other
    ground, over all.
    """
    for _, problem, branches, counted in case.grounds.of(case.rows.slope):
        if len(counted):
            for branch in branches:
                yield problem, branch


def _curve(problem: Problem, branch: Branch) -> dict[str, np.ndarray]:
    """Points along a branch for a picture, several between its nodes, which are where it
    bends.
    """
    Z = np.hstack([*between_nodes(branch)])
    return {"slope": problem.slopes(np.exp(Z[-1])), "stance_angle": np.exp(Z[0])}
