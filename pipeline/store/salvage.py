"""Rows of a damaged SQLite file, read from its pages alone, without its header, schema, trees or indexes.

The format is https://www.sqlite.org/fileformat2.html. Deleted rows may appear; the caller decides whether a row is
intact.
"""

from __future__ import annotations

import contextlib
import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, BinaryIO, TypeVar

_LEAF, _HEAD = b"\x0d", 8  # type of a page that holds rows, and offset of its cell pointers
_FILE_HEAD = 100  # bytes before the first page's own header
_LOG_HEAD, _FRAME_HEAD = 32, 24  # header sizes of a write-ahead log and of each frame [byte]
#: Size of a value of each type [byte]; 7 is a double.
_SIZES = {0: 0, 1: 1, 2: 2, 3: 3, 4: 4, 5: 6, 6: 8, 7: 8, 8: 0, 9: 0}
_MAX_INVALID = 4  # consecutive invalid pointers that end the array
_Row = TypeVar("_Row")


def rows(path: Path, size: int, parse: Callable[[int, list[Any]], _Row | None]) -> Iterator[_Row]:
    """Rows of every table of a file with pages of `size` byte, and of its write-ahead log.

    Parameters
    ----------
    path : Path
    size : int [byte]
    parse : callable
        Receives the number and values of a possible row; returns what to yield, or None if it is not a row.
    """
    with contextlib.ExitStack() as stack:
        file = stack.enter_context(open(path, "rb"))
        yield from _rows(_Pages(file, size, {}), parse)
        with contextlib.suppress(FileNotFoundError):
            log = stack.enter_context(open(path.with_name(path.name + "-wal"), "rb"))
            if frames := _log(log, size):  # the log may be damaged too, so the file is read without it first
                yield from _rows(_Pages(file, size, frames), parse)


def _log(file: BinaryIO, size: int) -> dict[int, tuple[BinaryIO, int]]:
    """Location of the latest version of each page in a write-ahead log; earlier rounds have another salt."""
    frames, salt, end = {}, file.read(_LOG_HEAD)[16:24], file.seek(0, 2)
    for start in range(_LOG_HEAD, end - _FRAME_HEAD - size + 1, _FRAME_HEAD + size):
        file.seek(start)
        head = file.read(_FRAME_HEAD)
        if head[8:16] == salt:
            frames[int.from_bytes(head[:4], "big")] = file, start + _FRAME_HEAD
    return frames


def _rows(pages: _Pages, parse: Callable[[int, list[Any]], _Row | None]) -> Iterator[_Row]:
    used: set[int] = set()
    # Leaves first. A page that holds no part of their rows may be a leaf whose type is damaged.
    for leaf in (True, False):
        for number in range(1, pages.last + 1):
            page, start = pages.read(number), _FILE_HEAD if number == 1 else 0
            if number in used or (page[start : start + 1] == _LEAF) != leaf:
                continue
            for position in _pointers(page, start, leaf):
                try:
                    key, payload, overflow = pages.cell(page, position)
                    row = parse(key, _values(payload))
                except (ValueError, IndexError):
                    continue
                if row is not None:
                    used |= {number, *overflow}
                    yield row


def _pointers(page: bytes, start: int, leaf: bool) -> Iterator[int]:
    """Possible offsets of rows: the pointers of a leaf end at its first row, or after the number in its header."""
    count = int.from_bytes(page[start + 3 : start + 5], "big") if leaf else 0
    first, invalid = len(page), 0
    for k, pointer in enumerate(range(start + _HEAD, len(page) - 1, 2)):
        if k >= count and (pointer >= first or invalid == _MAX_INVALID):
            return
        position = int.from_bytes(page[pointer : pointer + 2], "big")
        invalid += 1
        if pointer < position < len(page):
            first, invalid = min(first, position), 0
            yield position


class _Pages:
    """Pages of a file by number, from 1; `log` locates later versions."""

    def __init__(self, file: BinaryIO, size: int, log: dict[int, tuple[BinaryIO, int]]):
        self.file, self.size, self.log = file, size, log
        self.last = max(-(-file.seek(0, 2) // size), *log, 0)

    def read(self, number: int) -> bytes:
        file, offset = self.log.get(number, (self.file, (number - 1) * self.size))
        try:
            file.seek(offset)
            return file.read(self.size)
        except OSError:  # an unreadable sector of the disk
            return b""

    def cell(self, page: bytes, offset: int) -> tuple[int, bytes, list[int]]:
        """Number and payload of the row at `offset`, and its overflow pages."""
        size, offset = _varint(page, offset)
        number, offset = _varint(page, offset)
        max_local, capacity = self.size - 35, self.size - 4
        if size > capacity * self.last:
            raise ValueError
        local = size
        if size > max_local:
            min_local = (self.size - 12) * 32 // 255 - 23
            local = min_local + (size - min_local) % capacity
            local = local if local <= max_local else min_local
        parts, overflow, remaining = [page[offset : offset + local]], [], size - local
        following = page[offset + local : offset + local + 4]
        while remaining > 0:
            overflow.append(int.from_bytes(following, "big"))
            if not 1 <= overflow[-1] <= self.last:
                raise ValueError
            page = self.read(overflow[-1])
            following = page[:4]
            parts.append(page[4 : 4 + remaining])
            remaining -= capacity
        return number, b"".join(parts), overflow


def _varint(data: bytes, offset: int) -> tuple[int, int]:
    """A number of one to nine bytes, and the offset of its end."""
    number = 0
    for k in range(offset, offset + 8):
        number = number << 7 | data[k] & 0x7F
        if data[k] < 0x80:
            return number, k + 1
    return number << 8 | data[offset + 8], offset + 9


def _values(payload: bytes) -> list[Any]:
    """Decode the values of a row."""
    start, offset = _varint(payload, 0)
    end, values = start, list[Any]()
    while offset < end:
        kind, offset = _varint(payload, offset)
        if kind in (10, 11):
            raise ValueError
        size = _SIZES[kind] if kind < 10 else (kind - 12) // 2
        part = payload[start : start + size]
        if len(part) != size:
            raise ValueError
        start += size
        if kind < 10:
            number = struct.unpack(">d", part)[0] if kind == 7 else int.from_bytes(part, "big", signed=True)
            values.append(None if kind == 0 else kind - 8 if kind > 7 else number)
        else:
            values.append(part if kind % 2 == 0 else part.decode())
    return values
