"""Attractors at a slope, the least cost of a speed, and steps of the ground that are
survived.
"""

import numpy as np
import pytest

import gaitsweep
from gaitsweep.tasks.mechanics.lumped import structure_of
from gaitsweep.tasks.step.problem import Lanes
from gaitsweep.tasks.step.simulate import step_onto, stride
from gaitsweep.tasks.studies.disturb_designs import attractors_beside
from gaitsweep.tasks.studies.map_designs import design
from gaitsweep.tasks.walkers.resolve import resolve, resolve_many
from lines import gait


def computed(walker, at=None, **options):
    line = {
        "walker": walker,
        "set": {key: np.array(value) for key, value in (at or {}).items()},
    }
    params = {"line": line, "slope": np.array([1e-5, 0.4]), **options}
    return {
        name.removeprefix("design/"): value
        for name, value in design(params, []).items()
    }


def test_what_is_not_asked_for_is_not_computed():
    assert not {"attractor", "largest_step_up", "least_cost_of_transport"} & set(
        computed("D")
    )
    assert "largest_step_up" not in computed("D", at_slope=0.009)


@pytest.mark.parametrize(
    ("slope", "attractor"),
    # Garcia et al. 1998: doublings at 0.0151, 0.0174 and 0.0179 or so, chaos, and falls
    # from 0.019 on.
    [
        (0.009, "period 1"),
        (0.0165, "period 2"),
        (0.0177, "period 4"),
        (0.01885, "chaotic"),
        (0.02, "falls"),
    ],
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
    flatter = [
        gait("A", slope, label)["speed"]
        for slope in (0.9 * cost, 0.5 * cost)
        for label in ("long", "short")
    ]
    assert max(flatter) < 0.5
    assert found["stable_at_least_cost"].tolist() == [1.0]
    assert np.isnan(computed("A", at_speed=20.0)["least_cost_of_transport"]).all()


def test_the_least_cost_of_stable_gaits_is_told_from_that_of_short_unstable_ones():
    """The paper, section 3: the simplest walker's short gait is faster at every slope,
    and never stable.
    """
    speed = gait("D", 0.009, "long")["speed"]
    found = computed("D", at_speed=speed)
    assert found["slope_at_least_stable_cost"][0] == pytest.approx(0.009, rel=1e-9)
    assert found["least_stable_cost_of_transport"][0] == pytest.approx(
        np.sin(0.009), rel=1e-9
    )
    (slope,) = found["slope_at_least_cost"]
    assert slope < 0.009 and gait("D", float(slope), "short")["speed"] == pytest.approx(
        speed, rel=1e-9
    )
    labels = (
        found[f"gait_at_{name}"].tolist()
        for name in ("least_cost", "least_stable_cost")
    )
    assert list(labels) == [["short"], ["long"]] and found[
        "stable_at_least_cost"
    ].tolist() == [0.0]


@pytest.mark.parametrize(("walker", "slope"), [("D", 0.009), ("A", 0.02), ("C", 0.02)])
def test_larger_steps_of_the_ground_are_not_survived(walker, slope):
    """A simulation of every one of the 200 steps, by another integrator, agrees on both
    sides of the limit.
    """
    long = gait(walker, slope, "long")
    state = np.array(
        [long[name] for name in ("stance_angle", "stance_rate", "thigh_rate")]
    )
    found = computed(walker, at_slope=slope, ground=0.03)
    (down,), (up,) = found["largest_step_down"], found["largest_step_up"]
    leg = resolve(walker).leg
    assert 0 <= up <= down < 0.03
    for h, survives in (
        (-down, True),
        (-down - 1e-3, False),
        (up, True),
        (up + 1e-3, False),
    ):
        if h:
            steps = gaitsweep.simulate(walker, slope, state, 200, ground={0: h * leg})
            last = [
                float(steps[name][-1])
                for name in ("stance_angle", "stance_rate", "thigh_rate")
            ]
            assert (np.abs(np.array(last) / state - 1) < 1e-3).all() == survives


def test_no_step_larger_than_asked_for_is_tried():
    found = computed("A", at_slope=0.02, ground=0.003)
    assert (
        found["largest_step_down"].tolist()
        == found["largest_step_up"].tolist()
        == [0.003]
    )


@pytest.mark.parametrize("walker", ["A", "C"])
def test_steps_onto_other_ground_are_those_of_a_simulation(walker):
    long, heights = (
        gait(walker, 0.009, "long"),
        np.array([-0.004, -0.001, 0.0, 0.001, 0.004]),
    )
    state = np.array(
        [long[name] for name in ("stance_angle", "stance_rate", "thigh_rate")]
    )
    own = resolve_many(walker, {"m_h": np.full(5, resolve(walker).m_h)})
    problem = Lanes(own, structure_of(resolve(walker)))
    unit = np.sqrt(own.leg / own.g)
    y = problem.section_of(
        np.repeat((state * [1, unit, unit])[:, None], 5, axis=1), np.full(5, 0.009)
    )
    after = step_onto(problem, y, np.full(5, 0.009), heights * own.leg / own.l)
    start = problem.start(after.image, np.full(5, 0.009))
    for i, h in enumerate(heights):
        steps = gaitsweep.simulate(walker, 0.009, state, 2, ground={0: h * own.leg})
        last = [
            float(steps["stance_angle"][-1]),
            *(float(steps[k][-1]) * unit for k in ("stance_rate", "thigh_rate")),
        ]
        assert start[:3, i] == pytest.approx(last, rel=1e-6)
        assert after.times[-1, i] * unit == pytest.approx(
            float(steps["period"][1]), rel=1e-6
        )


def test_options_over_a_plane_give_what_lines_give():
    """Some long gaits are stable, others lead to gaits of two and four steps."""
    draw = np.random.default_rng(0)
    at = {"R": draw.uniform(0.05, 0.1, 10), "m_s": draw.uniform(0.03, 0.06, 10)}
    params = {"line": {"walker": "B", "set": at}, "slope": np.array([1e-6, 0.45])}
    params |= {"at_slope": 0.0102, "at_speed": 0.3, "ground": 0.005}
    cell = {
        "keys": list(at),
        "low": [0.05, 0.03],
        "high": [0.1, 0.06],
        "log": [False, False],
        "lines": 900,
    }
    one, other = design({**params, "plane": cell}, []), design(params, [])
    assert one["design/surveyed"].mean() < 0.2 and (other["design/surveyed"] == 1).all()
    assert {"period 1", "period 2"} <= set(other["design/attractor"])
    assert np.isfinite(other["design/largest_step_up"]).any()
    for name in (
        "attractor",
        "stable_at_least_cost",
        "largest_step_down",
        "largest_step_up",
    ):
        a, b = one[f"design/{name}"], other[f"design/{name}"]
        assert np.array_equal(a, b, equal_nan=a.dtype.kind == "f"), name
    a, b = (
        one["design/least_cost_of_transport"],
        other["design/least_cost_of_transport"],
    )
    bound = one["design/least_cost_error"] + other["design/least_cost_error"]
    assert (np.abs(a / b - 1) <= bound).all() and bound.max() < 1e-8


@pytest.mark.parametrize("ground", [0.0004, 0.0027])
def test_the_largest_step_asked_for_need_not_be_in_thousandths(ground):
    """It was rounded: none was tried, or a larger one."""
    found = computed("A", at_slope=0.02, ground=ground)
    assert (
        found["largest_step_down"].tolist()
        == found["largest_step_up"].tolist()
        == [ground]
    )


@pytest.mark.parametrize("walker", ["D", "A", "C"])
def test_walkers_that_all_fall_have_no_attractor(walker):
    """The Jacobians of no step at all had no shape, and the map of designs ended with
    an error.
    """
    problem = Lanes([resolve(walker)] * 2)
    falling = np.vstack(
        [np.full(2, 0.3), np.full((problem.m - 1, 2), 1e-3)]
    )  # too slow to pass over the stance foot
    assert np.isnan(stride(problem, falling, np.full(2, 0.01)).jacobian).all()
    assert attractors_beside(problem, falling, 0.01).tolist() == ["falls", "falls"]
