"""Appendix A of the paper: what the simulated gaits take for granted, and by how much they break it."""

from __future__ import annotations

import numpy as np

from tasks.paper.claim import ClaimResult, claim, verdict
from tasks.paper.lines import LONG, SHORT, Arrays, line
from tasks.registry import VARIABLES, VIOLATIONS

_WANT = ("stance_angle", *(v for v in VARIABLES if VARIABLES[v].group == "violations"))
#: Walkers and slopes, those of the paper's figures, whose gaits are looked through.
_WALKERS = ("A", "B", "C", "D", "E", "physical", "physical-straight")
_SLOPES = (1e-5, 1e-4, 1e-3, 0.01, 0.02, 0.025, 0.03, 0.036, 0.045, 0.06, 0.1)
_STRAIGHT = ("A", "B", "D", "E", "physical-straight")


def _measured(walker: str, slopes: tuple[float, ...]) -> Arrays:
    return line(walker).at(list(slopes), _WANT)


def _flagged(found: Arrays, name: str) -> np.ndarray:
    """Where a gait is flagged, among those there are; shape (n,)."""
    there = np.isfinite(found["stance_angle"])
    return (found["violations"][there] >> VIOLATIONS.index(name) & 1).astype(bool)


@claim(
    "A1",
    "straight legs always scuff, kneed legs need not",
    "appendix A, 1",
    "figure3/angles",
    "gaitsweep solve --walker physical --slope 0.036 --json",
)
def scuffing() -> ClaimResult:
    straight = np.concatenate([_flagged(_measured(w, _SLOPES), "scuff") for w in _STRAIGHT])
    kneed = np.concatenate([_flagged(_measured(w, _SLOPES), "scuff") for w in ("C", "physical")])
    depth = _measured("physical", (0.036,))["scuff_depth"][0, LONG]
    return ClaimResult(
        f"{straight.sum()} of {len(straight)} straight-legged gaits scuff, {kneed.sum()} of {len(kneed)} "
        f"kneed ones; the gait of figure 3 by {1e3 * depth:.3g} mm",
        verdict(bool(straight.all()) and not kneed.all()),
        float(depth),
    )


@claim(
    "A2",
    "the gait of figure 3 has a slight unlocking impulse at the stance knee at kneestrike, and re-engages after it",
    "appendix A, 2",
    "figure3/angles",
    "gaitsweep solve --walker physical --slope 0.036 --json",
)
def unlocking() -> ClaimResult:
    found = {
        k: float(v[0, LONG])
        for k, v in _measured("physical", (0.036,)).items()
        if v.ndim == 2 and k.startswith("unlocking")
    }
    impulse = found["unlocking_impulse_kneestrike"]
    torque = found["unlocking_torque"]
    return ClaimResult(
        f"unlocking impulse {impulse:.4g} N m s at kneestrike, {found['unlocking_impulse_heelstrike']:.4g} "
        f"at heelstrike; the largest unlocking torque over the step is {torque:.4g} N m, at "
        f"{found['unlocking_torque_time']:.3f} s (negative: held by the stop)",
        verdict(impulse > 0 and torque < 0, impulse > 0),
        impulse,
    )


@claim(
    "A3",
    "no contact tension; enough friction is assumed",
    "appendix A, 3",
    "figure3/angles",
    "gaitsweep solve --walker physical --slope 0.036 --json",
)
def tension() -> ClaimResult:
    names = (*_STRAIGHT, "C", "physical")
    found = {w: _measured(w, _SLOPES) for w in names}
    least = min(float(np.nanmin(f["least_normal_force"])) for f in found.values())
    tense = sum(int(_flagged(f, "contact_tension").sum()) for f in found.values())
    figure3 = _SLOPES.index(0.036)
    demand = {
        k: float(found["physical"][k][figure3, LONG])
        for k in ("friction_demand", "friction_demand_heelstrike", "friction_demand_kneestrike")
    }
    return ClaimResult(
        f"least normal force {least:.3f} of the weight over gaits of {', '.join(names)} at slopes from "
        f"1e-5 to 0.1; the ground would have to pull at an impact in {tense} of them; friction asked of "
        f"the gait of figure 3: {demand['friction_demand']:.3f} in motion, "
        f"{demand['friction_demand_heelstrike']:.3f} at heelstrike, "
        f"{demand['friction_demand_kneestrike']:.3f} at kneestrike",
        verdict(least > 0 and not tense, least > 0),
        least,
    )


@claim(
    "A4",
    "some non-tuned kneed walkers would hyperextend at release at very small steps",
    "appendix A, 4",
    "figure6/locus",
    "gaitsweep solve --walker C --slope 1e-4 --json",
)
def hyperextension() -> ClaimResult:
    release = line("physical").special_of("release_hyperextension")
    exact = {
        ("long", "short")[p["branch"] != _branch_of("C")]: p["slope"]
        for p in line("C").special_of("release_hyperextension")
    }
    deep = _measured("C", (1e-4,))["hyperextension"][0]
    tuned = ", ".join(f"{k} below {s:.7g}" for k, s in sorted(exact.items()))
    return ClaimResult(
        f"the machine does below angle {release[0]['stance_angle']:.5f} (point 3, slope "
        f"{release[0]['slope']:.6f}); so does the tuned walker C: {tuned}; at 1e-4 by "
        f"{deep[LONG]:.2g} and {deep[SHORT]:.2g} rad",
        verdict(bool(release)),
        release[0]["slope"],
    )


def _branch_of(walker: str) -> int:
    """Number of the branch with a walker's long step."""
    own = line(walker)
    return next(k for k in range(len(own.branches)) if not own.curve(k)["short"][len(own.branches[k].q) // 2])


def _count(name: str) -> tuple[int, int, str]:
    """How many gaits are flagged, of how many, and of which walkers."""
    flags = {w: _flagged(_measured(w, _SLOPES), name) for w in _WALKERS}
    said = ", ".join(f"{w} {f.sum()} of {len(f)}" for w, f in flags.items())
    return sum(int(f.sum()) for f in flags.values()), sum(len(f) for f in flags.values()), said


@claim(
    "A5",
    "at release the swing foot sometimes penetrates the ground at first",
    "appendix A, 5",
    "figure3/angles",
    "gaitsweep solve --walker physical-straight --slope 0.3 --json",
)
def penetration() -> ClaimResult:
    some, of, said = _count("release_penetrates")
    steep = _measured("physical-straight", (0.3,))
    return ClaimResult(
        f"{some} of {of} gaits at {len(_SLOPES)} slopes from 1e-5 to 0.1 ({said}); on steeper slopes it "
        f"happens: the machine with its knees locked at 0.3 by "
        f"{1e3 * np.nanmax(steep['penetration_depth']):.2g} mm",
        verdict(some > 0),
        float(some),
    )


@claim(
    "A6",
    "that no impulse acts on the trailing foot is self-consistent",
    "appendix A, 6",
    "figure3/angles",
    "gaitsweep solve --walker physical --slope 0.036 --json",
)
def trailing_foot() -> ClaimResult:
    some, of, said = _count("trailing_foot_pulls")
    steep = np.nanmax(_measured("physical-straight", (0.3,))["trailing_impulse"])
    return ClaimResult(
        f"two contacts would push the trailing foot in {some} of {of} gaits at {len(_SLOPES)} slopes from "
        f"1e-5 to 0.1 ({said}); on steeper slopes they do: the machine with its knees locked at 0.3 "
        f"by {steep:.2g} N s",
        verdict(some == 0, some < of / 10),
        float(some),
    )
