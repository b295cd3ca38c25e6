"""The grid of an archive, and the boxes in which it is written and read with bounded memory."""

from __future__ import annotations

import itertools
import math
import zlib
from collections.abc import Iterator, Mapping

import numpy as np

from pipeline.study.model import Study

CHUNK, REGION = 16384, 65536  # points in a chunk of the file, and in a box assembled in memory
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


def regions(sizes: Mapping[str, int]) -> Iterator[Box]:
    """Boxes of at most `REGION` points, each of complete chunks, that cover the grid."""
    chunk = dict(zip(sizes, chunk_shape(sizes, CHUNK), strict=True))
    chunks = chunk_shape({d: -(-sizes[d] // c) for d, c in chunk.items()}, REGION // math.prod(chunk.values()))
    extent = tuple(c * n for c, n in zip(chunk.values(), chunks, strict=True))
    for corner in itertools.product(*(range(0, n, c) for n, c in zip(sizes.values(), extent, strict=True))):
        yield tuple(slice(i, min(i + c, n)) for i, c, n in zip(corner, extent, sizes.values(), strict=True))


def checksum(values: np.ndarray, box: Box = ()) -> int:
    """Checksum of a variable in a box; that of the variable is the sum over its boxes modulo 2^32.

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
    data = "\0".join(values.ravel()).encode() if values.dtype.kind == "O" else np.ascontiguousarray(values).tobytes()
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
        return self.study.slope[dict(zip(self.sizes, box, strict=True))["slope"]]

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
