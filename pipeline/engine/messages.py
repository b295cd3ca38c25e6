"""Messages of several parts between a run and its workers."""

from __future__ import annotations

import struct
from multiprocessing.connection import Connection


def send(connection: Connection, *parts: bytes) -> None:
    """Send one message."""
    connection.send_bytes(struct.pack("<Q", len(parts)))
    for part in parts:
        connection.send_bytes(part)


def receive(connection: Connection) -> list[bytes]:
    """Receive one message.

    Raises
    ------
    EOFError
        If the other end is closed.
    """
    (count,) = struct.unpack("<Q", connection.recv_bytes())
    return [connection.recv_bytes() for _ in range(count)]
