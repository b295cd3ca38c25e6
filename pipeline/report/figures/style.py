"""One quiet style for every figure, and the way from matplotlib to an SVG that follows the page's colours."""

from __future__ import annotations

from typing import Any

import matplotlib
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

from pipeline.report.source import SYMBOLS

#: Widest a figure gets [pt]; its 10 pt text stays legible on a phone.
WIDTH = 400

#: Colours as drawn. On the page each one is a variable with a light and a dark value.
INK, MUTED, RULE, PAPER = "#1b1d20", "#5d6268", "#dfe2e6", "#fefefd"
GAIT_COLOURS = {"long": "#1f6fb2", "short": "#c04a08", "other1": "#7a4fa3", "other2": "#2a7a54"}
VARIABLES = {
    INK: "ink",
    MUTED: "muted",
    RULE: "rule",
    PAPER: "paper",
    **{colour: gait for gait, colour in GAIT_COLOURS.items()},
}

#: Colours inside pictures made of pixels, which cannot follow the page: legible on both grounds.
RASTER = {"long": "#3c8fd6", "short": "#e0691f"}

#: Dashes tell lines of one gait apart; the first is unbroken.
DASHES: tuple[Any, ...] = ("-", (0, (6, 1.6)), (0, (2, 1.4)), (0, (7, 1.5, 1.5, 1.5)), (0, (1, 1)), (0, (10, 3)))

#: Marks drawn as shapes rather than pixels, and points drawn of one curve.
SHAPES, SAMPLES = 2000, 600

_RC: Any = {
    "svg.fonttype": "none",
    "text.parse_math": False,
    "axes.unicode_minus": True,
    "path.simplify": True,
    "font.family": "DejaVu Sans",
    "font.size": 9.5,
    "axes.titlesize": 9.5,
    "axes.titleweight": "normal",
    "axes.labelsize": 9.5,
    "xtick.labelsize": 9,
    "ytick.labelsize": 9,
    "legend.fontsize": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": MUTED,
    "axes.linewidth": 0.7,
    "axes.labelcolor": INK,
    "axes.titlecolor": INK,
    "text.color": INK,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "axes.facecolor": "none",
    "figure.facecolor": "none",
    "savefig.facecolor": "none",
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": RULE,
    "grid.linewidth": 0.6,
    "xtick.major.size": 3,
    "ytick.major.size": 3,
    "xtick.minor.size": 0,
    "ytick.minor.size": 0,
    "xtick.major.width": 0.7,
    "ytick.major.width": 0.7,
    "legend.frameon": False,
    "legend.handlelength": 2.2,
    "legend.columnspacing": 1.6,
    "lines.solid_capstyle": "round",
}


def style() -> Any:
    """The context every figure is drawn in."""
    return matplotlib.rc_context({**matplotlib.rcParamsDefault, "backend": "svg", **_RC})


def canvas(height: float, width: float = WIDTH) -> Figure:
    """An empty figure of that size [pt]; one unit of its display is one point."""
    figure = Figure(figsize=(width / 72, height / 72), dpi=72, layout="constrained")
    FigureCanvasSVG(figure)
    return figure


def colour(gait: str) -> str:
    return GAIT_COLOURS.get(gait, INK)


def plain(value: float, digits: int = 4) -> str:
    """A number as people write it: 0.0153, 1.2 × 10⁻⁶, −3."""
    if not np.isfinite(value):
        return {np.inf: "∞", -np.inf: "−∞"}.get(float(value), "–")
    text = f"{value + 0.0:.{digits}g}"  # and never −0
    mantissa, _, exponent = text.partition("e")
    if exponent:
        power = _raised(int(exponent))
        text = f"10{power}" if mantissa == "1" else f"{mantissa} × 10{power}"
    return text.replace("-", "−")


def _narrow(low: float, high: float) -> bool:
    """True where fewer than two or three powers of ten are in view."""
    return high < 200 * low


class _Decades(LogLocator):
    """Ticks at powers of ten, and at 2 and 5 between them where few powers are in view."""

    def __call__(self) -> Any:
        assert self.axis is not None
        low, high = self.axis.get_view_interval()
        self.set_params(subs=(1.0, 2.0, 5.0) if _narrow(low, high) else (1.0,))
        return super().__call__()


def log_axis(axes: Axes, which: str) -> None:
    """A logarithmic axis, its decades written as powers of ten."""
    getattr(axes, f"set_{which}scale")("log")
    axis = getattr(axes, f"{which}axis")
    axis.set_major_locator(_Decades())
    axis.set_major_formatter(
        FuncFormatter(lambda value, _: plain(value, 2) if _narrow(*axis.get_view_interval()) else _decade(value))
    )
    axis.set_minor_locator(NullLocator())


def _decade(value: float) -> str:
    power = round(np.log10(value)) if value > 0 else 0
    return {0: "1", 1: "10"}.get(power, "10" + _raised(power))


def _raised(power: int) -> str:
    return str(power).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))


def curve(axes: Axes, x: pd.Series, y: pd.Series, stable: pd.Series, ink: str, k: int = 0) -> None:
    """Line k of a colour: thin where it exists, thick where it is stable; its dashes run on through both."""
    dash = DASHES[k % len(DASHES)]
    thick = dash if dash == "-" else (0, tuple(length / 2.2 for length in dash[1]))
    settled = stable.to_numpy() == 1
    # The thin line reaches one point into the thick one, so that no gap opens between them.
    inside = settled & np.roll(settled, 1) & np.roll(settled, -1)
    inside[[0, -1]] &= settled[[0, -1]]
    axes.plot(x, y.mask(inside), color=ink, lw=1.1, ls=dash)
    axes.plot(x, y.where(settled), color=ink, lw=2.6, ls=thick)


def named(frame: pd.DataFrame, gait: str) -> pd.Series:
    """Stance angles of a curve where it has that label, and one point beyond: no gap opens where its label changes."""
    here = frame["gait"] == gait
    return frame["stance_angle"].where(here | here.shift(fill_value=False))


def heading(axes: Axes, text: str) -> None:
    """The name of the vertical axis, written level above its end."""
    axes.set_title(text, loc="left", pad=7)


def brief(name: str, most: int = 30) -> str:
    """A name no longer than a figure has room for."""
    return name if len(name) <= most else name[: most - 1] + "…"


def thin(frame: pd.DataFrame, most: int = SAMPLES) -> pd.DataFrame:
    """At most so many rows, evenly chosen, ends kept."""
    if len(frame) <= most:
        return frame
    return frame.iloc[np.unique(np.linspace(0, len(frame) - 1, most).round().astype(int))]


def rows_of(every: list[dict[str, Any]], most: int) -> list[dict[str, Any]]:
    """At most so many of a figure's rows, evenly chosen, the first and the last among them."""
    return [every[i] for i in np.unique(np.linspace(0, len(every) - 1, min(most, len(every))).round().astype(int))]


def told(at: dict[str, Any]) -> str:
    """Where on the other axes a row lies: a walker's name, values with their symbols."""
    return ", ".join(str(v) if k == "walker" else f"{SYMBOLS.get(k, k)} = {plain(float(v), 6)}" for k, v in at.items())


def places(drawn: list[dict[str, Any]], every: list[dict[str, Any]]) -> str:
    """What a caption says of a figure's rows."""
    if len(every) < 2:
        return ""
    head = "Rows" if len(drawn) == len(every) else f"Rows, {len(drawn)} of {len(every)}"
    return f" {head}: {'; '.join(map(told, drawn))}."


def end_labels(axes: Axes, labels: list[tuple[float, float, str, str]], gap: float = 11) -> None:
    """Names left of curves that start at (x, y), in room made for them; names that would collide share one line."""
    (left, right), log = axes.get_xlim(), axes.get_xscale() == "log"
    axes.set_xlim(left * (left / right) ** 0.2 if log else left - 0.2 * (right - left), right)
    placed: list[tuple[float, float, float, list[str], str]] = []
    for x, y, name, ink in sorted(labels, key=lambda item: (item[3], item[1])):
        height = axes.transData.transform((x, y))[1]
        if placed and abs(height - placed[-1][0]) < gap and placed[-1][4] == ink:
            placed[-1][3].append(name)
        else:
            placed.append((height, x, y, [name], ink))
    order = [name for _, _, name, _ in labels]
    lowest = -np.inf
    for height, x, y, names, ink in sorted(placed, key=lambda item: item[0]):
        lift = max(0.0, lowest + gap - height)
        lowest = height + lift
        axes.annotate(
            brief(_joined(sorted(names, key=order.index))),
            (x, y),
            xytext=(-5, lift),
            textcoords="offset points",
            ha="right",
            va="center",
            color=ink,
            fontsize=8.5,
            annotation_clip=False,
        )


def _joined(names: list[str]) -> str:
    """E, F · ρ = 0.1, 0.05: what the names share is said once; many are named by their ends."""
    heads = {name.partition(" = ")[0] for name in names}
    names = list(dict.fromkeys(names))
    if len(names) > 1 and len(heads) == 1 and " = " in names[0]:
        tails = [name.partition(" = ")[2] for name in names]
        return f"{heads.pop()} = " + (", ".join(tails) if len(tails) < 3 else f"{tails[0]} … {tails[-1]}")
    return ", ".join(names) if len(names) < 5 else f"{names[0]} … {names[-1]}"
