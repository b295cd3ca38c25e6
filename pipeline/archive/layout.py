"""The grid of an archive, and the boxes in which it is written and read with bounded memory."""

from __future__ import annotations

import itertools
import math
import zlib
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from pipeline.study.model import Study

CHUNK, REGION = 16384, 65536  # points in a chunk of the file, and in a box assembled in memory
#: Dimensions of the characters of strings are called by this and their length.
STRING = "string"
FILTERS = {"zlib": True, "complevel": 1, "shuffle": True, "fletcher32": True}
Box = tuple[slice, ...]


def chunk_shape(sizes: Mapping[str, int], points: int) -> tuple[int, ...]:
    """Shape of a box of at most `points` points, extended along the slope first, then along the last axes.

    Parameters
    ----------
    sizes : mapping
        Size of each dimension.
    points : int

    Returns
    -------
    tuple of int
    """
    extent: dict[str, int] = {}
    for name in sorted(sizes, key=lambda d: (d == "slope", list(sizes).index(d)), reverse=True):
        extent[name] = min(sizes[name], max(1, points // math.prod(extent.values())))
    return tuple(extent[d] for d in sizes)


def grid_chunk(sizes: Mapping[str, int]) -> tuple[int, ...]:
    """Shape of a chunk of the grid: many short lines, or a part of a long one, which a worker can finish by itself."""
    from tasks.registry import SHORT_LINE  # local: the report reads archives without any task

    slopes = sizes["slope"]
    if slopes <= SHORT_LINE:
        return chunk_shape(sizes, CHUNK)
    extent = math.ceil(slopes / math.ceil(slopes / CHUNK))
    return tuple(extent if d == "slope" else 1 for d in sizes)


def line_extent(sizes: Mapping[str, int]) -> int:
    """Points in a chunk of the grid if it is a part of one line; else 0."""
    shape = grid_chunk(sizes)
    slopes = shape[list(sizes).index("slope")]
    return slopes if math.prod(shape) == slopes else 0


def filters(n: int) -> dict[str, int]:
    """Filters of a variable of n values; HDF5 keeps no checksum of empty data."""
    return {**FILTERS, "fletcher32": n > 0}


def is_of_characters(dim: str) -> bool:
    """Whether a dimension is that of the characters of strings."""
    return dim.startswith(STRING) and dim.removeprefix(STRING).isdigit()


def dims(variable: Any) -> tuple[str, ...]:
    """Dimensions of a variable as read: strings lose that of their characters."""
    return tuple(dim for dim in variable.dimensions if not is_of_characters(dim))


def regions(sizes: Mapping[str, int], shape: tuple[int, ...], points: int = 0) -> Iterator[Box]:
    """Boxes that cover the grid, each of complete chunks of that shape, and of at most `points` or `REGION` points."""
    chunk = dict(zip(sizes, shape, strict=True))
    chunks = chunk_shape(
        {d: -(-sizes[d] // c) for d, c in chunk.items()}, (points or REGION) // math.prod(chunk.values())
    )
    extent = tuple(c * n for c, n in zip(chunk.values(), chunks, strict=True))
    for corner in itertools.product(*(range(0, n, c) for n, c in zip(sizes.values(), extent, strict=True))):
        yield tuple(slice(i, min(i + c, n)) for i, c, n in zip(corner, extent, sizes.values(), strict=True))


def split(values: np.ndarray, box: Box, extent: tuple[int, ...]) -> Iterator[tuple[tuple[int, ...], np.ndarray]]:
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
    start = (*(s.start for s in box), *(0,) * (values.ndim - len(box)))
    for corner in itertools.product(*(range(0, n, c) for n, c in zip(values.shape, extent, strict=True))):
        part = values[tuple(slice(i, i + c) for i, c in zip(corner, extent, strict=True))]
        yield tuple(a + b for a, b in zip(start, corner, strict=True)), part


def chunk_checksum(checksum: int, corner: tuple[int, ...]) -> int:
    """Checksum of a chunk from that of its values; that of the variable is the sum over its chunks modulo 2^32.

    Parameters
    ----------
    checksum : int
        CRC-32 of the values, without what lies beyond the end of the variable.
    corner : tuple of int
        Start of the chunk in the variable.
    """
    return zlib.crc32(checksum.to_bytes(4, "little"), zlib.crc32(",".join(map(str, corner)).encode()))


def checksum(values: np.ndarray, box: Box = ()) -> int:
    """Checksum of a small variable, or of archives of schema 1 in a box, whose sum modulo 2^32 is the variable's.

    Parameters
    ----------
    values : ndarray
        Values in the box.
    box : Box

    Returns
    -------
    int
    """
    corner = ",".join(str(s.start) for s in box)
    if values.dtype.kind in "OU":
        data: bytes | memoryview = "\0".join(values.ravel().tolist()).encode()
    else:
        data = np.ascontiguousarray(values).reshape(-1).view(np.uint8).data
    return zlib.crc32(data, zlib.crc32(corner.encode()))


class Grid:
    """Dimensions of the archive of a study: walkers if there are several, then the axes in order."""

    def __init__(self, study: Study):
        self.study = study
        walkers = [("walker", len(study.walkers))] if study.walker_axis else []
        self.sizes = dict(walkers + [(a.name, len(a)) for a in study.axes if study.kind == "grid" or a.name != "slope"])
        self.lines = [d for d in self.sizes if d != "slope"]

    def lines_in(self, box: Box) -> tuple[tuple[np.ndarray, ...], np.ndarray]:
        """Lines that cross a box.

        Returns
        -------
        indices : tuple of ndarray of int, shape (n,)
            Their indices in the box, without the slope.
        numbers : ndarray of int, shape (n,)
        """
        spans = dict(zip(self.sizes, box, strict=True))
        starts = [spans[d].start for d in self.lines]
        if not starts:
            return (), np.zeros(1, int)
        indices = tuple(np.indices([spans[d].stop - spans[d].start for d in self.lines]).reshape(len(starts), -1))
        shape = self.study.line_shape if self.study.walker_axis else self.study.line_shape[1:]
        return indices, np.ravel_multi_index([i + start for i, start in zip(indices, starts, strict=True)], shape)

    def slopes(self, box: Box) -> np.ndarray:
        """Slopes of a box.

        Returns
        -------
        ndarray, shape (n,) [rad]
        """
        return self.study.slope[slice(*self.slope_span(box))]

    def slope_span(self, box: Box) -> tuple[int, int]:
        """First slope of a box, and that after its last."""
        span = dict(zip(self.sizes, box, strict=True))["slope"]
        return span.start, span.stop

    def slope_last(self, values: np.ndarray) -> np.ndarray:
        """View the values of a box with the slope after the axes of the lines.

        Parameters
        ----------
        values : ndarray, shape (extents of the box, ...)

        Returns
        -------
        ndarray, shape (extents of the lines' axes, slopes, ...)
        """
        return np.moveaxis(values, list(self.sizes).index("slope"), len(self.lines))
