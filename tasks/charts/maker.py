"""What charts over the keys of a box are made with: its walkers and their step map."""

from __future__ import annotations

import numpy as np

from gaitsweep.tasks.charts.box import Box, Refused
from gaitsweep.tasks.charts.family import Family
from gaitsweep.tasks.mechanics.lumped import Structure
from gaitsweep.tasks.step.problem import Lanes
from gaitsweep.tasks.walkers.statics import leg_moment
from gaitsweep.tasks.walkers.walker import WalkerError
from gaitsweep.tasks.walkers.walker_array import WalkerArray


class Maker:
    """Makes charts over a box.

    Parameters
    ----------
    family : Family
    box : Box
    structure : Structure
        Of all its walkers.
    """

    def __init__(
        self,
        family: Family,
        box: Box,
        structure: Structure,
    ):
        self.family = family
        self.box = box
        self.structure = structure
        self.d = len(box.keys)

    def problem(self, unit: np.ndarray) -> Lanes:
        """Return the step map of walkers.

        Parameters
        ----------
        unit : ndarray, shape (n, d)
            Coordinates of keys.
        """
        return Lanes(self.walkers(unit), self.structure, self.family.drive)

    def walkers(self, unit: np.ndarray) -> WalkerArray:
        """Return walkers.

        Parameters
        ----------
        unit : ndarray, shape (n, d)
            Coordinates of keys.

        Raises
        ------
        Refused
            If one cannot be.
        """
        try:
            return self.family.walkers(self.box.at(unit))
        except WalkerError as error:
            raise Refused(f"special points are followed to where {error}") from None

    def static_moment(self, unit: np.ndarray) -> np.ndarray:
        """Return what vanishes where the smallest slope of straight legs does: the
        moment of a leg about the hip.

        Parameters
        ----------
        unit : ndarray, shape (n, d)
            Coordinates of keys.

        Returns
        -------
        ndarray, shape (n,)
        """
        return np.broadcast_to(leg_moment(self.walkers(unit)).real, len(unit))
