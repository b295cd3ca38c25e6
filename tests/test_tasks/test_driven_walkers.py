"""Walkers that more than gravity drives: a push-off of the trailing leg, and a spring, a
damper and a motor between the thighs.
"""

import math

import numpy as np
import pytest
from scipy.integrate import simpson

from gaitsweep import gaits, simulate, solve, step_map
from gaitsweep.pipeline.errors import StudyError
from gaitsweep.tasks.branches import atlas as atlases
from gaitsweep.tasks.branches.conditions import CONDITIONS
from gaitsweep.tasks.branches.joint import evaluate
from gaitsweep.tasks.branches.refine import COARSE
from gaitsweep.tasks.measures.drive import push_off
from gaitsweep.tasks.mechanics.kernel import Flow
from gaitsweep.tasks.mechanics.lumped import structure_of
from gaitsweep.tasks.mechanics.small_angles import SmallAngles
from gaitsweep.tasks.step.drive import Drive, unit_of_impulse
from gaitsweep.tasks.step.extended_precision import Start, solved
from gaitsweep.tasks.step.problem import Problem, scale_of
from gaitsweep.tasks.studies import solve_points
from gaitsweep.tasks.studies.solve_driven import driven
from gaitsweep.tasks.walkers.resolve import resolve
from gaitsweep.tasks.walkers.walker import WalkerError
from oracle import Oracle

HIP = {
    "hip_stiffness": 0.05,
    "hip_damping": 0.001,
    "hip_rest": 0.1,
    "hip_torque": 0.001,
}
#: Walkers, what drives them, and slopes on which they walk.
DRIVEN = [
    ("B", {"push_off": 0.05}, 0.01),
    ("B", HIP, 0.01),
    ("B", {"push_off": 0.05, **HIP}, 0.01),
    ("B", {"push_off": 0.1, "hip_damping": 0.0005}, 0.0),
    ("E", {"push_off": 0.1, "hip_stiffness": 0.001}, 0.0),
    ("C", {"push_off": 0.05, "hip_torque": 0.01}, 0.03),
    ("C", {"push_off": 0.05, "hip_stiffness": 0.3, "trailing_knee": "locked"}, 0.03),
    ("C", {"hip_damping": 0.001, "push_off": 0.05}, 0.03),
    ("B", {"hip_torque": 0.01, "hip_stiffness": 0.05}, 0.0),
    ("C", {"hip_torque": 0.02}, 0.0),
]
#: Those of the first tier: one of each kind of drive, with and without knees.
FIRST = (2, 3, 6, 8)
EVERY = [
    pytest.param(*case, marks=() if number in FIRST else pytest.mark.thorough)
    for number, case in enumerate(DRIVEN)
]


def on_the_oracle(name, keys):
    """The second derivation of a walker."""
    return Oracle(resolve(name, keys).table())


@pytest.mark.parametrize(("name", "keys", "slope"), EVERY)
def test_gaits_repeat_in_a_derivation_by_constraints_and_impulses(name, keys, slope):
    """The oracle solves for the push-off and for heelstrike one after the other, the
    walker free between them.
    """
    found = solve(name, slope, **keys)

    assert len(found)
    oracle = on_the_oracle(name, keys)

    for gait in found.itertuples():
        rates = [gait.stance_rate, gait.thigh_rate, gait.shank_rate]
        step = oracle.step(gait.stance_angle, rates[: 2 + oracle.knees], slope)

        assert step.period == pytest.approx(gait.period, rel=1e-10)

        assert step.theta == pytest.approx(gait.stance_angle, rel=1e-9)
        size = max(map(abs, rates))
        np.testing.assert_allclose(step.rates, rates, rtol=0, atol=1e-9 * size)
        lost = step.loss_heelstrike

        assert lost == pytest.approx(
            gait.loss_normal + gait.loss_tangential,
            rel=1e-9,
        )

        if "push_off" in keys:
            assert oracle.push_work == pytest.approx(gait.push_off_work, rel=1e-9)


@pytest.mark.parametrize(("name", "keys", "slope"), EVERY)
def test_what_is_lost_is_what_is_supplied(name, keys, slope):
    """Gravity, push-off and motor supply what impacts and damper take; the spring's work
    is nothing over a step.
    """
    found = solve(name, slope, **keys)

    assert (np.abs(found["energy_imbalance"]) < 1e-12).all()

    assert (found["error_bound"] < 1e-12).all()
    weight = resolve(name, keys).total_mass * resolve(name, keys).g
    supplied = found["cost_of_transport"] * weight * found["step_length"]
    losses = [name for name in found if name.startswith("loss_")]
    np.testing.assert_allclose(found[losses].sum(axis=1), supplied, rtol=1e-11)


@pytest.mark.parametrize("key", ["push_off", "hip_torque"])
@pytest.mark.parametrize(
    ("name", "keys", "w"),
    [
        ("B", {}, [-1.6, -1.1, -1.03, 3.02]),
        ("D", {}, [-1.6, -1.1, 3.5]),
        ("C", {}, [-1.6, -1.33, -1.2, 1.76, 2.74]),
        ("C", {"trailing_knee": "locked"}, [-1.6, -1.33, -1.2, 1.76, 2.74]),
    ],
)
def test_derivatives_by_the_drive_are_exact(name, keys, w, key):
    problem = Problem(resolve(name, keys), drive=Drive(key, 0.0))
    Z = np.array([*w, math.log(0.01)])[:, None]
    exact = evaluate(problem, Z).derivative[..., 0]

    h = 1e-5

    for column in range(1, len(Z)):
        moved = np.zeros_like(Z)
        moved[column] = h
        above, below = (evaluate(problem, Z + sign * moved) for sign in (1, -1))
        by_difference = (above.residual - below.residual)[:, 0] / (2 * h)
        np.testing.assert_allclose(by_difference, exact[:, column], rtol=0, atol=1e-8)


def test_on_level_ground_the_simplest_walker_is_a_rimless_wheel_that_pushes():
    """From heelstrike to heelstrike the stance leg keeps its speed on level ground, so
    that rate (1 - cos 2a) = -sin 2a P: that of a wheel of half angle a, with the push-off
    of Kuo (2002).
    """
    pushes = np.array([1e-4, 1e-3, 0.02, 0.1])
    found = gaits(
        "D",
        0.0,
        push_off=pushes,
        variables=["stance_angle", "stance_rate"],
    )

    for label in ("long", "short"):
        angle, rate = (
            found[name].sel(gait=label).values
            for name in ("stance_angle", "stance_rate")
        )
        wheel = -np.sin(2 * angle) * pushes / (1 - np.cos(2 * angle))
        np.testing.assert_allclose(rate, wheel, rtol=1e-10)


def test_half_the_square_of_the_push_pays_for_the_collision_of_massless_legs():
    found = solve("D", 0.0, push_off=0.05)
    np.testing.assert_allclose(found["push_off_work"], 0.05**2 / 2, rtol=1e-14)
    np.testing.assert_allclose(found["loss_normal"], 0.05**2 / 2, rtol=1e-10)


def test_pushing_off_costs_a_fourth():
    """Kuo (2002): the collision after a push-off takes a fourth of that before one, for
    steps of one length.
    """
    names = ["step_length", "cost_of_transport"]
    pushed = gaits(
        "D",
        0.0,
        push_off=np.geomspace(1e-4, 1e-2, 60),
        variables=names,
    )
    down = gaits("D", [1e-5, 1e-4], variables=names)
    for label in ("long", "short"):
        length, cost = (pushed[name].sel(gait=label).values for name in names)
        longer, dearer = (down[name].sel(gait=label).values for name in names)
        same = np.interp(np.log(longer), np.log(length), np.log(cost))
        np.testing.assert_allclose(dearer / np.exp(same), 4, rtol=3e-3)


@pytest.mark.parametrize("label", ["long", "short"])
def test_steps_shorten_with_the_root_of_a_vanishing_push(label):
    """The periods are those at which legs exchange places at equal rates, as on
    vanishing slopes.
    """
    pushes = np.array([1e-10, 1.001e-10])
    found = gaits(
        "D",
        0.0,
        push_off=pushes,
        variables=["stance_angle", "period"],
    )
    angle = found["stance_angle"].sel(gait=label).values
    exponent = np.diff(np.log(angle)) / np.diff(np.log(pushes))

    assert exponent == pytest.approx(0.5, abs=1e-6)

    passive = solve("D", 1e-12).set_index("gait").loc[label]
    period = found["period"].sel(gait=label).values[0]

    assert period == pytest.approx(passive["period"], rel=1e-7)


def test_on_a_slope_a_vanishing_push_leaves_the_passive_gait():
    pushed = solve("B", 0.02, push_off=1e-12)
    passive = solve("B", 0.02)

    for name in ("stance_angle", "period", "spectral_radius"):
        np.testing.assert_allclose(pushed[name], passive[name], rtol=1e-9)


def test_branches_over_the_push_and_over_the_slope_meet():
    """Where both drives lead to a walker's gait, it is one gait."""
    push, slope = 0.05, 0.01
    walker = resolve("B", {"push_off": push})
    problem = Problem(resolve("B"), drive=Drive("push_off", slope))
    branches = atlases.survey(problem, COARSE)
    q = np.array([math.log(push / unit_of_impulse(walker))])
    angles = sorted(math.exp(Z[0, 0]) for b in branches for _, Z, _ in b.guesses(q))

    over_slope = sorted(solve("B", slope, push_off=push)["stance_angle"])
    np.testing.assert_allclose(angles, over_slope, rtol=1e-4)


@pytest.mark.parametrize(("name", "keys", "slope"), [EVERY[k] for k in (2, 3, 5, 6, 9)])
def test_error_bounds_hold_against_113_bits(name, keys, slope):
    walker = resolve(name, keys)
    problem, drive = Problem(walker), slope

    if slope <= 0:
        problem, drive = driven(walker, slope)
    for gait in solve(name, slope, **keys).itertuples():
        angle, period = in_113_bits(problem, drive, gait)

        assert abs(angle / gait.stance_angle - 1) <= 2 * gait.error_bound

        assert abs(period / gait.period - 1) <= 2 * gait.error_bound


def in_113_bits(problem, drive, gait):
    """Stance angle and period of a gait solved in 113 bits."""
    time, at = problem.walker.time_unit, np.array([drive])
    rates = np.array([gait.stance_rate, gait.thigh_rate]) * time
    y = problem.section_of(np.array([[gait.stance_angle], *rates[:, None]]), at)
    scale = scale_of(y[0])
    times = (
        np.array([gait.kneestrike_time, gait.period])[-problem.phases :, None] / time
    )

    stride = problem.map(
        y / scale,
        times,
        problem.parameters(at, scale),
        by_drive=True,
    )
    start = Start(
        problem,
        0,
        stride,
        y[:, 0] / scale,
        times[:, 0],
        drive,
        scale[0],
    )
    exact = solved(start, 1)

    return float(exact.y[0]) * scale[0], float(exact.times[-1]) * time


def test_a_walker_without_these_keys_is_compiled_and_written_as_before():
    plain = resolve("C")
    zero = resolve("C", dict.fromkeys(("push_off", *HIP), 0.0))

    assert zero == plain

    assert zero.table() == plain.table()

    assert not {"push_off", *HIP} & {*plain.table()}

    assert structure_of(zero) == structure_of(plain)

    assert not {"push", "hip_bias"} & {*structure_of(plain).constants}


def test_the_work_of_a_push_is_what_the_walker_gains():
    """By the kinetic energies before and after, as the oracle has them."""
    for name in ("B", "E", "C"):
        keys = {"push_off": 0.07}
        oracle, walker = on_the_oracle(name, keys), resolve(name, keys)
        angle = np.array([0.3])
        impulse = np.array([0.07]) / unit_of_impulse(walker)
        work = push_off(walker, angle, impulse).work[0]
        oracle.heelstrike(np.array([-0.3, 0.3, 0.3, 0.0, 0.0, 0.0]))
        unit = walker.total_mass * walker.g * walker.leg

        assert work * unit == pytest.approx(oracle.push_work, rel=1e-12)


def test_a_spring_makes_the_leg_swing_faster_to_first_order():
    walker = {"hip_stiffness": 0.1}

    assert SmallAngles(resolve("B", walker)).swing < SmallAngles(resolve("B")).swing
    free, braked = (
        SmallAngles(resolve("C", {"hip_stiffness": 1.0, "hip_damping": damping}))
        for damping in (0.0, 1e-9)
    )
    times = np.linspace(0, 3, 7)

    for motion in ("locked", "free"):
        undamped, damped = (getattr(x, motion).after(times) for x in (free, braked))
        np.testing.assert_allclose(damped, undamped, rtol=0, atol=1e-7)


@pytest.mark.parametrize(
    ("name", "slope", "push"),
    [
        ("D", -0.01, 0.1),
        ("C", 0.03, 0.05),
    ],
)
def test_driven_walking_is_flown_step_by_step(name, slope, push):
    """Uphill, too; with knees a push-off adds to what rates before heelstrike give."""
    (gait, *_) = solve(name, slope, push_off=push).itertuples()
    assert gait.stable
    state = [gait.stance_angle, gait.stance_rate, gait.thigh_rate]

    flown = simulate(name, slope, state, 20, push_off=push)
    angles = flown["stance_angle"]
    np.testing.assert_allclose(angles, gait.stance_angle, rtol=1e-12)
    mapped = step_map(name, slope, state, push_off=push)
    np.testing.assert_allclose(mapped.state, state, rtol=1e-12)


def test_what_nothing_drives_is_refused_on_level_ground():
    for ask in (solve, lambda *given: simulate(*given, [0.2, -0.2, -0.2], 1)):
        with pytest.raises(StudyError, match="needs a `push_off` or a `hip_torque`"):
            ask("D", 0.0)
    # A torque cannot move legs without mass.
    with pytest.raises(StudyError, match="above 0, .* between legs with mass"):
        solve("D", 0.0, hip_torque=0.01)

    asked = gaits("D", [0.0, 0.0], push_off=[0.0, 0.05], variables=["period"])
    codes = asked["status"].attrs["flag_meanings"].split()
    refused, walks = asked["status"].sel(gait="long").values.tolist()

    assert (codes[refused], codes[walks]) == ("raised", "converged")


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"push_off": -0.1}, "`push_off` must be >= 0"),
        ({"hip_damping": -1.0}, "`hip_damping` must be >= 0"),
        ({"hip_rest": 4.0}, "`hip_rest`"),
        ({"push_off": math.nan}, "`push_off` must be finite"),
    ],
)
def test_a_wrong_key_is_refused_with_its_bound(keys, said):
    with pytest.raises(WalkerError, match=said):
        resolve("B", keys)


def test_a_released_knee_feels_the_torque_that_drives():
    """Where it begins to bend backwards a branch ends; a torque had no part in it."""
    keys = {
        "trailing_knee": "locked",
        "hip_torque": 0.05,
    }
    slope = 0.02
    walker = resolve("C", keys)
    drive = Drive("hip_torque", slope)
    bends = CONDITIONS["release_hyperextension"].value
    w = np.array([-1.6, -1.33, -1.2, 1.76, 2.74])[:, None]

    at_slope = np.vstack([w, [[np.log(slope)]]])
    at_torque = np.vstack([w, [[np.log(drive.of(walker))]]])
    passive = resolve("C", {"trailing_knee": "locked"})

    of_slope = bends(evaluate(Problem(walker), at_slope))
    of_torque = bends(evaluate(Problem(passive, drive=drive), at_torque))
    without = bends(evaluate(Problem(passive), at_slope))

    np.testing.assert_allclose(of_torque, of_slope, rtol=1e-9)
    assert abs(without - of_slope) > 0.1


@pytest.mark.parametrize("name", ["B", "C"])
def test_what_a_damper_dissipates_is_the_integral_along_the_motion(name):
    """By Simpson's rule over samples, to which the motion is flown with derivatives."""
    problem = Problem(resolve(name, {"hip_damping": 0.01}))
    y = np.array([[0.21], [-0.33], [-0.2]])
    times = np.array([[0.5], [1.1]]) if problem.step.kneed else np.array([[1.1]])
    parameters = problem.parameters(
        np.array([0.02]),
        np.array([1.0]),
    )

    dissipated = problem.step.dissipation(y, times, parameters)

    sampled = problem.step(y, times, parameters, samples=2000)
    durations = np.diff(times[:, 0], prepend=0.0)
    expected = 0.0

    for phase, duration in zip(sampled.motion, durations, strict=True):
        stance, thigh = np.split(phase[..., 0], 2, axis=1)[1].T[:2]
        power = (thigh - stance) ** 2
        expected += simpson(power, dx=duration / 2000)

    assert dissipated == pytest.approx(expected, rel=1e-11)


def test_energies_fly_the_damped_motion_once_and_without_derivatives(monkeypatch):
    """They took 1.6 times as long as those of a walker without a damper."""
    line = {
        "walker": "C",
        "set": {"hip_damping": 0.0005},
    }
    params = {
        "line": line,
        "slope": np.array([0.01, 0.02]),
        "gaits": ["long"],
        "want": ["period"],
    }
    atlas = solve_points.atlas({"line": line, "coarse": True}, [])
    flights = []
    fly = Flow.__call__

    def watched(flow, state, parameters, duration, samples=0):
        flights.append((*state.shape, samples))
        return fly(flow, state, parameters, duration, samples)

    monkeypatch.setattr(Flow, "__call__", watched)
    solve_points.points(params, [atlas])
    without = list(flights)
    flights.clear()
    params["want"].append("energy_imbalance")
    solve_points.points(params, [atlas])

    # Angles and rates of three links, then of two, and what is dissipated.
    assert flights == [*without, (7, 2, 0), (5, 2, 0)]


@pytest.mark.thorough
@pytest.mark.parametrize(("name", "slope"), [("B", -0.034), ("D", -0.02)])
def test_gaits_are_found_nearly_to_where_walking_uphill_ends(name, slope):
    """Over slopes, B pushing off by 0.25 walks to -0.0344, and D by 0.2 to -0.0203;
    anchors are those of level ground.
    """
    push = {"B": 0.23, "D": 0.2}[name]

    found = solve(name, slope, push_off=push)

    assert len(found) >= 1
