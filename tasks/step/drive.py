"""What drives a walker along its branches: the slope of the ground or, at one slope, level
or even uphill, the push-off of the trailing leg or a torque between the thighs.

Gaits are followed over the logarithm of the drive, which is positive: the last unknown of
their equations is ln slope, ln push-off or ln torque.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy import ndarray

from gaitsweep.tasks.contract.registry import SLOPES
from gaitsweep.tasks.mechanics.lumped import (
    Structure,
    common_structure,
    constants_of,
    general_structure_of,
    lump,
    structure_of,
)
from gaitsweep.tasks.walkers.walker import KEYS, Walker
from gaitsweep.tasks.walkers.walker_array import WalkerArray

SLOPE, PUSH_OFF, HIP_TORQUE = "slope", "push_off", "hip_torque"
#: Windows in which branches are followed: of slopes [rad], impulses [mass sqrt(g leg)],
#: as whose root angles grow, and torques [weight leg], counted over the swing leg's
#: inertia in `Drive`, which give a step as much as twice as large a slope.
_WINDOWS = {
    SLOPE: (SLOPES[0], 0.7),
    PUSH_OFF: (1e-12, 2.0),
    HIP_TORQUE: (1e-18, 0.35),
}
#: A drive of no special size, which is a parameter of compiled code.
_ORDINARY = 0.4871


@dataclass(frozen=True)
class Drive:
    """What gaits are followed over.

    Attributes
    ----------
    key : str
        `slope`, `push_off` or `hip_torque`.
    base : float or None
        The slope [rad] where the drive vanishes: at which another key drives, or from
        which slopes are counted where it is theirs that is varied, so that those of 0
        and below have logarithms, too. None where slopes are counted from 0.
    """

    key: str = SLOPE
    base: float | None = None

    def structure(self, walker: Walker) -> Structure:
        """Return the structure of a walker, differentiated by the drive."""
        if self.key == SLOPE:
            return structure_of(walker)
        driven = walker.having(self.key, _ORDINARY * self.unit(walker))
        return replace(structure_of(driven), drive=self.key)

    def common_structure(self, walkers: WalkerArray) -> Structure:
        """Return a structure for all of an array of walkers, differentiated by the
        drive.
        """
        if self.key == SLOPE:
            return common_structure(walkers)
        drive = np.full(len(walkers), _ORDINARY)
        return replace(common_structure(self.walkers(walkers, drive)), drive=self.key)

    def unit(self, walker: Walker) -> Any:
        """Return the unit of the drive inside the solver, in the walker's units; of an
        array of walkers, that of each.
        """
        if self.key == SLOPE:
            return 1.0
        if self.key == PUSH_OFF:
            return unit_of_impulse(walker)
        return 1.0 / _lumped_torque(walker)

    def of(self, walker: Walker) -> float:
        """Return the drive of a walker; 0 where it has none."""
        return float(getattr(walker, self.key) / self.unit(walker))

    def at(self, walker: Walker, drive: float) -> tuple[Walker, float]:
        """Return a walker and the slope [rad] at a value of the drive; a torque adds to
        the walker's own.
        """
        if self.key == SLOPE:
            return walker, (self.base or 0.0) + drive
        assert self.base is not None
        own = getattr(walker, self.key) if self.key == HIP_TORQUE else 0.0
        return walker.having(self.key, own + drive * self.unit(walker)), self.base

    def walkers(self, walker: Walker, drive: ndarray) -> WalkerArray:
        """Return the walkers that values of a drive other than the slope (n,) make of
        one walker, or each of one of an array; a torque adds to their own.
        """
        own = getattr(walker, self.key) if self.key == HIP_TORQUE else 0.0
        changes: dict[str, Any] = {self.key: own + drive * self.unit(walker)}
        numbers = {name: getattr(walker, name) for name in KEYS}
        return WalkerArray(**{**numbers, **changes})

    def slopes(self, drive: ndarray) -> ndarray:
        """Return the slopes at values of the drive.

        Parameters
        ----------
        drive : ndarray, shape (n,)

        Returns
        -------
        ndarray, shape (n,) [rad]
        """
        if self.base is None:
            return drive
        if self.key == SLOPE:
            return self.base + drive
        return np.full(np.shape(drive), self.base)

    def counted(self, slope: ndarray) -> ndarray:
        """Return the values of a drive that is the slope at slopes (n,) [rad]."""
        return slope - (self.base or 0.0)

    def constants(
        self, structure: Structure, constants: ndarray, drive: ndarray
    ) -> ndarray:
        """Return a structure's constants, shape (constants, n), at values of the drive
        (n,).
        """
        if self.key == SLOPE:
            return constants
        driven = constants.copy()
        row = structure.constants.index(_LUMPED[self.key])
        driven[row] = drive + (driven[row] if self.key == HIP_TORQUE else 0.0)
        return driven

    def set_exact(
        self,
        constants: dict[str, object],
        drive: float,
        number: Callable[[float], object],
    ) -> None:
        """Set constants of a wider type of number to a value of the drive."""
        if self.key == PUSH_OFF:
            constants["push"] = number(drive)
        if self.key == HIP_TORQUE:
            constants["hip_bias"] = constants["hip_bias"] + number(drive)  # type: ignore[operator]

    def window(self, walker: Walker) -> tuple[float, float]:
        """Return the least and largest value at which a walker's branches are
        followed.
        """
        low, high = _WINDOWS[self.key]
        if self.key == SLOPE and self.base is not None:
            return max(low, -SLOPES[1] - self.base), high - self.base
        unit = self._size(walker)
        return low * unit, high * unit

    def anchors(self, walker: Walker, slopes: tuple[float, ...]) -> tuple[float, ...]:
        """Return values at which steps on level ground are as long as those on slopes
        [rad]: angles grow as the cube root of slopes and torques, and as the root of
        impulses. They are dense enough uphill, too, to where walking ends.
        """
        if self.key == PUSH_OFF:
            return tuple(slope ** (2 / 3) for slope in slopes)
        return tuple(slope / 2 * self._size(walker) for slope in slopes)

    def like_slope(self, walker: Walker, drive: float) -> float:
        """Return the slope [rad] on which steps are as long as at a value: what
        `anchors` takes to it.
        """
        if self.key == PUSH_OFF:
            return drive**1.5
        if self.key == HIP_TORQUE:
            return 2 * drive / self._size(walker)
        return drive

    def _size(self, walker: Walker) -> float:
        """The lumped value of a torque of one weight times leg; 1 of other drives."""
        return 1 / lump(walker)["eps"] if self.key == HIP_TORQUE else 1.0


#: The lumped constants that drive.
_LUMPED = {PUSH_OFF: "push", HIP_TORQUE: "hip_bias"}


def _lumped_torque(walker: Walker) -> Any:
    """The lumped constant of a unit torque; of an array of walkers, that of each."""
    alone = replace(walker, hip_torque=1.0, hip_rest=0.0)
    if not isinstance(alone, WalkerArray):
        return float(lump(alone)["hip_bias"])
    structure = general_structure_of(alone)
    constants = constants_of(alone, structure)
    return constants[structure.constants.index("hip_bias")]


def unit_of_impulse(walker: Walker) -> Any:
    """Return the unit of impulses inside the solver, mass sqrt(g leg), in the walker's
    units; of an array of walkers, that of each.
    """
    return walker.total_mass * (walker.g * walker.leg) ** 0.5


#: Passive walking, and walkers that are driven on a slope that varies.
OVER_SLOPE = Drive()


def over_slopes(slope: float) -> tuple[Drive, float]:
    """Return how slopes are counted so that a given one has a logarithm, and its value:
    one of 0 or below is counted from a lower one, without loss of digits.

    Parameters
    ----------
    slope : float [rad]
    """
    if slope > 0:
        return OVER_SLOPE, slope
    above = 2.0 ** np.ceil(np.log2(-slope)) if slope else 1.0
    return Drive(SLOPE, slope - above), above
