"""Lanes of results: taken, replaced and joined, whatever holds them."""

import functools
from dataclasses import dataclass

import numpy as np

from gaitsweep.tasks.step.lanes import join_lanes, lanes_of, replace_lanes


@dataclass
class Inner:
    rows: np.ndarray
    parts: list


@dataclass
class Outer:
    inner: Inner
    values: np.ndarray

    @functools.cached_property
    def doubled(self):
        return 2 * self.values


def outer(values):
    values = np.asarray(values, float)
    return Outer(
        Inner(np.vstack([values, -values]), [values + 10, values[None, None] + 20]),
        values,
    )


def equal(a, b):
    np.testing.assert_array_equal(a.values, b.values)
    np.testing.assert_array_equal(a.doubled, b.doubled)
    np.testing.assert_array_equal(a.inner.rows, b.inner.rows)
    for x, y in zip(a.inner.parts, b.inner.parts, strict=True):
        np.testing.assert_array_equal(x, y)


def test_lanes_are_taken_from_all_that_a_result_holds():
    whole = outer([1, 2, 3])
    assert whole.doubled.tolist() == [2, 4, 6]
    for lanes in (np.array([2, 0]), slice(1, 3), np.array([True, False, True])):
        equal(lanes_of(whole, lanes), outer(np.array([1, 2, 3])[lanes]))


def test_lanes_are_replaced_in_place_and_what_was_computed_of_them_is_dropped():
    whole = outer([1, 2, 3, 4])
    assert whole.doubled.tolist() == [2, 4, 6, 8]
    replace_lanes(whole, np.array([3, 1]), outer([40, 20]))
    equal(whole, outer([1, 20, 3, 40]))


def test_parts_follow_one_another():
    parts = [
        Outer(np.array([[1.0, 2.0]]), np.array([3, 4])),
        Outer(np.array([[5.0]]), np.array([6])),
    ]
    joined = join_lanes(parts)
    assert joined.inner.tolist() == [[1, 2, 5]] and joined.values.tolist() == [3, 4, 6]
