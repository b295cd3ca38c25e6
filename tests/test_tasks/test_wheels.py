"""A rimless wheel, by its closed form: a check of heelstrike, and of the simplest
walker's stance leg.
"""

import json

import numpy as np
import pytest

import gaitsweep
from conftest import ROOT
from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.step.simulate import scanner
from gaitsweep.tasks.walkers.resolve import resolve


def struck(walker, angle, stance_rate, swing_rate):
    """Stance rate just after the heelstrike of legs at an angle to both sides."""
    problem = Problem(walker)
    n = len(angle)
    before = np.array(
        [
            -angle,
            angle,
            np.full(n, stance_rate),
            np.full(n, swing_rate),
        ]
    )
    parameters = problem.parameters(np.full(n, 0.05), np.ones(n))
    return scanner(problem.structure).strike(before, parameters)[1]


SPOKES = np.array([5, 6, 8, 12, 40])
#: Of the rates after and before a strike.
RATIO = np.cos(2 * np.pi / SPOKES)


@pytest.mark.parametrize("swing_rate", [0.7, -2.0])
def test_heelstrike_keeps_of_a_wheels_energy_the_squared_cosine(swing_rate):
    """The legs of D, whose feet have no mass, stand as neighbouring spokes of a wheel
    with its mass at the hub, however the swing leg moves.
    """
    after = struck(resolve("D"), np.pi / SPOKES, -1.3, swing_rate)
    kept = (after / -1.3) ** 2
    assert kept == pytest.approx(RATIO**2, rel=2e-15)
    assert after / -1.3 == pytest.approx(RATIO, rel=1e-15)


def test_legs_of_small_mass_strike_as_a_wheel_in_the_limit():
    """What feet of mass change vanishes with their mass."""
    differences = []
    for ratio in (1e-3, 1e-4, 1e-5):
        walker = resolve("E", {"foot_mass_ratio": ratio})
        after = struck(walker, np.pi / SPOKES, -1.3, 0.7)
        differences.append(np.abs(after / -1.3 - RATIO).max())

    ratios = np.divide(differences[:-1], differences[1:])
    assert ratios == pytest.approx([10, 10], rel=0.02)


def rate_of_wheel(angle, slope):
    """Rate just after a strike of a wheel that rolls steadily, sqrt(g/l): what it gains
    from strike to strike it loses at each.
    """
    return 2 * np.sqrt(np.sin(angle) * np.sin(slope)) / np.tan(2 * angle)


def test_the_stance_leg_of_every_gait_of_d_is_a_spoke():
    reference = json.loads((ROOT / "data" / "reference" / "gaits.json").read_text())
    gaits = [
        entry
        for entry in reference["entries"]
        if entry["walker"] == "D" and entry["kind"] == "gait"
    ]
    assert len(gaits) == 16
    for entry in gaits:
        angle = float(entry["stance_angle"])
        slope = float(entry["slope"])
        rate = rate_of_wheel(angle, slope)
        assert -float(entry["stance_rate"]) == pytest.approx(rate, rel=2e-15)


def test_gaits_of_d_are_solved_to_the_closed_form():
    slope = np.geomspace(1e-5, 0.018, 30)
    gaits = gaitsweep.gaits("D", slope, variables=["stance_angle", "stance_rate"])
    for label in ("long", "short"):
        gait = gaits.sel(gait=label)
        rate = rate_of_wheel(gait["stance_angle"].values, slope)
        assert -gait["stance_rate"].values == pytest.approx(rate, rel=1e-12)


def test_the_example_of_the_docs_rolls_to_its_closed_form():
    """A wheel of eight spokes, simulated step by step by its own equations."""
    slope, rate = 0.1, 0.9
    alpha = np.pi / 8
    gained = 4 * np.sin(alpha) * np.sin(slope)
    for _ in range(60):
        assert rate**2 > 2 * (1 - np.cos(alpha - slope))  # it passes the top
        rate = np.cos(2 * alpha) * np.sqrt(rate**2 + gained)
    assert rate == pytest.approx(rate_of_wheel(alpha, slope), rel=1e-12)
    assert round(rate, 4) == 0.3909
    text = (ROOT / "docs" / "physics.md").read_text(encoding="utf-8")
    assert "0.3909 √(g/l)" in text
