"""Properties of a walker that a study needs to know before anything runs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from gaitsweep.tasks.walkers.resolve import moved_by, resolve, way
from gaitsweep.tasks.walkers.scaling import scaling
from gaitsweep.tasks.walkers.statics import CONDITIONED
from gaitsweep.tasks.walkers.walker import DIFFERENTIATED, KEYS, OF_PASSIVE, ONE_LINK


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
    moved = {owner: moved_by(owner, definition) for owner in overrides}
    return {
        "si": walker.si,
        "kneed": walker.knees,
        "features": walker.features,
        "driven": walker.is_driven,
        "massless_leg": walker.massless_leg,
        "keys": len(OF_PASSIVE if walker.is_passive else DIFFERENTIATED),
        "multipliers": 4 if walker.knees else 3,
        "table": resolve(definition).table(),
        "parameters": walker.table(),
        "varied": _varied(moved, tuned),
        "tuned": tuned,
        "scaling": scaling(walker, {"walker": definition, "set": overrides}),
        "smooth": tuple(
            key for key in overrides if walker.is_passive and _is_smooth(key)
        ),
        **(
            {"way": way(definition)}
            if {"detuning", "toward"} & {*overrides, *given}
            else {}
        ),
    }


def _varied(
    moved: Mapping[str, tuple[str, ...]], tuned: tuple[str, ...]
) -> dict[str, tuple[str, ...]]:
    """For each key that is `moved`, or tuned when one is, those that move it."""
    varied: dict[str, tuple[str, ...]] = {}
    for owner, keys in moved.items():
        for key in keys:
            varied[key] = (*varied.get(key, ()), owner)

    movers = tuple(
        owner for owner, keys in moved.items() if not set(keys).isdisjoint(CONDITIONED)
    )
    return varied | dict.fromkeys(tuned, movers) if movers else varied


def _is_smooth(key: str) -> bool:
    """Whether gaits change smoothly with a key: a length, a mass, an angle, or what
    moves several of these.
    """
    if key in ("foot_mass_ratio", "detuning"):
        return True
    return (KEYS | ONE_LINK).get(key, "") in ("length", "mass", "angle")
