"""Walks, what captures them, and the periods of those that nothing captures: by maps of
known dynamics and by gaits.
"""

from types import SimpleNamespace

import numpy as np
import pytest

from gaitsweep.tasks.branches.atlas import from_arrays
from gaitsweep.tasks.orbits import attractors as capturing
from gaitsweep.tasks.orbits import walk as walks
from gaitsweep.tasks.orbits.attractors import Neighbourhoods, attractors
from gaitsweep.tasks.orbits.crisis import surviving_slopes
from gaitsweep.tasks.orbits.initial_states import gaits_at
from gaitsweep.tasks.orbits.walk import Walk
from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.step.simulate import FORWARD, STRUCK, stride
from gaitsweep.tasks.walkers.resolve import resolve
from lines import _atlas, some

ANY = SimpleNamespace(some=lambda lanes: ANY, phases=1)


def stepping(monkeypatch, image, module=walks):
    """Let a map of states (m, n) be what steps do; NaN is a fall."""

    def step(problem, y, slope, exact=True):
        after = image(y, slope)
        fell = np.isnan(after).any(axis=0)
        outcome = np.where(fell, FORWARD, STRUCK)
        return SimpleNamespace(
            image=after,
            outcome=outcome,
            times=np.sum(y, axis=0)[None],
            jacobian=y[None],
            closing=y[None],
        )

    monkeypatch.setattr(module, "stride", step)


def test_walkers_keep_their_numbers(monkeypatch):
    """Each counts down to its fall; the third is left behind after two steps."""
    stepping(monkeypatch, lambda y, slope: np.where(y > 1, y - 1, np.nan))
    walk = Walk(ANY, np.array([[3.0, 1.0, 9.0, 4.0]]), np.zeros(4))
    seen = []
    for taken in walk.steps(9):
        seen.append(walk.lanes.tolist())
        assert (walk.before == walk.y[:, walk.lanes] + 1).all() and walk.jacobian.shape[
            -1
        ] == len(walk.lanes)
        if taken == 2:
            walk.lanes = walk.lanes[walk.lanes != 2]
    assert seen == [[0, 2, 3], [0, 2, 3], [3], []]
    assert walk.taken.tolist() == [2, 0, 2, 3] and walk.outcome.tolist() == [
        FORWARD,
        FORWARD,
        STRUCK,
        FORWARD,
    ]
    assert (
        walk.y[0, 2] == 7
        and np.isnan(walk.y[0, [0, 1, 3]]).all()
        and walk.times[0].tolist() == [1, 1, 8, 1]
    )
    assert list(walk.steps(9)) == []


def found(walk, steps):
    return attractors(walk, {}, steps).tolist()


def test_periods_of_the_logistic_map(monkeypatch):
    """Growth rates with attractors of period 1, 2, 4 and 3, and chaos."""
    stepping(monkeypatch, lambda x, r: r * x * (1 - x))
    rates = np.array([2.9, 3.2, 3.5, 3.83, 3.9])
    expected = ["period 1", "period 2", "period 4", "period 3", "walks on"]
    for steps in (300, 2000):
        assert found(Walk(ANY, np.full((1, 5), 0.3), rates), steps) == expected


@pytest.mark.parametrize("steps", [7, 100, 101, 2000])
def test_beside_a_flip_an_orbit_has_not_twice_its_period(monkeypatch, steps):
    """It alternates around its fixed point: after two steps it was at rest before it
    was after one.
    """
    stepping(monkeypatch, lambda y, factor: 1 + factor * (y - 1))
    walk = Walk(ANY, np.array([[1 + 1e-6, 1 + 1e-6]]), np.array([-0.97, 0.97]))
    assert found(walk, steps) == ["period 1", "period 1"]


def test_the_period_of_an_orbit_that_still_changes_is_told_after_the_steps(monkeypatch):
    """One that changes by more than 1e-5 in a period has none, and one that returns but
    once neither.
    """
    stepping(monkeypatch, lambda y, growth: np.roll(y, 1, axis=0) * growth)
    start = np.array([[1.0, 1.0], [2.0, 2.0], [3.0, 3.0]])
    walk = Walk(ANY, start, np.array([1 + 3e-7, 1 + 3e-6]))
    assert found(walk, 40) == ["period 3", "walks on"]
    assert walk.taken.tolist() == [46, 104]
    image = lambda y, slope: np.where(y == 5, 1.0, y + 1)  # noqa: E731
    stepping(monkeypatch, lambda y, slope: np.where(y > 40, 7.7 * y, image(y, slope)))
    assert found(Walk(ANY, np.array([[1.0, 1.5]]), np.zeros(2)), 100) == [
        "period 5",
        "walks on",
    ]


def test_the_longest_period_is_told_and_none_beyond(monkeypatch):
    stepping(monkeypatch, lambda y, period: np.where(y + 1 > period, 1.0, y + 1))
    periods = np.array([1.0, 31, 32, 33, 64])
    for steps in (1, 32, 65):
        expected = ["period 1", "period 31", "period 32", "walks on", "walks on"]
        assert found(Walk(ANY, np.ones((1, 5)), periods), steps) == expected


@pytest.fixture(
    scope="module",
    params=[("D", 0.0126), ("D", 0.015), ("A", 0.05), ("C", 0.02), ("C", 0.07)],
)
def captured(request):
    walker, slope = request.param
    problem = Problem(resolve(walker))
    _, y = gaits_at(problem, from_arrays(_atlas(walker, ())), np.array([slope]), "long")
    return problem, y, slope, Neighbourhoods(problem, y, np.array([slope]))


def test_steps_contract_a_neighbourhood(captured):
    """Of states drawn all over it every step leads deeper into it."""
    problem, y, slope, home = captured
    assert 1e-6 < home.radius[0] <= 1e-4
    dice, lanes = np.random.default_rng(0), np.zeros(500, int)
    off = dice.normal(size=(problem.m, 500))
    off *= 0.999 * home.radius / home._size(off, lanes)
    start = y + off
    assert home.hold(start, lanes).all() and not home.hold(y + 1.01 * off, lanes).any()
    walk = Walk(problem, start, np.full(500, slope))
    size = home._size(off, lanes)
    for _ in walk.steps(8, exact=True):
        after = home._size(walk.y - y, lanes)
        assert (after < np.maximum(size, 1e-12)).all()
        size = after


def test_a_neighbourhood_is_half_as_far_as_the_measured_curvature_allows(monkeypatch):
    """Of a quadratic map, whose curvature is known: x -> 0.5 x + 300 x^2 along each of
    two coordinates.
    """
    centre = np.array([[0.6], [-0.8]])

    def image(y, slope):
        off = y - centre
        return centre + 0.5 * off + 300 * off**2

    stepping(monkeypatch, image, capturing)
    step = capturing.stride
    J = np.repeat(0.5 * np.eye(2)[:, :, None], 9, axis=2)

    def with_jacobian(problem, y, slope, exact=True):
        at = step(problem, y, slope)
        at.jacobian = J[:, :, : y.shape[1]]
        return at

    monkeypatch.setattr(capturing, "stride", with_jacobian)
    home = Neighbourhoods(ANY, centre, np.zeros(1))
    assert home.radius[0] == pytest.approx(min(1e-4, 0.5 * 0.5 / (8 * 300)), rel=1e-6)
    monkeypatch.setattr(capturing, "_NEAR", 1.0)
    assert Neighbourhoods(ANY, centre, np.zeros(1)).radius[0] == pytest.approx(
        0.5 * 0.5 / (8 * 300), rel=1e-6
    )
    J[:] = 1.001 * np.eye(2)[:, :, None]
    unstable = Neighbourhoods(ANY, centre, np.zeros(1))
    assert unstable.radius[0] == 0 and not unstable.hold(centre, np.array([0])).any()


def test_the_curvature_along_both_vectors_of_a_pair_counts(monkeypatch):
    """Of a map that turns, and is curved along one coordinate only; which of them the
    real part lies along is open.
    """
    centre, turn = np.array([[0.6], [-0.8]]), 0.5 * np.array([[0.0, -1.0], [1.0, 0.0]])
    monkeypatch.setattr(capturing, "_NEAR", 1.0)
    for along in (0, 1):

        def step(problem, y, slope, exact=True, along=along):
            off = y - centre
            after = centre + turn @ off + 300 * off[along] ** 2
            jacobian = np.repeat(turn[:, :, None], y.shape[1], axis=2)
            return SimpleNamespace(
                image=after,
                outcome=np.zeros(y.shape[1], int),
                jacobian=jacobian,
                closing=jacobian,
            )

        monkeypatch.setattr(capturing, "stride", step)
        assert Neighbourhoods(ANY, centre, np.zeros(1)).radius[0] < 1e-3


def test_what_settles_beside_a_gait_without_a_neighbourhood_has_its_name(captured):
    problem, y, slope, home = captured
    tiny = home.some(np.zeros(2, int))
    tiny.radius = np.full(2, 1e-12)
    start = np.hstack([y * (1 + 1e-4), y * (1 + 2e-4)])
    for homes, name in (
        ({"long": tiny}, "long"),
        ({}, "period 1"),
        ({"long": home.some(np.zeros(2, int))}, "long"),
    ):
        walk = Walk(problem, start, np.full(2, slope))
        assert attractors(walk, homes, 3000).tolist() == [name, name]


def test_falls_have_their_causes_and_the_steps_before_them(captured):
    problem, y, slope, home = captured
    start = np.hstack([y, y * 0.5, y * 2.0])
    walk = Walk(problem, start, np.full(3, slope))
    names = attractors(walk, {"long": home.some(np.zeros(3, int))}, 50)
    assert names[0] == "long" and walk.taken[0] == 1
    for lane in some(np.flatnonzero(walk.outcome != STRUCK)):
        state = start[:, [lane]]
        for _ in range(walk.taken[lane]):
            state = stride(problem, state, np.array([slope]), exact=False).image
        last = stride(problem, state, np.array([slope]), exact=False)
        assert last.outcome[0] == walk.outcome[lane] != STRUCK
        assert names[lane] in (
            "fell forward",
            "fell backward",
            "foot never struck",
            "knee never struck",
        )


@pytest.mark.parametrize("size", [1.0, 1e-9])
def test_orbits_of_any_size_survive_unless_they_settle(monkeypatch, size):
    """At small slopes all of them counted as settled, for their steps changed by less
    than a number of the walker's.
    """
    rates = np.array([2.9, 3.2, 3.9])
    stepping(monkeypatch, lambda x, r: r * x * (1 - x / size))
    trial = np.array([[0.3, 0.31]]) * size, rates
    (survives,) = surviving_slopes(ANY, [trial], 200)
    assert survives.tolist() == [False, True, True]
