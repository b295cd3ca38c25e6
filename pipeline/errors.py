"""One tree of exceptions: each branch is one exit code of the command line."""

import contextlib
import errno
import itertools
import os
import re
from pathlib import Path

_LITTLE = 1 << 20  # fits on any disk that is not full [byte]
#: Errors of a process that is out of files, processes or memory, whatever file it was
#: opening.
_LIMITS = (errno.EMFILE, errno.ENFILE, errno.EAGAIN, errno.ENOMEM)


class GaitsweepError(Exception):
    """An error a user can act on; `str` is one sentence on one line and `exit_code`
    what the command ends with.
    """

    exit_code = 2

    def __init__(self, message: str = ""):
        # Names in foreign files may contain line ends or terminal control characters.
        super().__init__(
            "".join(c if c.isprintable() else ascii(c)[1:-1] for c in message)
        )

    def _render_traceback_(self) -> list[str]:
        """What a notebook shows instead of all frames: the line that called gaitsweep,
        and the sentence.
        """
        import traceback

        frames = traceback.extract_tb(self.__traceback__)
        # contextlib decorates functions of ours.
        inside = (f"{Path(__file__).parent.parent}{os.sep}", contextlib.__file__)
        own = list(
            itertools.takewhile(
                lambda frame: not frame.filename.startswith(inside), frames
            )
        )
        return [*traceback.format_list(own[-1:]), f"{type(self).__name__}: {self}"]


class StudyError(GaitsweepError):
    """An invalid study, walker file or option."""


class WalkerFileError(StudyError):
    """A file of a walker where one of a study is wanted."""


class NoGaitError(GaitsweepError):
    """There is no gait to begin with."""

    exit_code = 1


class ArchiveError(GaitsweepError):
    """An archive or journal that cannot be read or written, or is not one of gaitsweep."""


class WorkerError(GaitsweepError):
    """Workers or the cluster could not be kept alive."""

    exit_code = 3


class DiskFullError(GaitsweepError):
    """There is no room on the disk, or a file may not grow; finished results are kept."""

    exit_code = 4


def described(error: BaseException) -> str:
    """Name and message of any exception on one line without a full stop, the same in
    every process.
    """
    try:
        text = " ".join(str(error).split())
    except Exception:
        text = ""
    text = re.sub(r"0x[0-9a-f]{6,}", "0x...", text)[:300].removesuffix(".")
    return f"{type(error).__name__}: {text}" if text else type(error).__name__


def is_disk_full(error: BaseException) -> bool:
    """Whether the operating system reports a full disk or an exhausted quota."""
    return getattr(error, "errno", None) in (errno.ENOSPC, errno.EDQUOT)


def reached_limit(error: BaseException) -> OSError | None:
    """The error of the system if `error` says that there are no more threads or no more
    memory.
    """
    if isinstance(error, MemoryError):
        return OSError(errno.ENOMEM, os.strerror(errno.ENOMEM))
    if isinstance(error, RuntimeError) and "start new thread" in str(error):
        return OSError(errno.EAGAIN, "no more threads can be started")
    return None


def shortage(error: BaseException, *files: Path) -> OSError | None:
    """The system's error for lack of space, files, threads or memory, if that caused
    `error` in writing to `files`.

    Libraries do not say why they cannot write, and free space does not show quotas and
    limits of a file's size: a MiB is written to a file in the same folder, behind as
    many bytes as the largest of them has.
    """
    import tempfile

    if isinstance(error, OSError) and _is_shortage(error):
        return error
    if limit := reached_limit(error):
        return limit

    try:
        start = max((file.stat().st_size for file in files if file.exists()), default=0)
        with tempfile.TemporaryFile(dir=files[0].parent, buffering=0) as file:
            file.seek(start)
            while (n := file.tell() - start) < _LITTLE:
                file.write(bytes(_LITTLE - n))
    except OSError as failure:
        return failure if _is_shortage(failure) else None

    return None


def _is_shortage(error: OSError) -> bool:
    """Whether the operating system reports a lack of space, files, processes or memory."""
    return is_disk_full(error) or error.errno in (*_LIMITS, errno.EFBIG)


def unread(path: Path, error: OSError) -> GaitsweepError:
    """Error for a file that cannot be read."""
    return unwritten(path, error, "read")


def unwritten(path: Path, error: OSError, use: str = "written") -> GaitsweepError:
    """Error for a file or folder that cannot be written: the one that the system names,
    or else `path`.
    """
    if error.errno in _LIMITS:
        place = f" at {path}" if path.name else ""
        return WorkerError(
            f"A limit of the system is reached{place}: {error.strerror}."
        )

    sentence = f"{error.filename or path} cannot be {use}: {error.strerror}."
    if is_disk_full(error) or error.errno == errno.EFBIG:
        return DiskFullError(sentence)

    return ArchiveError(sentence)


class BusyError(GaitsweepError):
    """Another run holds the archive."""

    exit_code = 5


class StoppedError(GaitsweepError):
    """A signal ended the run; finished results are kept."""

    def __init__(self, signum: int, message: str):
        super().__init__(message)
        self.exit_code = 128 + signum
