"""Walkers whose trailing knee is locked during heelstrike, against two derivations that
share nothing with the solver, and against the same walkers with a free one.
"""

import tomllib
from dataclasses import replace

import mpmath as mp
import numpy as np
import pytest

import extended
import gaitsweep
from gaitsweep.pipeline.cli.commands import main
from gaitsweep.pipeline.errors import StudyError
from gaitsweep.pipeline.study.parse import parse
from gaitsweep.tasks.contract.registry import VIOLATIONS
from gaitsweep.tasks.measures import violations
from gaitsweep.tasks.measures.losses import heelstrike_losses
from gaitsweep.tasks.mechanics.small_angles import SmallAngles
from gaitsweep.tasks.proofs.records import prove_stored
from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.step.verify_step import hyperextends_at_release, verify
from gaitsweep.tasks.studies.follow_branches import branch
from gaitsweep.tasks.studies.prove_gaits import prove_one
from gaitsweep.tasks.studies.solve_at_slope import solve_one
from gaitsweep.tasks.studies.solve_points import atlas
from gaitsweep.tasks.walkers.resolve import resolve
from gaitsweep.tasks.walkers.walker import Walker, WalkerError
from oracle import SHANK, Oracle

C, PHYSICAL = ({"base": name, "trailing_knee": "locked"} for name in ("C", "physical"))
RATES = ("stance_rate", "thigh_rate", "shank_rate")
#: A walker with nothing symmetric about it, so that no term can hide.
ODD = Walker(
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
    trailing_knee="locked",
)
#: A walker whose knee, released at rest, first moves against its stop at some slopes.
HYPEREXTENDING = {
    **PHYSICAL,
    **{"w_s": 0.07, "eps_T": 0.008, "c_s": 0.31, "m_h": 2.0, "R": 0.2, "w_t": 0.0156},
}


def gaits_of(walker, slope):
    """Gaits of a walker at a slope, dicts of variables."""
    return solve_one({"walker": walker, "slope": slope})["gaits"]


def gait_of(walker, slope, label="long"):
    """One of them."""
    return next(gait for gait in gaits_of(walker, slope) if gait["gait"] == label)


def state_of(gait):
    """Angle and rates just after heelstrike."""
    return gait["stance_angle"], np.array([gait[name] for name in RATES])


def rigid_leg(walker):
    """Mass, centre of mass from the hip, inertia about it, and centre of the foot, of a
    leg whose knee is straight.
    """
    bend = np.arcsin(walker.l_t * np.sin(walker.eps_T) / (walker.l_s - walker.R))
    along_thigh, along_shank = np.exp(-1j * walker.eps_T), np.exp(1j * bend)
    knee = -1j * walker.l_t * along_thigh
    thigh = -(walker.w_t + 1j * walker.c_t) * along_thigh
    shank = knee - (walker.w_s + 1j * walker.c_s) * along_shank
    foot = knee - 1j * (walker.l_s - walker.R) * along_shank

    mass = walker.m_t + walker.m_s
    centre = (walker.m_t * thigh + walker.m_s * shank) / mass
    spread = (
        walker.m_t * abs(thigh - centre) ** 2 + walker.m_s * abs(shank - centre) ** 2
    )
    own = walker.m_t * walker.r_t**2 + walker.m_s * walker.r_s**2
    return mass, centre, spread + own, foot


def moment(about, place, mass, velocity, inertia=0.0, rate=0.0):
    """Angular momentum of a body about a point."""
    return mass * ((place - about).conjugate() * velocity).imag + inertia * rate


def rates_of_rigid_legs(walker, angle, stance, swing):
    """Rates of the new stance leg and of the leg that leaves the ground, by the momenta
    of two rigid legs and a hip: of all about the new contact, and of the trailing leg
    about the hip.
    """
    mass, centre, inertia, foot = rigid_leg(walker)
    new = np.exp(1j * angle)
    old = np.exp(-1j * angle)
    contact = foot * new - 1j * walker.R

    def momenta(hip, leading, trailing):
        ways = {"new": (new, leading), "old": (old, trailing)}
        moments = {}
        for leg, (turn, rate) in ways.items():
            place = centre * turn
            velocity = hip + 1j * rate * place
            for name, point in (("contact", contact), ("hip", 0.0)):
                moments[leg, name] = moment(point, place, mass, velocity, inertia, rate)
        of_hip = moment(contact, 0.0, walker.m_h, hip)
        all_about_contact = moments["new", "contact"] + moments["old", "contact"]
        return np.array([all_about_contact + of_hip, moments["old", "hip"]])

    def rolling(turn, rate):
        return -walker.R * rate - 1j * rate * foot * turn

    before = momenta(rolling(old, stance), swing, stance)
    columns = [
        momenta(rolling(new, leading), leading, trailing)
        for leading, trailing in ((1.0, 0.0), (0.0, 1.0))
    ]
    return np.linalg.solve(np.array(columns).T, before)


@pytest.mark.parametrize("walker", [resolve(C), resolve(PHYSICAL), ODD], ids="CPO")
def test_the_impact_is_that_of_two_rigid_legs(walker):
    problem = Problem(walker)
    random = np.random.default_rng(1)
    for _ in range(20):
        angle = random.uniform(0.01, 0.4)
        stance, swing = random.uniform(-2, 2, 2)
        unit = walker.time_unit

        y = np.array([[angle], [stance * unit], [swing * unit]])
        found = problem.start(y, np.array([0.02]))[1:, 0] / unit

        leading, trailing = rates_of_rigid_legs(walker, angle, stance, swing)
        np.testing.assert_allclose(found, [leading, trailing, trailing], rtol=1e-11)
        assert found[1] == found[2]


def test_the_impact_is_that_of_the_same_walker_without_knees():
    straight = replace(ODD, knees=False, trailing_knee="free")
    angle, rates = np.array([0.2]), np.array([[-1.1], [0.3]])

    with_knees = heelstrike_losses(ODD, angle, rates)

    assert with_knees == heelstrike_losses(straight, angle, rates)
    free = heelstrike_losses(replace(ODD, trailing_knee="free"), angle, rates)
    assert not np.allclose(with_knees, free, rtol=1e-3)


@pytest.mark.parametrize(
    ("walker", "slope"),
    [
        (C, 0.02),
        (PHYSICAL, 0.036),
        (PHYSICAL, 0.0195),
        (C, 1e-4),
    ],
)
def test_a_step_is_that_of_the_rigid_bodies(walker, slope):
    angle, rates = state_of(gait_of(walker, slope))
    # Beside the gait, so that agreement is not just that of two fixed points.
    state = np.array([1.003 * angle, 0.998 * rates[0], 1.01 * rates[1]])
    begin = [state[1], state[2], state[2]]

    answer = gaitsweep.step_map(walker, slope, state)

    step = Oracle(resolve(walker).table()).step(state[0], begin, slope)
    image = [step.theta, *step.rates[:2]]
    assert answer.state == pytest.approx(image, rel=1e-8)
    times = [step.kneestrike_time, step.period]
    assert list(answer.times) == pytest.approx(times, rel=1e-8)
    assert sum(answer.losses[:2]) == pytest.approx(step.loss_heelstrike, rel=1e-7)
    assert answer.losses.kneestrike == pytest.approx(step.loss_kneestrike, rel=1e-7)


def test_uneven_ground_is_that_of_the_rigid_bodies():
    slope, height = 0.036, 0.003
    angle, rates = state_of(gait_of(PHYSICAL, slope))

    steps = gaitsweep.simulate(
        PHYSICAL, slope, [angle, *rates[:2]], 2, ground={0: height}
    )

    names = ("stance_angle", "thigh_angle", "thigh_angle", *RATES)
    after = np.array([float(steps[name][1]) for name in names])
    assert after[0] != -after[1] and after[4] == after[5]
    # The rates before that lead to those after, of stance leg and thigh.
    oracle = Oracle(resolve(PHYSICAL).table())
    stand = [after[1], after[0], after[0]]
    columns = [
        oracle.heelstrike([*stand, *unit])[0][3:5] for unit in ([1, 0, 0], [0, 1, 1])
    ]
    stance, swing = np.linalg.solve(np.array(columns).T, after[3:5])
    struck, _, _ = oracle.heelstrike([*stand, stance, swing, swing])
    np.testing.assert_allclose(after, struck, rtol=1e-12)


@pytest.mark.parametrize(
    ("walker", "slope", "label"),
    [
        (C, 0.02, "long"),
        (C, 0.02, "short"),
        (C, 1e-6, "long"),
        (PHYSICAL, 0.036, "long"),
        pytest.param(PHYSICAL, 0.08, "long", marks=pytest.mark.thorough),
    ],
)
def test_a_gait_lies_within_its_bound_of_one_in_113_bits(walker, slope, label):
    gait = gait_of(walker, slope, label)
    numbers = {
        key: mp.mpf(value) if type(value) is float else value
        for key, value in resolve(walker).table().items()
    }
    names = ("stance_angle", *RATES, "kneestrike_time", "period")

    guess = [gait[name] for name in names]
    _, exact, _ = extended.solve(numbers, mp.mpf(slope), guess)

    fastest = max(abs(gait[name]) for name in RATES)
    for name, value in zip(names, exact, strict=True):
        if name == "kneestrike_time":
            continue
        size = abs(value)
        if name in RATES:
            size = fastest
        error = abs(mp.mpf(gait[name]) - value)
        assert error <= gait["error_bound"] * size
    assert gait["error_bound"] < 1e-11


def test_hsu_chens_walker_settles_on_the_gait_to_which_its_printed_start_leads():
    """V. F. Hsu Chen, M.Eng. thesis, MIT, 2007: 0.238 rad to either side of the normal,
    -1.1014 and -0.0399 rad/s.
    """
    walker, slope = "kneed-point-foot-locked.toml", 0.0504
    printed = [0.238, -1.1014, -0.0399]

    steps = gaitsweep.simulate(walker, slope, printed, 45)

    gait = gaitsweep.solve(walker, slope).iloc[0]
    assert gait.gait == "long" and gait.stable
    last = [float(steps[name][-1]) for name in ("stance_angle", *RATES)]
    found = [gait[name] for name in ("stance_angle", *RATES)]
    assert last == pytest.approx(found, rel=1e-7)
    assert found[0] == pytest.approx(printed[0], abs=1e-3)
    assert found[1:3] == pytest.approx(printed[1:], abs=0.02)
    free = gaitsweep.solve("kneed-point-foot.toml", slope).iloc[0]
    assert abs(free.thigh_rate - printed[2]) > 0.09


@pytest.mark.parametrize(
    ("walker", "slope"),
    [
        (C, 0.02),
        (C, 0.07),
        (PHYSICAL, 0.036),
        (PHYSICAL, 0.08),
    ],
)
def test_the_impulse_that_locks_is_that_of_the_constraint(walker, slope):
    gait = gait_of(walker, slope)
    angle, rates = state_of(gait)
    oracle = Oracle(resolve(walker).table())

    before = oracle.step(angle, rates, slope).before_heelstrike

    jac, _ = oracle._constraints(oracle._links(before[:3]), np.zeros(4), 1, (0, 1))
    momentum = oracle.mass * oracle.velocities(before)
    _, impulses = oracle._solve(jac, momentum, np.zeros(len(jac)))
    # On the thigh of the leg that leaves the ground, then of the one that lands.
    assert gait["unlocking_impulse_trailing"] == pytest.approx(-impulses[10], rel=1e-8)
    assert gait["unlocking_impulse_heelstrike"] == pytest.approx(
        -impulses[11], rel=1e-8
    )
    # A latch is needed where the knee, were it free, would bend.
    free = Oracle({**resolve(walker).table(), "trailing_knee": "free"})
    bends = free.heelstrike(before)[0][4] > free.heelstrike(before)[0][5]
    assert (gait["unlocking_impulse_trailing"] > 0) == bends


def test_a_knee_that_only_a_latch_holds_is_flagged_beyond_the_limit():
    limit = VIOLATIONS["trailing_knee_unlocks"].limit
    found = []
    for slope in (0.02, 0.07):
        gait = gait_of(C, slope)
        walker = resolve(C)
        unit = walker.total_mass * walker.leg**2 / walker.time_unit
        beyond = gait["unlocking_impulse_trailing"] > limit * unit
        assert ("trailing_knee_unlocks" in gait["violations"]) == beyond
        found.append(beyond)
    assert found == [False, True]


def test_only_walkers_that_lock_the_knee_have_the_impulse():
    assert "unlocking_impulse_trailing" not in gait_of("C", 0.02)
    found = gaitsweep.gaits("C", 0.02, variables=["violations"])
    assert "unlocking_impulse_trailing" not in found
    assert "trailing_knee_unlocks" not in found.violations.flag_meanings
    found = gaitsweep.gaits(C, 0.02, variables=["violations"])
    assert np.isfinite(found.unlocking_impulse_trailing[0])
    assert "trailing_knee_unlocks" in found.violations.flag_meanings


def test_losses_pay_for_the_drop():
    for walker in (C, PHYSICAL):
        found = gaitsweep.gaits(walker, [0.02, 0.05], variables=["energy_imbalance"])
        imbalance = found.energy_imbalance.values
        assert np.isfinite(imbalance[:, 0]).all()
        assert np.nanmax(np.abs(imbalance)) < 1e-11


def push_of_two_contacts(oracle, before):
    """Impulse on the trailing foot that keeps it from sinking, its knee locked."""
    angles = oracle._links(before[:3])
    jac, _ = oracle._constraints(angles, np.zeros(4), 1, (0, 1))
    # A row that is the rate of the foot's height.
    row = np.zeros((1, jac.shape[1]))
    foot = np.exp(1j * angles[0]) * complex(*oracle.centre_on_shank)
    row[0, SHANK[0] + 1], row[0, SHANK[0] + 2] = 1, foot.real

    rows = np.vstack([jac, row])
    momentum = oracle.mass * oracle.velocities(before)
    _, impulses = oracle._solve(rows, momentum, np.zeros(len(rows)))
    return impulses[-1]


def test_a_foot_that_sinks_is_pushed_while_the_knee_is_locked():
    walker = resolve(C)
    oracle, unit = Oracle(walker.table()), walker.time_unit
    before = np.array([-0.1, 0.1, 0.1, 0.5, -4.0, -4.0])
    after, _, _ = oracle.heelstrike(before)
    state = after * np.array([1, 1, 1, unit, unit, unit])
    three = np.repeat(state[None, :, None], violations.SAMPLES + 1, axis=0)

    found = violations.measure(
        walker,
        [three, three[:, [0, 1, 3, 4]]],
        before[[3, 4]][:, None] * unit,
        np.array([[0.1], [0.2]]),
        np.array([0.02]),
    )

    impulse = push_of_two_contacts(oracle, before)
    assert impulse > 0
    assert found["trailing_impulse"][0] == pytest.approx(impulse, rel=1e-9)


@pytest.mark.parametrize(
    ("walker", "slope"),
    [
        (C, "0.02"),
        (PHYSICAL, "0.036"),
        (PHYSICAL, "0.08"),
    ],
)
def test_gaits_are_proved_where_they_are_computed(walker, slope):
    proved = prove_one({"walker": walker, "slope": slope, "accuracy": 1e-12})["gaits"]

    solved = gaits_of(walker, float(slope))
    assert len(proved) == len(solved)
    for proof, gait in zip(proved, solved, strict=True):
        assert proof["proved"], proof["reason"]
        assert proof["walker"]["trailing_knee"] == "locked"
        middle, radius = map(mp.mpf, proof["box"]["stance_angle"])
        apart = abs(mp.mpf(gait["stance_angle"]) - middle)
        assert apart <= radius + gait["error_bound"] * middle
        assert proof["stable"] == gait["stable"]


def test_a_proof_of_the_other_rules_gait_is_refused():
    """Free and locked knees have gaits that differ by more than a box."""
    free, locked = gait_of("C", 0.02), gait_of(C, 0.02)
    assert abs(free["stance_angle"] / locked["stance_angle"] - 1) > 1e-3
    params = {"walker": C, "slope": 0.02, "gait": "long", "accuracy": 1e-12}
    assert prove_stored({**params, "values": locked})["proved"]
    assert not prove_stored({**params, "values": free})["proved"]


def test_the_rules_coincide_as_the_shanks_mass_vanishes():
    """A shank without mass pulls on nothing: stance leg and thigh move as one rule or
    the other says, and a gait's angle and period differ in proportion to the mass.
    """
    differences = []
    for share in (1e-2, 1e-3, 1e-4):
        light = {"base": "C", "m_s": 1.013 * share, "tuned": ["w_t", "w_s"]}
        free = gait_of(light, 0.01)
        locked = gait_of({**light, "trailing_knee": "locked"}, 0.01)
        differences.append(abs(free["stance_angle"] / locked["stance_angle"] - 1))
    ratios = np.divide(differences[1:], differences[:-1])
    np.testing.assert_allclose(ratios, 0.1, rtol=0.2)


def knee_acceleration(walker, slope, state):
    """Acceleration with which the released knee begins to bend, by the rigid bodies."""
    angle, *rates = state
    start = np.array([angle, -angle, -angle, *rates])
    _, thigh, shank = Oracle(resolve(walker).table()).accelerations(start, slope, False)
    return thigh - shank


def columns_of(found, table, names):
    """Columns of a table, shape (columns, rows)."""
    return np.array([found[f"{table}/{name}"] for name in names], float)


def test_a_knee_released_at_rest_may_first_move_against_its_stop():
    line = {"walker": HYPEREXTENDING, "set": {}}
    window = {"slope_from": 0.02, "slope_to": 0.03, "n": 40}
    names = ("slope", "stance_angle", *RATES)

    found = branch({"line": line, **window}, [atlas({"line": line}, [])])

    (at,) = np.flatnonzero(found["special_points/kind"] == "release_hyperextension")
    assert found["special_points/error_bound"][at] < 1e-12
    slope, *state = columns_of(found, "special_points", names)[:, at]
    assert abs(knee_acceleration(HYPEREXTENDING, slope, state)) < 1e-8
    # On one side of it, on the same branch, the knee first hyperextends.
    rows = columns_of(found, "branches", names)
    rows = rows[:, found["branches/branch"] == found["special_points/branch"][at]]
    near = rows[:, np.abs(rows[1] - state[0]) < 0.02].T
    signs = {
        (np.sign(knee_acceleration(HYPEREXTENDING, row[0], row[1:])), row[1] > state[0])
        for row in near
    }
    assert len(signs) == 2 and len({sign for sign, _ in signs}) == 2


@pytest.mark.parametrize(
    "name", ["C", pytest.param("physical", marks=pytest.mark.thorough)]
)
def test_a_plane_of_keys_has_the_gaits_of_its_lines(name):
    walker = {"base": name, "trailing_knee": "locked"}
    start = resolve(name).m_h
    hips = np.linspace(start, start + 1.5, 16)
    keys = {"m_h": hips[:, None]}
    variables = ["stance_angle", "period", "error_bound", "spectral_radius"]

    found = gaitsweep.gaits(walker, np.array([0.03, 0.05]), variables=variables, **keys)

    for i in (0, 7, 15):
        own = {"m_h": float(hips[i])}
        alone = gaitsweep.gaits(walker, [0.03, 0.05], variables=variables, **own)
        at = found.isel(dim_0=i)
        for variable in ("stance_angle", "period"):
            a, b = at[variable].values, alone[variable].values
            bound = at.error_bound.values + alone.error_bound.values
            assert (np.isnan(a) == np.isnan(b)).all()
            assert (np.abs(a - b) <= bound * np.abs(b))[~np.isnan(a)].all()


def test_a_search_without_gaits_names_the_rule_that_walks():
    answer = solve_one({"walker": "physical", "slope": 0.1})
    assert not answer["gaits"]
    (said,) = [line for line in answer["search"] if "trailing_knee" in line]
    assert said == 'The walker has gaits at this slope with `trailing_knee` = "locked"'
    assert gaits_of(PHYSICAL, 0.1)
    # Nothing is said where neither rule walks.
    answer = solve_one({"walker": "physical", "slope": 0.005})
    assert not answer["gaits"]
    assert not [line for line in answer["search"] if "trailing_knee" in line]


@pytest.mark.parametrize(
    ("walker", "words"),
    [
        (
            {"base": "A", "trailing_knee": "locked"},
            "`trailing_knee` is of walkers with knees (`knees` = true): straight legs "
            "have no knee to lock; got 'locked'.",
        ),
        (
            {"base": "C", "trailing_knee": "stiff"},
            '`trailing_knee` must be "free" or "locked"; got \'stiff\'.',
        ),
        (
            {"base": "C", "trailing_knee": True},
            '`trailing_knee` must be "free" or "locked"; got True.',
        ),
        (
            {"base": "C", "trailing_knee": ["free"]},
            '`trailing_knee` must be "free" or "locked"; got [\'free\'].',
        ),
        (
            {**C, "knees": False},
            "`trailing_knee` is of walkers with knees (`knees` = true): straight legs "
            "have no knee to lock; got 'locked'.",
        ),
        (
            {**C, "toward": "physical", "detuning": 0.1},
            '`toward` must have `trailing_knee` = "locked", as the walker has; '
            "got physical.",
        ),
    ],
)
def test_a_rule_that_cannot_be_is_told_in_one_line(walker, words):
    with pytest.raises(WalkerError) as told:
        resolve(walker)
    assert str(told.value) == words


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (
            lambda: gaitsweep.gaits("C", 0.02, trailing_knee=["free", "locked"]),
            "`trailing_knee` stands in the table of the walker, beside its `base` or "
            "its keys.",
        ),
        (
            lambda: gaitsweep.solve("C", 0.02, trailing_knee=1.0),
            '`trailing_knee` must be "free" or "locked"; got \'1.0\'.',
        ),
    ],
)
def test_a_rule_is_no_axis(call, words):
    with pytest.raises(StudyError) as told:
        call()
    assert str(told.value) == words


def test_the_rule_may_be_set_beside_other_keys():
    there = gaitsweep.solve("C", 0.02, trailing_knee="locked", m_h=7.0)
    table = gaitsweep.solve({**C, "m_h": 7.0}, 0.02)
    assert there.equals(table)
    assert gaitsweep.solve("C", 0.02, trailing_knee="free").equals(
        gaitsweep.solve("C", 0.02)
    )


def test_a_table_names_the_rule_only_where_it_is_not_the_papers():
    assert "trailing_knee" not in resolve("C").table()
    assert resolve(C).table()["trailing_knee"] == "locked"
    assert resolve(resolve(C).table()) == resolve(C)


@pytest.mark.parametrize("walker", [resolve(C), ODD], ids="CO")
def test_guesses_begin_with_the_impact_to_first_order(walker):
    angle, rates = 1e-5, np.array([-1.1, 0.4])
    y = angle * np.array([[1.0], *rates[:, None]])

    after = Problem(walker).start(y, np.array([0.02]))[1:, 0] / angle

    first_order = SmallAngles(walker).heelstrike @ rates
    np.testing.assert_allclose(after, first_order, rtol=1e-5)


def motion_of_knee(flexion, samples=16):
    """Samples of three links whose knee bends by a polynomial of time, from 0 to 1."""
    time = np.linspace(0, 1, samples + 1)
    three = np.zeros((samples + 1, 6, 1))
    three[:, 1, 0], three[:, 4, 0] = flexion(time), flexion.deriv()(time)
    return three


@pytest.mark.parametrize("first", [0.3, -0.3, 1e-6, -1e-6])
def test_the_acceleration_says_where_a_knee_at_rest_goes(first):
    three = motion_of_knee(np.polynomial.Polynomial([0, 0, first, 0.4, -0.7, 0.2]))
    against = hyperextends_at_release(three, np.array([1 / 16]))
    assert against[0] == (first < 0)


def test_a_knee_that_never_bent_has_not_struck():
    """Near the double root of its guard at the start Newton's method may end."""
    interval = np.array([1 / 16])
    sinks = motion_of_knee(np.polynomial.Polynomial([0, 0, -1.0, 0.0]))
    bends = motion_of_knee(np.polynomial.Polynomial([0, 0, 1.0, -1.0]))
    for three, is_step in ((sinks, False), (bends, True)):
        three[:, 0] = 0.5 - 1e-3 * np.arange(17)[:, None]
        two = np.zeros((17, 4, 1))
        two[:, 0, 0], two[:, 1, 0] = np.linspace(0.3, -0.3, 17), 0.3
        two[:, 2] = -0.6
        closing = np.array([[-1.0], [-0.6]])
        times = np.array([16.0 * interval, 32.0 * interval])
        check = verify([three, two], closing, times)
        assert check.step[0] == is_step


STUDY = """
name = "rule"
walker = {walker}
axes.slope = [0.02, 0.03]
want = {{ variables = [{variables}] }}
"""


@pytest.mark.parametrize(
    ("walker", "variables", "has_impulse"),
    [
        ('"C"', '"violations"', False),
        ('"C"', '"violations", "unlocking_impulse_trailing"', True),
        ('{ base = "C", trailing_knee = "locked" }', '"violations"', True),
        ('["A", "kneed-point-foot-locked.toml"]', '"violations"', True),
    ],
)
def test_a_study_of_free_knees_keeps_its_variables(
    walker, variables, has_impulse, tmp_path
):
    text = STUDY.format(walker=walker, variables=variables)
    found = parse(tomllib.loads(text), text, tmp_path / "rule.toml")
    assert ("unlocking_impulse_trailing" in found.variables) == has_impulse


def test_a_study_refuses_the_rule_as_an_axis(tmp_path):
    text = STUDY.format(walker='"C"', variables='"energy"')
    text += 'axes.trailing_knee = ["free", "locked"]\n'
    with pytest.raises(StudyError) as told:
        parse(tomllib.loads(text), text, tmp_path / "rule.toml")
    words = "`trailing_knee` holds a text and is no axis: it stands in the table of a"
    assert words in str(told.value)


def test_the_command_line_sets_the_rule(capsys):
    main(["solve", "--walker", "C", "--slope", "0.02", "--set", "trailing_knee=locked"])
    assert "stance_angle      0.27245 rad" in capsys.readouterr().out
