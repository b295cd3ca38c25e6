"""Description of walkers, for `gaitsweep walkers`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from gaitsweep.tasks.walkers.catalogue import CATALOGUE, DESCRIPTIONS
from gaitsweep.tasks.walkers.resolve import from_catalogue, resolve
from gaitsweep.tasks.walkers.statics import statics
from gaitsweep.tasks.walkers.walker import Walker


def describe(params: Mapping[str, Any]) -> dict[str, Any]:
    """Describe the catalogue, or one walker.

    Parameters
    ----------
    params : mapping
        `name` (str or None) or `walker` (a table, whose `name` is shown if it has one).

    Returns
    -------
    dict
        `walkers`, a list of dicts: name, description, parameters and geometry (in the
        walker's units), drawing, and statics (residuals of the static conditions).

    Raises
    ------
    WalkerError
        If there is no such walker.
    """
    if params.get("walker") is not None:
        walkers = {
            str(params["walker"].get("name", "custom")): resolve(params["walker"])
        }
    elif params.get("name"):
        walkers = {params["name"]: from_catalogue(params["name"])}
    else:
        walkers = CATALOGUE

    return {
        "walkers": [
            {
                "name": name,
                "description": DESCRIPTIONS.get(name, "a walker of your own"),
                "parameters": w.table(),
                "geometry": {
                    "l": w.l,
                    "eps_S": w.eps_S,
                    "leg": w.leg,
                    "total_mass": w.total_mass,
                },
                "drawing": drawing(w),
                "statics": statics(w),
            }
            for name, w in walkers.items()
        ]
    }


def drawing(walker: Walker) -> str:
    """Sketch the walker's hip, knees and feet in a few lines of text, not to scale."""
    foot = "(_)" if walker.R > 0 else " * "
    rows = ["        o        hip"]
    if walker.knees:
        rows += [
            "       / \\",
            "      /   >      knee",
            "     /   /",
            f"   {foot} {foot}      feet",
        ]
    else:
        rows += [
            "       / \\",
            "      /   \\",
            "     /     \\",
            f"   {foot}     {foot}  feet",
        ]

    return "\n".join(rows)
