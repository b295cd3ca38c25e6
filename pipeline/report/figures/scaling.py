"""The slope at which the short step changes its scaling, against the mass of the feet (the paper's 3/2 law)."""

from __future__ import annotations

import numpy as np
import pandas as pd

from pipeline.report.figures.style import DASHES, GAIT_COLOURS, INK, MUTED, canvas, log_axis, plain, set_heading
from pipeline.report.figures.svg import Marks, Sketch
from pipeline.report.source import Source

_MARKERS = "osD^v"


def transition_ladder(source: Source) -> Sketch | None:
    """Plot the transition slope against the foot mass ratio, with the law ρ^(3/2) and the local exponent."""
    table = source.tables.get("fits/transition")
    if table is None or not {"foot_mass_ratio", "slope_transition"} <= set(table.columns):
        return None
    table = table.sort_values("foot_mass_ratio").reset_index(drop=True)
    table = table[table["foot_mass_ratio"] > 0]
    slopes = [c for c in table.columns if c.startswith("slope_transition") and not c.endswith(("_low", "_high"))]
    exponents = [c for c in table.columns if c.startswith("local_exponent") and not c.endswith(("_low", "_high"))]
    if not np.isfinite(table["slope_transition"]).any():
        return None
    figure = canvas(380 if exponents else 260)
    panels = figure.subplots(2, 1, sharex=True, height_ratios=[5, 3]) if exponents else [figure.add_subplot()]
    ratio = table["foot_mass_ratio"].to_numpy()
    top = panels[0]
    log_axis(top, "x")
    log_axis(top, "y")
    anchor = table[np.isfinite(table["slope_transition"])].iloc[0]
    law = anchor["slope_transition"] * (ratio / anchor["foot_mass_ratio"]) ** 1.5
    top.plot(ratio, law, color=INK, lw=1, ls=(0, (1, 2)), label="∝ ρ^(3/2)".replace("^(3/2)", "³ᐟ²"))
    marks = []
    for k, column in enumerate(slopes):
        colour = [GAIT_COLOURS["short"], MUTED, GAIT_COLOURS["other1"]][k % 3]
        top.plot(
            ratio,
            table[column],
            color=colour,
            lw=1,
            ls=DASHES[k % len(DASHES)],
            marker=_MARKERS[k % 5],
            ms=4.5,
            label=_column_title(column, "slope_transition", "crossing of asymptotes"),
        )
        marks.append(
            Marks(
                top,
                ratio,
                table[column].to_numpy(),
                _column_title(column, "slope_transition", "crossing of asymptotes"),
                {"ρ": ratio, "γ at the transition (rad)": table[column].to_numpy()},
            )
        )
    if "asymptotic" in table:
        top.plot(ratio, table["asymptotic"], color=MUTED, lw=0.9, label="asymptotic formula")
    set_heading(top, "slope at the transition (rad)")
    top.legend(loc="upper left")
    if exponents:
        below = panels[1]
        below.axhline(1.5, color=INK, lw=1, ls=(0, (1, 2)))
        for k, column in enumerate(exponents):
            colour = [GAIT_COLOURS["short"], MUTED, GAIT_COLOURS["other1"]][k % 3]
            below.plot(
                ratio, table[column], color=colour, lw=1, ls=DASHES[k % len(DASHES)], marker=_MARKERS[k % 5], ms=4.5
            )
            marks.append(
                Marks(
                    below,
                    ratio,
                    table[column].to_numpy(),
                    _column_title(column, "local_exponent", "local exponent"),
                    {"ρ": ratio, "local exponent": table[column].to_numpy()},
                )
            )
        set_heading(below, "local exponent d ln γ / d ln ρ")
    panels[-1].set_xlabel("foot mass over total mass ρ")
    first = table["local_exponent"].dropna() if "local_exponent" in table else pd.Series(dtype=float)
    words = f" The local exponent is {plain(first.iloc[0])} at the lightest feet." if len(first) else ""
    return Sketch(
        figure,
        "The scaling transition of the short step",
        "Slope at which the two power laws of the short step cross, against foot mass ratio. Dotted: the asymptotic "
        "3/2 law of section 6.3, drawn through the lightest feet; the local exponent approaches it.",
        f"Transition slope against foot mass ratio from {plain(ratio.min())} to {plain(ratio.max())} on "
        f"logarithmic axes, with a line of power 3/2.{words}",
        table,
        marks,
    )


def _column_title(column: str, stem: str, words: str) -> str:
    """A column's name in words: those of its stem, and the rest of the name."""
    rest = column.removeprefix(stem).strip("_").replace("_", " ")
    return f"{words.partition(' of ')[0]}, {rest}" if rest else words
