"""The lock of an archive: one run at a time."""

import contextlib
import fcntl
import json
import os
import platform
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from gaitsweep.pipeline import paths
from gaitsweep.pipeline.companions import Companions
from gaitsweep.pipeline.errors import ArchiveError, BusyError

_TRIES, _PAUSE = 5, 0.05  # how often a lock is tried, and the time between [s]


@contextlib.contextmanager
def lock_archive(path: Path) -> Iterator[None]:
    """Lock an archive. A lock ends with its process; drafts it left behind are removed.

    Raises
    ------
    ArchiveError
        If its disk has no locks.
    BusyError
        If another run holds it.
    """
    companions = Companions(path)
    with open(companions.lock, "a+", encoding="utf-8") as file:
        try:
            for _ in range(_TRIES):  # `status` holds it for a moment
                with contextlib.suppress(BlockingIOError):
                    fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    break
                time.sleep(_PAUSE)
            else:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except (BlockingIOError, PermissionError) as error:
            name = "its process is not known yet."
            with contextlib.suppress(KeyError):
                name = "process {pid} on {host}, started {started}.".format_map(
                    _holder(file)
                )
            raise BusyError(f"{path} is held by another run: {name}") from error
        except OSError as error:  # as on some network disks
            raise ArchiveError(
                f"{path} cannot be locked: its disk has no locks; choose another folder."
            ) from error

        for file_path in (path.resolve(), companions.journal, companions.record):
            paths.discard(file_path, _holder(file).get("drafts"))
        file.seek(0)
        file.truncate()
        started = time.strftime("%Y-%m-%d %H:%M:%S")
        json.dump(
            {
                "pid": os.getpid(),
                "host": platform.node(),
                "started": started,
                "drafts": paths.SECRET,
            },
            file,
        )
        file.flush()
        yield


def holder(path: Path) -> dict[str, Any] | None:
    """Who runs a study into an archive, as far as is known; None if nobody does."""
    lock = Companions(path).lock
    if not lock.is_file():  # another one might be waited for
        return None

    with contextlib.suppress(OSError), open(lock, encoding="utf-8") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except (BlockingIOError, PermissionError):
            return _holder(file)

    return None


def _holder(file: Any) -> dict[str, Any]:
    """Holder of a lock, or the last one, as far as is known."""
    try:
        file.seek(0)
        holder = json.load(file)
        return holder if isinstance(holder, dict) else {}
    except (ValueError, RecursionError):
        return {}
