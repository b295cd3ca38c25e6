"""Gaits over a key of the walker at fixed slopes, as those over the push-off on level
ground.
"""

import itertools
from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from gaitsweep.pipeline.report.figures.continued import goes_on, parts
from gaitsweep.pipeline.report.figures.sketch import Sketch
from gaitsweep.pipeline.report.figures.stability import TESTS, tests
from gaitsweep.pipeline.report.figures.style import MOST_COLOURS, draw_gait, inks
from gaitsweep.pipeline.report.source import Source, stable
from gaitsweep.pipeline.report.words import axis_values, symbol, with_unit

#: Variables under the pointer, beside the key and what is drawn.
_SHOWN = {"slope": "γ (rad)", "stance_angle": "θ* (rad)", "spectral_radius": "max |λ|"}
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
    (axes,) = sketch.panels
    lines = list(itertools.islice(_lines(source, key), MOST_COLOURS))
    names = [name for name, _ in lines]
    colours = inks([""] * len(lines))

    for number, ((name, rows), ink) in enumerate(zip(lines, colours, strict=True)):
        for gait, curve in rows.groupby("gait", sort=False):
            known = curve[curve["stance_angle"].notna()]
            if known.empty:
                continue

            whole = parts(curve)
            draw_gait(
                axes,
                whole,
                str(gait),
                ink,
                number,
                key,
                "stance_angle",
            )
            _mark(sketch, known, f"{gait} step · {name}", key, number)
            sketch.pieces.append(
                known.drop(columns=_UNTOLD, errors="ignore").assign(line=name)
            )

    if not sketch.pieces:
        return None

    sketch.gait_keys()

    return sketch.finish(
        lines=names,
        inks=colours,
        key=key,
        x=with_unit(symbol(key), source.units(key)),
        drawn=len(lines),
        every=_count(source, key),
    )


def _mark(
    sketch: Sketch, curve: pd.DataFrame, label: str, key: str, number: int
) -> None:
    """Mark the gaits of a curve, which tell their values and command."""
    (axes,) = sketch.panels
    told = curve.drop(columns=["gait", "stable", *_UNTOLD], errors="ignore")
    tips = {key: symbol(key), **_SHOWN}
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
    grid = source.grid
    others = [axis for axis in source.axes if axis != key]

    for place in itertools.product(*(range(grid.sizes[axis]) for axis in others)):
        at = dict(zip(others, place, strict=True))
        values: dict[str, Any] = {axis: grid[axis].values[i] for axis, i in at.items()}
        varied = {axis: v for axis, v in values.items() if grid.sizes[axis] > 1}
        rows = _rows(grid.isel(at), key)
        rows["command"] = [
            _command(source, values, key, value) for value in rows[key].tolist()
        ]
        yield axis_values(varied) or source.walker, rows


def _rows(here: xr.Dataset, key: str) -> pd.DataFrame:
    """The gaits over a key where all else is fixed, and how they are drawn."""
    told = here[
        [
            "stance_angle",
            "spectral_radius",
        ]
    ]
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
