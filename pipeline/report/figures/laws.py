"""Scaling laws: the exponents of the paper's figure 10 as a picture, and its 3/2 law of
the transition.
"""

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from gaitsweep.pipeline.report.figures.sketch import Sketch
from gaitsweep.pipeline.report.figures.style import (
    DOTTED,
    INK,
    LINE,
    MARKERS,
    MUTED,
    PAPER,
    PRINTED,
    inks,
)
from gaitsweep.pipeline.report.source import Source
from gaitsweep.pipeline.report.words import plain, spaced

#: Marker of each range of slopes, and the exponents that section 6.2 allows.
_RANGES = {"vanishing": "o", "small": "s", "larger": "^"}
_LAWS = {"angle": {1 / 3: "1/3", 1.0: "1"}, "power": {2.0: "2", 4.0: "4"}}
#: Further ticks, at which the other exponents are read.
_TICKS = {"angle": (0.5, 0.6, 0.7, 0.8, 0.9), "power": (2.5, 3.0, 3.5, 4.5)}

#: Quantities of the two panels, as the names of their columns begin: their names in a
#: legend and under the pointer.
_TITLES = {
    "slope_transition": ("crossing of asymptotes", "γ at the transition (rad)"),
    "local_exponent": ("local exponent", "local exponent"),
}
_INKS = (LINE, MUTED, PRINTED)


def exponents(source: Source, table: pd.DataFrame) -> Sketch:
    """Plot the exponents of stance angle in slope and of power in speed, a row for each
    gait of each walker.
    """
    data = _exponents(table)
    rows = data.drop_duplicates("row")
    sketch = Sketch("exponents", 60 + 24 * len(rows), 1, 2, sharey=True)
    for axes, of in zip(sketch.panels, _LAWS, strict=True):
        _draw_exponents(sketch, axes, of, data[data["of"] == of])
        names = [f"{row.walker} {row.gait}" for row in rows.itertuples()]
        axes.set_yticks(rows["row"].tolist(), names)

    for when, marker in _RANGES.items():
        fill = PAPER if when == "small" else INK
        sketch.dot_key(f"{when} slopes", marker=marker, mfc=fill)

    shown = data.drop(columns=["of", "row"])
    return sketch.finish(shown, count=len(rows), slopes=_slopes(source))


def _exponents(table: pd.DataFrame) -> pd.DataFrame:
    """Every exponent with its walker, gait, law and range of slopes; rows of the figure
    from the top.
    """
    found = []
    gaits = [(k, gait) for k in range(len(table)) for gait in ("short", "long")]
    for of in _LAWS:
        for number, (k, gait) in enumerate(gaits):
            values = table.iloc[k]
            for when in _RANGES:
                found.append(
                    {
                        "walker": str(values["walker"]),
                        "gait": gait,
                        "law": "θ* ∝ γᵖ" if of == "angle" else "P ∝ vᵖ",
                        "slopes": when,
                        "exponent": float(values[f"{gait}_{of}_{when}"]),
                        "of": of,
                        "row": -number,
                    }
                )

    return pd.DataFrame(found)


def _draw_exponents(sketch: Sketch, axes: Axes, of: str, data: pd.DataFrame) -> None:
    """Draw the exponents of one law, with those that section 6.2 allows."""
    laws = _LAWS[of]
    for value in laws:
        axes.axvline(value, color=MUTED, lw=0.9, ls=DOTTED, zorder=1)
    ticks = [*laws, *_TICKS[of]]
    axes.set_xticks(ticks, [*laws.values(), *(f"{tick:g}" for tick in _TICKS[of])])

    colours = dict(
        zip(data["walker"].unique(), inks(data["walker"].unique()), strict=True)
    )
    for (walker, gait), rows in data.groupby(["walker", "gait"], sort=False):
        for one in rows.itertuples():
            ink = colours[one.walker]
            fill = PAPER if one.slopes == "small" else ink
            marker = _RANGES[one.slopes]
            axes.plot([one.exponent], [one.row], marker, color=ink, mfc=fill, ms=6)

        tips = {"exponent": f"p of {rows['law'].iloc[0]}", "slopes": "slopes"}
        sketch.mark(
            axes, rows, f"{walker}, {gait} step", tips=tips, x="exponent", y="row"
        )


def _slopes(source: Source) -> str:
    """The slopes of the three ranges, of a study that has those alone."""
    slopes: list[float] = (
        source.grid["slope"].values.tolist() if "slope" in source.grid.coords else []
    )
    return (
        f" ({', '.join(plain(v) for v in slopes)} rad)"
        if len(slopes) == len(_RANGES)
        else ""
    )


def transition_ladder(source: Source, table: pd.DataFrame) -> Sketch | None:
    """Plot the slope at which the short step changes its scaling against the mass of
    the feet, with the 3/2 law.
    """
    table = table.sort_values("foot_mass_ratio").reset_index(drop=True)
    table = table[table["foot_mass_ratio"] > 0]
    if not np.isfinite(table["slope_transition"]).any():
        return None

    sketch = _ladder(has_exponents=bool(_columns(table, "local_exponent")))
    ratio = table["foot_mass_ratio"]
    top = sketch.panels[0]
    top.plot(ratio, _three_halves(table), color=INK, lw=1, ls=DOTTED, label="∝ ρ³ᐟ²")
    for axes, stem in zip(sketch.panels, _TITLES, strict=False):
        _draw_columns(sketch, axes, table, stem)
    if "asymptotic" in table:
        formula = table["asymptotic"]
        top.plot(ratio, formula, color=MUTED, lw=0.9, label="asymptotic formula")

    top.legend(loc="upper left")

    lightest = ""
    if "local_exponent" in table and table["local_exponent"].notna().any():
        first = plain(table["local_exponent"].dropna().iloc[0])
        lightest = f" The local exponent is {first} at the lightest feet."

    return sketch.finish(table, low=ratio.min(), high=ratio.max(), lightest=lightest)


def _ladder(has_exponents: bool) -> Sketch:
    """Empty panels: of the slopes and, if there are any, of the local exponents, with
    the law's.
    """
    if not has_exponents:
        return Sketch("transition_ladder", 260)
    sketch = Sketch("transition_ladder", 380, 2, sharex=True, height_ratios=[5, 3])
    sketch.panels[1].axhline(1.5, color=INK, lw=1, ls=DOTTED)
    return sketch


def _three_halves(table: pd.DataFrame) -> pd.Series:
    """Slopes by the 3/2 law, through the first that is known."""
    anchor = table[np.isfinite(table["slope_transition"])].iloc[0]
    share = table["foot_mass_ratio"] / anchor["foot_mass_ratio"]
    law: pd.Series = anchor["slope_transition"] * share**1.5
    return law


def _columns(table: pd.DataFrame, stem: str) -> list[str]:
    """The columns of a quantity, without their bounds."""
    own = [column for column in table.columns if column.startswith(stem)]
    return [column for column in own if not column.endswith(("_low", "_high"))]


def _draw_columns(sketch: Sketch, axes: Any, table: pd.DataFrame, stem: str) -> None:
    """Draw the columns of a quantity against the foot mass ratio."""
    words, tip = _TITLES[stem]
    for k, column in enumerate(_columns(table, stem)):
        rest = spaced(column.removeprefix(stem)).strip()
        name = f"{words.partition(' of ')[0]}, {rest}" if rest else words
        how: Any = {"color": _INKS[k % 3], "lw": 1, "marker": MARKERS[k % 5], "ms": 4.5}
        axes.plot(table["foot_mass_ratio"], table[column], label=name, **how)
        sketch.mark(
            axes,
            table,
            name,
            tips={"foot_mass_ratio": "ρ", column: tip},
            x="foot_mass_ratio",
            y=column,
        )
