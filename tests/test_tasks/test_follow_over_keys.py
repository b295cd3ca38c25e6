"""Curves over two keys: closed ones, and several of one condition."""

import numpy as np
import pytest

from gaitsweep.tasks.branches.conditions import Condition
from gaitsweep.tasks.branches.equations import Equations, Keys
from gaitsweep.tasks.studies.follow_curves import curve
from gaitsweep.tasks.studies.follow_over_keys import curves_over_keys
from gaitsweep.tasks.studies.gaits_over_key import gaits_over_key
from gaitsweep.tasks.studies.solve_at_slope import solve_one
from gaitsweep.tasks.walkers.resolve import walkers_over

LINE = {"walker": "A", "set": {}}
RANGES = {"R": (0.1, 0.3), "m_h": (0.0, 2.0)}
MIDDLES = 0.8, 1.2


def circle(middle, radius):
    """Vanishes on a circle of keys, over the lengths of their ranges."""

    def value(at):
        walkers = at.problem.every_walker
        across = (walkers.R - 0.2) / 0.2
        up = (walkers.m_h - middle) / 2
        off = across**2 + up**2 - radius**2
        return np.broadcast_to(off, at.q.shape)

    return value


def both(at):
    """Vanishes on either of two circles that lie apart."""
    one = circle(MIDDLES[0], 0.09)
    other = circle(MIDDLES[1], 0.09)
    return one(at) * other(at)


@pytest.fixture(scope="module")
def around():
    condition = Condition("level", circle(1.0, 0.3))
    return curves_over_keys(LINE, np.array([0.02]), RANGES, {"circle": condition})


def test_a_curve_that_returns_to_its_start_is_closed_and_followed_once(around):
    # One of long gaits, and one of short ones.
    assert set(around["curves/curve"]) == {0, 1}
    for number in (0, 1):
        own = around["curves/curve"] == number
        stopped = around["curves/stopped"][own]
        assert stopped[0] == stopped[-1] == "closed"

        R = around["curves/value"][own]
        m_h = around["curves/other_value"][own]
        assert (R[0], m_h[0]) == pytest.approx((R[-1], m_h[-1]), abs=1e-9)
        assert np.ptp(m_h) == pytest.approx(1.2, rel=0.02)


def test_points_of_a_curve_fulfil_its_condition(around):
    across = (around["curves/value"] - 0.2) / 0.2
    up = (around["curves/other_value"] - 1) / 2
    off = across**2 + up**2
    np.testing.assert_allclose(off, 0.09, rtol=1e-9)
    assert (around["curves/walks"] == 1).all()


@pytest.mark.thorough
def test_components_that_lie_apart_are_found():
    conditions = {"both": Condition("level", both)}
    found = curves_over_keys(LINE, np.array([0.02]), RANGES, conditions)
    middles = []
    for number in set(found["curves/curve"]):
        own = found["curves/curve"] == number
        m_h = found["curves/other_value"][own]
        middles.append((m_h.min() + m_h.max()) / 2)
    assert sorted(middles) == pytest.approx([0.8, 0.8, 1.2, 1.2], abs=0.02)


@pytest.mark.thorough
def test_flips_on_level_ground_are_followed_over_the_push_off_and_a_key():
    """Single gaits have the multiplier -1 there."""
    plane = {
        "push_off": [0.1, 0.2],
        "R": [0.0, 0.2],
    }
    asked = {
        "line": {"walker": "D", "set": {}},
        "slope": np.array([0.0]),
        "plane": plane,
        "kinds": ["flip"],
    }

    found = {
        name.removeprefix("curves/"): column
        for name, column in curve(asked, [{}]).items()
    }

    last = len(found["kind"]) - 1
    assert last > 4
    assert set(found["slope"]) == {0.0}
    assert found["walks"].all()
    assert (found["error_bound"] < 1e-13).all()
    for k in (0, last // 2, last):
        gait = long_gait(
            push_off=found["value"][k],
            R=found["other_value"][k],
        )
        multiplier, _ = gait["multipliers"][0]
        assert multiplier == pytest.approx(-1, abs=1e-11)

        angle = found["stance_angle"][k]
        assert gait["stance_angle"] == pytest.approx(angle, rel=1e-12)


def long_gait(**keys):
    """The long gait of D on level ground."""
    asked = {
        "walker": "D",
        "slope": 0.0,
        "set": keys,
    }
    for gait in solve_one(asked)["gaits"]:
        if gait["gait"] == "long":
            return gait
    raise AssertionError(keys)


def test_a_curve_on_which_steps_vanish_ends():
    """On level ground short steps vanish at a push-off: 5,000 points led to angles
    of 1e-218.
    """
    walker_at = walkers_over({"walker": "B", "set": {}}, "push_off")
    keys = Keys.of_one("push_off", walker_at, 0.01, 0.3)

    curves = [X for X, _ in gaits_over_key(Equations(keys, [], 0.0))]

    lengths = [len(X) for X in curves]
    least = min(float(X[:, 0].min()) for X in curves)
    assert max(lengths) < 500 and -25 < least < -20
