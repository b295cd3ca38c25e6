"""The style of all figures: colours, dashes, axes, numbers and labels."""

import contextlib
import warnings
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from textwrap import fill
from typing import Any

import matplotlib
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

from gaitsweep.pipeline.report.words import axis_values, plain, shorten, superscript

#: Width of a figure [pt]; its text stays legible on a phone.
WIDTH = 480

#: Colours as drawn, those of walkers in their order. On the page each is a CSS
#: variable, with a light and a dark value.
_GROUND = {"ink": "#1b1d20", "muted": "#5d6268", "rule": "#dfe2e6", "paper": "#fefefd"}
COLOURS = {
    "line0": "#1f6fb2", "line1": "#c04a08", "line2": "#2a7a54",
    "line3": "#8a6a00", "line4": "#a3246b", "line5": "#7a4fa3",
}  # fmt: skip
INK, MUTED, RULE, PAPER = _GROUND.values()
LINE, SECOND, _, _, _, PRINTED = COLOURS.values()  # the last one: what the paper prints
VARIABLES = {colour: name for name, colour in (_GROUND | COLOURS).items()}

#: Colours in raster images, which cannot follow the page: legible on light and dark
#: backgrounds.
RASTER = {"long": "#3c8fd6", "short": "#e0691f"}

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
MAX_PANELS, MAX_ROWS = 6, 4

#: Least distance of names at the ends of curves [pt].
_GAP = 11

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
    figure = Figure(figsize=(WIDTH / 72, height / 72), dpi=72, layout="constrained")
    FigureCanvasSVG(figure)
    return figure


def colour(k: int) -> str:
    """Colour of the k-th walker, or line, of a study."""
    return tuple(COLOURS.values())[k % len(COLOURS)]


def dash(gait: str) -> Any:
    """Dash pattern of a gait's label."""
    return _DASHES.get(gait, (0, (2, 1.4)))


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
    axes: Axes, curve: pd.DataFrame, gait: str, k: int = 0, group: int | None = None, x: str = "slope",
    y: str = "stance_angle",
) -> None:  # fmt: skip
    """Draw line k, in its colour, where it has a gait's label: thin, and thick where it
    is stable; one point as a dot.

    It goes one point beyond, so that a new label leaves no gap. `group` is the number
    of the line that the page highlights as one.
    """
    has_label = curve["gait"] == gait
    across, upward = (
        curve[x],
        curve[y].where(has_label | has_label.shift(fill_value=False)),
    )
    is_stable = (
        (curve["stable"] == 1).to_numpy()
        if "stable" in curve
        else np.zeros(len(curve), bool)
    )
    thin = dash(gait)
    thick = thin if thin == "-" else (0, tuple(length / 2.2 for length in thin[1]))
    how: Any = {"color": colour(k), "gid": None if group is None else f"line-{group}"}
    # The thin line extends one point into the thick one, so that there is no gap
    # between them.
    inside = is_stable & np.roll(is_stable, 1) & np.roll(is_stable, -1)
    inside[[0, -1]] &= is_stable[[0, -1]]
    axes.plot(across, upward.mask(inside), lw=1.1, ls=thin, **how)
    axes.plot(across, upward.where(is_stable), lw=2.6, ls=thick, **how)
    # A line of one point is invisible.
    alone = upward.notna() & upward.shift().isna() & upward.shift(-1).isna()
    for dots, size in ((alone & ~is_stable, 3), (alone & is_stable, 5)):
        if dots.any():
            axes.plot(across[dots], upward[dots], "o", ms=size, **how)


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
    axes.set_title(text, loc="left", pad=7)


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
    """At most `most` rows of a frame, evenly spaced, the first and the last included."""
    return frame if len(frame) <= most else frame.iloc[spread_evenly(len(frame), most)]


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


def end_labels(
    axes: Axes, labels: Sequence[tuple[float, float, str, str]], side: str
) -> None:
    """Write names beside the ends (x, y) of curves, in their inks; those of one ink
    that would overlap share a line.
    """
    sign, log = 1 if side == "right" else -1, axes.get_xscale() == "log"
    left, right = np.log(axes.get_xlim()) if log else axes.get_xlim()
    placed: list[tuple[float, float, float, list[str], str]] = []
    for x, y, name, ink in sorted(labels, key=lambda item: item[1]):
        height = axes.transData.transform((x, y))[1]
        if placed and abs(height - placed[-1][0]) < _GAP and placed[-1][4] == ink:
            placed[-1][3].append(name)
        else:
            placed.append((height, x, y, [name], ink))
    order = [name for _, _, name, _ in labels]
    longest = max(
        (len(shorten(_merge_names(names))) for _, _, _, names, _ in placed), default=0
    )
    room = (right - left) * min(0.6, max(0.06, (5 * longest + 8) / (0.8 * WIDTH)))
    ends = np.array([left - room * (side == "left"), right + room * (side == "right")])
    axes.set_xlim(*(np.exp(ends) if log else ends))
    lowest = -np.inf
    for height, x, y, names, ink in sorted(placed, key=lambda item: item[0]):
        lift = max(0.0, lowest + _GAP - height)
        lowest = height + lift
        text = shorten(_merge_names(sorted(names, key=order.index)))
        how = {"ha": "left" if sign > 0 else "right", "va": "center", "bbox": None}
        write_at(
            axes,
            text,
            (x, y),
            (5 * sign, lift),
            color=ink,
            annotation_clip=False,
            **how,
        )


def _merge_names(names: list[str]) -> str:
    """Merge names as in `ρ = 0.1, 0.05`: a common symbol is written once, a long list
    is cut to its ends.
    """
    heads = {name.partition(" = ")[0] for name in names}
    names = list(dict.fromkeys(names))
    if len(names) > 1 and len(heads) == 1 and " = " in names[0]:
        tails = [name.partition(" = ")[2] for name in names]
        return f"{heads.pop()} = " + (
            ", ".join(tails) if len(tails) < 3 else f"{tails[0]} … {tails[-1]}"
        )
    return ", ".join(names) if len(names) < 5 else f"{names[0]} … {names[-1]}"
