"""Gait families: stance angle against slope (the paper's figures 5 and 11), and residuals of the power laws."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from pipeline.report.figures import landmarks, measured
from pipeline.report.figures.style import (
    DASHES,
    INK,
    MUTED,
    PAPER,
    PRINTED,
    SAMPLES,
    canvas,
    colour,
    draw_curve,
    end_labels,
    labelled,
    log_axis,
    plain,
    set_heading,
    shorten,
    thin,
)
from pipeline.report.figures.svg import Marks, Sketch
from pipeline.report.source import RATES, Line, Source


def loglog(source: Source) -> Sketch | None:
    """Plot stance angle against slope on logarithmic axes, with the fitted power laws."""
    return _families(source, "log")


def linear(source: Source) -> Sketch | None:
    """Plot stance angle against slope on linear axes."""
    return _families(source, "linear")


def _families(source: Source, scale: str) -> Sketch | None:
    lines = [line for line in source.lines if "stance_angle" in line.data]
    if not lines:
        return None
    names = _line_titles(source, lines)
    figure = canvas(350)
    axes = figure.add_subplot()
    if scale == "log":
        log_axis(axes, "x")
        log_axis(axes, "y")
    pieces: list[pd.DataFrame] = []
    marks: list[Marks] = []
    labels = []
    for k, line in enumerate(lines):
        curves = [thin(c, max(60, 3 * SAMPLES // len(lines))) for c in line.curves("stance_angle", "period")]
        for gait in source.gaits:
            starts = []
            for frame in curves:
                points = frame[(frame["gait"] == gait) & frame["stance_angle"].notna()]
                if points.empty:
                    continue
                draw_curve(axes, frame["slope"], labelled(frame, gait), frame["stable"], colour(gait), k, k)
                starts.append(tuple(points.loc[points["slope"].idxmin(), ["slope", "stance_angle"]]))
                marks.append(_marks(axes, points, f"{gait} step · {names[k]}", line.command, k))
                pieces.append(points.drop(columns=list(RATES), errors="ignore").assign(line=line.label))
            if starts:
                labels.append((*min(starts), names[k], colour(gait)))
    if not pieces:
        return None
    data = pd.concat(pieces, ignore_index=True)
    fitted = _draw_power_laws(source, axes, lines) if scale == "log" else False
    crossings = _draw_fitted_lines(source, axes, lines, names) if scale == "log" else ""
    printed = landmarks.rows(source) if scale == "log" else pd.DataFrame()
    own = measured.draw(axes, source, "stance_angle")
    has_printed = bool(len(printed)) and landmarks.draw_at_angles(axes, printed)
    axes.set_xlabel("slope γ (rad)")
    letter = _letter(source, scale)
    set_heading(axes, f"{letter}stance angle θ* (rad)")
    if scale == "linear":
        axes.set_xlim(left=0)
        axes.set_ylim(bottom=0)
    if len(lines) > 1 and scale == "log":
        end_labels(axes, labels)
    _add_legend(figure, data, fitted, names, has_printed, own)
    kind = "logarithmic" if scale == "log" else "linear"
    caption = (
        f"Stance angle just after heelstrike against slope, on {kind} axes, for {_line_names(names)}. "
        + ("Thick: stable. " if (data["stable"] == 1).any() else "")
        + ("Dotted: fitted power laws. " if fitted else "")
        + crossings
        + (landmarks.sentence(printed[np.isfinite(printed["stance_angle"])]) if has_printed else "")
    )
    alt = (
        f"Line plot on {kind} axes of stance angle against slope from {plain(data['slope'].min())} to "
        f"{plain(data['slope'].max())} rad; stance angles reach {plain(data['stance_angle'].max())} rad. "
        f"{data['line'].nunique()} walkers, gaits: {', '.join(data['gait'].unique())}."
    )
    title = "Gait families" + (", on logarithmic axes" if scale == "log" else "")
    return Sketch(figure, title, caption.strip(), alt, data, marks, names if len(names) > 2 else [])


def _marks(axes: Axes, frame: pd.DataFrame, label: str, command: str, group: int) -> Marks:
    slopes, angles = frame["slope"].to_numpy(), frame["stance_angle"].to_numpy()
    values = {"γ (rad)": slopes, "θ* (rad)": angles}
    if "period" in frame:
        values["period"] = frame["period"].to_numpy()
    if "spectral_radius" in frame:
        values["max |λ|"] = frame["spectral_radius"].to_numpy()
    return Marks(axes, slopes, angles, label, values, command, slopes, group=group, gaits=frame)


def _letter(source: Source, scale: str) -> str:
    """Letter of the panel where a study shows the families on both kinds of axes, as the paper's figure 11 does."""
    shown = [name for name in source.figures if name in ("linear", "loglog")]
    return f"({'ab'[shown.index('linear' if scale == 'linear' else 'loglog')]}) " if len(shown) == 2 else ""


def _line_titles(source: Source, lines: list[Line]) -> list[str]:
    """Names of the lines; the two foot mass ratios of the paper are called by the names of their walkers."""
    table, names = source.tables.get("fits/transition_ratio"), {}
    if table is not None and len(table) == 1 and {"pair", "foot_mass_ratios"} <= set(table.columns):
        pair, ratios = str(table["pair"].iloc[0]).split(" / "), str(table["foot_mass_ratios"].iloc[0]).split(" / ")
        names = {float(ratio): walker for walker, ratio in zip(pair, ratios, strict=True)}
    called = [names.get(line.set.get("foot_mass_ratio", np.nan), "") for line in lines]
    return [f"{name} ({line.label})" if name else line.label for name, line in zip(called, lines, strict=True)]


def _draw_fitted_lines(source: Source, axes: Axes, lines: list[Line], names: list[str]) -> str:
    """Draw the lines fitted to the short step's two regimes and their crossing; the crossings in words."""
    table = source.tables.get("fits/transition")
    needed = {"foot_mass_ratio", "fitted_exponent", "fitted_amplitude", "fitted_cube_root", "slope_transition_fitted"}
    if table is None or not needed <= set(table.columns) or len(lines) > 4:
        return ""
    words: list[str] = []
    left, right = axes.get_xlim()
    for line, name in zip(lines, names, strict=True):
        own = line.set.get("foot_mass_ratio", np.nan)
        fits = table[np.isclose(table["foot_mass_ratio"], own, rtol=1e-9, atol=0)]
        for row in fits[np.isfinite(fits["slope_transition_fitted"])].itertuples():
            cross = row.slope_transition_fitted
            ink: Any = {"color": INK, "lw": 0.6, "zorder": 4}
            below, above = np.array([line.data["slope"].values.min(), 3 * cross]), np.array([cross / 30, right])
            axes.plot(below, row.fitted_amplitude * below**row.fitted_exponent, **ink)
            axes.plot(above, row.fitted_cube_root * above ** (1 / 3), **ink)
            height = row.fitted_cube_root * cross ** (1 / 3)
            axes.plot([cross], [height], "o", color=INK, mfc=PAPER, ms=5, zorder=6)
            axes.annotate(
                f"{shorten(name, 12)}: γ = {plain(cross, 3)}",
                (cross, height),
                xytext=(8, -26 if words else -12),
                textcoords="offset points",
                fontsize=8.5,
            )
            for x, power in ((below[0] * 30, row.fitted_exponent), (cross / 8, 1 / 3)):
                law = row.fitted_amplitude * x**power if power > 0.5 else row.fitted_cube_root * x**power
                lift = (-4, 5) if (power > 0.5) == bool(words) else (9, -9)
                text = f"θ* ∝ γᵖ, p = {plain(power, 4)}" if power > 0.5 else "p = 1/3"
                if power > 0.5 or not words:
                    axes.annotate(
                        text, (x, law), xytext=lift, textcoords="offset points", fontsize=8.5,
                        ha="right" if lift[0] < 0 else "left",
                    )  # fmt: skip
            words.append(f"{name} at γ = {plain(cross, 4)} rad")
    axes.set_xlim(left, right)
    ratio = source.tables.get("fits/transition_ratio")
    sentence = f"Thin black: lines fitted to the short step beside its transition; they cross for {', '.join(words)}"
    if (
        words
        and ratio is not None
        and {"fitted_lines", "predicted"} <= set(ratio.columns)
        and ratio["fitted_lines"].notna().all()
    ):
        fitted, predicted = (plain(ratio[name].iloc[0], 3) for name in ("fitted_lines", "predicted"))
        ends = (plain(source.grid["slope"].values[i], 2) for i in (0, -1))
        sentence += f", a ratio of {fitted} as fitted to slopes from {' to '.join(ends)} (the 3/2 law: {predicted})"
    return f"{sentence}. " if words else ""


def _scaling_laws(source: Source, line: Line, gait: str) -> pd.DataFrame:
    """Fitted power laws θ* ∝ γ^p of one gait of one line."""
    table = source.tables.get("fits/scaling")
    needed = {"quantity", "gait", "exponent", "amplitude", "slope_from", "slope_to"}
    if table is not None:
        table = table.rename(columns={"from": "slope_from", "to": "slope_to"})
    if table is None or not needed <= set(table.columns):
        return pd.DataFrame()
    keep = (table["quantity"] == "stance_angle") & (table["gait"] == gait)
    for column in source.line_columns(table):
        if column in line.set:
            keep &= np.isclose(table[column].astype(float), line.set[column], rtol=1e-9, atol=0)
        elif column == "walker" and len(source.walkers) > 1:
            keep &= table[column] == line.walker
    return table[keep & np.isfinite(table["exponent"]) & np.isfinite(table["amplitude"])]


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
                axes.plot(slopes, row.amplitude * slopes**row.exponent, color=MUTED, lw=1, ls=(0, (1, 2)), zorder=1.5)
                drawn = True
    return drawn


def _line_names(names: list[str]) -> str:
    return ", ".join(names) if len(names) < 7 else f"{len(names)} lines from {names[0]} to {names[-1]}"


def _add_legend(
    figure: Figure, data: pd.DataFrame, fitted: bool, names: list[str], printed: bool, own: Line2D | None
) -> None:
    handles = [
        Line2D([], [], color=colour(g), lw=1.4, label=f"{g} step" if g in ("long", "short") else shorten(g))
        for g in data["gait"].unique()
    ]
    if (data["stable"] == 1).any():
        handles.append(Line2D([], [], color=INK, lw=2.6, label="stable"))
    if fitted:
        handles.append(Line2D([], [], color=MUTED, lw=1, ls=(0, (1, 2)), label="fitted"))
    if printed:
        handles.append(Line2D([], [], color=PRINTED, lw=5, alpha=0.4, label="printed, and allowed by rounding"))
    handles += [own] if own else []
    figure.legend(handles=handles, loc="outside upper left", ncols=3)
    if 1 < len(names) <= len(DASHES):
        keys = [Line2D([], [], color=MUTED, lw=1.2, ls=DASHES[k], label=shorten(n)) for k, n in enumerate(names)]
        figure.axes[0].legend(handles=keys, loc="lower right", handlelength=3)


def residuals(source: Source) -> Sketch | None:
    """Plot the relative residuals of the fitted power laws, each over its fitted range."""
    if "stance_angle" not in source.grid:
        return None
    figure = canvas(210)
    axes = figure.add_subplot()
    pieces = []
    marks = []
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
                axes.plot(used["slope"], 100 * used["residual"], color=colour(gait), lw=1.2, ls=DASHES[k % len(DASHES)])
                regime = getattr(row, "regime", "")
                label = f"{gait} step · {line.label} · {regime} slopes"
                slopes, percent = used["slope"].to_numpy(), 100 * used["residual"].to_numpy()
                values = {"γ (rad)": slopes, "residual (%)": percent}
                marks.append(Marks(axes, slopes, percent, label, values, line.command, slopes, gaits=used))
                pieces.append(used.drop(columns=list(RATES), errors="ignore").assign(line=line.label, regime=regime))
    if not pieces:
        return None
    data = pd.concat(pieces, ignore_index=True)
    log_axis(axes, "x")
    axes.axhline(0, color=MUTED, lw=0.7)
    axes.set_xlabel("slope γ (rad)")
    set_heading(axes, "relative residual of the stance angle (%)")
    figure.legend(
        handles=[Line2D([], [], color=colour(g), lw=1.4, label=shorten(f"{g} step")) for g in data["gait"].unique()],
        loc="outside upper left",
        ncols=4,
    )
    worst = plain(100 * data["residual"].abs().max(), 2)
    return Sketch(
        figure,
        "Residuals of the power laws",
        "Relative residuals of the fitted power laws, each over its fitted range.",
        f"Residuals of the fitted power laws in percent; the largest is {worst} percent.",
        data,
        marks,
    )
