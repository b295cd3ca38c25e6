"""Rows of the journal: what they hold, columns and checksums."""

from __future__ import annotations

import functools
import re
import zlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from pipeline import serialize
from pipeline.statuses import ENDINGS
from pipeline.store.finished import FinishedChunk, Head

SCHEMA = (
    "CREATE TABLE points (id INTEGER PRIMARY KEY, line TEXT, kin TEXT, variables TEXT, low REAL, high REAL,"
    " n INTEGER, seconds REAL, start INTEGER, length INTEGER, data_sum INTEGER, sum INTEGER, slopes BLOB, states BLOB,"
    " data BLOB)",
    "CREATE TABLE results (id INTEGER PRIMARY KEY, key TEXT, kin TEXT, outcome TEXT, reason TEXT, seen INTEGER,"
    " seconds REAL, data_sum INTEGER, sum INTEGER, data BLOB)",
    "CREATE TABLE notes (key TEXT PRIMARY KEY, value TEXT)",
    "CREATE INDEX points_line ON points (line)",
    "CREATE INDEX points_kin ON points (kin)",
    "CREATE INDEX results_key ON results (key)",
    "CREATE INDEX results_kin ON results (kin)",
)
#: Columns of each table after its id. `sum` is the checksum of all others except `data`, which has its own. Of a
#: finished chunk, whose `length` is not 0, the data are in the segment from `start` on, `states` is its head, and
#: `slopes` the digest of its slopes.
COLUMNS = {
    table: tuple(re.findall(r"(\w+) (?:TEXT|REAL|INTEGER|BLOB)", statement)[1:])
    for table, statement in zip(("points", "results"), SCHEMA, strict=False)
}
_TYPES = {
    table: tuple({"TEXT": str, "REAL": float, "INTEGER": int, "BLOB": bytes}[word] for word in types)
    for table, statement in zip(("points", "results"), SCHEMA, strict=False)
    if (types := re.findall(r"\w+ (TEXT|REAL|INTEGER|BLOB)\b", statement)[1:])
}
#: First word of the keys of blocks of lines; other keys of points are of one line.
BLOCK = "block"
#: Largest data of a row [byte]; SQLite has rows of at most 10^9 byte.
MAX_DATA = 999_000_000
_REAL = ("low", "high", "seconds")


class TaskKey(NamedTuple):
    """Keys of a task with its parameters and inputs; `unversioned` is the same for all versions of the task."""

    key: str
    unversioned: str


class Outcome(NamedTuple):
    """How a task over a line or a study ended; `seen` is the last block of points it read."""

    status: str
    reason: str
    seen: int


@dataclass(frozen=True)
class Block:
    """Some points of one line as the journal holds them, without their variables.

    Attributes
    ----------
    id : int
    variables : frozenset of str
        Names of the variables, and of the gaits as `@long`.
    finished : FinishedChunk or None
        The finished chunk that it is, if it is one.
    slopes : ndarray, shape (n,) [rad]
    states : dict
        `status` and `reason`, shape (n, gait), and the sentences `reasons`; of several lines, whose points follow each
        other, their digests `lines`, shape (m, 2).
    """

    id: int
    variables: frozenset[str]
    finished: FinishedChunk | None
    _read: Callable[[], tuple[np.ndarray, dict[str, np.ndarray]]]

    @functools.cached_property
    def _contents(self) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        return self._read()

    @property
    def slopes(self) -> np.ndarray:
        """Slopes of the points."""
        return self._contents[0]

    @property
    def states(self) -> dict[str, np.ndarray]:
        """How the points ended."""
        return self._contents[1]


@dataclass(frozen=True)
class Result:
    """Result of a task over a line or a study; `seen` is the last block of points it read."""

    outcome: str
    reason: str
    seen: int
    data: bytes


def insert(table: str, conflict: str = "") -> str:
    """SQL statement that inserts a row into a table; `conflict` is its conflict clause."""
    columns = ("id", *COLUMNS[table])
    return f"INSERT {conflict} INTO {table} ({', '.join(columns)}) VALUES ({', '.join('?' * len(columns))})"


def with_checksums(table: str, number: int, *row: Any, data_sum: int | None = None) -> tuple[Any, ...]:
    """Add the number and checksums to the values of a row; `data_sum` is that of data in the segment."""
    k = COLUMNS[table].index("data_sum")
    head = (number, *row[:k], zlib.crc32(row[-1]) if data_sum is None else data_sum)
    return (*head, _sum(head, row[k:-1]), *row[k:])


def _sum(head: tuple[Any, ...], blobs: Iterable[bytes]) -> int:
    return functools.reduce(lambda check, blob: zlib.crc32(blob, check), blobs, zlib.crc32(repr(head).encode()))


def is_intact(table: str, row: tuple[Any, ...]) -> bool:
    """Whether the values of a row without its data are of their types, and its checksum is right."""
    k = 1 + COLUMNS[table].index("sum")
    return all(map(isinstance, row[1:], _TYPES[table])) and row[k] == _sum(row[:k], row[k + 1 :])


def is_readable(table: str, row: tuple[Any, ...]) -> bool:
    """Whether a row's data can be unpacked; data that cannot must have forged checksums."""
    try:
        if table == "results":
            return row[3] in ("ok", *ENDINGS) and (row[3] != "ok" or serialize.load(row[-1]) is not None)
        if place(table, row)[1]:
            return Head(row[-2]).size == place(table, row)[1]
        states, n = serialize.load(row[-2]), len(np.frombuffer(row[-3]))
        return len(states["status"]) == len(states["reason"]) == n and isinstance(serialize.load(row[-1]), dict)
    except (ValueError, KeyError, TypeError, IndexError, AttributeError):
        return False


def parse(number: int, values: list[Any]) -> tuple[str, tuple[Any, ...]] | None:
    """Table and row of that number and values as read from a page; None if it is not an intact row."""
    for table, columns in COLUMNS.items():
        if len(values) == 1 + len(columns):
            # SQLite stores integral reals as integers.
            pairs = zip(columns, values[1:], strict=True)
            row = (number, *(float(v) if name in _REAL and isinstance(v, int) else v for name, v in pairs))
            data, checksum = row[-1], row[1 + columns.index("data_sum")]
            is_elsewhere = bool(place(table, row)[1])
            if is_intact(table, row[:-1]) and isinstance(data, bytes) and is_elsewhere | (zlib.crc32(data) == checksum):
                return table, row
    return None


def place(table: str, row: tuple[Any, ...]) -> tuple[int, int, int]:
    """Offset, length and checksum of the data of a row in the segment; the length is 0 if the row holds them."""
    if table != "points":
        return 0, 0, 0
    k = 1 + COLUMNS[table].index("start")
    return row[k], row[k + 1], row[k + 2]
