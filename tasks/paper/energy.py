"""Energy, scaling and the general claims (sections 2.2, 4.1, 5.3 and 6 of the paper)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gaitsweep.tasks.fixed_points.search import search
from gaitsweep.tasks.fixed_points.step_check import LONG_BELOW, gait_ratio
from gaitsweep.tasks.measures.losses import contact_mass
from gaitsweep.tasks.paper.claim import Found, claim, found, verdict
from gaitsweep.tasks.paper.lines import LONG, SHORT, TUNED, WALKERS, Paper
from gaitsweep.tasks.paper.zero_slope import VANISHING
from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.walkers.catalogue import CATALOGUE


@claim("M1")
def diagonal(paper: Paper) -> Found:
    """Evaluate the contact mass matrices at stance angle zero."""
    M = [contact_mass(CATALOGUE[w], np.zeros(1))[0] for w in TUNED]
    deviation = max(max(abs(m[0, 1]), abs(m[1, 1] - 1)) for m in M)
    light = {
        f"{r:g}": contact_mass(paper.line("E", foot_mass_ratio=r).walker, np.zeros(1))[
            0, 0, 0
        ]
        / r
        for r in (0.1, 0.01, 1e-3, 1e-4)
    }
    untuned = contact_mass(CATALOGUE["physical"], np.zeros(1))[0, 0, 1]
    least = light["0.0001"]
    holds = verdict(deviation < 1e-14 and abs(least - 1) < 1e-3)
    return found(holds, least, deviation=deviation, untuned=untuned, light=light)


@claim("M2")
def balance(paper: Paper) -> Found:
    """Compare the losses of the impacts with the loss of potential energy."""
    imbalance = {
        name: paper.line(name).grid(1e-6, 0.2, 85)["energy_imbalance"]
        for name in WALKERS
    }
    worst = {name: np.nanmax(np.abs(each)) for name, each in imbalance.items()}
    most = max(worst.values())
    return found(verdict(most < 1e-12, most < 1e-10), most, worst=worst)


@claim("M3")
def exponents(paper: Paper) -> Found:
    """Compute the exponents of the stance angle at a vanishing slope."""
    exponent = paper.exponents_of_both(TUNED, VANISHING)
    deviation = max(min(abs(p - 1), abs(p - 1 / 3)) for p in exponent.values())
    return found(verdict(deviation < 1e-3), deviation, exponent=exponent)


@claim("M4")
def powers(paper: Paper) -> Found:
    """Compute the exponents of power in speed at a vanishing slope."""
    exponent = paper.exponents_of_both(TUNED, VANISHING, "power", "speed")
    steps = paper.exponents_of_both(TUNED, VANISHING)
    agrees = [
        abs(power - (4 if steps[gait] < 2 / 3 else 2)) < 0.01
        for gait, power in exponent.items()
    ]
    return found(verdict(all(agrees)), exponent["E long"], exponent=exponent)


@claim("M5")
def kneestrike(paper: Paper) -> Found:
    """Compute the exponent of the kneestrike loss in speed."""
    exponent = paper.line("C").exponents(VANISHING, "loss_kneestrike", "speed")
    grid = paper.line("C").grid()
    losses = sum(
        grid[k][0, :2] for k in ("loss_normal", "loss_tangential", "loss_kneestrike")
    )
    share = grid["loss_kneestrike"][0, :2] / losses
    holds = verdict(max(abs(p - 2) for p in exponent.values()) < 1e-3)
    return found(holds, exponent["long"], exponent=exponent, share=share)


def _power_at(paper: Paper, walker: str, gait: int, froude: float) -> float:
    """Power over weight and sqrt(g leg) of a gait at a given Froude speed: that speed
    times its slope.
    """
    grid = paper.line(walker).grid()
    speed = grid["froude_speed"][:, gait]
    return float(
        np.exp(np.interp(np.log(froude), np.log(speed), np.log(grid["slope"] * speed)))
    )


@claim("M6")
def cheaper(paper: Paper) -> Found:
    """Compare the power of both gaits at equal Froude speeds."""
    slow, fast = (
        {
            w: _power_at(paper, w, SHORT, speed) / _power_at(paper, w, LONG, speed)
            for w in TUNED
        }
        for speed in (0.01, 0.03)
    )
    least = min(slow[w] for w in TUNED if w != "D")
    return found(verdict(least > 5, least > 2), slow["E"], slow=slow, fast=fast)


@claim("M7")
def freed_knee(paper: Paper) -> Found:
    """Compare the contact mass matrices of C with its knee free and locked."""
    change = {}
    for hip in (0.0, 10.0, 100.0):
        kneed = replace(CATALOGUE["C"], m_h=hip)
        free, locked = (
            contact_mass(replace(kneed, knees=k), np.array([0.1]))[0]
            for k in (True, False)
        )
        change[f"{hip:g} kg"] = np.linalg.norm(free - locked) / np.linalg.norm(locked)
    hipless, falls = change["0 kg"], change["100 kg"] < change["0 kg"]
    return found(verdict(hipless < 0.05 and falls, falls), hipless, change=change)


@claim("W1")
def silly_wheel(paper: Paper) -> Found:
    """Compute the slope and the mismatch of leg rates that a given long step of B
    needs, as its feet grow.
    """
    need, mismatch = {}, {}
    for radius in (0.2, 0.5, 0.8, 0.9, 0.95, 0.98):
        problem = Problem(replace(CATALOGUE["B"], R=radius))
        # Slope for an angle of about 0.1, from angle^3 = slope (l + R)/(l k)^2 with k
        # near 1.
        slope = 1e-3 * problem.walker.l**2 / problem.walker.leg
        w, stride, steps = search(problem, slope)
        if stride is None or steps is None:
            continue
        long = np.nonzero(steps.anthropomorphic & (gait_ratio(stride) < LONG_BELOW))[0]
        if len(long):
            angle = float(np.exp(w[0, long[-1]]))
            need[f"{radius:g}"] = slope / angle**3
            mismatch[f"{radius:g}"] = float(gait_ratio(stride)[long[-1]]) / angle**2
    values = list(mismatch.values())
    holds = verdict(
        values[-1] < 0.2 * values[0] and list(need.values())[-1] < 0.05 * need["0.2"]
    )
    return found(holds, values[-1], need=need, mismatch=mismatch)


@claim("G2")
def dimension(paper: Paper) -> Found:
    """Evaluate the multipliers of the physical walker, kneed and straight-legged."""
    gaits = (
        paper.line(walker).at([0.036]) for walker in ("physical", "physical-straight")
    )
    four, three = (
        np.hypot(g["multiplier_real"][0, LONG], g["multiplier_imag"][0, LONG])
        for g in gaits
    )
    return found(
        verdict(four[3] == 0 and four[2] > 1e-9 and three[2] > 1e-9),
        four[2],
        four=four,
        three=three,
    )
