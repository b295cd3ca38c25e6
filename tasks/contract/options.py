"""Options of each kind of study, which `options.toml` lists: what each holds, its
default and its meaning.

Like the registry, this module imports no solver.
"""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

#: Longest period of gaits, in steps.
MAX_STEPS = 64


@dataclass(frozen=True)
class Option:
    """One option of a kind of study: what it holds, its default, and its meaning.

    `holds` names a kind of value of `pipeline/study/fields.py`, which has its bounds.
    """

    holds: str
    default: Any
    meaning: str


_TABLES = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
_EVERY = _TABLES.pop("every")
#: Options of each kind of study; the parser, `gaitsweep plan --help`, the tasks and the
#: docs read them here.
OPTIONS = {
    kind: {
        name: Option(
            about["holds"],
            about.get("default"),
            about["meaning"].format(MAX_STEPS=MAX_STEPS),
        )
        for name, about in (table | _EVERY).items()
    }
    for kind, table in _TABLES.items()
}


def options(kind: str, given: Mapping[str, Any]) -> dict[str, Any]:
    """Options of a kind of study: those given, and the defaults of the others."""
    return {
        name: given.get(name, option.default) for name, option in OPTIONS[kind].items()
    }
