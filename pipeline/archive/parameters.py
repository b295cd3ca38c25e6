"""Parameters of the walkers in the archive: variables along the axes where they vary, attributes where they do not."""

from __future__ import annotations

from typing import Any

import numpy as np

from pipeline import dispatch
from pipeline.archive.attributes import put
from pipeline.study import units
from pipeline.study.model import Study
from tasks.registry import SI_UNITS


def write(file: Any, study: Study) -> None:
    """Write every parameter of the study's walkers that is not an axis itself.

    Parameters
    ----------
    file : netCDF4.Dataset
        With the dimensions and coordinates of the lines' axes.
    study : Study

    Notes
    -----
    A parameter that the walkers of a study do not share is a variable along `walker`, one that an axis such as
    `detuning` moves is one along that axis; so `ds.where(ds.R > 0.2)` selects by either. All others are global
    attributes under their own names.
    """
    kinds = dispatch.resolve("tasks.walkers.walker:KEYS")
    axes = {axis.name: axis.values for axis in study.line_axes}
    is_si = units.is_si(study)
    tables = [check["table"] for check in study.checks]
    moved: dict[str, list[list[dict[str, Any]]]] = {}
    for key in dispatch.resolve("tasks.walkers.walker:NUMBERS"):
        if key in axes:
            continue
        axis = next((check["varied"][key] for check in study.checks if key in check["varied"]), "")
        values = np.array([float(table[key]) for table in tables])
        dims = ("walker",) if study.walker_axis and len(set(values)) > 1 else ()
        if axis:
            dims = (*(("walker",) if study.walker_axis else ()), axis)
            if axis not in moved:
                moved[axis] = [[_table(w, axis, v) for v in axes[axis].tolist()] for w in study.walkers]
            values = np.array([[table[key] for table in line] for line in moved[axis]], float)
        if not dims:
            put(file, {key: float(values.ravel()[0])})
            continue
        shape = [len(study.walkers) if d == "walker" else len(axes[d]) for d in dims]
        variable = file.createVariable(key, "f8", dims, fill_value=False)
        unit = SI_UNITS[kinds[key]] if is_si or kinds[key] == "angle" else "1"
        put(variable, {"long_name": f"walker's {key}", "units": unit})
        if not is_si and kinds[key] not in ("angle", "number") and any(check["si"] for check in study.checks):
            put(variable, {"comment": "in the units of each walker: see walker_units"})
        variable[...] = values.reshape(shape)


def _table(walker: str | dict[str, Any], axis: str, value: float) -> dict[str, Any]:
    """A walker's parameters at one value of an axis."""
    parameters: dict[str, Any] = dispatch.call("check_walker", {"walker": walker, "set": {axis: value}})["parameters"]
    return parameters
