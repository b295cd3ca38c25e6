"""Kneestrike and heelstrike as matrices that turn rates before into rates after, with
derivatives by the angles.

An impact keeps the momentum of every motion the constraints after it allow: M q'_after
= Q q'_before, where rows of M and Q belong to the motions after and are sums over mass
elements m V_row . V_column.
"""

from __future__ import annotations

from collections.abc import Sequence

from flint import arb, arb_mat, arb_series, ctx

from gaitsweep.tasks.proofs.body import Body, Vector


def push_off(body: Body, angle: arb) -> tuple[arb_mat, arb_mat]:
    """Rates that the push-off before a heelstrike adds to those after it, and their
    derivative by the stance angle before.

    Parameters
    ----------
    body : Body
    angle : arb
        Stance angle just before [rad].

    Returns
    -------
    arb_mat, arb_mat
        Shape (2 or 3, 1).

    Notes
    -----
    The impulse at the trailing contact, toward the hip, has a moment about the new contact,
    and about the knee if that is free.
    """
    swing = [body.thigh, body.shank] if body.frees_trailing_knee else [body.leg]
    size = 1 + len(swing)
    if body.drive is None:
        return arb_mat(size, 1), arb_mat(size, 1)

    with _two_terms():
        old = _sin_cos(arb_series([angle, 1]))
        new = _sin_cos(arb_series([-angle, -1]))
        rows = _mass(body, new, [old] * len(swing), swing)
        cos, sin = old
        to_hip = Vector(-body.l * sin, body.l * cos + body.R)
        length = to_hip.dot(to_hip).sqrt()
        impulse = to_hip * (body.drive.push / length)
        gained = [impulse.dot(_hip(body, new))]
        bending = 0 * gained[0]
        if body.frees_trailing_knee:
            bending = impulse.dot(body.drive.knee.turned(*old).normal())
        gained += [bending, -bending][: len(swing)]
        return _solved(rows, [[each] for each in gained])


def heelstrike(body: Body, angle: arb) -> tuple[arb_mat, arb_mat]:
    """Rates after heelstrike from those before, and the derivative by the stance angle
    before; what a push-off adds is `push_off`'s.

    Parameters
    ----------
    body : Body
    angle : arb
        Stance angle just before [rad]; the swing leg stands at minus it.

    Returns
    -------
    arb_mat, arb_mat
        Shape (2 or 3, 2): rates of new stance leg, thigh (and shank, if its knee is
        free during the impact) from those of old stance and swing leg.
    """
    with _two_terms():
        old = _sin_cos(arb_series([angle, 1]))
        new = _sin_cos(arb_series([-angle, -1]))
        swing = [body.leg]
        if body.frees_trailing_knee:
            swing = [body.thigh, body.shank]
        rows = _mass(body, new, [old] * len(swing), swing)

        before = [_about_contact(body, old, new)]
        hip_before = _hip(body, old)
        for first, inertia in swing:
            own = inertia
            if body.frees_trailing_knee:
                own = inertia + body.coupling.x
            falling = first.turned(*old).normal()
            carried = falling.dot(hip_before)
            before.append([carried + own, 0 * carried])

        return _solved(rows, before)


def _about_contact(
    body: Body, old: tuple[arb_series, arb_series], new: tuple[arb_series, arb_series]
) -> list[arb_series]:
    """Angular momentum of the whole walker about the new contact just before heelstrike,
    by the rates of the old stance leg and of the swing leg, which is the new one.
    """
    hip_before = _hip(body, old)
    hip_after = _hip(body, new)
    both = body.mass * hip_after.dot(hip_before)
    if not body.heavy:
        return [both, 0 * both]

    leg, inertia = body.leg
    turning = leg.turned(*new).normal()
    falling = leg.turned(*old).normal()
    both = both + turning.dot(hip_before) + falling.dot(hip_after)
    spin = hip_after.dot(turning) + inertia
    return [both, spin]


def kneestrike(body: Body, stance: arb, swing: arb) -> tuple[arb_mat, arb_mat, arb_mat]:
    """Rates after kneestrike from those before, and the derivatives by stance and swing
    angle.

    Parameters
    ----------
    body : Body
    stance, swing : arb [rad]
        Angles of stance leg and swing leg, whose thigh and shank are in line.

    Returns
    -------
    arb_mat, arb_mat, arb_mat
        Shape (2, 3): rates of stance leg and swing leg from those of stance leg, thigh
        and shank.
    """
    maps = []
    for moved in (0, 1):
        with _two_terms():
            old = _sin_cos(arb_series([stance, 1 - moved]))
            new = _sin_cos(arb_series([swing, moved]))
            free = _mass(body, old, [new] * 2, [body.thigh, body.shank])
            locked = _mass(body, old, [new], [body.leg])
            of_stance, of_thigh, of_shank = free
            of_swing = [a + b for a, b in zip(of_thigh, of_shank, strict=True)]
            maps.append(_solved(locked, [of_stance, of_swing]))

    return maps[0][0], maps[0][1], maps[1][1]


class _two_terms:
    """Series of two terms inside: a value and its derivative."""

    def __enter__(self) -> None:
        self.cap, ctx.cap = ctx.cap, 2

    def __exit__(self, *error: object) -> None:
        ctx.cap = self.cap


def _sin_cos(angle: arb_series) -> tuple[arb_series, arb_series]:
    sin, cos = angle.sin_cos()
    return cos, sin


def _hip(body: Body, stance: tuple[arb_series, arb_series]) -> Vector:
    """Velocity of the hip for a unit rate of the stance leg, whose foot rolls."""
    cos, sin = stance
    return Vector(-body.l * cos - body.R, -body.l * sin)


def _mass(
    body: Body,
    stance: tuple,
    angles: Sequence[tuple],
    swing: Sequence[tuple[Vector, arb]],
) -> list[list]:
    """Mass matrix of the stance leg and one or two swing links; for a light leg its
    rows are divided by its mass.
    """
    hip = _hip(body, stance)
    arms = [
        first.turned(*at).normal() for (first, _), at in zip(swing, angles, strict=True)
    ]
    cross = [hip.dot(arm) for arm in arms]
    zero = 0 * cross[0]
    stance_first = body.stance_first.turned(*stance)
    rows = [
        [
            body.stance_second + 2 * body.R * stance_first.y,
            *(cross if body.heavy else [zero] * len(cross)),
        ]
    ]
    for i, (_, inertia) in enumerate(swing):
        rows.append(
            [
                cross[i],
                *[
                    zero + inertia if i == j else _coupling(body, angles)
                    for j in range(len(swing))
                ],
            ]
        )

    return rows


def _coupling(body: Body, angles: Sequence[tuple]) -> arb_series:
    (cos_a, sin_a), (cos_b, sin_b) = angles
    return body.coupling.x * (cos_b * cos_a + sin_b * sin_a) - body.coupling.y * (
        sin_b * cos_a - cos_b * sin_a
    )


def _solved(after: list[list], before: list[list]) -> tuple[arb_mat, arb_mat]:
    """M^-1 Q and its derivative, from matrices of series of two terms."""
    (M, dM), (Q, dQ) = (
        [arb_mat([[x[k] for x in row] for row in rows]) for k in (0, 1)]
        for rows in (after, before)
    )
    inverse = M.inv()
    rates = inverse * Q
    return rates, inverse * (dQ - dM * rates)
