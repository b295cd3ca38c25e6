"""Maps: a quantity over two axes of a design, and where starts end up."""

from __future__ import annotations

import itertools

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap

from pipeline.report.figures.style import (
    RASTER,
    SHAPES,
    brief,
    canvas,
    heading,
    log_axis,
    places,
    plain,
    rows_of,
    thin,
    told,
)
from pipeline.report.figures.svg import Marks, Sketch
from pipeline.report.source import SYMBOLS, Source

#: What a map shows, the first that the archive holds.
_SHOWN = ("speed", "froude_speed", "stance_angle", "period", "spectral_radius")

#: Places on other axes than the map's that are drawn, a row each.
_ROWS = 4

#: Outcomes that are neither a gait nor a fall, and falls: quiet, so that what walks stands out.
_OUTCOMES, _FELL = ("#b8a23a", "#9a74c4", "#4a9c74"), ("#8d939940", "#8d939980", "#8d9399c0")


def heatmap(source: Source) -> Sketch | None:
    """A quantity of each gait over two axes, with the border of stability; a row of maps a place on others."""
    grid = source.grid
    wide = [d for d in source.axes if d != "walker" and grid.sizes[d] > 1][:2]
    variable = next((v for v in _SHOWN if v in grid), None)
    if len(wide) < 2 or variable is None:
        return None
    down, along = wide
    rest = [d for d in source.axes if d not in wide]
    every = [dict(zip(rest, place, strict=True)) for place in itertools.product(*(grid[d].values for d in rest))]
    rows = rows_of(every, _ROWS)
    several = [{d: v for d, v in at.items() if grid.sizes[d] > 1} for at in rows]
    shown = {g: [grid.sel(at).sel(gait=g) for at in rows] for g in source.gaits}
    found = [g for g, here in shown.items() if any(np.isfinite(one[variable]).any() for one in here)]
    if not (gaits := found[:2]):
        return None
    unseen = f" Not drawn: {', '.join(found[2:])}." if len(found) > 2 else ""
    figure = canvas(260 if len(rows) == 1 else 60 + 150 * len(rows))
    panels = figure.subplots(len(rows), len(gaits), sharex=True, sharey=True, squeeze=False)
    known = np.array([one[variable].values for g in gaits for one in shown[g]])
    low, high = np.nanmin(known), np.nanmax(known)
    pieces, marks = [], []
    for k, (at, words) in enumerate(zip(rows, several, strict=True)):
        fixed = dict(at)
        walker = str(fixed.pop("walker", source.walker))
        for axes, gait in zip(panels[k], gaits, strict=True):
            here = shown[gait][k].transpose(down, along, ...)
            x, y, z = here[along].values, here[down].values, here[variable].values
            picture = axes.pcolormesh(x, y, z, shading="nearest", cmap="cividis", vmin=low, vmax=high, rasterized=True)
            _border(axes, here, x, y)
            _scales(axes, x, y)
            axes.grid(False)
            axes.set_title(brief(", ".join(filter(None, (f"{gait} step", told(words)))), 60 // len(gaits)), pad=5)
            frame = here[[v for v in (variable, "spectral_radius") if v in here]].to_dataframe().reset_index()
            frame = frame[[c for c in dict.fromkeys((down, along, variable, "spectral_radius")) if c in frame]]
            pieces.append(frame.assign(gait=gait, **words))
            finite = frame.dropna(subset=[variable])
            marks += _spots(axes, source, finite, gait, walker, (down, along, variable), fixed)
        panels[k][0].set_ylabel(_named(source, down) if len(rows) == 1 else SYMBOLS.get(down, down.replace("_", " ")))
    for axes in panels[-1]:
        axes.set_xlabel(_named(source, along))
    bar = figure.colorbar(picture, ax=list(panels.ravel()), shrink=0.9, aspect=24)
    bar.outline.set_visible(False)
    bar.ax.grid(False)
    bar.set_label(_named(source, variable))
    data = pd.concat(pieces, ignore_index=True)
    border = "spectral_radius" in grid
    return Sketch(
        figure,
        f"Map of {variable.replace('_', ' ')}",
        f"{_named(source, variable).capitalize()} over {_named(source, along)} and {_named(source, down)}. "
        "Left blank: no such gait."
        + (" White line: the border of stability, max |λ| = 1." if border else "")
        + unseen
        + places(several, every),
        f"Heat map of {variable} over {along} and {down}, from {plain(low)} to {plain(high)}." + places(several, every),
        data,
        marks,
    )


def _border(axes: Axes, here, x: np.ndarray, y: np.ndarray) -> None:
    if "spectral_radius" not in here or min(len(x), len(y)) < 2:
        return
    radius = here["spectral_radius"].values
    if np.nanmin(radius, initial=np.inf) < 1 < np.nanmax(radius, initial=-np.inf):
        axes.contour(x, y, np.ma.masked_invalid(radius), levels=[1.0], colors="#ffffff", linewidths=1.6)


def _scales(axes: Axes, x: np.ndarray, y: np.ndarray) -> None:
    """Logarithmic where the axis' points are evenly spaced so."""
    for which, values in (("x", x), ("y", y)):
        if len(values) > 2 and (values > 0).all() and values[-1] / values[0] > 30:
            log_axis(axes, which)


def _spots(
    axes: Axes, source: Source, frame: pd.DataFrame, gait: str, walker: str, names: tuple[str, str, str], fixed: dict
) -> list[Marks]:
    """Hover targets, each with the whole command: every point of a map is another line."""
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


def _named(source: Source, name: str) -> str:
    known = source.grid.variables.get(name)
    unit = source.units(name)
    words = str(known.attrs.get("long_name", "")) if known is not None else ""
    words = words if words and len(words) < 34 else name.replace("_", " ")
    symbol = SYMBOLS.get(name, "")
    return " ".join(p for p in (words, symbol, f"({unit})" if unit else "") if p)


def _lost(outcome: str) -> bool:
    """Whether a start does not come to walk."""
    return outcome.startswith(("fell", "foot", "no ", "-1"))


def _column(table: pd.DataFrame, name: str) -> str:
    """A column in words, with its symbol and unit."""
    unit = table.attrs.get("units", {}).get(name, "1")
    return " ".join(filter(None, (name.replace("_", " "), SYMBOLS.get(name), f"({unit})" if unit != "1" else "")))


def basin(source: Source) -> Sketch | None:
    """Where each start ends: starts as points over their first two coordinates, coloured by outcome."""
    table = source.tables.get("basin")
    if table is None or "outcome" not in table or table.empty:
        return None
    taken = {*source.line_columns(table), "outcome", "slope", "steps"}
    plane = [c for c in table.columns if c not in taken and table[c].dtype.kind == "f" and table[c].nunique() > 1][:2]
    if len(plane) < 2:
        return None
    figure = canvas(300)
    axes = figure.add_subplot()
    outcomes = sorted({str(o) for o in table["outcome"]}, key=lambda o: (_lost(o), o))
    others, falls = itertools.cycle(_OUTCOMES), itertools.cycle(_FELL)
    inks = [next(falls) if _lost(o) else RASTER[o] if o in RASTER else next(others) for o in outcomes]
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
        axes.scatter([], [], s=40, marker="s", lw=0, color=ink, label=brief(outcome.replace("_", " ")))
    axes.grid(False)
    axes.set_xlabel(_column(table, plane[0]))
    heading(axes, _column(table, plane[1]))
    figure.legend(loc="outside upper left", ncols=3)
    shown = thin(table, 400)
    marks = [
        Marks(
            axes,
            shown[plane[0]].to_numpy(),
            shown[plane[1]].to_numpy(),
            "start",
            {
                plane[0]: shown[plane[0]].to_numpy(),
                plane[1]: shown[plane[1]].to_numpy(),
                "outcome": shown["outcome"].astype(str).to_numpy(),
            },
        )
    ]
    return Sketch(
        figure,
        "Basin of attraction",
        "Starts coloured by what becomes of them; grey ones do not come to walk.",
        f"Map of {len(table)} starts over {plane[0]} and {plane[1]}, coloured by outcome: {', '.join(outcomes)}.",
        table,
        marks,
    )
