"""Properties of a walker that a study needs to know before anything runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from gaitsweep.tasks.walkers.resolve import moved_by, resolve, way
from gaitsweep.tasks.walkers.scaling import scaling
from gaitsweep.tasks.walkers.statics import CONDITIONED
from gaitsweep.tasks.walkers.walker import (
    DIFFERENTIATED,
    KEYS,
    OF_DRIVE,
    OF_PASSIVE,
    ONE_LINK,
)


def check(params: Mapping[str, Any]) -> dict[str, Any]:
    """What a study needs to know of a walker before anything runs.

    Parameters
    ----------
    params : mapping
        `walker` (name or table) and `set` (values of keys, in the walker's units).

    Returns
    -------
    dict
        `si` and `kneed` (bool), `features` (what some variables are of), `driven`
        (whether more than gravity drives it, so that it may walk on level ground),
        `massless_leg` (whether its swing leg has no inertia about the hip),
        `multipliers` (their number), `keys` (by how many of `DIFFERENTIATED` measures
        are differentiated), `table` (the walker before `set`), `parameters` (the walker
        with `set`), `varied` (for each key of the walker that `set` moves, the keys of
        `set` that do), `tuned` (keys that are changed so that the walker is tuned),
        `scaling` (keys of `set` each of which changes nothing but its units), `smooth`
        (keys of `set` with which gaits change smoothly, so that charts may predict
        them), and of a walker that is or may be detuned `way`: the walkers `start` and
        `end` between which `detuning` leads, in words, and both `tables`.

    Raises
    ------
    WalkerError
        If the walker, a key or a value is invalid.
    """
    definition, overrides = params["walker"], params.get("set") or {}
    given: Mapping[str, Any] = {} if isinstance(definition, str) else definition
    walker = resolve(definition, overrides)
    tuned = tuple(dict.fromkeys(given.get("tuned", ())))
    properties = {
        "si": walker.si,
        "kneed": walker.knees,
        "features": walker.features,
        "driven": walker.is_driven,
        "massless_leg": walker.massless_leg,
        "keys": len(OF_PASSIVE if walker.is_passive else DIFFERENTIATED),
        "multipliers": 4 if walker.knees else 3,
        "table": resolve(definition).table(),
        "parameters": walker.table(),
        "varied": _varied(definition, overrides, tuned),
        "tuned": tuned,
        "scaling": scaling(walker, {"walker": definition, "set": overrides}),
        "smooth": tuple(key for key in overrides if _is_smooth(key)),
    }

    if {"detuning", "toward"} & {*overrides, *given}:
        properties["way"] = way(definition)
    return properties


def _varied(
    definition: Any, overrides: Mapping[str, Any], tuned: Sequence[str]
) -> dict[str, tuple[str, ...]]:
    """For each key of the walker that others move, these; a walker is tuned anew where
    a key moves that its tuning depends on.
    """
    varied: dict[str, tuple[str, ...]] = {}
    movers = []
    for owner in overrides:
        moved = moved_by(owner, definition)
        for key in moved:
            varied[key] = (*varied.get(key, ()), owner)
        if any(key in CONDITIONED for key in moved):
            movers.append(owner)

    if movers:
        varied |= dict.fromkeys(tuned, tuple(movers))
    return varied


def _is_smooth(key: str) -> bool:
    """Whether gaits change smoothly with a key: with lengths, masses, angles, shares,
    and what drives.
    """
    kind = (KEYS | ONE_LINK).get(key, "")
    is_size = kind in ("length", "mass", "angle")
    return is_size or key in ("foot_mass_ratio", "detuning", *OF_DRIVE)
