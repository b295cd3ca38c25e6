"""`gaitsweep reference`: the reference gaits in the variables of a convention."""

import argparse
import csv
import json
import sys
from pathlib import Path
from typing import Any

from gaitsweep.pipeline.dispatch import ask
from gaitsweep.pipeline.study.location import Location

REFERENCE = Path(__file__).parents[2] / "data" / "reference" / "gaits.json"
#: Columns before those of the convention.
_FIRST = ("name", "walker", "gait", "slope")


def run(options: argparse.Namespace) -> int:
    """Print the gaits as CSV, or as JSON."""
    rows, left_out = gaits(options.convention, options.walker)
    if left_out:
        names = ", ".join(left_out)
        print(
            f"Gaits of {names} are left out: `{options.convention}` has no knees.",
            file=sys.stderr,
        )

    if options.json:
        print(json.dumps(rows))
    elif not rows:
        asked = {"walker": options.walker, "convention": options.convention}
        given = [f"`{name}` {value!r}" for name, value in asked.items() if value]
        words = "gaitsweep: There are no reference gaits of"
        print(f"{words} {' and '.join(given)}.", file=sys.stderr)
        return 1
    else:
        table = csv.DictWriter(sys.stdout, list(rows[0]), lineterminator="\n")
        table.writeheader()
        table.writerows(rows)

    return 0


def gaits(
    convention: str, walker: str | None = None
) -> tuple[list[dict[str, str]], list[str]]:
    """The reference gaits of all walkers, or of one, in a convention's variables.

    Returns
    -------
    rows : list of dict of str
        `name`, `walker`, `gait` and `slope` [rad], the columns of the convention, and
        `period`, each number in all its digits.
    left_out : list of str
        Walkers with knees, for which the convention has no variables.

    Raises
    ------
    StudyError
        If there is no such convention or walker.
    """
    known = ask("convention", {"convention": convention})["names"]
    Location("", "convention").check_names([convention], known, "convention")
    reference = json.loads(REFERENCE.read_text(encoding="utf-8"))
    names = list(reference["walkers"])
    if walker is not None:
        chosen = Path(walker).name.removesuffix(".toml")
        Location("", "walker").check_names([chosen], names, "walker")
        names = [chosen]

    rows: list[dict[str, str]] = []
    left_out = []
    for name in names:
        table = _table(reference["walkers"][name])
        if table["knees"] and convention != "gaitsweep":
            left_out.append(name)
            continue

        entries = [
            entry
            for entry in reference["entries"]
            if entry["walker"] == name and entry["kind"] == "gait"
        ]
        asked = {"convention": convention, "walker": table, "gaits": entries}
        for entry, written in zip(entries, ask("written_in", asked), strict=True):
            rows.append({column: entry[column] for column in _FIRST} | written)

    return rows, left_out


def _table(keys: dict[str, str]) -> dict[str, Any]:
    """A walker's table, of the decimals in which the reference has it."""
    table: dict[str, Any] = {key: float(keys[key]) for key in keys if key != "knees"}
    return table | {"knees": keys["knees"] == "true"}
