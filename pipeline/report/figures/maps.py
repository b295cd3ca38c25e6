"""Maps of a quantity over two axes, and of the outcomes of initial conditions."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap

from pipeline.report.figures.style import (
    RASTER,
    SHAPES,
    axis_values,
    canvas,
    log_axis,
    plain,
    rows_caption,
    set_heading,
    shorten,
    spread_evenly,
    thin,
)
from pipeline.report.figures.svg import Marks, Sketch
from pipeline.report.source import SYMBOLS, Source, print_units

#: Quantities that a map may show: the first that the archive holds.
_SHOWN = ("speed", "froude_speed", "stance_angle", "period", "spectral_radius")

#: Largest number of rows of maps, one for each value of the other axes.
_MAX_ROWS = 4

#: Colours of outcomes other than gaits and falls, and of falls: muted, so that gaits stand out.
_OTHER_COLOURS, _FALL_COLOURS = ("#b8a23a", "#9a74c4", "#4a9c74"), ("#8d939940", "#8d939980", "#8d9399c0")


def heatmap(source: Source) -> Sketch | None:
    """Map a quantity of each gait over two axes, with the border of stability; one row per value of other axes."""
    grid = source.grid
    wide = [d for d in source.axes if d != "walker" and grid.sizes[d] > 1][:2]
    variable = next((v for v in _SHOWN if v in grid), None)
    if len(wide) < 2 or variable is None:
        return None
    down, along = wide
    rest = [d for d in source.axes if d not in wide]
    every = [dict(zip(rest, place, strict=True)) for place in itertools.product(*(grid[d].values for d in rest))]
    rows = [every[i] for i in spread_evenly(len(every), _MAX_ROWS)]
    several = [{d: v for d, v in at.items() if grid.sizes[d] > 1} for at in rows]
    slices = {gait: [grid.sel(at).sel(gait=gait) for at in rows] for gait in source.gaits}
    present = [gait for gait, maps in slices.items() if any(np.isfinite(part[variable]).any() for part in maps)]
    if not (gaits := present[:2]):
        return None
    omitted = f" Not drawn: {', '.join(present[2:])}." if len(present) > 2 else ""
    figure = canvas(260 if len(rows) == 1 else 60 + 150 * len(rows))
    panels = figure.subplots(len(rows), len(gaits), sharex=True, sharey=True, squeeze=False)
    values = np.array([part[variable].values for gait in gaits for part in slices[gait]])
    low, high = np.nanmin(values), np.nanmax(values)
    pieces, marks = [], []
    for k, (at, words) in enumerate(zip(rows, several, strict=True)):
        fixed = dict(at)
        walker = str(fixed.pop("walker", source.walker))
        for axes, gait in zip(panels[k], gaits, strict=True):
            part = slices[gait][k].transpose(down, along, ...)
            x, y, z = part[along].values, part[down].values, part[variable].values
            picture = axes.pcolormesh(x, y, z, shading="nearest", cmap="cividis", vmin=low, vmax=high, rasterized=True)
            _draw_stability_border(axes, part, x, y)
            _set_scales(axes, x, y)
            axes.grid(False)
            title = ", ".join(filter(None, (f"{gait} step", axis_values(words))))
            axes.set_title(shorten(title, 60 // len(gaits)), pad=5)
            frame = part[[v for v in (variable, "spectral_radius") if v in part]].to_dataframe().reset_index()
            frame = frame[[c for c in dict.fromkeys((down, along, variable, "spectral_radius")) if c in frame]]
            pieces.append(frame.assign(gait=gait, **words))
            finite = frame.dropna(subset=[variable])
            marks += _cell_marks(axes, source, finite, gait, walker, (down, along, variable), fixed)
        symbol = SYMBOLS.get(down, down.replace("_", " "))
        panels[k][0].set_ylabel(_axis_title(source, down) if len(rows) == 1 else symbol)
    quantity, x_title, y_title = (_axis_title(source, name) for name in (variable, along, down))
    for axes in panels[-1]:
        axes.set_xlabel(x_title)
    bar = figure.colorbar(picture, ax=list(panels.ravel()), shrink=0.9, aspect=24)
    bar.outline.set_visible(False)
    bar.ax.grid(False)
    bar.set_label(quantity)
    data = pd.concat(pieces, ignore_index=True)
    border = " White line: the border of stability, max |λ| = 1." if "spectral_radius" in grid else ""
    shown = rows_caption(several, every)
    return Sketch(
        figure,
        f"Map of {variable.replace('_', ' ')}",
        f"{quantity.capitalize()} over {x_title} and {y_title}. Blank: no such gait.{border}{omitted}{shown}",
        f"Heat map of {variable} over {along} and {down}, from {plain(low)} to {plain(high)}.{shown}",
        data,
        marks,
    )


def _draw_stability_border(axes: Axes, part: xr.Dataset, x: np.ndarray, y: np.ndarray) -> None:
    """Draw the contour max |λ| = 1 where it crosses the map."""
    if "spectral_radius" not in part or min(len(x), len(y)) < 2:
        return
    radius = part["spectral_radius"].values
    if np.nanmin(radius, initial=np.inf) < 1 < np.nanmax(radius, initial=-np.inf):
        axes.contour(x, y, np.ma.masked_invalid(radius), levels=[1.0], colors="#ffffff", linewidths=1.6)


def _set_scales(axes: Axes, x: np.ndarray, y: np.ndarray) -> None:
    """Make axes that span more than a factor of 30 logarithmic."""
    for which, values in (("x", x), ("y", y)):
        if len(values) > 2 and (values > 0).all() and values[-1] / values[0] > 30:
            log_axis(axes, which)


def _cell_marks(
    axes: Axes,
    source: Source,
    frame: pd.DataFrame,
    gait: str,
    walker: str,
    names: tuple[str, str, str],
    fixed: dict[str, Any],
) -> list[Marks]:
    """Marks of a map's cells, each with its whole command, for every cell belongs to another line."""
    down, along, _ = names
    frame = thin(frame, 180)
    values = {SYMBOLS.get(n, n): frame[n].to_numpy() for n in names}
    settings = [
        {k: float(v) for k, v in {**fixed, down: getattr(r, down), along: getattr(r, along)}.items()}
        for r in frame.itertuples()
    ]
    slopes = [s.pop("slope", None) for s in settings]
    commands = [
        source.command(walker, s) + (f" --slope {slope!r}" if slope is not None else "")
        for s, slope in zip(settings, slopes, strict=True)
    ]
    return [
        Marks(
            axes, frame[along].to_numpy(), frame[down].to_numpy(), f"{gait} step · {walker}", values, commands=commands
        )
    ]


def _axis_title(source: Source, name: str) -> str:
    column = source.grid.variables.get(name)
    unit = source.units(name)
    words = str(column.attrs.get("long_name", "")) if column is not None else ""
    words = words if words and len(words) < 34 else name.replace("_", " ")
    symbol = SYMBOLS.get(name, "")
    return " ".join(p for p in (words, symbol, f"({unit})" if unit else "") if p)


def _is_fall(outcome: str) -> bool:
    """Whether an outcome is a fall, or no step at all."""
    return outcome.startswith(("fell", "foot", "no ", "-1"))


def _column(table: pd.DataFrame, name: str) -> str:
    """A column's name in words, with its symbol and unit."""
    unit = print_units(table.attrs.get("units", {}).get(name, "1"))
    return " ".join(filter(None, (name.replace("_", " "), SYMBOLS.get(name), f"({unit})" if unit else "")))


def basin(source: Source) -> Sketch | None:
    """Map the outcome of each initial condition over its first two coordinates."""
    table = source.tables.get("basin")
    if table is None or "outcome" not in table or table.empty:
        return None
    others = {*source.line_columns(table), "outcome", "slope", "steps"}
    plane = [c for c in table.columns if c not in others and table[c].dtype.kind == "f" and table[c].nunique() > 1][:2]
    if len(plane) < 2:
        return None
    figure = canvas(300)
    axes = figure.add_subplot()
    outcomes = sorted({str(o) for o in table["outcome"]}, key=lambda o: (_is_fall(o), o))
    other_inks, fall_inks = itertools.cycle(_OTHER_COLOURS), itertools.cycle(_FALL_COLOURS)
    inks = [next(fall_inks) if _is_fall(o) else RASTER.get(o) or next(other_inks) for o in outcomes]
    which = table["outcome"].astype(str).map(outcomes.index)
    if len(table) == table[plane[0]].nunique() * table[plane[1]].nunique():
        z = table.assign(which=which.astype(float)).pivot(index=plane[1], columns=plane[0], values="which")
        axes.pcolormesh(
            z.columns,
            z.index,
            z.values,
            shading="nearest",
            cmap=ListedColormap(inks),
            vmin=-0.5,
            vmax=len(inks) - 0.5,
            rasterized=True,
        )
    else:
        axes.scatter(
            table[plane[0]], table[plane[1]], s=4, lw=0, c=[inks[w] for w in which], rasterized=len(table) > SHAPES
        )
    for outcome, ink in zip(outcomes, inks, strict=True):
        axes.scatter([], [], s=40, marker="s", lw=0, color=ink, label=shorten(outcome.replace("_", " ")))
    axes.grid(False)
    axes.set_xlabel(_column(table, plane[0]))
    set_heading(axes, _column(table, plane[1]))
    figure.legend(loc="outside upper left", ncols=3)
    shown = thin(table, 400)
    x, y = (shown[name].to_numpy() for name in plane)
    values = {plane[0]: x, plane[1]: y, "outcome": shown["outcome"].astype(str).to_numpy()}
    return Sketch(
        figure,
        "Basin of attraction",
        "Initial conditions coloured by outcome; grey ones fall.",
        f"{len(table)} initial conditions over {' and '.join(plane)}, coloured by outcome: {', '.join(outcomes)}.",
        table,
        [Marks(axes, x, y, "initial condition", values)],
    )
