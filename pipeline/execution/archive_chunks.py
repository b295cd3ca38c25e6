"""How the points of a line are divided into jobs: where it can be, into whole chunks of the archive."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

TARGET_SECONDS = 1.0  # work in a job [s]
CHUNKS_PER_WORKER = 4  # jobs for each worker at least, where there is enough work
_MIN_SECONDS = 0.25  # less work than this is not divided [s]
MAX_EXCESS = 4  # how much longer a job may be to be a whole chunk of the archive
_WHOLE = 0.9  # smallest missing share of a chunk for which all of it is solved


def seconds_of_chunk(share: float, limit: float) -> float:
    """Work in a job: about a second, less where workers would otherwise be idle.

    Parameters
    ----------
    share : float [s]
        Work for each worker.
    limit : float [s]
        Longest time of a point.

    Returns
    -------
    float [s]
    """
    return min(TARGET_SECONDS, max(_MIN_SECONDS, share / CHUNKS_PER_WORKER), limit / (2 * MAX_EXCESS))


@dataclass(frozen=True)
class ArchiveChunks:
    """Chunks of the archive along a line.

    Attributes
    ----------
    slopes : int
        Number of slopes on the line.
    extent : int
        Points in a chunk, if it is a part of one line that workers may finish; else 0.
    """

    slopes: int
    extent: int

    def divide(self, indices: np.ndarray, size: int) -> list[np.ndarray]:
        """Divide slopes into jobs of at most about `size` points, but of one whole chunk at least.

        Parameters
        ----------
        indices : ndarray of int, shape (n,)
            Indices of slopes, ascending.
        size : int

        Returns
        -------
        list of ndarray of int
        """
        if not self.extent:
            return np.array_split(indices, math.ceil(len(indices) / size))
        return np.split(indices, self._bounds(indices, max(1, size // self.extent)))

    def cut(self, indices: np.ndarray, size: int) -> int:
        """How many of the slopes of a job to take if about `size` points are wanted.

        Parameters
        ----------
        indices : ndarray of int, shape (n,)
            Indices of slopes, ascending.
        size : int

        Returns
        -------
        int
            Where a chunk ends, unless the first one alone is far too large.
        """
        if not self.extent or len(indices) <= size:
            return min(size, len(indices))
        bounds = [*self._bounds(indices, 1).tolist(), len(indices)]
        return max((n for n in bounds if n <= size), default=bounds[0] if bounds[0] <= MAX_EXCESS * size else size)

    def _bounds(self, indices: np.ndarray, chunks: int) -> np.ndarray:
        """Positions at which every `chunks`-th chunk begins; without temporaries as long as the line."""
        step = chunks * self.extent
        first, last = indices[[0, -1]].tolist()
        starts = np.arange((first // step + 1) * step, last + 1, step, dtype=indices.dtype)
        return np.unique(np.searchsorted(indices, starts))

    def whole(self, indices: np.ndarray) -> slice | None:
        """All slopes of the chunks that hold the given ones; None if more than a few of them are solved already.

        Parameters
        ----------
        indices : ndarray of int, shape (n,)
            Indices of slopes to solve, ascending.

        Returns
        -------
        slice or None
            A point depends on its line alone, so solving some again changes nothing.
        """
        if not self.extent:
            return None
        first, last = (indices[[0, -1]] // self.extent).tolist()
        start, stop = first * self.extent, min((last + 1) * self.extent, self.slopes)
        return slice(start, stop) if len(indices) >= _WHOLE * (stop - start) else None
