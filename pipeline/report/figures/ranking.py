"""What gaits depend on: keys ranked by what their tolerances change."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from matplotlib.axes import Axes

from gaitsweep.pipeline.report.figures.sketch import Sketch
from gaitsweep.pipeline.report.figures.style import INK, inks
from gaitsweep.pipeline.report.figures.tolerances import (
    given,
    in_words,
    listed,
    units_of_keys,
)
from gaitsweep.pipeline.report.source import Source
from gaitsweep.pipeline.study.tolerances import size

#: End of the names of derivatives.
_BY_KEY = "_by_key"
#: Measures that are drawn, in the order of the panels.
_MEASURES = ("speed", "stance_angle", "period")
#: Labels whose gaits are drawn, of the first walkers, and their distance in a row.
_GAITS = ("long", "short")
_MOST_WALKERS = 3
_APART = 0.2
#: Tolerances: of lengths over the leg, or in metres where they are in SI; of angles
#: [rad]; of masses and of gravity, over their values.
_OF_LEG, _IN_SI, _OF_ANGLE, _OF_VALUE = 5e-4, 5e-4, 5e-4, 0.01


@dataclass(frozen=True)
class _Tolerances:
    """How far the keys of a walker may be off: as the study says, which gives those of
    some keys with their units; where it gives none, all keys by their kinds.
    """

    walker: Mapping[str, Any]
    kinds: Mapping[str, str]
    given: Mapping[str, float | str]
    units: Mapping[str, str]

    @property
    def is_si(self) -> bool:
        """Whether the walker is in SI units."""
        return self.walker.get("units") == "SI"

    @property
    def length(self) -> float:
        """Tolerance of lengths [the walker's units]."""
        leg = float(self.walker["l_t"]) + float(self.walker["l_s"])
        return _IN_SI if self.is_si else _OF_LEG * leg

    def of(self, key: str) -> float:
        """Tolerance of a key [the walker's units]."""
        value = float(self.walker.get(key) or 0.0)
        if self.given:
            return size(self.given[key], value) if key in self.given else 0.0

        kind = self.kinds.get(key, "")
        if kind == "length":
            return self.length
        if kind == "angle":
            return _OF_ANGLE
        return _OF_VALUE * abs(value)

    def words(self, key: str) -> str:
        """A tolerance in words."""
        if self.given:
            return f"{in_words(self.given[key], self.units.get(key, ''))} in {key}"

        kind = self.kinds.get(key, "")
        if kind == "length":
            return f"{self.length_words} in {key}"
        return f"{_OF_ANGLE:g} rad in {key}" if kind == "angle" else f"1 % in {key}"

    @property
    def length_words(self) -> str:
        """The tolerance of lengths in words."""
        return "0.5 mm" if self.is_si else "0.05 % of the leg"


def sensitivities(source: Source) -> Sketch | None:
    """Plot by how much the tolerance of each key changes measures of gaits."""
    if not source.walkers:
        return None

    # Other pages load no module that knows keys.
    from gaitsweep.pipeline.study import units

    kinds = units.kinds()
    each = {
        name: _Tolerances(table, kinds, given(source), units_of_keys(source))
        for name, table in list(source.walkers.items())[:_MOST_WALKERS]
    }
    data = pd.DataFrame(_of_walkers(source.grid, each))
    if data.empty:
        return None

    first = data[data["measure"] == data["measure"].iloc[0]]
    sketch = _drawn(data, _ranked(first))
    told = _told(data, first, each)
    return sketch.finish(data.drop(columns="row"), given=listed(source), **told)


def _told(
    data: pd.DataFrame, first: pd.DataFrame, each: Mapping[str, _Tolerances]
) -> dict[str, Any]:
    """What the words of the figure take: its measures, and of the first of these the key
    on which it depends most.
    """
    greatest = first.loc[first["median"].idxmax()]
    tolerances = each[str(greatest["walker"])]
    measures = _words(data["measure"].unique().tolist())
    headings = dict(zip(("first", "second", "third"), measures, strict=False))

    return {
        **headings,
        "most": greatest["key"],
        "change": float(greatest["median"]),
        "of": measures[0],
        "tolerance": tolerances.words(str(greatest["key"])),
        "gait": " and ".join(data["gait"].unique()),
        "walker": ", ".join(data["walker"].unique()),
        "length": ", ".join(dict.fromkeys(one.length_words for one in each.values())),
        "angle": _OF_ANGLE,
        "ranked": True,
        "by_kind": not any(one.given for one in each.values()),
    }


def _of_walkers(
    grid: xr.Dataset, each: Mapping[str, _Tolerances]
) -> Iterator[dict[str, Any]]:
    """Changes of all walkers, by their tolerances."""
    for number, (name, tolerances) in enumerate(each.items()):
        own = grid.isel(walker=number) if "walker" in grid.dims else grid
        for change in _changes(own, tolerances):
            yield {"walker": name, **change}


def _ranked(changes: pd.DataFrame) -> list[str]:
    """Keys by the largest of their median changes."""
    greatest = changes.groupby("key", sort=False)["median"].max()
    return [str(key) for key in greatest.sort_values(ascending=False).index]


def _drawn(data: pd.DataFrame, ranked: list[str]) -> Sketch:
    """The figure, a panel for each measure, with keys as they are ranked, and the gaits
    of a label and walker below one another; the data gain the row of each.
    """
    measures = data["measure"].unique().tolist()
    series = data[["walker", "gait"]].drop_duplicates().values.tolist()
    height = 70 + (12 + 4 * len(series)) * len(ranked)
    sketch = Sketch("sensitivities", height, 1, len(measures), sharey=True)

    data["row"] = _rows(data, ranked)
    colours = _colours([walker for walker, _ in series])
    for walker, gait in series:
        ink = colours[walker]
        face = ink if gait == "long" else "none"
        is_own = (data["walker"] == walker) & (data["gait"] == gait)
        own = data[is_own]
        for axes, measure in zip(sketch.panels, measures, strict=True):
            _draw(sketch, axes, own[own["measure"] == measure], measure, ink, face)
        sketch.dot_key(f"{walker}, {gait}", ink, mfc=face, ms=4.5)

    sketch.panels[0].set_yticks([-k for k in range(len(ranked))], ranked)
    return sketch


def _rows(data: pd.DataFrame, ranked: list[str]) -> pd.Series:
    """Where each change is drawn: at the rank of its key, gaits apart."""
    number = data.groupby(["walker", "gait"], sort=False).ngroup()
    beside = number - 0.5 * number.max()
    return -data["key"].map(ranked.index) - _APART * beside


def _colours(walkers: list[str]) -> dict[str, str]:
    """The colour of each walker; of one alone that of words."""
    names = list(dict.fromkeys(walkers))
    if len(names) == 1:
        return {names[0]: INK}
    return dict(zip(names, inks(names), strict=True))


def _words(measures: list[str]) -> list[str]:
    """Names of measures as headings."""
    return [measure.replace("_", " ") for measure in measures]


def _changes(grid: xr.Dataset, tolerances: _Tolerances) -> Iterator[dict[str, Any]]:
    """Of each measure and key, by how much its tolerance changes the measure [%]: the
    least, the median and the largest over the gaits of a label.
    """
    held = [name for name in _MEASURES if f"{name}{_BY_KEY}" in grid and name in grid]
    gaits = grid["gait"].values.astype(str).tolist() if held else []
    for gait in filter(_GAITS.__contains__, gaits):
        there = grid.sel(gait=gait)
        for name in held:
            for key in there["key"].values.astype(str).tolist():
                rate = there[f"{name}{_BY_KEY}"].sel(key=key).values
                change = np.abs(rate / there[name].values) * tolerances.of(key) * 100
                change = change[np.isfinite(change)]
                if key != "slope" and len(change) and change.max() > 0:
                    yield {
                        "gait": gait,
                        "measure": name,
                        "key": key,
                        "least": change.min(),
                        "median": np.median(change),
                        "largest": change.max(),
                    }


def _draw(
    sketch: Sketch, axes: Axes, data: pd.DataFrame, measure: str, ink: str, face: str
) -> None:
    """Draw the changes of one measure."""
    if data.empty:
        return

    axes.set_xscale("log")
    axes.hlines(data["row"], data["least"], data["largest"], color=ink, lw=1)
    axes.plot(data["median"], data["row"], "o", color=ink, mfc=face, ms=4.5)
    tips = {"key": "key", "median": "change (%)", "largest": "at most (%)"}
    (words,) = _words([measure])
    sketch.mark(axes, data, words, tips=tips, x="median", y="row")
