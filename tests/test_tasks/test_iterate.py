"""The loop that all iterations share."""

import numpy as np

from gaitsweep.tasks.step.iterate import Ended, iterate


class Roots:
    """Newton's method for the square roots of numbers, which notes the lanes stepped."""

    def __init__(self, numbers):
        self.numbers = np.array(numbers, float)
        self.x = np.ones(len(numbers))
        self.stepped = []

    def step(self, lanes, taken):
        self.stepped.append(lanes.tolist())
        change = (self.numbers[lanes] / self.x[lanes] - self.x[lanes]) / 2
        self.x[lanes] += change
        ended = np.full(len(lanes), Ended.RUNNING)
        ended[np.abs(change) < 1e-12] = Ended.CONVERGED
        ended[np.abs(change) > 100] = Ended.DIVERGED
        ended[np.isnan(change)] = Ended.SINGULAR
        return ended


def test_every_lane_tells_why_it_ended():
    ended = iterate(Roots([1.0, 4.0, 1e4, np.nan, -3.0]), 5, 30)
    assert [Ended(code).name for code in ended] == [
        "CONVERGED",
        "CONVERGED",
        "DIVERGED",
        "SINGULAR",
        "OUT_OF_STEPS",
    ]


def test_lanes_that_ended_are_not_stepped_again():
    roots = Roots([1.0, 4.0, 1e4])
    iterate(roots, 3, 30)
    assert roots.stepped[:3] == [[0, 1, 2], [1], [1]]


def test_a_lane_has_the_bits_that_it_has_alone():
    numbers = [1.0, 2.0, 3.0, 1e3, 7.0]
    together = Roots(numbers)
    iterate(together, 5, 30)
    for number, x in zip(numbers, together.x, strict=True):
        alone = Roots([number])
        iterate(alone, 1, 30)
        assert alone.x[0] == x


def test_no_more_steps_are_taken_than_allowed():
    roots = Roots([2.0])
    assert iterate(roots, 1, 2).tolist() == [Ended.OUT_OF_STEPS]
    assert len(roots.stepped) == 2


def test_nothing_is_stepped_where_there_are_no_lanes():
    roots = Roots([])
    assert not iterate(roots, 0, 5).size and not roots.stepped
