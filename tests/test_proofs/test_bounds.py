"""Error bounds of random gaits against proved boxes."""

import pytest

from pipeline.bench.proved import Proved, proved


def check(gaits, kneed, share, tell):
    found = proved(gaits, kneed)
    tell(str(found))
    assert found.violations == 0
    assert len(found.nearest) >= share * gaits
    return found


def test_no_bound_of_random_gaits_is_below_the_proved_distance(tell):
    check(8, False, 1.0, tell)


def test_no_bound_of_random_kneed_gaits_is_below_the_proved_distance(tell):
    check(2, True, 1.0, tell)


@pytest.mark.soak
@pytest.mark.timeout(14400)
@pytest.mark.parametrize(("gaits", "kneed"), [(10_000, False), (500, True)])
def test_no_bound_of_many_gaits_is_below_the_proved_distance(gaits, kneed, tell):
    check(gaits, kneed, 0.99, tell)


def test_a_bound_too_small_is_counted():
    assert Proved([0.5, 1.5, 1.0], [0.6, 1.6, 1.1]).violations == 1
