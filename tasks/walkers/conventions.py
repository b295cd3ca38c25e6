"""The variables in which others write the state of a walker, and the way to ours.

Each convention is a row of contract/conventions.toml: our coordinates as sums of its
columns. What differs from ours is where angles begin (the ground's normal, the vertical,
the other leg), in which sense they grow, and the unit of rates.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from gaitsweep.tasks.walkers.walker import Walker, WalkerError

#: Our coordinates, in their order.
COORDINATES = ("stance_angle", "thigh_angle", "stance_rate", "thigh_rate")
#: The unit of rates.
RATES = ("walker", "scaled")


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
        both feet are on the ground; `names` of all conventions.
    """
    known = conventions()
    about = known.get(params["convention"], {})
    found = dict[str, None]()
    for coordinate in COORDINATES:
        found |= dict.fromkeys(about.get(coordinate, {}))
    found.pop("slope", None)
    needed = set(about.get("stance_angle", {})) | set(about.get("stance_rate", {}))
    needed |= set(about.get("thigh_rate", {}))
    optional = [name for name in found if name not in needed]
    return {"columns": list(found), "optional": optional, "names": list(known)}


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
        Columns; angles in rad.
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
    with_slope = {**table, "slope": np.zeros_like(slope) if is_size else slope}
    rows = np.zeros((len(COORDINATES), len(slope)))
    for row, coordinate in zip(rows, COORDINATES, strict=True):
        if all(name in with_slope for name in about[coordinate]):
            for name, factor in about[coordinate].items():
                row += (abs(factor) if is_size else factor) * with_slope[name]
        else:
            row += rows[0] if is_size else -rows[0]
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
