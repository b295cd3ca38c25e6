"""Tables of results that neither figures nor the ledger show: cascades, censuses, curves, the paper's figures 9, 10."""

from __future__ import annotations

import re

import pandas as pd

from pipeline.report.cells import Cell, cell
from pipeline.report.html_tables import MAX_ROWS, Table, from_frame, head
from pipeline.report.source import Source

#: Tables and their captions, in the order of a page.
CAPTIONS = {
    "figure9": "The tuned walkers (the paper's figure 9)",
    "figure10_cells": "Figure 10, cell by cell: as printed, as computed, and the verdict",
    "figure10": "Exponents of the tuned walkers' gaits",
    "cascade": "Folds and flips of each family of periodic gaits",
    "accumulation": "Accumulation points of the period doublings",
    "census": "Gaits found",
    "coverage": "Coverage of the search",
    "areas": "Outcomes of the initial conditions",
    "turnings": "Turning points of the curves of special points",
    "lyapunov": "Lyapunov exponents",
    "survival": "Survival times",
    "lost": "Loss of the attractor",
    "falls": "Falls",
    "offsets": "Smallest slope against offset from exact tuning",
    "rounding": "Effect of the rounding of each printed parameter on each landmark",
}

#: Tables shown by figures, by the ledger or by tables of their own, or too long for a page.
_ELSEWHERE = (
    "claims",
    "landmarks",
    "crises",
    "figure10_cells",
    "fixed_points",
    "stable_manifold",
    "overlay",
    "branches",
    "special_points",
    "trace",
    "orbits",
    "basin",
    "curves",
    "failed_tasks",
)

_EXPONENTS = "{1} step, p of {0}: γ {2}"
_FIGURE10 = {
    "zero_slope_capable": "walks at vanishing slopes",
    **{
        f"{gait}_{of}_{when}": _EXPONENTS.format(law, gait, near)
        for gait in ("short", "long")
        for of, law in (("angle", "θ* ∝ γᵖ"), ("power", "P ∝ vᵖ"))
        for when, near in (("vanishing", "vanishing"), ("small", "small"), ("larger", "larger"))
    },
    "faster_vanishing": "faster step: γ vanishing",
    "faster_larger": "faster step: γ larger",
    "crossing_slope": "γ at which both are equally fast (rad)",
}


def tables(source: Source) -> list[Table]:
    """Make every table of results in the archive that is not shown elsewhere on its page."""
    rest = [n for n in source.tables if n not in CAPTIONS and n not in _ELSEWHERE and not n.startswith("fits/")]
    return [
        _table(name, source)
        for name in (*CAPTIONS, *sorted(rest))
        if name in source.tables and len(source.tables[name])
    ]


def _table(name: str, source: Source) -> Table:
    frame = source.tables[name]
    caption = CAPTIONS.get(name, name.replace("_", " ").replace("/", ": "))
    if name in ("figure9", "figure10") and "walker" in frame:
        return _transposed(caption, frame, {key for table in source.walkers.values() for key in table})
    if name == "figure10_cells":
        return _printed_cells(caption, frame)
    # States and bounds of a design's gaits are in the archive and the CSV file.
    begins, ends = ("stance_", "thigh_rate", "shank_rate", "surveyed"), "_error"
    aside = [c for c in frame if name == "design" and (str(c).startswith(begins) or str(c).endswith(ends))]
    shown = frame.head(MAX_ROWS).drop(columns=aside)
    note = f"{len(frame) - len(shown)} more rows are in the archive." if len(shown) < len(frame) else ""
    return from_frame(caption, shown, note, name.replace("/", "-"), frame)


def _transposed(caption: str, frame: pd.DataFrame, keys: set[str]) -> Table:
    """A table with one column per walker and one row per quantity, as the paper prints it."""
    columns = [c for c in frame.columns if c not in ("walker", "description")]
    rows = []
    for column in columns:
        flag = set(frame[column]) <= {0, 1} and frame[column].dtype.kind in "iu"
        # The residual of a condition that is met exactly is rounding.
        met = column.endswith("_offset")
        values = [cell(bool(v)) if flag else cell(0.0 if met and abs(v) < 1e-15 else v) for v in frame[column]]
        rows.append([cell(column if column in keys else _FIGURE10.get(column, head(column))), *values])
    return Table(
        caption,
        ["", *map(str, frame["walker"])],
        rows,
        "",
        ["", *(frame["description"] if "description" in frame else [""] * len(frame))],
    )


_VERDICTS = {"reproduced": "●", "approximate": "○", "not reproduced": "✕"}


def _printed_cells(caption: str, frame: pd.DataFrame) -> Table:
    """The paper's figure 10: a row per walker, in each cell what is printed and computed, by range of slopes."""
    columns = list(dict.fromkeys(frame["column"]))
    rows = []
    for walker, cells in frame.groupby("walker", sort=False):
        row = [cell(str(walker))]
        for column in columns:
            lines = []
            for entry in cells[cells["column"] == column].itertuples():
                sign = _VERDICTS.get(str(entry.verdict), "–")
                where = f"γ {entry.slopes}: " if entry.slopes else ""
                computed = re.sub(r"\^(\d+\.\d+)", r"ᵖ, p = \1", str(entry.computed))
                lines.append(f"{sign} {where}{entry.printed}\n    computed {computed}")
            row.append(Cell("\n".join(lines)))
        rows.append(row)
    return Table(caption, ["walker", *columns], rows, "● reproduced, ○ approximate, ✕ not reproduced, – not checked.")
