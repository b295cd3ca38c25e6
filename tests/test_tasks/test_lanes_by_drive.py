"""Lanes of gaits over what drives them: walkers of their own, of any number of steps."""

import numpy as np
import pytest

from gaitsweep.tasks.branches.conditions import CONDITIONS
from gaitsweep.tasks.branches.joint import evaluate
from gaitsweep.tasks.measures.levels import measures_at
from gaitsweep.tasks.step.drive import PUSH_OFF, Drive
from gaitsweep.tasks.step.problem import Lanes, Problem
from gaitsweep.tasks.walkers.resolve import resolve

SLOW = pytest.mark.thorough
#: What drives on level ground, and some values of it.
OVER_PUSH = Drive(PUSH_OFF, 0.0)
PUSHES = np.array([0.05, 0.1, 0.2])


def steps_of(problem, n):
    """Steps (c, n) that differ, not gaits, without what drives them."""
    some = np.arange(problem.m * n).reshape(-1, n)
    sections = 0.2 + 0.05 * np.cos(some)
    sections[0] = np.log(sections[0])

    number = 1 + np.arange(problem.phases)
    times = 2.5 * problem.steps * number / problem.phases
    times = np.repeat(times[:, None], n, axis=1)

    drive = np.zeros((1, n))
    return np.vstack([sections, times, drive])


@pytest.mark.parametrize("steps", [1, 2, 4])
@pytest.mark.parametrize("walker", ["B", "C"])
def test_lanes_and_each_of_them_keep_the_number_of_steps(walker, steps):
    alone = resolve(walker, {})
    problem = Problem(alone, steps, OVER_PUSH)

    lanes, _ = problem.lanes_at(PUSHES)

    some = lanes.some(np.array([2, 0]))
    for each in (lanes, some, lanes.alone(1)):
        assert each.steps == steps
        assert each.m == problem.m
        assert each.phases == problem.phases


@pytest.mark.parametrize("walker", ["B", pytest.param("C", marks=SLOW)])
def test_lanes_of_two_steps_are_measured_as_each_walker_by_itself(walker):
    masses = 0.1, 0.2, 0.3
    walkers = [resolve(walker, {"m_h": mass}) for mass in masses]
    lanes = Lanes(walkers).of_steps(2)
    Z = steps_of(lanes, 3)
    Z[-1] = np.log([0.01, 0.02, 0.03])
    names = [
        "period",
        "speed",
        "loss_normal",
        "friction_demand",
    ]

    together = measures_at(names, evaluate(lanes, Z))

    for lane, each in enumerate(walkers):
        step = evaluate(Problem(each, 2), Z[:, [lane]])
        alone = measures_at(names, step)
        for name in names:
            (own,) = alone[name]
            assert together[name][lane] == pytest.approx(own, rel=1e-12)


def test_a_drive_that_is_no_number_makes_no_walker():
    """Where Newton's method wanders off there is none; at these lanes measures and
    conditions have no value.
    """
    problem = Problem(resolve("B", {}), drive=OVER_PUSH)
    drive = np.array([0.1, np.nan, 0.1])

    ((lanes, driven, slope),) = problem.at_slopes(drive)

    assert lanes.tolist() == [0, 2]
    assert driven.walker.push_off > 0
    assert len(slope) == 2
    Z = steps_of(problem, 3)
    Z[-1] = np.log(drive)
    at = evaluate(problem, Z)
    speed = measures_at(["speed"], at)["speed"]
    assert np.isfinite(speed).tolist() == [True, False, True]


def test_no_drive_at_all_makes_none():
    problem = Problem(resolve("C", {}), drive=OVER_PUSH)
    nowhere = np.full(2, np.nan)

    found = [*problem.at_slopes(nowhere)]

    assert not found


@SLOW
def test_a_released_knee_has_no_acceleration_where_nothing_drives():
    problem = Problem(resolve("C", {}), drive=OVER_PUSH)
    Z = steps_of(problem, 2)
    Z[-1] = np.log([0.1, np.nan])

    at = evaluate(problem, Z)
    value = CONDITIONS["release_hyperextension"].value(at)

    assert np.isfinite(value).tolist() == [True, False]
