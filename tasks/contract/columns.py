"""Columns of tables: kind of quantity (`tasks.contract.registry.SI_UNITS`) and meaning, as
`columns.toml` lists them.

A column is looked up as "group/column", then by its own name, then among the variables
of grid studies and the walker's keys. Like the registry, this module imports no solver.
"""

import functools
import tomllib
from pathlib import Path


@functools.cache
def table_columns() -> dict[str, list[str]]:
    """Kind and meaning by "group/column" or column; grids of points do without."""
    return tomllib.loads(
        Path(__file__).with_suffix(".toml").read_text(encoding="utf-8")
    )
