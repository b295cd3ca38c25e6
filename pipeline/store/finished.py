"""Finished chunks: consecutive points of a line, packed by a worker as an archive holds them.

A head lists the contents; the pieces, one for each variable and gait, follow each other in the payload. Writers of
archives copy them unopened; readers of the values unpack them.
"""

from __future__ import annotations

import functools
import hashlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any

import numpy as np

from pipeline import serialize
from pipeline.statuses import ALL_STATUSES
from pipeline.store.packing import Packed, pack_values, unpack
from tasks.registry import VARIABLES

_BASE = 1 + max(ALL_STATUSES.values())


def digest(slopes: np.ndarray) -> bytes:
    """Digest of slopes, by which those of a chunk are compared.

    Parameters
    ----------
    slopes : ndarray, shape (n,) [rad]

    Returns
    -------
    bytes
    """
    return hashlib.blake2b(np.ascontiguousarray(slopes, float).tobytes(), digest_size=16).digest()


def status_rows(status: np.ndarray) -> dict[tuple[int, ...], int]:
    """Count the distinct rows of an array of statuses.

    Parameters
    ----------
    status : ndarray, shape (n, gait)

    Returns
    -------
    dict
        Occurrences of each row.
    """
    code = np.zeros(len(status), np.intp)
    for column in status.T:
        code = code * _BASE + column
    occurrences = np.bincount(code)
    powers = _BASE ** np.arange(status.shape[1])[::-1]
    return {tuple((c // powers % _BASE).tolist()): int(occurrences[c]) for c in np.flatnonzero(occurrences)}


def extent_of(name: str, points: int, multipliers: int) -> tuple[int, ...]:
    """Shape of a piece: points, and multipliers where the variable has them."""
    is_multiple = name in VARIABLES and "multiplier" in VARIABLES[name].dims
    return (points, multipliers) if is_multiple else (points,)


def finish(
    slopes: np.ndarray, values: Mapping[str, np.ndarray], sentences: list[str], extent: int, multipliers: int
) -> tuple[bytes, bytes]:
    """Pack the points of one chunk.

    Parameters
    ----------
    slopes : ndarray, shape (n,) [rad]
    values : mapping
        `status` and `reason`, shape (n, gait), and the other variables, shape (n, gaits[, multipliers]), without
        trailing gaits that do not exist.
    sentences : list of str
        Sentences of `reason`.
    extent, multipliers : int
        Points in a chunk of the archive, at least n, and multipliers.

    Returns
    -------
    head, payload : bytes
    """
    pieces = [pack_values(np.ascontiguousarray(slopes, float), (extent,))]
    for name, array in values.items():
        shape = extent_of(name, extent, multipliers)
        for g in range(array.shape[1]):
            column = array[:, g]
            if len(shape) > 1 and column.shape[1] < multipliers:
                wide = np.full((len(column), multipliers), VARIABLES[name].absent, column.dtype)
                wide[:, : column.shape[1]] = column
                column = wide
            pieces.append(pack_values(column, shape))
    states = status_rows(values["status"])
    used = [np.isin(np.arange(len(sentences)), column) for column in values["reason"].T]
    head = {
        "names": list(values),
        "columns": np.array([array.shape[1] for array in values.values()]),
        "sizes": np.array([len(piece.data) for piece in pieces]),
        "checksums": np.array([piece.checksum for piece in pieces]),
        "points": len(slopes),
        "extent": extent,
        "multipliers": multipliers,
        "low": float(slopes.min()),
        "high": float(slopes.max()),
        "digest": digest(slopes).hex(),
        "states": np.array(list(states)),
        "n_states": np.array(list(states.values())),
        "sentences": np.array(sentences, "U"),
        "used": np.stack(used, axis=1),
    }
    return serialize.dump(head), b"".join(piece.data for piece in pieces)


class Head:
    """What a finished chunk holds.

    Attributes
    ----------
    points, extent, multipliers : int
        Points in it and in a whole chunk, and multipliers.
    low, high : float [rad]
        Least and largest slope.
    digest : bytes
        Of its slopes.
    size : int [byte]
        Of its payload.
    sentences : list of str
        Sentences of `reason`.
    """

    def __init__(self, data: bytes):
        head: dict[str, Any] = serialize.load(data)
        if (head["columns"] < 0).any() or 1 + head["columns"].sum() != len(head["sizes"]):
            raise ValueError("not the head of a chunk")
        self.points, self.extent, self.multipliers = head["points"], head["extent"], head["multipliers"]
        self.low, self.high, self.digest = head["low"], head["high"], bytes.fromhex(head["digest"])
        self.sentences: list[str] = head["sentences"].tolist()
        self._used: np.ndarray = head["used"]
        self._states = head["states"], head["n_states"]
        ends = np.cumsum(head["sizes"])
        self.size = int(ends[-1])
        places = zip((ends - head["sizes"]).tolist(), ends.tolist(), head["checksums"].tolist(), strict=True)
        self._places = dict(zip(self._names(head), places, strict=True))
        self.columns: dict[str, int] = dict(zip(head["names"], head["columns"].tolist(), strict=True))

    @staticmethod
    def _names(head: dict[str, Any]) -> list[tuple[str, int]]:
        columns = zip(head["names"], head["columns"].tolist(), strict=True)
        return [("slope", 0), *((name, g) for name, n in columns for g in range(n))]

    def rows(self) -> dict[tuple[int, ...], int]:
        """Count the points by their row of `status`."""
        states, n = self._states
        return dict(zip(map(tuple, states.tolist()), n.tolist(), strict=True))

    def used(self, columns: Iterable[int]) -> list[int]:
        """Numbers of the sentences that occur for any of those gaits."""
        return np.flatnonzero(self._used[:, list(columns)].any(axis=1)).tolist()

    def piece(self, payload: memoryview, name: str, gait: int) -> Packed | None:
        """Piece of a variable and gait; None if there is no such gait."""
        if (name, gait) not in self._places:
            return None
        start, end, checksum = self._places[name, gait]
        return Packed(bytes(payload[start:end]), checksum)

    def unpack(self, payload: memoryview, name: str, gait: int = 0) -> np.ndarray:
        """Values of a variable and gait.

        Returns
        -------
        ndarray, shape (points,) or (points, multipliers)
        """
        piece = self.piece(payload, name, gait)
        assert piece
        dtype = "f8" if name == "slope" else VARIABLES[name].dtype
        return unpack(piece.data, dtype, extent_of(name, self.extent, self.multipliers))[: self.points]


class FinishedChunk(Mapping[str, np.ndarray]):
    """Variables of a finished chunk, each of shape (n, gaits[, multipliers]), unpacked when they are asked for.

    Parameters
    ----------
    head : Head
    read : callable
        Returns the payload.
    """

    def __init__(self, head: Head, read: Callable[[], bytes]):
        self.head, self._read = head, read
        self._unpacked: dict[str, np.ndarray] = {}

    @functools.cached_property
    def payload(self) -> memoryview:
        """Pieces of all variables and gaits, one after the other."""
        return memoryview(self._read())

    def __getitem__(self, name: str) -> np.ndarray:
        if name not in self._unpacked:
            columns = range(self.head.columns.get(name, 0))
            if not columns:
                raise KeyError(name)
            self._unpacked[name] = np.stack([self.head.unpack(self.payload, name, g) for g in columns], axis=1)
        return self._unpacked[name]

    def __iter__(self) -> Iterator[str]:
        return (name for name, n in self.head.columns.items() if n)

    def __len__(self) -> int:
        return sum(1 for _ in self)

    def contents(self) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Unpack slopes and states.

        Returns
        -------
        slopes : ndarray, shape (n,) [rad]
        states : dict
            `status` and `reason`, shape (n, gait), and the sentences `reasons`.
        """
        states = {name: self[name] for name in ("status", "reason")}
        return self.head.unpack(self.payload, "slope"), {**states, "reasons": np.array(self.head.sentences, "U")}
