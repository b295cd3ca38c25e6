"""Checks of whole branches: a sound one passes unchanged, a damaged one is mended, cut
or reported.
"""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from gaitsweep.tasks.branches import checks, tracking
from gaitsweep.tasks.branches.atlas import from_arrays
from gaitsweep.tasks.branches.branch import Branch
from gaitsweep.tasks.branches.checks import checked
from gaitsweep.tasks.branches.lockstep import run
from gaitsweep.tasks.branches.pseudo_arclength import Tracks
from gaitsweep.tasks.branches.refine import COARSE, measure
from gaitsweep.tasks.branches.sampling import within
from gaitsweep.tasks.branches.special_points import special_points
from gaitsweep.tasks.branches.tracking import correct
from gaitsweep.tasks.contract.status import outside, ranges
from gaitsweep.tasks.studies.solve_points import _reasons, atlas
from lines import branches


def plain(branch, nodes=None):
    nodes = np.arange(len(branch.q)) if nodes is None else nodes
    return Branch(
        branch.m,
        branch.Z[:, nodes],
        branch.tangent[:, nodes],
        np.zeros(len(nodes)),
        branch.why,
    )


@pytest.mark.parametrize("name", ["B", "C", "physical", "physical-straight"])
def test_a_sound_branch_passes_unchanged(name):
    problem, found = branches(name)
    for branch in found:
        assert run(problem, checked(branch, branch.Z[:, 0])) is branch


def test_a_part_of_a_branch_keeps_what_is_known_of_the_end_it_has():
    branch = replace(branches("C")[1][0], end_errors=(0.25, 0.5))
    n = len(branch.q)
    first, last = branch.part(np.arange(n - 1)), branch.part(np.arange(1, n))
    assert branch.part(np.arange(n)).end_errors == (0.25, 0.5)
    assert (first.end_errors, last.end_errors) == ((0.25, 0), (0, 0.5))
    assert (first.why, last.why) == (
        (branch.why[0], "no further point"),
        ("no further point", branch.why[1]),
    )


def test_both_segments_beside_a_fold_fail_where_the_slope_does_not_turn():
    problem, found = branches("physical")
    branch = plain(next(b for b in found if len(b.pieces()) > 1))
    fold = branch.pieces()[1][0]
    assert not run(problem, checks._failing(branch))[[fold - 1, fold]].any()
    tangent = branch.tangent.copy()
    tangent[:, fold + 1] *= np.sign(tangent[-1, fold + 1] * tangent[-1, fold - 1])
    failing = run(problem, checks._failing(replace(branch, tangent=tangent)))
    assert failing[[fold - 1, fold]].all() and not failing[fold + 1]


def test_a_branch_of_few_nodes_is_mended():
    problem, found = branches("B")
    branch = max(found, key=lambda b: len(b.q))
    few = plain(branch, np.linspace(0, len(branch.q) - 1, 5).astype(int))
    assert run(problem, checks._failing(few)).any()
    mended = run(problem, checked(few, few.Z[:, 0]))
    assert mended.why == branch.why and len(mended.q) > len(few.q)
    assert not run(problem, checks._failing(mended)).any()
    # What was inserted lies on the branch, whose nodes are apart by up to the root of
    # two.
    for Z in mended.Z.T:
        assert np.abs(branch.Z - Z[:, None]).max(axis=0).min() < 0.75


@pytest.mark.parametrize(
    "x",
    [[-0.3, -0.2, -0.1, 0.0, 4e-8, 0.1, 0.2], [-0.3, -0.2, -4e-8, 0.0, 0.1, 0.2, 0.3]],
)
@pytest.mark.parametrize("side", [-1, 1])
def test_a_node_beside_a_fold_is_not_the_fold(x, side):
    """Whose slope differs from the fold's by rounding."""
    x = np.array(x)
    Z, tangent = (
        np.array([x, x, side * x**2]),
        np.array([np.ones(7), np.ones(7), 2 * side * x]),
    )
    (fold,) = np.flatnonzero(x == 0)
    assert Branch(1, Z, tangent, np.zeros(7), ("", "")).pieces() == [
        (0, fold),
        (fold, 6),
    ]


def test_one_node_is_left_as_it_is():
    problem, found = branches("D")
    one = found[0].part(np.array([5]))
    assert run(problem, checked(one, one.Z[:, 0])) is one


def test_of_a_branch_that_is_cut_the_part_with_its_gait_remains_or_the_longest():
    _, found = branches("B")
    branch = found[0]
    n, cuts = len(branch.q), np.array([2])
    assert len(branch.part_of(branch.Z[:, 1], cuts).q) == 3
    assert len(branch.part_of(branch.Z[:, 2], cuts).q) == 3
    assert len(branch.part_of(branch.Z[:, 3], cuts).q) == n - 3
    # A short part of many nodes before a long one of two.
    apart = np.linalg.norm(np.diff(branch.Z), axis=0)
    last = next(k for k in range(3, n) if apart[2:k].sum() > 2 * apart[:2].sum())
    few = plain(branch, np.array([0, 1, 2, last, n - 1]))
    for cut, kept in (([2], [last, n - 1]), ([0, 1], [2, last, n - 1])):
        np.testing.assert_array_equal(
            few.part_of(branch.Z[:, 0] + 1e-12, np.array(cut)).Z, branch.Z[:, kept]
        )


def test_a_narrow_window_is_sampled_on_few_segments(monkeypatch):
    _, found = branches("E")
    branch, evaluated, evaluate = found[0], [], Branch.evaluate

    def counted(branch, segments, x):
        evaluated.append(len(segments))
        return evaluate(branch, segments, x)

    place, inner = within(branch, *np.log([0.011, 0.02]), 64)
    monkeypatch.setattr(Branch, "evaluate", counted)
    _, narrow = within(branch, *np.log([0.011, 0.01101]), 64)
    assert sum(evaluated) < 6 * 64 < 64 * (len(branch.q) - 1)
    every = branch.at(np.arange(0, len(branch.q) - 1, 1 / 64))
    inside = (every[-1] >= np.log(0.011)) & (every[-1] <= np.log(0.02))
    assert inner.shape[1] == len(place) == inside.sum() + 2
    assert narrow.shape[1] >= 2 and np.exp(narrow[-1, [0, -1]]) == pytest.approx(
        [0.011, 0.01101], rel=1e-12
    )


def test_a_polynomial_that_goes_astray_between_two_nodes_is_longer_than_its_chord():
    _, found = branches("B")
    branch = plain(found[0])
    assert not checks._too_long(branch).any()
    tangent = branch.tangent.copy()
    k = len(branch.q) // 2
    tangent[branch.m, k] += 40 * np.linalg.norm(tangent[:, k])
    assert checks._too_long(replace(branch, tangent=tangent))[k - 1 : k + 1].any()


def test_segments_are_split_side_by_side_by_nodes_between_their_own():
    problem, found = branches("D")
    branch, other = (plain(b) for b in found)
    n, k = len(branch.q), len(branch.q) // 3
    split = run(problem, checks._split(branch, np.arange(k, n - 1)))
    new = np.arange(k + 1, len(split.q), 2)
    assert len(split.q) == 2 * n - 1 - k
    np.testing.assert_array_equal(np.delete(split.Z, new, axis=1), branch.Z)
    assert (
        (split.direction[:, new] * (split.Z[:, new + 1] - split.Z[:, new - 1])).sum(
            axis=0
        )
        > 0
    ).all()
    point = correct(problem, split.Z[:, new], split.direction[:, new])
    np.testing.assert_allclose(point.Z, split.Z[:, new], atol=1e-12)
    # A tangent that bends the polynomial to the other gait, which is not taken for one
    # between the nodes.
    low, high = branch.q[k - 1 : k + 1]
    ((_, beside, _),) = other.guesses(np.array([(low + high) / 2]))
    tangent = branch.tangent.copy()
    bend = beside[:-1, 0] - branch.at(np.array([k - 0.5]))[:-1, 0]
    tangent[:-1, k] -= 8 / (high - low) * tangent[-1, k] * bend
    alone = replace(branch, tangent=tangent).part(np.array([k - 1, k]))
    middle = alone.evaluate(np.array([0]), np.array([(low + high) / 2]))
    assert (
        alone.axis == len(middle) - 1
        and correct(problem, middle, branch.direction[:, k - 1 : k]).ok
    )
    strange = run(
        problem,
        checks._split(replace(branch, tangent=tangent), np.array([k - 1, n - 3])),
    )
    np.testing.assert_array_equal(np.delete(strange.Z, n - 2, axis=1), branch.Z)


def test_a_branch_that_cannot_be_mended_is_cut_and_reported():
    """A node of the other gait in its midst: the slope turns where there is no fold."""
    problem, found = branches("D")
    branch, other = (plain(b) for b in found)
    k = len(branch.q) // 3
    Z = branch.Z.copy()
    Z[:, k] = other.Z[:, np.argmin(np.abs(other.q - branch.q[k]))]
    Z[-1, k] = branch.q[k] + 0.3 * (branch.q[k] - branch.q[k + 8])
    damaged = replace(branch, Z=Z)
    kept = run(problem, checked(damaged, Z[:, -1]))
    assert "no further point" in kept.why and len(kept.lost()) >= 1
    assert np.isin(kept.Z[0], branch.Z[0]).mean() > 0.9
    assert (run(problem, checked(damaged, Z[:, 0])).Z[:, 0] == Z[:, 0]).all() and (
        kept.Z[:, -1] == Z[:, -1]
    ).all()
    assert "lost" in [p["kind"] for p in special_points(problem, kept)]
    run(problem, measure(kept, COARSE))
    assert all(
        "continuation was lost at" in sentence
        for sentence in np.array(_reasons(problem, [kept]))[[1, 5]]
    )
    assert "lost" not in outside("long", [], "searched")


def test_slopes_that_branches_span_are_told_in_order_and_once():
    pieces = [(0.3, 0.4), (0.05, 0.06), (0.01, 0.05), (0.02, 0.03), (0.2, 0.2 + 1e-12)]
    assert ranges(pieces) == "0.01 to 0.06; 0.2; 0.3 to 0.4"


@pytest.mark.parametrize(
    "end", ["end_kneestrike_at_heelstrike", "end_tangential_heelstrike", "end_fall"]
)
def test_an_end_whose_condition_does_not_hold_is_none(end):
    problem, found = branches("C", detuning=0.3)
    branch = next(b for b in found if b.why[1] != end)
    claimed = replace(branch, why=(branch.why[0], end))
    assert run(problem, checked(claimed, branch.Z[:, 0])).why == (
        branch.why[0],
        "no further point",
    )


def test_a_branch_before_a_fall_takes_few_corrections(monkeypatch):
    """Its tail took 900 steps, and each of its 1,200 failing segments was split by
    itself: half a minute.
    """
    calls = Counter()

    def counted(module, name):
        original = getattr(module, name)
        monkeypatch.setattr(
            module, name, lambda *a, **k: calls.update([name]) or original(*a, **k)
        )

    counted(Tracks, "advance")
    counted(tracking, "bordered_newton")
    legs = {
        "units": "SI",
        "g": 9.81,
        "knees": False,
        "l": 1.0,
        "m": 3,
        "c": 0.3,
        "r": 0.2,
        "R": 0.3,
    }
    branches = from_arrays(
        atlas({"line": {"walker": legs, "set": {}}, "coarse": True}, [])
    )
    assert (
        max(branch.Z[-2].max() for branch in branches) > 10
    )  # a period close to the longest
    assert calls["advance"] < 400 and calls["bordered_newton"] < 500
