"""heyoka's compile cache, which has no checksums of its machine code.

A damaged byte there crashes a process or changes numbers. Beside the cache, a file keeps the checksum of every entry as
it was first seen; a cache with another entry than that, or one that cannot be read, is removed and fills again.
"""

from __future__ import annotations

import contextlib
import sqlite3
import zlib
from pathlib import Path

import heyoka as hy

_LIMIT = 256 << 20  # size of the cache [byte]
_TIMEOUT = 30.0  # wait for other writing processes [s]
_CACHE, _SUMS = "cache.db", "checksums.db"
_ENTRIES = "SELECT hash, env_fingerprint, comp_flag, bitcode, obj FROM cache"
#: SQLite errors that mean damage; others, such as a folder that cannot be written, are not the cache's fault.
_DAMAGES = (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB, sqlite3.SQLITE_ERROR)


def use(folder: Path) -> None:
    """Keep compiled code in a folder; where that cannot be used, every process compiles its own."""
    hy.set_logger_level_error()  # a warning says that an entry could not be kept
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if not _is_intact(folder):
            _remove(folder)
        hy.llvm_state.set_diskcache_path(str(folder))
        hy.llvm_state.set_diskcache_limit(_LIMIT)
        hy.llvm_state.set_diskcache_enabled(True)
        hy.llvm_state.get_diskcache_size()  # opens it
    except (OSError, RuntimeError):
        hy.llvm_state.set_diskcache_enabled(False)


def _is_intact(folder: Path) -> bool:
    """Whether every entry is as it was first seen; new ones are noted."""
    if not (folder / _CACHE).exists():
        return True
    try:
        with contextlib.closing(sqlite3.connect(folder / _CACHE, timeout=_TIMEOUT)) as cache:
            if cache.execute("PRAGMA quick_check(1)").fetchone() != ("ok",):
                return False
            entries = {
                f"{number} {zlib.crc32(bitcode)} {flags} {environment}": zlib.crc32(code)
                for number, environment, flags, bitcode, code in cache.execute(_ENTRIES)
            }
        with contextlib.closing(sqlite3.connect(folder / _SUMS, timeout=_TIMEOUT)) as db:
            db.execute("CREATE TABLE IF NOT EXISTS sums (entry TEXT PRIMARY KEY, sum INTEGER)")
            known = dict(db.execute("SELECT entry, sum FROM sums"))
            new = entries.keys() - known.keys()
            if new:
                db.executemany("INSERT OR IGNORE INTO sums VALUES (?, ?)", ((entry, entries[entry]) for entry in new))
                db.commit()
        return all(known.get(entry, code) == code for entry, code in entries.items())
    except TypeError:
        return False  # a value of another type
    except sqlite3.Error as error:
        return getattr(error, "sqlite_errorcode", 0) & 0xFF not in _DAMAGES


def _remove(folder: Path) -> None:
    for name in (_CACHE, _SUMS):
        for suffix in ("", "-wal", "-shm", "-journal"):
            with contextlib.suppress(OSError):
                (folder / f"{name}{suffix}").unlink(missing_ok=True)
