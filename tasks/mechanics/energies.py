"""Kinetic and potential energy of a walker, part by part as in the paper's figure 1.

Nothing here is lumped, scaled or divided: this is what `tasks.mechanics.equations` is
checked against, not what is integrated.
"""

from __future__ import annotations

from typing import NamedTuple

import heyoka as hy

from gaitsweep.tasks.mechanics.equations import ZERO, Sym
from gaitsweep.tasks.mechanics.vector import Vector
from gaitsweep.tasks.walkers.walker import Walker


def energies(
    walker: Walker,
    q: list[Sym],
    rate: list[Sym],
    slope: Sym,
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

    with x down the slope and y along its normal (figure 1 of the paper), and of the
    spring between the thighs k/2 (swing - stance - rest)^2.
    """
    kinetic = ZERO
    potential = ZERO
    for part in _parts(walker, q, rate):
        x = part.centre.x
        y = part.centre.y
        forward = _rate_of(x, q, rate)
        upward = _rate_of(y, q, rate)
        turning = part.gyration * part.rate
        kinetic += 0.5 * part.mass * (forward**2.0 + upward**2.0 + turning**2.0)

        height = y * hy.cos(slope) - x * hy.sin(slope)
        potential += part.mass * walker.g * height

    if walker.hip_stiffness:
        stretch = q[1] - q[0] - walker.hip_rest
        potential += 0.5 * walker.hip_stiffness * stretch**2.0

    return kinetic, potential


def hip_forces(walker: Walker, rate: list[Sym]) -> list[Sym]:
    """Generalised forces of damper and motor between the thighs, which no energy has.

    Parameters
    ----------
    walker : Walker
    rate : list of expression

    Returns
    -------
    list of expression
        On the stance leg, the swing thigh and, with a free knee, the swing shank.
    """
    torque = walker.hip_torque - walker.hip_damping * (rate[1] - rate[0])
    return [-torque, torque, *[ZERO] * (len(rate) - 2)]


class _Part(NamedTuple):
    """A rigid part: its mass, radius of gyration, centre and rate of turning."""

    mass: float
    gyration: float
    centre: Vector
    rate: Sym


def _parts(walker: Walker, q: list[Sym], rate: list[Sym]) -> list[_Part]:
    """The hip, and thigh and shank of the stance and of the swing leg."""
    stance = q[0]
    thigh = q[1]
    shank = q[-1]

    foot = Vector(-walker.R * stance, hy.expression(walker.R))
    hip = foot + _turned(1j * walker.l, stance)
    stance_thigh = hip + _turned(walker.thigh_centre, stance)
    stance_shank = hip + _turned(walker.knee + walker.shank_centre, stance)
    swing_thigh = hip + _turned(walker.thigh_centre, thigh)
    knee = hip + _turned(walker.knee, thigh)
    swing_shank = knee + _turned(walker.shank_centre, shank)

    return [
        _Part(walker.m_h, 0.0, hip, ZERO),
        _Part(walker.m_t, walker.r_t, stance_thigh, rate[0]),
        _Part(walker.m_s, walker.r_s, stance_shank, rate[0]),
        _Part(walker.m_t, walker.r_t, swing_thigh, rate[1]),
        _Part(walker.m_s, walker.r_s, swing_shank, rate[-1]),
    ]


def _turned(arm: complex, angle: Sym) -> Vector:
    """An arm in the frame of a leg, turned with that leg."""
    return Vector(arm.real, arm.imag).rotate(hy.sin(angle), hy.cos(angle))


def _rate_of(place: Sym, q: list[Sym], rate: list[Sym]) -> Sym:
    """Rate of change of an expression of the angles."""
    total = ZERO
    for angle, speed in zip(q, rate, strict=True):
        total += hy.diff(place, angle) * speed
    return total
