"""Names of the measures of a walker's gaits; this module imports no solver."""

from __future__ import annotations

from gaitsweep.tasks.contract.registry import VARIABLES
from gaitsweep.tasks.walkers.walker import Walker

#: Variables that say how well a gait is known, not what it is.
_OF_THE_SOLVE = (
    "residual",
    "error_bound",
    "multiplier_error_bound",
    "energy_imbalance",
)


def measures(walker: Walker) -> list[str]:
    """Return the names of the measures of a walker whose value may be asked for."""
    return [
        name
        for name, about in VARIABLES.items()
        if about.dims == ("gait",)
        and about.dtype == "f8"
        and about.group != "proofs"
        and name not in _OF_THE_SOLVE
        and about.only_of in ("", *walker.features)
    ]
