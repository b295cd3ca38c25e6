"""Intervals of slopes covered by tubes of stable gaits."""

from __future__ import annotations

from collections.abc import Sequence

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
        middle, tangent, curvature = (
            first.middle,
            tangent_of(first),
            [arb(0)] * len(first.middle),
        )
        at, half = (low - OVERLAP * FIRST_HALF).mid(), FIRST_HALF
        while not at > high:
            half = min(half, (1 + OVERLAP) * float((high - at) / 2))
            centre = (at + half).mid()
            shift = centre - middle[-1]
            guessed = [
                (c + t * shift + b * shift**2 / 2).mid()
                for c, t, b in zip(middle, tangent, curvature, strict=True)
            ]
            leaning = [
                (t + b * shift).mid() for t, b in zip(tangent, curvature, strict=True)
            ]
            leaning[-1] = arb(1)
            try:
                piece = _stable_piece(
                    first.body, [*guessed[:-1], centre], leaning, half, cover[-1:]
                )
                if cover and not piece.holds(cover[-1], cover[-1].half):
                    raise NotProvedError(
                        "Two neighbouring tubes do not hold the same gait where they meet."
                    )
            except (NotProvedError, ZeroDivisionError):
                half /= 1.6
                if half < MIN_HALF:
                    raise
                continue
            cover.append(piece)
            own = tangent_of(piece)
            curvature = [
                ((new - old) / shift).mid()
                for new, old in zip(own, tangent, strict=True)
            ]
            middle, tangent = (
                [(c + k).mid() for c, k in zip(piece.middle, piece.image, strict=True)],
                own,
            )
            at = (centre + (1 - OVERLAP) * half).mid()
            half *= 1.1
    return cover


def _stable_piece(
    walker: Body,
    middle: list[arb],
    tangent: list[arb],
    half: float,
    neighbour: list[Tube],
) -> Tube:
    scales = sizes(walker, middle)
    turning = max(
        abs(float(t)) / s for t, s in zip(tangent[:-1], scales[:-1], strict=True)
    )
    radii = [
        (0.03 * abs(float(t)) + 0.005 * turning * s) * half
        for t, s in zip(tangent, scales, strict=True)
    ]
    for one in neighbour:  # whose gait is to lie in this tube where they meet
        radii = [
            max(r, 2 * float(abs(k).upper()))
            for r, k in zip(radii, one.image, strict=True)
        ]
    piece = tube_image(walker, BY_SLOPE, (middle, tangent, arb(half)), radii, TOLERANCE)
    if not piece.is_proved():
        raise NotProvedError("Krawczyk's operator does not map the tube into itself.")
    if is_stable(piece.step_derivative()) is not True or piece.events().label != "long":
        raise NotProvedError("The gait is not shown to be a stable long step.")
    return piece
