"""`gaitsweep walkers`: the catalogue of walkers, or one walker."""

import argparse
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from gaitsweep.pipeline.cli import kinds
from gaitsweep.pipeline.dispatch import ask
from gaitsweep.pipeline.study import files, toml

#: Residuals of the static conditions that are rounding, in the walker's unit of length.
_ROUNDING = 1e-15


def run(options: argparse.Namespace) -> int:
    """Print the walkers."""
    table = files.walker(options.name, Path()) if options.name else None
    asked = {"walker": table} if isinstance(table, dict) else {"name": table}
    walkers = ask("walkers", asked)["walkers"]
    lines = [*_lines(walkers, in_full=options.name is not None)]
    if not options.name:
        lines += [f"{name:<21} {where}" for name, where in files.more_walkers()]
    kinds.show(options, walkers, lines)
    return 0


def or_zero(residual: float) -> float:
    """A residual of a condition; 0 where it is rounding."""
    return residual if abs(residual) > _ROUNDING else 0.0


def table(name: str, values: dict[str, Any]) -> Iterator[str]:
    """Format a TOML table."""
    yield f"[{name}]"
    for key, value in values.items():
        yield f"{key} = {toml.written(value)}"


def _lines(descriptions: Iterable[dict[str, Any]], in_full: bool) -> Iterator[str]:
    """The catalogue, a line for each walker, or one walker in full."""
    for walker in descriptions:
        if not in_full:
            yield f"{walker['name']:<21} {walker['description']}"
            continue

        yield f"{walker['name']}: {walker['description']}"
        yield walker["drawing"]
        yield from table("walker", walker["parameters"])
        yield ""
        for key, value in walker["statics"].items():
            yield f"{key:<16} {or_zero(value):.6g}"
        yield "Only a walker with zero residuals can walk at vanishing slope, and not every such walker does."
        yield "`gaitsweep tune` shows the nearest one, `gaitsweep solve` whether it walks."
