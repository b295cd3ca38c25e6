"""The archive: a study's results as one CF netCDF-4 file, written beside its name and then moved there.

Everything in it follows from the study and the results: no clock, path, worker count or order of arrival. It
is written region by region, so its size is not bounded by memory.
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
from pipeline.archive import chunks, layout, read, result_tables
from pipeline.archive.citation import PAPER
from pipeline.archive.provenance import provenance
from pipeline.archive.read import SCHEMA
from pipeline.errors import ArchiveError, DiskFullError
from pipeline.plan.missing import Plan
from pipeline.statuses import ALL_STATUSES, ANSWERS
from pipeline.store import lines
from pipeline.study.model import Study
from tasks.registry import GAITS, PROVED, STATUSES, VARIABLES, VIOLATIONS, Variable

_PACKED = {"zlib": True, "complevel": 1, "shuffle": True, "fletcher32": True}
#: What is said of a line on which a curve could not begin.
NO_CURVE = "None of the points to follow was found, neither at the walker's own value nor at the range's ends."
_LONG_NAMES = {
    "slope": "slope of the ground",
    "foot_mass_ratio": "mass of each foot over the total mass",
    "detuning": "mixture of the exactly tuned walker (0) and the physical one (1)",
}


@dataclass
class Written:
    """What stands in an archive: points (or lines) by status, and the failed ones by reason, with one of each."""

    counts: Counter[str] = field(default_factory=Counter)
    failures: Counter[str] = field(default_factory=Counter)
    examples: dict[str, str] = field(default_factory=dict)

    def fail(self, reason: str, n: int, example: str) -> None:
        """Count failures of one reason."""
        self.failures[reason] += n
        self.examples.setdefault(reason, example)


def write(plan: Plan, path: Path, threads: int = 1) -> Written:
    """Write the archive of what the journal holds and put it at `path`; so many threads pack its chunks.

    Raises
    ------
    ArchiveError, DiskFullError
        If it cannot be written. What was at `path` stays.
    """
    place = path.resolve()  # what a link leads to is replaced, not the link
    draft = paths.of(place)
    try:
        written = _write(plan, draft, threads)
        with open(draft, "rb") as file:
            os.fsync(file.fileno())
        os.replace(draft, place)
        folder = os.open(place.parent, os.O_RDONLY)
        os.fsync(folder)
        os.close(folder)
    except (OSError, RuntimeError) as error:
        free = os.statvfs(place.parent)
        if getattr(error, "errno", None) == 28 or free.f_bavail * free.f_frsize < 1 << 20:
            raise DiskFullError(f"The disk is full: {path} stays as it was; what was finished is kept.") from error
        raise ArchiveError(f"{path} cannot be written: {error}.") from error
    finally:
        paths.discard(place)
    return written


def _write(plan: Plan, draft: Path, threads: int) -> Written:
    import netCDF4

    writer = _Points(plan) if plan.study.kind == "grid" else _Lines(plan)
    with netCDF4.Dataset(draft, "w", format="NETCDF4") as file:
        _head(file, plan, writer)
        writer.define(file)
        result_tables.write(file, plan)
    writer.fill(draft, threads)
    with netCDF4.Dataset(draft, "a") as file:
        _seal(file, writer.sums)
    with netCDF4.Dataset(draft) as file:
        if "status" not in file.variables or file.variables["status"].dimensions != (*writer.dims,):
            raise ArchiveError(f"{draft} does not read back.")
        file.variables["status"][(-1,) * len(writer.dims)]
    return writer.written


def _head(file: Any, plan: Plan, writer: _Points | _Lines) -> None:
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
        long_name = _LONG_NAMES.get(name, f"walker's {name}")
        variable.setncatts({"long_name": long_name, "units": layout.axis_units(study, name)})
        variable[:] = axis.values
    file.createDimension("reason_index", len(writer.sentences))
    _strings(file, "reason_text", "reason_index", writer.sentences, "sentences that `reason` counts from 0")


def _seal(file: Any, sums: Counter[str]) -> None:
    """Write the checksum of every variable; `sums` holds those of the large ones."""
    small = [name for name in (*file.variables, *read.columns(file)) if name not in sums]
    whole = {name: layout.checksum(np.ma.getdata(file[name][...])) for name in small}
    file.checksums = json.dumps({name: n % 2**32 for name, n in {**whole, **sums}.items()}, sort_keys=True)


def _strings(file: Any, name: str, dim: str, values: list[str], long_name: str) -> None:
    variable = file.createVariable(name, str, (dim,))
    variable.setncatts({"long_name": long_name, "units": "1"})
    variable[:] = np.array(values, object)


def _describe(variable: Any, about: Variable, si: bool, mixed: bool) -> None:
    variable.setncatts({"long_name": about.long_name, "units": about.units(si)})
    if about.name == "status":
        variable.setncatts(
            {"flag_values": np.array(list(ALL_STATUSES.values()), np.int8), "flag_meanings": " ".join(ALL_STATUSES)}
        )
    elif about.name == "proved":
        variable.setncatts({"flag_values": np.array(list(PROVED.values()), np.int8), "flag_meanings": " ".join(PROVED)})
    elif about.name == "violations":
        variable.setncatts(
            {
                "flag_masks": np.array([1 << i for i in range(len(VIOLATIONS))], np.int32),
                "flag_meanings": " ".join(VIOLATIONS),
            }
        )
    if about.name not in ("status", "reason"):
        variable.ancillary_variables = "status reason"
    if mixed and about.kind not in ("number", "angle"):
        variable.comment = "in the units of each walker: see walker_units"


def _spot(study: Study, number: int) -> str:
    """A line as a user would name it."""
    return " ".join([study.name_of(number), *(f"{key}={value!r}" for key, value in study.line(number)["set"].items())])


class _Points:
    """The main group of a grid study."""

    def __init__(self, plan: Plan):
        self.plan, self.study, self.grid = plan, plan.study, layout.Grid(plan.study)
        self.written = Written()
        self.sums: Counter[str] = Counter()
        self.shapes: dict[str, tuple[int, ...]] = {}
        self.dtypes: dict[str, np.dtype] = {}
        self.columns = [GAITS.index(g) for g in self.study.gaits]
        asked = "other" in " ".join(self.study.gaits) and len(self.study.gaits) < len(GAITS)
        live = np.array([asked or not GAITS[c].startswith("other") for c in self.columns])
        solved = [code for name, code in STATUSES.items() if name != "no_gait"]
        used: set[str] = set()
        for box in layout.boxes(self.grid.sizes):
            for _, number, found in self._lines(box, ()):
                status, reason = found["status"][:, self.columns], found["reason"][:, self.columns]
                rows = lines.rows(status)
                self.written.counts += lines.count(status)
                live |= np.isin(list(rows), solved).any(axis=0)
                used.update(found["reasons"][np.flatnonzero(np.bincount(reason.ravel()))].tolist())
                if not set(ANSWERS).issuperset(itertools.chain(*rows)):
                    self._note_failures(number, found, status, reason)
        self.sentences = sorted(used)
        self.columns = self.columns[: max(np.flatnonzero(live), default=0) + 1]
        self.dims = (*self.grid.sizes, "gait")

    def _note_failures(self, number: int, found: dict[str, Any], status: np.ndarray, reason: np.ndarray) -> None:
        failed = ~np.isin(status, ANSWERS)
        rows = np.flatnonzero(failed.any(axis=1))
        reasons = reason[rows, failed[rows].argmax(axis=1)]
        for k in np.unique(reasons):
            those = rows[reasons == k]
            self.written.fail(
                str(found["reasons"][k]),
                len(those),
                f"{_spot(self.study, number)} slope={float(found['slope'][those[0]])!r}",
            )

    def _lines(self, box: layout.Box, names: tuple[str, ...]) -> Iterator[tuple[tuple[int, ...], int, dict[str, Any]]]:
        slopes = self.grid.slopes(box)
        for place, number in self.grid.lines_in(box):
            keys = self.plan.line_keys(number)
            yield (
                place,
                number,
                lines.line(self.plan.journal, keys, self.plan.want, self.study, names, slopes, max(self.columns) + 1),
            )

    def define(self, file: Any) -> None:
        """Create every variable, without values."""
        multipliers = max(c["multipliers"] for c in self.study.checks)
        file.createDimension("gait", len(self.columns))
        _strings(file, "gait", "gait", [GAITS[c] for c in self.columns], "gait by its character")
        names = self.plan.variables
        if any("multiplier" in VARIABLES[n].dims for n in names):
            file.createDimension("multiplier", multipliers)
            number = file.createVariable("multiplier", "i4", ("multiplier",), fill_value=False)
            number.setncatts({"long_name": "number of the eigenvalue, largest magnitude first", "units": "1"})
            number[:] = np.arange(multipliers)
        si, mixed = layout.si(self.study), len({c["si"] for c in self.study.checks}) > 1
        chunk = layout.cut(self.grid.sizes, layout.CHUNK)
        for name in names:
            about = VARIABLES[name]
            wide = name == "reason" and len(self.sentences) > np.iinfo(np.int16).max
            extra = [len(self.columns), multipliers][: len(about.dims)]
            variable = file.createVariable(
                name,
                "i4" if wide else about.dtype,
                (*self.grid.sizes, *about.dims),
                **_PACKED,
                chunksizes=(*chunk, *extra),
                fill_value=np.nan if about.dtype == "f8" else False,
            )
            self.shapes[name], self.dtypes[name] = tuple(variable.chunking()), variable.dtype
            _describe(variable, about, si, mixed)

    def fill(self, draft: Path, threads: int) -> None:
        """Write the values region by region; while one is packed the next is put together."""
        before: list[tuple[str, tuple[int, ...], Future[bytes]]] = []
        with ThreadPoolExecutor(threads) as pool, chunks.Chunks(draft) as out:
            for box in [*layout.boxes(self.grid.sizes), ()]:
                region = self._region(box) if box else {}
                sums = {name: pool.submit(layout.checksum, values, box) for name, values in region.items()}
                now = [
                    (name, corner, pool.submit(chunks.packed, part))
                    for name, values in region.items()
                    for corner, part in chunks.cut(values, box, self.shapes[name])
                ]
                for name, corner, data in before:
                    out.write(name, corner, data.result())
                before = now
                self.sums.update({name: found.result() for name, found in sums.items()})

    def _region(self, box: layout.Box) -> dict[str, np.ndarray]:
        """Every variable in a box."""
        extent = tuple(s.stop - s.start for s in box)
        values = {
            name: np.empty((*extent, max(self.columns) + 1, *shape[len(box) + 1 :]), self.dtypes[name])
            for name, shape in self.shapes.items()
        }
        lined_up = {name: self.grid.lined_up(v) for name, v in values.items()}
        index = {sentence: i for i, sentence in enumerate(self.sentences)}
        for place, _, found in self._lines(box, tuple(n for n in values if n not in ("status", "reason"))):
            table = np.array([index.get(s, 0) for s in found["reasons"].tolist()])
            found["reason"] = table[found["reason"]]
            for name, along in lined_up.items():
                along[place] = found[name]
        if self.columns == list(range(len(self.columns))):
            return values
        return {name: v.take(self.columns, axis=len(box)) for name, v in values.items()}


class _Lines:
    """The main group of a study of another kind: what became of each line."""

    def __init__(self, plan: Plan):
        self.plan, self.study, self.grid = plan, plan.study, layout.Grid(plan.study)
        self.dims, self.sums = tuple(self.grid.sizes), Counter[str]()
        ends = [self._end(plan.line_keys(i)) for i in range(plan.study.lines)]
        self.sentences = sorted({reason for _, reason in ends})
        shape = tuple(self.grid.sizes.values())
        self.status = np.array([ALL_STATUSES[status] for status, _ in ends], np.int8).reshape(shape)
        self.reason = np.array([self.sentences.index(reason) for _, reason in ends], np.int16).reshape(shape)
        self.written = Written(Counter(status for status, _ in ends))
        for i, (status, reason) in enumerate(ends):
            if ALL_STATUSES[status] not in ANSWERS:
                self.written.fail(reason, 1, _spot(plan.study, i))

    def _end(self, keys: dict[str, tuple[str, str]]) -> tuple[str, str]:
        for name in ("atlas", self.study.kind):
            found = self.plan.journal.outcome(keys[name][0]) if name in keys else ("ok", "", 0)
            if found is None:
                return "not_attempted", lines.NOT_ATTEMPTED
            if found[0] != "ok":
                return found[0], f"{'The atlas of the line: ' if name == 'atlas' else ''}{found[1]}"
        if self.study.kind == "curve":
            result = self.plan.journal.result(keys["curve"][0])
            if result is not None and not len(serialize.load(result.data)["curves/slope"]):
                return "converged", NO_CURVE
        return "converged", "The line was followed; what was found is in the groups."

    def define(self, file: Any) -> None:
        """Create and write every variable."""
        for name, values in (("status", self.status), ("reason", self.reason)):
            variable = file.createVariable(name, values.dtype, self.dims, fill_value=False)
            _describe(variable, VARIABLES[name], True, False)
            variable[...] = values

    def fill(self, draft: Path, threads: int) -> None:
        """Nothing is left to be written."""
