"""Check the `[options]` of a study: every one known to its kind, and of the right sort."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from typing import Any

from pipeline.study import slopes
from pipeline.study.location import Location
from tasks import registry
from tasks.registry import FOLLOWED, GAITS, MAX_STEPS, OPTIONS, VIOLATIONS

_MAX = 10**6


def check(options: Any, kind: str, axes: tuple[str, ...], place: Location) -> dict[str, Any]:
    """The options of a study of that kind; `axes` are the keys a study may sweep.

    Raises
    ------
    StudyError
        If one is unknown or invalid.
    """
    if not isinstance(options, Mapping):
        raise place.wrong("must be a table", options)
    known = OPTIONS.get(kind, {})
    if options and not known:
        raise place.error(f"A study of kind `{kind}` has no options; got {', '.join(options)}")
    for name, value in options.items():
        if name not in known:
            raise place.unknown(name, known, "key")
        _check(value, known[name].holds, axes, place.at(name))
    # An option at its default counts as left out.
    if "violation_limits" in options:
        options = {**options, "violation_limits": violation_limits(options["violation_limits"], place)}
    options = {name: value for name, value in options.items() if value != known[name].default}
    whole = registry.options(kind, options) if known else {}
    if kind == "curve" and not whole["from"] < whole["to"]:
        raise place.at("from").wrong(f"must be less than `to` = {whole['to']!r}", whole["from"])
    if kind == "design" and whole["ground"] and whole["at_slope"] is None:
        raise place.error("`ground` needs the slope at which the walker walks, `at_slope`")
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
        raise place.at("violation_limits").wrong("must be a table of limits by the names of violations", limits)
    changed = {}
    for name, value in limits.items():
        if name not in VIOLATIONS:
            raise place.at("violation_limits").unknown(str(name), VIOLATIONS, "violation")
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
        lines += [
            f"  {kind:<8} {name:<17}{json.dumps(option.default):<18} {option.meaning}" for name, option in known.items()
        ]
    lines.append("limits of violations and their defaults (`violation_limits`):")
    lines += [f"  {v.name:<22}{v.limit:<8g}{v.unit}: {v.reason}" for v in VIOLATIONS.values()]
    return "\n".join(lines)


def _check(value: Any, what: str, axes: tuple[str, ...], place: Location) -> None:
    if what == "count or 0" and not (_count(value) or value == 0):
        raise place.wrong(f"must be a whole number from 0 to {_MAX:,}", value)
    if what == "count" and not _count(value):
        raise place.wrong(f"must be a whole number from 1 to {_MAX:,}", value)
    if what == "steps" and not (_count(value) and value <= MAX_STEPS):
        raise place.wrong(f"must be a whole number from 1 to {MAX_STEPS}", value)
    if what == "counts" and not (isinstance(value, list) and value and all(map(_count, value))):
        raise place.wrong(f"must be a list of whole numbers from 1 to {_MAX:,}", value)
    if what in _NUMBERS:
        fits, bound = _NUMBERS[what]
        if not fits(place.number(value)):
            raise place.wrong(bound, value)
    if what == "range" and not (_pair(value) and place.number(value[0]) < place.number(value[1])):
        raise place.wrong("must be two increasing numbers", value)
    keys = tuple(a for a in axes if a != "slope")
    names = {"gait": GAITS, "key": keys, "kinds": FOLLOWED, "keys": keys}.get(what, ())
    if what == "kinds" and (not isinstance(value, list) or not value):
        raise place.wrong(f"must be a list of {', '.join(FOLLOWED)}", value)
    if what == "keys" and not isinstance(value, list):
        raise place.wrong("must be a list of keys of a walker", value)
    for name in value if what in ("kinds", "keys") else [value] if names else []:
        if name not in names:
            raise place.unknown(str(name), names)


#: Numbers that options hold: whether one fits, and what it must be.
_NUMBERS: dict[str, tuple[Callable[[float], bool], str]] = {
    "number": (lambda x: True, ""),
    "positive": (lambda x: x > 0, "must be above 0"),
    "slope": (slopes.is_slope, slopes.BOUND),
    "share": (lambda x: 0 <= x <= 0.5, "must lie in [0, 0.5]"),
}


def _pair(value: Any) -> bool:
    return isinstance(value, list) and len(value) == 2


def _count(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 1 <= value <= _MAX
