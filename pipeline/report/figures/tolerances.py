"""What follows from tolerances of keys, to first order: bands around curves of measures,
and bars at special points.

Half of their width is the sum of |derivative| × tolerance over the keys that have one:
the worst case of keys that are off independently of each other.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from matplotlib.axes import Axes

from gaitsweep.pipeline.report.figures.style import INK
from gaitsweep.pipeline.report.source import Source
from gaitsweep.pipeline.report.words import plain, print_units, spaced
from gaitsweep.pipeline.study import tolerances

#: Ends of the names of derivatives, and of half-widths.
_BY_KEY, _HALF_WIDTH = "_by_key", "_half_width"
#: Of a special point: half the width of its bar, and the key that has most of it.
_OF_SLOPE, _MOST = "slope_half_width", "most_from"
#: How bands and bars are drawn.
_BAND: Any = {
    "alpha": 0.2,
    "lw": 0,
    "zorder": 1.5,
}
_BAR: Any = {
    "fmt": "none",
    "color": INK,
    "elinewidth": 0.9,
    "capsize": 2.5,
}


def given(source: Source) -> dict[str, float | str]:
    """Tolerances of keys that a study gives."""
    return dict(source.given("figures", "tolerances") or {})


def half_width(measure: str) -> str:
    """Name of a measure's half-width."""
    return f"{measure}{_HALF_WIDTH}"


def with_half_widths(
    source: Source, data: xr.Dataset, at: Mapping[str, Any], measures: Sequence[str]
) -> xr.Dataset:
    """The data of gaits that are `at` some values of the axes, with the half-widths of
    measures of which they have derivatives.
    """
    widths = {}
    for measure in measures:
        parts = _contributions(source, data, at, measure)
        if parts is not None:
            widths[half_width(measure)] = parts.sum("key", skipna=False)
    return data.assign(widths)


def _contributions(
    source: Source, data: xr.Dataset, at: Mapping[str, Any], measure: str
) -> xr.DataArray | None:
    """By how much the tolerance of each key changes a measure of gaits that are `at`
    some values of the axes; None where nothing tells.
    """
    each, name = given(source), f"{measure}{_BY_KEY}"
    if not each or name not in data:
        return None

    values = source.parameters(at)
    parts: list[xr.DataArray] = []
    for key, tolerance in each.items():
        fixed = xr.DataArray(float(values.get(key) or 0.0))
        off = tolerances.size(tolerance, data.get(key, fixed))
        rate = data[name].sel(key=key, drop=True)
        parts.append(abs(rate) * off)

    return xr.concat(parts, pd.Index([*each], name="key"))


def draw_band(
    axes: Axes,
    curve: pd.DataFrame,
    gait: str,
    ink: str,
    group: int,
    x: str,
    y: str,
    measure: str,
) -> None:
    """Shade how far a curve, drawn as by `draw_gait`, may lie off where its measure has
    half-widths.
    """
    name = half_width(measure)
    if name not in curve:
        return

    has_label = curve["gait"] == gait
    goes_on = has_label | has_label.shift(fill_value=False)
    is_known = goes_on & curve[name].notna() & curve[y].notna()
    axes.fill_between(
        curve[x],
        curve[y] - curve[name],
        curve[y] + curve[name],
        where=is_known.to_numpy(),
        color=ink,
        gid=f"line-{group}",
        **_BAND,
    )


def told(
    source: Source,
    places: Iterable[tuple[xr.Dataset, Mapping[str, Any]]],
    measures: Sequence[str],
) -> dict[str, str]:
    """What the words of a figure say of the bands of some measures: the tolerances, the
    keys that have most of each band, those that change nothing, and those by which some
    gaits have no derivative.
    """
    every = [*places]
    changes = {}
    for measure in measures:
        known = []
        for data, at in every:
            parts = _contributions(source, data, at, measure)
            if parts is not None:
                known.append(_flat(parts, data[measure]))

        if known:
            changes[measure] = np.hstack(known)
    if not changes:
        return {}

    keys = [*given(source)]
    shares = [_most(measure, keys, rows) for measure, rows in changes.items()]
    rows = np.hstack([*changes.values()])
    by_key = dict(zip(keys, rows, strict=True))
    lacking = [key for key, row in by_key.items() if np.isnan(row).any()]
    still = [key for key, row in by_key.items() if row.size and (row == 0).all()]

    return {
        "tolerances": listed(source),
        "most_off": "; ".join(filter(None, shares)),
        "unmoved": ", ".join(still),
        "undifferentiated": ", ".join(lacking),
    }


def _flat(contributions: xr.DataArray, measure: xr.DataArray) -> np.ndarray:
    """Contributions (keys, n) to a measure of the n gaits that there are."""
    rows = contributions.transpose("key", *measure.dims).values
    return np.asarray(rows[:, measure.notnull().values])


def _most(measure: str, keys: Sequence[str], rows: np.ndarray) -> str:
    """The key with the largest share, in the median over gaits, of the half-width of a
    measure, from contributions (keys, gaits); empty if nothing moves it, or if there is
    one key.
    """
    whole = rows.sum(axis=0)
    is_known = whole > 0
    if not is_known.any() or len(keys) == 1:
        return ""

    shares = np.median(rows[:, is_known] / whole[is_known], axis=1)
    first = int(shares.argmax())
    share = 100 * float(shares[first])
    return f"{keys[first]} ({share:.0f} % of the half-width of {spaced(measure)})"


def listed(source: Source) -> str:
    """The tolerances in words; empty if there are none."""
    units = units_of_keys(source)
    return ", ".join(
        f"{key} ± {in_words(tolerance, units.get(key, ''))}"
        for key, tolerance in given(source).items()
    )


def units_of_keys(source: Source) -> dict[str, str]:
    """Units of the keys by which an archive has derivatives, as they are printed."""
    grid, rates = source.grid, source.tables.get("special_sensitivities")
    units: dict[str, str] = {}
    if {"key", "key_units"} <= set(grid.variables):
        names, own = (grid[name].values.astype(str) for name in ("key", "key_units"))
        units = dict(zip(names.tolist(), own.tolist(), strict=True))
    if rates is not None:
        units |= dict(zip(rates["key"], rates["key_units"], strict=True))
    return {key: print_units(str(unit)) for key, unit in units.items()}


def in_words(tolerance: float | str, unit: str) -> str:
    """A tolerance in words."""
    if isinstance(tolerance, str):
        return f"{tolerance.rstrip('% ')} %"
    return f"{plain(tolerance)} {unit}".rstrip()


def special_points(source: Source) -> pd.DataFrame:
    """The table of special points, with the half-widths of their slopes and the key
    that has most of each, where tolerances and derivatives are known.

    A point that lacks the derivative by one of the keys has none.
    """
    points = source.tables.get("special_points", pd.DataFrame())
    rates = source.table("special_sensitivities", "key", "slope_by_key", "slope")
    each = given(source)
    if not each or rates is None or points.empty:
        return points

    axes = [axis for axis in ("walker", *source.axes) if axis in rates]
    at = list(dict.fromkeys((*axes, "branch", "kind", "slope")))
    own = rates[rates["key"].isin(each)]
    own = own.assign(off=[*_off(source, own, axes)])
    whole = own.groupby(at, sort=False)["off"].sum(min_count=len(each))
    whole = whole.rename(_OF_SLOPE)

    found = points
    for column in (whole, _greatest(own, at)):
        found = found.merge(column, how="left", left_on=at, right_index=True)
    found[_MOST] = found[_MOST].where(found[_OF_SLOPE].notna(), "")
    units = {**points.attrs.get("units", {}), _OF_SLOPE: "rad"}
    found.attrs = {**points.attrs, "units": units}
    return found


def _greatest(own: pd.DataFrame, at: list[str]) -> pd.Series:
    """The key with most of the half-width of each point, of which some part is known."""
    known = own.dropna(subset=["off"])
    rows = known.groupby(at, sort=False)["off"].idxmax()
    return known.loc[rows].set_index(at)["key"].rename(_MOST)


def _off(source: Source, rates: pd.DataFrame, axes: Sequence[str]) -> Iterator[float]:
    """By how much the tolerance of the key of each row changes a slope."""
    each = given(source)
    for row in rates.to_dict("records"):
        at = {axis: row[axis] for axis in axes if axis != "slope"}
        key = str(row["key"])
        value = float(source.parameters(at).get(key) or 0.0)
        yield abs(row["slope_by_key"]) * tolerances.size(each[key], value)


def draw_bars(axes: Axes, points: pd.DataFrame) -> None:
    """Draw how far the slopes of special points may lie off."""
    if _OF_SLOPE in points:
        known = points[points[_OF_SLOPE].notna()]
        axes.errorbar(
            known["slope"],
            known["stance_angle"],
            xerr=known[_OF_SLOPE],
            **_BAR,
        )


def told_of_points(source: Source, points: pd.DataFrame) -> dict[str, str]:
    """What the words of a figure say of the bars of special points."""
    if _OF_SLOPE not in points or points[_OF_SLOPE].isna().all():
        return {}

    most = [
        f"{row[_MOST]} ({spaced(row['kind'])} at {plain(row['slope'])})"
        for row in points.to_dict("records")
        if row[_MOST]
    ]
    return {"bars": listed(source), "most_off": ", ".join(most[:_MOST_TOLD])}


#: Most points of which a caption says which key has most.
_MOST_TOLD = 4
