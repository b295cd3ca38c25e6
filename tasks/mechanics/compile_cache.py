"""heyoka's compile cache, which has no checksums of its machine code.

A damaged byte there crashes a process or changes numbers. Beside the cache, a file keeps the checksum of every entry as
it was first seen; a cache with another entry than that, or one that cannot be read, is removed and fills again.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import sqlite3
import time
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path

import heyoka as hy

_LIMIT = 256 << 20  # size of the cache [byte]
_TIMEOUT = 30.0  # wait for other writing processes [s]
_PATIENCE = 120.0  # longest wait for code that another process compiles [s]
_CACHE, _SUMS, _LOCKS = "cache.db", "checksums.db", "locks"
_ENTRIES = "SELECT hash, env_fingerprint, comp_flag, bitcode, obj FROM cache"
#: SQLite errors that mean damage; others, such as a folder that cannot be written, are not the cache's fault.
_DAMAGES = (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB, sqlite3.SQLITE_ERROR)
#: The open file whose bytes stand for what is compiled, a lock on each; none where no cache is used.
_locks: list[int] = []


def use(folder: Path) -> None:
    """Keep compiled code in a folder; where that cannot be used, every process compiles its own."""
    hy.set_logger_level_error()  # a warning says that an entry could not be kept
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with contextlib.suppress(OSError):
            _locks[:] = [os.open(folder / _LOCKS, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)]
        # A cache that another process is just making has no tables yet, which would count as damage.
        with turn(""):
            if not _is_intact(folder):
                _remove(folder)
            hy.llvm_state.set_diskcache_path(str(folder))
            hy.llvm_state.set_diskcache_limit(_LIMIT)
            hy.llvm_state.set_diskcache_enabled(True)
            hy.llvm_state.get_diskcache_size()  # opens it
    except (OSError, RuntimeError):
        hy.llvm_state.set_diskcache_enabled(False)


@contextlib.contextmanager
def turn(name: str, meanwhile: Callable[[], object] = lambda: None) -> Iterator[None]:
    """Compile what has this name while no other process that shares the cache does, or where none can be asked.

    Parameters
    ----------
    name : str
    meanwhile : callable
        Called once if another process has the turn, before waiting for it.
    """
    place, began, has_turn = zlib.crc32(name.encode()), time.monotonic(), False
    while _locks and not has_turn and time.monotonic() < began + _PATIENCE:
        try:
            fcntl.lockf(_locks[0], fcntl.LOCK_EX | fcntl.LOCK_NB, 1, place)
            has_turn = True
        except BlockingIOError:
            meanwhile()
            meanwhile = lambda: time.sleep(0.05)  # noqa: E731
        except OSError:  # a file system without locks
            break
    try:
        yield
    finally:
        if has_turn:
            fcntl.lockf(_locks[0], fcntl.LOCK_UN, 1, place)


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
