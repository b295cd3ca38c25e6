"""What the studies of the paper show, which `paper.toml` holds: titles, sections,
findings, and what no page shows.
"""

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from gaitsweep.pipeline.report.source import Source
from gaitsweep.pipeline.report.words import as_printed, fill, spaced, typeset

PAPER = tomllib.loads(
    (Path(__file__).parent / "paper.toml").read_text(encoding="utf-8")
)

#: Places of the paper's studies in the index.
PLACES = {name: k for k, name in enumerate(PAPER)}


def words(source: Source) -> Mapping[str, Any]:
    """Words of a study of the paper; empty for another, even if it has the name of one."""
    known = PAPER.get(source.name, {})
    return (
        known
        if known.get("walkers") == source.study.get("walker") and "section" in known
        else {}
    )


def finding(study: str, figure: str, claims: Mapping[str, Mapping[str, Any]]) -> str:
    """What a figure of the paper shows, with the numbers of claims; empty where the
    ledger lacks one of them.
    """
    told = PAPER.get(study, {}).get(figure, {})
    if any(
        spaced(claims.get(name, {}).get("verdict")) != verdict
        for name, verdict in told.get("if", {}).items()
    ):
        return ""

    try:
        return fill(
            told.get("finding", ""),
            {k: v for row in claims.values() for k, v in _numbers(row).items()},
        )
    except KeyError:
        return ""


def claim(row: Mapping[str, Any]) -> str:
    """A claim that does not hold, or nearly, in a few words: those of `paper.toml`,
    else its own.
    """
    try:
        return fill(
            PAPER["claims"][row["id"]], {k: v for k, v in row.items() if v is not None}
        )
    except KeyError:
        return typeset(str(row.get("printed", "")))


def _numbers(row: Mapping[str, Any]) -> dict[str, Any]:
    """The numbers of a claim, by its id and what they are."""
    name, printed = row["id"], row.get("printed_value")
    found = {
        name: row.get("value"),
        f"{name}_low": row.get("interval_low"),
        f"{name}_high": row.get("interval_high"),
    }
    if isinstance(printed, float):
        found[f"{name}_printed"] = as_printed(
            printed, row.get("printed_half_unit") or 0.0
        )

    return {k: v for k, v in found.items() if v is not None}
