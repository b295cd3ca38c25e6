"""Slopes that can be asked for: the same in studies, in commands and in Python."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from gaitsweep.tasks.registry import SLOPES

if TYPE_CHECKING:  # help needs no arrays
    import numpy as np

#: What a slope must be.
BOUND = f"must lie in [{SLOPES[0]:g}, {SLOPES[1]:g}) rad"


def is_slope(value: float | np.ndarray) -> Any:
    """Whether one can be asked for, of a slope or of each of an array [rad]; what is no number cannot."""
    return (value >= SLOPES[0]) & (value < SLOPES[1])
