"""Gaits over a key of the walker at fixed slopes, as those over the push-off on level
ground.
"""

import itertools
from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from gaitsweep.pipeline.report.figures import tolerances
from gaitsweep.pipeline.report.figures.continued import goes_on, parts
from gaitsweep.pipeline.report.figures.sketch import Sketch
from gaitsweep.pipeline.report.figures.stability import TESTS, tests
from gaitsweep.pipeline.report.figures.style import MOST_COLOURS, draw_gait, inks
from gaitsweep.pipeline.report.source import Source, stable
from gaitsweep.pipeline.report.words import axis_values, symbol, with_unit

#: Variables under the pointer, beside the key and what is drawn.
_SHOWN = {"slope": "γ (rad)", "stance_angle": "θ* (rad)", "spectral_radius": "max |λ|"}
_ANGLE, _WIDTH = "stance_angle", tolerances.half_width("stance_angle")
#: Columns by which curves are drawn.
_UNTOLD = ["goes_on", *TESTS]


def over_key(source: Source) -> Sketch | None:
    """Plot the stance angle of every gait against the study's longest axis of a key, a
    colour for each of its slopes and values of other axes.
    """
    key = _longest_key(source)

    if key is None:
        return None

    sketch = Sketch("over_key", 350)
    lines = list(itertools.islice(_lines(source, key), MOST_COLOURS))
    names = [name for name, _ in lines]
    colours = inks([""] * len(lines))

    for number, ((name, rows), ink) in enumerate(zip(lines, colours, strict=True)):
        for _, curve in rows.groupby("gait", sort=False):
            if curve[_ANGLE].notna().any():
                _draw_curve(sketch, curve, key, name, (number, ink))

    if not sketch.pieces:
        return None

    sketch.gait_keys()
    places = itertools.islice(_places(source, key), len(lines))
    told = tolerances.told(source, places, [_ANGLE])

    return sketch.finish(
        lines=names,
        inks=colours,
        key=key,
        x=with_unit(symbol(key), source.units(key)),
        drawn=len(lines),
        every=_count(source, key),
        **told,
    )


def _draw_curve(
    sketch: Sketch, curve: pd.DataFrame, key: str, name: str, how: tuple[int, str]
) -> None:
    """Draw a gait of a line over a key, by the line's number and ink, and mark its
    points.
    """
    (axes,) = sketch.panels
    number, ink = how
    gait = str(curve["gait"].iloc[0])
    whole = parts(curve)
    tolerances.draw_band(axes, whole, gait, ink, number, key, _ANGLE, _ANGLE)
    draw_gait(axes, whole, gait, ink, number, key, _ANGLE)

    known = curve[curve[_ANGLE].notna()]
    _mark(sketch, known, f"{gait} step · {name}", key, number)
    told = known.drop(columns=_UNTOLD, errors="ignore")
    sketch.pieces.append(told.assign(line=name))


def _mark(
    sketch: Sketch, curve: pd.DataFrame, label: str, key: str, number: int
) -> None:
    """Mark the gaits of a curve, which tell their values and command."""
    (axes,) = sketch.panels
    told = curve.drop(columns=["gait", "stable", *_UNTOLD], errors="ignore")
    tips = {key: symbol(key), **_SHOWN}
    if _WIDTH in curve:
        tips[_WIDTH] = "± θ* (rad)"
    sketch.mark(axes, told, label, tips=tips, x=key, group=number)


def _longest_key(source: Source) -> str | None:
    """The longest axis of numbers that is no slope, of more values than one."""
    grid = source.grid

    if not {"stance_angle", "spectral_radius"} <= set(grid.variables):
        return None

    keys = [axis for axis in source.axes if axis not in ("slope", "walker")]
    lengths = {axis: grid.sizes[axis] for axis in keys if grid.sizes[axis] > 1}

    return max(
        lengths,
        key=lambda axis: lengths[axis],
        default=None,
    )


def _count(source: Source, key: str) -> int:
    """How many lines over a key the grid holds."""
    others = [size for axis, size in source.grid.sizes.items() if axis in source.axes]

    return int(np.prod(others)) // source.grid.sizes[key]


def _lines(source: Source, key: str) -> Iterator[tuple[str, pd.DataFrame]]:
    """The gaits over a key at each slope and value of the other axes, called by those of
    them that vary.
    """
    for here, values in _places(source, key):
        varied = {a: v for a, v in values.items() if source.grid.sizes[a] > 1}
        data = tolerances.with_half_widths(source, here, values, [_ANGLE])
        rows = _rows(data, key)
        rows["command"] = [
            _command(source, values, key, value) for value in rows[key].tolist()
        ]
        yield axis_values(varied) or source.walker, rows


def _places(source: Source, key: str) -> Iterator[tuple[xr.Dataset, dict[str, Any]]]:
    """The grid over a key where all else is fixed, and the values of the other axes."""
    grid = source.grid
    others = [axis for axis in source.axes if axis != key]

    ranges = [range(grid.sizes[axis]) for axis in others]

    for place in itertools.product(*ranges):
        at = dict(zip(others, place, strict=True))
        values = {axis: grid[axis].values[i] for axis, i in at.items()}
        yield grid.isel(at), values


def _rows(here: xr.Dataset, key: str) -> pd.DataFrame:
    """The gaits over a key where all else is fixed, and how they are drawn."""
    shown = [_ANGLE, "spectral_radius", _WIDTH]
    told = here[[name for name in shown if name in here]]
    whole = told.assign(tests(here))
    rows = whole.to_dataframe().reset_index()

    rows["stable"] = stable(rows)
    rows["goes_on"] = goes_on(here["stance_angle"], key)
    drawn = [name for name in _UNTOLD if name in rows]

    columns = [
        key,
        "slope",
        "gait",
        *told,
        "stable",
        *drawn,
    ]
    return rows[columns]


def _command(source: Source, values: dict[str, Any], key: str, value: float) -> str:
    """The command that solves the gaits of a point."""
    at = {axis: v for axis, v in values.items() if axis != "slope"}
    line = {"walker": str(at.pop("walker", source.walker)), **at, key: value}

    return f"{source.command(line)} --slope {float(values['slope'])!r}"
