"""Random driven walkers: bounds hold, and gaits repeat in an independent derivation."""

import itertools

import pytest

from soak import driven

THOROUGH, SOAK = pytest.mark.thorough, pytest.mark.soak


@pytest.mark.parametrize(
    "count", [pytest.param(4, marks=THOROUGH), pytest.param(1000, marks=SOAK)]
)
def test_random_driven_gaits_repeat_in_the_independent_derivation(count):
    compared = driven.by_derivation(itertools.count(), count)
    assert len(compared.off) == count
    assert not compared.wrong


@pytest.mark.parametrize(
    "count", [pytest.param(4, marks=THOROUGH), pytest.param(200, marks=SOAK)]
)
def test_bounds_of_random_driven_gaits_hold_in_113_bits(count):
    compared = driven.in_113_bits(itertools.count(10_000), count)
    assert len(compared.off) == count
    assert not compared.wrong
