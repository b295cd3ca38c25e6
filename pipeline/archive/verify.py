"""Check that an archive is intact, complete and valid."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.archive import layout, read
from pipeline.archive.read import columns, open_archive
from pipeline.statuses import ALL_STATUSES
from tasks.accuracy import always
from tasks.registry import GAITS, VARIABLES

_CF_ATTRIBUTES = ("Conventions", "title", "institution", "source", "history", "references")
_ATTRIBUTES = (*_CF_ATTRIBUTES, "provenance", "study", "kind", "checksums")


def verify(path: Path) -> list[str]:
    """List the problems of an archive, one sentence each; empty if it is intact, complete and valid.

    Raises
    ------
    ArchiveError
        If it cannot be read or is not an archive of gaitsweep.
    """
    with open_archive(path) as file:
        return [*_attributes(file), *_dimensions(file), *_states(file), *_values(file), *_groups(file)]


def _attributes(file: Any) -> Iterator[str]:
    for name in _ATTRIBUTES:
        if not isinstance(getattr(file, name, None), str):
            yield f"The attribute `{name}` is missing."
    try:
        if not isinstance(json.loads(file.provenance), dict):
            raise ValueError
    except (AttributeError, ValueError, RecursionError):
        yield "`provenance` is not JSON."
    for name in (*_required(file), "reason_text"):
        if name not in file.variables:
            yield f"`{name}` is missing."


def _required(file: Any) -> tuple[str, ...]:
    """Variables that an archive of its kind and accuracy holds, whatever was wanted."""
    is_grid = getattr(file, "kind", "grid") == "grid"
    return always(getattr(file, "accuracy", 0.0)) if is_grid else ("status", "reason")


def _dimensions(file: Any) -> Iterator[str]:
    order = list(file.dimensions)
    for name, variable in file.variables.items():
        if [order.index(d) for d in variable.dimensions] != sorted({order.index(d) for d in variable.dimensions}):
            yield f"`{name}` has its dimensions in another order."
        for attribute in ("long_name", "units"):
            if attribute not in variable.ncattrs():
                yield f"`{name}` has no {attribute}."
    for name in file.dimensions:
        if name not in file.variables and name != "reason_index":
            yield f"The dimension `{name}` has no coordinate."


def _states(file: Any) -> Iterator[str]:
    if not {"status", "reason", "reason_text"} <= set(file.variables):
        return
    status, reason = np.asarray(file.variables["status"][...]), np.asarray(file.variables["reason"][...])
    if not np.isin(status, list(ALL_STATUSES.values())).all():
        yield "`status` holds values without a meaning."
    if reason.size and not (reason.min() >= 0 and reason.max() < len(file.dimensions["reason_index"])):
        yield "`reason` points outside its table."
    left = int(np.count_nonzero(status == ALL_STATUSES["not_attempted"]))
    if left:
        yield f"It is not complete: {left:,} values of `status` are not_attempted."
    if "gait" in file.variables and not set(file.variables["gait"][...].tolist()) <= set(GAITS):
        yield "`gait` holds unknown names."


def _values(file: Any) -> Iterator[str]:
    """Compare every checksum, and check that numbers stand only where a gait converged."""
    sums = json.loads(getattr(file, "checksums", "{}"))
    tabled = list(columns(file))
    present = {*file.variables, *tabled}
    yield from (f"`{name}` is missing." for name in sums if name not in present)
    for name in tabled:
        if layout.checksum(np.ma.getdata(file[name][...])) % 2**32 != sums.get(name) and name in sums:
            yield f"`{name}` is not as it was written."
    for name, variable in file.variables.items():
        description, misplaced, total = VARIABLES.get(name), 0, 0
        for box in read.boxes(variable) if (large := read.is_over_grid(variable)) else [()]:
            values = np.ma.getdata(variable[box] if large else variable[...])
            total += read.box_checksum(variable, values, box) if large else layout.checksum(values)
            if large and description and description.dtype == "f8":
                other = np.asarray(file.variables["status"][box]) != ALL_STATUSES["converged"]
                misplaced += int(np.count_nonzero(~np.isnan(values[other])))
        if total % 2**32 != sums.get(name):
            yield f"`{name}` is not as it was written."
        if misplaced:
            yield f"`{name}` has {misplaced:,} values where nothing converged."


def _groups(parent: Any, path: str = "") -> Iterator[str]:
    for name, group in parent.groups.items():
        for column, variable in group.variables.items():
            if "units" not in variable.ncattrs() or "long_name" not in variable.ncattrs():
                yield f"`{path}/{name}/{column}` has no units or long_name."
        yield from _groups(group, f"{path}/{name}")
