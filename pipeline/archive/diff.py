"""Differences between two archives."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.archive import layout
from pipeline.archive.read import columns, open_archive
from pipeline.errors import ArchiveError
from pipeline.statuses import ALL_STATUSES

_Pair = tuple[np.ndarray, np.ndarray]
#: Variables that measure relative rounding: a tolerance applies to their absolute difference.
_ROUNDING = ("residual", "error_bound", "energy_imbalance")


@dataclass(frozen=True)
class Tolerance:
    """Relative tolerance of every variable, and exceptions `own` by name."""

    rtol: float
    own: Mapping[str, float]

    def of(self, name: str) -> float | None:
        """Relative tolerance of a variable; None if `rtol` applies to its absolute difference."""
        if name in self.own:
            return self.own[name]
        return None if name.rpartition("/")[2] in _ROUNDING else self.rtol


def diff(a: Path, b: Path, rtol: float = 0.0, own: Mapping[str, float] | None = None) -> list[str]:
    """List the differences between two archives, aligned by coordinates.

    Parameters
    ----------
    a, b : Path
    rtol : float
        Relative tolerance: numbers are equal if they differ by at most `rtol` times the larger. Parts of an eigenvalue
        are compared with its magnitude, measures of rounding with one.
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
        differences = [
            f"the {what} differs: {getattr(left, what, None)} and {getattr(right, what, None)}"
            for what in ("kind",)
            if getattr(left, what, None) != getattr(right, what, None)
        ]
        constants, others = _parameters(left), _parameters(right)
        for name in sorted(constants.keys() & others.keys()):
            differences += _compare_values(name, constants[name], others[name], tolerance)
        places: dict[str, _Pair] = {}
        for name in sorted(set(left.dimensions) | set(right.dimensions)):
            if not any(name in file.variables for file in (left, right)):
                continue  # reasons, characters
            if name not in left.dimensions or name not in right.dimensions:
                differences.append(f"the dimension `{name}` is only in {a if name in left.dimensions else b}")
                continue
            places[name], sentences = _aligned(name, left, right, a, b)
            differences += sentences
        for name in sorted(set(left.variables) | set(right.variables)):
            if name in left.dimensions or name in right.dimensions or name == "reason_text":
                continue
            if name not in left.variables or name not in right.variables:
                differences.append(f"`{name}` is only in {a if name in left.variables else b}")
            elif set(layout.dims(left.variables[name])) <= set(places):
                differences += _compare(name, left, right, places, tolerance)
        shared = {name: np.ma.getdata(left.variables[name][...])[pair[0]] for name, pair in places.items()}
        differences += _compare_groups(left, right, tolerance, shared, a, b)
        names = {name for file in (left, right) for name in (*file.variables, *columns(file))}
        for name in tolerance.own:
            if name not in names:
                raise ArchiveError(f"Neither {a} nor {b} holds `{name}`.")
        return differences


def _parameters(file: Any) -> dict[str, np.ndarray]:
    """Parameters that all walkers of an archive share, shape (1,) each."""
    attributes = {name: file.getncattr(name) for name in file.ncattrs() if name != "accuracy"}
    return {name: np.array([value]) for name, value in attributes.items() if isinstance(value, float)}


def _aligned(name: str, left: Any, right: Any, a: Path, b: Path, path: str = "") -> tuple[_Pair, list[str]]:
    """Indices of the coordinate values that both have, and sentences on those that only one has."""
    x, y = np.ma.getdata(left.variables[name][...]), np.ma.getdata(right.variables[name][...])
    if x.dtype.kind == "O" or y.dtype.kind == "O":
        x, y = x.astype(str), y.astype(str)
    _, i, j = np.intersect1d(x, y, return_indices=True)
    order = np.argsort(i)
    sentences = [
        f"{len(values) - len(i):,} of {len(values):,} values of `{path}{name}` are only in {archive}"
        for values, archive in ((x, a), (y, b))
        if len(values) > len(i)
    ]
    return (i[order], j[order]), sentences


def _compare(name: str, left: Any, right: Any, places: dict[str, _Pair], tolerance: Tolerance) -> list[str]:
    dims = layout.dims(left.variables[name])
    if set(layout.dims(right.variables[name])) != set(dims):
        return [f"`{name}` has other dimensions"]
    units = [getattr(file.variables[name], "units", None) for file in (left, right)]
    if units[0] != units[1]:
        return [f"`{name}` is in {units[0]} and in {units[1]}"]
    x, y = (
        _along(dims, file.variables[name])[np.ix_(*(places[d][k] for d in dims))]
        for k, file in enumerate((left, right))
    )
    x, y = np.atleast_1d(x), np.atleast_1d(y)  # scalars of a single line
    if name == "reason":
        x, y = (np.ma.getdata(f.variables["reason_text"][...]).astype(str)[v] for f, v in ((left, x), (right, y)))
    elif name == "status":
        return _compare_status(x, y)
    scale = None
    if name in ("multiplier_real", "multiplier_imag") and {"multiplier_real", "multiplier_imag"} <= set(left.variables):
        real, imag = (np.ma.getdata(left.variables[f"multiplier_{part}"][...]) for part in ("real", "imag"))
        scale = np.hypot(real, imag)[np.ix_(*(places[d][0] for d in dims))]
    return _compare_values(name, x, y, tolerance, scale)


def _along(dims: tuple[str, ...], variable: Any) -> np.ndarray:
    """Values of a variable, its dimensions in that order."""
    own = layout.dims(variable)
    return np.ma.getdata(variable[...]).transpose([own.index(d) for d in dims])


def _compare_status(x: np.ndarray, y: np.ndarray) -> list[str]:
    names = {code: name for name, code in ALL_STATUSES.items()}
    pairs, counts = np.unique(np.stack([x[x != y], y[x != y]]), axis=1, return_counts=True)
    return [
        f"`status`: {n:,} were {names.get(int(p), p)} and are {names.get(int(q), q)}"
        for (p, q), n in zip(pairs.T, counts, strict=True)
    ]


def _compare_values(
    name: str, x: np.ndarray, y: np.ndarray, tolerance: Tolerance, scale: np.ndarray | None = None
) -> list[str]:
    if x.shape != y.shape:
        return [f"`{name}` has {x.size:,} values and {y.size:,}"]
    if x.dtype.kind != "f" or y.dtype.kind != "f":
        unequal = x.astype(str) != y.astype(str) if "O" in (x.dtype.kind, y.dtype.kind) else x != y
        return [f"`{name}`: {np.count_nonzero(unequal):,} of {x.size:,} differ"] if unequal.any() else []
    rtol, unit = tolerance.of(name), " of their size"
    with np.errstate(invalid="ignore", divide="ignore"):
        size = np.maximum(np.abs(x), np.abs(y)) if scale is None else scale
        if rtol is None:
            rtol, size, unit = tolerance.rtol, np.ones(x.shape), ""
        gap = np.abs(x - y)
        unequal = ~((gap <= rtol * size) | (x == y) | (np.isnan(x) & np.isnan(y)))
        worst = np.max(np.where(unequal & np.isfinite(gap) & (size > 0), gap / size, 0.0), initial=0.0)
    if not unequal.any():
        return []
    return [f"`{name}`: {np.count_nonzero(unequal):,} of {x.size:,} differ, by up to {worst:.2g}{unit}"]


def _compare_groups(
    left: Any, right: Any, tolerance: Tolerance, shared: dict[str, np.ndarray], a: Path, b: Path, path: str = ""
) -> list[str]:
    """Differences between tables on the lines of both archives, whose coordinates are `shared`."""
    differences = []
    for name in sorted(set(left.groups) | set(right.groups)):
        group_path = f"{path}/{name}"
        if name not in left.groups or name not in right.groups:
            differences.append(f"the group {group_path} is only in {a if name in left.groups else b}")
            continue
        left_group, right_group = left.groups[name], right.groups[name]
        slopes: _Pair | None = None  # of arrays
        if all("slope" in group.variables and "slope" in group.dimensions for group in (left_group, right_group)):
            slopes, sentences = _aligned("slope", left_group, right_group, a, b, f"{group_path}/".lstrip("/"))
            differences += sentences
        rows = _matching_rows(left_group, right_group, shared)
        for column in sorted(set(left_group.variables) | set(right_group.variables)):
            if column == "slope" and slopes:
                continue
            if column not in left_group.variables or column not in right_group.variables:
                differences.append(f"`{group_path}/{column}` is only in {a if column in left_group.variables else b}")
                continue
            dims = layout.dims(left_group.variables[column])
            if set(layout.dims(right_group.variables[column])) != set(dims):
                differences.append(f"`{group_path}/{column}` has other dimensions")
                continue
            x, y = (
                _shared_part(group, column, dims, shared, rows[k], slopes and slopes[k])
                for k, group in enumerate((left_group, right_group))
            )
            differences += _compare_values(f"{group_path}/{column}".lstrip("/"), x, y, tolerance)
        differences += _compare_groups(left_group, right_group, tolerance, shared, a, b, group_path)
    return differences


def _shared_part(
    group: Any,
    column: str,
    dims: tuple[str, ...],
    shared: dict[str, np.ndarray],
    rows: np.ndarray,
    slopes: np.ndarray | None,
) -> np.ndarray:
    """Values of a column, or of an array over the lines' axes, on the lines that both archives have, in one order.

    `rows` are those of a table, `slopes` the places of those of arrays.
    """
    variable = group.variables[column]
    values = _along(dims, variable)
    if dims == ("row",):
        return values[rows]
    if slopes is not None and "slope" in dims:
        values = values.take(slopes, dims.index("slope"))
    for axis, name in enumerate(dims):
        coordinate = group.parent.variables.get(name)
        if name in shared and name not in group.variables and coordinate is not None:
            is_shared, places = _places(coordinate, shared[name])
            values = values.take(np.flatnonzero(is_shared)[np.argsort(places)], axis)
    return values


def _matching_rows(left: Any, right: Any, shared: dict[str, np.ndarray]) -> _Pair:
    """Rows of two tables on the lines that both archives have, in one order; by slope where both have the same ones."""
    x, y = _rows_of(left, shared), _rows_of(right, shared)
    if not all("slope" in group.variables and "row" in group.dimensions for group in (left, right)):
        return x, y
    p, q = (np.ma.getdata(group.variables["slope"][...])[rows] for group, rows in ((left, x), (right, y)))
    if not np.array_equal(np.unique(p), np.unique(q)):
        return x, y
    return _rows_of(left, shared, by_slope=True), _rows_of(right, shared, by_slope=True)


def _rows_of(group: Any, shared: dict[str, np.ndarray], by_slope: bool = False) -> np.ndarray:
    """Indices of the rows of a table whose line both archives have, line by line in the order of `shared`."""
    kept = np.ones(len(group.dimensions["row"]) if "row" in group.dimensions else 0, bool)
    order: list[np.ndarray] = [np.ma.getdata(group.variables["slope"][...])] if by_slope else []
    for name, values in shared.items():
        # A column `slope` may be a result, as along a branch or at a fold.
        if name in group.variables and name not in ("slope", "gait"):
            is_shared, places = _places(group.variables[name], values)
            kept &= is_shared
            order.append(np.zeros(len(kept), int))
            order[-1][is_shared] = places
    rows = np.flatnonzero(kept)
    # Stable: rows of one line, or of one slope of it, stay as its task has written them.
    return rows[np.lexsort([places[rows] for places in order])] if order else rows


def _places(variable: Any, shared: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mask of the values of a variable that both archives have, and the places of these in `shared`."""
    values = np.ma.getdata(variable[...])
    if values.dtype.kind in "OU":  # a longer word must not be cut to one of `shared`
        values, shared = values.astype(str), shared.astype(str)
    is_shared, order = np.isin(values, shared), np.argsort(shared)
    return is_shared, order[np.searchsorted(shared[order], values[is_shared])]
