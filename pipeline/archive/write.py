"""The archive: results of a study as one CF netCDF-4 file, written as a draft and then moved into place.

Its bytes depend on the study and the results only: not on the time, paths, workers or order of arrival. It is written
region by region, so memory does not limit its size.
"""

from __future__ import annotations

import itertools
import json
import os
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from pipeline import paths, serialize
from pipeline.archive import attributes, chunks, layout, parameters, read, result_tables
from pipeline.archive.citation import PAPER
from pipeline.archive.provenance import provenance
from pipeline.archive.read import SCHEMA
from pipeline.errors import ArchiveError, DiskFullError, is_disk_full
from pipeline.plan.missing import Plan
from pipeline.statuses import ALL_STATUSES, ANSWERS
from pipeline.store import lines
from pipeline.store.rows import Outcome, TaskKey
from pipeline.study import units
from pipeline.study.model import Study
from tasks.registry import GAITS, STATUSES, VARIABLES

_FILTERS = {"zlib": True, "complevel": 1, "shuffle": True, "fletcher32": True}
#: Reason of a line on which a curve has no starting point.
_NO_CURVE = "No point to start a curve from was found, neither at the value of the walker nor at the ends of the range."


@dataclass
class Written:
    """Contents of an archive: points (or lines) by status, and failures by reason with an example of each."""

    counts: Counter[str] = field(default_factory=Counter)
    failures: Counter[str] = field(default_factory=Counter)
    examples: dict[str, str] = field(default_factory=dict)

    def add_failure(self, reason: str, n: int, example: str) -> None:
        """Count failures of one reason."""
        self.failures[reason] += n
        self.examples.setdefault(reason, example)


def write(plan: Plan, path: Path, threads: int = 1) -> Written:
    """Write the results in the journal as the archive at `path`.

    Parameters
    ----------
    plan : Plan
    path : Path
    threads : int
        Number of threads that pack chunks.

    Returns
    -------
    Written

    Raises
    ------
    ArchiveError, DiskFullError
        If it cannot be written. An earlier archive at `path` is kept.
    """
    target = path.resolve()  # replace the target of a link, not the link
    draft = paths.of(target)
    try:
        written = _write(plan, draft, threads)
        with open(draft, "rb") as file:
            os.fsync(file.fileno())
        os.replace(draft, target)
        folder = os.open(target.parent, os.O_RDONLY)
        os.fsync(folder)
        os.close(folder)
    except (OSError, RuntimeError) as error:
        free = os.statvfs(target.parent)
        if is_disk_full(error) or free.f_bavail * free.f_frsize < 1 << 20:
            raise DiskFullError(f"The disk is full: {path} is unchanged; finished results are kept.") from error
        raise ArchiveError(f"{path} cannot be written: {error}.") from error
    finally:
        paths.discard(target)
    return written


def _write(plan: Plan, draft: Path, threads: int) -> Written:
    import netCDF4

    writer = _PointWriter(plan) if plan.study.kind == "grid" else _LineWriter(plan)
    with netCDF4.Dataset(draft, "w", format="NETCDF4") as file:
        _write_header(file, plan, writer)
        writer.define(file)
        result_tables.write(file, plan)
    writer.fill(draft, threads)
    with netCDF4.Dataset(draft, "a") as file:
        _write_checksums(file, writer.sums)
    with netCDF4.Dataset(draft) as file:
        if "status" not in file.variables or file.variables["status"].dimensions != (*writer.dims,):
            raise ArchiveError(f"{draft} does not read back.")
        file.variables["status"][(-1,) * len(writer.dims)]
    return writer.written


def _write_header(file: Any, plan: Plan, writer: _PointWriter | _LineWriter) -> None:
    study = plan.study
    file.setncatts(
        {
            "Conventions": "CF-1.11",
            "title": f"gaitsweep study {study.name}",
            "institution": "gaitsweep developers",
            "source": "gaitsweep: passive dynamic walking in two dimensions, solved numerically",
            "history": "written by gaitsweep run",
            "references": PAPER,
            "gaitsweep_schema": np.int32(SCHEMA),
            "study": study.name,
            "kind": study.kind,
            "not_attempted": np.int64(writer.written.counts["not_attempted"]),
            "figures": " ".join(study.figures),
            "provenance": provenance(plan),
            **attributes.of_steps(study.steps),
        }
    )
    for name, size in writer.grid.sizes.items():
        file.createDimension(name, size)
        if name == "walker":
            _strings(file, name, name, list(study.names), "walker")
            _strings(
                file,
                "walker_units",
                name,
                ["SI" if c["si"] else "1" for c in study.checks],
                "units of each walker: SI, or 1 for any consistent ones",
            )
            continue
        axis = next(a for a in study.axes if a.name == name)
        variable = file.createVariable(name, "f8", (name,), fill_value=False, fletcher32=True)
        variable.setncatts(attributes.of_axis(name, units.is_si(study)))
        variable[:] = axis.values
    parameters.write(file, study)
    file.createDimension("reason_index", len(writer.sentences))
    _strings(file, "reason_text", "reason_index", writer.sentences, "sentences that `reason` counts from 0")


def _write_checksums(file: Any, sums: Counter[str]) -> None:
    """Write the checksum of every variable; `sums` holds those of large variables."""
    small = [name for name in (*file.variables, *read.columns(file)) if name not in sums]
    checksums = {name: layout.checksum(np.ma.getdata(file[name][...])) for name in small}
    file.checksums = json.dumps({name: n % 2**32 for name, n in {**checksums, **sums}.items()}, sort_keys=True)


def _strings(file: Any, name: str, dim: str, values: list[str], long_name: str) -> None:
    variable = file.createVariable(name, str, (dim,))
    variable.setncatts({"long_name": long_name, "units": "1"})
    variable[:] = np.array(values, object)


def _line_description(study: Study, number: int) -> str:
    """Name of a line in messages: its walker and parameters."""
    return " ".join([study.name_of(number), *(f"{key}={value!r}" for key, value in study.line(number)["set"].items())])


class _PointWriter:
    """Writes the main group of a study of kind `grid`."""

    def __init__(self, plan: Plan):
        self.plan, self.study, self.grid = plan, plan.study, layout.Grid(plan.study)
        self.written = Written()
        self.sums: Counter[str] = Counter()
        self.shapes: dict[str, tuple[int, ...]] = {}
        self.dtypes: dict[str, np.dtype] = {}
        self.columns = [GAITS.index(g) for g in self.study.gaits]
        others_wanted = "other" in " ".join(self.study.gaits) and len(self.study.gaits) < len(GAITS)
        is_solved = np.array([others_wanted or not GAITS[c].startswith("other") for c in self.columns])
        solved = [code for name, code in STATUSES.items() if name != "no_gait"]
        sentences: set[str] = set()
        for box in layout.regions(self.grid.sizes):
            for _, numbers, data in self._lines(box, ()):
                status, reason = (
                    data[name][..., self.columns].reshape(-1, len(self.columns)) for name in ("status", "reason")
                )
                rows = lines.rows(status)
                self.written.counts += lines.count(status)
                is_solved |= np.isin(list(rows), solved).any(axis=0)
                sentences.update(data["reasons"][np.flatnonzero(np.bincount(reason.ravel()))].tolist())
                if not set(ANSWERS).issuperset(itertools.chain(*rows)):
                    self._count_failures(numbers, data, status, reason)
        self.sentences = sorted(sentences)
        self.columns = self.columns[: max(np.flatnonzero(is_solved), default=0) + 1]
        self.dims = (*self.grid.sizes, "gait")

    def _count_failures(
        self, numbers: np.ndarray, data: dict[str, Any], status: np.ndarray, reason: np.ndarray
    ) -> None:
        failed, slopes = ~np.isin(status, ANSWERS), data["slope"]
        rows = np.flatnonzero(failed.any(axis=1))
        reasons = reason[rows, failed[rows].argmax(axis=1)]
        for k in np.unique(reasons):
            failed_rows = rows[reasons == k]
            line, slope = divmod(int(failed_rows[0]), len(slopes))
            example = f"{_line_description(self.study, int(numbers[line]))} slope={float(slopes[slope])!r}"
            self.written.add_failure(str(data["reasons"][k]), len(failed_rows), example)

    def _lines(
        self, box: layout.Box, names: tuple[str, ...]
    ) -> Iterator[tuple[tuple[np.ndarray, ...], np.ndarray, dict[str, Any]]]:
        """Points of the lines in a box, some lines at a time: their indices in the box, numbers and data."""
        indices, numbers = self.grid.lines_in(box)
        for part, data in self.plan.read(numbers, names, self.grid.slopes(box), max(self.columns) + 1):
            yield tuple(index[part] for index in indices), numbers[part], data

    def define(self, file: Any) -> None:
        """Create every variable, without values."""
        multipliers = max(c["multipliers"] for c in self.study.checks)
        file.createDimension("gait", len(self.columns))
        _strings(file, "gait", "gait", [GAITS[c] for c in self.columns], "gait by its character")
        names = self.plan.variables
        if any("multiplier" in VARIABLES[n].dims for n in names):
            file.createDimension("multiplier", multipliers)
            multiplier = file.createVariable("multiplier", "i4", ("multiplier",), fill_value=False)
            multiplier.setncatts({"long_name": "number of the eigenvalue, largest magnitude first", "units": "1"})
            multiplier[:] = np.arange(multipliers)
        is_si, is_mixed = units.is_si(self.study), len({c["si"] for c in self.study.checks}) > 1
        chunk = layout.chunk_shape(self.grid.sizes, layout.CHUNK)
        for name in names:
            description = VARIABLES[name]
            is_wide = name == "reason" and len(self.sentences) > np.iinfo(np.int16).max
            gait_and_multiplier = [len(self.columns), multipliers][: len(description.dims)]
            variable = file.createVariable(
                name,
                "i4" if is_wide else description.dtype,
                (*self.grid.sizes, *description.dims),
                **_FILTERS,
                chunksizes=(*chunk, *gait_and_multiplier),
                fill_value=np.nan if description.dtype == "f8" else False,
            )
            self.shapes[name], self.dtypes[name] = tuple(variable.chunking()), variable.dtype
            variable.setncatts(attributes.of_variable(description, is_si, is_mixed, self.study.steps))

    def fill(self, draft: Path, threads: int) -> None:
        """Write values region by region; while one region is packed the next is assembled."""
        previous: list[tuple[str, tuple[int, ...], Future[bytes]]] = []
        with ThreadPoolExecutor(threads) as pool, chunks.Chunks(draft) as out:
            for box in [*layout.regions(self.grid.sizes), ()]:
                region = self._region(box) if box else {}
                sums = {name: pool.submit(layout.checksum, values, box) for name, values in region.items()}
                packing = [
                    (name, corner, pool.submit(chunks.pack, part))
                    for name, values in region.items()
                    for corner, part in chunks.split(values, box, self.shapes[name])
                ]
                for name, corner, data in previous:
                    out.write(name, corner, data.result())
                previous = packing
                self.sums.update({name: checksum.result() for name, checksum in sums.items()})

    def _region(self, box: layout.Box) -> dict[str, np.ndarray]:
        """Values of every variable in a box."""
        extent = tuple(s.stop - s.start for s in box)
        values = {
            name: np.empty((*extent, max(self.columns) + 1, *shape[len(box) + 1 :]), self.dtypes[name])
            for name, shape in self.shapes.items()
        }
        views = {name: self.grid.slope_last(v) for name, v in values.items()}
        index = {sentence: i for i, sentence in enumerate(self.sentences)}
        for position, _, data in self._lines(box, tuple(n for n in values if n not in ("status", "reason"))):
            table = np.array([index.get(s, 0) for s in data["reasons"].tolist()])
            data["reason"] = table[data["reason"]]
            for name, view in views.items():
                view[position] = data[name] if position else data[name][0]
        if self.columns == list(range(len(self.columns))):
            return values
        return {name: v.take(self.columns, axis=len(box)) for name, v in values.items()}


class _LineWriter:
    """Writes the main group of a study of another kind: the outcome of each line."""

    def __init__(self, plan: Plan):
        self.plan, self.study, self.grid = plan, plan.study, layout.Grid(plan.study)
        self.dims, self.sums = tuple(self.grid.sizes), Counter[str]()
        ends: list[tuple[str, str]] = [("", "")] * plan.study.lines
        for i in range(plan.study.batches):
            end = self._outcome(plan.line_keys(i))
            for number in plan.study.batch(i).tolist():
                ends[number] = end
        self.sentences = sorted({reason for _, reason in ends})
        shape = tuple(self.grid.sizes.values())
        self.status = np.array([ALL_STATUSES[status] for status, _ in ends], np.int8).reshape(shape)
        self.reason = np.array([self.sentences.index(reason) for _, reason in ends], np.int16).reshape(shape)
        self.written = Written(Counter(status for status, _ in ends))
        for i, (status, reason) in enumerate(ends):
            if ALL_STATUSES[status] not in ANSWERS:
                self.written.add_failure(reason, 1, _line_description(plan.study, i))

    def _outcome(self, keys: dict[str, TaskKey]) -> tuple[str, str]:
        for name in ("atlas", self.study.kind):
            outcome = self.plan.journal.outcome(keys[name].key) if name in keys else Outcome("ok", "", 0)
            if outcome is None:
                return "not_attempted", lines.NOT_ATTEMPTED
            if outcome.status != "ok":
                return outcome.status, lines.of_atlas(outcome.reason) if name == "atlas" else outcome.reason
        if self.study.kind == "curve":
            result = self.plan.journal.result(keys["curve"].key)
            if result is not None and not len(serialize.load(result.data)["curves/slope"]):
                return "converged", _NO_CURVE
        return "converged", "The line was followed; its results are in the groups."

    def define(self, file: Any) -> None:
        """Create and write every variable."""
        for name, values in (("status", self.status), ("reason", self.reason)):
            variable = file.createVariable(name, values.dtype, self.dims, fill_value=False)
            variable.setncatts(attributes.of_variable(VARIABLES[name], True))
            variable[...] = values

    def fill(self, draft: Path, threads: int) -> None:
        """Do nothing: all values are written by `define`."""
