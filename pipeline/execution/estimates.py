"""What points cost by region: a point near a singularity may cost as much as a thousand others.

A region is one part of one line's slopes. Long lines are probed: a few points from each region, before the rest.
"""

from __future__ import annotations

import numpy as np

REGIONS = 64
_PROBE = 50  # a probe is so manieth part of its region


class Costs:
    """Seconds that were measured and points that are left, by line and region.

    Parameters
    ----------
    slopes : int
        How many each line has.
    points : int
        How many are to be solved on all lines.
    guess : float
        Seconds of a point, before anything is measured.
    """

    def __init__(self, slopes: int, points: int, guess: float):
        self.slopes, self.points, self.mean = max(1, slopes), points, guess
        self.lines: dict[int, np.ndarray] = {}  # of lines at work, each region's: left, points and seconds, of probes
        self.totals = np.zeros((2, REGIONS))  # points and seconds of all lines
        self.probed: set[int] = set()
        self.overhead = 0.0  # s a chunk takes whatever is in it; shows where more of a region than a probe was measured

    def region(self, places: np.ndarray) -> np.ndarray:
        """Region of each place."""
        return places * REGIONS // self.slopes

    def _counts_by_region(self, places: np.ndarray) -> np.ndarray:
        return np.bincount(self.region(places), minlength=REGIONS)

    def open_line(self, line: int, places: np.ndarray) -> None:
        """The line is at work on the slopes at those places."""
        if len(places):
            self.lines[line] = np.zeros((5, REGIONS))
            self.lines[line][0] = self._counts_by_region(places)
            self.points -= len(places)

    def open_points(self) -> float:
        """How many points are left on lines at work."""
        return sum(regions[0].sum() for regions in self.lines.values())

    def abandon(self, line: int) -> None:
        """Nothing of the line is left to be done."""
        self.lines.pop(line, None)

    def add(self, line: int, places: np.ndarray, seconds: float, probe: bool) -> None:
        """Points of a line took so long."""
        counts = self._counts_by_region(places)
        counts_and_seconds = np.stack([counts, seconds * counts / len(places)])
        self.totals += counts_and_seconds
        self.mean = self.totals[1].sum() / self.totals[0].sum()
        if line in self.lines:
            self.lines[line][0] -= counts
            self.lines[line][slice(3, 5) if probe else slice(1, 3)] += counts_and_seconds
            if not self.lines[line][0].any():
                self.abandon(line)

    def cost_per_point(self, line: int) -> np.ndarray:
        """Seconds of a point in each region of a line."""
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
        """Seconds of work that is left, on one line at work or on all."""
        lines = dict(self.lines)  # it may change while another thread reads
        if line is not None:
            return float(self.cost_per_point(line) @ lines[line][0]) if line in lines else 0.0
        open_lines = sum(float(self.cost_per_point(line) @ regions[0]) for line, regions in lines.items())
        return open_lines + self.points * float(_interpolate(self.totals[0], self.totals[1], self.mean).mean())

    def probes(self, line: int, places: np.ndarray) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """A few points of each region, and the rest of it."""
        self.probed.add(line)
        probes, rest = [], []
        for piece in np.split(places, np.flatnonzero(np.diff(self.region(places))) + 1):
            at, n = len(piece) // 2, 1 + self.slopes // (REGIONS * _PROBE)
            probes.append(piece[at : at + n])
            rest += [part for part in (piece[:at], piece[at + n :]) if len(part)]
        return probes, rest


def _interpolate(n: np.ndarray, seconds: np.ndarray, guess: float) -> np.ndarray:
    """Seconds of a point by region; where nothing was measured, between those beside it."""
    measured = np.flatnonzero(n)
    if not len(measured):
        return np.full(len(n), guess)
    return np.interp(np.arange(len(n)), measured, seconds[measured] / n[measured])
