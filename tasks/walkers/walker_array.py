"""Walkers that differ in some numbers, as arrays."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np

from gaitsweep.tasks.walkers.walker import KEYS, Walker


class WalkerArray(Walker):
    """Walkers of one kind: each number is one for all, or an array of one for each, shape (n,).

    Numbers are not checked: for an invalid walker, what follows from them is NaN or meaningless.
    """

    def __post_init__(self) -> None:
        """Check nothing."""

    @functools.cached_property
    def _size(self) -> int:
        return max(np.size(getattr(self, key)) for key in KEYS)

    def __len__(self) -> int:
        return self._size

    def __getitem__(self, lane: int) -> Walker:
        return Walker(**{key: v[lane].item() if isinstance(v, np.ndarray) else v for key, v in self.table().items()})

    def some(self, lanes: np.ndarray) -> WalkerArray:
        """Return some of the walkers.

        Parameters
        ----------
        lanes : ndarray of int, shape (k,)
        """
        return WalkerArray(**{key: v[lanes] if isinstance(v, np.ndarray) else v for key, v in self.table().items()})

    def table(self) -> dict[str, Any]:
        """All keys and values."""
        return {key: getattr(self, key) for key in KEYS}

    @property
    def eps_S(self) -> Any:
        """Angle between the shank and the hip-foot-centre line at full extension [rad]."""
        d = self.l_s - self.R
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.where(d == 0, 0.0, np.arcsin(self.l_t * np.sin(self.eps_T) / d))

    @property
    def l(self) -> Any:
        """Length from hip to foot centre, with the knee extended."""
        return self.l_t * np.cos(self.eps_T) + (self.l_s - self.R) * np.cos(self.eps_S)

    @property
    def knee(self) -> Any:
        """Position of the knee from the hip, in the frame of the extended leg: x forward, y up."""
        return -self.l_t * (np.sin(self.eps_T) + 1j * np.cos(self.eps_T))

    @property
    def thigh_centre(self) -> Any:
        """Position of the thigh's centre of mass from the hip, in the frame of the extended leg."""
        return -np.exp(-1j * self.eps_T) * (self.w_t + 1j * self.c_t)

    @property
    def shank_centre(self) -> Any:
        """Position of the shank's centre of mass from the knee, in the frame of the extended leg."""
        return -np.exp(1j * self.eps_S) * (self.w_s + 1j * self.c_s)

    @property
    def massless_legs(self) -> np.ndarray:
        """Whether each walker's swing leg has no inertia about the hip, shape (n,)."""
        massive = (self.m_s != 0) | (self.m_t * (self.r_t**2 + self.c_t**2 + self.w_t**2) != 0)
        return np.broadcast_to(np.logical_not(massive), len(self))

    @property
    def massless_leg(self) -> bool:
        """Whether no swing leg has inertia about the hip."""
        return bool(self.massless_legs.all())

    @property
    def point_foot(self) -> bool:
        """Whether every leg's mass is one point at a foot of zero radius."""
        hip_thigh = not np.any(self.m_t) or not any(map(np.any, (self.c_t, self.w_t, self.r_t)))
        foot = np.all(self.c_s == self.l_s) and not (np.any(self.w_s) or np.any(self.r_s))
        return bool(hip_thigh and foot and not (np.any(self.R) or np.any(self.eps_T) or self.knees))
