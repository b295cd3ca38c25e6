"""Functions for notebooks and scripts: the commands of the command line, returning
Datasets and tables.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, overload

import numpy as np
import pandas as pd
import xarray as xr

from gaitsweep.pipeline.api import in_memory
from gaitsweep.pipeline.api.gait_table import GaitTable, Walks
from gaitsweep.pipeline.api.reports import archive_path
from gaitsweep.pipeline.api.threads import in_turn
from gaitsweep.pipeline.archive import layout, read, unfold
from gaitsweep.pipeline.archive.unfold import dataset
from gaitsweep.pipeline.companions import default_archive
from gaitsweep.pipeline.engine import runner
from gaitsweep.pipeline.engine.places import MAX_JOBS
from gaitsweep.pipeline.errors import ArchiveError, StudyError
from gaitsweep.pipeline.study import (
    broadcast,
    files,
    model,
    parse,
    rules,
    single_point,
    target,
    toml,
    want,
)
from gaitsweep.pipeline.study.fields import VIOLATION_LIMITS
from gaitsweep.pipeline.study.location import Location
from gaitsweep.tasks.contract.registry import MAX_STEPS, nameable


@overload
def load(archive: str | Path, table: None = None) -> xr.Dataset: ...
@overload
def load(archive: str | Path, table: str) -> pd.DataFrame: ...
@in_turn
def load(archive: str | Path, table: str | None = None) -> xr.Dataset | pd.DataFrame:
    """Read an archive, or one of its tables.

    Parameters
    ----------
    archive : str or Path
        An archive written by `run`.
    table : str, optional
        A group of the archive: `"fits/scaling"`, `"branches"`, `"special_points"`,
        `"claims"`, …

    Returns
    -------
    xarray.Dataset
        The grid, in memory, with its flags decoded: `status` and `reason` in words,
        `violations` as booleans along a dimension `violation`, and complex
        `multipliers` beside their parts. `attrs["tables"]` lists the tables.
    pandas.DataFrame
        The requested table; `attrs["units"]` holds the units of its columns,
        `attrs["meanings"]` what they are.

    Raises
    ------
    ArchiveError
        If the file is not an archive of gaitsweep, or does not have the table.
    """
    path = archive_path(archive)
    with read.open_archive(
        path
    ) as file:  # unreadable parts of a damaged file are reported as such
        tables = layout.tables(file)
        if table is None:
            grid = _decode(dataset(file).load()).assign_attrs(tables=tables)
            for name in (
                grid.variables
            ):  # how strings lie in this file; a part of them lies otherwise in another
                grid[name].encoding.pop("char_dim_name", None)
            return Dataset(grid.data_vars, grid.coords, grid.attrs)

        if table not in tables:
            raise ArchiveError(
                f"{path} has no table {table}; it has {', '.join(tables) or 'none'}."
            )

        columns = dataset(file[table]).load()
        return unfold.table(columns, dataset(file).coords.to_dataset().load())


class Dataset(xr.Dataset):
    """A loaded grid, which calls itself as xarray's; netCDF has no complex numbers, so
    `multipliers` are left out.
    """

    __slots__ = ()

    def to_netcdf(self, *args: Any, **options: Any) -> Any:
        """Write the grid as `xarray.Dataset.to_netcdf` does."""
        return xr.Dataset.to_netcdf(
            self.drop_vars("multipliers", errors="ignore"), *args, **options
        )


def _decode(grid: xr.Dataset) -> xr.Dataset:
    """Decode the flags of a grid and combine the parts of its multipliers."""
    texts = {}
    if "status" in grid:
        names = dict(
            zip(
                grid.status.flag_values.tolist(),
                grid.status.flag_meanings.split(),
                strict=True,
            )
        )
        texts["status"] = np.vectorize(names.get, otypes=[object])(grid.status.values)
        texts["reason"] = grid.reason_text.values[grid.reason.values]

    grid = grid.assign(
        {
            name: (grid[name].dims, text, {"long_name": grid[name].long_name})
            for name, text in texts.items()
        }
    ).drop_vars("reason_text", errors="ignore")
    if "violations" in grid:
        bits = grid.violations
        violation = xr.DataArray(
            bits.flag_meanings.split(), dims="violation", name="violation"
        )
        masks = xr.DataArray(
            bits.flag_masks, coords={"violation": violation}, dims="violation"
        )
        grid = grid.assign(
            violations=((bits & masks) != 0).assign_attrs(long_name=bits.long_name)
        )

    if "multiplier_real" in grid and "multiplier_imag" in grid:
        multipliers = grid.multiplier_real + 1j * grid.multiplier_imag
        long_name = grid.multiplier_real.long_name.removeprefix("real part of ")
        grid = grid.assign(
            multipliers=multipliers.assign_attrs(long_name=long_name, units="1")
        )

    return grid


@in_turn
def run(
    wanted: str | Path | Mapping[str, object],
    jobs: int = 2,
    archive: str | Path | None = None,
    *,
    accuracy: float | None = None,
    cluster: str | None = None,
    fresh: bool = False,
    retry_failed: bool = False,
    quiet: bool = False,
) -> xr.Dataset:
    """Run a study, or the rest of it, and load its archive.

    Parameters
    ----------
    wanted : str, Path or mapping
        A study: its file, its TOML text, a mapping with the same keys, in which an axis
        may be an array, or one that comes with gaitsweep, such as `"paper/figure5"`.
    jobs : int
        Worker processes.
    archive : str or Path, optional
        Path of the archive; by default `data/archive/NAME.nc` under the current folder.
    accuracy : float, optional
        Largest error bound wanted, from 1e-15 to 1e-2, instead of the study's own.
    cluster : str, optional
        A Dask scheduler, `tcp://HOST:PORT`, or `local:N`, instead of `jobs`.
    fresh, retry_failed, quiet : bool
        As on the command line: discard earlier results, retry failed points and tasks,
        show no progress.

    Returns
    -------
    xarray.Dataset
        As `load` returns it. `status` and `reason` tell which points failed and why.

    Raises
    ------
    StudyError
        If the study is invalid: one sentence that names the key, its value and the
        bound.
    GaitsweepError
        If the run cannot start or continue; finished results are kept.
    """
    jobs = Location("", "jobs").count(jobs, MAX_JOBS)
    if not isinstance(cluster, str | None):
        raise Location("", "cluster").wrong(
            "must be tcp://HOST:PORT or local:N", cluster
        )
    if not isinstance(archive, str | Path | None) or (
        archive is not None and Path(archive).suffix != ".nc"
    ):
        raise Location("", "archive").wrong("must be a name that ends in .nc", archive)

    study = _study(wanted, accuracy)
    path = Path(archive) if archive else default_archive(study.name)
    runner.run(
        [(study, path)], runner.Options(jobs, cluster, fresh, retry_failed, quiet=quiet)
    )
    return load(path)


def _study(
    wanted: str | Path | Mapping[str, object], accuracy: float | None = None
) -> model.Study:
    if isinstance(wanted, Mapping):
        wanted = "".join(
            f"{key} = {toml.written(value, key)}\n" for key, value in wanted.items()
        )
    elif not isinstance(wanted, str | Path):
        raise StudyError(
            f"A study must be a file, a text or a mapping; got {type(wanted).__name__}."
        )
    elif (
        isinstance(wanted, Path)
        or "=" not in wanted
        or ("\n" not in wanted and wanted.endswith(".toml"))
    ):
        found = files.studies(Path(wanted))
        if len(found) > 1:
            raise StudyError(
                f"{wanted} is a folder of {len(found)} studies; `run` takes one."
            )
        return parse.read(found[0], accuracy)

    try:
        table = toml.read(wanted)
    except ValueError as error:
        wrong = StudyError(f"The study cannot be read: {error}.")
        toml.note_place(wrong, wanted, error)
        raise wrong from error

    return parse.parse(table, wanted, Path("study"), accuracy)


@in_turn
def gaits(
    walker: str | Path | Mapping[str, object],
    slope: broadcast.Values | None = None,
    *,
    at: Mapping[str, broadcast.Values] | None = None,
    vary: str = "slope",
    between: tuple[float, float] | None = None,
    steps: int = 1,
    accuracy: float | None = None,
    variables: Sequence[str] | None = None,
    violation_limits: Mapping[str, float] | None = None,
    tuned: Sequence[str] = (),
    **keys: broadcast.Values,
) -> xr.Dataset:
    """Solve the gaits of a walker over arrays of slopes and keys, in memory.

    Parameters
    ----------
    walker : str, Path or mapping
        A name from the catalogue, a walker file, or the table of a walker.
    slope : float, array or DataArray [rad]
        Slopes of the ground, in [1e-18, 0.5), of driven walkers also in
        (-0.5, 0]; none where `at` is reached by varying it.
    at : mapping, optional
        A measure of gaits and the values that it is to have, as `{"speed": [0.3,
        0.4]}`: all gaits that have them, by varying the slope or a key. What was varied
        is a variable of that name.
    vary : str
        `slope`, or a key of the walker.
    between : (float, float), optional
        Least and largest value of what is varied; by default all slopes from 1e-6, or
        values within a characteristic length, mass or angle of the key's.
    steps : int
        Number of steps after which a gait repeats, at most 64; those that repeat after
        fewer are left out. The state is that with the largest stance angle, `period`
        and losses are of all steps, the multipliers those of all steps.
    accuracy : float, optional
        Largest error bound wanted, from 1e-15 to 1e-2; by default as good as doubles
        give.
    variables : sequence of str, optional
        Names and groups of variables, as in a study; by default all but the violations,
        and with an accuracy those that a study has.
    violation_limits : mapping, optional
        Limits above which violations are flagged, by name, other than the defaults
        (docs/archive.md).
    tuned : sequence of str
        Walker keys that are changed at each point, by least relatively, so that the
        walker meets the two static conditions for walking at vanishing slopes.
    **keys : float, array or DataArray
        Walker keys to change, `foot_mass_ratio` or `detuning`, in the walker's units;
        `knees` takes booleans.

    Returns
    -------
    xarray.Dataset
        Variables, units and flags as in an archive, with the dimensions to which the
        arguments broadcast (`slope` for an array of slopes in one dimension, `dim_0`, …
        for other arrays, their own for DataArrays), then `gait`. Points with a slope or
        a walker that cannot be have the status `raised`, and the sentence in
        `reason_text`.

    Raises
    ------
    StudyError
        If an argument is invalid, shapes do not broadcast, or no point at all has a
        slope and a walker that can be.

    Notes
    -----
    Points are solved as by a study, line by line: the branches of the last lines are remembered, which makes later
    calls faster and does not change them.
    """
    steps = Location("", "steps").count(steps, MAX_STEPS)
    bound = (
        0.0 if accuracy is None else parse.accuracy(accuracy, Location("", "accuracy"))
    )
    names = [variables] if isinstance(variables, str) else variables
    if not isinstance(names, Iterable | None):
        raise Location("", "variables").wrong("must be a list of names", names)

    wanted = want.variables(
        None if names is None else list(names), Location("", "variables"), bound
    )
    _check_of_one_step(wanted, steps)
    place = Location("", "violation_limits")
    limits = VIOLATION_LIMITS.read(violation_limits or {}, place)
    walker = files.changed(broadcast.definition(walker), tuned=tuned)
    asked, sought = _asked(slope, at, vary, between)
    if sought:
        target.check_steps(steps, sought, Location("", "steps"))
    wanted = want.of_targets(wanted, sought)
    asked |= keys
    named = () if names is None else names
    found = in_memory.gaits(walker, wanted, asked, steps, bound, limits, sought, named)
    return _along_first(found, asked)


def _check_of_one_step(wanted: Sequence[str], steps: int) -> None:
    """Check that of gaits of several steps nothing is wanted that is of one."""
    for name in wanted if steps > 1 else ():
        if rules.is_of_one_step(name):
            raise Location("", "variables").error(
                f"`{name}` is of gaits of one step, and `steps` is {steps}"
            )


def _along_first(found: xr.Dataset, asked: Mapping[str, Any]) -> xr.Dataset:
    """Gaits with the first of what was asked, slopes or values of a measure, as a
    dimension, where it is an array of one.
    """
    along, values = next(iter(asked.items()))
    dims = found[along].dims
    if isinstance(values, xr.DataArray) or np.ndim(values) != 1 or not dims:
        return found
    return found.swap_dims({dims[0]: along})


def _asked(
    slope: broadcast.Values | None,
    at: Mapping[str, broadcast.Values] | None,
    vary: str,
    between: tuple[float, float] | None,
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Slopes, or the values of a measure and perhaps slopes, by name; and what a study
    says of the measure.
    """
    if at is None:
        target.check_is_asked(vary, between)
        if slope is None:
            raise StudyError("`slope` is needed, or `at` with values of a measure.")
        return {"slope": slope}, {}

    if not isinstance(at, Mapping) or len(at) != 1:
        raise Location("", "at").wrong("must be a table of one measure", at)

    Location("", "at").check_names(at, nameable(), "measure")
    place = Location("", "slope")
    if slope is None and vary != "slope":
        raise place.error("`slope` is needed where a key is varied")
    if slope is not None and vary == "slope":
        raise place.error("`slope` is varied and cannot be set too")

    slopes = {} if slope is None else {"slope": slope}
    sought = {"measure": next(iter(at)), **target.varied(vary, between)}
    return {**at, **slopes}, sought


@in_turn
def solve(
    walker: str | Path | Mapping[str, object],
    slope: float | None = None,
    every: bool = False,
    *,
    at: Mapping[str, float] | None = None,
    vary: str = "slope",
    between: tuple[float, float] | None = None,
    steps: int = 1,
    accuracy: float | None = None,
    violation_limits: Mapping[str, float] | None = None,
    tuned: Sequence[str] = (),
    **keys: float,
) -> pd.DataFrame:
    """Find every gait of a walker at one slope, or at a value of a measure.

    Parameters
    ----------
    walker : str, Path or mapping
        A name from the catalogue, a walker file, or the table of a walker.
    slope : float [rad]
        Slope of the ground, in [1e-18, 0.5), of driven walkers also in
        (-0.5, 0]; none where `at` is reached by varying it.
    every : bool
        Include gaits whose swing leg passes the stance leg more than once.
    at : mapping, optional
        A measure and the value that it is to have, as `{"speed": 0.4}`: all gaits that
        have it, by varying the slope or a key.
    vary : str
        `slope`, or a key of the walker.
    between : (float, float), optional
        Least and largest value of what is varied, by default as for `gaits`.
    steps : int
        Number of steps after which a gait repeats, as for `gaits`; with `at`, where
        slopes are varied.
    accuracy : float, optional
        Largest error bound wanted, as for `gaits`; not with `at`.
    violation_limits : mapping, optional
        As for `gaits`.
    tuned : sequence of str
        As for `gaits`.
    **keys : float
        Walker keys to change, `foot_mass_ratio` or `detuning`.

    Returns
    -------
    pandas.DataFrame
        One row for each gait, with the columns of archives, and `multipliers` and
        `violations` as tuples; first that of the key that is varied. No row if there is
        no gait; `attrs["search"]` describes the search, `attrs["absent"]` says why
        there is none. A notebook shows the gaits' steps above it.

    Raises
    ------
    StudyError
        If the walker, a key or the slope is invalid.
    """
    definition, changes = broadcast.definition(walker), broadcast.changes(keys)
    fixed = None if slope is None else broadcast.number("slope", slope)
    limits = violation_limits or {}
    steps = Location("", "steps").count(steps, MAX_STEPS)
    if at is not None:
        if every or accuracy is not None:
            raise StudyError("`at` takes no `every` or `accuracy`.")
        asked = vary, between, fixed, changes, limits, tuned, steps
        answer = single_point.solve_at(definition, at, *asked)
    else:
        target.check_is_asked(vary, between)
        if fixed is None:
            raise StudyError("`slope` is needed, or `at` with the value of a measure.")
        chosen = every, steps, accuracy, limits, tuned
        answer = single_point.solve(definition, fixed, changes, *chosen)

    frame = pd.DataFrame(map(_row, answer["gaits"]), columns=answer["columns"])
    frame.attrs["search"] = answer["search"]
    frame.attrs["absent"] = list(answer["absent"])
    whole = files.changed(definition, tuned=tuned)
    return GaitTable.of(frame, Walks(whole, changes, steps, vary if at else "slope"))


def _row(gait: Mapping[str, Any]) -> dict[str, Any]:
    """A gait as a row of a table: numbers, and tuples of multipliers and violations."""
    known = {name: math.nan if value is None else value for name, value in gait.items()}
    return {
        **known,
        "multipliers": tuple(complex(*pair) for pair in gait["multipliers"]),
        "violations": tuple(gait["violations"] or ()),
    }
