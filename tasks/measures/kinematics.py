"""Step length, speed, cost of transport and power of a gait."""

from __future__ import annotations

import numpy as np

from gaitsweep.tasks.walkers.walker import Walker


def step_length(
    walker: Walker, angle: np.ndarray, end: np.ndarray | None = None
) -> np.ndarray:
    """Distance along the slope between footprints: of a step that repeats, 2 (l sin
    angle + R angle).

    Parameters
    ----------
    walker : Walker
    angle : ndarray [rad]
        Stance angle at the start of the step.
    end : ndarray, optional [rad]
        Stance angle just after the heelstrike that ends it; by default the same.

    Returns
    -------
    ndarray [the walker's unit of length]
    """
    angles = (angle, angle) if end is None else (angle, end)
    halves = [walker.l * np.sin(each) + walker.R * each for each in angles]
    return np.asarray(halves[0] + halves[1])


#: What `travel` computes.
TRAVEL = ("step_frequency", "speed", "froude_speed", "cost_of_transport", "power")


def travel(
    walker: Walker,
    slope: np.ndarray,
    length: np.ndarray,
    period: np.ndarray,
    steps: int = 1,
) -> dict[str, np.ndarray]:
    """Compute step frequency, mean speed, Froude speed, cost of transport and power
    over a gait's steps.

    Parameters
    ----------
    walker : Walker
    slope, length, period : ndarray, shape (n,) [rad, the walker's units of length and time]
        The mean length of the steps, and the period of all of them.
    steps : int

    Returns
    -------
    dict of ndarray, shape (n,)
        `step_frequency`, `speed`, `froude_speed` (over sqrt(g leg)),
        `cost_of_transport` and `power`, in the walker's units.

    Notes
    -----
    Paper, section 2.3.
    """
    speed = steps * length / period
    cost = np.broadcast_to(np.sin(slope), speed.shape)
    weight = walker.total_mass * walker.g
    froude_speed = speed / np.sqrt(walker.g * walker.leg)
    where_walking = np.where(np.isfinite(speed), cost, np.nan)
    values = steps / period, speed, froude_speed, where_walking, weight * speed * cost
    return dict(zip(TRAVEL, values, strict=True))
