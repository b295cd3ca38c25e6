"""Energy, scaling and the general claims (sections 2.2, 4.1, 5.3 and 6 of the paper)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gaitsweep.tasks.gaits.search import search
from gaitsweep.tasks.gaits.step_check import LONG_BELOW, gait_ratio
from gaitsweep.tasks.ledger.claim import Found, claim, farthest, found, verdict
from gaitsweep.tasks.ledger.lines import LONG, SHORT, TUNED, WALKERS, Paper
from gaitsweep.tasks.ledger.zero_slope import VANISHING
from gaitsweep.tasks.measures.losses import contact_mass
from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.walkers.catalogue import CATALOGUE
from gaitsweep.tasks.walkers.walker import Walker


@claim("M1")
def diagonal(paper: Paper) -> Found:
    """Evaluate the contact mass matrices at stance angle zero."""

    def mass(walker: Walker) -> np.ndarray:
        (matrix,) = contact_mass(walker, np.zeros(1))
        return matrix

    deviation = 0.0
    for name in TUNED:
        M = mass(CATALOGUE[name])
        deviation = max(deviation, abs(M[0, 1]), abs(M[1, 1] - 1))

    light = {}
    for ratio in (0.1, 0.01, 1e-3, 1e-4):
        walker = paper.line("E", foot_mass_ratio=ratio).walker
        light[f"{ratio:g}"] = mass(walker)[0, 0] / ratio

    untuned = mass(CATALOGUE["physical"])[0, 1]
    least = light["0.0001"]
    holds = verdict(deviation < 1e-14 and abs(least - 1) < 1e-3)
    return found(holds, least, deviation=deviation, untuned=untuned, light=light)


@claim("M2")
def balance(paper: Paper) -> Found:
    """Compare the losses of the impacts with the loss of potential energy."""
    worst = {}
    for name in WALKERS:
        grid = paper.line(name).grid(1e-6, 0.2, 85)
        worst[name] = np.nanmax(np.abs(grid["energy_imbalance"]))
    most = max(worst.values())
    holds = verdict(most < 1e-12, most < 1e-10)
    return found(holds, most, worst=worst)


@claim("M3")
def exponents(paper: Paper) -> Found:
    """Compute the exponents of the stance angle at a vanishing slope."""
    exponent = paper.exponents_of_both(TUNED, VANISHING)
    deviation = 0.0
    for power in exponent.values():
        off = min(abs(power - 1), abs(power - 1 / 3))
        deviation = max(deviation, off)
    return found(verdict(deviation < 1e-3), deviation, exponent=exponent)


@claim("M4")
def powers(paper: Paper) -> Found:
    """Compute the exponents of power in speed at a vanishing slope."""
    exponent = paper.exponents_of_both(TUNED, VANISHING, "power", "speed")
    steps = paper.exponents_of_both(TUNED, VANISHING)
    agrees = True
    for gait, power in exponent.items():
        wanted = 4 if steps[gait] < 2 / 3 else 2
        agrees &= abs(power - wanted) < 0.01
    return found(verdict(agrees), exponent["E long"], exponent=exponent)


@claim("M5")
def kneestrike(paper: Paper) -> Found:
    """Compute the exponent of the kneestrike loss in speed."""
    exponent = paper.line("C").exponents(VANISHING, "loss_kneestrike", "speed")
    grid = paper.line("C").grid()
    names = ("loss_normal", "loss_tangential", "loss_kneestrike")
    losses = sum(grid[name][0, :2] for name in names)
    share = grid["loss_kneestrike"][0, :2] / losses
    holds = verdict(farthest(exponent.values(), 2) < 1e-3)
    return found(holds, exponent["long"], exponent=exponent, share=share)


def _power_at(paper: Paper, walker: str, gait: int, froude: float) -> float:
    """Power over weight and sqrt(g leg) of a gait at a given Froude speed: that speed
    times its slope.
    """
    grid = paper.line(walker).grid()
    speed = grid["froude_speed"][:, gait]
    log_speed = np.log(speed)
    log_power = np.log(grid["slope"] * speed)
    found_power = np.interp(np.log(froude), log_speed, log_power)
    return float(np.exp(found_power))


@claim("M6")
def cheaper(paper: Paper) -> Found:
    """Compare the power of both gaits at equal Froude speeds."""

    def ratios(speed: float) -> dict[str, float]:
        found_ratios = {}
        for walker in TUNED:
            short = _power_at(paper, walker, SHORT, speed)
            found_ratios[walker] = short / _power_at(paper, walker, LONG, speed)
        return found_ratios

    slow, fast = ratios(0.01), ratios(0.03)
    least = min(slow[w] for w in TUNED if w != "D")
    holds = verdict(least > 5, least > 2)
    return found(holds, slow["E"], slow=slow, fast=fast)


@claim("M7")
def freed_knee(paper: Paper) -> Found:
    """Compare the contact mass matrices of C with its knee free and locked."""
    change = {}
    for hip in (0.0, 10.0, 100.0):
        kneed = replace(CATALOGUE["C"], m_h=hip)
        straight = replace(kneed, knees=False)
        (free,) = contact_mass(kneed, np.array([0.1]))
        (locked,) = contact_mass(straight, np.array([0.1]))
        off = np.linalg.norm(free - locked)
        change[f"{hip:g} kg"] = off / np.linalg.norm(locked)

    hipless = change["0 kg"]
    falls = change["100 kg"] < hipless
    holds = verdict(hipless < 0.05 and falls, falls)
    return found(holds, hipless, change=change)


@claim("W1")
def silly_wheel(paper: Paper) -> Found:
    """Compute the slope and the mismatch of leg rates that a given long step of B
    needs, as its feet grow.
    """
    need: dict[str, float] = {}
    mismatch: dict[str, float] = {}
    for radius in (0.2, 0.5, 0.8, 0.9, 0.95, 0.98):
        problem = Problem(replace(CATALOGUE["B"], R=radius))
        # Slope for an angle of about 0.1, from angle^3 = slope (l + R)/(l k)^2 with k
        # near 1.
        slope = 1e-3 * problem.walker.l**2 / problem.walker.leg
        w, stride, steps = search(problem, slope)
        if stride is None or steps is None:
            continue

        ratio = gait_ratio(stride)
        is_long = steps.anthropomorphic & (ratio < LONG_BELOW)
        if is_long.any():
            last_long = np.flatnonzero(is_long)[-1]
            angle = float(np.exp(w[0, last_long]))
            name = f"{radius:g}"
            need[name] = slope / angle**3
            mismatch[name] = float(ratio[last_long]) / angle**2

    first, *_, last = mismatch.values()
    *_, last_need = need.values()
    holds = verdict(last < 0.2 * first and last_need < 0.05 * need["0.2"])
    return found(holds, last, need=need, mismatch=mismatch)


@claim("G2")
def dimension(paper: Paper) -> Found:
    """Evaluate the multipliers of the physical walker, kneed and straight-legged."""

    def magnitudes(walker: str) -> np.ndarray:
        gait = paper.line(walker).at([0.036])
        real = gait["multiplier_real"][0, LONG]
        imaginary = gait["multiplier_imag"][0, LONG]
        return np.asarray(np.hypot(real, imaginary))

    four = magnitudes("physical")
    three = magnitudes("physical-straight")
    holds = four[3] == 0 and four[2] > 1e-9 and three[2] > 1e-9

    return found(
        verdict(holds),
        four[2],
        four=four,
        three=three,
    )
