"""The main group of a study of kind `grid`: every variable over the grid and its gaits, in packed chunks.

A chunk that a worker has finished is copied from the journal, unopened. Others are assembled from the journal's
blocks, region by region, and packed in threads; both ways give the same bytes.
"""

from __future__ import annotations

import functools
import itertools
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.archive import attributes, chunks, layout
from pipeline.archive.written import Written, line_description, write_strings
from pipeline.plan.missing import Plan
from pipeline.statuses import ALL_STATUSES, ANSWERS
from pipeline.store import lines
from pipeline.store.finished import FinishedChunk, digest, extent_of, status_rows
from pipeline.store.packing import Packed, pack_values
from pipeline.study import units
from tasks.accuracy import MANTISSA, significant_bits
from tasks.registry import GAITS, STATUSES, VARIABLES, Variable

#: Name of a variable, start of a chunk in it, and what gives the chunk.
_Piece = tuple[str, tuple[int, ...], Callable[[], Packed]]


class PointWriter:
    """Writes the main group of a study of kind `grid`."""

    def __init__(self, plan: Plan):
        self.plan, self.study, self.grid = plan, plan.study, layout.Grid(plan.study)
        self.written = Written()
        self.sums: Counter[str] = Counter()
        self.shapes: dict[str, tuple[int, ...]] = {}
        self.dtypes: dict[str, np.dtype] = {}
        self.multipliers = max(c["multipliers"] for c in self.study.checks)
        self.chunk = layout.grid_chunk(self.grid.sizes)
        #: Points in a chunk, if it is a part of one line.
        self.extent = 0 if plan.blocks else layout.line_extent(self.grid.sizes)
        self._ranges = functools.lru_cache(64)(self._read_ranges)
        self._unreached = functools.lru_cache(256)(self._pack_unreached)
        self._digest = functools.lru_cache(1024)(lambda start, stop: digest(self.study.slope[start:stop]))
        self.columns = [GAITS.index(g) for g in self.study.gaits]
        others_wanted = "other" in " ".join(self.study.gaits) and len(self.study.gaits) < len(GAITS)
        self._is_solved = np.array([others_wanted or not GAITS[c].startswith("other") for c in self.columns])
        self._used: set[str] = set()
        for box in self._boxes():
            self._survey(box)
        self.sentences = sorted(self._used)
        self.columns = self.columns[: max(np.flatnonzero(self._is_solved), default=0) + 1]
        self.dims = (*self.grid.sizes, "gait")

    def _boxes(self) -> Iterator[layout.Box]:
        """Boxes of the grid that are written at a time: single chunks, if workers may have finished them."""
        return layout.regions(self.grid.sizes, self.chunk, self.extent)

    def _survey(self, box: layout.Box) -> None:
        """Count the points in a box, and note its sentences and the gaits that it has."""
        chunk = self._finished(box)
        if chunk:
            rows: Counter[tuple[int, ...]] = Counter()
            for row, n in chunk.head.rows().items():
                rows[tuple(row[c] for c in self.columns)] += n
            if set(ANSWERS).issuperset(itertools.chain(*rows)):
                self._count(rows, (chunk.head.sentences[k] for k in chunk.head.used(self.columns)))
                return
        if self._is_unreached(box):
            slopes, number = self.grid.slopes(box), int(self.grid.lines_in(box)[1][0])
            row = (ALL_STATUSES["not_attempted"],) * len(self.columns)
            self._count(Counter({row: len(slopes)}), [lines.NOT_ATTEMPTED])
            self._add_failure(lines.NOT_ATTEMPTED, len(slopes), number, slopes[0])
            return
        for _, numbers, data in self._lines(box, ()):
            status, reason = (
                data[name][..., self.columns].reshape(-1, len(self.columns)) for name in ("status", "reason")
            )
            rows = Counter(status_rows(status))
            self._count(rows, data["reasons"][np.flatnonzero(np.bincount(reason.ravel()))].tolist())
            if not set(ANSWERS).issuperset(itertools.chain(*rows)):
                self._count_failures(numbers, data, status, reason)

    def _count(self, rows: Counter[tuple[int, ...]], sentences: Iterable[str]) -> None:
        solved = [code for name, code in STATUSES.items() if name != "no_gait"]
        self.written.counts += lines.count(rows)
        self._is_solved |= np.isin(list(rows), solved).any(axis=0)
        self._used.update(sentences)

    def _count_failures(
        self, numbers: np.ndarray, data: dict[str, Any], status: np.ndarray, reason: np.ndarray
    ) -> None:
        failed, slopes = ~np.isin(status, ANSWERS), data["slope"]
        rows = np.flatnonzero(failed.any(axis=1))
        reasons = reason[rows, failed[rows].argmax(axis=1)]
        for k in np.unique(reasons):
            failed_rows = rows[reasons == k]
            line, slope = divmod(int(failed_rows[0]), len(slopes))
            self._add_failure(str(data["reasons"][k]), len(failed_rows), int(numbers[line]), slopes[slope])

    def _add_failure(self, reason: str, points: int, number: int, slope: float) -> None:
        example = f"{line_description(self.study, number)} slope={float(slope)!r}"
        self.written.add_failure(reason, points, example)

    def _lines(
        self, box: layout.Box, names: tuple[str, ...]
    ) -> Iterator[tuple[tuple[np.ndarray, ...], np.ndarray, dict[str, Any]]]:
        """Points of the lines in a box, some lines at a time: their indices in the box, numbers and data."""
        indices, numbers = self.grid.lines_in(box)
        for part, data in self.plan.read(numbers, names, self.grid.slopes(box), max(self.columns) + 1):
            yield tuple(index[part] for index in indices), numbers[part], data

    def _read_ranges(self, number: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return self.plan.journal.ranges(self.plan.line_keys(number)["points"].key)

    def _stored(self, box: layout.Box) -> list[int]:
        """Numbers of the journal's blocks that may hold points of a part of one line, latest first."""
        slopes = self.grid.slopes(box)
        numbers, low, high = self._ranges(int(self.grid.lines_in(box)[1][0]))
        stored: list[int] = numbers[(low <= slopes.max()) & (high >= slopes.min())][::-1].tolist()
        return stored

    def _is_unreached(self, box: layout.Box) -> bool:
        """Whether a box is part of one line without any results: its points need not be read."""
        if not self.extent or self._stored(box):
            return False
        atlas = self.plan.line_keys(int(self.grid.lines_in(box)[1][0])).get("atlas")
        outcome = self.plan.journal.outcome(atlas.key) if atlas else None
        return outcome is None or outcome.status == "ok"

    def _finished(self, box: layout.Box) -> FinishedChunk | None:
        """The finished chunk that holds a box's points, if it is their latest stored result."""
        if not self.extent:
            return None
        span = self.grid.slope_span(box)
        for number in self._stored(box):
            block = self.plan.journal.block(number)
            if self.plan.want <= block.variables:
                head = block.finished.head if block.finished else None
                shape = self.extent, self.multipliers
                if head and (head.extent, head.multipliers) == shape and head.digest == self._digest(*span):
                    return block.finished
                return None
        return None

    def define(self, file: Any) -> None:
        """Create every variable, without values."""
        file.createDimension("gait", len(self.columns))
        about = {"long_name": "gait by its character", "units": "1"}
        write_strings(file, "gait", "gait", [GAITS[c] for c in self.columns], about)
        names = self.plan.variables
        if any("multiplier" in VARIABLES[n].dims for n in names):
            file.createDimension("multiplier", self.multipliers)
            multiplier = file.createVariable("multiplier", "i4", ("multiplier",), fill_value=False)
            attributes.put(multiplier, {"long_name": "number of the eigenvalue, largest magnitude first", "units": "1"})
            multiplier[:] = np.arange(self.multipliers)
        is_si, is_mixed = units.is_si(self.study), len({c["si"] for c in self.study.checks}) > 1
        limits = self.study.options.get("violation_limits")
        for name in names:
            description = VARIABLES[name]
            is_wide = name == "reason" and len(self.sentences) > np.iinfo(np.int16).max
            variable = file.createVariable(
                name,
                "i4" if is_wide else description.dtype,
                (*self.grid.sizes, *description.dims),
                **layout.FILTERS,
                **_quantization(description, self.study.accuracy),
                # For one gait: which trailing gaits are absent is known only once all points are.
                chunksizes=(*self.chunk, *(1, self.multipliers)[: len(description.dims)]),
                fill_value=np.nan if description.dtype == "f8" else False,
            )
            self.shapes[name], self.dtypes[name] = tuple(variable.chunking()), variable.dtype
            attributes.put(variable, attributes.of_variable(description, is_si, is_mixed, self.study.steps, limits))

    def fill(self, draft: Path, threads: int) -> None:
        """Write values box by box; while one box is packed the next is assembled."""
        previous: list[_Piece] = []
        with ThreadPoolExecutor(threads) as pool, chunks.Chunks(draft) as out:
            for box in [*self._boxes(), ()]:
                pieces = list(self._pieces(box, pool)) if box else []
                for name, corner, piece in previous:
                    packed = piece()
                    out.write(name, corner, packed.data)
                    self.sums[name] += layout.chunk_checksum(packed.checksum, corner)
                previous = pieces

    def _pieces(self, box: layout.Box, pool: ThreadPoolExecutor) -> Iterator[_Piece]:
        """Chunks of every variable in a box."""
        chunk = self._finished(box)
        if chunk or self._is_unreached(box):
            start, points = tuple(s.start for s in box), len(self.grid.slopes(box))
            for name, shape in self.shapes.items():
                unreached = functools.partial(self._unreached, name, points)
                for g, column in enumerate(self.columns):
                    corner = (*start, g, *(0,) * (len(shape) - len(start) - 1))
                    yield name, corner, functools.partial(self._copy, chunk, name, column) if chunk else unreached
            return
        for name, values in self._region(box).items():
            for corner, part in layout.split(values, box, self.shapes[name]):
                yield name, corner, pool.submit(pack_values, part, self.shapes[name]).result

    def _copy(self, chunk: FinishedChunk, name: str, column: int) -> Packed:
        """The piece of a finished chunk; sentences are numbered over the study."""
        head, shape = chunk.head, extent_of(name, self.extent, self.multipliers)
        if name == "reason":
            table = self._table(tuple(head.sentences))
            if self.dtypes[name] != VARIABLES[name].dtype or (table != np.arange(len(table))).any():
                values = table[head.unpack(chunk.payload, name, column)]
                return pack_values(values.astype(self.dtypes[name]), shape)
        points = extent_of(name, head.points, self.multipliers)
        absent = VARIABLES[name].absent, self.dtypes[name]
        return head.piece(chunk.payload, name, column) or pack_values(np.full(points, *absent), shape)

    def _pack_unreached(self, name: str, points: int) -> Packed:
        """The piece of a chunk none of whose points is known."""
        states = {"status": ALL_STATUSES["not_attempted"], "reason": self._numbers.get(lines.NOT_ATTEMPTED, 0)}
        shape, extent = (extent_of(name, n, self.multipliers) for n in (points, self.extent))
        return pack_values(np.full(shape, states.get(name, VARIABLES[name].absent), self.dtypes[name]), extent)

    @functools.cached_property
    def _numbers(self) -> dict[str, int]:
        return {sentence: i for i, sentence in enumerate(self.sentences)}

    def _table(self, sentences: Iterable[str]) -> np.ndarray:
        """Numbers of sentences in the study; those of gaits that are not archived are not used."""
        return np.array([self._numbers.get(s, 0) for s in sentences], int)

    def _region(self, box: layout.Box) -> dict[str, np.ndarray]:
        """Values of every variable in a box."""
        extent = tuple(s.stop - s.start for s in box)
        values = {
            name: np.empty((*extent, max(self.columns) + 1, *shape[len(box) + 1 :]), self.dtypes[name])
            for name, shape in self.shapes.items()
        }
        views = {name: self.grid.slope_last(v) for name, v in values.items()}
        for position, _, data in self._lines(box, tuple(n for n in values if n not in ("status", "reason"))):
            data["reason"] = self._table(data["reasons"].tolist())[data["reason"]]
            for name, view in views.items():
                view[position] = data[name] if position else data[name][0]
        if self.columns == list(range(len(self.columns))):
            return values
        return {name: v.take(self.columns, axis=len(box)) for name, v in values.items()}


def _quantization(variable: Variable, accuracy: float) -> dict[str, Any]:
    """Options by which netCDF records how many bits an accuracy leaves values; bounds have fewer."""
    bits = significant_bits(accuracy)
    if bits == MANTISSA or variable.dtype != "f8" or variable.name.endswith("error_bound"):
        return {}
    return {"significant_digits": bits, "quantize_mode": "BitRound"}
