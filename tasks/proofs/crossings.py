"""Flips and folds as intervals that hold one, shown by a function of opposite signs at
the ends of a tube.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from flint import arb, ctx

from gaitsweep.tasks.proofs.enclosure import NotProvedError
from gaitsweep.tasks.proofs.stability import flip_function
from gaitsweep.tasks.proofs.tubes import (
    BY_ANGLE,
    BY_SLOPE,
    REMAINDER,
    Family,
    Tube,
    point,
    tangent_of,
    tube,
)

#: Radius of the box of an interval's end over the interval's; steps of the secant
#: method.
SHARPER, MAX_SECANTS = 1e-6, 30


@dataclass(frozen=True)
class Interval:
    """An interval of slopes that holds a flip or a fold, and the tube that shows it.

    `values` are those of the function that changes its sign, at the interval's ends.
    """

    slope: arb
    angle: arb
    values: tuple[arb, arb]
    tube: Tube
    bits: int


#: The coordinate along which a special point of each kind is sought, and the function
#: that changes its sign there.
KINDS: dict[str, tuple[int, Callable[[Tube], arb]]] = {
    "flip": (BY_SLOPE, lambda piece: flip_function(piece.step_derivative())),
    "fold": (BY_ANGLE, Tube.turn),
}


def bracketed(
    family: Family, guess: Sequence[arb], half: float, function: Callable[[Tube], arb]
) -> Interval:
    """An interval of slopes that holds a zero of a function along one branch.

    Parameters
    ----------
    family : Family
    guess : sequence of arb
        Section state, event times and slope near it.
    half : float
        Half the interval of the family's parameter [rad].
    function : callable
        One of `KINDS`.

    Returns
    -------
    Interval

    Raises
    ------
    NotProvedError
        If the function is not shown to change its sign along one branch.
    """
    size = half * SHARPER
    with ctx.workprec(64 - math.floor(math.log2(size * REMAINDER))):
        centre = _zero(family, guess, function, half, size)
        ends = [
            point(family, [x.mid() for x in centre.at(arb(side * half))], size)
            for side in (-1, 1)
        ]
        whole = tube(family, centre, arb(half))
        if not all(whole.holds(end) for end in ends):
            raise NotProvedError(
                "The gaits at the interval's ends are not those of the tube."
            )

        values = function(ends[0]), function(ends[1])
        if not (values[0] * values[1] < 0):
            raise NotProvedError("The test function is not shown to change its sign.")

        every = whole.whole
        return Interval(every[-1], every[0], values, whole, ctx.prec)


def _zero(
    family: Family,
    guess: Sequence[arb],
    function: Callable[[Tube], arb],
    half: float,
    size: float,
) -> Tube:
    """A point of the branch near a zero of the function, by the secant method."""
    p = family.parameter
    current = point(family, guess, 1e-12)
    value, reach = function(current).mid(), 1e-4 * abs(current.middle[p])
    for _ in range(MAX_SECANTS):
        fine = 1e-4 * float(abs(reach / current.middle[p]))
        trial = point(family, _along(current, reach), max(size, min(fine, 1e-10)))
        other = function(trial).mid()
        if other == value:
            break

        reach, current, value = (-other * reach / (other - value)).mid(), trial, other
        if abs(reach) < half / 100:
            return current

        reach = max(
            min(reach, 0.02 * abs(current.middle[p])), -0.02 * abs(current.middle[p])
        )

    raise NotProvedError("No zero of the test function is found near the guess.")


def _along(current: Tube, reach: arb) -> list[arb]:
    return [
        (c + t * reach).mid()
        for c, t in zip(current.middle, tangent_of(current), strict=True)
    ]
