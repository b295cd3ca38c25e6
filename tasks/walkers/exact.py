"""The offsets of tuned walkers to more digits than doubles have.

The steps of a walker that is tuned to rounding are solved as those of one that is tuned
exactly. Its offsets in doubles are another walker's, whose gaits at small slopes are
others.
"""

from __future__ import annotations

from decimal import Context, Decimal, localcontext

from gaitsweep.tasks.walkers.statics import is_tuned
from gaitsweep.tasks.walkers.walker import NUMBERS, Walker

#: Significant digits that are computed, and that are stated.
_COMPUTED, _STATED = 60, 40


def exact_offsets(walker: Walker) -> dict[str, str]:
    """Offsets with which a walker that is tuned to rounding is tuned exactly, its other
    keys being those doubles.

    Parameters
    ----------
    walker : Walker

    Returns
    -------
    dict of str
        By their keys the decimal numbers, of 40 digits, that are no doubles: of `w_s`
        with knees and `w_t`, or of `w_s` alone if the thigh has no mass. Empty for a
        walker that is not tuned.

    Notes
    -----
    Paper, section 5.1: the centre of mass of the shank, with knees, and that of the leg lie on their lines.
    """
    if not is_tuned(walker):
        return {}
    with localcontext(Context(prec=_COMPUTED)):
        key = {name: Decimal(getattr(walker, name)) for name in NUMBERS}
        exact = _tuned(walker, key)
        return {
            name: _stated(value) for name, value in exact.items() if value != key[name]
        }


def _tuned(walker: Walker, key: dict[str, Decimal]) -> dict[str, Decimal]:
    """The offsets by their keys, of a walker with such numbers."""
    sine_T, cosine_T = _sine_and_cosine(key["eps_T"])
    length = key["l_s"] - key["R"]
    sine_S = Decimal(0)
    if length:
        sine_S = key["l_t"] * sine_T / length
    cosine_S = (1 - sine_S * sine_S).sqrt()

    # How far the knee and the shank's own centre are across the leg's line.
    knee = key["l_t"] * sine_T
    centre = key["c_s"] * sine_S
    exact: dict[str, Decimal] = {}
    if walker.knees:
        exact["w_s"] = centre / cosine_S
    elif not walker.m_t and walker.m_s:
        exact["w_s"] = (centre - knee) / cosine_S

    if walker.m_t:
        w_s = exact.get("w_s", key["w_s"])
        shank = knee + w_s * cosine_S - centre
        shank_over_thigh = key["m_s"] / key["m_t"]
        moment = shank_over_thigh * shank + key["c_t"] * sine_T
        exact["w_t"] = -moment / cosine_T

    return exact


def _stated(value: Decimal) -> str:
    return str(Context(prec=_STATED).plus(value))


def _sine_and_cosine(angle: Decimal) -> tuple[Decimal, Decimal]:
    """Sine and cosine of an angle below a quarter of a turn, by their power series."""
    sums, term = [Decimal(0), Decimal(0)], Decimal(1)
    k = 0
    while k < 2 or abs(term) > Decimal(10) ** -_COMPUTED * abs(angle):
        sums[k % 2] += term if k % 4 < 2 else -term
        k += 1
        term = term * abs(angle) / k

    cosine, sine = sums
    return sine.copy_sign(angle), cosine
