"""Kneestrike and heelstrike: plastic impacts, as linear maps of the rates (section 2.1
of the paper).

Momentum is conserved in every motion that the constraints after the impact allow: with
V the bodies' velocities, M_after q'_after = sum m (dV/dq'_after)(V_before). Rows of the
swing leg are divided by `eps` as in the equations of motion.
"""

from __future__ import annotations

import heyoka as hy

from gaitsweep.tasks.mechanics.equations import ZERO, Solver, Sym, Symbols, rows
from gaitsweep.tasks.mechanics.lumped import Structure
from gaitsweep.tasks.mechanics.vector import Vector


def release(
    structure: Structure,
    p: Symbols,
    angle: Sym,
    stance_rate: Sym,
    swing_rate: Sym,
    old_angle: Sym | None = None,
) -> list[Sym]:
    """Rates of all links just after heelstrike, when the knee of the leg that left the
    ground is released.

    Parameters
    ----------
    structure : Structure
        Says whether that knee was free during the impact already.
    p, angle, stance_rate, swing_rate, old_angle
        As for `heelstrike`.

    Returns
    -------
    list of expression
        Rates of the new stance leg, new swing thigh[, new swing shank].

    Notes
    -----
    With a knee that is locked during the impact, the impact is that of the same walker
    without knees, and shank and thigh begin with one rate.
    """
    is_free = structure.kneed and not structure.locks_trailing_knee
    rates = heelstrike(p, angle, stance_rate, swing_rate, is_free, old_angle)
    return [*rates, rates[-1]] if structure.locks_trailing_knee else rates


def heelstrike(
    p: Symbols,
    angle: Sym,
    stance_rate: Sym,
    swing_rate: Sym,
    free_knee: bool,
    old_angle: Sym | None = None,
) -> list[Sym]:
    """Rates just after heelstrike from the rates just before.

    Parameters
    ----------
    p : Symbols
        The structure's parameters.
    angle : expression
        Scaled stance angle just after heelstrike.
    stance_rate, swing_rate : expression
        Rates of the old stance and swing leg just before.
    free_knee : bool
        True where the new swing knee is free during the impact.
    old_angle : expression, optional
        Scaled angle of the old stance leg; on even ground both feet touch, so it is
        minus the new one's.

    Returns
    -------
    list of expression
        Rates of the new stance leg, new swing thigh[, new swing shank].

    Notes
    -----
    Section 2.1 of the paper, with feet of any radius: the impulse acts at the new contact only, so angular momentum of
    the whole walker about it and of the old stance leg about the hip are conserved.
    That leg becomes the swing leg. A push-off of that leg adds its own momenta first.
    """
    new, old, hips = _on_ground(p, angle, old_angle)
    swing_angle = -angle if old_angle is None else old_angle
    S, J = p.locked()
    swing = [(S, J)]
    angles = [angle, swing_angle]
    if free_knee:
        swing = _links(p)
        angles.append(swing_angle)

    M, _ = rows(p, angles, [ZERO] * len(angles), free_knee)

    turned = new.sweep(S)
    legs = turned.dot(old.hip) + new.hip.dot(old.sweep(S))
    of_stance = (hips + p.eps * legs) * stance_rate
    of_swing = p.eps * (new.hip.dot(turned) + J) * swing_rate
    momentum = [of_stance + of_swing]
    for S_j, inertia in swing:
        carried = old.sweep(S_j).dot(old.hip)
        momentum.append((carried + inertia) * stance_rate)

    return Solver(M)(_pushed(momentum, p, new, old))


def _on_ground(p: Symbols, angle: Sym, old_angle: Sym | None) -> tuple[_Leg, _Leg, Sym]:
    """The new and the old stance leg, and the product of their hips, without
    cancellation for legs at a wide angle.
    """
    new = _Leg(p, p.scale * angle)
    if old_angle is None:
        old = _Leg(p, -p.scale * angle)
        cosines = 2.0 * p.R * p.l * new.cosine
        between = 2.0 * new.angle
    else:
        old = _Leg(p, p.scale * old_angle)
        cosines = p.R * p.l * (new.cosine + old.cosine)
        between = new.angle - old.angle

    hips = p.R**2.0 + cosines + p.l**2.0 * hy.cos(between)
    return new, old, hips


def _links(p: Symbols) -> list[tuple[Vector, Sym]]:
    """First moments of thigh and shank, and inertias with which both turn together."""
    thigh = (p.S_b, p.C_bb + p.H.x)
    shank = (p.S_c, p.C_cc + p.H.x)
    return [thigh, shank]


def _pushed(momentum: list[Sym], p: Symbols, new: _Leg, old: _Leg) -> list[Sym]:
    """Momenta, with what a push-off of the trailing leg adds to them."""
    if not p.pushes_off:
        return momentum
    gained = _push_off(p, new, old, len(momentum) == 3)
    return [a + b for a, b in zip(momentum, gained, strict=True)]


def _push_off(p: Symbols, new: _Leg, old: _Leg, free_knee: bool) -> list[Sym]:
    """Momenta that the trailing leg's push-off gives: its impulse, from the contact
    toward the hip, times the velocity of that contact at a unit rate of each link.

    It turns no leg about the hip, but thigh and shank against each other where the knee
    lies beside its line.
    """
    push = p.push / p.scale
    to_contact = Vector(p.l * old.sine, -p.R - p.l * old.cosine)
    direction = to_contact / -hy.sqrt(to_contact.dot(to_contact))
    of_hip = push * direction.dot(new.hip)
    if not free_knee:
        return [of_hip, ZERO]

    knee = p.knee.rotate(old.sine, old.cosine)
    bending = push * direction.dot(knee.normal()) / p.eps
    return [of_hip, bending, -bending]


class _Leg:
    """A leg on the ground at an angle, and the velocity of its hip at a unit rate."""

    def __init__(self, p: Symbols, angle: Sym):
        self.angle = angle
        self.sine = hy.sin(angle)
        self.cosine = hy.cos(angle)
        self.hip = Vector(-p.R - p.l * self.cosine, -p.l * self.sine)

    def sweep(self, S: Vector) -> Vector:
        """Momentum that a unit rate gives a leg of first moment S."""
        return S.rotate(self.sine, self.cosine).normal()


def kneestrike(
    p: Symbols,
    q: list[Sym],
    rate: list[Sym],
) -> list[Sym]:
    """Rates of the stance and the locked swing leg just after kneestrike.

    Parameters
    ----------
    p : Symbols
        The structure's parameters.
    q, rate : list of expression
        Scaled angles and rates of the three links just before.

    Returns
    -------
    list of expression
        Rates of the stance leg and of the locked swing leg.

    Notes
    -----
    Section 2.1 of the paper: the impulse is a torque in the knee, so the generalised momenta of the stance leg and of
    the whole swing leg are conserved.
    """
    free, _ = rows(p, q, rate, True)
    locked, _ = rows(p, q[:2], rate[:2], False)
    momenta = []
    for row in free:
        terms = [mass * v for mass, v in zip(row, rate, strict=True)]
        momenta.append(sum(terms, ZERO))

    stance, thigh, shank = momenta
    return Solver(locked)([stance, thigh + shank])
