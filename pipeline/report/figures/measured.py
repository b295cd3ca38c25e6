"""The user's own measurements: drawn on the figures of their variables, and compared
with the curves.
"""

import itertools
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from gaitsweep.pipeline.report.figures.sketch import Sketch
from gaitsweep.pipeline.report.figures.style import INK, PAPER
from gaitsweep.pipeline.report.source import Source, rows_at
from gaitsweep.pipeline.report.words import print_units, spaced, with_unit

#: How measurements are drawn, and their entry in a legend.
_MARK: Any = {
    "fmt": "s",
    "color": INK,
    "mfc": PAPER,
    "ms": 5,
    "capsize": 2.5,
    "lw": 0.9,
    "zorder": 7,
}
_KEY: Any = {"label": "measured", "marker": "s", "mfc": PAPER, "ms": 5}

#: Share by which a measurement's values may differ from those of a line's axes.
_SAME = 1e-5


def table(source: Source) -> pd.DataFrame:
    """The measurements in the archive; no rows if there are none."""
    return source.tables.get("overlay", pd.DataFrame())


def variables(source: Source) -> list[str]:
    """Names of the variables that were measured."""
    names = [str(c) for c in table(source).columns]
    return [
        n
        for n in names
        if n not in ("walker", "gait", *source.axes, "slope")
        and not n.endswith("_error")
    ]


def draw(
    sketch: Sketch,
    axes: Axes,
    source: Source,
    variable: str,
    at: dict[str, Any] | None = None,
) -> None:
    """Draw the measurements of a variable against slope, if there are any."""
    rows = rows_at(table(source), at or {}, _SAME)
    if variable not in rows or "slope" not in rows or not rows[variable].notna().any():
        return
    errors = {"xerr": "slope_error", "yerr": f"{variable}_error"}
    bars = {key: rows[name].fillna(0.0) for key, name in errors.items() if name in rows}
    axes.errorbar(rows["slope"], rows[variable], **bars, **_MARK)
    sketch.last_key = _KEY


def residuals(source: Source) -> pd.DataFrame:
    """Compare every measurement with the curve at its slope.

    Returns
    -------
    DataFrame
        The coordinates of each measurement, `variable` with its unit, `measured`,
        `computed` (NaN where no curve has those coordinates), `residual`, its `error`
        and the residual `over_error`. Curves are interpolated linearly; of several
        gaits the nearest is taken, unless the measurement names one.
    """
    frame, parts = table(source), []
    units, places = (
        frame.attrs.get("units", {}),
        dict.fromkeys(("walker", *source.axes, "slope", "gait")),
    )
    lines = [
        (rows_at(frame, line.at, _SAME), list(line.curves(*variables(source))))
        for line in source.lines
    ]
    compared = [part.index for part, _ in lines]
    # Measurements between the values of an axis are on no line; they are listed without
    # a computed value.
    lines.append((frame.drop(np.concatenate(compared)) if compared else frame, []))
    for variable, (rows, curves) in itertools.product(variables(source), lines):
        rows = rows.dropna(subset=variable)
        parts.append(
            rows[[c for c in places if c in rows]].assign(
                variable=with_unit(
                    spaced(variable), print_units(units.get(variable, ""))
                ),
                measured=rows[variable],
                computed=np.array(
                    [_nearest(curves, variable, row) for _, row in rows.iterrows()],
                    float,
                ),
                residual=lambda known: known["measured"] - known["computed"],
                error=rows.get(f"{variable}_error", np.nan),
                over_error=lambda known: (known["residual"] / known["error"]).where(
                    known["error"] > 0
                ),
            )
        )
    answer = pd.concat(parts, ignore_index=True) if parts else pd.DataFrame()
    answer.attrs = {"units": {c: u for c, u in units.items() if c in answer}}
    return answer


def _nearest(curves: list[pd.DataFrame], variable: str, row: pd.Series) -> float:
    """The computed value nearest to a measured one among the gaits at its slope; NaN if
    there is none.
    """
    computed = []
    for curve in curves:
        wanted = str(row.get("gait", "") or "")
        part = curve if not wanted else curve[curve["gait"] == wanted]
        if variable not in part:
            continue
        part = part.dropna(subset=[variable]).sort_values("slope")
        slope = float(row.get("slope", part["slope"].iloc[0] if len(part) else np.nan))
        if len(part) and part["slope"].iloc[0] <= slope <= part["slope"].iloc[-1]:
            computed.append(float(np.interp(slope, part["slope"], part[variable])))
    return min(computed, key=lambda y: abs(y - row[variable])) if computed else np.nan
