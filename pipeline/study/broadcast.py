"""Requests from Python: a walker, and arrays of slopes and keys that are broadcast to
one grid of points.
"""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import xarray as xr

from gaitsweep.pipeline.errors import StudyError
from gaitsweep.pipeline.study import files
from gaitsweep.pipeline.study.location import Location, clip
from gaitsweep.pipeline.study.model import Definition
from gaitsweep.tasks.contract.registry import VARIABLES

#: Numbers, of `knees` truth values. So is a pandas.Series, but where pandas has no
#: stubs its name would admit all.
Values: TypeAlias = (
    float | Sequence[float] | Sequence[Sequence[float]] | np.ndarray | xr.DataArray
)
#: Dimensions and coordinates of results, which no argument may use.
_RESERVED = (
    *("gait", "multiplier", "key", "key_units", "reason_index", "reason_text"),
    *VARIABLES,
)


def definition(walker: object) -> Definition:
    """Name or table of a walker.

    Parameters
    ----------
    walker : str, Path or mapping
        A name from the catalogue, a walker file, or a table, whose `base` and `toward`
        may be files too.

    Raises
    ------
    StudyError
        If it is anything else, or the name or the file is unknown.
    """
    if isinstance(walker, Mapping):
        return files.walker(_plain(walker), Path())
    if not isinstance(walker, str | Path):
        raise StudyError(
            f"`walker` must be a name, a file or a table; got {_kind(walker)}."
        )
    return files.walker(str(walker), Path())


def _plain(value: Any) -> Any:
    """A table, and one that it holds, with numbers and names in place of numpy's
    numbers and paths.
    """
    if isinstance(value, Mapping):
        return {str(key): _plain(each) for key, each in value.items()}
    if isinstance(value, np.generic):
        return value.item()
    return str(value) if isinstance(value, Path) else value


def _check_keys(names: Iterable[str], texts: Iterable[str] = ("toward",)) -> None:
    for key in texts:
        if key in names:
            raise StudyError(
                f"`{key}` stands in the table of the walker, beside its `base` or its keys."
            )


def number(name: str, value: object) -> float:
    """Check that an argument is one finite number, of Python or numpy.

    Raises
    ------
    StudyError
        If it is not.
    """
    if (
        isinstance(value, np.generic | np.ndarray | xr.DataArray)
        and np.ndim(value) == 0
    ):
        value = value.item()
    return Location("", name).number(value)


def changes(keys: Mapping[str, object]) -> dict[str, float | bool | str]:
    """Check values of keys to change: finite numbers, of `knees` true or false, of
    `trailing_knee` a text.

    Raises
    ------
    StudyError
        If one is not.
    """
    if not isinstance(keys.get("knees", True), bool | np.bool_):
        raise Location("", "knees").wrong("must be true or false", keys["knees"])
    _check_keys(keys)
    return {key: _change(key, value) for key, value in keys.items()}


def _change(key: str, value: object) -> float | bool | str:
    """The value of one key to change, checked."""
    if key == "knees":
        return bool(value)
    if key == "trailing_knee":
        return str(value)
    return number(key, value)


def broadcast(
    values: Mapping[str, Any],
) -> tuple[dict[str, xr.DataArray], tuple[xr.DataArray, ...]]:
    """Broadcast arguments: arrays by numpy's rules along dimensions `dim_0`, …,
    DataArrays along their own.

    Parameters
    ----------
    values : mapping
        Numbers, arrays and DataArrays by the names of the arguments.

    Returns
    -------
    arrays : dict
        DataArrays, each with the dimensions along which it varies alone.
    grid : tuple of DataArray
        The same in their order, all with the dimensions of the grid: numpy's, then
        those of DataArrays as they appear.

    Raises
    ------
    StudyError
        If one holds anything but numbers, if shapes do not broadcast, or if the
        coordinates of two DataArrays differ.
    """
    plain: dict[str, np.ndarray] = {}
    for name, value in values.items():
        if not isinstance(value, xr.DataArray):
            plain[name] = _numbers(name, value)

    shape = _shape_of_all(plain)
    named = {name: _named(name, v, shape) for name, v in {**values, **plain}.items()}

    try:
        aligned = xr.align(*named.values(), join="exact", copy=False)
        dims = [f"dim_{i}" for i in range(len(shape))]
        whole = xr.DataArray(np.broadcast_to(0.0, shape), dims=dims)
        _, *grid = xr.broadcast(whole, *aligned)
    except ValueError as error:
        # Only the first line of xarray's message says what is wrong.
        why = clip(str(error).splitlines()[0], 200)
        raise StudyError(f"The DataArrays do not fit each other: {why}.") from error

    arrays = dict(zip(named, aligned, strict=True))
    for name, array in arrays.items():
        if name in grid[0].dims and array.dims != (name,):
            raise StudyError(
                f"`{name}` is the name of a dimension, along which it does not vary alone."
            )

    return arrays, tuple(grid)


def _shape_of_all(arrays: Mapping[str, np.ndarray]) -> tuple[int, ...]:
    """The shape to which arrays broadcast."""
    try:
        return np.broadcast_shapes(*(array.shape for array in arrays.values()))
    except ValueError as error:
        shapes = [f"`{name}` {a.shape}" for name, a in arrays.items() if a.ndim]
        raise StudyError(f"Shapes do not broadcast: {', '.join(shapes)}.") from error


def _numbers(name: str, value: object) -> np.ndarray:
    _check_keys([name], ("toward", "trailing_knee"))
    kinds, wanted = "iuf", "a number or an array of numbers"
    if name == "knees":
        kinds, wanted = "b", "true or false, or an array of them"
    try:
        if isinstance(value, np.ma.MaskedArray):
            array = np.ma.filled(value.astype(float), np.nan)
        else:
            array = np.asarray(value)
    except (ValueError, TypeError):
        # Rows of different lengths, objects of other packages.
        array = np.empty(0, object)

    if array.dtype.kind not in kinds:
        raise StudyError(f"`{name}` must be {wanted}; got {_kind(value)}.")

    return array if name == "knees" else array.astype(float, copy=False)


def _named(
    name: str, value: np.ndarray | xr.DataArray, shape: tuple[int, ...]
) -> xr.DataArray:
    """A DataArray whose only dimensions are those along which the value varies."""
    if isinstance(value, xr.DataArray):
        others = {*_RESERVED} - {name}
        clash = [str(d) for d in (*value.dims, *value.coords) if d in others]
        if clash:
            raise StudyError(
                f"`{name}` has a dimension or coordinate `{clash[0]}`, a name that results use."
            )
        return value.copy(data=_numbers(name, value.values))

    first = len(shape) - value.ndim
    varies = [i for i, n in enumerate(value.shape) if n == shape[first + i]]

    return xr.DataArray(
        value.reshape([value.shape[i] for i in varies]),
        dims=[f"dim_{first + i}" for i in varies],
    )


def _kind(value: object) -> str:
    """What an unsuitable argument is, in a few words."""
    if isinstance(value, np.ndarray):
        return f"an array of {value.dtype}"
    if isinstance(value, str | bytes | complex | bool | list | tuple | None):
        return clip(repr(value))
    return type(value).__name__
