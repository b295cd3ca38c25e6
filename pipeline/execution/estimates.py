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
        self.whole = np.zeros((2, REGIONS))  # points and seconds of all lines
        self.probed: set[int] = set()
        self.overhead = 0.0  # s a chunk takes whatever is in it; shows where more of a region than a probe was measured

    def region(self, places: np.ndarray) -> np.ndarray:
        """Region of each place."""
        return places * REGIONS // self.slopes

    def _often(self, places: np.ndarray) -> np.ndarray:
        return np.bincount(self.region(places), minlength=REGIONS)

    def begin(self, line: int, places: np.ndarray) -> None:
        """The line is at work on the slopes at those places."""
        if len(places):
            self.lines[line] = np.zeros((5, REGIONS))
            self.lines[line][0] = self._often(places)
            self.points -= len(places)

    def begun(self) -> float:
        """How many points are left on lines at work."""
        return sum(regions[0].sum() for regions in self.lines.values())

    def give_up(self, line: int) -> None:
        """Nothing of the line is left to be done."""
        self.lines.pop(line, None)

    def add(self, line: int, places: np.ndarray, seconds: float, probe: bool) -> None:
        """Points of a line took so long."""
        where = self._often(places)
        measured = np.stack([where, seconds * where / len(places)])
        self.whole += measured
        self.mean = self.whole[1].sum() / self.whole[0].sum()
        if line in self.lines:
            self.lines[line][0] -= where
            self.lines[line][slice(3, 5) if probe else slice(1, 3)] += measured
            if not self.lines[line][0].any():
                self.give_up(line)

    def each(self, line: int) -> np.ndarray:
        """Seconds of a point in each region of a line."""
        whole = _filled(self.whole[0], self.whole[1], self.mean)
        regions = self.lines.get(line)
        if regions is None:
            return whole
        _, n, seconds, n_probe, probe = regions
        found, known = whole, n > 0
        if n_probe.any():
            both = known & (n_probe > 0)
            if both.any():
                self.overhead = max(0.0, np.median(probe[both] - n_probe[both] * seconds[both] / n[both]))
            found = _filled(n_probe, np.maximum(probe - self.overhead, 0.0), self.mean)
        elif known.any():
            found = whole * seconds.sum() / (n @ whole)
        return np.divide(seconds, n, out=found.copy(), where=known)

    def left(self, line: int | None = None) -> float:
        """Seconds of work that is left, on one line at work or on all."""
        lines = dict(self.lines)  # it may change while another thread reads
        if line is not None:
            return float(self.each(line) @ lines[line][0]) if line in lines else 0.0
        begun = sum(float(self.each(line) @ regions[0]) for line, regions in lines.items())
        return begun + self.points * float(_filled(self.whole[0], self.whole[1], self.mean).mean())

    def probes(self, line: int, places: np.ndarray) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """A few points of each region, and the rest of it."""
        self.probed.add(line)
        few, rest = [], []
        for piece in np.split(places, np.flatnonzero(np.diff(self.region(places))) + 1):
            at, n = len(piece) // 2, 1 + self.slopes // (REGIONS * _PROBE)
            few.append(piece[at : at + n])
            rest += [part for part in (piece[:at], piece[at + n :]) if len(part)]
        return few, rest


def _filled(n: np.ndarray, seconds: np.ndarray, guess: float) -> np.ndarray:
    """Seconds of a point by region; where nothing was measured, between those beside it."""
    known = np.flatnonzero(n)
    if not len(known):
        return np.full(len(n), guess)
    return np.interp(np.arange(len(n)), known, seconds[known] / n[known])
