"""Steps from states anywhere in a step, and motions sampled at a constant step."""

import csv

import numpy as np
import pytest

import gaitsweep
from gaitsweep.pipeline.cli import commands

NAMES = ("stance_angle", "stance_rate", "thigh_rate")


def gait_of(walker, slope):
    found = gaitsweep.gaits(walker, slope).sel(gait="long")
    return [float(found[name]) for name in NAMES], float(found["period"])


CASES = [
    (
        "D",
        0.009,
    ),
    (
        "B",
        0.009,
    ),
    (
        "physical",
        0.036,
    ),
]


@pytest.mark.parametrize(("walker", "slope"), CASES)
def test_a_series_has_a_constant_step_over_all_steps(walker, slope):
    state, period = gait_of(walker, slope)

    walk = gaitsweep.simulate(
        walker,
        slope,
        state,
        3,
        dt=period / 40,
    )

    np.testing.assert_allclose(
        np.diff(walk["time"]),
        period / 40,
        rtol=1e-9,
    )
    assert walk.sizes["sample"] == 120
    assert np.bincount(walk["step_number"]).tolist() == [40] * 3
    np.testing.assert_allclose(
        walk["theta_st"][40:80], walk["theta_st"][:40], atol=1e-6
    )


def test_rates_of_a_series_are_derivatives_of_its_angles():
    state, period = gait_of("B", 0.009)

    walk = gaitsweep.simulate(
        "B",
        0.009,
        state,
        1,
        dt=period / 400,
    )

    for link in ("st", "th"):
        angle, rate = walk[f"theta_{link}"].values, walk[f"rate_{link}"].values
        differences = (angle[2:] - angle[:-2]) / (2 * period / 400)
        np.testing.assert_allclose(
            differences,
            rate[1:-1],
            atol=1e-4,
        )


@pytest.mark.parametrize(("walker", "slope"), CASES)
def test_a_series_has_both_limits_at_each_strike_on_request(walker, slope):
    state, period = gait_of(walker, slope)

    walk = gaitsweep.simulate(
        walker,
        slope,
        state,
        2,
        samples=81,
        limits=True,
    )

    time, stance = walk["time"].values, walk["theta_st"].values
    twice = np.flatnonzero(np.abs(np.diff(time)) < 1e-12)
    # Kneestrikes and the heelstrike between the first and the last instant.
    assert len(twice) == (3 if walker == "physical" else 1)
    # At heelstrike the legs change their names.
    heelstrike = twice[np.argmin(np.abs(time[twice] - period))]
    np.testing.assert_allclose(
        [stance[heelstrike], stance[heelstrike + 1]], [-state[0], state[0]], rtol=1e-9
    )


@pytest.mark.parametrize(("walker", "slope"), CASES)
def test_a_state_within_a_step_goes_on_to_the_same_heelstrike(walker, slope):
    state, period = gait_of(walker, slope)
    walk = gaitsweep.simulate(
        walker,
        slope,
        state,
        1,
        dt=period / 40,
    )
    row = walk.isel(sample=32)
    within = [
        float(row[name]) for name in ("theta_st", "theta_th", "rate_st", "rate_th")
    ]

    steps = gaitsweep.simulate(walker, slope, within, 2)
    image = gaitsweep.step_map(walker, slope, within).state

    assert float(steps["period"][0]) == pytest.approx(period - float(row["time"]))
    assert float(steps["period"][1]) == pytest.approx(period)
    np.testing.assert_allclose(
        [steps[name][1] for name in NAMES],
        state,
        rtol=1e-9,
    )
    np.testing.assert_allclose(
        image,
        state,
        rtol=1e-8,
    )


def test_a_state_with_a_free_knee_goes_on_to_its_kneestrike():
    state, period = gait_of("physical", 0.036)
    walk = gaitsweep.simulate("physical", 0.036, state, 1, dt=period / 100)
    clear = (walk["theta_sh"] < walk["theta_th"] - 0.05) & (walk["theta_st"] < 0)
    row = walk.isel(sample=int(np.flatnonzero(clear)[0]))
    within = [
        float(row[f"{kind}_{x}"])
        for kind in ("theta", "rate")
        for x in ("st", "th", "sh")
    ]

    steps = gaitsweep.simulate("physical", 0.036, within, 1)

    assert float(steps["period"][0]) == pytest.approx(period - float(row["time"]))
    np.testing.assert_allclose(
        [steps[name][1] for name in NAMES],
        state,
        rtol=1e-9,
    )


def test_four_numbers_with_both_feet_on_the_ground_are_three():
    (angle, *rates), _ = gait_of("B", 0.009)

    three = gaitsweep.step_map("B", 0.009, [angle, *rates])
    four = gaitsweep.step_map("B", 0.009, [angle, -angle, *rates])

    np.testing.assert_array_equal(three.state, four.state)


def test_a_state_of_another_slope_is_told_to_which_it_belongs():
    (angle, *rates), _ = gait_of("B", 0.009)
    gentler = [
        angle + 0.01,
        -angle + 0.01,
        *rates,
    ]
    steeper = [
        angle - 0.01,
        -angle - 0.01,
        *rates,
    ]

    with pytest.raises(gaitsweep.StudyError) as caught:
        gaitsweep.simulate("B", 0.019, gentler, 1)
    walk = gaitsweep.simulate("B", 0.019, steeper, 1)

    assert "slope of 0.009 rad (0.52°), to which it belongs" in str(caught.value)
    assert (
        "slope of 0.029 rad (1.66°), to which the state belongs" in walk.attrs["start"]
    )


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            {"dt": 0},
            "`dt` must be above 0",
        ),
        (
            {"dt": 5.0},
            "at most the shortest step, 3.882",
        ),
        (
            {"dt": 1e-9},
            "for 1,000,000 samples",
        ),
        (
            {"samples": 10**7},
            "`samples` must be a whole number from 2 to 1,000,000",
        ),
        (
            {"samples": 9, "dt": 0.1},
            "cannot both be given",
        ),
        (
            {"limits": True},
            "needs `dt` or `samples`",
        ),
        (
            {"state": [0.2, -0.2]},
            "must be 3, 4 or 6 numbers",
        ),
        (
            {"state": [-0.2, 0.1, 0.1, -1, 0, 0]},
            "must have no knee",
        ),
        (
            {"state": [-0.1, 7.0, -1, 0]},
            "must have angles below",
        ),
    ],
)
def test_wrong_samples_and_states_are_refused_in_a_line(arguments, message):
    state, _ = gait_of("D", 0.009)
    arguments = {"state": state, "steps": 2} | arguments

    with pytest.raises(gaitsweep.StudyError) as caught:
        gaitsweep.simulate("D", 0.009, **arguments)

    assert message in str(caught.value)


def test_the_command_writes_the_motion_as_csv(tmp_path, capsys):
    path = tmp_path / "walk.csv"
    words = [
        "simulate",
        "--walker",
        "physical",
        "--slope",
        "0.036",
        "--steps",
        "2",
    ]

    code = commands.main(
        [
            *words,
            "--csv",
            str(path),
            "--dt",
            "0.02",
            "--degrees",
        ]
    )

    with path.open() as file:
        rows = list(csv.DictReader(file))
    assert code == 0 and len(rows) == 76
    assert list(rows[0])[:3] == ["time (s)", "step_number", "theta_st (deg)"]
    assert "rate_st (deg s-1)" in rows[0]
    assert float(rows[0]["theta_st (deg)"]) == pytest.approx(13.940, abs=1e-3)
    assert float(rows[1]["time (s)"]) == pytest.approx(0.02)


def test_the_motion_replaces_no_table_of_others(tmp_path, capsys):
    path = tmp_path / "walk.csv"
    words = ["simulate", "--walker", "physical", "--slope", "0.036", "--steps", "1"]
    words += ["--csv", str(path), "--samples", "2"]  # none within a phase
    assert commands.main(words) == 0
    assert commands.main([*words, "--degrees"]) == 0  # over its own
    assert "(deg)" in path.read_text()
    capsys.readouterr()

    foreign = "time (s),step_number,angle\n1,2,3\n"
    path.write_text(foreign)

    assert commands.main(words) == 2
    assert path.read_text() == foreign
    said = f"gaitsweep: {path} is not a file of gaitsweep; move it away.\n"
    assert capsys.readouterr().err == said
