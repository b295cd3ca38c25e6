"""The variables in which others write the state of a walker, and the way to ours.

Each convention is a row of contract/conventions.toml: our coordinates as sums of its
columns. What differs from ours is where angles begin (the ground's normal, the vertical,
the other leg), in which sense they grow, and the unit of rates.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from decimal import Context, Decimal
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from gaitsweep.tasks.walkers.resolve import walker_of_line
from gaitsweep.tasks.walkers.walker import Walker, WalkerError

#: Our coordinates, in their order.
COORDINATES = ("stance_angle", "thigh_angle", "stance_rate", "thigh_rate")
#: Those of the swing leg's shank, which conventions of straight legs do not have.
KNEE = ("shank_angle", "shank_rate")
#: The unit of rates.
RATES = ("walker", "scaled")
#: What is given of a gait, and the digits of what is converted by a number.
_GIVEN = ("slope", "stance_angle", "stance_rate", "thigh_rate", "period")
_SIXTEEN = Context(prec=16)


@cache
def conventions() -> dict[str, Any]:
    """Return the conventions by name."""
    path = Path(__file__).parents[1] / "contract" / "conventions.toml"
    return tomllib.loads(path.read_text(encoding="utf-8"))


def columns(params: Mapping[str, Any]) -> dict[str, Any]:
    """Return the columns of a convention.

    Parameters
    ----------
    params : mapping
        `convention`, its name.

    Returns
    -------
    dict
        `columns`, list of str; `optional`, those of the swing leg's angle, without which
        both feet are on the ground, and of its shank, without which its knee is straight;
        `names` of all conventions.
    """
    known = conventions()
    about = known.get(params["convention"], {})
    found = _names(about, (*COORDINATES, *KNEE))
    needed = set(about.get("stance_angle", {})) | set(about.get("stance_rate", {}))
    needed |= set(about.get("thigh_rate", {}))
    optional = [name for name in found if name not in needed]
    return {"columns": found, "optional": optional, "names": list(known)}


def _names(
    about: Mapping[str, Any], coordinates: Sequence[str] = COORDINATES
) -> list[str]:
    """Columns of a convention, in the order of our coordinates."""
    found = dict[str, None]()
    for coordinate in coordinates:
        found |= dict.fromkeys(about.get(coordinate, {}))
    return [name for name in found if name != "slope"]


def to_ours(
    convention: str,
    table: Mapping[str, np.ndarray],
    slope: np.ndarray,
    is_size: bool = False,
) -> np.ndarray:
    """Return our coordinates of states in others' variables.

    Parameters
    ----------
    convention : str
    table : mapping of ndarray, shape (n,)
        Columns; angles in rad. Sizes may have that of the slope.
    slope : ndarray, shape (n,) [rad]
    is_size : bool
        Add magnitudes, as sizes of errors add up.

    Returns
    -------
    ndarray, shape (4, n)
        Of COORDINATES, rates in the unit of the table's; the thigh angle is minus the
        stance angle, both feet on the ground, where no column gives it.
    """
    about = conventions()[convention]
    with_slope = {"slope": np.zeros_like(slope) if is_size else slope, **table}
    rows = np.zeros((len(COORDINATES), len(slope)))
    for row, coordinate in zip(rows, COORDINATES, strict=True):
        if all(name in with_slope for name in about[coordinate]):
            for name, factor in about[coordinate].items():
                row += (abs(factor) if is_size else factor) * with_slope[name]
        else:
            row += rows[0] if is_size else -rows[0]

    return rows


def shank_of(convention: str, table: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return the angle and rate of the swing leg's shank as they stand in a table,
    shape (2, n); NaN where no column gives them.
    """
    about = conventions()[convention]
    count = len(next(iter(table.values())))
    rows = np.full((len(KNEE), count), np.nan)
    for row, coordinate in zip(rows, KNEE, strict=True):
        for name in about.get(coordinate, {}):
            if name in table:
                row[:] = table[name]

    return rows


def rate_unit(walker: Walker, convention: str, rates: str | None) -> float:
    """Return by what a convention's rates are multiplied to be over sqrt(g/leg).

    Raises
    ------
    WalkerError
        If the convention is one of straight legs, and the walker has knees.
    """
    if walker.knees and convention != "gaitsweep":
        raise WalkerError(
            "convention", convention, "has no knees, which the walker has"
        )
    chosen = rates or conventions()[convention]["rates"]
    return walker.time_unit if chosen == "walker" else 1.0


def written_in(params: Mapping[str, Any]) -> list[dict[str, str]]:
    """Return gaits in a convention's variables, digit for digit.

    Parameters
    ----------
    params : mapping
        `convention`, its name; `walker`, the table of the walker whose gaits they are;
        `gaits`, a list of mappings with `slope`, `stance_angle`, `stance_rate`,
        `thigh_rate` and `period` as decimal strings, angles in rad, rates and periods
        in the walker's units.

    Returns
    -------
    list of dict of str
        The convention's columns and the `period` of each as decimal strings: all digits
        of what was given, or 16 where rates are over sqrt(g/leg) and the walker's unit
        of time is another.

    Raises
    ------
    WalkerError
        If the convention is one of straight legs, and the walker has knees.
    """
    convention = params["convention"]
    walker = walker_of_line(params)
    unit = walker.time_unit / rate_unit(walker, convention, None)
    return [_written(convention, gait, unit) for gait in params["gaits"]]


def _written(convention: str, gait: Mapping[str, str], unit: float) -> dict[str, str]:
    """A gait in a convention's variables, whose rates are those of the walker times
    `unit`.
    """
    about = conventions()[convention]
    exact = _in_units(gait, unit)
    # From the angles' own zero.
    for ours in COORDINATES:
        exact[ours] -= about[ours].get("slope", 0) * exact["slope"]

    written = {}
    for name, row in _way_back(convention).items():
        terms = [
            factor * exact[ours]
            for factor, ours in zip(row, COORDINATES, strict=True)
            if factor
        ]
        written[name] = str(sum(terms, Decimal(0)))

    return written | {"period": str(exact["period"])}


def _in_units(gait: Mapping[str, str], unit: float) -> dict[str, Decimal]:
    """Slope, period and our coordinates of a gait, rates times `unit`."""
    exact = {name: Decimal(gait[name]) for name in _GIVEN}
    exact["thigh_angle"] = -exact["stance_angle"]
    if unit == 1.0:
        return exact

    factor = Decimal(unit)
    for name in ("stance_rate", "thigh_rate"):
        exact[name] = _SIXTEEN.multiply(exact[name], factor)
    exact["period"] = _SIXTEEN.divide(exact["period"], factor)
    return exact


@cache
def _way_back(convention: str) -> dict[str, list[int]]:
    """Columns of a convention as sums of our coordinates less their part of the
    slope.
    """
    about = conventions()[convention]
    names = _names(about)
    factors = np.zeros((len(COORDINATES), len(names)))
    for row, ours in enumerate(COORDINATES):
        for column, name in enumerate(names):
            factors[row, column] = about[ours].get(name, 0)

    # The factors are whole numbers, and so are those of the way back.
    back = np.linalg.inv(factors).round().astype(int)
    return dict(zip(names, back.tolist(), strict=True))
