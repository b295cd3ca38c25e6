"""What `gaitsweep walkers` shows."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from tasks.walkers.catalogue import CATALOGUE, DESCRIPTIONS
from tasks.walkers.resolve import from_table, named
from tasks.walkers.walker import Walker


def describe(params: Mapping[str, Any]) -> dict[str, Any]:
    """The catalogue, or one walker: parameters, drawing and statics.

    Parameters
    ----------
    params : mapping
        `name` (str or None) or `walker` (a table).

    Raises
    ------
    WalkerError
        If there is no such walker.
    """
    from tasks.walkers.tuning import statics

    if params.get("walker") is not None:
        found = {"custom": from_table(params["walker"])}
    elif params.get("name"):
        found = {params["name"]: named(params["name"])}
    else:
        found = CATALOGUE
    return {
        "walkers": [
            {
                "name": name,
                "description": DESCRIPTIONS.get(name, "a walker of your own"),
                "parameters": w.table(),
                "geometry": {"l": w.l, "eps_S": w.eps_S, "leg": w.leg, "total_mass": w.total_mass},
                "drawing": drawing(w),
                "statics": statics(w),
            }
            for name, w in found.items()
        ]
    }


def drawing(walker: Walker) -> str:
    """A few lines of text: the walker's hip, knees and feet, to no scale."""
    foot = "(_)" if walker.R > 0 else " * "
    rows = ["        o        hip"]
    if walker.knees:
        rows += ["       / \\", "      /   >      knee", "     /   /", f"   {foot} {foot}      feet"]
    else:
        rows += ["       / \\", "      /   \\", "     /     \\", f"   {foot}     {foot}  feet"]
    return "\n".join(rows)
