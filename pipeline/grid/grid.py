"""The dimensions of a study and its chunks."""

import functools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from gaitsweep.pipeline.grid import costs
from gaitsweep.pipeline.grid.boxes import MOST_POINTS, box_shape
from gaitsweep.pipeline.grid.choose_method import method_of
from gaitsweep.pipeline.grid.method import Method, scaling_axes
from gaitsweep.pipeline.study.model import Plane, Study

_SECONDS = 0.3  # work in a chunk of points of one line [s]
_MAX_SHARE = 8  # parts of a point's time limit that a chunk may take
_FEWEST = 4  # points in a chunk of dear ones
_TINY = 1e-8  # slopes that may need extended precision [rad]
_MOST_TINY = 512  # points in a chunk of such slopes
# Lines in a chunk of lines side by side: enough to fill registers, few enough to show
# progress.
_LINES = 64
#: Fewest and most points in a chunk of a plane, the latter an eighth of a second of work
#: for straight legs, half a second with knees.
PLANE_POINTS = 512, 2048
# Chunks of a study over planes, so that workers share it and its first charts serve
# some.
_PLANE_CHUNKS = 16


@dataclass(frozen=True)
class Shape:
    """How the points of a chunk lie in the grid.

    Attributes
    ----------
    sizes : tuple of int
        Of the chunk along each dimension of the grid.
    extent : tuple of int
        Of a whole chunk, which is larger than the last ones.
    slope : int
        Number of the dimension of slopes.
    """

    sizes: tuple[int, ...]
    extent: tuple[int, ...]
    slope: int

    @classmethod
    def of(cls, sizes: Sequence[int], extent: Sequence[int], slope: int) -> "Shape":
        """Shape from its parts as they were packed."""
        return cls(tuple(sizes), tuple(extent), slope)

    @classmethod
    def of_rows(cls, lines: int, slopes: int) -> "Shape":
        """Shape of lines that are no chunk, one after the other."""
        return cls((lines, slopes), (lines, slopes), 1)

    @property
    def order(self) -> list[tuple[int, int, bool]]:
        """What decides where values lie in a packed chunk; dimensions of one value,
        such as a walker's, do not.
        """
        order = []
        for k, extent in enumerate(self.extent):
            if extent > 1:
                order.append((self.sizes[k], extent, k == self.slope))
        return order

    def unfold(self, rows: np.ndarray) -> np.ndarray:
        """Arrange points in the order of the grid.

        Parameters
        ----------
        rows : ndarray, shape (points, ...)
            Line by line.

        Returns
        -------
        ndarray, shape (*sizes, ...)
        """
        of_lines = list(self.sizes)
        slopes = of_lines.pop(self.slope)
        of_values = rows.shape[1:]

        lines_first = rows.reshape(*of_lines, slopes, *of_values)
        return np.moveaxis(lines_first, len(of_lines), self.slope)

    def fold(self, values: np.ndarray) -> np.ndarray:
        """Undo `unfold` for an array of whole chunks."""
        dimensions = len(self.sizes)
        of_values = values.shape[dimensions:]

        inside = values[tuple(map(slice, self.sizes))]
        lines_first = np.moveaxis(inside, self.slope, dimensions - 1)
        return lines_first.reshape(-1, *of_values)


@dataclass(frozen=True)
class Chunk:
    """A rectangle of the grid.

    Attributes
    ----------
    spans : dict of slice
        Along each dimension of the grid, by its name.
    of_lines : tuple of slice
        Along each dimension of the grid of lines, of shape `line_shape`.
    line_shape : tuple of int
    slopes : slice
        Of the study's slopes.
    shape : Shape
    """

    spans: dict[str, slice]
    of_lines: tuple[slice, ...]
    line_shape: tuple[int, ...]
    slopes: slice
    shape: Shape

    @property
    def line(self) -> int:
        """Number of its first line."""
        number = 0
        for span, size in zip(self.of_lines, self.line_shape, strict=True):
            number = number * size + span.start
        return number

    @functools.cached_property
    def numbers(self) -> np.ndarray:
        """Numbers of its lines, shape (n,)."""
        sides = [np.arange(span.start, span.stop) for span in self.of_lines]
        indices = np.ix_(*sides)
        return np.ravel_multi_index(indices, self.line_shape).ravel()

    @property
    def lines(self) -> int:
        """Number of its lines."""
        return math.prod(span.stop - span.start for span in self.of_lines)

    @property
    def per_line(self) -> int:
        """Number of its points on each line."""
        return self.slopes.stop - self.slopes.start

    @property
    def points(self) -> int:
        """Number of its points."""
        return math.prod(self.shape.sizes)


class Grid:
    """Dimensions of a study, walkers if there are several, then the axes in order; and
    its chunks, if it has points.

    In memory, where nothing is gained by dividing a line, each is one chunk.

    Attributes
    ----------
    sizes : dict
        Size of each dimension.
    line_dims : list of str
        All dimensions but that along lines.
    extent : tuple of int
        Shape of a chunk.
    multipliers : int
        Most of any walker.
    keys : int
        By how many of the slope and keys measures are differentiated, those of what
        drives last.
    """

    def __init__(self, study: Study, in_memory: bool = False):
        self.study = study
        self.method = method_of(study, in_memory)
        self.sizes: dict[str, int] = {}
        if study.walker_axis:
            self.sizes["walker"] = len(study.walkers)
        for axis in study.axes:
            if study.kind == "grid" or axis.name != study.along:
                self.sizes[axis.name] = len(axis)

        self.line_dims = [name for name in self.sizes if name != study.along]

        multipliers = [check["multipliers"] for check in study.checks]
        self.multipliers = max(multipliers, default=3)
        keys = [check["keys"] for check in study.checks]
        self.keys = max(keys, default=0)

        self.extent: tuple[int, ...] = ()
        if self.method is not Method.TASK:
            extent = self._extent(in_memory)
            self.extent = tuple(extent[name] for name in self.sizes)

    @functools.cached_property
    def _counts(self) -> tuple[int, ...]:
        """Number of chunks along each dimension."""
        sizes = zip(self.sizes.values(), self.extent, strict=True)
        return tuple(math.ceil(n / extent) for n, extent in sizes)

    @functools.cached_property
    def _place_of_slope(self) -> int:
        """Number of the dimension along lines."""
        names = list(self.sizes)
        return names.index(self.study.along)

    @functools.cached_property
    def alike(self) -> int:
        """Lines that differ only in their units, of which one is solved: those of a
        chunk; if chunks are of one line, those of the study, of which each process solves
        one and remembers it.
        """
        sizes = {axis.name: len(axis) for axis in scaling_axes(self.study)}
        if self.method.is_of_lines:
            of_chunk = zip(self.sizes, self.extent, strict=True)
            sizes = {name: extent for name, extent in of_chunk if name in sizes}
        return math.prod(sizes.values())

    @property
    def chunks(self) -> int:
        """Number of chunks."""
        return math.prod(self._counts) if self.extent else 0

    def chunk(self, number: int) -> Chunk:
        """The chunk of that number, in C order of the grid."""
        places = []
        for count in reversed(self._counts):
            number, place = divmod(number, count)
            places.append(place)

        spans = {}
        dims = zip(self.sizes.items(), reversed(places), self.extent, strict=True)
        for (name, n), place, extent in dims:
            start = place * extent
            spans[name] = slice(start, min(start + extent, n))

        of_lines = [spans.get("walker", slice(0, 1))]
        of_lines += [spans[axis.name] for axis in self.study.line_axes]
        sizes = tuple(span.stop - span.start for span in spans.values())
        return Chunk(
            spans,
            tuple(of_lines),
            self.study.line_shape,
            spans[self.study.along],
            Shape(sizes, self.extent, self._place_of_slope),
        )

    def chunks_of_line(self, line: int) -> range:
        """Numbers of the chunks that hold the points of a line."""
        slope = self._place_of_slope
        place = np.unravel_index(line, self.study.line_shape)
        if not self.study.walker_axis:
            place = place[1:]
        point = [*map(int, place)]
        point.insert(slope, 0)
        pairs = zip(point, self.extent, strict=True)
        first = [k // extent for k, extent in pairs]

        start = int(np.ravel_multi_index(first, self._counts))
        step = math.prod(self._counts[slope + 1 :])
        stop = start + self._counts[slope] * step
        return range(start, stop, step)

    def _extent(self, in_memory: bool) -> dict[str, int]:
        """Size of a chunk along each dimension: many lines at all slopes, or a part of
        one.
        """
        slopes = len(self.study.values_along)
        along = self.study.along
        if self.method.is_of_lines:
            return {**self._extent_of_lines(slopes), along: slopes}

        each = dict.fromkeys(self.line_dims, 1)
        if in_memory:
            return {**each, along: slopes}

        chunks = math.ceil(slopes / self._most_points())
        of_chunk = math.ceil(slopes / chunks)
        return {**each, along: of_chunk}

    def _extent_of_lines(self, slopes: int) -> dict[str, int]:
        """Size of a chunk of many lines along all dimensions but that of slopes.

        Lines that differ only in their units are solved once: a chunk holds as many of
        these as it can, of each line that it has.
        """
        scaling = {axis.name: len(axis) for axis in scaling_axes(self.study)}
        alike = math.prod(scaling.values())

        dims = [name for name in self.line_dims if name not in scaling]
        own = {name: self.sizes[name] for name in dims}
        if self.method is Method.PLANE and self.study.plane:
            tile = self._extent_of_plane(self.study.plane, slopes, alike)
            extent = dict.fromkeys(own, 1) | tile
        else:
            shape = box_shape(own, _LINES)
            extent = dict(zip(own, shape, strict=True))

        points = slopes * math.prod(extent.values())
        most_alike = max(1, MOST_POINTS // points)
        shape = box_shape(scaling, most_alike)
        return extent | dict(zip(scaling, shape, strict=True))

    def _extent_of_plane(self, plane: Plane, slopes: int, alike: int) -> dict[str, int]:
        """Size of a chunk along the axes of a plane, of whose lines `alike` each differ
        only in their units.
        """
        fewest_points, most_points = PLANE_POINTS
        fewest = fewest_points // slopes
        of_chunk = MOST_POINTS // (slopes * alike)
        most = min(most_points // slopes, of_chunk)
        most = max(fewest, most)

        wanted = self.study.lines // alike // _PLANE_CHUNKS
        lines = max(_LINES, fewest, wanted)
        return _tile(plane.axes, min(lines, most))

    def _most_points(self) -> int:
        """Most points of a chunk of one line: those of about `_SECONDS`."""
        share = self.study.limits.seconds / _MAX_SHARE
        seconds = min(_SECONDS, share)
        of_point = costs.of_point(self.study, self.method)
        in_time = int(seconds / of_point)

        most = MOST_POINTS
        if not self.study.values_along.min() > _TINY:
            most = _MOST_TINY
        return min(most, max(_FEWEST, in_time))


def _tile(axes: tuple[Any, ...], lines: int) -> dict[str, int]:
    """Size along the axes of a plane of a rectangle of about so many lines, as square
    as they allow.
    """
    short, *long = sorted(axes, key=len)
    lines = max(1, lines)
    if not long:
        return {short.name: min(len(short), lines)}

    side = math.isqrt(lines)
    if len(short) <= 2 * side:
        side = min(len(short), lines)
    across = min(len(long[0]), lines // side)
    return {short.name: side, long[0].name: across}


def golden_ratio_order(n: int) -> Iterator[int]:
    """Numbers from 0 to n - 1 in an order whose leading part, however long, samples
    them evenly: from the middle, since what costs most often lies at an end.
    """
    first = max(1, round(0.618 * n))
    steps = range(first, 2 * n + 2)
    step = next(k for k in steps if math.gcd(k, n) == 1)

    middle = n // 2
    return ((middle + i * step) % n for i in range(n))
