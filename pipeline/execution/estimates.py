"""Cost of points by region: a point near a singularity may cost as much as a thousand others.

A region is an interval of the slopes of one line. Long lines are probed: a few points of each region run first.
"""

from __future__ import annotations

import numpy as np

_REGIONS = 64
_PROBE, _MAX_PROBE = 50, 256  # parts of a region of which a probe is one, and most points of it


class Costs:
    """Measured times and remaining points by line and region.

    Parameters
    ----------
    slopes : int
        Number of slopes on each line.
    points : int
        Number of points to solve on all lines.
    guess : float [s]
        Time of a point until one is measured.
    """

    def __init__(self, slopes: int, points: int, guess: float):
        self.slopes, self.points, self.mean = max(1, slopes), points, guess
        self.lines: dict[int, np.ndarray] = {}  # open lines: points left, points, seconds, and those of probes
        self.totals = np.zeros((2, _REGIONS))  # points and seconds of all lines
        self.probed: set[int] = set()
        self.overhead = 0.0  # fixed time of a chunk [s], from regions measured in probes and in blocks

    def region(self, indices: np.ndarray) -> np.ndarray:
        """Region of each slope.

        Parameters
        ----------
        indices : ndarray of int, shape (n,)
            Indices of slopes.

        Returns
        -------
        ndarray of int, shape (n,)
        """
        return np.asarray(indices, np.int64) * _REGIONS // self.slopes

    def by_region(self, indices: np.ndarray, parts: int = 1) -> list[np.ndarray]:
        """Divide slopes by region, or by equal parts of it.

        Parameters
        ----------
        indices : ndarray of int, shape (n,)
            Indices of slopes in ascending order.
        parts : int
            Into how many each region is divided.

        Returns
        -------
        list of ndarray of int
        """
        return [part for part in np.split(indices, self._positions(indices, parts)[1:-1]) if len(part)]

    def _positions(self, indices: np.ndarray, parts: int = 1) -> np.ndarray:
        """Where in ascending indices each region, or part of one, begins; without temporaries as long as a line."""
        n = parts * _REGIONS
        starts = -(-np.arange(n + 1) * self.slopes // n)
        return np.searchsorted(indices, starts.astype(indices.dtype))

    def _counts_by_region(self, indices: np.ndarray) -> np.ndarray:
        if len(indices) > self.slopes:  # of several short lines
            return np.bincount(self.region(indices), minlength=_REGIONS)
        return np.diff(self._positions(indices))

    def open_line(self, line: int, indices: np.ndarray) -> None:
        """Open a line.

        Parameters
        ----------
        line : int
        indices : ndarray of int, shape (n,)
            Indices of its slopes that are to be solved.
        """
        if len(indices):
            self.lines[line] = np.zeros((5, _REGIONS))
            self.lines[line][0] = self._counts_by_region(indices)
            self.points -= len(indices)

    def open_points(self) -> float:
        """Number of points left on open lines."""
        return sum(regions[0].sum() for regions in list(self.lines.values()))  # another thread may change it

    def reopen(self, line: int, indices: np.ndarray) -> None:
        """Close a line that is to be opened again.

        Parameters
        ----------
        line : int
        indices : ndarray of int, shape (n,)
            As it was opened with.
        """
        self.lines.pop(line, None)
        self.points += len(indices)

    def add(self, line: int, indices: np.ndarray, seconds: float, probe: bool) -> None:
        """Add a measurement.

        Parameters
        ----------
        line : int
        indices : ndarray of int, shape (n,)
            Indices of the slopes that were solved.
        seconds : float [s]
        probe : bool
            Whether they were a probe.
        """
        counts = self._counts_by_region(indices)
        shares = counts * (self.cost_per_point(line) if np.count_nonzero(counts) > 1 else 1.0)
        shares = shares if shares.any() else counts  # points too cheap to be measured
        counts_and_seconds = np.stack([counts, seconds * shares / shares.sum()])
        self.totals += counts_and_seconds
        self.mean = self.totals[1].sum() / self.totals[0].sum()
        if line in self.lines:
            self.lines[line][0] -= counts
            self.lines[line][slice(3, 5) if probe else slice(1, 3)] += counts_and_seconds
            if not self.lines[line][0].any():
                del self.lines[line]

    def cost_per_point(self, line: int) -> np.ndarray:
        """Time of a point by region.

        Parameters
        ----------
        line : int

        Returns
        -------
        ndarray, shape (64,) [s]
        """
        overall = _interpolate(self.totals[0], self.totals[1], self.mean)
        regions = self.lines.get(line)
        if regions is None:
            return overall
        _, n, seconds, n_probe, probe_seconds = regions
        estimate, in_blocks = overall, n > 0
        if n_probe.any():
            both = in_blocks & (n_probe > 0)
            if both.any():
                self.overhead = max(0.0, np.median(probe_seconds[both] - n_probe[both] * seconds[both] / n[both]))
            estimate = _interpolate(n_probe, np.maximum(probe_seconds - self.overhead, 0.0), self.mean)
        elif in_blocks.any():
            estimate = overall * seconds.sum() / (n @ overall)
        return np.divide(seconds, n, out=estimate.copy(), where=in_blocks)

    def seconds_left(self, line: int | None = None) -> float:
        """Remaining work [s], on one open line or on all lines."""
        lines = dict(self.lines)  # another thread may change it
        if line is not None:
            return float(self.cost_per_point(line) @ lines[line][0]) if line in lines else 0.0
        open_lines = sum(float(self.cost_per_point(line) @ regions[0]) for line, regions in lines.items())
        return open_lines + self.points * float(_interpolate(self.totals[0], self.totals[1], self.mean).mean())

    def probes(self, line: int, indices: np.ndarray) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """Divide slopes into probes, a few points of each region, and the rest.

        Parameters
        ----------
        line : int
        indices : ndarray of int, shape (n,)
            Indices of slopes in ascending order.

        Returns
        -------
        probes, remainder : list of ndarray of int
        """
        self.probed.add(line)
        probes, remainder = [], []
        for piece in self.by_region(indices):
            middle, n = len(piece) // 2, min(_MAX_PROBE, 1 + self.slopes // (_REGIONS * _PROBE))
            probes.append(piece[middle : middle + n].copy())  # not a view, which would keep all of the line
            remainder += [part for part in (piece[:middle], piece[middle + n :]) if len(part)]
        return probes, remainder


def _interpolate(n: np.ndarray, seconds: np.ndarray, guess: float) -> np.ndarray:
    """Time of a point by region [s], interpolated where none was measured."""
    measured = np.flatnonzero(n)
    if not len(measured):
        return np.full(len(n), guess)
    return np.interp(np.arange(len(n)), measured, seconds[measured] / n[measured])
