"""Gaits along lines: their quantities against slope or speed, those measured, and
residuals of the power laws.
"""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from gaitsweep.pipeline.report.figures import landmarks, measured
from gaitsweep.pipeline.report.figures.sketch import TIPS, Sketch
from gaitsweep.pipeline.report.figures.style import (
    COLOURS,
    DOTTED,
    INK,
    MUTED,
    PAPER,
    colour,
    draw_gait,
    draw_guide,
    end_labels,
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


QUANTITIES = {
    name: Quantity(words["heading"], **words["drawn"])
    for name, words in WORDS["figures"].items()
    if "drawn" in words
}


def quantity(name: str, source: Source) -> Sketch | None:
    """Plot a quantity of every gait against slope (the paper's figures 5 and 11) or
    speed.
    """
    shown = QUANTITIES[name]
    if shown.abscissa == "speed" and "froude_speed" in source.grid:
        shown = replace(
            shown,
            heading="power P/(m g √(g l))",
            reads=("froude_speed",),
            abscissa="froude_speed",
        )
    lines = [line for line in source.lines if set(shown.reads) <= set(line.data)]
    sketch, names, x, y = (
        Sketch(name, 350),
        _line_titles(source, lines),
        shown.abscissa,
        shown.heading,
    )
    (axes,) = sketch.panels
    _draw_lines(sketch, axes, source, shown, lines, names)
    if not sketch.pieces:
        return None
    sketch.gait_keys()
    data, laws = (
        sketch.data,
        _draw_laws(sketch, axes, source, lines, names) if shown.laws else {},
    )
    # Shares of several losses are drawn, which no measurement of one of them can be
    # compared with.
    if x == "slope" and len(shown.reads) == 1:
        measured.draw(sketch, axes, source, shown.reads[0])
    if shown.origin:
        axes.set_xlim(left=0)
        axes.set_ylim(bottom=0)
    if 1 < len(lines) <= len(COLOURS) or (shown.laws and len(lines) > 1):
        _label_lines(sketch, lines, names, x, y, "left" if shown.laws else "right")
    for at, words in shown.guides.items():
        draw_guide(axes, float(at), words)
    finite, called = (
        data[y][np.isfinite(data[y])],
        "speed v" if x == "speed" else spaced(x),
    )
    return sketch.finish(
        lines=names,
        heading=y,
        names=", ".join(names)
        if len(names) < 7
        else f"{len(names)} lines from {names[0]} to {names[-1]}",
        stable=(data["stable"] == 1).any(),
        least=finite.min(),
        most=finite.max(),
        count=data["line"].nunique(),
        gaits=", ".join(data["gait"].unique()),
        x=with_unit(called, source.units(x)),
        y=with_unit(y, source.units(shown.reads[0])),
        **laws,
    )


def measurements(source: Source) -> Sketch | None:
    """Plot every measured variable against slope, with the curves and their
    measurements.
    """
    rows, lines = measured.table(source), source.lines
    read = [line.curves(*measured.variables(source)) for line in lines]
    known = {column for curves in read for curve in curves for column in curve}
    variables = [name for name in measured.variables(source) if name in known]
    if not variables or "slope" not in rows:
        return None
    sketch = Sketch("measured", 60 + 250 * len(variables), len(variables), sharex=True)
    names = [line.label for line in lines]
    for axes, name in zip(sketch.panels, variables, strict=True):
        _draw_lines(
            sketch, axes, source, Quantity(name, (name,), samples=1800), lines, names
        )
        measured.draw(sketch, axes, source, name)
        sketch.mark(
            axes,
            rows,
            "measured",
            tips={"slope": "γ (rad)", name: spaced(name)},
            y=name,
        )
        set_heading(axes, titled(name, source.units(name)))
    sketch.gait_keys()
    sketch.line_keys(names)
    left = measured.residuals(source)
    largest = (
        left["residual"].abs().groupby(left["variable"], sort=False).max().dropna()
        if len(left)
        else {}
    )
    worst = "; the largest ".join(
        f"residual of {name} is {plain(value, 3)}" for name, value in largest.items()
    )
    return sketch.finish(
        lines=names, names=", ".join(variables), count=len(rows), worst=worst
    )


def _draw_lines(
    sketch: Sketch,
    axes: Axes,
    source: Source,
    shown: Quantity,
    lines: Sequence[Line],
    names: Sequence[str],
) -> None:
    """Draw a quantity of every gait of some lines, called so."""
    known, columns = (
        TIPS | {"spectral_radius": "max |λ|"},
        ("slope", shown.abscissa, *shown.reads, *shown.shows),
    )
    tips = {column: known.get(column, spaced(column)) for column in columns}
    for k, (line, name) in enumerate(zip(lines, names, strict=True)):
        curves = [
            thin(c, max(60, shown.samples // len(lines)))
            for c in line.curves(*shown.reads, *shown.shows)
        ]
        curves = [
            c.assign(**{shown.heading: shown.value(c)})
            for c in curves
            if set(shown.reads) <= set(c)
        ]
        gaits = dict.fromkeys(
            [*source.gaits, *(gait for curve in curves for gait in curve["gait"])]
        )
        for gait, curve in itertools.product(gaits, curves):
            _draw_curve(
                sketch,
                axes,
                curve,
                gait,
                line,
                k,
                name,
                tips,
                shown.abscissa,
                shown.heading,
            )


def _draw_curve(
    sketch: Sketch, axes: Axes, curve: pd.DataFrame, gait: str, line: Line, k: int, name: str,
    tips: Mapping[str, str], x: str, y: str,
) -> None:  # fmt: skip
    """Draw a gait of a curve of line k, called so, if the curve has it: with the points
    that it lacks, as gaps.
    """
    points = curve[(curve["gait"] == gait) & curve[y].notna()]
    if len(points):
        draw_gait(axes, curve, gait, k, k, x, y)
        how: Any = {"command": line.command, "tips": tips, "x": x, "y": y, "group": k}
        sketch.mark(axes, points, f"{gait} step · {name}", **how)
        sketch.pieces.append(
            points.drop(columns=list(RATES), errors="ignore").assign(line=line.label)
        )


def _label_lines(
    sketch: Sketch,
    lines: Sequence[Line],
    names: Sequence[str],
    x: str,
    y: str,
    side: str,
) -> None:
    """Write the name of each line at the right end of one of its curves, or at the left
    end of each of its gaits.
    """
    (axes,), ends = sketch.panels, []
    data = sketch.data[np.isfinite(sketch.data[[x, y]]).all(axis=1)]
    for k, (line, name) in enumerate(zip(lines, names, strict=True)):
        own = data[data["line"] == line.label]
        for _, rows in own.groupby("gait" if side == "left" else "line", sort=False):
            end = rows.loc[rows[x].idxmin() if side == "left" else rows[x].idxmax()]
            ends.append((end[x], end[y], name, colour(k)))
    end_labels(axes, ends, side)


def _draw_laws(
    sketch: Sketch, axes: Axes, source: Source, lines: list[Line], names: list[str]
) -> dict[str, Any]:
    """Draw fitted power laws and printed slopes; what is said of them."""
    fitted, crossings = (
        _draw_power_laws(source, axes, lines),
        _draw_fitted_lines(source, axes, lines, names),
    )
    if fitted:
        sketch.key("fitted", MUTED, lw=1, ls=DOTTED)
    if crossings:
        sketch.key("fitted on either side of the transition", INK, lw=0.6)
    printed = landmarks.draw_at_angles(sketch, axes, source)
    said = landmarks.sentence(printed[np.isfinite(printed["stance_angle"])])
    return {"fitted": fitted, "crossings": crossings, "printed": said}


def _line_titles(source: Source, lines: list[Line]) -> list[str]:
    """Names of the lines; the two foot mass ratios of the paper are called by the names
    of their walkers.
    """
    table, names = source.tables.get("fits/transition_ratio"), {}
    if (
        table is not None
        and len(table) == 1
        and {"pair", "foot_mass_ratios"} <= set(table.columns)
    ):
        pair, ratios = (
            str(table["pair"].iloc[0]).split(" / "),
            str(table["foot_mass_ratios"].iloc[0]).split(" / "),
        )
        names = {
            float(ratio): walker for walker, ratio in zip(pair, ratios, strict=True)
        }
    called = [names.get(line.at.get("foot_mass_ratio", np.nan), "") for line in lines]
    return [
        f"{name} ({line.label})" if name else line.label
        for name, line in zip(called, lines, strict=True)
    ]


def _draw_fitted_lines(
    source: Source, axes: Axes, lines: list[Line], names: list[str]
) -> str:
    """Draw the lines fitted to the short step's two regimes and their crossing; the
    crossings in words.
    """
    fields = (
        "foot_mass_ratio",
        "fitted_exponent",
        "fitted_amplitude",
        "fitted_cube_root",
        "slope_transition_fitted",
    )
    table = source.table("fits/transition", *fields)
    if table is None or len(lines) > 4:
        return ""
    words: list[str] = []
    left, right = axes.get_xlim()
    for line, name in zip(lines, names, strict=True):
        fits = rows_at(
            table, {"foot_mass_ratio": line.at.get("foot_mass_ratio", np.nan)}
        )
        for row in fits[np.isfinite(fits["slope_transition_fitted"])].itertuples():
            cross = row.slope_transition_fitted
            ink: Any = {"color": INK, "lw": 0.6, "zorder": 1.6}
            below, above = (
                np.array([line.data["slope"].values.min(), 3 * cross]),
                np.array([cross / 30, right]),
            )
            axes.plot(below, row.fitted_amplitude * below**row.fitted_exponent, **ink)
            axes.plot(above, row.fitted_cube_root * above ** (1 / 3), **ink)
            height = row.fitted_cube_root * cross ** (1 / 3)
            axes.plot([cross], [height], "o", color=INK, mfc=PAPER, ms=5, zorder=6)
            write_at(
                axes,
                f"{shorten(name, 12)}: γ = {plain(cross, 3)}",
                (cross, height),
                (8, -26 if words else -12),
            )
            x, law = 30 * below[0], f"θ* ∝ γᵖ, p = {plain(row.fitted_exponent)}"
            offset, how = (
                ((-4, 5), {"ha": "right"}) if words else ((9, -9), {"ha": "left"})
            )
            write_at(
                axes,
                law,
                (x, row.fitted_amplitude * x**row.fitted_exponent),
                offset,
                **how,
            )
            if not words:
                x = cross / 8
                write_at(
                    axes,
                    "p = 1/3",
                    (x, row.fitted_cube_root * x ** (1 / 3)),
                    (-4, 5),
                    ha="right",
                )
            words.append(f"{plain(cross, 3)} ({name.partition(' (')[0]})")
    axes.set_xlim(left, right)
    ratio = source.table("fits/transition_ratio", "fitted_lines", "predicted")
    sentence = f"They cross at {' and '.join(words)}"
    if ratio is not None and ratio["fitted_lines"].notna().all():
        fitted, predicted = (
            plain(ratio[name].iloc[0], 3) for name in ("fitted_lines", "predicted")
        )
        sentence += f", ratio {fitted}; the 3/2 law gives {predicted}"
    return f"{sentence}." if words else ""


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


def _draw_power_laws(source: Source, axes: Axes, lines: list[Line]) -> bool:
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
                    zorder=1.5,
                )
                drawn = True
    return drawn


def residuals(source: Source) -> Sketch | None:
    """Plot the relative residuals of the fitted power laws, each over its fitted range."""
    if "stance_angle" not in source.grid:
        return None
    sketch = Sketch("residuals", 210)
    (axes,) = sketch.panels
    names = _line_titles(source, source.lines)
    percent = "residual (%)"
    tips = {"slope": TIPS["slope"], percent: percent}
    for k, line in enumerate(source.lines):
        curves = list(line.curves("stance_angle"))
        for gait in source.gaits:
            for row, piece in itertools.product(
                _scaling_laws(source, line, gait).itertuples(), curves
            ):
                if any(
                    getattr(row, c, piece[c].iloc[0]) != piece[c].iloc[0]
                    for c in ("branch", "piece")
                ):
                    continue
                fitted = (piece["gait"] == gait) & piece["slope"].between(
                    row.slope_from, row.slope_to
                )
                used, regime = thin(piece[fitted], 80), getattr(row, "regime", "")
                law = row.amplitude * used["slope"] ** row.exponent
                used = used.assign(
                    **{
                        percent: 100 * (used["stance_angle"] / law - 1),
                        "regime": regime,
                    }
                )
                _draw_curve(
                    sketch,
                    axes,
                    used,
                    gait,
                    line,
                    k,
                    f"{names[k]} · {regime} slopes",
                    tips,
                    "slope",
                    percent,
                )
    if not sketch.pieces:
        return None
    axes.axhline(0, color=MUTED, lw=0.7)
    sketch.gait_keys()
    sketch.line_keys(names)
    return sketch.finish(lines=names, worst=sketch.data[percent].abs().max())
