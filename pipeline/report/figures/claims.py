"""The numbers of a study's claims beside the printed ones: a strip of ratios with their intervals."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.lines import Line2D

from pipeline.report.figures.style import GAIT_COLOURS, INK, MUTED, PRINTED, canvas, plain, set_heading
from pipeline.report.figures.svg import Marks, Sketch
from pipeline.report.source import Source

#: Colour and marker of each verdict; a square is a proof here as in the ledger.
_MARKS = {
    "proved": (GAIT_COLOURS["long"], "s"),
    "reproduced": (GAIT_COLOURS["long"], "o"),
    "consistent within rounding": (PRINTED, "o"),
    "approximate": (MUTED, "^"),
    "not reproduced": (GAIT_COLOURS["short"], "X"),
    "not checkable": (MUTED, "X"),
}


def claims(source: Source) -> Sketch | None:
    """Plot the verdict on every claim of a study, and the ratio of computed to printed numbers where one is printed."""
    table = source.tables.get("claims")
    if table is None or not len(table) or not {"id", "verdict", "value"} <= set(table.columns):
        return None
    verdicts = table["verdict"].astype(str).str.replace("_", " ")
    table = table.assign(verdict=verdicts).iloc[::-1].reset_index(drop=True)
    printed = table["printed_value"].astype(float) if "printed_value" in table else pd.Series(np.nan, table.index)
    figure = canvas(max(180, 60 + 13 * len(table)))
    # Claims without a printed number have no ratio: they stand in a column of their own.
    beside, axes = figure.subplots(1, 2, sharey=True, width_ratios=[1, 12])
    axes.axvline(1, color=INK, lw=0.8, zorder=1)
    marks, drawn = [], []
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
        marks.append(
            Marks(panel, np.array([ratio]), np.array([float(k)]), str(row["id"]), values, commands=[row["command"]])
        )
        drawn.append(str(row["verdict"]))
    beside.set_yticks(range(len(table)), table["id"].astype(str), fontsize=8)
    beside.set_ylim(-0.8, len(table) - 0.2)
    beside.set_xticks([])
    beside.set_xlim(-1, 1)
    axes.tick_params(axis="y", left=False)
    for each in (beside, axes):
        each.grid(axis="y", visible=False)
    axes.set_xlabel("computed over printed number")
    set_heading(beside, "claim")
    keys = [
        Line2D([], [], ls="", marker=marker, color=ink, ms=6, label=verdict)
        for verdict, (ink, marker) in _MARKS.items()
        if verdict in drawn
    ]
    keys.append(Line2D([], [], ls="", marker="o", color=MUTED, mfc="none", ms=6, label="no number printed (left)"))
    keys.append(Line2D([], [], color=PRINTED, lw=5, alpha=0.3, label="allowed by rounding"))
    figure.legend(handles=keys, loc="outside upper left", ncols=3)
    counts = ", ".join(f"{drawn.count(v)} {v}" for v in _MARKS if v in drawn)
    compared = int(np.isfinite(printed).sum())
    worst = np.nanmax(np.abs(table["value"].astype(float) / printed - 1)) if compared else np.nan
    return Sketch(
        figure,
        "Claims",
        f"Verdicts on the {len(table)} claims of this study: {counts}. "
        + (
            f"Filled: computed over printed number, for the {compared} that have one; they differ by up to "
            f"{plain(100 * worst, 2)} %."
            if compared
            else "None has a printed number."
        ),
        f"Ratio of computed to printed numbers of {len(table)} claims: {counts}.",
        table,
        marks,
    )
