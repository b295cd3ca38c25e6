"""`gaitsweep check`: whether the states of a table are gaits."""

import argparse
import json
import math
from collections.abc import Iterator
from typing import Any

import pandas as pd

from gaitsweep.pipeline import paths
from gaitsweep.pipeline.api.check import check
from gaitsweep.pipeline.dispatch import ask
from gaitsweep.pipeline.study.single_point import led

#: Columns of the table that is printed.
_SHOWN = ("verdict", "gait", "steps", "distance", "missed", "spectral_radius")
#: Most rows printed: those that are no gaits first.
_MOST = 40


def run(options: argparse.Namespace) -> int:
    """Print a row per state and the summary; the exit code is 1 if one is no gait."""
    if options.page:
        paths.check_page(options.page, "check")
    walker, keys = led(options.walker, options.set)
    # As a keyword a wrong key might be another argument.
    ask("check_walker", {"walker": walker, "set": keys})
    frame = check(
        options.states,
        walker,
        options.slope,
        convention=options.convention,
        rename=options.map,
        degrees=options.degrees,
        rates=options.rates,
        tolerance=options.tolerance,
        steps=options.steps,
        **keys,
    )
    if options.page:
        _write_page(options, frame)
    if options.json:
        rows = [_plain(row) for row in frame.to_dict("records")]
        print(json.dumps({"summary": frame.attrs["summary"], "rows": rows}))
    else:
        print("\n".join(_lines(frame)))

    return int(not frame["is_gait"].all())


def _plain(row: dict[Any, Any]) -> dict[Any, Any]:
    """A row for machines, in which an absent number is null."""
    plain = {}
    for name, value in row.items():
        is_absent = isinstance(value, float) and not math.isfinite(value)
        plain[name] = None if is_absent else value
    return plain


def _lines(frame: pd.DataFrame) -> Iterator[str]:
    """The summary, then the rows that are no gaits, then the others."""
    yield str(frame.attrs["summary"])
    ordered = frame.sort_values("is_gait", kind="stable")
    if not ordered.index.equals(frame.index):
        yield "Rows that are no gaits come first."
    for number, row in ordered.head(_MOST).iterrows():
        words = [f"row {int(str(number)) + 1}: {row['reason']}"]
        if row["gait"]:
            words.append(
                f"Nearest: {row['gait']}, {row['distance']:.2g} away, relative;"
            )
            words.append("stable." if row["stable"] else "unstable.")

        if math.isfinite(row["missed"]):
            words.append(f"Misses itself by {row['missed']:.2g}.")
        yield " ".join(words)

    if len(frame) > _MOST:
        yield f"{len(frame) - _MOST:,} more rows are in --json."


def _write_page(options: argparse.Namespace, frame: pd.DataFrame) -> None:
    """Write the page."""
    from gaitsweep.pipeline.report import check_page

    title = f"Gaits of {options.walker} in {options.states.name}?"
    text = check_page.page(frame, title)
    paths.publish_page(options.page, "check", text)
