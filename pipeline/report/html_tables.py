"""The tables of a report: cells of text, each number with the exact value that it
rounds.
"""

import itertools
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pandas as pd

from gaitsweep.pipeline.outcomes import ANSWERS, FOLLOWED, count, count_rows
from gaitsweep.pipeline.report.cells import Cell, cell, column_cells
from gaitsweep.pipeline.report.figures import landmarks as places
from gaitsweep.pipeline.report.figures import measured, tolerances
from gaitsweep.pipeline.report.figures.starts import addresses
from gaitsweep.pipeline.report.figures.style import spread_evenly
from gaitsweep.pipeline.report.source import Source
from gaitsweep.pipeline.report.words import (
    WORDS,
    grouped,
    plain,
    print_units,
    spaced,
    with_unit,
)
from gaitsweep.pipeline.terminal import counted

#: Failed points listed on the page, and points without a gait in the CSV file; the
#: archive has all of them.
MAX_ROWS, MAX_LISTED = 60, 20_000

#: Reasons in the table of outcomes; each point of a large study may have its own.
_MAX_REASONS = 200

#: Rows of the longest table that a page shows unfolded, those shown of one that is
#: longer than `MAX_ROWS`, and columns shown before all are asked for.
_OPEN_ROWS, _EXCERPT, MAX_COLUMNS = 20, 12, 6

#: Columns that stand last.
_LAST, _KEPT = WORDS["kinds"]["last"], WORDS["kinds"]["kept"]


@dataclass(frozen=True)
class Table:
    """A caption, column headings and rows of cells; `meanings` are the long names of
    the columns.

    `frame` holds all rows, for the CSV file that is called after `name`; `gaits` are
    the addresses of the rows' gaits. One that is `turned` has a column for each walker.
    """

    caption: str
    heads: list[str]
    rows: list[list[Cell]]
    note: str = ""
    meanings: list[str] = field(default_factory=list)
    name: str = ""
    frame: pd.DataFrame | None = None
    gaits: list[str] = field(default_factory=list)
    most: int = MAX_COLUMNS
    is_open: bool = False
    turned: bool = False

    @property
    def numeric(self) -> list[bool]:
        """Whether each column holds numbers, beside which a dash stands for an absent
        one.
        """
        return [
            any(c.value is not None for c in column)
            for column in zip(*self.rows, strict=True)
        ]

    @property
    def folded(self) -> bool:
        """Whether the rows are folded under the caption."""
        return len(self.rows) > _OPEN_ROWS and not self.is_open


def _head(column: str) -> str:
    """Heading of a column: the paper's symbol where there is one, else the name in
    words.
    """
    return str(WORDS["columns"].get(column, spaced(column)))


def named(
    name: str, frame: pd.DataFrame, is_open: bool = False, where: str = "archive", note: str = "",
    whole: pd.DataFrame | None = None,
) -> Table:  # fmt: skip
    """Make a table of the first rows of a frame, with the words of its name and the
    number of rows left out.

    Errors and bounds have two digits, comparable numbers of a column the same number of
    decimals. Columns that tell little stand last. `whole` is the frame with all rows
    and columns, for the CSV file called after `name`. One that `is_open` has up to
    twice as many rows, and they are never folded.
    """
    words = WORDS["tables"].get(name, {})
    caption = words.get("caption", spaced(name).replace("/", ": "))
    whole = frame if whole is None else whole
    file = re.sub(r"[^\w-]+", "-", name, flags=re.ASCII)

    most = MAX_ROWS * (1 + is_open)
    if len(frame) > most:
        most = _EXCERPT
    notes = [words.get("note", ""), note]
    if len(frame) > most:
        notes.append(f"{grouped(len(frame) - most)} more rows are in the {where}.")
    about = " ".join(filter(None, notes))

    shown = _excerpt(name, frame, whole, most)
    heads = [_head_with_unit(str(column), shown) for column in shown]
    cells = [column_cells(str(column), shown) for column in shown]
    rows = [list(row) for row in zip(*cells, strict=True)]
    meanings = shown.attrs.get("meanings", {})
    means = [meanings.get(column, "") for column in shown]
    return Table(caption, heads, rows, about, means, file, whole, is_open=is_open)


def _head_with_unit(column: str, frame: pd.DataFrame) -> str:
    """Heading of a column of a frame, with its unit; a period in whole numbers counts
    steps.
    """
    head = _head(column)
    if column == "period" and frame[column].dtype.kind in "iu":
        head = "steps"
    unit = frame.attrs.get("units", {}).get(column, "")
    return with_unit(head, print_units(unit))


def _excerpt(
    name: str, frame: pd.DataFrame, whole: pd.DataFrame, most: int
) -> pd.DataFrame:
    """Rows of a frame that a page shows, the columns that tell little last."""
    shown = frame.head(most)
    # Of a map of designs the first rows are all on one edge.
    if name == "design" and len(frame) > most:
        shown = frame.iloc[spread_evenly(len(frame), most)]

    telling = _telling(shown)

    def rank(column: Any) -> tuple[bool, bool]:
        is_constant = whole.get(column, frame[column]).nunique() == 1
        tells_little = len(shown) > 1 and is_constant and column not in _KEPT
        return column in _LAST and column not in telling, tells_little

    return shown[sorted(frame.columns, key=rank)]


def _telling(frame: pd.DataFrame) -> set[str]:
    """Columns of words, of those that would stand last, that tell apart rows which all
    others call the same.
    """
    words = {str(c) for c in frame if not pd.api.types.is_numeric_dtype(frame[c])}
    last = words & set(_LAST)
    called = sorted(words - last)
    if not called:
        return set()
    twofold = frame.duplicated(called).sum()
    return {c for c in last if frame.duplicated([*called, c]).sum() < twofold}


def sections(source: Source) -> dict[str, tuple[str, list[Table]]]:
    """Tables of results on a page, by the section in which they stand: its heading, and
    they.
    """
    parts = {
        "landmarks": ("Paper and computation", landmarks(source)),
        "residuals": ("Measurements", residuals(source)),
        "fits": ("Tables", results(source)),
    }
    return {
        name: (heading, tables) for name, (heading, tables) in parts.items() if tables
    }


def _fit(name: str, frame: pd.DataFrame) -> Table:
    fitted = frame[frame["n"] > 0] if "n" in frame else frame
    missing, more = len(frame) - len(fitted), "further " if len(fitted) else ""
    note = (
        f"For {counted(missing, f'{more}case')} no power law fits." if missing else ""
    )
    if "quantity" in fitted:
        fitted = fitted.replace({"quantity": WORDS["laws"]}).rename(
            columns={"quantity": "law"}
        )

    return named(name, fitted, True, note=note, whole=frame)


def landmarks(source: Source) -> list[Table]:
    """Landmarks that the paper prints or numbers at slopes of the study, beside those
    computed and what rounding allows.
    """
    heads = WORDS["landmarks"]
    frame = places.within(source, places.every(source, *heads))
    rows = [[cell(v) for v in row] for row in frame.itertuples(index=False, name=None)]
    words, gaits = places.note(frame), addresses(source, frame)

    return (
        [Table("Paper and computation", list(heads.values()), rows, words, gaits=gaits)]
        if rows
        else []
    )


def residuals(source: Source) -> list[Table]:
    """The study's own measurements beside the computed values."""
    frame = measured.residuals(source)
    return [] if frame.empty else [named("residuals", frame, True, "CSV file")]


def results(source: Source) -> list[Table]:
    """Make every table of results in the archive that is not shown elsewhere on its
    page.
    """
    order = [*WORDS["tables"], *sorted(source.tables.keys() - WORDS["tables"].keys())]
    frames = {
        name: source.table(name)
        for name in order
        if name not in WORDS["elsewhere"]["tables"]
    }
    return [
        _result(source, name, frame)
        for name, frame in frames.items()
        if frame is not None
    ]


def _result(source: Source, name: str, frame: pd.DataFrame) -> Table:
    if name.startswith("fits/"):
        return _fit(name, frame)
    if name == "special_points":
        frame = tolerances.special_points(source)
        table = named(name, frame, True)
        return replace(table, gaits=addresses(source, frame.head(len(table.rows))))

    if name in ("figure9", "figure10") and "walker" in frame:
        return _transposed(name, frame)
    if name == "figure10_cells":
        return _printed_cells(name, frame)

    frame = _of_key(frame)
    # States and bounds of a design's gaits are in the archive and the CSV file.
    begins, ends = ("stance_", "thigh_rate", "shank_rate", "surveyed"), "_error"
    aside = [
        c
        for c in frame
        if name == "design" and (str(c).startswith(begins) or str(c).endswith(ends))
    ]
    return named(name, frame.drop(columns=aside), whole=frame)


def _of_key(frame: pd.DataFrame) -> pd.DataFrame:
    """A table of points over one key, whose values stand under its name, not beside the
    value that the axis of that name has.
    """
    keys = set(frame["key"]) if {"key", "value"} <= set(frame.columns) else set()
    if len(keys) != 1:
        return frame

    (key,) = keys
    rest = frame.drop(columns=["key", str(key)], errors="ignore")
    renamed = rest.rename(columns={"value": str(key)})
    if "turn" in renamed:
        renamed["turn"] = renamed["turn"].replace({"key": str(key)})
    renamed.attrs = frame.attrs
    return renamed


def _transposed(name: str, frame: pd.DataFrame) -> Table:
    """A table with one column per walker and one row per quantity, as the paper prints
    it.
    """
    rows = []
    for column in frame.columns.drop(["walker", "description"], errors="ignore"):
        flag = set(frame[column]) <= {0, 1} and frame[column].dtype.kind in "iu"
        # The residual of a condition that is met exactly is rounding.
        met = column.endswith("_offset")
        values = [
            cell(bool(v)) if flag else cell(0.0 if met and abs(v) < 1e-15 else v)
            for v in frame[column]
        ]
        rows.append([cell(_head(column)), *values])

    meanings = ["", *frame.get("description", [""] * len(frame))]
    caption, heads = WORDS["tables"][name]["caption"], ["", *map(str, frame["walker"])]
    return Table(caption, heads, rows, meanings=meanings, most=len(heads), turned=True)


def _printed_cells(name: str, frame: pd.DataFrame) -> Table:
    """The paper's figure 10: a row per walker, in each cell what is printed and
    computed, by range of slopes.
    """
    columns, lines = (
        list(dict.fromkeys(frame["column"])),
        dict[str, dict[str, list[str]]](),
    )
    for entry in frame.itertuples():
        sign = WORDS["verdicts"].get(entry.verdict, {}).get("sign", "–")
        where = f"γ {entry.slopes}: " if entry.slopes else ""
        computed = re.sub(r"\^(\d+\.\d+)", r"ᵖ, p = \1", str(entry.computed))
        own = lines.setdefault(str(entry.walker), {column: [] for column in columns})
        own[entry.column].append(
            f"{sign} {where}{entry.printed}\n    computed {computed}"
        )

    rows = [
        [cell(walker), *(Cell("\n".join(texts)) for texts in own.values())]
        for walker, own in lines.items()
    ]
    words = WORDS["tables"][name]
    return Table(words["caption"], ["walker", *columns], rows, words["note"])


def points(source: Source) -> pd.DataFrame:
    """List every grid point without a converged gait: coordinates, gait, status and the
    sentence that says why.
    """
    grid = source.outcomes
    if "status" not in grid:
        return pd.DataFrame(columns=["status", "reason"])

    status = (
        grid["status"] if grid["status"].ndim else grid["status"].expand_dims("study")
    )
    at = np.nonzero(status.values)
    sentences, names = source.reasons, source.statuses
    columns = {
        str(d): _decode(i, grid[d].values)
        for d, i in zip(status.dims, at, strict=True)
        if d in grid.coords
    }
    values, codes = np.unique(status.values[at], return_inverse=True)
    columns["status"] = _decode(codes, [names.get(int(s), str(s)) for s in values])
    index = (
        np.atleast_1d(grid["reason"].values)[at]
        if "reason" in grid
        else np.full(len(at[0]), -1)
    )
    values, codes = np.unique(index, return_inverse=True)
    columns["reason"] = _decode(
        codes, [sentences[i] if 0 <= i < len(sentences) else "" for i in values]
    )
    return pd.DataFrame(columns)


def _decode(codes: np.ndarray, values: Sequence[Any] | np.ndarray) -> Any:
    """Expand codes to values; words become categories, each stored once."""
    values = np.asarray(values)
    return (
        values[codes]
        if values.dtype.kind not in "OU"
        else pd.Categorical(values.astype(str)).take(codes)
    )


def statuses(source: Source) -> list[tuple[str, int, float]]:
    """Count and share of every status of points or lines that occurs, in the order of
    the flag values.
    """
    if "status" not in source.outcomes:
        return []

    status = source.outcomes["status"]
    by_gait = (
        status.transpose(..., "gait")
        if "gait" in status.dims
        else status.expand_dims("gait", -1)
    )
    counts = count(
        count_rows(by_gait.values.reshape(-1, by_gait.sizes["gait"])), source.statuses
    )
    every = dict.fromkeys([*source.statuses.values(), *counts])

    return [
        (name, counts[name], counts[name] / counts.total())
        for name in every
        if counts[name]
    ]


def outcome_sentence(source: Source) -> str:
    """The outcomes of a study in one sentence."""
    counts = {name: count for name, count, _ in statuses(source)}
    total = sum(counts.values())
    if not total:
        return ""

    whole = "curve" if source.whole == "line" else "point"
    if "design" in source.tables:
        whole = "design"
    s = "" if total == 1 else "s"
    complete = counts.pop("converged", 0)
    parts = (
        [f"{grouped(complete)} of {grouped(total)} {whole}{s} complete"]
        if complete
        else []
    )
    return f"Solver: {', '.join([*parts, *(f'{grouped(count)} {spaced(name)}' for name, count in counts.items())])}"


def _of_converged(source: Source) -> Iterator[tuple[str, int]]:
    """What converged points or lines lack, in a sentence, and how many they are."""
    status = np.atleast_1d(source.outcomes["status"].values)
    solved = status == 0
    if source.whole == "point" or "reason" not in source.outcomes:
        yield "", int(solved.sum())
        return

    reasons = np.atleast_1d(source.outcomes["reason"].values)
    numbers, counts = np.unique(reasons[solved], return_counts=True)
    for number, n in zip(numbers.tolist(), counts.tolist(), strict=True):
        yield source.reasons[number].removeprefix(FOLLOWED).strip(), n


def outcomes(source: Source, absent: pd.DataFrame) -> Table | None:
    """Outcomes by status and reason: how many gaits or lines, and over which slopes."""
    if "status" not in source.outcomes:
        return None

    of_converged = _rows_of_converged(source)
    groups = absent.groupby(["status", "reason"], sort=False, observed=True)
    rows = of_converged[:_MAX_REASONS]
    for (status, reason), group in itertools.islice(groups, _MAX_REASONS):
        over = _range(group["slope"].to_numpy() if "slope" in group else np.array([]))
        rows.append([Cell(spaced(status)), Cell(reason), cell(len(group), True), *over])

    caption, what = (
        ("Outcomes by gait", "gaits")
        if source.whole == "point"
        else ("Outcomes by line", "lines")
    )
    left = len(of_converged) + groups.ngroups - len(rows)
    note = f"{left} more reasons are in the archive." if left else ""

    return Table(
        caption, ["status", "reason", what, "from γ (rad)", "to γ (rad)"], rows, note
    )


def _rows_of_converged(source: Source) -> list[list[Cell]]:
    """Rows of the outcomes for converged gaits or lines, by what they lack."""
    status, slopes = source.outcomes["status"], np.array([])
    if "slope" in status.indexes:
        slopes = status["slope"].values[
            (status == 0).any([d for d in status.dims if d != "slope"]).values
        ]

    return [
        [Cell("converged"), Cell(said), cell(n, True), *_range(slopes)]
        for said, n in _of_converged(source)
        if n
    ]


def _range(slopes: np.ndarray) -> list[Cell]:
    return (
        [cell(slopes.min()), cell(slopes.max())]
        if len(slopes)
        else [Cell("–"), Cell("–")]
    )


def listed(absent: pd.DataFrame) -> pd.DataFrame:
    """Points without a converged gait that the CSV file lists: failures first, which
    answers would push out.
    """
    order = np.argsort(absent["status"].isin(ANSWERS).to_numpy(), kind="stable")
    return absent.iloc[order[:MAX_LISTED]]


def failures(absent: pd.DataFrame) -> Table | None:
    """Points that failed; that there is no gait at a point is an answer, not a failure."""
    failed = absent[~absent["status"].isin(ANSWERS)]
    if failed.empty:
        return None

    shown = failed.head(MAX_ROWS)
    more, beyond = min(len(failed), MAX_LISTED) - len(shown), len(failed) - MAX_LISTED
    note = f"{more} more are in the CSV file." if more else ""
    note += f" {beyond} others are in the archive alone." if beyond > 0 else ""
    return named("failed_points", shown, note=note)


def failed_tasks(source: Source) -> Table | None:
    """Tasks on whole lines or on the study that failed."""
    frame = source.table("failed_tasks")
    return None if frame is None else replace(named("failed_tasks", frame), name="")


def walkers(source: Source) -> Table | None:
    """Parameters of the study's walkers, one column each, with what each key means; a
    key that the study varies shows its values.
    """
    tables = source.walkers
    if not tables:
        return None

    names = dict.fromkeys(axis for axes in source.varied.values() for axis in axes)
    given = {
        axis: _axis_values(source.grid[axis].values)
        for axis in names
        if axis in source.grid.coords
    }
    moved = {
        key: given.get(key, Cell("varied"))
        if key in axes
        else Cell(f"by {', '.join(axes)}")
        for key, axes in source.varied.items()
    }
    keys = list(dict.fromkeys(key for table in tables.values() for key in table))
    rows = [
        [
            Cell(key),
            _meaning(key),
            *(moved.get(key) or cell(table.get(key, "–")) for table in tables.values()),
        ]
        for key in keys
    ]
    rows += [
        [Cell(axis), _meaning(axis), *[values] * len(tables)]
        for axis, values in given.items()
        if axis not in keys
    ]
    heads = ["key", "meaning", *tables]
    return Table("Parameters", heads, rows, most=MAX_COLUMNS + 1)


def _meaning(key: str) -> Cell:
    """What a key of a walker means; empty where its name says it."""
    return Cell(WORDS["parameters"].get(key, ""))


def _axis_values(values: np.ndarray) -> Cell:
    """The values of an axis, in one cell."""
    if len(values) == 1:
        return cell(float(values[0]))

    shown = [plain(float(v), 6) for v in values]
    return Cell(
        ", ".join(shown)
        if len(shown) < 5
        else f"{shown[0]} … {shown[-1]} ({len(shown)} values)"
    )


def pairs(record: dict[str, Any]) -> list[tuple[str, Cell]]:
    """Flatten a record into names and cells; nested entries are named by their path."""
    entries: list[tuple[str, Cell]] = []
    for key, value in record.items():
        if isinstance(value, dict):
            entries += [(f"{key} {inner}", shown) for inner, shown in pairs(value)]
        elif isinstance(value, list):
            words = (
                " ".join(map(str, v)) if isinstance(v, list) else str(v) for v in value
            )
            entries.append((spaced(key), Cell(", ".join(words))))
        elif value is not None:
            entries.append((spaced(key), cell(value)))

    return entries


def claims(source: Source) -> list[dict[str, Any]]:
    """Rows of the ledger in an archive, as plain data."""
    table = source.table("claims", "id")
    return [] if table is None else table.to_dict("records")
