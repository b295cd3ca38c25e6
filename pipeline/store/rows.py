"""Rows of the journal: their columns, and the checksums over everything they hold."""

from __future__ import annotations

import functools
import zlib
from collections.abc import Iterable
from typing import Any

SCHEMA = (
    "CREATE TABLE points (id INTEGER PRIMARY KEY, line TEXT, kin TEXT, variables TEXT, low REAL, high REAL,"
    " n INTEGER, seconds REAL, data_sum INTEGER, sum INTEGER, slopes BLOB, states BLOB, data BLOB)",
    "CREATE TABLE results (id INTEGER PRIMARY KEY, key TEXT, kin TEXT, outcome TEXT, reason TEXT, seen INTEGER,"
    " seconds REAL, data_sum INTEGER, sum INTEGER, data BLOB)",
    "CREATE TABLE notes (key TEXT PRIMARY KEY, value TEXT)",
    "CREATE INDEX points_line ON points (line)",
    "CREATE INDEX points_kin ON points (kin)",
    "CREATE INDEX results_key ON results (key)",
    "CREATE INDEX results_kin ON results (kin)",
)
#: Columns of each table after its id. `sum` is the checksum of all the others but `data`, which has its own.
COLUMNS = {
    "points": (
        "line",
        "kin",
        "variables",
        "low",
        "high",
        "n",
        "seconds",
        "data_sum",
        "sum",
        "slopes",
        "states",
        "data",
    ),
    "results": ("key", "kin", "outcome", "reason", "seen", "seconds", "data_sum", "sum", "data"),
}
_REAL = ("low", "high", "seconds")


def insert(table: str, how: str = "") -> str:
    """The statement that puts a row into a table."""
    columns = ("id", *COLUMNS[table])
    return f"INSERT {how} INTO {table} ({', '.join(columns)}) VALUES ({', '.join('?' * len(columns))})"


def summed(table: str, number: int, *row: Any) -> tuple[Any, ...]:
    """A row with its checksums."""
    k = COLUMNS[table].index("data_sum")
    head = (number, *row[:k], zlib.crc32(row[-1]))
    return (*head, _sum(head, row[k:-1]), *row[k:])


def _sum(head: tuple[Any, ...], blobs: Iterable[bytes]) -> int:
    return functools.reduce(lambda check, blob: zlib.crc32(blob, check), blobs, zlib.crc32(repr(head).encode()))


def is_whole(table: str, row: tuple[Any, ...]) -> bool:
    """Whether everything in a row from its id to before its data is as it was written."""
    k = 1 + COLUMNS[table].index("sum")
    return all(isinstance(blob, bytes) for blob in row[k + 1 :]) and row[k] == _sum(row[:k], row[k + 1 :])


def found(number: int, values: list[Any]) -> tuple[str, tuple[Any, ...]] | None:
    """The table of a row with that number and those values, and the row as it was written; None if it is not whole."""
    for table, columns in COLUMNS.items():
        if len(values) == 1 + len(columns):
            # SQLite keeps whole numbers as such in any column.
            row = (
                number,
                *(
                    float(v) if name in _REAL and isinstance(v, int) else v
                    for name, v in zip(columns, values[1:], strict=True)
                ),
            )
            data, check = row[-1], row[1 + columns.index("data_sum")]
            if is_whole(table, row[:-1]) and isinstance(data, bytes) and zlib.crc32(data) == check:
                return table, row
    return None
