"""Fits on laws that are known."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gaitsweep.tasks.fits import power_law, transition
from gaitsweep.tasks.studies.fit_laws import scaling
from gaitsweep.tasks.studies.fit_laws import transition as transition_table
from lines import solved


def test_a_pure_power_is_found_to_rounding():
    x = np.geomspace(1e-6, 1e-1, 60)
    (run,) = power_law.plateaus(x, 3.5 * x**0.25)
    law = power_law.fit(x[run[0] : run[1] + 1], 3.5 * x[run[0] : run[1] + 1] ** 0.25)
    assert law.exponent == pytest.approx(0.25, abs=1e-13)
    assert law.amplitude == pytest.approx(3.5, rel=1e-12)
    assert law.low <= 0.25 <= law.high
    assert law.n == 60


@settings(max_examples=150, deadline=None)
@given(
    exponent=st.floats(-4, 4),
    log_amplitude=st.floats(-20, 20),
    log_from=st.floats(-12, 0),
    decades=st.floats(0.5, 12),
    n=st.integers(3, 3000),
)
def test_a_fit_is_that_of_data_off_by_a_few_roundings(
    exponent, log_amplitude, log_from, decades, n
):
    """Backward error: how far known data had to be moved, in ulps of its logarithm, for
    the law found to be theirs.
    """
    x = np.geomspace(10**log_from, 10 ** (log_from + decades), n)
    y = np.exp(log_amplitude) * x**exponent
    law = power_law.fit(x, y)
    size = 2.3e-16 * (
        1 + np.abs(np.log(y)).max() + abs(exponent) * np.abs(np.log(x)).max()
    )
    assert (
        np.abs(np.log(law.amplitude) + law.exponent * np.log(x) - np.log(y)).max()
        < 8 * size
    )
    # What data off by that much leave open of the exponent.
    assert abs(law.exponent - exponent) < 16 * size / np.log(10**decades)
    assert 0 <= law.high - law.low < 1e3 * n * size / np.log(10**decades)
    assert law.low <= law.exponent <= law.high


def test_the_transition_of_known_laws_is_found_with_its_power():
    """Angles that solve slope = c rho angle + (angle/B)^3: both laws and their crossing
    (B c rho)^(3/2) are exact.
    """
    slope, factor = np.geomspace(1e-12, 1e-1, 220), 0.37
    lines, inputs = [], []
    for ratio in (1e-1, 1e-2, 1e-3, 1e-4):
        angle = np.array(
            [
                next(
                    float(r.real)
                    for r in np.roots([transition.CUBE_ROOT**-3, 0, factor * ratio, -s])
                    if abs(r.imag) < 1e-9 * abs(r) and r.real > 0
                )
                for s in slope
            ]
        )
        lines.append({"walker": "E", "set": {"foot_mass_ratio": ratio}})
        inputs.append(
            {
                "slope": slope,
                "stance_angle": np.stack([angle * np.nan, angle], axis=1),
                **dict.fromkeys(("branch", "piece"), np.zeros((len(slope), 2), int)),
            }
        )
    table = transition_table({"lines": lines}, inputs)
    known = (
        transition.CUBE_ROOT * factor * table["fits/transition/foot_mass_ratio"]
    ) ** 1.5
    np.testing.assert_allclose(
        table["fits/transition/slope_transition"], known, rtol=3e-5
    )
    np.testing.assert_allclose(
        table["fits/transition/local_exponent"][:-1], 1.5, rtol=1e-5
    )


def _jumping(slope, jump=1e-3):
    """A line whose long gait goes from branch 1 to piece 1 of branch 0 at a slope, both
    following nearly one law.
    """
    angle = np.where(slope < jump, 1.0, 1.0005) * slope ** (1 / 3)
    branch = np.where(slope < jump, 1, 0)
    both = {
        "stance_angle": angle,
        "speed": angle,
        "power": angle**4,
        "branch": branch,
        "piece": 1 - branch,
    }
    return {"slope": slope, **{k: np.stack([v, v], axis=1) for k, v in both.items()}}


def test_a_law_is_of_one_piece_of_one_branch_and_says_which():
    data = _jumping(np.geomspace(1e-6, 0.2, 200))
    table = scaling({"lines": [{"walker": "E", "set": {}}]}, [data])
    rows = [
        {k.rpartition("/")[2]: v[i] for k, v in table.items()}
        for i in range(len(table["fits/scaling/n"]))
    ]
    small, large = (
        next(
            r
            for r in rows
            if (r["gait"], r["quantity"], r["regime"])
            == ("long", "stance_angle", regime)
        )
        for regime in ("small", "large")
    )
    assert (small["branch"], small["piece"], large["branch"], large["piece"]) == (
        1,
        0,
        0,
        1,
    )
    assert small["to"] < 1e-3 < large["from"]
    # Each is its branch's own, to rounding.
    assert small["amplitude"] == pytest.approx(1, rel=1e-12) and large[
        "amplitude"
    ] == pytest.approx(1.0005, rel=1e-12)
    nothing = scaling(
        {"lines": [{"walker": "E", "set": {}}]},
        [_jumping(np.geomspace(5e-4, 2e-3, 200))],
    )
    assert (nothing["fits/scaling/n"] == 0).all() and (
        nothing["fits/scaling/branch"] == -1
    ).all()


def test_two_pieces_of_one_branch_are_two_curves():
    data = _jumping(np.geomspace(1e-6, 0.2, 200))
    data["branch"] = np.zeros_like(data["branch"])
    table = scaling({"lines": [{"walker": "E", "set": {}}]}, [data])
    assert not (
        (table["fits/scaling/from"] < 1e-3) & (table["fits/scaling/to"] > 1e-3)
    ).any()


def test_a_transition_is_read_from_the_curve_that_comes_to_the_smallest_slope():
    slope = np.geomspace(1e-11, 0.05, 200)
    out = solved("E", slope, want=("stance_angle",))
    lines, known = (
        [{"walker": "E", "set": {}}],
        {k: out[k] for k in ("stance_angle", "branch", "piece")},
    )
    whole = transition_table({"lines": lines}, [{"slope": slope, **known}])
    assert whole["fits/transition/foot_mass_ratio"] == [0.1]
    other = transition_table(
        {"lines": [{"walker": "F", "set": {}}]}, [{"slope": slope, **known}]
    )
    assert other["fits/transition/foot_mass_ratio"] == [0.05]
    # Of equal angles the ratio is one; the law of the paper says 2^(3/2).
    both = transition_table(
        {"lines": [*lines, {"walker": "F", "set": {}}]}, [{"slope": slope, **known}] * 2
    )
    names = ("predicted", "exact_asymptotes", "fitted_lines")
    assert [both[f"fits/transition_ratio/{name}"][0] for name in names] == [
        2**1.5,
        1,
        1,
    ]
    # From 0.02 on the label goes to another branch.
    beyond = slope > 0.02
    jumps = {
        "stance_angle": np.where(
            beyond[:, None], 2 * known["stance_angle"], known["stance_angle"]
        ),
        "branch": np.where(beyond[:, None], 7, known["branch"]),
        "piece": known["piece"],
    }
    found = transition_table({"lines": lines}, [{"slope": slope, **jumps}])
    kept = transition_table(
        {"lines": lines},
        [{"slope": slope[~beyond], **{k: v[~beyond] for k, v in known.items()}}],
    )
    assert found.keys() == kept.keys() == whole.keys() and found[
        "fits/transition/branch"
    ] == [0]
    for name in found:
        np.testing.assert_array_equal(found[name], kept[name])


def test_ratios_are_those_of_the_walkers_and_exponents_those_between_different_ones():
    slope = np.geomspace(1e-11, 0.05, 200)
    data = []
    for ratio in (0.1, 0.1, 0.05):
        out = solved("E", slope, want=("stance_angle",), foot_mass_ratio=ratio)
        data.append(
            {"slope": slope, **{k: out[k] for k in ("stance_angle", "branch", "piece")}}
        )
    lines = [
        {"walker": {"base": "E"}, "set": {}},
        {"walker": "E", "set": {"g": 2.0}},
        {"walker": "F", "set": {}},
    ]
    found = transition_table({"lines": lines}, data)
    assert found["fits/transition/foot_mass_ratio"].tolist() == [0.1, 0.1, 0.05]
    exponents = found["fits/transition/local_exponent"]
    slopes = found["fits/transition/slope_transition"]
    assert exponents[0] == exponents[1] == pytest.approx(
        np.log2(slopes[0] / slopes[2])
    ) and np.isnan(exponents[2])
    few = {k: v if k == "slope" else v[:3] for k, v in data[0].items()} | {
        "slope": slope[:3]
    }
    assert transition_table({"lines": lines[:1]}, [few]) == {}
    assert transition_table({"lines": [{"walker": "A", "set": {}}]}, data[:1]) == {}


def test_a_bend_splits_the_range():
    x = np.geomspace(1e-8, 1e4, 240)
    y = 1 / (1 / x + 1 / x ** (1 / 3))
    runs = power_law.plateaus(x, y)
    assert power_law.local_exponents(x, y)[runs[0][0]] == pytest.approx(1, abs=0.01)
    assert power_law.local_exponents(x, y)[runs[-1][1] - 1] == pytest.approx(
        1 / 3, abs=0.01
    )


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
    found, error, sensitivity, n = transition.linear_amplitude(
        slope, np.where(angle > 0, angle, a * slope * 1e-3)
    )
    # ln(1 - x) bends beyond its first term: 2 % off the law leaves 4e-6 in its limit.
    assert found == pytest.approx(a, rel=4e-6)
    # The law is bent by less than 2 % up to there.
    assert (
        sensitivity
        == slope[n - 1]
        == slope[1 - 0.3 * (slope / bend) ** 2 > np.exp(-0.02)].max()
    )
    assert error < 1e-3
    x = transition.crossing(a, transition.CUBE_ROOT)
    assert a * x == pytest.approx(transition.CUBE_ROOT * x ** (1 / 3), rel=1e-12)


@pytest.mark.parametrize(("first", "rows"), [(1e-12, 220), (1e-3, 3000)])
def test_a_linear_law_is_fitted_only_where_angles_are_linear(first, rows):
    """Above the transition thousands of slopes lie so close that some change
    angle/slope by less than 2 %.
    """
    slope, ratio = np.geomspace(first, 0.1, rows), 1e-3
    angle = (
        (4 * np.tanh(np.pi / 2) ** 2 * slope / ratio) ** -3.0
        + (transition.CUBE_ROOT**3 * slope) ** -1.0
    ) ** (-1 / 3)
    known = {
        "stance_angle": np.stack([angle, angle], axis=1),
        **dict.fromkeys(("branch", "piece"), np.zeros((rows, 2))),
    }
    table = transition_table(
        {"lines": [{"walker": "E", "set": {"foot_mass_ratio": ratio}}]},
        [{"slope": slope, **known}],
    )
    found = (
        table["fits/transition/slope_transition"],
        table["fits/transition/slope_transition_fitted"],
    )
    if first > 1e-5:
        assert np.isnan(found).all()
    else:
        np.testing.assert_allclose(
            found, table["fits/transition/asymptotic"][0], rtol=0.05
        )


def test_the_asymptotic_law_is_three_halves():
    ratio = np.array([1e-2, 1e-4])
    crossing = transition.asymptotic(ratio)
    assert np.log(crossing[0] / crossing[1]) / np.log(100) == pytest.approx(
        1.5, rel=1e-12
    )
    # 4 tanh^2(pi/2)/ratio is the linear amplitude behind it.
    linear = 4 * np.tanh(np.pi / 2) ** 2 / ratio
    assert transition.crossing(linear[0], transition.CUBE_ROOT) == pytest.approx(
        crossing[0], rel=1e-12
    )


def test_light_feet_reach_the_three_halves_power():
    slope = np.geomspace(1e-10, 1e-2, 90)
    lines, inputs = [], []
    for ratio in (1e-3, 1e-4):
        out = solved("E", slope, want=("stance_angle",), foot_mass_ratio=ratio)
        lines.append({"walker": "E", "set": {"foot_mass_ratio": ratio}})
        inputs.append(
            {"slope": slope, **{k: out[k] for k in ("stance_angle", "branch", "piece")}}
        )
    table = transition_table({"lines": lines}, inputs)
    assert table["fits/transition/local_exponent"][0] == pytest.approx(1.5, abs=3e-3)
    found = table["fits/transition/slope_transition"]
    np.testing.assert_allclose(found, table["fits/transition/asymptotic"], rtol=5e-3)


def test_a_law_that_holds_from_the_smallest_speeds_on_is_that_of_small_ones():
    slope = np.geomspace(1e-6, 1e-1, 160)
    angle = slope ** (1 / 3)
    # The local exponent of power in speed changes too much within a decade for the
    # smaller tolerance, not the larger.
    power = np.exp(4 * np.log(angle) + 0.0035 * np.log(angle / angle[0]) ** 2)
    both = {
        "stance_angle": angle,
        "speed": angle,
        "power": power,
        **dict.fromkeys(("branch", "piece"), 0 * angle),
    }
    data = {"slope": slope, **{k: np.stack([v, v], axis=1) for k, v in both.items()}}
    table = scaling({"lines": [{"walker": "E", "set": {}}]}, [data])
    power_laws = table["fits/scaling/quantity"] == "power_speed"
    for regime, points in (("small", 160), ("large", 0)):
        rows = power_laws & (table["fits/scaling/regime"] == regime)
        assert rows.sum() == 2 and (table["fits/scaling/n"][rows] == points).all()


def test_five_points_over_a_decade_are_a_plateau():
    """Alone on their curve they had none, beside others they had."""
    slope = np.geomspace(1e-4, 1e-3, 5)
    one, no = np.ones((5, 2)), np.zeros((5, 2), int)
    data = {
        "slope": slope,
        "stance_angle": one * slope[:, None],
        "speed": one * slope[:, None] ** 2,
        "power": one,
    }
    table = scaling(
        {"lines": [{"walker": "E", "set": {}}]}, [{**data, "branch": no, "piece": no}]
    )
    small = table["fits/scaling/regime"] == "small"
    laws = zip(
        table["fits/scaling/quantity"][small],
        table["fits/scaling/exponent"][small],
        strict=True,
    )
    assert dict(laws) == pytest.approx(
        {"stance_angle": 1.0, "speed": 2.0, "power_speed": 0.0}, abs=1e-12
    )
    assert set(table["fits/scaling/n"][small]) == {5}
