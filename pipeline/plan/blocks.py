"""Blocks of short lines: consecutive lines of a study, or of a cell of its plane, computed and kept under one key.

Nothing here is done line by line in Python, so that a plane of a million lines is planned in seconds. Within a block a
line is known by a digest of its walker and parameters, whatever block of whatever grid it was computed in.
"""

from __future__ import annotations

import functools
import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from pipeline.plan import graph
from pipeline.store.journal import Journal
from pipeline.store.rows import BLOCK, Block, TaskKey
from pipeline.study.model import Axis, Study

SIZE = 64  # lines in a block: enough to fill registers, few enough to show progress
_MAX_POINTS = 8192  # in a block of a plane, whose lines lie in one cell
#: Constants of the finalizer of splitmix64 (Steele, Lea and Flood 2014, doi:10.1145/2660193.2660195).
_INCREMENT, _FIRST, _SECOND = (np.uint64(c) for c in (0x9E3779B97F4A7C15, 0xBF58476D1CE4E5B9, 0x94D049BB133111EB))


@dataclass(frozen=True)
class Blocks:
    """The blocks of a study whose lines are short."""

    study: Study
    layers: Mapping[str, graph.Layer]

    @property
    def count(self) -> int:
        """Number of blocks."""
        return len(self._plane[1]) - 1 if self._plane else -(-self.study.lines // SIZE)

    def numbers(self, block: int) -> np.ndarray:
        """Numbers of the lines of a block.

        Returns
        -------
        ndarray of int, shape (n,)
        """
        if self._plane:
            order, bounds, _ = self._plane
            return order[bounds[block] : bounds[block + 1]]
        return np.arange(block * SIZE, min((block + 1) * SIZE, self.study.lines))

    def of(self, numbers: np.ndarray) -> np.ndarray:
        """Blocks of lines.

        Parameters
        ----------
        numbers : ndarray of int, shape (n,)

        Returns
        -------
        ndarray of int, shape (n,)
        """
        if self._plane:
            _, bounds, places = self._plane
            return np.searchsorted(bounds, places[numbers], side="right") - 1
        return numbers // SIZE

    @functools.cached_property
    def _plane(self) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
        """Lines of a plane cell by cell, the bounds of blocks among them, and the place of each line."""
        if not graph.over_plane(self.study):
            return None
        most = max(1, _MAX_POINTS // len(self.study.slope))
        cells = list(self.study.cells())
        sizes = [len(part) for cell in cells for part in np.array_split(cell, -(-len(cell) // most))]
        order = np.concatenate(cells)
        places = np.empty(len(order), int)
        places[order] = np.arange(len(order))
        return order, np.cumsum([0, *sizes]), places

    def digests(self, numbers: np.ndarray, versioned: bool = True) -> np.ndarray:
        """Digests of lines; unless `versioned`, those of all versions of the tasks.

        Parameters
        ----------
        numbers : ndarray of int, shape (n,)
        versioned : bool

        Returns
        -------
        ndarray of uint64, shape (n, 2)
        """
        walkers, *indices = np.unravel_index(numbers, self.study.line_shape)
        digest = self._walkers[versioned][walkers]
        axes = sorted(zip(self.study.line_axes, indices, strict=True), key=lambda pair: pair[0].name)
        values = [axis.values.astype(float)[index] for axis, index in axes]
        if self._plane and self.study.plane:
            # The results of a line of a plane depend on its cell.
            for axis, index in axes:
                sides = self.study.plane.sides(axis, axis.values)
                values += [side[index] for side in (*sides, *self._neighbours(axis, sides))]
            # A line whose prediction is not accepted at one slope is followed by itself, at all of them.
            values.append(np.full(len(numbers), _mark(np.sort(self.study.slope))).view(float))
        for value in values:
            z = (digest ^ value.view(np.uint64)[:, None]) + _INCREMENT
            z = (z ^ z >> np.uint64(30)) * _FIRST
            z = (z ^ z >> np.uint64(27)) * _SECOND
            digest = z ^ z >> np.uint64(31)
        return digest

    def key(self, block: int) -> str:
        """Key of a block."""
        last = self._last[-1]
        if last[0] != block:
            last = block, _hash(self.digests(self.numbers(block)))
            self._last[-1] = last  # at once: other threads read it too
        return last[1]

    def keys(self, block: int) -> TaskKey:
        """Key of a block, for this version of the tasks and for all."""
        return TaskKey(self.key(block), _hash(self.digests(self.numbers(block), versioned=False)))

    @functools.cached_property
    def _last(self) -> list[tuple[int, str]]:
        """The last block and its key, usually requested several times in a row."""
        return [(-1, "")]

    def _neighbours(self, axis: Axis, sides: tuple[np.ndarray, ...]) -> list[np.ndarray]:
        """For each value of an axis a number for all values in its cell, which decide how that is split."""
        marks = np.zeros(len(axis) if sides else 0, np.uint64)
        for low, high in np.unique(sides, axis=1).T if sides else ():
            # A value on the upper border counts here too, though its line belongs to the next cell.
            marks[sides[0] == low] = _mark(np.sort(axis.values[(axis.values >= low) & (axis.values <= high)]))
        return [marks.view(float)] if sides else []

    @functools.cached_property
    def _walkers(self) -> dict[bool, np.ndarray]:
        """Digest of each walker with all that its lines share, for this version of the tasks and for all."""
        tasks = [self.layers[name].task for name in ("atlas", "points")]
        shared = {"options": graph.point_params(self.study), "keys": sorted(axis.name for axis in self.study.line_axes)}
        keys = [
            graph.key(tasks[1], {**shared, "walker": walker}, [f"{tasks[0].name} {tasks[0].version}"])
            for walker in self.study.walkers
        ]
        texts = {True: [key.key for key in keys], False: [key.unversioned for key in keys]}
        return {
            versioned: np.array([np.frombuffer(hashlib.sha256(t.encode()).digest()[:16], np.uint64) for t in each])
            for versioned, each in texts.items()
        }


def _mark(values: np.ndarray) -> np.uint64:
    """A number that stands for some values."""
    return np.uint64(np.frombuffer(hashlib.sha256(values.astype(float).tobytes()).digest()[:8], np.uint64)[0])


def _hash(digests: np.ndarray) -> str:
    return f"{BLOCK}-{hashlib.sha256(digests.tobytes()).hexdigest()}"


class StoredLines:
    """Lines in blocks of other grids, as a study has them in its journal after its axes were changed.

    Parameters
    ----------
    journal : Journal
    blocks : Blocks
        Those of the study as it is now.
    """

    def __init__(self, journal: Journal, blocks: Blocks):
        own = {blocks.key(block) for block in range(blocks.count)}
        stored = [
            (block.id, block.states["lines"])
            for key in journal.block_keys()
            if key not in own
            for block in journal.blocks(key)
        ]
        self.ids = np.repeat([number for number, _ in stored], [len(lines) for _, lines in stored]).astype(int)
        digests = np.concatenate([lines for _, lines in stored]) if stored else np.empty((0, 2), np.uint64)
        order = np.argsort(digests[:, 0], kind="stable")
        self.ids, self.digests = self.ids[order], digests[order, 0]

    def find(self, digests: np.ndarray) -> list[int]:
        """Numbers of blocks that may hold lines.

        Parameters
        ----------
        digests : ndarray of uint64, shape (n, 2)

        Returns
        -------
        list of int
        """
        low, high = (np.searchsorted(self.digests, digests[:, 0], side) for side in ("left", "right"))
        return sorted({int(number) for a, b in zip(low, high, strict=True) if b > a for number in self.ids[a:b]})


def stored_blocks(journal: Journal, key: str, others: StoredLines | None, digests: np.ndarray) -> Iterator[Block]:
    """Blocks of the journal that hold lines of a block of the study, earliest first.

    Parameters
    ----------
    journal : Journal
    key : str
        Of the block.
    others : StoredLines, optional
        Where lines may be besides the blocks of that key.
    digests : ndarray of uint64, shape (n, 2)
        Of its lines.
    """
    blocks = list(journal.blocks(key))
    if others:
        blocks += [journal.block(number) for number in others.find(digests)]
    return iter(sorted(blocks, key=lambda block: block.id))
