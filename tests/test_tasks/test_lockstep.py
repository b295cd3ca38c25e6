"""Procedures side by side: batches, procedures within procedures, and points of branches
that are evaluated once.
"""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from gaitsweep.tasks.branches import atlas
from gaitsweep.tasks.branches import segment as segments
from gaitsweep.tasks.branches.atlas import survey
from gaitsweep.tasks.branches.lockstep import Call, run, side_by_side
from gaitsweep.tasks.branches.refine import COARSE
from gaitsweep.tasks.branches.segment import locate_root
from gaitsweep.tasks.branches.tracking import (
    _ENOUGH,
    correct,
    follow,
    refine_and_check,
)
from gaitsweep.tasks.gaits import newton, rounding
from gaitsweep.tasks.gaits.newton import curvature
from gaitsweep.tasks.gaits.rounding import rounding_std
from gaitsweep.tasks.studies.locate_cascade import Orbits
from lines import branches

ALONE = SimpleNamespace(some=lambda lanes: lanes)


class Doubling:
    """A function of lanes that knows how many each of its calls had."""

    def __init__(self):
        self.batches = []

    def __call__(self, lanes, x):
        self.batches.append(len(lanes))
        return 2 * x


def doubled(double, value, times):
    for _ in range(times):
        value = (yield Call(double, (np.array([value]),)))[0]
    return value


def test_a_procedure_goes_on_with_what_others_return_which_run_side_by_side():
    double = Doubling()

    def parent(begin):
        inner = yield [doubled(double, begin + k, k) for k in range(4)]
        none = yield []
        more = yield [parent_of_one(sum(inner))]
        return inner, none, more

    def parent_of_one(value):
        (only,) = yield [doubled(double, value, 1)]
        return only

    found = side_by_side(ALONE, [0, 0], [parent(0), parent(10)])

    # 0, 1, 2, 3 are doubled so many times; their sum once more, by others within.
    assert found[0] == ([0, 2, 8, 24], [], [68])
    assert found[1] == ([10, 22, 48, 104], [], [368])
    assert double.batches == [6, 4, 2, 2]


def test_procedures_within_others_have_their_lines():
    def line_of(lanes, x):
        return lanes

    def parent():
        return (yield [child(), child()])

    def child():
        return (yield Call(line_of, (np.zeros(1),)))[0]

    assert side_by_side(ALONE, [5, 7], [parent(), parent()]) == [[5, 5], [7, 7]]


def test_a_root_is_located_without_a_point_evaluated_twice(monkeypatch):
    problem, (branch, *_) = branches("B")
    k = len(branch.q) // 2
    a, b = branch.q[[k, k + 1]]
    q = 0.3 * a + 0.7 * b
    places = []
    correct_at = segments.correct_at

    def off(point):
        return point.Z[-1, 0] - q

    def noted(branch, segment, x, *known):
        places.append(x)
        return correct_at(branch, segment, x, *known)

    monkeypatch.setattr(segments, "correct_at", noted)
    known = {}
    point = run(problem, locate_root(branch, k, off, known))
    assert point.Z[-1, 0] == pytest.approx(q, abs=1e-14)
    assert len(places) > 2
    assert len(set(places)) == len(places)
    assert set(places) == set(known)

    # Of points that are known none is evaluated again.
    before = len(places)
    again = run(problem, locate_root(branch, k, off, known))
    assert len(places) == before
    np.testing.assert_array_equal(again.Z, point.Z)


@pytest.mark.parametrize("side", [0, 1])
def test_a_root_between_values_of_one_sign_is_the_end_nearer_zero(side):
    problem, (branch, *_) = branches("B")
    k = len(branch.q) // 2
    ends = np.sort(branch.q[[k, k + 1]])
    beyond = ends[side] + (-1e-9, 1e-9)[side]

    def off(point):
        return point.Z[-1, 0] - beyond

    point = run(problem, locate_root(branch, k, off))
    assert point.Z[-1, 0] == pytest.approx(ends[side], abs=1e-12)


def test_points_of_a_segment_are_guessed_as_far_off_as_the_nearest_that_is_known():
    """A polynomial that is off by a thousandth costs Newton's method a step, once."""
    problem, (branch, *_) = branches("B")
    k = len(branch.q) // 2
    off = replace(branch)
    off.coefficients[0] += 1e-3
    x = off.ends_of(np.array(k)).mean()
    on_branch = branch.evaluate(np.array([k]), x)

    def guess(known):
        procedure = segments.correct_at(off, k, x, known)
        (Z, _) = next(procedure).arrays
        procedure.close()
        return Z

    point = run(problem, segments.correct_at(branch, k, x))
    alone = np.abs(guess({}) - on_branch)
    beside = np.abs(guess({x: point}) - on_branch)
    assert alone.max() > 5e-4
    assert beside.max() < 1e-6


def test_nodes_of_others_take_their_places():
    _, (branch, *_) = branches("B")
    places = np.array([3.5, 3.75, 8.5])
    more = branch.at(places)
    one = branch.insert(np.array([4, 4]), more[:, :2], more[:, :2])
    other = branch.insert(9, more[:, 2], more[:, 2])

    both = branch.with_nodes_of([(3, one), (8, other)])
    nodes = np.arange(len(branch.q))
    order = np.argsort(np.append(nodes, places))
    every = np.hstack([branch.Z, more])
    np.testing.assert_array_equal(both.Z, every[:, order])
    assert both.why == branch.why
    assert branch.with_nodes_of([]) is branch


@pytest.fixture(scope="module")
def track():
    """A problem, and a track of its gaits."""
    problem, (branch, *_) = branches("A")
    middle = branch.Z[:, [len(branch.q) // 2]]
    ((_, up),) = follow(problem, middle)
    return problem, up


def test_points_of_tracks_are_as_good_as_corrected_after_one_step_more(track):
    problem, up = track
    point, check = refine_and_check(problem, up.Z, up.tangent)
    exact = correct(problem, up.Z, up.tangent)
    ok = exact.ok & check.step
    assert ok.sum() > 10

    apart = np.abs(point.Z - exact.Z)[:, ok]
    assert apart.max() < 1e-12

    direction = exact.oriented(up.tangent).direction
    turned = np.abs(point.direction - direction)[:, ok]
    assert turned.max() < 1e-8


def test_points_that_one_step_moves_farther_than_tracks_are_off_stay(track):
    problem, up = track
    far = up.Z[:, 2:6].copy()
    far[0] += 10 * _ENOUGH
    border = np.zeros(far.shape)
    border[-1] = 1.0
    kept, _ = refine_and_check(problem, far, border)
    np.testing.assert_array_equal(kept.Z, far)
    np.testing.assert_array_equal(kept.direction, border)


def test_cycles_of_several_periods_are_found_among_the_same_orbits():
    problem, found = branches("D")
    slopes = np.array([0.0177, 0.0189])
    orbits = Orbits(problem, found, slopes, 4, 100)
    for n in (2, 3, 4):
        alone = Orbits(problem, found, slopes, n, 100).cycles(n)
        among = orbits.cycles(n)
        assert len(among) == len(alone) > 0
        for one, other in zip(among, alone, strict=True):
            np.testing.assert_array_equal(one.Z, other.Z)


@pytest.mark.parametrize("steps", [1, 2])
def test_states_are_measured_alike_together_and_one_by_one(monkeypatch, steps):
    problem, found = branches("C")
    Z = found[0].Z[:, 5:40:7]
    w, q = Z[:-1], Z[-1]
    if steps > 1:
        m = problem.m
        rates = w[1:m]
        times = w[m:]
        one = np.ones((1, w.shape[1]))
        later = times + times[-1]
        w = np.vstack([w[:1], rates, one, rates, times, later])

    several = problem.of_steps(steps)

    def measured():
        std = rounding_std(several, w, q, near=3)
        return [*curvature(several, w, q), std]

    together = measured()
    for module in (newton, rounding):
        monkeypatch.setattr(module, "_MOST_STEPS", 1)
    one_by_one = measured()
    for value, other in zip(together, one_by_one, strict=True):
        np.testing.assert_array_equal(value, other)
        assert np.isfinite(value).any()


def test_a_survey_of_either_tolerance_has_accurate_nodes():
    problem, found = branches("C")
    assert found
    for branch in [*found, *survey(problem, COARSE)]:
        at = correct(problem, branch.Z, branch.direction)
        off = np.abs(at.Z - branch.Z).max(axis=0)
        inner = np.flatnonzero(at.ok)[1:-1]
        assert off[inner].max() < 1e-11


def test_orbits_have_no_cycles_longer_than_they_are():
    problem, found = branches("D")
    orbits = Orbits(problem, found, np.array([0.0177]), 2, 20)
    with pytest.raises(AssertionError, match="no orbit is as long"):
        orbits.cycles(3)


@pytest.mark.parametrize("side", [0, 1])
def test_an_end_narrowed_where_a_limit_is_passed_leaves_nodes_in_their_order(
    monkeypatch, side
):
    """Of a run of one node, the outermost: beyond it the limit, before it a cut."""
    _, (branch, *_) = branches("B")
    n = len(branch.q)
    run = (n - 1, n - 1) if side else (0, 0)
    places = np.array([n - 1.6, n - 1.3]) if side else np.array([0.3, 0.6])
    more = branch.at(places)
    segment = n - 2 if side else 0
    narrowed = branch.insert(np.full(2, segment + 1), more, more)
    good = n + 1 if side else 0
    asked = []

    def cut(raw, *nodes):
        return narrowed, good, "cut"
        yield

    def limit(raw, at):
        asked.append((len(raw.q), at))
        return "limit"
        yield

    monkeypatch.setattr(atlas, "_cut_end", cut)
    monkeypatch.setattr(atlas, "_passed_limit", limit)

    whole, first, last, ends = run_alone(atlas._located_ends(branch, *run))

    # The limit is sought on what the cut has narrowed.
    assert asked == [(n + 2, side)]
    assert len(whole.q) == n + 2
    assert ends == {side: "limit", 1 - side: "cut"}
    assert (first, last) == ((n + 1, n) if side else (1, 0))


def run_alone(procedure):
    """What a procedure returns that asks for no calls."""
    return run(ALONE, procedure)
