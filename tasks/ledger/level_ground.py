"""What drives beside gravity (section 8 of the paper): pushing off before heelstrike, and
a torque at the hip that retards.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from gaitsweep.tasks.contract.registry import GAITS
from gaitsweep.tasks.contract.tables import Arrays
from gaitsweep.tasks.ledger.claim import Found, claim, farthest, found, verdict
from gaitsweep.tasks.ledger.lines import BOTH, LONG, SHORT, Paper
from gaitsweep.tasks.studies.solve_points import atlas, points

_WANT = ("stance_angle", "froude_speed", "cost_of_transport", "loss_tangential")
_WANT_OF_TORQUE = (*_WANT, "hip_torque_work")
#: A slope and a push-off, over m sqrt(g leg), of steps of nearly one length.
DOWN, PUSH = 1e-6, 1e-4
#: Slope of large steps of E, and a torque at its hip, over m g leg, that retards.
STEEP, RETARDING = 0.05, -0.002


def _gaits(
    walker: str, slope: float, want: tuple[str, ...] = _WANT, **settings: float
) -> Arrays:
    """Variables of the gaits of a walker with some keys set, at one slope: arrays of
    shape (1, gaits).
    """
    line = {"walker": walker, "set": settings}
    branches = atlas({"line": line, "coarse": True, "level": slope <= 0}, [])
    asked = {"slope": np.array([slope]), "want": want, "gaits": GAITS}
    return points({"line": line, **asked}, [branches])


def _over_cube(gaits: Mapping[str, np.ndarray], gait: int) -> float:
    """Cost of transport over the cube of the stance angle, which has a limit for short
    steps whose heelstrike is normal.
    """
    cost = gaits["cost_of_transport"][0, gait] / gaits["stance_angle"][0, gait] ** 3
    return float(cost)


@claim("L1")
def pushing_off(paper: Paper) -> Found:
    """Compare the cost of steps of one length on a slope and with a push-off on level
    ground, and compute how power grows with speed there.
    """
    ratio = {}
    for walker, gaits in (("D", BOTH), ("B", {"long": LONG})):
        down = paper.line(walker).at([DOWN], _WANT)
        pushed = _gaits(walker, 0.0, push_off=PUSH)
        for label, gait in gaits.items():
            name = f"{walker} {label}"
            ratio[name] = _over_cube(down, gait) / _over_cube(pushed, gait)

    more = _gaits("D", 0.0, push_off=1.1 * PUSH)
    less = _gaits("D", 0.0, push_off=PUSH)
    exponent = {}
    for label, gait in BOTH.items():
        of_speed, of_cost = (
            float(np.log(more[name][0, gait] / less[name][0, gait]))
            for name in ("froude_speed", "cost_of_transport")
        )
        exponent[label] = 1 + of_cost / of_speed

    is_a_fourth = farthest(ratio.values(), 4) < 1e-2
    is_avoided = min(ratio.values()) > 100

    return found(
        verdict(is_avoided, is_a_fourth),
        ratio["D long"],
        ratio=ratio,
        exponent=exponent,
    )


@claim("L2")
def retarding(paper: Paper) -> Found:
    """Compare the short step of E on a steep slope with that of a walker whose hip is
    retarded by a constant torque.
    """
    passive = paper.line("E").at([STEEP], _WANT)
    torque = RETARDING * paper.line("E").walker.leg
    retarded = _gaits("E", STEEP, _WANT_OF_TORQUE, hip_torque=torque)

    lost = passive["loss_tangential"][0, SHORT]
    saved = lost - retarded["loss_tangential"][0, SHORT]
    work = -retarded["hip_torque_work"][0, SHORT]
    speed = {
        "short": passive["froude_speed"][0, SHORT],
        "short, retarded": retarded["froude_speed"][0, SHORT],
        "long": passive["froude_speed"][0, LONG],
    }
    is_faster = speed["short, retarded"] > speed["long"]

    return found(
        verdict(is_faster and saved > work, saved > 0.5 * work),
        saved / work,
        saved=saved,
        work=work,
        share=saved / lost,
        speed=speed,
    )
