"""Sums of lanes: in order, and alike however many lanes there are.

So are sums of products that leave out what is zero, and steps that are equal are
evaluated once.
"""

import functools
import operator

import numpy as np
import pytest

from gaitsweep.tasks.mechanics import sums
from gaitsweep.tasks.mechanics.sums import matvec, total
from gaitsweep.tasks.step import several_steps
from gaitsweep.tasks.step.problem import EPS, Problem
from gaitsweep.tasks.step.several_steps import joined
from gaitsweep.tasks.walkers.resolve import resolve


@pytest.fixture
def dice():
    return np.random.default_rng(7)


def added_in_order(terms):
    return functools.reduce(operator.add, [*terms])


def same_bits(found, expected):
    assert found.tobytes() == expected.tobytes()


@pytest.mark.parametrize("terms", [1, 3, 40, 700])
def test_terms_are_added_in_order(dice, terms):
    """By one call or one by one: of few lanes and of many."""
    for lanes in (1, 7, sums._FEW, sums._FEW + 1):
        values = dice.normal(size=(terms, lanes))
        expected = added_in_order(values)
        same_bits(total(values), expected)
        same_bits(total(values[:, -1:]), expected[-1:])


@pytest.mark.parametrize("columns", [1, 3, 200])
@pytest.mark.parametrize("lanes", [1, 5, 60, 400])
def test_products_are_added_in_order(dice, columns, lanes):
    """Of matrices with vectors, and with matrices."""
    A = dice.normal(size=(5, columns, lanes))
    v = dice.normal(size=(columns, lanes))
    B = dice.normal(size=(columns, 4, lanes))

    expected = added_in_order(A[:, j] * v[j] for j in range(columns))
    same_bits(matvec(A, v), expected)

    expected = added_in_order(A[:, j, None] * B[j] for j in range(columns))
    same_bits(matvec(A[:, :, None], B), expected)


def two_gaits(walker, steps, dice):
    """A problem, and steps that no gait takes."""
    problem = Problem(resolve(walker)).of_steps(steps)
    m = problem.m // steps
    phases = problem.phases // steps
    middle = np.array([0.3, -0.3, 0.03])[:m, None]

    y = middle * dice.uniform(0.9, 1.1, (steps, m, 2))
    durations = np.full((steps, phases, 2), 3.5 / phases)
    w = joined(0.0, y, durations)

    slope = np.array([0.02, 0.03])
    stride, _ = problem.stride(
        w,
        np.log(slope),
        by_drive=True,
    )
    return problem, stride


@pytest.mark.parametrize(
    ("walker", "steps"),
    [
        ("D", 1),
        ("D", 3),
        ("C", 4),
    ],
)
def test_what_is_carried_through_steps_is_the_whole_product(dice, walker, steps):
    """Of which the derivatives of other steps are left out, which are zero."""
    problem, stride = two_gaits(walker, steps, dice)
    by_y = stride.derivative[:, : problem.m].copy()
    own = np.arange(problem.m)
    by_y[own, own] += 1.0
    assert np.isfinite(by_y).all()

    rows = dice.normal(size=(5, *stride.residual.shape))
    expected = matvec(rows[:, :, None], by_y)
    np.testing.assert_array_equal(stride.carried(rows), expected)


@pytest.mark.parametrize(
    "mixer",
    [
        several_steps._MIXER,
        np.uint64(0),
    ],
)
def test_equal_steps_are_evaluated_once(monkeypatch, dice, mixer):
    """And different ones never as one, even if all are mixed to one number."""
    monkeypatch.setattr(several_steps, "_MIXER", mixer)
    columns = dice.normal(size=(4, 6))
    columns = columns[:, [3, 3, 0, 5, 0, 3, 1]]
    columns[3, 5] *= 1 + EPS

    first, place = several_steps._distinct(columns)

    np.testing.assert_array_equal(columns[:, first[place]], columns)
    if mixer:
        assert first.tolist() == [0, 2, 3, 5, 6]


@pytest.mark.parametrize("kind", [bool, np.int8, float, complex])
def test_a_sum_has_the_type_of_its_terms_however_many_lanes_there_are(kind):
    few, many = (total(np.ones((3, n), kind)) for n in (4, 300))

    assert few.dtype == many.dtype == kind
    assert (few == many[:4]).all()


def test_gaits_of_several_steps_may_be_none():
    y, durations = np.empty((4, 3, 0)), np.empty((4, 1, 0))

    assert joined(np.empty(0), y, durations).shape == (16, 0)
