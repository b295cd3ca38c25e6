"""The compile cache: compiled objects, kept in files between processes.

A file holds one object, as heyoka pickles it with its machine code, and a checksum. Its
name follows from what was compiled, the modules that write down and compile equations,
heyoka's library and the processor, so that what changes with any of them has another.
Damaged files, and those that another user may change, are as none; a folder that others
may change is not used.
"""

from __future__ import annotations

import contextlib
import fcntl
import functools
import grp
import hashlib
import logging
import os
import pickle
import pwd
import stat
import sys
import threading
import time
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TypeVar

_LIMIT = 256 << 20  # size of all files together [byte]
_PATIENCE = 120.0  # longest wait for code that another process compiles [s]
_SUFFIX, _LOCKS = ".compiled", "locks"
#: Folders of the modules that write down equations: whatever changes there, all is
#: compiled anew.
_EQUATIONS = (Path(__file__).parent, Path(__file__).parents[1] / "step")
#: What tells processors apart whose code differs.
_PROCESSOR = {
    "vendor_id",
    "cpu family",
    "model",
    "flags",
    "CPU implementer",
    "CPU variant",
    "CPU part",
    "Features",
    "cpu",
}
#: When this process began: modules that have changed since are not those it imported.
_BEGUN = time.time()
_SUM = 16  # size of a checksum [byte]
#: The open file whose bytes stand for what is compiled, a lock on each; none where no
#: cache is used.
_locks: list[int] = []
Compiled = TypeVar("Compiled")


def kept(
    make: Callable[..., Compiled],
    *given: Any,
    variant: str = "",
    meanwhile: Callable[[], object] = lambda: None,
) -> Compiled:
    """Return what a function compiles: loaded from the file of it if there is one, or
    compiled and kept there.

    Parameters
    ----------
    make : callable
        Compiles; what it returns depends on its module, those of the equations, and
        what follows.
    given
        Its arguments, whose representations tell them apart.
    variant : str
        What else it depends on.
    meanwhile : callable
        Called once if another process compiles the same, before waiting for it.
    """
    name = f"{make.__module__}.{make.__qualname__} {given!r} {variant}"
    folder = usable_folder()
    origin = _origin(Path(str(sys.modules[make.__module__].__file__)))
    if folder is None or origin is None:
        return make(*given)

    file = folder / f"{_checksum(origin + name.encode()).hex()}{_SUFFIX}"
    found = _read(file)
    if found is None:
        _open_locks(folder)
        with turn(file.name, meanwhile):
            found = _read(file)
            if found is None:
                found = make(*given)
                # What cannot be kept, for want of memory say, is there all the same.
                with contextlib.suppress(Exception):
                    _write(file, found)
                    _make_room(file)

    return found


def _origin(module: Path) -> bytes | None:
    """A checksum of what code depends on besides arguments: the text of a module and of
    those with the equations, heyoka's library, and the processor. None where that
    cannot be told, or is not what this process runs.
    """
    try:
        texts = [module]
        for folder in _EQUATIONS:
            texts += sorted(folder.glob("*.py"))
        if any(file.stat().st_ctime > _BEGUN for file in texts):
            return None
        return _origin_of(tuple(texts))
    except OSError:
        return None


@functools.cache
def _origin_of(modules: tuple[Path, ...]) -> bytes:
    import heyoka  # here: a run asks for the folder without the solver

    texts = [file.read_bytes() for file in modules]
    library = Path(heyoka._core.__file__).stat()
    version = heyoka.__version__, library.st_size, library.st_mtime_ns
    texts.append(repr((version, _processor())).encode())
    return _checksum(b"\0".join(texts))


def _processor() -> list[str]:
    """What the first processor says of its kind; OSError where it says nothing."""
    lines = []
    with open("/proc/cpuinfo", encoding="utf-8") as file:
        for line in file:
            if not line.strip():
                break
            if line.partition(":")[0].strip() in _PROCESSOR:
                lines.append(line)

    if not lines:
        raise OSError("/proc/cpuinfo does not tell which processor this is")
    return lines


def _checksum(data: bytes | memoryview) -> bytes:
    return hashlib.blake2b(data, digest_size=_SUM).digest()


def _read(file: Path) -> Any:
    """The object of a file; None if there is none, it is damaged, or others may change
    it.
    """
    flags = os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK
    try:
        with open(os.open(file, flags), "rb") as opened:
            status = os.fstat(opened.fileno())
            if is_shared(status) or not stat.S_ISREG(status.st_mode):
                return None
            data = memoryview(opened.read())

        pickled = data[_SUM:]
        if data[:_SUM] != _checksum(pickled):
            return None
        found = pickle.loads(pickled)
    except Exception:  # heyoka may refuse what it has written in any way
        return None

    with contextlib.suppress(OSError):
        os.utime(file)  # for `_make_room`
    return found


def _write(file: Path, compiled: object) -> None:
    """Keep an object in a file, whole or not at all."""
    data = pickle.dumps(compiled)
    # By this name `_make_room` finds drafts of processes that were killed.
    writer = f"{os.getpid()}.{threading.get_ident()}"
    draft = file.with_name(f"{file.stem}.{writer}{_SUFFIX}")
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC
    with contextlib.suppress(OSError):
        with open(os.open(draft, flags, 0o600), "wb") as opened:
            opened.write(_checksum(data) + data)
        draft.replace(file)
        return

    with contextlib.suppress(OSError):
        draft.unlink(missing_ok=True)


def _make_room(wanted: Path) -> None:
    """Remove files that were used longest ago where all together are too large, but not
    the one that is wanted.
    """
    used = []
    for file in wanted.parent.glob(f"*{_SUFFIX}"):
        with contextlib.suppress(OSError):
            status = file.lstat()
            if stat.S_ISREG(status.st_mode):
                used.append((file == wanted, status.st_mtime, status.st_size, file))

    total = 0
    for is_wanted, _, size, file in sorted(used, reverse=True):
        total += size
        if total > _LIMIT and not is_wanted:
            with contextlib.suppress(OSError):
                file.unlink(missing_ok=True)


def _open_locks(folder: Path) -> None:
    """Open the file of the locks, once a process."""
    if _locks:
        return
    with contextlib.suppress(OSError):
        flags = os.O_RDWR | os.O_CREAT | os.O_CLOEXEC
        _locks.append(os.open(folder / _LOCKS, flags, 0o600))


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
    try:
        folder = cache_folder().resolve()  # without links, which others could change
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
    """Say once in a process that a folder is not used since others may change it."""
    logging.getLogger("gaitsweep").warning(
        "gaitsweep: The compile cache in %s is not used: %s is no folder that only you may change.",
        folder,
        shared,
    )


def cache_folder() -> Path:
    """Folder of the compile cache, which `GAITSWEEP_CACHE` may name."""
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
    """Folders of a cache that another user may change: it, and those above."""
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
