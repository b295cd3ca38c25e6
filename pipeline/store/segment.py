"""The segment file beside a journal: payloads of finished chunks, appended as workers packed them.

Rows of the journal hold offset, length and checksum of each. Anything behind the last of them remains from a write
that was interrupted.
"""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

SUFFIX = "-chunks"
MAGIC = b"gaitsweep chunks"


class Segment:
    """The segment file of the journal at `path`; it is made by the first payload."""

    def __init__(self, path: Path, write: bool = True):
        self.path = path.with_name(path.name + SUFFIX)
        self._flags = (os.O_RDWR if write else os.O_RDONLY) | os.O_CLOEXEC
        self._file: int | None = None
        self._is_dirty = False
        self._end = len(MAGIC)  # where the next payload is written

    def _open(self, flags: int = 0) -> int:
        if self._file is None:
            self._file = os.open(self.path, self._flags | flags, 0o666)
        return self._file

    @property
    def size(self) -> int:
        """Size of the file [byte]; 0 if there is none."""
        return self.path.stat().st_size if self.path.exists() else 0

    def is_ours(self) -> bool:
        """Whether there is no file, or it begins like a segment."""
        if not self.size:
            return True
        with open(self.path, "rb") as file:
            return file.read(len(MAGIC)) == MAGIC

    def resume(self, end: int) -> None:
        """Continue to write at `end`, discarding what follows it."""
        self._end = max(end, len(MAGIC))
        if self.size > self._end:
            os.ftruncate(self._open(), self._end)

    def append(self, payload: bytes) -> int:
        """Write a payload and return its offset; it counts once a row of the journal says so.

        Raises
        ------
        OSError
            If it cannot be written. The next payload then takes its place.
        """
        file, start = self._open(os.O_CREAT), self._end
        self._is_dirty = True
        if start == len(MAGIC):  # on the disk before anything else: it identifies the file as ours
            _write(file, MAGIC, 0)
            os.fsync(file)
        _write(file, payload, start)
        self._end += len(payload)
        return start

    def read(self, start: int, length: int) -> bytes:
        """Read a payload; it is shorter, or empty, where the file is."""
        with contextlib.suppress(OSError, OverflowError):
            return os.pread(self._open(), max(0, min(length, self.size - start)), start)
        return b""

    def restore_magic(self) -> None:
        """Write the beginning of the file anew."""
        _write(self._open(), MAGIC, 0)

    def sync(self) -> None:
        """Flush what was written to the disk."""
        if self._file is not None and self._is_dirty:
            os.fsync(self._file)
            self._is_dirty = False

    def close(self) -> None:
        """Close the file."""
        if self._file is not None:
            os.close(self._file)
        self._file = None


def _write(file: int, data: bytes, offset: int) -> None:
    view = memoryview(data)
    while view:
        n = os.pwrite(file, view, offset)
        view, offset = view[n:], offset + n
