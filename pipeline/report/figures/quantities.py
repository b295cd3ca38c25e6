"""Quantities of gaits other than the stance angle: multipliers, losses, heelstrike, power and speed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
import pandas as pd

from pipeline.report.figures import measured
from pipeline.report.figures.sketch import Sketch
from pipeline.report.figures.style import DOTTED, MUTED, draw_gait, set_heading, set_log, thin
from pipeline.report.source import RATES, Source
from pipeline.report.words import WORDS, spaced, with_unit


@dataclass(frozen=True)
class Quantity:
    """One figure: variables read, what is drawn of them, abscissa, logarithmic axes and values marked across it.

    A quantity of another unit than 1 is named with the unit of its first variable.
    """

    reads: tuple[str, ...]
    value: Callable[[pd.DataFrame], pd.Series]
    abscissa: str = "slope"
    log: str = "x"
    guides: Mapping[float, str] = field(default_factory=dict)


def _share(frame: pd.DataFrame) -> pd.Series:
    total = frame["loss_normal"] + frame["loss_tangential"] + frame["loss_kneestrike"].fillna(0.0)
    return 1 - frame["loss_normal"] / total


QUANTITIES = {
    "multipliers": Quantity(
        ("spectral_radius",), lambda frame: frame["spectral_radius"], log="xy", guides={1.0: "border of stability"}
    ),
    "losses": Quantity(("loss_normal", "loss_tangential", "loss_kneestrike"), _share),
    "heelstrike": Quantity(
        ("heelstrike_rate_ratio",),
        lambda frame: frame["heelstrike_rate_ratio"],
        guides={0.5: "long below, short above", 1.0: "swing leg at rest"},
    ),
    "power": Quantity(("power", "speed"), lambda frame: frame["power"], abscissa="speed", log="xy"),
}


def draw(name: str, source: Source) -> Sketch | None:
    """Plot a quantity of every gait against slope or speed."""
    quantity, heading = QUANTITIES[name], WORDS["figures"][name]["heading"]
    lines = [line for line in source.lines if set(quantity.reads) <= set(line.data)]
    if not any(np.isfinite(line.data[quantity.reads[0]]).any() for line in lines):
        return None
    sketch = Sketch(330)
    (axes,) = sketch.panels
    set_log(axes, quantity.log)
    tips = {column: spaced(column) for column in ("slope", quantity.abscissa, *quantity.reads)}
    for k, line in enumerate(lines):
        for frame in line.curves(*quantity.reads):
            curve = thin(frame, max(60, 700 // len(lines)))
            curve = curve.assign(value=quantity.value(curve))
            for gait in (g for g in source.gaits if (curve["gait"] == g).any()):
                part = curve[(curve["gait"] == gait) & curve["value"].notna()]
                # With the points that the gait lacks, so that no line crosses a gap.
                draw_gait(axes, curve, gait, k, k, quantity.abscissa, "value")
                label, x = f"{gait} step · {line.label}", quantity.abscissa
                sketch.mark_gaits(axes, part, label, line.command, tips, x, "value", group=k)
                sketch.pieces.append(part.drop(columns=list(RATES), errors="ignore").assign(line=line.label))
    if not any(len(piece) for piece in sketch.pieces):
        return None
    for value, words in quantity.guides.items():
        axes.axhline(value, color=MUTED, lw=0.9, ls=DOTTED, zorder=1)
        place = {"xycoords": axes.get_yaxis_transform(), "xytext": (0, 3), "textcoords": "offset points"}
        axes.annotate(words, (0.005, value), fontsize=8, color=MUTED, **place)  # type: ignore[arg-type]
    _name_axes(sketch, source, quantity, heading)
    data, names = pd.concat(sketch.pieces, ignore_index=True), [line.label for line in lines]
    sketch.gait_keys(data)
    sketch.line_keys(names)
    # Shares of several losses are drawn, which no measurement of one of them can be compared with.
    is_read = quantity.abscissa == "slope" and len(quantity.reads) == 1
    if is_read and measured.draw(axes, source, quantity.reads[0]):
        sketch.dot_key(**measured.KEY)
    finite = data["value"][np.isfinite(data["value"])]
    ends = {"low": finite.min(), "high": finite.max()}
    return sketch.finish(data, 4, names if len(names) > 2 else [], heading=heading, count=len(names), **ends)


def _name_axes(sketch: Sketch, source: Source, quantity: Quantity, heading: str) -> None:
    mixed = len(set(source.grid["walker_units"].values.tolist())) > 1 if "walker_units" in source.grid else False
    (axes,) = sketch.panels
    if quantity.abscissa == "slope":
        axes.set_xlabel("slope γ (rad)")
        set_heading(axes, heading)
        return
    across, upward = (
        "each walker's units" if mixed else source.units(v) for v in (quantity.abscissa, quantity.reads[0])
    )
    axes.set_xlabel(with_unit(f"{quantity.abscissa} v", across))
    set_heading(axes, with_unit(heading, upward))
