"""The style of all figures: colours, dashes, axes, numbers and labels."""

import contextlib
import itertools
import warnings
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from textwrap import fill
from typing import Any, NamedTuple

import matplotlib
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator
from matplotlib.transforms import ScaledTranslation

from gaitsweep.pipeline.report.words import axis_values, plain, shorten, superscript

#: Width of a figure [pt]; its text stays legible on a phone.
WIDTH = 480

#: Sizes of words of a figure on pages as narrow as a phone, in its own units: of most,
#: and of those drawn smaller than the latter's border. The page's style takes them from
#: here.
NARROW_WORDS, NARROW_SMALL_WORDS, SMALL_BELOW = 12, 11, 9

#: Colours as drawn, those of walkers in their order. On the page each is a CSS
#: variable, with a light and a dark value.
_GROUND = {"ink": "#1b1d20", "muted": "#5d6268", "rule": "#dfe2e6", "paper": "#fefefd"}
COLOURS = {
    "line0": "#1f6fb2", "line1": "#c04a08", "line2": "#2a7a54", "line3": "#8a6a00",
    "line4": "#a3246b", "line5": "#7a4fa3", "line6": "#00758a", "line7": "#8f3f2b",
    "line8": "#54606e", "line9": "#3f4fc4", "line10": "#5c7306",
}  # fmt: skip
INK, MUTED, RULE, PAPER = _GROUND.values()
LINE, SECOND = COLOURS["line0"], COLOURS["line1"]
VARIABLES = {colour: name for name, colour in (_GROUND | COLOURS).items()}

#: What the paper prints; nothing that is computed has its colour.
PRINTED = COLOURS["line5"]

#: The walkers of the catalogue have one colour each on every page.
WALKERS = {
    "A": COLOURS["line0"],
    "B": COLOURS["line1"],
    "C": COLOURS["line2"],
    "D": COLOURS["line3"],
    "E": COLOURS["line4"],
    "F": COLOURS["line6"],
    "physical": COLOURS["line7"],
    "physical-straight": COLOURS["line8"],
    "A-printed": COLOURS["line10"],
    "C-printed": COLOURS["line9"],
}

#: Colours of lines that are no walker of the catalogue.
_OTHERS = [colour for colour in COLOURS.values() if colour != PRINTED]

#: Most lines that colours tell apart.
MOST_COLOURS = len(_OTHERS)

#: Colours in raster images, which cannot follow the page: legible on light and dark
#: backgrounds.
RASTER = {"long": "#3c8fd6", "short": "#e0691f"}

#: Share of white that a colour takes up to be legible on both.
_LIGHTENED = 0.3

#: Dash patterns that distinguish the gaits of a walker, by their labels; another gait
#: is dotted.
_DASHES: dict[str, Any] = {
    "long": "-",
    "": "-",
    "short": (0, (6, 1.6)),
    "other1": (0, (7, 1.5, 1.5, 1.5)),
}

#: Dashes of laws, borders and guides.
DOTTED = (0, (1, 2))

#: Markers that distinguish lines of points.
MARKERS = "osD^vPXd"

#: Largest numbers of panels, one for each line, and of rows of maps, one for each value
#: of the other axes.
MAX_PANELS, MAX_ROWS = 9, 4

#: Size of words that keep clear of curves [pt].
_CLEAR_SIZE = 8.5

#: Least distance of names at the ends of curves [pt].
_GAP = 11

#: Label of the artists that are titles of panels.
_TITLE = "title of a panel"

#: Largest number of marks drawn as vectors, and of points drawn of one curve.
SHAPES, SAMPLES = 2000, 600

_RC = matplotlib.rc_params_from_file(
    Path(__file__).parent / "report.mplstyle", use_default_template=False
)


@contextlib.contextmanager
def style() -> Iterator[None]:
    """The matplotlib settings in which every figure is drawn, as a context."""
    with (
        matplotlib.rc_context({**matplotlib.rcParamsDefault, "backend": "svg", **_RC}),
        warnings.catch_warnings(),
    ):
        # Words stay words in the SVG: the reader's fonts have the glyphs that the font
        # of the layout lacks.
        warnings.filterwarnings("ignore", "Glyph .* missing from font", UserWarning)
        yield


def canvas(height: float) -> Figure:
    """An empty figure of that height [pt]; one display unit is one point."""
    figure = Figure(figsize=(WIDTH / 72, height / 72), dpi=72, layout=_Layout())
    FigureCanvasSVG(figure)
    return figure


class _Layout(ConstrainedLayoutEngine):
    """Matplotlib's layout of panels, and of words whose places follow from those of
    panels.
    """

    def __init__(self) -> None:
        super().__init__()
        self._waiting: list[Callable[[], None]] = []

    def then(self, write: Callable[[], None]) -> None:
        """Have words written after the panels were laid out."""
        self._waiting.append(write)

    def execute(self, figure: Figure) -> None:
        """Lay out panels, then write the words that wait for their places."""
        for axes in every_axes(figure):
            for axis in (axes.xaxis, axes.yaxis):
                if not axis.get_label_text():
                    # Of no title the place would be found by measuring all numbers.
                    axis.set_label_coords(0, 0)

        super().execute(figure)
        while self._waiting:
            self._waiting.pop(0)()


def every_axes(figure: Figure) -> list[Any]:
    """Axes of a figure, and those within them."""
    inner = [child for axes in figure.axes for child in axes.child_axes]
    return [*figure.axes, *inner]


def colour(k: int) -> str:
    """The k-th colour of things that are no walkers of the catalogue."""
    return _OTHERS[k % MOST_COLOURS]


def inks(called: Sequence[str]) -> list[str]:
    """Colours of lines by what each is called: a walker's own, which one line alone
    has; others take those that are left, in their order.
    """
    fixed: dict[int, str] = {}
    for k, name in enumerate(called):
        if name in WALKERS and WALKERS[name] not in fixed.values():
            fixed[k] = WALKERS[name]

    left = [ink for ink in _OTHERS if ink not in fixed.values()] or _OTHERS
    others = [k for k in range(len(called)) if k not in fixed]
    taken = {k: left[i % len(left)] for i, k in enumerate(others)}
    return [(fixed | taken)[k] for k in range(len(called))]


def on_both(ink: str) -> str:
    """A colour made lighter, for rasters, which stand on light and dark pages alike."""
    parts = [int(ink[i : i + 2], 16) for i in (1, 3, 5)]
    lighter = [round(part + _LIGHTENED * (255 - part)) for part in parts]
    return "#" + "".join(f"{part:02x}" for part in lighter)


def dash(gait: str) -> Any:
    """Dash pattern of a gait's label."""
    return _DASHES.get(gait, (0, (2, 1.4)))


def _wide_dash(gait: str) -> Any:
    """The same pattern for thick lines, whose dashes are counted in their width."""
    pattern = dash(gait)
    return pattern if pattern == "-" else (0, tuple(part / 2.2 for part in pattern[1]))


def _is_narrow(low: float, high: float) -> bool:
    """Whether a logarithmic axis spans little more than two decades."""
    return high < 200 * low


class _Decades(LogLocator):
    """Ticks at powers of ten, and on narrow axes at twice and five times them."""

    def __call__(self) -> Any:
        assert self.axis is not None
        low, high = self.axis.get_view_interval()
        self.set_params(subs=(1.0, 2.0, 5.0) if _is_narrow(low, high) else (1.0,))
        return super().__call__()


def set_log(axes: Axes, which: str) -> None:
    """Make axes (`"x"`, `"y"` or `"xy"`) logarithmic, their decades written as powers
    of ten.
    """
    for side in which:
        getattr(axes, f"set_{side}scale")("log")
        axis: Axis = getattr(axes, f"{side}axis")
        axis.set_major_locator(_Decades())
        axis.set_major_formatter(FuncFormatter(partial(_tick, axis)))
        axis.set_minor_locator(NullLocator())


def _tick(axis: Axis, value: float, _: int) -> str:
    """A tick of a logarithmic axis: on a narrow one a number with digits that
    distinguish it, else a power of ten.
    """
    low, high = axis.get_view_interval()
    if _is_narrow(low, high):
        return plain(value, 2 if high > 2 * low else 4)
    power = round(np.log10(value)) if value > 0 else 0
    return {0: "1", 1: "10"}.get(power, "10" + superscript(power))


def draw_gait(
    axes: Axes, curve: pd.DataFrame, gait: str, ink: str, group: int | None = None,
    x: str = "slope", y: str = "stance_angle",
) -> None:  # fmt: skip
    """Draw a line, in its colour, where it has a gait's label: thin, and thick where it
    is stable; one point as a dot.

    It goes one point beyond, so that a new label leaves no gap. Where stability changes
    between two points, `add_borders` has given the curve a point. `group` is the number
    of the line that the page highlights as one. Thin lines lie above thick ones, which
    would hide an unstable gait beside a stable one.
    """
    has_label = curve["gait"] == gait
    goes_on = has_label | has_label.shift(fill_value=False)
    across, upward = curve[x], curve[y].where(goes_on)
    is_stable = np.zeros(len(curve), bool)
    if "stable" in curve:
        is_stable = (curve["stable"] == 1).to_numpy()

    how: Any = {"color": ink, "gid": None if group is None else f"line-{group}"}
    thick: Any = {"lw": 2.6, "ls": _wide_dash(gait), "zorder": 1.9}
    axes.plot(across, upward.where(is_stable), **thick, **how)
    thin_part = upward.mask(_inside(is_stable))
    axes.plot(across, thin_part, lw=1.1, ls=dash(gait), zorder=2, **how)

    alone = _alone(upward)
    for dots, size in ((alone & ~is_stable, 3), (alone & is_stable, 5)):
        if dots.any():
            axes.plot(across[dots], upward[dots], "o", ms=size, **how)


def _inside(is_stable: np.ndarray) -> np.ndarray:
    """Points of a thick line without its ends, over which a thin one extends, so that
    there is no gap between them.
    """
    inside = is_stable & np.roll(is_stable, 1) & np.roll(is_stable, -1)
    inside[[0, -1]] &= is_stable[[0, -1]]
    return inside


def _alone(values: pd.Series) -> pd.Series:
    """Points that have no neighbour, as lines of which they would be invisible."""
    before, after = values.shift(), values.shift(-1)
    return values.notna() & before.isna() & after.isna()


def write_at(
    axes: Axes,
    text: str,
    at: tuple[float, float],
    offset: tuple[float, float],
    **how: Any,
) -> None:
    """Write words beside a point, at a distance from it [pt], on ground that hides
    curves.
    """
    ground = {"facecolor": PAPER, "edgecolor": "none", "pad": 0.6, "alpha": 0.8}
    axes.annotate(
        text,
        at,
        xytext=offset,
        textcoords="offset points",
        **{"fontsize": 8.5, "bbox": ground, **how},
    )


def once_laid_out(axes: Axes, write: Callable[[], None]) -> None:
    """Have words written when the panels of a figure have their places, from which
    those of the words follow.
    """
    figure: Any = axes.figure
    figure.get_layout_engine().then(write)


def write_clear(
    axes: Axes,
    words: Sequence[tuple[str, tuple[float, float]]],
    places: Sequence[tuple[float, float, str]],
    **how: Any,
) -> None:
    """Write words beside a point each, at the first of some places, (right, up,
    alignment) of their middle line in points, where they stand on no curve and within
    the frame; at the last if none is free.
    """
    more: Any = {"fontsize": _CLEAR_SIZE, "va": "center", "bbox": None, **how}

    def write() -> None:
        curves = _pixels_of_curves(axes)
        for text, at in words:
            right, up, aligned = _free_place(axes, text, at, places, curves)
            write_at(axes, text, at, (right, up), ha=aligned, **more)

    if words:
        once_laid_out(axes, write)


def _free_place(
    axes: Axes,
    text: str,
    at: tuple[float, float],
    places: Sequence[tuple[float, float, str]],
    curves: np.ndarray,
) -> tuple[float, float, str]:
    """The first of some places where words stand on no pixel of curves, else the last."""
    across, upward = axes.transData.transform(at)
    width, height = 0.62 * _CLEAR_SIZE * len(text) + 2, _CLEAR_SIZE + 3

    for right, up, aligned in places:
        left = (
            across + right - {"left": 0.0, "center": 0.5, "right": 1.0}[aligned] * width
        )
        low = upward + up - height / 2
        apart = curves - np.array([left, low])
        is_inside = (
            axes.bbox.x0 <= left <= axes.bbox.x1 - width
            and axes.bbox.y0 <= low <= axes.bbox.y1 - height
        )
        if (
            is_inside
            and not ((apart >= 0) & (apart <= [width, height])).all(axis=1).any()
        ):
            break

    return right, up, aligned


def _pixels_of_curves(axes: Axes) -> np.ndarray:
    """Points (n, 2) of all curves of some axes, a point or two apart, and their marks."""
    found = [np.zeros((0, 2))]
    for line in axes.lines:
        points = line.get_transform().transform(np.asarray(line.get_xydata(), float))
        if line.get_linestyle() == "None":
            found.append(points)
            continue

        for start, end in itertools.pairwise(points):
            length = np.hypot(*(end - start))
            if np.isfinite(length):
                steps = np.linspace(0, 1, 2 + int(min(length, 2000) / 2))
                found.append(start + steps[:, None] * (end - start))

    return np.concatenate(found)


def draw_guide(axes: Axes, value: float, words: str) -> None:
    """Draw a guide across the axes, with its words at its right end, where no curve is."""
    axes.axhline(value, color=MUTED, lw=0.9, ls=DOTTED, zorder=1)
    how: Any = {
        "fontsize": 8,
        "color": MUTED,
        "va": "center",
        "xycoords": axes.get_yaxis_transform(),
    }
    write_at(axes, fill(words, 11), (1, value), (4, 0), annotation_clip=False, **how)


def hatch(axes: Axes) -> None:
    """Hatch the ground of a map: its cells without a value differ from every colour, on
    light and dark pages.
    """
    axes.grid(False)
    axes.patch.set(
        visible=True, facecolor="none", edgecolor=MUTED, hatch="////", linewidth=0
    )


def add_bar(picture: Any, axes: Sequence[Axes], **how: Any) -> Any:
    """Add the colour scale of a picture beside some axes, without a frame."""
    bar = axes[0].figure.colorbar(picture, ax=axes, shrink=0.9, aspect=24, **how)
    bar.outline.set_visible(False)
    bar.ax.grid(False)
    return bar


def on_map(level: float, low: float, high: float) -> str:
    """Ink of a contour on the colour map: light on its dark half, dark on its light
    half.
    """
    return "#ffffff" if level < low + 0.55 * (high - low) else "#101418"


def set_heading(axes: Axes, text: str) -> None:
    """Write the title of the vertical axis horizontally above its end."""
    set_title(axes, text, loc="left", pad=7)


def set_title(axes: Axes, text: str, **how: Any) -> None:
    """Write the title of a panel above its frame, in that place: where Matplotlib looks
    for one, it measures all words of the axes at every layout.
    """
    axes.set_title(text, y=1, **how).set_label(_TITLE)


def raise_titles(axes: Axes, points: float) -> None:
    """Raise the titles of a panel, by what stands above its frame."""
    up = ScaledTranslation(0, points / 72, axes.figure.dpi_scale_trans)
    for artist in axes.get_children():
        if artist.get_label() == _TITLE:
            artist.set_transform(artist.get_transform() + up)


def title_of(axes: Axes, side: str) -> str:
    """Title of an axis: that of all panels, its own, or the heading above it."""
    every = getattr(axes.figure, f"get_sup{side}label")()
    return str(
        every
        or getattr(axes, f"get_{side}label")()
        or (axes.get_title(loc="left") if side == "y" else "")
    )


def spread_evenly(count: int, most: int) -> np.ndarray:
    """Indices of some of many items, evenly spaced, the first and the last included.

    Parameters
    ----------
    count : int
        Number of items.
    most : int
        Largest number of indices.

    Returns
    -------
    ndarray of int, shape (n,)
        Increasing indices, n = min(count, most).
    """
    return np.unique(np.linspace(0, count - 1, min(most, count)).round().astype(int))


def thin(frame: pd.DataFrame, most: int = SAMPLES) -> pd.DataFrame:
    """At most `most` rows of a frame, evenly spaced, the first and the last included,
    and those at which stability changes.
    """
    if len(frame) <= most:
        return frame
    if "border" not in frame:
        return frame.iloc[spread_evenly(len(frame), most)]

    is_border = frame["border"].to_numpy(bool)
    computed = np.flatnonzero(~is_border)
    chosen = computed[spread_evenly(len(computed), most)]
    return frame.iloc[np.union1d(chosen, np.flatnonzero(is_border))]


def evenly(items: Sequence[Any], most: int) -> list[Any]:
    """At most `most` of some items, evenly spaced, the first and the last included."""
    return [items[i] for i in spread_evenly(len(items), most)] if items else []


def choose_rows(
    every: list[dict[str, Any]],
) -> tuple[list[dict[str, Any]], list[str], str]:
    """Rows of maps, one for each value of some axes: those drawn, what tells each from
    the others, and a sentence.
    """
    rows, keys = (
        evenly(every, MAX_ROWS),
        [key for key in every[0] if any(at[key] != every[0][key] for at in every)],
    )
    names = [axis_values({key: at[key] for key in keys}) for at in rows]
    if len(every) == 2:
        return rows, names, f"Top: {names[0]}; bottom: {names[1]}."

    head = "Rows" if len(rows) == len(every) else f"Rows, {len(rows)} of {len(every)}"
    return rows, names, f"{head}: {'; '.join(names)}." if len(every) > 1 else ""


class End(NamedTuple):
    """The end of a curve, which its name stands beside, in its ink."""

    x: float
    y: float
    name: str
    ink: str


def end_labels(axes: Axes, ends: Sequence[End], side: str) -> None:
    """Write names in a column beside the ends of curves, at the left or the right, each
    joined to its end by a thin line; none stands on a curve, or beyond the frame.
    """
    share = _share_of_names(axes, ends)
    _add_room(axes, share, side)
    column = share - 0.02 if side == "left" else 1 - share + 0.02

    places = [axes.transLimits.transform(_on_scale(axes, end)) for end in ends]
    gap = _GAP / (0.75 * float(axes.figure.bbox.height))
    ends, heights = _without_repeats(ends, [float(y) for _, y in places], gap)
    for end, height in zip(ends, spread_heights(heights, gap), strict=True):
        name = axes.annotate(
            shorten(end.name),
            (end.x, end.y),
            xytext=(column, height),
            textcoords="axes fraction",
            ha="right" if side == "left" else "left",
            va="center",
            fontsize=8.5,
            color=end.ink,
            annotation_clip=False,
            arrowprops={
                "arrowstyle": "-",
                "color": end.ink,
                "lw": 0.5,
                # From the near edge of the name, which needs no search for a point of
                # its border.
                "patchA": None,
                "relpos": (1 if side == "left" else 0, 0.5),
                "shrinkA": 0,
                "shrinkB": 0,
            },
        )
        # Within the frame it takes no room, which is costly to find out.
        name.set_in_layout(False)


def _share_of_names(axes: Axes, ends: Sequence[End]) -> float:
    """Share of the width that the longest name takes beside the curves."""
    longest = max((len(shorten(end.name)) for end in ends), default=0)
    return min(0.4, (5.2 * longest + 22) / (0.86 * WIDTH))


def _add_room(axes: Axes, share: float, side: str) -> None:
    """Widen the horizontal axis, so that a share of it at one side is free."""
    log = axes.get_xscale() == "log"
    left, right = np.log(axes.get_xlim()) if log else axes.get_xlim()
    room = (right - left) * share / (1 - share)
    ends = np.array([left - room * (side == "left"), right + room * (side == "right")])
    axes.set_xlim(*(np.exp(ends) if log else ends))


def _on_scale(axes: Axes, end: End) -> tuple[float, float]:
    """A place as the scales of the axes have it, which limits are linear in."""
    x, y = axes.transScale.transform((end.x, end.y))
    return float(x), float(y)


def _without_repeats(
    ends: Sequence[End], heights: Sequence[float], gap: float
) -> tuple[list[End], list[float]]:
    """Ends from the lowest to the highest, with their heights; curves of one name that
    end side by side have it once.
    """
    kept: list[tuple[float, End]] = []
    for height, end in sorted(
        zip(heights, ends, strict=True), key=lambda item: item[0]
    ):
        is_told = any(
            end.name == other.name and height - below < gap for below, other in kept
        )
        if not is_told:
            kept.append((height, end))

    return [end for _, end in kept], [height for height, _ in kept]


def spread_heights(heights: Sequence[float], gap: float) -> list[float]:
    """Heights of rows of text, shares of the frame, as near as they can be to rising
    ones given and at least a gap apart, within the frame.
    """
    rows = len(heights)
    gap = min(gap, 1 / max(1, rows))
    # What remains when the gaps are taken away must not fall: its means over runs that
    # would.
    runs: list[list[float]] = []
    for k, height in enumerate(heights):
        runs.append([height - k * gap, 1.0])
        while len(runs) > 1 and runs[-2][0] > runs[-1][0]:
            value, count = runs.pop()
            before = runs[-1]
            before[0] = (before[0] * before[1] + value * count) / (before[1] + count)
            before[1] += count

    low, high = gap / 2, 1 - gap / 2 - (rows - 1) * gap
    bases = [
        min(high, max(low, value)) for value, count in runs for _ in range(int(count))
    ]
    return [base + k * gap for k, base in enumerate(bases)]
