"""The record of a chunk: its points, packed as an archive holds them.

A head lists the contents; the pieces, one for each variable and gait, follow each other
in the payload. Writers of archives copy them unopened; readers of the values unpack
them. A sentence is known by a number made from its text, until the archive numbers
those that it holds.
"""

import dataclasses
import functools
import hashlib
import itertools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from gaitsweep.pipeline import serialize
from gaitsweep.pipeline.grid.grid import Shape
from gaitsweep.pipeline.outcomes import count_rows
from gaitsweep.pipeline.statuses import ANSWERS, ENDINGS, OF_GAITS
from gaitsweep.pipeline.store.packing import Packed, pack_values, unpack
from gaitsweep.tasks.registry import GAITS, VARIABLES

#: Type of the numbers of sentences.
_REASON = np.dtype("u8")


@functools.lru_cache(4096)
def sentence_number(sentence: str) -> int:
    """Number that stands for a sentence."""
    return int.from_bytes(
        hashlib.blake2b(sentence.encode(), digest_size=8).digest(), "little"
    )


def _dtype_of(name: str) -> np.dtype:
    """Type of a variable in a record."""
    return _REASON if name == "reason" else np.dtype(VARIABLES[name].dtype)


@dataclass
class Points:
    """Points, line by line.

    Attributes
    ----------
    values : dict of ndarray, shape (n, gaits[, multipliers])
        `status` and `reason`, of all gaits; the other variables perhaps without
        trailing gaits that do not exist.
    sentences : dict
        Sentences of `reason`, by their numbers.
    """

    values: dict[str, np.ndarray]
    sentences: dict[int, str] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.values["status"])

    @classmethod
    def of_task(cls, returned: Any, params: Mapping[str, Any]) -> "Points":
        """What a task with these parameters returns for a chunk of a line, or of lines
        side by side with their atlases.

        Raises
        ------
        ValueError
            If a variable has not the shape of the points, or they are not those of the
            lines.
        """
        results = (
            [result for _, result in returned] if "lines" in params else [returned]
        )
        parts, count = (
            list[Points](),
            len(params.get("lines", [None])) * len(params["slope"]),
        )
        for result in results:
            names = (
                "status",
                *(name for name in params["want"] if name not in ("status", "reason")),
            )
            values = {
                name: np.asarray(result[name], VARIABLES[name].dtype) for name in names
            }
            for name, array in values.items():
                if array.shape[:2] != values["status"].shape:
                    raise ValueError(
                        f"`{name}` has shape {array.shape}, `status` {values['status'].shape}"
                    )
            sentences = [str(sentence) for sentence in result["reasons"]] or [""]
            reason = np.asarray(result["reason"])
            occurs = np.flatnonzero(
                np.bincount(reason.ravel(), minlength=len(sentences))
            ).tolist()
            numbers = np.array(
                [sentence_number(sentence) for sentence in sentences], _REASON
            )
            parts.append(
                cls(
                    {**values, "reason": numbers[reason]},
                    {int(numbers[k]): sentences[k] for k in occurs},
                )
            )
        points = joined(parts) if len(parts) > 1 else parts[0]
        if len(points) != count:
            raise ValueError(f"{len(points)} points are returned of {count}")
        return points

    @classmethod
    def of_ending(
        cls, points: int, ending: str, reason: str, want: Iterable[str]
    ) -> "Points":
        """Points whose worker ended so, a name of `statuses.ENDINGS`."""
        number, shape = sentence_number(reason), (points, len(GAITS))
        none = {
            name: (points, 0, 0) if has_multipliers(name) else (points, 0)
            for name in want
        }
        values = {
            name: np.empty(extent, _dtype_of(name)) for name, extent in none.items()
        }
        values |= {
            "status": np.full(shape, ENDINGS[ending], np.int8),
            "reason": np.full(shape, number, _REASON),
        }
        return cls(values, {number: reason})

    def take(self, rows: np.ndarray) -> "Points":
        """Some of the points, in that order."""
        return Points(
            {name: array[rows] for name, array in self.values.items()}, self.sentences
        )


def rows_of(lines: np.ndarray, slopes: int) -> np.ndarray:
    """Rows of the points of some lines, by their places, which have so many slopes
    each.
    """
    rows: np.ndarray = (lines[:, None] * slopes + np.arange(slopes)).ravel()
    return rows


def joined(parts: Sequence[Points], least: tuple[int, int] = (0, 0)) -> Points:
    """Points one after the other; of a variable as many gaits and multipliers as any
    part has, and at least so many.
    """
    sentences = {
        number: text for part in parts for number, text in part.sentences.items()
    }
    values = {}
    for name in parts[0].values:
        arrays = [part.values[name] for part in parts]
        shape = tuple(
            map(
                max,
                zip(
                    least[: arrays[0].ndim - 1],
                    *(array.shape[1:] for array in arrays),
                    strict=True,
                ),
            )
        )
        values[name] = np.concatenate(
            [_widened(name, array, shape) for array in arrays]
        )
    return Points(values, sentences)


def _widened(name: str, values: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Values of points with so many gaits and multipliers, of which the last are
    absent.
    """
    if values.shape[1:] == shape:
        return values
    whole = np.full((len(values), *shape), VARIABLES[name].absent, values.dtype)
    whole[(slice(None), *map(slice, values.shape[1:]))] = values
    return whole


@dataclass(frozen=True)
class Packing:
    """How the points of a chunk are packed.

    Attributes
    ----------
    shape : Shape
        Of the chunk.
    multipliers : int
        Most of any walker of the study.
    gaits : iterable of str
        Labels that were solved.
    digests : ndarray of uint64, shape (m, 2), optional
        Those of its lines, if it holds several.
    """

    shape: Shape
    multipliers: int
    gaits: Sequence[str]
    digests: np.ndarray | None = None


def pack(points: Points, packing: Packing) -> tuple[bytes, bytes]:
    """Pack the points of a chunk, as head and payload, without the last gaits that no
    point has.

    `status` and `reason` are of all gaits.
    """
    shape, multipliers = packing.shape, packing.multipliers
    status, reason = points.values["status"], points.values["reason"]
    gaits = 1 + int(
        np.flatnonzero(np.isin(status, OF_GAITS).any(axis=0)).max(initial=-1)
    )
    pieces, columns = list[Packed](), dict[str, int]()
    for name, array in points.values.items():
        extent = _extent(name, shape, multipliers)
        columns[name] = (
            array.shape[1]
            if name in ("status", "reason")
            else min(gaits, array.shape[1])
        )
        whole = (
            _widened(name, array, (array.shape[1], multipliers))
            if has_multipliers(name)
            else array
        )
        pieces += [
            pack_values(shape.unfold(whole[:, g]), extent) for g in range(columns[name])
        ]
    rows, numbers = count_rows(status), sorted(points.sentences)
    head = {
        "shape": dataclasses.astuple(shape),
        "multipliers": multipliers,
        "gaits": list(packing.gaits),
        "lines": np.empty((0, 2), np.uint64)
        if packing.digests is None
        else packing.digests,
        "names": list(columns),
        "columns": np.array(list(columns.values())),
        "sizes": np.array([len(piece.data) for piece in pieces]),
        "checksums": np.array([piece.checksum for piece in pieces]),
        "rows": np.array(list(rows)),
        "of_row": np.array(list(rows.values())),
        "numbers": np.array(numbers, _REASON),
        "sentences": np.array([points.sentences[number] for number in numbers], "U"),
        "used": np.stack(
            [np.isin(np.array(numbers, _REASON), column) for column in reason.T], axis=1
        ),
    }
    return serialize.dump(head), b"".join(piece.data for piece in pieces)


def _extent(name: str, shape: Shape, multipliers: int) -> tuple[int, ...]:
    return (*shape.extent, multipliers) if has_multipliers(name) else shape.extent


def has_multipliers(name: str) -> bool:
    """Whether a variable has a value for each multiplier."""
    return "multiplier" in VARIABLES[name].dims


class Head:
    """What a record holds.

    Attributes
    ----------
    shape : Shape
    multipliers : int
    digests : ndarray of uint64, shape (m, 2)
        Those of its lines; none if it is part of one line.
    columns : dict
        Number of gaits of each variable.
    """

    def __init__(self, data: bytes):
        head: dict[str, Any] = serialize.load(data)
        if (head["columns"] < 0).any() or head["columns"].sum() != len(head["sizes"]):
            raise ValueError("not the head of a record")
        self.shape = Shape.of(*head["shape"])
        self.multipliers, self.digests = head["multipliers"], head["lines"]
        self.columns: dict[str, int] = dict(
            zip(head["names"], head["columns"].tolist(), strict=True)
        )
        self._gaits = frozenset(head["gaits"])
        self._rows = head["rows"], head["of_row"]
        self._numbers, self._sentences, self._used = (
            head["numbers"],
            head["sentences"],
            head["used"],
        )
        ends = np.cumsum(head["sizes"])
        places = zip(
            (ends - head["sizes"]).tolist(),
            ends.tolist(),
            head["checksums"].tolist(),
            strict=True,
        )
        names = [(name, g) for name, n in self.columns.items() for g in range(n)]
        self._places = dict(zip(names, places, strict=True))

    def holds(self, variables: Iterable[str], gaits: Iterable[str]) -> bool:
        """Whether these variables and gaits were solved."""
        return self.columns.keys() >= set(variables) and self._gaits >= set(gaits)

    def rows(self, columns: Iterable[int]) -> dict[tuple[int, ...], int]:
        """Count the points by their row of `status` of some gaits."""
        states, n = self._rows
        counts: dict[tuple[int, ...], int] = {}
        for row, k in zip(
            map(tuple, states[:, list(columns)].tolist()), n.tolist(), strict=True
        ):
            counts[row] = counts.get(row, 0) + k
        return counts

    def has_failed(self, columns: Iterable[int]) -> bool:
        """Whether any point failed for some gaits."""
        return not set(ANSWERS).issuperset(itertools.chain(*self.rows(columns)))

    def sentences(self, columns: Iterable[int] | None = None) -> dict[int, str]:
        """Sentences by their numbers, those that occur for some gaits or for any."""
        used = self._used if columns is None else self._used[:, list(columns)]
        return {
            int(self._numbers[k]): str(self._sentences[k])
            for k in np.flatnonzero(used.any(axis=1))
        }

    def piece(self, payload: memoryview, name: str, gait: int) -> Packed | None:
        """Piece of a variable and gait; None if there is no such gait."""
        if (name, gait) not in self._places:
            return None
        start, end, checksum = self._places[name, gait]
        return Packed(bytes(payload[start:end]), checksum)

    def unpack(self, payload: memoryview, name: str) -> np.ndarray:
        """Values of a variable.

        Returns
        -------
        ndarray, shape (points, gaits) or (points, gaits, multipliers)
            Line by line.
        """
        extent, dtype, columns = (
            _extent(name, self.shape, self.multipliers),
            _dtype_of(name),
            [],
        )
        for g in range(self.columns[name]):
            piece = self.piece(payload, name, g)
            assert piece
            columns.append(self.shape.fold(unpack(piece.data, dtype.str, extent)))
        shape = (int(np.prod(self.shape.sizes)), 0, *extent[len(self.shape.extent) :])
        return np.stack(columns, axis=1) if columns else np.empty(shape, dtype)


def unpacked(head: bytes, payload: bytes, names: Iterable[str] | None = None) -> Points:
    """Points of a record, with all variables that it holds or some of them."""
    contents, view = Head(head), memoryview(payload)
    return Points(
        {name: contents.unpack(view, name) for name in names or contents.columns},
        contents.sentences(),
    )
