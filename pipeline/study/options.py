"""Check the `[options]` of a study: every one known to its kind, and of the right sort."""

import json
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from gaitsweep.pipeline.study import slopes
from gaitsweep.pipeline.study.location import LARGEST, Location
from gaitsweep.tasks.contract import registry
from gaitsweep.tasks.contract.registry import (
    FOLLOWED,
    GAITS,
    MAX_STEPS,
    OPTIONS,
    SLOPES,
    VIOLATIONS,
)

_MAX = 10**6


def check(
    options: Any, kind: str, axes: tuple[str, ...], place: Location
) -> dict[str, Any]:
    """The options of a study of that kind; `axes` are the keys a study may sweep.

    Raises
    ------
    StudyError
        If one is unknown or invalid.
    """
    if not isinstance(options, Mapping):
        raise place.wrong("must be a table", options)
    known = OPTIONS[kind]
    place.check_names(options, known, "key")
    for name, value in options.items():
        _check(
            value,
            known[name].holds,
            tuple(a for a in axes if a != "slope"),
            place.at(name),
        )
    # An option at its default counts as left out.
    if "violation_limits" in options:
        options = {
            **options,
            "violation_limits": violation_limits(options["violation_limits"], place),
        }
    options = {
        name: value for name, value in options.items() if value != known[name].default
    }
    whole = registry.options(kind, options)
    if kind == "curve" and not whole["from"] < whole["to"]:
        raise place.at("from").wrong(
            f"must be less than `to` = {whole['to']!r}", whole["from"]
        )
    if kind == "design" and whole["ground"] and whole["at_slope"] is None:
        raise place.error(
            "`ground` needs the slope at which the walker walks, `at_slope`"
        )
    return options


def violation_limits(limits: object, place: Location) -> dict[str, float]:
    """Check limits of violations, by name; those at their defaults count as left out.

    Parameters
    ----------
    limits : object
    place : Location
        Of what holds them.

    Raises
    ------
    StudyError
        If they are no mapping, or one is unknown or negative.
    """
    if not isinstance(limits, Mapping):
        raise place.at("violation_limits").wrong(
            "must be a table of limits by the names of violations", limits
        )
    changed = {}
    place.at("violation_limits").check_names(limits, VIOLATIONS, "violation")
    for name, value in limits.items():
        limit = place.at("violation_limits", name).number(value)
        if limit < 0:
            raise place.at("violation_limits", name).wrong("must be at least 0", value)
        if limit != VIOLATIONS[name].limit:
            changed[name] = limit
    return changed


def listing() -> str:
    """The options that each kind of study may set, with their defaults."""
    lines = ["options of a study's kind ([options] in its file) and their defaults:"]
    for kind, known in OPTIONS.items():
        for name, option in known.items():
            lines.append(
                f"  {kind:<8} {name:<17}{json.dumps(option.default):<18} {option.meaning}"
            )
    lines.append("limits of violations and their defaults (`violation_limits`):")
    lines += [
        f"  {v.name:<22}{v.limit:<8g}{v.unit}: {v.reason}" for v in VIOLATIONS.values()
    ]
    return "\n".join(lines)


def schema(what: str, keys: tuple[str, ...]) -> dict[str, Any]:
    """JSON Schema of what an option holds; `keys` are those that an axis may have, but
    for the slope.
    """
    if what in _COUNTS:
        most, least = _COUNTS[what]
        return {"type": "integer", "minimum": least, "maximum": most}
    if what == "limits":
        limits = {
            v.name: {
                "description": f"{v.reason} [{v.unit}]",
                "type": "number",
                "minimum": 0,
                "default": v.limit,
            }
            for v in VIOLATIONS.values()
        }
        return {"type": "object", "properties": limits, "additionalProperties": False}
    names = one_of(_names(what, keys))
    return (
        _HOLDS[what][2] | ({"items": names} if what in ("kinds", "keys") else {})
        if what in _HOLDS
        else names
    )


def one_of(names: Iterable[str]) -> dict[str, Any]:
    """JSON Schema of one of several names."""
    return {"type": "string", "enum": list(names)}


def _names(what: str, keys: tuple[str, ...]) -> tuple[str, ...]:
    """Names of which an option holds one or several."""
    return {"gait": GAITS, "key": keys, "kinds": FOLLOWED, "keys": keys}.get(what, ())


def _check(value: Any, what: str, keys: tuple[str, ...], place: Location) -> None:
    if what in _COUNTS:
        place.count(value, *_COUNTS[what])
    if what in _HOLDS:
        fits, bound, _ = _HOLDS[what]
        if not fits(value, place):
            raise place.wrong(bound, value)
    names = _names(what, keys)
    place.check_names(
        value if what in ("kinds", "keys") else [value] if names else [], names
    )


#: Whole numbers that options hold: the largest and the least.
_COUNTS = {"count": (_MAX, 1), "count or 0": (_MAX, 0), "steps": (MAX_STEPS, 1)}
_NUMBER = {"type": "number", "minimum": -LARGEST, "maximum": LARGEST}
_SLOPE = {"type": "number", "minimum": SLOPES[0], "exclusiveMaximum": SLOPES[1]}
_SHARE = {"type": "number", "minimum": 0, "maximum": 0.5}
#: What else they hold: whether a value fits, what it must be, and the same as JSON
#: Schema. That one is no number says its place.
_HOLDS: dict[str, tuple[Callable[[Any, Location], Any], str, dict[str, Any]]] = {
    "counts": (
        lambda x, _: (
            isinstance(x, list)
            and x
            and all(type(n) is int and 1 <= n <= _MAX for n in x)
        ),
        f"must be a list of whole numbers from 1 to {_MAX:,}",
        {
            "type": "array",
            "minItems": 1,
            "items": {"type": "integer", "minimum": 1, "maximum": _MAX},
        },
    ),
    "number": (lambda x, place: isinstance(place.number(x), float), "", _NUMBER),
    "positive": (
        lambda x, place: place.number(x) > 0,
        "must be above 0",
        {**_NUMBER, "exclusiveMinimum": 0},
    ),
    "slope": (lambda x, place: slopes.is_slope(place.number(x)), slopes.BOUND, _SLOPE),
    "share": (
        lambda x, place: 0 <= place.number(x) <= 0.5,
        "must lie in [0, 0.5]",
        _SHARE,
    ),
    "range": (
        lambda x, place: (
            isinstance(x, list)
            and len(x) == 2
            and place.number(x[0]) < place.number(x[1])
        ),
        "must be two increasing numbers",
        {"type": "array", "minItems": 2, "maxItems": 2, "items": _NUMBER},
    ),
    "kinds": (
        lambda x, _: isinstance(x, list) and x,
        f"must be a list of {', '.join(FOLLOWED)}",
        {"type": "array", "minItems": 1},
    ),
    "keys": (
        lambda x, _: isinstance(x, list),
        "must be a list of keys of a walker",
        {"type": "array"},
    ),
}
