"""What searches found: a census of gaits, and cascades of period doublings."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from gaitsweep.pipeline.report.figures.sketch import TIPS, Sketch
from gaitsweep.pipeline.report.figures.style import (
    DOTTED,
    MARKERS,
    MUTED,
    PAPER,
    inks,
)
from gaitsweep.pipeline.report.source import Line, Source, rows_at
from gaitsweep.pipeline.report.words import (
    plain,
    shorten,
    with_unit,
)

#: Feigenbaum's constant: the limit of the ratios of successive distances between flips.
FEIGENBAUM = 4.669201609102990
#: Factor of the slope, or of what else drives, over which the walkers of a census at one
#: value are spread.
_ABREAST = 1.5


def census(source: Source, table: pd.DataFrame, coverage: pd.DataFrame) -> Sketch:
    """Plot the gaits that a census found, and the bound on what it missed, against
    slope, or what else drives.
    """
    sketch = Sketch("census", 430, 2, sharex=True, height_ratios=[5, 3])
    every = source.lines_of(table)
    reached = coverage[coverage["converged"] > 0]
    colours = inks([line.called for line in every])
    for k, (line, ink) in enumerate(zip(every, colours, strict=True)):
        # Walkers at one slope stand side by side, one alone at its slope.
        beside = _ABREAST ** ((k + 0.5) / len(every) - 0.5)
        marker = MARKERS[k % len(MARKERS)]
        _draw_line(sketch, source, line, reached, beside, (ink, marker))
        if k < len(MARKERS):
            name = line.label or source.walker
            sketch.key(shorten(name), ink, marker=marker, ms=5)

    sketch.panels[1].set_ylim(bottom=0)
    sketch.dot_key("legs pass more than once", mfc=PAPER, ms=5)

    most = int(coverage["anthropomorphic"].max())
    worst = float(reached["unseen"].max()) if len(reached) else 1.0

    return sketch.finish(
        table,
        abscissa=source.along,
        most=most,
        worst=f"{100 * worst:.1f}",
        abreast=len(every) > 1,
        **source.words_along,
    )


def _draw_line(
    sketch: Sketch,
    source: Source,
    line: Line,
    reached: pd.DataFrame,
    beside: float,
    style: tuple[str, str],
) -> None:
    """Draw the gaits of a line, which walk, and the share of guesses that lead to others,
    with an ink and a marker, at so many times what they lie along.
    """
    top, below = sketch.panels
    along = source.along
    ink, marker = style
    rows = line.rows.assign(place=beside * line.rows[along])
    _draw_found(top, rows, ink, marker)

    driven = {} if along in TIPS else {along: source.words_along["x"]}
    period = source.period_title(line.at)
    tips = driven | TIPS | {"period": period, "hits": "hits"}
    how = {"tips": tips, "x": "place", "along": along}
    name = line.label or source.walker
    sketch.mark(top, rows, name, command=line.command, **how)

    seen = rows_at(reached, line.at)
    unseen = beside * seen[along], 100 * seen["unseen"]
    below.plot(*unseen, color=ink, lw=1.1, marker=marker, ms=4)


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
    colours = inks(names)
    for k, (one, ink) in enumerate(zip(families, colours, strict=True)):
        marker = MARKERS[k % len(MARKERS)]
        _draw_family(sketch, source, axes, one, ink, marker)

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
