"""The ledger of claims: rows made of the pages' entries, a small picture of each
number, and the tally of verdicts.
"""

import itertools
import math
from collections.abc import Mapping
from typing import Any

import pandas as pd

from gaitsweep.pipeline.report import paper
from gaitsweep.pipeline.report.cells import Cell, cell
from gaitsweep.pipeline.report.entry import Entry
from gaitsweep.pipeline.report.words import WORDS, plain, spaced, typeset

#: A claim as the ledger shows it: texts, cells of numbers, its picture, and the figures
#: that show it with their links.
Claim = dict[str, Any]


def families(
    entries: list[Entry], places: Mapping[tuple[str, str], list[str]]
) -> dict[str, list[Claim]]:
    """Every claim of some studies by subject, each with links to the figures that show
    it, as `figures` gives them.
    """
    shown: dict[str, list[tuple[str, str]]] = {}
    for entry in entries:
        for figure in entry.figures:
            title = (
                f"{entry.short}: {figure['title']}"
                if len(entry.figures) > 1
                else entry.short
            )
            for id in places[entry.slug, figure["name"]]:
                shown.setdefault(id, []).append(
                    (title, f"{entry.slug}.html#{figure['name']}")
                )

    rows = [
        _claim(row, shown.get(str(row["id"]), []))
        for entry in entries
        for row in entry.claims
    ]
    groups: dict[str, list[Claim]] = {
        subject: [] for subject in (*WORDS["subjects"].values(), "Others")
    }
    for row in sorted(rows, key=lambda row: (row["id"][:1], len(row["id"]), row["id"])):
        groups[WORDS["subjects"].get(row["id"][:1].upper(), "Others")].append(row)
    return {subject: members for subject, members in groups.items() if members}


def figures(entries: list[Entry]) -> dict[tuple[str, str], list[str]]:
    """Claims that each figure shows, by page and name: those that name it, and those
    that it names itself.
    """
    rows = [
        (
            str(row["id"]),
            own
            if "/" in (own := str(row.get("figure", "")))
            else f"{entry.study}/{own}",
        )
        for entry in entries
        for row in entry.claims
    ]
    places = {}
    for entry in entries:
        for figure in entry.figures:
            at = f"{entry.study}/{figure['name']}"
            places[entry.slug, figure["name"]] = [
                id for id, of in rows if of == at or id in figure["claims"]
            ]

    return places


def tally(ledger: Mapping[str, list[Claim]]) -> dict[str, list[Claim]]:
    """Claims by verdict, the best verdict first."""
    groups: dict[str, list[Claim]] = {verdict: [] for verdict in WORDS["verdicts"]}
    for row in itertools.chain(*ledger.values()):
        groups.setdefault(row["verdict"], []).append(row)
    return {verdict: members for verdict, members in groups.items() if members}


def table(ledger: Mapping[str, list[Claim]]) -> pd.DataFrame:
    """The ledger as a table, for the CSV file."""
    rows = [
        {
            "id": row["id"],
            "claim": row["printed"].text,
            "quotation": row["quotation"],
            "place": row["source"],
            "printed": row["number"].value,
            "computed": row["value"].value,
            "interval_low": row["interval"][0].value if row["interval"] else None,
            "interval_high": row["interval"][1].value if row["interval"] else None,
            "verdict": row["verdict"],
            "result": "; ".join(row["computed"]),
            "command": row["command"],
        }
        for row in itertools.chain(*ledger.values())
    ]
    return pd.DataFrame(rows)


def sign(verdict: str) -> str:
    """Sign of a verdict: proved, yes, within, no or open."""
    words = spaced(verdict).strip().lower()
    known = WORDS["verdicts"].get(words)
    return str(known["chip"]) if known else "no" if words.startswith("not ") else "open"


def _claim(row: Mapping[str, Any], shown: list[tuple[str, str]]) -> Claim:
    """A claim of an archive as the ledger shows it."""
    verdict, printed, computed = (
        spaced(row.get("verdict", "")),
        row.get("printed", ""),
        row.get("computed", ""),
    )
    low, high = (_number(row, name) for name in ("interval_low", "interval_high"))
    has_interval = low.value is not None and high.value is not None
    words = (
        [str(computed)]
        if not isinstance(computed, str)
        else [part.strip() for part in computed.split(";")]
    )

    return {
        "id": str(row["id"]),
        **{name: str(row.get(name, "")) for name in ("quotation", "source", "command")},
        "printed": Cell(typeset(printed))
        if isinstance(printed, str)
        else cell(printed),
        "computed": [typeset(part) for part in words if part],
        "value": _number(row, "value" if "value" in row else "computed"),
        "number": _number(row, "printed_value"),
        "interval": [low, high] if has_interval else [],
        "bar": _bar(row),
        "verdict": verdict,
        "sign": sign(verdict),
        "short": paper.claim(row),
        "shown": shown,
    }


def _number(row: Mapping[str, Any], name: str) -> Cell:
    """The cell of a number of a claim, empty where there is none."""
    value = _entry(row, name)
    return cell(value) if math.isfinite(value) else Cell("")


def _bar(row: Mapping[str, Any]) -> dict[str, Any] | None:
    """Picture of a claim's numbers: words, and places in percent of its width; None if
    nothing is printed or varies.

    Numbers from `printed_from` to `printed_to` round to the one `printed`, which may be
    None; the rounding of the printed parameters allows the computed `value` to lie from
    `low` to `high`, which are equal for an exact one.
    """
    value = _entry(row, "value")
    printed = _entry(row, "printed_value")
    low, high = _entry(row, "interval_low"), _entry(row, "interval_high")
    is_printed, varies = math.isfinite(printed), low <= high
    if not math.isfinite(value) or not (is_printed or varies):
        return None

    words = f"computed {plain(value, 6)}"
    numbers = {"value": value, "low": value, "high": value}
    if varies:
        numbers |= {"low": low, "high": high}
        words += f", from {plain(low)} to {plain(high)} by rounding"

    if is_printed:
        half = _entry(row, "printed_half_unit")
        half = half if math.isfinite(half) else 0.0
        numbers["printed"] = printed
        numbers["printed_from"] = printed - half
        numbers["printed_to"] = printed + half
        words = f"printed {plain(printed)}, {words}"

    return {"words": words, "printed": None, **_places(numbers, value)}


def _entry(row: Mapping[str, Any], name: str) -> float:
    """An entry of a claim, NaN where it is no number."""
    value = row.get(name)
    return float(value) if isinstance(value, (int, float)) else math.nan


def _places(numbers: Mapping[str, float], value: float) -> dict[str, float]:
    """Places of numbers in percent of a width that shows all of them, with a margin."""
    least, most = min(numbers.values()), max(numbers.values())
    # At least 2 % of the number, so that equal numbers are not drawn apart.
    span = max(most - least, 0.02 * abs(value)) or 1.0
    middle, width = 0.5 * (least + most), 1.16 * span
    left, right = middle - 0.5 * width, middle + 0.5 * width

    return {
        name: round(100 * (x - left) / (right - left), 2) for name, x in numbers.items()
    }
