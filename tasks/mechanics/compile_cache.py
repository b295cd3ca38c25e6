"""heyoka's compile cache: its folders, whose they are, and whether their machine code is
as it was written.

heyoka reads the whole cache that it opens, and executes what it finds there; it has no
checksums of it. So each structure has a folder of its own, and another for compact
code: who asks about one walker reads and checks what was compiled for such walkers
alone. A folder or file that another
user may change is not used. Damage crashes a process or changes numbers: beside each
cache, a file keeps the checksum of every entry as it was first seen; a cache with another
entry than that, or one that cannot be read, is removed and fills again.
"""

from __future__ import annotations

import contextlib
import fcntl
import functools
import grp
import hashlib
import logging
import os
import pwd
import sqlite3
import stat
import time
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path

_LIMIT = 256 << 20  # size of all folders together [byte]
_TIMEOUT = 30.0  # wait for other writing processes [s]
_PATIENCE = 120.0  # longest wait for code that another process compiles [s]
_CACHE, _SUMS, _LOCKS = "cache.db", "checksums.db", "locks"
_ENTRIES = "SELECT hash, env_fingerprint, comp_flag, bitcode, obj FROM cache"
#: SQLite errors that mean damage; others, such as a folder that cannot be written, are
#: not the cache's fault.
_DAMAGES = (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB, sqlite3.SQLITE_ERROR)
#: The open file whose bytes stand for what is compiled, a lock on each; none where no
#: cache is used.
_locks: list[int] = []
#: Folders whose entries this process has found to be as they were written.
_checked: set[Path] = set()


def use(name: str) -> None:
    """Keep what is compiled from now on in this user's folder of that name; where it
    cannot be used, every process compiles its own.

    Parameters
    ----------
    name : str
        What is compiled, in any words: equal names have one folder.
    """
    import heyoka as hy  # here: a run asks for the folder without the solver

    cache = hy.llvm_state
    hy.set_logger_level_error()  # a warning says that an entry could not be kept
    cache.set_diskcache_enabled(False)
    folder = _folder_of(name)
    if folder is None:
        return

    try:
        _open_locks(folder.parent)
        _make_room(folder)
        # A cache that another process is just making has no tables yet, which would
        # count as damage.
        with turn(folder.name):
            if not _may_be_used(folder):
                return
            cache.set_diskcache_path(str(folder))
            cache.set_diskcache_limit(_LIMIT)
            cache.set_diskcache_enabled(True)
            cache.get_diskcache_size()  # opens it
    except (OSError, RuntimeError):
        cache.set_diskcache_enabled(False)


def _open_locks(folder: Path) -> None:
    """Open the file of the locks, once a process."""
    if _locks:
        return
    with contextlib.suppress(OSError):
        flags = os.O_RDWR | os.O_CREAT | os.O_CLOEXEC
        _locks.append(os.open(folder / _LOCKS, flags, 0o600))


def _may_be_used(folder: Path) -> bool:
    """Whether a folder's entries are as they were written, which is looked at once a
    process; damaged ones are removed. Another program's database is left alone.
    """
    if folder in _checked:
        return True
    if not _is_intact(folder):
        if not _is_ours(folder):
            return False
        _remove(folder)

    _checked.add(folder)
    return True


@functools.cache
def _make_room(wanted: Path) -> None:
    """Remove folders that were used longest ago where all together are too large, but
    not the one that is wanted, nor what is another program's.
    """
    used = []
    for folder in wanted.parent.iterdir():
        with contextlib.suppress(OSError):
            if folder.is_symlink() or not _is_ours(folder):
                continue
            files = [file.stat() for file in _files(folder) if file.exists()]
            newest = max(status.st_mtime for status in files)
            size = sum(status.st_size for status in files)
            used.append((folder == wanted, newest, size, folder))

    total = 0
    for is_wanted, _, size, folder in sorted(used, reverse=True):
        total += size
        if total > _LIMIT and not is_wanted:
            _remove(folder)


def _is_ours(folder: Path) -> bool:
    """Whether a folder holds a cache that has checksums, as all of this program have."""
    return all((folder / name).is_file() for name in (_CACHE, _SUMS))


@contextlib.contextmanager
def turn(name: str, meanwhile: Callable[[], object] = lambda: None) -> Iterator[None]:
    """Compile what has this name while no other process that shares the cache does, or
    where none can be asked.

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


def usable_folder() -> Path | None:
    """Folder of the compile cache, made if there is none; None if it cannot be made or
    others may change it.

    The latter is said once in a process.
    """
    return _usable(cache_folder())


def _folder_of(name: str) -> Path | None:
    """Folder in which what is compiled under a name is kept; None if it cannot be used."""
    cache = usable_folder()
    if cache is None:
        return None
    return _usable(cache / hashlib.sha256(name.encode()).hexdigest()[:16])


def _usable(folder: Path) -> Path | None:
    """A folder, made if there is none, unless it cannot be made or others may change it,
    which is said.
    """
    try:
        folder = folder.resolve()  # without links, which others could change
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        shared = next(_shared(folder), None)
    except (OSError, RuntimeError):
        return None

    if shared:
        _say_not_used(folder, shared)
        return None
    return folder


@functools.cache
def _say_not_used(folder: Path, shared: Path) -> None:
    """Say once in a process that a folder is not used since others may change a part."""
    logging.getLogger("gaitsweep").warning(
        "gaitsweep: The compile cache in %s is not used: %s is no plain file or folder that only you may change.",
        folder,
        shared,
    )


def cache_folder() -> Path:
    """Folder of the compile cache, which `GAITSWEEP_CACHE` may name; on a network disk
    it is slower than compiling.
    """
    named, base = (
        os.environ.get("GAITSWEEP_CACHE"),
        os.environ.get("XDG_CACHE_HOME", ""),
    )
    folder = Path(
        named or Path(base if os.path.isabs(base) else "~/.cache", "gaitsweep")
    )
    try:
        return folder.expanduser()
    except RuntimeError:  # there is no home, and `~` would be a folder of that name
        return Path(os.devnull)


def _shared(folder: Path) -> Iterator[Path]:
    """What another user may change of a cache: its files, its folder, and the folders
    above it.
    """
    for file in _files(folder):
        with contextlib.suppress(FileNotFoundError):
            status = file.lstat()
            if is_shared(status) or not stat.S_ISREG(status.st_mode):
                yield file

    for place in (folder, *folder.parents):
        status = place.lstat()
        # In a sticky folder, such as `/tmp`, only the owner of an entry may replace it.
        is_sticky = place != folder and status.st_mode & stat.S_ISVTX
        if is_shared(status, stat.S_IWGRP | stat.S_IWOTH if is_sticky else 0):
            yield place


def is_shared(status: os.stat_result, allowed: int = 0) -> bool:
    """Whether other users may change a file or folder: it is neither the user's nor
    root's, or its mode lets them.

    Parameters
    ----------
    status : os.stat_result
    allowed : int
        Permissions that do not count.

    Notes
    -----
    A group that is called as the user and has no other members, as many systems give to each user, is the user.
    """
    mode = status.st_mode & ~allowed
    if mode & stat.S_IWGRP and not mode & stat.S_IWOTH:
        with contextlib.suppress(KeyError):
            group, user = grp.getgrgid(status.st_gid), pwd.getpwuid(os.geteuid())
            if group.gr_name == user.pw_name and not {*group.gr_mem} - {user.pw_name}:
                mode &= ~stat.S_IWGRP

    return status.st_uid not in (0, os.geteuid()) or bool(
        mode & (stat.S_IWGRP | stat.S_IWOTH)
    )


def _is_intact(folder: Path) -> bool:
    """Whether every entry is as it was first seen; new ones are noted."""
    entries: dict[str, int] = {}
    try:
        if (folder / _CACHE).exists():
            with contextlib.closing(
                sqlite3.connect(folder / _CACHE, timeout=_TIMEOUT)
            ) as cache:
                if cache.execute("PRAGMA quick_check(1)").fetchone() != ("ok",):
                    return False
                entries = {
                    f"{number} {zlib.crc32(bitcode)} {flags} {environment}": zlib.crc32(
                        code
                    )
                    for number, environment, flags, bitcode, code in cache.execute(
                        _ENTRIES
                    )
                }

        with contextlib.closing(
            sqlite3.connect(folder / _SUMS, timeout=_TIMEOUT)
        ) as db:
            db.execute(
                "CREATE TABLE IF NOT EXISTS sums (entry TEXT PRIMARY KEY, sum INTEGER)"
            )
            known = dict(db.execute("SELECT entry, sum FROM sums"))
            new = entries.keys() - known.keys()
            if new:
                db.executemany(
                    "INSERT OR IGNORE INTO sums VALUES (?, ?)",
                    ((entry, entries[entry]) for entry in new),
                )
                db.commit()

        return all(known.get(entry, code) == code for entry, code in entries.items())
    except TypeError:
        return False  # a value of another type
    except sqlite3.Error as error:
        return getattr(error, "sqlite_errorcode", 0) & 0xFF not in _DAMAGES


def _files(folder: Path) -> Iterator[Path]:
    for name in (_CACHE, _SUMS):
        for suffix in ("", "-wal", "-shm", "-journal"):
            yield folder / f"{name}{suffix}"


def _remove(folder: Path) -> None:
    for file in _files(folder):
        with contextlib.suppress(OSError):
            file.unlink(missing_ok=True)
