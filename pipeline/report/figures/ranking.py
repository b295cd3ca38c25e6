"""What gaits depend on: keys ranked by what their tolerances change."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from matplotlib.axes import Axes

from gaitsweep.pipeline.report.figures.sketch import Sketch
from gaitsweep.pipeline.report.figures.style import INK
from gaitsweep.pipeline.report.source import Source

#: End of the names of derivatives.
_BY_KEY = "_by_key"
#: Measures that are drawn, in the order of the panels.
_MEASURES = ("speed", "stance_angle", "period")
#: Tolerances: of lengths over the leg, or in metres where they are in SI; of angles
#: [rad]; of masses and of gravity, over their values.
_OF_LEG, _IN_SI, _OF_ANGLE, _OF_VALUE = 5e-4, 5e-4, 5e-4, 0.01


@dataclass(frozen=True)
class _Tolerances:
    """How far the keys of a walker may be off."""

    walker: Mapping[str, Any]
    kinds: Mapping[str, str]

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
        kind = self.kinds.get(key, "")
        if kind == "length":
            return self.length
        if kind == "angle":
            return _OF_ANGLE
        return _OF_VALUE * abs(float(self.walker.get(key, 0.0)))

    def words(self, key: str) -> str:
        """A tolerance in words."""
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
    name, table = next(iter(source.walkers.items()))
    # Other pages load no module that knows keys.
    from gaitsweep.pipeline.study import units

    tolerances = _Tolerances(table, units.kinds())
    grid = source.grid.isel(walker=0) if "walker" in source.grid.dims else source.grid
    data = pd.DataFrame(_changes(grid, tolerances))
    if data.empty:
        return None

    first = data[data["measure"] == data["measure"].iloc[0]]
    ranked = first.sort_values("median", ascending=False)["key"].tolist()
    data["row"] = [-ranked.index(key) for key in data["key"]]
    sketch = _drawn(data, ranked)

    greatest = first.loc[first["median"].idxmax()]
    measures = _words(data["measure"].unique().tolist())
    headings = dict(zip(("first", "second", "third"), measures, strict=False))
    return sketch.finish(
        data.drop(columns="row"),
        **headings,
        most=greatest["key"],
        change=float(greatest["median"]),
        of=measures[0],
        tolerance=tolerances.words(str(greatest["key"])),
        gait=str(greatest["gait"]),
        walker=name,
        length=tolerances.length_words,
        angle=_OF_ANGLE,
    )


def _drawn(data: pd.DataFrame, ranked: list[str]) -> Sketch:
    """The figure, a panel for each measure, with keys as they are ranked."""
    measures = data["measure"].unique().tolist()
    height = 70 + 16 * len(ranked)
    sketch = Sketch("sensitivities", height, 1, len(measures), sharey=True)
    for axes, measure in zip(sketch.panels, measures, strict=True):
        _draw(sketch, axes, data[data["measure"] == measure], measure)
    sketch.panels[0].set_yticks([-k for k in range(len(ranked))], ranked)
    return sketch


def _words(measures: list[str]) -> list[str]:
    """Names of measures as headings."""
    return [measure.replace("_", " ") for measure in measures]


def _changes(grid: xr.Dataset, tolerances: _Tolerances) -> Iterator[dict[str, Any]]:
    """Of each measure and key, by how much its tolerance changes the measure [%]: the
    least, the median and the largest over the gaits of a label.
    """
    held = [name for name in _MEASURES if f"{name}{_BY_KEY}" in grid and name in grid]
    for gait in grid["gait"].values.astype(str).tolist() if held else ():
        there = grid.sel(gait=gait)
        if not np.isfinite(there[held[0]].values).any():
            continue
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
        return


def _draw(sketch: Sketch, axes: Axes, data: pd.DataFrame, measure: str) -> None:
    """Draw the changes of one measure."""
    axes.set_xscale("log")
    axes.hlines(data["row"], data["least"], data["largest"], color=INK, lw=1)
    axes.plot(data["median"], data["row"], "o", color=INK, ms=4.5)
    tips = {"key": "key", "median": "change (%)", "largest": "at most (%)"}
    (words,) = _words([measure])
    sketch.mark(axes, data, words, tips=tips, x="median", y="row")
