"""Solution branches continued through folds to their ends (figures 6 and 8)."""

from __future__ import annotations

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
    canvas,
    colour,
    draw_curve,
    labelled,
    plain,
    set_heading,
    shorten,
    spread_evenly,
    thin,
)
from pipeline.report.figures.svg import Marks, Sketch
from pipeline.report.source import SYMBOLS, Source

MAX_PANELS = 6
#: Spectral radius above which it is rounding of one without bound.
_UNBOUNDED = 1e12
#: Sentence of a caption on the paper's numbers of points.
_NUMBERED = " The numbers 1 to 4 are those of the paper's figure; bars through them: what rounding allows."
#: Marker of each kind of special point; ends are filled.
_SHAPES = {
    "fold": "o",
    "flip": "s",
    "neimark_sacker": "D",
    "branch_point": "P",
    "release_hyperextension": "^",
    "end_kneestrike_at_heelstrike": "X",
    "end_tangential_heelstrike": "v",
    "end_tangential_kneestrike": "<",
    "end_zero_step": "d",
    "end_contact_lost": "p",
    "end_earlier_strike": "h",
}


def groups(source: Source, table: pd.DataFrame) -> list[tuple[dict[str, Any], pd.DataFrame]]:
    """Rows of a table grouped by line, in the archive's order, with the values that differ between lines."""
    columns = [c for c in source.line_columns(table) if table[c].nunique() > 1]
    if not columns:
        return [({}, table)]
    return [(dict(zip(columns, key, strict=True)), rows) for key, rows in table.groupby(columns, sort=False)]


def title(at: dict[str, Any]) -> str:
    """Values of a line as a title."""
    return ", ".join(str(v) if k == "walker" else f"{SYMBOLS.get(k, k)} {plain(float(v), 6)}" for k, v in at.items())


def line_command(source: Source, rows: pd.DataFrame) -> str:
    """The `gaitsweep solve` command of a line, without the slope."""
    settings = {c: float(rows[c].iloc[0]) for c in source.line_columns(rows) if c != "walker"}
    return source.command(str(rows["walker"].iloc[0]) if "walker" in rows else source.walker, settings)


def locus(source: Source) -> Sketch | None:
    """Plot stance angle against slope along each branch, with special points; one panel per line."""
    table = source.tables.get("branches")
    if table is None or not {"slope", "stance_angle"} <= set(table.columns) or table.empty:
        return None
    special = source.tables.get("special_points", pd.DataFrame())
    every = groups(source, table)
    together = len(every) == 2 and all(set(at) == {"walker"} for at, _ in every)
    chosen = [every[i] for i in spread_evenly(len(every), MAX_PANELS)]
    count = 1 if together else len(chosen)
    across = min(count, 3)
    rows = -(-count // across)
    figure = canvas(350 if count == 1 else 200 * rows + 60)
    panels = np.atleast_1d(figure.subplots(rows, across, sharex=True, sharey=True)).ravel()
    pieces, marks, own = [], [], None
    for k, (at, frame) in enumerate(chosen):
        axes = panels[0 if together else k]
        command = line_command(source, frame)
        pieces += _draw_branches(axes, frame, k if together else 0)
        marks += _branch_marks(axes, frame, title(at), command)
        own = measured.draw(axes, source, "stance_angle", at) or own
        marks += _draw_special(axes, _rows_at(special, at), command)
        if at and not together:
            letter = f"({'abcdef'[k]}) " if count > 1 else ""
            axes.set_title(letter + shorten(title(at), 60 // across), fontsize=9, pad=4, loc="left")
    for axes in panels[count:]:
        axes.axis("off")
    for axes in panels:
        axes.set_ylim(bottom=0)
        axes.set_xlim(left=0)
        if across > 1:
            axes.locator_params(axis="x", nbins=3)
    numbered = _draw_points(panels[0], landmarks.point_numbers(source)) if count == 1 else False
    printed = landmarks.rows(source)
    has_printed = count == 1 and landmarks.draw_at_angles(panels[0], printed)
    figure.supxlabel("slope γ (rad)", fontsize=9.5)
    if count == 1:
        set_heading(panels[0], "stance angle θ* (rad)")
    else:
        figure.supylabel("stance angle θ* (rad)", fontsize=9.5)
    data = pd.concat(pieces, ignore_index=True)
    if "spectral_radius" in data:  # at a tangential strike the derivative of the step map has no bound
        data["spectral_radius"] = data["spectral_radius"].where(data["spectral_radius"] < _UNBOUNDED, np.inf)
    _add_legend(figure, data, special, [str(at["walker"]) for at, _ in chosen] if together else [], has_printed, own)
    omitted = f" Six of {len(every)} lines are drawn." if len(every) > len(chosen) else ""
    return Sketch(
        figure,
        "Solution branches",
        "Stance angle along each solution branch, continued through folds to its ends. The colour tells the gait's "
        "label: a gait is long if the legs' rates differ by less than half the stance rate just before heelstrike. "
        "Filled marks: branch ends."
        + (_NUMBERED if numbered else "")
        + (landmarks.sentence(printed) if has_printed else "")
        + omitted,
        f"{count} panel{'s' * (count > 1)} of stance angle against slope along branches of gaits, slopes "
        f"{plain(data['slope'].min())} to {plain(data['slope'].max())} rad, with {len(special)} special points.",
        data,
        marks,
    )


def _add_legend(
    figure: Figure, data: pd.DataFrame, special: pd.DataFrame, walkers: list[str], printed: bool, own: Line2D | None
) -> None:
    keys = [Line2D([], [], color=colour(g), lw=1.4, label=f"{shorten(g)} step") for g in data["gait"].unique() if g]
    if "stable" in data and (data["stable"] == 1).any():
        keys.append(Line2D([], [], color=INK, lw=2.6, label="stable"))
    keys += [Line2D([], [], color=INK, lw=1.1, ls=DASHES[k], label=shorten(w)) for k, w in enumerate(walkers)]
    for kind in special["kind"].astype(str).unique() if "kind" in special else ():
        words = kind.replace("_", " ").removeprefix("end ")
        keys.append(Line2D([], [], ls="", **_mark(kind), label=f"end: {words}" if kind.startswith("end_") else words))
    if printed:
        keys.append(Line2D([], [], color=PRINTED, lw=5, alpha=0.4, label="printed, and allowed by rounding"))
    keys += [own] if own else []
    figure.legend(handles=keys, loc="outside upper left", ncols=3, columnspacing=1.2)


def _mark(kind: str) -> dict[str, Any]:
    """Properties of the mark of a kind of special point."""
    is_end = kind.startswith("end_")
    return {"marker": _SHAPES.get(kind, "*"), "color": INK, "mfc": INK if is_end else PAPER, "ms": 6 if is_end else 5}


def _draw_branches(axes: Axes, frame: pd.DataFrame, k: int) -> list[pd.DataFrame]:
    """Draw the branches of a line, each gait in the colour of its label; the rows drawn."""
    pieces: list[pd.DataFrame] = []
    edges = frame["slope"].min(), frame["slope"].max()
    by_branch = frame.groupby("branch", sort=False) if "branch" in frame else [(0, frame)]
    for branch, whole in by_branch:
        # A branch that leaves the window may come back at the same edge: no line joins the two parts.
        at = np.array([np.isclose(whole["slope"], edge, rtol=1e-9, atol=0) for edge in edges])
        for _, run in whole.groupby(np.cumsum((at & np.roll(at, 1, axis=1)).any(axis=0))):
            rows = thin(run, 400).reset_index(drop=True)
            rows = rows.assign(branch=branch, gait=rows["gait"].astype(str) if "gait" in rows else "")
            stable = rows["stable"] if "stable" in rows else pd.Series(np.nan, rows.index)
            for gait in rows["gait"].unique():
                draw_curve(axes, rows["slope"], labelled(rows, gait), stable, colour(gait), k)
            pieces.append(rows)
    return pieces


def _branch_marks(axes: Axes, frame: pd.DataFrame, name: str, command: str) -> list[Marks]:
    frame = thin(frame.dropna(subset=["stance_angle"]), 300)
    slopes, angles = frame["slope"].to_numpy(), frame["stance_angle"].to_numpy()
    values = {"γ (rad)": slopes, "θ* (rad)": angles}
    if "period" in frame:
        values["period"] = frame["period"].to_numpy()
    if "stable" in frame:
        values["stable"] = np.where(frame["stable"] == 1, "yes", "no")
    return [Marks(axes, slopes, angles, name or "branch", values, command, slopes, gaits=frame)]


def _draw_special(axes: Axes, points: pd.DataFrame, command: str) -> list[Marks]:
    if not {"kind", "slope", "stance_angle"} <= set(points.columns) or points.empty:
        return []
    for kind, rows in points.groupby(points["kind"].astype(str), sort=False):
        axes.plot(rows["slope"], rows["stance_angle"], ls="", zorder=5, clip_on=False, **_mark(str(kind)))
    slopes, angles = points["slope"].to_numpy(), points["stance_angle"].to_numpy()
    kinds = [str(kind).replace("_", " ") for kind in points["kind"]]
    values = {"kind": kinds, "γ (rad)": slopes, "θ* (rad)": angles}
    # At the slope where steps vanish there is none, however small the last one followed.
    gaits = points.assign(stance_angle=points["stance_angle"].where(points["kind"] != "end_zero_step", 0.0))
    return [Marks(axes, slopes, angles, "special point", values, command, slopes, gaits=gaits, above=True)]


def _draw_points(axes: Axes, numbered: pd.DataFrame) -> bool:
    """Number the points as the paper does, with the interval that rounding allows; whether there were any."""
    for row in numbered.itertuples():
        if np.isfinite(row.slope_low):
            axes.plot([row.slope_low, row.slope_high], [row.stance_angle] * 2, color=MUTED, lw=0.8, zorder=4)
        axes.annotate(
            str(row.point),
            (row.slope, row.stance_angle),
            xytext=(15, 5) if row.stance_angle < 0.01 else (14, -12 if row.stance_angle > 0.05 else 8),
            textcoords="offset points",
            ha="center",
            va="center",
            fontsize=10,
            fontweight="bold",
            annotation_clip=False,
        )
    return bool(len(numbered))


def _rows_at(points: pd.DataFrame, at: dict[str, Any]) -> pd.DataFrame:
    for column, value in at.items():
        if column in points:
            points = points[points[column] == value]
    return points
