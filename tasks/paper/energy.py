"""Energy, scaling and the general claims (sections 2.2, 4.1, 5.3 and 6 of the paper)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gaitsweep.tasks.fixed_points.search import search
from gaitsweep.tasks.fixed_points.step_check import gait_ratio
from gaitsweep.tasks.measures.losses import contact_mass
from gaitsweep.tasks.paper.claim import ClaimResult, claim, verdict
from gaitsweep.tasks.paper.lines import LONG, SHORT, TUNED, WALKERS, Paper, numbers
from gaitsweep.tasks.paper.zero_slope import VANISHING
from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.walkers.catalogue import CATALOGUE


@claim("M1")
def diagonal(paper: Paper) -> ClaimResult:
    """Evaluate the contact mass matrices at stance angle zero."""
    M = {w: contact_mass(CATALOGUE[w], np.zeros(1))[0] for w in TUNED}
    deviation = max(max(abs(m[0, 1]), abs(m[1, 1] - 1)) for m in M.values())
    light = {
        f"{r:g}": contact_mass(paper.line("E", foot_mass_ratio=r).walker, np.zeros(1))[0, 0, 0] / r
        for r in (0.1, 0.01, 1e-3, 1e-4)
    }
    untuned = contact_mass(CATALOGUE["physical"], np.zeros(1))[0, 0, 1]
    return ClaimResult(
        f"off-diagonal entry and deviation of M_yy from the total mass at most {deviation:g} of it (untuned physical "
        f"walker: {untuned:.2g}); M_xx over the foot mass, at foot mass ratios {numbers(light, 5)}",
        verdict(deviation < 1e-14 and abs(light["0.0001"] - 1) < 1e-3),
        float(light["0.0001"]),
    )


@claim("M2")
def balance(paper: Paper) -> ClaimResult:
    """Compare the losses of the impacts with the loss of potential energy."""
    worst = {}
    for name in WALKERS:
        imbalance = paper.line(name).grid(1e-6, 0.2, 85)["energy_imbalance"]
        worst[name] = float(np.nanmax(np.abs(imbalance)))
    return ClaimResult(
        f"relative difference of impact losses and loss of potential energy at most {numbers(worst, 2)} over slopes "
        f"1e-6 to 0.2",
        verdict(max(worst.values()) < 1e-12, max(worst.values()) < 1e-10),
        max(worst.values()),
    )


@claim("M3")
def exponents(paper: Paper) -> ClaimResult:
    """Compute the exponents of the stance angle at a vanishing slope."""
    exponent = paper.exponents_of_both(TUNED, VANISHING)
    deviation = max(min(abs(p - 1), abs(p - 1 / 3)) for p in exponent.values())
    return ClaimResult(
        f"exponents at slope {VANISHING:g}: {numbers(exponent, 6)}", verdict(deviation < 1e-3), deviation
    )


@claim("M4")
def powers(paper: Paper) -> ClaimResult:
    """Compute the exponents of power in speed at a vanishing slope."""
    exponent = paper.exponents_of_both(TUNED, VANISHING, "power", "speed")
    steps = paper.exponents_of_both(TUNED, VANISHING)
    agrees = [abs(power - (4 if steps[gait] < 2 / 3 else 2)) < 0.01 for gait, power in exponent.items()]
    return ClaimResult(
        f"P ~ v^p at slope {VANISHING:g}: {numbers(exponent, 5)}",
        verdict(all(agrees)),
        exponent["E long"],
    )


@claim("M5")
def kneestrike(paper: Paper) -> ClaimResult:
    """Compute the exponent of the kneestrike loss in speed."""
    exponent = paper.line("C").exponents(VANISHING, "loss_kneestrike", "speed")
    grid = paper.line("C").grid()
    losses = sum(grid[k][0, :2] for k in ("loss_normal", "loss_tangential", "loss_kneestrike"))
    share = grid["loss_kneestrike"][0, :2] / losses
    return ClaimResult(
        f"exponents at slope {VANISHING:g}: {numbers(exponent, 6)}; share of the kneestrike loss in all losses at "
        f"slope 1e-8: long {share[0]:.4f}, short {share[1]:.4f}",
        verdict(max(abs(p - 2) for p in exponent.values()) < 1e-3),
        exponent["long"],
    )


def _power_at(paper: Paper, walker: str, gait: int, froude: float) -> float:
    """Power over weight and sqrt(g leg) of a gait at a given Froude speed: that speed times its slope."""
    grid = paper.line(walker).grid()
    speed = grid["froude_speed"][:, gait]
    return float(np.exp(np.interp(np.log(froude), np.log(speed), np.log(grid["slope"] * speed))))


@claim("M6")
def cheaper(paper: Paper) -> ClaimResult:
    """Compare the power of both gaits at equal Froude speeds."""
    speeds = (0.01, 0.03)
    ratio = {v: {w: _power_at(paper, w, SHORT, v) / _power_at(paper, w, LONG, v) for w in TUNED} for v in speeds}
    tuned = [ratio[0.01][w] for w in TUNED if w != "D"]
    return ClaimResult(
        f"ratio of power, short step over long step, at Froude speed 0.01: {numbers(ratio[0.01], 3)}; at "
        f"0.03: {numbers(ratio[0.03], 3)} (D has no tangential loss)",
        verdict(min(tuned) > 5, min(tuned) > 2),
        ratio[0.01]["E"],
    )


@claim("M7")
def freed_knee(paper: Paper) -> ClaimResult:
    """Compare the contact mass matrices of C with its knee free and locked."""
    change = {}
    for hip in (0.0, 10.0, 100.0):
        kneed = replace(CATALOGUE["C"], m_h=hip)
        free, locked = (contact_mass(replace(kneed, knees=k), np.array([0.1]))[0] for k in (True, False))
        change[f"{hip:g} kg"] = float(np.linalg.norm(free - locked) / np.linalg.norm(locked))
    hipless = change["0 kg"]
    return ClaimResult(
        f"|M_free - M_locked|/|M_locked| of C at stance angle 0.1 with a hip mass of {numbers(change, 3)}",
        verdict(hipless < 0.05 and change["100 kg"] < hipless, change["100 kg"] < hipless),
        hipless,
    )


@claim("W1")
def silly_wheel(paper: Paper) -> ClaimResult:
    """Compute the slope and the mismatch of leg rates that a given long step of B needs, as its feet grow."""
    need, mismatch = {}, {}
    for radius in (0.2, 0.5, 0.8, 0.9, 0.95, 0.98):
        problem = Problem(replace(CATALOGUE["B"], R=radius))
        # Slope for an angle of about 0.1, from angle^3 = slope (l + R)/(l k)^2 with k near 1.
        slope = 1e-3 * problem.walker.l**2 / problem.walker.leg
        w, stride, steps = search(problem, slope)
        if stride is None or steps is None:
            continue
        long = np.nonzero(steps.anthropomorphic & (gait_ratio(stride) < 0.5))[0]
        if len(long):
            angle = float(np.exp(w[0, long[-1]]))
            need[f"{radius:g}"] = slope / angle**3
            mismatch[f"{radius:g}"] = float(gait_ratio(stride)[long[-1]]) / angle**2
    values = list(mismatch.values())
    return ClaimResult(
        f"long gait of B with foot radius R, slope/angle^3: {numbers(need, 3)}; mismatch of the legs' rates over "
        f"(stance rate x angle^2): {numbers(mismatch, 3)}; for a given step length both vanish as R tends to "
        f"the leg length",
        verdict(values[-1] < 0.2 * values[0] and list(need.values())[-1] < 0.05 * need["0.2"]),
        values[-1],
    )


@claim("G2")
def dimension(paper: Paper) -> ClaimResult:
    """Evaluate the multipliers of the physical walker, kneed and straight-legged."""
    gaits = (paper.line(walker).at([0.036]) for walker in ("physical", "physical-straight"))
    four, three = (np.hypot(g["multiplier_real"][0, LONG], g["multiplier_imag"][0, LONG]) for g in gaits)
    return ClaimResult(
        f"magnitudes of multipliers at slope 0.036: kneed {', '.join(f'{x:.6g}' for x in four)}; straight-legged "
        f"{', '.join(f'{x:.6g}' for x in three)}",
        verdict(bool(four[3] == 0 and four[2] > 1e-9 and three[2] > 1e-9)),
        float(four[2]),
    )
