"""What is asked of the gaits of lines."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from gaitsweep.tasks.contract.accuracy import is_converted
from gaitsweep.tasks.measures.gaits import Wanted


@dataclass(frozen=True, eq=False)
class Request:
    """The slopes at which gaits are solved, and what is wanted of them.

    Attributes
    ----------
    slope : ndarray, shape (n,) [rad]
    wanted : Wanted
        Variables, labels, limits of violations and accuracy.
    steps : int
        After which the gaits repeat.
    interpolated : bool
        Whether polynomials give the gaits where they reach the accuracy.
    charted : bool
        Whether polynomials give the derivatives of gaits where they suffice.
    along : str
        The key that drives at the lines' slopes and has the values in place of slopes,
        in the walker's units; empty if these do.
    """

    slope: np.ndarray
    wanted: Wanted
    steps: int = 1
    interpolated: bool = False
    charted: bool = False
    along: str = ""

    @property
    def is_converted(self) -> bool:
        """Whether gaits may be those of a walker that differs in its units."""
        return is_converted(self.wanted.names, self.wanted.accuracy)

    @property
    def key(self) -> tuple[Any, ...]:
        """What tells requests apart."""
        kind = (
            repr(self.wanted),
            self.steps,
            self.interpolated,
            self.charted,
            self.along,
        )
        return self.slope.tobytes(), *kind

    @classmethod
    def of(cls, params: Mapping[str, Any]) -> Request:
        """Return what the parameters of a task ask for, as
        `tasks.studies.solve_points:points` has them.
        """
        return cls(
            slope=np.asarray(params["slope"], float),
            wanted=Wanted.of(params),
            steps=int(params.get("steps", 1)),
            interpolated=bool(params.get("interpolated", False)),
            charted=bool(params.get("charted", False)),
            along=str(params.get("along", "")),
        )
