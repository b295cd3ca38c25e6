"""Messages of several parts over a pipe."""

from __future__ import annotations

import io
import struct

Stream = io.RawIOBase | io.BufferedIOBase


def send(stream: Stream, *parts: bytes) -> None:
    """Write one message of several parts."""
    stream.write(struct.pack(f"<{1 + len(parts)}Q", len(parts), *map(len, parts)))
    for part in parts:
        left = memoryview(part)
        while left:
            left = left[stream.write(left) or 0 :]
    stream.flush()


def receive(stream: Stream) -> list[bytes]:
    """Read one message.

    Raises
    ------
    EOFError
        If the other end is closed.
    """
    (count,) = struct.unpack("<Q", _read_exactly(stream, 8))
    sizes = struct.unpack(f"<{count}Q", _read_exactly(stream, 8 * count))
    return [_read_exactly(stream, size) for size in sizes]


def _read_exactly(stream: Stream, size: int) -> bytes:
    data, received = memoryview(bytearray(size)), 0
    while received < size:
        n = stream.readinto(data[received:])
        if not n:
            raise EOFError
        received += n
    return bytes(data)
