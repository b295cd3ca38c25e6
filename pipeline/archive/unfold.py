"""Groups of an archive as tables; reading needs neither the tasks nor the plan."""

from typing import Any

import numpy as np
import pandas as pd
import xarray as xr


def dataset(group: Any, **options: Any) -> xr.Dataset:
    """Return a group of an open archive, not yet read; opening the file again can crash
    the library.

    Whoever opened the file closes it.

    Parameters
    ----------
    group : netCDF4.Dataset or netCDF4.Group
    **options
        Of `xarray.open_dataset`.
    """
    opened = xr.open_dataset(xr.backends.NetCDF4DataStore(group), **options)
    opened.set_close(None)
    return opened


class _Shared(dict[str, str]):
    """Words on the columns of a frame, which pandas copies with every column that is
    read unless they are shared.
    """

    def __deepcopy__(self, memo: dict[int, Any]) -> "_Shared":
        return self


def table(dataset: xr.Dataset, grid: xr.Dataset) -> pd.DataFrame:
    """A group as a frame: its columns along `row`, or its arrays with a row per element
    that holds something.

    Parameters
    ----------
    dataset : Dataset
        The group.
    grid : Dataset
        The archive's main group, with the coordinates of the lines.

    Returns
    -------
    DataFrame
        Its `attrs` hold the units and the meanings of the columns.
    """
    variables = dataset.variables
    if any(variable.ndim > 1 for variable in variables.values()):
        frame = _unfolded(dataset, grid)
    else:
        columns = {
            str(name): column for name, column in variables.items() if column.ndim == 1
        }
        rows = max(map(len, columns.values()), default=0)
        whole = {}
        for heading, column in columns.items():
            if len(column) == rows:
                whole[heading] = column.values
        frame = pd.DataFrame(whole)

    for what, attribute in (("units", "units"), ("meanings", "long_name")):
        words = _Shared()
        for name, variable in variables.items():
            words[str(name)] = str(variable.attrs.get(attribute, ""))
        frame.attrs[what] = words

    return frame


def _unfolded(dataset: xr.Dataset, grid: xr.Dataset) -> pd.DataFrame:
    """Turn arrays of a group into rows again, flags into words; rows without a number
    or a flag are left out.
    """
    dims = max((column.dims for column in dataset.variables.values()), key=len)
    frame = _frame(dataset, grid, dims)
    coordinates = [str(dim) for dim in dims]

    empty = np.ones(len(frame), bool)
    for name in frame.columns.difference(coordinates):
        values = frame[name].to_numpy()
        if values.dtype.kind == "f":
            empty &= np.isnan(values)
        elif values.dtype.kind != "O":
            empty &= values < 0

        words = _words(dataset, name)
        if words:
            codes = np.where(values < len(words), values, -1)
            frame[name] = pd.Categorical.from_codes(codes, words)

    return frame[~empty].reset_index(drop=True)


def _frame(
    dataset: xr.Dataset,
    grid: xr.Dataset,
    dims: tuple[Any, ...],
) -> pd.DataFrame:
    """A row for each element of the arrays of a group, with its coordinates."""
    of_lines = {}
    for dim in dims:
        if dim in grid.coords and dim not in dataset.coords:
            of_lines[dim] = grid[dim]
    whole = dataset.assign_coords(of_lines)

    beside = []
    for name, variable in whole.data_vars.items():
        if not set(variable.dims) <= set(dims):
            beside.append(name)

    frame = whole.drop_vars(beside).to_dataframe().reset_index()
    for dim in dims:
        values = f"{dim}_values"
        if values in frame:
            frame[dim] = frame.pop(values)

    return frame


def _words(dataset: xr.Dataset, name: str) -> list[str]:
    """What the flags of a variable mean, if they are flags."""
    if name not in dataset:
        return []
    meanings = str(dataset[name].attrs.get("flag_meanings", "")).split()
    return [word.replace("_", " ") for word in meanings]
