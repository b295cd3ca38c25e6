"""Kneestrike and heelstrike: plastic impacts, as linear maps of the rates (section 2.1
of the paper).

Momentum is conserved in every motion that the constraints after the impact allow: with
V the bodies' velocities, M_after q'_after = sum m (dV/dq'_after)(V_before). Rows of the
swing leg are divided by `eps` as in the equations of motion.
"""

from __future__ import annotations

import heyoka as hy

from gaitsweep.tasks.mechanics.equations import ZERO, Solver, Sym, Symbols, rows
from gaitsweep.tasks.mechanics.vector import Vector


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
        True where the new swing knee is free.
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
    That leg becomes the swing leg.
    """
    new = p.scale * angle
    old = -p.scale * angle if old_angle is None else p.scale * old_angle
    trig_new, trig_old = (hy.sin(new), hy.cos(new)), (hy.sin(old), hy.cos(old))
    hip_new = Vector(-p.R - p.l * trig_new[1], -p.l * trig_new[0])
    hip_old = Vector(-p.R - p.l * trig_old[1], -p.l * trig_old[0])

    def sweep(S: Vector, trig: tuple[Sym, Sym]) -> Vector:
        """Momentum that a unit rate gives a leg of first moment S."""
        return S.rotate(*trig).normal()

    S, J = p.locked()
    swing_angle = -angle if old_angle is None else old_angle
    angles = [angle, swing_angle] + ([swing_angle] if free_knee else [])
    M, _ = rows(p, angles, [ZERO] * len(angles), free_knee)
    # The product hip_new . hip_old, without cancellation for legs at a wide angle.
    hips = p.R**2.0 + 2.0 * p.R * p.l * trig_new[1] + p.l**2.0 * hy.cos(2.0 * new)
    if old_angle is not None:
        hips = (
            p.R**2.0
            + p.R * p.l * (trig_new[1] + trig_old[1])
            + p.l**2.0 * hy.cos(new - old)
        )
    momentum = [
        (
            hips
            + p.eps
            * (sweep(S, trig_new).dot(hip_old) + hip_new.dot(sweep(S, trig_old)))
        )
        * stance_rate
        + p.eps * (hip_new.dot(sweep(S, trig_new)) + J) * swing_rate
    ]
    swing = (
        [(p.S_b, p.C_bb + p.H.x), (p.S_c, p.C_cc + p.H.x)] if free_knee else [(S, J)]
    )
    for S_j, inertia in swing:
        momentum.append((sweep(S_j, trig_old).dot(hip_old) + inertia) * stance_rate)
    return Solver(M)(momentum)


def kneestrike(p: Symbols, q: list[Sym], rate: list[Sym]) -> list[Sym]:
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
    row = [sum((free[i][j] * rate[j] for j in range(3)), ZERO) for i in range(3)]
    return Solver(locked)([row[0], row[1] + row[2]])
