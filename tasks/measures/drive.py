"""What drives a walker beside gravity: the work of its push-off, and of what acts between
its thighs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from gaitsweep.tasks.mechanics.contact import Chain, solve
from gaitsweep.tasks.mechanics.sums import total
from gaitsweep.tasks.walkers.walker import Walker


@dataclass(frozen=True)
class PushOff:
    """What the push-off of a trailing leg does, just before the other foot strikes.

    Attributes
    ----------
    work : ndarray, shape (n,) [weight leg]
    direction : ndarray of complex, shape (n,)
        Unit vector from the trailing contact to the hip.
    translation : ndarray of complex, shape (n,) [sqrt(g leg)]
        Velocity that it gives the point of the leading foot that is to strike.
    rates : ndarray, shape (4, n) [sqrt(g/leg)]
        Rates that it gives the links: leading shank and thigh, trailing thigh and
        shank.
    """

    work: ndarray
    direction: ndarray
    translation: ndarray
    rates: ndarray

    def some(self, lanes: slice | ndarray) -> PushOff:
        """Return those of some lanes."""
        return PushOff(
            self.work[lanes],
            self.direction[lanes],
            self.translation[lanes],
            self.rates[:, lanes],
        )


def push_off(walker: Walker, angle: ndarray, impulse: ndarray) -> PushOff:
    """Compute what the push-off does to a walker with both feet on the ground.

    Parameters
    ----------
    walker : Walker
    angle : ndarray, shape (n,) [rad]
        Stance angle just after the heelstrike that follows.
    impulse : ndarray, shape (n,) [mass sqrt(g leg)]

    Returns
    -------
    PushOff

    Notes
    -----
    For the time of the impulse P no foot is held. With M the mass matrix of the walker
    that is free to move, J the velocity of the trailing contact at unit rates and u its
    direction, rates change by P M^-1 J^T u, and the work of a foot that was at rest is
    P^2/2 u J M^-1 J^T u.
    """
    chain = Chain(walker)
    q = np.stack([angle, angle, -angle, -angle])
    to_contact = np.exp(-1j * angle) * -1j * chain.l - 1j * chain.R
    direction = -to_contact / np.abs(to_contact)

    if chain.massless:
        # The hip has all the mass.
        return PushOff(
            0.5 * impulse**2,
            direction,
            impulse * direction,
            0.0 * q,
        )

    groups = _groups(chain)
    along = _along(chain, q, to_contact, direction)
    pushed = [direction.real, direction.imag, *along]
    moved = solve(_free_mass(chain, q), [impulse * each for each in pushed])

    x, y, *rates = moved
    work = 0.5 * impulse * total(a * b for a, b in zip(pushed, moved, strict=True))
    of_links = [rate for rate, g in zip(rates, groups, strict=True) for _ in g]

    return PushOff(work, direction, x + 1j * y, np.stack(of_links))


def _groups(chain: Chain) -> list[list[int]]:
    """Links that move as one during the push: the trailing knee follows its rule."""
    return chain.groups(chain.frees_trailing_knee)


def _along(
    chain: Chain, q: ndarray, to_contact: ndarray, direction: ndarray
) -> list[ndarray]:
    """Velocities of the trailing contact along a direction at a unit rate of each group
    of links.
    """
    contact = _contact(chain, q, to_contact)
    along = [(direction.conj() * velocity).real for velocity in contact]

    return [total(along[i] for i in g) for g in _groups(chain)]


def _contact(chain: Chain, q: ndarray, to_contact: ndarray) -> list[ndarray]:
    """Velocities, complex, of the trailing contact at a unit rate of each link, the
    leading foot rolling.
    """
    shank, thigh, knee, _ = chain.to_foot
    turned = np.exp(1j * q)
    to_knee = knee * turned[2]

    return [
        1j * shank * turned[0] - chain.R,
        1j * thigh * turned[1],
        1j * to_knee,
        1j * (to_contact - to_knee),
    ]


def _free_mass(chain: Chain, q: ndarray) -> list[list[ndarray]]:
    """Mass matrix of the walker with no foot held: by the velocity of the leading
    contact along x and y, then by the rates of links that move as one.
    """
    groups = _groups(chain)
    by_link = chain.levers(q)
    levers = [total(by_link[i] for i in g) for g in groups]
    one, zero = np.ones_like(q[0]), np.zeros_like(q[0])
    M = chain.matrix(q)
    rows = [
        [one, zero, *(lever.real for lever in levers)],
        [zero, one, *(lever.imag for lever in levers)],
    ]

    for g, lever in zip(groups, levers, strict=True):
        row = [lever.real, lever.imag]
        row += [total(M[i][j] for i in g for j in h) for h in groups]
        rows.append(row)

    return rows


def hip_torque_work(walker: Walker, begin: ndarray, end: ndarray) -> ndarray:
    """Compute the work of the constant torque between the thighs over a step.

    Parameters
    ----------
    walker : Walker
    begin, end : ndarray, shape (n,) [rad]
        Stance angles just after the heelstrikes with which the step begins and ends.

    Returns
    -------
    ndarray, shape (n,) [weight leg]

    Notes
    -----
    The legs pass from -2 `begin` to 2 `end`. A spring that rests at an angle is one that
    rests with the legs together, and a constant torque; the first gives back over steps
    that repeat what it takes.
    """
    chain = Chain(walker)
    bias = 0.0 if chain.massless else chain.hip_bias

    return np.asarray(bias * 2 * (begin + end))


def damping_loss(walker: Walker, dissipated: ndarray) -> ndarray:
    """Compute the energy lost in the damper between the thighs over a step.

    Parameters
    ----------
    walker : Walker
    dissipated : ndarray, shape (n,) [sqrt(g/leg)]
        Integral over the step of the square of the rate at which the thighs open.

    Returns
    -------
    ndarray, shape (n,) [weight leg]
    """
    chain = Chain(walker)
    damping = 0.0 if chain.massless else chain.hip_damping

    return np.asarray(damping * dissipated)
