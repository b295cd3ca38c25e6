"""Solution branches continued through folds (figures 6 and 8), and bifurcation diagrams of orbits (figure 12)."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from pipeline.report.figures.style import (
    GAIT_COLOURS,
    INK,
    PAPER,
    RASTER,
    SHAPES,
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

_MAX_PANELS = 6
_SHAPES = {"fold": "o", "flip": "s", "neimark_sacker": "D", "branch_point": "P"}


def _groups(source: Source, table: pd.DataFrame) -> list[tuple[dict[str, Any], pd.DataFrame]]:
    """Rows of a table grouped by line, in the archive's order."""
    columns = [c for c in source.line_columns(table) if table[c].nunique() > 1]
    if not columns:
        return [({}, table)]
    return [(dict(zip(columns, key, strict=True)), rows) for key, rows in table.groupby(columns, sort=False)]


def _title(at: dict[str, Any]) -> str:
    return ", ".join(str(v) if k == "walker" else f"{SYMBOLS.get(k, k)} {plain(float(v), 6)}" for k, v in at.items())


def locus(source: Source) -> Sketch | None:
    """Plot stance angle against slope along each branch, with special points; one panel per line."""
    table = source.tables.get("branches")
    if table is None or not {"slope", "stance_angle"} <= set(table.columns) or table.empty:
        return None
    special = source.tables.get("special_points", pd.DataFrame())
    every = _groups(source, table)
    together = len(every) == 2 and all(set(at) == {"walker"} for at, _ in every)
    chosen = [every[i] for i in spread_evenly(len(every), _MAX_PANELS)]
    count = 1 if together else len(chosen)
    across = min(count, 3)
    rows = -(-count // across)
    figure = canvas(300 if rows == 1 and count == 1 else 170 * rows + 30)
    panels = np.atleast_1d(figure.subplots(rows, across, sharex=True, sharey=True)).ravel()
    pieces, marks = [], []
    for k, (at, frame) in enumerate(chosen):
        axes = panels[0 if together else k]
        command = source.command(str(_first(frame, "walker", source)), _settings(source, frame))
        pieces += _draw_branches(axes, frame, k if together else 0)
        marks += _branch_marks(axes, frame, _title(at), command)
        marks += _draw_special(axes, _rows_at(special, at), numbered=count > 2, command=command)
        if at and not together:
            axes.set_title(shorten(_title(at), 60 // across), fontsize=9, pad=4)
        if together:
            end = frame.iloc[frame["stance_angle"].argmax()]
            axes.annotate(
                str(at["walker"]),
                (end["slope"], end["stance_angle"]),
                xytext=(-6, 4),
                textcoords="offset points",
                ha="right",
                fontsize=8.5,
                annotation_clip=False,
            )
    for axes in panels[count:]:
        axes.axis("off")
    for axes in panels:
        axes.set_ylim(bottom=0)
        axes.set_xlim(left=0)
        if across > 1:
            axes.locator_params(axis="x", nbins=3)
    figure.supxlabel("slope γ (rad)", fontsize=9.5)
    if count == 1:
        set_heading(panels[0], "stance angle θ* (rad)")
    else:
        figure.supylabel("stance angle θ* (rad)", fontsize=9.5)
    data = pd.concat(pieces, ignore_index=True)
    omitted = f" Six of {len(every)} lines are drawn." if len(every) > len(chosen) else ""
    return Sketch(
        figure,
        "Solution branches",
        "Stance angle along each solution branch, continued through folds to its ends. Thick: stable. Marked: folds "
        f"(circles), flips (squares), ends and other special points (triangles); the table lists them.{omitted}",
        f"{count} panel{'s' * (count > 1)} of stance angle against slope along branches of gaits, slopes "
        f"{plain(data['slope'].min())} to {plain(data['slope'].max())} rad, with {len(special)} special points.",
        data,
        marks,
    )


def _draw_branches(axes: Axes, frame: pd.DataFrame, k: int) -> list[pd.DataFrame]:
    pieces = []
    edges = frame["slope"].min(), frame["slope"].max()
    for branch, whole in frame.groupby("branch", sort=False) if "branch" in frame else [(0, frame)]:
        # A branch that leaves the window may come back at the same edge: no line joins the two parts.
        at = np.array([np.isclose(whole["slope"], edge, rtol=1e-9, atol=0) for edge in edges])
        for _, run in whole.groupby(np.cumsum((at & np.roll(at, 1, axis=1)).any(axis=0))):
            rows = thin(run, 500)
            for gait in rows["gait"].unique() if "gait" in rows else [""]:
                angle = labelled(rows, gait) if gait else rows["stance_angle"]
                stable = rows["stable"] if "stable" in rows else pd.Series(np.nan, rows.index)
                draw_curve(axes, rows["slope"], angle, stable, colour(str(gait)), k)
            pieces.append(rows.assign(branch=branch))
    return pieces


def _branch_marks(axes: Axes, frame: pd.DataFrame, title: str, command: str) -> list[Marks]:
    frame = thin(frame.dropna(subset=["stance_angle"]), 300)
    slopes, angles = frame["slope"].to_numpy(), frame["stance_angle"].to_numpy()
    values = {"γ (rad)": slopes, "θ* (rad)": angles}
    if "period" in frame:
        values["period"] = frame["period"].to_numpy()
    if "stable" in frame:
        values["stable"] = np.where(frame["stable"] == 1, "yes", "no")
    return [Marks(axes, slopes, angles, title or "branch", values, command, slopes)]


def _draw_special(axes: Axes, points: pd.DataFrame, numbered: bool, command: str) -> list[Marks]:
    if not {"kind", "slope", "stance_angle"} <= set(points.columns):
        return []
    placed: list[tuple[float, float]] = []
    wide, high = np.maximum(axes.dataLim.size, 1e-300)
    # Folds and ends get their labels first, so that they keep them where points are dense.
    order = points["kind"].astype(str).str.startswith(("fold", "end")).sort_values(ascending=False, kind="stable").index
    for row in points.loc[order].itertuples():
        kind = str(row.kind)
        axes.plot(row.slope, row.stance_angle, _SHAPES.get(kind, "^"), color=INK, mfc=PAPER, ms=5, zorder=5)
        is_crowded = any(
            abs(row.slope - x) < 0.3 * wide and abs(row.stance_angle - y) < 0.045 * high for x, y in placed
        )
        if not (numbered or is_crowded or row.stance_angle < 0.02 * high):
            placed.append((row.slope, row.stance_angle))
            axes.annotate(
                f"({plain(row.slope, 3)}, {plain(row.stance_angle, 3)})",
                (row.slope, row.stance_angle),
                xytext=(7, -3),
                textcoords="offset points",
                fontsize=8,
                annotation_clip=False,
            )
    if points.empty:
        return []
    slopes, angles = points["slope"].to_numpy(), points["stance_angle"].to_numpy()
    kinds = [str(kind).replace("_", " ") for kind in points["kind"]]
    values = {"kind": kinds, "γ (rad)": slopes, "θ* (rad)": angles}
    return [Marks(axes, slopes, angles, "special point", values, command, slopes)]


def _rows_at(points: pd.DataFrame, at: dict[str, Any]) -> pd.DataFrame:
    for column, value in at.items():
        if column in points:
            points = points[points[column] == value]
    return points


def _settings(source: Source, frame: pd.DataFrame) -> dict[str, float]:
    return {c: float(frame[c].iloc[0]) for c in source.line_columns(frame) if c != "walker"}


def _first(frame: pd.DataFrame, column: str, source: Source) -> str:
    return str(frame[column].iloc[0]) if column in frame else source.walker


def bifurcation(source: Source) -> Sketch | None:
    """Plot stance angles of successive steps of orbits against slope."""
    table = source.tables.get("orbits")
    if table is None or not {"slope", "stance_angle"} <= set(table.columns):
        return None
    table = table[np.isfinite(table["stance_angle"])]
    if table.empty:
        return None
    groups = _groups(source, table)[:_MAX_PANELS]
    figure = canvas(300 if len(groups) == 1 else 190 * len(groups))
    panels = np.atleast_1d(figure.subplots(len(groups), 1, sharex=True))
    raster = len(table) > SHAPES
    ink = RASTER["long"] if raster else GAIT_COLOURS["long"]
    panels[-1].set_xlabel("slope γ (rad)")
    marks = []
    for axes, (at, rows) in zip(panels, groups, strict=True):
        axes.plot(rows["slope"], rows["stance_angle"], ".", ms=2, mew=0, color=ink, rasterized=raster)
        set_heading(axes, (shorten(_title(at)) + ": " if at else "") + "stance angle θ* of successive steps (rad)")
        shown = thin(rows, 400)
        slopes, angles = shown["slope"].to_numpy(), shown["stance_angle"].to_numpy()
        command = source.command(_first(shown, "walker", source), _settings(source, shown))
        marks.append(
            Marks(axes, slopes, angles, _title(at) or "orbit", {"γ (rad)": slopes, "θ* (rad)": angles}, command, slopes)
        )
    return Sketch(
        figure,
        "Bifurcation diagram",
        "Stance angles of successive steps after the transient; initial conditions that fall are left out.",
        f"Bifurcation diagram: {len(table)} stance angles against slope from {plain(table['slope'].min())} to "
        f"{plain(table['slope'].max())} rad.",
        table,
        marks,
    )
