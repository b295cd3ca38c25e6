"""Bifurcation diagrams of orbits (figure 12), and where orbits are chaotic."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from gaitsweep.pipeline.report.figures import landmarks
from gaitsweep.pipeline.report.figures.sketch import Sketch
from gaitsweep.pipeline.report.figures.style import (
    DOTTED,
    LINE,
    MAX_PANELS,
    MUTED,
    PRINTED,
    SHAPES,
    WALKERS,
    evenly,
    inks,
    on_both,
    set_heading,
    thin,
)
from gaitsweep.pipeline.report.source import Line, Source, rows_at
from gaitsweep.pipeline.report.words import (
    plain,
    shorten,
    symbol,
    with_unit,
)

#: An exponent is positive if it exceeds so many of its standard errors.
_ERRORS = 3

#: What is told of orbits at a slope, by column.
_TOLD = {"exponent": "exponent (per step)", "lifetime": "lifetime (steps)"}


def bifurcation(source: Source, table: pd.DataFrame) -> Sketch | None:
    """Plot stance angles of successive steps of orbits against slope, or what else
    drives, with printed and computed landmarks.
    """
    table = table[np.isfinite(table["stance_angle"])]
    if table.empty:
        return None

    every_line = source.lines_of(table)
    lines = evenly(every_line, MAX_PANELS)
    height = 330 if len(lines) == 1 else 230 * len(lines)
    sketch = Sketch("bifurcation", height, len(lines), sharex=True)

    printed = [_near(source, line) for line in lines]
    for axes, line in zip(sketch.panels, lines, strict=True):
        _draw_orbits(sketch, source, axes, line, len(table) > SHAPES)

    every = pd.concat(printed, ignore_index=True)
    if len(every):
        _widen(sketch.panels[-1], every)
        for axes, shown in zip(sketch.panels, printed, strict=True):
            landmarks.draw_over_slopes(axes, shown)
        sketch.key("printed", PRINTED, lw=1.4, ls=(0, (5, 2)))
        if landmarks.has_rounding(every):
            sketch.key("rounding range", PRINTED, lw=7, alpha=0.25)
        sketch.key("computed", lw=0.8, ls=DOTTED)

    return sketch.finish(
        table,
        transients=_transients(source, table),
        printed=landmarks.sentence(every),
        drawn=len(lines),
        every=len(every_line),
        abscissa=source.along,
        **source.words_along,
    )


def _near(source: Source, line: Line) -> pd.DataFrame:
    """Printed landmarks of a line's walker beside the slopes of its orbits."""
    rows = landmarks.rows(source, line.at["walker"])
    slopes = line.rows["slope"]
    return rows[rows["printed"].between(0.8 * slopes.min(), 1.2 * slopes.max())]


def _draw_orbits(
    sketch: Sketch, source: Source, axes: Axes, line: Line, raster: bool
) -> None:
    """Draw every step of a line's orbits as a dot."""
    rows = line.rows
    ink = WALKERS.get(line.at["walker"], LINE)
    axes.plot(
        rows[source.along],
        rows["stance_angle"],
        ".",
        ms=0.9 if len(rows) > 10_000 else 2,
        mew=0,
        color=on_both(ink) if raster else ink,
        rasterized=raster,
    )
    name = f"{shorten(line.label)}: " if line.label else ""
    set_heading(axes, f"{name}stance angle θ* of successive steps (rad)")
    sketch.mark(
        axes,
        thin(rows, 400),
        line.label or "orbit",
        command=line.command,
        tips={
            source.along: _title(source),
            "stance_angle": "θ* of one step (rad)",
            "period": source.period_title(line.at),
        },
        x=source.along,
        along=source.along,
        free=True,
    )


def _title(source: Source) -> str:
    """The symbol of what gaits are followed along, with its unit."""
    return with_unit(symbol(source.along), source.units(source.along))


def _widen(axes: Axes, printed: pd.DataFrame) -> None:
    """Extend the shared slope axis so that every printed and computed landmark lies on
    it, with its label.
    """
    values = printed[["printed", "slope"]].to_numpy(float).ravel()
    left, right = axes.get_xlim()
    width = right - left
    axes.set_xlim(
        min(left, values.min() - 0.22 * width), max(right, values.max() + 0.25 * width)
    )


def _transients(source: Source, table: pd.DataFrame) -> int:
    """Steps after which dots beyond the loss of walking have not yet fallen; 0 where
    there are no such dots.
    """
    crises, survival = (
        source.table("crises", "walker", "slope"),
        source.table("survival", "strides", "starts"),
    )
    if crises is None or survival is None:
        return 0

    names = (
        table["walker"] if "walker" in table else pd.Series(source.walker, table.index)
    )
    beyond = table["slope"] > names.map(crises.groupby("walker")["slope"].max())
    return int((survival["strides"] / survival["starts"]).max()) if beyond.any() else 0


def lyapunov(source: Source, table: pd.DataFrame) -> Sketch | None:
    """Plot the largest Lyapunov exponent of orbits against slope, or what else drives,
    and, where they fall, how long they walk.
    """
    table = table[table["index"] == 0] if "index" in table else table
    frames = {
        "exponent": table,
        "lifetime": source.table("survival", "slope", "lifetime"),
    }
    shown = {
        name: each
        for name, each in frames.items()
        if each is not None and np.isfinite(each[name]).any()
    }
    if "exponent" not in shown:
        return None

    sketch = Sketch("lyapunov", 330 if len(shown) > 1 else 230, len(shown), sharex=True)
    sketch.panels[0].axhline(0, color=MUTED, lw=0.9)
    lines = source.lines_of(table)
    names = [line.label or source.walker for line in lines]
    colours = inks([line.called for line in lines])
    for axes, (column, frame) in zip(sketch.panels, shown.items(), strict=True):
        _draw_column(sketch, axes, source, frame, column, names, colours)
    sketch.line_keys(names, colours)

    return sketch.finish(
        chaos=_chaos(source, lines, names),
        errors=_ERRORS,
        falls="lifetime" in shown,
        and_falls=", and steps before a fall" if "lifetime" in shown else "",
        abscissa=source.along,
        **source.words_along,
    )


def _chaos(source: Source, lines: Sequence[Line], names: Sequence[str]) -> str:
    """Where orbits of lines called so are chaotic, in words."""
    ranges = [chaotic(source, line) for line in lines]
    said = [
        found.words(name, source.words_along)
        for name, found in zip(names, ranges, strict=True)
        if found is not None
    ]
    return "; ".join(said)


def _draw_column(
    sketch: Sketch,
    axes: Axes,
    source: Source,
    frame: pd.DataFrame,
    column: str,
    names: Sequence[str],
    colours: Sequence[str],
) -> None:
    """Draw a column of each line's table against what orbits lie along."""
    along, lines = source.along, source.lines_of(frame)
    tips = {along: _title(source), column: _TOLD[column]}
    for line, name, ink in zip(lines, names, colours, strict=True):
        seen = thin(line.rows[np.isfinite(line.rows[column])], 400)
        axes.plot(seen[along], seen[column], ".", color=ink, ms=2.5)
        how = {"tips": tips, "x": along, "y": column, "along": along}
        sketch.mark(axes, seen, name, **how)
        kept = [c for c in (along, column, "standard_error") if c in line.rows]
        # Without its walker a line that is alone has no name.
        sketch.pieces.append(line.rows[kept].assign(line=name))


class Chaos(NamedTuple):
    """Slopes, or values of what else drives, between which orbits of a line are chaotic:
    the least and the largest, and at how many of those computed between them.
    """

    low: float
    high: float
    chaotic: int
    between: int

    def words(self, name: str, along: Mapping[str, str]) -> str:
        """The range in words, of a line called so, and of what it lies along."""
        whole = "all" if self.chaotic == self.between else f"{self.chaotic} of the"
        return (
            f"from {plain(self.low)} to {plain(self.high)}{along['unit']} at {whole} "
            f"{self.between} {along['values']} ({name})"
        )


def chaotic(source: Source, line: Line) -> Chaos | None:
    """Where the exponents of a line exceed their standard errors by a factor, and
    walking persists; None where they do nowhere.

    Walking persists below the slope at which the archive has it lost, and where no
    orbit falls. At a flip an exponent is zero within its error, and orbits beyond the
    loss of walking are transients.
    """
    rows = line.rows
    if "standard_error" not in rows:
        return None

    along = source.along
    if along == "slope":
        rows = rows[rows["slope"] < _loss_of_walking(source, line)]
    fell = _fallen(source, line)
    rows = rows[~rows[along].isin(fell)]

    is_positive = rows["exponent"] > _ERRORS * rows["standard_error"]
    found = rows.loc[is_positive, along]
    if found.empty:
        return None

    low, high = float(found.min()), float(found.max())
    between = int(rows[along].between(low, high).sum())
    return Chaos(low, high, len(found), between)


def _loss_of_walking(source: Source, line: Line) -> float:
    """The slope at which a line's walking is lost; infinite if the archive has none."""
    table = source.table("crises", "walker", "slope")
    own = [] if table is None else table[table["walker"] == line.at["walker"]]["slope"]
    return float(min(own, default=np.inf))


def _fallen(source: Source, line: Line) -> pd.Series:
    """Slopes, or values of what else drives, at which an orbit of a line falls."""
    table = source.table("survival", source.along, "falls")
    if table is None:
        return pd.Series(dtype=float)
    own = rows_at(table, line.at)
    return own.loc[own["falls"] > 0, source.along]
