"""Whether states that somebody holds for gaits are gaits, and if not, why."""

import json
import re
import time

import numpy as np
import pandas as pd
import pytest

import gaitsweep
from gaitsweep.pipeline.cli import commands
from gaitsweep.pipeline.report import check_page
from gaitsweep.tasks.branches import atlas
from gaitsweep.tasks.branches.nearest import described
from gaitsweep.tasks.check import several_steps
from gaitsweep.tasks.check.case import Case
from gaitsweep.tasks.check.grounds import Grounds
from gaitsweep.tasks.check.rows import Rows
from gaitsweep.tasks.gaits.newton import newton
from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.walkers.resolve import resolve

NAMES = ("stance_angle", "stance_rate", "thigh_rate")
SLOPE = 0.03


def gait_of(walker, slope, label="long", **more):
    """State of a gait, in the walker's units."""
    found = gaitsweep.gaits(walker, slope, variables=list(NAMES), **more)
    return np.array([float(found[name].sel(gait=label)) for name in NAMES])


@pytest.fixture(scope="module")
def compass(tmp_path_factory):
    """Goswami's walker, in SI, whose unit of time is not 1."""
    table = {"knees": False, "units": "SI", "g": 9.8, "m_h": 10.0}
    return table | {"m": 5.0, "l": 1.0, "c": 0.5, "w": 0.0, "r": 0.0, "R": 0.0}


def judged(table, walker, slope=SLOPE, **more):
    return gaitsweep.check(table, walker, slope, **more).iloc[0]


DEGREE = np.pi / 180
UNIT = (1.0 / 9.8) ** 0.5
FAULTS = {
    "sign_of_angle": lambda a, b, c: (
        -a,
        b,
        c,
    ),
    "sign_of_stance_rate": lambda a, b, c: (
        a,
        -b,
        c,
    ),
    "sign_of_thigh_rate": lambda a, b, c: (
        a,
        b,
        -c,
    ),
    "sign_of_rates": lambda a, b, c: (
        a,
        -b,
        -c,
    ),
    "mirrored": lambda a, b, c: (
        -a,
        -b,
        -c,
    ),
    "legs_exchanged": lambda a, b, c: (
        -a,
        c,
        b,
    ),
    "rates_exchanged": lambda a, b, c: (
        a,
        c,
        b,
    ),
    "degrees": lambda a, b, c: (
        a / DEGREE,
        b / DEGREE,
        c / DEGREE,
    ),
    "angle_in_degrees": lambda a, b, c: (
        a / DEGREE,
        b,
        c,
    ),
    "rates_in_degrees": lambda a, b, c: (
        a,
        b / DEGREE,
        c / DEGREE,
    ),
    "radians": lambda a, b, c: (
        a * DEGREE,
        b * DEGREE,
        c * DEGREE,
    ),
    "rates_over_root": lambda a, b, c: (
        a,
        b * UNIT,
        c * UNIT,
    ),
    "reversed": lambda a, b, c: (
        c,
        b,
        a,
    ),
    "columns_exchanged": lambda a, b, c: (
        b,
        a,
        c,
    ),
    "angle_between_legs": lambda a, b, c: (
        2 * a,
        b,
        c,
    ),
    "rate_between_legs": lambda a, b, c: (
        a,
        b,
        b - c,
    ),
    "from_vertical": lambda a, b, c: (
        a - SLOPE,
        b,
        c,
    ),
    "clockwise_from_vertical": lambda a, b, c: (
        SLOPE - a,
        -b,
        -c,
    ),
    "near": lambda a, b, c: (
        1.001 * a,
        b,
        c,
    ),
    "none": lambda a, b, c: (
        2.5 * a,
        b,
        c,
    ),
}


@pytest.mark.parametrize("label", ["long", "short"])
def test_a_gait_is_one(compass, label):
    row = judged([gait_of(compass, SLOPE, label)], compass)

    assert row["verdict"] == "gait" and row["is_gait"]
    assert row["gait"] == label and row["steps"] == 1
    assert row["distance"] < 1e-9 and row["missed"] < 1e-9


@pytest.fixture(scope="module")
def faulty(compass):
    """Verdicts of a table with a row for each fault, by their names."""
    state = gait_of(compass, SLOPE)
    table = [fault(*state) for fault in FAULTS.values()]
    return dict(zip(FAULTS, gaitsweep.check(table, compass, SLOPE).iloc, strict=True))


@pytest.mark.parametrize("fault", FAULTS)
def test_each_fault_of_a_state_is_named(faulty, fault):
    row = faulty[fault]

    assert row["verdict"] == fault, row["reason"]
    assert not row["is_gait"] and row["gait"] == "long"


def test_the_slope_to_which_a_state_belongs_is_told(compass):
    row = judged([gait_of(compass, 0.0314)], compass)

    assert row["verdict"] == "slope" and "belongs to 0.0314 rad" in row["reason"]
    assert row["belongs_to_slope"] == pytest.approx(0.0314, rel=1e-9)


def test_angles_of_both_legs_tell_the_ground_on_which_they_stand(compass):
    angle, *rates = gait_of(compass, 0.04)
    # Turned by the difference of the slopes, as angles from another ground's normal.
    turned = {"stance_angle": angle - 0.01, "thigh_angle": -angle - 0.01}
    table = {**turned, "stance_rate": rates[0], "thigh_rate": rates[1]}

    row = judged(table, compass)

    assert row["verdict"] == "slope"
    assert row["belongs_to_slope"] == pytest.approx(0.04, rel=1e-9)


def test_a_gait_of_two_steps_taken_for_one_is_told():
    state = gait_of("D", 0.0165, steps=2)

    one, two = judged([state], "D", 0.0165), judged([state], "D", 0.0165, steps=2)

    assert (one["verdict"], one["steps"], one["is_gait"]) == ("period", 2, False)
    assert two["verdict"] == "gait" and two["missed"] < 1e-9


def test_a_row_with_a_fault_is_as_far_from_its_gait_as_without_it():
    state = gait_of("D", 0.009)
    table = [state * [-1, 1, 1], np.degrees(state), state * [1 + 1e-7, -1, -1]]

    told = gaitsweep.check(table, "D", 0.009)

    assert told["verdict"].tolist() == ["sign_of_angle", "degrees", "sign_of_rates"]
    np.testing.assert_allclose(told["distance"], [0, 0, 1e-7], atol=1e-9)


def test_a_row_just_before_heelstrike_is_as_far_from_its_gait_as_that_is_there():
    walked = gaitsweep.simulate(
        "D", 0.009, gait_of("D", 0.009), 1, samples=200, limits=True
    )
    at = int(np.flatnonzero(walked["step_number"].values == 0)[-1])
    before = [float(walked[name][at]) for name in ("theta_st", "rate_st", "rate_th")]

    row = judged([before], "D", 0.009)

    assert row["verdict"] == "before_heelstrike" and row["distance"] < 1e-6


def test_gaits_of_fewer_steps_than_claimed_are_told_with_a_fault_too():
    """Those that divide the claimed ones repeat after these as well."""
    one, two = gait_of("D", 0.0165), gait_of("D", 0.0165, steps=2)
    table = [one, two, -one, -two]

    told = gaitsweep.check(table, "D", 0.0165, steps=4)

    assert told["verdict"].tolist() == ["period", "period", "mirrored", "mirrored"]
    assert told["steps"].tolist() == [1, 2, 1, 2]
    for reason, words in zip(told["reason"], ["1 step", "2 steps"] * 2, strict=True):
        assert reason.lower().endswith(f"repeats after {words}.")


def test_the_picture_has_the_gaits_of_several_steps_that_are_claimed():
    angles = states_of_cycle("D", 0.0165, 2)[:, 0]

    told = gaitsweep.check([gait_of("D", 0.0165, steps=2)], "D", 0.0165, steps=2)

    drawn = []
    for curve in told.attrs["curves"]:
        if curve["slope"].min() < 0.0165 < curve["slope"].max():
            order = np.argsort(curve["slope"])
            known = curve["slope"][order], curve["stance_angle"][order]
            drawn.append(np.interp(0.0165, *known))
    for angle in angles:
        assert np.abs(np.array(drawn) - angle).min() < 1e-5


CYCLES = [
    pytest.param("D", 0.0165, 2),
    pytest.param("B", 0.018, 4, marks=pytest.mark.thorough),
    pytest.param("C", 0.085, 2, marks=pytest.mark.thorough),
]


def states_of_cycle(walker, slope, steps):
    """States with which the steps of a gait begin, as a simulation has them."""
    first = gait_of(walker, slope, steps=steps)
    moved = gaitsweep.simulate(walker, slope, first, steps - 1)
    return np.array([np.ravel(moved[name].values)[:steps] for name in NAMES]).T


@pytest.mark.parametrize(("walker", "slope", "steps"), CYCLES)
def test_each_fault_of_a_gait_of_several_steps_is_named(walker, slope, steps):
    begun = states_of_cycle(walker, slope, steps)
    expected = ["gait"] * steps
    table = [*begun]
    in_place = {"from_vertical", "clockwise_from_vertical", "rates_over_root", "none"}
    for verdict, change in FAULTS.items():
        # Each begins at another step than the one before.
        if verdict not in in_place:
            table.append(np.array(change(*begun[len(table) % steps])))
            expected.append(verdict)

    one = gait_of(walker, slope)
    told = gaitsweep.check([*table, one], walker, slope, steps=steps)

    assert told["verdict"].tolist() == [*expected, "period"]
    assert told["steps"].tolist() == [*[steps] * len(table), 1]


@pytest.mark.parametrize(("walker", "slope", "steps"), CYCLES)
def test_the_slope_of_a_gait_of_several_steps_is_told(walker, slope, steps):
    begun = states_of_cycle(walker, 1.004 * slope, steps)

    told = gaitsweep.check(begun, walker, slope, steps=steps)

    assert set(told["verdict"]) == {"slope"}
    np.testing.assert_allclose(told["belongs_to_slope"], 1.004 * slope, rtol=1e-6)


def test_a_rounded_slope_of_a_gait_of_several_steps_is_told():
    table = {"slope": ["0.0165", "0.0170"]}
    exact = [gait_of("D", slope, steps=2) for slope in (0.01652, 0.0170)]
    for name, values in zip(NAMES, np.transpose(exact), strict=True):
        table[name] = [f"{value:.4f}" for value in values]

    told = gaitsweep.check(pd.DataFrame(table), "D", steps=2)

    assert told["verdict"].tolist() == ["gait", "gait"]
    assert told["steps"].tolist() == [2, 2]


def test_a_gait_of_another_walker_is_told():
    row = judged([gait_of("B", 0.009)], "E", 0.009)

    assert (row["verdict"], row["walker"]) == ("walker", "B")


def test_a_gait_of_two_steps_of_another_walker_is_told():
    row = judged([gait_of("D", 0.0165, steps=2)], "B", 0.0165, steps=2)

    assert (row["verdict"], row["walker"]) == ("walker", "D")


def test_digits_that_were_cut_are_told_apart_from_a_table_of_few(compass):
    exact = gait_of(compass, SLOPE)
    cut = np.round(exact, 4)

    both = gaitsweep.check([exact, cut], compass, SLOPE)
    alone = judged([cut], compass)

    assert both["verdict"].tolist() == ["gait", "digits"]
    assert alone["verdict"] == "gait"


def test_a_state_in_the_middle_of_a_step_is_flown_to_its_end(compass):
    state = gait_of(compass, SLOPE)
    motion = gaitsweep.simulate(compass, SLOPE, state, 1, motion=True)
    stance, thigh, when = (
        motion[name].values[0, 0] for name in ("theta_st", "theta_th", "time")
    )
    k = 36
    h = when[k + 1] - when[k]
    rates = [
        (8 * (x[k + 1] - x[k - 1]) - (x[k + 2] - x[k - 2])) / (12 * h)
        for x in (stance, thigh)
    ]
    names = ("stance_angle", "thigh_angle", "stance_rate", "thigh_rate")
    table = dict(zip(names, (stance[k], thigh[k], *rates), strict=True))

    row = judged(table, compass, tolerance=1e-4)

    assert row["flown"] and row["verdict"] == "gait", row["reason"]


def test_a_state_with_the_swing_foot_under_ground_is_refused(compass):
    table = {
        "stance_angle": 0.3,
        "thigh_angle": -0.1,
        "stance_rate": -1,
        "thigh_rate": 0,
    }

    row = judged(table, compass)

    assert row["verdict"] == "below_ground"
    assert row["belongs_to_slope"] == pytest.approx(SLOPE - 0.1)


def test_gaits_of_knees_are_checked(compass):
    state = gait_of("physical", 0.036)

    verdicts = [judged([x], "physical", 0.036)["verdict"] for x in (state, state[::-1])]

    assert verdicts == ["gait", "reversed"]


def _moving(walker, slope, state):
    """A step at twenty times, in the columns of `check`, from its simulation."""
    motion = gaitsweep.simulate(walker, slope, state, 1, motion=True, dt=0.04)
    links = {"stance": "st", "thigh": "th", "shank": "sh"}
    table = {}
    for name, link in links.items():
        table[f"{name}_angle"] = motion[f"theta_{link}"].values
        table[f"{name}_rate"] = motion[f"rate_{link}"].values
    return pd.DataFrame(table)


@pytest.mark.parametrize("digits", [12, 5])
def test_states_with_a_bent_knee_are_flown_to_the_end_of_their_step(digits):
    table = _moving("physical", 0.036, gait_of("physical", 0.036)).round(digits)

    checked = gaitsweep.check(table, "physical", 0.036)

    is_bent = table["shank_angle"] < table["thigh_angle"] - 1e-4
    assert is_bent.sum() > 8 and (~is_bent).sum() > 4
    assert checked["is_gait"].all(), checked["reason"].tolist()
    assert checked["flown"].tolist()[1:] == [True] * (len(table) - 1)


@pytest.mark.thorough
def test_a_changed_rate_of_a_bent_shank_is_no_gait():
    table = _moving("physical", 0.036, gait_of("physical", 0.036)).iloc[[6]]

    assert judged(table, "physical", 0.036)["is_gait"]
    table.loc[:, "shank_rate"] *= 1.01
    assert judged(table, "physical", 0.036)["verdict"] == "near"


def test_a_bent_knee_puts_the_foot_above_or_below_the_ground():
    """Where knee and foot are follows from the links' lengths alone."""
    row = judged(
        {
            "stance_angle": 0.2,
            "thigh_angle": -0.1,
            "shank_angle": -0.15,
            "stance_rate": -1.0,
            "thigh_rate": 1.0,
            "shank_rate": 1.0,
        },
        "physical",
        0.036,
    )

    keys = {"l_t": 0.35, "l_s": 0.46, "R": 0.2, "eps_T": 0.097}
    below_knee = keys["l_s"] - keys["R"]
    turned = np.arcsin(keys["l_t"] * np.sin(keys["eps_T"]) / below_knee)
    line = keys["l_t"] * np.cos(keys["eps_T"]) + below_knee * np.cos(turned)
    thigh = keys["l_t"] * np.exp(1j * (-0.1 - keys["eps_T"] - np.pi / 2))
    shank = below_knee * np.exp(1j * (-0.15 + turned - np.pi / 2))
    swing, stance = thigh + shank, line * np.exp(1j * (0.2 - np.pi / 2))
    way = swing - stance
    assert row["verdict"] == "below_ground" and way.imag < 0
    tilt = np.arctan(way.imag / way.real)
    assert row["belongs_to_slope"] == pytest.approx(0.036 - tilt, abs=1e-12)


def test_straight_knees_need_no_more_columns_and_bent_ones_a_rate():
    state = dict(zip(NAMES, gait_of("physical", 0.036), strict=True))
    straight = state | {"shank_angle": -state["stance_angle"]}
    assert judged(straight, "physical", 0.036)["verdict"] == "gait"

    bent = straight | {"shank_angle": -state["stance_angle"] - 0.1}
    with pytest.raises(gaitsweep.StudyError, match="`shank_rate` is needed"):
        gaitsweep.check(bent, "physical", 0.036)
    absent = judged(bent | {"shank_rate": np.nan}, "physical", 0.036)
    assert absent["verdict"] == "not_a_number"
    with pytest.raises(gaitsweep.StudyError, match="a walker without knees"):
        gaitsweep.check(bent | {"shank_rate": 0.0}, "D", 0.009)


@pytest.mark.thorough
def test_the_rate_that_heelstrike_gives_a_free_shank_is_compared():
    names = [*NAMES, "shank_rate"]
    found = gaitsweep.gaits("physical", 0.036, variables=names).sel(gait="long")
    state = {name: float(found[name]) for name in names}

    assert judged(state, "physical", 0.036)["verdict"] == "gait"
    wrong = judged(state | {"shank_rate": state["thigh_rate"]}, "physical", 0.036)
    assert wrong["verdict"] == "shank_rate"
    assert f"gives it {state['shank_rate']:.6g}" in wrong["reason"]


@pytest.mark.parametrize(
    ("walker", "slope", "state"),
    [
        ("A", 0.03, [0.3378646946395741, -1.1317728430271727, -0.7748042835683868]),
        pytest.param(
            "physical",
            0.03,
            [0.23576086614515102, -0.8582486952489479, -0.25538266326346476],
            marks=pytest.mark.thorough,
        ),
    ],
)
def test_gaits_whose_legs_pass_three_times_are_found_beside_the_branches(
    walker, slope, state
):
    """The motion itself shows how often the legs pass, and that it repeats."""
    motion = gaitsweep.simulate(walker, slope, state, 1, motion=True)
    between = (motion["theta_th"] - motion["theta_st"]).values.ravel()
    signs = np.sign(between[np.isfinite(between)])
    assert np.count_nonzero(np.diff(signs)) == 3
    after = [float(motion[name].values[1]) for name in NAMES]
    np.testing.assert_allclose(after, state, rtol=1e-9)

    row = judged([state], walker, slope)
    changed = judged([np.array(state) * [1 + 1e-5, 1, 1]], walker, slope)

    assert (row["verdict"], row["gait"]) == ("gait", "passes_3_times")
    assert row["distance"] < 1e-11 and not row["stable"]
    assert (changed["verdict"], changed["gait"]) == ("near", "passes_3_times")
    assert changed["distance"] == pytest.approx(1e-5, rel=1e-3)


@pytest.mark.parametrize("steps", [2, 3, 8])
def test_a_gait_of_one_step_beside_the_branches_is_none_of_several(steps):
    """It was one of any number: all of its steps solve their equations."""
    state = [0.3378646946395741, -1.1317728430271727, -0.7748042835683868]

    row = judged([state], "A", 0.03, steps=steps)

    assert (row["verdict"], row["steps"]) == ("period", 1)
    assert row["reason"] == "Repeats after 1 step." and row["gait"] == "passes_3_times"


@pytest.fixture(scope="module")
def two_steps():
    """A gait of two steps of C, with the rate of its free shank, at slope 0.085."""
    names = (*NAMES, "shank_rate")
    found = gaitsweep.gaits("C", 0.085, variables=[*names], steps=2).sel(gait="long")
    return {name: float(found[name]) for name in names}


@pytest.mark.thorough
def test_the_rate_of_a_free_shank_is_compared_in_gaits_of_several_steps(two_steps):
    moved = gaitsweep.simulate("C", 0.085, [two_steps[name] for name in NAMES], 2)
    after = [float(moved[name].values[2]) for name in NAMES]
    np.testing.assert_allclose(after, [two_steps[name] for name in NAMES], rtol=1e-8)
    straight = two_steps | {"shank_angle": -two_steps["stance_angle"]}

    wrong = straight | {"shank_rate": two_steps["shank_rate"] * 1.01}
    right, changed = (judged(table, "C", 0.085, steps=2) for table in (straight, wrong))

    assert (right["verdict"], right["steps"]) == ("gait", 2)
    assert changed["verdict"] == "shank_rate"
    assert f"gives it {two_steps['shank_rate']:.6g}" in changed["reason"]


@pytest.mark.parametrize("steps", [1, 2])
def test_a_straight_leg_has_one_rate(steps):
    state = dict(zip(NAMES, gait_of("B", 0.0165, steps=steps), strict=True))
    shank = {"shank_angle": -state["stance_angle"], "shank_rate": state["thigh_rate"]}

    right = judged(state | shank, "B", 0.0165, steps=steps)
    shank["shank_rate"] *= 1.01
    wrong = judged(state | shank, "B", 0.0165, steps=steps)

    assert (right["verdict"], wrong["verdict"]) == ("gait", "shank_rate")


def test_a_state_near_a_gait_of_as_many_steps_as_claimed_is_near_that():
    state = gait_of("B", 0.0165, steps=2) * [1.001, 1, 1]

    row = judged([state], "B", 0.0165, steps=2)

    assert (row["verdict"], row["steps"]) == ("near", 2)
    assert row["distance"] == pytest.approx(1e-3, rel=1e-3)


def test_a_solution_of_two_steps_that_are_none_is_no_gait():
    """Its second stance angle is negative: its foot strikes behind, and before it began."""
    sections = [-3.5924881, 2.5630948, 2.5571984, -0.9980606, -2.5625015, -2.5561102]
    guess = np.array([[*sections, 4.1115436, 2.8546666]]).T
    q, lanes = np.log([0.08]), np.array([0])
    problem = Problem(resolve("A", {}), 2)
    w, solved = newton(problem, guess, q)
    state = described(problem, w, q).state
    assert solved.all() and np.abs(w[3] + 1).max() < 0.01

    of_rows = dict(zip(NAMES, state, strict=True))
    digits = dict.fromkeys(NAMES, np.zeros(1))
    params = {"slope": [0.08], "convention": "gaitsweep", "tolerance": 1e-6}
    params |= {"table": of_rows, "digits": digits, "sizes": digits, "rates": "scaled"}
    rows = Rows.of(problem.walker, params)
    case = Case(problem.walker, Grounds(problem.of_steps(1), [], 2), rows)
    several_steps._judge_cycles_of(case, problem, lanes, w, q)

    assert case.verdict.tolist() == [""]


def _rounded(values, digits):
    return [float(f"{value:.{digits - 1}e}") for value in values]


@pytest.mark.parametrize("walker", ["A", pytest.param("C", marks=pytest.mark.thorough)])
@pytest.mark.parametrize("digits", [4, 6])
def test_tables_of_few_digits_are_gaits_to_these_with_their_slopes_rounded(
    walker, digits
):
    slope = np.geomspace(0.002, 0.03, 12)
    found = gaitsweep.gaits(walker, slope, variables=list(NAMES)).sel(gait="long")
    states = {name: found[name].values for name in NAMES} | {"slope": slope}
    decimals = {name: np.round(column, digits) for name, column in states.items()}
    as_many = {name: _rounded(column, digits) for name, column in states.items()}

    for table in (decimals, as_many):
        checked = gaitsweep.check(table, walker)
        assert checked["is_gait"].all(), checked["reason"].tolist()
    with_slope = gaitsweep.check(decimals | {"slope": slope}, walker)
    assert with_slope["is_gait"].all()
    said = f"A gait, to the {digits} digits given."
    assert said in with_slope["reason"].tolist()


def test_a_rounded_slope_changes_neither_the_period_nor_what_the_shank_lacks():
    """Such rows were gaits of two steps, and with any rate of the shank."""
    found = gaitsweep.solve("C", 0.0123456789)
    table = {name: np.round(found[name], 5) for name in NAMES}
    table["slope"] = [0.01235] * len(found)

    assert set(gaitsweep.check(table, "C")["verdict"]) == {"gait"}
    of_two = gaitsweep.check(table, "C", steps=2)
    assert set(of_two["reason"]) == {"Repeats after 1 step."}
    shanks = {"shank_angle": -table["stance_angle"], "shank_rate": [-5.0] * len(found)}
    wrong = gaitsweep.check(table | shanks, "C")
    assert set(wrong["verdict"]) == {"shank_rate"}


def test_a_gait_of_level_ground_that_is_a_little_off_is_near():
    """It was one of the slope on which it was."""
    found = gaitsweep.solve("B", 0.0, push_off=0.1)
    table = {name: found[name] * (1 + 1.5e-6) for name in NAMES}

    checked = gaitsweep.check(table, "B", slope=0.0, push_off=0.1)

    assert set(checked["verdict"]) == {"near"}


def test_a_slope_that_is_missing_is_told_with_its_row():
    state = dict(zip(NAMES, gait_of("D", 0.009), strict=True))
    table = pd.DataFrame([state | {"slope": 0.009}, state])
    with pytest.raises(gaitsweep.StudyError, match=r"got nan \(row 2, slope\)"):
        gaitsweep.check(table, "D")


def test_the_slope_of_a_neighbour_is_no_rounding():
    slope = np.round(np.linspace(0.01, 0.02, 11), 3)
    found = gaitsweep.gaits("D", slope, variables=list(NAMES)).sel(gait="long")
    states = {name: np.round(found[name].values, 4) for name in NAMES}
    shifted = {**states, "slope": np.roll(slope, 1)}

    assert set(gaitsweep.check(shifted, "D")["verdict"]) == {"slope"}


def test_a_column_that_names_several_walkers_is_refused(tmp_path):
    state = dict(zip(NAMES, gait_of("D", 0.009), strict=True))
    twice = {name: [value, value] for name, value in state.items()}

    one = gaitsweep.check({**twice, "walker": ["D", "D"]}, "D", 0.009)
    assert one["is_gait"].all()
    with pytest.raises(gaitsweep.StudyError, match="`walker` must name one walker"):
        gaitsweep.check({**twice, "walker": ["D", "A"]}, "D", 0.009)


def feet(stance, swing):
    """Hip and swing foot over the stance foot of legs of unit length, from the angles of
    both legs from the vertical, counter-clockwise; x to the right.
    """
    hip = np.array([-np.sin(stance), np.cos(stance)])
    return hip, hip + np.array([np.sin(swing), -np.cos(swing)])


def _garcia(stance, swing, rates):
    normal = stance + SLOPE
    between = stance - swing
    columns = {"theta": normal, "phi": between, "theta_dot": UNIT * rates[0]}
    return columns | {"phi_dot": UNIT * (rates[0] - rates[1])}


def _goswami(stance, swing, rates):
    columns = {"theta_s": stance, "theta_ns": swing}
    return columns | {"theta_s_dot": rates[0], "theta_ns_dot": rates[1]}


def _drake(stance, swing, rates):
    columns = {"stance": -stance, "swing": -swing}
    return columns | {"stancedot": -rates[0], "swingdot": -rates[1]}


def _mcgeer(stance, swing, rates):
    columns = {"theta_C": -(stance + SLOPE), "theta_F": -(swing + SLOPE)}
    return columns | {"omega_C": -UNIT * rates[0], "omega_F": -UNIT * rates[1]}


CONVENTIONS = {
    "garcia": _garcia,
    "goswami": _goswami,
    "drake": _drake,
    "mcgeer": _mcgeer,
}


@pytest.mark.parametrize("convention", CONVENTIONS)
def test_conventions_place_feet_and_hip_where_ours_do(compass, convention):
    """The legs' angles from the vertical are those of the drawn feet and hip."""
    angle, *rates = gait_of(compass, SLOPE)
    hip, foot = feet(angle - SLOPE, -angle - SLOPE)
    stance = np.arctan2(-hip[0], hip[1])
    swing = np.arctan2(foot[0] - hip[0], hip[1] - foot[1])
    assert np.arctan2(foot[1], -foot[0]) == pytest.approx(SLOPE)  # both on the slope

    table = CONVENTIONS[convention](stance, swing, rates)
    row = judged(table, compass, convention=convention)

    assert row["verdict"] == "gait", row["reason"]
    assert not row["flown"]


def test_published_gaits_are_gaits_in_their_own_conventions(compass):
    """Goswami's compass at 3 degrees, as printed with the walker's public ports."""
    printed = {"theta_ns": -0.3234, "theta_s": 0.2187}
    printed |= {"theta_ns_dot": -0.3772, "theta_s_dot": -1.0918}

    row = judged(printed, compass, 3 * DEGREE, convention="goswami", tolerance=2e-3)

    assert row["verdict"] == "gait", row["reason"]


def test_ten_thousand_states_take_five_seconds():
    slope = np.linspace(0.005, 0.015, 10_000)
    found = gaitsweep.gaits("B", slope, variables=list(NAMES)).sel(gait="long")
    table = {name: found[name].values for name in NAMES}

    begin = time.process_time()
    right = gaitsweep.check({**table, "slope": slope}, "B")
    middle = time.process_time()
    wrong = gaitsweep.check(table, "B", 0.009)
    end = time.process_time()

    assert right["is_gait"].all()
    assert (wrong["verdict"] == "slope").sum() >= 9_999
    np.testing.assert_allclose(
        wrong["belongs_to_slope"].fillna(0.009), slope, rtol=1e-8
    )
    assert max(middle - begin, end - middle) < 5


def test_an_angle_of_the_swing_leg_that_is_none_is_told():
    angle, *rates = gait_of("D", 0.009)
    row = judged(
        {
            "stance_angle": angle,
            "thigh_angle": np.nan,
            "stance_rate": rates[0],
            "thigh_rate": rates[1],
        },
        "D",
        0.009,
    )
    assert row["verdict"] == "not_a_number"


def test_both_angles_from_the_vertical_are_told(compass):
    angle, *rates = gait_of(compass, SLOPE)
    turned = {"stance_angle": angle - SLOPE, "thigh_angle": -angle - SLOPE}
    table = {**turned, "stance_rate": rates[0], "thigh_rate": rates[1]}
    assert judged(table, compass)["verdict"] == "from_vertical"


def test_a_state_that_falls_on_its_way_says_so(compass):
    table = {
        "stance_angle": 0.3,
        "thigh_angle": -0.1,
        "stance_rate": 3.0,
        "thigh_rate": 3.0,
    }
    row = judged(table | {"thigh_angle": -0.4}, compass)
    said = "Flown on, the walker has no heelstrike: "
    assert row["verdict"] == "none" and row["flown"]
    assert row["reason"].startswith(said) and len(row["reason"]) > len(said) + 5


def test_few_digits_in_all_rows_excuse_no_more_than_a_hundredth():
    row = judged([[0.2, -0.2, -0.2]], "D", 0.009)
    assert row["verdict"] == "near" and 0.05 < row["distance"] < 0.1


def test_a_gait_in_the_middle_of_a_step_is_called_so_though_flight_adds_to_its_error():
    start = gait_of("D", 0.009)
    motion = gaitsweep.simulate("D", 0.009, start, 1, motion=True)
    k = 36
    stance, thigh, when = (
        motion[name].values[0, 0] for name in ("theta_st", "theta_th", "time")
    )
    h = when[k + 1] - when[k]
    rates = [
        (8 * (x[k + 1] - x[k - 1]) - (x[k + 2] - x[k - 2])) / (12 * h)
        for x in (stance, thigh)
    ]
    names = ("stance_angle", "thigh_angle", "stance_rate", "thigh_rate")
    table = dict(zip(names, (stance[k], thigh[k], *rates), strict=True))
    distance = judged(table, "D", 0.009, tolerance=1e-2)["distance"]
    row = judged(table, "D", 0.009, tolerance=distance / 4)
    assert row["verdict"] == "gait" and row["flown"]
    assert row["reason"] == "A gait, in the middle of a step."
    assert judged(table, "D", 0.009, tolerance=distance / 40)["verdict"] != "gait"


@pytest.mark.parametrize("legs", ["old", "mirrored", "new"])
def test_a_state_before_heelstrike_is_told_by_either_legs_name(legs):
    names = [*NAMES, "heelstrike_rate_ratio"]
    found = gaitsweep.gaits("D", 0.009, variables=names).sel(gait="long")
    angle, after, _, ratio = (float(found[name]) for name in names)
    # The foot without mass takes nothing of the hip's velocity along the new leg.
    old = after / np.cos(2 * angle)
    swing = old + ratio * abs(old)
    state = {
        "old": [-angle, old, swing],
        "mirrored": [angle, old, swing],
        "new": [angle, swing, old],
    }
    assert judged([state[legs]], "D", 0.009)["verdict"] == "before_heelstrike"


def test_rates_of_the_walker_read_as_scaled_are_told(compass):
    row = judged([gait_of(compass, SLOPE)], compass, rates="scaled")
    assert row["verdict"] == "rates_in_units"


@pytest.mark.parametrize("order", [(1, 2, 0), (2, 0, 1)])
def test_columns_in_any_order_are_told(compass, order):
    state = gait_of(compass, SLOPE)[list(order)]
    assert judged([state], compass)["verdict"] == "columns_exchanged"


def test_a_gait_of_a_walker_with_another_unit_of_time_is_told():
    """Rates are taken as they are: the walker's second is the other's unit of time."""
    row = judged([gait_of("A", 0.009)], "E", 0.009)
    assert (row["verdict"], row["walker"]) == ("walker", "A")


def test_a_walker_whose_unit_of_time_is_one_has_no_fault_of_units():
    state = gait_of("D", 0.009) * [1 + 1.5e-6, 1, 1]
    row = judged([state], "D", 0.009)
    assert row["verdict"] == "slope"  # the next rule
    assert row["belongs_to_slope"] == pytest.approx(0.009, rel=1e-4)


def test_what_is_half_as_large_again_is_near_to_none(compass):
    angle, *rates = gait_of(compass, SLOPE)
    row = judged([[1.5 * angle, *rates]], compass)
    assert row["verdict"] == "none" and 0.1 < row["distance"] < 1


def test_a_gait_of_one_step_claimed_to_take_two_is_told():
    row = judged([gait_of("D", 0.009)], "D", 0.009, steps=2)
    assert (row["verdict"], row["steps"], row["is_gait"]) == ("period", 1, False)


def test_ten_thousand_rows_of_noise_take_no_longer():
    """States that are near no branch are not followed along it."""
    random = np.random.default_rng(1)
    angle = random.uniform(0.05, 0.5, 10_000)
    rates = random.uniform(-0.5, 0.5, (2, 10_000))
    table = dict(zip(NAMES, (angle, *rates), strict=True))
    begin = time.process_time()
    checked = gaitsweep.check(table, "B", 0.009)
    assert time.process_time() - begin < 4
    assert set(checked["verdict"]) <= {"none", "near"}


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "states.csv"
    state = gait_of("D", 0.009)
    frame = pd.DataFrame([[0.009, *state], [0.009, *(state * [1, -1, 1])]])
    frame.columns = ["gamma", *NAMES]
    frame.to_csv(path, index=False)
    return path


def test_the_command_tells_verdicts_and_fails_if_one_is_no_gait(file, tmp_path, capsys):
    words = ["check", str(file), "--walker", "D", "--map", "gamma=slope"]

    assert (
        commands.main(
            [
                *words,
                "--page",
                str(tmp_path / "page.html"),
            ]
        )
        == 1
    )
    told = capsys.readouterr().out.splitlines()
    assert told[0] == "1 of 2 states are gaits; the others: 1 sign of stance rate."
    assert told[1] == "Rows that are no gaits come first."
    assert told[2].startswith("row 2: A gait with the sign of the stance rate changed.")

    page = (tmp_path / "page.html").read_text()
    assert told[0] in page and "<svg" in page and "sign of stance rate" in page

    assert commands.main([*words, "--json"]) == 1
    answer = json.loads(capsys.readouterr().out)
    assert [row["is_gait"] for row in answer["rows"]] == [True, False]


def test_the_command_succeeds_if_all_are_gaits(tmp_path, capsys):
    path = tmp_path / "states.csv"
    state = ",".join(map(str, gait_of("D", 0.009)))
    path.write_text(f"{','.join(NAMES)}\n{state}\n")

    assert commands.main(["check", str(path), "--walker", "D", "--slope", "0.009"]) == 0
    assert capsys.readouterr().out.startswith("The one state is a gait")


HEAD = ",".join(NAMES)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "",
            "states.csv is empty",
        ),
        (
            HEAD,
            "must have 1 to 1,000,000 rows; got 0",
        ),
        (
            f"{HEAD}\n0.2,x,0.1",
            "`stance_rate` must be a number; got 'x' in row 1",
        ),
        (
            "stance_angle,stance_rate\n0.2,-0.2",
            "Column `thigh_rate` is missing",
        ),
        (
            f"{HEAD},stance_angle\n1,2,3,4",
            "Column `stance_angle` must stand once",
        ),
        (
            f"{HEAD}\n0.2,-0.2",
            "Row 1 of states.csv must have 3 cells",
        ),
    ],
)
def test_tables_that_are_none_are_refused_in_a_line(tmp_path, text, message):
    path = tmp_path / "states.csv"
    path.write_text(text)

    with pytest.raises(gaitsweep.StudyError, match=".*") as caught:
        gaitsweep.check(path, "D", 0.009)

    assert message in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            {"convention": "garca"},
            "did you mean `garcia`",
        ),
        (
            {"slope": None},
            "`slope` is needed once",
        ),
        (
            {"slope": 0.7},
            "`slope` must lie in",
        ),
        (
            {"rates": "rpm"},
            "Unknown unit of rates `rpm`",
        ),
        (
            {"tolerance": 2},
            "`tolerance` must lie in",
        ),
        (
            {"steps": 9},
            "`steps` must be a whole number from 1 to 8",
        ),
        (
            {"table": [[0.2, 0.1, 0.1, 0.3]]},
            "rows of 3 numbers",
        ),
        (
            {"table": 3.0},
            "rows of 3 numbers",
        ),
        (
            {"rename": {"a": "stance_angle"}},
            "Unknown column `a`",
        ),
    ],
)
def test_wrong_arguments_are_refused_in_a_line(arguments, message):
    given = {"table": [[0.2, -0.2, -0.18]], "slope": 0.009} | arguments

    with pytest.raises(gaitsweep.StudyError) as caught:
        gaitsweep.check(given.pop("table"), "D", given.pop("slope"), **given)

    assert message in str(caught.value)


def test_a_convention_without_knees_is_refused_for_a_walker_with_them():
    table = {"theta": 0.2, "theta_dot": -0.2, "phi_dot": 0.0}

    with pytest.raises(gaitsweep.StudyError, match="has no knees"):
        gaitsweep.check(table, "physical", 0.03, convention="garcia")


def test_rows_that_are_no_numbers_are_no_gaits():
    answer = gaitsweep.check([[0.2, np.nan, -0.1], [np.inf, 1, 1]], "D", 0.009)

    assert answer["verdict"].tolist() == ["not_a_number"] * 2


@pytest.mark.parametrize(
    ("walker", "slope", "keys"),
    [
        ("B", 0.0, {"push_off": 0.1}),
        ("B", -0.01, {"push_off": 0.2}),
        pytest.param("C", 0.0, {"hip_torque": 0.02}, marks=pytest.mark.thorough),
        pytest.param("C", 0.0, {"push_off": 0.05}, marks=pytest.mark.thorough),
    ],
)
def test_states_of_driven_walkers_are_judged_on_level_ground(walker, slope, keys):
    state = gait_of(walker, slope, **keys)
    faulty = [state * [-1, 1, 1], state * [1, 1, -1], state / DEGREE, state * 1.001]
    found = gaitsweep.check([state, *faulty], walker, slope, **keys)
    expected = ["gait", "sign_of_angle", "sign_of_thigh_rate", "degrees", "near"]
    assert found["verdict"].tolist() == expected
    assert (found["gait"] == "long").all()


def test_the_ground_is_told_on_which_a_driven_walker_is_a_gait():
    """Down, and level, with slopes of both kinds in one table."""
    keys = {"push_off": 0.1}
    level, down = (gait_of("B", slope, **keys) for slope in (0.0, 0.02))
    pairs = zip(level, down, strict=True)
    table = {name: [*pair] for name, pair in zip(NAMES, pairs, strict=True)}
    right = gaitsweep.check({**table, "slope": [0.0, 0.02]}, "B", **keys)
    assert right["is_gait"].all()
    wrong = gaitsweep.check({**table, "slope": [0.02, 0.0]}, "B", **keys)
    assert wrong["verdict"].tolist() == ["slope", "slope"]
    assert wrong["belongs_to_slope"].tolist() == pytest.approx([0.0, 0.02], rel=1e-9)


@pytest.mark.parametrize("given", [0.01, 0.0, -0.003])
@pytest.mark.parametrize("slope", [-0.005, -0.0002])
def test_the_slope_uphill_to_which_a_state_belongs_is_told(slope, given):
    keys = {"push_off": 0.1}
    states = [gait_of("B", slope, label, **keys) for label in ("long", "short")]

    found = gaitsweep.check(states, "B", given, **keys)

    assert found["verdict"].tolist() == ["slope"] * 2
    assert found["belongs_to_slope"].tolist() == pytest.approx([slope] * 2, rel=1e-9)


@pytest.mark.thorough
def test_the_slope_uphill_of_a_walker_with_knees_is_told():
    keys = {"hip_torque": 0.02}
    row = judged([gait_of("C", -0.0003, **keys)], "C", 0.01, **keys)
    assert row["belongs_to_slope"] == pytest.approx(-0.0003, rel=1e-9)


def test_a_slope_uphill_may_have_been_rounded_to_level_ground_too():
    keys = {"push_off": 0.1}
    slope = np.array([-0.0034567, -0.0000034])
    found = gaitsweep.gaits("B", slope, variables=[*NAMES], **keys).sel(gait="short")
    states = {name: np.round(found[name].values, 5) for name in NAMES}

    rounded = gaitsweep.check({**states, "slope": [-0.00346, 0.0]}, "B", **keys)

    assert rounded["verdict"].tolist() == ["gait", "gait"]
    assert "which may have been -0.003456" in rounded["reason"][0]


@pytest.mark.parametrize("label", ["long", "short", "other1", "other2"])
def test_a_gait_of_a_rounded_slope_is_called_what_it_is_there(label):
    """Of four gaits of this slope two branches are near one another, and were called by
    whether they are long alone.
    """
    keys = {"push_off": 0.05}
    state = gait_of("D", -0.00432, label, **keys)
    table = dict(zip(NAMES, np.round(state, 4)[:, None], strict=True))
    table["slope"] = [-0.0043]

    row = gaitsweep.check(table, "D", **keys).iloc[0]

    assert row["verdict"] == "gait" and row["gait"] == label
    assert row["distance"] < 1e-3


def _table(states, slope):
    columns = dict(zip(NAMES, np.transpose(states), strict=True))
    return pd.DataFrame(columns | {"slope": slope})


@pytest.mark.thorough
@pytest.mark.parametrize("keys", [{"push_off": 0.1}, {"hip_torque": 0.02}])
def test_a_row_is_judged_the_same_alone_and_in_any_table(keys):
    """Surveys once began at a table's steepest and gentlest slope uphill."""
    slopes = np.array([-0.003, 0.0, 0.002, 0.01])
    states = [gait_of("B", slope, **keys) for slope in slopes]
    table = _table(states * 2, [*slopes, *np.roll(slopes, 1)])
    compared = ["verdict", "gait", "distance", "belongs_to_slope"]

    whole = gaitsweep.check(table, "B", **keys)
    order = np.random.default_rng(1).permutation(len(table))
    shuffled = gaitsweep.check(table.iloc[order], "B", **keys)
    alone = [gaitsweep.check(table.iloc[[i]], "B", **keys) for i in order]

    expected = whole.iloc[order][compared].reset_index(drop=True)
    assert expected["verdict"].value_counts().to_dict() == {"gait": 4, "slope": 4}
    for found in (shuffled, pd.concat(alone, ignore_index=True)):
        pd.testing.assert_frame_equal(found[compared], expected, rtol=1e-9, atol=1e-9)


def test_what_a_table_asks_of_level_ground_is_surveyed_once(monkeypatch):
    """A hundred rows at as many slopes took a survey of the drive each."""
    surveyed = []
    survey = atlas.survey

    def counting(problem, *more):
        surveyed.append(problem.drive)
        return survey(problem, *more)

    monkeypatch.setattr(atlas, "survey", counting)
    keys = {"push_off": 0.0987}
    slope = -np.linspace(1e-4, 0.005, 30)

    found = gaitsweep.check(_table([[0.3, -0.3, -0.2]] * 30, slope), "B", **keys)

    assert len(found) == 30
    # Downhill and, unless a walker that differs by its push-off was, on level ground.
    assert len(surveyed) <= 2


@pytest.mark.parametrize("slope", [-0.005, 0.0, 0.01])
def test_driven_gaits_stand_on_the_curves_of_the_picture(slope):
    keys = {"push_off": 0.1}
    states = [gait_of("B", slope, label, **keys) for label in ("long", "short")]

    curves = gaitsweep.check(states, "B", slope, **keys).attrs["curves"]

    for angle, *_ in states:
        off = [
            np.hypot(curve["slope"] - slope, curve["stance_angle"] - angle).min()
            for curve in curves
        ]
        assert min(off) < 5e-3


def test_how_steps_from_a_state_end_is_told():
    """This walker steps neither from a slow start nor from a gait's mirror image."""
    row = judged([[0.3, -0.1, -0.1]], "D", 0.009)
    said = "Walked on, it has no heelstrike: fell backward."
    assert row["verdict"] == "none" and row["reason"].endswith(said)
    mirrored = judged([[-0.3, -0.1, -0.1]], "D", 0.009)
    assert "Walked on" not in mirrored["reason"]


def test_a_gait_of_two_steps_on_level_ground_is_told():
    keys = {"push_off": 0.1}
    cycle = gait_of("B", 0.0, steps=2, **keys)
    assert np.isfinite(cycle).all()
    assert judged([cycle], "B", 0.0, **keys).verdict == "period"
    assert judged([cycle], "B", 0.0, steps=2, **keys).verdict == "gait"


def test_a_page_of_states_replaces_no_other_file(file, capsys):
    table = file.read_text()
    words = ["check", str(file), "--walker", "D", "--map", "gamma=slope"]

    assert commands.main([*words, "--page", str(file)]) != 0

    assert "is not a file of gaitsweep" in capsys.readouterr().err
    assert file.read_text() == table


def test_angles_in_other_units_leave_the_curves_of_the_picture_their_room():
    state = gait_of("D", 0.009)

    def ticks(states):
        text = check_page.page(gaitsweep.check(states, "D", 0.009), "D")
        return re.findall(r">([0-9.]+)</text>", text)

    assert ticks([state, state * [60, 1, 1]]) == ticks([state, state * [0.9, 1, 1]])
    assert ticks([state])


def test_the_command_says_how_many_steps_a_table_may_claim(file, capsys):
    words = ["check", str(file), "--walker", "D", "--map", "gamma=slope"]

    assert commands.main([*words, "--steps", "65"]) == 2

    assert "from 1 to 8" in capsys.readouterr().err


def test_states_of_passive_walkers_are_refused_on_level_ground():
    table = {"slope": [0.01, -0.01], "stance_angle": [0.2] * 2}
    table |= {"stance_rate": [-0.2] * 2, "thigh_rate": [-0.2] * 2}
    with pytest.raises(gaitsweep.StudyError, match="got -0.01"):
        gaitsweep.check(table, "B")

    with pytest.raises(gaitsweep.StudyError, match="needs a `push_off` or a `hip_torq"):
        gaitsweep.check([[0.2, -0.2, -0.2]], "B", 0.0)
