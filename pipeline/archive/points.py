"""The main group of a study of kind `grid`: every variable over the grid and its gaits,
chunk by chunk.
"""

import functools
import itertools
import math
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from gaitsweep.pipeline.archive import attributes, layout
from gaitsweep.pipeline.archive.direct_chunks import direct_chunks
from gaitsweep.pipeline.archive.written import (
    Sentences,
    Written,
    line_description,
    write_strings,
    write_variable,
)
from gaitsweep.pipeline.graph.plan import Plan
from gaitsweep.pipeline.grid.grid import Chunk, Shape
from gaitsweep.pipeline.outcomes import count
from gaitsweep.pipeline.statuses import (
    ANSWERS,
    NOT_ATTEMPTED,
    OF_GAITS,
    STATUS_NAMES,
    of_atlas,
)
from gaitsweep.pipeline.store.packing import Packed, pack_values
from gaitsweep.pipeline.store.points import Points, has_multipliers, inner_sizes
from gaitsweep.pipeline.store.record import ChunkCodec, Head, Record
from gaitsweep.pipeline.study import units
from gaitsweep.tasks.contract.accuracy import MANTISSA, significant_bits
from gaitsweep.tasks.contract.registry import GAITS, VARIABLES, Variable


class PointWriter:
    """Writes the main group of a study of kind `grid`.

    Parameters
    ----------
    plan : Plan
    """

    def __init__(self, plan: Plan):
        self.plan, self.study, self.grid = plan, plan.study, plan.graph.grid
        self.written = Written()
        self.sums: Counter[str] = Counter()
        self.dtypes: dict[str, np.dtype] = {}
        self.chunk = self.grid.extent
        self._same = functools.lru_cache(256)(self._pack_same)
        self._unfinished = functools.lru_cache(256)(self._pack_ending)

        gaits = self.study.gaits
        are_others = np.array([gait.startswith("other") for gait in gaits])
        self.columns = [GAITS.index(gait) for gait in gaits]
        # Of other gaits those that some point has, unless some of them are asked for.
        self._is_solved = ~are_others
        if are_others.any() and len(gaits) < len(GAITS):
            self._is_solved[:] = True

        self._texts: dict[int, str] = {}
        for chunk, key in self._chunks():
            self._survey(chunk, key)

        self.sentences = Sentences(self._texts)
        last = np.flatnonzero(self._is_solved).max(initial=0)
        self.columns = self.columns[: last + 1]
        self.dims = (*self.grid.sizes, "gait")

    def _chunks(self) -> Iterator[tuple[Chunk, str]]:
        for number in range(self.grid.chunks):
            self.plan.check()
            chunk = self.grid.chunk(number)
            yield chunk, self.plan.graph.chunk_key(chunk)

    def _survey(self, chunk: Chunk, key: str) -> None:
        """Count the points of a chunk, and note its sentences and the gaits that it
        has.
        """
        head = self.plan.store.chunk(key)
        if head is None:
            head = ChunkCodec.summary(self._record(chunk, key).head)

        rows, sentences = head.rows(self.columns), head.sentences(self.columns)
        self.written.counts += count(rows, STATUS_NAMES)
        self._is_solved |= np.isin(list(rows), OF_GAITS).any(axis=0)
        self._texts |= sentences
        if not head.has_failed(self.columns):
            return

        if len(rows) == len(sentences) == 1:  # as where nothing was computed
            (reason,) = sentences.values()
            failures = [(reason, chunk.points, 0)]
        else:
            failures = [*self._failures(key)]

        for reason, points, first in failures:
            line, k = divmod(first, chunk.per_line)
            value = float(self.study.values_along[chunk.slopes][k])
            described = line_description(self.study, int(chunk.numbers[line]))
            example = f"{described} {self.study.along}={value!r}"
            self.written.add_failure(reason, points, example)

    def _failures(self, key: str) -> Iterator[tuple[str, int, int]]:
        """Reasons for which points of a chunk failed, how many, and the first of them."""
        points = self.plan.store.points(key)
        failed = ~np.isin(points.values["status"][:, self.columns], ANSWERS)
        rows = np.flatnonzero(failed.any(axis=1))
        first_failed = failed[rows].argmax(axis=1)
        reasons = points.values["reason"][:, self.columns][rows, first_failed]
        for number in np.unique(reasons):
            of_reason = rows[reasons == number]
            sentence = points.sentences[int(number)]
            yield sentence, len(of_reason), int(of_reason[0])

    def _record(self, chunk: Chunk, key: str) -> Record:
        """Record of a chunk; of one that is not stored, why it is not."""
        if key in self.plan.store:
            return self.plan.store.get(key)

        atlas = None
        if chunk.lines == 1:
            atlas = self.plan.outcome_of_line(chunk.line)
        if atlas is None or atlas.status == "ok":
            return self._unfinished(chunk.shape, "not_attempted", NOT_ATTEMPTED)

        return self._unfinished(chunk.shape, atlas.status, of_atlas(atlas.reason))

    def _pack_ending(self, shape: Shape, ending: str, reason: str) -> Record:
        grid, variables = self.grid, self.plan.graph.variables
        codec = ChunkCodec(shape, grid.multipliers, self.study.gaits, keys=grid.keys)
        count = math.prod(shape.sizes)
        return codec.encode(Points.of_ending(count, ending, reason, variables))

    def define(self, file: Any) -> None:
        """Create every variable, without values."""
        names, multipliers = self.plan.graph.variables, self.grid.multipliers
        file.createDimension("gait", len(self.columns))
        if any("key" in VARIABLES[name].dims for name in names):
            self._define_keys(file)
        gaits = [GAITS[column] for column in self.columns]
        write_strings(file, "gait", "gait", gaits, attributes.GAIT)
        if any(has_multipliers(name) for name in names):
            file.createDimension("multiplier", multipliers)
            numbers = np.arange(multipliers, dtype=np.int32)
            write_variable(
                file, "multiplier", ("multiplier",), numbers, attributes.MULTIPLIER
            )

        for name in names:
            self._define_variable(file, name)

    def _define_variable(self, file: Any, name: str) -> None:
        description = VARIABLES[name]
        dtype: Any = description.dtype
        fill: Any = False
        if name == "reason":
            dtype = self.sentences.dtype
        elif dtype == "f8":
            fill = np.nan

        variable = file.createVariable(
            self.study.archived(name),
            dtype,
            (*self.grid.sizes, *description.dims),
            **layout.FILTERS,
            **_quantization(description, self.study.accuracy),
            # For one gait: which trailing gaits are absent is known only once all
            # points are.
            chunksizes=(*self.chunk, 1, *self._inner(name)),
            fill_value=fill,
        )
        self.dtypes[name] = variable.dtype
        attributes.put(variable, attributes.of_variable(description, self.study))

    def _inner(self, name: str) -> tuple[int, ...]:
        """Sizes of the dimensions of a variable after the gait."""
        return inner_sizes(name, self.grid.multipliers, self.grid.keys)

    def _define_keys(self, file: Any) -> None:
        """Write the keys by which measures are differentiated, with their units."""
        keys = attributes.differentiated(self.grid.keys)
        file.createDimension("key", len(keys))
        write_strings(file, "key", "key", keys, attributes.KEY)
        of_keys = [units.axis_units(key, self.study.checks) for key in keys]
        write_strings(file, "key_units", "key", of_keys, attributes.KEY_UNITS)

    def fill(self, draft: Path) -> None:
        """Write the values chunk by chunk."""
        with direct_chunks(draft) as write:
            for chunk, key in self._chunks():
                start = tuple(span.start for span in chunk.spans.values())
                record = self._record(chunk, key)
                with self.plan.store.reading():
                    head = ChunkCodec.summary(record.head)
                    payload = memoryview(record.data)
                    pieces = self._pieces(chunk.shape, head, payload)

                for (name, g), piece in pieces.items():
                    corner = (*start, g, *(0 for _ in inner_sizes(name, 0, 0)))
                    archived = self.study.archived(name)
                    write(archived, corner, piece.data)
                    self.sums[archived] += layout.chunk_checksum(piece.checksum, corner)

    def _pieces(
        self, shape: Shape, head: Head, payload: memoryview
    ) -> dict[tuple[str, int], Packed]:
        """Pieces of a chunk, by variable and place of the gait; its sentences have the
        numbers of the archive.
        """
        # What it says of every point must be readable, whatever its checksum.
        head.unpack(payload, "status")
        reasons = self.sentences.renumbered(head.unpack(payload, "reason"))

        pieces: dict[tuple[str, int], Packed] = {}
        gaits = [*enumerate(self.columns)]
        for name, (g, column) in itertools.product(self.dtypes, gaits):
            if name == "reason":
                values = shape.unfold(reasons[:, column])
                piece: Packed | None = pack_values(values, self.chunk)
            else:
                piece = head.piece(payload, name, column)
            pieces[name, g] = piece or self._same(name, shape.sizes)

        return pieces

    def _pack_same(self, name: str, sizes: tuple[int, ...]) -> Packed:
        """Piece of a chunk that holds no gait."""
        more = self._inner(name)
        absent = VARIABLES[name].absent
        values = np.full((*sizes, *more), absent, self.dtypes[name])
        return pack_values(values, (*self.chunk, *more))


def _quantization(variable: Variable, accuracy: float) -> dict[str, Any]:
    """Options by which netCDF records how many bits an accuracy leaves values; bounds
    have fewer.
    """
    bits = significant_bits(accuracy)
    if (
        bits == MANTISSA
        or variable.dtype != "f8"
        or variable.name.endswith("error_bound")
    ):
        return {}

    return {"significant_digits": bits, "quantize_mode": "BitRound"}
