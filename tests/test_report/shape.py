"""An archive shaped as the contract says, from plain arrays: no solver and no run
behind it.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from gaitsweep.pipeline.companions import Companions

POINT = {
    "l_t": 0.5,
    "w_t": 0.0,
    "m_t": 0.4,
    "r_t": 0.0,
    "c_t": 0.0,
    "l_s": 0.5,
    "w_s": 0.0,
    "m_s": 0.1,
    "r_s": 0.0,
    "c_s": 0.5,
    "R": 0.0,
    "eps_T": 0.0,
    "m_h": 0.0,
    "g": 1.0,
    "knees": False,
    "units": "1",
}
KNEED = {
    "l_t": 0.35,
    "w_t": -0.0228856,
    "m_t": 2.345,
    "r_t": 0.1882,
    "c_t": 0.084,
    "l_s": 0.46,
    "w_s": 0.0223541,
    "m_s": 1.013,
    "r_s": 0.1226,
    "c_s": 0.17,
    "R": 0.2,
    "eps_T": 0.097,
    "m_h": 0.0,
    "g": 9.81,
    "knees": True,
    "units": "SI",
}
GAITS = np.array(["long", "short"], dtype=object)
NAMES = "converged no_gait not_converged fell worker_died timed_out out_of_memory not_attempted"
REASONS = [
    "",
    "The branch ends at a lower slope.",
    "Newton stopped after 40 steps with residual 3e-05.",
    "The worker died by signal 11.",
]


def write(
    path: Path,
    study: str,
    grid: dict[str, Any],
    coords: dict[str, Any],
    walkers: dict[str, Any],
    tables: dict[str, dict[str, Any]] | None = None,
    run: dict[str, Any] | None = None,
    varied: dict[str, str] | None = None,
) -> Path:
    """One archive: the grid's variables, and a group of columns for each table."""
    provenance = {
        "study": study,
        "walkers": list(walkers.values()),
        "varied": {
            key: [own] if isinstance(own, str) else own
            for key, own in (varied or {}).items()
        },
        "packages": {"gaitsweep": "0.1.0", "numpy": "2.4.6"},
        "commit": "0123abcd",
        "cpu": ["avx2", "fma"],
    }
    units = {"slope": "rad", "stance_angle": "rad", "period": "1"}
    about = {
        "Conventions": "CF-1.11",
        "gaitsweep_schema": np.int32(2),
        "provenance": json.dumps(provenance),
    }
    dataset = xr.Dataset(grid, coords, about)
    points = [
        n
        for d, n in dataset.sizes.items()
        if d not in ("gait", "multiplier", "reason_index")
    ]
    dataset.attrs["checksum_chunk"] = np.array(points, np.int64)
    for name, variable in dataset.variables.items():
        if variable.dtype.kind in "fi":
            variable.attrs.update(
                units=units.get(str(name), "1"), long_name=str(name).replace("_", " ")
            )
    if "status" in dataset:
        dataset["status"].attrs.update(
            flag_values=np.arange(8, dtype="i1"), flag_meanings=NAMES
        )
        dataset["reason_text"] = ("reason_index", np.array(REASONS, dtype=object))
    dataset.to_netcdf(path, engine="netcdf4", encoding=as_characters(dataset))
    for group, columns in (tables or {}).items():
        table = xr.Dataset(
            {
                k: (
                    "row",
                    np.asarray(
                        v, dtype=object if np.asarray(v).dtype.kind == "U" else None
                    ),
                )
                for k, v in columns.items()
            }
        )
        table.to_netcdf(
            path, mode="a", group=group, engine="netcdf4", encoding=as_characters(table)
        )
    if run is not None:
        write_record(path, run)
    return path


def write_record(path: Path, run: dict[str, Any]) -> None:
    """Write the record of the run of an archive."""
    companions = Companions(path)
    companions.make_folder()
    companions.record.write_text(json.dumps(run))


def as_characters(dataset: xr.Dataset) -> dict[str, dict[str, str]]:
    """The encoding by which strings are written as in archives."""
    return {
        str(name): {"dtype": "S1"}
        for name, column in dataset.variables.items()
        if column.dtype.kind in "OU"
    }
