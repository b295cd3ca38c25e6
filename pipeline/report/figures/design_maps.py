"""Design maps: the best gaits of each walker over two of its keys."""

import itertools
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from gaitsweep.pipeline.report.figures.maps import draw_map
from gaitsweep.pipeline.report.figures.sketch import Panel, Sketch
from gaitsweep.pipeline.report.figures.starts import START, cells
from gaitsweep.pipeline.report.figures.style import add_bar, choose_rows, on_map
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
#: Fewest cells along each side of a map on which contours are drawn.
_MIN_CONTOURED = 6


def design(source: Source, table: pd.DataFrame) -> Sketch | None:
    """Map smallest slope, largest stable slope and fastest stable speed over two keys,
    one row per walker.
    """
    keys = [
        c
        for c in source.line_columns(table)
        if c != "walker" and table[c].nunique() > 1
    ][:2]
    if len(keys) < 2:
        return None
    down, along = keys
    others = [c for c in source.line_columns(table) if c not in keys]
    every = table[others].drop_duplicates().to_dict("records") if others else [{}]
    rows, names, more = choose_rows(every)
    sketch = Sketch(
        "design",
        100 + 150 * len(rows),
        len(rows),
        len(MAPPED),
        sharex=True,
        sharey=True,
    )
    panels = sketch.grid
    pictures: dict[str, Any] = {}
    is_marked = False
    for k, (row, at) in enumerate(zip(panels, rows, strict=True)):
        part = rows_at(table, at)
        for axes, (column, mapped) in zip(row, MAPPED.items(), strict=True):
            values = part.pivot(index=down, columns=along, values=column)
            pictures[column] = draw_map(axes, values, table[column])
            _draw_contours(axes, values, *pictures[column].get_clim())
            if columns := _gait_columns(part, column):
                grids = {
                    name: part.pivot(index=down, columns=along, values=own)
                    for name, own in columns.items()
                }
                grids["slope"] *= mapped.inside
                shown = (
                    down,
                    along,
                    *(name for name in ("slope", "froude_speed") if name in grids),
                )
                held = cells(source, at, grids, shown, sketch.grid.size, mapped.cell)
                sketch.maps.append(Panel(axes, values, held))
            own = source.walkers.get(str(at.get("walker", source.walker)), {})
            is_marked = _mark_walkers(axes, own, down, along) or is_marked
            axes.set_title(mapped.title if k == 0 else "", pad=5)
        row[0].set_ylabel(
            f"{shorten(names[k], 22)}: " * bool(names[k]) + _symbol(source, down)
        )
    for axes, picture, column in zip(
        panels[-1], pictures.values(), panels.T, strict=True
    ):
        axes.set_xlabel(_symbol(source, along))
        axes.xaxis.set_major_locator(MaxNLocator(5))
        add_bar(picture, list(column), location="bottom").ax.xaxis.set_major_locator(
            MaxNLocator(4)
        )
    ends = [(spaced(c), table[c].min(), table[c].max()) for c in MAPPED]
    ranges = "; ".join(
        f"{name} from {plain(low)} to {plain(high)}" for name, low, high in ends
    )
    return sketch.finish(
        table[[*source.line_columns(table), *(c for c in _DATA if c in table)]],
        down=down,
        along=along,
        circles=_named(source, down, along) if is_marked else "",
        blank=True,
        more=more,
        ranges=ranges,
        best=_best(source, table),
    )


def _best(source: Source, table: pd.DataFrame) -> str:
    """The smallest slope, the largest and the highest speed of the maps, and where they
    are found.
    """
    parts = []
    for column, mapped in MAPPED.items():
        values = table[column].dropna()
        if len(values):
            best = table.loc[
                values.idxmin() if mapped.slope == "smallest_slope" else values.idxmax()
            ]
            where = axis_values(
                {name: best[name] for name in source.line_columns(table)}
            )
            parts.append(f"{mapped.title}: {plain(best[column])} ({where})")
    text = "; ".join(parts) or "no design walks"
    return text[0].upper() + text[1:]


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
