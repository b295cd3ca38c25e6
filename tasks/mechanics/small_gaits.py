"""Gaits of straight legs to first order in the angles and the slope.

That a step repeats itself takes four equations, that both legs exchange places and keep
their rates. They are linear in the angle, two rates, 1 and the slope, with coefficients
that depend on the period: periods of gaits are those at which the determinant vanishes.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gaitsweep.tasks.mechanics.small_angles import SmallAngles

#: Periods looked at, over the time in which the leg swings by itself.
_PERIODS = np.linspace(0.1, 2.2, 85)


def small_gaits(linear: SmallAngles, slopes: Sequence[float]) -> list[np.ndarray]:
    """Find gaits of straight legs to first order.

    Parameters
    ----------
    linear : SmallAngles
    slopes : sequence of float [rad]

    Returns
    -------
    list of ndarray, shape (4, k)
        For each slope, angles [rad], rates of the stance and of the swing leg over them
        [1/sqrt(leg/g)], and periods [sqrt(leg/g)]. Legs whose masses lie on a line have
        the same gaits on all slopes, with angles in proportion: they are those of the
        smallest alone. Angles out of all proportion, of either sign, are those of steps
        that lose nothing to first order: these may have any.
    """
    periods = _PERIODS * linear.swing
    off_rest, off_slope = _determinants(linear, periods)

    is_aligned = not linear.locked.c[:, 0].any()
    smallest = min(slopes)
    found = []

    for slope in slopes:
        if is_aligned and slope != smallest:
            found.append(np.zeros((4, 0)))
            continue

        off = off_rest + slope * off_slope
        period = np.concatenate(
            [_crossings(periods, off), _pairs(periods, off)],
        )
        found.append(_gaits(linear, period, slope))

    return found


def _determinants(
    linear: SmallAngles,
    periods: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Determinants of the equations with what is by 1, and with what is by the slope."""
    by_unknown, rest = _repetition(linear, periods)
    with_rest = np.dstack([by_unknown, rest[:, :, :1]])
    with_slope = np.dstack([by_unknown, rest[:, :, 1:]])
    return np.linalg.det(with_rest), np.linalg.det(with_slope)


def _crossings(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Roots of a function known at x where it changes its sign, by linear
    interpolation.
    """
    at = np.flatnonzero(y[:-1] * y[1:] < 0)
    before = y[at]
    after = y[at + 1]
    share = before / (before - after)

    return x[at] + share * np.diff(x)[at]


def _pairs(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Pairs of roots of a function known at equal distances x where it does not change
    its sign, by a parabola through its values about a least one.
    """
    height = np.abs(y)
    sign = np.sign(y)
    left = height[:-2]
    least = height[1:-1]
    right = height[2:]
    is_least = least <= np.minimum(left, right)
    keeps_sign = np.abs(sign[:-2] + sign[1:-1] + sign[2:]) == 3

    slant = (right - left) / 2
    bend = right + left - 2 * least
    square = slant**2 - 2 * bend * least
    at = np.flatnonzero(is_least & keeps_sign & (square > 0))

    step = (x[1] - x[0]) / bend[at]
    root = np.sqrt(square[at])
    lower = x[at + 1] - (slant[at] + root) * step
    upper = x[at + 1] - (slant[at] - root) * step

    return np.concatenate([lower, upper])


def _gaits(linear: SmallAngles, period: np.ndarray, slope: float) -> np.ndarray:
    """Those of some periods, as `small_gaits` returns them."""
    by_unknown, rest = _repetition(linear, period)
    lack = -rest @ [[1.0], [slope]]
    solved = np.linalg.pinv(by_unknown) @ lack

    gaits = np.vstack([solved[:, :, 0].T, period])
    gaits[1:3] /= gaits[0]

    return gaits


def _repetition(
    linear: SmallAngles,
    periods: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """By how much steps fail to repeat themselves: by the angle and both rates, shape
    (k, 4, 3), and by (1, slope), shape (k, 4, 2).
    """
    end = linear.locked.after(periods)
    end[:, 2:] = linear.heelstrike @ end[:, 2:]
    # At the start the swing leg's angle is that of the stance leg, reversed.
    end[:, :, 1] = end[:, :, 0] - end[:, :, 1]
    by_unknown = end[:, :, 1:4]
    # At the end the new stance angle, which the push-off acts by, is that of the start.
    by_unknown[:, 2:, 0] += linear.push_off[:, 0]

    # At the end the legs have exchanged their places, and each has the other's rate.
    repeated = np.array(
        [
            [-1.0, 0.0, 0.0],
            [1.0, 0.0, 0.0],
            [0.0, 1.0, 0.0],
            [0.0, 0.0, 1.0],
        ]
    )

    return by_unknown - repeated, end[:, :, 4:]
