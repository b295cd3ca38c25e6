"""The journal of a run: every finished result, in SQLite, safe against any interruption.

A point is identified by the key of its line and its slope. Slopes are compared as arrays, so a grid may be divided into
chunks in any way and refined later. Where a point was computed twice the later result counts. Each row is verified by
its checksum before use: a damaged journal loses its damaged rows only.
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
from pathlib import Path
from typing import Any, NoReturn
from urllib.parse import quote

import numpy as np

from pipeline import paths, serialize
from pipeline.errors import ArchiveError, DiskFullError, is_disk_full
from pipeline.store import rows, salvage
from pipeline.store.rows import Block, Outcome, Result

_APPLICATION_ID = 0x67735732  # in the header of a journal of this format
_SYNC_INTERVAL = 0.5  # finished work that a power failure may cost [s]
_MIN_SMALL_BLOCKS, _SMALL_BLOCK = 64, 1000  # a line in more blocks than this, of fewer points, is compacted
#: Page sizes [byte]; from `_LARGE_JOURNAL` points on, blocks take megabytes and larger pages are faster.
_PAGE, _LARGE_PAGE, _LARGE_JOURNAL = 4096, 32768, 100_000
#: SQLite errors of a full disk, and errors that do not mean a damaged file; any other does.
_FULL = (sqlite3.SQLITE_FULL, sqlite3.SQLITE_IOERR)
_HARMLESS = ("PERM", "BUSY", "LOCKED", "NOMEM", "READONLY", "PROTOCOL", "CANTOPEN", "AUTH")
_NOT_THE_FILE = tuple(getattr(sqlite3, f"SQLITE_{name}") for name in _HARMLESS)
_READ_ERRORS = (sqlite3.SQLITE_IOERR_SHORT_READ, sqlite3.SQLITE_IOERR_READ, sqlite3.SQLITE_IOERR_CORRUPTFS)


class CorruptJournalError(ArchiveError):
    """The journal does not hold what was written; `repair` it and plan again."""

    def __init__(self, path: Path):
        self.path = path
        super().__init__(f"{path} is damaged; the next run repairs it.")


class Journal:
    """The journal of one archive. The run is its only writer; others open it with `write=False`.

    Parameters
    ----------
    path : Path
    write : bool
    points : int
        Expected number of points, which sets the page size of a new journal.

    Raises
    ------
    ArchiveError, DiskFullError
        If it cannot be opened or is not a journal; CorruptJournalError if it is damaged.
    """

    def __init__(self, path: Path, write: bool = True, points: int = 0):
        self.path, self._lock, self._synced = path, threading.RLock(), 0.0
        self._recent: OrderedDict[int, dict[str, np.ndarray]] = OrderedDict()
        self._last: dict[str, int] = {}
        try:
            exists = _is_ours(path)
            page = 0 if exists else _LARGE_PAGE if points >= _LARGE_JOURNAL else _PAGE
            self._db = _connect(path if exists or write else None, write, page)
        except (sqlite3.Error, OSError) as error:
            _raise_for(error, path)

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
            _raise_for(error, self.path)

    def _rows(self, table: str, condition: str, *values: Any) -> list[tuple[Any, ...]]:
        """Rows from the id on, without their data, after checking their checksums."""
        columns = ", ".join(rows.COLUMNS[table][:-1])
        table_rows = self._read(f"SELECT id, {columns} FROM {table} WHERE {condition}", *values)
        if not all(rows.is_intact(table, row) for row in table_rows):
            raise CorruptJournalError(self.path)
        return table_rows

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
            self._write(rows.insert(table), *rows.with_checksums(table, self._last[table], *row))

    def _write(self, sql: str, *values: Any) -> None:
        """Execute one statement, durable at once if the run crashes, within `_SYNC_INTERVAL` if the power fails."""
        clock = time.monotonic()
        synchronous = clock - self._synced > _SYNC_INTERVAL
        self._read(f"PRAGMA synchronous={'FULL' if synchronous else 'NORMAL'}")
        self._read(sql, *values)
        if synchronous:
            self._synced = clock

    def add_points(
        self, line: str, unversioned_key: str, variables: Iterable[str], row: tuple[bytes, bytes, bytes], seconds: float
    ) -> None:
        """Store a block of points of one line.

        Parameters
        ----------
        line, unversioned_key : str
        variables : iterable of str
            Names of the variables, and of the gaits as `@long`.
        row : tuple of bytes
            Slopes (n float64 [rad]), packed states and packed variables.
        seconds : float [s]
            Time they took.
        """
        self._add("points", line, *_points_row(unversioned_key, variables, row, seconds))

    def add_result(self, key: str, unversioned_key: str, result: Result, seconds: float) -> None:
        """Store the result of a task over a line or a study."""
        self._add(
            "results", key, unversioned_key, result.outcome, result.reason, result.seen, float(seconds), result.data
        )

    def _latest(self, key: str) -> tuple[Any, ...] | None:
        latest = self._rows("results", "key = ? ORDER BY id DESC LIMIT 1", key)
        return latest[0] if latest else None

    def result(self, key: str) -> Result | None:
        """The latest result of that key."""
        latest = self._latest(key)
        if not latest:
            return None
        number, _, _, outcome, reason, seen, *_ = latest
        return Result(outcome, reason, seen, self._data("results", number))

    def outcome(self, key: str) -> Outcome | None:
        """How the latest result of that key ended."""
        latest = self._latest(key)
        return Outcome(*latest[3:6]) if latest else None

    def blocks(self, line: str, low: float = -np.inf, high: float = np.inf) -> Iterator[Block]:
        """Blocks of the line with that key and slopes in [low, high] [rad], earliest first."""
        query = "SELECT id FROM points WHERE line = ? AND high >= ? AND low <= ? ORDER BY id"
        for (number,) in self._read(query, line, low, high):
            yield self.block(number, line)

    def block(self, number: int, line: str | None = None) -> Block:
        """The block of that number, and key."""
        rows_found = self._rows("points", "id = ? AND line = ifnull(?, line)", number, line)
        if not rows_found:
            raise CorruptJournalError(self.path)
        _, _, _, variables, *_, slopes, states = rows_found[0]
        return Block(number, _split_words(variables), np.frombuffer(slopes), serialize.load(states))

    def block_keys(self) -> list[str]:
        """Keys of blocks of lines."""
        query = "SELECT DISTINCT line FROM points WHERE line >= ? AND line < ?"
        return [key for (key,) in self._read(query, f"{rows.BLOCK}-", f"{rows.BLOCK}.")]

    def variables(self, block: int) -> dict[str, np.ndarray]:
        """Read the variables of one block; the last two blocks are cached.

        Returns
        -------
        dict of ndarray, shape (n, gait, ...)
        """
        with self._lock:
            if block in self._recent:
                self._recent.move_to_end(block)
            else:
                self._recent[block] = serialize.load(self._data("points", block))
                while len(self._recent) > 2:
                    self._recent.popitem(last=False)
            return self._recent[block]

    def last_block(self, line: str | None = None) -> int:
        """Number of the latest block, of a line or of all; 0 where there is none."""
        condition, values = ("WHERE line = ?", [line]) if line else ("", [])
        return self._read(f"SELECT max(id) FROM points {condition}", *values)[0][0] or 0

    def knows(self, unversioned_key: str) -> bool:
        """Whether any version of the task has a result for these parameters."""
        return any(
            self._read(f"SELECT 1 FROM {table} WHERE kin = ? LIMIT 1", unversioned_key) for table in rows.COLUMNS
        )

    def empty(self) -> bool:
        """Whether the journal holds no result."""
        return not any(self._read(f"SELECT 1 FROM {table} LIMIT 1") for table in rows.COLUMNS)

    def seconds_per_point(self) -> float | None:
        """Mean cost of a point in the latest thousand blocks [s]; None if there is none."""
        latest = "SELECT n, seconds FROM points ORDER BY id DESC LIMIT 1000"
        n, seconds = self._read(f"SELECT sum(n), sum(seconds) FROM ({latest})")[0]
        return seconds / n if n else None

    def small_lines(self) -> list[str]:
        """Keys of lines stored in many blocks of few points."""
        many_small = f"count(*) > {_MIN_SMALL_BLOCKS} AND avg(n) < {_SMALL_BLOCK}"
        query = f"SELECT line FROM points WHERE line NOT LIKE '{rows.BLOCK}-%' GROUP BY line HAVING {many_small}"
        return [key for (key,) in self._read(query)]

    def replace_points(
        self, numbers: Iterable[int], line: str, variables: Iterable[str], row: tuple[bytes, bytes, bytes]
    ) -> None:
        """Replace several blocks by one, in one transaction."""
        selection = f"FROM points WHERE id IN ({','.join(map(str, numbers := sorted(numbers)))})"
        unversioned_key, seconds = self._read(f"SELECT max(kin), sum(seconds) {selection}")[0]
        self._recent.clear()
        with self._lock:
            self._write("BEGIN IMMEDIATE")
            self._read(f"DELETE {selection}")
            values = _points_row(unversioned_key, variables, row, seconds)
            self._read(rows.insert("points"), *rows.with_checksums("points", numbers[-1], line, *values))
            self._read("COMMIT")

    def shrink(self) -> None:
        """Return the space of replaced rows to the disk."""
        pages, free = (self._read(f"PRAGMA {what}")[0][0] for what in ("page_count", "freelist_count"))
        if 2 * free > pages:
            self._read("VACUUM")

    def note(self, key: str) -> str | None:
        """Value of a note stored beside the results; None if there is none."""
        values = self._read("SELECT value FROM notes WHERE key = ?", key)
        return values[0][0] if values else None

    def set_note(self, key: str, value: str) -> None:
        """Store a note beside the results."""
        self._write("INSERT OR REPLACE INTO notes VALUES (?, ?)", key, value)


@functools.lru_cache(256)
def _split_words(text: str) -> frozenset[str]:
    return frozenset(text.split())


def _points_row(
    unversioned_key: str, variables: Iterable[str], row: tuple[bytes, bytes, bytes], seconds: float
) -> tuple[Any, ...]:
    """Columns of a block of points after its line, without checksums."""
    slopes = np.frombuffer(row[0])
    limits = float(slopes.min()), float(slopes.max())
    return unversioned_key, " ".join(sorted(variables)), *limits, len(slopes), float(seconds), *row


def _connect(path: Path | None, write: bool = True, page: int = 0) -> sqlite3.Connection:
    """Open a journal, or create one with pages of `page` byte; without a path, in memory."""
    options: dict[str, Any] = {"timeout": 10, "isolation_level": None, "check_same_thread": False}
    if path and not write and not os.access(path.parent, os.W_OK):
        # SQLite creates a shared lock file even to read; in a read-only folder only the files of a writer can be used.
        is_written = path.with_name(path.name + "-wal").exists()
        how = "mode=ro" if is_written else "immutable=1"
        db = sqlite3.connect(f"file:{quote(str(path))}?{how}", uri=True, **options)
    else:
        db = sqlite3.connect(path or ":memory:", **options)
    try:
        if page:
            db.execute(f"PRAGMA page_size={page}")
            db.execute(f"PRAGMA application_id={_APPLICATION_ID}")
        if write:
            db.execute("PRAGMA journal_mode=WAL")
        for pragma in ("trusted_schema=OFF", "synchronous=NORMAL", "cache_size=-8192"):
            db.execute(f"PRAGMA {pragma}")
        if page:
            db.execute("BEGIN IMMEDIATE")
            for statement in rows.SCHEMA:
                db.execute(statement)
            db.execute("COMMIT")
        schema = {sql for (sql,) in db.execute("SELECT sql FROM sqlite_master WHERE sql IS NOT NULL")}
        # An incomplete index would hide rows; reading the whole journal is cheap beside computing them.
        if schema != set(rows.SCHEMA) or (write and db.execute("PRAGMA integrity_check(1)").fetchone() != ("ok",)):
            raise sqlite3.DatabaseError("malformed")
    except BaseException:
        db.close()
        raise
    return db


def _is_ours(path: Path) -> bool:
    """Whether there is a journal of this format at `path`: it has the application id or an intact row.

    Raises
    ------
    ArchiveError
        If there is another file.
    """
    if not path.exists() or not path.stat().st_size:
        return False
    with open(path, "rb") as file:
        file.seek(68)
        mark = file.read(4)
    if mark != _APPLICATION_ID.to_bytes(4, "big") and not any(True for _ in _intact_rows(path)):
        raise ArchiveError(f"{path} is not a journal of this version of gaitsweep; move it away.")
    return True


def _intact_rows(path: Path) -> Iterator[tuple[str, tuple[Any, ...]]]:
    """Intact rows of a journal, each with its table, however damaged the rest is."""
    for size in (_PAGE, _LARGE_PAGE):
        yield from salvage.rows(path, size, rows.parse)


def forget(path: Path) -> None:
    """Remove a journal; a file that is none is left alone.

    Raises
    ------
    ArchiveError
        If there is another file at `path`.
    """
    if _is_ours(path):
        _remove(path)


def _remove(path: Path, *suffixes: str) -> None:
    for suffix in suffixes or ("", "-wal", "-shm"):
        path.with_name(path.name + suffix).unlink(missing_ok=True)


def repair(path: Path) -> None:
    """Rewrite the journal with its intact rows."""
    draft = paths.of(path)
    paths.discard(path)
    try:
        page = _LARGE_PAGE if path.stat().st_size > 1 << 24 else _PAGE
        with contextlib.closing(_connect(draft, page=page)) as journal:
            for table, row in _intact_rows(path):
                if table == "points":  # a compacted block has the number of its last part, and more points
                    journal.execute("DELETE FROM points WHERE id = ? AND n < ?", (row[0], row[6]))
                journal.execute(rows.insert(table, "OR IGNORE"), row)
            journal.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        _remove(path, "-wal", "-shm")
        os.replace(draft, path)
    except (sqlite3.Error, OSError) as error:
        _raise_for(error, path)
    finally:
        paths.discard(path)


def _raise_for(error: Exception, path: Path) -> NoReturn:
    if isinstance(error, sqlite3.ProgrammingError):
        raise error
    code = getattr(error, "sqlite_errorcode", 0)
    if (code & 0xFF in _FULL and code not in _READ_ERRORS) or is_disk_full(error):
        raise DiskFullError(f"The disk is full: {path} cannot grow; finished results are kept.") from error
    if code & 0xFF in _NOT_THE_FILE or isinstance(error, OSError):
        raise ArchiveError(f"{path} cannot be used: {error}.") from error
    raise CorruptJournalError(path) from error
