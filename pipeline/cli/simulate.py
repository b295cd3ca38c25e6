"""`gaitsweep simulate`: steps from a state or a gait, with pushes."""

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from gaitsweep.pipeline import paths
from gaitsweep.pipeline.api.steps import simulate
from gaitsweep.pipeline.cli import kinds
from gaitsweep.pipeline.dispatch import ask
from gaitsweep.pipeline.errors import StudyError
from gaitsweep.pipeline.report.folder import csv_text
from gaitsweep.pipeline.study.single_point import led, state_of

#: Columns of the motion.
_SERIES = (
    "time",
    "step_number",
    "theta_st",
    "theta_th",
    "theta_sh",
    "rate_st",
    "rate_th",
    "rate_sh",
    "foot_x",
)
_STATE = ("stance_angle", "stance_rate", "thigh_rate")


def run(options: argparse.Namespace) -> int:
    """Print the steps and how they end, which may be a fall; the exit code is 1 if
    there is no gait to begin with.
    """
    if options.state and options.gait:
        raise StudyError("Steps begin either at a `--state` or at a `--gait`.")

    pushes: dict[Any, list[float]] = {}
    for step, *change in options.push:
        if step in pushes:
            raise StudyError(f"`--push` is given twice for step {step:g}.")
        pushes[int(step) if step.is_integer() else step] = change

    if options.csv:
        _check_file(options.csv)
    walker, keys = led(options.walker, options.set)
    # Checked here: as a keyword, a wrong one might be another argument.
    ask("check_walker", {"walker": walker, "set": keys})
    state = options.state or state_of(
        walker, options.slope, keys, options.gait or "long"
    )
    found = simulate(walker, options.slope, state, options.steps, pushes=pushes, **keys)
    if options.csv:
        _write_series(options, walker, state, pushes, keys, float(found["period"][0]))
    elif options.dt or options.samples or options.limits or options.degrees:
        raise StudyError(
            "`--dt`, `--samples`, `--limits` and `--degrees` need `--csv`."
        )

    kinds.show(
        options,
        {name: _plain(values) for name, values in found.variables.items()},
        _lines(found),
    )
    return 0


def _write_series(
    options: argparse.Namespace,
    walker: Any,
    state: Any,
    pushes: dict[Any, list[float]],
    keys: dict[str, Any],
    period: float,
) -> None:
    """Write the motion at a constant step as CSV."""
    dt = options.dt
    if dt is None and options.samples is None:
        dt = period / 100
    found = simulate(
        walker,
        options.slope,
        state,
        options.steps,
        pushes=pushes,
        dt=dt,
        samples=options.samples,
        limits=options.limits,
        **keys,
    )
    frame = found[list(_SERIES)].drop_vars("step", errors="ignore").to_dataframe()
    units = {name: str(found[name].units) for name in _SERIES}
    if options.degrees:
        for name in frame.columns:
            if name.startswith(("theta", "rate")):
                frame[name] = np.degrees(frame[name])
                units[name] = units[name].replace("rad", "deg")

    _check_file(options.csv)
    paths.publish_for_user(options.csv, csv_text(frame, units).encode())


def _check_file(path: Path) -> None:
    """Check that nothing stands where the motion is to be written, or an earlier one:
    of its columns, whatever their units.
    """
    head = r"[^,\n]*,".join(_SERIES)
    paths.check_own(path, head.encode())


def _plain(values: xr.Variable) -> Any:
    """Values for machines; those after a fall, and kneestrikes without knees, are null."""
    plain = values.values.astype(object)
    plain[values.isnull().values] = None
    return plain.tolist()


def _lines(found: xr.Dataset) -> Iterator[str]:
    """A table of the states with which the steps begin and of their periods, and how
    the last of them ended.
    """
    columns = [found[name] for name in (*_STATE, "period")]
    heads = ["step", *(f"{c.name} ({c.units})".removesuffix(" (1)") for c in columns)]
    yield "  ".join(heads)
    for k in range(int(found.steps_taken) + 1):
        cells = [
            str(k),
            *("" if np.isnan(c[k]) else f"{float(c[k]):.6g}" for c in columns),
        ]
        yield "  ".join(
            f"{cell:>{len(head)}}" for cell, head in zip(cells, heads, strict=True)
        ).rstrip()

    yield str(found.reason.item())
