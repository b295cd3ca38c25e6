"""What is varied until gaits have the values of a measure, over these values."""

import itertools
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from gaitsweep.pipeline.report.figures.sketch import Sketch
from gaitsweep.pipeline.report.figures.style import (
    MOST_COLOURS,
    draw_gait,
    inks,
    set_log,
)
from gaitsweep.pipeline.report.source import Source
from gaitsweep.pipeline.report.words import axis_values, plain, spaced, symbol, titled

#: What is drawn below, where the archive holds it, and columns under the pointer.
_COST = "cost_of_transport"
_SHOWN = {"stance_angle": "θ* (rad)", _COST: "cost of transport"}


class _Sought(NamedTuple):
    """The measure whose values are sought, and what is varied."""

    measure: str
    varied: str


def sought(source: Source) -> Sketch | None:
    """Plot what is varied against the measure whose values gaits are sought at, and
    below it their cost of transport, if the archive has it.
    """
    asked = _asked(source)
    if asked is None:
        return None

    sketch, shown = _panels(source, asked)
    lines = list(itertools.islice(_lines(source, asked), MOST_COLOURS))
    names = [name for name, _ in lines] if len(lines) > 1 else []
    colours = inks([""] * len(lines))

    for number, (name, rows) in enumerate(lines):
        for gait, curve in rows.groupby("gait", sort=False):
            label = " · ".join(filter(None, (f"{gait} step", name)))
            known = curve[curve[asked.varied].notna()].reset_index(drop=True)
            if len(known):
                known = known.assign(line=label)
                _draw(sketch, asked, shown, known, colours[number], number)

    if not sketch.pieces:
        return None

    sketch.gait_keys()
    _set_scales(sketch, asked, shown)

    return sketch.finish(
        lines=names,
        inks=colours[: len(names)],
        laws=" ".join(_laws(sketch.pieces, asked)),
        drawn=len(lines),
        every=_count(source, asked),
        **_titles(source, asked),
    )


def _panels(source: Source, asked: _Sought) -> tuple[Sketch, list[str]]:
    """Empty panels, and what is drawn in each."""
    shown = [asked.varied]
    if _COST in source.grid:
        shown.append(_COST)
    height = 330 * len(shown)
    return Sketch("sought", height, len(shown), sharex=True), shown


def _set_scales(sketch: Sketch, asked: _Sought, shown: list[str]) -> None:
    """Make axes logarithmic along which all values are positive."""
    data = sketch.data
    for axes, name in zip(sketch.panels, shown, strict=True):
        columns = {"x": asked.measure, "y": name}
        sides = [side for side, own in columns.items() if (data[own] > 0).all()]
        set_log(axes, "".join(sides))


def _titles(source: Source, asked: _Sought) -> dict[str, str]:
    """Names and titles of what is sought and of what is varied."""
    measure, varied = asked
    return {
        "measure": spaced(measure),
        "varied": spaced(varied),
        "x": titled(measure, source.units(measure)),
        "first": titled(varied, source.units(varied)),
    }


def _laws(curves: list[pd.DataFrame], asked: _Sought) -> Iterator[str]:
    """Yield how what is varied goes with the measure along each curve."""
    for curve in curves:
        if len(curve) > 1:
            yield _law(curve, asked)


def _asked(source: Source) -> _Sought | None:
    """What is sought in a study at values of a measure; None of another."""
    at = source.given("at") or {}
    measures = [name for name in at if name in source.axes]
    varied = str(at.get("vary", "slope"))
    if not measures or varied not in source.grid:
        return None
    return _Sought(measures[0], varied)


def _count(source: Source, asked: _Sought) -> int:
    """How many lines over the measure the grid holds."""
    return int(
        np.prod([source.grid.sizes[a] for a in source.axes if a != asked.measure])
    )


def _lines(source: Source, asked: _Sought) -> Iterator[tuple[str, pd.DataFrame]]:
    """The gaits over the measure at values of the other axes, called by those of them
    that differ.
    """
    grid, others = source.grid, [a for a in source.axes if a != asked.measure]
    columns = [asked.varied, *(name for name in _SHOWN if name in grid)]
    for place in itertools.product(*(range(grid.sizes[axis]) for axis in others)):
        at = dict(zip(others, place, strict=True))
        values: dict[str, Any] = {axis: grid[axis].values[i] for axis, i in at.items()}
        differ = {axis: v for axis, v in values.items() if grid.sizes[axis] > 1}
        here = grid.isel(at)[columns]
        rows = here.to_dataframe().reset_index().sort_values(asked.measure)
        rows = rows[[asked.measure, "gait", *columns]]
        sought_at = rows[asked.measure].tolist()
        rows["command"] = [_command(source, values, asked, x) for x in sought_at]
        yield axis_values(differ), rows


def _draw(
    sketch: Sketch,
    asked: _Sought,
    shown: list[str],
    curve: pd.DataFrame,
    ink: str,
    number: int,
) -> None:
    """Draw a curve in each panel, with marks that tell their values and command."""
    measure, varied = asked
    tips = {measure: symbol(measure), varied: symbol(varied)} | _SHOWN
    gait, label = (str(curve[name].iloc[0]) for name in ("gait", "line"))
    for axes, name in zip(sketch.panels, shown, strict=True):
        draw_gait(axes, curve, gait, ink, number, measure, name)
        axes.plot(curve[measure], curve[name], "o", color=ink, ms=3.5)
        sketch.mark(axes, curve, label, tips=tips, x=measure, y=name, group=number)

    sketch.pieces.append(curve)


def _law(curve: pd.DataFrame, asked: _Sought) -> str:
    """How what is varied goes with the measure, in a sentence: its exponents between the
    first two and the last two values, where there are three and all are positive.
    """
    x, y = (curve[name].to_numpy(float) for name in (asked.measure, asked.varied))
    low, high = (f"{plain(y[k])} at {plain(x[k])}" for k in (0, -1))
    where = f"({curve['line'].iloc[0]})"
    text = f"{spaced(asked.varied).capitalize()} goes from {low} to {high} {where}"

    is_power = len(x) > 2 and (x > 0).all() and (y > 0).all()
    if not is_power:
        return f"{text}."

    powers = np.diff(np.log(y)) / np.diff(np.log(x))
    ends = [plain(float(power), 3) for power in powers[[0, -1]]]
    power = f"the power {ends[0]}"
    if ends[0] != ends[1]:
        power = f"powers {ends[0]} to {ends[1]}"
    return f"{text}, as {power} of the {spaced(asked.measure)}."


def _command(
    source: Source, values: dict[str, Any], asked: _Sought, value: float
) -> str:
    """The command that finds the gaits at a value of the measure."""
    keys = {axis: v for axis, v in values.items() if axis != "slope"}
    line = {"walker": str(keys.pop("walker", source.walker)), **keys}
    words = f"{source.command(line)} --at {asked.measure}={value!r}"
    if asked.varied != "slope":
        words += f" --vary {asked.varied} --slope {float(values['slope'])!r}"
    return words
