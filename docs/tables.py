"""Writes the tables of fields and options into studies.md, and of gaits into
conventions.md: `python docs/tables.py`.

A table stands below a comment that names it, as `<!-- options of grid -->` or `<!-- D in
garcia -->`. That of `<!-- figures -->` is written by hand but for its last column, a
small picture of each figure that a row names (pictures.py).
"""

import argparse
import json
import re
from collections.abc import Iterator, Mapping
from pathlib import Path

from gaitsweep.pipeline.cli import reference
from gaitsweep.pipeline.study import fields
from gaitsweep.pipeline.study.fields import Field

PAGES = [Path(__file__).with_name(name) for name in ("studies.md", "conventions.md")]
_PLACE = re.compile(r"(<!-- (\w[\w -]*) -->\n)(?:\|.*\n)*")
#: A table of a walker's gaits in a convention.
_OF_GAITS = re.compile(r"([\w-]+) in (\w+)")


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
        "fields of figures": fields.BESIDE,
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


def _gaits(walker: str, convention: str) -> Iterator[str]:
    """A table of a walker's reference gaits."""
    rows, _ = reference.gaits(convention, walker)
    names = [name for name in rows[0] if name not in ("name", "walker")]
    yield f"| {' | '.join(f'`{name}`' for name in names)} |"
    yield "|---" * len(names) + "|"
    for row in rows:
        yield f"| {' | '.join(row[name] for name in names)} |"


def _with_pictures(rows: list[str]) -> Iterator[str]:
    """Rows of a table with small pictures of the figures that each names."""
    for row in rows:
        *cells, last = (cell.strip() for cell in row.split("|")[1:-1])
        figures = re.findall(r"`(\w+)`", cells[0])
        if figures:
            last = " ".join(f"![{name}](figures/{name}.svg)" for name in figures)
        yield f"| {' | '.join([*cells, last])} |"


def filled(text: str) -> str:
    """A page with its tables as the fields and the gaits are now."""
    tables = _tables()

    def table(place: re.Match[str]) -> str:
        if place[2] == "figures":
            lines = _with_pictures(place[0].splitlines()[1:])
            return place[1] + "".join(f"{line}\n" for line in lines)

        of_gaits = _OF_GAITS.fullmatch(place[2])
        lines = _gaits(*of_gaits.groups()) if of_gaits else _lines(tables[place[2]])
        return place[1] + "".join(f"{line}\n" for line in lines)

    return _PLACE.sub(table, text)


if __name__ == "__main__":
    argparse.ArgumentParser(description=__doc__).parse_args()
    for page in PAGES:
        page.write_text(filled(page.read_text(encoding="utf-8")), encoding="utf-8")
