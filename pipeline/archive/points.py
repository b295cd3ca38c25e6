"""The main group of a study of kind `grid`: every variable over the grid and its gaits, chunk by chunk."""

import functools
import itertools
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from gaitsweep.pipeline.archive import attributes, chunks, layout
from gaitsweep.pipeline.archive.written import Sentences, Written, line_description, write_strings, write_variable
from gaitsweep.pipeline.graph.plan import Plan
from gaitsweep.pipeline.grid.grid import Chunk
from gaitsweep.pipeline.outcomes import count
from gaitsweep.pipeline.statuses import ALL_STATUSES, ANSWERS, NOT_ATTEMPTED, STATUS_NAMES, of_atlas
from gaitsweep.pipeline.store.packing import Packed, pack_values
from gaitsweep.pipeline.store.record import Head, has_multipliers, sentence_number, unpacked
from gaitsweep.pipeline.study import units
from gaitsweep.tasks.accuracy import MANTISSA, significant_bits
from gaitsweep.tasks.registry import GAITS, STATUSES, VARIABLES, Variable


class PointWriter:
    """Writes the main group of a study of kind `grid`.

    Parameters
    ----------
    plan : Plan
    check : callable
        Called between chunks; it may raise.
    """

    def __init__(self, plan: Plan, check: Callable[[], None]):
        self.plan, self.study, self.grid, self.check = plan, plan.study, plan.graph.grid, check
        self.written = Written()
        self.sums: Counter[str] = Counter()
        self.dtypes: dict[str, np.dtype] = {}
        self.chunk = self.grid.extent
        self._same = functools.lru_cache(256)(self._pack_same)
        self.columns = [GAITS.index(g) for g in self.study.gaits]
        others_wanted = "other" in " ".join(self.study.gaits) and len(self.study.gaits) < len(GAITS)
        self._is_solved = np.array([others_wanted or not GAITS[c].startswith("other") for c in self.columns])
        self._texts: dict[int, str] = {}
        for chunk in self._chunks():
            self._survey(chunk)
        self.sentences = Sentences(self._texts)
        self.columns = self.columns[: max(np.flatnonzero(self._is_solved), default=0) + 1]
        self.dims = (*self.grid.sizes, "gait")

    def _chunks(self) -> Iterator[Chunk]:
        for number in range(self.grid.chunks):
            self.check()
            yield self.grid.chunk(number)

    def _survey(self, chunk: Chunk) -> None:
        """Count the points of a chunk, and note its sentences and the gaits that it has."""
        key = self.plan.graph.chunk_key(chunk).key
        if key not in self.plan.store:
            status, reason = self._ending(chunk)
            self._count({(ALL_STATUSES[status],) * len(self.columns): chunk.points}, {sentence_number(reason): reason})
            self._add_failure(reason, chunk.points, chunk, 0)
            return
        head = self.plan.store.chunk(key)
        self._count(head.rows(self.columns), head.sentences(self.columns))
        if head.has_failed(self.columns):
            self._count_failures(chunk, key)

    def _count(self, rows: dict[tuple[int, ...], int], sentences: dict[int, str]) -> None:
        solved = [code for name, code in STATUSES.items() if name != "no_gait"]
        self.written.counts += count(rows, STATUS_NAMES)
        self._is_solved |= np.isin(list(rows), solved).any(axis=0)
        self._texts |= sentences

    def _count_failures(self, chunk: Chunk, key: str) -> None:
        points = unpacked(*self.plan.store.get(key))
        failed = ~np.isin(points.values["status"][:, self.columns], ANSWERS)
        rows = np.flatnonzero(failed.any(axis=1))
        reasons = points.values["reason"][:, self.columns][rows, failed[rows].argmax(axis=1)]
        for number in np.unique(reasons):
            own = rows[reasons == number]
            self._add_failure(points.sentences[int(number)], len(own), chunk, int(own[0]))

    def _add_failure(self, reason: str, points: int, chunk: Chunk, first: int) -> None:
        line, k = divmod(first, chunk.points // len(chunk.lines))
        slope = float(self.study.slope[chunk.slopes][k])
        example = f"{line_description(self.study, int(chunk.lines[line]))} slope={slope!r}"
        self.written.add_failure(reason, points, example)

    def _ending(self, chunk: Chunk) -> tuple[str, str]:
        """Status and reason of the points of a chunk that is not stored."""
        atlas = None if len(chunk.lines) > 1 else self.plan.outcome_of_line(int(chunk.lines[0]))
        if atlas is None or atlas.status == "ok":
            return "not_attempted", NOT_ATTEMPTED
        return atlas.status, of_atlas(atlas.reason)

    def define(self, file: Any) -> None:
        """Create every variable, without values."""
        file.createDimension("gait", len(self.columns))
        write_strings(file, "gait", "gait", [GAITS[c] for c in self.columns], attributes.GAIT)
        names, multipliers = self.plan.graph.variables, self.grid.multipliers
        if any(has_multipliers(n) for n in names):
            file.createDimension("multiplier", multipliers)
            numbers = np.arange(multipliers, dtype=np.int32)
            write_variable(file, "multiplier", ("multiplier",), numbers, attributes.MULTIPLIER)
        is_si, is_mixed = units.is_si(self.study), units.is_mixed(self.study)
        limits = self.study.options.get("violation_limits")
        for name in names:
            description = VARIABLES[name]
            variable = file.createVariable(
                name,
                self.sentences.dtype if name == "reason" else description.dtype,
                (*self.grid.sizes, *description.dims),
                **layout.FILTERS,
                **_quantization(description, self.study.accuracy),
                # For one gait: which trailing gaits are absent is known only once all points are.
                chunksizes=(*self.chunk, *(1, multipliers)[: len(description.dims)]),
                fill_value=np.nan if description.dtype == "f8" else False,
            )
            self.dtypes[name] = variable.dtype
            attributes.put(variable, attributes.of_variable(description, is_si, is_mixed, self.study.steps, limits))

    def fill(self, draft: Path) -> None:
        """Write the values chunk by chunk."""
        with chunks.Chunks(draft) as out:
            for chunk in self._chunks():
                start = tuple(span.start for span in chunk.box)
                for name, g, packed in self._pieces(chunk):
                    corner = (*start, g, *([0] if has_multipliers(name) else []))
                    out.write(name, corner, packed.data)
                    self.sums[name] += layout.chunk_checksum(packed.checksum, corner)

    def _pieces(self, chunk: Chunk) -> Iterator[tuple[str, int, Packed]]:
        """Pieces of a chunk: name, number of the gait in the archive, and packed values."""
        key = self.plan.graph.chunk_key(chunk).key
        if key not in self.plan.store:
            status, reason = self._ending(chunk)
            number = self.sentences.renumbered(np.array(sentence_number(reason), np.uint64))
            states = {"status": ALL_STATUSES[status], "reason": int(number)}
            for name, g in itertools.product(self.dtypes, range(len(self.columns))):
                yield name, g, self._same(name, states.get(name, VARIABLES[name].absent), chunk.shape.sizes)
            return
        data, payload = self.plan.store.get(key)
        with self.plan.store.reading():
            head, view = Head(data), memoryview(payload)
            reasons = self.sentences.renumbered(head.unpack(view, "reason"))
            for name, (g, column) in itertools.product(self.dtypes, enumerate(self.columns)):
                if name == "reason":
                    values = chunk.shape.unfold(np.ascontiguousarray(reasons[:, column]))
                    yield name, g, pack_values(np.ascontiguousarray(values), self.chunk)
                else:
                    piece = head.piece(view, name, column)
                    yield name, g, piece or self._same(name, VARIABLES[name].absent, chunk.shape.sizes)

    def _pack_same(self, name: str, value: float, sizes: tuple[int, ...]) -> Packed:
        """Piece of a chunk in which all values are the same."""
        more = (self.grid.multipliers,) if has_multipliers(name) else ()
        return pack_values(np.full((*sizes, *more), value, self.dtypes[name]), (*self.chunk, *more))


def _quantization(variable: Variable, accuracy: float) -> dict[str, Any]:
    """Options by which netCDF records how many bits an accuracy leaves values; bounds have fewer."""
    bits = significant_bits(accuracy)
    if bits == MANTISSA or variable.dtype != "f8" or variable.name.endswith("error_bound"):
        return {}
    return {"significant_digits": bits, "quantize_mode": "BitRound"}
