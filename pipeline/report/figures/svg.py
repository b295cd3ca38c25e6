"""From a sketch to an SVG for the page: inline, in the page's colours, with points that answer to the pointer."""

from __future__ import annotations

import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import matplotlib
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pipeline.report.figures.style import VARIABLES, plain

#: Points a figure answers to under the pointer.
TARGETS = 400


@dataclass(frozen=True)
class Marks:
    """Points of one curve that answer to the pointer: their values and the command that gives them.

    The command is `command` and a slope of `slopes`, or one of `commands` whole.
    """

    axes: Axes
    x: np.ndarray
    y: np.ndarray
    label: str
    values: Mapping[str, Any]
    command: str = ""
    slopes: np.ndarray | None = None
    commands: Sequence[str] | None = None


@dataclass
class Sketch:
    """A figure as its function leaves it: a drawing, its words, its data and its marks."""

    figure: Figure
    title: str
    caption: str
    alt: str
    data: pd.DataFrame
    marks: list[Marks] = field(default_factory=list)


@dataclass(frozen=True)
class Drawing:
    """A figure as the page takes it."""

    name: str
    title: str
    caption: str
    alt: str
    svg: str
    width: float
    height: float
    data: pd.DataFrame
    small: str
    targets: list[dict[str, Any]]


def render(sketch: Sketch, name: str, salt: str) -> Drawing:
    """The sketch as an SVG to put into a page, with its marks placed.

    Notes
    -----
    Equal sketches give equal bytes: the identifiers inside come from `salt`, and no date is written.
    """
    figure = sketch.figure
    figure.draw_without_rendering()
    figure.set_layout_engine("none")
    svg = _saved(figure, f"{salt}/{name}", 200)
    small = _saved(figure, f"{salt}/{name}/small", 80) if "data:image" in svg else svg
    width, height = (float(side) for side in figure.get_size_inches() * 72)
    return Drawing(
        name,
        sketch.title,
        sketch.caption,
        sketch.alt,
        svg,
        width,
        height,
        sketch.data,
        small,
        _targets(sketch.marks, height),
    )


def _saved(figure: Figure, salt: str, dpi: int) -> str:
    """The figure's SVG; `dpi` is that of parts made of pixels."""
    stream = io.StringIO()
    with matplotlib.rc_context({"svg.hashsalt": salt}):
        figure.savefig(stream, format="svg", dpi=dpi, metadata={"Date": None})
    return _inline(stream.getvalue())


def _inline(svg: str) -> str:
    """Matplotlib's file without its prologue, outside names and fixed colours."""
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.S)
    svg = re.sub(r"<style.*?</style>", "", svg, flags=re.S)
    svg = re.sub(
        r"<svg [^>]*?viewBox=(\"[^\"]*\")[^>]*>", r'<svg viewBox=\1 aria-hidden="true" focusable="false">', svg
    )
    svg = re.sub(r" id=\"[A-Za-z_.]+_\d+\"", "", svg).replace("xlink:href", "href")
    svg = re.sub(r"font: ([\d.]+px) [^;\"]*", r"font-size: \1", svg)
    for drawn, variable in VARIABLES.items():
        svg = svg.replace(f": {drawn}", f": var(--{variable})")
    svg = re.sub(r' d="[^"]*"', lambda path: re.sub(r"(\.\d\d)\d+", r"\1", path[0]), svg)
    return re.sub(r">\s+<", "><", re.sub(r"\n\s*", " ", svg))


def _targets(marks: list[Marks], height: float) -> list[dict[str, Any]]:
    """Marks in the SVG's own coordinates, thinned to `TARGETS` a figure."""
    found = []
    for mark in marks:
        x, y = np.asarray(mark.x, float), np.asarray(mark.y, float)
        (left, right), (low, high) = sorted(mark.axes.get_xlim()), sorted(mark.axes.get_ylim())
        seen = np.flatnonzero((x >= left) & (x <= right) & (y >= low) & (y <= high))
        share = max(1, TARGETS // len(marks))
        if len(seen) > share:
            seen = seen[np.unique(np.linspace(0, len(seen) - 1, share).round().astype(int))]
        if not len(seen):
            continue
        place = mark.axes.transData.transform(np.column_stack([x[seen], y[seen]]))
        rows = [
            [
                round(float(a), 1),
                round(float(height - b), 1),
                _command(mark, i),
                *(_said(column[i]) for column in mark.values.values()),
            ]
            for i, (a, b) in zip(seen.tolist(), place, strict=True)
        ]
        found.append({"label": mark.label, "names": list(mark.values), "command": mark.command, "rows": rows})
    return found[:TARGETS]


def _command(mark: Marks, i: int) -> float | str | None:
    """What row i adds to the command of its curve: a slope, the whole command, or nothing."""
    if mark.commands is not None:
        return mark.commands[i]
    return None if mark.slopes is None else float(mark.slopes[i])


def _said(value: Any) -> str:
    return plain(float(value), 7) if isinstance(value, (float, np.floating)) else str(value)
