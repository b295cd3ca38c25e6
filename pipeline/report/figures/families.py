"""Gaits along lines: stance angle (the paper's figures 5 and 11), other quantities, and residuals of the power laws."""

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
    SAMPLES,
    colour,
    dash,
    draw_gait,
    draw_guide,
    end_labels,
    thin,
    write_at,
)
from gaitsweep.pipeline.report.source import RATES, Line, Source, rows_at
from gaitsweep.pipeline.report.words import WORDS, plain, shorten, spaced, with_unit


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


def loglog(source: Source) -> Sketch | None:
    """Plot stance angle against slope on logarithmic axes, with the fitted power laws."""
    if not (drawn := _draw_families(source, "loglog")):
        return None
    sketch, lines, names = drawn
    (axes,) = sketch.panels
    fitted = _draw_power_laws(source, axes, lines)
    crossings = _draw_fitted_lines(source, axes, lines, names)
    measured.draw(sketch, axes, source, "stance_angle")
    printed = landmarks.rows(source)
    has_printed = bool(len(printed)) and landmarks.draw_at_angles(axes, printed)
    if len(lines) > 1:
        _label_lines(sketch, lines, names, "left")
    sentence = landmarks.sentence(printed[np.isfinite(printed["stance_angle"])]) if has_printed else ""
    return _finish(sketch, names, fitted=fitted, crossings=crossings, printed=sentence)


def linear(source: Source) -> Sketch | None:
    """Plot stance angle against slope on linear axes."""
    if not (drawn := _draw_families(source, "linear")):
        return None
    sketch, lines, names = drawn
    (axes,) = sketch.panels
    measured.draw(sketch, axes, source, "stance_angle")
    axes.set_xlim(left=0)
    axes.set_ylim(bottom=0)
    if 1 < len(lines) <= len(COLOURS):
        _label_lines(sketch, lines, names)
    return _finish(sketch, names)


def quantity(name: str, source: Source) -> Sketch | None:
    """Plot a quantity of every gait against slope or speed."""
    shown = QUANTITIES[name]
    if shown.abscissa == "speed" and "froude_speed" in source.grid:
        shown = replace(shown, heading="power P/(m g √(g l))", reads=("froude_speed",), abscissa="froude_speed")
    lines = [line for line in source.lines if set(shown.reads) <= set(line.data)]
    if not any(np.isfinite(line.data[shown.reads[0]]).any() for line in lines):
        return None
    sketch = Sketch(name, 330)
    (axes,) = sketch.panels
    tips = {column: spaced(column) for column in ("slope", shown.abscissa, *shown.reads)}
    for k, line in enumerate(lines):
        for frame in line.curves(*shown.reads):
            curve = thin(frame, max(60, 700 // len(lines)))
            curve = curve.assign(value=shown.value(curve))
            for gait in source.gaits:
                _draw_curve(sketch, curve, gait, line, k, line.label, tips, shown.abscissa, "value")
    if not sketch.pieces:
        return None
    data, names = pd.concat(sketch.pieces, ignore_index=True), [line.label for line in lines]
    sketch.gait_keys(data)
    if 1 < len(lines) <= len(COLOURS):
        _label_lines(sketch, lines, names, x=shown.abscissa, y="value")
    for at, words in shown.guides.items():
        draw_guide(axes, float(at), words)
    # Shares of several losses are drawn, which no measurement of one of them can be compared with.
    if shown.abscissa == "slope" and len(shown.reads) == 1:
        measured.draw(sketch, axes, source, shown.reads[0])
    finite = data["value"][np.isfinite(data["value"])]
    said = {"heading": shown.heading, "count": len(names), "low": finite.min(), "high": finite.max()}
    if shown.abscissa != "slope":
        across, upward = (source.units(v) for v in (shown.abscissa, shown.reads[0]))
        speed = "speed v" if shown.abscissa == "speed" else spaced(shown.abscissa)
        said |= {"x": with_unit(speed, across), "y": with_unit(shown.heading, upward)}
    return sketch.finish(data.rename(columns={"value": shown.heading}), names, **said)


def _draw_families(source: Source, name: str) -> tuple[Sketch, list[Line], list[str]] | None:
    """Draw every gait of every line; the sketch, the lines and their names, or None without gaits."""
    sketch, lines = Sketch(name, 350), [line for line in source.lines if "stance_angle" in line.data]
    names, tips = _line_titles(source, lines), TIPS | {"spectral_radius": "max |λ|"}
    for k, line in enumerate(lines):
        curves = [thin(c, max(60, 3 * SAMPLES // len(lines))) for c in line.curves("stance_angle", "period")]
        for gait, curve in itertools.product(source.gaits, curves):
            _draw_curve(sketch, curve, gait, line, k, names[k], tips)
    return (sketch, lines, names) if sketch.pieces else None


def _draw_curve(
    sketch: Sketch, curve: pd.DataFrame, gait: str, line: Line, k: int, name: str, tips: Mapping[str, str],
    x: str = "slope", y: str = "stance_angle",
) -> None:  # fmt: skip
    """Draw a gait of a curve of line k, called so, if the curve has it: with the points that it lacks, as gaps."""
    points = curve[(curve["gait"] == gait) & curve[y].notna()]
    if len(points):
        (axes,) = sketch.panels
        draw_gait(axes, curve, gait, k, k, x, y)
        sketch.mark_gaits(axes, points, f"{gait} step · {name}", line.command, tips, x, y, group=k)
        sketch.pieces.append(points.drop(columns=list(RATES), errors="ignore").assign(line=line.label))


def _label_lines(
    sketch: Sketch,
    lines: Sequence[Line],
    names: Sequence[str],
    side: str = "right",
    x: str = "slope",
    y: str = "stance_angle",
) -> None:
    """Write the name of each line at the right end of one of its curves, or at the left end of each of its gaits."""
    (axes,), ends = sketch.panels, []
    data = pd.concat(sketch.pieces, ignore_index=True)
    data = data[np.isfinite(data[x]) & np.isfinite(data[y])]
    for k, (line, name) in enumerate(zip(lines, names, strict=True)):
        own = data[data["line"] == line.label]
        for _, rows in own.groupby("gait" if side == "left" else "line", sort=False):
            end = rows.loc[rows[x].idxmin() if side == "left" else rows[x].idxmax()]
            ends.append((end[x], end[y], name, colour(k)))
    end_labels(axes, ends, side)


def _finish(sketch: Sketch, names: list[str], **sentences: Any) -> Sketch:
    """Say what is drawn."""
    data = pd.concat(sketch.pieces, ignore_index=True)
    sketch.gait_keys(data)
    if sentences.get("fitted"):
        sketch.key("fitted", MUTED, lw=1, ls=DOTTED)
    if sentences.get("crossings"):
        sketch.key("fitted on either side of the transition", INK, lw=0.6)
    if sentences.get("printed"):
        sketch.printed_key()
    return sketch.finish(
        data,
        lines=names,
        names=_line_names(names),
        stable=(data["stable"] == 1).any(),
        most=data["stance_angle"].max(),
        count=data["line"].nunique(),
        gaits=", ".join(data["gait"].unique()),
        **sentences,
    )


def _line_titles(source: Source, lines: list[Line]) -> list[str]:
    """Names of the lines; the two foot mass ratios of the paper are called by the names of their walkers."""
    table, names = source.tables.get("fits/transition_ratio"), {}
    if table is not None and len(table) == 1 and {"pair", "foot_mass_ratios"} <= set(table.columns):
        pair, ratios = str(table["pair"].iloc[0]).split(" / "), str(table["foot_mass_ratios"].iloc[0]).split(" / ")
        names = {float(ratio): walker for walker, ratio in zip(pair, ratios, strict=True)}
    called = [names.get(line.at.get("foot_mass_ratio", np.nan), "") for line in lines]
    return [f"{name} ({line.label})" if name else line.label for name, line in zip(called, lines, strict=True)]


def _draw_fitted_lines(source: Source, axes: Axes, lines: list[Line], names: list[str]) -> str:
    """Draw the lines fitted to the short step's two regimes and their crossing; the crossings in words."""
    fields = ("foot_mass_ratio", "fitted_exponent", "fitted_amplitude", "fitted_cube_root", "slope_transition_fitted")
    table = source.table("fits/transition", *fields)
    if table is None or len(lines) > 4:
        return ""
    words: list[str] = []
    left, right = axes.get_xlim()
    for line, name in zip(lines, names, strict=True):
        fits = rows_at(table, {"foot_mass_ratio": line.at.get("foot_mass_ratio", np.nan)})
        for row in fits[np.isfinite(fits["slope_transition_fitted"])].itertuples():
            cross = row.slope_transition_fitted
            ink: Any = {"color": INK, "lw": 0.6, "zorder": 1.6}
            below, above = np.array([line.data["slope"].values.min(), 3 * cross]), np.array([cross / 30, right])
            axes.plot(below, row.fitted_amplitude * below**row.fitted_exponent, **ink)
            axes.plot(above, row.fitted_cube_root * above ** (1 / 3), **ink)
            height = row.fitted_cube_root * cross ** (1 / 3)
            axes.plot([cross], [height], "o", color=INK, mfc=PAPER, ms=5, zorder=6)
            write_at(axes, f"{shorten(name, 12)}: γ = {plain(cross, 3)}", (cross, height), (8, -26 if words else -12))
            x, law = 30 * below[0], f"θ* ∝ γᵖ, p = {plain(row.fitted_exponent)}"
            offset, how = ((-4, 5), {"ha": "right"}) if words else ((9, -9), {"ha": "left"})
            write_at(axes, law, (x, row.fitted_amplitude * x**row.fitted_exponent), offset, **how)
            if not words:
                x = cross / 8
                write_at(axes, "p = 1/3", (x, row.fitted_cube_root * x ** (1 / 3)), (-4, 5), ha="right")
            words.append(f"{plain(cross, 3)} ({name.partition(' (')[0]})")
    axes.set_xlim(left, right)
    ratio = source.table("fits/transition_ratio", "fitted_lines", "predicted")
    sentence = f"They cross at {' and '.join(words)}"
    if ratio is not None and ratio["fitted_lines"].notna().all():
        fitted, predicted = (plain(ratio[name].iloc[0], 3) for name in ("fitted_lines", "predicted"))
        sentence += f", ratio {fitted}; the 3/2 law gives {predicted}"
    return f"{sentence}." if words else ""


def _scaling_laws(source: Source, line: Line, gait: str) -> pd.DataFrame:
    """Fitted power laws θ* ∝ γ^p of one gait of one line."""
    table = source.table("fits/scaling", "quantity", "gait", "exponent", "amplitude")
    if table is None:
        return pd.DataFrame()
    table = table.rename(columns={"from": "slope_from", "to": "slope_to"})
    keep = (table["quantity"] == "stance_angle") & (table["gait"] == gait)
    table = table[keep & np.isfinite(table["exponent"]) & np.isfinite(table["amplitude"])]
    return rows_at(table, line.at)


def _is_one_curve(rows: pd.DataFrame) -> bool:
    """Whether all laws belong to one piece of one branch."""
    return all(rows[column].nunique() == 1 for column in ("branch", "piece") if column in rows)


def _draw_power_laws(source: Source, axes: Axes, lines: list[Line]) -> bool:
    """Draw the fitted laws; those of the two regimes of one curve extend to their crossing, as in figure 5."""
    drawn = False
    for line in lines:
        for gait in source.gaits:
            rows = _scaling_laws(source, line, gait)
            ends = [[r.slope_from, r.slope_to] for r in rows.itertuples()]
            if len(rows) == 2 and _is_one_curve(rows) and abs(np.diff(rows["exponent"])[0]) > 0.1:
                (p, q), (a, b) = rows["exponent"], rows["amplitude"]
                cross = (b / a) ** (1 / (p - q))
                ends = [[min(lo, cross), max(hi, cross)] for lo, hi in ends]
            for row, (low, high) in zip(rows.itertuples(), ends, strict=True):
                slopes = np.array([low, high])
                axes.plot(slopes, row.amplitude * slopes**row.exponent, color=MUTED, lw=1, ls=DOTTED, zorder=1.5)
                drawn = True
    return drawn


def _line_names(names: list[str]) -> str:
    return ", ".join(names) if len(names) < 7 else f"{len(names)} lines from {names[0]} to {names[-1]}"


def residuals(source: Source) -> Sketch | None:
    """Plot the relative residuals of the fitted power laws, each over its fitted range."""
    if "stance_angle" not in source.grid:
        return None
    sketch = Sketch("residuals", 210)
    (axes,) = sketch.panels
    names = _line_titles(source, source.lines)
    for k, line in enumerate(source.lines):
        curves = list(line.curves("stance_angle"))
        for gait in source.gaits:
            for row, piece in itertools.product(_scaling_laws(source, line, gait).itertuples(), curves):
                if any(getattr(row, c, piece[c].iloc[0]) != piece[c].iloc[0] for c in ("branch", "piece")):
                    continue
                fitted = (piece["gait"] == gait) & piece["slope"].between(row.slope_from, row.slope_to)
                used = thin(piece[fitted].dropna(subset="stance_angle"), 80)
                if used.empty:
                    continue
                law = row.amplitude * used["slope"] ** row.exponent
                used = used.assign(residual=used["stance_angle"] / law - 1)
                percent = 100 * used["residual"]
                axes.plot(used["slope"], percent, color=colour(k), lw=1.2, ls=dash(gait))
                regime = getattr(row, "regime", "")
                label = f"{gait} step · {names[k]} · {regime} slopes"
                tips = {"slope": "γ (rad)", "percent": "residual (%)"}
                sketch.mark_gaits(axes, used.assign(percent=percent), label, line.command, tips, y="percent")
                used = used.drop(columns=list(RATES), errors="ignore")
                sketch.pieces.append(used.assign(line=line.label, regime=regime))
    if not sketch.pieces:
        return None
    data = pd.concat(sketch.pieces, ignore_index=True)
    axes.axhline(0, color=MUTED, lw=0.7)
    sketch.gait_keys(data[["gait"]])
    sketch.line_keys(names)
    return sketch.finish(data, worst=100 * data["residual"].abs().max())
