"""Intervals of slopes covered by tubes of stable gaits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from flint import arb, ctx, fmpq

from gaitsweep.tasks.proofs.body import Body
from gaitsweep.tasks.proofs.enclosure import NotProvedError
from gaitsweep.tasks.proofs.gait import sizes
from gaitsweep.tasks.proofs.stability import is_stable
from gaitsweep.tasks.proofs.tubes import (
    BY_SLOPE,
    Family,
    Tube,
    point,
    tangent_of,
    tube_image,
)

#: Precision, remainders, half the first tube's length and the least [rad], and how far
#: tubes overlap.
BITS, TOLERANCE, FIRST_HALF, MIN_HALF, OVERLAP = 64, 1e-13, 5e-7, 1e-10, 1e-3


def stable_over(
    family: Family, guess: Sequence[arb], ends: tuple[fmpq, fmpq]
) -> list[Tube]:
    """Tubes that cover an interval of slopes, on each of which the gait is a step of
    one label, and stable.

    Parameters
    ----------
    guess : sequence of arb
        Section state, event times and slope of a gait near the lower end.
    ends : (fmpq, fmpq) [rad]

    Returns
    -------
    list of Tube
        By rising slope.

    Raises
    ------
    NotProvedError
        If a tube fails however short, or two neighbours hold different gaits.
    """
    cover: list[Tube] = []
    with ctx.workprec(BITS):
        low, high = (arb(end) for end in ends)
        first = point(family, [*guess[:-1], low.mid()], TOLERANCE)
        flat = [arb(0)] * len(first.middle)
        branch = _Nearby(first.middle, tangent_of(first), flat)
        begin = (low - OVERLAP * FIRST_HALF).mid()
        half = FIRST_HALF
        while not begin > high:
            half = min(half, (1 + OVERLAP) * float((high - begin) / 2))
            slope = (begin + half).mid()
            middle, tangent = branch.at(slope)
            try:
                piece = _stable_piece(first.body, middle, tangent, half, cover[-1:])
            except (NotProvedError, ZeroDivisionError):
                half /= 1.6
                if half < MIN_HALF:
                    raise
                continue

            cover.append(piece)
            branch = branch.moved_to(piece, slope)
            begin = (slope + (1 - OVERLAP) * half).mid()
            half *= 1.1

    return cover


@dataclass(frozen=True)
class _Nearby:
    """A branch near a gait, roughly: the gait with its slope, and first and second
    derivatives by that.
    """

    middle: list[arb]
    tangent: list[arb]
    curvature: list[arb]

    def at(self, slope: arb) -> tuple[list[arb], list[arb]]:
        """The gait at another slope, and the tangent there."""
        shift = slope - self.middle[-1]
        middle, tangent = [], []
        by_order = zip(self.middle, self.tangent, self.curvature, strict=True)
        for c, t, b in by_order:
            middle.append((c + t * shift + b * shift**2 / 2).mid())
            tangent.append((t + b * shift).mid())

        middle[-1] = slope
        tangent[-1] = arb(1)
        return middle, tangent

    def moved_to(self, piece: Tube, slope: arb) -> _Nearby:
        """The branch near a tube around a slope."""
        shift = slope - self.middle[-1]
        tangent = tangent_of(piece)
        changes = zip(tangent, self.tangent, strict=True)
        curvature = [((new - old) / shift).mid() for new, old in changes]
        corrected = zip(piece.middle, piece.image, strict=True)
        middle = [(c + k).mid() for c, k in corrected]
        return _Nearby(middle, tangent, curvature)


def _stable_piece(
    walker: Body,
    middle: list[arb],
    tangent: list[arb],
    half: float,
    neighbour: list[Tube],
) -> Tube:
    """A tube on which gaits are stable long steps, and that holds the gait of its
    neighbour, if there is one, where they meet.
    """
    scales = sizes(walker, middle)
    rates = [abs(float(t)) for t in tangent]
    turning = max(rate / s for rate, s in zip(rates[:-1], scales[:-1], strict=True))
    radii = [
        (0.03 * rate + 0.005 * turning * s) * half
        for rate, s in zip(rates, scales, strict=True)
    ]
    for tube in neighbour:
        least = [2 * float(abs(k).upper()) for k in tube.image]
        radii = list(map(max, radii, least))

    piece = tube_image(walker, BY_SLOPE, (middle, tangent, arb(half)), radii, TOLERANCE)
    if not piece.is_proved():
        raise NotProvedError("Krawczyk's operator does not map the tube into itself.")
    if is_stable(piece.step_derivative()) is not True or piece.events().label != "long":
        raise NotProvedError("The gait is not shown to be a stable long step.")
    if not all(piece.holds(tube, tube.half) for tube in neighbour):
        raise NotProvedError(
            "Two neighbouring tubes do not hold the same gait where they meet."
        )

    return piece
