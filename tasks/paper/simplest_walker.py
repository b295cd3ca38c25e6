"""The simplest walker, D (sections 3 and 4.1 of the paper)."""

from __future__ import annotations

import math

import numpy as np

from tasks.paper.claim import ClaimResult, claim, rounded, verdict
from tasks.paper.lines import LONG, SHORT, foot_ratio, line, numbers
from tasks.trace_motion import trace

#: Periods of the limit of vanishing slope: tan(t/2) = -3 tanh(t/2), and pi.
PERIODS = (3.8120917950, math.pi)


def power_factor(period: float) -> float:
    """P/v^4 of walker D as the slope vanishes, with m = g = l = 1: period^3/(8 tanh^2(period/2))."""
    return period**3 / (8 * math.tanh(period / 2) ** 2)


@claim(
    "D1", "two gaits at every slope up to 0.2", "section 3", "figure11/linear", "gaitsweep solve --walker D --slope 0.2"
)
def two_gaits() -> ClaimResult:
    found = line("D").grid(1e-8, 0.2, 97)
    both = np.isfinite(found["stance_angle"][:, [LONG, SHORT]]).all(axis=1)
    spans = [(np.exp(b.q.min()), np.exp(b.q.max())) for b in line("D").branches]
    upper = float(min(high for _, high in spans))
    return ClaimResult(
        f"both gaits at each of {both.size} slopes from 1e-8 to 0.2; their branches reach beyond {upper:.2f}",
        verdict(bool(both.all()) and upper > 0.2),
        upper,
    )


@claim(
    "D2",
    "the long step is stable below 0.015",
    "section 3",
    "figure11/linear",
    "gaitsweep solve --walker D --slope 0.0150884379411",
)
def long_stable() -> ClaimResult:
    flips = line("D").special_of("flip")
    found = line("D").grid(1e-8, flips[0]["slope"], 61)
    worst = float(found["spectral_radius"][:-1, LONG].max())
    finding = rounded(0.015, 5e-4, flips[0]["slope"])
    return ClaimResult(
        f"stable from 1e-8 (largest multiplier {worst:.4f} at most) to the flip at {flips[0]['slope']:.15g}",
        finding.verdict if worst < 1 else verdict(False),
        finding.value,
        finding.low,
        finding.high,
    )


@claim(
    "D3", "the short step is never stable", "section 3", "figure11/linear", "gaitsweep solve --walker D --slope 0.009"
)
def short_unstable() -> ClaimResult:
    radius = line("D").grid(1e-8, 0.2, 97)["spectral_radius"][:, SHORT]
    least = float(radius.min())
    return ClaimResult(
        f"largest multiplier from {least:.4f} to {radius.max():.4f} over slopes 1e-8 to 0.2", verdict(least > 1), least
    )


@claim(
    "D4",
    "long step: x'/y' -> 0 and time reversal symmetry as the slope vanishes; short step: neither",
    "sections 3 and 4.1",
    "figure11/loglog",
    "gaitsweep solve --walker D --slope 1e-6 --json",
)
def heelstrike_direction() -> ClaimResult:
    slopes = [1e-3, 1e-5, 1e-7]
    ratios = {w: foot_ratio(line(w).walker, line(w).at(slopes)) for w in ("D", "A", "B", "E", "F")}
    power = {w: np.diff(np.log(r[1:, :2]), axis=0)[0] / np.log(slopes[2] / slopes[1]) for w, r in ratios.items()}
    uneven = [_asymmetry(s) for s in slopes]
    falls = all(p[LONG] > 0.3 for p in power.values())
    rises = all(abs(power[w][SHORT] + 1) < 0.02 for w in "ABEF")
    even = uneven[2][0] < 1e-3 and uneven[2][1] > 0.1
    shorts = numbers({w: power[w][SHORT] for w in power}, 3)
    return ClaimResult(
        f"long: x'/y' of D {ratios['D'][0, LONG]:.2g}, {ratios['D'][1, LONG]:.2g}, {ratios['D'][2, LONG]:.2g} at "
        f"slopes 1e-3, 1e-5, 1e-7; motion off its time reversal by {uneven[0][0]:.1g}, {uneven[1][0]:.1g}, "
        f"{uneven[2][0]:.1g} of the step (short: {uneven[2][1]:.2g}); short: x'/y' ~ slope^p with p = {shorts}",
        verdict(falls and rises and even),
        float(power["E"][SHORT]),
    )


def _asymmetry(slope: float) -> tuple[float, float]:
    """Largest distance of both gaits of D from their time reversal (t, angles) -> (T - t, -angles), over the angle."""
    found = trace({**line("D").params, "slope": np.array([slope]), "gaits": ("long", "short")}, [line("D").arrays])
    out = []
    for gait in ("long", "short"):
        mine = found["trace/gait"] == gait
        out.append(
            max(
                float(np.abs(found[f"trace/{k}"][mine] + found[f"trace/{k}"][mine][::-1]).max())
                for k in ("theta_st", "theta_th")
            )
            / float(found["trace/theta_st"][mine][0])
        )
    return out[0], out[1]


@claim(
    "D5",
    "step length and speed ~ slope^(1/3), the period tends to a constant, for both gaits",
    "section 3",
    "figure11/loglog",
    "gaitsweep run data/studies/paper/figure11.toml",
)
def cube_roots() -> ClaimResult:
    found = line("D").at([1e-9])
    names = ("long", "short")
    angle = {n: line("D").exponent(g, 1e-8) for g, n in enumerate(names)}
    speed = {n: line("D").exponent(g, 1e-8, "speed") for g, n in enumerate(names)}
    period = {n: float(found["period"][0, g]) for g, n in enumerate(names)}
    off = max(abs(p - 1 / 3) for p in (*angle.values(), *speed.values()))
    drift = max(abs(period[n] - limit) for n, limit in zip(names, PERIODS, strict=True))
    return ClaimResult(
        f"exponents of the angle: {numbers(angle, 6)}, of the speed: {numbers(speed, 6)} at 1e-8; "
        f"periods at 1e-9: {numbers(period, 10)}",
        verdict(off < 1e-4 and drift < 1e-4),
        angle["long"],
    )


@claim(
    "D6",
    "power ~ speed^4 on both gaits",
    "section 3, eq. 8",
    "figure11/loglog",
    "gaitsweep run data/studies/paper/figure11.toml",
)
def fourth_power() -> ClaimResult:
    d = line("D")
    exponents = [d.exponent(g, 1e-8, "power", "speed") for g in (LONG, SHORT)]
    found, unit = d.at([1e-9]), d.walker.total_mass * d.walker.g
    factors = [float(found["power"][0, g] / found["speed"][0, g] ** 4) / unit for g in (LONG, SHORT)]
    limits = [power_factor(p) for p in PERIODS]
    off = max(abs(a / b - 1) for a, b in zip(factors, limits, strict=True))
    return ClaimResult(
        f"exponents {exponents[0]:.6f} long, {exponents[1]:.6f} short; P/v^4 = {factors[0]:.6f} and "
        f"{factors[1]:.6f} (closed form {limits[0]:.6f} and {limits[1]:.6f})",
        verdict(max(abs(p - 4) for p in exponents) < 1e-3 and off < 1e-4),
        exponents[0],
    )


@claim(
    "D7",
    "the short step is the faster one at every slope",
    "section 3",
    "figure11/linear",
    "gaitsweep solve --walker D --slope 0.01 --json",
)
def short_faster() -> ClaimResult:
    speed = line("D").grid(1e-8, 0.2, 97)["speed"]
    ratio = speed[:, SHORT] / speed[:, LONG]
    return ClaimResult(
        f"v short / v long from {ratio.min():.4f} to {ratio.max():.4f} over slopes 1e-8 to 0.2",
        verdict(bool((ratio > 1).all())),
        float(ratio.min()),
    )


@claim(
    "D10",
    "at heelstrike the swing leg still goes forward on the short step and has turned back on the long one",
    "section 3",
    "figure3/angles",
    "gaitsweep solve --walker D --slope 0.009 --json",
)
def swing_at_heelstrike() -> ClaimResult:
    # Swing leg rate over the stance leg's, both from the ground normal: u - 1, positive is forward.
    rate = line("D").grid(1e-8, 0.2, 97)["heelstrike_rate_ratio"] - 1
    long, short = rate[:, LONG], rate[:, SHORT]
    at = line("D").at([0.009])["heelstrike_rate_ratio"][0] - 1
    return ClaimResult(
        f"swing rate over stance rate just before heelstrike, forward positive: short {at[SHORT]:.4f}, long "
        f"{at[LONG]:.4f} at 0.009; over slopes 1e-8 to 0.2 short {short.min():.2g} (it tends to rest as the "
        f"slope vanishes) to {short.max():.3f}, long {long.min():.3f} to {long.max():.3f}",
        verdict(bool((long <= 0).all() and (short > 0).all())),
        float(at[SHORT]),
    )
