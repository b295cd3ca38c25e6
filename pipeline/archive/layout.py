"""Dimensions and chunks of variables as they lie in an archive, and their checksums."""

import zlib
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy import ndarray

from gaitsweep.pipeline.grid.boxes import Box, boxes

#: Dimensions of the characters of strings are called by this and their length.
STRING = "string"
FILTERS = {"zlib": True, "complevel": 1, "shuffle": True, "fletcher32": True}


def filters(n: int) -> dict[str, int]:
    """Filters of a variable of n values; HDF5 keeps no checksum of empty data."""
    return {**FILTERS, "fletcher32": n > 0}


def is_of_characters(dim: str) -> bool:
    """Whether a dimension is that of the characters of strings."""
    return dim.startswith(STRING) and dim.removeprefix(STRING).isdigit()


def dims(variable: Any) -> tuple[str, ...]:
    """Dimensions of a variable as read: strings lose that of their characters."""
    return tuple(dim for dim in variable.dimensions if not is_of_characters(dim))


def variables(parent: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Variables of an open archive by name, and columns of its tables, as
    "fits/scaling/exponent".
    """
    for name, variable in parent.variables.items():
        yield f"{path}{name}", variable
    for name, group in parent.groups.items():
        yield from variables(group, f"{path}{name}/")


def tables(file: Any) -> list[str]:
    """Names of the tables in an open archive, as "fits/scaling"."""
    names: dict[str, None] = {}
    for column, _ in variables(file):
        table, slash, _ = column.rpartition("/")
        if slash:
            names[table] = None

    return list(names)


def split(
    values: ndarray,
    box: Box,
    extent: tuple[int, ...],
) -> Iterator[tuple[tuple[int, ...], ndarray]]:
    """Split a box that starts at the corner of a chunk into chunks.

    Parameters
    ----------
    values : ndarray
        Values of the box; dimensions beyond those of the box are complete.
    box : Box
    extent : tuple of int
        Shape of a chunk.

    Yields
    ------
    corner : tuple of int
        Start of the chunk in the variable.
    part : ndarray
        Its values; at the end of the variable they are fewer than `extent`.
    """
    start = [span.start for span in box]
    start += [0] * (values.ndim - len(box))

    sizes = {str(k): n for k, n in enumerate(values.shape)}
    for part in boxes(sizes, extent, points=0):
        corner = []
        for begin, span in zip(start, part, strict=True):
            corner.append(begin + span.start)
        yield tuple(corner), values[part]


def chunk_checksum(checksum: int, corner: tuple[int, ...]) -> int:
    """Checksum of a chunk from that of its values; that of the variable is the sum over
    its chunks modulo 2^32.

    Parameters
    ----------
    checksum : int
        CRC-32 of the values, without what lies beyond the end of the variable.
    corner : tuple of int
        Start of the chunk in the variable.
    """
    place = ",".join(map(str, corner))
    of_corner = zlib.crc32(place.encode())
    return zlib.crc32(checksum.to_bytes(4, "little"), of_corner)


def checksum(values: ndarray) -> int:
    """Checksum of a small variable.

    Parameters
    ----------
    values : ndarray

    Returns
    -------
    int
    """
    if values.dtype.kind in "OU":
        texts = values.ravel().tolist()
        return zlib.crc32("\0".join(texts).encode())

    flat = np.ascontiguousarray(values).reshape(-1)
    return zlib.crc32(flat.view(np.uint8).data)
