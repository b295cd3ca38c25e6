"""Where the walkers of a box are tuned: their gaits continue to vanishing slopes, and
special points move by powers.
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gaitsweep.tasks.branches.root import bracketed_root
from gaitsweep.tasks.charts.box import Box
from gaitsweep.tasks.charts.family import Family
from gaitsweep.tasks.walkers.statics import leg_moment
from gaitsweep.tasks.walkers.walker import WalkerError

#: Places along a key beside which walkers may be tuned, and how far outside they count.
_PLACES = np.linspace(-1, 1, 9)
_NEAR = 1.25
#: A face lies where walkers are tuned if the slope at which its own are balanced, over
#: the largest of the box, is less than this: the place may be a root, found to about so
#: much. It says how a box is divided, not who is tuned.
_AT_FACE = 1e-9


@dataclass(frozen=True)
class Tuning:
    """Slopes at which still walkers, legs together, are balanced, along a key through
    the middle of a box.

    Attributes
    ----------
    family : Family
    box : Box
    axis : int
    others : float
        Coordinate of the other keys.
    """

    family: Family
    box: Box
    axis: int
    others: float = 0.0

    def balanced(self, at: np.ndarray) -> np.ndarray:
        """Return the slopes [rad] at coordinates of the key, shape (n,) both: of that
        order are smallest slopes.
        """
        unit = np.full((len(at), len(self.box.keys)), self.others)
        unit[:, self.axis] = at
        walkers = self.family.walkers(self.box.at(unit))
        moment = leg_moment(walkers)
        slopes = 2 * moment.real / (walkers.total_mass * walkers.leg + 2 * moment.imag)
        return np.broadcast_to(slopes, len(at))

    @cached_property
    def slopes(self) -> np.ndarray:
        """The slopes [rad] at places from face to face."""
        return self.balanced(_PLACES)

    @property
    def largest(self) -> float:
        """Largest of the slopes."""
        return float(np.abs(self.slopes).max())

    def at_faces(self) -> tuple[bool, bool]:
        """Return whether the walkers at the lower and at the upper face are tuned."""
        low, high = np.abs(self.slopes[[0, -1]]) < _AT_FACE * self.largest
        return bool(low), bool(high)

    def inside(self) -> float | None:
        """Return the first value of the key between the faces at which walkers are
        tuned [the walker's units].
        """
        return None if any(self.at_faces()) else self._between(_PLACES, self.slopes)

    def outside(self) -> float | None:
        """Return a value of the key near outside faces that are not, where walkers are
        tuned [the walker's units].
        """
        for side in () if any(self.at_faces()) else (-1, 1):
            places = side * np.array([1.0, _NEAR])
            # Some walkers outside cannot be.
            with contextlib.suppress(WalkerError):
                if (value := self._between(places, self.balanced(places))) is not None:
                    return value
        return None

    def _between(self, places: np.ndarray, slopes: np.ndarray) -> float | None:
        """The first value of the key at which walkers are tuned, between places with
        these slopes.
        """
        crossing = np.flatnonzero(np.sign(slopes[1:]) != np.sign(slopes[:-1]))
        if not len(crossing):
            return None

        low, high = sorted(places[crossing[0] : crossing[0] + 2].tolist())
        at = bracketed_root(lambda x: float(self.balanced(np.array([x]))[0]), low, high)
        unit = np.full((1, len(self.box.keys)), self.others)
        unit[0, self.axis] = at
        return float(self.box.at(unit)[0, self.axis])

    def beside(self) -> int:
        """Return -1 or 1 if walkers are tuned at the lower or the upper face, or just
        outside or inside; 0 if not.
        """
        for side in (-1, 1):
            a, b = self.balanced(side * np.array([0.9, 1.1]))
            if a * b < 0:
                return side
        return 0
