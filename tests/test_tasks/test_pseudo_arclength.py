"""Predictor, corrector and step control on circles, whose points, tangents and lengths
are known.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from gaitsweep.tasks.branches.pseudo_arclength import (
    Newton,
    StepControl,
    Tracks,
    bordered_newton,
)
from gaitsweep.tasks.branches.root import hermite

#: Squares of the radii of the circles x^2 + y^2 = r^2 of three lanes, with a time t = x
#: y beside them.
SQUARES = np.array([1.0, 4.0, 0.25])
NEWTON = Newton(max_iterations=8, max_step=1.0, small=1e-9, shrinking=0.2)
CONTROL = StepControl(
    shortest=1e-6,
    longest=0.3,
    min_cosine=0.9,
    target=1e-3,
    power=0.5,
    growth=(0.5, 2.0),
    reduction=0.5,
    max_bend=0.1,
)


@dataclass
class Equations:
    residual: Any
    derivative: Any


def circles(squares):
    def linearise(lanes, Z):
        x, y, time = Z
        residual = np.array([x**2 + y**2 - squares[lanes], x * y - time])
        return Equations(residual, np.array([[2 * x, 2 * y, 0 * x], [y, x, 0 * x - 1]]))

    return lambda guess, border: bordered_newton(
        linearise, lambda *_: 1e-15, NEWTON, guess, border, [0, 1]
    )


class Circles(Tracks):
    def __init__(self, squares, step):
        radius = np.sqrt(squares)
        self.solve = circles(squares)
        super().__init__(
            CONTROL,
            np.array([radius, 0 * radius, 0 * radius]),
            unit_tangents(radius),
            step,
        )

    def correct(self, tracks, guess, border):
        return self.solve(guess, border)


def unit_tangents(radius):
    """Tangents where y vanishes."""
    return np.array([0 * radius, 0 * radius + 1, radius]) / np.sqrt(1 + radius**2)


def test_points_tangents_and_times_of_circles():
    radius, angle = np.sqrt(SQUARES), np.array([0.3, 1.2, 2.5])
    border = np.array([-np.sin(angle), np.cos(angle), 0 * angle])
    at = circles(SQUARES)(
        np.array(
            [1.1 * radius * np.cos(angle), 1.1 * radius * np.sin(angle), 0 * angle]
        ),
        border,
    )
    assert at.ok.all()
    np.testing.assert_allclose(
        at.Z[:2], radius * [np.cos(angle), np.sin(angle)], atol=1e-14
    )
    np.testing.assert_allclose(at.Z[2], at.Z[0] * at.Z[1], atol=1e-13)
    rates = np.vstack([border[:2], radius * np.cos(2 * angle)])
    np.testing.assert_allclose(
        np.abs((at.direction * rates).sum(axis=0)),
        np.linalg.norm(rates, axis=0),
        rtol=1e-14,
    )
    assert not circles(SQUARES)(np.array([[np.nan], [0.0], [0.0]]), border[:, :1]).ok[0]


def test_tracks_side_by_side_go_once_round_and_as_each_does_alone():
    def followed(squares):
        tracks = Circles(squares, 0.2)
        turned, rounds = np.zeros(len(squares)), []
        for _ in range(140):
            before = tracks.Z.copy()
            tracks.advance(np.arange(len(squares)))
            turned += np.arctan2(
                before[0] * tracks.Z[1] - before[1] * tracks.Z[0],
                (before[:2] * tracks.Z[:2]).sum(axis=0),
            )
            rounds.append(tracks.Z.copy())
        return turned, np.array(rounds)

    turned, together = followed(SQUARES)
    assert (turned > 2 * np.pi).all()
    np.testing.assert_allclose(
        (together[:, :2] ** 2).sum(axis=1), SQUARES * np.ones((140, 1)), rtol=1e-14
    )
    for lane in range(3):
        np.testing.assert_array_equal(
            followed(SQUARES[lane : lane + 1])[1][..., 0], together[..., lane]
        )


def test_a_step_that_turns_too_far_is_refused_and_halved():
    tracks = Circles(SQUARES[2:], 0.4)
    _, fair = tracks.advance(np.array([0]))
    assert not fair[0] and tracks.step[0] == 0.2
    np.testing.assert_array_equal(tracks.Z[:, 0], [0.5, 0.0, 0.0])


def test_newtons_method_begins_on_the_cubic_through_the_last_two_points():
    """In the plane of the predicted point, so that the corrected one is the same: only
    sooner reached.
    """
    begun, predicted = [], []

    class Told(Circles):
        def correct(self, tracks, guess, border):
            begun.append((guess, border))
            return super().correct(tracks, guess, border)

        def judge(self, tracks, point, guess, error):
            predicted.append((point.Z, guess))
            return super().judge(tracks, point, guess, error)

    tracks = Told(SQUARES, 0.15)
    for k in range(3):
        has_two = tracks.back > 0
        tracks.advance(np.arange(3))
        (start, border), (reached, guess) = begun[-1], predicted[-1]
        np.testing.assert_allclose(
            ((start - guess) * border).sum(axis=0), 0.0, atol=1e-15
        )
        near, far = (np.linalg.norm(reached - Z, axis=0) for Z in (start, guess))
        assert (near[has_two] < 0.7 * far[has_two]).all() and (start == guess)[
            :, ~has_two
        ].all()
        assert has_two.sum() == (0, 2, 3)[k]


def test_hermites_polynomial_is_the_cubic_through_both_points_and_tangents():
    cubic = np.polynomial.Polynomial([0.3, -1.0, 0.7, 0.4])
    a, length = 0.2, 1.7
    rate = cubic.deriv()
    h = np.linspace(0, 1, 9)
    ends = ((cubic(x) + 0 * h, rate(x) + 0 * h) for x in (a, a + length))
    found = hermite(*ends, length, h)
    np.testing.assert_allclose(found, cubic(a + length * h), atol=1e-14)


def test_a_curve_that_closes_in_the_step_in_which_it_stops_for_another_reason_is_closed():
    """It had the other reason, and was taken for one with two ends."""

    class Stopped(Circles):
        def reasons(self, tracks, point, last):
            return np.array(["" if self.count[0] < most else "elsewhere"])

    def followed():
        (track,) = Stopped(SQUARES[2:], 0.1).follow(1000)
        return track.stop_reason, track.Z.shape[1]

    most = 1000
    reason, n = followed()
    assert (reason, n > 4) == ("closed", True)
    most = n
    assert followed() == ("closed", n)
    most = n - 1
    assert followed() == ("elsewhere", n - 1)


def test_what_only_leads_to_others_has_converged_in_coordinates_without_size_too():
    """Of x^2 = 2 and t^2 = 0, of which only x has a size, t converges slowly."""

    def linearise(lanes, Z):
        t, x, _ = Z
        zero = np.zeros_like(t)
        derivative = np.array([[2 * t, zero, zero], [zero, 2 * x, zero]])
        return Equations(np.array([t**2, x**2 - 2]), derivative)

    limits = Newton(20, max_step=1.0, small=0.0, shrinking=0.0, enough=1e-2)
    begin = np.array([[0.4], [1.5], [0.0]])
    found = bordered_newton(
        linearise, lambda *_: 0.0, limits, begin, np.eye(3)[:, [2]], sized=[1, 2]
    )
    assert found.ok[0] and found.Z[1, 0] == pytest.approx(np.sqrt(2), abs=1e-12)
    # Until x changed no more; it was enough after two steps, with 0.1 left of t.
    assert found.Z[0, 0] < 0.02
