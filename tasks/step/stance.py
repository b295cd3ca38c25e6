"""Where the feet of a walker stand, from the angles of its legs.

A state just after heelstrike has both feet on the ground: its legs' angles add up to
zero. From any other state either the swing foot is above the ground, or both feet stand
on ground of another slope.
"""

from __future__ import annotations

import numpy as np

from gaitsweep.tasks.walkers.walker import Walker

#: Sum of the legs' angles that counts as zero [rad].
ON_GROUND = 1e-9


def tilt(stance: np.ndarray, thigh: np.ndarray) -> np.ndarray:
    """Return by how much gentler the slope is on which both feet stand, (n,) [rad].

    Both feet are as far from the hip, so the line through them is at right angles to
    the bisector of the legs: the slope is less by half the sum of the angles.
    """
    return np.asarray(0.5 * (stance + thigh))


def half_between(stance: np.ndarray, thigh: np.ndarray) -> np.ndarray:
    """Return the stance angle from the normal of the ground on which both feet stand."""
    return np.asarray(0.5 * (stance - thigh))


def height(length: float, stance: np.ndarray, thigh: np.ndarray) -> np.ndarray:
    """Return the height of the swing foot's centre above the stance foot's.

    Parameters
    ----------
    length : float
        From the hip to the centre of a foot.
    stance, thigh : ndarray, shape (n,) [rad]
        Of legs whose knees are locked.
    """
    mean, half = tilt(stance, thigh), half_between(stance, thigh)
    return np.asarray(-2.0 * length * np.sin(mean) * np.sin(half))


def between_feet(
    walker: Walker, stance: np.ndarray, thigh: np.ndarray, shank: np.ndarray
) -> np.ndarray:
    """Return the way from the stance foot's centre to the swing foot's, x + iy over the
    leg, y along the ground's normal; with the knee bent if thigh and shank differ.

    From the hip the knee, then the foot's centre follow; at full extension the two links
    make the line from hip to foot, from which both angles are measured.
    """
    line = -1j * walker.l
    foot = walker.knee * np.exp(1j * thigh) + (line - walker.knee) * np.exp(1j * shank)
    return np.asarray((foot - line * np.exp(1j * stance)) / walker.leg)


def ground_under(way: np.ndarray) -> np.ndarray:
    """Return by how much gentler the slope is on which both feet stand, [rad], from the
    way between them: of locked knees it is `tilt`.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.arctan(way.imag / way.real))
