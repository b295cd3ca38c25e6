"""Point feet with mass: walkers E and F and lighter ones (section 4.1 of the paper)."""

from __future__ import annotations

import numpy as np

from gaitsweep.tasks.ledger.claim import Found, claim, farthest, found, verdict
from gaitsweep.tasks.ledger.lines import LONG, SHORT, Arrays, Paper, memoize
from gaitsweep.tasks.studies.fit_laws import transition
from gaitsweep.tasks.studies.simulate_steps import section_problem
from gaitsweep.tasks.studies.solve_points import lines

#: Foot mass ratios at which the transition is located, down to where the 3/2 power is
#: exact.
RATIOS = (0.1, 0.05, 0.01, 1e-3, 1e-4, 1e-5)


@claim("E1")
def two_dimensional(paper: Paper) -> Found:
    """Evaluate the third multiplier of E and F."""
    worst = max(_third_multiplier(paper, w) for w in ("E", "F"))
    gaits = paper.line("E").at([0.01])
    zero = not any(
        gaits[f"multiplier_{part}"][0, :2, 2].any() for part in ("real", "imag")
    )
    return found(verdict(zero and worst < 1e-12), worst)


def _third_multiplier(paper: Paper, walker: str) -> float:
    """Smallest multiplier of both gaits at slope 0.01 on the section of a general
    straight-legged walker.
    """
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
    jacobians = np.moveaxis(stride.jacobian, -1, 0)
    smallest = np.abs(np.linalg.eigvals(jacobians)).min(axis=1)
    return float(smallest.max())


@claim("E2")
def long_cube_root(paper: Paper) -> Found:
    """Compute the local exponents of the long step."""
    small = paper.exponents("EF", LONG, 1e-8)
    large = paper.exponents("EF", LONG, 0.05)
    off = farthest(small.values(), 1 / 3)
    above = farthest(large.values(), 1 / 3)
    holds = verdict(off < 1e-4 and above < 0.05)
    return found(holds, small["E"], small=small, large=large)


@claim("E3")
def short_two_laws(paper: Paper) -> Found:
    """Compute the local exponents of the short step on both sides of the transition."""
    small, middle, large = (
        paper.exponents("EF", SHORT, slope) for slope in (1e-8, 0.01, 0.1)
    )
    light = paper.line("E", foot_mass_ratio=1e-4).exponent(SHORT, 1e-3)
    linear = farthest(small.values(), 1) < 1e-4
    cube = farthest(large.values(), 1 / 3) < 0.05 and abs(light - 1 / 3) < 0.01

    return found(
        verdict(linear and cube),
        large["E"],
        small=small,
        middle=middle,
        large=large,
        light=light,
    )


@memoize
def _transitions(paper: Paper) -> dict[str, np.ndarray]:
    """Tables of task `transition` for the foot mass ratios in `RATIOS`."""
    slope = np.geomspace(1e-11, 0.2, 220)
    each = [{"walker": "E", "set": {"foot_mass_ratio": r}} for r in RATIOS]
    solved = lines({"lines": each, "slope": slope, "want": ("stance_angle",)}, [])
    return transition(
        {"lines": each}, [{"slope": slope, **points} for _, points in solved]
    )


@claim("E4")
def transition_power(paper: Paper) -> Found:
    """Compute the ratio of transition slopes and their local exponent in the foot mass
    ratio.
    """
    table = _transitions(paper)
    exact, fitted = (
        table[f"fits/transition_ratio/{name}"][0]
        for name in ("exact_asymptotes", "fitted_lines")
    )
    powers = table["fits/transition/local_exponent"][:-1]
    holds = verdict(False, abs(powers[-1] - 1.5) < 0.01)
    return found(holds, fitted, exact=exact, ratios=RATIOS, powers=powers)


@claim("E5")
def similar_curves(paper: Paper) -> Found:
    """Compare the steps of E and F at equal slopes."""
    slopes = [1e-6, 0.01, 0.05, 0.1, 0.2]
    of_E = paper.line("E").at(slopes)["stance_angle"]
    of_F = paper.line("F").at(slopes)["stance_angle"]
    short = of_F[:, SHORT] / of_E[:, SHORT]
    long = of_F[:, LONG] / of_E[:, LONG]
    apart = abs(short[3] - 1)

    return found(
        verdict(apart < 0.02, apart < 0.1),
        short[3],
        short=short,
        long=100 * np.abs(long - 1).max(),
    )


def speed_crossing(paper: Paper, walker: str) -> float:
    """Slope at which a walker's short step becomes the faster one [rad]; NaN where the
    order never changes.
    """

    def log_ratio(gaits: Arrays) -> np.ndarray:
        return np.asarray(np.log(gaits["speed"][:, SHORT] / gaits["speed"][:, LONG]))

    return paper.line(walker).crossing(log_ratio, ("speed",))


@claim("E6")
def faster(paper: Paper) -> Found:
    """Locate the slopes at which both gaits are equally fast."""
    crossing = {w: speed_crossing(paper, w) for w in ("A", "B", "C", "E", "F")}
    speeds = [paper.line(w).grid()["speed"] for w in crossing]
    in_order = all(
        v[0, LONG] > v[0, SHORT] and v[-1, SHORT] > v[-1, LONG] for v in speeds
    )
    crosses = all(np.isfinite(v) for v in crossing.values())
    return found(verdict(in_order and crosses), crossing["E"], crossing=crossing)


@claim("E7")
def tangential(paper: Paper) -> Found:
    """Evaluate the ratio of the swing foot's velocities just before heelstrike."""
    ratio = {
        w: np.abs(paper.line(w).at([1e-6, 1e-4, 1e-2, 0.1])["velocity_ratio"])
        for w in ("E", "F")
    }
    is_clear = all(
        (r[:, LONG] < 0.1).all()
        and (r[:, SHORT] > 3).all()
        and (r[:2, SHORT] > 100).all()
        for r in ratio.values()
    )
    long, short = ratio["E"][:, LONG], ratio["E"][:, SHORT]
    return found(verdict(is_clear), short[1], long=long, short=short)
