"""Curves of folds, flips, ends and levels over slope and a key, or over two keys, with
their codimension-two points.
"""

from collections.abc import Hashable
from typing import Any

import pandas as pd

from gaitsweep.pipeline.report.figures.sketch import Sketch
from gaitsweep.pipeline.report.figures.starts import points_of_curves, with_slope
from gaitsweep.pipeline.report.figures.style import (
    INK,
    PAPER,
    colour,
    write_at,
    write_clear,
)
from gaitsweep.pipeline.report.source import Line, Source
from gaitsweep.pipeline.report.words import (
    plain,
    print_units,
    spaced,
    symbol,
    with_unit,
)

#: Where the name of a codimension-two point may stand beside its mark.
_BESIDE = (
    (8, 8, "left"),
    (-8, 8, "right"),
    (-8, -10, "right"),
    (8, -10, "left"),
    (-12, 0, "right"),
)


def curves(source: Source, table: pd.DataFrame) -> Sketch:
    """Plot the curves of folds, flips or ends over the slope and the key that varies,
    with their turning points, or over two keys.
    """
    sketch = Sketch("curves", 330)
    table = table if "kind" in table else table.assign(kind="curve")
    kinds = {str(kind): colour(k) for k, kind in enumerate(table["kind"].unique())}
    key = str(table["key"].iloc[0])
    unit = print_units(table.attrs.get("units", {}).get("value", ""))
    touches = _mark_touches(sketch, source, key)
    for line in source.lines_of(table):
        for number, curve in line.rows.groupby("curve", sort=False):
            _draw_curve(sketch, source, line, number, curve, kinds)

    meetings = _mark_meetings(sketch, source, key)
    words = " and ".join(map(_several, kinds))
    _legend(sketch, kinds)

    return sketch.finish(
        _named_by_key(table, key),
        count=len(touches),
        touches="; ".join(touches),
        meetings="; ".join(meetings),
        Kinds=words[0].upper() + words[1:],
        kinds=", ".join(kinds),
        key=key,
        value=with_unit(symbol(key), unit),
        **_abscissa(table),
    )


def _legend(sketch: Sketch, kinds: dict[str, str]) -> None:
    """Add the kinds of points to the legend, in their inks."""
    for kind, ink in kinds.items():
        sketch.key(_several(kind), ink, lw=1.5)


def _named_by_key(table: pd.DataFrame, key: str) -> pd.DataFrame:
    """The curves over one key with its values under its name, not beside the value
    that an axis of that name has.
    """
    if "other_key" in table or set(table["key"]) != {key}:
        return table
    rest = table.drop(columns=["key", key], errors="ignore")
    return rest.rename(columns={"value": key})


def _abscissa(table: pd.DataFrame) -> dict[str, str]:
    """What curves lie over beside the key: the slope, or another key at fixed slopes."""
    if "other_key" not in table:
        return {"x": "slope γ (rad)", "over": "slope"}

    key = str(table["other_key"].iloc[0])
    unit = print_units(table.attrs.get("units", {}).get("other_value", ""))
    slopes = sorted(set(table["slope"].tolist()))
    shown = ", ".join(plain(slope) for slope in slopes)

    return {
        "x": with_unit(symbol(key), unit),
        "over": f"{key} at slope {shown} rad",
    }


def _draw_curve(
    sketch: Sketch,
    source: Source,
    line: Line,
    number: Any,
    curve: pd.DataFrame,
    kinds: dict[str, str],
) -> None:
    """Draw one curve in the colour of its kind; each point tells its values and the
    command that solves it.
    """
    (axes,) = sketch.panels
    kind, key = str(curve["kind"].iloc[0]), str(curve["key"].iloc[0])
    x = "other_value" if "other_value" in curve else "slope"
    axes.plot(curve[x], curve["value"], color=kinds[kind], lw=1.5)

    keys = {key: "value"}
    if x == "other_value":
        keys[str(curve["other_key"].iloc[0])] = x
    label = _labelled(line, f"{spaced(kind)}, curve {number}")
    _mark(sketch, source, curve, label, keys, x)


def _mark(
    sketch: Sketch,
    source: Source,
    points: pd.DataFrame,
    label: str,
    keys: dict[str, str],
    x: str,
    **more: Any,
) -> None:
    """Mark points of curves over keys, which are in some columns; each tells its values
    and the command that solves it.
    """
    (axes,) = sketch.panels
    commands = [
        with_slope(source.command(at), row["slope"])
        for at, row in points_of_curves(source, points)
    ]
    tips = {"slope": "γ (rad)", **{of: name for name, of in keys.items()}}
    if "criticality" in points and (points["criticality"] != "").any():
        tips["criticality"] = "normal form"

    rows = points.assign(command=commands)
    at = source.line_of(points)
    base = source.command({name: at[name] for name in at if name not in keys})
    sketch.mark(axes, rows, label, command=base, tips=tips, x=x, y="value", **more)


def _several(kind: str) -> str:
    """Points of a curve in words: folds, or gaits of a level or an onset."""
    if "=" in kind or kind.startswith("onset_"):
        return spaced(kind)
    return f"{spaced(kind)} points" if kind == "neimark_sacker" else f"{spaced(kind)}s"


def _mark_touches(sketch: Sketch, source: Source, key: str) -> list[str]:
    """Mark where branches touch: where a curve of folds turns back in its key; these
    places in words.
    """
    (axes,) = sketch.panels
    turns = source.table("turnings", "slope", "value", "turn")
    if turns is None:
        return []

    # Where curves of flips or ends turn back, two such points meet on one branch.
    kinds = (
        turns["kind"].astype(str) if "kind" in turns else pd.Series("fold", turns.index)
    )
    touches = []
    folds = turns[(turns["turn"] == "key") & (kinds == "fold")]
    if len(folds):
        keys = {key: "value"}
        _mark(sketch, source, folds, "branches touch", keys, "slope", above=True)
    for row in folds.itertuples():
        axes.plot([row.slope], [row.value], "o", color=INK, mfc=PAPER, ms=7, zorder=5)
        words = (
            f"branches touch: {key} {plain(row.value, 6)}, γ = {plain(row.slope, 6)}"
        )
        write_at(axes, words, (row.slope, row.value), (0, -16), ha="center")
        touches.append(
            f"{key} {plain(row.value, 7)} and slope {plain(row.slope, 7)} rad"
        )

    return touches


def _mark_meetings(sketch: Sketch, source: Source, key: str) -> list[str]:
    """Mark codimension-two points with their names; these in words. Where both curves
    were followed, either has the point, which is named once.
    """
    (axes,) = sketch.panels
    table = source.table("meetings", "slope", "value", "point")
    if table is None:
        return []

    keys, x = {key: "value"}, "slope"
    if "other_value" in table:
        x = "other_value"
        keys[str(table["other_key"].iloc[0])] = x

    named: dict[str, tuple[str, tuple[float, float]]] = {}
    for line in source.lines_of(table):
        _mark_points(sketch, source, line, keys, x)
        for row in line.rows.to_dict("records"):
            name = spaced(str(row["point"]))
            words = f"{_labelled(line, name)} at {_where(row, keys)}"
            named.setdefault(words, (name, (row[x], row["value"])))

    write_clear(axes, [*named.values()], _BESIDE)
    return [*named]


def _mark_points(
    sketch: Sketch, source: Source, line: Line, keys: dict[str, str], x: str
) -> None:
    """Mark the codimension-two points of a line; each tells its values and the command
    that solves it.
    """
    (axes,) = sketch.panels
    for point, rows in line.rows.groupby("point"):
        axes.plot(rows[x], rows["value"], "D", color=INK, ms=5, zorder=6)
        label = _labelled(line, spaced(str(point)))
        _mark(sketch, source, rows, label, keys, x, above=True)


def _labelled(line: Line, name: str) -> str:
    """Name of a point or curve, after that of its line if there are several."""
    return ", ".join(filter(None, (line.label, name)))


def _where(row: dict[Hashable, Any], keys: dict[str, str]) -> str:
    """Place of a point of curves in words: its keys, which are in some columns, and its
    slope.
    """
    values = [f"{name} {plain(row[of], 6)}" for name, of in keys.items()]
    return ", ".join([*values, f"slope {plain(row['slope'], 6)} rad"])
