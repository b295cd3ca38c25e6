"""Everything that can go wrong, as one tree: each branch is one exit code of the command line."""

import errno
from pathlib import Path


class GaitsweepError(Exception):
    """An error a user can act on; `str` is one sentence on one line and `exit_code` what the command ends with."""

    exit_code = 2

    def __init__(self, message: str = ""):
        # A name in a file from elsewhere may hold a line's end, or what a terminal obeys.
        super().__init__("".join(c if c.isprintable() else ascii(c)[1:-1] for c in message))


class StudyError(GaitsweepError):
    """A study, walker file or option that cannot be."""


class ArchiveError(GaitsweepError):
    """An archive or journal that cannot be read, is foreign, or cannot be written where it should be."""


class WorkerError(GaitsweepError):
    """Workers or the cluster could not be kept alive."""

    exit_code = 3


class DiskFullError(GaitsweepError):
    """The disk is full; what was finished is kept."""

    exit_code = 4


def unwritten(path: Path, error: OSError) -> GaitsweepError:
    """The error of a file or folder that cannot be written."""
    kind = DiskFullError if error.errno in (errno.ENOSPC, errno.EDQUOT) else ArchiveError
    return kind(f"{path} cannot be written: {error.strerror}.")


class BusyError(GaitsweepError):
    """Another run holds the archive."""

    exit_code = 5


class StoppedError(GaitsweepError):
    """A signal ended the run; what was finished is kept."""

    def __init__(self, signum: int, message: str):
        super().__init__(message)
        self.exit_code = 128 + signum
