"""What searches found: a census of gaits, cascades of period doublings, and curves of folds and flips."""

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from gaitsweep.pipeline.report.figures.sketch import Sketch
from gaitsweep.pipeline.report.figures.style import (
    DOTTED,
    INK,
    MARKERS,
    MUTED,
    PAPER,
    colour,
    write_at,
)
from gaitsweep.pipeline.report.source import Source, rows_at
from gaitsweep.pipeline.report.words import axis_values, plain, print_units, shorten, spaced, symbol, with_unit

#: Feigenbaum's constant: the limit of the ratios of successive distances between flips.
FEIGENBAUM = 4.669201609102990
#: Factor of the slope over which the walkers of a census at one slope are spread.
_ABREAST = 1.5


def census(source: Source, table: pd.DataFrame, coverage: pd.DataFrame) -> Sketch:
    """Plot the gaits that a census found, and the bound on what it missed, against slope."""
    sketch = Sketch("census", 430, 2, sharex=True, height_ratios=[5, 3])
    top, below = sketch.panels
    every, reached = source.line_groups(table), coverage[coverage["converged"] > 0]
    tips = {"γ (rad)": "slope", "θ* (rad)": "stance_angle", "hits": "hits" if "hits" in table else "slope"}
    for k, (at, rows) in enumerate(every):
        name, ink, marker = axis_values(at) or source.walker, colour(k), MARKERS[k % 8]
        # Walkers at one slope stand side by side, one alone at its slope.
        beside = _ABREAST ** ((k + 0.5) / len(every) - 0.5)
        for passes_once, fill in ((1, ink), (0, PAPER)):
            part = rows[rows["anthropomorphic"] == passes_once]
            top.plot(beside * part["slope"], part["stance_angle"], marker, color=ink, mfc=fill, ms=5, ls="")
        values, place = {tip: rows[column] for tip, column in tips.items()}, beside * rows["slope"]
        command = source.line_command(rows)
        sketch.mark(top, place, rows["stance_angle"], name, values, command=command, slopes=rows["slope"])
        seen = rows_at(reached, at)
        below.plot(beside * seen["slope"], 100 * seen["unseen"], color=ink, lw=1.1, marker=marker, ms=4)
        if k < len(MARKERS):
            sketch.key(shorten(name), ink, marker=marker, ms=5)
    below.set_ylim(bottom=0)
    sketch.dot_key("legs pass more than once", mfc=PAPER, ms=5)
    most = int(coverage["anthropomorphic"].max())
    worst = float(reached["unseen"].max()) if len(reached) else 1.0
    return sketch.finish(table, most=most, worst=f"{100 * worst:.1f}", abreast=len(every) > 1)


def cascade(source: Source, table: pd.DataFrame) -> Sketch | None:
    """Plot the distances between successive flips of each family on a logarithmic axis, with Feigenbaum's line."""
    sketch = Sketch("cascade", 330)
    (axes,) = sketch.panels
    for at, rows in source.line_groups(table):
        for family, events in rows[rows["kind"] == "flip"].groupby("family", sort=False):
            slopes = events["slope"].to_numpy()
            if len(slopes) < 3:
                continue
            distance, number, k = np.diff(slopes), np.arange(1, len(slopes)), len(sketch.pieces)
            name = ", ".join(filter(None, (axis_values(at), f"period {family}")))
            ink, marker = colour(k), MARKERS[k % 5]
            axes.plot(number, np.abs(distance), marker, color=ink, ms=5, ls="-", lw=0.9)
            law = np.abs(distance[-1]) * FEIGENBAUM ** (number[-1] - number)
            axes.plot(number, law, color=MUTED, lw=1, ls=DOTTED)
            sketch.key(shorten(name), ink, marker=marker, ms=5, lw=0.9)
            values = {"flip (rad)": slopes[:-1], "next flip (rad)": slopes[1:], "distance (rad)": distance}
            command = source.line_command(rows)
            sketch.mark(axes, number, np.abs(distance), name, values, command=command, slopes=slopes[:-1])
            named = {"number": number, "line": axis_values(at), "family": str(family)}
            sketch.pieces.append(pd.DataFrame({**values, **named}))
    if not sketch.pieces:
        return None
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    sketch.key(f"Feigenbaum's ratio {FEIGENBAUM:.4f}", MUTED, lw=1, ls=DOTTED)
    limits = source.table("accumulation", "slope", "ratio")
    ratios = [] if limits is None else [plain(r, 5) for r in limits["ratio"].dropna()]
    sentence = f" The last ratio{'s are' if len(ratios) > 1 else ' is'} {', '.join(ratios)}." if ratios else ""
    return sketch.finish(count=len(sketch.pieces), ratios=sentence)


def curves(source: Source, table: pd.DataFrame) -> Sketch:
    """Plot the curves of folds, flips or ends over the slope and the key that varies, with their turning points."""
    sketch = Sketch("curves", 330)
    (axes,) = sketch.panels
    table = table if "kind" in table else table.assign(kind="curve")
    kinds = {str(kind): colour(k) for k, kind in enumerate(table["kind"].unique())}
    for at, rows in source.line_groups(table):
        for number, curve in rows.groupby("curve", sort=False):
            kind, key = str(curve["kind"].iloc[0]), str(curve["key"].iloc[0])
            axes.plot(curve["slope"], curve["value"], color=kinds[kind], lw=1.5)
            label = ", ".join(filter(None, (axis_values(at), f"{spaced(kind)}, curve {number}")))
            base = source.line_command(curve.drop(columns=key, errors="ignore"))
            places = curve[["slope", "value"]].to_numpy(float).tolist()
            commands = [f"{base} --set {key}={v!r} --slope {s!r}" for s, v in places]
            values = {"γ (rad)": curve["slope"], key: curve["value"]}
            sketch.mark(axes, curve["slope"], curve["value"], label, values, commands=commands)
    key, unit = str(table["key"].iloc[0]), print_units(table.attrs.get("units", {}).get("value", ""))
    touches = _mark_touches(source, axes, key)
    for kind, ink in kinds.items():
        sketch.key(f"{spaced(kind)}s", ink, lw=1.5)
    named = " and ".join(f"{spaced(kind)}s" for kind in kinds).capitalize()
    words = {"Kinds": named, "kinds": ", ".join(kinds), "key": key, "value": with_unit(symbol(key), unit)}
    return sketch.finish(table, count=len(touches), touches="; ".join(touches), **words)


def _mark_touches(source: Source, axes: Axes, key: str) -> list[str]:
    """Mark where branches touch: where a curve of folds turns back in its key; these places in words."""
    turns = source.table("turnings", "slope", "value", "turn")
    if turns is None:
        return []
    # Where curves of flips or ends turn back, two such points meet on one branch.
    kinds = turns["kind"].astype(str) if "kind" in turns else pd.Series("fold", turns.index)
    touches = []
    for row in turns[(turns["turn"] == "key") & (kinds == "fold")].itertuples():
        axes.plot([row.slope], [row.value], "o", color=INK, mfc=PAPER, ms=7, zorder=5)
        words = f"branches touch: {key} {plain(row.value, 6)}, γ = {plain(row.slope, 6)}"
        write_at(axes, words, (row.slope, row.value), (0, -16), ha="center")
        touches.append(f"{key} {plain(row.value, 9)} and slope {plain(row.slope, 9)} rad")
    return touches
