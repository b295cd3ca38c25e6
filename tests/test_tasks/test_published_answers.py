"""Published values found backwards: as targets, on curves over two keys, and as optima.

Each is a row of the table "Published answers" of docs/trust.md.
"""

import tomllib
from pathlib import Path

import numpy as np
import pytest

import gaitsweep
from gaitsweep.tasks.studies.follow_curves import curve
from gaitsweep.tasks.studies.solve_points import atlas

ROOT = Path(__file__).resolve().parents[2]


def printed(name):
    """A value of the literature that data/reference has."""
    path = ROOT / "data/reference/published.toml"
    rows = tomllib.loads(path.read_text(encoding="utf-8"))["values"]

    (row,) = [each for each in rows if each["id"] == name]

    return row["value"]


def test_the_slope_of_a_published_stance_angle_is_the_published_one():
    """P. A. Bhounsule (2014), table 1: the short gait of the simplest walker at 0.009."""
    angle = printed("D-short-stance_angle")

    found = gaitsweep.solve(
        "D",
        at={"stance_angle": angle},
        between=(0.006, 0.02),
    )

    short = found[found["gait"] == "short"].iloc[0]
    assert short["slope"] == pytest.approx(0.009, rel=1e-12)
    rate = printed("D-short-stance_rate")
    assert short["stance_rate"] == pytest.approx(rate, abs=1e-14)

    multipliers = np.array(short["multipliers"])
    for number in (1, 2):
        value = printed(f"D-short-multiplier-{number}")
        assert np.abs(multipliers - value).min() < 2e-12


def test_power_grows_with_the_fourth_power_of_the_speed():
    """M. Garcia, A. Chatterjee and A. Ruina (2000), equation 8: of both gaits of D."""
    slow = gaitsweep.gaits(
        "D",
        at={"speed": [0.01, 0.02]},
        variables=["power"],
    )

    ratio = (slow.power[1] / slow.power[0]).dropna("gait").values

    assert len(ratio) == 2
    np.testing.assert_allclose(ratio, 16, rtol=3e-3)


@pytest.mark.thorough
def test_a_push_off_costs_a_quarter_of_a_slope_at_the_same_speed():
    """A. D. Kuo (2002): just before heelstrike it costs four times less than power that
    acts during the step, in the limit of short steps.
    """
    at = {"froude_speed": 0.02}
    downhill = gaitsweep.solve("D", at=at)
    level = gaitsweep.solve("D", 0.0, at=at, vary="push_off")

    for gait in ("long", "short"):
        cost = [
            table.loc[table["gait"] == gait, "cost_of_transport"].item()
            for table in (level, downhill)
        ]
        assert cost[0] / cost[1] == pytest.approx(0.25, abs=1e-3)


@pytest.mark.thorough
def test_the_curve_of_flips_passes_the_published_doubling_of_the_compass_gait():
    """A. Goswami, B. Thuilot and B. Espiau (1996): its first at 4.37 degrees, with a
    hip of twice the mass of a leg, from which the curve begins far away.
    """
    path = ROOT / "data/walkers/goswami-compass.toml"
    compass = tomllib.loads(path.read_text(encoding="utf-8"))["walker"]
    line = {
        "walker": compass | {"m_h": 6.0},
        "set": {},
    }

    found = curve(
        {
            "line": line,
            "slope": np.array([0.02, 0.12]),
            "kinds": ["flip"],
            "key": "m_h",
            "from": 6.0,
            "to": 10.0,
        },
        [atlas({"line": line}, [])],
    )

    assert found["curves/value"][-1] == 10.0
    assert np.degrees(found["curves/slope"][-1]) == pytest.approx(4.37, abs=0.03)
