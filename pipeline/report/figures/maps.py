"""Maps of a quantity over two axes, and of the outcomes of initial conditions."""

import itertools
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.patches import Rectangle

from gaitsweep.pipeline.report.figures import fields
from gaitsweep.pipeline.report.figures.sketch import Panel, Sketch
from gaitsweep.pipeline.report.figures.slices import axes_of
from gaitsweep.pipeline.report.figures.starts import START, cells, parameters
from gaitsweep.pipeline.report.figures.style import (
    INK,
    LINE,
    RASTER,
    SHAPES,
    VARIABLES,
    WALKERS,
    add_bar,
    choose_rows,
    hatch,
    set_heading,
    set_log,
    set_title,
)
from gaitsweep.pipeline.report.source import Source, rows_at
from gaitsweep.pipeline.report.words import (
    SYMBOLS,
    axis_values,
    plain,
    print_units,
    shorten,
    spaced,
    symbol,
    titled,
)

#: Quantities that a map may show: the first that the archive holds.
_SHOWN = ("speed", "froude_speed", "stance_angle", "period", "spectral_radius")

#: Colours of outcomes other than gaits and falls, and of falls: muted, so that gaits
#: stand out, and of different hues, so that they can be distinguished on light and dark
#: pages.
_OTHER_COLOURS, _FALL_COLOURS = (
    ("#b8a23a", "#9a74c4", "#4a9c74"),
    ("#8fa3b866", "#b59a8566", "#6c8f6c99", "#8d9399cc"),
)


class _Maps(NamedTuple):
    """A quantity of gaits over two axes: a map for each gait and each place on the
    other axes.

    Attributes
    ----------
    variable : str
        The quantity.
    down, along : str
        The axes.
    columns, states : list of str
        The variables whose values a cell tells, and those of the state from which its
        gait walks.
    rows : list of dict
        Places on the other axes, a row of maps each; `names` are their words, and
        `more` says how many there are beside them.
    gaits : list of str
        Those that are drawn; `omitted` are the others that there are.
    parts : dict
        Of each gait a table for each row.
    """

    variable: str
    down: str
    along: str
    columns: list[str]
    states: list[str]
    rows: list[dict[str, Any]]
    names: list[str]
    more: str
    gaits: list[str]
    omitted: list[str]
    parts: dict[str, list[pd.DataFrame]]

    @property
    def shown(self) -> pd.Series:
        """All values that are drawn."""
        drawn = [
            part[self.variable] for gait in self.gaits for part in self.parts[gait]
        ]
        return pd.concat(drawn)

    def grids(self, part: pd.DataFrame) -> dict[str, pd.DataFrame]:
        """A table's variables over the two axes."""
        return {
            name: part.pivot(index=self.down, columns=self.along, values=name)
            for name in (*self.columns, *self.states)
        }


def heatmap(source: Source) -> Sketch | None:
    """Map a quantity of each gait over two axes, with the border of stability; one row
    per value of other axes.
    """
    maps = _maps(source)
    if maps is None:
        return None

    rows = len(maps.rows)
    height = 260 if rows == 1 else 60 + 150 * rows
    sketch = Sketch("heatmap", height, rows, len(maps.gaits), sharex=True, sharey=True)
    shown = maps.shown
    for row in range(rows):
        for column in range(len(maps.gaits)):
            picture = _draw_cell_map(sketch, source, maps, row, column, shown)

    titles = [
        _axis_title(source, name) for name in (maps.variable, maps.along, maps.down)
    ]
    for axes in sketch.grid:
        axes[0].set_ylabel(titles[2] if rows == 1 else symbol(maps.down))
    add_bar(picture, sketch.panels).set_label(titles[0])
    has_blanks = any(panel.values.isna().any(axis=None) for panel in sketch.maps)
    words = _words_of_maps(source, maps, titles, shown)
    return sketch.finish(blank=has_blanks, **words)


def _maps(source: Source) -> _Maps | None:
    """What there is to map; None if there is no plane of a quantity."""
    grid = source.grid
    wide = [d for d in source.axes if d != "walker" and grid.sizes[d] > 1][:2]
    quantities = [name for name in _SHOWN if name in grid]
    if len(wide) < 2 or not quantities:
        return None

    variable = quantities[0]
    columns = [v for v in dict.fromkeys((variable, "spectral_radius")) if v in grid]
    states = _states(source)
    table = _sorted(source, wide, [*dict.fromkeys((*columns, *states))])
    rows, names, more = choose_rows(_places_beside(source, wide))

    parts = _parts(source, table, variable, rows)
    if not parts:
        return None

    down, along = wide
    drawn, omitted = [*parts][:2], [*parts][2:]

    return _Maps(
        variable, down, along, columns, states, rows, names, more, drawn, omitted, parts
    )


def _parts(
    source: Source, table: pd.DataFrame, variable: str, rows: list[dict[str, Any]]
) -> dict[str, list[pd.DataFrame]]:
    """Of each gait that there is, its part of a table at each place."""
    parts = {}
    for gait in source.gaits:
        of_gait = table[table["gait"] == gait]
        of_rows = [rows_at(of_gait, at) for at in rows]
        if any(np.isfinite(part[variable]).any() for part in of_rows):
            parts[gait] = of_rows
    return parts


def _sorted(source: Source, wide: list[str], names: list[str]) -> pd.DataFrame:
    """A table of variables, along two axes, which may fall, in rising order."""
    return source.grid.sortby(wide)[names].to_dataframe().reset_index()


def _states(source: Source) -> list[str]:
    """Variables of the state from which a cell's gait walks, if they are all there."""
    if source.steps > 1:
        return []
    states = [name for name in START[1:] if name in source.grid]
    return states if set(START[1:4]) <= set(states) else []


def _places_beside(source: Source, wide: list[str]) -> list[dict[str, Any]]:
    """All places on the axes that are not those of a map."""
    rest = [d for d in source.axes if d not in wide]
    places = itertools.product(*(source.grid[d].values for d in rest))
    return [dict(zip(rest, place, strict=True)) for place in places]


def _draw_cell_map(
    sketch: Sketch, source: Source, maps: _Maps, row: int, column: int, shown: pd.Series
) -> Any:
    """Draw the map of a gait at a place on the other axes; `shown` are the values of
    all maps. Returns its picture.
    """
    axes, gait = sketch.grid[row][column], maps.gaits[column]
    at, part = maps.rows[row], maps.parts[gait][row]
    grids = maps.grids(part)
    values = grids[maps.variable]
    _set_scales(axes, values)
    picture = draw_map(axes, values, shown)
    _draw_stability_border(axes, grids.get("spectral_radius"))
    title = ", ".join(filter(None, (f"{gait} step", maps.names[row])))
    set_title(axes, shorten(title, 60 // len(maps.gaits)), pad=5)

    named = (maps.down, maps.along, *maps.columns)
    fixed = {d: value for d, value in at.items() if source.grid.sizes[d] > 1}
    sketch.pieces.append(part[[*named]].assign(gait=gait, **fixed))
    held = cells(source, at, grids, named, _share(sketch, source), f"{gait} step")
    sketch.maps.append(Panel(axes, values, held))
    return picture


def _share(sketch: Sketch, source: Source) -> int:
    """Among how many maps the room of a figure is shared; slices take as much as all."""
    return int(sketch.grid.size) * (2 if axes_of(source) else 1)


def _words_of_maps(
    source: Source, maps: _Maps, titles: list[str], shown: pd.Series
) -> dict[str, Any]:
    """What the caption of maps says, by the titles of quantity and axes."""
    quantity, x_title, y_title = titles
    return {
        "quantity": spaced(maps.variable),
        "Quantity": quantity.capitalize(),
        "variable": maps.variable,
        "x": x_title,
        "y": y_title,
        "along": maps.along,
        "down": maps.down,
        "border": "spectral_radius" in source.grid,
        "omitted": ", ".join(maps.omitted),
        "more": maps.more,
        "rows": f" {maps.more}" if maps.more else "",
        "low": shown.min(),
        "high": shown.max(),
    }


def draw_map(axes: Axes, values: pd.DataFrame, every: pd.Series) -> Any:
    """Draw numbers over two keys as cells; all maps of `every` value share one scale of
    colours.
    """
    x, y = values.columns.to_numpy(float), values.index.to_numpy(float)
    sides = _edges(x, axes.get_xscale()), _edges(y, axes.get_yscale())
    low, high = (every.min(), every.max()) if every.notna().any() else (0.0, 1.0)
    hatch(axes)

    return axes.pcolormesh(
        *sides,
        values.to_numpy(float),
        cmap="cividis",
        vmin=low,
        vmax=high,
        rasterized=True,
    )


def _draw_stability_border(axes: Axes, radius: pd.DataFrame | None) -> None:
    """Draw the contour max |λ| = 1 where it crosses the map."""
    if radius is not None and radius.min().min() < 1 < radius.max().max():
        for ink, width in (("#101418", 3.0), ("#ffffff", 1.4)):
            inner = np.ma.masked_invalid(radius.to_numpy())
            axes.contour(
                radius.columns,
                radius.index,
                inner,
                levels=[1.0],
                colors=ink,
                linewidths=width,
            )


def _set_scales(axes: Axes, grid: pd.DataFrame) -> None:
    """Make axes that span more than a factor of 30 logarithmic."""
    for which, values in (("x", grid.columns), ("y", grid.index)):
        if len(values) > 2 and (values > 0).all() and values[-1] / values[0] > 30:
            set_log(axes, which)


def _edges(values: np.ndarray, scale: str) -> np.ndarray:
    """Borders (n + 1,) of cells around values (n,), halfway between them on the axis's
    scale.
    """
    places = np.log(values) if scale == "log" else values
    middles = 0.5 * (places[1:] + places[:-1])
    borders = np.concatenate(
        [[2 * places[0] - middles[0]], middles, [2 * places[-1] - middles[-1]]]
    )
    return np.asarray(np.exp(borders) if scale == "log" else borders)


def _axis_title(source: Source, name: str) -> str:
    words = (
        str(source.grid[name].attrs.get("long_name", ""))
        if name in source.grid.variables
        else ""
    )
    return titled(name, source.units(name), words if len(words) < 34 else "")


def _is_fall(outcome: str) -> bool:
    """Whether an outcome is a fall, or no step at all."""
    return outcome.startswith(("fell", "motion lost", "no ", "-1")) or outcome.endswith(
        "never struck"
    )


def _column(table: pd.DataFrame, name: str) -> str:
    """A column's name in words, with its symbol and unit."""
    return titled(name, print_units(table.attrs.get("units", {}).get(name, "1")))


class _Basin(NamedTuple):
    """Outcomes of initial conditions over a plane, those of one slope and line: colours
    of the outcomes, ranges of the enlarged part, gaits and manifold.
    """

    shown: pd.DataFrame
    plane: list[str]
    first: dict[str, Any]
    inks: dict[str, str]
    window: list[tuple[float, float]]
    gaits: pd.DataFrame
    manifold: pd.DataFrame


def basin(source: Source, table: pd.DataFrame) -> Sketch | None:
    """Map the outcome of each initial condition over its first two coordinates, whole
    and around the gaits.
    """
    plane = _plane(source, table)
    if len(plane) < 2:
        return None

    data = _outcomes_over(source, table.astype({"outcome": str}), plane)
    start = _motion(source, data.shown)
    sketch = Sketch("basin", 330 if data.window else 380, 1, 1 + bool(data.window))
    _draw_basin(sketch, data)
    _enlarge(sketch, data)
    _legend_of_basin(sketch, data)

    # With knees the rates are those before heelstrike, for which θ̇* does not stand.
    is_kneed = bool(start and start["keys"]["knees"])
    upward = _column(table, plane[1])
    if is_kneed:
        upward = upward.replace(f" {SYMBOLS['stance_rate']}", "")
    set_heading(sketch.panels[0], upward)
    sketch.maps = _cells_of_basin(sketch, data, start)

    return sketch.finish(
        table,
        x=_column(table, plane[0]),
        count=len(data.shown),
        plane=" and ".join(map(symbol, plane)),
        outcomes=", ".join(data.inks),
        **_areas(source, data),
        saddles=" and ".join(sorted(set(data.manifold["gait"].astype(str)))),
        # The plane of a section of three coordinates in which the initial conditions
        # lie.
        ratio=start.get("ratio"),
        when="before" if is_kneed else "after",
        only=axis_values(data.first),
    )


def _plane(source: Source, table: pd.DataFrame) -> list[str]:
    """The first two coordinates of initial conditions that vary, the stance angle
    first.
    """
    others = {*source.line_columns(table), "outcome", "slope", "steps", "swing_rate"}
    others.add(source.along)
    known = [
        c
        for c in table.columns
        if c not in others and table[c].dtype.kind == "f" and table[c].nunique() > 1
    ]
    return sorted(known, key=lambda name: name != "stance_angle")[:2]


def _outcomes_over(source: Source, table: pd.DataFrame, plane: list[str]) -> _Basin:
    """The outcomes of the first line and slope of a table."""
    columns = [*source.line_columns(table), source.along]
    same = [c for c in columns if c in table and table[c].nunique() > 1]
    first = table[same].iloc[0].to_dict() if same else {}
    shown = rows_at(table, first)

    others = itertools.cycle(_OTHER_COLOURS)
    falls = itertools.cycle(_FALL_COLOURS)
    inks = {}
    for outcome in sorted(set(shown["outcome"]), key=lambda o: (_is_fall(o), o)):
        own = next(falls) if _is_fall(outcome) else RASTER.get(outcome)
        inks[outcome] = own or next(others)

    walking = shown[~shown["outcome"].map(_is_fall)]
    is_wide = all(walking[name].nunique() > 1 for name in plane)
    is_small = is_wide and len(walking) < 0.3 * len(shown)
    window = _window(walking, plane) if is_small else []
    gaits = _points(source, "fixed_points", first, plane)
    manifold = _points(source, "stable_manifold", first, plane)
    return _Basin(shown, plane, first, inks, window, gaits, manifold)


def _draw_basin(sketch: Sketch, data: _Basin) -> None:
    """Draw outcomes, gaits and manifold in each panel."""
    plane = data.plane
    widths = (0.8, 1.6) if data.window else (1.6,)
    for axes, width in zip(sketch.panels, widths, strict=True):
        _draw_outcomes(
            axes, data.shown, plane, list(data.inks), list(data.inks.values())
        )
        for row in data.gaits.itertuples():
            marker, fill = ("o", INK) if row.gait in data.inks else ("X", "#ffffff")
            place = (getattr(row, c) for c in plane)
            axes.plot(*place, marker, color=INK, mfc=fill, ms=6, mew=1, zorder=5)

        across, upward = (data.manifold[name].to_numpy() for name in plane)
        _draw_dots(axes, across, upward, width)
        axes.grid(False)


def _enlarge(sketch: Sketch, data: _Basin) -> None:
    """Enlarge a window in the second panel, and frame it in the first."""
    if not data.window:
        return

    whole, part = sketch.panels
    (left, right), (low, high) = data.window
    part.set_xlim(left, right)
    part.set_ylim(low, high)
    set_heading(part, "enlarged")
    frame = Rectangle((left, low), right - left, high - low, fill=False, ec=INK, lw=0.9)
    whole.add_patch(frame)


def _legend_of_basin(sketch: Sketch, data: _Basin) -> None:
    """Add outcomes, gaits and manifold to the legend."""
    for outcome, ink in data.inks.items():
        sketch.dot_key(shorten(spaced(outcome)), ink, "s", ms=7)
    if len(data.gaits):
        sketch.dot_key("stable gait", mfc=INK)
        sketch.dot_key("unstable gait", marker="X", mfc="#ffffff")
    if len(data.manifold):
        sketch.key("stable manifold", ls=":", lw=2)


def _cells_of_basin(sketch: Sketch, data: _Basin, start: dict[str, Any]) -> list[Panel]:
    """Every cell names its outcome and, with a start, is set in motion; first of all
    one that walks, in the middle of those.
    """
    grid = data.shown.pivot_table(
        index=data.plane[1], columns=data.plane[0], values="outcome", aggfunc="first"
    )
    outcomes = grid.fillna("–").to_numpy(str)
    called: dict[str, Any] = {
        "label": "initial condition",
        "shown": [[symbol(name), name] for name in (*data.plane, "outcome")],
    }
    walks = np.argwhere(~np.vectorize(_is_fall)(outcomes) & (outcomes != "–"))
    if len(walks):
        apart = np.abs(walks - np.median(walks, axis=0)).sum(axis=1)
        row, column = walks[apart.argmin()]
        called["first"] = [int(column), int(row)]

    words = {"outcome": fields.words(outcomes)}
    every = {"free": True, **start, **called, "fields": words}
    return [Panel(axes, grid, every) for axes in sketch.panels]


def _areas(source: Source, data: _Basin) -> dict[str, str]:
    """The areas of the basins that lie within the window, with their standard errors,
    and the names of those that it cuts.
    """
    table = source.table("areas", "outcome", "area", "standard_error")
    if table is None:
        return {}

    edge = np.zeros(len(data.shown), bool)
    for name in data.plane:
        values = data.shown[name]
        edge |= values.isin([values.min(), values.max()]).to_numpy()

    reaching = set(data.shown["outcome"][edge])

    rows = rows_at(table, data.first)
    rows = rows[~rows["outcome"].astype(str).map(_is_fall)]
    is_cut = rows["outcome"].astype(str).isin(reaching)
    areas = [
        f"{spaced(row.outcome)} {plain(row.area, 3)} ± {plain(row.standard_error, 1)}"
        for row in rows[~is_cut].itertuples()
    ]
    cut = [spaced(outcome) for outcome in rows["outcome"][is_cut]]
    return {"areas": "; ".join(areas), "cut": " and ".join(cut)}


def _motion(source: Source, table: pd.DataFrame) -> dict[str, Any]:
    """What the script needs to start any initial condition: the line, its slope and the
    ratio of the rates.
    """
    row = table.iloc[0]
    at = source.line_of(table)
    if source.along in row and source.along != "slope":
        at[source.along] = float(row[source.along])
        at.pop("slope", None)

    if not (keys := parameters(source, at)) or "slope" not in row:
        return {}

    start: dict[str, Any] = {
        "slope": float(row["slope"]),
        "ink": VARIABLES[WALKERS.get(str(at["walker"]), LINE)],
    }
    if np.isfinite(row.get("swing_rate", np.nan)):
        start["ratio"] = float(row["swing_rate"] / row["stance_rate"])
    return {"at": at, "keys": keys, "command": source.command(at), **start}


def _draw_outcomes(
    axes: Axes,
    table: pd.DataFrame,
    plane: list[str],
    outcomes: list[str],
    inks: list[str],
) -> None:
    """Draw outcomes as cells where the initial conditions are a grid, else as dots."""
    which = table["outcome"].map(outcomes.index).astype(float)
    if len(table) != table[plane[0]].nunique() * table[plane[1]].nunique():
        colours, raster = [inks[int(w)] for w in which], len(table) > SHAPES
        axes.scatter(
            table[plane[0]], table[plane[1]], s=4, lw=0, c=colours, rasterized=raster
        )
        return

    z = table.assign(which=which).pivot(
        index=plane[1], columns=plane[0], values="which"
    )
    how: Any = {
        "cmap": ListedColormap(inks),
        "vmin": -0.5,
        "vmax": len(inks) - 0.5,
        "rasterized": True,
    }
    axes.pcolormesh(z.columns, z.index, z.values, shading="nearest", **how)


def _window(walking: pd.DataFrame, plane: list[str]) -> list[tuple[float, float]]:
    """Ranges that hold the middle half of the walking initial conditions, with a
    margin.
    """
    ranges = []
    for name in plane:
        low, high = np.quantile(
            walking[name], [0.05, 0.75] if walking[name].mean() > 0 else [0.25, 0.95]
        )
        ranges.append((low - 0.08 * (high - low), high + 0.08 * (high - low)))
    return ranges


def _draw_dots(axes: Axes, x: np.ndarray, y: np.ndarray, width: float) -> None:
    """Draw points as dots of one path, which takes a fifth of the room of as many
    markers.
    """
    lines = np.full((2, 3 * len(x)), np.nan)
    lines[:, ::3] = lines[:, 1::3] = x, y
    (dots,) = axes.plot(
        *lines,
        "-",
        color=INK,
        lw=width,
        solid_capstyle="round",
        zorder=4,
        scalex=False,
        scaley=False,
    )
    dots.get_path().should_simplify = False


def _points(
    source: Source, name: str, first: dict[str, Any], plane: list[str]
) -> pd.DataFrame:
    """Points of a table on the line and at the slope drawn, in the coordinates of the
    map.
    """
    table = source.table(name, "gait", *plane)
    return (
        pd.DataFrame(columns=["gait", *plane])
        if table is None
        else rows_at(table, first)
    )
