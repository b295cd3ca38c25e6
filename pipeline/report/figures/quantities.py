"""Quantities of gaits other than the stance angle: multipliers, losses, heelstrike, power and speed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from pipeline.report.figures import measured
from pipeline.report.figures.style import (
    DASHES,
    INK,
    MUTED,
    canvas,
    colour,
    draw_curve,
    labelled,
    log_axis,
    plain,
    set_heading,
    shorten,
    thin,
)
from pipeline.report.figures.svg import Marks, Sketch
from pipeline.report.source import RATES, Line, Source


@dataclass(frozen=True)
class _Quantity:
    """One figure: variables read, abscissa, its title, and what is drawn of the variables.

    `guides` are values marked across the figure, with their words; a quantity of another unit than 1 is named with the
    unit of its first variable.
    """

    reads: tuple[str, ...]
    title: str
    heading: str
    caption: str
    value: Callable[[pd.DataFrame], pd.Series]
    abscissa: str = "slope"
    log: str = "x"
    guides: Mapping[float, str] | None = None


def _share(frame: pd.DataFrame) -> pd.Series:
    total = frame["loss_normal"] + frame["loss_tangential"] + frame["loss_kneestrike"].fillna(0.0)
    return 1 - frame["loss_normal"] / total


_QUANTITIES = {
    "multipliers": _Quantity(
        ("spectral_radius",),
        "Stability",
        "largest magnitude of the multipliers, max |λ|",
        "Largest magnitude of the step map's multipliers against slope; a gait is stable below the line at 1.",
        lambda frame: frame["spectral_radius"],
        log="xy",
        guides={1.0: "border of stability"},
    ),
    "losses": _Quantity(
        ("loss_normal", "loss_tangential", "loss_kneestrike"),
        "Losses",
        "share of the loss from tangential heelstrike and kneestrike",
        "Share of the energy lost in each step that the tangential velocity at heelstrike and kneestrike account for; "
        "the rest is lost by the normal velocity.",
        _share,
    ),
    "heelstrike": _Quantity(
        ("heelstrike_rate_ratio",),
        "Rates just before heelstrike",
        "(thigh rate − stance rate)/|stance rate|",
        "Difference of the legs' rates over the stance rate just before heelstrike: 0 where both legs turn alike and "
        "the foot meets the ground along the normal; above 1 the swing leg still swings forward.",
        lambda frame: frame["heelstrike_rate_ratio"],
        guides={0.5: "long below, short above", 1.0: "swing leg at rest"},
    ),
    "power": _Quantity(
        ("power", "speed"),
        "Power against speed",
        "power P",
        "Mean power drawn from gravity against mean speed on logarithmic axes: P ∝ v⁴ where the normal heelstrike "
        "dominates the loss, P ∝ v² where tangential velocity or kneestrike does.",
        lambda frame: frame["power"],
        abscissa="speed",
        log="xy",
    ),
}


def multipliers(source: Source) -> Sketch | None:
    """Plot the spectral radius of every gait against slope."""
    return _draw(source, _QUANTITIES["multipliers"])


def losses(source: Source) -> Sketch | None:
    """Plot the share of losses other than by the normal velocity at heelstrike against slope."""
    return _draw(source, _QUANTITIES["losses"])


def heelstrike(source: Source) -> Sketch | None:
    """Plot the difference of the legs' rates just before heelstrike against slope."""
    return _draw(source, _QUANTITIES["heelstrike"])


def power(source: Source) -> Sketch | None:
    """Plot power against speed."""
    return _draw(source, _QUANTITIES["power"])


def _draw(source: Source, quantity: _Quantity) -> Sketch | None:
    lines = [line for line in source.lines if set(quantity.reads) <= set(line.data)]
    if not any(np.isfinite(line.data[quantity.reads[0]]).any() for line in lines):
        return None
    figure = canvas(330)
    axes = figure.add_subplot()
    for which in quantity.log:
        log_axis(axes, which)
    pieces, marks = [], []
    for k, line in enumerate(lines):
        for frame in line.curves(*quantity.reads):
            curve = thin(frame, max(60, 700 // len(lines)))
            curve = curve.assign(value=quantity.value(curve))
            for gait in (g for g in source.gaits if (curve["gait"] == g).any()):
                part = curve[(curve["gait"] == gait) & curve["value"].notna()]
                # With the points that the gait lacks, so that no line crosses a gap.
                y = labelled(curve, gait, "value")
                draw_curve(axes, curve[quantity.abscissa], y, curve["stable"], colour(gait), k, k)
                marks.append(_marks(axes, part, quantity, f"{gait} step · {line.label}", line, k))
                pieces.append(part.drop(columns=list(RATES), errors="ignore").assign(line=line.label))
    if not any(len(piece) for piece in pieces):
        return None
    for value, words in (quantity.guides or {}).items():
        axes.axhline(value, color=MUTED, lw=0.9, ls=(0, (1, 2)), zorder=1)
        at = {"xycoords": axes.get_yaxis_transform(), "xytext": (0, 3), "textcoords": "offset points"}
        axes.annotate(words, (0.005, value), fontsize=8, color=MUTED, **at)  # type: ignore[arg-type]
    unit = {name: source.units(name) for name in (quantity.reads[0], quantity.abscissa)}
    words = "slope γ" if quantity.abscissa == "slope" else f"{quantity.abscissa} v"
    mixed = len(set(source.grid["walker_units"].values.tolist())) > 1 if "walker_units" in source.grid else False
    if mixed:
        unit = dict.fromkeys(unit, "each walker's units")
    shown = "rad" if quantity.abscissa == "slope" else unit[quantity.abscissa]
    axes.set_xlabel(f"{words} ({shown})" if shown else words)
    shown = "" if quantity.abscissa == "slope" else unit[quantity.reads[0]]
    set_heading(axes, f"{quantity.heading} ({shown})" if shown else quantity.heading)
    data = pd.concat(pieces, ignore_index=True)
    gaits = list(data["gait"].unique())
    keys = [Line2D([], [], color=colour(g), lw=1.4, label=shorten(f"{g} step")) for g in gaits]
    keys.append(Line2D([], [], color=INK, lw=2.6, label="stable"))
    names = [line.label for line in lines]
    if 1 < len(names) <= len(DASHES):
        keys += [Line2D([], [], color=MUTED, lw=1.2, ls=DASHES[k], label=shorten(n)) for k, n in enumerate(names)]
    # Shares of several losses are drawn, which no measurement of one of them can be compared with.
    is_read = quantity.abscissa == "slope" and len(quantity.reads) == 1
    own = measured.draw(axes, source, quantity.reads[0]) if is_read else None
    keys += [own] if own else []
    figure.legend(handles=keys, loc="outside upper left", ncols=4)
    finite = data["value"][np.isfinite(data["value"])]
    return Sketch(
        figure,
        quantity.title,
        quantity.caption,
        f"{quantity.title}: {quantity.heading} against {quantity.abscissa} of {len(names)} walkers, from "
        f"{plain(finite.min())} to {plain(finite.max())}.",
        data,
        marks,
        names if len(names) > 2 else [],
    )


def _marks(axes: Axes, part: pd.DataFrame, quantity: _Quantity, label: str, line: Line, group: int) -> Marks:
    names = dict.fromkeys(("slope", quantity.abscissa, *quantity.reads))
    values = {name.replace("_", " "): part[name].to_numpy() for name in names if name in part}
    x, y = part[quantity.abscissa].to_numpy(), part["value"].to_numpy()
    return Marks(axes, x, y, label, values, line.command, part["slope"].to_numpy(), group=group, gaits=part)
