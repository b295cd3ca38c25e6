"""Appendix A of the paper: the assumptions of the model, and by how much the simulated gaits violate them."""

from __future__ import annotations

import numpy as np

from gaitsweep.tasks.paper.claim import ClaimResult, claim, verdict
from gaitsweep.tasks.paper.lines import BOTH, LONG, SHORT, Arrays, Paper, memoize
from gaitsweep.tasks.paper.rounding_intervals import interval
from gaitsweep.tasks.registry import VARIABLES, VIOLATIONS

_WANT = ("stance_angle", *(v for v in VARIABLES if VARIABLES[v].group == "violations"))
#: Walkers and slopes of the paper's figures, whose gaits are examined.
_WALKERS = ("A", "B", "C", "D", "E", "physical", "physical-straight")
_SLOPES = (1e-5, 1e-4, 1e-3, 0.01, 0.02, 0.025, 0.03, 0.036, 0.045, 0.06, 0.1)
_STRAIGHT = ("A", "B", "D", "E", "physical-straight")


@memoize
def _measure(paper: Paper, walker: str, slopes: tuple[float, ...]) -> Arrays:
    return paper.line(walker).at(list(slopes), _WANT)


def _of_figure_3(paper: Paper) -> dict[str, float]:
    """Violations of the gait of figure 3."""
    return {k: float(v[0, LONG]) for k, v in _measure(paper, "physical", (0.036,)).items() if v.ndim == 2}


def _flags(gaits: Arrays, name: str) -> np.ndarray:
    """Whether each existing gait violates an assumption at all, by however little, shape (n,)."""
    exists, violation = np.isfinite(gaits["stance_angle"]), VIOLATIONS[name]
    amounts = np.array([gaits[amount][exists] for amount in violation.amounts])
    return np.asarray((amounts < 0 if violation.is_least else amounts > 0).any(axis=0))


@claim("A1")
def scuffing(paper: Paper) -> ClaimResult:
    """Count the gaits whose swing foot scuffs."""
    straight = np.concatenate([_flags(_measure(paper, w, _SLOPES), "scuff") for w in _STRAIGHT])
    kneed = np.concatenate([_flags(_measure(paper, w, _SLOPES), "scuff") for w in ("C", "physical")])
    depth = _of_figure_3(paper)["scuff_depth"]
    return ClaimResult(
        f"{straight.sum()} of {len(straight)} straight-legged gaits and {kneed.sum()} of {len(kneed)} kneed gaits "
        f"scuff; scuff depth of the gait of figure 3: {1e3 * depth:.3g} mm",
        verdict(bool(straight.all()) and not kneed.all()),
        depth,
    )


@claim("A2")
def unlocking(paper: Paper) -> ClaimResult:
    """Evaluate impulses and torque on the stance knee of the gait of figure 3."""
    amounts = _of_figure_3(paper)
    impulse, torque = amounts["unlocking_impulse_kneestrike"], amounts["unlocking_torque"]
    return ClaimResult(
        f"unlocking impulse {impulse:.4g} N m s at kneestrike, {amounts['unlocking_impulse_heelstrike']:.4g} N m s "
        f"at heelstrike; largest unlocking torque over the step {torque:.4g} N m, at "
        f"{amounts['unlocking_torque_time']:.3f} s (negative: the knee stop holds)",
        verdict(impulse > 0 and torque < 0, impulse > 0),
        impulse,
    )


@claim("A3")
def tension(paper: Paper) -> ClaimResult:
    """Evaluate the least normal force and the friction that gaits demand."""
    names = (*_STRAIGHT, "C", "physical")
    gaits = {w: _measure(paper, w, _SLOPES) for w in names}
    least = min(float(np.nanmin(g["least_normal_force"])) for g in gaits.values())
    tense = sum(int(_flags(g, "contact_tension").sum()) for g in gaits.values())
    amounts = _of_figure_3(paper)
    return ClaimResult(
        f"least normal force {least:.3f} of the weight over gaits of {', '.join(names)} at slopes from "
        f"1e-5 to 0.1; an impact requires contact tension in {tense} of them; friction coefficient that the "
        f"gait of figure 3 requires: {amounts['friction_demand']:.3f} during the step, "
        f"{amounts['friction_demand_heelstrike']:.3f} at heelstrike, "
        f"{amounts['friction_demand_kneestrike']:.3f} at kneestrike",
        verdict(least > 0 and not tense, least > 0),
        least,
    )


@claim("A4")
def hyperextension(paper: Paper) -> ClaimResult:
    """Locate the slopes at which the released knee begins to hyperextend."""
    release = paper.line("physical").special_of("release_hyperextension")
    tuned = {label: interval(paper, f"C release, {label}").value for label in BOTH}
    deep = _measure(paper, "C", (1e-4,))["hyperextension"][0]
    limits = ", ".join(f"{k} step below slope {s:.7g}" for k, s in tuned.items())
    return ClaimResult(
        f"the physical walker hyperextends beyond point 3 (slope {release[0]['slope']:.6f}, stance angle "
        f"{release[0]['stance_angle']:.5f}), as does the tuned walker C: {limits}; at slope 1e-4 by "
        f"{deep[LONG]:.2g} rad (long) and {deep[SHORT]:.2g} rad (short)",
        verdict(bool(release)),
        release[0]["slope"],
    )


def _count(paper: Paper, name: str) -> tuple[int, int, str]:
    """Number of gaits that violate an assumption, number of all gaits, and both by walker in words."""
    flags = {w: _flags(_measure(paper, w, _SLOPES), name) for w in _WALKERS}
    by_walker = ", ".join(f"{w} {f.sum()} of {len(f)}" for w, f in flags.items())
    return sum(int(f.sum()) for f in flags.values()), sum(len(f) for f in flags.values()), by_walker


@claim("A5")
def penetration(paper: Paper) -> ClaimResult:
    """Count the gaits whose released foot penetrates the ground."""
    count, total, by_walker = _count(paper, "release_penetrates")
    steep = _measure(paper, "physical-straight", (0.3,))
    return ClaimResult(
        f"{count} of {total} gaits at {len(_SLOPES)} slopes from 1e-5 to 0.1 ({by_walker}); it occurs on steeper "
        f"slopes: the physical walker with locked knees at slope 0.3 by "
        f"{1e3 * np.nanmax(steep['penetration_depth']):.2g} mm",
        verdict(count > 0),
        float(count),
    )


@claim("A6")
def trailing_foot(paper: Paper) -> ClaimResult:
    """Count the gaits in which simultaneous contact of both feet would push the trailing foot."""
    count, total, by_walker = _count(paper, "trailing_foot_pulls")
    steep = np.nanmax(_measure(paper, "physical-straight", (0.3,))["trailing_impulse"])
    return ClaimResult(
        f"an impulse would act on the trailing foot in {count} of {total} gaits at {len(_SLOPES)} slopes from "
        f"1e-5 to 0.1 ({by_walker}); it does on steeper slopes: {steep:.2g} N s for the physical walker with locked "
        f"knees at slope 0.3",
        verdict(count == 0, count < total / 10),
        float(count),
    )
