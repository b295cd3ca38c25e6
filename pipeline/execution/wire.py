"""Messages of several parts over a pipe."""

from __future__ import annotations

import struct
from typing import BinaryIO


def send(stream: BinaryIO, *parts: bytes) -> None:
    """Write one message of several parts."""
    stream.write(struct.pack(f"<{1 + len(parts)}Q", len(parts), *map(len, parts)))
    for part in parts:
        left = memoryview(part)
        while left:
            left = left[stream.write(left) or 0 :]
    stream.flush()


def receive(stream: BinaryIO) -> list[bytes]:
    """Read one message.

    Raises
    ------
    EOFError
        If the other end is gone.
    """
    (count,) = struct.unpack("<Q", _exactly(stream, 8))
    sizes = struct.unpack(f"<{count}Q", _exactly(stream, 8 * count))
    return [_exactly(stream, size) for size in sizes]


def _exactly(stream: BinaryIO, size: int) -> bytes:
    data, got = memoryview(bytearray(size)), 0
    while got < size:
        n = stream.readinto(data[got:])  # type: ignore[attr-defined]
        if not n:
            raise EOFError
        got += n
    return bytes(data)
