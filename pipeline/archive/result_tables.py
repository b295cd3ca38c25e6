"""Tables in the archive: one netCDF group each, its columns along the dimension `row`,
or arrays over the grid.
"""

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from gaitsweep.pipeline.archive import layout
from gaitsweep.pipeline.archive.attributes import of_axis, over_steps
from gaitsweep.pipeline.archive.written import write_strings, write_variable
from gaitsweep.pipeline.graph.plan import Plan
from gaitsweep.pipeline.study import units
from gaitsweep.pipeline.study.fields import EXTRA_AXES
from gaitsweep.pipeline.study.model import Study
from gaitsweep.tasks.contract import registry
from gaitsweep.tasks.contract.columns import table_columns

Columns = dict[str, np.ndarray]
#: Dimensions of each array after those of the lines and of the points along them, by
#: the columns that hold their coordinates.
_LAYOUTS = {
    "basin": ("stance_angle", "stance_rate"),
    "stable_manifold": ("point",),
    "orbits": ("start", "stride"),
}
#: Tables of studies of curves, which hold values of the keys that vary.
_OF_CURVES = ("curves", "turnings", "meetings", "curve_walkers")
#: Names of dimensions that differ from the columns'.
_RENAMED = {"stride": "step"}
#: Dimensions along which a column is constant.
_CONSTANT = {"repeats_to": ("stride",), "swing_rate": ("stance_angle",)}
_FILTERS = {"zlib": True, "complevel": 4, "shuffle": True, "fletcher32": True}


def write(file: Any, plan: Plan) -> None:
    """Write the tables of all tasks of a study; of failed tasks, their names and
    reasons.
    """
    for name, layer in plan.graph.layers.items():
        is_of_another_kind = name in registry.OPTIONS and name != plan.study.kind
        if name not in registry.INTERNAL and not is_of_another_kind:
            _write_task(file, plan, name, layer.per_line)

    failures = [*failed(plan)]
    if failures:
        columns = zip(*failures, strict=True)
        names = ("task", "outcome", "reason")
        arrays = map(np.array, columns)
        tables = dict(zip(names, arrays, strict=True))
        _group(file, plan, "failed_tasks", tables)

    if plan.study.overlay:
        _group(file, plan, "overlay", dict(plan.study.overlay))


def _write_task(file: Any, plan: Plan, name: str, per_line: bool) -> None:
    """Write the tables of one task, over all its jobs."""
    parts: dict[str, list[tuple[np.ndarray, Columns]]] = {}
    for coordinates, key, numbers in _task_runs(plan, name, per_line):
        tables = split(plan.store.result(key) or {})
        for told in ("nothing", "partly"):
            tables.pop(told, None)  # its reason is the line's
        for group, columns in tables.items():
            whole = {**_repeat(coordinates, columns), **columns}
            parts.setdefault(group, []).append((numbers, whole))

    for group in sorted(parts):
        places, tables_of_jobs = zip(*parts[group], strict=True)
        columns = _stack(tables_of_jobs)
        if plan.study.kind == name == "design":
            # Jobs go through the grid cell by cell, rows line by line.
            order = np.argsort(np.concatenate(places), kind="stable")
            columns = {column: values[order] for column, values in columns.items()}
        _group(file, plan, group, columns)


def failed(plan: Plan) -> Iterator[tuple[str, str, str]]:
    """Name, outcome and reason of failed tasks; points report an atlas that only they
    need.
    """
    for name, layer in plan.graph.layers.items():
        if name == "points" or (name == "atlas" and not plan.graph.atlas_readers):
            continue
        if name == "charts":
            keys = _charts(plan)
        else:
            keys = (key for _, key, _ in _task_runs(plan, name, layer.per_line))

        for key in keys:
            ending = plan.store.outcome(key)
            if ending and ending.status != "ok":
                yield name, ending.status, ending.reason


def _charts(plan: Plan) -> Iterable[str]:
    """Keys of all charts: a million lines of a plane share them."""
    grid = plan.graph.grid
    keys: dict[str, None] = {}
    for number in range(grid.chunks):
        for charts in plan.charts_of(grid.chunk(number)):
            keys[charts.key] = None
    return keys


def _task_runs(
    plan: Plan, name: str, per_line: bool
) -> Iterable[tuple[dict[str, Any], str, np.ndarray]]:
    """Coordinates, key and numbers of the lines of every execution of a task, in the
    order of the grid.
    """
    if not per_line:
        yield {}, plan.graph.study_keys[name], np.zeros(0, int)
        return

    for i in range(plan.study.batches):
        numbers = plan.study.batch(i)
        line = plan.study.batch_line(i)
        coordinates = {"walker": plan.study.name_of(int(numbers[0]))}
        coordinates |= line["set"]
        if "slope" in line:
            coordinates["slope"] = line["slope"]
        yield coordinates, plan.graph.line_keys(i)[name], numbers


def split(table: Mapping[str, np.ndarray]) -> dict[str, Columns]:
    """Group columns by table.

    Parameters
    ----------
    table : mapping
        Columns by name "group/column", each of shape (n,).

    Returns
    -------
    dict
        Columns of each group.

    Raises
    ------
    ValueError
        If a name is not "group/column", or columns of a group differ in length.
    """
    groups: dict[str, Columns] = {}
    for name, values in table.items():
        if not re.fullmatch(r"(\w+/)?\w+/\w+", name) or np.ndim(values) != 1:
            raise ValueError(f"`{name}` is no column of a table")
        group, _, column = name.rpartition("/")
        groups.setdefault(group, {})[column] = values

    for group, columns in groups.items():
        lengths = set(map(len, columns.values()))
        if len(lengths) > 1:
            raise ValueError(f"columns of `{group}` differ in length")

    return groups


def _repeat(coordinates: Mapping[str, Any], columns: Columns) -> Columns:
    """Coordinates that are no columns of a table, at each of its rows."""
    rows = _rows(columns)
    repeated = {}
    for name, value in coordinates.items():
        if name not in columns:
            repeated[name] = np.full(rows, value)

    return repeated


def _rows(columns: Columns) -> int:
    """Number of rows of a table."""
    return len(next(iter(columns.values())))


def _stack(parts: Sequence[Columns]) -> Columns:
    """The rows of all parts; a column that some lack, such as a rate of other walkers,
    is NaN or empty there.
    """
    absent: dict[str, str | float] = {}
    for part in parts:
        for name, values in part.items():
            absent[name] = np.nan
            if values.dtype.kind == "U":
                absent[name] = ""

    stacked = {}
    for name, nothing in absent.items():
        columns = []
        for part in parts:
            missing = np.full(_rows(part), nothing)
            columns.append(part.get(name, missing))
        stacked[name] = np.concatenate(columns)

    return stacked


def _group(file: Any, plan: Plan, group: str, columns: Columns) -> None:
    inner = _LAYOUTS.get(group)
    if inner and {plan.study.along, *inner} <= set(columns):
        _Arrays(file, plan, group, columns).write()
        return

    netcdf_group = file.createGroup(group)
    netcdf_group.createDimension("row", _rows(columns))
    for name, values in columns.items():
        attributes = _attributes(plan, group, name)
        if values.dtype.kind == "U":
            write_strings(netcdf_group, name, "row", values.tolist(), attributes)
            continue

        options: dict[str, Any] = {**layout.filters(len(values))}
        if values.dtype.kind == "f":
            options["fill_value"] = np.nan
        write_variable(netcdf_group, name, ("row",), values, attributes, **options)


class _Arrays:
    """Writes the rows of a table as arrays over the lines' axes and the axis along
    them, which are its cases, and then over the table's own dimensions.

    A coordinate that differs from case to case, as the ranges of basins do by default,
    is an array over the cases and its own index.
    """

    def __init__(self, file: Any, plan: Plan, group: str, columns: Columns):
        self.plan = plan
        self.group = group
        self.columns = columns
        self.netcdf_group = file.createGroup(group)
        self.dims = [*plan.graph.grid.line_dims, plan.study.along]
        self.sizes, self.case = _cases(plan, self.dims, columns)
        #: Of the table's own coordinates the place of each row, and their number.
        self.inner: dict[str, tuple[np.ndarray, int]] = {}

    def write(self) -> None:
        """Write coordinates, then all other columns."""
        along, values = self.plan.study.along, self.plan.study.values_along
        self.netcdf_group.createDimension(along, len(values))
        self._variable(along, (along,), values, self._described(along))
        for name in _LAYOUTS[self.group]:
            self._write_coordinate(name)

        for name, values in self.columns.items():
            if name not in (*self.dims, "walker", *self.inner):
                self._write_column(name, values)

    def _write_coordinate(self, name: str) -> None:
        """Write one of the table's own coordinates."""
        dim = _RENAMED.get(name, name)
        place, values = _positions(self.case, self.columns[name])
        count = values.shape[-1]
        self.inner[name] = place, count
        self.netcdf_group.createDimension(dim, count)
        if values.ndim == 1:
            self._variable(dim, (dim,), values, self._described(name))
            return

        array = np.full((math.prod(self.sizes), count), np.nan)
        array[np.unique(self.case)] = values
        shaped = array.reshape(*self.sizes, -1)
        dims = (*self.dims, dim)
        self._variable(f"{name}_values", dims, shaped, self._described(name))

    def _write_column(self, name: str, values: np.ndarray) -> None:
        """Write a column: words as flags, absent numbers as NaN or -1."""
        described: dict[str, Any] = dict(self._described(name))
        if values.dtype.kind == "U":
            values, flags = _flags(values)
            described |= flags

        dtype = np.dtype(float)
        absent = np.nan
        if values.dtype.kind in "iu":
            dtype = np.min_scalar_type(-int(values.max(initial=0)) - 1)
            absent = -1

        dims = list(self.dims)
        places = [self.case]
        counts: list[int] = []
        for inner, (place, count) in self.inner.items():
            if inner not in _CONSTANT.get(name, ()):
                dims.append(_RENAMED.get(inner, inner))
                places.append(place)
                counts.append(count)

        array = np.full((math.prod(self.sizes), *counts), absent, dtype)
        array[tuple(places)] = values
        shaped = array.reshape(*self.sizes, *counts)
        self._variable(name, tuple(dims), shaped, described)

    def _described(self, name: str) -> dict[str, str]:
        return _attributes(self.plan, self.group, name)

    def _variable(
        self,
        name: str,
        dims: tuple[str, ...],
        values: np.ndarray,
        attributes: dict[str, Any],
    ) -> None:
        options: dict[str, Any] = {}
        if values.size and dims:
            options |= _FILTERS
        if values.dtype.kind == "f" and name not in dims:
            options["fill_value"] = np.nan
        write_variable(self.netcdf_group, name, dims, values, attributes, **options)


def _flags(words: np.ndarray) -> tuple[np.ndarray, dict[str, Any]]:
    """Words as numbers, and the attributes that say what these mean."""
    different, numbers = np.unique(words, return_inverse=True)
    meanings = [str(word).replace(" ", "_") for word in different]
    values = np.arange(len(different), dtype=np.int8)
    return numbers, {"flag_values": values, "flag_meanings": " ".join(meanings)}


def _cases(
    plan: Plan,
    dims: Sequence[str],
    columns: Columns,
) -> tuple[list[int], np.ndarray]:
    """Lengths of some axes of the grid, and the number of each row's place on them."""
    known = {axis.name: axis.values for axis in plan.study.axes}
    known["walker"] = np.array(plan.study.names)
    sizes, places = [], []
    for dim in dims:
        order = np.argsort(known[dim])
        found = np.searchsorted(known[dim], columns[dim], sorter=order)
        places.append(order[found])
        sizes.append(len(known[dim]))

    return sizes, np.ravel_multi_index(places, sizes)


def _positions(case: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Index of each coordinate, and the coordinates: shape (n,) if all cases share
    them, else (cases, n).
    """
    every, place = np.unique(values, return_inverse=True)
    cases, number = np.unique(case, return_inverse=True)
    count = len(every)

    # The coordinates of each case, as numbers that order them case by case.
    of_each, at = np.unique(number * count + place, return_inverse=True)
    if values.dtype.kind != "f" or len(of_each) == len(cases) * count:
        return place, every

    starts = np.arange(len(cases)) * count
    first = np.searchsorted(of_each, starts)
    own = every[of_each % count]
    return at - first[number], own.reshape(len(cases), -1)


def meaning_of(name: str, group: str = "") -> tuple[str, str]:
    """Kind of quantity and meaning of a column; one without a description is called by
    its name.
    """
    kinds = units.kinds()
    known = table_columns()
    if name in registry.VARIABLES and f"{group}/{name}" not in known:
        return registry.VARIABLES[name].kind, registry.VARIABLES[name].long_name

    own = name.replace("_", " ")
    if name in kinds:
        own = EXTRA_AXES.get(name, f"walker's {name}")

    unknown = kinds.get(name, "number"), ""
    of_any_group = known.get(name, unknown)
    kind, meaning = known.get(f"{group}/{name}", of_any_group)
    return kind, meaning or own


def _of_drive(drive: str, kind: str, meaning: str) -> tuple[str, str]:
    """Kind and meaning of a column of slopes, or of their errors, where what else drives
    stands in the place of the slope.
    """
    if kind == "angle":
        kind = units.kinds()[drive]
    return kind, meaning.replace("slope", drive)


def _attributes(plan: Plan, group: str, name: str) -> dict[str, str]:
    """Attributes of a column."""
    of_errors = {
        "overlay": "standard error of the measured",
        "measured_gaits": "bound on the error of the",
    }
    if group in of_errors and name.endswith("_error"):
        attributes = _attributes(plan, group, name.removesuffix("_error"))
        meaning = attributes["long_name"]
        return {**attributes, "long_name": f"{of_errors[group]} {meaning}"}

    study = plan.study
    kind, meaning = meaning_of(name, group)
    if name == "detuning":
        meaning = of_axis(name, study.checks)["long_name"]
    if study.drive and name != "slope" and "slope" in meaning:
        kind, meaning = _of_drive(study.drive, kind, meaning)
    attributes = units.described(over_steps(meaning, study.steps), kind, study.checks)
    if study.kind == "curve" and group in _OF_CURVES:
        key = _keys_of_values(study).get(name)
        if key:
            attributes["units"] = units.axis_units(key, study.checks)

    return attributes


def _keys_of_values(study: Study) -> dict[str, str]:
    """The keys whose values columns of a study of curves hold."""
    options = registry.options("curve", study.options)
    keys = [*(options["plane"] or [options["key"]])]
    held = dict(zip(("value", "other_value"), keys, strict=False))
    return held | {f"{name}_error": key for name, key in held.items()}
