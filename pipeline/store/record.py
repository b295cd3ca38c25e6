"""The record of a chunk: its points, packed as an archive holds them.

A head lists the contents; the pieces, one for each variable and gait, follow each other
in the payload. Writers of archives copy them unopened; readers of the values unpack
them. In memory the payload is the points as they are.
"""

import dataclasses
import functools
import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy import ndarray

from gaitsweep.pipeline import serialize
from gaitsweep.pipeline.grid.grid import Shape
from gaitsweep.pipeline.outcomes import count_rows
from gaitsweep.pipeline.statuses import ANSWERS, OF_GAITS
from gaitsweep.pipeline.store.packing import Packed, pack_values, unpack
from gaitsweep.pipeline.store.points import (
    REASON,
    Points,
    dtype_of,
    inner_sizes,
    widened,
)
from gaitsweep.tasks.contract.registry import VARIABLES


class Record(NamedTuple):
    """What a store keeps under a key; the payload of a chunk that is kept in memory is
    its points.
    """

    head: bytes
    payload: bytes | Points

    @property
    def data(self) -> bytes:
        """The payload of a record that is packed."""
        assert isinstance(self.payload, bytes)
        return self.payload

    @property
    def size(self) -> int:
        """Bytes of both."""
        payload = self.payload
        if isinstance(payload, bytes):
            return len(self.head) + len(payload)
        return len(self.head) + sum(array.nbytes for array in payload.values.values())


@dataclass(frozen=True)
class Head:
    """What a record of a chunk holds.

    Attributes
    ----------
    shape : Shape
    multipliers, keys : int
    gaits : frozenset of str
        Labels that were solved.
    columns : dict
        Number of packed gaits of each variable.
    statuses : ndarray of int, shape (n, gaits)
        Distinct rows of `status`.
    occurrences : ndarray of int, shape (n,)
        How many points have each.
    numbers : ndarray of int, shape (m,)
        Numbers of its sentences.
    texts : ndarray of str, shape (m,)
    used : ndarray of bool, shape (m, gaits)
        Which gaits have each.
    sizes, checksums : ndarray of int, shape (p,)
        Of the pieces, gait by gait of each variable.
    """

    shape: Shape
    multipliers: int
    keys: int
    gaits: frozenset[str]
    columns: dict[str, int]
    statuses: ndarray
    occurrences: ndarray
    numbers: ndarray
    texts: ndarray
    used: ndarray
    sizes: ndarray
    checksums: ndarray

    @functools.cached_property
    def places(self) -> dict[tuple[str, int], tuple[int, int, int]]:
        """Of each piece, by variable and gait, where it begins and ends in the payload,
        and its checksum.
        """
        names = []
        for name, gaits in self.columns.items():
            names += [(name, gait) for gait in range(gaits)]

        ends = np.cumsum(self.sizes)
        starts = ends - self.sizes
        places = zip(
            starts.tolist(), ends.tolist(), self.checksums.tolist(), strict=True
        )
        return dict(zip(names, places, strict=True))

    def holds(self, variables: Iterable[str], gaits: Iterable[str]) -> bool:
        """Whether these variables and gaits were solved."""
        return self.columns.keys() >= set(variables) and self.gaits >= set(gaits)

    def rows(self, columns: Iterable[int]) -> dict[tuple[int, ...], int]:
        """Count the points by their row of `status` of some gaits."""
        counts: dict[tuple[int, ...], int] = {}
        rows = map(tuple, self.statuses[:, list(columns)].tolist())
        for row, n in zip(rows, self.occurrences.tolist(), strict=True):
            counts[row] = counts.get(row, 0) + n
        return counts

    def has_failed(self, columns: Iterable[int]) -> bool:
        """Whether any point failed for some gaits."""
        return not set(ANSWERS).issuperset(itertools.chain(*self.rows(columns)))

    def sentences(self, columns: Iterable[int] | None = None) -> dict[int, str]:
        """Sentences by their numbers, those that occur for some gaits or for any."""
        used = self.used if columns is None else self.used[:, list(columns)]
        there = np.flatnonzero(used.any(axis=1)).tolist()
        return {int(self.numbers[k]): str(self.texts[k]) for k in there}

    def piece(self, payload: memoryview, name: str, gait: int) -> Packed | None:
        """Piece of a variable and gait; None if there is no such gait."""
        if (name, gait) not in self.places:
            return None
        start, end, checksum = self.places[name, gait]
        return Packed(bytes(payload[start:end]), checksum)

    def unpack(self, payload: memoryview, name: str) -> ndarray:
        """Values of a variable.

        Returns
        -------
        ndarray, shape (points, gaits) or (points, gaits, multipliers)
            Line by line.
        """
        extent = _extent(name, self.shape, self.multipliers, self.keys)
        dtype = dtype_of(name)

        columns: list[ndarray] = []
        for gait in range(self.columns[name]):
            piece = self.piece(payload, name, gait)
            assert piece
            columns.append(self.shape.fold(unpack(piece.data, dtype.str, extent)))

        if columns:
            return np.stack(columns, axis=1)

        more = extent[len(self.shape.extent) :]
        return np.empty((math.prod(self.shape.sizes), 0, *more), dtype)


@dataclass(frozen=True)
class ChunkCodec:
    """Packs the points of a chunk, and unpacks those of any.

    Attributes
    ----------
    shape : Shape
        Of the chunk.
    multipliers : int
        Most of any walker of the study.
    gaits : sequence of str
        Labels that were solved.
    is_packed : bool
        Whether points are packed as an archive holds them; else they are kept as they
        are.
    keys : int
        By how many of the slope and keys of walkers measures are differentiated.
    """

    shape: Shape
    multipliers: int
    gaits: Sequence[str]
    is_packed: bool = True
    keys: int = 0

    def encode(self, points: Points) -> Record:
        """Pack points, without the last gaits that none of them has, or keep them.

        `status` and `reason` are of all gaits.
        """
        whole = {name: self._whole(name, a) for name, a in points.values.items()}
        if not self.is_packed:
            kept = Points(whole, points.sentences)
            return Record(self._head(points, dict.fromkeys(whole, 0), []), kept)

        there = np.isin(whole["status"], OF_GAITS).any(axis=0)
        gaits = 1 + int(np.flatnonzero(there).max(initial=-1))
        columns: dict[str, int] = {}
        pieces: list[Packed] = []
        for name, array in whole.items():
            columns[name] = array.shape[1]
            if name not in ("status", "reason"):
                columns[name] = min(gaits, array.shape[1])
            pieces += self._pieces(name, array[:, : columns[name]])

        payload = b"".join(piece.data for piece in pieces)
        return Record(self._head(points, columns, pieces), payload)

    def _whole(self, name: str, array: ndarray) -> ndarray:
        """Values with as many multipliers, and derivatives by keys, as the study has."""
        inner = inner_sizes(name, self.multipliers, self.keys)
        if "key" in VARIABLES[name].dims:
            array = array[..., : self.keys]
        return widened(name, array, (array.shape[1], *inner))

    def _pieces(self, name: str, array: ndarray) -> list[Packed]:
        """Pack a variable, gait by gait."""
        extent = _extent(name, self.shape, self.multipliers, self.keys)

        pieces = []
        for gait in range(array.shape[1]):
            values = self.shape.unfold(array[:, gait])
            pieces.append(pack_values(values, extent))

        return pieces

    def _head(
        self, points: Points, columns: dict[str, int], pieces: list[Packed]
    ) -> bytes:
        """Head of a record with pieces of so many gaits of each variable."""
        return serialize.dump(
            {
                "shape": dataclasses.astuple(self.shape),
                "multipliers": self.multipliers,
                "keys": self.keys,
                "gaits": list(self.gaits),
                "names": list(columns),
                "columns": np.array([*columns.values()], int),
                "sizes": np.array([len(piece.data) for piece in pieces], int),
                "checksums": np.array([piece.checksum for piece in pieces], int),
                **_counted(points),
            }
        )

    @staticmethod
    @functools.lru_cache(256)
    def summary(head: bytes) -> Head:
        """What a record holds, by its head.

        Raises
        ------
        ValueError, KeyError, TypeError, AttributeError
            If it is none.
        """
        found: dict[str, Any] = serialize.load(head)
        sizes = found["sizes"]
        counts = found["columns"]
        is_right = (counts >= 0).all() and counts.sum() == len(sizes)
        if not is_right or len(found["checksums"]) != len(sizes):
            raise ValueError("not the head of a record")

        return Head(
            Shape.of(*found["shape"]),
            found["multipliers"],
            found["keys"],
            frozenset(found["gaits"]),
            dict(zip(found["names"], counts.tolist(), strict=True)),
            found["rows"],
            found["of_row"],
            found["numbers"],
            found["sentences"],
            found["used"],
            sizes,
            found["checksums"],
        )

    @classmethod
    def decode(cls, record: Record, names: Iterable[str] | None = None) -> Points:
        """Points of a record, with all variables that it holds or some of them."""
        head, payload = cls.summary(record.head), record.payload
        names = names or head.columns
        if isinstance(payload, Points):
            return Points(
                {name: payload.values[name] for name in names}, head.sentences()
            )

        packed = memoryview(payload)
        return Points(
            {name: head.unpack(packed, name) for name in names}, head.sentences()
        )


def _counted(points: Points) -> dict[str, ndarray]:
    """What the head of a record says of its points: how many have which statuses, and
    which sentences their gaits have.
    """
    rows = count_rows(points.values["status"])
    numbers = np.array(sorted(points.sentences), REASON)
    sentences = [points.sentences[number] for number in numbers.tolist()]
    used = [np.isin(numbers, column) for column in points.values["reason"].T]

    return {
        "rows": np.array(list(rows)),
        "of_row": np.array(list(rows.values())),
        "numbers": numbers,
        "sentences": np.array(sentences, "U"),
        "used": np.stack(used, axis=1),
    }


def _extent(name: str, shape: Shape, multipliers: int, keys: int) -> tuple[int, ...]:
    return (*shape.extent, *inner_sizes(name, multipliers, keys))
