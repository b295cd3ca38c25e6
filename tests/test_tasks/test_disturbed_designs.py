"""Attractors at a slope, the least cost of a speed, and steps of the ground that are survived."""

import numpy as np
import pytest

import pipeline
from lines import gait
from tasks.disturb_designs import largest_steps
from tasks.map_designs import design
from tasks.walkers.resolve import resolve


def computed(walker, at=None, **options):
    line = {"walker": walker, "set": {key: np.array(value) for key, value in (at or {}).items()}}
    params = {"line": line, "slope": np.array([1e-5, 0.4]), **options}
    return {name.removeprefix("design/"): value for name, value in design(params, []).items()}


def test_what_is_not_asked_for_is_not_computed():
    assert not {"attractor", "largest_step_up", "least_cost_of_transport"} & set(computed("D"))
    assert "largest_step_up" not in computed("D", at_slope=0.009)


@pytest.mark.parametrize(
    ("slope", "attractor"),
    # Garcia et al. 1998: doublings at 0.0151, 0.0174 and 0.0179 or so, chaos, and falls from 0.019 on.
    [(0.009, "period 1"), (0.0165, "period 2"), (0.0177, "period 4"), (0.01885, "chaotic"), (0.02, "falls")],
)
def test_the_simplest_walker_doubles_its_period(slope, attractor):
    assert computed("D", at_slope=slope)["attractor"].tolist() == [attractor]


def test_designs_of_a_batch_have_their_own_attractors():
    both = computed("A", {"detuning": [0.2, 1.0], "m_h": [0.0, 0.0]}, at_slope=0.02)
    assert both["attractor"].tolist() == ["period 1", "period 2"]
    assert computed("physical", at_slope=0.01)["attractor"].tolist() == ["no gait"]


def test_the_least_cost_is_that_of_the_flattest_gait_with_the_speed():
    found = computed("A", at_speed=0.5)
    (cost,) = found["least_cost_of_transport"]
    gaits = [gait("A", float(np.arcsin(cost)), label) for label in ("long", "short")]
    assert min(abs(g["speed"] / 0.5 - 1) for g in gaits) < 1e-9
    # On flatter ground both gaits are slower.
    flatter = [gait("A", slope, label)["speed"] for slope in (0.9 * cost, 0.5 * cost) for label in ("long", "short")]
    assert max(flatter) < 0.5
    assert found["stable_at_least_cost"].tolist() == [1.0]
    assert np.isnan(computed("A", at_speed=20.0)["least_cost_of_transport"]).all()


@pytest.mark.parametrize(("walker", "slope"), [("D", 0.009), ("A", 0.02), ("C", 0.02)])
def test_larger_steps_of_the_ground_are_not_survived(walker, slope):
    """A simulation of every one of the 200 steps, by another integrator, agrees on both sides of the limit."""
    long = gait(walker, slope, "long")
    state = np.array([long[name] for name in ("stance_angle", "stance_rate", "thigh_rate")])
    down, up = largest_steps({"walker": walker}, slope, state, 0.03)
    leg = resolve(walker).leg
    assert 0 <= up <= down < 0.03
    for h, survives in ((-down, True), (-down - 1e-3, False), (up, True), (up + 1e-3, False)):
        if h:
            steps = pipeline.simulate(walker, slope, state, 200, ground={0: h * leg})
            last = [float(steps[name][-1]) for name in ("stance_angle", "stance_rate", "thigh_rate")]
            assert (np.abs(np.array(last) / state - 1) < 1e-3).all() == survives


def test_no_step_larger_than_asked_for_is_tried():
    long = gait("A", 0.02, "long")
    state = np.array([long[name] for name in ("stance_angle", "stance_rate", "thigh_rate")])
    assert largest_steps({"walker": "A"}, 0.02, state, 0.003) == (0.003, 0.003)
