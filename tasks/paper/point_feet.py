"""Point feet with mass: walkers E and F and lighter ones (section 4.1 of the paper)."""

from __future__ import annotations

import numpy as np

from gaitsweep.tasks.fit_laws import transition
from gaitsweep.tasks.paper.claim import APPROXIMATE, ClaimResult, claim, verdict
from gaitsweep.tasks.paper.lines import LONG, SHORT, Arrays, Paper, memoize, numbers
from gaitsweep.tasks.simulate_steps import section_problem
from gaitsweep.tasks.solve_points import lines

#: Foot mass ratios at which the transition is located, down to where the 3/2 power is exact.
RATIOS = (0.1, 0.05, 0.01, 1e-3, 1e-4, 1e-5)


@claim("E1")
def two_dimensional(paper: Paper) -> ClaimResult:
    """Evaluate the third multiplier of E and F."""
    worst = max(_third_multiplier(paper, w) for w in ("E", "F"))
    gaits = paper.line("E").at([0.01])
    zero = bool((gaits["multiplier_real"][0, :2, 2] == 0).all() and (gaits["multiplier_imag"][0, :2, 2] == 0).all())
    return ClaimResult(
        f"third multiplier exactly 0 on the two-dimensional section, {worst:.1g} on the general three-dimensional one",
        verdict(zero and worst < 1e-12),
        worst,
    )


def _third_multiplier(paper: Paper, walker: str) -> float:
    """Smallest multiplier of both gaits at slope 0.01 on the section of a general straight-legged walker."""
    problem = section_problem(paper.line(walker).walker)
    gaits = paper.line(walker).at([0.01])
    unit = problem.walker.time_unit
    angle = gaits["stance_angle"][0, :2]
    w = np.stack(
        [
            np.log(angle),
            gaits["stance_rate"][0, :2] / angle * unit,
            gaits["thigh_rate"][0, :2] / angle * unit,
            gaits["period"][0, :2] / unit,
        ]
    )
    stride, _ = problem.some(np.zeros(2, int)).stride(w, np.full(2, np.log(0.01)))
    return float(np.abs(np.linalg.eigvals(np.moveaxis(stride.jacobian, -1, 0))).min(axis=1).max())


@claim("E2")
def long_cube_root(paper: Paper) -> ClaimResult:
    """Compute the local exponents of the long step."""
    small = paper.exponents("EF", LONG, 1e-8)
    large = paper.exponents("EF", LONG, 0.05)
    deviation = max(abs(p - 1 / 3) for p in small.values())
    return ClaimResult(
        f"local exponents at slope 1e-8: {numbers(small, 6)}; at 0.05: {numbers(large)}",
        verdict(deviation < 1e-4 and max(abs(p - 1 / 3) for p in large.values()) < 0.05),
        small["E"],
    )


@claim("E3")
def short_two_laws(paper: Paper) -> ClaimResult:
    """Compute the local exponents of the short step on both sides of the transition."""
    small = paper.exponents("EF", SHORT, 1e-8)
    large = paper.exponents("EF", SHORT, 0.1)
    middle = paper.exponents("EF", SHORT, 0.01)
    light = paper.line("E", foot_mass_ratio=1e-4).exponent(SHORT, 1e-3)
    linear = max(abs(p - 1) for p in small.values()) < 1e-4
    cube = max(abs(p - 1 / 3) for p in large.values()) < 0.05 and abs(light - 1 / 3) < 0.01
    return ClaimResult(
        f"local exponents at slope 1e-8: {numbers(small, 6)}; at 0.1: {numbers(large)} (at 0.01 still "
        f"{middle['E']:.3f} and {middle['F']:.3f}); with a foot mass ratio of 1e-4 at slope 1e-3: {light:.4f}",
        verdict(linear and cube),
        large["E"],
    )


@memoize
def _transitions(paper: Paper) -> dict[str, np.ndarray]:
    """Tables of task `transition` for the foot mass ratios in `RATIOS`."""
    slope = np.geomspace(1e-11, 0.2, 220)
    each = [{"walker": "E", "set": {"foot_mass_ratio": r}} for r in RATIOS]
    solved = lines({"lines": each, "slope": slope, "want": ("stance_angle",)}, [])
    return transition({"lines": each}, [{"slope": slope, **points} for _, points in solved])


@claim("E4")
def transition_power(paper: Paper) -> ClaimResult:
    """Compute the ratio of transition slopes and their local exponent in the foot mass ratio."""
    table = _transitions(paper)
    exact = float(table["fits/transition_ratio/exact_asymptotes"][0])
    fitted = float(table["fits/transition_ratio/fitted_lines"][0])
    powers = table["fits/transition/local_exponent"][:-1]
    listed = ", ".join(f"{p:.4f}" for p in powers)
    tends = abs(powers[-1] - 1.5) < 0.01
    return ClaimResult(
        f"ratio of E to F {fitted:.3f} by fitted lines as in the paper, {exact:.3f} by the exact "
        f"asymptotes (2^1.5 = 2.828); local exponents between foot mass ratios "
        f"{', '.join(f'{r:g}' for r in RATIOS)}: {listed}, tending to 3/2",
        APPROXIMATE if tends else verdict(False),
        fitted,
    )


@claim("E5")
def similar_curves(paper: Paper) -> ClaimResult:
    """Compare the steps of E and F at equal slopes."""
    slopes = np.array([1e-6, 0.01, 0.05, 0.1, 0.2])
    e, f = (paper.line(w).at(slopes)["stance_angle"] for w in ("E", "F"))
    short, long = f[:, SHORT] / e[:, SHORT], f[:, LONG] / e[:, LONG]
    listed = ", ".join(f"{r:.4f} at {s:g}" for r, s in zip(short, slopes, strict=True))
    return ClaimResult(
        f"ratio of short steps, F to E, at slopes: {listed}; long steps differ by at most "
        f"{100 * np.abs(long - 1).max():.1f} %",
        verdict(abs(short[3] - 1) < 0.02, abs(short[3] - 1) < 0.1),
        float(short[3]),
    )


def speed_crossing(paper: Paper, walker: str) -> float:
    """Slope at which a walker's short step becomes the faster one [rad]; NaN where the order never changes."""

    def log_ratio(gaits: Arrays) -> np.ndarray:
        return np.asarray(np.log(gaits["speed"][:, SHORT] / gaits["speed"][:, LONG]))

    return paper.line(walker).crossing(log_ratio, ("speed",))


@claim("E6")
def faster(paper: Paper) -> ClaimResult:
    """Locate the slopes at which both gaits are equally fast."""
    crossing = {w: speed_crossing(paper, w) for w in ("A", "B", "C", "E", "F")}
    speeds = [paper.line(w).grid()["speed"] for w in crossing]
    in_order = all(v[0, LONG] > v[0, SHORT] and v[-1, SHORT] > v[-1, LONG] for v in speeds)
    return ClaimResult(
        f"speeds are equal at slope {numbers(crossing, 6)}; for D the short step is faster at every slope",
        verdict(in_order and all(np.isfinite(v) for v in crossing.values())),
        crossing["E"],
    )


@claim("E7")
def tangential(paper: Paper) -> ClaimResult:
    """Evaluate the ratio of the swing foot's velocities just before heelstrike."""
    slopes = [1e-6, 1e-4, 1e-2, 0.1]
    ratio = {w: np.abs(paper.line(w).at(slopes)["velocity_ratio"]) for w in ("E", "F")}
    long = ", ".join(f"{r:.2g}" for r in ratio["E"][:, LONG])
    short = ", ".join(f"{r:.3g}" for r in ratio["E"][:, SHORT])
    is_clear = all(
        (r[:, LONG] < 0.1).all() and (r[:, SHORT] > 3).all() and (r[:2, SHORT] > 100).all() for r in ratio.values()
    )
    return ClaimResult(
        f"E at slopes 1e-6, 1e-4, 0.01, 0.1: long {long}; short {short}", verdict(is_clear), float(ratio["E"][1, SHORT])
    )
