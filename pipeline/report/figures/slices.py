"""All gaits of a grid of three or more axes in few bytes, through which a page's script
cuts slices.
"""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from gaitsweep.pipeline.report.figures import fields
from gaitsweep.pipeline.report.figures.starts import START, parameters, rounded
from gaitsweep.pipeline.report.figures.style import (
    LINE,
    VARIABLES,
    WALKERS,
    spread_evenly,
)
from gaitsweep.pipeline.report.source import Source
from gaitsweep.pipeline.report.words import titled

#: Least number of axes of a grid that has slices, and largest numbers of its points and
#: of the values of an axis that a page holds.
_LEAST, _POINTS, _VALUES = 3, 12_000, 80

#: Characters of all numbers of the slices of a page.
_ROOM = 130_000

#: Quantities that come first, and the most that may be chosen from.
_FIRST = ("speed", "froude_speed", "stance_angle", "period", "spectral_radius")
_MOST = 7

#: Steps of the numbers: digits of what is shown, of stance angles, and of rates over
#: stance angles, from which Newton's method begins.
_SHOWN, _ANGLE, _RATE = 1e-4, 1e-6, 1e-4


class _Quantity(NamedTuple):
    """A quantity over walkers, gaits and axes, and the step and the scale of its
    numbers.
    """

    values: np.ndarray
    step: float
    log: bool


def axes_of(source: Source) -> list[str]:
    """Axes of a grid with more than one value, but that of walkers; none if they are
    too few to have slices.
    """
    sizes = source.grid.sizes
    axes = [axis for axis in source.axes if axis != "walker" and sizes[axis] > 1]
    return axes if len(axes) >= _LEAST and "gait" in sizes else []


def volume(source: Source) -> dict[str, Any]:
    """What the script needs to cut slices of a grid; empty where there are none.

    Returns
    -------
    dict
        `axes`, name, title and rising values of each, the two longest last; `lines`,
        for each walker what its gaits start from; `gaits`; `quantities`, name and title
        of those that may be shown; `fields`, by quantity, a text for each slice along
        the two last axes: of each walker, gait and place on the other axes, the last
        fastest, and under `present` in the same order whether there is a gait; a
        quantity that not every gait has, has its own `present`. `every` is the number
        of points of the grid of which the page holds `held`.
    """
    axes = axes_of(source)
    shown = _shown(source, axes)
    if not axes or not shown:
        return {}

    sizes = source.grid.sizes
    # A large grid is read at every n-th slope.
    whole = {**sizes, **source.outcomes.sizes}
    grid = _thinned(source.grid.sortby(axes), axes)
    axes.sort(key=lambda axis: sizes[axis])

    encoded = _encoded(_quantities(grid, source, axes, shown))
    if not encoded:
        return {}

    return {
        "axes": [
            {
                "name": axis,
                "title": _title(source, axis),
                "values": rounded(grid[axis].values, 12),
            }
            for axis in axes
        ],
        "lines": [_line(source, grid, axes, name) for name in source.walkers],
        "gaits": source.gaits,
        "quantities": [[name, _title(source, name)] for name in shown],
        "fields": encoded,
        "every": int(np.prod([whole[axis] for axis in axes])),
        "held": int(np.prod([grid.sizes[axis] for axis in axes])),
    }


def _title(source: Source, name: str) -> str:
    return titled(name, source.units(name))


def _shown(source: Source, axes: list[str]) -> list[str]:
    """Quantities that may be chosen: numbers over the gaits of all points."""
    wanted = {*axes, "gait"}
    others = (
        str(name)
        for name, column in source.grid.data_vars.items()
        if column.dtype.kind == "f" and not str(name).endswith(("bound", "residual"))
    )
    first = [name for name in _FIRST if name in source.grid]
    every = [
        name
        for name in dict.fromkeys([*first, *others])
        if name not in START[2:] and wanted <= {*source.grid[name].dims}
    ]
    flat = [
        name
        for name in every
        if {*source.grid[name].dims} <= {*source.axes, "gait"}
        and source.grid[name].notnull().any()
    ]
    return flat[:_MOST]


def _thinned(grid: xr.Dataset, axes: list[str]) -> xr.Dataset:
    """Every second value of the longest axis, again and again, until a page holds all
    points.
    """
    kept = {axis: spread_evenly(grid.sizes[axis], _VALUES) for axis in axes}
    while np.prod([len(places) for places in kept.values()]) > _POINTS:
        longest = max(axes, key=lambda axis: len(kept[axis]))
        places = kept[longest]
        kept[longest] = places[spread_evenly(len(places), (len(places) + 1) // 2)]
    return grid.isel(kept)


def _quantities(
    grid: xr.Dataset, source: Source, axes: list[str], shown: list[str]
) -> Iterator[tuple[str, _Quantity]]:
    """Values of what is shown and of the state that starts a gait, over walkers, gaits
    and axes.
    """

    def values(name: str) -> np.ndarray:
        column = grid[name]
        if "walker" not in column.dims:
            column = column.expand_dims("walker")
        rest = [d for d in column.dims if d not in ("walker", "gait", *axes)]
        return column.transpose(*rest, "walker", "gait", *axes).values.reshape(
            [column.sizes[d] for d in ("walker", "gait", *axes)]
        )

    angle = values("stance_angle") if "stance_angle" in grid else None
    names = dict.fromkeys([*shown, *(name for name in START[1:] if name in grid)])
    for name in names:
        own = values(name)
        if name in START[2:]:
            if angle is not None and source.steps == 1:
                yield name, _Quantity(own / angle, _RATE, False)
            continue

        finite = own[np.isfinite(own)]
        log = bool((finite > 0).all())
        size = 1.0 if log else float(np.abs(finite).max(initial=1e-9))
        step = _ANGLE if name == "stance_angle" else _SHOWN
        yield name, _Quantity(own, step * size, log)


def _encoded(quantities: Iterator[tuple[str, _Quantity]]) -> dict[str, Any]:
    """Texts of all slices, if need be with fewer digits; empty if they take too much
    room.
    """
    known = dict(quantities)
    masks = {name: np.isfinite(one.values) for name, one in known.items()}
    has_gait = next(iter(masks.values()))
    own_mask = {
        name: {"present": fields.words(mask)}
        for name, mask in masks.items()
        if not np.array_equal(mask, has_gait)
    }
    for coarser in (1, 10, 100):
        found: dict[str, Any] = {}
        characters = 0
        for name, (values, step, log) in known.items():
            own = [
                fields.numbers(part, step * coarser, log) for part in _slices(values)
            ]
            texts = [one["text"] for one in own]
            found[name] = {"step": step * coarser, "log": log, "texts": texts}
            found[name] |= own_mask.get(name, {})
            characters += sum(map(len, texts))

        if characters <= _ROOM:
            return {**found, "present": fields.words(has_gait)}

    return {}


def _slices(values: np.ndarray) -> Iterator[np.ndarray]:
    """The slices of an array along its two last axes."""
    return iter(values.reshape(-1, *values.shape[-2:]))


def _line(
    source: Source, grid: xr.Dataset, axes: list[str], walker: str
) -> dict[str, Any]:
    """What gaits of one of the grid's walkers start from: values of axes of one value,
    keys, command, and keys that the axes move.
    """
    alone = [a for a in source.axes if a not in (*axes, "walker")]
    at = {"walker": walker, **{a: float(grid[a].values[0]) for a in alone}}
    moved = {}
    for key, by in source.varied.items():
        across = [axis for axis in axes if axis in by]
        if across and key not in by and key in grid:
            column = grid[key]
            if "walker" in column.dims:
                column = column.isel(walker=list(source.walkers).index(walker))
            held = column.squeeze(drop=True).transpose(*across).values
            moved[key] = [across, rounded(np.ravel(held), 10)]

    return {
        "at": at,
        "keys": parameters(source, at),
        "command": source.command(at),
        "ink": VARIABLES[WALKERS.get(walker, LINE)],
        "moved": moved,
    }
