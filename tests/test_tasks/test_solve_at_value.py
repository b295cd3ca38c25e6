"""Gaits at a value of a measure, against single solves and crossings of dense grids."""

import time

import numpy as np
import pytest

from gaitsweep.tasks.measures.levels import measures
from gaitsweep.tasks.studies.solve_at_slope import solve_one
from gaitsweep.tasks.studies.solve_at_value import solve_at_value
from gaitsweep.tasks.studies.solve_points import points
from gaitsweep.tasks.walkers.resolve import resolve
from gaitsweep.tasks.walkers.walker import WalkerError
from lines import _atlas

SLOW = pytest.mark.thorough


def at(walker, measure, value, **more):
    return solve_at_value(
        {"walker": walker, "measure": measure, "value": value, **more}
    )


def crossings_of_a_grid(walker, measure, value, low, high):
    """Slopes at which both gaits' measures pass a value, by linear interpolation."""
    slope = np.geomspace(low, high, 1500)
    line = {"walker": walker, "set": {}}
    request = {"line": line, "slope": slope, "want": (measure,)}
    grid = points(request, [_atlas(walker, ())])[measure]
    found = []
    for gait in (0, 1):
        off = grid[:, gait] - value
        for k in np.flatnonzero(off[1:] * off[:-1] < 0):
            share = off[k] / (off[k] - off[k + 1])
            found.append(float(slope[k] * (slope[k + 1] / slope[k]) ** share))
    return sorted(found)


@pytest.mark.parametrize(
    ("walker", "measure", "value"),
    [
        ("A", "froude_speed", 0.2),
        ("C", "speed", 0.3),
        ("A", "spectral_radius", 1.0),
        ("C", "foot_clearance", -0.005),
        ("D", "least_normal_force", 0.75),
    ],
)
def test_gaits_at_a_value_are_those_of_a_dense_grid(walker, measure, value):
    window = 1e-4, 0.2
    expected = crossings_of_a_grid(walker, measure, value, *window)

    found = at(walker, measure, value, between=window)

    slopes = [gait["slope"] for gait in found["gaits"]]
    assert slopes == pytest.approx(expected, rel=1e-4) and expected
    for gait in found["gaits"]:
        assert gait[measure] == pytest.approx(value, rel=1e-11)


def test_a_gait_at_a_value_is_the_one_that_its_slope_has():
    (gait, *_) = at("C", "speed", 0.3)["gaits"]
    answer = solve_one({"walker": "C", "slope": gait["slope"]})
    (other,) = [g for g in answer["gaits"] if g["gait"] == gait["gait"]]
    for name in ("stance_angle", "period", "loss_normal", "multipliers"):
        np.testing.assert_allclose(gait[name], other[name], rtol=1e-11)
    assert gait["violations"] == other["violations"]


def test_a_key_is_found_at_which_gaits_of_a_slope_have_a_value():
    slope, keys = 0.02, (0.05, 1.0)
    found = at("A", "froude_speed", 0.2, vary="m_h", between=keys, slope=slope)

    assert found["columns"][0] == "m_h" and found["gaits"]
    for gait in found["gaits"]:
        there = {"walker": "A", "slope": slope, "set": {"m_h": gait["m_h"]}}
        speeds = [other["froude_speed"] for other in solve_one(there)["gaits"]]
        assert min(abs(speed - 0.2) for speed in speeds) < 1e-12
    # As often as both gaits' speeds pass the value over the range.
    signs = []
    for m_h in np.linspace(*keys, 7):
        gaits = solve_one({"walker": "A", "slope": slope, "set": {"m_h": m_h}})["gaits"]
        signs.append([gait["froude_speed"] > 0.2 for gait in gaits])
    passed = np.count_nonzero(np.diff(np.array(signs, int), axis=0))
    assert len(found["gaits"]) == passed


def test_a_value_that_no_gait_has_is_told_with_what_there_is():
    (sentence,) = at("A", "speed", 9.0)["absent"]
    assert sentence.startswith("No gait has speed = 9 for `slope` from 1e-06 to 0.5: ")
    assert " to 2.15" in sentence
    (sentence,) = at("A", "speed", 0.2, between=(0.4, 0.45))["absent"]
    assert sentence.startswith("No gait")


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        (
            {"measure": "kneestrike_time"},
            "`at` must be a measure of its gaits: stance_",
        ),
        ({"measure": "residual"}, "`at` must be a measure of its gaits: stance_"),
        ({"value": np.inf}, "`at` must be finite; got inf."),
        ({"between": (0.2, 0.1)}, "`between` must rise; got (0.2, 0.1)."),
        (
            {"vary": "l_t", "between": (-0.1, 1.0), "slope": 0.1},
            "`l_t` must be > 0; got -0.1.",
        ),
        (
            {"vary": "R", "set": {"R": 0.2}, "between": (0.1, 0.3), "slope": 0.1},
            "`R` is varied and cannot be set too; got 0.2.",
        ),
        (
            {"vary": "l_x", "between": (0.1, 0.3), "slope": 0.1},
            "`l_x` is not a walker key",
        ),
    ],
)
def test_what_cannot_be_asked_is_refused_in_a_line(asked, message):
    request = {"measure": "speed", "value": 0.2} | asked
    with pytest.raises(WalkerError) as refused:
        at("A", **request)
    assert str(refused.value).startswith(message)


def test_measures_of_knees_are_for_knees():
    kneed, straight = measures(resolve("C")), measures(resolve("A"))
    assert "kneestrike_time" in kneed and "kneestrike_time" not in straight
    assert not {"branch", "status", "proved", "violations"} & set(kneed)
    locked = measures(resolve("C", {"trailing_knee": "locked"}))
    assert {*locked} - {*kneed} == {"unlocking_impulse_trailing"}


@pytest.mark.parametrize(
    ("walker", "keys", "vary", "between", "slope"),
    [
        ("B", {}, "push_off", (0.0, 0.3), 0.0),
        pytest.param("B", {}, "push_off", (0.05, 0.3), -0.01, marks=SLOW),
        pytest.param("B", {"push_off": 0.15}, "m_h", (0.05, 2.0), 0.0, marks=SLOW),
        pytest.param("C", {}, "hip_torque", (0.005, 0.2), 0.0, marks=SLOW),
    ],
)
def test_keys_are_found_on_level_ground(walker, keys, vary, between, slope):
    value = 0.2 if walker == "B" else 0.08
    asked = {"set": keys, "vary": vary, "between": between, "slope": slope}
    found = at(walker, "froude_speed", value, **asked)["gaits"]

    assert found
    for gait in found:
        there = {"walker": walker, "slope": slope, "set": {**keys, vary: gait[vary]}}
        others = solve_one(there)["gaits"]
        (other,) = [one for one in others if one["gait"] == gait["gait"]]
        assert other["froude_speed"] == pytest.approx(value, rel=1e-12)
        assert other["loss_normal"] == pytest.approx(gait["loss_normal"], rel=1e-11)
        assert gait["slope"] == slope and gait["error_bound"] < 1e-12


def test_violations_on_level_ground_are_those_of_single_gaits():
    """Motions were integrated on the slope from which slopes of 0 are counted."""
    between = 0.12, 0.16
    found = at("B", "friction_demand", 0.28, vary="push_off", between=between, slope=0)

    assert found["gaits"]
    for gait in found["gaits"]:
        there = {"walker": "B", "slope": 0.0, "set": {"push_off": gait["push_off"]}}
        demands = [one["friction_demand"] for one in solve_one(there)["gaits"]]
        assert min(abs(demand / 0.28 - 1) for demand in demands) < 1e-11


@SLOW
def test_slopes_that_lead_up_and_down_are_searched_as_one_range():
    """By the speeds of single solves on both sides of each."""
    asked = {"set": {"push_off": 0.1}, "between": (-0.1, 0.05)}
    slopes = []
    for value in (0.15, 0.23):
        found = at("B", "froude_speed", value, **asked)["gaits"]
        assert len(found) == 2
        for gait in found:
            slopes.append(gait["slope"])
            for beside, is_faster in ((1e-4, True), (-1e-4, False)):
                there = {"slope": gait["slope"] + beside, "set": {"push_off": 0.1}}
                others = solve_one({"walker": "B", **there})["gaits"]
                (speed,) = [
                    one["froude_speed"] for one in others if one["gait"] == gait["gait"]
                ]
                assert (speed > value) == is_faster
    assert min(slopes) < 0 < max(slopes)


def test_a_passive_walker_has_no_gaits_over_slopes_that_lead_up():
    with pytest.raises(WalkerError, match="`between` must be slopes above 0, as noth"):
        at("B", "speed", 0.2, between=(-0.1, 0.1))


@SLOW
def test_slopes_of_a_kneed_walker_that_pushes_are_found_in_seconds():
    """They took minutes: curves were followed to where steps vanish in more and more
    points.
    """
    asked = {"set": {"push_off": 0.1}, "between": (-0.02, 0.02)}
    began = time.process_time()

    found = at("C", "froude_speed", 0.1, **asked)["gaits"]

    assert time.process_time() - began < 60
    assert len(found) == 1
    for gait in found:
        there = {"slope": gait["slope"], "set": {"push_off": 0.1}}
        others = solve_one({"walker": "C", **there})["gaits"]
        (single,) = [one for one in others if one["gait"] == gait["gait"]]
        assert single["froude_speed"] == pytest.approx(0.1, rel=1e-11)
