"""Writes the tables of fields and options into studies.md: `python docs/tables.py`.

A table stands below a comment that names it, as `<!-- options of grid -->`.
"""

import json
import re
from collections.abc import Iterator, Mapping
from pathlib import Path

from gaitsweep.pipeline.study import fields
from gaitsweep.pipeline.study.fields import Field

PAGE = Path(__file__).with_name("studies.md")
_PLACE = re.compile(r"(<!-- (\w[\w ]*) -->\n)(?:\|.*\n)*")


def _tables() -> dict[str, Mapping[str, Field]]:
    """Fields of each table, by its name; options of every kind have one of their own."""
    kinds = fields.OPTIONS
    shared = {
        name: field
        for name, field in kinds["grid"].items()
        if all(options.get(name) == field for options in kinds.values())
    }
    own = {
        f"options of {kind}": {k: v for k, v in options.items() if k not in shared}
        for kind, options in kinds.items()
    }
    return {
        "fields of a study": fields.STUDY,
        "fields of at": fields.AT,
        "fields of want": fields.WANT,
        "fields of limits": fields.LIMITS,
        "fields of a range": fields.RANGE,
        "options of every kind": shared,
        **own,
    }


def _lines(table: Mapping[str, Field]) -> Iterator[str]:
    """A table in Markdown."""
    yield "| | holds | default | meaning |"
    yield "|---|---|---|---|"
    for field in table.values():
        default = ""
        if field.default is not None:
            default = f"`{json.dumps(field.value.written(field.default))}`"
        cells = f"`{field.name}`", field.value.words, default, field.meaning
        yield f"| {' | '.join(cells)} |"


def filled(text: str) -> str:
    """A page with its tables as the fields are now."""
    tables = _tables()

    def table(place: re.Match[str]) -> str:
        return place[1] + "".join(f"{line}\n" for line in _lines(tables[place[2]]))

    return _PLACE.sub(table, text)


if __name__ == "__main__":
    PAGE.write_text(filled(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
