"""Names of the measures of a walker's gaits; this module imports no solver."""

from __future__ import annotations

from gaitsweep.tasks.contract.registry import VARIABLES, is_measure
from gaitsweep.tasks.walkers.walker import Walker


def measures(walker: Walker) -> list[str]:
    """Return the names of the measures of a walker whose value may be asked for."""
    return [
        name
        for name, about in VARIABLES.items()
        if is_measure(name) and about.only_of in ("", *walker.features)
    ]
