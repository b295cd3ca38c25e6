"""The fields of a study: name, what each holds, default and meaning.

What checks studies, their JSON Schema and the tables of docs/studies.md are all made of
these; what fields must be together is in `rules`.
"""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gaitsweep import extensions
from gaitsweep.pipeline import dispatch
from gaitsweep.pipeline.study.location import Location
from gaitsweep.pipeline.study.model import Limits
from gaitsweep.pipeline.study.values import (
    Composite,
    Either,
    Flag,
    KeyRanges,
    Memory,
    Names,
    Number,
    Numbers,
    OneOf,
    Range,
    Slope,
    Table,
    Text,
    Tolerance,
    Value,
    ViolationLimits,
    Whole,
    Wholes,
)
from gaitsweep.tasks.contract import accuracy as accuracies
from gaitsweep.tasks.contract import registry
from gaitsweep.tasks.contract.registry import (
    FOLLOWED,
    GAITS,
    MAX_STEPS,
    OF_TARGETS,
    SENSITIVITIES,
    VARIABLES,
    VIOLATIONS,
    nameable,
)

#: Largest axis; anything above is taken for a mistake.
MAX_VALUES = 10_000_000
_MAX_COUNT = 10**6
_MAX_NAME = 100  # letters


@dataclass(frozen=True)
class Field:
    """One field of a study."""

    name: str
    value: Value
    default: Any
    meaning: str


class Accuracy(Number):
    """An error bound: 1 or 3 times a power of ten."""

    def __init__(self) -> None:
        super().__init__(*accuracies.ACCURACIES)

    def read(self, value: object, place: Location) -> float:
        """The largest accuracy that is not above a number."""
        number = place.number(value)
        super().read(number, place)
        steps = [
            float(f"{digit}e{power}") for power in range(-16, -1) for digit in (1, 3)
        ]
        return max(step for step in steps if step <= number)


def groups() -> list[str]:
    """Names of the groups of variables."""
    own = {v.group for v in VARIABLES.values()} - {"", OF_TARGETS}
    return sorted({*own, SENSITIVITIES})


def axis_names() -> tuple[str, ...]:
    """Names that an axis may have."""
    keys = dispatch.resolve("gaitsweep.tasks.walkers.walker:NUMBERS")
    one_link = dispatch.resolve("gaitsweep.tasks.walkers.walker:ONE_LINK")
    return (*EXTRA_AXES, *keys, *one_link)


def _keys_of_walkers() -> tuple[str, ...]:
    """Names of axes but for the slope."""
    return tuple(name for name in axis_names() if name != "slope")


def _differentiated() -> tuple[str, ...]:
    """Names of what gaits are differentiated by: the slope, and keys."""
    names = dispatch.resolve("gaitsweep.tasks.walkers.walker:DIFFERENTIATED")
    return tuple(names)


def _objectives() -> tuple[str, ...]:
    """Names of what may be least or largest: variables, the slope and keys."""
    return (*nameable(), *axis_names())


#: Limits above which violations are flagged.
VIOLATION_LIMITS = ViolationLimits()
_COUNT = Whole(_MAX_COUNT)
_NAME = Text(
    rf"[A-Za-z0-9][A-Za-z0-9._-]{{0,{_MAX_NAME - 1}}}",
    f"up to {_MAX_NAME} letters, digits, dots, dashes or underscores, the first a letter or digit",
)
#: What the tables of fields and of options say that a field holds.
_VALUES: dict[str, Value] = {
    "name": _NAME,
    "kind": OneOf(lambda: registry.OPTIONS),
    "accuracy": Accuracy(),
    "gaits": Names(lambda: GAITS, least=1),
    "variables": Names(
        lambda: (*registry.nameable(), *groups()),
        least=1,
        others=lambda: extensions.names("measures"),
    ),
    "fits": Names(lambda: registry.FITS),
    "figures": Names(
        lambda: registry.FIGURES, others=lambda: extensions.names("figures")
    ),
    "claims": Names(lambda: registry.CLAIMS),
    "seconds": Number(0, 1e6, without_low=True, unit=" s"),
    "memory": Memory(1 << 26, 1 << 50),
    "n": Whole(MAX_VALUES),
    "spacing": Either(lambda: ("linear", "log")),
    "tolerance": Number(1e-6, 0.1),
    "tolerances": Table(_differentiated, Tolerance(), ("tolerances", "key")),
    "file": Text(r"[^/].*", "a path relative to the study"),
    "number": Number(),
    "positive": Number(0, without_low=True),
    "share": Number(0, 0.5),
    "slope": Slope(),
    "count": _COUNT,
    "count or 0": Whole(_MAX_COUNT, 0),
    "steps": Whole(MAX_STEPS),
    "counts": Wholes(_COUNT),
    "range": Range(),
    "gait": OneOf(lambda: GAITS),
    "key": OneOf(_keys_of_walkers, "a key of a walker"),
    "keys": Names(_keys_of_walkers, "keys of a walker"),
    "kinds": Names(lambda: FOLLOWED, ", ".join(FOLLOWED)),
    "levels": Table(nameable, Number(), ("values", "variable")),
    "flag": Flag(),
    "objective": OneOf(_objectives, "a variable, `slope` or a free key"),
    "ranges of keys": Table(_keys_of_walkers, Range(), ("ranges", "key")),
    "ranges": Table(nameable, Range(or_equal=True), ("ranges", "variable")),
    "values": Table(nameable, Numbers(), ("values", "variable")),
    "violations": Names(lambda: (*VIOLATIONS, "all"), "names of violations, or `all`"),
    "plane": KeyRanges(_keys_of_walkers),
    "limits": VIOLATION_LIMITS,
    "varied": OneOf(axis_names, "`slope`, or a key of a walker"),
    "target": Composite("table of a measure and what is varied"),
    "walker": Composite("name, file, table, or list of names"),
    "axes": Composite("table of axes"),
    "table": Composite("table"),
    "other walker": Composite("name, file or table"),
}

_TABLES = tomllib.loads(
    Path(__file__).with_name("keys.toml").read_text(encoding="utf-8")
)
#: Axes that are not keys of a walker, and what each is.
EXTRA_AXES: dict[str, str] = _TABLES["axes"]


def _fields(table: str, defaults: Mapping[str, Any] | None = None) -> dict[str, Field]:
    """Fields of a table, by name; `defaults` are those that stand elsewhere."""
    found = {}
    for name, about in _TABLES[table].items():
        default = about.get("default", (defaults or {}).get(name))
        found[name] = Field(name, _VALUES[about["holds"]], default, about["meaning"])
    return found


def value_of(
    fields: Mapping[str, Field], name: str, table: Mapping[str, Any], place: Location
) -> Any:
    """Value of a field of a table, read; its default, unread, where it is left out.

    Raises
    ------
    StudyError
        If it is invalid.
    """
    field = fields[name]
    if name not in table:
        return field.default
    return field.value.read(table[name], place.at(name))


#: Fields of a study, of its tables, of axes that are no lists, and of measurements.
STUDY, WANT, RANGE, OVERLAY = map(_fields, ("study", "want", "range", "overlay"))
#: Fields of `at`, besides the measure, and of what figures show beside gaits.
AT, BESIDE = _fields("at"), _fields("figures")
LIMITS = _fields("limits", vars(Limits()))
#: Options of each kind of study.
OPTIONS: dict[str, dict[str, Field]] = {
    kind: {
        name: Field(name, _VALUES[option.holds], option.default, option.meaning)
        for name, option in options.items()
    }
    for kind, options in registry.OPTIONS.items()
}
