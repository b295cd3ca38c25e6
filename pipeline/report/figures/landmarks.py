"""Printed numbers beside computed ones: a mark at the printed number, a bar over what
rounding allows.
"""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from gaitsweep.pipeline.report.figures.sketch import Sketch
from gaitsweep.pipeline.report.figures.style import (
    INK,
    NARROW_SMALL_WORDS,
    PRINTED,
    once_laid_out,
    write_at,
    write_clear,
)
from gaitsweep.pipeline.report.source import Source
from gaitsweep.pipeline.report.words import as_printed, plain

#: Columns of the tables of landmarks.
_COLUMNS = [
    "landmark",
    "walker",
    "printed",
    "half_unit",
    "slope",
    "slope_low",
    "slope_high",
    "stance_angle",
]

#: Where a printed number may stand beside its mark.
_BESIDE = (
    (8, 0, "left"),
    (-14, 0, "right"),
    (14, 0, "left"),
    (0, 16, "center"),
    (0, -16, "center"),
    (-6, 26, "right"),
    (6, -28, "left"),
    (-10, 36, "right"),
    (16, -40, "left"),
)

#: Width of a letter of the words at lines across a panel, at most: on a narrow page,
#: where they are larger [pt].
_WIDTH_OF_A_LETTER = 0.59 * NARROW_SMALL_WORDS
#: Walkers of exact parameters, whose slopes have the bracket in which they are located
#: instead of what rounding allows.
_EXACT = ("B", "D", "E", "F")
#: Walkers that are tuned exactly whatever their other parameters are rounded to.
_TUNED = ("A", "C")


def every(source: Source, *columns: str) -> pd.DataFrame:
    """Some columns of the tables `landmarks` and `crises`."""
    found = [source.table(name, *columns) for name in ("landmarks", "crises")]
    tables = [table[[*columns]] for table in found if table is not None]
    return (
        pd.concat(tables, ignore_index=True)
        if tables
        else pd.DataFrame(columns=[*columns])
    )


def within(source: Source, table: pd.DataFrame) -> pd.DataFrame:
    """Landmarks whose computed or printed slope is among a study's slopes."""
    low, high = _window(source.given("axes", "slope"))
    is_inside = [table[name].between(low, high) for name in ("slope", "printed")]
    return table[is_inside[0] | is_inside[1]]


def _window(slopes: Any) -> tuple[float, float]:
    """The least and the largest slope of an axis; all slopes where none is given."""
    if isinstance(slopes, Mapping):
        slopes = [slopes[end] for end in ("from", "to") if end in slopes]
    ends = np.atleast_1d(np.array([0.0, np.inf] if slopes is None else slopes, float))
    return float(ends.min()), float(ends.max())


def rows(source: Source, walker: str | None = None) -> pd.DataFrame:
    """Landmarks with a printed number, of one walker or of all."""
    table = every(source, *_COLUMNS).astype(dict.fromkeys(_COLUMNS[2:], float))
    table = table[np.isfinite(table["printed"])]
    return table if walker is None else table[table["walker"] == walker]


def point_numbers(source: Source) -> pd.DataFrame:
    """Landmarks that are numbered in the paper's figure."""
    table = every(source, *_COLUMNS, "point")
    return table[table["point"].astype(str) != ""]


def draw_at_angles(sketch: Sketch, axes: Axes, source: Source) -> pd.DataFrame:
    """Mark printed slopes at the stance angles of the computed landmarks; all that are
    printed, if any is marked.
    """
    printed = rows(source)
    low, high = sorted(axes.get_xlim())
    table = printed[
        np.isfinite(printed["stance_angle"]) & printed["printed"].between(low, high)
    ]
    for row in table.itertuples():
        axes.plot(
            [row.slope_low, row.slope_high],
            [row.stance_angle] * 2,
            color=PRINTED,
            lw=5,
            alpha=0.3,
            zorder=3,
        )
        axes.plot(
            [row.printed],
            [row.stance_angle],
            "|",
            color=PRINTED,
            ms=15,
            mew=2,
            zorder=6,
        )

    words = [
        (as_printed(row.printed, row.half_unit), (row.printed, row.stance_angle))
        for row in table.itertuples()
    ]
    write_clear(axes, words, _BESIDE, color=PRINTED)
    if len(table):
        sketch.key("paper's value, rounding range", PRINTED, lw=5, alpha=0.4)
    return printed if len(table) else table


def draw_over_slopes(axes: Axes, table: pd.DataFrame) -> None:
    """Mark printed slopes by lines across the panel, beside the computed ones; their
    words stand below the data.
    """
    if table.empty:
        return

    low, high = axes.get_ylim()
    axes.set_ylim(low - 0.22 * (high - low), high)
    rows = [*table.sort_values("slope").itertuples()]
    for row in rows:
        axes.axvspan(
            row.slope_low, row.slope_high, color=PRINTED, alpha=0.12, lw=0, zorder=0.5
        )
        axes.axvline(row.printed, color=PRINTED, lw=1.4, ls=(0, (5, 2)), zorder=3)
        axes.axvline(row.slope, color=INK, lw=0.8, ls=(0, (1, 2)), zorder=3)

    once_laid_out(axes, partial(_write_at_lines, axes, rows))


def _write_at_lines(axes: Axes, rows: Sequence[Any]) -> None:
    """Write printed and computed slopes beside their lines, which the legend tells
    apart: longer words would touch on a narrow page.
    """
    for row in rows:
        words = as_printed(row.printed, row.half_unit)
        is_right = row.printed >= row.slope
        _write_at_line(axes, words, row.printed, is_right, height=0.03, color=PRINTED)

        words = plain(row.slope, 4)
        is_right = row.slope >= row.printed
        _write_at_line(axes, words, row.slope, is_right, height=0.11, color=INK)


def _write_at_line(
    axes: Axes, words: str, at: float, wants_right: bool, height: float, color: str
) -> None:
    """Write words beside a line across the panel, at a share of its height: on the side
    wanted, unless they fit only on the other.
    """
    across = axes.transData.transform((at, 0.0))[0]
    width = _WIDTH_OF_A_LETTER * len(words)
    fits_right = across + width <= axes.bbox.x1
    fits_left = across - width >= axes.bbox.x0
    is_right = wants_right if fits_right == fits_left else fits_right

    how: Any = {
        "ha": "left" if is_right else "right",
        "xycoords": axes.get_xaxis_transform(),
        "fontsize": 8,
    }
    away = 3 if is_right else -3
    write_at(axes, words, (at, height), (away, 0), color=color, **how)


def has_rounding(table: pd.DataFrame) -> bool:
    """Whether a landmark of the table is of a walker with rounded parameters."""
    return not table["walker"].isin(_EXACT).all()


def sentence(table: pd.DataFrame) -> str:
    """The printed and computed slopes in words."""
    parts = []
    for row in table.itertuples():
        width, ends = row.slope_high - row.slope_low, (row.slope_low, row.slope_high)
        interval = ""
        if row.walker in _EXACT and width > 0:
            interval = f" (between {plain(ends[0], 6)} and {plain(ends[1], 6)})"
        elif width > 1e-3 * row.slope:
            kept = (
                "with exact tuning"
                if row.walker in _TUNED
                else "with the parameters as printed"
            )
            interval = f", {plain(ends[0], 3)}–{plain(ends[1], 3)} {kept}"

        printed = as_printed(row.printed, row.half_unit)
        parts.append(
            f"{row.landmark}: printed {printed}, computed {plain(row.slope, 5)}{interval}"
        )

    head = (
        "printed slopes, and the interval that rounding allows"
        if has_rounding(table)
        else "printed slopes"
    )
    return f"Purple: {head} ({'; '.join(parts)})." if parts else ""


def note(table: pd.DataFrame) -> str:
    """What the ends of the landmarks' intervals are, for their table."""
    names = set(table["walker"])
    tuned, exact = (", ".join(sorted(names & set(group))) for group in (_TUNED, _EXACT))
    kept = f" (of {tuned} with exact tuning)" if tuned else ""
    parts = (
        [f"the slopes that the rounding of the printed parameters allows{kept}"]
        if has_rounding(table)
        else []
    )
    parts += (
        [
            f"of {exact}, whose parameters are exact, the bracket in which the slope is located"
        ]
        if exact
        else []
    )
    return f"Rounding range: {'; '.join(parts)}."
