"""Step length, speed, cost of transport and power of a gait."""

from __future__ import annotations

import numpy as np

from tasks.walkers.walker import Walker


def step_length(walker: Walker, angle: np.ndarray) -> np.ndarray:
    """Distance along the slope between footprints, 2 (l sin angle + R angle).

    Parameters
    ----------
    walker : Walker
    angle : ndarray [rad]
        Stance angle at the start of the step.

    Returns
    -------
    ndarray [the walker's unit of length]
    """
    return 2 * (walker.l * np.sin(angle) + walker.R * angle)


def travel(walker: Walker, slope: np.ndarray, angle: np.ndarray, period: np.ndarray) -> dict[str, np.ndarray]:
    """Compute mean speed, Froude speed, cost of transport and power over a step.

    Parameters
    ----------
    walker : Walker
    slope, angle, period : ndarray, shape (n,) [rad, rad, the walker's unit of time]

    Returns
    -------
    dict of ndarray, shape (n,)
        `speed`, `froude_speed` (over sqrt(g leg)), `cost_of_transport` and `power`, in the walker's units.

    Notes
    -----
    Paper, section 2.3.
    """
    speed = step_length(walker, angle) / period
    cost = np.broadcast_to(np.sin(slope), speed.shape)
    weight = walker.total_mass * walker.g
    return {
        "speed": speed,
        "froude_speed": speed / np.sqrt(walker.g * walker.leg),
        "cost_of_transport": np.where(np.isfinite(speed), cost, np.nan),
        "power": weight * speed * cost,
    }
