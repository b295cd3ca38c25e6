"""Energy that a step loses in its impacts, from the impacts themselves (section 6 of the paper).

A difference of energies would cancel: energies are of order angle^2, while a loss may be of order angle^4.
"""

from __future__ import annotations

import numpy as np

from gaitsweep.tasks.mechanics.contact import Chain
from gaitsweep.tasks.walkers.walker import Walker


def velocity_ratio(walker: Walker, angle: np.ndarray, rate_ratio: np.ndarray) -> np.ndarray:
    """Ratio x'/y' of the swing foot's velocities just before heelstrike.

    Parameters
    ----------
    walker : Walker
    angle : ndarray, shape (n,) [rad]
        Stance angle.
    rate_ratio : ndarray, shape (n,)
        Difference of the legs' rates over the stance rate's size, u.

    Returns
    -------
    ndarray, shape (n,)

    Notes
    -----
    Paper, equation 12 with the sign of its first line corrected. Over that size, x' = (R + l cos angle) u and
    y' = -l sin angle (2 - u).
    """
    with np.errstate(divide="ignore", invalid="ignore"):  # the legs may stand, or the foot move along the ground
        return (walker.R + walker.l * np.cos(angle)) * rate_ratio / (walker.l * np.sin(angle) * (rate_ratio - 2))


def contact_mass(walker: Walker, angle: np.ndarray) -> np.ndarray:
    """Compute the contact mass matrix at the new foothold, in units of the walker's mass.

    Parameters
    ----------
    walker : Walker
    angle : ndarray, shape (n,) [rad]
        Stance angle just after heelstrike; the other leg stands at the opposite angle, its knee free if it has one.

    Returns
    -------
    ndarray, shape (n, 2, 2)
        Along x (down the slope) and y (ground normal).

    Notes
    -----
    Paper, equation 9. The velocity of a body is that of the contact plus that due to the joint rates, so
    M = 1 - L Q^-1 L^T with Q the mass matrix of the walker pivoting on the contact and L = sum m dV/dq'. With a
    massless leg, M = n n^T along the line from the contact to the hip.
    """
    chain = Chain(walker)
    if chain.massless:
        normal = _to_hip(chain, angle)
        return normal[:, :, None] * normal[:, None, :]
    q = np.stack([angle, angle, -angle, -angle])
    lever = chain.levers(q)
    joints = np.array(chain.compliance(q, [lever.real, lever.imag], chain.kneed))
    return np.eye(2) - np.moveaxis(joints, -1, 0)


def _to_hip(chain: Chain, angle: np.ndarray) -> np.ndarray:
    """Unit vectors (n, 2) from the contact to the hip, the only direction in which a massless leg pushes."""
    x, y = -chain.l * np.sin(angle), chain.R + chain.l * np.cos(angle)
    return np.stack([x, y], axis=-1) / np.hypot(x, y)[..., None]


def heelstrike_losses(walker: Walker, angle: np.ndarray, rates: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Compute the energy lost at heelstrike, split on the two eigenvectors of the contact mass matrix.

    Parameters
    ----------
    walker : Walker
    angle : ndarray, shape (n,) [rad]
    rates : ndarray, shape (2, n) [sqrt(g/leg)]
        Rates of the old stance and swing leg just before heelstrike.

    Returns
    -------
    normal, tangential : ndarray, shape (n,)
        In units of weight times leg: 1/2 mu_i (e_i . v)^2, `normal` for the eigenvector nearer the ground normal.

    Notes
    -----
    Paper, section 6.1; v by equation 12 with the sign of its first line corrected and the stance angle -`angle`.
    """
    chain = Chain(walker)
    velocity = np.stack(
        [-(chain.R + chain.l * np.cos(angle)) * (rates[0] - rates[1]), chain.l * np.sin(angle) * (rates[0] + rates[1])],
        axis=-1,
    )
    if chain.massless:
        return 0.5 * (_to_hip(chain, angle) * velocity).sum(axis=-1) ** 2, np.zeros(len(angle))
    M = contact_mass(walker, angle)
    # The angle between eigenvectors and axes, without cancellation.
    turn = 0.5 * np.arctan2(2 * M[:, 0, 1], M[:, 0, 0] - M[:, 1, 1])
    first = np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    second = np.stack([-np.sin(turn), np.cos(turn)], axis=-1)
    losses = [0.5 * _mass_along(M, e) * (e * velocity).sum(axis=-1) ** 2 for e in (first, second)]
    is_upright = np.abs(first[:, 1]) > np.abs(second[:, 1])
    return np.where(is_upright, losses[0], losses[1]), np.where(is_upright, losses[1], losses[0])


def _mass_along(M: np.ndarray, e: np.ndarray) -> np.ndarray:
    """Contact mass (n,) along unit vectors (n, 2)."""
    x, y = e.T
    return x * (M[:, 0, 0] * x + M[:, 0, 1] * y) + y * (M[:, 1, 0] * x + M[:, 1, 1] * y)


def kneestrike_loss(walker: Walker, state: np.ndarray) -> np.ndarray:
    """Compute the energy lost at kneestrike.

    Parameters
    ----------
    walker : Walker
    state : ndarray, shape (6, n) [rad, sqrt(g/leg)]
        Angles and rates of stance leg, thigh and shank just before.

    Returns
    -------
    ndarray, shape (n,)
        In units of weight times leg.

    Notes
    -----
    1/2 (closing rate)^2 / (n M^-1 n^T) with n = (0, 1, -1) the direction of motion that the lock removes.
    """
    lock = np.broadcast_to(np.array([0.0, 0.0, 1.0, -1.0])[:, None], (4, state.shape[1]))
    ((compliance,),) = Chain(walker).compliance(state[[0, 0, 1, 2]], [lock], True)
    return 0.5 * (state[4] - state[5]) ** 2 / compliance
