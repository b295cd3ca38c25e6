"""Check that an archive is intact, complete and valid."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.archive import layout, read, structure
from pipeline.archive.read import columns, open_archive
from pipeline.statuses import FOUND
from tasks.registry import VARIABLES, Variable

#: Statuses of gaits that were found, whose values stand in the archive; of others it holds none.
#: What every gait has that an archive holds at all.
_ALWAYS = ("stance_angle", "stance_rate", "thigh_rate", "shank_rate", "period")


def verify(path: Path) -> list[str]:
    """List the problems of an archive, one sentence each; empty if it is intact, complete and valid.

    Raises
    ------
    ArchiveError
        If it cannot be read or is not an archive of gaitsweep.
    """
    with open_archive(path) as file:
        return [*structure.misfits(file), *_values(file)]


def _values(file: Any) -> Iterator[str]:
    """Compare every checksum, and check that numbers stand only where a gait was found."""
    sums = json.loads(getattr(file, "checksums", "{}"))
    tabled = list(columns(file))
    present = {*file.variables, *tabled}
    yield from (f"`{name}` is missing." for name in sums if name not in present)
    for name in tabled:
        if layout.checksum(np.ma.getdata(file[name][...])) % 2**32 != sums.get(name) and name in sums:
            yield f"`{name}` is not as it was written."
    for name, variable in file.variables.items():
        description, misplaced, impossible, total = VARIABLES.get(name), 0, 0, 0
        for box in read.boxes(variable) if (large := read.is_over_grid(variable)) else [()]:
            values = np.ma.getdata(variable[box] if large else variable[...])
            total += read.box_checksum(variable, values, box) if large else layout.checksum(values)
            if large and description and description.dtype == "f8":
                other = ~np.isin(file.variables["status"][box], FOUND)
                misplaced += int(np.count_nonzero(~np.isnan(values[other])))
                impossible += int(np.count_nonzero(_is_impossible(description, values[~other])))
        if total % 2**32 != sums.get(name):
            yield f"`{name}` is not as it was written."
        if misplaced:
            yield f"`{name}` has {misplaced:,} values where nothing converged."
        if impossible:
            yield f"`{name}` has {impossible:,} values that no gait has."


def _is_impossible(description: Variable, values: np.ndarray) -> np.ndarray:
    """Values of gaits that were found: none with a unit is infinite, and each gait has an angle, rates and a period."""
    is_infinite = np.isinf(values) & (description.kind != "number")
    return is_infinite | (np.isnan(values) & (description.name in _ALWAYS))
