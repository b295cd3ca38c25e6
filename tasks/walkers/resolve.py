"""From a name or a table, and the keys that a line sets, to a walker."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Any

from tasks.walkers.walker import KEYS, NUMBERS, Walker, WalkerError

#: Keys of a line that set several of a walker's.
DERIVED = ("foot_mass_ratio", "detuning")


def from_table(table: Mapping[str, Any], catalogue: Mapping[str, Walker] | None = None) -> Walker:
    """Read a `[walker]` table: every key, or `base` and the keys that differ.

    Raises
    ------
    WalkerError
        If a key is unknown or missing, or the walker cannot be.
    """
    table = dict(table)
    base = table.pop("base", None)
    for key in table:
        if key not in KEYS:
            near = difflib.get_close_matches(key, KEYS, 1)
            raise WalkerError(
                key, table[key], "is not a walker key" + (f" (did you mean `{near[0]}`?)" if near else "")
            )
    if base is not None:
        return replace(named(base, catalogue), **table)
    missing = [f.name for f in fields(Walker) if f.default is f.default_factory and f.name not in table]
    if missing:
        raise WalkerError(missing[0], ", ".join(table) or "no key", "is missing from the walker")
    return Walker(**table)


def named(name: object, catalogue: Mapping[str, Walker] | None = None) -> Walker:
    """The catalogue's walker of that name.

    Raises
    ------
    WalkerError
        If there is none.
    """
    if catalogue is None:
        from tasks.walkers.catalogue import CATALOGUE as catalogue
    if not isinstance(name, str) or name not in catalogue:
        near = difflib.get_close_matches(str(name), catalogue, 1)
        raise WalkerError("walker", name, "is not a known walker" + (f" (did you mean {near[0]}?)" if near else ""))
    return catalogue[name]


def resolve(walker: str | Mapping[str, Any], overrides: Mapping[str, float | bool] | None = None) -> Walker:
    """A walker from its name or table and a line's axis values, incl. `foot_mass_ratio` and `detuning`, or `knees`.

    Raises
    ------
    WalkerError
        If the walker, a key or a value cannot be.
    """
    overrides = dict(overrides or {})
    found = named(walker) if isinstance(walker, str) else from_table(walker)
    derived = {key: float(overrides.pop(key)) for key in DERIVED if overrides.get(key) is not None}
    own = dict(walker) if isinstance(walker, Mapping) and "base" in walker else {}
    for owner, value in derived.items():
        if owner == "detuning":
            pass

            found = detuned(walker, value)
        else:
            found = with_foot_mass_ratio(found, value)
        keys = owned(owner, walker)
        for key in (k for k in (*own, *overrides) if k in keys):
            raise WalkerError(
                key, overrides.get(key, own.get(key)), f"is set by `{owner}`, which owns {', '.join(keys)}"
            )
    for key in overrides:
        if key not in NUMBERS and not (key == "knees" and isinstance(overrides[key], bool)):
            near = difflib.get_close_matches(key, [*NUMBERS, "foot_mass_ratio", "detuning", "slope"], 1)
            raise WalkerError(
                key, overrides[key], "is not a walker key" + (f" (did you mean `{near[0]}`?)" if near else "")
            )
    return replace(found, **overrides) if overrides else found


def owned(derived: str, walker: str | Mapping[str, Any]) -> tuple[str, ...]:
    """Keys that a derived key sets: the masses, or those in which the tuned walker and the physical one differ."""
    if derived == "foot_mass_ratio":
        return tuple(key for key, kind in KEYS.items() if kind == "mass")
    pass

    tuned, physical = ends(walker)
    return tuple(key for key in NUMBERS if getattr(tuned, key) != getattr(physical, key))


def with_foot_mass_ratio(walker: Walker, ratio: float) -> Walker:
    """A point-foot walker with each foot `ratio` of the total mass; the hip carries the rest (section 4.1)."""
    if not walker.point_foot:
        raise WalkerError("foot_mass_ratio", ratio, "needs a point-foot walker (D, E or F)")
    total = walker.total_mass
    if not 0 <= ratio < 0.5:
        raise WalkerError("foot_mass_ratio", ratio, "must lie in [0, 0.5)")
    return replace(walker, m_s=ratio * total, m_t=(0.5 - ratio) * total, m_h=0.0)


def check(params: Mapping[str, Any]) -> dict[str, Any]:
    """What a study needs to know of a walker before anything runs; raises WalkerError where it cannot be.

    `table` is the walker as it is before `set`, and `varied` says which key of `set` moves each of its own.
    """
    given = params.get("set") or {}
    walker = resolve(params["walker"], given)
    varied = {
        key: owner for owner in given for key in (owned(owner, params["walker"]) if owner in DERIVED else [owner])
    }
    return {
        "si": walker.si,
        "kneed": walker.knees,
        "multipliers": 4 if walker.knees else 3,
        "table": resolve(params["walker"]).table(),
        "varied": varied,
    }


#: What `detuning` = 1 means for each tuned walker (paper, section 5.2 and figure 8).
PARTNERS = {"A": "physical-straight", "C": "physical"}


def ends(walker: str | Mapping[str, Any]) -> tuple[Walker, Walker]:
    """The tuned walker of the catalogue and its physical partner, between which `detuning` mixes."""
    name = walker if isinstance(walker, str) else str(walker.get("base"))
    return named(name), named(PARTNERS[name])


def detuned(walker: str | Mapping[str, Any], amount: float) -> Walker:
    """Mix what differs linearly from the tuned walker (0) to the physical one (1); beyond is allowed."""
    if (walker if isinstance(walker, str) else walker.get("base")) not in PARTNERS:
        raise WalkerError("detuning", amount, "needs walker A or C")
    tuned, physical = ends(walker)
    mixed = {k: (1 - amount) * getattr(tuned, k) + amount * getattr(physical, k) for k in owned("detuning", walker)}
    return replace(tuned if isinstance(walker, str) else from_table(walker), **mixed if amount else {})
