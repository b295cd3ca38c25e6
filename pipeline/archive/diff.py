"""Differences between two archives."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from gaitsweep.pipeline.archive import layout
from gaitsweep.pipeline.archive.read import open_archive
from gaitsweep.pipeline.archive.unfold import dataset
from gaitsweep.pipeline.errors import ArchiveError
from gaitsweep.pipeline.statuses import STATUS_NAMES
from gaitsweep.pipeline.terminal import counted

#: Variables that measure relative rounding: a tolerance applies to their absolute
#: difference.
_ROUNDING = ("residual", "error_bound", "energy_imbalance")
#: Parts of an eigenvalue, which are compared with its magnitude.
_PARTS = ("multiplier_real", "multiplier_imag")
_Pair = tuple[xr.Dataset, xr.Dataset]


@dataclass(frozen=True)
class Tolerance:
    """Relative tolerance of every variable, and exceptions `own` by name."""

    rtol: float
    own: Mapping[str, float]

    def compare(
        self, name: str, x: np.ndarray, y: np.ndarray, scale: np.ndarray | None = None
    ) -> list[str]:
        """Differences between the values of a variable, if any, in a sentence."""
        if x.shape != y.shape:
            return [f"`{name}` has {counted(x.size, 'value')} and {y.size:,}"]
        if x.dtype.kind != "f" or y.dtype.kind != "f":
            unequal = (
                x.astype(str) != y.astype(str)
                if "O" in (x.dtype.kind, y.dtype.kind)
                else x != y
            )
            return (
                [f"`{name}`: {np.count_nonzero(unequal):,} of {x.size:,} differ"]
                if unequal.any()
                else []
            )
        rtol, unit = self.own.get(name, self.rtol), " of their size"
        with np.errstate(invalid="ignore", divide="ignore"):
            size = np.maximum(np.abs(x), np.abs(y)) if scale is None else scale
            if name not in self.own and name.rpartition("/")[2] in _ROUNDING:
                size, unit = np.ones(x.shape), ""
            gap = np.abs(x - y)
            unequal = ~((gap <= rtol * size) | (x == y) | (np.isnan(x) & np.isnan(y)))
            worst = np.max(
                np.where(unequal & np.isfinite(gap) & (size > 0), gap / size, 0.0),
                initial=0.0,
            )
        if not unequal.any():
            return []
        absent = np.count_nonzero(np.isnan(x) != np.isnan(y))
        by = (
            [f"by up to {worst:.2g}{unit}"]
            if absent < np.count_nonzero(unequal)
            else []
        )
        by += [f"{absent:,} absent in one"] if absent else []
        return [
            f"`{name}`: {np.count_nonzero(unequal):,} of {x.size:,} differ, {', '.join(by)}"
        ]


def diff(
    a: Path, b: Path, rtol: float = 0.0, own: Mapping[str, float] | None = None
) -> list[str]:
    """List the differences between two archives, aligned by coordinates.

    Parameters
    ----------
    a, b : Path
    rtol : float
        Relative tolerance: numbers are equal if they differ by at most `rtol` times the
        larger. Parts of an eigenvalue are compared with its magnitude, measures of
        rounding with one.
    own : mapping, optional
        Relative tolerances of single variables, or of columns as "group/column".

    Returns
    -------
    list of str
        One sentence for each difference.

    Raises
    ------
    ArchiveError
        If an archive cannot be read, or neither has a variable that `own` names.
    """
    tolerance = Tolerance(rtol, own or {})
    with open_archive(a) as left, open_archive(b) as right:
        kinds = [getattr(file, "kind", None) for file in (left, right)]
        differences = (
            [f"the kind differs: {kinds[0]} and {kinds[1]}"]
            if kinds[0] != kinds[1]
            else []
        )
        constants, others = _parameters(left), _parameters(right)
        for name in sorted(constants.keys() & others.keys()):
            differences += tolerance.compare(name, constants[name], others[name])
        x, y = (
            dataset(file, mask_and_scale=False, decode_times=False)
            for file in (left, right)
        )
        for name in sorted(
            (set(x.indexes) | set(y.indexes)) - (set(x.sizes) & set(y.sizes))
        ):
            differences.append(
                f"the dimension `{name}` is only in {a if name in x.sizes else b}"
            )
        differences += _compare_groups((left, right), (a, b), (x, y), tolerance)
        names = {name for file in (left, right) for name, _ in layout.variables(file)}
        for name in sorted(tolerance.own.keys() - names):
            raise ArchiveError(f"Neither {a} nor {b} holds `{name}`.")
        return differences


def _parameters(file: Any) -> dict[str, np.ndarray]:
    """Parameters that all walkers of an archive share, shape (1,) each."""
    attributes = {
        name: file.getncattr(name) for name in file.ncattrs() if name != "accuracy"
    }
    return {
        name: np.array([value])
        for name, value in attributes.items()
        if isinstance(value, float)
    }


def _compare_groups(
    groups: tuple[Any, Any],
    paths: tuple[Path, Path],
    grids: _Pair,
    tolerance: Tolerance,
    prefix: str = "",
) -> Iterator[str]:
    """Differences between two open groups, and the groups in them; `grids` are the main
    groups of the archives.
    """
    x, y = (
        _opened(group, grid) if prefix else grid
        for group, grid in zip(groups, grids, strict=True)
    )
    for name in sorted(set(x.indexes) & set(y.indexes)):
        if prefix and name != "slope":
            continue  # said of the main groups
        for one, other, path in ((x, y, paths[0]), (y, x, paths[1])):
            if n := len(one.indexes[name].difference(other.indexes[name])):
                yield f"{n:,} of {one.sizes[name]:,} values of `{prefix}{name}` are only in {path}"
    rows = _matching_rows(x, y, grids)
    for name in sorted(
        map(str, {*x.variables, *y.variables} - {*x.indexes, *y.indexes, "reason_text"})
    ):
        if name not in x or name not in y:
            yield f"`{prefix}{name}` is only in {paths[0] if name in x else paths[1]}"
        elif prefix or set(x[name].dims) <= set(y.sizes):
            yield from _compare(name, prefix, (x, y), rows, tolerance)
    for name in sorted(set(groups[0].groups) | set(groups[1].groups)):
        inner = [group.groups.get(name) for group in groups]
        if None in inner:
            yield f"the group /{prefix}{name} is only in {paths[inner.index(None) - 1]}"
        else:
            yield from _compare_groups(
                (inner[0], inner[1]), paths, grids, tolerance, f"{prefix}{name}/"
            )


def _opened(group: Any, grid: xr.Dataset) -> xr.Dataset:
    """A group with the coordinates of the lines; its own, but for slopes, are results,
    and compared as such.
    """
    opened = dataset(group, mask_and_scale=False, decode_times=False)
    own = [name for name in opened.indexes if name != "slope"]
    opened = opened.drop_indexes(own).reset_coords(own)
    return opened.assign_coords(
        {
            name: grid[name]
            for name in opened.dims
            if name in grid.indexes and name not in opened
        }
    )


def _compare(
    name: str,
    prefix: str,
    groups: _Pair,
    rows: tuple[np.ndarray, np.ndarray],
    tolerance: Tolerance,
) -> list[str]:
    """Differences between a variable of two groups, where both have it; of tables in
    some `rows`.
    """
    x, y = (group[name].load() for group in groups)
    if set(x.dims) != set(y.dims):
        return [f"`{prefix}{name}` has other dimensions"]
    units = [each.attrs.get("units") for each in (x, y)]
    if units[0] != units[1]:
        return [f"`{prefix}{name}` is in {units[0]} and in {units[1]}"]
    if x.dims == ("row",):
        return tolerance.compare(
            f"{prefix}{name}", x.values[rows[0]], y.values[rows[1]]
        )
    parts = [x, y]
    if name in _PARTS and all(set(_PARTS) <= set(group) for group in groups):
        parts += [sum(group[part] ** 2 for part in _PARTS) ** 0.5 for group in groups]
    parts = list(xr.align(*parts, join="inner", exclude=set(x.dims) - set(x.indexes)))
    one, other, *sizes = (
        np.atleast_1d(part.transpose(*x.dims).values) for part in parts
    )  # scalars of a single line
    if name == "status":
        return _compare_status(one, other)
    if name == "reason":
        one, other = (
            group["reason_text"].values.astype(str)[each]
            for group, each in zip(groups, (one, other), strict=True)
        )
    return tolerance.compare(
        f"{prefix}{name}", one, other, np.maximum(*sizes) if sizes else None
    )


def _compare_status(x: np.ndarray, y: np.ndarray) -> list[str]:
    pairs, counts = np.unique(
        np.stack([x[x != y], y[x != y]]), axis=1, return_counts=True
    )
    return [
        f"`status`: {n:,} were {STATUS_NAMES.get(int(p), p)} and are {STATUS_NAMES.get(int(q), q)}"
        for (p, q), n in zip(pairs.T, counts, strict=True)
    ]


def _matching_rows(
    x: xr.Dataset, y: xr.Dataset, grids: _Pair
) -> tuple[np.ndarray, np.ndarray]:
    """Rows of two tables on the lines that both archives have, in one order; by slope
    where both have the same ones.
    """
    # A column `slope` may be a result, as along a branch or at a fold.
    names = (set(grids[0].indexes) & set(grids[1].indexes)) - {"slope", "gait"}
    shared = {
        name: grids[0].indexes[name].intersection(grids[1].indexes[name])
        for name in names
    }
    rows = _rows(x, shared), _rows(y, shared)
    if all("row" in table.sizes and "slope" in table for table in (x, y)):
        p, q = (
            np.unique(table["slope"].values[own])
            for table, own in zip((x, y), rows, strict=True)
        )
        if np.array_equal(p, q):
            return _rows(x, shared, by_slope=True), _rows(y, shared, by_slope=True)
    return rows


def _rows(
    table: xr.Dataset, shared: Mapping[Any, pd.Index], by_slope: bool = False
) -> np.ndarray:
    """Rows of a table whose line has `shared` coordinates, line by line."""
    names = sorted(set(shared) & set(table.data_vars), reverse=True)
    order = [*names, "slope"] if by_slope else names
    rows = pd.DataFrame(
        {name: table[name].values for name in order},
        np.arange(table.sizes.get("row", 0)),
    )
    for name in names:
        rows = rows[rows[name].isin(shared[name])]
    # Stable: rows of one line, or of one slope of it, stay as its task has written
    # them.
    return np.asarray((rows.sort_values(order, kind="stable") if order else rows).index)
