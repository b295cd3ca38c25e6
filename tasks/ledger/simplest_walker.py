"""The simplest walker, D (sections 3 and 4.1 of the paper)."""

from __future__ import annotations

import math

import numpy as np

from gaitsweep.tasks.branches.tracking import MAX_SLOPE
from gaitsweep.tasks.ledger.claim import (
    NOT_REPRODUCED,
    PRINTED,
    Found,
    claim,
    farthest,
    found,
    verdict,
)
from gaitsweep.tasks.ledger.lines import BOTH, LONG, SHORT, Paper
from gaitsweep.tasks.studies.trace_motion import trace

#: Periods as the slope vanishes, long and short step: the root of tan(t/2) = -3
#: tanh(t/2), and pi [sqrt(l/g)].
PERIODS = (3.8120917950, math.pi)


def _power_factor(period: float) -> float:
    """Limit of P/v^4 of walker D as the slope vanishes, with m = g = l = 1: period^3/(8
    tanh^2(period/2)).
    """
    return period**3 / (8 * math.tanh(period / 2) ** 2)


@claim("D1")
def two_gaits(paper: Paper) -> Found:
    """Solve both gaits over a grid of slopes."""
    angles = paper.line("D").grid()["stance_angle"]
    both = np.isfinite(angles[:, [LONG, SHORT]]).all(axis=1)
    upper = min(MAX_SLOPE, paper.line("D").reaches[1].min())
    return found(verdict(both.all() and upper > 0.2), upper, slopes=both.size)


@claim("D2")
def long_stable(paper: Paper) -> Found:
    """Locate the flip of the long step and evaluate its multipliers below."""
    flip = paper.line("D").special_of("flip")[0]["slope"]
    below = paper.line("D").grid(high=flip, n=61)
    largest = below["spectral_radius"][:-1, LONG].max()

    return found(
        PRINTED["D2"].compare(flip) if largest < 1 else NOT_REPRODUCED,
        flip,
        largest=largest,
    )


@claim("D3")
def short_unstable(paper: Paper) -> Found:
    """Evaluate the multipliers of the short step over a grid of slopes."""
    radius = paper.line("D").grid()["spectral_radius"][:, SHORT]
    return found(verdict(radius.min() > 1), radius.min(), most=radius.max())


@claim("D4")
def heelstrike_direction(paper: Paper) -> Found:
    """Evaluate the swing foot's direction at heelstrike and the asymmetry of the motion
    under time reversal.
    """
    slopes = [1e-3, 1e-5, 1e-7]
    ratios, power = {}, {}
    for walker in ("D", "A", "B", "E", "F"):
        ratio = np.abs(paper.line(walker).at(slopes)["velocity_ratio"])
        change = np.diff(np.log(ratio[1:, :2]), axis=0)
        ratios[walker] = ratio
        power[walker] = change[0] / np.log(slopes[2] / slopes[1])

    of_long, of_short = zip(*(_asymmetry(paper, s) for s in slopes), strict=True)
    falls = all(p[LONG] > 0.3 for p in power.values())
    rises = all(abs(power[w][SHORT] + 1) < 0.02 for w in "ABEF")
    is_reversed = of_long[2] < 1e-3 and of_short[2] > 0.1

    return found(
        verdict(falls and rises and is_reversed),
        power["E"][SHORT],
        ratio=ratios["D"][:, LONG],
        asymmetry=of_long,
        of_short=of_short[2],
        power={w: p[SHORT] for w, p in power.items()},
    )


def _asymmetry(paper: Paper, slope: float) -> tuple[float, float]:
    """Largest distance of both gaits of D from their time reversal (t, angles) -> (T -
    t, -angles), over the angle.
    """
    d = paper.line("D")
    wanted = {"slope": np.array([slope]), "gaits": ("long", "short")}
    motion = trace({**d.params, **wanted}, [d.arrays])

    def distance(gait: str) -> float:
        is_gait = motion["trace/gait"] == gait
        stance = motion["trace/theta_st"][is_gait]
        swing = motion["trace/theta_th"][is_gait]
        off = 0.0
        for angle in (stance, swing):
            both_ways = np.abs(angle + angle[::-1])
            off = max(off, float(both_ways.max()))

        return off / float(stance[0])

    return distance("long"), distance("short")


@claim("D5")
def cube_roots(paper: Paper) -> Found:
    """Compute exponents and periods at vanishing slopes."""
    d = paper.line("D")
    angle = d.exponents(1e-8)
    speed = d.exponents(1e-8, "speed")
    periods = d.at([1e-9])["period"][0]
    period = {label: periods[gait] for label, gait in BOTH.items()}
    deviation = farthest([*angle.values(), *speed.values()], 1 / 3)
    drifts = zip(period.values(), PERIODS, strict=True)
    drift = farthest((one - limit for one, limit in drifts), 0)
    holds = verdict(deviation < 1e-4 and drift < 1e-4)

    return found(
        holds,
        angle["long"],
        angle=angle,
        speed=speed,
        period=period,
    )


@claim("D6")
def fourth_power(paper: Paper) -> Found:
    """Compute exponents and factors of power in speed at vanishing slopes."""
    d = paper.line("D")
    exponents = d.exponents(1e-8, "power", "speed")
    gaits = d.at([1e-9])
    weight = d.walker.total_mass * d.walker.g
    factors = []
    for gait in (LONG, SHORT):
        power = gaits["power"][0, gait]
        speed = gaits["speed"][0, gait]
        factors.append(power / speed**4 / weight)

    limits = [_power_factor(period) for period in PERIODS]
    ratios = [a / b for a, b in zip(factors, limits, strict=True)]
    is_fourth = farthest(exponents.values(), 4) < 1e-3
    holds = verdict(is_fourth and farthest(ratios, 1) < 1e-4)

    return found(
        holds, exponents["long"], exponents=exponents, factors=factors, limits=limits
    )


@claim("D7")
def short_faster(paper: Paper) -> Found:
    """Compare the speeds of both gaits over a grid of slopes."""
    speed = paper.line("D").grid()["speed"]
    ratio = speed[:, SHORT] / speed[:, LONG]
    return found(verdict((ratio > 1).all()), ratio.min(), most=ratio.max())


@claim("D10")
def swing_at_heelstrike(paper: Paper) -> Found:
    """Evaluate the rate of the swing leg just before heelstrike."""
    # Swing leg rate over the stance leg's, both from the ground normal: u - 1, positive
    # is forward.
    d = paper.line("D")
    rate = d.grid()["heelstrike_rate_ratio"] - 1
    at = d.at([0.009])["heelstrike_rate_ratio"] - 1
    long, short = rate[:, LONG], rate[:, SHORT]
    holds = verdict((long <= 0).all() and (short > 0).all())

    return found(
        holds,
        at[0, SHORT],
        at=at[0, LONG],
        long=(long.min(), long.max()),
        short=(short.min(), short.max()),
    )
