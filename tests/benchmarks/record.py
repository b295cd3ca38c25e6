"""The bench's archive."""

import json
import re
from pathlib import Path

import numpy as np
import xarray as xr

from benchmarks.harness import Measurements

_TEXTS = {"family": "walker", "problem": "what was computed", "method": "method"}
_NUMBERS = {
    "tolerance": (
        "tolerance asked for, or the precision's rounding",
        "1",
        lambda case: case.setting,
    ),
    "seconds": (
        "median processor time of one answer",
        "s",
        lambda case: np.median(case.seconds),
    ),
    "seconds_least": (
        "least processor time of one answer",
        "s",
        lambda case: min(case.seconds),
    ),
    "seconds_most": (
        "greatest processor time of one answer",
        "s",
        lambda case: max(case.seconds),
    ),
    "error": (
        "largest error over the largest entry, against extended precision",
        "1",
        lambda case: case.error,
    ),
    "work": (
        "steps per fixed point, gaits per grid point, nodes of the branches",
        "1",
        lambda case: case.work,
    ),
}


def write(measured: Measurements, path: Path) -> None:
    """Write one row per measurement, and the tables in groups."""
    rows = {
        name: (
            "row",
            np.array([getattr(case, name) for case in measured.cases], object),
            {"long_name": about},
        )
        for name, about in _TEXTS.items()
    }
    rows |= {
        name: (
            "row",
            np.array([of(case) for case in measured.cases], float),
            {"long_name": about, "units": units},
        )
        for name, (about, units, of) in _NUMBERS.items()
    }
    about = {
        "Conventions": "CF-1.11",
        "title": "Run time against error",
        "reference": measured.kind,
        "machine": json.dumps(measured.machine, sort_keys=True),
        "quick": int(measured.quick),
    }
    xr.Dataset(rows, attrs=about).to_netcdf(path, mode="w", engine="netcdf4")
    for group, table in measured.tables.items():
        columns = {
            re.sub(r"\W+", "_", name.replace("/", " per ")).strip("_"): (
                "row",
                np.array(
                    [row[name] for row in table],
                    object if isinstance(first, str) else float,
                ),
            )
            for name, first in table[0].items()
        }
        xr.Dataset(columns).to_netcdf(path, mode="a", engine="netcdf4", group=group)
