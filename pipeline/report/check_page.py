"""The page of a check of states: its summary, a picture and the verdicts."""

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from gaitsweep.pipeline.report import html_tables
from gaitsweep.pipeline.report.figures.sketch import Sketch
from gaitsweep.pipeline.report.figures.style import INK, MUTED, inks, style
from gaitsweep.pipeline.report.figures.svg import render
from gaitsweep.pipeline.report.pages import render_template

#: Columns of the table of states.
_COLUMNS = [
    "row",
    "verdict",
    "gait",
    "steps",
    "stable",
    "distance",
    "missed",
    "slope",
    "belongs_to_slope",
    "stance_angle",
    "reason",
]

#: What is drawn of slopes on either side of level ground alone [rad].
_ROOM = 0.01


def page(frame: pd.DataFrame, title: str) -> str:
    """Return the page of a check.

    Parameters
    ----------
    frame : DataFrame
        As `gaitsweep.check` returns it.
    title : str
    """
    with style():
        drawing = render(_sketch(frame), "check", "check", small=False)
    rows = frame.assign(row=np.arange(1, len(frame) + 1))
    ordered = rows.sort_values("is_gait", kind="stable")
    is_moved = not ordered.index.equals(rows.index)
    note = "States that are no gaits come first." if is_moved else ""
    counts = frame["verdict"].value_counts().rename_axis("verdict").reset_index()

    return render_template(
        "check.html",
        title=title,
        summary=frame.attrs["summary"],
        drawing=drawing,
        counts=html_tables.named(
            "check/verdicts", counts, is_open=True, where="answer"
        ),
        rows=html_tables.named(
            "check/states", ordered[_COLUMNS], is_open=True, where="answer", note=note
        ),
    )


def _sketch(frame: pd.DataFrame) -> Sketch:
    """The states on the walker's curves, coloured by verdict."""
    sketch = Sketch("check", 300)
    (axes,) = sketch.panels
    low, high = _edges(frame["slope"])
    curves = [_between(curve, low, high) for curve in frame.attrs["curves"]]
    for curve in curves:
        axes.plot(curve["slope"], curve["stance_angle"], color=MUTED, lw=1.2)
    bottom, top = _heights(frame, curves)

    found = frame["verdict"].unique().tolist()
    others = [name for name in found if name != "gait"]
    colours = dict(zip(others, inks(others), strict=True))
    for verdict in found:
        rows = frame[frame["verdict"] == verdict]
        rows = rows.assign(stance_angle=rows["stance_angle"].clip(bottom, top))
        _draw_states(sketch, rows, verdict, colours.get(verdict, INK))

    axes.set_xlim(low, high)
    axes.set_ylim(bottom, top)
    sketch.draw_legend(set())
    shown = frame[["slope", "stance_angle", "verdict"]]
    return sketch.finish(shown, summary=frame.attrs["summary"])


def _between(curve: Mapping[str, np.ndarray], low: float, high: float) -> pd.DataFrame:
    """Points of a curve between two slopes, and beyond, so that it leads up to them."""
    frame = pd.DataFrame(curve)
    room = high - low
    return frame[frame["slope"].between(low - room, high + room)]


def _heights(
    frame: pd.DataFrame, curves: Sequence[pd.DataFrame]
) -> tuple[float, float]:
    """Least and largest angle of a picture: those of gaits and curves. Angles in other
    units, which would leave these no room, stand at its edge.
    """
    heights = [curve["stance_angle"] for curve in curves]
    heights.append(frame["stance_angle"][frame["is_gait"]])
    known = pd.concat(heights)
    least, most = _range(known if len(known) else frame["stance_angle"])
    return min(0.0, 1.2 * least), 1.2 * max(most, 0.01)


def _draw_states(sketch: Sketch, rows: pd.DataFrame, verdict: str, ink: str) -> None:
    """Draw the states of one verdict."""
    (axes,) = sketch.panels
    marker = "o" if verdict == "gait" else "s"
    axes.plot(
        rows["slope"],
        rows["stance_angle"],
        color=ink,
        ls="",
        marker=marker,
        ms=4,
    )
    sketch.dot_key(verdict.replace("_", " "), ink, marker)


def _edges(slope: pd.Series) -> tuple[float, float]:
    """Least and largest slope of a picture, with room beside the states."""
    low, high = _range(slope)
    low, high = low - 0.5 * abs(low), high + 0.5 * abs(high)
    is_one = low == high  # all states stand on level ground
    return (low - _ROOM, high + _ROOM) if is_one else (low, high)


def _range(values: pd.Series) -> tuple[float, float]:
    """Least and largest finite value."""
    finite = values[np.isfinite(values)]
    return (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 1.0)
