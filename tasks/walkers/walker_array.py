"""Walkers that differ in some numbers, as arrays."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np

from gaitsweep.tasks.walkers.walker import KEYS, NUMBERS, OF_HIP, Walker


class WalkerArray(Walker):
    """Walkers of one kind: each number is one for all, or an array of one for each,
    shape (n,).

    Numbers are not checked: for an invalid walker, what follows from them is NaN or
    meaningless.
    """

    _math: ClassVar[Any] = np

    def __post_init__(self) -> None:
        """Check nothing."""

    @classmethod
    def of(cls, walkers: Sequence[Walker]) -> WalkerArray:
        """Return walkers as an array.

        Parameters
        ----------
        walkers : sequence of Walker
            All with or all without knees, which all follow one rule at heelstrike.
        """
        numbers: dict[str, Any] = {
            key: np.array([getattr(walker, key) for walker in walkers], float)
            for key in NUMBERS
        }
        units: Any = np.array([walker.units for walker in walkers])
        first = walkers[0]

        return cls(
            **numbers,
            knees=first.knees,
            units=units,
            trailing_knee=first.trailing_knee,
        )

    @functools.cached_property
    def _size(self) -> int:
        return max(np.size(getattr(self, key)) for key in KEYS)

    def __len__(self) -> int:
        return self._size

    def __getitem__(self, lane: int) -> Walker:
        keys = self.table()
        for key, value in keys.items():
            if isinstance(value, np.ndarray):
                keys[key] = value[lane].item()
        return Walker(**keys)

    def some(self, lanes: np.ndarray | slice) -> WalkerArray:
        """Return some of the walkers.

        Parameters
        ----------
        lanes : ndarray of int, shape (k,), or slice
        """
        keys = self.table()
        for key, value in keys.items():
            if isinstance(value, np.ndarray):
                keys[key] = value[lanes]
        return WalkerArray(**keys)

    def beyond(self, mirrored: WalkerArray) -> WalkerArray:
        """Return walkers as far beyond these as others are before them, linearly in every
        number.
        """
        numbers = {
            key: 2 * getattr(self, key) - getattr(mirrored, key) for key in NUMBERS
        }
        return WalkerArray(**{**self.table(), **numbers})

    @property
    def eps_S(self) -> Any:
        """Angle between the shank and the hip-foot-centre line at full extension [rad]."""
        d = self.l_s - self.R
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.where(d == 0, 0.0, np.arcsin(self.l_t * np.sin(self.eps_T) / d))

    @property
    def massless_legs(self) -> np.ndarray:
        """Whether each walker's swing leg has no inertia about the hip, shape (n,)."""
        massive = (self.m_s != 0) | (
            self.m_t * (self.r_t**2 + self.c_t**2 + self.w_t**2) != 0
        )
        return np.broadcast_to(np.logical_not(massive), len(self))

    @property
    def acting(self) -> np.ndarray:
        """Whether each walker pushes off, and whether anything acts between its thighs,
        shape (2, n).
        """
        of_hip = np.any(
            [np.broadcast_to(getattr(self, key), len(self)) for key in OF_HIP], axis=0
        )
        pushes = np.broadcast_to(self.push_off, len(self))
        return np.stack([pushes, of_hip]) != 0
