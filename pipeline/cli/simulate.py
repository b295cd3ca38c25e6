"""`gaitsweep simulate`: steps from a state or a gait, with pushes."""

import argparse
from collections.abc import Iterator
from typing import Any

import numpy as np
import xarray as xr

from gaitsweep.pipeline.api.steps import simulate
from gaitsweep.pipeline.cli import kinds
from gaitsweep.pipeline.dispatch import ask
from gaitsweep.pipeline.errors import StudyError
from gaitsweep.pipeline.study.single_point import led, state_of

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
    walker, keys = led(options.walker, options.set)
    ask(
        "check_walker", {"walker": walker, "set": keys}
    )  # as a keyword, a wrong one might be another argument
    state = options.state or state_of(
        walker, options.slope, keys, options.gait or "long"
    )
    found = simulate(walker, options.slope, state, options.steps, pushes=pushes, **keys)
    kinds.show(
        options,
        {name: _plain(values) for name, values in found.variables.items()},
        _lines(found),
    )
    return 0


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
