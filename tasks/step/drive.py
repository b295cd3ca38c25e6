"""What drives a walker along its branches: the slope of the ground, or at one slope, level
or even uphill, the push-off of the trailing leg.

Gaits are followed over the logarithm of the drive, which is positive. The last unknown of
a gait's equations is ln slope or ln push-off.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy import ndarray

from gaitsweep.tasks.contract.registry import SLOPES
from gaitsweep.tasks.mechanics.lumped import Structure, structure_of
from gaitsweep.tasks.walkers.walker import Walker

#: Windows in which branches are followed: of slopes [rad], and of impulses [mass sqrt(g
#: leg)], as whose root angles grow.
_SLOPES, _IMPULSES = (SLOPES[0], 0.7), (1e-12, 2.0)
#: An impulse that is a parameter of compiled code [mass sqrt(g leg)].
_ORDINARY = 0.4871


@dataclass(frozen=True)
class Drive:
    """What gaits are followed over.

    Attributes
    ----------
    at_slope : float or None
        The slope [rad] at which the push-off drives; None where the slope drives.
    """

    at_slope: float | None = None

    @property
    def name(self) -> str:
        """The key whose logarithm is an unknown."""
        return "slope" if self.at_slope is None else "push_off"

    def structure(self, walker: Walker) -> Structure:
        """Return the structure of a walker, differentiated by the drive."""
        if self.at_slope is None:
            return structure_of(walker)
        # Of no special size, or it would be compiled as a number.
        pushing = replace(walker, push_off=_ORDINARY * unit_of_impulse(walker))
        return replace(structure_of(pushing), drive=self.name)

    def slopes(self, drive: ndarray) -> ndarray:
        """Return the slopes at values of the drive.

        Parameters
        ----------
        drive : ndarray, shape (n,)

        Returns
        -------
        ndarray, shape (n,) [rad]
        """
        if self.at_slope is None:
            return drive
        return np.full(np.shape(drive), self.at_slope)

    def at(self, walker: Walker, drive: float) -> tuple[Walker, float]:
        """Return a walker and the slope [rad] at a value of the drive."""
        if self.at_slope is None:
            return walker, drive
        push = drive * unit_of_impulse(walker)
        return replace(walker, push_off=push), self.at_slope

    @property
    def window(self) -> tuple[float, float]:
        """Least and largest value at which branches are followed."""
        return _SLOPES if self.at_slope is None else _IMPULSES

    def impulses(self, walker: Walker, drive: ndarray) -> ndarray:
        """Return the impulses of the push-off at values of the drive.

        Parameters
        ----------
        walker : Walker or WalkerArray
        drive : ndarray, shape (n,)

        Returns
        -------
        ndarray, shape (n,) [mass sqrt(g leg)]
        """
        if self.at_slope is None:
            own = walker.push_off / unit_of_impulse(walker)
            return np.asarray(np.broadcast_to(own, np.shape(drive)))
        return drive

    def constants(
        self, structure: Structure, constants: ndarray, drive: ndarray
    ) -> ndarray:
        """Return a structure's constants, shape (constants, n), at values of the drive
        (n,).
        """
        if self.at_slope is None:
            return constants
        driven = constants.copy()
        driven[structure.constants.index("push")] = drive
        return driven


def unit_of_impulse(walker: Walker) -> float:
    """Return the unit of impulses inside the solver, mass sqrt(g leg), in the walker's
    units.
    """
    return walker.total_mass * (walker.g * walker.leg) ** 0.5


#: Passive walking, and walkers with a push-off on a slope that varies.
OVER_SLOPE = Drive()
