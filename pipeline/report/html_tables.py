"""The tables of a report: cells of text, each number with the exact value that it rounds."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from pipeline.report.cells import Cell, cell, column_cells
from pipeline.report.figures import landmarks as places
from pipeline.report.figures import measured
from pipeline.report.figures.starts import addresses
from pipeline.report.source import ANSWERS, Source
from pipeline.report.words import plain, print_units

#: Failed points listed on the page, and points without a gait in the CSV file; the archive has all of them.
MAX_ROWS, MAX_LISTED = 60, 20_000

#: Reasons in the table of outcomes; each point of a large study may have its own.
_MAX_REASONS = 200

#: Answers for one gait of a point, least serious first; a failure outranks them all.
_WEIGHTS = ("no_gait", "fell", "converged")

#: Rows of the longest table that a page shows unfolded.
_OPEN_ROWS = 20

_HEADS = {
    "exponent_low": "low",
    "exponent_high": "high",
    "slope_from": "from γ",
    "slope_to": "to γ",
    "from": "from",
    "n": "points",
    "starts": "initial conditions",
    "strides": "steps",
    "foot_mass_ratio": "ρ",
    "slope": "γ",
    "stance_angle": "θ*",
    "period": "T",
    "slope_transition": "γ where asymptotes cross",
    "slope_transition_fitted": "γ where fitted lines cross",
    "amplitude_linear": "linear amplitude",
    "amplitude_linear_error": "relative error",
    "amplitude_cube_root": "cube-root amplitude",
    "linear_to": "linear up to γ",
    "fitted_below": "lower line below γ",
    "fitted_above": "upper line above γ",
    "fitted_exponent": "exponent of the lower line",
    "fitted_amplitude": "amplitude of the lower line",
    "fitted_cube_root": "amplitude of the upper line",
    "asymptotic": "γ by the asymptotic formula",
    "local_exponent": "local exponent",
    "local_exponent_fitted": "local exponent of fitted lines",
    "predicted": "by the 3/2 law",
    "exact_asymptotes": "by asymptotes",
    "fitted_lines": "by fitted lines",
    "found_deflated": "added by deflation",
    "found_once": "found once",
    "non_anthropomorphic": "legs pass more than once",
    "unseen": "share unseen",
    "over_error": "residual / error",
    "error_bound": "relative error bound",
    "largest_stable_slope": "largest stable γ",
    "smallest_slope": "smallest γ",
    "fastest_slope": "γ of the fastest",
    "fastest_froude_speed": "fastest stable Fr",
    "fastest_stable_speed": "fastest stable v",
    "stance_rate_values": "θ̇*",
    "stride": "step",
    "spectral_radius": "max |λ|",
    "stance_rate": "θ̇*",
    **{key: key for key in ("l_t", "w_t", "m_t", "r_t", "c_t", "l_s", "w_s", "m_s", "r_s", "c_s", "m_h", "eps_T")},
}

#: Captions of the tables of fits.
_FITS = {
    "fits/scaling": "Fitted power laws",
    "fits/transition": "Scaling transition of the short step",
    "fits/transition_ratio": "Ratio of transition slopes",
}

#: What the columns of a table of fits mean.
_NOTES = {
    "fits/scaling": "Regime: the law at the smallest slopes or speeds of the line, or another at its largest. Low, "
    "high: the range of local exponents over the fitted range, joined with the 95 % confidence interval of the "
    "regression. It shows how far the curve bends, not how uncertain its limit is: an exact exponent that is reached "
    "at vanishing slopes only, such as 1/3, may lie at its end or just beyond.",
    "fits/transition": "Fitted lines: a power law below a tenth of the slope at which the asymptotes cross, and one of "
    "power 1/3 above three times it, each to the end of this study's slopes. Where they cross depends on the range and "
    "the number of slopes and differs between studies; where the asymptotes cross does not.",
    "fits/transition_ratio": "By fitted lines: over the slopes of this study; over other ranges the ratio differs.",
}

#: Fitted laws.
_LAWS = {"stance_angle": "θ* of γ", "speed": "v of γ", "power_speed": "P of v"}


@dataclass(frozen=True)
class Table:
    """A caption, column headings and rows of cells; `meanings` are the long names of the columns.

    `frame` holds all rows, for the CSV file that is called after `name`; `gaits` are the addresses of the rows' gaits.
    """

    caption: str
    heads: list[str]
    rows: list[list[Cell]]
    note: str = ""
    meanings: list[str] = field(default_factory=list)
    name: str = ""
    frame: pd.DataFrame | None = None
    gaits: list[str] = field(default_factory=list)

    @property
    def numeric(self) -> list[bool]:
        """Whether each column holds numbers, beside which a dash stands for an absent one."""
        return [any(c.value is not None for c in column) for column in zip(*self.rows, strict=True)]

    @property
    def folded(self) -> bool:
        """Whether the rows are folded under the caption."""
        return len(self.rows) > _OPEN_ROWS


def head(column: str) -> str:
    """Heading of a column: the paper's symbol where there is one, else the name in words."""
    return _HEADS.get(column, column.replace("_", " "))


def from_frame(
    caption: str, frame: pd.DataFrame, note: str = "", name: str = "", whole: pd.DataFrame | None = None
) -> Table:
    """Make a table of a frame.

    Located numbers have the digits that their error leaves, with the error of the last digit in parentheses; errors and
    bounds have two digits; the other numbers of a column have the same number of decimals where they are comparable.
    `whole` is the frame with all rows, for the CSV file called after `name`.
    """
    whole = frame if whole is None else whole
    counts = frame.columns[[kind.kind in "iu" for kind in frame.dtypes]]
    units = frame.attrs.get("units", {})
    shown = {str(c): column_cells(str(c), frame) for c in frame.columns}
    heads = [_with_unit("steps" if c == "period" and c in counts else head(str(c)), units.get(c, "")) for c in frame]
    rows = [list(row) for row in zip(*shown.values(), strict=True)] if len(frame) else []
    return Table(caption, heads, rows, note, [frame.attrs.get("meanings", {}).get(c, "") for c in frame], name, whole)


def _with_unit(name: str, unit: str) -> str:
    return f"{name} ({print_units(unit)})" if print_units(unit) else name


def fits(source: Source) -> list[Table]:
    """One table for each fit in the archive."""
    tables = []
    for name, table in source.tables.items():
        if name.startswith("fits/") and not table.empty:
            fitted = table[table["n"] > 0] if "n" in table else table
            shown = fitted.head(2 * MAX_ROWS)
            if "quantity" in shown:
                shown = shown.assign(quantity=[_LAWS.get(q, q) for q in shown["quantity"]]).rename(
                    columns={"quantity": "law"}
                )
            note = f"{len(table) - len(shown)} more rows are in the archive." if len(shown) < len(fitted) else ""
            if len(fitted) < len(table) and not note:
                missing, more = len(table) - len(fitted), "more " if len(fitted) else ""
                note = f"{missing} {more}fits found no range over which a power law holds."
            words = " ".join(filter(None, (_NOTES.get(name, ""), note)))
            caption = _FITS.get(name, name.replace("_", " "))
            tables.append(from_frame(caption, shown, words, name.replace("/", "-"), table))
    return tables


def landmarks(source: Source) -> Table | None:
    """Landmarks that the paper prints or numbers, beside those computed and what rounding allows."""
    names = ["landmark", "walker", "point", "printed", "slope", "slope_low", "slope_high", "stance_angle"]
    tables = [source.tables[n] for n in ("landmarks", "crises") if n in source.tables]
    frame = pd.concat([t[names] for t in tables if set(names) <= set(t.columns)] or [pd.DataFrame(columns=names)])
    if frame.empty:
        return None
    heads = ["landmark", "walker", "point"]
    heads += ["printed γ (rad)", "computed γ (rad)", "from γ (rad)", "to γ (rad)", "θ* (rad)"]
    rows = [[cell(v) for v in row] for row in frame.itertuples(index=False, name=None)]
    words, gaits = places.note(frame), addresses(source, frame)
    return Table("The paper's numbers beside the computed ones", heads, rows, words, gaits=gaits)


def residuals(source: Source) -> Table | None:
    """The study's own measurements beside the computed values."""
    frame = measured.residuals(source)
    if frame.empty:
        return None
    shown = frame.head(2 * MAX_ROWS)
    note = "Residual: measured less computed; – where no computed gait has that slope."
    note += f" {len(frame) - len(shown)} more are in the CSV file." if len(shown) < len(frame) else ""
    return from_frame("Residuals of the measurements", shown, note, "residuals", frame)


def special_points(source: Source) -> Table | None:
    """Folds, flips and ends, with their coordinates."""
    table = source.tables.get("special_points")
    if table is None or table.empty:
        return None
    shown = table.head(2 * MAX_ROWS)
    note = f"{len(table) - len(shown)} more are in the archive." if len(shown) < len(table) else ""
    return replace(from_frame("Special points", shown, note, "special_points", table), gaits=addresses(source, shown))


def points(source: Source) -> pd.DataFrame:
    """List every grid point without a converged gait: coordinates, gait, status and the sentence that says why."""
    grid = source.outcomes
    if "status" not in grid:
        return pd.DataFrame()
    status = grid["status"] if grid["status"].ndim else grid["status"].expand_dims("study")
    at = np.nonzero(status.values)
    sentences, names = source.reasons, source.statuses
    frame = pd.DataFrame(
        {str(d): _decode(i, grid[d].values) for d, i in zip(status.dims, at, strict=True) if d in grid.coords}
    )
    values, codes = np.unique(status.values[at], return_inverse=True)
    frame["status"] = _decode(codes, [names.get(int(s), str(s)) for s in values])
    index = np.atleast_1d(grid["reason"].values)[at] if "reason" in grid else np.full(len(at[0]), -1)
    values, codes = np.unique(index, return_inverse=True)
    frame["reason"] = _decode(codes, [sentences[i] if 0 <= i < len(sentences) else "" for i in values])
    return frame


def _decode(codes: np.ndarray, values: Sequence[Any] | np.ndarray) -> Any:
    """Expand codes to values; words become categories, each stored once."""
    if getattr(values, "dtype", None) is not None and values.dtype.kind not in "OU":  # type: ignore[union-attr]
        return np.asarray(values)[codes]
    words = list(dict.fromkeys(map(str, values)))
    places = {word: i for i, word in enumerate(words)}
    return pd.Categorical.from_codes(np.array([places[str(v)] for v in values], np.int32)[codes], words)


def statuses(source: Source) -> list[tuple[str, int, float]]:
    """Count and share of every status of points or lines that occurs, in the order of the flag values.

    As `gaitsweep run` counts, the status of a point is a failure of any of its gaits, else the best answer of any.
    """
    if "status" not in source.outcomes:
        return []
    status = source.outcomes["status"]
    values, counts = np.unique(_of_points(source, status) if "gait" in status.dims else status, return_counts=True)
    total = counts.sum()
    return [
        (source.statuses.get(int(v), str(v)), int(c), float(c / total)) for v, c in zip(values, counts, strict=True)
    ]


def _of_points(source: Source, status: xr.DataArray) -> np.ndarray:
    """Status of each point, from those of its gaits."""
    codes, place = np.unique(status.values, return_inverse=True)
    names = [source.statuses.get(int(code), "") for code in codes]
    weights = [_WEIGHTS.index(n) if n in _WEIGHTS else len(_WEIGHTS) + k for k, n in enumerate(names)]
    order = np.argsort(weights)
    heaviest = np.argsort(order)[place.reshape(status.shape)].max(axis=status.dims.index("gait"))
    return np.asarray(codes[order][heaviest])


def outcome_sentence(source: Source) -> str:
    """The outcomes of a study in one sentence."""
    counts = {name: count for name, count, _ in statuses(source)}
    total = sum(counts.values())
    if not total:
        return ""
    what = source.whole + ("" if total == 1 else "s")
    grouped = f"{total:,}".replace(",", "\u202f")
    if set(counts) == {"converged"}:
        return f"{ {1: 'The', 2: 'Both'}.get(total, f'All {grouped}') } {what} converged."
    parts = [f"{count:,}".replace(",", "\u202f") + f" {name.replace('_', ' ')}" for name, count in counts.items()]
    return f"Of {grouped} {what}: {', '.join(parts)}."


def outcomes(source: Source, absent: pd.DataFrame) -> Table | None:
    """Outcomes by status and reason: how many gaits or lines, and over which slopes."""
    if "status" not in source.outcomes:
        return None
    status = source.outcomes["status"]
    solved, slopes = status.size - len(absent), np.array([])
    if "slope" in status.coords and "slope" in status.dims:
        slopes = status["slope"].values[(status == 0).any([d for d in status.dims if d != "slope"]).values]
    rows = [[Cell("converged"), Cell(""), cell(solved, True), *_range(slopes)]] if solved else []
    groups = absent.groupby(["status", "reason"], sort=False, observed=True)
    for (status, reason), group in itertools.islice(groups, _MAX_REASONS):
        rows.append(
            [
                Cell(status.replace("_", " ")),
                Cell(reason),
                cell(len(group), True),
                *_range(group["slope"].to_numpy() if "slope" in group else np.array([])),
            ]
        )
    caption, what = ("Outcomes by gait", "gaits") if source.whole == "point" else ("Outcomes by line", "lines")
    note = f"{groups.ngroups - _MAX_REASONS} more reasons are in the archive." if groups.ngroups > _MAX_REASONS else ""
    return Table(caption, ["status", "reason", what, "from γ (rad)", "to γ (rad)"], rows, note)


def _range(slopes: np.ndarray) -> list[Cell]:
    return [cell(slopes.min()), cell(slopes.max())] if len(slopes) else [Cell("–"), Cell("–")]


def listed(absent: pd.DataFrame) -> pd.DataFrame:
    """Points without a converged gait that the CSV file lists: failures first, which answers would push out."""
    if absent.empty:
        return absent
    order = np.argsort(absent["status"].isin(ANSWERS).to_numpy(), kind="stable")
    return absent.iloc[order[:MAX_LISTED]]


def failures(absent: pd.DataFrame) -> Table | None:
    """Points that failed; that there is no gait at a point is an answer, not a failure."""
    failed = absent[~absent["status"].isin(ANSWERS)] if len(absent) else absent
    if failed.empty:
        return None
    shown = failed.head(MAX_ROWS)
    more, beyond = min(len(failed), MAX_LISTED) - len(shown), len(failed) - MAX_LISTED
    note = f"{more} more are in the CSV file." if more else ""
    note += f" {beyond} others are in the archive alone." if beyond > 0 else ""
    return from_frame("Failed points", shown, note)


def failed_tasks(source: Source) -> Table | None:
    """Tasks on whole lines or on the study that failed."""
    table = source.tables.get("failed_tasks")
    if table is None or table.empty:
        return None
    note = f"{len(table) - MAX_ROWS} more are in the archive." if len(table) > MAX_ROWS else ""
    return from_frame("Failed tasks", table.head(MAX_ROWS), note)


def walkers(source: Source) -> Table | None:
    """Parameters of the study's walkers, one column each; a key that the study varies shows its values."""
    tables = source.walkers
    if not tables:
        return None
    names = dict.fromkeys(axis for axes in source.varied.values() for axis in axes)
    given = {axis: _axis_values(source.grid[axis].values) for axis in names if axis in source.grid.coords}
    moved = {
        key: given.get(key, Cell("varied")) if key in axes else Cell(f"by {', '.join(axes)}")
        for key, axes in source.varied.items()
    }
    keys = list(dict.fromkeys(key for table in tables.values() for key in table))
    rows = [[Cell(key), *(moved.get(key) or cell(table.get(key, "–")) for table in tables.values())] for key in keys]
    rows += [[Cell(axis), *[values] * len(tables)] for axis, values in given.items() if axis not in keys]
    return Table("Parameters", ["key", *tables], rows)


def _axis_values(values: np.ndarray) -> Cell:
    """The values of an axis, in one cell."""
    if len(values) == 1:
        return cell(float(values[0]))
    shown = [plain(float(v), 6) for v in values]
    return Cell(", ".join(shown) if len(shown) < 5 else f"{shown[0]} … {shown[-1]} ({len(shown)} values)")


def pairs(record: dict[str, Any]) -> list[tuple[str, Cell]]:
    """Flatten a record into names and cells; nested entries are named by their path."""
    entries: list[tuple[str, Cell]] = []
    for key, value in record.items():
        if isinstance(value, dict):
            entries += [(f"{key} {inner}", shown) for inner, shown in pairs(value)]
        elif isinstance(value, list):
            entries.append((str(key), Cell(", ".join(str(v) for v in value))))
        elif value is not None:
            entries.append((str(key).replace("_", " "), cell(value)))
    return entries


def claims(source: Source) -> list[dict[str, Any]]:
    """Rows of the ledger in an archive, as plain data."""
    table = source.tables.get("claims")
    rows = table.to_dict("records") if table is not None and "id" in table else []
    return [{str(k): v.item() if isinstance(v, np.generic) else v for k, v in row.items()} for row in rows]
