"""Check that an archive is intact, complete and valid."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from gaitsweep.pipeline.archive import layout, read, structure
from gaitsweep.pipeline.archive.read import open_archive
from gaitsweep.pipeline.statuses import FOUND
from gaitsweep.tasks.contract.registry import VARIABLES, Variable

#: What every gait has that an archive holds at all.
_ALWAYS = ("stance_angle", "stance_rate", "thigh_rate", "shank_rate", "period")


def verify(path: Path) -> list[str]:
    """List the problems of an archive, one sentence each; empty if it is intact,
    complete and valid.

    Raises
    ------
    ArchiveError
        If it cannot be read or is not an archive of gaitsweep.
    """
    with open_archive(path) as file:
        return [
            *structure.misfits(file),
            *_unlisted(file),
            *read.changes(file),
            *_out_of_place(file),
        ]


def _unlisted(file: Any) -> Iterator[str]:
    """Variables without a checksum."""
    sums = json.loads(getattr(file, "checksums", "{}"))
    yield from (
        f"`{name}` is not as it was written."
        for name, _ in layout.variables(file)
        if name not in sums
    )


def _out_of_place(file: Any) -> Iterator[str]:
    """Check that numbers stand only where a gait was found, and that they are such as
    gaits have.
    """
    for name, variable in file.variables.items():
        description, misplaced, impossible = VARIABLES.get(name), 0, 0
        if (
            not description
            or description.dtype != "f8"
            or not read.is_over_grid(variable)
        ):
            continue

        for box in read.boxes(variable):
            values, other = (
                np.ma.getdata(variable[box]),
                ~np.isin(file.variables["status"][box], FOUND),
            )
            misplaced += int(np.count_nonzero(~np.isnan(values[other])))
            impossible += int(
                np.count_nonzero(_is_impossible(description, values[~other]))
            )

        if misplaced:
            yield f"`{name}` has {misplaced:,} values where nothing converged."
        if impossible:
            yield f"`{name}` has {impossible:,} values that no gait has."


def _is_impossible(description: Variable, values: np.ndarray) -> np.ndarray:
    """Values of gaits that were found: none with a unit is infinite, and each gait has
    an angle, rates and a period.
    """
    is_infinite = np.isinf(values) & (description.kind != "number")
    return is_infinite | (np.isnan(values) & (description.name in _ALWAYS))
