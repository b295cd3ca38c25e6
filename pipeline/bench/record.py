"""The bench's archive."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import xarray as xr

from pipeline.bench.run import Measurements


def write(measurements: Measurements, path: Path) -> None:
    """Write one row per measurement, and the counted work in groups."""
    cases = measurements.cases
    rows = {
        "family": ("walker", [c.family for c in cases]),
        "problem": ("what was computed", [c.problem for c in cases]),
        "method": ("method", [c.method for c in cases]),
    }
    data = {k: ("row", np.array(v, dtype=object), {"long_name": about}) for k, (about, v) in rows.items()}

    def numbers(name: str, about: str, units: str, values: list[float]) -> None:
        data[name] = ("row", np.array(values, float), {"long_name": about, "units": units})

    numbers("tolerance", "tolerance asked for, or the precision's rounding", "1", [c.setting for c in cases])
    numbers("seconds", "median time of one answer", "s", [float(np.median(c.seconds)) for c in cases])
    numbers("seconds_least", "least time of one answer", "s", [min(c.seconds) for c in cases])
    numbers("seconds_most", "greatest time of one answer", "s", [max(c.seconds) for c in cases])
    numbers("error", "largest error over the largest entry, against extended precision", "1", [c.error for c in cases])
    numbers("work", "steps per fixed point, gaits per grid point, nodes of the branches", "1", [c.work for c in cases])
    about = {
        "Conventions": "CF-1.11",
        "title": "Run time against error",
        "reference": measurements.kind,
        "machine": json.dumps(measurements.machine, sort_keys=True),
        "quick": int(measurements.quick),
    }
    xr.Dataset(data, attrs=about).to_netcdf(path, mode="w", engine="netcdf4")
    counts = [{"family": name, **work} for name, work in measurements.work.items()]
    flows = [{"family": name, **flow} for name, of in measurements.flows.items() for flow in of]
    less = [{"family": name, **row} for name, of in measurements.less.items() for row in of]
    for group, table in (
        ("counts", counts),
        ("flows", flows),
        ("less", less),
        ("outcomes", measurements.outcomes),
        ("bounds", measurements.bounds),
        ("lines", measurements.lines),
        ("planes", measurements.planes),
        ("missed", measurements.missed),
        ("deception", measurements.deception),
        ("hunted", measurements.hunted),
    ):
        if not table:
            continue
        columns = {
            re.sub(r"\W+", "_", k.replace("/", " per ")).strip("_"): (
                "row",
                np.array([row[k] for row in table], dtype=object if isinstance(table[0][k], str) else float),
            )
            for k in table[0]
        }
        xr.Dataset(columns).to_netcdf(path, mode="a", engine="netcdf4", group=group)
