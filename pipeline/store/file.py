"""The file of a store: opened, recognised, repaired and removed."""

import contextlib
import errno
import os
import sqlite3
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NoReturn
from urllib.parse import quote

from gaitsweep.pipeline import paths
from gaitsweep.pipeline.errors import (
    ArchiveError,
    DiskFullError,
    is_disk_full,
    shortage,
    unwritten,
)

_APPLICATION_ID = 0x67735735  # in the header of a store
_PAGE = 8192  # size of its pages [byte]
_SCHEMA = (
    "CREATE TABLE records (id INTEGER PRIMARY KEY, key TEXT, sum INTEGER,"
    " payload_sum INTEGER, head BLOB, payload BLOB)",
    "CREATE TABLE notes (key TEXT PRIMARY KEY, value TEXT)",
)
#: SQLite errors that do not mean a damaged file; others but those of a full disk do.
_HARMLESS = ("PERM", "BUSY", "LOCKED", "NOMEM", "READONLY", "PROTOCOL", "AUTH")
_NOT_THE_FILE = tuple(getattr(sqlite3, f"SQLITE_{name}") for name in _HARMLESS)
_OF_SYSTEM = (sqlite3.SQLITE_IOERR, sqlite3.SQLITE_CANTOPEN)
_READ_ERRORS = (
    sqlite3.SQLITE_IOERR_SHORT_READ,
    sqlite3.SQLITE_IOERR_READ,
    sqlite3.SQLITE_IOERR_CORRUPTFS,
)
#: How a damaged file is read: a schema that cannot be parsed is no reason to read
#: nothing.
_OF_DAMAGED = ("trusted_schema=OFF", "writable_schema=ON")
#: Errors of reading a damaged row: of SQLite, its text, the number of its columns, a
#: number that is none or too large.
_UNREADABLE = (sqlite3.DatabaseError, OverflowError, TypeError, ValueError)
_MAX_GAP = 1000  # records missing in a row where a damaged file is taken to end
#: Files of a store, and how those of SQLite begin, which it writes over and removes.
_BEGINNINGS = {
    "": b"",
    "-wal": rb"\x37\x7f\x06[\x82\x83]",
    "-shm": rb"\x18\xe2\x2d\x00|\x00\x2d\xe2\x18",
    "-journal": rb"\xd9\xd5\x05\xf9\x20\xa1\x63\xd7",
}


class CorruptStoreError(ArchiveError):
    """The store does not hold what was written; `repair` it and plan again."""

    def __init__(self, path: Path):
        self.path = path
        super().__init__(f"{path} is damaged; the next run repairs it.")


def connect(
    path: Path | None, write: bool = True, new: bool = False
) -> sqlite3.Connection:
    """Open a store, or make a new one; without a path, in memory. Its schema is
    checked.
    """
    db = _opened(path, write)
    try:
        _prepare(db, write, new)
        _check(db, write)
    except BaseException:
        db.close()
        if new and path:  # half of a store is none
            _remove(path)
        raise

    return db


def _opened(path: Path | None, write: bool) -> sqlite3.Connection:
    """A connection to a file, or in memory."""
    options: dict[str, Any] = {
        "timeout": 10,
        "isolation_level": None,
        "check_same_thread": False,
    }
    if not path:
        return sqlite3.connect(":memory:", **options)

    may_write = not path.exists() or os.access(path, os.W_OK)
    if write and not may_write:
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))
    if write or (may_write and os.access(path.parent, os.W_OK)):
        return sqlite3.connect(path, **options)

    # SQLite creates a shared lock file even to read; where it may not write the store,
    # it leaves it in the way of who may; in a read-only folder only the files of a
    # writer can be used.
    is_written = path.with_name(path.name + "-wal").exists()
    how = "mode=ro" if is_written else "immutable=1"
    return sqlite3.connect(f"file:{quote(str(path))}?{how}", uri=True, **options)


def _prepare(db: sqlite3.Connection, write: bool, new: bool) -> None:
    """Set how a store is used, and make the tables of a new one."""
    settings = []
    if new:
        settings += [f"page_size={_PAGE}", f"application_id={_APPLICATION_ID}"]
    if write:
        settings.append("journal_mode=WAL")
    settings += [
        "trusted_schema=OFF",
        "synchronous=NORMAL",
        "cache_size=-8192",
        "temp_store=MEMORY",
    ]
    for setting in settings:
        db.execute(f"PRAGMA {setting}")
    if new:
        for statement in ("BEGIN IMMEDIATE", *_SCHEMA, "COMMIT"):
            db.execute(statement)


def _check(db: sqlite3.Connection, write: bool) -> None:
    """Refuse a store of another schema, and to write one whose pages are damaged."""
    rows = db.execute("SELECT sql FROM sqlite_master WHERE sql IS NOT NULL")
    if {sql for (sql,) in rows} != set(_SCHEMA):
        raise sqlite3.DatabaseError("malformed")
    if write and db.execute("PRAGMA quick_check(1)").fetchone() != ("ok",):
        raise sqlite3.DatabaseError("malformed")


def is_ours(path: Path) -> bool:
    """Whether there is a store of this version at `path`.

    Raises
    ------
    ArchiveError
        If there is another file.
    """
    is_there = path.exists() and path.stat().st_size > 0
    for (
        suffix,
        beginning,
    ) in _BEGINNINGS.items():  # beside a store, what bears its name belongs to it
        paths.check_own(
            path.with_name(path.name + suffix), b"" if is_there else beginning
        )

    if not is_there:
        return False

    with open(path, "rb") as file:
        file.seek(68)
        mark = int.from_bytes(file.read(4), "big")

    if mark != _APPLICATION_ID:
        raise ArchiveError(
            f"{path} is not a journal of this version of gaitsweep; move it away."
        )

    return True


def forget(path: Path) -> int:
    """Remove a store and return its size [byte]; a file that is none is left alone.

    Raises
    ------
    ArchiveError
        If there is another file in its place.
    """
    if not is_ours(path):
        return 0
    files = [path.with_name(path.name + suffix) for suffix in ("", "-wal", "-shm")]
    size = sum(file.stat().st_size for file in files if file.exists())
    _remove(path)
    return size


def _remove(path: Path, *suffixes: str) -> None:
    for suffix in suffixes or ("", "-wal", "-shm"):
        path.with_name(path.name + suffix).unlink(missing_ok=True)


def repair(path: Path) -> None:
    """Rewrite a store with the records that SQLite still reads; `Store` checks each
    before it is used.
    """
    draft = paths.of(path)
    paths.discard(path)
    try:
        damaged = sqlite3.connect(path, isolation_level=None)
        with (
            contextlib.closing(connect(draft, new=True)) as new,
            contextlib.closing(damaged) as old,
        ):
            for pragma in _OF_DAMAGED:
                with contextlib.suppress(sqlite3.DatabaseError):
                    old.execute(f"PRAGMA {pragma}")

            for row in _readable(old):
                new.execute(
                    "INSERT OR IGNORE INTO records VALUES (?, ?, ?, ?, ?, ?)", row
                )

            new.execute("PRAGMA wal_checkpoint(TRUNCATE)")

        _remove(path, "-wal", "-shm")
        os.replace(draft, path)
    except (sqlite3.Error, OSError) as error:
        raise_for(error, path)
    finally:
        paths.discard(path)


def _readable(db: sqlite3.Connection) -> Iterator[tuple[Any, ...]]:
    """Whole records of a damaged store, looked up one by one."""
    number, gap = 1, 0
    while gap < _MAX_GAP:
        gap += 1
        with contextlib.suppress(*_UNREADABLE):
            for row in db.execute("SELECT * FROM records WHERE id = ?", (number,)):
                gap = 0
                if is_whole(row):
                    yield row

        if gap == _MAX_GAP:  # as records leave that were stored anew
            with contextlib.suppress(*_UNREADABLE):
                for (found,) in db.execute(
                    "SELECT id FROM records WHERE id > ? ORDER BY id LIMIT 1", (number,)
                ):
                    if found > number:
                        number, gap = found - 1, 0

        number += 1


def sums(number: int, key: str, head: bytes, payload: bytes) -> tuple[int, int]:
    """Checksums of a record: of all but its payload, and of this."""
    named = zlib.crc32(repr((number, key)).encode())
    return zlib.crc32(head, named), zlib.crc32(payload)


def is_whole(row: tuple[Any, ...]) -> bool:
    """Whether a row holds a record as it was written."""
    number, key, head_sum, payload_sum, head, payload = row
    is_typed = (
        isinstance(key, str) and isinstance(head, bytes) and isinstance(payload, bytes)
    )
    return is_typed and sums(number, key, head, payload) == (head_sum, payload_sum)


def raise_for(error: Exception, path: Path) -> NoReturn:
    """Raise the error that says what an error of SQLite or of the system means for the
    store.

    Raises
    ------
    ArchiveError, DiskFullError, WorkerError
        If the file cannot be used or cannot grow, or a limit of the system is reached;
        CorruptStoreError if it is damaged.
    """
    if isinstance(error, sqlite3.ProgrammingError):
        raise error

    code = getattr(error, "sqlite_errorcode", 0)
    # SQLite also reports a full disk as an input or output error, as it does a folder
    # in place of its log.
    is_of_system = isinstance(error, OSError) or (
        code & 0xFF in _OF_SYSTEM and code not in _READ_ERRORS
    )
    cause = None
    if is_of_system:
        cause = shortage(error, path, path.with_name(path.name + "-wal"))
    if code == sqlite3.SQLITE_FULL or (cause and is_disk_full(cause)):
        raise DiskFullError(
            f"The disk is full: {path} cannot grow; finished results are kept."
        ) from error
    if cause:
        raise unwritten(path, cause) from error
    if is_of_system or code & 0xFF in _NOT_THE_FILE:
        raise ArchiveError(f"{path} cannot be used: {error}.") from error

    raise CorruptStoreError(path) from error
