"""From a sketch to an inline SVG in the page's colours, with points that show their
values under the pointer.
"""

import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.text import Text

from gaitsweep.pipeline.report.figures.sketch import Marks, Panel, Sketch
from gaitsweep.pipeline.report.figures.starts import START, rounded
from gaitsweep.pipeline.report.figures.style import (
    NARROW_SMALL_WORDS,
    NARROW_WORDS,
    PAPER,
    SMALL_BELOW,
    VARIABLES,
    every_axes,
    thin,
    title_of,
)
from gaitsweep.pipeline.report.words import plain

#: Points of a figure that show their values under the pointer.
TARGETS = 200

#: Dots that a picture on the index may have as vectors; more are left out there.
_MAX_DOTS = 1500

#: Size above which the index shows the rasters of a figure more coarsely [character].
_MAX_THUMBNAIL = 30_000


#: The least distance of numbers on pages as narrow as a phone, and how far words may
#: stand out there [pt].
_APART, _MARGIN = 5.0, 16.0
#: Words of an SVG that are not turned: size, anchor if any, place, content.
_WORDS = re.compile(
    r'<text style="font-size: ([\d.]+)px;(?:[^"]*text-anchor: (\w+))?[^"]*"'
    r' x="([-\d.]+)" y="[-\d.]+">([^<]*)<'
)

#: A group of an SVG that holds nothing.
_EMPTY = r"<g(?: [^>]*)?/>|<g(?: [^>]*[^/>])?>\s*</g>"

#: Markers as characters, filled and hollow.
_CHARACTERS = {
    "o": "●○",
    "s": "■□",
    "^": "▲△",
    "v": "▼▽",
    "<": "◀◁",
    ">": "▶▷",
    "D": "◆◇",
    "d": "◆◇",
    "*": "★☆",
    "P": "✚",
    "X": "✖",
    "x": "×",
    "+": "+",
}


@dataclass(frozen=True)
class Drawing:
    """A figure as the page shows it.

    `keys` repeat its legend in words that break into lines, for pages too narrow for
    the drawn one: style of an entry's line or marker, its character, and its label.
    """

    name: str
    title: str
    caption: str
    alt: str
    finding: str
    svg: str
    width: float
    height: float
    data: pd.DataFrame
    small: str
    targets: list[dict[str, Any]]
    lines: list[tuple[str, str]]
    keys: list[tuple[str, str, str]]
    panels: list[dict[str, Any]]
    axes: list[dict[str, Any]]
    is_wide: bool = False


def render(sketch: Sketch, name: str, salt: str, small: bool = True) -> Drawing:
    """Render a sketch as an SVG for a page, with its marks in the SVG's coordinates;
    `small` for the index as well.

    Notes
    -----
    Equal sketches give equal bytes: the SVG's identifiers derive from `salt`, and no date is written.
    """
    figure = sketch.figure
    engine = figure.get_layout_engine()
    assert engine is not None
    engine.execute(figure)
    # A placeholder would have everything drawn once more before it is written.
    figure.set_layout_engine(None)
    _mark_crowded(figure)
    svg = _to_svg(figure, f"{salt}/{name}", 160)
    width, height = (float(side) for side in figure.get_size_inches() * 72)

    return Drawing(
        name,
        *sketch.words,
        svg,
        width,
        height,
        sketch.data,
        _thumbnail(figure, f"{salt}/{name}/small") if small else "",
        _targets(sketch.marks, height),
        sketch.lines,
        [key(line) for line in sketch.legend],
        [_panel(k, sketch.maps, height) for k in range(len(sketch.maps))],
        [
            _frame(axes, height)
            for axes in figure.axes
            if axes.axison and axes.get_label() != "<colorbar>"
        ],
        _is_wide(svg, width),
    )


def _mark_crowded(figure: Figure) -> None:
    """Mark those numbers of axes that would touch others on a narrow page, where they
    are larger: it leaves them out. Panels side by side have their numbers in one row.
    """
    for k in (0, 1):
        rows: dict[int, list[tuple[float, Text]]] = {}
        for axes in every_axes(figure):
            for row, place, label in _numbers((axes.xaxis, axes.yaxis)[k], k):
                rows.setdefault(row, []).append((place, label))

        for numbers in rows.values():
            _mark_in_row(sorted(numbers, key=lambda item: item[0]), k)


def _mark_in_row(numbers: list[tuple[float, Text]], k: int) -> None:
    """Mark those of a row or column of numbers that would touch one before."""
    last = -np.inf
    for place, label in numbers:
        size: float = NARROW_WORDS
        if k == 0:
            size *= 0.62 * len(label.get_text())
        if place - size / 2 < last + _APART:
            label.set_gid("crowded")
        else:
            last = place + size / 2


def _is_wide(svg: str, width: float) -> bool:
    """Whether words of a figure would leave it on a narrow page, where they are larger:
    there it keeps its size, and is moved sideways. The legend, which is drawn last, is
    told below the figure there.
    """
    drawn = svg.partition('<g class="told">')[0]
    for size, anchor, x, text in _WORDS.findall(drawn):
        is_small = float(size) < SMALL_BELOW
        larger = NARROW_SMALL_WORDS if is_small else NARROW_WORDS
        long = 0.55 * larger * len(text.strip())
        left = float(x) - {"middle": 0.5, "end": 1.0}.get(anchor, 0.0) * long
        if left < -_MARGIN or left + long > width + _MARGIN:
            return True
    return False


def _numbers(axis: Axis, k: int) -> list[tuple[int, float, Text]]:
    """The numbers of an axis that are seen, with the row that they are in and the
    places of their middles along it.
    """
    labels = axis.get_ticklabels() if axis.get_visible() and axis.axes.axison else []
    low, high = axis.axes.get_window_extent().get_points()[:, k]
    found = []
    for label in labels:
        place = label.get_transform().transform(label.get_position())
        if label.get_text() and low - 1 <= place[k] <= high + 1:
            found.append((round(place[1 - k]), float(place[k]), label))

    return found


def _thumbnail(figure: Figure, salt: str) -> str:
    """A small version of a figure, with more coarsely drawn rasters if it would be
    large.
    """
    small = _small(_to_svg(figure, salt, 50, 0))
    return (
        _small(_to_svg(figure, salt, 20, 0))
        if len(small) > _MAX_THUMBNAIL and "<image" in small
        else small
    )


def _coarsen(figure: Figure) -> None:
    """Leave out what is too small to see on the index: ticks, words, grid, legends and
    the details of curves.
    """
    for line in figure.findobj(Line2D):
        line.get_path().simplify_threshold = 1.0
        if np.size(line.get_xdata()) > _MAX_DOTS and not line.get_rasterized():
            line.set_visible(False)

    for words in figure.findobj(Text):
        words.set_visible(False)
    for axes in figure.axes:
        for inset in axes.child_axes:
            inset.set_visible(False)
        axes.xaxis.set_visible(False)
        axes.yaxis.set_visible(False)

    for legend in [
        *figure.legends,
        *filter(None, (axes.get_legend() for axes in figure.axes)),
    ]:
        legend.set_visible(False)


def _small(svg: str) -> str:
    """A picture without what is not seen on the index."""
    svg = re.sub(
        r" data-line=\"\d+\"| clip-path=\"[^\"]*\"|; stroke-linecap: square|<clipPath.*?</clipPath>",
        "",
        svg,
    )
    previous = ""
    while svg != previous:
        previous, svg = svg, re.sub(_EMPTY, "", svg)
    return svg


def _to_svg(figure: Figure, salt: str, dpi: int, decimals: int = 2) -> str:
    """The figure's SVG; `dpi` is the resolution of its raster parts, `decimals` that of
    its paths.
    """
    stream = io.StringIO()
    if not decimals:
        _coarsen(figure)
    with matplotlib.rc_context({"svg.hashsalt": salt}):
        figure.savefig(stream, format="svg", dpi=dpi, metadata={"Date": None})
    return _adapt(stream.getvalue(), decimals)


def _adapt(svg: str, decimals: int) -> str:
    """Matplotlib's SVG without prologue, foreign names and fixed colours."""
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<(metadata|style).*?</\1>", "", svg, flags=re.S)
    svg = re.sub(
        r'<svg [^>]*?(viewBox="[^"]*")[^>]*>',
        r'<svg \1 aria-hidden="true" focusable="false">',
        svg,
    )
    svg = re.sub(r' id="line-(\d+)"', r' data-line="\1"', svg)
    for part in ("told", "crowded"):
        svg = svg.replace(f' id="{part}"', f' class="{part}"')
    svg = re.sub(r' transform="rotate\(-0 [^"]*\)"', "", svg)
    svg = re.sub(r" id=\"([A-Za-z_.0-9]+_\d+|image[0-9a-f]+)\"", "", svg).replace(
        "xlink:href", "href"
    )
    svg = re.sub(r"font: ([\d.]+px) [^;\"]*", r"font-size: \1", svg)
    # Marks, whose paths have a name, would become squares or nothing.
    fine = r"(\.\d\d)\d+"
    cut = rf"(\.\d{{{decimals}}})\d+" if decimals else r"()\.\d+"
    for drawn, variable in VARIABLES.items():
        svg = svg.replace(f": {drawn}", f": var(--{variable})")
    svg = re.sub(
        r'(<path id="[^"]*")? d="[^"]*"',
        lambda path: re.sub(fine if path[1] else cut, r"\1", path[0]),
        svg,
    )
    svg = re.sub(r"<use [^>]*>", lambda use: re.sub(fine, r"\1", use[0]), svg)
    return re.sub(r">\s+<", "><", re.sub(r"\n\s*", " ", svg))


def _targets(marks: list[Marks], height: float) -> list[dict[str, Any]]:
    """Marks in the SVG's coordinates, at most `TARGETS` per figure."""
    share = _share([len(mark.rows) for mark in marks])
    shown = [(mark, thin(_inside(mark), share)) for mark in marks]
    targets = [_target(mark, rows, height) for mark, rows in shown if len(rows)]
    return targets[:TARGETS]


def _inside(mark: Marks) -> pd.DataFrame:
    """The rows of marks that lie within their axes."""
    x, y = mark.rows[mark.x].astype(float), mark.rows[mark.y].astype(float)
    across = x.between(*sorted(mark.axes.get_xlim()))
    upward = y.between(*sorted(mark.axes.get_ylim()))
    return mark.rows[across & upward]


def _target(mark: Marks, rows: pd.DataFrame, height: float) -> dict[str, Any]:
    """Some rows of marks: their places, and what is told and asked of each."""
    tips = {column: title for column, title in mark.tips.items() if column in rows}
    target = {
        "label": mark.label,
        "names": [*tips.values()],
        "command": mark.command,
        "rows": _placed(mark, rows, [*tips], height),
        **_starts(mark, rows),
    }
    if mark.above:
        target["above"] = True
    if mark.group is not None:
        target["line"] = mark.group
    return target


def _placed(
    mark: Marks, rows: pd.DataFrame, told: list[str], height: float
) -> list[list[Any]]:
    """Place, command or slope or what else drives, and words of each row."""
    points = rows[[mark.x, mark.y]].to_numpy(float)
    pixels = mark.axes.transData.transform(points)
    asked: list[Any] = [None] * len(rows)
    for column in (mark.along, "command"):  # the latter, where there are both
        if column in rows:
            asked = rows[column].tolist()

    columns = [rows[column].tolist() for column in told]
    placed = []
    for (x, y), own, *values in zip(pixels, asked, *columns, strict=True):
        place = [round(float(x), 1), round(float(height - y), 1)]
        placed.append([*place, own, *map(_text, values)])

    return placed


def _share(sizes: list[int]) -> int:
    """Largest number of points that each curve may show; what short curves leave is
    shared by the others.
    """
    share, rest = TARGETS, TARGETS
    for k, size in enumerate(sorted(sizes)):
        share = max(1, rest // (len(sizes) - k))
        if size > share:
            break
        rest -= size
    return share


def _starts(mark: Marks, rows: pd.DataFrame) -> dict[str, Any]:
    """What the page's script needs to start the gaits of a curve's points."""
    names = [name for name in START[1:] if name in rows]
    if len(names) < 3:  # without the rates of both legs the page's script finds them
        names = names[:1]
    if (
        not mark.command
        or "stance_angle" not in names
        or (mark.free and "stance_rate" not in names)
    ):
        return {}

    starts = [
        [v for v in rounded(row, 12) if v is not None]
        for row in rows[names].to_numpy(float)
    ]
    return {"starts": starts, **({"free": True} if mark.free else {})}


def key(line: Line2D) -> tuple[str, str, str]:
    """An entry of the legend in the page's own colours: its style, character and label."""
    colour = str(line.get_color())
    ink = f"var(--{VARIABLES[colour]})" if colour in VARIABLES else colour
    label = str(line.get_label())

    marker = str(line.get_marker())
    if marker != "None":
        forms = _CHARACTERS.get(marker, "●○")
        is_hollow = str(line.get_markerfacecolor()) in (PAPER, "#ffffff", "none")
        return f"color:{ink}", forms[-1 if is_hollow else 0], label

    dashes = {"-": "solid", ":": "dotted"}.get(str(line.get_linestyle()), "dashed")
    drawn = f"border-top:{line.get_linewidth():g}px {dashes} {ink}"
    alpha = line.get_alpha()
    return drawn if alpha is None else f"{drawn};opacity:{alpha:g}", "", label


def _panel(k: int, panels: list[Panel], height: float) -> dict[str, Any]:
    """A map in the SVG's coordinates: its axes, with the name and the values of each,
    and what its cells hold.

    Of what an earlier map has as well, the place of that map stands here: under `same`,
    or `as` of a field.
    """
    panel = panels[k]
    frame = _frame(panel.axes, height)
    for side, which in (("x", "columns"), ("y", "index")):
        values, first = (getattr(map.values, which) for map in (panel, panels[0]))
        frame[side]["name"] = values.name
        if not k or not np.array_equal(values, first):
            frame[side]["values"] = rounded(values, 12)

    earlier = [other.cells for other in panels[:k]]
    own, same = _apart(panel.cells, earlier)
    if "fields" in own:
        fields, places = _apart(own["fields"], [each["fields"] for each in earlier])
        repeated = {name: {"as": place} for name, place in places.items()}
        # In the order of the fields, which the page counts.
        own["fields"] = {
            name: fields.get(name, repeated.get(name)) for name in own["fields"]
        }

    if same:
        own["same"] = same
    return frame | own


def _apart(
    held: Mapping[str, Any], earlier: Sequence[Mapping[str, Any]]
) -> tuple[dict[str, Any], dict[str, int]]:
    """What only this map holds by a name, and the places of those that hold the rest."""
    own, places = dict[str, Any](), dict[str, int]()
    for name, value in held.items():
        place = _first(earlier, name, value)
        if place is None:
            own[name] = value
        else:
            places[name] = place

    return own, places


def _first(earlier: Sequence[Mapping[str, Any]], name: str, value: Any) -> int | None:
    """Place of the first mapping that has that value under a name, if it is worth to be
    referred to.
    """
    return next(
        (i for i, other in enumerate(earlier) if value and other.get(name) == value),
        None,
    )


def _frame(axes: Axes, height: float) -> dict[str, Any]:
    """Axes in the SVG's coordinates: corners, and for each axis its ends and its scale."""
    box, sides = axes.get_window_extent(), {}
    for side in "xy":
        limits, scale = (
            getattr(axes, f"get_{side}{what}")() for what in ("lim", "scale")
        )
        sides[side] = {
            "limits": rounded(limits),
            "log": scale == "log",
            "title": title_of(axes, side),
        }

    return {
        "box": [
            round(float(v), 2)
            for v in (box.x0, height - box.y1, box.x1, height - box.y0)
        ],
        **sides,
    }


def _text(value: Any) -> str:
    return plain(value, 7) if isinstance(value, float) else str(value)
