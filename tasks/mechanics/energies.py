"""Kinetic and potential energy of a walker, part by part as in the paper's figure 1.

Nothing here is lumped, scaled or divided: this is what `tasks.mechanics.equations` is
checked against, not what is integrated.
"""

from __future__ import annotations

import heyoka as hy

from gaitsweep.tasks.mechanics.equations import ZERO, Sym
from gaitsweep.tasks.mechanics.vector import Vector
from gaitsweep.tasks.walkers.walker import Walker


def energies(
    walker: Walker, q: list[Sym], rate: list[Sym], slope: Sym
) -> tuple[Sym, Sym]:
    """Kinetic and potential energy of a walker on its rolling stance foot.

    Parameters
    ----------
    walker : Walker
    q, rate : list of expression
        Angles [rad] of the stance leg, the swing thigh and, with a free knee, the swing
        shank, counter-clockwise from the ground's normal, and their rates.
    slope : expression [rad]

    Returns
    -------
    kinetic, potential : expression
        In the walker's units.

    Notes
    -----
    Of each part of mass m, radius of gyration r, centre (x, y) and angle a,

        T = m/2 (x'^2 + y'^2 + r^2 a'^2),    V = m g (y cos(slope) - x sin(slope)),

    with x down the slope and y along its normal (figure 1 of the paper).
    """
    stance, thigh, shank = q[0], q[1], q[-1]
    foot = Vector(-walker.R * stance, hy.expression(walker.R))
    hip = foot + _turned(1j * walker.l, stance)
    knee = hip + _turned(walker.knee, thigh)
    locked_shank = walker.knee + walker.shank_centre
    parts = [
        (walker.m_h, 0.0, hip, ZERO),
        (walker.m_t, walker.r_t, hip + _turned(walker.thigh_centre, stance), rate[0]),
        (walker.m_s, walker.r_s, hip + _turned(locked_shank, stance), rate[0]),
        (walker.m_t, walker.r_t, hip + _turned(walker.thigh_centre, thigh), rate[1]),
        (walker.m_s, walker.r_s, knee + _turned(walker.shank_centre, shank), rate[-1]),
    ]

    kinetic, potential = ZERO, ZERO
    for mass, gyration, centre, turning in parts:
        x, y = (_rate_of(place, q, rate) for place in (centre.x, centre.y))
        kinetic += 0.5 * mass * (x**2.0 + y**2.0 + gyration**2 * turning**2.0)
        height = centre.y * hy.cos(slope) - centre.x * hy.sin(slope)
        potential += mass * walker.g * height
    return kinetic, potential


def _turned(arm: complex, angle: Sym) -> Vector:
    """An arm in the frame of a leg, turned with that leg."""
    return Vector(arm.real, arm.imag).rotate(hy.sin(angle), hy.cos(angle))


def _rate_of(place: Sym, q: list[Sym], rate: list[Sym]) -> Sym:
    """Rate of change of an expression of the angles."""
    changes = (
        hy.diff(place, angle) * speed for angle, speed in zip(q, rate, strict=True)
    )
    return sum(changes, ZERO)
