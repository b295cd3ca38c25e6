"""Parameters of the walkers in the archive: variables along the axes where they vary, attributes where they do not."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from gaitsweep.pipeline import dispatch
from gaitsweep.pipeline.archive.attributes import put
from gaitsweep.pipeline.archive.written import write_variable
from gaitsweep.pipeline.study import units
from gaitsweep.pipeline.study.model import Definition, Study


def write(file: Any, study: Study) -> None:
    """Write every parameter of the study's walkers that is not an axis itself.

    Parameters
    ----------
    file : netCDF4.Dataset
        With the dimensions and coordinates of the lines' axes.
    study : Study

    Notes
    -----
    A parameter that the walkers of a study do not share is a variable along `walker`, one that axes such as `detuning`
    move, or that is tuned anew along them, is one along these; so `ds.where(ds.R > 0.2)` selects by either. All others
    are global attributes under their own names.
    """
    kinds = units.kinds()
    axes = {axis.name: axis.values for axis in study.line_axes}
    tables = [check["table"] for check in study.checks]
    for key in dispatch.resolve("gaitsweep.tasks.walkers.walker:NUMBERS"):
        if key in axes:
            continue
        owners = {owner for check in study.checks for owner in check["varied"].get(key, ())}
        across = tuple(axis for axis in axes if axis in owners)
        values = np.array([float(table[key]) for table in tables])
        is_own = study.walker_axis and (across or len(set(values)) > 1)
        dims = (*(["walker"] if is_own else []), *across)
        if across:
            values = np.array([_values(w, key, {axis: axes[axis] for axis in across}) for w in study.walkers])
        if not dims:
            put(file, {key: float(values.ravel()[0])})
            continue
        shape = [len(study.walkers) if d == "walker" else len(axes[d]) for d in dims]
        about = units.described(f"walker's {key}", kinds[key], study.checks)
        write_variable(file, key, dims, values.reshape(shape), about)


def _values(walker: Definition, key: str, axes: Mapping[str, np.ndarray]) -> np.ndarray:
    """A walker's parameter at every point of a grid of axes, flattened; NaN where it cannot be tuned."""
    grid = [values.ravel() for values in np.meshgrid(*map(np.asarray, axes.values()), indexing="ij")]
    walkers = dispatch.resolve("gaitsweep.tasks.walkers.resolve:resolve_many")(
        walker, {axis: values.astype(float) for axis, values in zip(axes, grid, strict=True)}
    )
    return np.broadcast_to(getattr(walkers, key), len(grid[0]))
