"""One tree of exceptions: each branch is one exit code of the command line."""

import errno
import os
from pathlib import Path

_LITTLE = 1 << 20  # fits on any disk that is not full [byte]
#: Errors of a process that is out of files, processes or memory, whatever file it was opening.
_LIMITS = (errno.EMFILE, errno.ENFILE, errno.EAGAIN, errno.ENOMEM)


class GaitsweepError(Exception):
    """An error a user can act on; `str` is one sentence on one line and `exit_code` what the command ends with."""

    exit_code = 2

    def __init__(self, message: str = ""):
        # Names in foreign files may contain line ends or terminal control characters.
        super().__init__("".join(c if c.isprintable() else ascii(c)[1:-1] for c in message))


class StudyError(GaitsweepError):
    """An invalid study, walker file or option."""


class ArchiveError(GaitsweepError):
    """An archive or journal that cannot be read or written, or is not one of gaitsweep."""


class WorkerError(GaitsweepError):
    """Workers or the cluster could not be kept alive."""

    exit_code = 3


class DiskFullError(GaitsweepError):
    """The disk is full; finished results are kept."""

    exit_code = 4


def is_disk_full(error: BaseException) -> bool:
    """Whether the operating system reports a full disk or an exhausted quota."""
    return getattr(error, "errno", None) in (errno.ENOSPC, errno.EDQUOT)


def reached_limit(error: BaseException) -> OSError | None:
    """The error of the system if `error` says that there are no more threads or no more memory."""
    if isinstance(error, MemoryError):
        return OSError(errno.ENOMEM, os.strerror(errno.ENOMEM))
    if isinstance(error, RuntimeError) and "start new thread" in str(error):
        return OSError(errno.EAGAIN, "no more threads can be started")
    return None


def shortage(error: BaseException, folder: Path) -> OSError | None:
    """The system's error for lack of space, files, threads or memory, if that caused `error`.

    Libraries do not say why they cannot write, and free space does not show quotas: a MiB is written to the folder.
    """
    import tempfile

    if isinstance(error, OSError) and is_shortage(error):
        return error
    if limit := reached_limit(error):
        return limit
    try:
        with tempfile.TemporaryFile(dir=folder, buffering=0) as file:
            while (n := file.tell()) < _LITTLE:
                file.write(bytes(_LITTLE - n))
    except OSError as failure:
        return failure if is_shortage(failure) else None
    return None


def is_shortage(error: OSError) -> bool:
    """Whether the operating system reports a lack of space, files, processes or memory."""
    return is_disk_full(error) or error.errno in _LIMITS


def unwritten(path: Path, error: OSError) -> GaitsweepError:
    """Error for a file or folder that cannot be written: the one that the system names, or else `path`."""
    if error.errno in _LIMITS:
        return WorkerError(f"A limit of the system is reached: {error.strerror}.")
    kind = DiskFullError if is_disk_full(error) else ArchiveError
    return kind(f"{error.filename or path} cannot be written: {error.strerror}.")


class BusyError(GaitsweepError):
    """Another run holds the archive."""

    exit_code = 5


class StoppedError(GaitsweepError):
    """A signal ended the run; finished results are kept."""

    def __init__(self, signum: int, message: str):
        super().__init__(message)
        self.exit_code = 128 + signum
