"""The files of a journal: opened, recognised, repaired and removed.

They are the SQLite file with its log, and beside it the segment of finished chunks.
"""

from __future__ import annotations

import contextlib
import errno
import os
import sqlite3
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NoReturn
from urllib.parse import quote

from pipeline import paths
from pipeline.errors import ArchiveError, DiskFullError, is_disk_full, shortage, unwritten
from pipeline.store import rows, salvage
from pipeline.store.segment import MAGIC, SUFFIX, Segment

_APPLICATION_ID = 0x67735733  # in the header of a journal of this format
_EARLIER_IDS = (0x67735732,)
PAGE, LARGE_PAGE = 4096, 32768  # page sizes [byte]
#: SQLite errors that do not mean a damaged file; others but those of a full disk do.
_HARMLESS = ("PERM", "BUSY", "LOCKED", "NOMEM", "READONLY", "PROTOCOL", "CANTOPEN", "AUTH")
_NOT_THE_FILE = tuple(getattr(sqlite3, f"SQLITE_{name}") for name in _HARMLESS)
_READ_ERRORS = (sqlite3.SQLITE_IOERR_SHORT_READ, sqlite3.SQLITE_IOERR_READ, sqlite3.SQLITE_IOERR_CORRUPTFS)


#: Files of a journal, and how those of SQLite begin, which it writes over and removes.
_BEGINNINGS = {
    "": b"",
    "-wal": rb"\x37\x7f\x06[\x82\x83]",
    "-shm": rb"\x18\xe2\x2d\x00|\x00\x2d\xe2\x18",
    "-journal": rb"\xd9\xd5\x05\xf9\x20\xa1\x63\xd7",
    SUFFIX: MAGIC,
}


class CorruptJournalError(ArchiveError):
    """The journal does not hold what was written; `repair` it and plan again."""

    def __init__(self, path: Path):
        self.path = path
        super().__init__(f"{path} is damaged; the next run repairs it.")


def connect(path: Path | None, write: bool = True, page: int = 0, check: bool = True) -> sqlite3.Connection:
    """Open a journal, or create one with pages of `page` byte; without a path, in memory. Its schema is checked."""
    options: dict[str, Any] = {"timeout": 10, "isolation_level": None, "check_same_thread": False}
    may_write = not path or not path.exists() or os.access(path, os.W_OK)
    if write and not may_write:
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))
    if path and not write and not (may_write and os.access(path.parent, os.W_OK)):
        # SQLite creates a shared lock file even to read; where it may not write the journal, it leaves it in the way
        # of who may; in a read-only folder only the files of a writer can be used.
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
        # An incomplete index would hide rows; reading the whole journal is cheaper than computing them.
        if check and schema != set(rows.SCHEMA):
            raise sqlite3.DatabaseError("malformed")
        if write and db.execute("PRAGMA integrity_check(1)").fetchone() != ("ok",):
            raise sqlite3.DatabaseError("malformed")
    except BaseException:
        db.close()
        if page and path:  # half of a journal is none
            _remove(path)
        raise
    return db


def is_ours(path: Path) -> bool:
    """Whether there is a journal of this format at `path`: it has the application id or an intact row.

    Raises
    ------
    ArchiveError
        If there is another file, or a journal of an earlier version.
    """
    is_there = path.exists() and path.stat().st_size > 0
    for suffix, beginning in _BEGINNINGS.items():  # beside a journal, what bears its name belongs to it
        paths.check_own(path.with_name(path.name + suffix), b"" if is_there else beginning)
    if not is_there:
        return False
    mark = _mark(path)
    if mark in _EARLIER_IDS:
        cost = _cost(path)
        raise ArchiveError(f"{path} is a journal of an earlier version; `run --fresh` replaces it{cost}.")
    if mark != _APPLICATION_ID and not any(True for _ in _intact_rows(path)):
        raise ArchiveError(f"{path} is not a journal of this version of gaitsweep; move it away.")
    return True


def _mark(path: Path) -> int:
    """Application id in the header of a file."""
    with open(path, "rb") as file:
        file.seek(68)
        return int.from_bytes(file.read(4), "big")


def _cost(path: Path) -> str:
    """What the results of an earlier version's journal cost, as the end of a sentence."""
    with (
        contextlib.suppress(sqlite3.Error, UnicodeDecodeError),
        contextlib.closing(connect(path, write=False, check=False)) as db,
    ):
        n, seconds = db.execute("SELECT sum(n), sum(seconds) FROM points").fetchone()
        if n:
            return f" and computes its {n:,} points again, which took {seconds:,.0f} s of processor time"
    return ""


def check_segment(path: Path, segment: Segment, end: int, last: tuple[int, int, int] | None) -> None:
    """Check that a segment is the one of the journal at `path`, and as long as its rows say.

    Parameters
    ----------
    path : Path
    segment : Segment
    end : int
        Where the last payload ends; 0 if there is none.
    last : tuple of int, optional
        Offset, length and checksum of the latest payload.

    Raises
    ------
    CorruptJournalError
        If payloads are lost.
    ArchiveError
        If there is another file in its place.
    """
    if not segment.is_ours() and not last:
        raise ArchiveError(f"{segment.path} is not a file of gaitsweep; move it away.")
    if last and (segment.size < end or not segment.is_ours() or not _is_whole(segment, *last)):
        raise CorruptJournalError(path)


def _is_whole(segment: Segment, start: int, length: int, checksum: int) -> bool:
    return zlib.crc32(segment.read(start, length)) == checksum


def _intact_rows(path: Path) -> Iterator[tuple[str, tuple[Any, ...]]]:
    """Intact rows of a journal, each with its table, however damaged the rest is."""
    for size in (PAGE, LARGE_PAGE):
        yield from salvage.rows(path, size, rows.parse)


def forget(path: Path) -> None:
    """Remove a journal, of an earlier version too; files that are none are left alone.

    Raises
    ------
    ArchiveError
        If there is another file in the place of one of its files.
    """
    is_earlier = path.exists() and _mark(path) in _EARLIER_IDS
    if is_earlier or is_ours(path):
        check_segment(path, Segment(path, write=False), 0, None)
        _remove(path)


def _remove(path: Path, *suffixes: str) -> None:
    for suffix in suffixes or ("", "-wal", "-shm", SUFFIX):
        path.with_name(path.name + suffix).unlink(missing_ok=True)


def repair(path: Path) -> None:
    """Rewrite the journal with its intact rows, those of finished chunks if their payloads are intact too."""
    draft = paths.of(path)
    paths.discard(path)
    segment, is_named = Segment(path), False
    try:
        page = LARGE_PAGE if path.stat().st_size > 1 << 24 else PAGE
        with contextlib.closing(connect(draft, page=page)) as journal:
            for table, row in _intact_rows(path):
                place = rows.place(table, row)
                is_named |= bool(place[1])
                if (place[1] and not _is_whole(segment, *place)) or not rows.is_readable(table, row):
                    continue
                if table == "points":  # a compacted block has the number of its last part, and more points
                    journal.execute("DELETE FROM points WHERE id = ? AND n < ?", (row[0], row[6]))
                journal.execute(rows.insert(table, "OR IGNORE"), row)
            journal.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        if is_named and segment.size:
            segment.restore_magic()
        _remove(path, "-wal", "-shm")
        os.replace(draft, path)
    except (sqlite3.Error, OSError) as error:
        raise_for(error, path)
    finally:
        segment.close()
        paths.discard(path)


def raise_for(error: Exception, path: Path) -> NoReturn:
    """Raise the error that says what an error of SQLite or of the system means for the journal.

    Raises
    ------
    ArchiveError, DiskFullError, WorkerError
        If the file cannot be used or cannot grow, or a limit of the system is reached; CorruptJournalError if it is
        damaged.
    """
    if isinstance(error, sqlite3.ProgrammingError):
        raise error
    code = getattr(error, "sqlite_errorcode", 0)
    # SQLite also reports a full disk as an input or output error, as it does a folder in place of its log.
    is_output_error = code & 0xFF == sqlite3.SQLITE_IOERR and code not in _READ_ERRORS
    cannot_open = code & 0xFF == sqlite3.SQLITE_CANTOPEN
    cause = (
        shortage(error, path, path.with_name(path.name + "-wal"))
        if is_output_error or cannot_open or isinstance(error, OSError)
        else None
    )
    if code == sqlite3.SQLITE_FULL or (cause and is_disk_full(cause)):
        raise DiskFullError(f"The disk is full: {path} cannot grow; finished results are kept.") from error
    if cause:
        raise unwritten(path, cause) from error
    if is_output_error or code & 0xFF in _NOT_THE_FILE or isinstance(error, OSError):
        raise ArchiveError(f"{path} cannot be used: {error}.") from error
    raise CorruptJournalError(path) from error
