"""Whether a walker meets the static conditions of section 5.1 of the paper, and the
nearest one that does.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from gaitsweep.tasks.walkers.catalogue import CATALOGUE
from gaitsweep.tasks.walkers.resolve import resolve
from gaitsweep.tasks.walkers.statics import is_tuned, nearest, statics
from gaitsweep.tasks.walkers.walker import KEYS, NUMBERS, Walker, WalkerError


def untuned(params: Mapping[str, Any]) -> str:
    """Say that keys move a tuned walker of the catalogue off the static conditions.

    Parameters
    ----------
    params : mapping
        `walker` (name or table) and `set` (values of keys, in the walker's units).

    Returns
    -------
    str
        A sentence; empty where the walker is tuned, was not before, or is detuned on
        purpose by `detuning`.

    Raises
    ------
    WalkerError
        If the walker, a key or a value is invalid.
    """
    given, changes = params["walker"], dict(params.get("set") or {})
    table = {"base": given} if isinstance(given, str) else dict(given)
    if table.get("base") not in CATALOGUE or "detuning" in (*table, *changes):
        return ""

    base, walker = CATALOGUE[table["base"]], resolve(given, changes)
    if not is_tuned(base) or is_tuned(walker):
        return ""

    keys = ", ".join(
        key
        for key in dict.fromkeys((*table, *changes))
        if key in (*KEYS, "foot_mass_ratio")
    )
    off = ", ".join(f"{name} {value:.3g}" for name, value in statics(walker).items())

    return (
        f"With this {keys}, {table['base']} is no longer tuned ({off}): it has no gaits at vanishing slopes. "
        "`gaitsweep tune` shows the nearest walker that is; `tuned` retunes."
    )


def _instead(start: Walker, free: list[str]) -> str:
    """Which keys meet the conditions in place of those freed, or beside them."""
    alone = [key for key in NUMBERS if _meets(start, [key])]
    beside = [key for key in NUMBERS if key not in free and _meets(start, [*free, key])]
    ways = [
        f"{word} {' or '.join(keys)}"
        for word, keys in (("alone do", alone), ("beside it", beside))
        if keys
    ]
    return f"keys that can: {'; '.join(ways)}" if ways else "free two other keys"


def _meets(start: Walker, free: list[str]) -> bool:
    return bool(nearest(start, free)[2][0])


def tune(params: Mapping[str, Any]) -> dict[str, Any]:
    """Find the nearest zero-slope-capable walker: the smallest relative change of the
    freed keys.

    Parameters
    ----------
    params : mapping
        `walker` (name or table), `free` (keys that may change; default `w_t`, `w_s`).

    Returns
    -------
    dict
        `walker` (a table ready to paste), `moved` (old and new value by key, in the
        walker's units; empty where the walker meets the conditions as it is), `change`
        (relative change by key), and `statics` `before` and `after`.

    Raises
    ------
    WalkerError
        If a key cannot be freed or no change of the freed keys meets the conditions.
    """
    start = resolve(params["walker"])
    free = list(dict.fromkeys(params.get("free") or ("w_t", "w_s")))
    for key in free:
        if key not in NUMBERS:
            raise WalkerError(
                "free", key, f"must name walker keys ({', '.join(NUMBERS)})"
            )

    values, change, found = nearest(start, free)
    if not found[0]:
        raise WalkerError(
            "free",
            ", ".join(free),
            f"cannot meet the zero-slope conditions; {_instead(start, free)}",
        )

    tuned = Walker(
        **{**start.table(), **{k: float(value[0]) for k, value in values.items()}}
    )
    moved = {
        k: [getattr(start, k), getattr(tuned, k)]
        for k in free
        if getattr(tuned, k) != getattr(start, k)
    }

    return {
        "walker": tuned.table(),
        "moved": moved,
        "change": dict(zip(free, change[:, 0].tolist(), strict=True)),
        "before": statics(start),
        "after": statics(tuned),
    }
