"""Solution branches continued through folds to their ends (figures 6 and 8)."""

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from gaitsweep.pipeline.report.figures import landmarks, measured
from gaitsweep.pipeline.report.figures.sketch import TIPS, Sketch
from gaitsweep.pipeline.report.figures.style import (
    INK,
    MAX_PANELS,
    MUTED,
    PAPER,
    draw_gait,
    evenly,
    set_heading,
    thin,
    write_at,
)
from gaitsweep.pipeline.report.source import Source, rows_at
from gaitsweep.pipeline.report.words import WORDS, shorten, spaced, yes_or_no

#: Spectral radius above which it is rounding of one without bound.
_UNBOUNDED = 1e12


def locus(source: Source, table: pd.DataFrame) -> Sketch:
    """Plot stance angle against slope along each branch, with special points; one panel
    per line.
    """
    special = source.tables.get("special_points", pd.DataFrame())
    if "kind" in special:  # where a branch leaves the window nothing happens
        special = special[special["kind"].astype(str) != "window"]
    every = source.lines_of(table)
    together = len(every) == 2 and all(
        line.label == line.at["walker"] for line in every
    )
    chosen = evenly(every, MAX_PANELS)
    count = 1 if together else len(chosen)
    across = min(count, 3)
    rows = -(-count // across)
    sketch = Sketch(
        "locus",
        350 if count == 1 else 200 * rows + 60,
        rows,
        across,
        sharex=True,
        sharey=True,
    )
    panels = sketch.panels
    for k, line in enumerate(chosen):
        axes = panels[0 if together else k]
        sketch.pieces += _draw_branches(axes, line.rows, k)
        rows = thin(line.rows.dropna(subset=["stance_angle"]), 300)
        rows = (
            rows.assign(stable=yes_or_no(rows["stable"])) if "stable" in rows else rows
        )
        sketch.mark(
            axes,
            rows,
            line.label or "branch",
            command=line.command,
            tips=TIPS | {"stable": "stable"},
        )
        measured.draw(sketch, axes, source, "stance_angle", line.at)
        _draw_special(sketch, axes, rows_at(special, line.at), line.command)
        if line.label and not together:
            letter = f"({'abcdef'[k]}) " if count > 1 else ""
            axes.set_title(
                letter + shorten(line.label, 60 // across),
                fontsize=9,
                pad=4,
                loc="left",
            )
    for axes in panels[count:]:
        axes.axis("off")
    panels[0].set(xlim=(0, None), ylim=(0, None))  # which all panels share
    if across > 1:
        panels[0].locator_params(axis="x", nbins=3)
    numbered = (
        _draw_points(panels[0], landmarks.point_numbers(source))
        if count == 1
        else False
    )
    sketch.figure.supxlabel("slope γ (rad)", fontsize=9.5)
    if count == 1:
        set_heading(panels[0], "stance angle θ* (rad)")
    else:
        sketch.figure.supylabel("stance angle θ* (rad)", fontsize=9.5)
    data = sketch.data
    sketch.gait_keys()
    if (
        "spectral_radius" in data
    ):  # at a tangential strike the derivative of the step map has no bound
        data["spectral_radius"] = data["spectral_radius"].where(
            data["spectral_radius"] < _UNBOUNDED, np.inf
        )
    sketch.line_keys([line.label for line in chosen] if together else [])
    for kind in special["kind"].astype(str).unique() if "kind" in special else ():
        sketch.dot_key(spaced(kind), **_mark(kind))
    printed = (
        landmarks.sentence(landmarks.draw_at_angles(sketch, panels[0], source))
        if count == 1
        else ""
    )
    return sketch.finish(
        data,
        numbered=numbered,
        printed=printed,
        drawn=len(chosen),
        every=len(every),
        count=count,
        s="s" * (count > 1),
        special=len(special),
    )


def _mark(kind: str) -> dict[str, Any]:
    """Properties of the mark of a kind of special point."""
    fill, size = (INK, 6) if kind.startswith("end_") else (PAPER, 5)
    return {
        "marker": WORDS["special_points"].get(kind, "*"),
        "color": INK,
        "mfc": fill,
        "ms": size,
    }


def _draw_branches(axes: Axes, frame: pd.DataFrame, k: int) -> list[pd.DataFrame]:
    """Draw the branches of a line, each gait in the dashes of its label; the rows
    drawn.
    """
    pieces: list[pd.DataFrame] = []
    edges = frame["slope"].min(), frame["slope"].max()
    by_branch = (
        frame.groupby("branch", sort=False) if "branch" in frame else [(0, frame)]
    )
    for branch, whole in by_branch:
        # A branch that leaves the window may come back at the same edge: no line joins
        # the two parts.
        at = np.array(
            [np.isclose(whole["slope"], edge, rtol=1e-9, atol=0) for edge in edges]
        )
        for _, run in whole.groupby(
            np.cumsum((at & np.roll(at, 1, axis=1)).any(axis=0))
        ):
            rows = thin(run, 400).reset_index(drop=True)
            rows = rows.assign(
                branch=branch, gait=rows["gait"].astype(str) if "gait" in rows else ""
            )
            for gait in rows["gait"].unique():
                draw_gait(axes, rows, gait, k)
            pieces.append(rows)
    return pieces


def _draw_special(
    sketch: Sketch, axes: Axes, points: pd.DataFrame, command: str
) -> None:
    if not {"kind", "slope", "stance_angle"} <= set(points.columns) or points.empty:
        return
    for kind, rows in points.groupby(points["kind"].astype(str), sort=False):
        axes.plot(
            rows["slope"],
            rows["stance_angle"],
            ls="",
            zorder=5,
            clip_on=False,
            **_mark(str(kind)),
        )
    # At the slope where steps vanish there is none, however small the last one
    # followed.
    gaits = points.assign(
        told=points["kind"].map(spaced),
        angle=points["stance_angle"],
        stance_angle=points["stance_angle"].where(
            points["kind"] != "end_zero_step", 0.0
        ),
    )
    tips = {"told": "kind", "slope": "γ (rad)", "angle": "θ* (rad)"}
    sketch.mark(
        axes, gaits, "special point", command=command, tips=tips, y="angle", above=True
    )


def _draw_points(axes: Axes, numbered: pd.DataFrame) -> bool:
    """Number the points as the paper does, with the interval that rounding allows;
    whether there were any.
    """
    how = {
        "ha": "center",
        "va": "center",
        "fontsize": 10,
        "fontweight": "bold",
        "annotation_clip": False,
    }
    for row in numbered.itertuples():
        if np.isfinite(row.slope_low):
            axes.plot(
                [row.slope_low, row.slope_high],
                [row.stance_angle] * 2,
                color=MUTED,
                lw=0.8,
                zorder=4,
            )
        offset = (
            (15, 5)
            if row.stance_angle < 0.01
            else (14, -12 if row.stance_angle > 0.05 else 8)
        )
        write_at(axes, str(row.point), (row.slope, row.stance_angle), offset, **how)
    return bool(len(numbered))
