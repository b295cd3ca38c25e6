"""The page of two archives compared: how far every variable differs, and where most."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from gaitsweep.pipeline.archive.diff import Numbers
from gaitsweep.pipeline.report import html_tables
from gaitsweep.pipeline.report.figures.sketch import Sketch
from gaitsweep.pipeline.report.figures.style import (
    LINE,
    MUTED,
    set_heading,
    set_log,
    style,
)
from gaitsweep.pipeline.report.figures.svg import Drawing, render
from gaitsweep.pipeline.report.pages import render_template
from gaitsweep.pipeline.report.words import axis_values, spaced
from gaitsweep.pipeline.terminal import counted

#: Panels of the figure, and points of each of their curves.
_PANELS, _POINTS = 9, 400


def page(
    archives: tuple[Path, Path],
    summary: str,
    differences: Sequence[str],
    compared: Sequence[Numbers],
) -> str:
    """Return the page of two archives.

    Parameters
    ----------
    archives : pair of Path
    summary : str
        How many differences there are, in a sentence.
    differences : sequence of str
        Sentences on what differs, as `gaitsweep diff` prints them.
    compared : sequence of Numbers
        The numbers that both have.
    """
    first, second = (path.name for path in archives)
    ordered = sorted(compared, key=_how_far, reverse=True)
    differing = [numbers for numbers in ordered if _how_far(numbers) > (0, 0.0)]
    drawn = [numbers for numbers in differing if _has_curve(numbers)][:_PANELS]

    drawing: Drawing | None = None
    if drawn:
        with style():
            drawing = render(_sketch(drawn), "diff", "diff", small=False)

    table = None
    if differing:
        equal = len(ordered) - len(differing)
        note = (
            f"{counted(equal, 'other variable')} have equal numbers." if equal else ""
        )
        rows = pd.DataFrame([_row(numbers) for numbers in differing])
        table = html_tables.named(
            "diff/variables", rows, is_open=True, where="answer", note=note
        )

    return render_template(
        "diff.html",
        title=f"Differences of {first} and {second}",
        summary=summary,
        differences=differences,
        drawing=drawing,
        table=table,
    )


def _how_far(numbers: Numbers) -> tuple[int, float]:
    """How many numbers of a variable one archive lacks, and their largest difference."""
    return _absent(numbers), _largest(numbers)


def _absent(numbers: Numbers) -> int:
    """How many numbers of a variable only one archive has."""
    first, second = numbers.first.values, numbers.second.values
    return int(np.count_nonzero(np.isnan(first) != np.isnan(second)))


def _largest(numbers: Numbers) -> float:
    """Largest difference of a variable; 0 where none has both values."""
    return float(np.nanmax(numbers.difference.values, initial=0.0))


def _has_curve(numbers: Numbers) -> bool:
    """Whether the differences of a variable can be drawn: an infinite one has no place
    on an axis.
    """
    return 0 < _largest(numbers) < np.inf


def _sketch(compared: Sequence[Numbers]) -> Sketch:
    """Largest and median differences of variables along an axis, a panel each."""
    columns = min(3, len(compared))
    rows = -(-len(compared) // columns)
    sketch = Sketch("diff", 40 + 150 * rows, rows, columns)
    for axes, numbers in zip(sketch.panels, compared, strict=False):
        along = _along(numbers)
        frame = _along_axis(numbers, along)
        _draw(axes, frame)
        if along and _is_logarithmic(frame["value"].to_numpy()):
            set_log(axes, "x")
        axes.set_xlabel(spaced(along))
        set_heading(axes, spaced(numbers.name))
        sketch.pieces.append(frame.assign(variable=numbers.name, axis=along))

    for axes in sketch.panels[len(compared) :]:
        axes.set_visible(False)

    sketch.key("largest", LINE, lw=1.4)
    sketch.key("median", MUTED, lw=1.0)
    sketch.draw_legend(set())
    return sketch.finish(sketch.data, abscissa="value", variables=len(compared))


def _draw(axes: Axes, frame: pd.DataFrame) -> None:
    """Draw the largest and the median differences of a variable."""
    drawn = frame[["largest", "median"]]
    # A difference of 0 has no place on a logarithmic axis.
    drawn = drawn.clip(0.1 * drawn[drawn > 0].min(axis=None))
    axes.plot(frame["value"], drawn["median"], color=MUTED, lw=1.0)
    axes.plot(frame["value"], drawn["largest"], color=LINE, lw=1.4)
    set_log(axes, "y")
    _show_a_decade(axes)


def _show_a_decade(axes: Axes) -> None:
    """Widen a logarithmic axis to a decade at least."""
    low, high = axes.get_ylim()
    room = max(1.0, (10 / (high / low)) ** 0.5)
    axes.set_ylim(low / room, high * room)


def _along(numbers: Numbers) -> str:
    """The axis of numbers that has the most values."""
    shape = {
        str(dim): size
        for dim, size in numbers.difference.sizes.items()
        if numbers.first[dim].dtype.kind in "fiu"
    }
    return max(shape, key=lambda dim: shape[dim], default="")


def _along_axis(numbers: Numbers, along: str) -> pd.DataFrame:
    """Largest and median differences at each value of an axis, of many values at groups
    of neighbours; at one place where numbers have no axis.
    """
    over = numbers.difference
    values = np.array([0.0])
    flat = over.values.reshape(1, -1)
    if along:
        values = np.asarray(over[along].values, float)
        flat = over.transpose(along, ...).values.reshape(len(values), -1)

    rows = []
    for some in np.array_split(np.arange(len(values)), min(_POINTS, len(values))):
        known = flat[some][~np.isnan(flat[some])]
        if len(known):
            at = float(values[some[len(some) // 2]])
            rows.append((at, float(known.max()), float(np.median(known))))

    return pd.DataFrame(rows, columns=["value", "largest", "median"])


def _is_logarithmic(values: np.ndarray) -> bool:
    """Whether values of an axis are above 0 and span a decade in equal ratios."""
    if len(values) < 3 or values.min() <= 0 or values.max() < 10 * values.min():
        return False
    steps = np.diff(np.log(values))
    return bool(np.ptp(steps) < 0.5 * np.abs(steps).max())


def _row(numbers: Numbers) -> dict[str, object]:
    """What the table says of a variable: where it differs most, and by how much."""
    over = numbers.difference.values
    row: dict[str, object] = {
        "variable": numbers.name,
        "absent in one": _absent(numbers),
        "compared": int(np.count_nonzero(~np.isnan(over))),
        "differ": int((over > 0).sum()),
        "largest": _largest(numbers),
        "where": "",
        "first": np.nan,
        "second": np.nan,
    }
    if row["differ"]:
        place = np.unravel_index(int(np.nanargmax(over)), over.shape)
        row["first"] = float(numbers.first.values[place])
        row["second"] = float(numbers.second.values[place])
        row["where"] = axis_values(_at(numbers, place))

    return row


def _at(numbers: Numbers, place: tuple[np.intp, ...]) -> dict[str, object]:
    """Coordinates of a place."""
    dims = numbers.first.dims
    return {
        str(dim): numbers.first.indexes[dim][i]
        for dim, i in zip(dims, place, strict=True)
    }
