"""Fits on laws that are known."""

import numpy as np
import pytest

from tasks.fits import power_law, transition


def test_a_pure_power_is_found_to_rounding():
    x = np.geomspace(1e-6, 1e-1, 60)
    (run,) = power_law.plateaus(x, 3.5 * x**0.25)
    law = power_law.fit(x[run[0]:run[1] + 1], 3.5 * x[run[0]:run[1] + 1] ** 0.25)
    assert law.exponent == pytest.approx(0.25, abs=1e-13)
    assert law.amplitude == pytest.approx(3.5, rel=1e-12)
    assert law.low <= 0.25 <= law.high
    assert law.n == 60


def test_a_bend_splits_the_range():
    x = np.geomspace(1e-8, 1e4, 240)
    y = 1 / (1 / x + 1 / x ** (1 / 3))
    runs = sorted(power_law.plateaus(x, y))
    assert power_law.local_exponents(x, y)[runs[0][0]] == pytest.approx(1, abs=0.01)
    assert power_law.local_exponents(x, y)[runs[-1][1] - 1] == pytest.approx(1 / 3, abs=0.01)


def test_noise_widens_the_interval_that_holds_the_truth():
    rng = np.random.default_rng(5)
    x = np.geomspace(1e-4, 1, 80)
    y = 2 * x ** (1 / 3) * np.exp(1e-3 * rng.standard_normal(80))
    law = power_law.fit(x, y)
    assert law.low < 1 / 3 < law.high


def test_crossing_of_two_laws():
    slope = np.geomspace(1e-9, 1e-4, 80)
    a, bend = 4e4, 3e-6
    angle = a * slope * (1 - 0.3 * (slope / bend) ** 2)
    found, error, _, n = transition.linear_amplitude(slope, np.where(angle > 0, angle, a * slope * 1e-3))
    # ln(1 - x) bends beyond its first term: 2 % off the law leaves 4e-6 in its limit.
    assert found == pytest.approx(a, rel=4e-6)
    assert n >= 4
    assert error < 1e-3
    x = transition.crossing(a, transition.CUBE_ROOT)
    assert a * x == pytest.approx(transition.CUBE_ROOT * x ** (1 / 3), rel=1e-12)


def test_the_asymptotic_law_is_three_halves():
    ratio = np.array([1e-2, 1e-4])
    crossing = transition.asymptotic(ratio)
    assert np.log(crossing[0] / crossing[1]) / np.log(100) == pytest.approx(1.5, rel=1e-12)
    # 4 tanh^2(pi/2)/ratio is the linear amplitude behind it.
    linear = 4 * np.tanh(np.pi / 2) ** 2 / ratio
    assert transition.crossing(linear[0], transition.CUBE_ROOT) == pytest.approx(crossing[0], rel=1e-12)


def test_light_feet_reach_the_three_halves_power():
    from lines import solved
    from tasks.fit import transition as fit_transition

    slope = np.geomspace(1e-10, 1e-2, 90)
    lines, inputs = [], []
    for ratio in (1e-3, 1e-4):
        out = solved("E", slope, want=("stance_angle",), foot_mass_ratio=ratio)
        lines.append({"walker": "E", "set": {"foot_mass_ratio": ratio}})
        inputs.append({"slope": slope, "stance_angle": out["stance_angle"]})
    table = fit_transition({"lines": lines}, inputs)
    assert table["fits/transition/local_exponent"][0] == pytest.approx(1.5, abs=3e-3)
    found = table["fits/transition/slope_transition"]
    np.testing.assert_allclose(found, table["fits/transition/asymptotic"], rtol=5e-3)
