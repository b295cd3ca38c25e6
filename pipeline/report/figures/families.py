"""Gaits along lines: their quantities against slope or speed, those measured, and
residuals of the power laws.
"""

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import xarray as xr
from matplotlib.axes import Axes

from gaitsweep.pipeline.report.figures import landmarks, measured, tolerances
from gaitsweep.pipeline.report.figures.sketch import TIPS, Sketch
from gaitsweep.pipeline.report.figures.stability import add_borders
from gaitsweep.pipeline.report.figures.style import (
    DOTTED,
    INK,
    MOST_COLOURS,
    MUTED,
    PAPER,
    End,
    draw_gait,
    draw_guide,
    end_labels,
    inks,
    set_heading,
    thin,
    write_at,
)
from gaitsweep.pipeline.report.source import RATES, Line, Source, rows_at
from gaitsweep.pipeline.report.words import (
    WORDS,
    plain,
    shorten,
    spaced,
    titled,
    with_unit,
)

#: Most lines of which both fitted laws are drawn, with the place where they cross.
_MOST_CROSSINGS = 4

#: Heading of the residuals.
_PERCENT = "residual (%)"


@dataclass(frozen=True)
class Quantity:
    """One figure of gaits along lines: its heading, variables read, abscissa, and words
    at values marked across it.

    What is drawn is the first variable; of losses, the share of all but the first. A
    quantity of another unit than 1 is named with the unit of its first variable.
    `shows` are further variables under the pointer, `samples` points of all curves;
    with `laws` fitted power laws and printed slopes are drawn, with `origin` axes begin
    at zero.
    """

    heading: str
    reads: Sequence[str]
    abscissa: str = "slope"
    guides: Mapping[str, str] = field(default_factory=dict)
    shows: Sequence[str] = ()
    samples: int = 700
    laws: bool = False
    origin: bool = False

    def value(self, frame: pd.DataFrame) -> pd.Series:
        """What is drawn, of each row of a frame; power over m g √(g l) follows from the
        dimensionless speed.
        """
        if self.abscissa == "froude_speed":
            return frame["froude_speed"] * np.sin(frame["slope"])

        first, *others = (
            frame[name].fillna(0.0) if "knee" in name else frame[name]
            for name in self.reads
        )
        is_loss = self.reads[0] == "loss_normal"
        return 1 - first / sum(others, start=first) if is_loss else first

    @property
    def measures(self) -> Sequence[str]:
        """The measure that is drawn as it is against the slope, if one is."""
        is_drawn = self.abscissa == "slope" and len(self.reads) == 1
        return self.reads if is_drawn else ()


QUANTITIES = {
    name: Quantity(words["heading"], **words["drawn"])
    for name, words in WORDS["figures"].items()
    if "drawn" in words
}


def quantity(name: str, source: Source) -> Sketch | None:
    """Plot a quantity of every gait against slope (the paper's figures 5 and 11) or
    speed.
    """
    shown = _shown(name, source)
    lines = [line for line in source.lines if set(shown.reads) <= set(line.data)]
    drawn = _Lines.of(lines)

    sketch = Sketch(name, 350)
    (axes,) = sketch.panels
    _draw_lines(sketch, axes, source, shown, drawn)
    if not sketch.pieces:
        return None

    sketch.gait_keys()
    data = sketch.data
    laws = _draw_laws(sketch, axes, source, drawn) if shown.laws else {}
    # Shares of several losses are drawn, which no measurement of one of them can be
    # compared with.
    for name in shown.measures:
        measured.draw(sketch, axes, source, name)
    if shown.origin:
        axes.set_xlim(left=0)
        axes.set_ylim(bottom=0)

    if 1 < len(lines) <= MOST_COLOURS:
        _label_lines(axes, data, drawn, shown)
    for at, words in shown.guides.items():
        draw_guide(axes, float(at), words)

    values = _words(source, shown, drawn, data) | laws
    values |= tolerances.told(source, drawn.places, shown.measures)
    return sketch.finish(lines=drawn.names, inks=drawn.inks, **values)


def _shown(name: str, source: Source) -> Quantity:
    """What a figure shows; power over m g √(g l) and speed over √(g l) where the
    archive holds the latter.
    """
    shown = QUANTITIES[name]
    if shown.abscissa == "speed" and "froude_speed" in source.grid:
        return replace(
            shown,
            heading="power P/(m g √(g l))",
            reads=("froude_speed",),
            abscissa="froude_speed",
        )

    return shown


def _words(
    source: Source, shown: Quantity, drawn: "_Lines", data: pd.DataFrame
) -> dict[str, Any]:
    """The values of a figure's words."""
    finite = data[shown.heading][np.isfinite(data[shown.heading])]
    called = "speed v" if shown.abscissa == "speed" else spaced(shown.abscissa)
    names = ", ".join(drawn.names)
    if len(drawn.names) > 6:
        names = f"{len(drawn.names)} lines from {drawn.names[0]} to {drawn.names[-1]}"

    return {
        "heading": shown.heading,
        "names": names,
        "stable": (data["stable"] == 1).any(),
        "least": finite.min(),
        "most": finite.max(),
        "count": data["line"].nunique(),
        "gaits": ", ".join(data["gait"].unique()),
        "x": with_unit(called, source.units(shown.abscissa)),
        "y": with_unit(shown.heading, source.units(shown.reads[0])),
        "own_units": shown.abscissa == "speed",
        "over": shown.abscissa == "froude_speed",
    }


class _Lines(NamedTuple):
    """Lines of a figure with their names, what stands beside their curves, and colours."""

    lines: Sequence[Line]
    names: Sequence[str]
    short: Sequence[str]
    inks: Sequence[str]

    @classmethod
    def of(cls, lines: Sequence[Line]) -> "_Lines":
        """Lines called by the walker of the catalogue that each is, and by their
        labels.
        """
        names = []
        for line in lines:
            is_both = line.called and line.called != line.label
            names.append(f"{line.called} ({line.label})" if is_both else line.label)
        short = [line.called or line.label for line in lines]
        return cls(lines, names, short, inks([line.called for line in lines]))

    @property
    def places(self) -> list[tuple[xr.Dataset, Mapping[str, Any]]]:
        """The data of each line, and where it is."""
        return [(line.data, line.at) for line in self.lines]


def measurements(source: Source) -> Sketch | None:
    """Plot every measured variable against slope, with the curves and their
    measurements.
    """
    rows, lines = measured.table(source), source.lines
    variables = _drawable(lines, measured.variables(source))
    if not variables or "slope" not in rows:
        return None

    sketch = Sketch("measured", 60 + 250 * len(variables), len(variables), sharex=True)
    drawn = _Lines.of(lines)
    for axes, name in zip(sketch.panels, variables, strict=True):
        shown = Quantity(name, (name,), samples=1800)
        _draw_lines(sketch, axes, source, shown, drawn)
        measured.draw(sketch, axes, source, name)
        tips = {"slope": TIPS["slope"], name: spaced(name)}
        sketch.mark(axes, rows, "measured", tips=tips, y=name)
        set_heading(axes, titled(name, source.units(name)))

    sketch.gait_keys()
    sketch.line_keys(drawn.names, drawn.inks)

    return sketch.finish(
        lines=drawn.names,
        inks=drawn.inks,
        names=", ".join(variables),
        count=len(rows),
        worst=_worst_residuals(source),
        **tolerances.told(source, drawn.places, variables),
    )


def _drawable(lines: Sequence[Line], variables: Sequence[str]) -> list[str]:
    """Those of some variables of which lines have curves."""
    read = [line.curves(*variables) for line in lines]
    known = {column for curves in read for curve in curves for column in curve}
    return [name for name in variables if name in known]


def _worst_residuals(source: Source) -> str:
    """The largest residual of each measured variable, in words."""
    left = measured.residuals(source)
    if left.empty:
        return ""

    largest = left["residual"].abs().groupby(left["variable"], sort=False).max()

    return "; the largest ".join(
        f"residual of {name} is {plain(value, 3)}"
        for name, value in largest.dropna().items()
    )


def _draw_lines(
    sketch: Sketch, axes: Axes, source: Source, shown: Quantity, drawn: _Lines
) -> None:
    """Draw a quantity of every gait of some lines."""
    most = max(60, shown.samples // max(1, len(drawn.lines)))
    for k, own in enumerate(drawn.lines):
        data = tolerances.with_half_widths(source, own.data, own.at, shown.measures)
        line = replace(own, data=data)
        tips = _tips(source, line, shown)
        how = _Drawn(line, k, drawn.names[k], drawn.inks[k], tips, shown)
        curves = [
            _with_value(curve, shown, most)
            for curve in line.curves(*tips)
            if set(shown.reads) <= set(curve)
        ]
        gaits = dict.fromkeys(source.gaits)
        for curve in curves:
            gaits |= dict.fromkeys(curve["gait"])
        for gait, curve in itertools.product(gaits, curves):
            _draw_curve(sketch, axes, curve, gait, how)


def _tips(source: Source, line: Line, shown: Quantity) -> dict[str, str]:
    """What points of a line tell under the pointer, by the columns that hold it."""
    known = TIPS | {"spectral_radius": "max |λ|"}
    known |= {"period": source.period_title(line.at)}
    columns = ("slope", shown.abscissa, *shown.reads, *shown.shows)
    tips = {column: known.get(column, spaced(column)) for column in columns}
    for name in shown.measures:
        if tolerances.half_width(name) in line.data:
            tips[tolerances.half_width(name)] = f"± {known.get(name, spaced(name))}"
    return tips


class _Drawn(NamedTuple):
    """How a line's curves are drawn: its number, name and ink, and what its points
    tell.
    """

    line: Line
    number: int
    name: str
    ink: str
    tips: Mapping[str, str]
    shown: Quantity


def _with_value(curve: pd.DataFrame, shown: Quantity, most: int) -> pd.DataFrame:
    """At most some points of a curve, and the borders of stability, with what is
    drawn of each.
    """
    part = thin(add_borders(curve), most).reset_index(drop=True)
    return part.assign(**{shown.heading: shown.value(part)})


def _draw_curve(
    sketch: Sketch, axes: Axes, curve: pd.DataFrame, gait: str, how: _Drawn
) -> None:
    """Draw a gait of a curve, if the curve has it: with the points that it lacks, as
    gaps.
    """
    x, y = how.shown.abscissa, how.shown.heading
    is_drawn = (curve["gait"] == gait) & curve[y].notna()
    if "border" in curve:
        is_drawn &= ~curve["border"].astype(bool)
    points = curve[is_drawn]
    if points.empty:
        return

    for measure in how.shown.measures:
        tolerances.draw_band(axes, curve, gait, how.ink, how.number, x, y, measure)
    draw_gait(axes, curve, gait, how.ink, how.number, x, y)
    sketch.mark(
        axes,
        points,
        f"{gait} step · {how.name}",
        command=how.line.command,
        tips=how.tips,
        x=x,
        y=y,
        group=how.number,
    )
    kept = points.drop(columns=[*RATES, "border"], errors="ignore")
    sketch.pieces.append(kept.assign(**_about(how.line, "period" in kept)))


def _about(line: Line, has_periods: bool) -> dict[str, Any]:
    """Columns of a figure's data that tell its lines apart, and the unit of their
    periods if it has any.
    """
    units = line.data.get("walker_units")
    about: dict[str, Any] = {"line": line.label, **line.at}
    if units is not None and has_periods:
        about["period_unit"] = "s" if str(units.values) == "SI" else "own units"
    return about


def _label_lines(
    axes: Axes, data: pd.DataFrame, drawn: _Lines, shown: Quantity
) -> None:
    """Write the name of each line at the right end of one of its curves, or at the left
    end of each of its gaits.
    """
    x, y = shown.abscissa, shown.heading
    side = "left" if shown.laws else "right"
    known = data[np.isfinite(data[[x, y]]).all(axis=1)]
    ends = []
    for line, name, ink in zip(drawn.lines, drawn.short, drawn.inks, strict=True):
        own = known[known["line"] == line.label]
        for _, rows in own.groupby("gait" if side == "left" else "line", sort=False):
            last = rows[x].idxmin() if side == "left" else rows[x].idxmax()
            ends.append(End(rows.loc[last, x], rows.loc[last, y], name, ink))

    end_labels(axes, ends, side)


def _draw_laws(
    sketch: Sketch, axes: Axes, source: Source, drawn: _Lines
) -> dict[str, Any]:
    """Draw fitted power laws and printed slopes; what is said of them."""
    crossings = [] if len(drawn.lines) > _MOST_CROSSINGS else _crossings(source, drawn)
    if crossings:
        _draw_crossings(axes, crossings)
        sketch.key("fitted on either side of the transition", INK, lw=0.6)

    # Lines fitted on either side lie on these, and tell more.
    fitted = not crossings and _draw_power_laws(source, axes, drawn.lines)
    if fitted:
        sketch.key("fitted", MUTED, lw=1, ls=DOTTED)

    printed = landmarks.draw_at_angles(sketch, axes, source)
    said = landmarks.sentence(printed[np.isfinite(printed["stance_angle"])])
    words = _words_of_crossings(source, crossings)
    return {"fitted": fitted, "crossings": words, "printed": said}


class _Crossing(NamedTuple):
    """Two laws of one line, θ* = amplitude · γ^exponent below, θ* = cube_root · γ^(1/3)
    above, and the slopes where they cross and where the line begins.
    """

    name: str
    slope: float
    first: float
    exponent: float
    amplitude: float
    cube_root: float

    @property
    def angle(self) -> float:
        """Stance angle at which the laws cross."""
        return self.cube_root * self.slope ** (1 / 3)


def _crossings(source: Source, drawn: _Lines) -> list[_Crossing]:
    """The lines fitted to both regimes of the short step, by the slope at which they
    cross.
    """
    fields = (
        "foot_mass_ratio",
        "fitted_exponent",
        "fitted_amplitude",
        "fitted_cube_root",
        "slope_transition_fitted",
    )
    table = source.table("fits/transition", *fields)
    if table is None:
        return []

    found = []
    for line, name in zip(drawn.lines, drawn.short, strict=True):
        ratio = {"foot_mass_ratio": line.at.get("foot_mass_ratio", np.nan)}
        fits = rows_at(table, ratio)
        for row in fits[np.isfinite(fits["slope_transition_fitted"])].itertuples():
            found.append(
                _Crossing(
                    name,
                    row.slope_transition_fitted,
                    float(line.data["slope"].min()),
                    row.fitted_exponent,
                    row.fitted_amplitude,
                    row.fitted_cube_root,
                )
            )

    return sorted(found, key=lambda crossing: crossing.slope)


def _draw_crossings(axes: Axes, crossings: Sequence[_Crossing]) -> None:
    """Draw both laws of each line with a circle where they cross, and name the first
    at the left above its curve, the last at the right below it.
    """
    right = float(axes.get_xlim()[1])
    thin_ink: Any = {"color": INK, "lw": 0.6, "zorder": 1.6}
    for one in crossings:
        below = np.array([one.first, 3 * one.slope])
        above = np.array([one.slope / 30, right])
        axes.plot(below, one.amplitude * below**one.exponent, **thin_ink)
        axes.plot(above, one.cube_root * above ** (1 / 3), **thin_ink)
        axes.plot([one.slope], [one.angle], "o", color=INK, mfc=PAPER, ms=5, zorder=6)

    axes.set_xlim(right=right)

    _name_crossing(axes, crossings[0], (-3, 9), {"ha": "right", "va": "bottom"})
    if len(crossings) > 1:
        _name_crossing(axes, crossings[-1], (13, -9), {"ha": "left", "va": "top"})

    first = crossings[0]
    x = np.sqrt(first.first * first.slope)
    place = (x, first.cube_root * x ** (1 / 3))
    write_at(axes, "p = 1/3", place, (0, 8), ha="right", va="bottom", bbox=None)


def _name_crossing(
    axes: Axes, one: _Crossing, offset: tuple[float, float], how: dict[str, str]
) -> None:
    """Write the slope of a crossing beside it, and the law below beside its line."""
    said = f"{shorten(one.name, 12)}: γ = {plain(one.slope, 3)}"
    write_at(axes, said, (one.slope, one.angle), offset, bbox=None, **how)

    x = 30 * one.first
    place = (x, one.amplitude * x**one.exponent)
    law = f"θ* ∝ γᵖ, p = {plain(one.exponent)}"
    right, up = offset
    write_at(axes, law, place, (right, up / 2), bbox=None, **how)


def _words_of_crossings(source: Source, crossings: Sequence[_Crossing]) -> str:
    """Where the fitted lines cross, and the ratio of these slopes."""
    if not crossings:
        return ""

    slopes = [f"{plain(one.slope, 3)} ({one.name})" for one in crossings[::-1]]
    sentence = f"They cross at {' and '.join(slopes)}"
    ratio = source.table("fits/transition_ratio", "fitted_lines", "predicted")
    if ratio is not None and ratio["fitted_lines"].notna().all():
        fitted, predicted = (
            plain(ratio[name].iloc[0], 3) for name in ("fitted_lines", "predicted")
        )
        sentence += f", ratio {fitted}; the 3/2 law gives {predicted}"

    return f"{sentence}."


def _scaling_laws(source: Source, line: Line, gait: str) -> pd.DataFrame:
    """Fitted power laws θ* ∝ γ^p of one gait of one line."""
    table = source.table("fits/scaling", "quantity", "gait", "exponent", "amplitude")
    if table is None:
        return pd.DataFrame()

    table = table.rename(columns={"from": "slope_from", "to": "slope_to"})
    keep = (table["quantity"] == "stance_angle") & (table["gait"] == gait)
    table = table[
        keep & np.isfinite(table["exponent"]) & np.isfinite(table["amplitude"])
    ]
    return rows_at(table, line.at)


def _is_one_curve(rows: pd.DataFrame) -> bool:
    """Whether all laws belong to one piece of one branch."""
    return all(
        rows[column].nunique() == 1 for column in ("branch", "piece") if column in rows
    )


def _draw_power_laws(source: Source, axes: Axes, lines: Sequence[Line]) -> bool:
    """Draw the fitted laws; those of the two regimes of one curve extend to their
    crossing, as in figure 5.
    """
    drawn = False
    for line in lines:
        for gait in source.gaits:
            rows = _scaling_laws(source, line, gait)
            ends = [[r.slope_from, r.slope_to] for r in rows.itertuples()]
            if (
                len(rows) == 2
                and _is_one_curve(rows)
                and abs(np.diff(rows["exponent"])[0]) > 0.1
            ):
                (p, q), (a, b) = rows["exponent"], rows["amplitude"]
                cross = (b / a) ** (1 / (p - q))
                ends = [[min(lo, cross), max(hi, cross)] for lo, hi in ends]

            for row, (low, high) in zip(rows.itertuples(), ends, strict=True):
                slopes = np.array([low, high])
                axes.plot(
                    slopes,
                    row.amplitude * slopes**row.exponent,
                    color=MUTED,
                    lw=1,
                    ls=DOTTED,
                    zorder=2.1,
                )
                drawn = True

    return drawn


def residuals(source: Source) -> Sketch | None:
    """Plot the relative residuals of the fitted power laws, each over its fitted range."""
    if "stance_angle" not in source.grid:
        return None

    sketch = Sketch("residuals", 210)
    (axes,) = sketch.panels
    drawn = _Lines.of(source.lines)
    shown = Quantity(_PERCENT, ("stance_angle",))
    tips = {"slope": TIPS["slope"], _PERCENT: _PERCENT}
    for k, line in enumerate(drawn.lines):
        for regime, gait, part in _residuals_of(source, line):
            name = f"{drawn.names[k]} · {regime} slopes"
            how = _Drawn(line, k, name, drawn.inks[k], tips, shown)
            _draw_curve(sketch, axes, part, gait, how)

    if not sketch.pieces:
        return None

    axes.axhline(0, color=MUTED, lw=0.7)
    sketch.gait_keys()
    sketch.line_keys(drawn.names, drawn.inks)
    worst = sketch.data[_PERCENT].abs().max()
    return sketch.finish(lines=drawn.names, inks=drawn.inks, worst=worst)


def _residuals_of(
    source: Source, line: Line
) -> Iterator[tuple[str, str, pd.DataFrame]]:
    """Yield the regime, the gait and the points of each fitted law of a line, with
    their residuals.
    """
    curves = list(line.curves("stance_angle"))
    for gait in source.gaits:
        laws = _scaling_laws(source, line, gait).itertuples()
        for row, piece in itertools.product(laws, curves):
            places = [c for c in ("branch", "piece") if hasattr(row, c)]
            if any(getattr(row, c) != piece[c].iloc[0] for c in places):
                continue

            is_fitted = (piece["gait"] == gait) & piece["slope"].between(
                row.slope_from, row.slope_to
            )
            part = thin(piece[is_fitted], 80)
            law = row.amplitude * part["slope"] ** row.exponent
            regime = getattr(row, "regime", "")
            percent = 100 * (part["stance_angle"] / law - 1)
            yield regime, gait, part.assign(**{_PERCENT: percent, "regime": regime})
