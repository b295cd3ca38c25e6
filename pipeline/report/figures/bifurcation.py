"""Bifurcation diagrams of orbits (figure 12)."""

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
    RASTER,
    SHAPES,
    colour,
    evenly,
    set_heading,
    thin,
)
from gaitsweep.pipeline.report.source import Source
from gaitsweep.pipeline.report.words import shorten, spaced


def bifurcation(source: Source, table: pd.DataFrame) -> Sketch | None:
    """Plot stance angles of successive steps of orbits against slope, with printed and
    computed landmarks.
    """
    table = table[np.isfinite(table["stance_angle"])]
    if table.empty:
        return None
    every_line = source.lines_of(table)
    lines = evenly(every_line, MAX_PANELS)
    sketch = Sketch(
        "bifurcation",
        330 if len(lines) == 1 else 230 * len(lines),
        len(lines),
        sharex=True,
    )
    raster = len(table) > SHAPES
    printed = []
    # A dot is one step of an attractor: only its walker and slope can be solved again,
    # for the gaits there.
    tips = {
        "slope": "γ (rad)",
        "stance_angle": "θ* of one step (rad)",
        "period": "period",
    }
    for axes, line in zip(sketch.panels, lines, strict=True):
        rows, size = line.rows, 0.9 if len(line.rows) > 10_000 else 2
        ink = RASTER["long"] if raster else LINE
        axes.plot(
            rows["slope"],
            rows["stance_angle"],
            ".",
            ms=size,
            mew=0,
            color=ink,
            rasterized=raster,
        )
        set_heading(
            axes,
            f"{shorten(line.label)}: " * bool(line.label)
            + "stance angle θ* of successive steps (rad)",
        )
        of_walker = landmarks.rows(source, line.at["walker"])
        shown = of_walker[
            of_walker["printed"].between(
                0.8 * rows["slope"].min(), 1.2 * rows["slope"].max()
            )
        ]
        landmarks.draw_over_slopes(axes, shown)
        printed.append(shown)
        label = f"{line.label or 'orbit'}; command: the gaits there"
        sketch.mark(
            axes, thin(rows, 400), label, command=line.command, tips=tips, free=True
        )
    every = pd.concat(printed, ignore_index=True)
    if len(every):
        _widen(sketch.panels[-1], every)
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


def lyapunov(source: Source, table: pd.DataFrame) -> Sketch | None:
    """Plot the largest Lyapunov exponent of orbits against slope and, where they fall,
    how long they walk.
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
    lines = [line.label or source.walker for line in source.lines_of(table)]
    for axes, (column, frame) in zip(sketch.panels, shown.items(), strict=True):
        for k, line in enumerate(source.lines_of(frame)):
            seen = thin(line.rows[np.isfinite(line.rows[column])], 400)
            axes.plot(seen["slope"], seen[column], ".", color=colour(k), ms=2.5)
            tips = {"slope": "γ (rad)", column: spaced(column)}
            sketch.mark(axes, seen, lines[k], command=line.command, tips=tips, y=column)
            sketch.pieces.append(line.rows[["slope", column]].assign(line=line.label))
    sketch.line_keys(lines)
    chaotic = table[table["exponent"] > 0]["slope"]
    return sketch.finish(
        first=chaotic.min() if len(chaotic) else None,
        last=chaotic.max() if len(chaotic) else None,
    )
