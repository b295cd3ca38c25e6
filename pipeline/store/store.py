"""The store of one archive: records by key, in a file of SQLite beside it.

A record has a head, which is small, and a payload. It is verified by checksums before
use: a damaged file loses its damaged records only.
"""

import contextlib
import functools
import hashlib
import sqlite3
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

from gaitsweep.pipeline import serialize
from gaitsweep.pipeline.statuses import ENDINGS
from gaitsweep.pipeline.store import file
from gaitsweep.pipeline.store.file import CorruptStoreError
from gaitsweep.pipeline.store.record import Head, Points, unpacked

_SYNC_INTERVAL = 0.5  # finished work that a power failure may cost [s]
#: Largest payload [byte]; SQLite has rows of at most 10^9 byte.
MAX_PAYLOAD = 999_000_000


class Key(NamedTuple):
    """Key of a record; `kin` is the same for all versions of the task."""

    key: str
    kin: str


class Outcome(NamedTuple):
    """How a task ended: "ok" or a name of `statuses.ENDINGS`, and the reason."""

    status: str
    reason: str


class Store:
    """Records of one archive. The run is their only writer, one thread at a time;
    others open it with `write=False`.

    Parameters
    ----------
    path : Path
    write : bool

    Attributes
    ----------
    last : int
        Number of the latest record.

    Raises
    ------
    ArchiveError, DiskFullError
        If it cannot be opened or is no store; CorruptStoreError if it is damaged.
    """

    def __init__(self, path: Path, write: bool = True):
        self.path, self._synced = path, 0.0
        try:
            exists = file.is_ours(path)
            self._db = file.connect(
                path if exists or write else None, write, not exists
            )
        except (sqlite3.Error, OSError, UnicodeDecodeError) as error:
            file.raise_for(error, path)
        try:
            # Of a million records, a dictionary by their keys would take a fifth of a
            # gigabyte.
            self._db.create_function("short", 1, _short, deterministic=True)
            self._execute(
                "CREATE TEMP TABLE numbers (short INTEGER PRIMARY KEY, id INTEGER)"
            )
            self._execute(
                "INSERT OR REPLACE INTO numbers SELECT short(key), id FROM records ORDER BY id"
            )
            self.last: int = self._execute("SELECT ifnull(max(id), 0) FROM numbers")[0][
                0
            ]
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Fold the write-ahead log into the file and close it."""
        with contextlib.suppress(sqlite3.Error):
            self._db.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        self._db.close()

    def __contains__(self, key: str) -> bool:
        return self.number(key) > 0

    def __bool__(self) -> bool:
        return self.last > 0

    def number(self, key: str) -> int:
        """Number of the latest record with that key, which later ones have larger; 0 if
        there is none.
        """
        numbers = self._execute("SELECT id FROM numbers WHERE short = ?", _short(key))
        return int(numbers[0][0]) if numbers else 0

    def __iter__(self) -> Iterator[str]:
        """Keys of all records, in the order of their numbers."""
        return (
            str(key) for (key,) in self._execute("SELECT key FROM records ORDER BY id")
        )

    def knows(self, kin: str) -> bool:
        """Whether there was a record of any version of the task with these parameters
        when this was first asked.
        """
        return kin in self._kin

    @functools.cached_property
    def _kin(self) -> set[str]:
        return {str(kin) for (kin,) in self._execute("SELECT kin FROM records")}

    def put(self, key: Key, head: bytes, payload: bytes) -> None:
        """Store a record, instead of an earlier one with its key.

        Durable at once if the run crashes, within `_SYNC_INTERVAL` if the power fails.
        """
        clock, earlier = time.monotonic(), self.number(key.key)
        is_synchronous = clock - self._synced > _SYNC_INTERVAL
        self._execute(f"PRAGMA synchronous={'FULL' if is_synchronous else 'NORMAL'}")
        number = self.last + 1
        sums = file.sums(number, *key, head, payload)
        self._execute(
            "INSERT INTO records VALUES (?, ?, ?, ?, ?, ?, ?)",
            number,
            *key,
            *sums,
            head,
            payload,
        )
        self.last = number
        if earlier:  # if this is lost, the later one counts
            self._execute("DELETE FROM records WHERE id = ?", earlier)
        self._synced = clock if is_synchronous else self._synced
        self._execute(
            "INSERT OR REPLACE INTO numbers VALUES (?, ?)", _short(key.key), number
        )

    def head(self, key: str) -> bytes:
        """Head of a record, without reading its payload."""
        number = self.number(key)
        for kin, own, head in self._execute(
            "SELECT kin, sum, head FROM records WHERE id = ?", number
        ):
            if (
                isinstance(head, bytes)
                and file.sums(number, key, kin, head, b"")[0] == own
            ):
                return head
        raise CorruptStoreError(self.path)

    def get(self, key: str) -> tuple[bytes, bytes]:
        """Head and payload of a record.

        Raises
        ------
        CorruptStoreError
            If it is not as it was written.
        """
        for row in self._execute(
            "SELECT * FROM records WHERE id = ?", self.number(key)
        ):
            if row[1] == key and file.is_whole(row):
                return row[-2:]
        raise CorruptStoreError(self.path)

    def chunk(self, key: str) -> Head:
        """Contents of the record of a chunk."""
        with self.reading():
            return Head(self.head(key))

    def points(self, key: str, names: Iterable[str] | None = None) -> Points:
        """Points in the record of a chunk, with all its variables or some."""
        with self.reading():
            return unpacked(*self.get(key), names)

    def put_result(self, key: Key, outcome: Outcome, result: bytes) -> None:
        """Store the result of a task over a line or a study."""
        self.put(key, serialize.dump(list(outcome)), result)

    def outcome(self, key: str) -> Outcome | None:
        """How the task of that key ended; None if it has no result."""
        if key not in self:
            return None
        with self.reading():
            outcome = Outcome(*serialize.load(self.head(key)))
            if outcome.status not in ("ok", *ENDINGS):
                raise ValueError(outcome.status)
            return outcome

    def result(self, key: str) -> Any:
        """Result of a task; None if it has none, or failed."""
        outcome = self.outcome(key)
        if outcome is None or outcome.status != "ok":
            return None
        with self.reading():
            return serialize.load(self.get(key)[1])

    @contextlib.contextmanager
    def reading(self) -> Iterator[None]:
        """Treat bytes that were never packed as damage, whatever their checksum."""
        try:
            yield
        except (ValueError, KeyError, TypeError, IndexError, AttributeError) as error:
            raise CorruptStoreError(self.path) from error

    def note(self, key: str) -> str | None:
        """Value of a note stored beside the records; None if there is none."""
        values = self._execute("SELECT value FROM notes WHERE key = ?", key)
        return values[0][0] if values else None

    def set_note(self, key: str, value: str) -> None:
        """Store a note beside the records."""
        self._execute("INSERT OR REPLACE INTO notes VALUES (?, ?)", key, value)

    def _execute(self, sql: str, *values: Any) -> list[tuple[Any, ...]]:
        try:
            return self._db.execute(sql, values).fetchall()
        except (sqlite3.Error, OverflowError, UnicodeDecodeError) as error:
            file.raise_for(error, self.path)


def _short(key: str) -> int:
    """Number that stands for a key, of 64 bits: that two of a million keys share one
    has a probability of 3e-8.
    """
    return int.from_bytes(
        hashlib.blake2b(str(key).encode(), digest_size=8).digest(),
        "little",
        signed=True,
    )
