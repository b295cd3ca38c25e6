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
    lines = list(itertools.islice(_lines(source, asked), MOST_COLOURS))
    names = [name for name, _ in lines]
    colours = inks([""] * len(lines))
    shown = [asked.varied]
    if _COST in source.grid:
        shown.append(_COST)
    sketch = Sketch("sought", 330 * len(shown), len(shown), sharex=True)

    said = []
    for number, ((name, rows), ink) in enumerate(zip(lines, colours, strict=True)):
        for gait, curve in rows.groupby("gait", sort=False):
            known = curve[curve[asked.varied].notna()].reset_index(drop=True)
            if known.empty:
                continue
            label = f"{gait} step" + (f" · {name}" if name else "")
            _draw(sketch, asked, shown, known, label, ink, number)
            said.append(_law(known, asked, f" ({label})" if len(rows) else ""))
    if not sketch.pieces:
        return None

    sketch.gait_keys()
    for axes, name in zip(sketch.panels, shown, strict=True):
        is_positive = (sketch.data[[asked.measure, name]] > 0).all()
        sides = zip("xy", is_positive.tolist(), strict=True)
        set_log(axes, "".join(side for side, positive in sides if positive))
    return sketch.finish(
        lines=names if len(names) > 1 else (),
        inks=colours if len(names) > 1 else (),
        measure=spaced(asked.measure),
        varied=spaced(asked.varied),
        x=titled(asked.measure, source.units(asked.measure)),
        first=titled(asked.varied, source.units(asked.varied)),
        laws=" ".join(filter(None, said)),
        drawn=len(lines),
        every=_count(source, asked),
    )


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
    columns += ["spectral_radius"] * ("spectral_radius" in grid)
    for place in itertools.product(*(range(grid.sizes[axis]) for axis in others)):
        at = dict(zip(others, place, strict=True))
        values: dict[str, Any] = {axis: grid[axis].values[i] for axis, i in at.items()}
        differ = {axis: v for axis, v in values.items() if grid.sizes[axis] > 1}
        rows = grid.isel(at)[columns].to_dataframe().reset_index()
        rows = rows[[asked.measure, "gait", *columns]].sort_values(asked.measure)
        if "spectral_radius" in rows:
            rows["stable"] = np.where(rows["spectral_radius"] < 1, 1.0, 0.0)
        rows["command"] = [
            _command(source, values, asked, value)
            for value in rows[asked.measure].tolist()
        ]
        yield axis_values(differ), rows


def _draw(
    sketch: Sketch,
    asked: _Sought,
    shown: list[str],
    curve: pd.DataFrame,
    label: str,
    ink: str,
    number: int,
) -> None:
    """Draw a curve in each panel, with marks that tell their values and command."""
    tips = {name: symbol(name) for name in (asked.measure, asked.varied)} | _SHOWN
    for axes, name in zip(sketch.panels, shown, strict=True):
        gait = str(curve["gait"].iloc[0])
        draw_gait(axes, curve, gait, ink, number, asked.measure, name)
        axes.plot(curve[asked.measure], curve[name], "o", color=ink, ms=3.5)
        sketch.mark(
            axes, curve, label, tips=tips, x=asked.measure, y=name, group=number
        )
    sketch.pieces.append(curve.assign(line=label))


def _law(curve: pd.DataFrame, asked: _Sought, where: str) -> str:
    """How what is varied goes with the measure, in a sentence: its exponents between the
    first two and the last two values, where all are positive.
    """
    x, y = (curve[name].to_numpy(float) for name in (asked.measure, asked.varied))
    ends = f"from {plain(y[0])} at {plain(x[0])} to {plain(y[-1])} at {plain(x[-1])}"
    text = f"{spaced(asked.varied).capitalize()} goes {ends}{where}"
    if len(x) < 3 or not ((x > 0) & (y > 0)).all():
        return f"{text}." if len(x) > 1 else ""
    powers = np.diff(np.log(y)) / np.diff(np.log(x))
    first, last = plain(float(powers[0]), 3), plain(float(powers[-1]), 3)
    between = f"the power {first}" if first == last else f"powers {first} to {last}"
    return f"{text}, as {between} of the {spaced(asked.measure)}."


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
