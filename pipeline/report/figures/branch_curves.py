"""Solution branches continued through folds to their ends (figures 6 and 8)."""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from gaitsweep.pipeline.report.figures import landmarks, measured, tolerances
from gaitsweep.pipeline.report.figures.sketch import TIPS, Sketch
from gaitsweep.pipeline.report.figures.stability import add_borders
from gaitsweep.pipeline.report.figures.style import (
    INK,
    LINE,
    MAX_PANELS,
    MUTED,
    PAPER,
    WALKERS,
    draw_gait,
    evenly,
    inks,
    set_heading,
    set_title,
    thin,
    write_clear,
)
from gaitsweep.pipeline.report.source import Line, Source, rows_at
from gaitsweep.pipeline.report.words import (
    WORDS,
    plain,
    shorten,
    spaced,
    symbol,
    with_unit,
    yes_or_no,
)

#: Title of the vertical axis.
_ANGLE = "stance angle θ* (rad)"
#: Spectral radius above which it is rounding of one without bound.
_UNBOUNDED = 1e12

#: Where the number of a point may stand beside its mark, in a panel and enlarged.
_NUMBERS = tuple((x, y, "center") for x, y in ((-14, -13), (14, -13), (14, 13)))
_NUMBERS_NEAR = tuple((x, y, "center") for x, y in ((-24, 8), (4, 24), (24, -6)))

#: The corner of a panel at the origin is enlarged if so many special points lie there.
_CROWD = 3


class _Corner(NamedTuple):
    """The part of a panel that is enlarged: a share of its slopes, how far it goes
    beyond the special points there, and the box where it stands, in shares of the
    panel; branches that begin at small slopes leave it free.
    """

    share: float
    margin: float
    box: tuple[float, float, float, float]


#: Share of its value by which the edge of a window may differ from what is asked for.
_EDGE = 1e-9

#: Of a figure of one panel, and of small multiples.
_ALONE = _Corner(0.25, 1.35, (0.56, 0.055, 0.42, 0.36))
_AMONG = _Corner(0.12, 1.15, (0.53, 0.09, 0.45, 0.44))


@dataclass(frozen=True)
class _Branches:
    """What a locus shows: some of the lines that the archive follows, with the points
    drawn of each, its special points and its ink, and what they are followed `along`.
    """

    lines: Sequence[Line]
    every: int
    drawn: Sequence[list[pd.DataFrame]]
    special: Sequence[pd.DataFrame]
    inks: Sequence[str]
    together: bool
    along: str

    @property
    def count(self) -> int:
        """Number of panels."""
        return 1 if self.together else len(self.lines)


def locus(source: Source, table: pd.DataFrame) -> Sketch:
    """Plot stance angle along each branch against the slope, or what else drives, with
    special points; one panel per line.
    """
    shown = _data(source, table)
    sketch = _panels(shown)
    for k in range(len(shown.lines)):
        _draw_line(sketch, source, shown, k)
    _legend(sketch, shown)
    sketch.panels[0].set(xlim=(0, None), ylim=(0, None))  # which all panels share

    enlarged = [_enlarge(sketch, source, shown, k) for k in range(shown.count)]
    sketch.figure.supxlabel(source.words_along["x"], fontsize=9.5)
    printed, numbered = "", pd.DataFrame()
    if shown.count > 1:
        sketch.figure.supylabel(_ANGLE, fontsize=9.5)
    else:
        numbered, printed = _draw_landmarks(sketch, source, enlarged[0])

    return sketch.finish(
        _bounded(sketch.data),
        numbered=bool(len(numbered)),
        enlarged=any(inset is not None for inset in enlarged),
        printed=printed,
        drawn=len(shown.lines),
        every=shown.every,
        count=shown.count,
        s="s" * (shown.count > 1),
        special=sum(map(len, shown.special)),
        reach=_reach(source),
        **tolerances.told_of_points(source, pd.concat(shown.special)),
        abscissa=source.along,
        **source.words_along,
    )


def _reach(source: Source) -> str:
    """The least value beyond which branches go on, but are not followed, inside of the
    window that the study gives; empty where there is none.
    """
    special = source.table("special_points", "kind", source.along)
    given = source.given("axes", source.along)
    if special is None or not given:
        return ""

    ends = (given["from"], given["to"]) if isinstance(given, dict) else given
    least, largest = min(ends), max(ends)
    edges = special.loc[special["kind"].astype(str) == "window", source.along]
    inside = edges[(edges > least * (1 + _EDGE)) & (edges < largest * (1 - _EDGE))]
    return plain(inside.min()) if len(inside) else ""


def _draw_landmarks(
    sketch: Sketch, source: Source, inset: Axes | None
) -> tuple[pd.DataFrame, str]:
    """Draw the paper's points on the only panel: those that it numbers, and a sentence
    on those that it prints.
    """
    (panel,) = sketch.panels
    set_heading(panel, _ANGLE)
    numbered = landmarks.point_numbers(source)
    _draw_points(panel, inset, numbered)
    drawn = landmarks.draw_at_angles(sketch, panel, source)
    return numbered, landmarks.sentence(drawn)


def _bounded(data: pd.DataFrame) -> pd.DataFrame:
    """Points with infinite radii where the derivative of the step map has no bound, as
    at a tangential strike.
    """
    if "spectral_radius" in data:
        radius = data["spectral_radius"]
        data["spectral_radius"] = radius.where(radius < _UNBOUNDED, np.inf)
    return data


def _data(source: Source, table: pd.DataFrame) -> _Branches:
    """The branches of some lines, evenly chosen, and their special points."""
    special = tolerances.special_points(source)
    if "kind" in special:  # where a branch leaves the window nothing happens
        special = special[special["kind"].astype(str) != "window"]

    every = source.lines_of(table)
    together = len(every) == 2 and all(
        line.label == line.at["walker"] for line in every
    )
    lines = evenly(every, MAX_PANELS)
    # Panels of one walker all have its colour: their titles tell them apart.
    own = [WALKERS.get(line.at["walker"], LINE) for line in lines]

    return _Branches(
        lines,
        len(every),
        [list(_runs(line.rows, source.along)) for line in lines],
        [rows_at(special, line.at) for line in lines],
        inks([line.called for line in lines]) if together else own,
        together,
        source.along,
    )


def _runs(frame: pd.DataFrame, along: str) -> Iterator[pd.DataFrame]:
    """Yield the points drawn of the branches of a line, in parts that a curve joins."""
    edges = frame[along].min(), frame[along].max()
    by_branch = [(0, frame)]
    if "branch" in frame:
        by_branch = list(frame.groupby("branch", sort=False))
    for branch, whole in by_branch:
        # A branch that leaves the window may come back at the same edge: no line joins
        # the two parts.
        at = np.array(
            [np.isclose(whole[along], edge, rtol=1e-9, atol=0) for edge in edges]
        )
        returns = (at & np.roll(at, 1, axis=1)).any(axis=0)
        for _, run in whole.groupby(np.cumsum(returns)):
            rows = thin(add_borders(run), 400).reset_index(drop=True)
            gait = rows["gait"].astype(str) if "gait" in rows else ""
            yield rows.assign(branch=branch, gait=gait)


def _panels(shown: _Branches) -> Sketch:
    """Empty panels, at most three abreast."""
    across = min(shown.count, 3)
    rows = -(-shown.count // across)
    height = 350 if shown.count == 1 else 200 * rows + 60
    sketch = Sketch("locus", height, rows, across, sharex=True, sharey=True)
    for axes in sketch.panels[shown.count :]:
        axes.axis("off")
    if across > 1:
        sketch.panels[0].locator_params(axis="x", nbins=3)
    return sketch


def _draw_line(sketch: Sketch, source: Source, shown: _Branches, k: int) -> None:
    """Draw the branches of a line with its special points and measurements, in a panel
    under its name unless all are together.
    """
    line = shown.lines[k]
    axes = sketch.panels[0 if shown.together else k]
    if line.label and not shown.together:
        letter = f"({'abcdefghi'[k]}) " if shown.count > 1 else ""
        title = letter + shorten(line.label, 60 // min(shown.count, 3))
        set_title(axes, title, fontsize=9, pad=6, loc="left")

    _draw_runs(axes, shown.drawn[k], shown.inks[k], shown.along)
    for rows in shown.drawn[k]:
        computed = rows[~rows["border"].astype(bool)] if "border" in rows else rows
        sketch.pieces.append(computed.drop(columns="border", errors="ignore"))

    _mark_gaits(sketch, axes, source, line)
    measured.draw(sketch, axes, source, "stance_angle", line.at)
    _draw_special(sketch, axes, source, line, shown.special[k])


def _mark_gaits(sketch: Sketch, axes: Axes, source: Source, line: Line) -> None:
    """Mark gaits of a line's branches, which tell their values and command."""
    rows = thin(line.rows.dropna(subset=["stance_angle"]), 300)
    if "stable" in rows:
        rows = rows.assign(stable=yes_or_no(rows["stable"]))
    sketch.mark(
        axes,
        rows,
        line.label or "branch",
        command=line.command,
        tips=_tips(source)
        | TIPS
        | {"period": source.period_title(line.at), "stable": "stable"},
        x=source.along,
        along=source.along,
    )


def _tips(source: Source) -> dict[str, str]:
    """What gaits are followed along under the pointer, where it is not the slope."""
    unit = source.units(source.along)
    title = with_unit(symbol(source.along), unit)
    return {} if source.along == "slope" else {source.along: title}


def _legend(sketch: Sketch, shown: _Branches) -> None:
    """Add gaits, walkers and kinds of special points to the legend."""
    sketch.gait_keys()
    if shown.together:
        sketch.line_keys([line.label for line in shown.lines], shown.inks)
    kinds = dict.fromkeys(
        str(kind)
        for points in shown.special
        if "kind" in points
        for kind in points["kind"]
    )
    for kind in kinds:
        sketch.dot_key(spaced(kind), **_mark(kind))


def _enlarge(sketch: Sketch, source: Source, shown: _Branches, k: int) -> Axes | None:
    """Draw the corner at the origin of a panel once more, enlarged, where special
    points crowd there and no curve is in the way.
    """
    axes, members = sketch.panels[k], [k]
    if shown.together:
        members = list(range(len(shown.lines)))
    corner = _ALONE if shown.count == 1 else _AMONG
    along, low = shown.along, corner.share * float(axes.get_xlim()[1])
    near = [_below(shown.special[i], low, along) for i in members]
    runs = list(itertools.chain.from_iterable(shown.drawn[i] for i in members))
    if sum(map(len, near)) < _CROWD or _is_in_the_way(axes, runs, corner.box, along):
        return None

    inset = _inset(axes, corner, pd.concat(near), along)
    for i, points in zip(members, near, strict=True):
        _draw_runs(inset, shown.drawn[i], shown.inks[i], along)
        _draw_special(sketch, inset, source, shown.lines[i], points)

    _frame_inset(axes, inset)
    return inset


def _inset(axes: Axes, corner: _Corner, crowd: pd.DataFrame, along: str) -> Axes:
    """An empty panel in a panel that holds some special points."""
    inset = axes.inset_axes(corner.box)
    inset.set(xlim=(0, corner.margin * crowd[along].max()))
    inset.set(ylim=(0, 1.2 * crowd["stance_angle"].max()))
    return inset


def _draw_runs(axes: Axes, runs: Sequence[pd.DataFrame], ink: str, along: str) -> None:
    """Draw the branches of a line, each gait in its dashes."""
    for rows in runs:
        for gait in rows["gait"].unique():
            draw_gait(axes, rows, gait, ink, x=along)


def _frame_inset(axes: Axes, inset: Axes) -> None:
    """Frame an enlarged part, with a tick along each side, and its place in the panel."""
    ends = float(inset.get_xlim()[1]), float(inset.get_ylim()[1])
    for which, end in zip("xy", ends, strict=True):
        tick = _round_below(end)
        getattr(inset, f"set_{which}ticks")([tick], [plain(tick, 2)])

    inset.tick_params(labelsize=7, length=2, pad=1.5)
    inset.tick_params(axis="x", pad=3)  # below marks on the frame
    inset.grid(False)
    for spine in inset.spines.values():
        spine.set(visible=True, color=MUTED, linewidth=0.6)
    edge = [0, ends[0], ends[0]], [ends[1], ends[1], 0]
    axes.plot(*edge, color=MUTED, lw=0.6, zorder=4)


def _below(points: pd.DataFrame, value: float, along: str) -> pd.DataFrame:
    """Special points at smaller slopes than one, or values of what else drives."""
    is_known = {along, "stance_angle"} <= set(points.columns)
    return points[points[along] < value] if is_known else points.iloc[:0]


def _round_below(value: float) -> float:
    """The largest of 1, 2 and 5 times a power of ten below a number."""
    ten = 10.0 ** np.floor(np.log10(value))
    return max(float(n * ten) for n in (1, 2, 5) if n * ten <= value)


def _is_in_the_way(
    axes: Axes,
    runs: Sequence[pd.DataFrame],
    box: tuple[float, float, float, float],
    along: str,
) -> bool:
    """Whether a curve passes a box of a panel, or the words at its left."""
    left, low, width, height = box
    (_, right), (_, top) = axes.get_xlim(), axes.get_ylim()
    for rows in runs:
        x, y = rows[along] / right, rows["stance_angle"] / top
        if (x.between(left - 0.1, left + width) & y.between(0, low + height)).any():
            return True
    return False


def _mark(kind: str) -> dict[str, Any]:
    """Properties of the mark of a kind of special point."""
    fill, size = (INK, 6) if kind.startswith("end_") else (PAPER, 5)
    return {
        "marker": WORDS["special_points"].get(kind, "*"),
        "color": INK,
        "mfc": fill,
        "ms": size,
    }


def _draw_special(
    sketch: Sketch, axes: Axes, source: Source, line: Line, points: pd.DataFrame
) -> None:
    along = source.along
    if not {"kind", along, "stance_angle"} <= set(points.columns) or points.empty:
        return

    for kind, rows in points.groupby(points["kind"].astype(str), sort=False):
        axes.plot(
            rows[along],
            rows["stance_angle"],
            ls="",
            zorder=5,
            clip_on=False,
            **_mark(str(kind)),
        )

    tolerances.draw_bars(axes, points)
    # At the slope where steps vanish there is none, however small the last one
    # followed.
    gaits = points.assign(
        told=_told(points),
        angle=points["stance_angle"],
        stance_angle=points["stance_angle"].where(
            points["kind"] != "end_zero_step", 0.0
        ),
    )
    tips = {"told": "kind", **_tips(source), "slope": "γ (rad)", "angle": "θ* (rad)"}
    sketch.mark(
        axes,
        gaits,
        "special point",
        command=line.command,
        tips=tips,
        x=along,
        along=along,
        y="angle",
        above=True,
    )


def _told(points: pd.DataFrame) -> pd.Series:
    """Kinds of special points in words, of flips and pairs whether they are super- or
    subcritical.
    """
    kinds = points["kind"].map(spaced)
    if "criticality" not in points:
        return kinds
    criticality = points["criticality"].astype(str)
    return kinds.where(criticality == "", kinds + ", " + criticality)


def _draw_points(axes: Axes, inset: Axes | None, numbered: pd.DataFrame) -> None:
    """Number the points as the paper does, beside thin lines to them, with the interval
    that rounding allows; those of the enlarged part there.
    """
    is_near = np.zeros(len(numbered), bool)
    if inset is not None:
        is_near = (numbered["slope"] < inset.get_xlim()[1]).to_numpy()
        _draw_numbers(inset, numbered[is_near], _NUMBERS_NEAR)
    _draw_numbers(axes, numbered[~is_near], _NUMBERS)


def _draw_numbers(
    axes: Axes, numbered: pd.DataFrame, places: Sequence[tuple[float, float, str]]
) -> None:
    """Number points of one frame, at the first of some places that is clear."""
    words = []
    for row in numbered.itertuples():
        if np.isfinite(row.slope_low):
            interval = [row.slope_low, row.slope_high]
            axes.plot(interval, [row.stance_angle] * 2, color=MUTED, lw=0.8, zorder=4)
        words.append((str(row.point), (row.slope, row.stance_angle)))

    arrow = {"arrowstyle": "-", "color": MUTED, "lw": 0.6, "shrinkA": 1, "shrinkB": 4}
    write_clear(
        axes,
        words,
        places,
        fontsize=10,
        fontweight="bold",
        annotation_clip=False,
        arrowprops=arrow,
    )
