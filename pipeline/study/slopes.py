"""Slopes that can be asked for: the same in studies, in commands and in Python."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from gaitsweep.pipeline.errors import StudyError
from gaitsweep.pipeline.study.location import Location
from gaitsweep.tasks.contract.registry import SLOPES

if TYPE_CHECKING:  # help needs no arrays
    import numpy as np

#: What a slope must be, and that of a walker which more than gravity drives.
BOUND = f"must lie in [{SLOPES[0]:g}, {SLOPES[1]:g}) rad"
BOUND_OF_DRIVEN = f"{BOUND}, or in (-{SLOPES[1]:g}, 0]"
#: What a walker must have on other slopes than these.
WHAT_DRIVES = (
    "on level ground and uphill a walker needs a `push_off` or a `hip_torque` above 0, "
    "or a spring whose `hip_rest` is, between legs with mass"
)


def is_slope(value: float | np.ndarray) -> Any:
    """Whether one can be asked for, of a slope or of each of an array [rad]; what is no
    number cannot.
    """
    return (value >= SLOPES[0]) & (value < SLOPES[1])


def is_level(value: float | np.ndarray) -> Any:
    """Whether a slope is level, or leads uphill, so that a walker must be driven."""
    return (value <= 0) & (value > -SLOPES[1])


def undriven(value: float) -> StudyError:
    """Return why a slope of 0, or below, cannot be asked for of a walker that nothing
    drives there.
    """
    wrong = str(Location("", "slope").wrong(BOUND, value))
    return StudyError(f"{wrong[:-1]}: {WHAT_DRIVES}.")


def check(
    value: float, place: Location | None = None, may_be_level: bool = False
) -> None:
    """Refuse a slope that cannot be asked for; one that is too steep may be meant in
    degrees.

    Raises
    ------
    StudyError
        If it cannot.
    """
    if is_slope(value) or (may_be_level and is_level(value)):
        return

    bound = BOUND_OF_DRIVEN if may_be_level and value <= 0 else BOUND
    wrong = (place or Location("", "slope")).wrong(bound, value)
    if is_slope(radians := math.radians(value)):
        degrees = "1 degree is" if value == 1 else f"{value:g} degrees are"
        wrong = StudyError(f"{str(wrong)[:-1]}: degrees? {degrees} {radians:.6g} rad.")

    raise wrong
