"""Rows of the tables of curves: their points in the walker's units."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from gaitsweep.tasks.branches.curves import walks
from gaitsweep.tasks.branches.equations import Equations
from gaitsweep.tasks.step.problem import Problem


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
        What is said of a point (u,).
    """
    reasons = [""] * len(points)
    reasons[0] = stopped[0]
    reasons[-1] = stopped[1]
    for X, reason in zip(points, reasons, strict=True):
        is_step = int(walks(equations, X))
        yield (*head, *place(X), is_step, reason)


def start_and_period(
    problem: Problem, Z: np.ndarray, time_unit: float
) -> tuple[float, ...]:
    """Return the stance angle and the rates just after heelstrike, and the period, of a
    gait Z (c,) in similarity coordinates and ln drive, in the walker's units.
    """
    y, scale = problem.section(Z[:-1, None])
    state = problem.start(y * scale, np.exp(Z[-1:]))[:, 0]

    angle, *rates = state.tolist()
    in_units = [rate / time_unit for rate in rates]
    return (angle, *in_units, float(Z[-2]) * time_unit)
