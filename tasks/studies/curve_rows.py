"""Rows of the tables of curves: their points in the walker's units, and of what normal
form flips and Neimark-Sacker points are.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from gaitsweep.tasks.branches.curves import walks
from gaitsweep.tasks.branches.equations import Equations
from gaitsweep.tasks.branches.normal_forms import (
    NONE,
    NormalForm,
    has_form,
    normal_form,
)
from gaitsweep.tasks.step.problem import Problem

#: Columns of a normal form.
FORM = ("normal_form", "normal_form_error", "criticality")


def rows(
    head: tuple[Any, ...],
    equations: Equations,
    points: np.ndarray,
    stopped: tuple[str, str],
    place: Callable[[np.ndarray], tuple[Any, ...]],
) -> Iterator[tuple[Any, ...]]:
    """Yield the rows of a curve's points.

    Parameters
    ----------
    head : tuple
        First columns of all.
    equations : Equations
        Of the curve.
    points : ndarray, shape (p, u)
    stopped : (str, str)
        Why the curve ends at its first and at its last point.
    place : callable
        What is said of a point (u,), the bound on the error of its slope last.
    """
    (condition,) = equations.conditions
    kind = condition.name
    reasons = [""] * len(points)
    reasons[0] = stopped[0]
    reasons[-1] = stopped[1]

    for X, reason in zip(points, reasons, strict=True):
        is_step = int(walks(equations, X))
        placed = place(X)
        error = float(placed[-1])

        form = NONE
        if has_form(kind):
            lane = X[:, None]
            Z, _ = equations.split(lane)
            problem = equations.problem_at(lane).alone(0)
            form = normal_form(problem, kind, Z[:, 0], error)
        columns = form_columns(kind, form)
        yield (*head, *placed, *columns, is_step, reason)


def form_columns(kind: str, form: NormalForm) -> tuple[float, float, str]:
    """Return the columns of the normal form of a point of a kind."""
    return form.coefficient, form.error, form.criticality(kind)


def start_and_period(
    problem: Problem, Z: np.ndarray, time_unit: float
) -> tuple[float, ...]:
    """Return the stance angle and the rates just after heelstrike, and the period, of a
    gait Z (c,) in similarity coordinates and ln drive, in the walker's units.
    """
    y, scale = problem.section(Z[:-1, None])
    drive = np.exp(Z[-1:])
    state = problem.start(y * scale, drive)[:, 0]

    angle, *rates = state.tolist()
    in_units = [rate / time_unit for rate in rates]
    period = float(Z[-2]) * time_unit
    return (angle, *in_units, period)
