"""The journal of a run: every finished result, in SQLite, safe against whatever ends the run.

A point is found by its line's key and its slope; slopes are compared as arrays, so a grid may be cut into
chunks in any way and made denser later. Where a point was computed twice the later result counts. Rows carry
a checksum: a torn journal loses the rows that are torn and no other.
"""

from __future__ import annotations

import contextlib
import functools
import os
import sqlite3
import threading
import time
import zlib
from collections import OrderedDict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, NoReturn
from urllib.parse import quote

import numpy as np

from pipeline import pack
from pipeline.errors import ArchiveError, DiskFullError

_SCHEMA = (
    "CREATE TABLE points (id INTEGER PRIMARY KEY AUTOINCREMENT, line TEXT, kin TEXT, variables TEXT,"
    " low REAL, high REAL, n INTEGER, seconds REAL, sum INTEGER, slopes BLOB, states BLOB, data BLOB)",
    "CREATE TABLE results (id INTEGER PRIMARY KEY AUTOINCREMENT, key TEXT, kin TEXT, outcome TEXT,"
    " reason TEXT, seen INTEGER, seconds REAL, sum INTEGER, data BLOB)",
    "CREATE TABLE notes (key TEXT PRIMARY KEY, value TEXT)",
    "CREATE INDEX points_line ON points (line)",
    "CREATE INDEX points_kin ON points (kin)",
    "CREATE INDEX results_key ON results (key)",
    "CREATE INDEX results_kin ON results (kin)",
)
_COLUMNS = {"points": "line, kin, variables, low, high, n, seconds, sum, slopes, states, data",
            "results": "key, kin, outcome, reason, seen, seconds, sum, data"}
_LATEST = "FROM results WHERE key = ? ORDER BY id DESC LIMIT 1"
_SYNC = 0.5  # s: how much finished work a power cut may cost
_MANY, _FEW = 64, 1000  # blocks of a line, and points in one, from which they are put together
#: Size of a page [byte], and of one where so many points come in blocks of megabytes: every page costs.
_PAGE, _LARGE_PAGE, _LARGE = 4096, 32768, 100_000
_GIVE_UP = 5000  # lost rows in a row after which a torn table is taken to end


class TornError(ArchiveError):
    """A row of the journal does not hold what was written; `mend` and plan again."""


@dataclass(frozen=True)
class Block:
    """Some points of one line as the journal holds them, without their variables."""

    id: int
    variables: frozenset[str]
    slopes: np.ndarray
    states: dict[str, np.ndarray]


@dataclass(frozen=True)
class Result:
    """What a task over a line or a study gave; `seen` is the last block of points it read."""

    outcome: str
    reason: str
    seen: int
    data: bytes


class Journal:
    """One archive's journal. The run is its only writer; others open it with `write=False`.

    `points` is how many there may come, to lay out a new one.
    """

    def __init__(self, path: Path, write: bool = True, points: int = 0):
        self.path, self._lock, self._synced = path, threading.RLock(), 0.0
        self._recent: OrderedDict[int, dict[str, np.ndarray]] = OrderedDict()
        try:
            there = path.exists() and path.stat().st_size > 0
            if there:
                with open(path, "rb") as file:
                    if file.read(16) != b"SQLite format 3\0":
                        raise ArchiveError(f"{path} is not a journal of gaitsweep; move it away.")
            if write and there and _is_torn(path):
                mend(path)
            self._db = _connect(str(path) if there or write else ":memory:", write or not there,
                                _LARGE_PAGE if points >= _LARGE else _PAGE)
        except (sqlite3.Error, OSError) as error:
            _fail(error, path)

    def close(self) -> None:
        """Fold the write-ahead log into the file and close it."""
        with self._lock:
            with contextlib.suppress(sqlite3.Error):
                self._db.execute("PRAGMA wal_checkpoint(TRUNCATE)")
            self._db.close()

    def _read(self, sql: str, *values: Any) -> list[tuple[Any, ...]]:
        try:
            with self._lock:
                return self._db.execute(sql, values).fetchall()
        except sqlite3.Error as error:
            _fail(error, self.path)

    def _write(self, sql: str, *values: Any) -> None:
        """One durable statement: against a crash of the run at once, of the machine within `_SYNC`."""
        now = time.monotonic()
        full = now - self._synced > _SYNC
        self._read(f"PRAGMA synchronous={'FULL' if full else 'NORMAL'}")
        self._read(sql, *values)
        if full:
            self._synced = now

    def add_points(self, line: str, kin: str, variables: Iterable[str], row: tuple[bytes, bytes, bytes],
                   seconds: float) -> None:
        """Keep a block of points (slopes, packed states, packed variables) of the line with that key."""
        slopes = np.frombuffer(row[0])
        self._write(f"INSERT INTO points ({_COLUMNS['points']}) VALUES (?,?,?,?,?,?,?,?,?,?,?)",
                    line, kin, " ".join(sorted(variables)), slopes.min(), slopes.max(), len(slopes), seconds,
                    _sum(line, *row), *row)

    def add_result(self, key: str, kin: str, result: Result, seconds: float) -> None:
        """Keep the result of a task that is no block of points."""
        self._write(f"INSERT INTO results ({_COLUMNS['results']}) VALUES (?,?,?,?,?,?,?,?)", key, kin, result.outcome,
                    result.reason, result.seen, seconds, _sum(key, result.data), result.data)

    def result(self, key: str) -> Result | None:
        """The latest result of that key."""
        rows = self._read(f"SELECT outcome, reason, seen, data, sum {_LATEST}", key)
        if not rows:
            return None
        *values, check = rows[0]
        if check != _sum(key, values[3]):
            raise TornError(f"{self.path} is torn.")
        return Result(*values)

    def outcome(self, key: str) -> tuple[str, str, int] | None:
        """How the latest result of that key ended, the reason, and the last block it had seen."""
        rows = self._read(f"SELECT outcome, reason, seen {_LATEST}", key)
        return rows[0] if rows else None

    def blocks(self, line: str, low: float = -np.inf, high: float = np.inf) -> Iterator[Block]:
        """Blocks of the line with that key and slopes in [low, high], earliest first."""
        found_in = "FROM points WHERE line = ? AND high >= ? AND low <= ? ORDER BY id"
        for (number,) in self._read(f"SELECT id {found_in}", line, low, high):
            ((variables, n, slopes, states),) = self._read(
                "SELECT variables, n, slopes, states FROM points WHERE id = ?", number)
            try:
                found = pack.load(states)
                if len(slopes) != 8 * n or len(found["status"]) != n:
                    raise ValueError
            except (ValueError, KeyError, TypeError) as error:
                raise TornError(f"{self.path} is torn.") from error
            yield Block(number, _words(variables), np.frombuffer(slopes), found)

    def variables(self, block: int) -> dict[str, np.ndarray]:
        """Variables of one block, checked; the last two are kept at hand."""
        if block in self._recent:
            self._recent.move_to_end(block)
            return self._recent[block]
        ((line, check, *row),) = self._read("SELECT line, sum, slopes, states, data FROM points WHERE id = ?", block)
        if check != _sum(line, *row):
            raise TornError(f"{self.path} is torn.")
        self._recent[block] = pack.load(row[2])
        while len(self._recent) > 2:
            self._recent.popitem(last=False)
        return self._recent[block]

    def last_block(self, line: str) -> int:
        """Number of the latest block of a line; 0 where there is none."""
        return self._read("SELECT max(id) FROM points WHERE line = ?", line)[0][0] or 0

    def knows(self, kin: str) -> bool:
        """Whether there is anything from any version of that task with those parameters."""
        return any(self._read(f"SELECT 1 FROM {table} WHERE kin = ? LIMIT 1", kin) for table in _COLUMNS)

    def empty(self) -> bool:
        """Whether there is nothing at all."""
        return not any(self._read(f"SELECT 1 FROM {table} LIMIT 1") for table in _COLUMNS)

    def seconds_per_point(self) -> float | None:
        """Mean measured cost of the latest thousand blocks."""
        latest = "SELECT n, seconds FROM points ORDER BY id DESC LIMIT 1000"
        n, seconds = self._read(f"SELECT sum(n), sum(seconds) FROM ({latest})")[0]
        return seconds / n if n else None

    def small_lines(self) -> list[str]:
        """Keys of lines that are kept in many blocks of few points."""
        return [key for (key,) in self._read(
            f"SELECT line FROM points GROUP BY line HAVING count(*) > {_MANY} AND avg(n) < {_FEW}")]

    def replace_points(self, numbers: Iterable[int], line: str, variables: Iterable[str],
                       row: tuple[bytes, bytes, bytes]) -> None:
        """Put one block in the place of several: all of it or nothing."""
        numbers = sorted(numbers)
        kin, seconds = self._read(f"SELECT max(kin), sum(seconds) FROM points WHERE id IN ({_list(numbers)})")[0]
        slopes = np.frombuffer(row[0])
        self._recent.clear()
        with self._lock:
            self._write("BEGIN IMMEDIATE")
            self._read(f"DELETE FROM points WHERE id IN ({_list(numbers)})")
            self._read(f"INSERT INTO points (id, {_COLUMNS['points']}) VALUES (?,?,?,?,?,?,?,?,?,?,?,?)", numbers[-1],
                       line, kin, " ".join(sorted(variables)), slopes.min(), slopes.max(), len(slopes), seconds,
                       _sum(line, *row), *row)
            self._read("COMMIT")

    def shrink(self) -> None:
        """Give the space of what was replaced back to the disk."""
        pages, free = (self._read(f"PRAGMA {what}")[0][0] for what in ("page_count", "freelist_count"))
        if 2 * free > pages:
            self._read("VACUUM")

    def note(self, key: str) -> str | None:
        """A note kept beside the results."""
        rows = self._read("SELECT value FROM notes WHERE key = ?", key)
        return rows[0][0] if rows else None

    def set_note(self, key: str, value: str) -> None:
        """Keep a note beside the results."""
        self._write("INSERT OR REPLACE INTO notes VALUES (?, ?)", key, value)


@functools.lru_cache(256)
def _words(text: str) -> frozenset[str]:
    return frozenset(text.split())


def _list(numbers: Iterable[int]) -> str:
    return ",".join(str(int(n)) for n in numbers)


def _sum(key: str, *blobs: bytes) -> int:
    return functools.reduce(lambda check, blob: zlib.crc32(blob, check), blobs, zlib.crc32(key.encode()))


def _connect(path: str, write: bool = True, page: int = _PAGE) -> sqlite3.Connection:
    options: dict[str, Any] = {"timeout": 10, "isolation_level": None, "check_same_thread": False}
    if not write and not os.access(Path(path).parent, os.W_OK):
        # SQLite shares a lock file even to read; where it cannot, nobody else writes.
        db = sqlite3.connect(f"file:{quote(path)}?immutable=1", uri=True, **options)
    else:
        db = sqlite3.connect(path, **options)
        db.execute(f"PRAGMA page_size={page}")
        db.execute("PRAGMA journal_mode=WAL")
    for pragma in ("trusted_schema=OFF", "synchronous=NORMAL", "cache_size=-8192"):
        db.execute(f"PRAGMA {pragma}")
    if write and not db.execute("SELECT 1 FROM sqlite_master LIMIT 1").fetchone():
        db.execute("BEGIN IMMEDIATE")
        for statement in _SCHEMA:
            db.execute(statement)
        db.execute("COMMIT")
    found = {sql for (sql,) in db.execute("SELECT sql FROM sqlite_master WHERE sql IS NOT NULL")}
    if found - {"CREATE TABLE sqlite_sequence(name,seq)"} != set(_SCHEMA):
        db.close()
        raise ArchiveError(f"{path} is not a journal of this version of gaitsweep; move it away.")
    return db


def _is_torn(path: Path) -> bool:
    with open(path, "rb") as file:
        page, pages = _layout(file)
    return page * pages > path.stat().st_size


def _layout(file: BinaryIO) -> tuple[int, int]:
    """Size [byte] and number of the pages a database says it has."""
    header = file.read(32)
    return int.from_bytes(header[16:18], "big"), int.from_bytes(header[28:32], "big")


def mend(path: Path) -> None:
    """Write the journal anew with every row that can still be read and whose checksum holds."""
    fresh = path.with_name(path.name + ".mending")
    for suffix in ("", "-wal", "-shm"):
        fresh.with_name(fresh.name + suffix).unlink(missing_ok=True)
    with open(path, "r+b") as file:
        page, pages = _layout(file)
        # SQLite refuses a file shorter than its header says; rows in the missing pages fail one by one.
        file.truncate(max(os.fstat(file.fileno()).st_size, page * pages))
    new = _connect(str(fresh), page=page if page in (_PAGE, _LARGE_PAGE) else _PAGE)
    new.execute("BEGIN")
    with contextlib.suppress(sqlite3.Error), contextlib.closing(sqlite3.connect(path)) as old:
        old.execute("PRAGMA trusted_schema=OFF")
        for table, columns in _COLUMNS.items():
            _salvage(old, new, table, columns)
        for key, value in old.execute("SELECT key, value FROM notes").fetchall():
            new.execute("INSERT OR REPLACE INTO notes VALUES (?, ?)", (key, value))
    new.execute("COMMIT")
    new.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    new.close()
    for suffix in ("-wal", "-shm"):
        path.with_name(path.name + suffix).unlink(missing_ok=True)
    os.replace(fresh, path)


def _salvage(old: sqlite3.Connection, new: sqlite3.Connection, table: str, columns: str) -> None:
    names = columns.split(", ")
    number = lost = 0
    while lost < _GIVE_UP:
        number += 1
        try:
            row = old.execute(f"SELECT {columns} FROM {table} WHERE id = ?", (number,)).fetchone()
            blobs = row[names.index("sum") + 1:]
            if row[names.index("sum")] != _sum(row[0], *blobs):
                raise ValueError
        except (sqlite3.Error, TypeError, ValueError, AttributeError):
            lost += 1
            continue
        lost = 0
        new.execute(f"INSERT INTO {table} (id, {columns}) VALUES ({','.join('?' * (1 + len(names)))})", (number, *row))


def _fail(error: Exception, path: Path) -> NoReturn:
    text = str(error)
    if "disk is full" in text or "No space left" in text or "disk I/O error" in text:
        raise DiskFullError(f"The disk is full: {path} cannot grow; what was finished is kept.") from error
    if "malformed" in text or "not a database" in text or "corrupt" in text:
        raise TornError(f"{path} is torn.") from error
    raise ArchiveError(f"{path} cannot be used: {text}.") from error
