"""The archive: results of a study as one CF netCDF-4 file, written as a draft and then
moved into place.

Its bytes depend on the study and the results only: not on the time, paths, workers or
order of arrival. It is written chunk by chunk, so memory does not limit its size.
"""

import contextlib
import hashlib
import json
import os
import zlib
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from gaitsweep.pipeline import paths
from gaitsweep.pipeline.archive import (
    attributes,
    layout,
    parameters,
    read,
    result_tables,
)
from gaitsweep.pipeline.archive.points import PointWriter
from gaitsweep.pipeline.archive.provenance import code_digest, provenance
from gaitsweep.pipeline.archive.read import SCHEMA
from gaitsweep.pipeline.archive.written import (
    Sentences,
    Written,
    line_description,
    write_strings,
    write_variable,
)
from gaitsweep.pipeline.errors import (
    ArchiveError,
    DiskFullError,
    is_disk_full,
    shortage,
    unwritten,
)
from gaitsweep.pipeline.graph.plan import Plan
from gaitsweep.pipeline.outcomes import FOLLOWED
from gaitsweep.pipeline.statuses import ALL_STATUSES, ANSWERS, NOT_ATTEMPTED, of_atlas
from gaitsweep.pipeline.store.points import sentence_number
from gaitsweep.pipeline.study import corners
from gaitsweep.pipeline.study.model import Study
from gaitsweep.tasks.contract.registry import VARIABLES


def update(plan: Plan, path: Path) -> Written:
    """Write the results in the store as `write` does, unless the archive at `path` was
    last written of the same ones.

    What it was written of is noted in the store, with the checksum of its bytes.
    """
    study = plan.study
    measured = {name: column.tolist() for name, column in study.overlay.items()}
    # Names, units and meanings are in the tables of all folders, and of measures of
    # other packages in these.
    code = code_digest("pipeline"), code_digest("tasks")
    others = {
        v.name: attributes.of_variable(v, study)
        for v in VARIABLES.values()
        if v.measure
    }
    origin = provenance(plan), study.accuracy, measured, plan.store.last, code, others
    results = hashlib.sha256(repr(origin).encode()).hexdigest()
    with plan.store.reading():
        *noted, contents = json.loads(plan.store.note("archive") or "[null]")
        if noted and noted == [results, _checksum(path)]:
            counts, failures, examples = contents
            return Written(Counter(counts), Counter(failures), examples)

    written = write(plan, path)
    if (checksum := _checksum(path)) is not None:
        contents = [written.counts, written.failures, written.examples]
        plan.store.set_note("archive", json.dumps([results, checksum, contents]))

    return written


def _checksum(path: Path) -> int | None:
    """Checksum of a file; None if it cannot be read."""
    with contextlib.suppress(OSError), open(path, "rb") as file:
        checksum = 0
        while part := file.read(1 << 20):
            checksum = zlib.crc32(part, checksum)
        return checksum
    return None


def write(plan: Plan, path: Path) -> Written:
    """Write the results in the store as the archive at `path`.

    Parameters
    ----------
    plan : Plan
    path : Path

    Returns
    -------
    Written

    Raises
    ------
    ArchiveError, DiskFullError, WorkerError
        If it cannot be written. An earlier archive at `path` is kept.
    """
    target = _target(path)
    draft = paths.of(target)
    try:
        read.check_replaceable(target)
        written = _write(plan, draft)
        with open(draft, "rb") as file:
            os.fsync(file.fileno())
        os.replace(draft, target)
        folder = os.open(target.parent, os.O_RDONLY)
        os.fsync(folder)
        os.close(folder)
    except (OSError, RuntimeError, MemoryError) as error:
        cause = shortage(error, draft)
        if cause and is_disk_full(cause):
            raise DiskFullError(
                f"The disk is full: {path} is unchanged; finished results are kept."
            ) from error
        if cause:
            raise unwritten(path, cause) from error

        raise ArchiveError(f"{path} cannot be written: {error}.") from error
    finally:
        paths.discard(target)

    return written


def check_path(path: Path) -> None:
    """Check, before anything is computed, that an archive can be written at `path`.

    Raises
    ------
    ArchiveError, DiskFullError, WorkerError
        If it cannot.
    """
    target = _target(path)
    if not read.is_nameable(target):
        raise ArchiveError(
            f"{path} cannot be written: the netCDF library opens no file of such a name."
        )

    try:
        paths.of(target).touch()
    except OSError as error:
        raise unwritten(path, OSError(error.errno, error.strerror)) from error
    finally:
        paths.discard(target)


def _target(path: Path) -> Path:
    """The file to replace, or a link's target; otherwise as given: the folder may have
    any name.
    """
    if path.is_symlink():
        return path.resolve()
    return path


def _write(plan: Plan, draft: Path) -> Written:
    writer = PointWriter(plan) if plan.study.kind == "grid" else _LineWriter(plan)
    with read.open_netcdf(draft, "w") as file:
        _write_header(file, plan, writer)
        writer.define(file)
        result_tables.write(file, plan)
        wanted = _described(file)

    writer.fill(draft)
    with read.open_netcdf(draft, "a") as file:
        wanted["attributes"] |= _write_checksums(file, writer)
    # Short of memory, HDF5 may silently omit an attribute.
    with read.open_netcdf(draft) as file:
        if _described(file) != wanted:
            raise RuntimeError("it does not read back")
        file.variables["status"][(-1,) * len(writer.dims)]

    return writer.written


def _described(group: Any) -> dict[str, Any]:
    """Dimensions, attributes, variables and groups of an open group, all but the values
    of its variables.
    """
    return {
        "attributes": _attributes(group),
        "dimensions": {
            name: len(dimension) for name, dimension in group.dimensions.items()
        },
        "variables": {
            n: (str(v.dtype), v.dimensions, _attributes(v))
            for n, v in group.variables.items()
        },
        "groups": {name: _described(below) for name, below in group.groups.items()},
    }


def _attributes(owner: Any) -> dict[str, str]:
    # netCDF notes how it rounded values, when it closes the file.
    own = (name for name in owner.ncattrs() if not name.startswith("_Quantize"))
    return {name: repr(owner.getncattr(name)) for name in own}


def _write_header(file: Any, plan: Plan, writer: "PointWriter | _LineWriter") -> None:
    study = plan.study
    about: dict[str, Any] = {
        **attributes.of_dataset(study),
        "title": f"gaitsweep study {study.name}",
        "institution": "gaitsweep developers",
        "history": "written by gaitsweep run",
        "gaitsweep_schema": np.int32(SCHEMA),
        "study": study.name,
        "kind": study.kind,
        "not_attempted": np.int64(writer.written.counts["not_attempted"]),
        "figures": " ".join(study.figures),
        "provenance": provenance(plan),
    }
    notes = corners.notes(study)
    if notes:
        about["walker_notes"] = "\n".join(notes)
    attributes.put(file, about)

    for name, size in writer.grid.sizes.items():
        file.createDimension(name, size)
        if name == "walker":
            _write_walkers(file, study)
        else:
            _write_axis(file, study, name)

    parameters.write(file, study)

    texts = writer.sentences.texts
    file.createDimension("reason_index", len(texts))
    write_strings(file, "reason_text", "reason_index", texts, attributes.REASON_TEXT)


def _write_walkers(file: Any, study: Study) -> None:
    """Write the names of the walkers of a study, and their units."""
    about = {"long_name": "walker", "units": "1"}
    write_strings(file, "walker", "walker", study.names, about)
    units = ["SI" if check["si"] else "1" for check in study.checks]
    about = {
        "long_name": "units of each walker: SI, or 1 for any consistent ones",
        "units": "1",
    }
    write_strings(file, "walker_units", "walker", units, about)


def _write_axis(file: Any, study: Study, name: str) -> None:
    """Write the values of an axis of numbers."""
    (axis,) = (axis for axis in study.axes if axis.name == name)
    about = attributes.of_axis(name, study.checks)
    values = axis.values.astype(float)
    write_variable(file, name, (name,), values, about, fletcher32=True)


def _write_checksums(file: Any, writer: "PointWriter | _LineWriter") -> dict[str, str]:
    """Write the checksum of every variable, and the shape of the chunks whose sums are
    those of large variables.

    Returns
    -------
    dict of str
        These attributes, as `_attributes` has them.
    """
    sums = writer.sums
    file.set_auto_mask(False)  # a mask is as long as a line
    small = (
        (name, variable)
        for name, variable in layout.variables(file)
        if name not in sums
    )
    checksums = {
        name: layout.checksum(np.ma.getdata(variable[...])) for name, variable in small
    }
    about: dict[str, Any] = {}
    if isinstance(writer, PointWriter):
        about["checksum_chunk"] = np.array(writer.chunk, np.int64)
    modulo = {name: n % 2**32 for name, n in {**checksums, **sums}.items()}
    about["checksums"] = json.dumps(modulo, sort_keys=True)
    attributes.put(file, about)

    return {
        name: value
        for name, value in _attributes(file).items()
        if name.startswith("checksum")
    }


class _LineWriter:
    """Writes the main group of a study of another kind: the outcome of each line."""

    def __init__(self, plan: Plan):
        self.plan = plan
        self.study = plan.study
        self.grid = plan.graph.grid
        self.dims = tuple(self.grid.sizes)
        self.sums = Counter[str]()

        ends = self._outcomes()
        shape = tuple(self.grid.sizes.values())
        codes = [ALL_STATUSES[status] for status, _ in ends]
        self.status = np.array(codes, np.int8).reshape(shape)

        numbers = [sentence_number(reason) for _, reason in ends]
        reasons = [reason for _, reason in ends]
        self.sentences = Sentences(dict(zip(numbers, reasons, strict=True)))
        renumbered = self.sentences.renumbered(np.array(numbers, np.uint64))
        self.reason = renumbered.reshape(shape)

        self.written = Written(Counter(status for status, _ in ends))
        for i, (code, reason) in enumerate(zip(codes, reasons, strict=True)):
            if code not in ANSWERS:
                self.written.add_failure(reason, 1, line_description(plan.study, i))

    def _outcomes(self) -> list[tuple[str, str]]:
        """How every line ended, and why."""
        ends = [("", "")] * self.study.lines
        for i in range(self.study.batches):
            end = self._outcome(self.plan.graph.line_keys(i))
            for number in self.study.batch(i).tolist():
                ends[number] = end
        return ends

    def _outcome(self, keys: dict[str, str]) -> tuple[str, str]:
        # Of a study whose own result is known, the atlas may be lost, or never have
        # been needed.
        tasks = ["atlas", self.study.kind]
        if keys[self.study.kind] in self.plan.store:
            tasks.remove("atlas")
        for name in tasks:
            if name not in keys:
                continue

            outcome = self.plan.store.outcome(keys[name])
            if outcome is None:
                return "not_attempted", NOT_ATTEMPTED
            if outcome.status != "ok":
                reason = outcome.reason
                if name == "atlas":
                    reason = of_atlas(reason)
                return outcome.status, reason

        result = self.plan.store.result(keys[self.study.kind])
        with self.plan.store.reading():
            for reason in (result or {}).get("nothing/reason", ()):
                return "no_gait", str(reason)
            for reason in (result or {}).get("partly/reason", ()):
                return "converged", f"{FOLLOWED} {reason}"

        return "converged", FOLLOWED

    def define(self, file: Any) -> None:
        """Create and write every variable."""
        for name, values in (("status", self.status), ("reason", self.reason)):
            about = attributes.of_variable(VARIABLES[name], self.study)
            write_variable(file, name, self.dims, values, about)

    def fill(self, draft: Path) -> None:
        """Do nothing: all values are written by `define`."""
