"""Orbits and their exponents: known maps, known slopes, and the same bits in any
company.
"""

from types import SimpleNamespace

import numpy as np
import pytest

from gaitsweep.tasks.branches.atlas import from_arrays
from gaitsweep.tasks.branches.special_points import special_points
from gaitsweep.tasks.mechanics.sums import matvec
from gaitsweep.tasks.orbits import initial_states
from gaitsweep.tasks.orbits import walk as walks
from gaitsweep.tasks.orbits.initial_states import gaits_at, r_sequence
from gaitsweep.tasks.orbits.lyapunov import Exponents, estimate, orthogonalised
from gaitsweep.tasks.orbits.walk import Walk
from gaitsweep.tasks.step import simulate
from gaitsweep.tasks.step.problem import Problem, scale_of
from gaitsweep.tasks.step.simulate import stride
from gaitsweep.tasks.studies import iterate_orbits as orbits
from gaitsweep.tasks.studies import map_basin as basins
from gaitsweep.tasks.studies.follow_branches import branch
from gaitsweep.tasks.studies.iterate_orbits import orbit
from gaitsweep.tasks.studies.map_basin import basin
from gaitsweep.tasks.studies.trace_motion import trace
from gaitsweep.tasks.walkers.resolve import resolve
from lines import _atlas, branches, gait
from oracle import Oracle, SimplestWalker

D = {"walker": "D", "set": {}}
SHORT = {"starts": 4, "transient": 120, "steps": 80, "shown": 40}


@pytest.mark.parametrize("task", [orbit, basin, branch])
def test_a_line_without_a_gait_to_begin_with_says_so(task):
    window = (
        {"slope_from": 0.005, "slope_to": 0.01}
        if task is branch
        else {"slope": np.array([0.005, 0.01]), **SHORT}
    )
    none, some = (
        task(
            {"line": {"walker": name, "set": {}}, "size": 2, **window},
            [_atlas(name, ())],
        )
        for name in ("physical-straight", "D")
    )
    what = "gait" if task is branch else "long gait"
    assert none["nothing/reason"].tolist() == [
        f"No {what} at slopes from 0.005 to 0.01."
    ]
    assert "nothing/reason" not in some


def walked(slopes, **options):
    return orbit(
        {"line": D, "slope": np.array(slopes), **SHORT, **options}, [_atlas("D", ())]
    )


def test_exponents_of_the_logistic_map():
    x = np.random.default_rng(1).uniform(0.1, 0.9, 400)
    growth = Exponents.begin(1, len(x), 5)
    for k in range(500):
        growth.step((4 - 8 * x)[None, None], np.arange(400), k // 100)
        x = 4 * x * (1 - x)
    (value,), (error,) = estimate(growth.means())
    assert error < 2e-3
    assert abs(value - np.log(2)) < 4 * error


def test_exponents_of_the_henon_map():
    """The first is 0.4192 (a = 1.4, b = 0.3); both together are ln b exactly."""
    a, b = 1.4, 0.3
    x, y = np.random.default_rng(2).uniform(-0.05, 0.05, (2, 100))
    growth = Exponents.begin(2, 100, 10)
    one, zero = np.ones(100), np.zeros(100)
    for k in range(-50, 1000):
        growth.step(
            np.array([[-2 * a * x, one], [b * one, zero]]),
            np.arange(100),
            k // 100 if k >= 0 else None,
        )
        x, y = 1 - a * x * x + y, b * x
    value, error = estimate(growth.means())
    assert abs(value[0] - 0.4192) < 4 * error[0] < 0.01
    assert value.sum() == pytest.approx(np.log(b), rel=1e-12)


def test_a_destroyed_direction_has_no_growth():
    Q, growth = orthogonalised(np.array([[1.0, 2.0], [2.0, 4.0]])[:, :, None])
    assert growth[1, 0] < 1e-15
    assert np.isfinite(Q).all()


def test_exponents_of_a_stable_gait_are_its_multipliers():
    found = walked([0.009])
    # A complex pair of modulus |-0.19009984 + 0.55759878 i|: both exponents are its
    # logarithm.
    expected = np.log(abs(-0.19009984106588809 + 0.55759877668206829j))
    assert found["lyapunov/exponent"].sum() / 2 == pytest.approx(expected, abs=1e-6)
    assert np.ptp(found["orbits/stance_angle"]) < 1e-12


def test_the_exponent_of_d_in_chaos():
    """0.369 at slope 0.0189; chaotic, and contracting areas."""
    found = walked([0.0189], starts=96, transient=80, steps=240)
    first, time_unit = found["lyapunov/exponent"]
    error = found["lyapunov/standard_error"][0]
    assert error < 0.004
    assert abs(first - 0.3691) < 4 * error
    assert first + time_unit < -1


@pytest.mark.parametrize(("walker", "slope"), [("D", 0.009), ("A", 0.05), ("C", 0.07)])
def test_a_settled_orbit_is_the_gait(walker, slope):
    """Its state is that just after heelstrike, kneed or not, and its errors are those
    of a gait.
    """
    line = {
        "line": {"walker": walker, "set": {}},
        "slope": np.array([slope]),
        **SHORT,
        "transient": 400,
    }
    found, known = orbit(line, [_atlas(walker, ())]), gait(walker, slope, "long")
    for name in ("stance_angle", "stance_rate", "thigh_rate", "shank_rate", "period"):
        assert found[f"orbits/{name}"] == pytest.approx(known[name], rel=1e-12), name
    assert found["orbits/repeats_to"].max() < 1e-12
    assert (
        found["orbits/error_bound"].min() > 0
        and found["orbits/error_bound"].max() < 1e-12
    )


@pytest.mark.parametrize(("walker", "slope"), [("D", 0.0189), ("C", 0.0945)])
def test_an_orbit_can_be_restarted_from_its_rows(walker, slope):
    """A chaotic one, by the second derivation: from the state of each row to that of
    the next, in the row's period.
    """
    line = {
        "line": {"walker": walker, "set": {}},
        "slope": np.array([slope]),
        **SHORT,
        "starts": 1,
        "shown": 4,
    }
    found = orbit(line, [_atlas(walker, ())])
    rows = np.array(
        [
            found[f"orbits/{k}"]
            for k in ("stance_angle", "stance_rate", "thigh_rate", "shank_rate")
        ]
    ).T
    assert np.ptp(rows[:, 0]) > 1e-3 and (found["orbits/repeats_to"] > 1e-3).all()
    oracle = SimplestWalker() if walker == "D" else Oracle(resolve(walker).table())
    for row, period, after in zip(rows, found["orbits/period"], rows[1:], strict=False):
        step = oracle.step(row[0], row[1:], slope)
        assert step.period == pytest.approx(period, rel=1e-9)
        assert [step.theta, *step.rates] == pytest.approx(after, rel=1e-8)


@pytest.mark.parametrize("strides", [10, 16, 23])
def test_a_short_orbit_has_no_exponents_and_says_why(strides):
    found = walked([0.009], steps=strides)
    assert (
        len(found["lyapunov/exponent"]) == 2
        and np.isnan(found["lyapunov/exponent"]).all()
    )
    assert (
        np.isnan(found["lyapunov/standard_error"]).all()
        and (found["lyapunov/strides"] == 0).all()
    )
    assert set(found["lyapunov/reason"]) == {
        f"Exponents need at least 24 steps; these orbits have {strides}."
    }


def test_the_shortest_orbit_with_exponents_has_them():
    found = walked([0.009], steps=24)
    assert found["lyapunov/exponent"].sum() / 2 == pytest.approx(
        np.log(0.5891), abs=0.01
    )
    assert (found["lyapunov/strides"] == 32).all() and set(
        found["lyapunov/reason"]
    ) == {""}
    assert found["falls/cause"].dtype.kind == "U" and len(found["falls/cause"]) == 0


def test_periods_double_and_walking_ends():
    found = walked([0.0145, 0.0165, 0.0179, 0.0195], transient=400)
    counts = [
        len(
            np.unique(
                np.round(found["orbits/stance_angle"][found["orbits/slope"] == s], 6)
            )
        )
        for s in (0.0145, 0.0165, 0.0179)
    ]
    assert counts == [1, 2, 4]
    assert set(found["falls/slope"]) == {0.0195}
    assert set(found["falls/cause"]) == {"fell forward"}
    assert (found["falls/steps"] > 0).all()
    assert found["survival/lifetime"][:3].tolist() == [np.inf] * 3


@pytest.mark.parametrize(("walker", "slope"), [("D", 0.009), ("A", 0.05), ("C", 0.07)])
def test_guards_that_are_off_are_closed_by_the_derivatives_of_the_step(walker, slope):
    """To first order: of times that are off by 1e-6 the square is left."""
    problem, found = branches(walker)
    slopes = np.array([slope])
    y = gaits_at(problem, found, slopes, "long")[1] * 1.001
    steps, scale = stride(problem, y, slopes), scale_of(y[0])
    off = 1e-6 * np.arange(1, problem.phases + 1)[:, None]

    beside = problem.map.without_derivatives(
        y / scale, steps.times + off, problem.parameters(slopes, scale)
    )

    m = problem.m
    guards = beside.residual[m:]
    image = (beside.image + matvec(steps.closing[:m], guards)) * scale
    left = off + matvec(steps.closing[m:], guards)
    assert np.abs(guards).min() > 1e-8
    assert np.abs(image - steps.image).max() < 1e-10
    assert np.abs(left).max() < 1e-10


def test_an_orbit_keeps_its_bits_in_any_company():
    """Chaos doubles an error every other stride: a slip of one bit would show."""
    together = walked([0.0150, 0.0188, 0.0189, 0.0193])
    alone = walked([0.0189])
    mine = together["orbits/slope"] == 0.0189
    for column in ("stance_angle", "stance_rate", "start", "stride"):
        assert np.array_equal(
            together[f"orbits/{column}"][mine], alone[f"orbits/{column}"]
        )
    mine = together["lyapunov/slope"] == 0.0189
    assert np.array_equal(
        together["lyapunov/exponent"][mine], alone["lyapunov/exponent"]
    )
    fewer = walked([0.0189], starts=2)
    assert np.array_equal(
        fewer["orbits/stance_angle"],
        alone["orbits/stance_angle"][alone["orbits/start"] < 2],
    )


@pytest.mark.parametrize("walker", ["D", "C"])
def test_lanes_and_their_blocks_change_no_bit(walker, monkeypatch):
    """Each lane is flown alone, in another order, and in blocks of another width."""
    slope = {"D": 0.0189, "C": 0.0945}[walker]
    problem = Problem(resolve(walker))
    _, gait = gaits_at(
        problem, from_arrays(_atlas(walker, ())), np.array([slope]), "long"
    )
    y = gait * (1 + 0.01 * (2 * r_sequence(problem.m, 9) - 1))
    order = np.random.default_rng(3).permutation(9)
    for exact in (True, False):
        straight = stride(problem, y, np.full(9, slope), exact)
        mixed = stride(problem, y[:, order], np.full(9, slope), exact)
        single = [
            stride(problem, y[:, k : k + 1], np.array([slope]), exact) for k in range(9)
        ]
        for name in ("image", "times", "outcome", *(["jacobian"] if exact else [])):
            whole = getattr(straight, name)
            assert np.array_equal(
                whole[..., order],
                getattr(mixed, name),
                equal_nan=whole.dtype.kind == "f",
            )
            alone = np.concatenate([getattr(s, name) for s in single], axis=-1)
            assert np.array_equal(whole, alone, equal_nan=whole.dtype.kind == "f")
    line = {
        "line": {"walker": walker, "set": {}},
        "slope": np.array([0.98, 1.0]) * slope,
        "starts": 5,
        "transient": 8,
        "steps": 24,
        "shown": 10,
    }
    wide = orbits.orbit(line, [_atlas(walker, ())])
    monkeypatch.setattr(simulate, "_SIDE_BY_SIDE", 3)
    narrow = orbits.orbit(line, [_atlas(walker, ())])
    assert wide.keys() == narrow.keys()
    for name, column in wide.items():
        assert np.array_equal(
            column, narrow[name], equal_nan=column.dtype.kind == "f"
        ), name


@pytest.mark.parametrize("transient", [97, 98, 99, 100])
def test_steps_of_an_orbit_that_repeats_are_left_out_and_change_no_bit(
    monkeypatch, transient
):
    """Orbits that settle on three points and on one, a chaotic one, and one that falls
    after four steps.
    """
    taken = []

    def step(problem, y, slope, exact=True):
        taken.append(y.shape[1])
        kind, x = y
        image = np.where(
            kind == 0,
            4 * x * (1 - x),
            np.where(x > 3, x - 1, np.where(kind == 3, x % 3 + 1, x)),
        )
        fell = np.where((kind < 0) & (x == 16), 1, 0)
        return SimpleNamespace(
            image=np.array([kind, image]),
            outcome=fell,
            times=0 * y[:1],
            jacobian=0 * y[None],
            closing=0 * y[None],
        )

    monkeypatch.setattr(walks, "stride", step)
    start = np.array([[3, 1, 0, -1], [20, 20, 0.3, 20]])
    walk = Walk(SimpleNamespace(some=lambda lanes: None, phases=1), start, np.zeros(4))
    orbits._settle(walk, transient)
    assert sum(taken) < 1.9 * transient
    expected = start
    for _ in range(transient):
        expected = step(None, expected, None).image
    assert np.array_equal(walk.y[:, :3], expected[:, :3]) and walk.lanes.tolist() == [
        0,
        1,
        2,
    ]
    assert walk.taken.tolist() == [transient] * 3 + [4] and walk.outcome.tolist() == [
        0,
        0,
        0,
        1,
    ]


def test_blocks_of_a_basin_change_no_bit(monkeypatch):
    line = {
        "line": D,
        "slope": np.array([0.0126]),
        "size": 24,
        "strides": 60,
        "stance_angle": [0.18, 0.3],
        "stance_rate": [-0.3, -0.18],
    }
    wide = basins.basin(line, [_atlas("D", ())])
    monkeypatch.setattr(simulate, "_SIDE_BY_SIDE", 37)
    narrow = basins.basin(line, [_atlas("D", ())])
    assert len(set(wide["basin/outcome"])) > 3
    for name, column in wide.items():
        assert np.array_equal(
            column, narrow[name], equal_nan=column.dtype.kind == "f"
        ), name


def test_exponents_are_sorted():
    """Over few steps those of a pair of equal size came in any order."""
    means = np.repeat([[[-0.9, -0.9], [-0.5, -0.6]]], 20, axis=0)
    table = orbits._exponents(means, np.array([0.01, 0.01]), 40)
    assert table["lyapunov/exponent"] == pytest.approx([-0.55, -0.9])
    assert table["lyapunov/index"].tolist() == [0, 1]


def test_gaits_beside_a_fold_are_those_of_the_grid():
    """Three Newton steps and no look at what they gave left errors of 1e-9 there, and
    two those of drawn motions.
    """
    problem, found = branches("A", detuning=0.3)
    (fold,) = [
        p["slope"]
        for b in found
        for p in special_points(problem, b)
        if p["kind"] == "fold"
    ]
    slope = fold * (1 + 1e-11)
    angle = gait("A", slope, "long", detuning=0.3)["stance_angle"]
    _, y = gaits_at(problem, found, np.array([slope]), "long")
    assert y[0] == pytest.approx(angle, rel=1e-13)
    line, atlas = (
        {"walker": "A", "set": {"detuning": 0.3}},
        _atlas("A", (("detuning", 0.3),)),
    )
    drawn = trace(
        {"line": line, "slope": np.array([slope]), "gaits": ("long",)}, [atlas]
    )
    assert drawn["trace/theta_st"][0] == pytest.approx(angle, rel=1e-13)


def test_where_no_gait_is_found_orbits_and_basins_say_so(monkeypatch):
    settle = initial_states.settle_on_branches

    def lost(*arguments):
        at = settle(*arguments)
        at.converged[:] = False
        return at

    monkeypatch.setattr(initial_states, "settle_on_branches", lost)
    found = walked([0.009])
    assert found["falls/cause"].tolist() == ["no gait to start from"] and not len(
        found["orbits/slope"]
    )
    found = basins.basin(
        {"line": D, "slope": np.array([0.009]), "size": 4}, [_atlas("D", ())]
    )
    assert found["areas/outcome"].tolist() == ["no gait to start from"] and found[
        "areas/starts"
    ].tolist() == [0]
