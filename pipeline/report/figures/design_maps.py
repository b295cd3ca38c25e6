"""Design maps: the best gaits of each walker over two of its keys."""

import itertools
from collections.abc import Sequence
from textwrap import fill
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from gaitsweep.pipeline.report.figures.maps import draw_map
from gaitsweep.pipeline.report.figures.sketch import Panel, Sketch
from gaitsweep.pipeline.report.figures.starts import START, cells
from gaitsweep.pipeline.report.figures.style import (
    add_bar,
    choose_rows,
    on_map,
    set_title,
)
from gaitsweep.pipeline.report.source import Source, rows_at
from gaitsweep.pipeline.report.words import (
    SYMBOLS,
    WORDS,
    axis_values,
    plain,
    shorten,
    spaced,
    with_unit,
)


class Mapped(NamedTuple):
    """A quantity that is mapped.

    `title` and what a cell is called; the column of its gait's slope, and the ending of
    those of its state; the factor by which the slope of a cell lies beside the border
    that it is, so that its digits do not exceed it.
    """

    title: str
    cell: str
    slope: str
    ending: str
    inside: float


#: Quantities mapped, from left to right.
MAPPED = {
    name: Mapped(**mapped)
    for name, mapped in WORDS["figures"]["design"]["maps"].items()
}
#: Columns of the figure's data, besides the keys.
_DATA = (*MAPPED, "smallest_at", "stability_lost_by", "fastest_slope")
#: Values of derived keys at which walkers lie that have a name: of `detuning` those
#: that it leads from and to.
_NAMED = {"detuning": (0.0, 1.0)}
#: Extent of contours that have a label, over that of the map.
_LABELLED = 0.2
#: Letters of a line of a map's title, which does not reach the next on a phone, where
#: words are larger.
_TITLE = 18
#: Fewest cells along each side of a map on which contours are drawn.
_MIN_CONTOURED = 6


class _Maps(NamedTuple):
    """A table of designs over two keys, down and across, with the places of its rows of
    maps and their names.
    """

    table: pd.DataFrame
    down: str
    along: str
    rows: list[dict[str, Any]]
    names: list[str]
    more: str


def design(source: Source, table: pd.DataFrame) -> Sketch | None:
    """Map smallest slope, largest stable slope and fastest stable speed over two keys,
    one row per walker.
    """
    columns = source.line_columns(table)
    varied = [c for c in columns if c != "walker" and table[c].nunique() > 1]
    if len(varied) < 2:
        return None

    down, along = varied[:2]
    data = _maps(table, columns, down, along)
    count = len(data.rows)
    shape = (count, len(MAPPED))
    sketch = Sketch("design", 112 + 150 * count, *shape, sharex=True, sharey=True)
    marked = [_draw_row(sketch, source, data, k) for k in range(count)]
    _add_titles(sketch, _symbol(source, along))

    return sketch.finish(
        table[[*columns, *(c for c in _DATA if c in table)]],
        down=down,
        along=along,
        circles=_named(source, down, along) if any(marked) else "",
        blank=bool(table[[*MAPPED]].isna().any(axis=None)),
        more=data.more,
        ranges=_ranges(table),
        best=_best(source, table, (down, along)),
    )


def _maps(table: pd.DataFrame, columns: list[str], down: str, along: str) -> _Maps:
    """The maps over two of the columns of lines, a row for each place on the others."""
    others = [column for column in columns if column not in (down, along)]
    places: list[Any] = [{}]
    if others:
        places = table[others].drop_duplicates().to_dict("records")
    return _Maps(table, down, along, *choose_rows(places))


def _add_titles(sketch: Sketch, along: str) -> None:
    """Add titles of the columns of maps, of their axes, and their scales of colours."""
    for axes, mapped in zip(sketch.grid[0], MAPPED.values(), strict=True):
        # From the left, where lines stay one below the other at any size.
        set_title(axes, fill(mapped.title, _TITLE), x=0, ha="left", pad=5)
    for axes, column in zip(sketch.grid[-1], sketch.grid.T, strict=True):
        axes.set_xlabel(along)
        axes.xaxis.set_major_locator(MaxNLocator(5))
        bar = add_bar(axes.collections[0], list(column), location="bottom")
        bar.ax.xaxis.set_major_locator(MaxNLocator(4))


def _draw_row(sketch: Sketch, source: Source, data: _Maps, k: int) -> bool:
    """Draw the maps of a row; whether a walker with a name is marked on them."""
    at = data.rows[k]
    part = rows_at(data.table, at)
    walker = source.walkers.get(str(at.get("walker", source.walker)), {})
    is_marked = False
    for axes, (column, mapped) in zip(sketch.grid[k], MAPPED.items(), strict=True):
        values = part.pivot(index=data.down, columns=data.along, values=column)
        picture = draw_map(axes, values, data.table[column])
        _draw_contours(axes, values, *picture.get_clim())
        _add_cells(sketch, source, data, k, (axes, column, mapped), values)
        is_marked = _mark_walkers(axes, walker, data.down, data.along) or is_marked

    name = f"{shorten(data.names[k], 22)}: " if data.names[k] else ""
    sketch.grid[k][0].set_ylabel(name + _symbol(source, data.down))
    return is_marked


def _add_cells(
    sketch: Sketch,
    source: Source,
    data: _Maps,
    k: int,
    place: tuple[Axes, str, Mapped],
    values: pd.DataFrame,
) -> None:
    """Add the gaits of the cells of a map, where the archive holds their states."""
    axes, column, mapped = place
    part = rows_at(data.table, data.rows[k])
    columns = _gait_columns(part, column)
    if not columns:
        return

    grids = {
        name: part.pivot(index=data.down, columns=data.along, values=own)
        for name, own in columns.items()
    }
    grids["slope"] *= mapped.inside
    told = [name for name in ("slope", "froude_speed") if name in grids]
    shown = (data.down, data.along, *told)
    held = cells(source, data.rows[k], grids, shown, sketch.grid.size, mapped.cell)
    sketch.maps.append(Panel(axes, values, held))


def _ranges(table: pd.DataFrame) -> str:
    """The range of each quantity, for those who do not see the maps."""
    parts = []
    for column in MAPPED:
        low, high = table[column].min(), table[column].max()
        parts.append(f"{spaced(column)} from {plain(low)} to {plain(high)}")
    return "; ".join(parts)


def _best(source: Source, table: pd.DataFrame, keys: Sequence[str]) -> str:
    """The smallest slope, the largest and the highest speed of the maps, where they are
    found, and whether that is on their border: then it is no extreme of the walkers.
    """
    parts = []
    for column, mapped in MAPPED.items():
        values = table[column].dropna()
        if values.empty:
            continue

        is_least = mapped.slope == "smallest_slope"
        best = table.loc[values.idxmin() if is_least else values.idxmax()]
        at = {name: best[name] for name in source.line_columns(table)}
        where = axis_values(at)
        borders = [
            key for key in keys if best[key] in (min(table[key]), max(table[key]))
        ]
        if borders:
            where += ": on the map's border"
        parts.append(f"{mapped.title}: {plain(best[column])} ({where})")

    text = ". ".join(part[0].upper() + part[1:] for part in parts)
    return text or "No design walks"


def _draw_contours(axes: Axes, z: pd.DataFrame, low: float, high: float) -> None:
    """Draw contours of a map, with labels, in inks that stand out from its colours."""
    if min(z.shape) >= _MIN_CONTOURED and np.isfinite(z.to_numpy()).any():
        inner = np.ma.masked_invalid(z.to_numpy())
        levels = MaxNLocator(8, steps=[1, 2, 2.5, 5, 10]).tick_values(
            inner.min(), inner.max()
        )
        inks = [on_map(level, low, high) for level in levels]
        drawn = axes.contour(
            z.columns, z.index, inner, levels=levels, colors=inks, linewidths=0.7
        )
        curves = [
            max(parts, key=len) for parts in drawn.allsegs if sum(map(len, parts))
        ]
        # Labels in the middle of the curves, where they fit, not in a row.
        middles = [
            curve[int(len(curve) * (0.4 + 0.2 * (k % 2)))]
            for k, curve in enumerate(curves)
            if _fits(curve, z)
        ]
        axes.clabel(
            drawn,
            fmt=lambda level: plain(level),
            fontsize=7,
            inline_spacing=2,
            manual=middles,
        )


def _fits(curve: np.ndarray, z: pd.DataFrame) -> bool:
    """Whether a contour (n, 2) is long enough, and far enough from the map's sides, for
    a label.
    """
    sides = np.array(
        [[z.columns.min(), z.columns.max()], [z.index.min(), z.index.max()]]
    )
    spans = np.ptp(sides, axis=1)
    distance = np.abs(curve[len(curve) // 2] - sides.T).min(axis=0) / spans

    return bool(
        (np.ptp(curve, axis=0) / spans).max() > _LABELLED
        and distance.min() > 0.25 * _LABELLED
    )


def _named(source: Source, down: str, along: str) -> str:
    """What the circles of a map mark."""
    start, end = source.detuning_ends
    return (
        f"{start} (detuning 0) and {end} (1)"
        if {down, along} & set(_NAMED)
        else "the walker itself"
    )


def _mark_walkers(
    axes: Axes, parameters: dict[str, Any], down: str, along: str
) -> bool:
    """Mark the places of walkers that have a name, before the axes change them; whether
    any lie on the map.
    """
    places = [
        _NAMED[key]
        if key in _NAMED
        else (parameters[key],)
        if key in parameters
        else ()
        for key in (along, down)
    ]
    limits = axes.get_xlim(), axes.get_ylim()
    # A map that begins one cell beside a walker is drawn up to it.
    reach, is_marked = [0.02 * (high - low) for low, high in limits], False
    for x, y in itertools.product(*(map(float, place) for place in places)):
        if all(
            low - r <= v <= high + r
            for v, (low, high), r in zip((x, y), limits, reach, strict=True)
        ):
            is_marked = True
            for colour, width in (("#ffffff", 2.2), ("#000000", 0.9)):
                axes.plot(
                    [x],
                    [y],
                    "o",
                    color=colour,
                    mfc="none",
                    ms=8,
                    mew=width,
                    clip_on=False,
                    zorder=5,
                )

    axes.set_xlim(*limits[0])
    axes.set_ylim(*limits[1])
    return is_marked


def _gait_columns(table: pd.DataFrame, column: str) -> dict[str, str]:
    """Columns of the gaits that have a quantity, by those of a start; none where the
    archive lacks them.
    """
    mapped = MAPPED[column]
    states = {
        name: f"{name}{mapped.ending}"
        for name in START[1:]
        if f"{name}{mapped.ending}" in table
    }
    speed = {} if column == mapped.slope else {"froude_speed": column}

    return (
        {**states, "slope": mapped.slope, **speed}
        if set(START[1:4]) <= set(states)
        else {}
    )


def _symbol(source: Source, key: str) -> str:
    return with_unit(SYMBOLS.get(key, key), source.units(key))
