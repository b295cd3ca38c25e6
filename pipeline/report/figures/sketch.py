"""A figure while it is drawn: panels, marks that a page walks along, legend, data, and
the values of its words.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from gaitsweep.pipeline.report.figures.style import (
    INK,
    MOST_COLOURS,
    VARIABLES,
    canvas,
    dash,
    set_heading,
    set_log,
)
from gaitsweep.pipeline.report.words import WORDS, fill, sentences, shorten, yes_or_no

#: What a gait's columns are called under the pointer.
TIPS = {"slope": "γ (rad)", "stance_angle": "θ* (rad)", "period": "period"}


@dataclass(frozen=True)
class Marks:
    """Points of one curve that show their values and the command that reproduces them
    under the pointer.

    They are `rows` of a frame that lie at two of its columns, and show those that
    `tips` names. The command is `command` with the row's value of what gaits are
    followed `along`, or the row's own where there is a column `command`. Rows with a stance angle also have its rates,
    from which the page's script starts them; with `free` they are steps of no gait.
    Points that are drawn `above` others are found before those that they hide.
    """

    axes: Axes
    rows: pd.DataFrame
    label: str
    command: str = ""
    tips: Mapping[str, str] = field(default_factory=lambda: TIPS)
    x: str = "slope"
    y: str = "stance_angle"
    along: str = "slope"
    group: int | None = None
    free: bool = False
    above: bool = False


@dataclass(frozen=True)
class Panel:
    """A map whose every cell has a gait, a motion or an outcome of its own.

    `values` are those of one of its quantities, over the keys along and down; `cells`
    is what the script needs to name and start one.
    """

    axes: Axes
    values: pd.DataFrame
    cells: Mapping[str, Any]


class Sketch:
    """A figure of some height [pt] with a grid of panels.

    Its `texts` are those of its name in `words.toml`, or of a figure of another package
    its own: title, caption and the like, titles of axes and which of these are
    logarithmic. They are filled in with the `values` given at the end. `lines` are the
    names of the groups of curves that the page highlights one at a time, and the names
    of their colours.
    """

    def __init__(
        self, name: str, height: float, rows: int = 1, columns: int = 1, **grid: Any
    ) -> None:
        self.texts: dict[str, Any] = WORDS["figures"].get(name, {})
        self.figure = canvas(height)
        self.grid: Any = self.figure.subplots(rows, columns, squeeze=False, **grid)
        self.panels: list[Axes] = list(self.grid.flat)
        self.marks: list[Marks] = []
        self.maps: list[Panel] = []
        self.keys: list[Any] = []
        self.legend: list[Line2D] = []  # the keys that the figure itself tells
        self.last_key: dict[
            str, Any
        ] = {}  # points that stand last in the legend, if there are any
        self.pieces: list[pd.DataFrame] = []
        self.values: dict[str, Any] = {}
        self.lines: list[tuple[str, str]] = []
        for axes, sides in zip(self.panels, self.texts.get("log", ()), strict=False):
            set_log(axes, sides)

    def mark(self, axes: Axes, rows: pd.DataFrame, label: str, **more: Any) -> None:
        """Add points, a row of a frame each, with the other fields of `Marks`."""
        self.marks.append(Marks(axes, rows, label, **more))

    def key(self, label: str, color: str = INK, **line: Any) -> None:
        """Add an entry to the legend."""
        self.keys.append(Line2D([], [], color=color, label=label, **line))

    def dot_key(
        self, label: str, color: str = INK, marker: str = "o", **line: Any
    ) -> None:
        """Add an entry of points to the legend."""
        self.key(label, color, ls="", marker=marker, **line)

    @property
    def data(self) -> pd.DataFrame:
        """What the figure shows: all pieces."""
        whole = len(self.pieces) == 1
        return (
            self.pieces[0]
            if whole
            else pd.concat(self.pieces or [pd.DataFrame()], ignore_index=True)
        )

    def gait_keys(self) -> None:
        """Add the dashes of the gaits drawn to the legend, and how stable ones are
        drawn if there are any.
        """
        data = self.data
        for gait in data["gait"].unique() if len(data) else ():
            if gait:
                self.key(shorten(f"{gait} step"), lw=1.4, ls=dash(gait))
        if "stable" in data and (data["stable"] == 1).any():
            self.key("stable", lw=2.6)

    def line_keys(self, names: Sequence[str], inks: Sequence[str]) -> None:
        """Add the colours of lines to the legend; if they are too many to tell, none."""
        if 1 < len(names) <= MOST_COLOURS:
            for name, ink in zip(names, inks, strict=True):
                self.key(shorten(name), ink, lw=2.2)

    def finish(
        self,
        data: pd.DataFrame | None = None,
        lines: Sequence[str] = (),
        inks: Sequence[str] = (),
        abscissa: str = "slope",
        **values: Any,
    ) -> "Sketch":
        """Keep the figure's data, its lines with their inks and the values of its
        words, and write the titles of its axes.

        Unless others are given, `count` is the number of its rows, `low` and `high` are
        the ends of their slopes, or of their `abscissa`. Where not `every` line is
        `drawn`, some are `omitted`.
        """
        if self.last_key:
            self.dot_key(**self.last_key)
        data = self.data if data is None else data
        self.pieces = [
            data.assign(stable=yes_or_no(data["stable"])) if "stable" in data else data
        ]
        self.values = _known(data, values, abscissa) | values
        self.lines = [
            (name, VARIABLES[ink]) for name, ink in zip(lines, inks, strict=True)
        ]
        for axes, text in zip(self.panels, self.texts.get("y", ()), strict=False):
            set_heading(axes, fill(text, self.values))
        for axes in self.grid[-1] if "x" in self.texts else ():
            axes.set_xlabel(fill(self.texts["x"], self.values))
        return self

    def draw_legend(self, told: set[str]) -> None:
        """Draw the legend, without what a page has told already; that of this figure is
        told from then on.
        """
        self.legend = [key for key in self.keys if key.get_label() not in told]
        if self.legend:
            columns = self.texts.get("keys", 3)
            drawn = self.figure.legend(
                handles=self.legend, loc="outside upper left", ncols=columns
            )
            drawn.set_gid("told")

        told |= {
            *(str(key.get_label()) for key in self.legend),
            *(shorten(name) for name, _ in self.lines),
        }

    @property
    def words(self) -> tuple[str, str, str, str]:
        """Title, caption, alt text and finding."""
        words, every = self.texts, WORDS["figures"]["all"]
        parts = (
            {**words.get(part, {}), **every.get(part, {})}
            for part in ("caption", "finding")
        )
        caption, finding = (sentences(part, self.values).strip() for part in parts)

        return (
            fill(words["title"], self.values),
            caption,
            fill(words["alt"], self.values),
            finding,
        )


def _known(data: pd.DataFrame, values: Mapping[str, Any], along: str) -> dict[str, Any]:
    """Values of a figure's words that follow from its data."""
    known: dict[str, Any] = {
        "count": len(data),
        "omitted": values.get("drawn") != values.get("every"),
    }
    if along not in data:
        return known

    known |= {"low": data[along].min(), "high": data[along].max()}
    stable = data[data["stable"] == 1][along] if "stable" in data else data[along][:0]
    if len(stable):
        known |= {"stable_low": stable.min(), "stable_high": stable.max()}
    return known
