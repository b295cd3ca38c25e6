"""Walkers that differ only in their units.

Gaits are solved in units of the leg, of sqrt(leg/g) and of the whole mass. A walker with
another g, with all lengths or with all masses larger by one factor is the same walker to
the solver, and its gaits are converted.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from gaitsweep.tasks.walkers.resolve import moved_by, resolve, walker_of_line
from gaitsweep.tasks.walkers.walker import KEYS, OF_DRIVE, ONE_LINK, Walker, WalkerError

#: Kinds of keys that may change units, and those of them that a walker without some of
#: its keys is compared by: the most first.
_SCALES = {"length", "mass", "acceleration"}
_TRIED = (_SCALES, {"mass", "acceleration"}, {"length", "acceleration"})
#: Kinds of keys that a line may set; derived keys have none.
_KINDS = KEYS | ONE_LINK
#: Rounding of a ratio of two lengths or masses.
_ROUNDING = 4 * np.finfo(float).eps


def scales(walker: Walker, line: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the keys that a line sets which change nothing but its walker's units;
    none where more than gravity drives it.

    Parameters
    ----------
    walker : Walker
        The line's.
    line : mapping
        `walker`, a name or table, and `set`, values of keys.

    Returns
    -------
    tuple of str
        They change nothing else together; `g` is always among them.
    """
    if not walker.is_passive:
        return ()

    changes = line.get("set") or {}
    for keys, _ in _candidates(walker, line):
        others = {key: value for key, value in changes.items() if key not in keys}
        try:
            plain = resolve(line["walker"], others)
        except WalkerError:
            continue
        if _differ_in_units(walker, plain):
            return keys

    return ("g",) if "g" in changes else ()


def scaling(walker: Walker, line: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the keys that a line sets of which each alone changes nothing but its
    walker's units, whatever the values of all keys that it sets; none where more than
    gravity may drive it.

    Parameters
    ----------
    walker : Walker
        The line's.
    line : mapping
        `walker`, a name or table, and `set`, values of keys.
    """
    changes = line.get("set") or {}
    if not walker.is_passive or not changes.keys().isdisjoint(OF_DRIVE):
        return ()
    return tuple(key for key in changes if key == "g" or _is_scale(walker, line, key))


def _is_scale(walker: Walker, line: Mapping[str, Any], key: str) -> bool:
    """Whether a key that a line sets is proportional to all lengths, or all masses, of
    its walker, of which no other key that it sets moves one.
    """
    kind = _KINDS.get(key, "")
    if kind not in ("length", "mass"):
        return False

    changes, definition = line["set"], line["walker"]
    others = (moved_by(other, definition) for other in changes if other != key)
    sizes = (own for moved in others for own in moved if KEYS.get(own, "") == kind)
    if any(sizes) or not _covers(walker, definition, (key,), {kind}):
        return False

    try:
        twice = resolve(definition, {**changes, key: 2 * changes[key]})
    except WalkerError:
        return False

    return _differ_in_units(twice, walker)


def scaled(params: Mapping[str, Any]) -> dict[str, Any]:
    """Say in which units a line's walker differs from another line's.

    Parameters
    ----------
    params : mapping
        The line: `walker` and `set`.

    Returns
    -------
    dict
        `keys`, those that it sets which change only units; `plain`, the line without
        them; `units` of its walker and `plain_units` of that line's: of length, mass
        and time; and `possible`, whether any line that sets the same keys may have such
        keys.

    Raises
    ------
    WalkerError
        If the walker is invalid.
    """
    walker = walker_of_line(params)
    keys = scales(walker, params)
    plain = plain_line(params, keys)
    is_covered = walker.is_passive and any(
        sizes for _, sizes in _candidates(walker, params)
    )
    plain_units = units(walker_of_line(plain) if keys else walker)

    return {
        "keys": keys,
        "plain": plain,
        "units": units(walker),
        "plain_units": plain_units,
        "possible": walker.is_passive
        and (is_covered or "g" in (params.get("set") or {})),
    }


def plain_line(line: Mapping[str, Any], keys: tuple[str, ...]) -> dict[str, Any]:
    """Return a line without some of the keys that it sets."""
    others = {key: value for key, value in line["set"].items() if key not in keys}
    return {**line, "set": others}


def units(walker: Walker) -> tuple[float, float, float]:
    """Return a walker's units of length, mass and time."""
    return walker.leg, walker.total_mass, walker.time_unit


def _candidates(
    walker: Walker, line: Mapping[str, Any]
) -> Iterator[tuple[tuple[str, ...], set[str]]]:
    """Keys that a line sets which move all of its walker's lengths, or masses, or both,
    with `g`; and which of these.
    """
    kinds = {key: _KINDS.get(key, "") for key in line.get("set") or {}}
    for tried in _TRIED:
        keys = tuple(key for key, kind in kinds.items() if kind in tried)
        sizes = {kinds[key] for key in keys} - {"acceleration"}
        if sizes and _covers(walker, line["walker"], keys, sizes):
            yield keys, sizes


def _covers(
    walker: Walker,
    definition: str | Mapping[str, Any],
    keys: tuple[str, ...],
    kinds: set[str],
) -> bool:
    """Whether keys move all of a walker's lengths, or masses, that are not zero."""
    moved = {each for key in keys for each in moved_by(key, definition)}
    return all(
        key in moved or not getattr(walker, key)
        for key, kind in KEYS.items()
        if kind in kinds
    )


def _differ_in_units(one: Walker, other: Walker) -> bool:
    """Whether two walkers differ in nothing but units of length, mass and time."""
    if (one.knees, one.units) != (other.knees, other.units):
        return False
    if one.trailing_knee != other.trailing_knee:
        return False

    sizes = {"length": (one.leg, other.leg), "angle": (1.0, 1.0)}
    sizes["mass"] = one.total_mass, other.total_mass
    for key, kind in KEYS.items():
        if kind not in sizes:
            continue

        a, b = (
            getattr(each, key) / size
            for each, size in zip((one, other), sizes[kind], strict=True)
        )
        if abs(a - b) > _ROUNDING * abs(b):
            return False

    return True
