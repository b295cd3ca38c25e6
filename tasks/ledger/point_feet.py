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
    worst = max(_third_multiplier(paper, walker) for walker in ("E", "F"))
    gaits = paper.line("E").at([0.01])
    is_zero = True
    for part in ("multiplier_real", "multiplier_imag"):
        multipliers = gaits[part][0, :2]
        third = multipliers[:, 2]
        is_zero &= not third.any()
    holds = verdict(is_zero and worst < 1e-12)
    return found(holds, worst)


def _third_multiplier(paper: Paper, walker: str) -> float:
    """Smallest multiplier of both gaits at slope 0.01 on the section of a general
    straight-legged walker.
    """
    problem = section_problem(paper.line(walker).walker)
    gaits = paper.line(walker).at([0.01])
    unit = problem.walker.time_unit
    angle = gaits["stance_angle"][0, :2]
    stance_rate = gaits["stance_rate"][0, :2]
    thigh_rate = gaits["thigh_rate"][0, :2]
    period = gaits["period"][0, :2]

    w = np.zeros((4, 2))
    w[0] = np.log(angle)
    w[1] = stance_rate / angle * unit
    w[2] = thigh_rate / angle * unit
    w[3] = period / unit
    both = problem.some(np.zeros(2, int))
    log_slope = np.full(2, np.log(0.01))
    stride, _ = both.stride(w, log_slope)
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
    return found(
        holds,
        small["E"],
        small=small,
        large=large,
    )


@claim("E3")
def short_two_laws(paper: Paper) -> Found:
    """Compute the local exponents of the short step on both sides of the transition."""
    small = paper.exponents("EF", SHORT, 1e-8)
    middle = paper.exponents("EF", SHORT, 0.01)
    large = paper.exponents("EF", SHORT, 0.1)
    lighter = paper.line("E", foot_mass_ratio=1e-4)
    light = lighter.exponent(SHORT, 1e-3)
    from_linear = farthest(small.values(), 1)
    from_cube_root = farthest(large.values(), 1 / 3)
    light_from_it = abs(light - 1 / 3)
    is_cube_root = from_cube_root < 0.05 and light_from_it < 0.01
    holds = verdict(from_linear < 1e-4 and is_cube_root)

    return found(
        holds,
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
    each = [{"walker": "E", "set": {"foot_mass_ratio": ratio}} for ratio in RATIOS]
    asked = {"lines": each, "slope": slope, "want": ("stance_angle",)}
    solved = [{"slope": slope, **points} for _, points in lines(asked, [])]
    return transition({"lines": each}, solved)


@claim("E4")
def transition_power(paper: Paper) -> Found:
    """Compute the ratio of transition slopes and their local exponent in the foot mass
    ratio.
    """
    table = _transitions(paper)
    (exact,) = table["fits/transition_ratio/exact_asymptotes"][:1]
    (fitted,) = table["fits/transition_ratio/fitted_lines"][:1]
    powers = table["fits/transition/local_exponent"][:-1]
    off = abs(powers[-1] - 1.5)
    holds = verdict(False, off < 0.01)
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
        speed = gaits["speed"]
        ratio = speed[:, SHORT] / speed[:, LONG]
        return np.asarray(np.log(ratio))

    return paper.line(walker).crossing(log_ratio, ("speed",))


@claim("E6")
def faster(paper: Paper) -> Found:
    """Locate the slopes at which both gaits are equally fast."""
    crossing = {w: speed_crossing(paper, w) for w in ("A", "B", "C", "E", "F")}
    in_order = all(_changes_order(paper, walker) for walker in crossing)
    crosses = all(np.isfinite(slope) for slope in crossing.values())
    return found(verdict(in_order and crosses), crossing["E"], crossing=crossing)


def _changes_order(paper: Paper, walker: str) -> bool:
    """Whether the long step is the faster one at the least slope, and the short one at
    the largest.
    """
    speed = paper.line(walker).grid()["speed"]
    least = speed[0]
    largest = speed[-1]
    return bool(least[LONG] > least[SHORT] and largest[SHORT] > largest[LONG])


@claim("E7")
def tangential(paper: Paper) -> Found:
    """Evaluate the ratio of the swing foot's velocities just before heelstrike."""
    of_E = _velocity_ratios(paper, "E")
    of_F = _velocity_ratios(paper, "F")
    holds = verdict(_are_clear(*of_E) and _are_clear(*of_F))
    long, short = of_E
    return found(holds, short[1], long=long, short=short)


def _velocity_ratios(paper: Paper, walker: str) -> tuple[np.ndarray, np.ndarray]:
    """Of the long and of the short step at some slopes, rising, shape (n,)."""
    gaits = paper.line(walker).at([1e-6, 1e-4, 1e-2, 0.1])
    ratio = np.abs(gaits["velocity_ratio"])
    return ratio[:, LONG], ratio[:, SHORT]


def _are_clear(long: np.ndarray, short: np.ndarray) -> bool:
    """Whether long steps strike nearly straight down, and short ones along the ground,
    those at small slopes far more so.
    """
    is_down = (long < 0.1).all()
    is_along = (short > 3).all()
    is_along &= (short[:2] > 100).all()
    return bool(is_down and is_along)
