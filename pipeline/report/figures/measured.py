"""The user's own measurements: drawn on the figures of their variables, and compared
with the gaits at their slopes and keys.
"""

from collections.abc import Mapping
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
    """Draw the measurements of a variable against the slope, or what else gaits are
    followed along, if there are any.
    """
    along = source.along
    rows = rows_at(table(source), at or {}, _SAME)
    if variable not in rows or along not in rows or not rows[variable].notna().any():
        return

    errors = {"xerr": f"{along}_error", "yerr": f"{variable}_error"}
    bars = {key: rows[name].fillna(0.0) for key, name in errors.items() if name in rows}
    axes.errorbar(rows[along], rows[variable], **bars, **_MARK)
    sketch.last_key = _KEY


def residuals(source: Source) -> pd.DataFrame:
    """Compare every measurement with the gait at its slope and keys.

    Returns
    -------
    DataFrame
        The coordinates of each measurement, `variable` with its unit, `measured`,
        `computed` (NaN where there is no gait, for the `reason`), `residual`, its
        `error` (the standard error of the measurement, if there is one, and the bound
        of the computed value) and the residual `over_error`, where there is a standard
        error. Of several gaits the nearest is taken, unless the measurement names one.
    """
    frame = table(source)
    units = frame.attrs.get("units", {})
    parts = [_compared(source, name, units) for name in variables(source)]
    answer = pd.concat(parts, ignore_index=True) if parts else pd.DataFrame()
    if "reason" in answer and not answer["reason"].any():
        answer = answer.drop(columns="reason")

    answer.attrs = {"units": {c: u for c, u in units.items() if c in answer}}
    return answer


def _compared(source: Source, variable: str, units: Mapping[str, str]) -> pd.DataFrame:
    """Measurements of a variable beside what is computed."""
    known = table(source)
    gaits = source.tables.get("measured_gaits", pd.DataFrame(index=known.index))
    has_value = known[variable].notna()
    known, gaits = known[has_value], gaits[has_value]

    nothing = pd.Series(np.nan, known.index)
    measured, computed = known[variable], gaits.get(variable, nothing)
    deviation = known.get(f"{variable}_error", nothing)
    bound = gaits.get(f"{variable}_error", nothing)
    residual = measured - computed
    error = deviation.fillna(0.0) + bound.fillna(0.0)

    places = dict.fromkeys(("walker", *source.axes, "slope"))
    named = with_unit(spaced(variable), print_units(units.get(variable, "")))
    words = pd.Series("", known.index)

    return known[[place for place in places if place in known]].assign(
        gait=gaits.get("gait", words),
        variable=named,
        measured=measured,
        computed=computed,
        residual=residual,
        error=error.where(deviation.notna() | bound.notna()),
        over_error=(residual / error).where(deviation > 0),
        reason=gaits.get("reason", words),
    )
