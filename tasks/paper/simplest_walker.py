"""The simplest walker, D (sections 3 and 4.1 of the paper)."""

from __future__ import annotations

import math

import numpy as np

from gaitsweep.tasks.continuation.tracking import MAX_SLOPE
from gaitsweep.tasks.paper.claim import NOT_REPRODUCED, PRINTED, ClaimResult, claim, verdict
from gaitsweep.tasks.paper.lines import BOTH, LONG, SHORT, Paper, numbers
from gaitsweep.tasks.trace_motion import trace

#: Periods as the slope vanishes, long and short step: the root of tan(t/2) = -3 tanh(t/2), and pi [sqrt(l/g)].
PERIODS = (3.8120917950, math.pi)


def _power_factor(period: float) -> float:
    """Limit of P/v^4 of walker D as the slope vanishes, with m = g = l = 1: period^3/(8 tanh^2(period/2))."""
    return period**3 / (8 * math.tanh(period / 2) ** 2)


@claim("D1")
def two_gaits(paper: Paper) -> ClaimResult:
    """Solve both gaits over a grid of slopes."""
    gaits = paper.line("D").grid()
    both = np.isfinite(gaits["stance_angle"][:, [LONG, SHORT]]).all(axis=1)
    upper = min(MAX_SLOPE, float(paper.line("D").reaches[1].min()))
    return ClaimResult(
        f"both gaits at each of {both.size} slopes from 1e-8 to 0.2; their branches extend to slope {upper:.2f}",
        verdict(bool(both.all()) and upper > 0.2),
        upper,
    )


@claim("D2")
def long_stable(paper: Paper) -> ClaimResult:
    """Locate the flip of the long step and evaluate its multipliers below."""
    flip = paper.line("D").special_of("flip")[0]["slope"]
    largest = float(paper.line("D").grid(1e-8, flip, 61)["spectral_radius"][:-1, LONG].max())
    return ClaimResult(
        f"stable from slope 1e-8 (spectral radius at most {largest:.4f}) to the flip at slope {flip:.15g}",
        PRINTED["D2"].compare(flip) if largest < 1 else NOT_REPRODUCED,
        flip,
    )


@claim("D3")
def short_unstable(paper: Paper) -> ClaimResult:
    """Evaluate the multipliers of the short step over a grid of slopes."""
    radius = paper.line("D").grid()["spectral_radius"][:, SHORT]
    least = float(radius.min())
    return ClaimResult(
        f"spectral radius {least:.4f}-{radius.max():.4f} over slopes 1e-8 to 0.2", verdict(least > 1), least
    )


@claim("D4")
def heelstrike_direction(paper: Paper) -> ClaimResult:
    """Evaluate the swing foot's direction at heelstrike and the asymmetry of the motion under time reversal."""
    slopes = [1e-3, 1e-5, 1e-7]
    ratios = {w: np.abs(paper.line(w).at(slopes)["velocity_ratio"]) for w in ("D", "A", "B", "E", "F")}
    power = {w: np.diff(np.log(r[1:, :2]), axis=0)[0] / np.log(slopes[2] / slopes[1]) for w, r in ratios.items()}
    asymmetry = [_asymmetry(paper, s) for s in slopes]
    falls = all(p[LONG] > 0.3 for p in power.values())
    rises = all(abs(power[w][SHORT] + 1) < 0.02 for w in "ABEF")
    symmetric = asymmetry[2][0] < 1e-3 and asymmetry[2][1] > 0.1
    shorts = numbers({w: power[w][SHORT] for w in power}, 3)
    return ClaimResult(
        f"long step of D at slopes 1e-3, 1e-5, 1e-7: x'/y' {ratios['D'][0, LONG]:.2g}, {ratios['D'][1, LONG]:.2g}, "
        f"{ratios['D'][2, LONG]:.2g}; deviation from time-reversal symmetry, over the stance angle, "
        f"{asymmetry[0][0]:.1g}, {asymmetry[1][0]:.1g}, {asymmetry[2][0]:.1g} (short step: {asymmetry[2][1]:.2g}); "
        f"short steps: x'/y' ~ slope^p with p = {shorts}",
        verdict(falls and rises and symmetric),
        float(power["E"][SHORT]),
    )


def _asymmetry(paper: Paper, slope: float) -> tuple[float, float]:
    """Largest distance of both gaits of D from their time reversal (t, angles) -> (T - t, -angles), over the angle."""
    d = paper.line("D")
    motion = trace({**d.params, "slope": np.array([slope]), "gaits": ("long", "short")}, [d.arrays])

    def distance(gait: str) -> float:
        angles = [motion[f"trace/{k}"][motion["trace/gait"] == gait] for k in ("theta_st", "theta_th")]
        return max(float(np.abs(a + a[::-1]).max()) for a in angles) / float(angles[0][0])

    return distance("long"), distance("short")


@claim("D5")
def cube_roots(paper: Paper) -> ClaimResult:
    """Compute exponents and periods at vanishing slopes."""
    d = paper.line("D")
    angle, speed, periods = d.exponents(1e-8), d.exponents(1e-8, "speed"), d.at([1e-9])["period"][0]
    period = {label: float(periods[gait]) for label, gait in BOTH.items()}
    deviation = max(abs(p - 1 / 3) for p in (*angle.values(), *speed.values()))
    drift = max(abs(one - limit) for one, limit in zip(period.values(), PERIODS, strict=True))
    return ClaimResult(
        f"exponents at slope 1e-8 of the angle: {numbers(angle, 6)}, of the speed: {numbers(speed, 6)}; "
        f"periods at slope 1e-9: {numbers(period, 10)}",
        verdict(deviation < 1e-4 and drift < 1e-4),
        angle["long"],
    )


@claim("D6")
def fourth_power(paper: Paper) -> ClaimResult:
    """Compute exponents and factors of power in speed at vanishing slopes."""
    d = paper.line("D")
    exponents = d.exponents(1e-8, "power", "speed")
    gaits, weight = d.at([1e-9]), d.walker.total_mass * d.walker.g
    factors = [float(gaits["power"][0, g] / gaits["speed"][0, g] ** 4) / weight for g in (LONG, SHORT)]
    limits = [_power_factor(p) for p in PERIODS]
    deviation = max(abs(a / b - 1) for a, b in zip(factors, limits, strict=True))
    return ClaimResult(
        f"exponents {exponents['long']:.6f} long, {exponents['short']:.6f} short; P/v^4 = {factors[0]:.6f} and "
        f"{factors[1]:.6f} (closed form {limits[0]:.6f} and {limits[1]:.6f})",
        verdict(max(abs(p - 4) for p in exponents.values()) < 1e-3 and deviation < 1e-4),
        exponents["long"],
    )


@claim("D7")
def short_faster(paper: Paper) -> ClaimResult:
    """Compare the speeds of both gaits over a grid of slopes."""
    speed = paper.line("D").grid()["speed"]
    ratio = speed[:, SHORT] / speed[:, LONG]
    return ClaimResult(
        f"ratio of speeds, short step to long step, {ratio.min():.4f}-{ratio.max():.4f} over slopes 1e-8 to 0.2",
        verdict(bool((ratio > 1).all())),
        float(ratio.min()),
    )


@claim("D10")
def swing_at_heelstrike(paper: Paper) -> ClaimResult:
    """Evaluate the rate of the swing leg just before heelstrike."""
    # Swing leg rate over the stance leg's, both from the ground normal: u - 1, positive is forward.
    rate = paper.line("D").grid()["heelstrike_rate_ratio"] - 1
    long, short = rate[:, LONG], rate[:, SHORT]
    at = paper.line("D").at([0.009])["heelstrike_rate_ratio"][0] - 1
    return ClaimResult(
        f"ratio of swing rate to stance rate just before heelstrike (forward positive) at slope 0.009: short "
        f"{at[SHORT]:.4f}, long {at[LONG]:.4f}; over slopes 1e-8 to 0.2: short from {short.min():.2g} (it tends to "
        f"zero as the slope vanishes) to {short.max():.3f}, long from {long.min():.3f} to {long.max():.3f}",
        verdict(bool((long <= 0).all() and (short > 0).all())),
        float(at[SHORT]),
    )
