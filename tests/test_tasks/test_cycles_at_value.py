"""Gaits of several steps at a value of a measure, found over a key at a fixed slope,
against single solves.
"""

import numpy as np
import pytest

from gaitsweep.tasks.branches.equations import Equations, Keys
from gaitsweep.tasks.step.several_steps import sections
from gaitsweep.tasks.studies.gaits_over_key import gaits_over_key
from gaitsweep.tasks.studies.solve_at_slope import solve_one
from gaitsweep.tasks.studies.solve_at_value import solve_at_value
from gaitsweep.tasks.walkers.resolve import walkers_over

SLOW = pytest.mark.thorough


def at(walker, measure, value, **more):
    return solve_at_value(
        {"walker": walker, "measure": measure, "value": value, **more}
    )


@pytest.mark.parametrize(
    ("walker", "slope", "steps", "key", "between", "measure", "value"),
    [
        ("B", 0.03, 2, "m_h", (0.0, 0.5), "speed", 0.175),
        # Gaits of two steps begin at R = 0.0316, between walkers that are searched.
        pytest.param("D", 0.016, 2, "R", (0.03, 0.5), "speed", 0.1258, marks=SLOW),
        pytest.param(
            "C", 0.09, 2, "m_h", (0.0, 30.0), "friction_demand", 0.38, marks=SLOW
        ),
        pytest.param("D", 0.02, 4, "R", (0.0, 0.1), "stance_angle", 0.28, marks=SLOW),
        pytest.param("D", 0.015, 3, "R", (0.0, 0.05), "period", 11.25, marks=SLOW),
    ],
)
def test_gaits_of_several_steps_at_a_key_are_those_of_its_walker(
    walker, slope, steps, key, between, measure, value
):
    asked = {"slope": slope, "steps": steps, "vary": key, "between": between}

    found = at(walker, measure, value, **asked)["gaits"]

    assert found
    for gait in found:
        there = {"walker": walker, "slope": slope, "steps": steps}
        single = solve_one({**there, "set": {key: gait[key]}})["gaits"]
        (same,) = [
            other
            for other in single
            if other["stance_angle"] == pytest.approx(gait["stance_angle"], rel=1e-11)
        ]
        assert abs(same[measure] / value - 1) < 1e-13 + 2 * same["error_bound"]
        for name in ("period", "step_length", "contact_mass_matrix"):
            np.testing.assert_allclose(gait[name], same[name], rtol=1e-10)


@SLOW
def test_curves_of_two_steps_end_at_the_flip_of_one():
    """Beyond it the halves of the gait are exchanged, and the curve goes back."""
    line = {"walker": "D", "set": {}}
    ends = 0.03, 0.5
    keys = Keys.of_one("R", walkers_over(line, "R"), *ends)

    gaits = Equations(keys, [], 0.016).of_steps(2)

    ((points, _),) = gaits_over_key(gaits)

    radius = points[:, -1] * (ends[1] - ends[0])
    assert 0.0315 < radius.max() < 0.0317
    y, _ = sections(points[:, :-1].T, gaits.problem.m, 2)
    first, second = y[:, 0, radius < 0.0315]
    assert (first > second).all() or (first < second).all()


@SLOW
def test_values_that_gaits_of_two_steps_have_not_are_told_with_those_they_have():
    found = at("B", "speed", 0.179, vary="m_h", between=(0, 0.5), slope=0.03, steps=2)

    assert not found["gaits"]
    (sentence,) = found["absent"]
    assert sentence.startswith("No gait has speed = 0.179 for `m_h` from 0 to 0.5: ")
    assert sentence.endswith("there are 0.174052 to 0.177859.")
