"""The journal of a run: every finished result, in SQLite, safe against any interruption.

A point is identified by the key of its line and its slope. Slopes are compared as arrays, so a grid may be divided into
chunks in any way and refined later. Where a point was computed twice the later result counts. Each row is verified by
its checksum before use: a damaged journal loses its damaged rows only.
"""

from __future__ import annotations

import contextlib
import functools
import sqlite3
import threading
import time
import zlib
from collections import OrderedDict
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pipeline import serialize
from pipeline.statuses import ENDINGS
from pipeline.store import journal_file, rows
from pipeline.store.finished import FinishedChunk, Head
from pipeline.store.journal_file import CorruptJournalError
from pipeline.store.rows import Block, Outcome, Result
from pipeline.store.segment import Segment

_SYNC_INTERVAL = 0.5  # finished work that a power failure may cost [s]
_MIN_SMALL_BLOCKS, _SMALL_BLOCK = 64, 1000  # a line in more blocks than this, of fewer points, is compacted
_MIN_MEASURED = 1000  # points beyond which starting workers no longer dominates their mean cost
_LARGE_JOURNAL = 100_000  # points beyond which blocks take megabytes and larger pages are faster


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
        self._recent: OrderedDict[int, Mapping[str, np.ndarray]] = OrderedDict()
        self._last: dict[str, int] = {}
        self._segment = Segment(path, write)
        try:
            exists = journal_file.is_ours(path)
            page = 0 if exists else journal_file.LARGE_PAGE if points >= _LARGE_JOURNAL else journal_file.PAGE
            self._db = journal_file.connect(path if exists or write else None, write, page)
            if exists or write:
                self._open_segment(write)
        except (sqlite3.Error, OSError, UnicodeDecodeError) as error:
            journal_file.raise_for(error, path)

    def _open_segment(self, write: bool) -> None:
        try:
            end = self._read("SELECT ifnull(max(start + length), 0) FROM points WHERE length > 0")[0][0]
            last = [rows.place("points", row) for row in self._rows("points", "length > 0 ORDER BY id DESC LIMIT 1")]
            if not isinstance(end, int):
                raise CorruptJournalError(self.path)
            journal_file.check_segment(self.path, self._segment, end, last[0] if last else None)
            if write:
                self._segment.resume(end)
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Fold the write-ahead log into the file and close it."""
        with self._lock:
            with contextlib.suppress(sqlite3.Error, OSError):
                self._segment.sync()
                self._db.execute("PRAGMA wal_checkpoint(TRUNCATE)")
            self._db.close()
            self._segment.close()

    def _read(self, sql: str, *values: Any) -> list[tuple[Any, ...]]:
        try:
            with self._lock:
                return self._db.execute(sql, values).fetchall()
        except (sqlite3.Error, OverflowError, UnicodeDecodeError) as error:
            journal_file.raise_for(error, self.path)

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

    def _add(self, table: str, *row: Any, data_sum: int | None = None) -> None:
        with self._lock:
            if table not in self._last:
                self._last[table] = self._read(f"SELECT ifnull(max(id), 0) FROM {table}")[0][0]
            self._last[table] += 1
            self._write(rows.insert(table), *rows.with_checksums(table, self._last[table], *row, data_sum=data_sum))

    def _write(self, sql: str, *values: Any) -> None:
        """Execute one statement, durable at once if the run crashes, within `_SYNC_INTERVAL` if the power fails."""
        clock = time.monotonic()
        synchronous = clock - self._synced > _SYNC_INTERVAL
        self._read(f"PRAGMA synchronous={'FULL' if synchronous else 'NORMAL'}")
        if synchronous:
            try:
                self._segment.sync()
            except OSError as error:
                journal_file.raise_for(error, self.path)
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

    def add_chunk(
        self, line: str, unversioned_key: str, variables: Iterable[str], chunk: tuple[bytes, bytes], cost: float
    ) -> Head:
        """Store a finished chunk of points of one line.

        Parameters
        ----------
        line, unversioned_key : str
        variables : iterable of str
            As for `add_points`.
        chunk : tuple of bytes
            Head and payload.
        cost : float [s]
            Time that each point took.

        Returns
        -------
        Head
        """
        data, payload = chunk
        head = Head(data)
        with self._lock:
            try:
                start = self._segment.append(payload)
            except OSError as error:
                journal_file.raise_for(error, self._segment.path)
            values = (
                unversioned_key,
                _join_words(variables),
                head.low,
                head.high,
                head.points,
                float(cost * head.points),
            )
            place = start, len(payload)
            self._add("points", line, *values, *place, head.digest, data, b"", data_sum=zlib.crc32(payload))
        return head

    def add_result(self, key: str, unversioned_key: str, result: Result, seconds: float) -> None:
        """Store the result of a task over a line or a study."""
        self._add(
            "results", key, unversioned_key, result.outcome, result.reason, result.seen, float(seconds), result.data
        )

    def _latest(self, key: str) -> tuple[Any, ...] | None:
        latest = self._rows("results", "key = ? ORDER BY id DESC LIMIT 1", key)
        if latest and latest[0][3] not in ("ok", *ENDINGS):
            raise CorruptJournalError(self.path)
        return latest[0] if latest else None

    def result(self, key: str) -> Result | None:
        """The latest result of that key."""
        latest = self._latest(key)
        if not latest:
            return None
        number, _, _, outcome, reason, seen, *_ = latest
        data = self._data("results", number)
        with self._unpacking():
            if outcome == "ok":
                serialize.load(data)
        return Result(outcome, reason, seen, data)

    def outcome(self, key: str) -> Outcome | None:
        """How the latest result of that key ended."""
        latest = self._latest(key)
        return Outcome(*latest[3:6]) if latest else None

    def is_outdated(self, key: str, tasks: Iterable[str]) -> bool:
        """Whether any result of these tasks is later than that of the key."""
        later = "SELECT 1 FROM results WHERE id > (SELECT max(id) FROM results WHERE key = ?) AND key LIKE ? LIMIT 1"
        return any(self._read(later, key, f"{task}-%") for task in tasks)

    def blocks(self, line: str, low: float = -np.inf, high: float = np.inf) -> Iterator[Block]:
        """Blocks of the line with that key and slopes in [low, high] [rad], earliest first."""
        query = "SELECT id FROM points WHERE line = ? AND high >= ? AND low <= ? ORDER BY id"
        for (number,) in self._read(query, line, low, high):
            yield self.block(number, line)

    def ranges(self, line: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Numbers of the blocks of a line, earliest first, and the least and largest slope of each.

        Returns
        -------
        numbers : ndarray of int, shape (n,)
        low, high : ndarray, shape (n,) [rad]
        """
        stored = self._read("SELECT id, low, high FROM points WHERE line = ? ORDER BY id", line)
        numbers, low, high = zip(*stored, strict=True) if stored else ((), (), ())
        with self._unpacking():
            return np.array(numbers, int), np.array(low, float), np.array(high, float)

    def block(self, number: int, line: str | None = None) -> Block:
        """The block of that number, and key."""
        rows_found = self._rows("points", "id = ? AND line = ifnull(?, line)", number, line)
        if not rows_found:
            raise CorruptJournalError(self.path)
        row = rows_found[0]
        variables, (slopes, states) = _split_words(row[3]), row[-2:]
        place = rows.place("points", row)
        with self._unpacking():
            if place[1]:
                chunk = FinishedChunk(Head(states), lambda: self._payload(*place))
                return Block(number, variables, chunk, chunk.contents)
            contents = np.frombuffer(slopes), serialize.load(states)
        return Block(number, variables, None, lambda: contents)

    @contextlib.contextmanager
    def _unpacking(self) -> Iterator[None]:
        """Treat bytes that were never packed as damage, whatever their checksum."""
        try:
            yield
        except (ValueError, KeyError, TypeError, IndexError, AttributeError) as error:
            raise CorruptJournalError(self.path) from error

    def _payload(self, start: int, length: int, checksum: int) -> bytes:
        payload = self._segment.read(start, length)
        if zlib.crc32(payload) != checksum:
            raise CorruptJournalError(self.path)
        return payload

    def block_keys(self) -> list[str]:
        """Keys of blocks of lines."""
        query = "SELECT DISTINCT line FROM points WHERE line >= ? AND line < ?"
        return [key for (key,) in self._read(query, f"{rows.BLOCK}-", f"{rows.BLOCK}.")]

    def variables(self, block: int) -> Mapping[str, np.ndarray]:
        """Read the variables of one block; the last two blocks are cached.

        Returns
        -------
        mapping of ndarray, shape (n, gait, ...)
        """
        with self._lock:
            if block in self._recent:
                self._recent.move_to_end(block)
            else:
                chunk = self.block(block).finished
                with self._unpacking():
                    self._recent[block] = serialize.load(self._data("points", block)) if chunk is None else chunk
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
        """Mean cost of a point of long lines in their latest thousand blocks [s]; None if too few were measured."""
        latest = f"SELECT n, seconds FROM points WHERE line NOT LIKE '{rows.BLOCK}-%' ORDER BY id DESC LIMIT 1000"
        n, seconds = self._read(f"SELECT sum(n), sum(seconds) FROM ({latest})")[0]
        return seconds / n if n and n >= _MIN_MEASURED and isinstance(seconds, float) else None

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


def _join_words(words: Iterable[str]) -> str:
    return " ".join(sorted(words))


def _points_row(
    unversioned_key: str, variables: Iterable[str], row: tuple[bytes, bytes, bytes], seconds: float
) -> tuple[Any, ...]:
    """Columns of a block of points after its line, without checksums."""
    slopes = np.frombuffer(row[0])
    limits = float(slopes.min()), float(slopes.max())
    return unversioned_key, _join_words(variables), *limits, len(slopes), float(seconds), 0, 0, *row
