"""Roots in brackets of functions whose every value costs a corrected gait, and the
cubic between points of a curve.

scipy's root finder would serve as well, but importing it takes longer than computing
most atlases.
"""

from __future__ import annotations

from collections.abc import Callable, Generator

import numpy as np
from numpy import ndarray

from gaitsweep.tasks.mechanics.sums import norm, total

_MAX_STEPS = 60
#: A curve has closed if between two points it passes its start within this share of
#: their distance.
_CLOSED_WITHIN = 1e-2


def bracketed_root(
    function: Callable[[float], float], a: float, b: float, tolerance: float = 0.0
) -> float:
    """Find the root between a and b, to `tolerance` or to rounding.

    Raises
    ------
    ValueError
        Where the function has the same sign at both ends.
    """
    search = root_search(a, b, tolerance)
    x = next(search)
    while True:
        try:
            x = search.send(function(x))
        except StopIteration as end:
            return float(end.value)


def root_search(
    a: float, b: float, tolerance: float = 0.0
) -> Generator[float, float, float]:
    """Find the root between a and b of a function whose values are sent for the
    arguments yielded.

    Raises
    ------
    ValueError
        Where the function has the same sign at both ends.

    Notes
    -----
    Inverse quadratic interpolation where three values allow it, bisection elsewhere (T. R. Chandrupatla, Advances in
    Engineering Software 28 (1997) 145-149).
    """
    at_a = yield a
    at_b = yield b
    if at_a == 0 or at_b == 0:
        return a if at_a == 0 else b
    if not at_a * at_b < 0:
        raise ValueError(f"no change of sign between {a!r} and {b!r}")

    share = 0.5
    for _ in range(_MAX_STEPS):
        x = a + share * (b - a)
        at_x = yield x
        if (at_x > 0) == (at_a > 0):
            c, at_c = a, at_a
        else:
            c, at_c = b, at_b
            b, at_b = a, at_a

        a, at_a = x, at_x

        best = a if abs(at_a) < abs(at_b) else b
        near = (2 * np.finfo(float).eps * abs(best) + 0.5 * tolerance) / abs(b - a)
        if near > 0.5 or at_a == 0:
            return best

        share = _next_share((a, at_a), (b, at_b), (c, at_c))
        share = min(1 - near, max(near, share))

    return best


def _next_share(
    last: tuple[float, float], opposite: tuple[float, float], past: tuple[float, float]
) -> float:
    """Where between the last argument and that of the opposite sign the root is sought
    next, by these and the last but one, with the values there.
    """
    a, at_a = last
    b, at_b = opposite
    c, at_c = past
    fraction = (a - b) / (c - b)
    value = (at_a - at_b) / (at_c - at_b)
    if value**2 < fraction and (1 - value) ** 2 < 1 - fraction:
        by_b = at_a / (at_b - at_a) * at_c / (at_b - at_c)
        by_c = (c - a) / (b - a) * at_a / (at_c - at_a) * at_b / (at_c - at_b)
        return by_b + by_c

    return 0.5


def nearest_to_zero(x: ndarray, off: ndarray) -> ndarray:
    """Return where parabolas through three neighbouring values of one sign are nearest
    to zero, if it is between them.

    Parameters
    ----------
    x, off : ndarray, shape (n,)
    """
    if len(x) < 3:
        return x[:0]

    rise = np.diff(off) / np.diff(x)
    bend = np.diff(rise) / (x[2:] - x[:-2])
    middle = 0.5 * (x[:-2] + x[1:-1])
    signs = np.sign(off)
    is_first_alike = signs[:-2] == signs[1:-1]
    is_last_alike = signs[1:-1] == signs[2:]
    opens = is_first_alike & is_last_alike
    opens &= bend * off[1:-1] > 0

    lowest = middle[opens] - 0.5 * rise[:-1][opens] / bend[opens]
    is_between = lowest > x[:-2][opens]
    is_between &= lowest < x[2:][opens]
    return np.asarray(lowest[is_between])


#: Points of curves and the unit tangents there, both (n,) or (n, k).
OnCurve = tuple[ndarray, ndarray]


def hermite(
    a: OnCurve, b: OnCurve, length: float | ndarray, h: float | ndarray
) -> ndarray:
    """Point at the fraction h of the cubic Hermite polynomial between two points of a
    curve.

    Parameters
    ----------
    a, b : OnCurve
    length : float or ndarray, shape (k,)
        Distance of the points.
    h : float or ndarray, shape (k,)

    Returns
    -------
    ndarray, shape (n,) or (n, k)
    """
    from_a = a[0] * (1 + 2 * h) * (1 - h) ** 2 + length * a[1] * h * (1 - h) ** 2
    return from_a + b[0] * h * h * (3 - 2 * h) + length * b[1] * h * h * (h - 1)


def passes(start: OnCurve, a: OnCurve, b: OnCurve) -> ndarray:
    """Whether curves pass their starts between two points, in their directions there.

    Parameters
    ----------
    start, a, b : OnCurve

    Returns
    -------
    ndarray of bool, shape () or (k,)
    """
    chord = b[0] - a[0]
    length = norm(chord)
    share = total((start[0] - a[0]) * chord) / length**2
    off = norm(hermite(a, b, length, share) - start[0])
    is_ahead = total(start[1] * chord) > 0.5 * length

    return np.asarray(
        (share > 0) & (share <= 1) & (off < _CLOSED_WITHIN * length) & is_ahead
    )
