"""Functions for notebooks and scripts: the commands of the command line, returning Datasets and tables."""

from __future__ import annotations

import json
import math
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from pipeline.archive import read
from pipeline.archive.unfold import unfolded
from pipeline.errors import ArchiveError, StudyError
from pipeline.execution import runner
from pipeline.study import model, parse, single_point


def load(archive: str | Path, table: str | None = None) -> Any:
    """Read an archive, or one of its tables.

    Parameters
    ----------
    archive : str or Path
        An archive written by `run`.
    table : str, optional
        A group of the archive: `"fits/scaling"`, `"branches"`, `"special_points"`, `"claims"`, …

    Returns
    -------
    xarray.Dataset
        The grid, in memory, with its flags decoded: `status` and `reason` in words, `violations` as booleans along
        a dimension `violation`, and complex `multipliers` beside their parts. `attrs["tables"]` lists the tables.
    pandas.DataFrame
        The requested table; `attrs["units"]` holds the units of its columns.

    Raises
    ------
    ArchiveError
        If the file is not an archive of gaitsweep, or does not have the table.
    """
    path = Path(archive)
    with read.open_archive(path) as file:
        tables = list(read.tables(file))
    if table is None:
        return _decode(xr.load_dataset(path, engine="netcdf4")).assign_attrs(tables=tables)
    if table not in tables:
        raise ArchiveError(f"{path} has no table {table}; it has {', '.join(tables) or 'none'}.")
    columns = xr.load_dataset(path, group=table, engine="netcdf4")
    if any(column.ndim > 1 for column in columns.values()):
        frame = unfolded(columns, xr.load_dataset(path, engine="netcdf4"))
    else:
        frame = pd.DataFrame({str(name): column.values for name, column in columns.items()})
    frame.attrs["units"] = {str(name): column.units for name, column in columns.items()}
    return frame


def _decode(grid: xr.Dataset) -> xr.Dataset:
    """Decode the flags of a grid and combine the parts of its multipliers."""
    texts = {}
    if "status" in grid:
        names = dict(zip(grid.status.flag_values.tolist(), grid.status.flag_meanings.split(), strict=True))
        texts["status"] = np.vectorize(names.get, otypes=[object])(grid.status.values)
        texts["reason"] = grid.reason_text.values[grid.reason.values]
    grid = grid.assign(
        {name: (grid[name].dims, text, {"long_name": grid[name].long_name}) for name, text in texts.items()}
    ).drop_vars("reason_text", errors="ignore")
    if "violations" in grid:
        bits = grid.violations
        violation = xr.DataArray(bits.flag_meanings.split(), dims="violation", name="violation")
        masks = xr.DataArray(bits.flag_masks, coords={"violation": violation}, dims="violation")
        grid = grid.assign(violations=((bits & masks) != 0).assign_attrs(long_name=bits.long_name))
    if "multiplier_real" in grid and "multiplier_imag" in grid:
        multipliers = grid.multiplier_real + 1j * grid.multiplier_imag
        grid = grid.assign(multipliers=multipliers.assign_attrs(long_name="eigenvalues of the step map", units="1"))
    return grid


def run(
    wanted: str | Path | Mapping[str, Any],
    jobs: int = 2,
    archive: str | Path | None = None,
    *,
    cluster: str | None = None,
    fresh: bool = False,
    retry_failed: bool = False,
    quiet: bool = False,
) -> xr.Dataset:
    """Run a study, or the rest of it, and load its archive.

    Parameters
    ----------
    wanted : str, Path or mapping
        A study: its file, its TOML text, or a mapping with the same keys, in which an axis may be an array.
    jobs : int
        Worker processes.
    archive : str or Path, optional
        Path of the archive; by default `data/archive/NAME.nc` under the current folder.
    cluster : str, optional
        A Dask scheduler, `tcp://HOST:PORT`, or `local:N`, instead of `jobs`.
    fresh, retry_failed, quiet : bool
        As on the command line: discard earlier results, retry failed points and tasks, show no progress.

    Returns
    -------
    xarray.Dataset
        As `load` returns it. `status` and `reason` tell which points failed and why.

    Raises
    ------
    StudyError
        If the study is invalid: one sentence that names the key, its value and the bound.
    GaitsweepError
        If the run cannot start or continue; finished results are kept.
    """
    study = _study(wanted)
    path = Path(archive) if archive else Path("data", "archive", f"{study.name}.nc")
    runner.run(study, path, runner.Options(jobs, cluster, fresh, retry_failed, quiet=quiet))
    return load(path)


def _study(wanted: str | Path | Mapping[str, Any]) -> model.Study:
    if isinstance(wanted, Mapping):
        wanted = "".join(f"{key} = {_to_toml(value, key)}\n" for key, value in wanted.items())
    elif isinstance(wanted, Path) or "=" not in wanted:
        return parse.read(wanted)
    try:
        table = tomllib.loads(wanted)
    except tomllib.TOMLDecodeError as error:
        raise StudyError(f"The study cannot be read: {error}.") from error
    return parse.parse(table, wanted, Path("study"))


def _to_toml(value: Any, key: str) -> str:
    """Format a value as TOML; mappings become inline tables."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{_to_toml(str(k), key)} = {_to_toml(v, key)}" for k, v in value.items()) + " }"
    if isinstance(value, list | tuple | range):
        return "[" + ", ".join(_to_toml(v, key) for v in value) + "]"
    if isinstance(value, str | Path):
        return json.dumps(str(value))
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    if isinstance(value, bool | int | float):
        return json.dumps(value)
    raise StudyError(f"`{key}` must be a number, a text, a list or a mapping; got {type(value).__name__}.")


def solve(walker: str | Path | Mapping[str, Any], slope: float, every: bool = False, **keys: float) -> pd.DataFrame:
    """Find every gait of a walker at one slope.

    Parameters
    ----------
    walker : str, Path or mapping
        A name from the catalogue, a walker file, or the table of a walker.
    slope : float [rad]
        Slope of the ground, in (0, 0.5).
    every : bool
        Include gaits whose swing leg passes the stance leg more than once.
    **keys : float
        Walker keys to change, `foot_mass_ratio` or `detuning`.

    Returns
    -------
    pandas.DataFrame
        One row for each gait, with the columns of archives, and `multipliers` and `violations` as tuples. Empty if
        there is no gait; `attrs["search"]` describes the search.

    Raises
    ------
    StudyError
        If the walker, a key or the slope is invalid.
    """
    definition = dict(walker) if isinstance(walker, Mapping) else str(walker)
    answer = single_point.solve(definition, float(slope), {key: float(value) for key, value in keys.items()}, every)
    rows = [
        {
            **{name: math.nan if value is None else value for name, value in gait.items()},
            "multipliers": tuple(complex(*pair) for pair in gait["multipliers"]),
            "violations": tuple(gait["violations"] or ()),
        }
        for gait in answer["gaits"]
    ]
    frame = pd.DataFrame(rows)
    frame.attrs["search"] = answer["search"]
    return frame
