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
    for name in sorted(
        sizes, key=lambda d: (d == "slope", list(sizes).index(d)), reverse=True
    ):
        extent[name] = min(sizes[name], max(1, points // math.prod(extent.values())))
    return tuple(extent[d] for d in sizes)


def boxes(
    sizes: Mapping[str, int], extent: tuple[int, ...], points: int
) -> Iterator[Box]:
    """Boxes that cover an array, each of complete chunks of that shape, and of at most
    `points` points if it can.
    """
    chunk = dict(zip(sizes, extent, strict=True))
    counts = box_shape(
        {d: -(-sizes[d] // c) for d, c in chunk.items()},
        points // math.prod(chunk.values()),
    )
    steps = tuple(c * n for c, n in zip(chunk.values(), counts, strict=True))
    for corner in itertools.product(
        *(range(0, n, c) for n, c in zip(sizes.values(), steps, strict=True))
    ):
        yield tuple(
            slice(i, min(i + c, n))
            for i, c, n in zip(corner, steps, sizes.values(), strict=True)
        )
