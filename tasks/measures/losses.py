"""Energy that a step loses in its impacts, from the impacts themselves (section 6 of
the paper).

A difference of energies would cancel: energies are of order angle^2, while a loss may
be of order angle^4.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from gaitsweep.tasks.measures.drive import PushOff
from gaitsweep.tasks.mechanics.apparent_mass import (
    ApparentMass,
    dot,
    of_free_link,
    of_hinged_link,
)
from gaitsweep.tasks.mechanics.contact import Chain
from gaitsweep.tasks.walkers.walker import Walker


def velocity_ratio(
    walker: Walker,
    angle: np.ndarray,
    rate_ratio: np.ndarray,
) -> np.ndarray:
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
    # The legs may stand, or the foot move along the ground.
    with np.errstate(divide="ignore", invalid="ignore"):
        along = (walker.R + walker.l * np.cos(angle)) * rate_ratio
        upward = walker.l * np.sin(angle) * (rate_ratio - 2)
        return along / upward


def contact_mass(walker: Walker, angle: np.ndarray) -> np.ndarray:
    """Compute the contact mass matrix at the new foothold, in units of the walker's
    mass.

    Parameters
    ----------
    walker : Walker
    angle : ndarray, shape (n,) [rad]
        Stance angle just after heelstrike; the other leg stands at the opposite angle,
        its knee free if it has one that is not locked meanwhile.

    Returns
    -------
    ndarray, shape (n, 2, 2)
        Along x (down the slope) and y (ground normal).

    Notes
    -----
    Paper, equation 9. With a massless leg, M = n n^T along the line from the contact to the hip.
    """
    if Chain(walker).massless:
        normal = _to_hip(Chain(walker), angle)
        return normal[:, :, None] * normal[:, None, :]
    return _contact_mass(walker, angle).matrix


class _Link(NamedTuple):
    """A rigid link: its mass, its centre from the joint above, along the extended leg,
    and its moment of inertia about that; over the walker's mass and leg.
    """

    mass: float | np.ndarray
    centre: complex | np.ndarray
    inertia: float | np.ndarray


def _links(walker: Walker) -> tuple[_Link, _Link, _Link]:
    """Thigh, shank, and both as one link, as they are with the knee locked."""
    leg, mass = walker.leg, walker.total_mass
    knee = walker.knee / leg
    thigh = walker.thigh_centre / leg
    shank = walker.shank_centre / leg
    m_t = walker.m_t / mass
    m_s = walker.m_s / mass
    I_t = m_t * (walker.r_t / leg) ** 2
    I_s = m_s * (walker.r_s / leg) ** 2

    m_leg = m_t + m_s
    centre = (m_t * thigh + m_s * (knee + shank)) / m_leg
    I_leg = I_t + I_s + m_t * m_s / m_leg * np.abs(knee + shank - thigh) ** 2
    return _Link(m_t, thigh, I_t), _Link(m_s, shank, I_s), _Link(m_leg, centre, I_leg)


# Of invalid walkers, which an array may hold, it is NaN.
@np.errstate(divide="ignore", invalid="ignore")
def _contact_mass(walker: Walker, angle: np.ndarray) -> ApparentMass:
    """Contact mass of a walker whose legs have mass, over the walker's."""
    thigh, shank, leg = _links(walker)
    new = np.exp(1j * angle)
    old = np.exp(-1j * angle)
    if walker.frees_trailing_knee:
        knee = walker.knee / walker.leg
        at_knee = of_free_link(shank.mass, shank.centre * old, shank.inertia)
        centre = (thigh.centre - knee) * old
        at_hip = of_hinged_link(at_knee, -knee * old, thigh.mass, centre, thigh.inertia)
    else:
        at_hip = of_free_link(leg.mass, leg.centre * old, leg.inertia)

    with_hip = at_hip.with_point(walker.m_h / walker.total_mass)
    contact = -1j * (walker.l / walker.leg * new + walker.R / walker.leg)
    return of_hinged_link(with_hip, contact, leg.mass, leg.centre * new, leg.inertia)


def _to_hip(chain: Chain, angle: np.ndarray) -> np.ndarray:
    """Unit vectors (n, 2) from the contact to the hip, the only direction in which a
    massless leg pushes.
    """
    x = -chain.l * np.sin(angle)
    y = chain.R + chain.l * np.cos(angle)
    return np.stack([x, y], axis=-1) / np.hypot(x, y)[..., None]


def heelstrike_losses(
    walker: Walker,
    angle: np.ndarray,
    rates: np.ndarray,
    push: PushOff | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Compute the energy lost at heelstrike, split on the two eigenvectors of the
    contact mass matrix.

    Parameters
    ----------
    walker : Walker
    angle : ndarray, shape (n,) [rad]
    rates : ndarray, shape (2, n) [sqrt(g/leg)]
        Rates of the old stance and swing leg just before heelstrike.
    push : PushOff, optional
        The push-off between, if there is one.

    Returns
    -------
    normal, tangential : ndarray, shape (n,)
        In units of weight times leg: 1/2 mu_i (e_i . v)^2, `normal` for the eigenvector
        nearer the ground normal.

    Notes
    -----
    Paper, section 6.1; v by equation 12 with the sign of its first line corrected and the stance angle -`angle`.
    """
    chain = Chain(walker)
    velocity = np.stack(
        [
            -(chain.R + chain.l * np.cos(angle)) * (rates[0] - rates[1]),
            chain.l * np.sin(angle) * (rates[0] + rates[1]),
        ],
        axis=-1,
    )
    if push is not None:
        velocity[..., 0] += push.translation.real
        velocity[..., 1] += push.translation.imag

    if chain.massless:
        return 0.5 * (_to_hip(chain, angle) * velocity).sum(axis=-1) ** 2, np.zeros(
            len(angle)
        )

    M = _contact_mass(walker, angle)
    velocity = velocity[:, 0] + 1j * velocity[:, 1]
    normal, tangential = (
        0.5 * M.along(e) * dot(e, velocity) ** 2 for e in (1j * M.axis, M.axis)
    )
    return normal, tangential


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
    lock = np.broadcast_to(
        np.array([0.0, 0.0, 1.0, -1.0])[:, None], (4, state.shape[1])
    )
    ((compliance,),) = Chain(walker).compliance(state[[0, 0, 1, 2]], [lock], True)
    return 0.5 * (state[4] - state[5]) ** 2 / compliance
