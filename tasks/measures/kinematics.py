"""What a walker's gait amounts to on the road: step length, speed, power."""

from __future__ import annotations

import numpy as np

from tasks.walkers.walker import Walker


def step_length(walker: Walker, angle: np.ndarray) -> np.ndarray:
    """Distance along the slope between footprints, 2 (l sin angle + R angle)."""
    return 2 * (walker.l * np.sin(angle) + walker.R * angle)


def travel(walker: Walker, slope: np.ndarray, angle: np.ndarray, period: np.ndarray) -> dict[str, np.ndarray]:
    """Mean speed, its Froude form, cost of transport and power over a step (paper, section 2.3).

    Parameters
    ----------
    slope, angle, period : ndarray
        In the walker's units, broadcast together.
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
