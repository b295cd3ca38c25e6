"""The variables of others: what `reference` prints in them is what their own equations
take for a gait, and `check` confirms it.
"""

import csv
import io
import json

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import gaitsweep
from gaitsweep.pipeline.cli import commands

CONVENTIONS = ("gaitsweep", "garcia", "goswami", "drake", "mcgeer")


def printed(capsys, *options):
    """Rows that the command prints, and what it says on stderr."""
    assert commands.main(["reference", *options]) == 0
    out, err = capsys.readouterr()
    return list(csv.DictReader(io.StringIO(out))), err


@pytest.mark.parametrize("walker", ["D", "A", "goswami-compass.toml"])
@pytest.mark.parametrize("convention", CONVENTIONS)
def test_what_reference_prints_check_confirms(capsys, tmp_path, convention, walker):
    options = ("--convention", convention, "--walker", walker)
    assert commands.main(["reference", *options]) == 0
    states = tmp_path / "states.csv"
    states.write_text(capsys.readouterr().out)

    assert commands.main(["check", str(states), *options, "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)["rows"]
    assert len(rows) >= 12
    assert all(row["is_gait"] for row in rows)
    assert all(row["distance"] < 1e-12 for row in rows)

    names = [row["name"] for row in csv.DictReader(states.read_text().splitlines())]
    assert [f"-{row['gait']}-" in name for row, name in zip(rows, names, strict=True)]


def flown(rates, start, struck, end=10.0):
    """State at which the motion from a start meets the condition for heelstrike."""
    struck.terminal, struck.direction = True, -1
    options = {"rtol": 1e-12, "atol": 1e-13, "events": struck}
    # Just after heelstrike the condition is met too.
    away = solve_ivp(rates, (0, 0.05), start, rtol=1e-12, atol=1e-13).y[:, -1]
    return solve_ivp(rates, (0.05, end), away, **options)


def of_gait(capsys, convention, walker, name):
    """The numbers of one gait in a convention, by their names."""
    rows, _ = printed(capsys, "--convention", convention, "--walker", walker)
    (row,) = [row for row in rows if row["name"] == name]
    numbers = {
        column: float(text)
        for column, text in row.items()
        if column not in ("name", "walker", "gait")
    }
    slope = numbers.pop("slope")
    period = numbers.pop("period")
    return np.array([*numbers.values()]), slope, period


def of_drake(m, mh, length, b, g, u):
    """Mass matrix and bias of Drake's compass gait (examples/compass_gait), written
    anew: angles of both legs from the vertical, clockwise.
    """
    stance, swing, stance_rate, swing_rate = u
    a = length - b
    c = np.cos(swing - stance)
    s = np.sin(stance - swing)
    coupling = m * length * b
    mass = np.array(
        [
            [mh * length**2 + m * (length**2 + a**2), -coupling * c],
            [-coupling * c, m * b**2],
        ]
    )

    weight = (mh * length + m * (a + length)) * g * np.sin(stance)
    bias = np.array(
        [
            -coupling * swing_rate**2 * s - weight,
            coupling * stance_rate**2 * s + m * b * g * np.sin(swing),
        ]
    )
    return mass, bias


def after_collision(m, mh, length, b, before):
    """Rates after the impact of the swing foot, by a model whose foot is free: position
    of the stance foot and both angles.
    """
    stance, swing, *rates = before
    along = {angle: np.array([np.cos(angle), -np.sin(angle)]) for angle in before[:2]}

    def velocity(on_stance, on_swing):
        """That of a point (2, 4), by those of the coordinates."""
        columns = [
            [1.0, 0.0],
            [0.0, 1.0],
            on_stance * along[stance],
            on_swing * along[swing],
        ]
        return np.array(columns).T

    leg = velocity(length - b, 0)
    hip = velocity(length, 0)
    other_leg = velocity(length, -b)
    foot = velocity(length, -length)

    mass = m * leg.T @ leg
    mass += mh * hip.T @ hip
    mass += m * other_leg.T @ other_leg
    inverse = np.linalg.inv(mass)
    moving = np.array([0.0, 0.0, *rates])
    impulse = np.linalg.solve(foot @ inverse @ foot.T, foot @ moving)
    after = moving - inverse @ foot.T @ impulse
    return np.array([swing, stance, after[3], after[2]])


COMPASS = (5.0, 10.0, 1.0, 0.5)


def flown_by_drake(start, slope):
    """The motion to what Drake takes for the collision of the foot."""

    def rates(t, u):
        mass, bias = of_drake(*COMPASS, 9.81, u)
        return [u[2], u[3], *np.linalg.solve(mass, -bias)]

    def struck(t, u):
        return max(2 * slope - u[0] - u[1], u[1] - u[0])

    return flown(rates, start, struck)


def test_drake_takes_its_variables_for_a_gait(capsys):
    name = "goswami-compass-long-0.0524"
    start, slope, period = of_gait(capsys, "drake", "goswami-compass", name)
    motion = flown_by_drake(start, slope)
    after = after_collision(*COMPASS, motion.y[:, -1])
    assert motion.t[-1] == pytest.approx(period, rel=1e-9)
    assert after == pytest.approx(start, abs=1e-9)


def test_drake_ends_a_short_step_where_the_legs_pass(capsys):
    """They pass when the stance leg is beyond the normal, and its witness is negative
    there.
    """
    name = "goswami-compass-short-0.0524"
    start, slope, period = of_gait(capsys, "drake", "goswami-compass", name)
    motion = flown_by_drake(start, slope)
    stance, swing = motion.y[:2, -1]
    assert motion.t[-1] < 0.6 * period and swing == pytest.approx(stance, abs=1e-9)
    assert stance > slope


def test_goswami_measures_in_the_other_sense(capsys):
    """His legs are clockwise where Drake's are not, so that at both ends of a step their
    angles add to minus two slopes.
    """
    name = "goswami-compass-long-0.0524"
    own, slope, _ = of_gait(capsys, "goswami", "goswami-compass", name)
    drake, *_ = of_gait(capsys, "drake", "goswami-compass", name)
    assert own == pytest.approx(-drake, rel=1e-15)
    assert own[0] + own[1] == pytest.approx(-2 * slope, abs=1e-15)


@pytest.mark.parametrize("name", ["D-long-0.01", "D-short-0.01"])
def test_garcia_takes_his_variables_for_a_gait(capsys, name):
    """Equations and heelstrike of Garcia, Chatterjee, Ruina and Coleman (1998)."""
    start, slope, period = of_gait(capsys, "garcia", "D", name)

    def rates(t, u):
        theta, phi, theta_rate, phi_rate = u
        pull = np.sin(theta - slope)
        weight = np.cos(theta - slope)
        swing = np.sin(phi) * (theta_rate**2 - weight)
        return [theta_rate, phi_rate, pull, pull + swing]

    def struck(t, u):
        # The swing foot is above the ground, or not far enough beyond the stance foot.
        return max(2 * u[0] - u[1], u[1] + 0.1)

    motion = flown(rates, start, struck)
    theta, _, rate, _ = motion.y[:, -1]
    c = np.cos(2 * theta)
    after = [
        -theta,
        -2 * theta,
        c * rate,
        c * (1 - c) * rate,
    ]
    assert motion.t[-1] == pytest.approx(period, rel=1e-9)
    assert np.array(after) == pytest.approx(start, abs=1e-9)


def test_states_of_garcias_own_program_are_gaits():
    """The long and the short gait at slope 0.009, to about 1e-10, with which his program
    of 1998 starts; there the second angle is that outside the legs, pi - phi.
    """
    angle = np.array([0.20031090049483, 0.19393736960624])
    rate = np.array([-0.19983247291764, -0.20386692731962])
    table = {
        "theta": angle,
        "phi": 2 * angle,
        "theta_dot": rate,
        "phi_dot": rate * (1 - np.cos(2 * angle)),
    }
    checked = gaitsweep.check(table, "D", 0.009, convention="garcia")
    assert checked["gait"].tolist() == ["long", "short"]
    assert checked["is_gait"].all()
    assert (checked["distance"] < 2e-9).all()


def test_mcgeer_turns_with_the_wheel_that_rolls_downhill(capsys):
    """Angles from the surface normal that grow in the direction of walking, time over
    sqrt(l/g): a step begins with the contact leg behind the normal.
    """
    name = "goswami-compass-long-0.0524"
    state, _, period = of_gait(capsys, "mcgeer", "goswami-compass", name)
    gait = gaitsweep.gaits("goswami-compass.toml", 0.0524).sel(gait="long")
    unit = 9.81**-0.5
    angle = float(gait["stance_angle"])
    rate = float(gait["stance_rate"])
    assert state[:3] == pytest.approx([-angle, angle, -rate * unit], rel=1e-12)
    assert state[0] < 0 < state[2]
    assert period == pytest.approx(float(gait["period"]) / unit, rel=1e-12)


def test_digits_are_kept(capsys):
    """Sums are exact; a number that converts rates leaves 16 digits."""
    found = {}
    for convention in CONVENTIONS:
        options = ("--walker", "goswami-compass", "--convention", convention)
        rows, _ = printed(capsys, *options)
        (found[convention],) = [
            row for row in rows if row["name"] == "goswami-compass-long-0.05"
        ]

    ours, drake = found["gaitsweep"], found["drake"]
    assert ours["stance_angle"] == "0.26682122236903970072"
    assert drake["stance"] == "-0.21682122236903970072"
    assert drake["stancedot"] == ours["stance_rate"].removeprefix("-")
    assert len(found["garcia"]["theta_dot"]) == len("-0.") + 16


def test_walkers_with_knees_are_left_out_with_a_word(capsys):
    rows, said = printed(capsys, "--convention", "drake")
    assert said == "Gaits of C, physical are left out: `drake` has no knees.\n"
    assert {"C", "physical"}.isdisjoint({row["walker"] for row in rows})
    rows, said = printed(capsys)
    assert len(rows) == 110
    assert not said
    assert {row["gait"] for row in rows} == {"long", "short"}


def test_json_has_the_same_rows(capsys):
    rows, _ = printed(capsys, "--convention", "mcgeer", "--walker", "E")
    options = ["--convention", "mcgeer", "--walker", "E", "--json"]
    assert commands.main(["reference", *options]) == 0
    assert json.loads(capsys.readouterr().out) == rows


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--convention", "drke"], "Unknown convention `drke`, did you mean `drake`?"),
        (["--walker", "Q"], "Unknown walker `Q`, known: A, B, C, D,"),
    ],
)
def test_a_wrong_name_is_answered_in_one_line(capsys, options, said):
    assert commands.main(["reference", *options]) == 2
    err = capsys.readouterr().err
    assert said in err and err.count("\n") == 1
