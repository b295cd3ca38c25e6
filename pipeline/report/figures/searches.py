"""What searches found: a census of gaits, cascades of period doublings, and curves of folds and flips."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from pipeline.report.figures.branch_curves import groups, line_command, title
from pipeline.report.figures.style import (
    DASHES,
    GAIT_COLOURS,
    INK,
    MUTED,
    PAPER,
    canvas,
    log_axis,
    plain,
    set_heading,
    shorten,
)
from pipeline.report.figures.svg import Marks, Sketch
from pipeline.report.source import SYMBOLS, Source, print_units

#: Feigenbaum's constant: the limit of the ratios of successive distances between flips.
FEIGENBAUM = 4.669201609102990
_INKS = tuple(GAIT_COLOURS.values())
#: Factor of the slope over which the walkers of a census at one slope are spread.
_ABREAST = 1.5


def _columns(source: Source, name: str, needed: set[str]) -> pd.DataFrame | None:
    """A table of the archive that has rows and all the columns that a figure needs."""
    table = source.tables.get(name)
    return table if table is not None and len(table) and needed <= set(table.columns) else None


def census(source: Source) -> Sketch | None:
    """Plot the gaits that a census found, and the bound on what it missed, against slope."""
    table = _columns(source, "census", {"slope", "stance_angle", "anthropomorphic"})
    coverage = _columns(source, "coverage", {"slope", "unseen", "converged", "anthropomorphic"})
    if table is None or coverage is None:
        return None
    figure = canvas(430)
    top, below = figure.subplots(2, 1, sharex=True, height_ratios=[5, 3])
    log_axis(top, "x")
    log_axis(top, "y")
    marks, names, every = [], [], groups(source, table)
    for k, (at, rows) in enumerate(every):
        names.append(title(at) or source.walker)
        ink, dash = _INKS[k % 4], DASHES[k // 4 % len(DASHES)]
        # Walkers at one slope stand side by side, one alone at its slope.
        beside = _ABREAST ** ((k + 0.5) / len(every) - 0.5)
        for passes_once, fill in ((1, ink), (0, PAPER)):
            part = rows[rows["anthropomorphic"] == passes_once]
            top.plot(beside * part["slope"], part["stance_angle"], "osD^vPXd"[k % 8], color=ink, mfc=fill, ms=5, ls="")
        slopes, angles = rows["slope"].to_numpy(), rows["stance_angle"].to_numpy()
        values = {"γ (rad)": slopes, "θ* (rad)": angles, "hits": rows.get("hits", rows["slope"]).to_numpy()}
        marks.append(Marks(top, beside * slopes, angles, names[-1], values, line_command(source, rows), slopes))
        seen = coverage
        for column, value in at.items():
            seen = seen[seen[column] == value]
        seen = seen[seen["converged"] > 0]
        below.plot(
            beside * seen["slope"], 100 * seen["unseen"], color=ink, ls=dash, lw=1.1, marker="osD^vPXd"[k % 8], ms=4
        )
    set_heading(top, "stance angle θ* of every gait found (rad)")
    set_heading(below, "converging guesses that may lead to unseen gaits, at most (%)")
    below.set_ylim(bottom=0)
    below.set_xlabel("slope γ (rad)")
    keys = [
        Line2D([], [], color=_INKS[k % 4], ls=DASHES[k // 4], marker="osD^vPXd"[k % 8], ms=5, label=shorten(name))
        for k, name in enumerate(names[:8])
    ]
    keys.append(Line2D([], [], color=INK, mfc=PAPER, marker="o", ls="", ms=5, label="legs pass more than once"))
    figure.legend(handles=keys, loc="outside upper left", ncols=3)
    abreast = " Gaits of one slope stand side by side around it." if len(every) > 1 else ""
    most, reached = int(coverage["anthropomorphic"].max()), coverage[coverage["converged"] > 0]
    worst = float(reached["unseen"].max()) if len(reached) else 1.0
    return Sketch(
        figure,
        "Gaits found by the census",
        f"At most {most} gaits whose legs pass once for any walker at any slope (filled). Below: the bound of Good and "
        f"Turing on the converging initial guesses that would lead to a gait not found, at most {100 * worst:.1f} %."
        f"{abreast}",
        f"Stance angles of {len(table)} gaits found from initial guesses over the section, against slope, and the "
        f"largest share of converging guesses that may lead to unseen gaits, {100 * worst:.1f} percent.",
        table,
        marks,
    )


def cascade(source: Source) -> Sketch | None:
    """Plot the distances between successive flips of each family on a logarithmic axis, with Feigenbaum's line."""
    table = _columns(source, "cascade", {"slope", "kind", "family"})
    if table is None:
        return None
    figure = canvas(330)
    axes = figure.add_subplot()
    pieces: list[pd.DataFrame] = []
    marks, keys = [], []
    for at, rows in groups(source, table):
        for family, events in rows[rows["kind"] == "flip"].groupby("family", sort=False):
            slopes = events["slope"].to_numpy()
            if len(slopes) < 3:
                continue
            distance, number = np.diff(slopes), np.arange(1, len(slopes))
            k = len(pieces)
            ink, name = _INKS[k % 4], ", ".join(filter(None, (title(at), f"period {family}")))
            axes.semilogy(number, np.abs(distance), "osD^v"[k % 5], color=ink, ms=5, ls=DASHES[k % len(DASHES)], lw=0.9)
            law = np.abs(distance[-1]) * FEIGENBAUM ** (number[-1] - number)
            axes.semilogy(number, law, color=MUTED, lw=1, ls=(0, (1, 2)))
            keys.append(Line2D([], [], color=ink, marker="osD^v"[k % 5], ms=5, lw=0.9, label=shorten(name)))
            command = line_command(source, rows)
            values = {"flip (rad)": slopes[:-1], "next flip (rad)": slopes[1:], "distance (rad)": distance}
            marks.append(Marks(axes, number, np.abs(distance), name, values, command, slopes[:-1]))
            pieces.append(pd.DataFrame({**values, "number": number, "line": title(at), "family": str(family)}))
    if not pieces:
        return None
    log_axis(axes, "y")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set_xlabel("number of the flip")
    set_heading(axes, "distance to the next flip in slope (rad)")
    keys.append(Line2D([], [], color=MUTED, lw=1, ls=(0, (1, 2)), label=f"Feigenbaum's ratio {FEIGENBAUM:.4f}"))
    figure.legend(handles=keys, loc="outside upper left", ncols=3)
    limits = _columns(source, "accumulation", {"slope", "ratio"})
    ratios = [] if limits is None else [plain(r, 5) for r in limits["ratio"].dropna()]
    sentence = f" The last ratio{'s are' if len(ratios) > 1 else ' is'} {', '.join(ratios)}." if ratios else ""
    return Sketch(
        figure,
        "Period doublings",
        "Distances in slope between successive period doublings of each family; dotted, the geometric law of "
        f"Feigenbaum through the last.{sentence}",
        f"Distances between successive flips of {len(pieces)} families, each about 4.67 times the next.{sentence}",
        pd.concat(pieces, ignore_index=True),
        marks,
    )


def curves(source: Source) -> Sketch | None:
    """Plot the curves of folds, flips or ends over the slope and the key that varies, with their turning points."""
    table = _columns(source, "curves", {"slope", "key", "value", "curve"})
    if table is None:
        return None
    figure = canvas(330)
    axes = figure.add_subplot()
    marks, kinds = [], list(dict.fromkeys(table["kind"].astype(str))) if "kind" in table else ["curve"]
    for at, rows in groups(source, table):
        for number, curve in rows.groupby("curve", sort=False):
            kind = str(curve["kind"].iloc[0]) if "kind" in curve else "curve"
            k = kinds.index(kind)
            axes.plot(curve["slope"], curve["value"], color=_INKS[k % 4], lw=1.5, ls=DASHES[k % len(DASHES)])
            slopes, values = curve["slope"].to_numpy(), curve["value"].to_numpy()
            key = str(curve["key"].iloc[0])
            label = ", ".join(filter(None, (title(at), f"{kind.replace('_', ' ')}, curve {number}")))
            base = line_command(source, curve.drop(columns=key, errors="ignore"))
            commands = [
                f"{base} --set {key}={float(v)!r} --slope {float(s)!r}" for s, v in zip(slopes, values, strict=True)
            ]
            marks.append(Marks(axes, slopes, values, label, {"γ (rad)": slopes, key: values}, commands=commands))
    key = str(table["key"].iloc[0])
    turns = _columns(source, "turnings", {"slope", "value", "turn"})
    touching = turns[turns["turn"] == "key"] if turns is not None else pd.DataFrame()
    # Where curves of flips or ends turn back, two such points meet on one branch.
    touching = touching[touching["kind"].astype(str) == "fold"] if "kind" in touching else touching
    touches = []
    for row in touching.itertuples():
        axes.plot([row.slope], [row.value], "o", color=INK, mfc=PAPER, ms=7, zorder=5)
        axes.annotate(
            f"branches touch: {key} {plain(row.value, 6)}, γ = {plain(row.slope, 6)}",
            (row.slope, row.value),
            xytext=(0, -16),
            textcoords="offset points",
            ha="center",
            fontsize=8.5,
        )
        touches.append(f"{key} {plain(row.value, 9)} and slope {plain(row.slope, 9)} rad")
    axes.set_xlabel("slope γ (rad)")
    unit = print_units(table.attrs.get("units", {}).get("value", ""))
    set_heading(axes, SYMBOLS.get(key, key.replace("_", " ")) + (f" ({unit})" if unit else ""))
    keys = [
        Line2D([], [], color=_INKS[k % 4], lw=1.5, ls=DASHES[k % len(DASHES)], label=f"{kind.replace('_', ' ')}s")
        for k, kind in enumerate(kinds)
    ]
    figure.legend(handles=keys, loc="outside upper left", ncols=4)
    return Sketch(
        figure,
        "Curves of special points",
        f"{' and '.join(k.replace('_', ' ') + 's' for k in kinds).capitalize()} over slope and {key}."
        + (
            f" Where the curve turns back in {key}, two branches touch and re-pair: {'; '.join(touches)}."
            if touches
            else ""
        ),
        f"Curves of {', '.join(kinds)} over slope and {key}, with {len(touching)} places where branches touch.",
        table,
        marks,
    )
