"""Optima over the keys of a walker: the ways of the searches that led there, and
trade-offs of two measures.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from gaitsweep.pipeline.report.figures.sketch import TIPS, Sketch
from gaitsweep.pipeline.report.figures.style import INK, MARKERS, MUTED, PAPER, colour
from gaitsweep.pipeline.report.source import Line, Source
from gaitsweep.pipeline.report.words import (
    SYMBOLS,
    plain,
    print_units,
    spaced,
    with_unit,
)

#: Distance over the axes within which a way ends at an optimum.
_REACHED = 1e-3


@dataclass(frozen=True)
class _Asked:
    """What a study asks: its objective, whether that is largest, the keys that are
    free, and the measure that the objective is traded for, empty if there is none.
    """

    objective: str
    is_largest: bool
    free: list[str]
    traded: str

    @classmethod
    def of(cls, source: Source) -> "_Asked":
        """Read it of the study."""
        largest = source.given("options", "maximise")
        objective = largest or source.given("options", "minimise") or ""
        free = list(source.given("options", "free") or {})
        traded = list(source.given("options", "tradeoff") or {})
        return cls(str(objective), bool(largest), free, "".join(traded[:1]))


def optimum(source: Source, table: pd.DataFrame, paths: pd.DataFrame) -> Sketch | None:
    """Plot the ways from each start to the optimum over two of the free keys, or the
    objective against the measure for which it is traded.
    """
    asked = _Asked.of(source)
    if not {asked.objective, *asked.free} <= set(table.columns):
        return None

    sketch = Sketch("optimum", 360)
    (axes,) = sketch.panels
    if asked.traded:
        place = asked.traded, asked.objective
    else:
        place = _plane(paths, asked)
        _draw_ways(axes, paths, table, place)
        sketch.dot_key("start of a search", MUTED, mfc=PAPER, ms=4)
        sketch.dot_key("where one ended elsewhere", MUTED, marker="x", ms=5)

    lines = source.lines_of(table)
    for number, line in enumerate(lines):
        ink = colour(number) if len(lines) > 1 else INK
        _draw_optima(sketch, line, number, ink, place, asked)
        _mark_optima(sketch, source, line, place, asked)

    return sketch.finish(table, **_values(table, place, asked))


def _values(
    table: pd.DataFrame, place: tuple[str, str], asked: _Asked
) -> dict[str, Any]:
    """Values of the figure's words."""
    values = table[asked.objective]
    best = values.max() if asked.is_largest else values.min()
    x, y = (_heading(table, name) for name in place)

    return {
        "xlabel": x,
        "ylabel": y,
        "objective": _symbol(asked.objective),
        "extreme": "largest" if asked.is_largest else "least",
        "best": plain(float(best), 6),
        "ways": not asked.traded,
        "traded": _symbol(asked.traded),
        "begun": int(table["begun"].iloc[0]),
    }


def _plane(paths: pd.DataFrame, asked: _Asked) -> tuple[str, str]:
    """Two quantities that vary along the ways: free keys before the slope and the
    objective.
    """
    every = dict.fromkeys((*asked.free, "slope", asked.objective))
    varied = [name for name in every if paths[name].nunique() > 1]
    first, second = [*varied, "slope", "iteration"][:2]
    return first, second


def _draw_ways(
    axes: Axes, paths: pd.DataFrame, table: pd.DataFrame, place: tuple[str, str]
) -> None:
    """Draw the way of each search, from its start; a cross where it ended elsewhere."""
    x, y = place
    begins = np.flatnonzero(paths["iteration"] == 0)
    for begin, end in zip(begins, [*begins[1:], len(paths)], strict=True):
        way = paths.iloc[begin:end]
        axes.plot(way[x], way[y], color=MUTED, lw=0.8)
        first, last = way.iloc[:1], way.iloc[-1:]
        axes.plot(first[x], first[y], "o", color=MUTED, mfc=PAPER, ms=4)

        apart = np.abs(table[[x, y]].to_numpy() - last[[x, y]].to_numpy())
        sizes = np.abs(table[[x, y]].to_numpy()).max(axis=0)
        if not (apart <= _REACHED * sizes).all(axis=1).any():
            axes.plot(last[x], last[y], "x", color=MUTED, ms=5)


def _draw_optima(
    sketch: Sketch,
    line: Line,
    number: int,
    ink: str,
    place: tuple[str, str],
    asked: _Asked,
) -> None:
    """Draw the optima of a line: of a trade-off those of all values, joined."""
    (axes,) = sketch.panels
    x, y = place
    rows = line.rows.sort_values(x)
    marker, size, width = "*", 12.0, 0.0
    if asked.traded:
        marker, size, width = MARKERS[number % len(MARKERS)], 6.0, 1.2
    axes.plot(rows[x], rows[y], color=ink, lw=width, marker=marker, ms=size)
    if line.label:
        sketch.dot_key(line.label, ink, marker=marker)


def _mark_optima(
    sketch: Sketch,
    source: Source,
    line: Line,
    place: tuple[str, str],
    asked: _Asked,
) -> None:
    """Add the gaits of a line's optima, each with the command that solves it."""
    (axes,) = sketch.panels
    x, y = place
    tips = {name: _symbol(name) for name in (*asked.free, asked.objective)} | TIPS
    tips |= {"period": source.period_title(line.at)}
    label = ", ".join(filter(None, (line.label, "optimum")))
    for number in range(len(line.rows)):
        rows = line.rows.iloc[[number]]
        keys = {key: float(rows[key].iloc[0]) for key in asked.free}
        command = source.command({**line.at, **keys})
        sketch.mark(axes, rows, label, command=command, tips=tips, x=x, y=y)


def _symbol(name: str) -> str:
    """A quantity in short: a key by its name."""
    return SYMBOLS.get(name, name if len(name) < 4 else spaced(name))


def _heading(table: pd.DataFrame, name: str) -> str:
    """Title of an axis, with its unit."""
    unit = print_units(table.attrs.get("units", {}).get(name, ""))
    return with_unit(_symbol(name), unit)
