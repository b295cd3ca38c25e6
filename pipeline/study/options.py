"""Check the `[options]` of a study, and list those that there are."""

import json
from collections.abc import Mapping
from typing import Any

from gaitsweep.pipeline.study.fields import OPTIONS, VIOLATION_LIMITS
from gaitsweep.pipeline.study.location import Location
from gaitsweep.tasks.contract.registry import VIOLATIONS


def check(options: object, kind: str, place: Location) -> dict[str, Any]:
    """The options of a study of that kind; one at its default counts as left out.

    Raises
    ------
    StudyError
        If one is unknown or invalid.
    """
    if not isinstance(options, Mapping):
        raise place.wrong("must be a table", options)

    fields = OPTIONS[kind]
    place.check_names(options, fields, "key")

    chosen = {}
    for name, value in options.items():
        checked = fields[name].value.read(value, place.at(name))
        # Numbers stay as they are written, as the keys of results hold them.
        chosen[name] = checked if fields[name].value is VIOLATION_LIMITS else value

    return {
        name: value for name, value in chosen.items() if value != fields[name].default
    }


def listing() -> str:
    """The options that each kind of study may set, with their defaults."""
    lines = ["options of a study's kind ([options] in its file) and their defaults:"]
    for kind, fields in OPTIONS.items():
        for name, field in fields.items():
            default = json.dumps(field.value.written(field.default))
            lines.append(f"  {kind:<8} {name:<17}{default:<18} {field.meaning}")

    lines.append("limits of violations and their defaults (`violation_limits`):")
    for v in VIOLATIONS.values():
        lines.append(f"  {v.name:<22}{v.limit:<8g}{v.unit}: {v.reason}")
    return "\n".join(lines)
