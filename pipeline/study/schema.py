"""JSON Schema of studies and of walker files, made of what checks them, so that editors
complete and explain.

What it refuses the checker refuses too, which alone knows what keys mean together; but
for what is never used, a walker's own `tuned` or `toward` where its study has another,
and for corners of a grid beyond the first 256. Editors of TOML complete from
`properties` and `anyOf`, not from conditions, and follow `$ref` badly: nothing is
referred to, and conditions only narrow what is stated before.
"""

from collections.abc import Iterable, Mapping
from dataclasses import MISSING, fields
from typing import Any, Literal

from gaitsweep import extensions
from gaitsweep.pipeline import dispatch
from gaitsweep.pipeline.study import options, parse
from gaitsweep.pipeline.study.location import Location
from gaitsweep.tasks.contract.accuracy import ACCURACIES
from gaitsweep.tasks.contract.registry import (
    CLAIMS,
    FIGURES,
    FITS,
    GAITS,
    NEEDED_KINDS,
    OPTIONS,
    OVER_LINES,
    VARIABLES,
)

Schema = dict[str, Any]
#: What a study may want beside variables.
_NAMES = {"fits": FITS, "figures": FIGURES, "claims": CLAIMS}


def schema(kind: Literal["study", "walker"] = "study") -> dict[str, object]:
    """Return the JSON Schema (draft 2020-12) of studies or of walker files.

    Parameters
    ----------
    kind : {"study", "walker"}

    Returns
    -------
    dict
        The schema; `json.dump` writes it.

    Raises
    ------
    StudyError
        If there is no such kind.
    """
    if kind not in ("study", "walker"):
        raise Location("", "kind").wrong('must be "study" or "walker"', kind)
    about: Schema = {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": f"{kind} of gaitsweep",
    }
    if kind == "study":
        return about | _study()
    walker = {"description": "Parameters of a walker."} | _walker()
    return about | {
        "type": "object",
        "properties": {"walker": walker},
        "required": ["walker"],
    }


def _study() -> Schema:
    keys = tuple(name for name in parse.axis_keys() if name != "slope")
    known: dict[str, list[Schema]] = {}  # options of all kinds
    for of_kind in OPTIONS.values():
        for name, option in of_kind.items():
            about: Schema = (
                {} if option.default is None else {"default": option.default}
            )
            about |= {"description": option.meaning} | options.schema(
                option.holds, keys
            )
            if about not in known.setdefault(name, []):
                known[name].append(about)
    groups = sorted({v.group for v in VARIABLES.values()} - {""})
    wanted = {
        "variables": _list(
            options.one_of([*VARIABLES, *extensions.names("measures"), *groups]), 1
        )
    }
    wanted |= {
        name: _list(options.one_of([*own, *extensions.names(name)]))
        for name, own in _NAMES.items()
    }
    memory = {"type": "string", "pattern": f"^{parse.MEMORY}$"}
    limits: dict[str, Schema] = {
        "seconds": {
            "type": "number",
            "exclusiveMinimum": 0,
            "maximum": parse.MAX_SECONDS,
        },
        "memory": {"anyOf": [_between("integer", *parse.MEMORIES), memory]},
    }
    file = {
        "type": "string",
        "minLength": 1,
        "description": "CSV file of measurements, relative to the study",
    }
    holds = {
        "name": {"type": "string", "pattern": f"^{parse.NAME}$"},
        "kind": {**options.one_of(OPTIONS), "default": "grid"},
        "accuracy": _between("number", *ACCURACIES),
        "walker": {
            "anyOf": [_name(), {**_list(_name(), 1), "uniqueItems": True}, _walker()]
        },
        "gaits": _list(options.one_of(GAITS), 1),
        "axes": _table({name: _axis(name) for name in parse.axis_keys()}, ["slope"]),
        "want": _table(_described(parse.WANTED, wanted)),
        "limits": _table(_described(parse.LIMITS, limits)),
        "options": _table({name: {"anyOf": each} for name, each in known.items()}),
        "figures": _table({"overlay": _table({"file": file}, ["file"])}),
    }
    conditions = [_of_kind(kind, keys) for kind in OPTIONS]
    return {
        **_table(_described(parse.KEYS, holds), ["name", "walker", "axes"]),
        "allOf": conditions,
    }


def _of_kind(kind: str, keys: tuple[str, ...]) -> Schema:
    """What else holds for studies of a kind."""
    of_options = {
        name: options.schema(option.holds, keys)
        for name, option in OPTIONS[kind].items()
    }
    wanted: dict[str, Schema] = {}
    for key, names in _NAMES.items():
        others = [
            n
            for n in names
            if NEEDED_KINDS.get(n, kind) != kind
            or (kind == "design" and n in OVER_LINES)
        ]
        wanted |= {key: {"items": {"not": {"enum": others}}}} if others else {}
    own: dict[str, Any] = {
        "options": _table(of_options),
        "want": {"properties": wanted},
    }
    if kind != "grid":
        own["accuracy"] = False
    if kind != "branch":
        own["axes"] = {"properties": {"slope": {"properties": {"adaptive": False}}}}
    is_of_it: Schema = {
        "properties": {"kind": {"const": kind}},
        "required": [] if kind == "grid" else ["kind"],
    }
    return {"if": is_of_it, "then": {"properties": own}}


def _axis(name: str) -> Schema:
    """An axis: a list, or a range; of the slope also an adaptive one, of detuning one
    that names a walker.
    """
    own = _key(name)
    spaced = {
        "from": own,
        "to": options.schema("number", ()),
        "n": _between("integer", 1, parse.MAX_VALUES),
    }
    spaced |= {"spacing": {**options.one_of(["linear", "log"]), "default": "linear"}}
    spaced |= {"toward": _other()} if name == "detuning" else {}
    # One value is the first.
    one_value = {
        "if": {"properties": {"n": {"minimum": 2}}},
        "then": {"properties": {"to": own}},
    }
    forms = [
        {**_list(own, 1), "uniqueItems": True},
        _table(spaced, ["from", "to", "n"]) | one_value,
    ]
    if name == "slope":
        adaptive = {
            "from": own,
            "to": own,
            "adaptive": _between("number", *parse.TOLERANCES),
        }
        forms.append(_table(adaptive, ["from", "to", "adaptive"]))
    return {"description": own["description"], "anyOf": forms}


def _key(name: str) -> Schema:
    """The number that a key of a walker, or an axis, holds."""
    about = {"description": (_of_walkers("MEANINGS") | parse.EXTRA_AXES)[name]}
    if name == "slope":
        return about | options.schema("slope", ())
    if name == "foot_mass_ratio":
        low, high = dispatch.resolve("gaitsweep.tasks.walkers.resolve:FOOT_MASS_RATIOS")
        return about | {"type": "number", "minimum": low, "exclusiveMaximum": high}
    most = _of_walkers("MAX_SIZE")
    return about | _between("number", *_of_walkers("BOUNDS").get(name, (-most, most)))


def _walker(leads: bool = True) -> Schema:
    """The table of a walker; one that another `leads` to leads to none."""
    texts, numbers = _of_walkers("MEANINGS"), _of_walkers("NUMBERS")
    keys: dict[str, Schema] = {
        name: _key(name)
        for name in (*texts, "foot_mass_ratio", "detuning")
        if name not in ("knees", "units", "trailing_knee")
    }
    keys |= {
        "knees": {"description": texts["knees"], "type": "boolean", "default": False},
        "units": {
            "description": texts["units"],
            **options.one_of(["SI", "1"]),
            "default": "1",
        },
        "trailing_knee": {
            "description": texts["trailing_knee"],
            **options.one_of([*_of_walkers("TRAILING_KNEES")]),
            "default": "free",
        },
        "base": {"description": "walker of which this one differs in the keys given"}
        | _name(),
        "tuned": {"description": OPTIONS["grid"]["tuned"].meaning}
        | _list(options.one_of(numbers)),
        "name": {"description": "what it is called"},
    }
    if leads:
        keys["toward"] = _other()
    needed = [
        f.name
        for f in fields(_of_walkers("Walker"))
        if f.default is f.default_factory is MISSING
    ]
    straight = {"properties": {"knees": {"const": False}}}
    zero = dispatch.resolve("gaitsweep.tasks.walkers.resolve:ZERO_IF_STRAIGHT")
    one_link = dispatch.resolve("gaitsweep.tasks.walkers.resolve:NEEDED_BY_ONE_LINK")
    whole = [
        {"required": ["base"]},
        {"required": needed},
        {
            **straight,
            "required": ["knees", *(name for name in needed if name not in zero)],
        },
        {**straight, "required": ["knees", "l", *one_link]},
    ]
    return {**_table(keys), "anyOf": whole}


def _other() -> Schema:
    """The walker to which detuning leads, which may be the text of a table."""
    text = {"type": "string", "pattern": r"^\s*\{"}
    return {
        "description": "walker to which `detuning` leads",
        "anyOf": [_name(), text, _walker(leads=False)],
    }


def _name() -> Schema:
    """Name of a walker: of the catalogue, or a file."""
    catalogue = dispatch.resolve("gaitsweep.tasks.walkers.catalogue:CATALOGUE")
    named = options.one_of([*catalogue, *extensions.names("walkers")])
    return {"anyOf": [named, {"type": "string", "pattern": r"\.toml$"}]}


def _of_walkers(name: str) -> Any:
    return dispatch.resolve(f"gaitsweep.tasks.walkers.walker:{name}")


def _described(
    texts: Mapping[str, str], schemas: Mapping[str, Schema]
) -> dict[str, Schema]:
    return {name: {"description": text} | schemas[name] for name, text in texts.items()}


def _between(kind: str, low: float, high: float) -> Schema:
    return {"type": kind, "minimum": low} | (
        {"maximum": high} if high < float("inf") else {}
    )


def _list(items: Schema, least: int = 0) -> Schema:
    return {"type": "array", "items": items, "minItems": least}


def _table(keys: Mapping[str, Schema], needed: Iterable[str] = ()) -> Schema:
    return {
        "type": "object",
        "properties": dict(keys),
        "required": list(needed),
        "additionalProperties": False,
    }
