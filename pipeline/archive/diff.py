"""Differences between two archives."""

from collections.abc import Callable, Iterator, Mapping
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
from gaitsweep.tasks.contract.registry import DRIVES

#: Variables that measure relative rounding: a tolerance applies to their absolute
#: difference.
_ROUNDING = ("residual", "error_bound", "energy_imbalance")
#: Coordinates of groups along which the points of a line lie.
_ALONG = ("slope", *DRIVES)
#: Parts of an eigenvalue, which are compared with its magnitude.
_PARTS = ("multiplier_real", "multiplier_imag")
_Pair = tuple[xr.Dataset, xr.Dataset]


@dataclass(frozen=True)
class Tolerance:
    """Relative tolerance of every variable, and exceptions `own` by name."""

    rtol: float
    own: Mapping[str, float]

    def compare(
        self,
        name: str,
        x: np.ndarray,
        y: np.ndarray,
        size: np.ndarray | None = None,
    ) -> list[str]:
        """Differences between the values of a variable, if any, in a sentence."""
        if x.shape != y.shape:
            return [f"`{name}` has {counted(x.size, 'value')} and {y.size:,}"]

        kinds = x.dtype.kind, y.dtype.kind
        if kinds == ("f", "f"):
            return self.describe(name, x, y, self.difference(name, x, y, size))

        if "O" in kinds:
            x = x.astype(str)
            y = y.astype(str)

        unequal = np.count_nonzero(x != y)
        if not unequal:
            return []

        return [f"`{name}`: {unequal:,} of {x.size:,} differ"]

    @np.errstate(invalid="ignore", divide="ignore", over="ignore")
    def difference(
        self,
        name: str,
        x: np.ndarray,
        y: np.ndarray,
        size: np.ndarray | None = None,
    ) -> np.ndarray:
        """|x - y| over the size with which two numbers of a variable are compared, by
        default the larger of both; infinite where they have none, NaN where one of them
        is absent.
        """
        if self._is_absolute(name):
            size = np.ones(x.shape)
        elif size is None:
            size = np.maximum(np.abs(x), np.abs(y))

        over = np.where(x == y, 0.0, np.abs(x - y) / size)

        is_absent = np.isnan(x) | np.isnan(y)
        over[np.isnan(over)] = np.inf
        over[is_absent] = np.nan
        return over

    def describe(
        self, name: str, x: np.ndarray, y: np.ndarray, difference: np.ndarray
    ) -> list[str]:
        """Say how many numbers of a variable differ by more than its tolerance, and by
        how much at most, if any do.
        """
        absent = np.count_nonzero(np.isnan(x) != np.isnan(y))
        beyond = np.count_nonzero(difference > self.own.get(name, self.rtol))
        by = []
        if beyond:
            unit = " of their size"
            if self._is_absolute(name):
                unit = ""
            by.append(f"by up to {np.nanmax(difference):.2g}{unit}")

        if absent:
            by.append(f"{absent:,} absent in one")
        if not by:
            return []

        return [f"`{name}`: {absent + beyond:,} of {x.size:,} differ, {', '.join(by)}"]

    def _is_absolute(self, name: str) -> bool:
        """Whether the numbers of a variable are compared as they are."""
        return name not in self.own and name.rpartition("/")[2] in _ROUNDING


@dataclass(frozen=True)
class Numbers:
    """A variable of numbers that two archives have, at the coordinates that both have.

    Attributes
    ----------
    name, units : str
    first, second : DataArray
        Its values in either archive, in one order; NaN where there is none.
    difference : DataArray
        |first - second| over the size with which they are compared, by default the
        larger of both; NaN where one of them lacks a value.
    """

    name: str
    units: str
    first: xr.DataArray
    second: xr.DataArray
    difference: xr.DataArray


def diff(
    a: Path,
    b: Path,
    rtol: float = 0.0,
    own: Mapping[str, float] | None = None,
    keep: Callable[[Numbers], object] | None = None,
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
    keep : callable, optional
        Is given the numbers of each variable over coordinates, from which the sentences
        are made.

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
        names = {*dict(layout.variables(left)), *dict(layout.variables(right))}
        for name in sorted(tolerance.own.keys() - names):
            raise ArchiveError(f"Neither {a} nor {b} holds `{name}`.")

        grids = _raw(left), _raw(right)
        comparison = _Comparison((a, b), grids, tolerance, keep)
        return list(comparison.of_archives(left, right))


def _is_over_coordinates(grid: xr.Dataset, name: str) -> bool:
    """Whether a group has numbers of a name over coordinates alone."""
    if name not in grid or grid[name].dtype.kind != "f" or not grid[name].dims:
        return False
    return set(grid[name].dims) <= set(grid.indexes)


def _raw(group: Any) -> xr.Dataset:
    """A group with its values as they are stored."""
    return dataset(group, mask_and_scale=False, decode_times=False)


@dataclass(frozen=True)
class _Comparison:
    """What two archives are compared by: their paths, their main groups, the
    tolerance, and what is given the numbers over coordinates.
    """

    paths: tuple[Path, Path]
    grids: _Pair
    tolerance: Tolerance
    keep: Callable[[Numbers], object] | None

    def of_archives(self, left: Any, right: Any) -> Iterator[str]:
        """Differences between two open archives."""
        kinds = [getattr(file, "kind", None) for file in (left, right)]
        if kinds[0] != kinds[1]:
            yield f"the kind differs: {kinds[0]} and {kinds[1]}"

        constants = _parameters(left)
        others = _parameters(right)
        for name in sorted(constants.keys() & others.keys()):
            yield from self.tolerance.compare(name, constants[name], others[name])

        x, y = self.grids
        in_both = x.sizes.keys() & y.sizes.keys()
        for dim in sorted({*x.indexes, *y.indexes} - in_both):
            yield f"the dimension `{dim}` is only in {self._holder(dim in x.sizes)}"
        yield from self._of_groups(left, right)

    def _of_groups(self, left: Any, right: Any, prefix: str = "") -> Iterator[str]:
        """Differences between two open groups, and between the groups in them."""
        x, y = self.grids
        if prefix:
            x = _opened(left, x)
            y = _opened(right, y)

        yield from self._of_coordinates(x, y, prefix)

        rows = _matching_rows(x, y, self.grids)
        for name in _compared(x, y):
            if name not in x or name not in y:
                yield f"`{prefix}{name}` is only in {self._holder(name in x)}"
            elif prefix or set(x[name].dims) <= set(y.sizes):
                yield from self._of_variable(name, prefix, (x, y), rows)

        for name in sorted({*left.groups, *right.groups}):
            path = f"{prefix}{name}"
            if name in left.groups and name in right.groups:
                inner = left.groups[name], right.groups[name]
                yield from self._of_groups(*inner, f"{path}/")
            else:
                holder = self._holder(name in left.groups)
                yield f"the group /{path} is only in {holder}"

    def _holder(self, is_first: bool) -> Path:
        """The archive that alone holds something: the first, or the second."""
        return self.paths[0] if is_first else self.paths[1]

    def _of_coordinates(
        self,
        x: xr.Dataset,
        y: xr.Dataset,
        prefix: str,
    ) -> Iterator[str]:
        """Values of coordinates that only one of two groups has."""
        for name in sorted(set(x.indexes) & set(y.indexes)):
            if prefix and name not in _ALONG:
                continue  # said of the main groups
            for one, other, path in ((x, y, self.paths[0]), (y, x, self.paths[1])):
                missing = len(one.indexes[name].difference(other.indexes[name]))
                if missing:
                    values = f"{missing:,} of {one.sizes[name]:,} values"
                    yield f"{values} of `{prefix}{name}` are only in {path}"

    def _of_variable(
        self,
        name: str,
        prefix: str,
        groups: _Pair,
        rows: tuple[np.ndarray, np.ndarray],
    ) -> list[str]:
        """Differences between a variable of two groups, where both have it; of tables in
        some `rows`.
        """
        x, y = (group[name].load() for group in groups)
        path = f"{prefix}{name}"
        if set(x.dims) != set(y.dims):
            return [f"`{path}` has other dimensions"]

        units = [variable.attrs.get("units") for variable in (x, y)]
        if units[0] != units[1]:
            return [f"`{path}` is in {units[0]} and in {units[1]}"]
        if x.dims == ("row",):
            return self.tolerance.compare(path, x.values[rows[0]], y.values[rows[1]])

        first, second, size = _aligned(name, groups)
        if not prefix and all(_is_over_coordinates(group, name) for group in groups):
            return self._of_numbers(name, first, second, size)

        # Those of a single line are scalars.
        one, other = np.atleast_1d(first.values, second.values)
        if name == "status":
            return _compare_status(one, other)
        if name == "reason":
            one = _sentences(groups[0])[one]
            other = _sentences(groups[1])[other]

        return self.tolerance.compare(path, one, other, size)

    def _of_numbers(
        self,
        name: str,
        first: xr.DataArray,
        second: xr.DataArray,
        size: np.ndarray | None,
    ) -> list[str]:
        """Differences between numbers over coordinates, which may be kept too."""
        x = first.values
        y = second.values
        over = self.tolerance.difference(name, x, y, size)

        if self.keep:
            units = str(first.attrs.get("units", ""))
            self.keep(Numbers(name, units, first, second, first.copy(data=over)))

        return self.tolerance.describe(name, x, y, over)


def _compared(x: xr.Dataset, y: xr.Dataset) -> list[str]:
    """Names of the variables of two groups that are compared."""
    others = {*x.indexes, *y.indexes, "reason_text"}
    return sorted(map(str, {*x.variables, *y.variables} - others))


def _aligned(
    name: str, groups: _Pair
) -> tuple[xr.DataArray, xr.DataArray, np.ndarray | None]:
    """Values of a variable at the coordinates that two groups share, and the size with
    which they are compared, if it is not their own.
    """
    x, y = (group[name] for group in groups)
    parts = [x, y, *_magnitudes(name, groups)]
    unindexed = set(x.dims) - set(x.indexes)
    aligned = xr.align(*parts, join="inner", exclude=unindexed)
    one, other, *sizes = (part.transpose(*x.dims) for part in aligned)
    if not sizes:
        return one, other, None

    of_one, of_other = (size.values for size in sizes)
    return one, other, np.atleast_1d(np.fmax(of_one, of_other))


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


def _opened(group: Any, grid: xr.Dataset) -> xr.Dataset:
    """A group with the coordinates of the lines; its own, but for slopes and values of
    what else drives, are results, and compared as such.
    """
    opened = _raw(group)
    results = [name for name in opened.indexes if name not in _ALONG]
    opened = opened.drop_indexes(results).reset_coords(results)
    of_lines = [dim for dim in opened.dims if dim in grid.indexes and dim not in opened]
    return opened.assign_coords({dim: grid[dim] for dim in of_lines})


def _magnitudes(name: str, groups: _Pair) -> list[xr.DataArray]:
    """Magnitudes of the eigenvalues of two groups, if a variable is a part of them."""
    if name not in _PARTS or not all(set(_PARTS) <= set(group) for group in groups):
        return []
    return [sum(group[part] ** 2 for part in _PARTS) ** 0.5 for group in groups]


def _sentences(group: xr.Dataset) -> np.ndarray:
    """Reasons by their numbers."""
    return np.asarray(group["reason_text"].values.astype(str))


def _compare_status(x: np.ndarray, y: np.ndarray) -> list[str]:
    """How many points had another status, by both."""
    differ = x != y
    changes = np.stack([x[differ], y[differ]])
    pairs, counts = np.unique(changes, axis=1, return_counts=True)
    sentences = []
    for pair, n in zip(pairs.T.tolist(), counts, strict=True):
        was, now = (STATUS_NAMES.get(number, number) for number in pair)
        sentences.append(f"`status`: {n:,} were {was} and are {now}")

    return sentences


def _matching_rows(
    x: xr.Dataset,
    y: xr.Dataset,
    grids: _Pair,
) -> tuple[np.ndarray, np.ndarray]:
    """Rows of two tables on the lines that both archives have, in one order; by slope,
    or what else drives, where both have the same values.
    """
    indexes, others = (grid.indexes for grid in grids)
    # A column `slope` may be a result, as along a branch or at a fold.
    along = str(grids[0].attrs.get("along", "slope"))
    names = (set(indexes) & set(others)) - {along, "gait"}
    shared = {name: indexes[name].intersection(others[name]) for name in names}
    rows = _rows(x, shared), _rows(y, shared)
    if not all("row" in table.sizes and along in table for table in (x, y)):
        return rows

    of_x, of_y = rows
    places = np.unique(x[along].values[of_x])
    others_places = np.unique(y[along].values[of_y])
    if not np.array_equal(places, others_places):
        return rows

    return _rows(x, shared, along), _rows(y, shared, along)


def _rows(
    table: xr.Dataset,
    shared: Mapping[Any, pd.Index],
    along: str = "",
) -> np.ndarray:
    """Rows of a table whose line has `shared` coordinates, line by line, and perhaps by
    what they lie along.
    """
    names = sorted(set(shared) & set(table.data_vars), reverse=True)
    order = list(names)
    if along:
        order.append(along)

    columns = {name: table[name].values for name in order}
    rows = pd.DataFrame(columns, np.arange(table.sizes.get("row", 0)))
    for name in names:
        rows = rows[rows[name].isin(shared[name])]
    if order:
        # Stable: rows of one line, or of one slope of it, stay as its task has written
        # them.
        rows = rows.sort_values(order, kind="stable")

    return np.asarray(rows.index)
