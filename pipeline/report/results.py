"""Tables of results that neither figures nor the ledger show: cascades, censuses, curves, the paper's figures 9, 10."""

import re

import pandas as pd

from gaitsweep.pipeline.report.cells import Cell, cell
from gaitsweep.pipeline.report.html_tables import Table, head, named
from gaitsweep.pipeline.report.source import Source
from gaitsweep.pipeline.report.words import WORDS


def tables(source: Source) -> list[Table]:
    """Make every table of results in the archive that is not shown elsewhere on its page."""
    captions, elsewhere = WORDS["tables"], WORDS["elsewhere"]["tables"]
    order = [*captions, *sorted(source.tables.keys() - captions.keys())]
    names = [name for name in order if name not in elsewhere and not name.startswith("fits/")]
    return [_table(name, frame) for name in names if (frame := source.table(name)) is not None]


def _table(name: str, frame: pd.DataFrame) -> Table:
    if name in ("figure9", "figure10") and "walker" in frame:
        return _transposed(name, frame)
    if name == "figure10_cells":
        return _printed_cells(name, frame)
    # States and bounds of a design's gaits are in the archive and the CSV file.
    begins, ends = ("stance_", "thigh_rate", "shank_rate", "surveyed"), "_error"
    aside = [c for c in frame if name == "design" and (str(c).startswith(begins) or str(c).endswith(ends))]
    return named(name, frame.drop(columns=aside), whole=frame)


def _transposed(name: str, frame: pd.DataFrame) -> Table:
    """A table with one column per walker and one row per quantity, as the paper prints it."""
    rows = []
    for column in frame.columns.drop(["walker", "description"], errors="ignore"):
        flag = set(frame[column]) <= {0, 1} and frame[column].dtype.kind in "iu"
        # The residual of a condition that is met exactly is rounding.
        met = column.endswith("_offset")
        values = [cell(bool(v)) if flag else cell(0.0 if met and abs(v) < 1e-15 else v) for v in frame[column]]
        rows.append([cell(head(column)), *values])
    meanings = frame["description"] if "description" in frame else [""] * len(frame)
    return Table(
        WORDS["tables"][name]["caption"],
        ["", *map(str, frame["walker"])],
        rows,
        "",
        ["", *meanings],
        most=1 + len(meanings),
    )


def _printed_cells(name: str, frame: pd.DataFrame) -> Table:
    """The paper's figure 10: a row per walker, in each cell what is printed and computed, by range of slopes."""
    columns = list(dict.fromkeys(frame["column"]))
    rows = []
    for walker, cells in frame.groupby("walker", sort=False):
        row = [cell(str(walker))]
        for column in columns:
            lines = []
            for entry in cells[cells["column"] == column].itertuples():
                sign = WORDS["verdicts"].get(entry.verdict, {}).get("sign", "–")
                where = f"γ {entry.slopes}: " if entry.slopes else ""
                computed = re.sub(r"\^(\d+\.\d+)", r"ᵖ, p = \1", str(entry.computed))
                lines.append(f"{sign} {where}{entry.printed}\n    computed {computed}")
            row.append(Cell("\n".join(lines)))
        rows.append(row)
    words = WORDS["tables"][name]
    return Table(words["caption"], ["walker", *columns], rows, words["note"])
