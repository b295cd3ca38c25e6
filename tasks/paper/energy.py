"""Energy, scaling and the general claims (sections 2.2, 4.1, 5.3 and 6 of the paper)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tasks.fixed_points.search import search
from tasks.fixed_points.step_check import gait_ratio
from tasks.measures.losses import contact_mass
from tasks.paper.claim import ClaimResult, claim, verdict
from tasks.paper.lines import LONG, SHORT, TUNED, line, numbers
from tasks.paper.zero_slope import VANISHING
from tasks.step.problem import Problem
from tasks.walkers.catalogue import CATALOGUE

_RUN = "gaitsweep run data/studies/paper/figure11.toml"


@claim(
    "M1",
    "the contact mass matrix of zero-slope walkers is diagonal, total mass along y, foot mass along x",
    "section 6.1",
    "figure5/loglog",
    "gaitsweep walkers E",
)
def diagonal() -> ClaimResult:
    M = {w: contact_mass(CATALOGUE[w], np.zeros(1))[0] for w in TUNED}
    off = max(max(abs(m[0, 1]), abs(m[1, 1] - 1)) for m in M.values())
    light = {
        f"{r:g}": contact_mass(line("E", foot_mass_ratio=r).walker, np.zeros(1))[0, 0, 0] / r
        for r in (0.1, 0.01, 1e-3, 1e-4)
    }
    other = contact_mass(CATALOGUE["physical"], np.zeros(1))[0, 0, 1]
    return ClaimResult(
        f"off-diagonal and y - 1 at most {off:g} of the total mass (the untuned machine: {other:.2g}); x "
        f"over the foot's mass at {numbers(light, 5)}",
        verdict(off < 1e-14 and abs(light["0.0001"] - 1) < 1e-3),
        float(light["0.0001"]),
    )


@claim("M2", "losses equal the drop in height", "sections 3 and 6.2", "figure11/loglog", _RUN)
def balance() -> ClaimResult:
    worst = {}
    for name in (*TUNED, "physical", "physical-straight"):
        found = line(name).grid(1e-6, 0.2, 85)["energy_imbalance"]
        worst[name] = float(np.nanmax(np.abs(found)))
    return ClaimResult(
        f"losses of the impacts less the drop, over the drop, at most {numbers(worst, 2)} from 1e-6 to 0.2",
        verdict(max(worst.values()) < 1e-12, max(worst.values()) < 1e-10),
        max(worst.values()),
    )


@claim("M3", "step lengths can scale as slope or as slope^(1/3) only", "sections 6.2 and 6.4", "figure11/loglog", _RUN)
def exponents() -> ClaimResult:
    found = {
        f"{w} {name}": line(w).exponent(g, VANISHING) for w in TUNED for g, name in ((LONG, "long"), (SHORT, "short"))
    }
    off = max(min(abs(p - 1), abs(p - 1 / 3)) for p in found.values())
    return ClaimResult(f"at {VANISHING:g}: {numbers(found, 6)}", verdict(off < 1e-3), off)


@claim(
    "M4",
    "power ~ speed^4 where steps scale as slope^(1/3), speed^2 where they scale as slope",
    "section 5.3",
    "figure11/loglog",
    _RUN,
)
def powers() -> ClaimResult:
    found, right = {}, []
    for name in TUNED:
        for g, gait in ((LONG, "long"), (SHORT, "short")):
            power = line(name).exponent(g, VANISHING, "power", "speed")
            step = line(name).exponent(g, VANISHING)
            found[f"{name} {gait}"] = power
            right.append(abs(power - (4 if step < 2 / 3 else 2)) < 0.01)
    return ClaimResult(f"P ~ v^p at {VANISHING:g}: {numbers(found, 5)}", verdict(all(right)), found["E long"])


@claim(
    "M5",
    "the loss at kneestrike goes as speed^2",
    "section 6.4",
    "figure11/loglog",
    "gaitsweep solve --walker C --slope 1e-5 --json",
)
def kneestrike() -> ClaimResult:
    found = {
        gait: line("C").exponent(g, VANISHING, "loss_kneestrike", "speed")
        for g, gait in ((LONG, "long"), (SHORT, "short"))
    }
    grid = line("C").grid()
    losses = sum(grid[k][0, :2] for k in ("loss_normal", "loss_tangential", "loss_kneestrike"))
    share = grid["loss_kneestrike"][0, :2] / losses
    return ClaimResult(
        f"exponents at {VANISHING:g}: {numbers(found, 6)}; its share of all losses at 1e-8: long "
        f"{share[0]:.4f}, short {share[1]:.4f}",
        verdict(max(abs(p - 2) for p in found.values()) < 1e-3),
        found["long"],
    )


def power_at(walker: str, gait: int, froude: float) -> float:
    """Power over weight and sqrt(g leg) of a gait at a given Froude speed: that speed times the sine of its slope."""
    grid = line(walker).grid()
    speed = grid["froude_speed"][:, gait]
    return float(np.exp(np.interp(np.log(froude), np.log(speed), np.log(grid["slope"] * speed))))


@claim("M6", "at a given small speed the long step needs far less power", "section 5.3", "figure11/loglog", _RUN)
def cheaper() -> ClaimResult:
    speeds = (0.01, 0.03)
    ratio = {v: {w: power_at(w, SHORT, v) / power_at(w, LONG, v) for w in TUNED} for v in speeds}
    tuned = [ratio[0.01][w] for w in TUNED if w != "D"]
    return ClaimResult(
        f"power of the short step over the long one's at Froude speed 0.01: {numbers(ratio[0.01], 3)}; at "
        f"0.03: {numbers(ratio[0.03], 3)} (D has no tangential loss)",
        verdict(min(tuned) > 5, min(tuned) > 2),
        ratio[0.01]["E"],
    )


@claim(
    "M7",
    "freeing the knee changes the contact mass little when the hip is heavy",
    "section 6.4",
    "figure11/loglog",
    "gaitsweep walkers C",
)
def freed_knee() -> ClaimResult:
    change = {}
    for hip in (0.0, 10.0, 100.0):
        kneed = replace(CATALOGUE["C"], m_h=hip)
        free, locked = (contact_mass(replace(kneed, knees=k), np.array([0.1]))[0] for k in (True, False))
        change[f"{hip:g} kg"] = float(np.linalg.norm(free - locked) / np.linalg.norm(locked))
    own = change["0 kg"]
    return ClaimResult(
        f"|M free - M locked|/|M locked| of C at angle 0.1 with a hip mass of {numbers(change, 3)}",
        verdict(own < 0.05 and change["100 kg"] < own, change["100 kg"] < own),
        own,
    )


@claim(
    "W1",
    "as the foot's radius nears the leg's length the long gait changes support like a rolling wheel",
    "section 4.1",
    "figure11/loglog",
    "gaitsweep solve --walker B --set R=0.9 --slope 1e-4 --json",
)
def silly_wheel() -> ClaimResult:
    need, mismatch = {}, {}
    for radius in (0.2, 0.5, 0.8, 0.9, 0.95, 0.98):
        problem = Problem(replace(CATALOGUE["B"], R=radius))
        # Slope for an angle of about 0.1, from angle^3 = slope (l + R)/(l k)^2 with k near 1.
        slope = 1e-3 * problem.walker.l**2 / problem.walker.leg
        w, stride, verify_steps = search(problem, slope)
        if stride is None or verify_steps is None:
            continue
        long = np.nonzero(verify_steps.anthropomorphic & (gait_ratio(stride) < 0.5))[0]
        if len(long):
            angle = float(np.exp(w[0, long[-1]]))
            need[f"{radius:g}"] = slope / angle**3
            mismatch[f"{radius:g}"] = float(gait_ratio(stride)[long[-1]]) / angle**2
    values = list(mismatch.values())
    return ClaimResult(
        f"long gait of B with R of {', '.join(need)}: slope over angle^3 {numbers(need, 3)}; mismatch of "
        f"the legs' rates over stance rate and angle^2 {numbers(mismatch, 3)}: at a given step both "
        f"vanish with leg - R",
        verdict(values[-1] < 0.2 * values[0] and list(need.values())[-1] < 0.05 * need["0.2"]),
        values[-1],
    )


@claim(
    "G2",
    "the map is three-dimensional; with knees a superficial multiplier is exactly zero",
    "section 2.2",
    "figure6/locus",
    "gaitsweep solve --walker physical --slope 0.036 --json",
)
def dimension() -> ClaimResult:
    kneed, straight = line("physical").at([0.036]), line("physical-straight").at([0.036])
    four = np.hypot(kneed["multiplier_real"][0, LONG], kneed["multiplier_imag"][0, LONG])
    three = np.hypot(straight["multiplier_real"][0, LONG], straight["multiplier_imag"][0, LONG])
    return ClaimResult(
        f"|multipliers| at 0.036: kneed {', '.join(f'{x:.6g}' for x in four)}; straight "
        f"{', '.join(f'{x:.6g}' for x in three)}",
        verdict(bool(four[3] == 0 and four[2] > 1e-9 and three[2] > 1e-9)),
        float(four[2]),
    )
