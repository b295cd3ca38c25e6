"""Rows of the tables of curves: their points in the walker's units, and of what normal
form flips and Neimark-Sacker points are.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from gaitsweep.tasks.branches.curves import walks
from gaitsweep.tasks.branches.equations import Keys
from gaitsweep.tasks.branches.meetings import Followed
from gaitsweep.tasks.branches.normal_forms import NormalForm
from gaitsweep.tasks.contract.tables import Arrays, table
from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.walkers.walker import NUMBERS

#: Columns of a normal form.
FORM = ("normal_form", "normal_form_error", "criticality")
#: Tables of points, and their columns of the values of the keys that vary.
_POINTS = ("curves", "turnings", "meetings")
_VALUES = ("value", "other_value")


def rows(
    number: int,
    curve: Followed,
    place: Callable[[np.ndarray], tuple[Any, ...]],
) -> Iterator[tuple[Any, ...]]:
    """Yield the rows of a curve's points.

    Parameters
    ----------
    number : int
        Of the curve.
    curve : Followed
    place : callable
        What is said of a point (u,) before the bound on the error of its slope.
    """
    (condition,) = curve.equations.conditions
    reasons = [""] * len(curve.points)
    reasons[0] = curve.stopped[0]
    reasons[-1] = curve.stopped[1]

    for X, known, reason in zip(curve.points, curve.bounds, reasons, strict=True):
        is_step = int(walks(curve.equations, X))
        columns = form_columns(condition.name, known.form)
        placed = (*place(X), known.error)
        yield (number, curve.kind, *placed, *columns, is_step, reason)


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


def walkers_of(keys: Keys, found: Arrays) -> Arrays:
    """Return the table `curve_walkers`: all keys of the walkers at the points of curves.

    Parameters
    ----------
    keys : Keys
        Those that vary.
    found : dict of ndarray
        The tables of points.

    Returns
    -------
    dict of ndarray
        The values of the keys that vary, in rising order and each once, with the
        numbers of the walker there.
    """
    columns = _VALUES[: len(keys.names)]
    places: set[tuple[float, ...]] = set()
    for group in _POINTS:
        if f"{group}/value" in found:
            values = [found[f"{group}/{name}"].tolist() for name in columns]
            places.update(zip(*values, strict=True))

    rows = []
    for place in sorted(places):
        walker = keys.walker_at(*place)
        numbers = [float(getattr(walker, name)) for name in NUMBERS]
        rows.append((*place, *numbers))

    return table("curve_walkers", rows, (*columns, *NUMBERS))
