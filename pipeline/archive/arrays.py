"""Tables that are arrays over the grid: orbits, basins and their edges, with flags for words."""

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from gaitsweep.pipeline.archive.written import write_variable
from gaitsweep.pipeline.graph.plan import Plan

Columns = Mapping[str, np.ndarray]
#: Dimensions of each array after those of the lines, by the columns that hold their coordinates.
LAYOUTS = {
    "basin": ("slope", "stance_angle", "stance_rate"),
    "stable_manifold": ("slope", "point"),
    "orbits": ("slope", "start", "stride"),
}
#: Names of dimensions that differ from the columns'.
_RENAMED = {"stride": "step"}
#: Dimensions along which a column is constant.
_CONSTANT = {"repeats_to": ("stride",), "swing_rate": ("stance_angle",)}
_FILTERS = {"zlib": True, "complevel": 4, "shuffle": True, "fletcher32": True}


def write(
    file: Any, plan: Plan, group: str, columns: Columns, attributes: Callable[[Plan, str, str], dict[str, str]]
) -> None:
    """Write the rows of a table as arrays over the lines' axes and the table's own dimensions.

    Parameters
    ----------
    file : netCDF4.Dataset
    plan : Plan
    group : str
        A table of `LAYOUTS`.
    columns : mapping
        Columns of all lines, shape (rows,), those of the lines' coordinates included. A coordinate that differs from
        case to case, as the ranges of basins do by default, is an array over the cases and its own index.
    attributes : callable
        From plan, group and column to the attributes of a variable.
    """
    study, lines = plan.study, plan.graph.grid
    dims = [*lines.lines, "slope"]
    known = {"walker": np.array(study.names), **{axis.name: axis.values for axis in study.axes}}
    sizes = [len(known[d]) for d in dims]
    case = np.ravel_multi_index([_find(columns[d], known[d]) for d in dims], sizes)
    netcdf_group = file.createGroup(group)
    netcdf_group.createDimension("slope", len(study.slope))
    _variable(netcdf_group, "slope", ("slope",), study.slope, attributes(plan, group, "slope"))
    inner: dict[str, tuple[np.ndarray, int]] = {}
    for name in LAYOUTS[group][1:]:
        dim = _RENAMED.get(name, name)
        place, values = _positions(case, columns[name])
        inner[name] = place, values.shape[-1]
        netcdf_group.createDimension(dim, values.shape[-1])
        if values.ndim == 1:
            _variable(netcdf_group, dim, (dim,), values, attributes(plan, group, name))
        else:
            array = np.full((math.prod(sizes), values.shape[-1]), np.nan)
            array[np.unique(case)] = values
            shaped = array.reshape(*sizes, -1)
            _variable(netcdf_group, f"{name}_values", (*dims, dim), shaped, attributes(plan, group, name))
    for name, values in columns.items():
        if name in (*dims, "walker", *inner) or name in lines.sizes:
            continue
        kept = [c for c in inner if c not in _CONSTANT.get(name, ())]
        shape = [math.prod(sizes), *(inner[c][1] for c in kept)]
        text, words = values.dtype.kind == "U", np.unique(values)
        codes = np.searchsorted(words, values).astype(np.int8) if text else values
        is_whole = codes.dtype.kind in "iu"
        array = np.full(shape, -1 if is_whole else np.nan, np.int32 if is_whole else "f8")
        array[(case, *(inner[c][0] for c in kept))] = codes
        described: dict[str, Any] = dict(attributes(plan, group, name))
        if text:
            described |= {
                "flag_values": np.arange(len(words), dtype=np.int8),
                "flag_meanings": " ".join(str(word).replace(" ", "_") for word in words),
            }
        if is_whole:
            array = array.astype(np.int8 if text else np.min_scalar_type(-array.max() - 1))
        names = (*dims, *(_RENAMED.get(c, c) for c in kept))
        _variable(netcdf_group, name, names, array.reshape(*sizes, *shape[1:]), described)


def _find(values: np.ndarray, among: np.ndarray) -> np.ndarray:
    """Index of each value in an array that holds it."""
    order = np.argsort(among)
    return order[np.searchsorted(among[order], values)]


def _positions(case: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Index of each coordinate, and the coordinates: shape (n,) if all cases share them, else (cases, n)."""
    every = np.unique(values)
    cases = np.unique(case)
    if values.dtype.kind != "f" or all(len(np.unique(values[case == c])) == len(every) for c in cases):
        return np.searchsorted(every, values), every
    place, own = np.zeros(len(values), int), []
    for c in cases:
        distinct, inverse = np.unique(values[case == c], return_inverse=True)
        place[case == c] = inverse
        own.append(distinct)
    return place, np.array(own)


def _variable(group: Any, name: str, dims: tuple[str, ...], values: np.ndarray, attributes: dict[str, Any]) -> None:
    fill = np.nan if values.dtype.kind == "f" and name not in dims else False
    filters = _FILTERS if values.size and dims else {}
    write_variable(group, name, dims, values, attributes, fill_value=fill, **filters)
