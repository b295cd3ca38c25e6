"""JSON Schema of studies and of walker files, made of what checks them, so that editors
complete and explain.

What it refuses the checker refuses too, which alone knows what keys mean together; but
for what is never used, a walker's own `tuned` or `toward` where its study has another,
and for corners of a grid beyond the first 256. Editors of TOML complete from
`properties` and `anyOf`, not from conditions, and follow `$ref` badly: nothing is
referred to, and conditions only narrow what is stated before.
"""

import dataclasses
from collections.abc import Iterable, Mapping
from typing import Any, Literal

from gaitsweep import extensions
from gaitsweep.pipeline import dispatch
from gaitsweep.pipeline.study import fields
from gaitsweep.pipeline.study.fields import Field
from gaitsweep.pipeline.study.location import Location
from gaitsweep.pipeline.study.values import Number, Schema, Slope, one_of, table
from gaitsweep.tasks.contract.registry import (
    CLAIMS,
    DRIVES,
    FIGURES,
    FITS,
    NEEDED_KINDS,
    OVER_LINES,
    VARIABLES,
    nameable,
)

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
    holds = {
        "walker": {
            "anyOf": [_name(), {**_list(_name(), 1), "uniqueItems": True}, _walker()]
        },
        "at": _at(),
        "axes": table(
            {name: _axis(name) for name in fields.axis_names()}
            | {name: _of_measure(name, "array", "object") for name in nameable()}
        ),
        "want": _table(fields.WANT),
        "limits": _table(fields.LIMITS),
        "options": table(_of_all_kinds()),
        "figures": _beside(),
    }
    known = {name: _described(field) for name, field in fields.STUDY.items()}
    for name, schema in holds.items():
        known[name] |= schema
    conditions = [_of_kind(kind) for kind in fields.OPTIONS]
    conditions.append({"anyOf": [{"required": ["at"]}, _NEEDS_SLOPE]})
    return {**table(known, ["name", "walker"]), "allOf": conditions}


def _beside() -> Schema:
    """What figures show beside the computed gaits."""
    known = {name: _described(field) for name, field in fields.BESIDE.items()}
    known["overlay"] |= _table(fields.OVERLAY, ["file"])
    return table(known)


#: What a study has whose gaits are at slopes.
_NEEDS_SLOPE = {
    "properties": {"axes": {"required": ["slope"]}},
    "required": ["axes"],
}


def _at() -> Schema:
    """A measure, with a value or the values of an axis, and what is varied."""
    own = {name: _described(field) for name, field in fields.AT.items()}
    types = "number", "array", "object"
    return table({**own, **{name: _of_measure(name, *types) for name in nameable()}})


def _of_measure(name: str, *types: str) -> Schema:
    """Values of a measure, in the forms of an axis, which the checker knows."""
    forms = [{"type": form} for form in types]
    return {"description": VARIABLES[name].long_name, "anyOf": forms}


def _of_all_kinds() -> dict[str, Schema]:
    """Options of all kinds of studies: each what any of them lets it hold."""
    known: dict[str, list[Schema]] = {}
    for options in fields.OPTIONS.values():
        for name, field in options.items():
            schemas = known.setdefault(name, [])
            if (schema := _described(field)) not in schemas:
                schemas.append(schema)
    return {name: {"anyOf": schemas} for name, schemas in known.items()}


def _described(field: Field) -> Schema:
    """What a field holds, with its default and its meaning."""
    about: Schema = {"description": field.meaning, **field.value.schema}
    if field.default is not None:
        about["default"] = field.value.written(field.default)
    return about


def _table(known: Mapping[str, Field], needed: Iterable[str] = ()) -> Schema:
    """A table of fields."""
    return table({name: _described(field) for name, field in known.items()}, needed)


def _of_kind(kind: str) -> Schema:
    """What else holds for studies of a kind."""
    options = {name: field.value.schema for name, field in fields.OPTIONS[kind].items()}
    own: dict[str, Any] = {
        "options": table(options),
        "want": {"properties": _not_wanted(kind)},
    }
    if kind != "grid":
        own |= {"accuracy": False, "at": False}
    if kind != "branch":
        not_adaptive = {"properties": {"adaptive": False}}
        own["axes"] = {"properties": dict.fromkeys(("slope", *DRIVES), not_adaptive)}

    is_of_it: Schema = {
        "properties": {"kind": {"const": kind}},
        "required": [] if kind == "grid" else ["kind"],
    }
    return {"if": is_of_it, "then": {"properties": own}}


def _not_wanted(kind: str) -> dict[str, Schema]:
    """What studies of a kind cannot want."""
    found: dict[str, Schema] = {}
    for key, names in _NAMES.items():
        others = [name for name in names if NEEDED_KINDS.get(name, kind) != kind]
        if kind == "design":
            others += [name for name in names if name in OVER_LINES]
        if others:
            found[key] = {"items": {"not": {"enum": others}}}

    return found


def _axis(name: str) -> Schema:
    """An axis: a list, or a range; of what drives also an adaptive one, of detuning one
    that names a walker.
    """
    own = _key(name)
    about = {key: _described(field) for key, field in fields.RANGE.items()}
    about["from"] = own | {"description": about["from"]["description"]}
    spaced = {key: about[key] for key in ("from", "to", "n", "spacing")}
    if name == "detuning":
        spaced["toward"] = about["toward"] | _other()
    # One value is the first.
    one_value = {
        "if": {"properties": {"n": {"minimum": 2}}},
        "then": {"properties": {"to": own}},
    }
    forms = [
        {**_list(own, 1), "uniqueItems": True},
        table(spaced, ["from", "to", "n"]) | one_value,
    ]
    if name in ("slope", *DRIVES):
        adaptive = {"from": own, "to": own, "adaptive": about["adaptive"]}
        forms.append(table(adaptive, ["from", "to", "adaptive"]))

    return {"description": own["description"], "anyOf": forms}


def _key(name: str) -> Schema:
    """The number that a key of a walker, or an axis, holds."""
    about = {"description": (_of_walkers("MEANINGS") | fields.EXTRA_AXES)[name]}
    if name == "slope":
        return about | Slope(may_be_level=True).schema
    if name == "foot_mass_ratio":
        low, high = dispatch.resolve("gaitsweep.tasks.walkers.resolve:FOOT_MASS_RATIOS")
        return about | Number(low, high, without_high=True).schema

    most = _of_walkers("MAX_SIZE")
    return about | _between(*_of_walkers("BOUNDS").get(name, (-most, most)))


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
            **one_of(["SI", "1"]),
            "default": "1",
        },
        "trailing_knee": {
            "description": texts["trailing_knee"],
            **one_of([*_of_walkers("TRAILING_KNEES")]),
            "default": "free",
        },
        "base": {"description": "walker of which this one differs in the keys given"}
        | _name(),
        "tuned": {"description": fields.OPTIONS["grid"]["tuned"].meaning}
        | _list(one_of(numbers)),
        "name": {"description": "what it is called"},
    }
    if leads:
        keys["toward"] = _other()
    needed = [
        f.name
        for f in dataclasses.fields(_of_walkers("Walker"))
        if f.default is f.default_factory is dataclasses.MISSING
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
    return {**table(keys), "anyOf": whole}


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
    named = one_of([*catalogue, *extensions.names("walkers")])
    return {"anyOf": [named, {"type": "string", "pattern": r"\.toml$"}]}


def _of_walkers(name: str) -> Any:
    return dispatch.resolve(f"gaitsweep.tasks.walkers.walker:{name}")


def _between(low: float, high: float) -> Schema:
    """A number within bounds, of which the upper may be infinite."""
    most = {"maximum": high} if high < float("inf") else {}
    return {"type": "number", "minimum": low, **most}


def _list(items: Schema, least: int = 0) -> Schema:
    return {"type": "array", "items": items, "minItems": least}
