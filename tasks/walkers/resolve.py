"""From a name or a table, and the keys that a line sets, to a walker."""

from __future__ import annotations

import difflib
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import fields, replace
from fractions import Fraction
from typing import Any, TypeVar

import numpy as np

from gaitsweep.tasks.walkers.catalogue import CATALOGUE, PARTNERS
from gaitsweep.tasks.walkers.statics import nearest
from gaitsweep.tasks.walkers.walker import (
    KEYS,
    NUMBERS,
    OF_DRIVE,
    ONE_LINK,
    Walker,
    WalkerError,
    check_number,
)
from gaitsweep.tasks.walkers.walker_array import WalkerArray

#: Keys of a line that set several of a walker's.
_DERIVED = ("detuning", "foot_mass_ratio")
#: What a walker's table may hold beside its own keys.
_MORE = (*_DERIVED, "tuned", "toward")
#: Keys that a line may set, beside those of a leg of one link.
_SETTABLE = (*NUMBERS, "knees", "trailing_knee", *_DERIVED, "slope")
#: Feet weigh at least the first, and less than the second, share of a walker's mass.
FOOT_MASS_RATIOS = 0.0, 0.5


#: Keys by which somebody asks for a leg that differs from the other, or for a wheel, and
#: what is said of them.
_ASKED_FOR = {
    re.compile(pattern): why
    for pattern, why in (
        (
            r"legs?_?\d?|(.*_)?(left|right|inner|outer|stance|swing)(_.*)?"
            r"|[lwmrcR](_[ts])?_?[12]",
            "both legs are equal, and a key is that of either",
        ),
        (
            r"(n_?|number_of_)?spokes?",
            "a wheel is no walker with two legs; docs/physics.md has its step",
        ),
    )
}

#: Keys that a leg of one link has as one of two has them.
_WITH_ONE_LINK = ("R", "m_h", "g", *OF_DRIVE, "knees", "units")


def from_table(table: Mapping[str, Any]) -> Walker:
    """Read a `[walker]` table: every key, or `base` and the keys that differ.

    A `name` is allowed. Straight legs need not name what is zero by default, fore-aft
    offsets and the angle of the thigh; and a leg of one link may be given by `m`, `c`,
    `l` (from the hip to the centre of the foot) and, where they are not zero, `w`, `r`
    and `R`.

    Raises
    ------
    WalkerError
        If a key is unknown or missing, or the walker is invalid.
    """
    values = {key: value for key, value in table.items() if key != "name"}
    if values.get("units") == "none":  # as others call consistent units
        values["units"] = "1"
    base = values.pop("base", None)
    if base is None and values.get("knees") is False:
        values = straight(values)
    _check_names(values, KEYS, KEYS)
    if base is not None:
        return (
            replace(from_catalogue(base), **values) if values else from_catalogue(base)
        )

    missing = [
        f.name
        for f in fields(Walker)
        if f.default is f.default_factory and f.name not in values
    ]
    if missing:
        raise WalkerError(
            missing[0], ", ".join(values) or "no key", "is missing from the walker"
        )

    try:
        return Walker(**values)
    except WalkerError as error:
        if "l" not in table:
            raise
        raise _of_one_link(error, table) from None


def _of_one_link(error: WalkerError, table: Mapping[str, Any]) -> WalkerError:
    """The error of a leg of one link, in its own keys."""
    if error.key == "m_s":
        bound = "must lie off the hip, or `r` be > 0: the leg has no inertia"
        return WalkerError("c", table["c"], bound)

    own = {link: key for key, links in _OF_LINKS.items() for link in links}
    if error.key not in own:
        return error

    key = own[error.key]
    return WalkerError(key, table[key], error.bound.replace("m_t, m_s", "m"))


#: Keys of straight legs that are zero unless they are given.
ZERO_IF_STRAIGHT = ("w_t", "w_s", "eps_T")
#: Keys that a leg of one link must have beside `l`.
NEEDED_BY_ONE_LINK = ("m", "c")
#: Keys of a leg of one link, and those of its thigh and shank that they set; its mass
#: and centre are the thigh's.
_OF_LINKS = {
    **{"m": ("m_t",), "c": ("c_t", "c_s"), "w": ("w_t", "w_s"), "r": ("r_t", "r_s")},
    "l": ("l_t", "l_s", "c_s"),
}
_OF_THIGH = {key: _OF_LINKS[key][0] for key in ("m", "c", "w", "r")}


def straight(values: Mapping[str, Any]) -> dict[str, Any]:
    """The table of straight legs with both links: what is zero by default, and a leg of
    one link as thigh and shank.

    Parameters
    ----------
    values : mapping
        A `[walker]` table without `base`; `l`, `R` and `c` may be fractions, or arrays,
        which are not checked.

    Raises
    ------
    WalkerError
        If keys of both kinds of leg are mixed, one is missing, or a length is no
        number.
    """
    given = dict(values)
    if "l" in given:
        _check_one_link(given)
        length, radius, centre = given.pop("l"), given.get("R", 0.0), given["c"]
        for key, value in {"l": length, "R": radius, "c": centre}.items():
            if not isinstance(value, Fraction | np.ndarray):
                check_number(key, value)

        links = {_OF_THIGH[key]: given.pop(key) for key in _OF_THIGH if key in given}
        # The shank, without mass, has the same centre: that of the leg where its mass
        # vanishes.
        shank = {
            "m_s": 0.0,
            "c_s": centre - length / 2,
            "w_s": links.get("w_t", 0.0),
            "r_s": links.get("r_t", 0.0),
        }
        halves = {"l_t": length / 2, "l_s": length / 2 + radius, **shank}
        given = {**halves, "R": radius, "r_t": 0.0, **links, **given}

    return {**dict.fromkeys(ZERO_IF_STRAIGHT, 0.0), **given}


def _check_one_link(given: Mapping[str, Any]) -> None:
    """Check that a table of a leg of one link has its keys and no others."""
    for key in given:
        if key in KEYS and key not in _WITH_ONE_LINK:
            bound = "does not go with `l`, the length of a leg of one link"
            raise WalkerError(key, given[key], bound)

    _check_names(given, (*KEYS, *ONE_LINK), (*ONE_LINK, *_WITH_ONE_LINK))
    for key in NEEDED_BY_ONE_LINK:
        if key not in given:
            raise WalkerError(key, ", ".join(given), "is missing from the walker")


def from_catalogue(name: object) -> Walker:
    """Look up a walker of the catalogue.

    Raises
    ------
    WalkerError
        If no walker has that name.
    """
    if not isinstance(name, str) or name not in CATALOGUE:
        near = difflib.get_close_matches(str(name), CATALOGUE, 1)
        raise WalkerError(
            "walker",
            name,
            "is not a known walker" + (f" (did you mean {near[0]}?)" if near else ""),
        )

    return CATALOGUE[name]


def _check_names(
    values: Mapping[str, Any], known: Iterable[str], suggested: Iterable[str]
) -> None:
    """Raise WalkerError at the first key that is not known."""
    for key in values:
        if key not in known:
            others = [name for name in suggested if name != key]
            near = difflib.get_close_matches(key, others)
            if near:
                hint = f"did you mean {' or '.join(f'`{name}`' for name in near)}?"
            else:
                hint = f"keys: {', '.join(k for k in others if k != 'slope')}"

            said = "; ".join(filter(None, [why_no_key({"key": key}), hint]))
            raise WalkerError(key, values[key], f"is not a walker key ({said})")


def why_no_key(params: Mapping[str, Any]) -> str:
    """Say why there is no such key as somebody asks for; empty if nothing is known.

    Parameters
    ----------
    params : mapping
        `key`, the name that is no key.
    """
    for pattern, why in _ASKED_FOR.items():
        if pattern.fullmatch(str(params["key"])):
            return why
    return ""


def resolve(
    walker: str | Mapping[str, Any],
    overrides: Mapping[str, float | bool | str] | None = None,
) -> Walker:
    """Make a walker of its name or table and a line's axis values.

    Parameters
    ----------
    walker : str or mapping
        Name in the catalogue, or a `[walker]` table, which may hold `foot_mass_ratio`
        or `detuning` too; `toward`, the name or table of the walker that `detuning` = 1
        gives; and `tuned`, keys that are changed, as little as possible, so that the
        walker meets the static conditions.
    overrides : mapping, optional
        Values of walker keys, `knees`, `trailing_knee`, `foot_mass_ratio` and
        `detuning`, in the walker's units; for a leg of one link its own keys, with the meaning that they
        have in its table; `R` keeps the length to the bottom of the foot.

    Raises
    ------
    WalkerError
        If the walker, a key or a value is invalid.
    """
    table, given = _table(walker), dict(overrides or {})
    given = {**{key: table[key] for key in _DERIVED if key in table}, **given}
    tuned = _free_keys(table.get("tuned", ()), given)
    own, changes = split({k: v for k, v in table.items() if k not in _MORE}, given)
    of_links = given.keys() - changes.keys()
    links = _links({key: given[key] for key in of_links})

    start = from_table(own)
    derived = {}
    for key in _DERIVED:
        if changes.get(key) is not None:
            derived[key] = changes.pop(key)
            check_number(key, derived[key])

    if "toward" in table and "detuning" not in derived:
        _detuning_ends(table)  # is checked though nothing is detuned
    moved: dict[str, Any] = _moved_values(table, start, derived, changes, links)
    numbers = _numbers_among(changes)
    _check_no_link(numbers)
    _check_names(numbers, NUMBERS, _SETTABLE)
    result = replace(start, **moved, **changes)
    return _retuned(result, tuned) if tuned else result


def _check_no_link(numbers: Mapping[str, Any]) -> None:
    """Refuse keys of a leg of one link for a walker of two."""
    for key, value in numbers.items():
        if key in ONE_LINK:
            raise WalkerError(
                key,
                value,
                "is a key of a leg of one link, whose table has `l`, `m` and `c`",
            )


def _links(given: Mapping[str, Any]) -> dict[str, tuple[str, Any]]:
    """Keys of links that those of a leg of one link set, each with that and its value."""
    links = {}
    for key, value in given.items():
        for link in _OF_LINKS[key]:
            links[link] = key, value
    return links


def _numbers_among(changes: Mapping[str, Any]) -> dict[str, Any]:
    """Changes without the keys that hold a flag or a rule, which walkers check."""
    return {
        key: value
        for key, value in changes.items()
        if key != "trailing_knee" and not (key == "knees" and isinstance(value, bool))
    }


def walker_of_line(line: Mapping[str, Any]) -> Walker:
    """Make the walker of a line: of its `walker`, a name or table, with the keys that
    it may `set`.
    """
    return resolve(line["walker"], line.get("set"))


def walkers_over(line: Mapping[str, Any], *keys: str) -> Callable[..., Walker]:
    """Return a line's walkers as a function of the values of keys."""
    own = line.get("set") or {}

    def walker_at(*values: float) -> Walker:
        changes = dict(zip(keys, values, strict=True))
        return resolve(line["walker"], {**own, **changes})

    return walker_at


def value_of_key(line: Mapping[str, Any], key: str) -> float:
    """Return a line's value of a key: of a walker, of a leg of one link, `detuning` or
    `foot_mass_ratio`.
    """
    walker = walker_of_line(line)
    settings = line.get("set", {})
    if key in settings:
        return float(settings[key])

    # A walker's table may be detuned too.
    given = line["walker"] if isinstance(line["walker"], Mapping) else {}
    derived = {
        "detuning": given.get("detuning", 0.0),
        "foot_mass_ratio": walker.m_s / walker.total_mass,
    }
    if is_one_link(given):
        derived |= {name: given.get(name, 0.0) for name in ONE_LINK}
    elif key in ONE_LINK:
        raise WalkerError(
            key,
            "two links",
            "is a key of a leg of one link, whose table has `l`, `m` and `c`",
        )

    return float(derived[key] if key in derived else getattr(walker, key))


def _table(walker: str | Mapping[str, Any]) -> Mapping[str, Any]:
    """The table of a walker that may be given by its name."""
    return {"base": walker} if isinstance(walker, str) else walker


def _moved_values(
    table: Mapping[str, Any],
    start: Walker,
    derived: Mapping[str, float],
    changes: Mapping[str, Any],
    links: Mapping[str, tuple[str, Any]],
) -> dict[str, float]:
    """Values of all keys that derived keys set; none of these may be set otherwise.

    `start` is the table's walker before derived keys move it; `changes` are the other
    keys that a line sets, and `links` the keys that those of a leg of one link set,
    each with that key and its value.
    """
    values: dict[str, float] = {}
    owners: dict[str, str] = {}
    for owner, value in derived.items():
        is_way = owner == "detuning"
        if not is_way:
            _check_feet(start, float(value), table.get("base"))
        own_values = _values(owner, table, float(value))
        keys = tuple(own_values)
        # A table's own keys are those of the walker at one end of its way to another.
        is_free = "base" not in table or (is_way and "toward" in table)
        given = changes if is_free else {**table, **changes}
        own = [(key, given[key]) for key in given if key in keys]
        own += [links[key] for key in keys if key in links and is_way]
        for key, other in own:
            raise WalkerError(
                key, other, f"is set by `{owner}`, which owns {', '.join(keys)}"
            )

        for key in (k for k in keys if k in owners):
            raise WalkerError(owner, value, f"sets {key}, and so does `{owners[key]}`")
        owners |= dict.fromkeys(keys, owner)
        values |= own_values

    return values


def split(
    table: Mapping[str, Any], changes: Mapping[str, Any]
) -> tuple[dict[str, Any], dict[str, Any]]:
    """The table of a leg of one link with changes of its own keys, and all other
    changes.
    """
    own = [key for key in changes if is_one_link(table) and key in _OF_LINKS]
    return (
        {**table, **{key: changes[key] for key in own}},
        {key: value for key, value in changes.items() if key not in own},
    )


def is_one_link(walker: str | Mapping[str, Any]) -> bool:
    """Whether a walker is the table of a leg of one link."""
    return (
        "l" in (table := _table(walker))
        and "base" not in table
        and table.get("knees") is False
    )


def _free_keys(tuned: Any, changes: Mapping[str, Any]) -> tuple[str, ...]:
    """Check the keys that are to be tuned: numbers of a walker, none of which is given
    otherwise.

    Raises
    ------
    WalkerError
        If one is not.
    """
    if not isinstance(tuned, list | tuple) or any(key not in NUMBERS for key in tuned):
        raise WalkerError(
            "tuned", tuned, f"must be a list of keys of a walker ({', '.join(NUMBERS)})"
        )

    for key in tuned:
        if key in changes:
            raise WalkerError(
                key,
                changes[key],
                "is set by `tuned`, which changes it so that the walker is tuned",
            )

    return tuple(dict.fromkeys(tuned))


_Walkers = TypeVar("_Walkers", bound=Walker)


def _retuned(walkers: _Walkers, free: Sequence[str]) -> _Walkers:
    """The nearest walkers that meet the static conditions; NaN in keys of those of many
    that no change of them tunes.

    Raises
    ------
    WalkerError
        If none can be tuned.
    """
    values, _, found = nearest(walkers, free)
    if not found.any():
        raise WalkerError(
            "tuned",
            ", ".join(free),
            "cannot meet the static conditions of vanishing slopes; add a key",
        )

    tuned = {
        key: value if len(value) > 1 else float(value[0])
        for key, value in values.items()
    }
    return type(walkers)(**{**walkers.table(), **tuned})


def owned(derived: str, walker: str | Mapping[str, Any]) -> tuple[str, ...]:
    """Keys that a derived key sets: the masses, or those in which the walkers at both
    ends of a way differ.
    """
    return tuple(_values(derived, walker, 0.0))


def _values(
    derived: str, walker: str | Mapping[str, Any], amount: Any
) -> dict[str, Any]:
    """Values of the keys that a derived key of some amount, a number or an array, sets.

    Detuning interpolates between two walkers. A foot mass ratio is the share of the
    total mass that each foot of a point-foot walker has; the hip carries the rest
    (section 4.1).
    """
    if derived == "detuning":
        start, end = _detuning_ends(walker)
        ends = {key: (getattr(start, key), getattr(end, key)) for key in NUMBERS}
        return {
            key: (1 - amount) * first + amount * last
            for key, (first, last) in ends.items()
            if first != last
        }

    own = _itself(_table(walker))
    total = own.total_mass
    if not own.m_t and (
        own.c_t or own.w_t or own.r_t
    ):  # the centre of no mass need not be at the hip
        return {"m_t": 0.0, "m_s": amount * total, "m_h": (1 - 2 * amount) * total}

    return {"m_t": (0.5 - amount) * total, "m_s": amount * total, "m_h": 0.0}


def _check_feet(walker: Walker, ratio: float, base: str | None) -> None:
    """Check a foot mass ratio.

    Of a table with a point-foot walker as its `base` the other keys, such as R, are
    free, as those that a line sets.

    Raises
    ------
    WalkerError
        If no walker with point feet has it.
    """
    if not (walker.point_foot or (base and from_catalogue(base).point_foot)):
        raise WalkerError(
            "foot_mass_ratio", ratio, "needs a point-foot walker (D, E or F)"
        )
    if not FOOT_MASS_RATIOS[0] <= ratio < FOOT_MASS_RATIOS[1]:
        raise WalkerError(
            "foot_mass_ratio",
            ratio,
            "must lie in [{:g}, {:g})".format(*FOOT_MASS_RATIOS),
        )


def _itself(table: Mapping[str, Any]) -> Walker:
    """The walker of a table without what moves it."""
    return from_table({key: value for key, value in table.items() if key not in _MORE})


def resolve_many(
    walker: str | Mapping[str, Any], overrides: Mapping[str, Any]
) -> WalkerArray:
    """Make walkers of a name or table and arrays of values of keys.

    Parameters
    ----------
    walker : str or mapping
        As for `resolve`.
    overrides : mapping
        As for `resolve`, of numbers and of ndarrays, shape (n,), of which not every
        walker is checked.

    Returns
    -------
    WalkerArray
        The walkers that `resolve` would make one by one.

    Raises
    ------
    WalkerError
        If no walker is valid.
    """
    table = dict(_table(walker))
    if "tuned" in table:
        free = _free_keys(table.pop("tuned"), overrides)
        return _retuned(resolve_many(table, overrides), free)

    arrays = {
        key: value for key, value in overrides.items() if isinstance(value, np.ndarray)
    }
    first = _first_valid(walker, overrides, arrays)
    values: dict[str, Any] = {}
    start, others = split({k: v for k, v in table.items() if k not in _MORE}, overrides)
    if is_one_link(table):
        values |= {
            key: value
            for key, value in straight(start).items()
            if isinstance(value, np.ndarray)
        }
        arrays = {key: value for key, value in arrays.items() if key in others}

    for key, array in arrays.items():
        values |= _values(key, table, array) if key in _DERIVED else {key: array}
    return WalkerArray(**{**first.table(), **values})


def _first_valid(
    walker: str | Mapping[str, Any],
    overrides: Mapping[str, Any],
    arrays: Mapping[str, np.ndarray],
) -> Walker:
    """The first of the walkers of arrays that is valid; the error of the last if none
    is.
    """
    if not arrays:
        return resolve(walker, overrides)

    for values in zip(*arrays.values(), strict=True):
        numbers = dict(zip(arrays, map(float, values), strict=True))
        try:
            return resolve(walker, {**overrides, **numbers})
        except WalkerError as error:
            impossible = error

    raise impossible


def way(walker: str | Mapping[str, Any]) -> dict[str, Any]:
    """Return the walkers between which detuning leads: `start` and `end`, in words, and
    both `tables`.
    """
    table = _table(walker)
    tables = [end.table() for end in _detuning_ends(table)]
    if "toward" not in table:
        return {
            "start": "the exactly tuned walker",
            "end": "the physical one",
            "tables": tables,
        }

    own = {key: value for key, value in table.items() if key not in _MORE}
    return {"start": label(own), "end": label(table["toward"]), "tables": tables}


def moved_by(owner: str, walker: str | Mapping[str, Any]) -> tuple[str, ...]:
    """Keys of a walker that a key of a line moves, those tuned apart."""
    if owner in _DERIVED:
        return owned(owner, walker)
    return _OF_LINKS.get(owner, (owner,)) if is_one_link(walker) else (owner,)


def _detuning_ends(walker: str | Mapping[str, Any]) -> tuple[Walker, Walker]:
    """Return the walkers between which `detuning` interpolates: the walker itself and
    the one it is `toward`.

    Where a table names none, those are the exactly tuned walker of the catalogue, A or
    C, and its physical partner.

    Raises
    ------
    WalkerError
        If there is no other walker, or no way to it.

    Notes
    -----
    Paper, section 5.2 and figure 8.
    """
    table = _table(walker)
    if "toward" not in table:
        name = table.get("base")
        if name not in PARTNERS:
            raise WalkerError(
                "detuning",
                label(walker),
                "needs walker A or C, or `toward`, another walker",
            )
        return from_catalogue(name), from_catalogue(PARTNERS[str(name)])

    other = table["toward"]
    if not isinstance(other, str | Mapping):
        raise WalkerError("toward", other, "must be the name or the table of a walker")
    if "toward" in _table(other):
        raise WalkerError(
            "toward", label(other), "must be a walker that has no `toward` itself"
        )

    start = _itself(table)
    try:
        end = resolve(other)
    except WalkerError as error:
        key = "base" if error.key == "walker" else error.key
        raise WalkerError(
            "toward", error.value, f"must be a walker, and its `{key}` {error.bound}"
        ) from error

    if start.knees != end.knees:
        raise WalkerError(
            "toward", label(other), f"must have {_LEGS[start.knees]}, as the walker has"
        )

    for key in ("units", "trailing_knee"):
        own = getattr(start, key)
        if getattr(end, key) != own:
            raise WalkerError(
                "toward",
                label(other),
                f'must have `{key}` = "{own}", as the walker has',
            )

    if all(getattr(start, key) == getattr(end, key) for key in NUMBERS):
        raise WalkerError(
            "toward", label(other), "must differ from the walker in a key"
        )

    return start, end


_LEGS = {True: "knees", False: "straight legs"}


def label(walker: str | Mapping[str, Any]) -> str:
    """A walker in words: its name, or that of its base with the keys that differ."""
    table = _table(walker)
    keys = ", ".join(
        f"{key} = {value}"
        for key, value in table.items()
        if key not in ("base", "name", "toward")
    )
    name = table.get("name") or table.get("base")
    if table.get("base") == name and keys:
        return f"{name} with {keys}"

    return str(name or "a walker of its own")
