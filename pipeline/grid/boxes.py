"""Boxes of arrays: the shapes of chunks, and the parts in which archives are read."""

import itertools
import math
from collections.abc import Iterator, Mapping

MOST_POINTS = 16384  # in a chunk
Box = tuple[slice, ...]


def box_shape(sizes: Mapping[str, int], points: int) -> tuple[int, ...]:
    """Shape of a box of at most `points` points, extended along the slope first, then
    along the last axes.

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
    last_first = [*sizes][::-1]
    for name in sorted(last_first, key=lambda dim: dim != "slope"):
        extent[name] = min(sizes[name], max(1, points // math.prod(extent.values())))
    return tuple(extent[d] for d in sizes)


def boxes(
    sizes: Mapping[str, int], extent: tuple[int, ...], points: int
) -> Iterator[Box]:
    """Boxes that cover an array, each of complete chunks of that shape, and of at most
    `points` points if it can.
    """
    chunk = dict(zip(sizes, extent, strict=True))
    chunks = {name: math.ceil(sizes[name] / size) for name, size in chunk.items()}
    counts = box_shape(chunks, points // math.prod(chunk.values()))

    sides = []
    for (name, size), count in zip(chunk.items(), counts, strict=True):
        n, step = sizes[name], size * count
        sides.append([slice(i, min(i + step, n)) for i in range(0, n, step)])

    yield from itertools.product(*sides)
