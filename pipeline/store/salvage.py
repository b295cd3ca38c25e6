"""Rows of a damaged SQLite file, from its pages alone: no header, schema, tree or index of it is trusted.

The format is https://www.sqlite.org/fileformat2.html. Rows are found that SQLite itself has deleted since; whether
a row is whole is for the caller to say.
"""

from __future__ import annotations

import contextlib
import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, BinaryIO, TypeVar

_LEAF, _HEAD = b"\x0d", 8  # type of a page that holds a table's rows, and where its pointers to them start
_FILE_HEAD = 100  # byte before those of the first page
_LOG_HEAD, _FRAME_HEAD = 32, 24  # byte before the frames of a write-ahead log, and before the page in each
_SIZES = {0: 0, 1: 1, 2: 2, 3: 3, 4: 4, 5: 6, 6: 8, 7: 8, 8: 0, 9: 0}  # byte of a value of each type; 7 is a double
_WRONG = 4  # pointers to nowhere, one after the other, that are none
Row = TypeVar("Row")


def rows(path: Path, size: int, whole: Callable[[int, list[Any]], Row | None]) -> Iterator[Row]:
    """Rows of every table of a file with pages of `size` byte, and of its log.

    `whole` is given the number and the values of what may be a row; what it makes of a whole one is yielded.
    """
    with contextlib.ExitStack() as stack:
        file = stack.enter_context(open(path, "rb"))
        yield from _rows(_Pages(file, size, {}), whole)
        with contextlib.suppress(FileNotFoundError):
            log = stack.enter_context(open(path.with_name(path.name + "-wal"), "rb"))
            if found := _log(log, size):  # it may be torn itself, so the file was read without it first
                yield from _rows(_Pages(file, size, found), whole)


def _log(file: BinaryIO, size: int) -> dict[int, tuple[BinaryIO, int]]:
    """Where the latest of each page is in a write-ahead log; frames of an earlier round have another salt."""
    found, salt, end = {}, file.read(_LOG_HEAD)[16:24], file.seek(0, 2)
    for start in range(_LOG_HEAD, end - _FRAME_HEAD - size + 1, _FRAME_HEAD + size):
        file.seek(start)
        head = file.read(_FRAME_HEAD)
        if head[8:16] == salt:
            found[int.from_bytes(head[:4], "big")] = file, start + _FRAME_HEAD
    return found


def _rows(pages: _Pages, whole: Callable[[int, list[Any]], Row | None]) -> Iterator[Row]:
    used: set[int] = set()
    # Leaves first. A page that no row of theirs lies on may be a leaf whose type is damaged.
    for leaf in (True, False):
        for number in range(1, pages.last + 1):
            page, start = pages.read(number), _FILE_HEAD if number == 1 else 0
            if number in used or (page[start : start + 1] == _LEAF) != leaf:
                continue
            for place in _pointers(page, start, leaf):
                try:
                    key, payload, over = pages.cell(page, place)
                    found = whole(key, _values(payload))
                except (ValueError, IndexError):
                    continue
                if found is not None:
                    used |= {number, *over}
                    yield found


def _pointers(page: bytes, start: int, leaf: bool) -> Iterator[int]:
    """Where rows may lie: the pointers of a leaf end where its first row starts, or are as many as it says."""
    told = int.from_bytes(page[start + 3 : start + 5], "big") if leaf else 0
    least, wrong = len(page), 0
    for k, pointer in enumerate(range(start + _HEAD, len(page) - 1, 2)):
        if k >= told and (pointer >= least or wrong == _WRONG):
            return
        place = int.from_bytes(page[pointer : pointer + 2], "big")
        wrong += 1
        if pointer < place < len(page):
            least, wrong = min(least, place), 0
            yield place


class _Pages:
    """Pages of a file by their numbers, from 1; `log` says where there are later ones."""

    def __init__(self, file: BinaryIO, size: int, log: dict[int, tuple[BinaryIO, int]]):
        self.file, self.size, self.log = file, size, log
        self.last = max(-(-file.seek(0, 2) // size), *log, 0)

    def read(self, number: int) -> bytes:
        file, place = self.log.get(number, (self.file, (number - 1) * self.size))
        try:
            file.seek(place)
            return file.read(self.size)
        except OSError:  # a sector of the disk that is gone
            return b""

    def cell(self, page: bytes, place: int) -> tuple[int, bytes, list[int]]:
        """Number and bytes of the row there, and the pages they go over to."""
        size, place = _varint(page, place)
        number, place = _varint(page, place)
        most, room = self.size - 35, self.size - 4
        if size > room * self.last:
            raise ValueError
        here = size
        if size > most:
            least = (self.size - 12) * 32 // 255 - 23
            here = least + (size - least) % room
            here = here if here <= most else least
        parts, over, left = [page[place : place + here]], [], size - here
        following = page[place + here : place + here + 4]
        while left > 0:
            over.append(int.from_bytes(following, "big"))
            if not 1 <= over[-1] <= self.last:
                raise ValueError
            page = self.read(over[-1])
            following = page[:4]
            parts.append(page[4 : 4 + left])
            left -= room
        return number, b"".join(parts), over


def _varint(data: bytes, place: int) -> tuple[int, int]:
    """A number of one to nine bytes, and where it ends."""
    number = 0
    for k in range(place, place + 8):
        number = number << 7 | data[k] & 0x7F
        if data[k] < 0x80:
            return number, k + 1
    return number << 8 | data[place + 8], place + 9


def _values(payload: bytes) -> list[Any]:
    """Values of a row."""
    start, place = _varint(payload, 0)
    head, values = start, list[Any]()
    while place < head:
        kind, place = _varint(payload, place)
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
