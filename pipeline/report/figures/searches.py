"""What searches found: a census of gaits, cascades of period doublings, and curves of
folds and flips.
"""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from gaitsweep.pipeline.report.figures.sketch import TIPS, Sketch
from gaitsweep.pipeline.report.figures.style import (
    DOTTED,
    INK,
    MARKERS,
    MUTED,
    PAPER,
    colour,
    inks,
    write_at,
)
from gaitsweep.pipeline.report.source import Line, Source, rows_at
from gaitsweep.pipeline.report.words import (
    plain,
    print_units,
    shorten,
    spaced,
    symbol,
    with_unit,
)

#: Feigenbaum's constant: the limit of the ratios of successive distances between flips.
FEIGENBAUM = 4.669201609102990
#: Factor of the slope over which the walkers of a census at one slope are spread.
_ABREAST = 1.5


def census(source: Source, table: pd.DataFrame, coverage: pd.DataFrame) -> Sketch:
    """Plot the gaits that a census found, and the bound on what it missed, against
    slope.
    """
    sketch = Sketch("census", 430, 2, sharex=True, height_ratios=[5, 3])
    top, below = sketch.panels
    every = source.lines_of(table)
    reached = coverage[coverage["converged"] > 0]
    colours = inks([line.called for line in every])
    for k, (line, ink) in enumerate(zip(every, colours, strict=True)):
        # Walkers at one slope stand side by side, one alone at its slope.
        beside = _ABREAST ** ((k + 0.5) / len(every) - 0.5)
        marker = MARKERS[k % len(MARKERS)]
        name = line.label or source.walker
        rows = line.rows.assign(place=beside * line.rows["slope"])
        _draw_found(top, rows, ink, marker)
        tips = TIPS | {"hits": "hits"}
        sketch.mark(top, rows, name, command=line.command, tips=tips, x="place")

        seen = rows_at(reached, line.at)
        unseen = beside * seen["slope"], 100 * seen["unseen"]
        below.plot(*unseen, color=ink, lw=1.1, marker=marker, ms=4)
        if k < len(MARKERS):
            sketch.key(shorten(name), ink, marker=marker, ms=5)
    below.set_ylim(bottom=0)
    sketch.dot_key("legs pass more than once", mfc=PAPER, ms=5)

    most = int(coverage["anthropomorphic"].max())
    worst = float(reached["unseen"].max()) if len(reached) else 1.0
    return sketch.finish(
        table, most=most, worst=f"{100 * worst:.1f}", abreast=len(every) > 1
    )


def _draw_found(axes: Axes, rows: pd.DataFrame, ink: str, marker: str) -> None:
    """Draw the gaits found of a walker, filled where the legs pass once."""
    for passes_once, fill in ((1, ink), (0, PAPER)):
        part = rows[rows["anthropomorphic"] == passes_once]
        how: Any = {"color": ink, "mfc": fill, "ms": 5, "ls": ""}
        axes.plot(part["place"], part["stance_angle"], marker, **how)


class _Family(NamedTuple):
    """Flips of a family of gaits of a line: their data, one row for each interval."""

    line: Line
    family: str
    name: str
    data: pd.DataFrame


def cascade(source: Source, table: pd.DataFrame) -> Sketch | None:
    """Plot the distances between successive flips of each family on a logarithmic axis,
    with Feigenbaum's line.
    """
    families = list(_families(source, table))
    if not families:
        return None

    sketch = Sketch("cascade", 330)
    (axes,) = sketch.panels
    names = [one.line.called if one.line.called else one.name for one in families]
    for k, (one, ink) in enumerate(zip(families, inks(names), strict=True)):
        _draw_family(sketch, source, axes, one, ink, MARKERS[k % len(MARKERS)])
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    sketch.key(f"Feigenbaum's ratio {FEIGENBAUM:.4f}", MUTED, lw=1, ls=DOTTED)

    limits = source.table("accumulation", source.along, "ratio")
    ratios = [] if limits is None else [plain(r, 5) for r in limits["ratio"].dropna()]
    are = "s are" if len(ratios) > 1 else " is"
    sentence = f" The last ratio{are} {', '.join(ratios)}." if ratios else ""
    about = source.words_along
    interval = f"{about['axis']} interval to the next period doubling"
    about["interval"] = with_unit(interval, source.units(source.along))
    return sketch.finish(count=len(families), ratios=sentence, **about)


def _families(source: Source, table: pd.DataFrame) -> Iterator[_Family]:
    """Yield the families of a table that have two intervals between flips or more."""
    for line in source.lines_of(table):
        flips = line.rows[line.rows["kind"] == "flip"]
        for family, events in flips.groupby("family", sort=False):
            values = events[source.along].to_numpy()
            if len(values) < 3:
                continue
            data = events.iloc[:-1].assign(
                number=np.arange(1, len(values)),
                flip=values[:-1],
                distance=np.diff(values),
                gap=np.abs(np.diff(values)),
            )
            data["next flip"] = values[1:]
            # Lines without flips have no rows: this may be the only one of several.
            label = line.label or source.label_among_lines(line.at)
            name = ", ".join(filter(None, (label, f"period {family}")))
            yield _Family(line, str(family), name, data)


def _draw_family(
    sketch: Sketch, source: Source, axes: Axes, one: _Family, ink: str, marker: str
) -> None:
    """Draw the intervals of a family, with the geometric law through the last."""
    unit = source.units(source.along)
    titles = {name: with_unit(name, unit) for name in ("flip", "next flip", "distance")}
    number, gap = one.data["number"].to_numpy(), one.data["gap"].to_numpy()
    axes.plot(number, gap, marker, color=ink, ms=5, ls="-", lw=0.9)
    law = gap[-1] * FEIGENBAUM ** (number[-1] - number)
    axes.plot(number, law, color=MUTED, lw=1, ls=DOTTED)
    sketch.key(shorten(one.name), ink, marker=marker, ms=5, lw=0.9)

    told = one.data[[*titles, "number"]].rename(columns=titles)
    sketch.pieces.append(told.assign(line=one.line.label, family=one.family))
    sketch.mark(
        axes,
        one.data,
        one.name,
        command=one.line.command,
        tips=titles,
        x="number",
        y="gap",
        along=source.along,
        free=True,
    )


def curves(source: Source, table: pd.DataFrame) -> Sketch:
    """Plot the curves of folds, flips or ends over the slope and the key that varies,
    with their turning points, or over two keys.
    """
    sketch = Sketch("curves", 330)
    (axes,) = sketch.panels
    table = table if "kind" in table else table.assign(kind="curve")
    kinds = {str(kind): colour(k) for k, kind in enumerate(table["kind"].unique())}
    for line in source.lines_of(table):
        for number, curve in line.rows.groupby("curve", sort=False):
            _draw_curve(sketch, source, line, number, curve, kinds)

    key = str(table["key"].iloc[0])
    unit = print_units(table.attrs.get("units", {}).get("value", ""))
    touches = _mark_touches(source, axes, key)
    meetings = _mark_meetings(sketch, source, key)
    several = {kind: _several(kind) for kind in kinds}
    for kind, ink in kinds.items():
        sketch.key(several[kind], ink, lw=1.5)
    return sketch.finish(
        table,
        count=len(touches),
        touches="; ".join(touches),
        meetings="; ".join(meetings),
        Kinds=" and ".join(several.values()).capitalize(),
        kinds=", ".join(kinds),
        key=key,
        value=with_unit(symbol(key), unit),
        **_abscissa(table),
    )


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

    words = line.label, f"{spaced(kind)}, curve {number}"
    keys = {key: "value"}
    if x == "other_value":
        keys[str(curve["other_key"].iloc[0])] = x
    others = {name: value for name, value in line.at.items() if name not in keys}
    commands = _commands(source.command(others), curve, keys)
    rows = curve.assign(command=commands)
    tips = {"slope": "γ (rad)", **{of: name for name, of in keys.items()}}
    label = ", ".join(filter(None, words))
    sketch.mark(axes, rows, label, tips=tips, x=x, y="value")


def _commands(base: str, curve: pd.DataFrame, keys: dict[str, str]) -> list[str]:
    """The command that solves each point of a curve, whose keys are in some columns."""
    commands = []
    for row in curve.to_dict("records"):
        sets = "".join(f" --set {name}={row[of]!r}" for name, of in keys.items())
        commands.append(f"{base}{sets} --slope {row['slope']!r}")
    return commands


def _several(kind: str) -> str:
    """Points of a curve in words: folds, or gaits of a level."""
    return spaced(kind) if "=" in kind else f"{spaced(kind)}s"


def _mark_touches(source: Source, axes: Axes, key: str) -> list[str]:
    """Mark where branches touch: where a curve of folds turns back in its key; these
    places in words.
    """
    turns = source.table("turnings", "slope", "value", "turn")
    if turns is None:
        return []
    # Where curves of flips or ends turn back, two such points meet on one branch.
    kinds = (
        turns["kind"].astype(str) if "kind" in turns else pd.Series("fold", turns.index)
    )
    touches = []
    for row in turns[(turns["turn"] == "key") & (kinds == "fold")].itertuples():
        axes.plot([row.slope], [row.value], "o", color=INK, mfc=PAPER, ms=7, zorder=5)
        words = (
            f"branches touch: {key} {plain(row.value, 6)}, γ = {plain(row.slope, 6)}"
        )
        write_at(axes, words, (row.slope, row.value), (0, -16), ha="center")
        touches.append(
            f"{key} {plain(row.value, 9)} and slope {plain(row.slope, 9)} rad"
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
    named: list[str] = []
    tips = {"slope": "γ (rad)", "value": key}
    for line in source.lines_of(table):
        others = {name: value for name, value in line.at.items() if name != key}
        commands = _commands(source.command(others), line.rows, {key: "value"})
        for name, rows in line.rows.assign(command=commands).groupby("point"):
            axes.plot(rows["slope"], rows["value"], "D", color=INK, ms=5, zorder=6)
            label = ", ".join(filter(None, (line.label, spaced(str(name)))))
            sketch.mark(axes, rows, label, tips=tips, x="slope", y="value")
            for row in rows.itertuples():
                where = f"{key} {plain(row.value, 6)}, slope {plain(row.slope, 6)} rad"
                words = f"{label} at {where}"
                if words not in named:
                    write_at(axes, spaced(str(name)), (row.slope, row.value), (6, 6))
                    named.append(words)
    return named
