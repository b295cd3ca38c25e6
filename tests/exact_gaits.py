"""Walkers, states and reference gaits for tests of proofs."""

import tomllib
from pathlib import Path

from flint import arb, arb_mat, ctx

from gaitsweep.tasks.proofs.body import body
from gaitsweep.tasks.proofs.enclosed_step import Region, step
from gaitsweep.tasks.proofs.enclosure import Accuracy, flow
from gaitsweep.tasks.proofs.gait import Setting
from gaitsweep.tasks.proofs.keys import decimal, exact
from gaitsweep.tasks.proofs.motion import Motion, evaluate

REFERENCE = Path(__file__).parents[1] / "data" / "reference"
GAITS = tomllib.loads((REFERENCE / "extended.toml").read_text())["gaits"]
SLOPE = 0.0625
#: A state in the middle of things: angles and rates of stance leg, thigh, shank, exact
#: in decimals and in doubles.
STATE = ([0.15625, -0.21875, -0.328125], [-0.90625, 0.40625, -0.703125])


def walker(name):
    """Constants of a walker at the present precision."""
    return body(*exact(name))


def state(links, spread=0.0):
    """The state as balls: angles, then rates."""
    return [arb(x, spread) for part in STATE for x in part[:links]]


def reference(name, slope, label):
    """A gait to 25 digits."""
    return next(
        g for g in GAITS if (g["walker"], g["slope"], g["gait"]) == (name, slope, label)
    )


def guess(gait, digits=17):
    """Numbers a proof starts from, rounded to so many digits."""
    names = ("stance_angle", "stance_rate", "thigh_rate", "kneestrike_time", "period")
    values = [float(gait[name]) for name in names if name in gait]
    return [float(f"{x:.{digits - 1}e}") for x in values if x == x]


def setting(name, slope, **keys):
    """A walker on a slope."""
    return Setting(*exact(name, keys), decimal(slope))


def fine(name, x, time):
    """A motion to more than 60 digits, by short steps at 512 bits."""
    with ctx.workprec(512):
        body = walker(name)
        for _ in range(40):
            motion = Motion(body, arb(SLOPE), x)
            for _ in range(40):
                motion.grow()
            x = [evaluate(s, arb(time) / 40).mid() for s in motion.series]
        return x


def coarse(name, links, spread, order=8, tolerance=1e-6, time=0.6, by_slope=None):
    """A flow whose remainders matter: order and tolerance are poor."""
    box = state(links, spread)
    middle = [x.mid() for x in box]
    unit = walker(name).time_unit
    start = arb_mat([[int(i == j) for j in range(2 * links)] for i in range(2 * links)])
    duration = arb(time * unit)
    return flow(
        walker(name),
        (arb(SLOPE), arb(SLOPE)),
        middle,
        box,
        start,
        (duration, duration),
        Accuracy(order, tolerance),
        None,
        [arb(0, spread)] * (2 * links),
    )


def check_remainder(name="C", links=3):
    found = coarse(name, links, 0.0)
    end = fine(name, state(links), float(0.6 * walker(name).time_unit))
    with ctx.workprec(512):
        for x, ball in zip(end, found.middle, strict=True):
            assert ball.contains(x)
        for x, ball in zip(end, found.state, strict=True):
            assert ball.contains(x)
    # The enclosure is not idle: its remainder is what makes it wide.
    assert max(float(x.rad()) for x in found.middle[links:]) > 1e-9


def check_durations(spread=2e-3):
    """The derivative by the unknowns holds that at either end of the period's bracket."""
    body = walker("D")
    middle = [
        arb(x)
        for x in (0.2003109005442471, -0.19983247300495235, 3.8824637528513742, 0.009)
    ]
    wide = Region(middle, [arb(0), arb(0), arb(0, spread), arb(0)])
    found = step(body, wide, Accuracy(20, 1e-15))
    for side in (-0.999, 0.999):
        moved = [*middle[:2], (middle[2] + side * spread).mid(), middle[3]]
        thin = step(body, Region(moved, [arb(0)] * 4), Accuracy(20, 1e-15))
        assert all(
            ball.contains(x.mid())
            for ball, x in zip(
                found.derivative.entries(), thin.derivative.entries(), strict=True
            )
        )
