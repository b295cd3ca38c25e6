"""Appendix A against the independent derivation in maximal coordinates, closed forms,
and the paper's statements.
"""

import tomllib
from pathlib import Path

import numpy as np
import pytest

import oracle
from gaitsweep.tasks.contract.registry import GAITS, VARIABLES, VIOLATIONS
from gaitsweep.tasks.measures import violations
from gaitsweep.tasks.mechanics.contact import Chain
from gaitsweep.tasks.studies.follow_branches import contact_lost
from gaitsweep.tasks.studies.solve_at_slope import solve_one
from gaitsweep.tasks.studies.solve_points import atlas, points
from gaitsweep.tasks.walkers.catalogue import CATALOGUE
from gaitsweep.tasks.walkers.resolve import resolve
from gaitsweep.tasks.walkers.statics import statics
from gaitsweep.tasks.walkers.walker import Walker
from lines import branches

WALKERS = Path(__file__).parents[2] / "data" / "walkers"
GROUP = tuple(v.name for v in VARIABLES.values() if v.group == "violations")
STATE = ("stance_angle", "stance_rate", "thigh_rate", "shank_rate", "kneestrike_time")
KNEE = (
    "unlocking_torque",
    "unlocking_torque_time",
    "unlocking_impulse_kneestrike",
    "unlocking_impulse_heelstrike",
    "hyperextension",
    "friction_demand_kneestrike",
)
_atlases: dict[str, dict] = {}


#: Whatever exceeds an assumption by however little is flagged.
NO_LIMITS = {**dict.fromkeys(VIOLATIONS, 0.0), "friction": 1.0}


def measured(
    name: str,
    slopes: list[float],
    want: tuple[str, ...] = STATE + GROUP,
    **options: object,
) -> dict[str, np.ndarray]:
    walker: object = name
    if name.endswith(".toml"):
        walker = tomllib.loads((WALKERS / name).read_text())["walker"]
    line = {"walker": walker, "set": {}}
    if name not in _atlases:
        _atlases[name] = atlas({"line": line}, [])
    base = {
        "line": line,
        "slope": np.array(slopes),
        "want": want,
        "violation_limits": NO_LIMITS,
    }
    return points(base | options, [_atlases[name]])


def gait(name: str, slope: float, label: str) -> dict[str, float]:
    found = measured(name, [slope])
    g = GAITS.index(label)
    assert found["status"][0, g] == 0
    return {k: found[k][0, g].item() for k in STATE + GROUP}


def flags(bits: int) -> set[str]:
    return {name for k, name in enumerate(VIOLATIONS) if bits >> k & 1}


def bit(name: str) -> int:
    return 1 << list(VIOLATIONS).index(name)


def lock_impulse(
    walker: oracle.Oracle, before: np.ndarray, contact: int, locked: tuple[int, ...]
) -> float:
    """Angular impulse of the first lock on its thigh."""
    angles = walker._links(before[:3])
    jac, _ = walker._constraints(angles, np.zeros(4), contact, locked)
    return walker._solve(
        jac, walker.mass * walker.velocities(before), np.zeros(len(jac))
    )[1][10]


def swing_foot(walker: oracle.Oracle, state: np.ndarray) -> float:
    place = walker.positions(state)
    return (
        place[oracle.SHANK[1] + 1]
        + oracle._turn(state[2], walker.centre_on_shank)[1]
        - walker.radius
    )


@pytest.mark.parametrize(
    ("name", "slope", "label"),
    [
        ("E", 0.01, "short"),
        ("A", 0.01, "long"),
        ("physical-straight", 0.03, "long"),
        ("physical", 0.036, "long"),
        ("physical", 0.0195, "long"),
        ("C", 0.001, "short"),
        ("kneed-point-foot.toml", 0.0504, "long"),
    ],
)
def test_amounts_agree_with_the_derivation_in_maximal_coordinates(name, slope, label):
    found = gait(name, slope, label)
    walker = resolve(
        tomllib.loads((WALKERS / name).read_text())["walker"]
        if name.endswith(".toml")
        else name
    )
    slow = oracle.Oracle(walker.table())
    step = slow.step(
        found["stance_angle"],
        [found["stance_rate"], found["thigh_rate"], found["shank_rate"]],
        slope,
        samples=600,
    )
    weight = walker.total_mass * walker.g
    # The oracle's own samples miss an extreme inside an interval by half a curvature
    # times the squared interval.
    assert found["least_normal_force"] == pytest.approx(
        step.force[:, 1].min() / weight, rel=2e-5
    )
    assert found["friction_demand"] == pytest.approx(
        (abs(step.force[:, 0]) / step.force[:, 1]).max(), rel=2e-5
    )
    impulse = step.impulse_heelstrike
    assert found["friction_demand_heelstrike"] == pytest.approx(
        abs(impulse[0]) / impulse[1], rel=1e-8
    )
    depth = -min(swing_foot(slow, state) for state in step.states)
    assert found["scuff_depth"] == pytest.approx(
        max(depth, 0.0), rel=1e-3, abs=1e-14 * walker.leg
    )
    if not walker.knees:
        assert all(np.isnan(found[k]) for k in KNEE)
        return
    impulse = step.impulse_kneestrike
    assert found["friction_demand_kneestrike"] == pytest.approx(
        abs(impulse[0]) / impulse[1], rel=1e-7
    )
    struck = lock_impulse(slow, step.before_kneestrike, 0, (0, 1))
    assert found["unlocking_impulse_kneestrike"] == pytest.approx(-struck, rel=1e-7)
    landed = lock_impulse(slow, step.before_heelstrike, 1, (1,))
    assert found["unlocking_impulse_heelstrike"] == pytest.approx(-landed, rel=1e-7)
    locked = (step.time >= step.kneestrike_time) & (
        abs(step.states[:, 4] - step.states[:, 5]) < 1e-9
    )
    held = np.array(
        [
            slow.motion(state, slope, lock)[1][10]
            for state, lock in zip(step.states, locked, strict=True)
        ]
    )
    assert found["unlocking_torque"] == pytest.approx(-held.min(), rel=1e-4)
    assert found["unlocking_torque_time"] == pytest.approx(
        step.time[held.argmin()], abs=2e-3
    )
    over = (step.states[:, 2] - step.states[:, 1]).max()
    assert found["hyperextension"] == pytest.approx(
        over if found["hyperextension"] else 0.0, rel=1e-3, abs=1e-13
    )
    assert ("release_hyperextends" in flags(found["violations"])) == (over > 1e-12)


@pytest.mark.parametrize(
    ("name", "keys", "slope"),
    [
        ("C", {"hip_torque": 0.02, "hip_stiffness": 0.1}, 0.03),
        pytest.param(
            "B",
            {"hip_torque": 0.01, "push_off": 0.02},
            0.0,
            marks=pytest.mark.thorough,
        ),
    ],
)
def test_forces_of_driven_walkers_are_those_of_constraints(name, keys, slope):
    """The torque between the thighs acts on the stance thigh, too."""
    (found, *_) = solve_one({"walker": name, "set": keys, "slope": slope})["gaits"]
    walker = resolve(name, keys)
    slow = oracle.Oracle(walker.table())
    rates = [found["stance_rate"], found["thigh_rate"], found["shank_rate"]]
    rates = rates[: 2 + slow.knees]
    step = slow.step(found["stance_angle"], rates, slope, samples=600)

    normal = step.force[:, 1].min() / (walker.total_mass * walker.g)
    assert found["least_normal_force"] == pytest.approx(normal, rel=2e-5)
    demand = (abs(step.force[:, 0]) / step.force[:, 1]).max()
    assert found["friction_demand"] == pytest.approx(demand, rel=2e-5)
    if walker.knees:
        held = min(_torques_of_the_lock(slow, step, slope))
        assert found["unlocking_torque"] == pytest.approx(-held, rel=1e-4)


def _torques_of_the_lock(slow, step, slope):
    """The torque that holds the stance knee, at each sample of a step."""
    locked = step.time >= step.kneestrike_time
    locked &= abs(step.states[:, 4] - step.states[:, 5]) < 1e-9
    for state, lock in zip(step.states, locked, strict=True):
        yield slow.motion(state, slope, lock)[1][10]


@pytest.mark.parametrize("name", ["E", "physical"])
def test_the_least_impulse_of_the_ground_is_that_of_either_strike(name):
    slope = 0.036 if name == "physical" else 0.01
    found = gait(name, slope, "long")
    walker = resolve(name)
    rates = [found["stance_rate"], found["thigh_rate"], found["shank_rate"]]

    step = oracle.Oracle(walker.table()).step(found["stance_angle"], rates, slope)

    least = step.impulse_heelstrike[1]
    if walker.knees:
        least = min(least, step.impulse_kneestrike[1])
    assert found["least_normal_impulse"] == pytest.approx(least, rel=1e-7)


def test_the_torque_is_that_of_the_lock_at_every_instant():
    # A walker with nothing symmetric about it, so no term can hide.
    walker = Walker(
        l_t=0.4,
        w_t=0.02,
        m_t=1.5,
        r_t=0.11,
        c_t=0.15,
        l_s=0.5,
        w_s=-0.03,
        m_s=0.8,
        r_s=0.13,
        c_s=0.2,
        R=0.15,
        eps_T=0.12,
        m_h=0.7,
        g=9.81,
        knees=True,
        units="SI",
    )
    slow, chain = oracle.Oracle(walker.table()), Chain(walker)
    second, size = np.sqrt(walker.leg / walker.g), walker.total_mass * walker.g
    rng = np.random.default_rng(3)
    for free_knee in (True, False):
        for _ in range(20):
            angle, rate = rng.uniform(-0.4, 0.4, 3), rng.uniform(-2, 2, 3)
            if not free_knee:
                angle[2], rate[2] = angle[1], rate[1]
            slope = rng.uniform(0, 0.2)
            links, rates = (
                angle[[0, 0, 1, 2]][:, None],
                rate[[0, 0, 1, 2]][:, None] * second,
            )
            gamma = np.array([slope])
            acceleration = chain.accelerations(links, rates, gamma, free_knee)
            force = chain.ground_force(links, rates, acceleration, gamma)[0] * size
            state = np.concatenate([angle, rate])
            expected = slow.accelerations(state, slope, not free_knee)
            np.testing.assert_allclose(
                acceleration[[0, 2, 3], 0] / second**2, expected, rtol=1e-10, atol=1e-10
            )
            force_slow = slow.motion(state, slope, not free_knee)[1]
            np.testing.assert_allclose(
                [force.real, force.imag], force_slow[8:10], rtol=1e-10, atol=1e-10
            )
            torque = (
                chain.holding(links, rates, acceleration, gamma)[0] * size * walker.leg
            )
            assert torque == pytest.approx(force_slow[10], rel=1e-9, abs=1e-10)
            assert chain.height(links)[0] * walker.leg == pytest.approx(
                swing_foot(slow, state), abs=1e-14
            )


def flown(
    walker: Walker, before: np.ndarray, slope: float
) -> tuple[dict[str, float], np.ndarray, oracle.Oracle]:
    """Violations of the first instants after a heelstrike that need not belong to a
    gait, flown by the oracle.
    """
    slow = oracle.Oracle(walker.table())
    after, _, _ = slow.heelstrike(before)
    second = np.sqrt(walker.leg / walker.g)
    state, samples, end = after, [after], 0.3 * second
    for _ in range(violations.SAMPLES):
        state = runge_kutta(
            lambda y: np.concatenate(
                [y[3:], slow.accelerations(y, slope, not walker.knees)]
            ),
            state,
            end / violations.SAMPLES,
        )
        samples.append(state)
    scale = np.array([1, 1, 1, second, second, second])
    path = np.array(samples) * scale
    motion = [path[:, :, None]] if walker.knees else [path[:, [0, 1, 3, 4], None]]
    times = [[end / second]]
    if walker.knees:
        # A second phase of no interest, so both are there.
        motion.append(
            np.repeat(path[-1:, [0, 1, 3, 4], None], violations.SAMPLES + 1, axis=0)
        )
        times.append([end / second + 0.1])
    found = violations.measure(
        walker,
        motion,
        before[[3, 4]][:, None] * second,
        np.array(times),
        np.array([slope]),
    )
    return {k: v[0].item() for k, v in found.items()}, path[:, :, None], slow


def runge_kutta(rhs, y, h):
    a = rhs(y)
    b = rhs(y + h / 2 * a)
    c = rhs(y + h / 2 * b)
    d = rhs(y + h * c)
    return y + h / 6 * (a + 2 * b + 2 * c + d)


@pytest.mark.parametrize("name", ["A", "C"])
def test_a_foot_released_downward_needs_the_push_of_two_contacts(name):
    walker = resolve(name)
    sinking = 0
    for swing in (-2.0, -4.0, -8.0, 2.0, 4.0, 8.0):
        before = np.array([-0.2, 0.2, 0.2, -0.5, swing, swing])
        found, path, slow = flown(walker, before, 0.02)
        after, _, _ = slow.heelstrike(before)
        speed = slow.velocities(after)
        down = (
            speed[oracle.SHANK[1] + 1]
            + speed[oracle.SHANK[1] + 2]
            * oracle._turn(after[2], slow.centre_on_shank)[0]
        )
        assert ("trailing_foot_pulls" in flags(found["violations"])) == (down < 0)
        assert ("release_penetrates" in flags(found["violations"])) == (down < 0)
        if down > 0:
            assert found["trailing_impulse"] == found["penetration_depth"] == 0
            continue
        sinking += 1
        # Two contacts: the leading foot as before, the trailing one kept from sinking
        # by a frictionless push.
        locked = (1,) if walker.knees else (0, 1)
        jac, _ = slow._constraints(slow._links(before[:3]), np.zeros(4), 1, locked)
        row = np.zeros((1, oracle.COORDINATES))
        row[0, oracle.SHANK[0] + 1] = 1
        row[0, oracle.SHANK[0] + 2] = oracle._turn(before[0], slow.centre_on_shank)[0]
        both = np.vstack([jac, row])
        pushed = slow._solve(
            both, slow.mass * slow.velocities(before), np.zeros(len(both))
        )[1][-1]
        assert found["trailing_impulse"] == pytest.approx(pushed, rel=1e-9)
        heights = [
            swing_foot(
                slow, state / np.array([1, 1, 1] + 3 * [np.sqrt(walker.leg / walker.g)])
            )
            for state in path[:, :, 0]
        ]
        assert found["penetration_depth"] == pytest.approx(-min(heights), rel=1e-3)
    assert sinking


def test_simplest_walker_meets_its_closed_forms():
    for slope, label in ((0.009, "long"), (0.009, "short"), (1e-4, "short")):
        found = gait("D", slope, label)
        theta, rate = found["stance_angle"], found["stance_rate"]
        # A massless leg can only push along itself.
        assert found["friction_demand_heelstrike"] == pytest.approx(
            np.tan(theta), rel=1e-12
        )
        assert found["friction_demand"] == pytest.approx(np.tan(theta), rel=1e-12)
        landing = rate**2 + 2 * (np.cos(theta - slope) - np.cos(theta + slope))
        least = np.cos(theta) * min(
            np.cos(theta - slope) - rate**2, np.cos(theta + slope) - landing
        )
        assert found["least_normal_force"] == pytest.approx(least, rel=1e-10)
        assert found["penetration_depth"] == found["trailing_impulse"] == 0
        assert flags(found["violations"]) == {"scuff"}


def test_scuff_of_the_simplest_walkers_short_step_follows_its_linear_motion():
    found = gait("D", 1e-9, "short")
    t = np.linspace(0, np.pi, 200_001)
    stance = np.sinh(np.pi / 2 - t) / np.sinh(np.pi / 2)
    apart = stance / 2 + 1.5 * np.cos(t) + 0.5 / np.tanh(np.pi / 2) * np.sin(t)
    depth = (apart * (2 * stance - apart) / 2).max()
    assert found["scuff_depth"] / found["stance_angle"] ** 2 == pytest.approx(
        depth, rel=1e-5
    )


def test_the_depth_of_a_scuff_does_not_depend_on_the_samples(monkeypatch):
    # On long steps the foot is below the ground for far less than the time between
    # samples.
    slopes, want = [1e-4, 1e-3], ("scuff_depth",)
    fine = measured("B", slopes, want)["scuff_depth"][:, 0]
    monkeypatch.setattr(violations, "SAMPLES", 48)
    np.testing.assert_allclose(
        measured("B", slopes, want)["scuff_depth"][:, 0], fine, rtol=1e-9
    )


def test_a_scuff_has_the_depth_of_a_simulation_in_more_digits():
    """It had six or seven right digits: the depth is small, and a quartic through its
    samples is off by 1e-10.
    """
    found = measured("F", [0.01], ("scuff_depth",))["scuff_depth"][0, 0]
    assert found == pytest.approx(7.435717431858e-5, rel=1e-11)


def test_extremes_within_a_step_do_not_depend_on_the_samples(monkeypatch):
    """The lock's torque was off by 1e-8, and its time by 4e-7."""
    name, slope, want = "kneed-point-foot.toml", [0.0504], GROUP
    coarse = measured(name, slope, want)
    monkeypatch.setattr(violations, "SAMPLES", 8 * violations.SAMPLES)
    fine = measured(name, slope, want)
    # A free knee needs no impulse that locks it.
    there = [key for key in want if np.nan_to_num(fine[key][0, 0]) != 0]
    values = [(coarse[key][0, 0], fine[key][0, 0]) for key in there]
    assert len(values) > 8 and fine["unlocking_torque_time"][0, 0] > 0
    for value, closer in values:
        assert value == pytest.approx(closer, rel=1e-9)
    assert coarse["unlocking_torque"][0, 0] == pytest.approx(
        fine["unlocking_torque"][0, 0], rel=1e-11
    )


def test_a_scuff_between_two_samples_is_found(monkeypatch):
    slopes, want = [0.324, 0.325], ("scuff_depth", "violations")
    found = measured("C", slopes, want)
    assert found["scuff_depth"][1, 1] < 1e-5
    assert (found["violations"][:, 1] & 1).all()
    monkeypatch.setattr(violations, "SAMPLES", 2400)
    fine = measured("C", slopes, want)["scuff_depth"][:, 1]
    np.testing.assert_allclose(found["scuff_depth"][:, 1], fine, atol=1e-8)


def test_a1_straight_legs_always_scuff():
    for name in (
        "A",
        "B",
        "D",
        "E",
        "physical-straight",
        "goswami-compass.toml",
        "round-foot.toml",
    ):
        found = measured(name, [1e-6, 1e-4, 0.01, 0.02, 0.05])
        there = found["status"] == 0
        assert there.sum() >= 3
        assert (found["violations"][there] & 1 == 1).all()
        assert (found["scuff_depth"][there] > 0).all()
    # The long step's scuff shrinks as the square of the slope, far below any sample.
    depth = measured("D", [1e-8, 1e-6])["scuff_depth"][:, 0]
    assert depth[1] / depth[0] == pytest.approx(1e4, rel=1e-3)


def test_a1_knees_need_not_scuff():
    assert "scuff" not in flags(gait("physical", 0.036, "long")["violations"])
    assert "scuff" in flags(gait("C", 0.036, "long")["violations"])


def test_a2_the_machines_stance_knee_is_struck_open_and_held_at_once():
    found = gait("physical", 0.036, "long")
    assert "stance_knee_unlocks" in flags(found["violations"])
    # Slight: a hundredth of the momentum of a leg's mass at walking speed over a leg.
    assert 0 < found["unlocking_impulse_kneestrike"] < 0.03
    assert found["unlocking_impulse_heelstrike"] < 0
    # Nothing opens the knee between the impacts, so it engages again.
    assert found["unlocking_torque"] < 0


def test_a3_no_contact_pulls_on_the_stable_gaits():
    for name, slopes in (
        ("physical", [0.025, 0.036, 0.05]),
        ("C", [1e-3, 0.02, 0.05]),
        ("A", [1e-3, 0.05]),
    ):
        found = measured(name, slopes)
        long = found["status"][:, 0] == 0
        assert long.any()
        assert (found["least_normal_force"][long, 0] > 0).all()
        assert (found["violations"][long, 0] & bit("contact_tension") == 0).all()


@pytest.mark.parametrize(
    ("label", "slope"), [("short", 0.0079745), ("long", 2.2077e-4)]
)
def test_a4_release_hyperextends_below_a_slope(label, slope):
    below, above = (
        gait("C", slope * (1 - 5e-4), label),
        gait("C", slope * (1 + 5e-4), label),
    )
    assert "release_hyperextends" in flags(below["violations"])
    assert below["hyperextension"] > 0
    assert "release_hyperextends" not in flags(above["violations"])
    assert above["hyperextension"] == 0


def test_flags_say_what_the_amounts_say():
    found = measured("C", list(np.geomspace(1e-5, 0.06, 12)))
    there = found["status"] == 0
    amounts = {
        "scuff": found["scuff_depth"] > 0,
        "release_hyperextends": found["hyperextension"] > 0,
        "stance_knee_unlocks": np.maximum.reduce(
            [found[k] for k in KNEE[:1] + KNEE[2:4]]
        )
        > 0,
        "release_penetrates": found["penetration_depth"] > 0,
        "trailing_foot_pulls": found["trailing_impulse"] > 0,
    }
    for name, expected in amounts.items():
        flagged = found["violations"] & bit(name) > 0
        np.testing.assert_array_equal(flagged[there], expected[there])
    assert (found["violations"][~there] == 0).all()


def test_amounts_do_not_depend_on_the_other_points():
    slopes = list(np.geomspace(1e-4, 0.05, 7))
    together = measured("A", slopes)
    for k, slope in enumerate(slopes):
        alone = measured("A", [slope])
        for name in GROUP:
            np.testing.assert_array_equal(alone[name][0], together[name][k])


def test_nothing_is_computed_that_is_not_wanted(monkeypatch):
    measured("D", [0.01], ("stance_angle",))

    def refuse(*_):
        raise AssertionError("violations were computed")

    monkeypatch.setattr(violations, "measure", refuse)
    measured("D", [0.01], ("stance_angle",))


def test_extremes_between_samples_are_found():
    shift = np.array([0.0, 0.3, 0.77])
    x = np.linspace(0, 2, 97)[:, None]
    value, at = violations.greatest(np.sin(2 * (x - 0.1) + shift))
    np.testing.assert_allclose(value, 1.0, rtol=1e-14)
    np.testing.assert_allclose(at / 48, (np.pi / 2 - shift) / 2 + 0.1, rtol=1e-11)
    # Where there is no value there is no extreme.
    partly = np.where((x < 0.3) | (x > 1.9), np.nan, np.sin(2 * (x - 0.1)))
    assert violations.greatest(partly)[0] == pytest.approx(1.0, abs=1e-9)
    # Samples that may not be the largest are none, however large.
    wave = np.sin(2 * (x - 0.1)) + np.where(x > 1.5, 9.0, 0.0)
    assert violations.greatest(wave, x <= 1.5)[0] == pytest.approx(1.0, abs=1e-9)
    # Between two samples a function may exceed a sample elsewhere that is larger than
    # both.
    between = np.where(x == 0, 0.0, 1e-6 - (x - 1.0104) ** 2)
    value, at = violations.greatest(between)
    assert (value[0], at[0] / 48) == pytest.approx((1e-6, 1.0104), rel=1e-7)
    rising, at = violations.greatest(x**3)
    assert rising[0] == 8.0
    assert at[0] == 96


@pytest.mark.parametrize(
    ("name", "slope", "angle", "rates"),
    [
        # Wisse and Schwab 2005, walking simulation example.
        ("round-foot.toml", 0.01, 0.2015, (-1.4052, -1.1205)),
    ],
)
def test_walkers_outside_the_paper_have_their_published_gaits(
    name, slope, angle, rates
):
    found = gait(name, slope, "long")
    assert found["stance_angle"] == pytest.approx(angle, abs=5.1e-5)
    assert (found["stance_rate"], found["thigh_rate"]) == pytest.approx(
        rates, abs=5.1e-5
    )


def test_the_compass_walks_with_period_one_at_three_degrees_and_is_tuned():
    found = measured(
        "goswami-compass.toml", list(np.radians([3.0, 4.3, 4.5])), ("spectral_radius",)
    )
    # One stable gait up to about 4.4 degrees (Goswami, Thuilot and Espiau 1998),
    # unstable after.
    assert list(found["spectral_radius"][:, 0] < 1) == [True, True, False]
    table = tomllib.loads((WALKERS / "goswami-compass.toml").read_text())["walker"]
    assert all(value == 0 for value in statics(resolve(table)).values())


@pytest.mark.parametrize(
    ("walker", "slope", "label", "violation"),
    [
        ("C", 0.02, "long", "scuff"),
        ("physical", 0.036, "long", "stance_knee_unlocks"),
        ("C", 0.02, "short", "stance_knee_unlocks"),
        ("D", 0.3, "long", "contact_tension"),
        ("physical", 0.036, "long", "friction"),
        ("C", 1e-4, "short", "release_hyperextends"),
        ("physical-straight", 0.3, "long", "release_penetrates"),
        ("physical-straight", 0.3, "long", "trailing_foot_pulls"),
    ],
)
def test_a_violation_is_flagged_where_an_amount_exceeds_its_limit(
    walker, slope, label, violation
):
    found, own = gait(walker, slope, label), CATALOGUE[walker]
    weight, time = own.total_mass * own.g, np.sqrt(own.leg / own.g)
    units = {
        "scuff_depth": own.leg,
        "penetration_depth": own.leg,
        "unlocking_torque": weight * own.leg,
        "unlocking_impulse_kneestrike": weight * own.leg * time,
        "unlocking_impulse_heelstrike": weight * own.leg * time,
        "least_normal_impulse": weight * time,
        "trailing_impulse": weight * time,
    }
    sign = -1 if VIOLATIONS[violation].is_least else 1
    worst = max(
        sign * found[name] / units.get(name, 1.0)
        for name in VIOLATIONS[violation].amounts
    )
    assert worst > 0
    for factor, flagged in ((0.999, True), (1.001, False)):
        limits = {violation: factor * worst}
        bits = measured(walker, [slope], violation_limits=limits)["violations"][
            0, GAITS.index(label)
        ]
        assert (violation in flags(bits)) == flagged


def test_the_default_limits_tell_walkers_apart():
    """Of the stable gaits of the tuned straight legs none is flagged, of C's all scuff,
    of the machine's none does.
    """
    for walker, slope, expected in (
        ("A", 0.02, set()),
        ("D", 0.009, set()),
        ("C", 0.02, {"scuff"}),
        ("physical", 0.036, {"stance_knee_unlocks"}),
    ):
        found = measured(
            walker, [slope], ("stance_angle", "violations"), violation_limits=None
        )
        assert flags(found["violations"][0, 0]) == expected


@pytest.mark.parametrize("name", VIOLATIONS)
def test_a_limit_is_of_amounts_that_are_archived(name):
    amounts = VIOLATIONS[name].amounts
    assert amounts and all(
        VARIABLES[amount].group == "violations" for amount in amounts
    )
    assert VIOLATIONS[name].limit >= 0 and VIOLATIONS[name].reason


@pytest.mark.parametrize("name", ["A", "D", "C"])
def test_the_foots_clearance_is_its_lowest_height_in_mid_swing(name):
    """Straight legs scuff by it; a foot that scuffs nowhere clears the ground by it, as
    a simulation shows.
    """
    found = gait(name, 0.02, "long")
    assert found["foot_clearance"] == -found["scuff_depth"] < 0


def test_the_machines_foot_clears_the_ground_by_what_a_simulation_shows():
    found, walker = gait("physical", 0.036, "long"), CATALOGUE["physical"]
    slow = oracle.Oracle(walker.table())
    rates = [found["stance_rate"], found["thigh_rate"], found["shank_rate"]]
    states = slow.step(found["stance_angle"], rates, 0.036, samples=600).states
    heights = np.array([swing_foot(slow, state) for state in states])
    low = heights[1:-1][(heights[1:-1] < heights[:-2]) & (heights[1:-1] < heights[2:])]
    assert found["foot_clearance"] == pytest.approx(low.min(), rel=1e-4)
    assert low.min() > 0


@pytest.mark.parametrize("name", ["E", "C"])
def test_where_contact_is_lost_the_second_derivation_finds_no_force_left(name):
    problem, found = branches(name)
    points = [p for b in found for p in contact_lost(problem, b, 0.2, 0.4)]
    assert points and all(p["error_bound"] < 1e-10 for p in points)
    for point in points:
        gaits = solve_one({"walker": name, "slope": point["slope"]})["gaits"]
        gait = min(gaits, key=lambda g: abs(g["stance_angle"] - point["stance_angle"]))
        assert gait["stance_angle"] == pytest.approx(point["stance_angle"], rel=1e-9)
        model = oracle.Oracle(CATALOGUE[name].table())
        rates = [gait["stance_rate"], gait["thigh_rate"], gait["shank_rate"]][
            : 3 if model.knees else 2
        ]
        force = model.step(
            gait["stance_angle"], rates, point["slope"], samples=4001
        ).force[:, 1]
        assert abs(force.min()) < 1e-6 * problem.walker.total_mass * problem.walker.g


def test_contact_is_lost_in_a_window_however_narrow():
    problem, found = branches("E")
    wide = [(b, p) for b in found for p in contact_lost(problem, b, 0.2, 0.4)]
    assert wide
    for branch, point in wide:
        low, high = point["slope"] * (1 - 1e-9), point["slope"] * (1 + 1e-9)
        assert not np.any((np.exp(branch.q) > low) & (np.exp(branch.q) < high))
        assert point in contact_lost(problem, branch, low, high)
        assert contact_lost(problem, branch, 0.49, 0.4900001) == []
