"""The bits of a lane do not depend on how many others are computed beside it, nor on
where it lies among them.

The numbers of lanes are those at which numpy changes its ways: one lane, whose leading
axes become the inner ones; 256 KiB of a matrix (3,641 lanes), from which temporaries
are reused; its buffer of 8,192 numbers.
"""

import dataclasses
import functools
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from gaitsweep.tasks.branches.atlas import from_arrays
from gaitsweep.tasks.branches.joint import evaluate, rounding_step
from gaitsweep.tasks.branches.pseudo_arclength import bordered_matrix
from gaitsweep.tasks.charts.box import Box
from gaitsweep.tasks.charts.chart import Chart
from gaitsweep.tasks.charts.family import Family
from gaitsweep.tasks.charts.pieces import pieces_of
from gaitsweep.tasks.gaits.multipliers import (
    characteristic,
    characteristic_errors,
    multiplier_bounds,
    multiplier_changes,
    multipliers,
)
from gaitsweep.tasks.gaits.newton import (
    curvature,
    newton,
    newton_step,
    relative_sizes,
)
from gaitsweep.tasks.gaits.polish import settle, unmeasured
from gaitsweep.tasks.gaits.rounding import (
    characteristic_scale,
    reported,
    reported_sizes,
    rounding,
    rounding_std,
    sensitivity,
)
from gaitsweep.tasks.gaits.step_check import gait_ratio, verified
from gaitsweep.tasks.measures import violations
from gaitsweep.tasks.measures.gaits import describe, measured_multipliers, to_accuracy
from gaitsweep.tasks.measures.kinematics import travel
from gaitsweep.tasks.measures.losses import contact_mass, heelstrike_losses
from gaitsweep.tasks.measures.smooth import Smooth
from gaitsweep.tasks.mechanics.kernel import LANES
from gaitsweep.tasks.mechanics.small_angles import SmallAngles
from gaitsweep.tasks.step.lanes import lanes_of
from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.studies.solve_points import atlas
from gaitsweep.tasks.walkers.resolve import resolve
from lines import WANT

ROOT = Path(__file__).parent.parent.parent
SIZES, FEW = (1, 7, 3000, 3641, 8192, 20000), (1, 7, 200)
#: Gaits of which the lanes are copies.
KNOWN = 61
#: Walkers with straight legs, knees, and point feet, with the number of steps after
#: which their gaits repeat.
WALKERS = {"A": ("A", 1), "C": ("C", 1), "E": ("E", 1), "three steps": ("C", 3)}


@dataclasses.dataclass
class Sample:
    """Lanes of a walker: guesses, and settled gaits with what was evaluated of them."""

    problem: Problem
    guesses: object
    at: object
    moved: object
    slope: np.ndarray

    def some(self, lanes):
        parts = (self.guesses, self.at, self.moved, self.slope)
        return Sample(self.problem, *(lanes_of(part, lanes) for part in parts))


@functools.lru_cache
def sample(name):
    """Neighbouring gaits of one piece of a branch; those of several steps repeat one."""
    walker, steps = WALKERS[name]
    problem = Problem(resolve(walker), steps)
    branches = from_arrays(atlas({"line": {"walker": walker}, "coarse": True}, []))
    piece = max(pieces_of(branches), key=lambda piece: piece.q[1] - piece.q[0])
    q = np.linspace(*piece.q, KNOWN + 2)[1:-1]
    w, m = piece.gaits(q), problem.step.m
    y, times = np.vstack([np.ones(KNOWN), w[1:m]]), w[m:]
    again = np.vstack(
        [
            w[0],
            np.tile(y, (steps, 1))[1:],
            *(times + k * times[-1] for k in range(steps)),
        ]
    )
    guesses = unmeasured(problem, again, np.exp(q))
    at, moved = (
        settle(problem, guesses, sampled=True),
        again + 1e-6 * np.sin(np.arange(again.size)).reshape(again.shape),
    )
    stride, scale = problem.stride(moved, q, by_drive=True, samples=16)
    return Sample(problem, guesses, at, (moved, stride, scale), np.exp(q))


def lanes_last(named):
    return [np.moveaxis(values, 0, -1) for values in named.values()]


def of_rounding(s):
    w, stride, scale = s.moved
    y, times = stride.y + stride.newton, stride.newton_times
    state, values, by_unknowns = reported(
        s.problem, y, times, s.problem.parameters(s.slope, scale)
    )
    return [
        *(
            rounding(stride),
            characteristic_scale(stride),
            sensitivity(stride, values, by_unknowns),
        ),
        *(state, values, by_unknowns, reported_sizes(values)),
        *(newton_step(stride, w), relative_sizes(w, s.problem.m)),
    ]


def of_multipliers(s):
    jacobian = s.moved[1].jacobian
    error = characteristic_errors(jacobian, 1e-12 * s.slope)
    values = multipliers(jacobian, len(jacobian) + 1)
    change = 1e-9 * np.sin(1e3 * error / s.slope)
    moved = multiplier_changes(values[:, :-1], change)
    measured = measured_multipliers(jacobian, change, error, s.problem.structure.kneed)
    bounds = [multiplier_bounds(values, factor * error) for factor in (1.0, 1e6, 1e10)]
    return [
        error,
        characteristic(jacobian),
        values.T,
        moved.T,
        *bounds,
        *lanes_last(measured),
    ]


def of_measures(s):
    gaits = describe(s.problem, s.at, s.slope, WANT)
    rounded = {
        name: values[:, None].copy() for name, values in gaits.items() if name in WANT
    }
    to_accuracy(rounded, 1e-6)
    return [*lanes_last(gaits), *lanes_last(rounded)]


def of_smooth_quantities(s):
    want = [name for name in WANT if name not in ("residual", "energy_imbalance")]
    smooth = Smooth.of(s.problem, want)
    gaits = describe(s.problem, s.at, s.slope, smooth.want)
    values, sizes = smooth.columns(s.slope, gaits, s.at.stride.jacobian)
    columns = dict(zip(smooth.names, values, strict=True))
    found = smooth.multipliers(columns, 1e-9)
    back = smooth.gaits(s.slope, columns | found, 1e-9, (0, 0))
    return [values, sizes, *lanes_last(found), *lanes_last(back)]


def of_walkers(s):
    """Measures of a walker for each lane."""
    family = Family.of({"walker": "A"}, ["detuning"])
    walkers = family.walkers(s.slope[:, None] * 3)
    angle = np.exp(s.moved[0][0])
    losses = heelstrike_losses(walkers, angle, np.vstack([-angle, 0.3 * angle]))
    return [
        np.moveaxis(contact_mass(walkers, angle), 0, -1),
        *losses,
        *travel(walkers, s.slope, angle, angle).values(),
    ]


def of_joint_equations(s):
    w, _, _ = s.moved
    at = evaluate(s.problem, np.vstack([w, np.log(s.slope)]))
    matrix = bordered_matrix(at.derivative, np.vstack([w, s.slope]))
    return [at.residual, at.derivative, at.multipliers.T, rounding_step(matrix, at)]


def of_steps(s):
    check = verified(s.moved[1])
    return [gait_ratio(s.moved[1]), check.step, check.doubt, check.leg_passes]


def of_search(s):
    walker, angle = s.problem.walker, np.exp(s.moved[0][0])
    return [
        SmallAngles(walker).exchange_rates(angle, 2 + angle, s.slope),
        SmallAngles(walker).exchange_periods(angle, s.slope),
    ]


def of_charts(s):
    x = np.stack([np.sin(7 * s.slope), np.cos(300 * s.slope)], axis=1)
    found = []
    for sizes, c in (((21,), 5), ((12, 7), 13)):
        chart = Chart(
            sizes, np.sin(np.arange(np.prod(sizes) * c, dtype=float)).reshape(-1, c)
        )
        found.append(chart(x[:, : len(sizes)]))
    box = Box(("m_h", "R"), (0.1, 0.01), (30.0, 0.4), log=True)
    keys = box.at(x)
    return [*found, keys.T, box.unit(keys).T]


def of_newton(s):
    """With so many solutions known that numpy adds their parts in another order."""
    w, *_ = s.moved
    known = np.cos(np.arange(9.0 * len(w))).reshape(len(w), 9)
    return [*newton(s.problem, w, np.log(s.slope), known=known, max_iterations=3)]


def of_polish(s):
    at = settle(s.problem, s.guesses)
    own = (
        at.y,
        at.state,
        at.times,
        at.bound,
        at.doubles,
        at.change,
        at.error,
        at.converged,
        at.step,
        at.leg_passes,
    )
    return [
        *own,
        *(
            values
            for values in vars(at.stride.one).values()
            if isinstance(values, np.ndarray)
        ),
    ]


def of_neighbours(s):
    w, q = s.moved[0], np.log(s.slope)
    return [*curvature(s.problem, w, q), rounding_std(s.problem, w, q)]


def of_violations(s):
    motion = [part * s.at.scale for part in fine(s).one.motion]
    impact = s.at.stride.one.impact * s.at.scale
    return lanes_last(
        violations.measure(s.problem.walker, motion, impact, s.at.times, s.slope)
    )


def fine(s):
    parameters = s.problem.parameters(s.slope, s.at.scale)
    return s.problem.map(s.at.y, s.at.times, parameters, samples=violations.SAMPLES)


CHEAP = (
    of_rounding,
    of_multipliers,
    of_measures,
    of_smooth_quantities,
    of_steps,
    of_charts,
)
#: What integrates steps.
DEAR = (of_joint_equations, of_newton, of_polish, of_neighbours)


def differing(name, measure, sizes):
    """Numbers of lanes at which the bits of any differ from those that it has among the
    known lanes.
    """
    known = sample(name)
    expected = measure(known)
    for n in sizes:
        lanes = (23 + np.arange(n)) % KNOWN
        found = measure(known.some(lanes))
        if not all(
            np.array_equal(a[..., lanes], b, equal_nan=True)
            for a, b in zip(expected, found, strict=True)
        ):
            yield n


@pytest.mark.parametrize("name", WALKERS)
@pytest.mark.parametrize("measure", CHEAP)
def test_a_lane_has_the_same_bits_among_any_number_of_others(name, measure):
    assert not list(differing(name, measure, SIZES))


@pytest.mark.parametrize("measure", [of_search, of_walkers])
def test_a_lane_of_straight_legs_has_the_same_bits_among_any_number_of_others(measure):
    assert not list(differing("A", measure, SIZES))


@pytest.mark.parametrize("name", WALKERS)
@pytest.mark.parametrize("measure", DEAR)
def test_a_lane_is_solved_to_the_same_bits_among_a_few_others(name, measure):
    assert not list(differing(name, measure, FEW))


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("measure", "name"),  # without those of which many need extended precision
    [
        (measure, name)
        for measure in DEAR
        for name in WALKERS
        if (measure, name) != (of_polish, "E")
    ],
)
def test_a_lane_is_solved_to_the_same_bits_among_many_others(name, measure):
    assert not list(differing(name, measure, SIZES[2:]))


@pytest.mark.parametrize("name", ["A", "C", "E"])
def test_violations_of_a_lane_do_not_depend_on_the_others(name):
    assert not list(differing(name, of_violations, FEW))


@pytest.mark.thorough
@pytest.mark.skipif(LANES <= 4, reason="this processor has no wider registers")
def test_bits_do_not_depend_on_the_others_in_narrower_registers():
    environment = {
        **os.environ,
        "GAITSWEEP_LANES": "4",
        "PYTHONPATH": os.pathsep.join([str(ROOT), str(ROOT / "tests")]),
    }
    subprocess.run([sys.executable, __file__], env=environment, check=True, timeout=280)


if __name__ == "__main__":
    for walker in WALKERS:
        for function in (*CHEAP, *DEAR):
            assert not list(differing(walker, function, FEW)), (walker, function)
