"""Procedures side by side: batches, procedures within procedures, and points of branches
that are evaluated once.
"""

from types import SimpleNamespace

import numpy as np
import pytest

from gaitsweep.tasks.branches import segment as segments
from gaitsweep.tasks.branches.atlas import survey
from gaitsweep.tasks.branches.branch import Branch
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
from gaitsweep.tasks.studies.locate_cascade import Orbits, search_cycles
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
    q, places = 0.3 * branch.q[k] + 0.7 * branch.q[k + 1], []
    correct_at = segments.correct_at

    def noted(branch, segment, x, *known):
        places.append(x)
        return correct_at(branch, segment, x, *known)

    monkeypatch.setattr(segments, "correct_at", noted)
    known = {}
    point = run(problem, locate_root(branch, k, lambda at: at.Z[-1, 0] - q, known))
    assert point.Z[-1, 0] == pytest.approx(q, abs=1e-14)
    assert len(places) == len(set(places)) == len(known) > 2

    # Of points that are known none is evaluated again.
    before = len(places)
    again = run(problem, locate_root(branch, k, lambda at: at.Z[-1, 0] - q, known))
    assert len(places) == before
    np.testing.assert_array_equal(again.Z, point.Z)


def test_a_root_between_values_of_one_sign_is_the_end_nearer_zero():
    problem, (branch, *_) = branches("B")
    k = len(branch.q) // 2
    a, b = np.sort(branch.q[[k, k + 1]])
    for beyond, nearest in ((b + 1e-9, b), (a - 1e-9, a)):
        point = run(
            problem, locate_root(branch, k, lambda at, q=beyond: at.Z[-1, 0] - q)
        )
        assert point.Z[-1, 0] == pytest.approx(nearest, abs=1e-12)


def test_points_of_a_segment_are_guessed_as_far_off_as_the_nearest_that_is_known():
    """A polynomial that is off by a thousandth costs Newton's method a step, once."""
    problem, (branch, *_) = branches("B")
    k = len(branch.q) // 2
    off = Branch(
        branch.m, branch.Z.copy(), branch.tangent, branch.lipschitz, branch.why
    )
    off.coefficients[0] += 1e-3
    x = off.ends_of(np.array(k)).mean()
    sizes = []
    for known in ({}, {x: run(problem, segments.correct_at(branch, k, x))}):
        moved = segments.correct_at(off, k, x, known)
        call = next(moved)
        sizes.append(np.abs(call.arrays[0] - branch.evaluate(np.array([k]), x)).max())
        moved.close()
    assert sizes[0] > 5e-4 and sizes[1] < 1e-6


def test_nodes_of_others_take_their_places():
    _, (branch, *_) = branches("B")
    halves = branch.at(np.array([3.5, 3.75, 8.5]))
    one = branch.insert(np.array([4, 4]), halves[:, :2], halves[:, :2])
    other = branch.insert(9, halves[:, 2], halves[:, 2])
    both = branch.with_nodes_of([(3, one), (8, other)])
    order = np.argsort(np.r_[: len(branch.q), 3.5, 3.75, 8.5])
    np.testing.assert_array_equal(both.Z, np.hstack([branch.Z, halves])[:, order])
    assert both.why == branch.why
    assert branch.with_nodes_of([]).Z.shape == branch.Z.shape


def test_points_of_tracks_are_as_good_as_corrected_after_one_step_more():
    problem, found = branches("A")
    start = found[0].Z[:, [len(found[0].q) // 2]]
    ((_, up),) = follow(problem, start)
    point, check = refine_and_check(problem, up.Z, up.tangent)
    exact = correct(problem, up.Z, up.tangent)
    ok = exact.ok & check.step
    assert ok.sum() > 10
    apart = np.abs(point.Z - exact.Z).max(axis=0)
    assert (apart <= 1e-12)[ok].all()
    assert apart[ok].max() < np.abs(up.Z - exact.Z)[:, ok].max()
    turned = np.abs(point.direction - exact.oriented(up.tangent).direction)
    assert (turned.max(axis=0) < 1e-8)[ok].all()

    # What one step would move farther than points of tracks are off stays.
    far = up.Z[:, 2:6].copy()
    far[0] += 10 * _ENOUGH
    kept, _ = refine_and_check(problem, far, np.eye(len(far))[:, [-1] * 4])
    np.testing.assert_array_equal(kept.Z, far)


def test_cycles_of_several_periods_are_found_among_the_same_orbits():
    problem, found = branches("D")
    slopes = np.array([0.0177, 0.0189])
    orbits = Orbits(problem, found, slopes, 4, 100)
    for n in (2, 3, 4):
        alone = search_cycles(problem, found, slopes, n, 100)
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
        rates, times = w[1 : problem.m], w[problem.m :]
        one = np.ones((1, w.shape[1]))
        w = np.vstack([w[:1], rates, one, rates, times, times + times[-1]])

    several = problem.of_steps(steps)
    together = [*curvature(several, w, q), rounding_std(several, w, q, near=3)]
    for module in (newton, rounding):
        monkeypatch.setattr(module, "_MOST_STEPS", 1)
    one_by_one = [*curvature(several, w, q), rounding_std(several, w, q, near=3)]
    for value, other in zip(together, one_by_one, strict=True):
        np.testing.assert_array_equal(value, other)
        assert np.isfinite(value).any()


def test_a_survey_of_either_tolerance_has_accurate_nodes():
    problem, found = branches("C")
    assert found
    for branch in [*found, *survey(problem, COARSE)]:
        at = correct(problem, branch.Z, branch.direction)
        off = np.abs(at.Z - branch.Z).max(axis=0)[1:-1]
        assert (off < 1e-11)[at.ok[1:-1]].all()
