"""The numbers of a study's claims beside the printed ones: a strip of ratios with their intervals."""

import numpy as np
import pandas as pd

from gaitsweep.pipeline.report.figures.sketch import Sketch
from gaitsweep.pipeline.report.figures.style import INK, MUTED, PRINTED, VARIABLES, set_heading
from gaitsweep.pipeline.report.source import Source
from gaitsweep.pipeline.report.words import WORDS, spaced

#: Colour and marker of each verdict; a square is a proof here as in the ledger.
_INKS = {name: ink for ink, name in VARIABLES.items()}
_MARKS = {verdict: (_INKS[style["ink"]], style["marker"]) for verdict, style in WORDS["verdicts"].items()}


def claims(source: Source) -> Sketch | None:
    """Plot the verdict on every claim of a study, and the ratio of computed to printed numbers where one is printed."""
    table = source.table("claims", "id", "verdict", "value")
    if table is None:
        return None
    table = table.assign(verdict=table["verdict"].map(spaced)).iloc[::-1].reset_index(drop=True)
    printed = table["printed_value"].astype(float) if "printed_value" in table else pd.Series(np.nan, table.index)
    # Claims without a printed number have no ratio: they stand in a column of their own.
    sketch = Sketch(max(180, 60 + 13 * len(table)), 1, 2, sharey=True, width_ratios=[1, 12])
    beside, axes = sketch.panels
    axes.axvline(1, color=INK, lw=0.8, zorder=1)
    for k, row in table.iterrows():
        ink, marker = _MARKS.get(str(row["verdict"]), (MUTED, "s"))
        has_ratio = bool(np.isfinite(printed[k]) and printed[k])
        ratio, panel = (float(row["value"]) / printed[k], axes) if has_ratio else (0.0, beside)
        fill = ink if np.isfinite(printed[k]) else "none"
        if has_ratio and row["interval_low"] <= row["interval_high"]:
            ends = [row["interval_low"] / printed[k], row["interval_high"] / printed[k]]
            axes.plot(ends, [k, k], color=PRINTED, lw=5, alpha=0.3, solid_capstyle="butt")
        panel.plot([ratio], [k], marker, color=ink, mfc=fill, ms=6)
        values = {"claim": [row["printed"]], "computed": [float(row["value"])], "verdict": [row["verdict"]]}
        sketch.mark(panel, [ratio], [k], str(row["id"]), values, commands=[row["command"]])
    beside.set_yticks(range(len(table)), table["id"].astype(str), fontsize=8)
    beside.set_ylim(-0.8, len(table) - 0.2)
    beside.set_xticks([])
    beside.set_xlim(-1, 1)
    axes.tick_params(axis="y", left=False)
    for each in (beside, axes):
        each.grid(axis="y", visible=False)
    axes.set_xlabel("computed over printed number")
    set_heading(beside, "claim")
    drawn = table["verdict"].tolist()
    known = {verdict: mark for verdict, mark in _MARKS.items() if verdict in drawn}
    for verdict, (ink, marker) in known.items():
        sketch.dot_key(verdict, ink, marker, ms=6)
    sketch.dot_key("no number printed (left)", MUTED, mfc="none", ms=6)
    sketch.key("allowed by rounding", PRINTED, lw=5, alpha=0.3)
    compared = int(np.isfinite(printed).sum())
    return sketch.finish(
        table,
        counts=", ".join(f"{drawn.count(verdict)} {verdict}" for verdict in known),
        compared=compared,
        uncompared=not compared,
        worst=100 * (table["value"].astype(float) / printed - 1).abs().max(),
    )
