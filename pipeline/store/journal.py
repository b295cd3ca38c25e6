"""The journal of a run: every finished result, in SQLite, safe against whatever ends the run.

A point is found by its line's key and its slope; slopes are compared as arrays, so a grid may be cut into
chunks in any way and made denser later. Where a point was computed twice the later result counts. Everything a
row holds is under its checksum, which is looked at first: a torn journal loses the rows that are torn and no other.
"""

from __future__ import annotations

import contextlib
import errno
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
from typing import Any, NoReturn
from urllib.parse import quote

import numpy as np

from pipeline import paths, serialize
from pipeline.errors import ArchiveError, DiskFullError
from pipeline.store import rows, salvage

_MARK = 0x67735732  # in the header of a journal of this version
_SYNC = 0.5  # s: how much finished work a power cut may cost
_MANY, _FEW = 64, 1000  # blocks of a line, and points in one, from which they are put together
#: Size of a page [byte], and of one where so many points come in blocks of megabytes: every page costs.
_PAGE, _LARGE_PAGE, _LARGE = 4096, 32768, 100_000
#: What SQLite says where the disk is full, and what is no fault of the file's; anything else is.
_FULL = (sqlite3.SQLITE_FULL, sqlite3.SQLITE_IOERR)
_INNOCENT = (
    sqlite3.SQLITE_PERM,
    sqlite3.SQLITE_BUSY,
    sqlite3.SQLITE_LOCKED,
    sqlite3.SQLITE_NOMEM,
    sqlite3.SQLITE_READONLY,
    sqlite3.SQLITE_PROTOCOL,
    sqlite3.SQLITE_CANTOPEN,
    sqlite3.SQLITE_AUTH,
)
_UNREAD = (sqlite3.SQLITE_IOERR_SHORT_READ, sqlite3.SQLITE_IOERR_READ, sqlite3.SQLITE_IOERR_CORRUPTFS)


class CorruptJournalError(ArchiveError):
    """The journal does not hold what was written; `mend` it and plan again."""

    def __init__(self, path: Path):
        super().__init__(f"{path} is damaged; the next run mends it.")


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
        self._last: dict[str, int] = {}
        try:
            there = _is_ours(path)
            page = 0 if there else _LARGE_PAGE if points >= _LARGE else _PAGE
            self._db = _connect(path if there or write else None, write, page)
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
        except (sqlite3.Error, OverflowError) as error:
            _fail(error, self.path)

    def _rows(self, table: str, where: str, *values: Any) -> list[tuple[Any, ...]]:
        """Rows without their data, from the id on, whose checksum was looked at."""
        found = self._read(f"SELECT id, {', '.join(rows.COLUMNS[table][:-1])} FROM {table} WHERE {where}", *values)
        if not all(rows.is_whole(table, row) for row in found):
            raise CorruptJournalError(self.path)
        return found

    def _data(self, table: str, number: int) -> bytes:
        for check, data in self._read(f"SELECT data_sum, data FROM {table} WHERE id = ?", number):
            if isinstance(data, bytes) and check == zlib.crc32(data):
                return data
        raise CorruptJournalError(self.path)

    def _add(self, table: str, *row: Any) -> None:
        with self._lock:
            if table not in self._last:
                self._last[table] = self._read(f"SELECT ifnull(max(id), 0) FROM {table}")[0][0]
            self._last[table] += 1
            self._write(rows.insert(table), *rows.summed(table, self._last[table], *row))

    def _write(self, sql: str, *values: Any) -> None:
        """One durable statement: against a crash of the run at once, of the machine within `_SYNC`."""
        now = time.monotonic()
        full = now - self._synced > _SYNC
        self._read(f"PRAGMA synchronous={'FULL' if full else 'NORMAL'}")
        self._read(sql, *values)
        if full:
            self._synced = now

    def add_points(
        self, line: str, unversioned_key: str, variables: Iterable[str], row: tuple[bytes, bytes, bytes], seconds: float
    ) -> None:
        """Keep a block of points (slopes, packed states, packed variables) of the line with that key."""
        self._add("points", line, *_points(unversioned_key, variables, row, seconds))

    def add_result(self, key: str, unversioned_key: str, result: Result, seconds: float) -> None:
        """Keep the result of a task that is no block of points."""
        self._add(
            "results", key, unversioned_key, result.outcome, result.reason, result.seen, float(seconds), result.data
        )

    def _latest(self, key: str) -> tuple[Any, ...] | None:
        found = self._rows("results", "key = ? ORDER BY id DESC LIMIT 1", key)
        return found[0] if found else None

    def result(self, key: str) -> Result | None:
        """The latest result of that key."""
        found = self._latest(key)
        if not found:
            return None
        number, _, _, outcome, reason, seen, *_ = found
        return Result(outcome, reason, seen, self._data("results", number))

    def outcome(self, key: str) -> tuple[str, str, int] | None:
        """How the latest result of that key ended, the reason, and the last block it had seen."""
        found = self._latest(key)
        return found[3:6] if found else None  # type: ignore[return-value]

    def blocks(self, line: str, low: float = -np.inf, high: float = np.inf) -> Iterator[Block]:
        """Blocks of the line with that key and slopes in [low, high], earliest first."""
        found_in = "FROM points WHERE line = ? AND high >= ? AND low <= ? ORDER BY id"
        for (number,) in self._read(f"SELECT id {found_in}", line, low, high):
            found = self._rows("points", "id = ? AND line = ?", number, line)
            if not found:
                raise CorruptJournalError(self.path)
            yield Block(number, _words(found[0][3]), np.frombuffer(found[0][10]), serialize.load(found[0][11]))

    def variables(self, block: int) -> dict[str, np.ndarray]:
        """Variables of one block; the last two are kept at hand."""
        if block in self._recent:
            self._recent.move_to_end(block)
            return self._recent[block]
        self._recent[block] = serialize.load(self._data("points", block))
        while len(self._recent) > 2:
            self._recent.popitem(last=False)
        return self._recent[block]

    def last_block(self, line: str) -> int:
        """Number of the latest block of a line; 0 where there is none."""
        return self._read("SELECT max(id) FROM points WHERE line = ?", line)[0][0] or 0

    def knows(self, unversioned_key: str) -> bool:
        """Whether there is anything from any version of that task with those parameters."""
        return any(
            self._read(f"SELECT 1 FROM {table} WHERE kin = ? LIMIT 1", unversioned_key) for table in rows.COLUMNS
        )

    def empty(self) -> bool:
        """Whether there is nothing at all."""
        return not any(self._read(f"SELECT 1 FROM {table} LIMIT 1") for table in rows.COLUMNS)

    def seconds_per_point(self) -> float | None:
        """Mean measured cost of the latest thousand blocks."""
        latest = "SELECT n, seconds FROM points ORDER BY id DESC LIMIT 1000"
        n, seconds = self._read(f"SELECT sum(n), sum(seconds) FROM ({latest})")[0]
        return seconds / n if n else None

    def small_lines(self) -> list[str]:
        """Keys of lines that are kept in many blocks of few points."""
        return [
            key
            for (key,) in self._read(
                f"SELECT line FROM points GROUP BY line HAVING count(*) > {_MANY} AND avg(n) < {_FEW}"
            )
        ]

    def replace_points(
        self, numbers: Iterable[int], line: str, variables: Iterable[str], row: tuple[bytes, bytes, bytes]
    ) -> None:
        """Put one block in the place of several: all of it or nothing."""
        numbers = sorted(numbers)
        unversioned_key, seconds = self._read(
            f"SELECT max(kin), sum(seconds) FROM points WHERE id IN ({_list(numbers)})"
        )[0]
        self._recent.clear()
        with self._lock:
            self._write("BEGIN IMMEDIATE")
            self._read(f"DELETE FROM points WHERE id IN ({_list(numbers)})")
            whole = rows.summed("points", numbers[-1], line, *_points(unversioned_key, variables, row, seconds))
            self._read(rows.insert("points"), *whole)
            self._read("COMMIT")

    def shrink(self) -> None:
        """Give the space of what was replaced back to the disk."""
        pages, free = (self._read(f"PRAGMA {what}")[0][0] for what in ("page_count", "freelist_count"))
        if 2 * free > pages:
            self._read("VACUUM")

    def note(self, key: str) -> str | None:
        """A note kept beside the results."""
        found = self._read("SELECT value FROM notes WHERE key = ?", key)
        return found[0][0] if found else None

    def set_note(self, key: str, value: str) -> None:
        """Keep a note beside the results."""
        self._write("INSERT OR REPLACE INTO notes VALUES (?, ?)", key, value)


@functools.lru_cache(256)
def _words(text: str) -> frozenset[str]:
    return frozenset(text.split())


def _list(numbers: Iterable[int]) -> str:
    return ",".join(str(int(n)) for n in numbers)


def _points(
    unversioned_key: str, variables: Iterable[str], row: tuple[bytes, bytes, bytes], seconds: float
) -> tuple[Any, ...]:
    """What a block of points holds beside its line, checksums left out."""
    slopes = np.frombuffer(row[0])
    return (
        unversioned_key,
        " ".join(sorted(variables)),
        float(slopes.min()),
        float(slopes.max()),
        len(slopes),
        float(seconds),
        *row,
    )


def _connect(path: Path | None, write: bool = True, page: int = 0) -> sqlite3.Connection:
    """Open a journal, or make one with pages of that size; without a path in memory."""
    options: dict[str, Any] = {"timeout": 10, "isolation_level": None, "check_same_thread": False}
    if path and not write and not os.access(path.parent, os.W_OK):
        # SQLite shares a lock file even to read; where it cannot, nobody else writes.
        db = sqlite3.connect(f"file:{quote(str(path))}?immutable=1", uri=True, **options)
    else:
        db = sqlite3.connect(path or ":memory:", **options)
    try:
        if page:
            db.execute(f"PRAGMA page_size={page}")
            db.execute(f"PRAGMA application_id={_MARK}")
        if write:
            db.execute("PRAGMA journal_mode=WAL")
        for pragma in ("trusted_schema=OFF", "synchronous=NORMAL", "cache_size=-8192"):
            db.execute(f"PRAGMA {pragma}")
        if page:
            db.execute("BEGIN IMMEDIATE")
            for statement in rows.SCHEMA:
                db.execute(statement)
            db.execute("COMMIT")
        found = {sql for (sql,) in db.execute("SELECT sql FROM sqlite_master WHERE sql IS NOT NULL")}
        # An index that misses rows would hide them; to read a journal through is little beside what comes of it.
        if found != set(rows.SCHEMA) or (write and db.execute("PRAGMA integrity_check(1)").fetchone() != ("ok",)):
            raise sqlite3.DatabaseError("malformed")
    except BaseException:
        db.close()
        raise
    return db


def _is_ours(path: Path) -> bool:
    """Whether there is a journal of this version at `path`: it has the mark of one, or a row.

    Raises
    ------
    ArchiveError
        If there is anything else.
    """
    if not path.exists() or not path.stat().st_size:
        return False
    with open(path, "rb") as file:
        file.seek(68)
        mark = file.read(4)
    if mark != _MARK.to_bytes(4, "big") and not any(True for _ in _whole_rows(path)):
        raise ArchiveError(f"{path} is not a journal of this version of gaitsweep; move it away.")
    return True


def _whole_rows(path: Path) -> Iterator[tuple[str, tuple[Any, ...]]]:
    """Every row of a journal, and its table, that is as it was written, whatever became of the rest."""
    for size in (_PAGE, _LARGE_PAGE):
        yield from salvage.rows(path, size, rows.found)


def forget(path: Path) -> None:
    """Remove a journal, but no file of somebody else's."""
    if _is_ours(path):
        _remove(path)


def _remove(path: Path, *suffixes: str) -> None:
    for suffix in suffixes or ("", "-wal", "-shm"):
        path.with_name(path.name + suffix).unlink(missing_ok=True)


def repair(path: Path) -> None:
    """Write the journal anew with every row that is whole."""
    fresh = paths.of(path)
    paths.discard(path)
    try:
        page = _LARGE_PAGE if path.stat().st_size > 1 << 24 else _PAGE
        with contextlib.closing(_connect(fresh, page=page)) as new:
            for table, row in _whole_rows(path):
                if table == "points":  # what took the place of several has the number of the last, and more points
                    new.execute("DELETE FROM points WHERE id = ? AND n < ?", (row[0], row[6]))
                new.execute(rows.insert(table, "OR IGNORE"), row)
            new.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        _remove(path, "-wal", "-shm")
        os.replace(fresh, path)
    except (sqlite3.Error, OSError) as error:
        _fail(error, path)
    finally:
        paths.discard(path)


def _fail(error: Exception, path: Path) -> NoReturn:
    if isinstance(error, sqlite3.ProgrammingError):
        raise error
    code = getattr(error, "sqlite_errorcode", 0)
    if (code & 0xFF in _FULL and code not in _UNREAD) or getattr(error, "errno", 0) in (errno.ENOSPC, errno.EDQUOT):
        raise DiskFullError(f"The disk is full: {path} cannot grow; what was finished is kept.") from error
    if code & 0xFF in _INNOCENT or isinstance(error, OSError):
        raise ArchiveError(f"{path} cannot be used: {error}.") from error
    raise CorruptJournalError(path) from error
