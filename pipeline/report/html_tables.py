"""The tables of a report: plain cells, each number with the exact value it stands for."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd

from pipeline.report.entry import Entry
from pipeline.report.figures.style import plain
from pipeline.report.source import ANSWERS, Source

#: Rows of failed points on the page; the file beside it has all.
MAX_ROWS = 60

#: Longest table of results that is open from the start.
_OPEN_ROWS = 20

#: Families of claims by the letter of their id.
FAMILIES = {
    "D": "Simplest walker",
    "E": "Point feet with mass",
    "P": "Physical walker",
    "T": "Tuning",
    "Z": "Zero-slope walkers",
    "M": "Energy",
    "K": "Kneed chaos",
    "W": "Wheels",
    "G": "General",
    "A": "Appendix A",
}

_HEADS = {
    "exponent_low": "low",
    "exponent_high": "high",
    "slope_from": "from γ",
    "slope_to": "to γ",
    "from": "from",
    "n": "points",
    "foot_mass_ratio": "ρ",
    "slope": "γ",
    "stance_angle": "θ*",
    "period": "T",
    "slope_transition": "γ transition",
    "spectral_radius": "max |λ|",
    "stance_rate": "θ̇*",
    **{key: key for key in ("l_t", "w_t", "m_t", "r_t", "c_t", "l_s", "w_s", "m_s", "r_s", "c_s", "m_h", "eps_T")},
}

#: Laws that are fitted.
_LAWS = {"stance_angle": "θ* of γ", "speed": "v of γ", "power_speed": "P of v"}


@dataclass(frozen=True)
class WorkerProcess:
    """What is shown, and the number it was rounded from (None for words)."""

    text: str
    value: float | None = None
    counted: bool = False

    @property
    def long(self) -> bool:
        return self.value is None and len(self.text) > 24

    @property
    def exact(self) -> str:
        return "" if self.value is None else repr(self.value)


@dataclass(frozen=True)
class Table:
    """A caption, column heads and rows of cells."""

    caption: str
    heads: list[str]
    rows: list[list[WorkerProcess]]
    note: str = ""
    meanings: list[str] = field(default_factory=list)

    @property
    def folded(self) -> bool:
        """Whether a page shows the caption first and the rows when asked."""
        return len(self.rows) > _OPEN_ROWS


@dataclass(frozen=True)
class StepCheck:
    """One claim of the ledger and where it is shown."""

    id: str
    printed: WorkerProcess
    source: str
    computed: WorkerProcess
    interval: list[WorkerProcess]
    verdict: str
    sign: str
    figure: str
    href: str
    command: str


@dataclass(frozen=True)
class Family:
    """Claims on one subject."""

    title: str
    verdicts: list[StepCheck] = field(default_factory=list)


def cell(value: Any, counted: bool = False, digits: int = 6) -> WorkerProcess:
    """A cell of a value: numbers are rounded for the eye and kept exactly."""
    if isinstance(value, (bool, np.bool_)):
        return WorkerProcess("yes" if value else "no")
    if isinstance(value, (int, np.integer)):
        return WorkerProcess(str(int(value)).replace("-", "−"), int(value), counted)
    if isinstance(value, (float, np.floating)):
        return (
            WorkerProcess("–") if np.isnan(value) else WorkerProcess(plain(float(value), digits), float(value), counted)
        )
    return WorkerProcess(str(value))


def head(column: str) -> str:
    return _HEADS.get(column, column.replace("_", " "))


def from_frame(caption: str, frame: pd.DataFrame, note: str = "") -> Table:
    """A table of every column that varies or is worth repeating; slopes with the digits their error leaves."""
    counts = frame.columns[[kind.kind in "iu" for kind in frame.dtypes]]
    digits = _digits(frame)
    return Table(
        caption,
        [
            _with_unit(
                "strides" if c == "period" and c in counts else head(str(c)), frame.attrs.get("units", {}).get(c, "")
            )
            for c in frame.columns
        ],
        [
            [cell(v, digits=n if c in _LOCATED else 6) for c, v in zip(frame.columns, row, strict=True)]
            for n, row in zip(digits, frame.itertuples(index=False, name=None), strict=True)
        ],
        note,
        [frame.attrs.get("meanings", {}).get(c, "") for c in frame.columns],
    )


#: Columns of a located point whose error a table knows.
_LOCATED = ("slope", "value", "low", "high")


def _digits(frame: pd.DataFrame) -> list[int]:
    """Digits worth showing of each row's located numbers: as many as its error bound or its interval leaves."""
    if "error_bound" in frame:
        error = frame["error_bound"].to_numpy(float)
    elif {"low", "high", "slope"} <= set(frame.columns):
        error = 0.01 * ((frame["high"] - frame["low"]) / frame["slope"]).to_numpy(float)  # both ends tell apart
    else:
        return [6] * len(frame)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.clip(np.nan_to_num(-np.log10(error), nan=6.0), 6, 15).astype(int).tolist()


def _with_unit(name: str, unit: str) -> str:
    return name if unit in ("", "1") else f"{name} ({unit})"


def fits(source: Source) -> list[Table]:
    """One table for each fit in the archive."""
    found = []
    for name, table in source.tables.items():
        if name.startswith("fits/") and not table.empty:
            found_some = table[table["n"] > 0] if "n" in table else table
            shown = found_some.head(2 * MAX_ROWS)
            if "quantity" in shown:
                shown = shown.assign(quantity=[_LAWS.get(q, q) for q in shown["quantity"]]).rename(
                    columns={"quantity": "law"}
                )
            note = f"{len(table) - len(shown)} more rows are in the archive." if len(shown) < len(found_some) else ""
            if len(found_some) < len(table) and not note:
                note = (
                    f"{len(table) - len(found_some)} {'more ' if len(found_some) else ''}fits found no range"
                    " where a power law holds."
                )
            found.append(from_frame(f"Fit: {name.removeprefix('fits/').replace('_', ' ')}", shown, note))
    return found


def special_points(source: Source) -> Table | None:
    """Folds, flips and ends, with their coordinates."""
    table = source.tables.get("special_points")
    if table is None or table.empty:
        return None
    shown = table.head(2 * MAX_ROWS)
    if "kind" in shown:
        shown = shown.assign(kind=[str(k).replace("_", " ") for k in shown["kind"]])
    note = f"{len(table) - len(shown)} more are in the archive." if len(shown) < len(table) else ""
    return from_frame("Special points", shown, note)


def points(source: Source) -> pd.DataFrame:
    """Every grid point that did not converge: coordinates, gait, status and the sentence why."""
    grid = source.fates
    if "status" not in grid:
        return pd.DataFrame()
    status = grid["status"] if grid["status"].ndim else grid["status"].expand_dims("study")
    at = np.nonzero(status.values)
    sentences, names = source.reasons, source.statuses
    frame = pd.DataFrame(
        {str(d): _named(i, grid[d].values) for d, i in zip(status.dims, at, strict=True) if d in grid.coords}
    )
    values, codes = np.unique(status.values[at], return_inverse=True)
    frame["status"] = _named(codes, [names.get(int(s), str(s)) for s in values])
    index = np.atleast_1d(grid["reason"].values)[at] if "reason" in grid else np.full(len(at[0]), -1)
    values, codes = np.unique(index, return_inverse=True)
    frame["reason"] = _named(codes, [sentences[i] if 0 <= i < len(sentences) else "" for i in values])
    return frame


def _named(codes: np.ndarray, values: Sequence[Any] | np.ndarray) -> Any:
    """Values by their places: words once, however many rows have them."""
    if getattr(values, "dtype", None) is not None and values.dtype.kind not in "OU":  # type: ignore[union-attr]
        return np.asarray(values)[codes]
    words = list(dict.fromkeys(map(str, values)))
    return pd.Categorical.from_codes(np.array([words.index(str(v)) for v in values], np.int16)[codes], words)


def statuses(source: Source) -> list[tuple[str, int, float]]:
    """Count and share of every status that occurs, in the order of the flags."""
    if "status" not in source.fates:
        return []
    values, counts = np.unique(source.fates["status"].values, return_counts=True)
    total = counts.sum()
    return [
        (source.statuses.get(int(v), str(v)), int(c), float(c / total)) for v, c in zip(values, counts, strict=True)
    ]


def outcomes(source: Source, absent: pd.DataFrame) -> Table | None:
    """What became of every point, by status and reason, and where."""
    found = statuses(source)
    if not found:
        return None
    slopes = source.grid["slope"].values if "slope" in source.grid.coords else np.array([])
    rows = [
        [WorkerProcess("converged"), WorkerProcess(""), cell(count, True), *_range(slopes)]
        for name, count, _ in found
        if name == "converged"
    ]
    for (status, reason), group in absent.groupby(["status", "reason"], sort=False, observed=True):
        rows.append(
            [
                WorkerProcess(status.replace("_", " ")),
                WorkerProcess(reason),
                cell(len(group), True),
                *_range(group["slope"].to_numpy() if "slope" in group else np.array([])),
            ]
        )
    what = "point and gait" if source.whole == "point" else "line"
    return Table(f"What became of every {what}", ["status", "reason", "count", "from γ", "to γ"], rows)


def _range(slopes: np.ndarray) -> list[WorkerProcess]:
    return [cell(slopes.min()), cell(slopes.max())] if len(slopes) else [WorkerProcess("–"), WorkerProcess("–")]


def failures(absent: pd.DataFrame) -> Table | None:
    """Points that failed (not those whose answer is that there is no gait)."""
    failed = absent[~absent["status"].isin(ANSWERS)] if len(absent) else absent
    if failed.empty:
        return None
    shown = failed.head(MAX_ROWS)
    note = f"{len(failed) - len(shown)} more are in the file beside this page." if len(shown) < len(failed) else ""
    shown = shown.assign(status=[s.replace("_", " ") for s in shown["status"]])
    return from_frame("Points that failed", shown, note)


def failed_tasks(source: Source) -> Table | None:
    """Work on whole lines or studies that failed."""
    table = source.tables.get("failed_tasks")
    return None if table is None or table.empty else from_frame("Tasks that failed", table.head(MAX_ROWS))


def walkers(source: Source) -> Table | None:
    """Parameters of the study's walkers, a column each; of a key that the study varies the values it is given."""
    found = source.walkers
    if not found:
        return None
    given = {axis: _given(source.grid[axis].values) for axis in source.varied.values() if axis in source.grid.coords}
    moved = {
        key: given.get(axis, WorkerProcess("varied")) if axis == key else WorkerProcess(f"by {axis}")
        for key, axis in source.varied.items()
    }
    keys = list(dict.fromkeys(key for table in found.values() for key in table))
    rows = [
        [WorkerProcess(key), *(moved.get(key) or cell(table.get(key, "–")) for table in found.values())] for key in keys
    ]
    rows += [[WorkerProcess(axis), *[values] * len(found)] for axis, values in given.items() if axis not in keys]
    return Table("Parameters", ["key", *found], rows)


def _given(values: np.ndarray) -> WorkerProcess:
    """The values of an axis, in one cell."""
    if len(values) == 1:
        return cell(float(values[0]))
    shown = [plain(float(v), 6) for v in values]
    return WorkerProcess(", ".join(shown) if len(shown) < 5 else f"{shown[0]} … {shown[-1]} ({len(shown)} values)")


def pairs(record: dict[str, Any]) -> list[tuple[str, WorkerProcess]]:
    """Plain entries of a record, for a list of names and values; nested ones are named by their path."""
    found: list[tuple[str, WorkerProcess]] = []
    for key, value in record.items():
        if isinstance(value, dict):
            found += [(f"{key} {inner}", shown) for inner, shown in pairs(value)]
        elif isinstance(value, list):
            found.append((str(key), WorkerProcess(", ".join(str(v) for v in value))))
        elif value is not None:
            found.append((str(key).replace("_", " "), cell(value)))
    return found


def claims(source: Source) -> list[dict[str, Any]]:
    """Rows of the ledger that an archive holds, as plain data."""
    table = source.tables.get("claims")
    rows = table.to_dict("records") if table is not None and "id" in table else []
    return [{str(k): v.item() if isinstance(v, np.generic) else v for k, v in row.items()} for row in rows]


def ledger(entries: Iterable[Entry]) -> list[Family]:
    """Every claim of some pages by family, each with a link to the picture of it."""
    entries = list(entries)
    pages = {one.slug: f"{one.slug}.html" for one in entries}
    pages |= {f"{one.study}/{figure}": f"{one.slug}.html#{figure}" for one in entries for figure in one.figures}
    families: dict[str, Family] = {}
    for one in entries:
        for row in one.claims:
            letter = str(row["id"])[:1].upper()
            title = FAMILIES.get(letter, "Others")
            families.setdefault(title, Family(title)).verdicts.append(_verdict(row, one, pages))
    order = [*FAMILIES.values(), "Others"]
    for family in families.values():
        family.verdicts.sort(key=lambda v: (v.id[:1], len(v.id), v.id))
    return sorted(families.values(), key=lambda f: order.index(f.title))


def _verdict(row: dict[str, Any], entry: Entry, pages: dict[str, str]) -> StepCheck:
    words = str(row.get("verdict", ""))
    figure = str(row.get("figure", ""))
    href = pages.get(figure) or pages.get(f"{entry.study}/{figure}") or pages.get(entry.slug, "")
    interval = [cell(row[k]) for k in ("interval_low", "interval_high") if k in row]
    if any(c.value is None for c in interval):
        interval = []
    return StepCheck(
        str(row["id"]),
        cell(row.get("printed", "")),
        str(row.get("source", "")),
        cell(row.get("computed", "")),
        interval,
        words.replace("_", " "),
        sign(words),
        figure or entry.name,
        href,
        str(row.get("command", "")),
    )


def sign(verdict: str) -> str:
    """yes, no or open: what a verdict says, in one word."""
    plainly = verdict.replace("_", " ").strip().lower()
    if plainly in ("reproduced", "proved"):
        return "yes"
    return "no" if plainly.startswith("not ") else "open"
