"""The step map with its modes, and simulations with pushes and uneven ground, against
the second derivation.
"""

import numpy as np
import pytest

import gaitsweep
from gaitsweep.pipeline.errors import StudyError
from gaitsweep.tasks.studies.map_step import map_step
from gaitsweep.tasks.studies.simulate_steps import simulate_steps
from gaitsweep.tasks.walkers.resolve import resolve
from lines import gait
from oracle import SHANK, Oracle, SimplestWalker, _turn

SLOPES = {"D": 0.009, "E": 0.005, "B": 0.01, "A": 0.02, "C": 0.02, "physical": 0.036}
# Off every gait, within two per cent of one, so that some steps are taken.
AWAY = np.array([1.004, 0.997, 1.02])


def at_gait(name):
    """State of the long gait."""
    found = gait(name, SLOPES[name], "long")
    return np.array([found[k] for k in ("stance_angle", "stance_rate", "thigh_rate")])


def oracle_of(name):
    return SimplestWalker() if name == "D" else Oracle(resolve(name).table())


def start(name, state):
    """Rates of all links after the heelstrike that leads to a state: a free shank's
    follows from the others.
    """
    if not resolve(name).knees:
        return state[1:]
    oracle, angles = oracle_of(name), np.array([-state[0], state[0], state[0]])
    columns = [
        oracle.heelstrike(np.concatenate([angles, r]))[0][3:]
        for r in ([1, 0, 0], [0, 1, 1])
    ]
    matrix = np.array(columns, float).T
    return matrix @ np.linalg.solve(matrix[:2], state[1:])


def oracle_map(name, state, slope):
    step = oracle_of(name).step(
        state[0], start(name, state), slope, rtol=1e-12, atol=1e-14
    )
    return np.array([step.theta, *step.rates[:2]]), step


def derivative(f, at, h):
    return (8 * (f(at + h) - f(at - h)) - (f(at + 2 * h) - f(at - 2 * h))) / (12 * h)


@pytest.mark.parametrize("name", SLOPES)
def test_the_step_map_agrees_with_the_rigid_bodies(name):
    state, slope = at_gait(name) * AWAY, SLOPES[name]
    answer = gaitsweep.step_map(name, slope, state)
    image, step = oracle_map(name, state, slope)
    assert answer.state == pytest.approx(image, rel=2e-9)
    assert answer.times.heelstrike == pytest.approx(step.period, rel=2e-9)
    assert (
        np.isnan(answer.times.kneestrike)
        == np.isnan(answer.losses.kneestrike)
        == (step.kneestrike_time is None)
    )
    if step.kneestrike_time:
        assert answer.times.kneestrike == pytest.approx(step.kneestrike_time, rel=2e-9)
        assert answer.losses.kneestrike == pytest.approx(step.loss_kneestrike, rel=1e-7)
    assert answer.losses.normal + answer.losses.tangential == pytest.approx(
        step.loss_heelstrike, rel=1e-7
    )


@pytest.mark.parametrize("name", SLOPES)
def test_the_derivatives_are_those_of_the_rigid_bodies(name):
    state, slope = at_gait(name) * AWAY, SLOPES[name]
    answer = gaitsweep.step_map(name, slope, state)
    for k in range(3):
        unit = np.eye(3)[k]
        column = derivative(
            lambda h, e=unit: oracle_map(name, state + h * e, slope)[0],
            0.0,
            1e-4 * abs(state[k]),
        )
        assert answer.jacobian[:, k] == pytest.approx(column, rel=1e-6, abs=1e-6)
    by_slope = derivative(lambda s: oracle_map(name, state, s)[0], slope, 1e-3 * slope)
    assert answer.by_slope == pytest.approx(by_slope, rel=1e-6, abs=1e-6)


@pytest.mark.parametrize("name", SLOPES)
def test_at_a_gait_the_eigenvalues_are_its_multipliers(name):
    known = gait(name, SLOPES[name], "long")
    answer = gaitsweep.step_map(name, SLOPES[name], at_gait(name))
    assert answer.state == pytest.approx(at_gait(name), rel=1e-12)
    multipliers = known["multiplier_real"][:3] + 1j * known["multiplier_imag"][:3]
    assert np.abs(answer.eigenvalues - multipliers).max() < 1e-11
    vectors = answer.eigenvectors
    assert (
        np.abs(answer.jacobian @ vectors - vectors * answer.eigenvalues).max() < 1e-12
    )
    assert np.linalg.norm(vectors, axis=0) == pytest.approx(1.0)
    largest = vectors[np.abs(vectors).argmax(axis=0), range(3)]
    assert (largest.real > 0).all() and np.abs(largest.imag).max() < 1e-15
    assert (answer.eigenvalues[2] == 0) == resolve(name).point_foot


def test_a_knee_that_first_hyperextends_has_not_struck():
    """The flexion falls to zero at the start of such a step too, which ends no phase."""
    state = at_gait("C") * [1, 1, 2.2]
    steps, mapped = (
        gaitsweep.simulate("C", 0.02, state, 1),
        gaitsweep.step_map("C", 0.02, state),
    )
    assert float(steps.thigh_rate[0] - steps.shank_rate[0]) < 0
    assert float(steps.kneestrike_time[0]) == pytest.approx(
        mapped.times.kneestrike, rel=1e-12
    )


# With so light a thigh the knee's flexion swings fast: time steps of fixed length find
# its kneestrike 0.04 s early.
FAST_KNEE = {
    **{"l_t": 0.64, "w_t": 0.0077, "m_t": 14.064, "r_t": 0.0964, "c_t": 0.1395},
    **{"l_s": 0.6187, "w_s": -0.0047, "m_s": 42.717, "r_s": 0.0629, "c_s": 0.3006},
    **{"R": 0.2863, "eps_T": 0.1793, "m_h": 10.398, "g": 5.5216, "knees": True},
}


def test_the_step_map_is_exact_where_the_knee_swings_fast():
    state, slope = np.array([0.1156, -0.3862, 0.0893]), 0.0351
    answer = gaitsweep.step_map(FAST_KNEE, slope, state)
    oracle = Oracle(resolve(FAST_KNEE).table())
    free = float(gaitsweep.simulate(FAST_KNEE, slope, state, 1).shank_rate[0])
    step = oracle.step(
        state[0], np.array([*state[1:], free]), slope, rtol=1e-12, atol=1e-14
    )
    assert answer.times.kneestrike == pytest.approx(step.kneestrike_time, rel=1e-7)
    assert answer.losses.kneestrike == pytest.approx(step.loss_kneestrike, rel=1e-6)
    assert answer.state == pytest.approx([step.theta, *step.rates[:2]], rel=1e-7)


@pytest.mark.parametrize("name", ["D", "B"])
def test_a_swing_leg_that_turns_over_the_hip_strikes_no_heel(name):
    """Its foot passes the ground beside the stance foot from above, where the legs are
    parallel again.
    """
    state = at_gait(name) * [1, 1, -40]
    steps = gaitsweep.simulate(name, SLOPES[name], state, 1)
    assert steps.outcome == "fell forward"
    with pytest.raises(StudyError, match="fell forward"):
        gaitsweep.step_map(name, SLOPES[name], state)


@pytest.mark.parametrize("name", ["D", "B", "C"])
def test_steps_follow_each_other_as_the_map_says(name):
    """Two methods: events located on Taylor polynomials, and event times as unknowns of
    the map.
    """
    state, slope = at_gait(name) * AWAY, SLOPES[name]
    steps = gaitsweep.simulate(name, slope, state, 3)
    for k in range(3):
        here = [
            float(steps[v][k]) for v in ("stance_angle", "stance_rate", "thigh_rate")
        ]
        there = [
            float(steps[v][k + 1])
            for v in ("stance_angle", "stance_rate", "thigh_rate")
        ]
        mapped = gaitsweep.step_map(name, slope, here)
        assert there == pytest.approx(mapped.state, rel=1e-12)
        assert float(steps.period[k]) == pytest.approx(
            mapped.times.heelstrike, rel=1e-12
        )
        assert float(steps.kneestrike_time[k]) == pytest.approx(
            mapped.times.kneestrike, rel=1e-12, nan_ok=True
        )
    assert (
        steps.outcome == "walks" and steps.reason == "All 3 steps end in a heelstrike."
    )
    assert (
        np.isnan(steps.period[3])
        and (steps.thigh_angle == -steps.stance_angle).values[0]
    )


def oracle_over(name, state, slope, height):
    """State of the rigid bodies after a step onto ground higher by `height`, from any
    angles and rates (6,).
    """
    oracle, time = oracle_of(name), 0.0
    options = {"slope": slope, "rtol": 1e-12, "atol": 1e-14}
    if oracle.knees:
        time, state, _ = oracle.integrate(
            state,
            locked=False,
            guard=lambda y: y[1] - y[2],
            direction=-1,
            start=time,
            **options,
        )
        state, *_ = oracle.kneestrike(state)

    def clearance(y):
        bodies = oracle.positions(y)
        centre = bodies[SHANK[1] : SHANK[1] + 2] + _turn(y[2], oracle.centre_on_shank)
        return centre[1] - oracle.radius - height

    if state[1] < 0.1:  # the swing leg first comes to the front
        time, state, _ = oracle.integrate(
            state,
            locked=True,
            guard=lambda y: y[1] - 0.1,
            direction=1,
            start=time,
            **options,
        )
    time, state, _ = oracle.integrate(
        state, locked=True, guard=clearance, direction=-1, start=time, **options
    )
    return time, oracle.heelstrike(state)[0]


@pytest.mark.parametrize(
    ("name", "height"),
    [("B", -0.002), ("E", 0.0005), ("C", -0.004), ("physical", 0.003)],
)
def test_uneven_ground_agrees_with_the_rigid_bodies(name, height):
    state, slope = at_gait(name), SLOPES[name]
    steps = gaitsweep.simulate(name, slope, state, 2, ground={0: height})
    rates = start(name, state)
    time, after = oracle_over(
        name,
        np.array([state[0], -state[0], -state[0], *rates, rates[-1]])[:6],
        slope,
        height,
    )
    names = (
        "stance_angle",
        "thigh_angle",
        "thigh_angle",
        "stance_rate",
        "thigh_rate",
        "shank_rate",
    )
    assert [float(steps[n][1]) for n in names] == pytest.approx(after, rel=1e-9)
    assert float(steps.period[0]) == pytest.approx(time, rel=1e-9)
    # The legs then stand at two different angles, and the next step begins from there.
    assert float(steps.stance_angle[1] + steps.thigh_angle[1]) * height > 0
    time, after = oracle_over(name, after, slope, 0.0)
    assert [float(steps[n][2]) for n in names] == pytest.approx(after, rel=1e-9)
    assert float(steps.period[1]) == pytest.approx(time, rel=1e-9)


def test_a_push_along_a_mode_decays_with_its_multiplier():
    modes = gaitsweep.step_map("C", 0.02, at_gait("C"))
    assert abs(modes.eigenvalues[0].imag) == 0
    mode = 1e-6 * modes.eigenvectors[:, 0].real
    steps = gaitsweep.simulate("C", 0.02, at_gait("C") + mode, 3)
    off = (
        np.array(
            [steps[v].values for v in ("stance_angle", "stance_rate", "thigh_rate")]
        )
        - at_gait("C")[:, None]
    )
    for k in range(4):
        assert off[:, k] == pytest.approx(
            modes.eigenvalues[0].real ** k * mode, abs=1e-10
        )


@pytest.mark.parametrize("name", ["B", "C"])
def test_a_push_changes_the_rates_after_the_state_that_is_recorded(name):
    push = (0.01, -0.02)
    steps = gaitsweep.simulate(name, SLOPES[name], at_gait(name), 3, pushes={1: push})
    still = gaitsweep.simulate(name, SLOPES[name], at_gait(name), 3)
    rates = []
    for v, change in (
        ("stance_angle", 0.0),
        ("stance_rate", 0.01),
        ("thigh_rate", -0.02),
        ("shank_rate", -0.02),
    ):
        assert (steps[v].values[:2] == still[v].values[:2]).all()
        rates += [float(steps[v][1]) + change] if v.endswith("rate") else []
    slow = oracle_of(name).step(
        at_gait(name)[0], rates[: 3 if name == "C" else 2], SLOPES[name]
    )
    assert float(steps.stance_angle[2]) == pytest.approx(slow.theta, rel=1e-8)


@pytest.mark.parametrize(("name", "phases"), [("B", 1), ("C", 2)])
def test_the_motion_leads_from_strike_to_strike(name, phases):
    steps = gaitsweep.simulate(
        name, SLOPES[name], at_gait(name), 2, motion=True, ground={1: -0.001}
    )
    assert (
        steps.theta_st.dims == ("step", "phase", "sample")
        and steps.sizes["phase"] == phases
    )
    walk = steps.isel(step=slice(2))
    first, last = walk.isel(phase=0, sample=0), walk.isel(phase=-1, sample=-1)
    np.testing.assert_allclose(first.theta_st, walk.stance_angle, rtol=1e-14)
    np.testing.assert_allclose(first.theta_th, walk.thigh_angle, rtol=1e-14)
    np.testing.assert_allclose(last.time, walk.period, rtol=1e-14)
    np.testing.assert_allclose(last.theta_th, steps.stance_angle[1:], rtol=1e-12)
    np.testing.assert_allclose(last.theta_st, steps.thigh_angle[1:], rtol=1e-12)
    np.testing.assert_allclose(walk.foot_x, -resolve(name).R * walk.theta_st)
    # The samples are those of the motion: accelerations by differences are the rigid
    # bodies'.
    i, h = 20, float(walk.time[0, 0, 1] - walk.time[0, 0, 0])
    angles = np.array(
        [
            walk[f"theta_{link}"].values[0, 0, i - 1 : i + 2]
            for link in ("st", "th", "sh")
        ]
    )
    rates = (angles[:, 2] - angles[:, 0]) / (2 * h)
    slow = oracle_of(name).accelerations(
        np.concatenate([angles[:, 1], rates]), SLOPES[name], phases == 1
    )
    assert (angles[:, 2] - 2 * angles[:, 1] + angles[:, 0]) / h**2 == pytest.approx(
        slow, rel=0.02
    )
    if phases == 2:
        knee = walk.isel(phase=0, sample=-1)
        np.testing.assert_allclose(knee.theta_sh, knee.theta_th, rtol=1e-12)
        np.testing.assert_allclose(knee.time, walk.kneestrike_time, rtol=1e-14)


def test_falls_are_outcomes_with_a_sentence():
    slow = gaitsweep.simulate("D", 0.009, at_gait("D") * [1, 0.8, 0.8], 5)
    fast = gaitsweep.simulate("D", 0.009, at_gait("D") * [1, 1.5, 1.5], 5, motion=True)
    assert (
        slow.outcome == "fell backward"
        and slow.reason == "Step 0: fell backward."
        and slow.steps_taken == 0
    )
    assert fast.outcome == "fell forward" and np.isnan(fast.stance_angle[1:]).all()
    # The motion of the fall itself is there to be drawn.
    assert (
        float(fast.theta_st[0, 0, -1]) == pytest.approx(-np.exp(0.5))
        and np.isnan(fast.theta_st[1:]).all()
    )
    later = gaitsweep.simulate("D", 0.009, at_gait("D"), 5, ground={2: -0.01})
    assert later.reason == "Step 3: fell forward." and later.steps_taken == 3


def test_a_gait_of_large_angle_walks():
    """Simulations took it for a fall beyond 1.2 rad; it is a gait up to the angle to
    which branches are followed.
    """
    keys = {"foot_mass_ratio": 0.49, "R": 0.5142857142857143}
    gait = gaitsweep.gaits("E", 0.01, **keys).sel(gait="short")
    state = [
        float(gait[name]) for name in ("stance_angle", "stance_rate", "thigh_rate")
    ]
    assert state[0] == pytest.approx(
        1.47754452865606847, rel=1e-13
    )  # proved in ball arithmetic
    walk = gaitsweep.simulate("E", 0.01, state, 4, **keys)
    assert walk.outcome == "walks" and np.ptp(walk.stance_angle.to_numpy()) < 1e-12
    modes = gaitsweep.step_map("E", 0.01, state, **keys).eigenvalues
    np.testing.assert_allclose(np.abs(modes).max(), gait.spectral_radius, rtol=1e-9)


def test_a_motion_that_overflows_is_lost(capfd):
    for push in (1e200, 1e15):
        walk = gaitsweep.simulate("D", 0.009, at_gait("D"), 3, pushes={0: (push, 0.0)})
        assert walk.reason == "Step 0: motion lost."
    assert (
        gaitsweep.simulate(
            "C", 0.02, at_gait("C") * [1, 1e200, 1], 3, motion=True
        ).outcome
        == "motion lost"
    )
    assert capfd.readouterr() == ("", "")


def test_units_are_the_walkers(tmp_path):
    steps = gaitsweep.simulate("C", 0.02, at_gait("C"), 2, motion=True)
    assert (steps.stance_rate.units, steps.period.units, steps.foot_x.units) == (
        "rad s-1",
        "s",
        "m",
    )
    assert gaitsweep.simulate("D", 0.009, at_gait("D"), 1).period.units == "1"
    steps.to_netcdf(tmp_path / "steps.nc")
    # Time in units of sqrt(leg/g): without a unit the same steps take another number.
    plain = gaitsweep.simulate(
        "C", 0.02, at_gait("C") * [1, 2**0.5, 2**0.5], 1, g=2 * 9.81
    )
    assert float(plain.period[0]) == pytest.approx(
        float(steps.period[0]) / 2**0.5, rel=1e-12
    )


@pytest.mark.parametrize(
    ("function", "arguments", "words"),
    [
        (
            "step_map",
            {"state": (0.0, -1.0, 0.0)},
            r"`state` must have a stance angle in \(0, 1.649\) rad; got 0.0 rad",
        ),
        (
            "step_map",
            {"state": (-0.2, -1.0, 0.0)},
            "`state` must have a stance angle in",
        ),
        (
            "step_map",
            {"state": (0.2, 0.1, 0.1)},
            r"`state` leads to no heelstrike \(fell backward\); got \(0.2",
        ),
        ("step_map", {"state": (0.2, -1.0)}, "`state` must be 3, 4 or 6 numbers"),
        ("step_map", {"state": 0.2}, "`state` must be 3, 4 or 6 numbers; got 0.2"),
        ("step_map", {"state": (0.2, -1.0, np.nan)}, "`state` must be finite"),
        (
            "step_map",
            {"slope": 0.0},
            r"`slope` must lie in \[1e-18, 0.5\) rad; got 0.0",
        ),
        (
            "simulate",
            {"slope": 0.5},
            r"`slope` must lie in \[1e-18, 0.5\) rad; got 0.5",
        ),
        ("step_map", {"slope": [0.01, 0.02]}, "`slope` must be a number"),
        ("step_map", {"foot": 1.0}, "`foot` is not a walker key"),
        (
            "step_map",
            {"walker": object()},
            "`walker` must be a name, a file or a table; got object",
        ),
        (
            "simulate",
            {"state": (1.7, -1.0, 0.0)},
            "`state` must have a stance angle in",
        ),
        (
            "simulate",
            {"steps": 0},
            "`steps` must be a whole number from 1 to 100,000; got 0",
        ),
        (
            "simulate",
            {"steps": 10**9},
            "`steps` must be a whole number from 1 to 100,000",
        ),
        (
            "simulate",
            {"pushes": {5: (0.1, 0.1)}},
            "`pushes` must name steps from 0 to 4; got 5",
        ),
        ("simulate", {"pushes": {1: 0.1}}, "`pushes` must be 2 numbers; got 0.1"),
        ("simulate", {"ground": [0.1]}, "`ground` must be a mapping from steps"),
        (
            "simulate",
            {"ground": {-1: 0.1}},
            "`ground` must name steps from 0 to 4; got -1",
        ),
        ("simulate", {"ground": {1: np.inf}}, "`ground` must be finite"),
    ],
)
def test_wrong_input_is_one_sentence(function, arguments, words):
    usual = {
        "walker": "C",
        "slope": 0.02,
        "state": at_gait("C"),
        **({"steps": 5} if function == "simulate" else {}),
    }
    with pytest.raises(StudyError, match=f"^{words}"):
        getattr(gaitsweep, function)(**{**usual, **arguments})


def test_the_tasks_take_plain_data():
    """What `pipeline` calls by name, without its checks."""
    params = {
        "walker": "D",
        "set": None,
        "slope": 0.009,
        "state": at_gait("D").tolist(),
    }
    assert map_step(params)["kneestrike_time"] is None
    assert simulate_steps({**params, "steps": 2})["cause"] == "walks"
