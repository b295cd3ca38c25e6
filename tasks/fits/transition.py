"""The rho^(3/2) transition of short steps with light feet (sections 4.1 and 6.3 of the
paper).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from gaitsweep.tasks.fits.power_law import fit

#: Above the transition all walkers with light feet follow walker D: angle = B
#: slope^(1/3) as slope -> 0 (M. Garcia et al., J. Biomech. Eng. 120, 1998).
CUBE_ROOT = math.tanh(math.pi / 2) ** (2 / 3)
#: Largest deviation from 1 of the exponent over the slopes that the linear law is
#: fitted to.
_LINEAR = 0.05


def asymptotic(ratio: ndarray) -> ndarray:
    """Slope at which the two laws cross, to leading order in the foot mass ratio:
    ratio^(3/2) coth^2(pi/2)/8.

    Parameters
    ----------
    ratio : ndarray, shape (n,)

    Returns
    -------
    ndarray, shape (n,) [rad]
    """
    tanh = math.tanh(math.pi / 2)
    return ratio**1.5 / (8 * tanh**2)


def linear_amplitude(slope: ndarray, angle: ndarray) -> tuple[float, float, float, int]:
    """Fit the limit of angle/slope as slope -> 0.

    Parameters
    ----------
    slope, angle : ndarray, shape (n,) [rad]
        Slope increasing.

    Returns
    -------
    amplitude, error, largest, n : float, float, float [rad], int
        The limit, its relative standard error, the largest slope and the number of
        points of the fit; NaN below four, and where the angle does not grow with the
        slope there, so that the slopes begin above the linear law.

    Notes
    -----
    The fit is ln(angle/slope) = A + B slope^2 over the slopes where angle/slope changes by less than 2 %: the energy
    balance slope angle ~ ratio angle^2 + angle^4 has no term between.
    """
    y = np.log(angle / slope)
    is_far = ~(np.abs(y - y[0]) < 0.02)
    n = len(y)
    if is_far.any():
        n = int(np.argmax(is_far))

    slope = slope[:n]
    y = y[:n]
    if n < 4 or not _is_linear(slope, y):
        return math.nan, math.nan, math.nan, n

    largest = slope[-1]
    squares = (slope / largest) ** 2
    design = np.stack([np.ones(n), squares], axis=1)
    solution, residual, _, _ = np.linalg.lstsq(design, y, rcond=None)
    scatter = 0.0
    if len(residual):
        scatter = math.sqrt(residual[0] / (n - 2))
    covariance = np.linalg.inv(design.T @ design)
    error = scatter * math.sqrt(covariance[0, 0])
    amplitude = float(np.exp(solution[0]))
    return amplitude, error, float(largest), n


def _is_linear(slope: ndarray, y: ndarray) -> bool:
    """Whether ln(angle/slope) is all but constant: many slopes may lie within 2 % of any
    law.
    """
    change = abs(y[-1] - y[0])
    return not change > _LINEAR * math.log(slope[-1] / slope[0])


def crossing(linear: float, cube_root: float) -> float:
    """Slope at which linear * slope = cube_root * slope^(1/3) [rad]."""
    return (cube_root / linear) ** 1.5


@dataclass(frozen=True)
class FittedLines:
    """Two lines fitted to a short step on logarithmic axes, and their crossing.

    Attributes
    ----------
    slope : float [rad]
        Where they cross.
    below, above : float [rad]
        The lower line is fitted to slopes below the one, the upper one, of power 1/3,
        above the other.
    exponent, amplitude : float
        The lower law, angle = amplitude slope^exponent.
    cube_root : float
        The upper law, angle = cube_root slope^(1/3).
    """

    slope: float
    below: float
    above: float
    exponent: float = math.nan
    amplitude: float = math.nan
    cube_root: float = math.nan


def fitted_lines(
    slope: ndarray,
    angle: ndarray,
    expected: float,
) -> FittedLines:
    """Fit the two straight lines of figure 5 of the paper and let them cross.

    Parameters
    ----------
    slope, angle : ndarray, shape (n,) [rad]
    expected : float [rad]
        Crossing of the exact asymptotes.

    Returns
    -------
    FittedLines
        The lower line is fitted over slopes below expected/10, the upper, held at power
        1/3, above 3 expected; its numbers are NaN where either has fewer than three
        points.
    """
    low = expected / 10
    high = expected * 3
    is_below = slope < low
    is_above = slope > high
    lower = fit(slope[is_below], angle[is_below])
    if lower is None or is_above.sum() < 3:
        return FittedLines(math.nan, low, high)

    over_cube_root = np.log(angle[is_above]) - np.log(slope[is_above]) / 3
    upper = float(np.exp(np.mean(over_cube_root)))
    power = 1 / (lower.exponent - 1 / 3)
    return FittedLines(
        slope=(upper / lower.amplitude) ** power,
        below=low,
        above=high,
        exponent=lower.exponent,
        amplitude=lower.amplitude,
        cube_root=upper,
    )
