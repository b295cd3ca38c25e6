"""Energy a step loses in its impacts, from the impacts themselves (section 6 of the paper).

Never a difference of energies: those are of order angle^2 while a loss may be of order angle^4.
"""

from __future__ import annotations

import numpy as np

from tasks.mechanics.contact import Chain
from tasks.walkers.walker import Walker


def contact_mass(walker: Walker, angle: np.ndarray) -> np.ndarray:
    """Contact mass matrix at the new foothold, in units of the walker's mass (paper, eq. 9).

    Parameters
    ----------
    walker : Walker
    angle : ndarray, shape (n,) [rad]
        Stance angle just after heelstrike; the other leg stands at minus it, its knee free if it has one.

    Returns
    -------
    ndarray, shape (n, 2, 2)
        On (x down the slope, y along the ground normal).

    Notes
    -----
    Bodies move as the contact does plus what the joint rates add, so M = 1 - L Q^-1 L^T with Q the mass matrix of
    the walker pivoting on the contact and L = sum m dV/dq'. With a massless leg, M = n n^T along the leg.
    """
    chain = Chain(walker)
    if chain.massless:
        normal = np.stack([-np.sin(angle), np.cos(angle)], axis=-1)
        return normal[:, :, None] * normal[:, None, :]
    q = np.stack([angle, angle, -angle, -angle])
    lever = chain.levers(q)
    taken = np.array(chain.compliance(q, [lever.real, lever.imag], chain.kneed))
    return np.eye(2) - np.moveaxis(taken, -1, 0)


def heelstrike_losses(walker: Walker, angle: np.ndarray, rates: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Energy lost at heelstrike on the two eigenvectors of the contact mass matrix.

    Parameters
    ----------
    angle : ndarray, shape (n,) [rad]
    rates : ndarray, shape (2, n) [sqrt(g/leg)]
        Rates of the old stance and swing leg just before heelstrike.

    Returns
    -------
    normal, tangential : ndarray, shape (n,)
        In units of weight times leg; 1/2 mu_i (e_i . v)^2, normal the one nearer the ground normal.

    Notes
    -----
    v from equation 12 with the sign of its first line mended; there the stance angle is minus `angle`.
    """
    chain = Chain(walker)
    velocity = np.stack(
        [-(chain.R + chain.l * np.cos(angle)) * (rates[0] - rates[1]), chain.l * np.sin(angle) * (rates[0] + rates[1])],
        axis=-1,
    )
    if chain.massless:
        along = np.stack([-np.sin(angle), np.cos(angle)], axis=-1)
        return 0.5 * (along * velocity).sum(axis=-1) ** 2, np.zeros(len(angle))
    M = contact_mass(walker, angle)
    # The angle of the eigenvectors from the axes, without cancellation.
    turn = 0.5 * np.arctan2(2 * M[:, 0, 1], M[:, 0, 0] - M[:, 1, 1])
    first = np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    time_unit = np.stack([-np.sin(turn), np.cos(turn)], axis=-1)
    losses = []
    for e in (first, time_unit):
        mu = (e[:, None, :] @ M @ e[:, :, None])[:, 0, 0]
        losses.append(0.5 * mu * (e * velocity).sum(axis=-1) ** 2)
    upright = np.abs(first[:, 1]) > np.abs(time_unit[:, 1])
    return np.where(upright, losses[0], losses[1]), np.where(upright, losses[1], losses[0])


def kneestrike_loss(walker: Walker, state: np.ndarray) -> np.ndarray:
    """Energy lost at kneestrike, in units of weight times leg.

    Parameters
    ----------
    state : ndarray, shape (6, n)
        Angles and rates of stance leg, thigh and shank just before [rad, sqrt(g/leg)].

    Notes
    -----
    1/2 (closing rate)^2 / (n M^-1 n^T) with n = (0, 1, -1) the direction the lock takes away.
    """
    lock = np.broadcast_to(np.array([0.0, 0.0, 1.0, -1.0])[:, None], (4, state.shape[1]))
    ((yielding,),) = Chain(walker).compliance(state[[0, 0, 1, 2]], [lock], True)
    return 0.5 * (state[4] - state[5]) ** 2 / yielding
