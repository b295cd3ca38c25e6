"""The slope at which the short step changes its scaling, against the mass of the feet (the paper's 3/2 law)."""

from typing import Any

import numpy as np
import pandas as pd

from gaitsweep.pipeline.report.figures.sketch import Sketch
from gaitsweep.pipeline.report.figures.style import (
    DOTTED,
    INK,
    LINE,
    MARKERS,
    MUTED,
    PRINTED,
    set_heading,
    set_log,
)
from gaitsweep.pipeline.report.source import Source
from gaitsweep.pipeline.report.words import plain, spaced

#: Quantities of the two panels, as the names of their columns begin: their names in a legend and under the pointer.
_TITLES = {
    "slope_transition": ("crossing of asymptotes", "γ at the transition (rad)"),
    "local_exponent": ("local exponent", "local exponent"),
}
_INKS = (LINE, MUTED, PRINTED)


def transition_ladder(source: Source) -> Sketch | None:
    """Plot the transition slope against the foot mass ratio, with the law ρ^(3/2) and the local exponent."""
    table = source.table("fits/transition", "foot_mass_ratio", "slope_transition")
    if table is None:
        return None
    table = table.sort_values("foot_mass_ratio").reset_index(drop=True)
    table = table[table["foot_mass_ratio"] > 0]
    if not np.isfinite(table["slope_transition"]).any():
        return None
    has_exponents = any(c.startswith("local_exponent") and not c.endswith(("_low", "_high")) for c in table.columns)
    shape: Any = {"rows": 2, "sharex": True, "height_ratios": [5, 3]} if has_exponents else {}
    sketch = Sketch(380 if has_exponents else 260, **shape)
    top, below = sketch.panels[0], sketch.panels[-1]
    ratio = table["foot_mass_ratio"].to_numpy()
    set_log(top, "xy")
    anchor = table[np.isfinite(table["slope_transition"])].iloc[0]
    law = anchor["slope_transition"] * (ratio / anchor["foot_mass_ratio"]) ** 1.5
    top.plot(ratio, law, color=INK, lw=1, ls=DOTTED, label="∝ ρ³ᐟ²")
    if has_exponents:
        below.axhline(1.5, color=INK, lw=1, ls=DOTTED)
    for axes, stem in zip(sketch.panels, _TITLES, strict=False):
        _draw_columns(sketch, axes, table, stem)
    if "asymptotic" in table:
        top.plot(ratio, table["asymptotic"], color=MUTED, lw=0.9, label="asymptotic formula")
    set_heading(top, "slope at the transition (rad)")
    top.legend(loc="upper left")
    if has_exponents:
        set_heading(below, "local exponent d ln γ / d ln ρ")
    below.set_xlabel("foot mass over total mass ρ")
    first = table["local_exponent"].dropna() if "local_exponent" in table else pd.Series(dtype=float)
    lightest = f" The local exponent is {plain(first.iloc[0])} at the lightest feet." if len(first) else ""
    return sketch.finish(table, low=ratio.min(), high=ratio.max(), lightest=lightest)


def _draw_columns(sketch: Sketch, axes: Any, table: pd.DataFrame, stem: str) -> None:
    """Draw the columns of a quantity against the foot mass ratio."""
    columns = [c for c in table.columns if c.startswith(stem) and not c.endswith(("_low", "_high"))]
    words, tip = _TITLES[stem]
    for k, column in enumerate(columns):
        rest = spaced(column.removeprefix(stem)).strip()
        name = f"{words.partition(' of ')[0]}, {rest}" if rest else words
        how: Any = {"color": _INKS[k % 3], "lw": 1, "marker": MARKERS[k % 5], "ms": 4.5}
        axes.plot(table["foot_mass_ratio"], table[column], label=name, **how)
        values = {"ρ": table["foot_mass_ratio"], tip: table[column]}
        sketch.mark(axes, table["foot_mass_ratio"], table[column], name, values)
