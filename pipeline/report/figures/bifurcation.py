"""Bifurcation diagrams of orbits (figure 12)."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from pipeline.report.figures import landmarks
from pipeline.report.figures.branch_curves import MAX_PANELS, groups, line_command, title
from pipeline.report.figures.style import (
    GAIT_COLOURS,
    INK,
    PRINTED,
    RASTER,
    SHAPES,
    canvas,
    plain,
    set_heading,
    shorten,
    spread_evenly,
    thin,
)
from pipeline.report.figures.svg import Marks, Sketch
from pipeline.report.source import Source


def bifurcation(source: Source) -> Sketch | None:
    """Plot stance angles of successive steps of orbits against slope, with printed and computed landmarks."""
    table = source.tables.get("orbits")
    if table is None or not {"slope", "stance_angle"} <= set(table.columns):
        return None
    table = table[np.isfinite(table["stance_angle"])]
    if table.empty:
        return None
    every_line = groups(source, table)
    lines = [every_line[i] for i in spread_evenly(len(every_line), MAX_PANELS)]
    figure = canvas(330 if len(lines) == 1 else 230 * len(lines))
    panels = np.atleast_1d(figure.subplots(len(lines), 1, sharex=True))
    raster = len(table) > SHAPES
    panels[-1].set_xlabel("slope γ (rad)")
    marks, printed = [], []
    for axes, (at, rows) in zip(panels, lines, strict=True):
        size = 0.9 if len(rows) > 10_000 else 2
        ink = RASTER["long"] if raster else GAIT_COLOURS["long"]
        axes.plot(rows["slope"], rows["stance_angle"], ".", ms=size, mew=0, color=ink, rasterized=raster)
        set_heading(axes, (shorten(title(at)) + ": " if at else "") + "stance angle θ* of successive steps (rad)")
        walker = str(at.get("walker", source.walker))
        of_walker = landmarks.rows(source, walker)
        shown = of_walker[of_walker["printed"].between(0.8 * rows["slope"].min(), 1.2 * rows["slope"].max())]
        landmarks.draw_over_slopes(axes, shown)
        printed.append(shown)
        marks.append(_marks(source, axes, rows, title(at)))
    _widen(panels, printed)
    every = pd.concat(printed, ignore_index=True)
    rounded = landmarks.has_rounding(every)
    if len(every):
        keys = [
            Line2D([], [], color=PRINTED, lw=1.4, ls=(0, (5, 2)), label="printed"),
            *([Line2D([], [], color=PRINTED, lw=7, alpha=0.25, label="allowed by rounding")] * rounded),
            Line2D([], [], color=INK, lw=0.8, ls=(0, (1, 2)), label="computed"),
        ]
        figure.legend(handles=keys, loc="outside upper left", ncols=3)
    return Sketch(
        figure,
        "Bifurcation diagram",
        "Stance angles of successive steps after the transient; initial conditions that fall are left out."
        + _transients(source, table)
        + landmarks.sentence(every)
        + (f" {len(lines)} of {len(every_line)} lines are drawn." if len(every_line) > len(lines) else ""),
        f"Bifurcation diagram: {len(table)} stance angles against slope from {plain(table['slope'].min())} to "
        f"{plain(table['slope'].max())} rad.",
        table,
        marks,
    )


def _transients(source: Source, table: pd.DataFrame) -> str:
    """Sentence on the dots beyond the loss of walking: no attractor is left there, and the walker falls later."""
    crises, survival = source.tables.get("crises"), source.tables.get("survival")
    if crises is None or survival is None or not {"walker", "slope"} <= set(crises.columns):
        return ""
    names = table["walker"] if "walker" in table else pd.Series(source.walker, table.index)
    beyond = table["slope"] > names.map(crises.groupby("walker")["slope"].max())
    steps = int((survival["strides"] / survival["starts"]).max())
    return f" Dots beyond the loss of walking are transients, not yet fallen after {steps} steps." * bool(beyond.any())


def _widen(panels: np.ndarray[tuple[int], np.dtype[np.object_]], printed: list[pd.DataFrame]) -> None:
    """Extend the shared slope axis so that every printed and computed landmark lies on it, with its label."""
    values = pd.concat(printed)[["printed", "slope"]].to_numpy(float).ravel()
    left, right = panels[-1].get_xlim()
    if len(values):
        width = right - left
        panels[-1].set_xlim(min(left, values.min() - 0.15 * width), max(right, values.max() + 0.25 * width))


def _marks(source: Source, axes: Axes, rows: pd.DataFrame, name: str) -> Marks:
    # A dot is one step of an attractor: only its walker and slope can be solved again, for the gaits there.
    shown = thin(rows, 400)
    slopes, angles = shown["slope"].to_numpy(), shown["stance_angle"].to_numpy()
    values = {"γ (rad)": slopes, "θ* of one step (rad)": angles}
    if "period" in shown:
        values["period"] = shown["period"].to_numpy()
    return Marks(
        axes,
        slopes,
        angles,
        f"{name or 'orbit'}; command: the gaits there",
        values,
        line_command(source, shown),
        slopes,
        gaits=shown,
        free=True,
    )
