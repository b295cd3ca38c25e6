"""Design maps: the best gaits of each walker over two of its keys."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pipeline.report.figures.starts import START, cells
from pipeline.report.figures.style import axis_values, canvas, plain, rows_caption, shorten, spread_evenly
from pipeline.report.figures.svg import Marks, Panel, Sketch
from pipeline.report.source import SYMBOLS, Source

#: Quantities mapped, from left to right, and their titles.
_SHOWN = {
    "smallest_slope": "smallest slope γ (rad)",
    "largest_stable_slope": "largest stable γ (rad)",
    "fastest_froude_speed": "fastest stable Fr (1)",
}
#: Quantities that compare, which share one colour scale.
_COMPARED = ("smallest_slope", "largest_stable_slope")
#: Fewest cells along each side of a map on which contours are drawn.
_MIN_CONTOURED = 6
#: Largest number of rows of maps, one for each value of the other axes.
_MAX_ROWS = 4


def design(source: Source) -> Sketch | None:
    """Map smallest slope, largest stable slope and fastest stable speed over two keys, one row per walker."""
    table = source.tables.get("design")
    if table is None or table.empty or not set(_SHOWN) <= set(table.columns):
        return None
    keys = [c for c in source.line_columns(table) if c != "walker" and table[c].nunique() > 1][:2]
    if len(keys) < 2:
        return None
    down, along = keys
    others = [c for c in source.line_columns(table) if c not in keys]
    every = table[others].drop_duplicates().to_dict("records") if others else [{}]
    rows = [every[i] for i in spread_evenly(len(every), _MAX_ROWS)]
    figure = canvas(60 + 150 * len(rows))
    panels = figure.subplots(len(rows), len(_SHOWN), sharex=True, sharey=True, squeeze=False)
    marks, maps = [], []
    several = [{k: v for k, v in at.items() if table[k].nunique() > 1} for at in rows]
    for k, (row, at) in enumerate(zip(panels, rows, strict=True)):
        part = table[np.logical_and.reduce([table[c] == v for c, v in at.items()], initial=True)] if at else table
        for axes, (column, words) in zip(row, _SHOWN.items(), strict=True):
            scale = table[list(_COMPARED)] if column in _COMPARED else table[column]
            _draw_map(axes, part.pivot(index=down, columns=along, values=column), scale, figure)
            _mark_walker(axes, source.walkers.get(str(at.get("walker", source.walker)), {}), down, along)
            axes.set_title(words if k == 0 else "", pad=5)
            marks.append(_marks(axes, source, part, at, (down, along), column))
        maps += _panels(list(row), source, part, at, keys, len(rows))
        name = axis_values(several[k])
        row[0].set_ylabel(f"{shorten(name, 22)}: {_symbol(source, down)}" if name else _symbol(source, down))
    for axes in panels[-1]:
        axes.set_xlabel(_symbol(source, along))
        axes.set_xticks([table[along].min(), table[along].max()])
    return Sketch(
        figure,
        "Design map",
        f"The smallest slope with a gait, the largest slope with a stable gait, and the Froude number of the fastest "
        f"stable gait, over {down} and {along}. Circle: the walker itself. The two slopes share one scale. Blank: no "
        "such gait." + rows_caption(several, every),
        f"Heat maps over {along} and {down}: "
        + "; ".join(f"{c.replace('_', ' ')} from {plain(table[c].min())} to {plain(table[c].max())}" for c in _SHOWN)
        + ".",
        table,
        marks,
        panels=maps,
    )


def _draw_map(axes: Axes, z: pd.DataFrame, whole: pd.Series | pd.DataFrame, figure: Figure) -> None:
    """Draw one map; all maps of a quantity share one colour scale."""
    values = np.asarray(whole, float)
    low, high = np.nanmin(values, initial=np.inf), np.nanmax(values, initial=-np.inf)
    low, high = (low, high) if low <= high else (0.0, 1.0)
    picture = axes.pcolormesh(
        z.columns, z.index, z.values, shading="nearest", cmap="cividis", rasterized=True, vmin=low, vmax=high
    )
    axes.grid(False)
    if min(z.shape) >= _MIN_CONTOURED and np.isfinite(z.to_numpy()).any():
        axes.contour(z.columns, z.index, np.ma.masked_invalid(z.to_numpy()), levels=5, colors="#ffffff", linewidths=0.7)
    bar = figure.colorbar(picture, ax=axes, shrink=0.9, aspect=16)
    bar.outline.set_visible(False)
    bar.ax.grid(False)


def _mark_walker(axes: Axes, parameters: dict[str, Any], down: str, along: str) -> None:
    """Mark the place of the study's walker, before the axes change it, if it lies on the map."""
    if not {down, along} <= set(parameters):
        return
    x, y = float(parameters[along]), float(parameters[down])
    (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
    if left <= x <= right and low <= y <= high:
        axes.plot([x], [y], "o", color="#ffffff", mfc="none", ms=9, mew=2)
        axes.plot([x], [y], "o", color="#000000", mfc="none", ms=9, mew=0.8)


def _panels(
    row: list[Axes], source: Source, table: pd.DataFrame, at: dict[str, Any], keys: list[str], rows: int
) -> list[Panel]:
    """The maps of one row, each cell of which starts the fastest stable gait of its walker."""
    if not set(START[1:4]) <= set(table.columns):
        return []
    down, along = keys
    names = {"fastest_slope": "slope"} | {name: name for name in START[1:] if name in table}
    grids = {to: table.pivot(index=down, columns=along, values=name) for name, to in names.items()}
    slope = grids["slope"]
    settings = {k: v for k, v in at.items() if k != "walker"}
    columns = {name: grid.to_numpy(float) for name, grid in grids.items()}
    start = cells(source, str(at.get("walker", source.walker)), settings, (along, down), columns, rows)
    return [
        Panel(axes, (along, down), slope.columns.to_numpy(float), slope.index.to_numpy(float), start) for axes in row
    ]


def _symbol(source: Source, key: str) -> str:
    unit = source.units(key)
    return f"{SYMBOLS.get(key, key)} ({unit})" if unit else SYMBOLS.get(key, key)


def _marks(
    axes: Axes, source: Source, table: pd.DataFrame, at: dict[str, Any], keys: tuple[str, str], column: str
) -> Marks:
    """Marks of the cells, each with the command that solves its walker at the slope of the cell."""
    down, along = keys
    walker = str(at.get("walker", source.walker))
    fixed = {k: float(v) for k, v in at.items() if k != "walker"}
    slopes = table["fastest_slope"] if column.startswith("fastest") else table[column]
    commands = [
        source.command(walker, fixed | {k: float(v) for k, v in zip(keys, place, strict=True)})
        + (f" --slope {slope!r}" if 0 < slope < 0.5 else "")
        for *place, slope in zip(table[down], table[along], map(float, slopes), strict=True)
    ]
    values = {name: table[name].to_numpy() for name in (down, along, column)}
    return Marks(axes, table[along].to_numpy(), table[down].to_numpy(), walker, values, commands=commands)
