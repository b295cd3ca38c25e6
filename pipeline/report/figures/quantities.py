"""Quantities of gaits other than the stance angle: multipliers, losses, heelstrike, power and speed."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
import pandas as pd

from gaitsweep.pipeline.report.figures import measured
from gaitsweep.pipeline.report.figures.families import draw_curve, label_lines
from gaitsweep.pipeline.report.figures.sketch import Sketch
from gaitsweep.pipeline.report.figures.style import COLOURS, draw_guide, thin
from gaitsweep.pipeline.report.source import Source
from gaitsweep.pipeline.report.words import WORDS, spaced, with_unit


@dataclass(frozen=True)
class Quantity:
    """One figure: its heading, variables read, abscissa, and words at values marked across it.

    What is drawn is the first variable; of losses, the share of all but the first. A quantity of another unit than 1 is
    named with the unit of its first variable.
    """

    heading: str
    reads: tuple[str, ...]
    abscissa: str = "slope"
    guides: Mapping[str, str] = field(default_factory=dict)

    def value(self, frame: pd.DataFrame) -> pd.Series:
        """What is drawn, of each row of a frame; power over m g √(g l) follows from the dimensionless speed."""
        if self.abscissa == "froude_speed":
            return frame["froude_speed"] * np.sin(frame["slope"])
        first, *others = (frame[name].fillna(0.0) if "knee" in name else frame[name] for name in self.reads)
        is_loss = self.reads[0] == "loss_normal"
        return 1 - first / sum(others, start=first) if is_loss else first


QUANTITIES = {
    name: Quantity(words["heading"], **words["drawn"]) for name, words in WORDS["figures"].items() if "drawn" in words
}


def draw(name: str, source: Source) -> Sketch | None:
    """Plot a quantity of every gait against slope or speed."""
    quantity = QUANTITIES[name]
    if quantity.abscissa == "speed" and "froude_speed" in source.grid:
        quantity = replace(quantity, heading="power P/(m g √(g l))", reads=("froude_speed",), abscissa="froude_speed")
    lines = [line for line in source.lines if set(quantity.reads) <= set(line.data)]
    if not any(np.isfinite(line.data[quantity.reads[0]]).any() for line in lines):
        return None
    sketch = Sketch(name, 330)
    (axes,) = sketch.panels
    tips = {column: spaced(column) for column in ("slope", quantity.abscissa, *quantity.reads)}
    for k, line in enumerate(lines):
        for frame in line.curves(*quantity.reads):
            curve = thin(frame, max(60, 700 // len(lines)))
            curve = curve.assign(value=quantity.value(curve))
            for gait in source.gaits:
                draw_curve(sketch, curve, gait, line, k, line.label, tips, quantity.abscissa, "value")
    if not sketch.pieces:
        return None
    data, names = pd.concat(sketch.pieces, ignore_index=True), [line.label for line in lines]
    sketch.gait_keys(data)
    if 1 < len(lines) <= len(COLOURS):
        label_lines(sketch, lines, names, x=quantity.abscissa, y="value")
    for at, words in quantity.guides.items():
        draw_guide(axes, float(at), words)
    # Shares of several losses are drawn, which no measurement of one of them can be compared with.
    if quantity.abscissa == "slope" and len(quantity.reads) == 1:
        measured.draw(sketch, axes, source, quantity.reads[0])
    finite = data["value"][np.isfinite(data["value"])]
    said = {"heading": quantity.heading, "count": len(names), "low": finite.min(), "high": finite.max()}
    if quantity.abscissa != "slope":
        across, upward = (source.units(v) for v in (quantity.abscissa, quantity.reads[0]))
        speed = "speed v" if quantity.abscissa == "speed" else spaced(quantity.abscissa)
        said |= {"x": with_unit(speed, across), "y": with_unit(quantity.heading, upward)}
    return sketch.finish(data.rename(columns={"value": quantity.heading}), names, **said)
