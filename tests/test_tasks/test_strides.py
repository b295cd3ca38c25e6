"""Strides from any start: against the slow oracles, against the exact map, and lane by
lane.
"""

import numpy as np
import pytest

from gaitsweep.tasks.contract.registry import ALWAYS
from gaitsweep.tasks.contract.status import CONVERGED
from gaitsweep.tasks.mechanics.kernel import Flow, integrating_seconds
from gaitsweep.tasks.mechanics.lumped import structure_of
from gaitsweep.tasks.step import simulate
from gaitsweep.tasks.step.crossing import crossings
from gaitsweep.tasks.step.problem import Lanes, Problem
from gaitsweep.tasks.step.simulate import BACKWARD, CAUSES, FORWARD, STRUCK, stride
from gaitsweep.tasks.step.verify_step import (
    _cubics,
    _extrema,
    _Guard,
    _least_distance,
    _Samples,
    _unclear,
    _zero,
)
from gaitsweep.tasks.studies.solve_points import lines
from gaitsweep.tasks.walkers.resolve import resolve, resolve_many
from oracle import Oracle, SimplestWalker, StepFailed
from soak.stress import random_walker

LONG_D = np.array([[0.2003109005442470894], [-0.1998324730049523546]])


@pytest.fixture(scope="module")
def simplest():
    return Problem(resolve("D"))


@pytest.mark.parametrize("walker", ["D", "A", "C"])
def test_bits_do_not_depend_on_how_often_strikes_are_looked_for(monkeypatch, walker):
    """Walkers that strike, fall either way or are lost in the middle of a block of time
    steps.
    """
    problem = Problem(resolve(walker))
    dice = np.random.default_rng(5)
    y = np.vstack(
        [dice.uniform(0.02, 0.6, 99), *dice.uniform(-1.2, 0.4, (problem.m - 1, 99))]
    )
    slope = dice.uniform(1e-3, 0.2, 99)
    whole = stride(problem, y, slope, exact=False)
    assert len(set(whole.outcome.tolist())) > 2 and (whole.outcome == STRUCK).sum() > 5
    monkeypatch.setattr(simulate, "_MAX_BLOCK", 1)
    single = stride(problem, y, slope, exact=False)
    for name in ("image", "times", "outcome"):
        assert getattr(whole, name).tobytes() == getattr(single, name).tobytes()


@pytest.mark.parametrize("exact", [True, False])
def test_lanes_simulated_in_parts_have_the_same_bits(monkeypatch, exact):
    """Each with its own walker and slope."""
    own = resolve_many("A", {"m_h": np.linspace(0.1, 2.0, 10)})
    problem, dice = Lanes(own, structure_of(resolve("A"))), np.random.default_rng(4)
    y = np.array([[0.2], [-0.22], [0.02]]) * dice.uniform(0.7, 1.3, (3, 10))
    slope = np.linspace(0.01, 0.04, 10)
    whole = stride(problem, y, slope, exact)
    assert 2 < (whole.outcome == STRUCK).sum() < 10 and len(whole.jacobian) == 3 * exact
    monkeypatch.setattr(simulate, "_SIDE_BY_SIDE", 3)
    parts = stride(problem, y, slope, exact)
    for name in ("image", "times", "outcome", "jacobian"):
        assert getattr(whole, name).tobytes() == getattr(parts, name).tobytes()


def test_time_in_compiled_code_is_counted(simplest):
    """Of a simulation too, which integrates by functions of its own."""
    before = integrating_seconds()
    for _ in range(20):
        stride(simplest, np.tile(LONG_D, 999), np.full(999, 0.009), exact=False)
    assert integrating_seconds() > before


def test_a_motion_that_ends_a_last_digit_early_is_not_lost(monkeypatch):
    """As about every second motion of two steps does, of which the second is the
    longer.
    """
    problem = Problem(resolve("D"))
    w, slope = np.array([[-1.6], [-1.0], [3.8]]), np.array([-4.6])
    advance = Flow._advance

    def ended(by):
        def early(flow, duration, fractions):
            motion = advance(flow, duration, fractions)
            monkeypatch.setattr(flow, "_time", flow._ta.time + by(flow._ta.time))
            return motion

        monkeypatch.setattr(Flow, "_advance", early)
        return problem.stride(w, slope)[0].residual

    whole = ended(lambda t: 0.0 * t)
    assert np.isfinite(whole).all()
    np.testing.assert_array_equal(ended(lambda t: -np.spacing(t)), whole)
    np.testing.assert_array_equal(ended(np.spacing), whole)
    assert np.isnan(ended(lambda t: -1e-14 * t)).all()


def test_the_published_gait_comes_back_to_itself(simplest):
    found = stride(simplest, LONG_D, np.array([0.009]))
    assert np.abs(found.image - LONG_D).max() < 2e-15
    assert found.times[0, 0] == pytest.approx(3.882463752851374137569671, rel=1e-14)
    values = np.linalg.eigvals(found.jacobian[:, :, 0])
    assert values.real == pytest.approx(-0.19009984106588809, abs=2e-7)


def test_any_start_agrees_with_the_published_equations(simplest):
    oracle = SimplestWalker()
    angle, rate = 0.23, -0.225
    found = stride(simplest, np.array([[angle], [rate]]), np.array([0.012]))
    slow = oracle.step(angle, (rate, rate * np.cos(2 * angle)), 0.012)
    assert found.image[:, 0] == pytest.approx([slow.theta, slow.rates[0]], rel=1e-11)
    assert found.times[0, 0] == pytest.approx(slow.period, rel=1e-11)


def test_any_start_of_a_kneed_walker_agrees_with_the_rigid_bodies():
    walker = resolve("C")
    problem, oracle = Problem(walker), Oracle(walker.table())
    y, slope = np.array([[0.36], [-0.50], [0.05]]), np.array([0.05])
    found = stride(problem, y, slope)
    begin = problem.map.start(y, problem.parameters(slope, np.ones(1)))[:, 0]
    slow = oracle.step(begin[0], begin[3:6] / oracle.time_unit, slope[0], rtol=1e-12)
    assert found.outcome[0] == STRUCK
    assert found.image[:, 0] == pytest.approx(
        [slow.theta, *(slow.before_heelstrike[3:5] * oracle.time_unit)], rel=1e-9
    )
    assert found.times[:, 0] * oracle.time_unit == pytest.approx(
        [slow.kneestrike_time, slow.period], rel=1e-9
    )


def test_rough_strides_agree_with_exact_ones(simplest):
    y = LONG_D * np.array([[1.05], [1.05]])
    coarse, exact = (
        stride(simplest, y, np.array([0.009]), exact=e) for e in (False, True)
    )
    assert np.abs(coarse.image - exact.image).max() < 1e-7
    assert np.abs(coarse.times - exact.times).max() < 1e-6


def test_falls_have_their_causes(simplest):
    slow, fast = LONG_D * np.array([[1.0], [0.8]]), LONG_D * np.array([[1.0], [1.5]])
    found = stride(simplest, np.hstack([slow, fast]), np.full(2, 0.009))
    assert found.outcome.tolist() == [BACKWARD, FORWARD]
    assert np.isnan(found.image).all()
    for y in (slow, fast):
        with pytest.raises(StepFailed):
            SimplestWalker().step(
                y[0, 0], (y[1, 0], y[1, 0] * np.cos(2 * y[0, 0])), 0.009
            )
    # A leg that begins beyond the angle of a fall has fallen, however it moves.
    assert (
        stride(simplest, np.array([[1.7], [0.5]]), np.array([0.009])).outcome[0]
        == FORWARD
    )
    assert len(CAUSES) == len(set(CAUSES))


@pytest.mark.parametrize("name", ["D", "C"])
def test_a_lane_does_not_know_its_neighbours(name):
    """Bits of a stride are the same alone, in another place and beside falls."""
    problem = Problem(resolve(name))
    centre = {"D": [0.2, -0.2], "C": [0.36, -0.5, 0.01]}[name]
    rng = np.random.default_rng(3)
    n = 61
    y = np.array(centre)[:, None] * (1 + 0.2 * rng.uniform(-1, 1, (len(centre), n)))
    slope = rng.uniform(0.01, 0.05, n)
    for exact in (False, True):
        whole = stride(problem, y, slope, exact)
        assert 3 < (whole.outcome == STRUCK).sum() < n
        order = rng.permutation(n)
        moved = stride(problem, y[:, order], slope[order], exact)
        assert np.array_equal(moved.image, whole.image[:, order], equal_nan=True)
        for lane in np.nonzero(whole.outcome == STRUCK)[0][:4]:
            alone = stride(problem, y[:, [lane]], slope[[lane]], exact)
            assert np.array_equal(alone.image[:, 0], whole.image[:, lane])
            assert np.array_equal(alone.times[:, 0], whole.times[:, lane])
            if exact:
                assert np.array_equal(
                    alone.jacobian[:, :, 0], whole.jacobian[:, :, lane]
                )


def test_a_knee_that_bends_again_before_it_is_straight_has_not_struck():
    """The walker falls forward; on the way its knee's flexion has a minimum, far from
    zero, within one time step.
    """
    walker = resolve("C")
    problem, y, slope = (
        Problem(walker),
        np.array([[0.346], [-0.88], [-0.014]]),
        np.array([0.052]),
    )
    found = stride(problem, y, slope, exact=False)
    assert found.outcome[0] == FORWARD and np.isnan(found.times).all()
    begin = problem.map.start(y, problem.parameters(slope, np.ones(1)))[:, 0]
    slow = Oracle(walker.table())
    with pytest.raises(StepFailed):
        slow.step(begin[0], begin[3:6] / slow.time_unit, slope[0])


def test_a_knee_that_flexes_for_a_moment_only_strikes_then():
    """Released flexing, it is straight again before the first sample, and before the
    first time step ends.
    """
    walker = random_walker("kneed, any", 21)
    problem, slope, slow = Problem(walker), np.array([0.02]), Oracle(walker.table())
    rates = ("stance_rate", "thigh_rate", "shank_rate")
    asked = {
        "lines": [{"walker": walker.table()}],
        "slope": slope,
        "want": ("stance_angle", *rates, *ALWAYS),
    }
    ((_, out),) = lines(asked, [])
    for g in np.flatnonzero(out["status"][0] == CONVERGED):
        start = out["stance_angle"][0, g], np.array([out[rate][0, g] for rate in rates])
        assert slow.step(*start, slope[0]).theta == pytest.approx(start[0], rel=1e-6)
    y = np.array([[0.04861636178892312], [-0.6706907890227205], [-0.6935433814763815]])
    found = stride(problem, y, slope)
    begin = problem.map.start(y, problem.parameters(slope, np.ones(1)))[:, 0]
    expected = slow.step(begin[0], begin[3:6] / slow.time_unit, slope[0])
    assert found.times[0, 0] * slow.time_unit == pytest.approx(
        expected.kneestrike_time, rel=1e-9
    )
    assert found.image[0, 0] == pytest.approx(expected.theta, rel=1e-9)


def test_strikes_within_a_time_step():
    """The stance angle counts where the guard is zero; a knee that flexes at the start
    may strike in the same step.
    """

    def fractions(free, states):
        return crossings(free, states[:, :, None], 0.0625)[2]

    states = np.array([[0.02, -0.0199, -1.0, 0.9], [-0.0425, 0.0365, -1.0, 0.9]])
    assert not len(fractions(False, states))
    states[:, 0] -= 0.03
    states[:, 1] += 0.03
    assert 0 < fractions(False, states)[0] < 0.1
    knee = np.array(
        [[0.1, -0.1, -0.1, 0.0, 0.2, 0.0], [0.1, -0.1, -0.09, 0.0, -0.5, 0.0]]
    )
    assert 0.2 < fractions(True, knee)[0] < 0.6
    knee[0, 4] = -0.2  # behind its stop from the start
    assert not len(fractions(True, knee))


def test_the_first_strike_of_a_lane_counts():
    """Its guard falls through zero in the second time step and in the fourth; that of
    its neighbour in the third.
    """
    states = np.zeros((5, 4, 2))
    states[:, 0] = -0.5
    states[:, 1, 0] = 0.5, 0.4, 0.4, 0.6, 0.4
    states[:, 1, 1] = 0.9, 0.8, 0.6, 0.4, 0.2
    states[:2, 1, 0] = 0.7, 0.6
    states[:, 2] = -3.2
    step, lane, fraction = crossings(False, states, 0.0625)
    assert [*zip(step, lane, strict=True)] == [(1, 0), (2, 1), (3, 0)]
    np.testing.assert_allclose(fraction, 0.5, atol=0.1)

    problem = Problem(resolve("D"))
    scan = simulate.scanner(problem.structure)
    constants = problem.parameters(np.full(2, 0.01), np.full(2, 0.25))
    begin, time = np.zeros((2, 2))
    way = simulate._Way(
        scan, False, 0.0625, begin, constants, None, states[0].copy(), time
    )
    ended, cause = way.end(np.arange(2), states, 0)
    assert ended.tolist() == [0, 1]
    assert cause.tolist() == [STRUCK, STRUCK]
    assert (time // 0.0625).tolist() == [1, 2]


def test_blocks_end_where_all_are_about_to_strike():
    """The guard of one vanishes in 3.5 time steps, of the other in 9.5."""
    x = np.zeros((4, 2))
    x[1] = 0.35, 0.95
    x[3] = -1.6
    most = simulate._MAX_BLOCK
    assert simulate._block_of(False, x, 0.0625, 99) == 2 + 9
    assert simulate._block_of(False, x, 0.0625, 5) == 5
    x[3, 0] = 0.1
    assert simulate._block_of(False, x, 0.0625, 99) == most
    many = np.zeros((4, 99999))
    assert simulate._block_of(False, many, 0.0625, 99) == 1


def test_a_guard_that_may_touch_zero_between_samples_is_in_doubt():
    x = np.linspace(0, 1, 33)[:, None] + 1e-3
    early = np.maximum(
        0.15 - x, 0
    )  # its rate is negative at first, whatever it does later
    for sign in (1, -1):
        g = sign * (10 * early**2 - (x - 0.6) ** 2) - 1e-5 * sign
        rate = sign * (-20 * early - 2 * (x - 0.6))
        doubtful = np.flatnonzero(_unclear(g, rate, 1e-6)[:, 0])
        assert ((x[doubtful, 0] < 0.6) & (x[doubtful + 1, 0] > 0.6)).sum() == 1
        # Where it passes through zero the samples show it.
        g, rate = sign * (x - 0.3), sign * np.ones_like(x)
        assert not _unclear(g, rate, 1e-6).any()


def test_a_cubic_between_samples_vanishes_at_its_root():
    """Of (x - r) (1 + 0.2 x + 0.2 x^2): its chord vanishes up to 0.07 elsewhere."""
    root = np.array([0.1, 0.37, 0.8])
    x = np.array([[0.0], [1.0]])
    factor = 1 + 0.2 * x + 0.2 * x**2
    value = (x - root) * factor
    rate = factor + (x - root) * (0.2 + 0.4 * x)
    passes = np.ones((1, 3), bool)
    samples = _Samples(value, rate)

    np.testing.assert_allclose(_zero(_cubics(samples, passes)), root, rtol=1e-12)


def test_extrema_between_samples_are_those_of_the_cubic_between_them():
    cubic = np.polynomial.Polynomial([0.2, -1.1, 0.3, 1.0])
    rate, x = cubic.deriv(), np.linspace(-1.2, 1.2, 9)[:, None]
    h = x[1] - x[0]
    for sign in (1, -1):
        low, high = (
            values[:, 0] for values in _extrema(sign * cubic(x), sign * h * rate(x))
        )
        turns = np.sort(rate.roots())
        for value, at in zip((high, low)[::sign], turns, strict=True):
            inside = (x[:-1, 0] < at) & (at < x[1:, 0])
            np.testing.assert_allclose(value[inside], sign * cubic(at), rtol=1e-12)
        assert np.isposinf(low).sum() == np.isneginf(high).sum() == len(low) - 1


def test_a_maximum_counts_only_where_the_guard_does():
    """The guard reaches 0.5 before its values count; its minimum below -0.4 is then far
    from a strike.
    """
    g, rate = np.full((4, 1), -0.3), np.array([[5.2], [-0.4], [-0.5], [0.4]])
    low, high = _extrema(g, rate)
    assert high[0, 0] > 0.5 and low[2, 0] < -0.4
    nowhere = np.full((3, 1), -np.inf)
    for before, least in ((False, 0.3), (True, low[2, 0])):
        counts = np.array([[before], [before], [True], [True]])
        guard = _Guard(g, rate, counts, nowhere)
        assert _least_distance([guard])[0] == pytest.approx(least)
