"""The journal of one archive: a store in a file of SQLite beside it.

A record is verified by checksums before use: a damaged file loses its damaged records
only.
"""

import contextlib
import hashlib
import sqlite3
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from gaitsweep.pipeline.store import file
from gaitsweep.pipeline.store.file import CorruptStoreError
from gaitsweep.pipeline.store.record import Record
from gaitsweep.pipeline.store.store import Store

_SYNC_INTERVAL = 0.5  # finished work that a power failure may cost [s]


class Journal(Store):
    """Records of one archive. The run is their only writer, one thread at a time;
    others open it with `write=False`.

    Parameters
    ----------
    path : Path
    write : bool

    Raises
    ------
    ArchiveError, DiskFullError
        If it cannot be opened or is no journal; CorruptStoreError if it is damaged.
    """

    def __init__(self, path: Path, write: bool = True):
        self.path = path
        self._synced = 0.0
        try:
            exists = file.is_ours(path)
            there = path if exists or write else None
            self._db = file.connect(there, write, not exists)
        except (sqlite3.Error, OSError, UnicodeDecodeError) as error:
            file.raise_for(error, path)

        try:
            self._last = self._index()
        except BaseException:
            self.close()
            raise

    def _index(self) -> int:
        """Index the records by their keys; returns the number of the latest.

        Of a million records, a dictionary by their keys would take a fifth of a
        gigabyte.
        """
        self._db.create_function("short", 1, _short, deterministic=True)
        self._execute(
            "CREATE TEMP TABLE numbers (short INTEGER PRIMARY KEY, id INTEGER)"
        )
        self._execute(
            "INSERT OR REPLACE INTO numbers"
            " SELECT short(key), id FROM records ORDER BY id"
        )
        ((last,),) = self._execute("SELECT ifnull(max(id), 0) FROM numbers")
        return int(last)

    def close(self) -> None:
        """Fold the write-ahead log into the file and close it."""
        with contextlib.suppress(sqlite3.Error):
            self._db.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        self._db.close()

    @property
    def last(self) -> int:
        """Number of the latest record."""
        return self._last

    def damage(self) -> CorruptStoreError:
        """Error that says that the journal is to be repaired."""
        return CorruptStoreError(self.path)

    def __contains__(self, key: object) -> bool:
        return self.number(str(key)) > 0

    def __iter__(self) -> Iterator[str]:
        rows = self._execute("SELECT key FROM records ORDER BY id")
        return (str(key) for (key,) in rows)

    def number(self, key: str) -> int:
        """Number of the latest record with that key; 0 if there is none."""
        numbers = self._execute("SELECT id FROM numbers WHERE short = ?", _short(key))
        return int(numbers[0][0]) if numbers else 0

    def put(self, key: str, record: Record) -> None:
        """Store a record, instead of an earlier one with its key.

        Durable at once if the run crashes, within `_SYNC_INTERVAL` if the power fails.
        """
        clock = time.monotonic()
        is_synchronous = clock - self._synced > _SYNC_INTERVAL
        self._execute(f"PRAGMA synchronous={'FULL' if is_synchronous else 'NORMAL'}")

        earlier = self.number(key)
        number = self._last + 1
        sums = file.sums(number, key, record.head, record.data)
        self._execute(
            "INSERT INTO records VALUES (?, ?, ?, ?, ?, ?)",
            number,
            key,
            *sums,
            record.head,
            record.data,
        )
        self._last = number
        if earlier:  # if this is lost, the later one counts
            self._execute("DELETE FROM records WHERE id = ?", earlier)
        if is_synchronous:
            self._synced = clock
        self._execute(
            "INSERT OR REPLACE INTO numbers VALUES (?, ?)", _short(key), number
        )

    def head(self, key: str) -> bytes | None:
        """Head of a record, without reading its payload; None if there is none."""
        rows = self._execute(
            "SELECT id, sum, head FROM numbers LEFT JOIN records USING (id)"
            " WHERE short = ?",
            _short(key),
        )
        if not rows:
            return None

        ((number, expected, head),) = rows
        if not isinstance(head, bytes):
            raise self.damage()
        found, _ = file.sums(number, key, head, b"")
        if found != expected:
            raise self.damage()

        return head

    def get(self, key: str) -> Record:
        """A record.

        Raises
        ------
        CorruptStoreError
            If there is none, or it is not as it was written.
        """
        rows = self._execute("SELECT * FROM records WHERE id = ?", self.number(key))
        for row in rows:
            if row[1] == key and file.is_whole(row):
                return Record(*row[-2:])
        raise self.damage()

    def note(self, name: str) -> str | None:
        """A note stored beside the records; None if there is none."""
        values = self._execute("SELECT value FROM notes WHERE key = ?", name)
        return values[0][0] if values else None

    def set_note(self, name: str, text: str) -> None:
        """Store a note beside the records."""
        self._execute("INSERT OR REPLACE INTO notes VALUES (?, ?)", name, text)

    def _execute(self, sql: str, *values: Any) -> list[tuple[Any, ...]]:
        try:
            return self._db.execute(sql, values).fetchall()
        except (sqlite3.Error, OverflowError, UnicodeDecodeError) as error:
            file.raise_for(error, self.path)


def _short(key: str) -> int:
    """Number that stands for a key, of 64 bits: that two of a million keys share one
    has a probability of 3e-8.
    """
    hashed = hashlib.blake2b(str(key).encode(), digest_size=8)
    return int.from_bytes(hashed.digest(), "little", signed=True)
