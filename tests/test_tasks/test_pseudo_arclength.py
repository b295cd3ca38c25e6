"""Predictor, corrector and step control on circles, whose points, tangents and lengths are known."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from gaitsweep.tasks.continuation.pseudo_arclength import (
    Newton,
    StepControl,
    Tracks,
    bordered_newton,
)
from gaitsweep.tasks.continuation.root import hermite

#: Squares of the radii of the circles x^2 + y^2 = r^2 of three lanes, with a time t = x y beside them.
SQUARES = np.array([1.0, 4.0, 0.25])
NEWTON = Newton(max_iterations=8, max_step=1.0, small=1e-9, shrinking=0.2)
CONTROL = StepControl(
    shortest=1e-6, longest=0.3, min_cosine=0.9, target=1e-3, power=0.5, growth=(0.5, 2.0), reduction=0.5, max_bend=0.1
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

    return lambda guess, border: bordered_newton(linearise, lambda *_: 1e-15, NEWTON, guess, border, [0, 1])


def unit_tangents(radius):
    """Tangents where y vanishes."""
    return np.array([0 * radius, 0 * radius + 1, radius]) / np.sqrt(1 + radius**2)


def test_points_tangents_and_times_of_circles():
    radius, angle = np.sqrt(SQUARES), np.array([0.3, 1.2, 2.5])
    border = np.array([-np.sin(angle), np.cos(angle), 0 * angle])
    at = circles(SQUARES)(np.array([1.1 * radius * np.cos(angle), 1.1 * radius * np.sin(angle), 0 * angle]), border)
    assert at.ok.all()
    np.testing.assert_allclose(at.Z[:2], radius * [np.cos(angle), np.sin(angle)], atol=1e-14)
    np.testing.assert_allclose(at.Z[2], at.Z[0] * at.Z[1], atol=1e-13)
    rates = np.vstack([border[:2], radius * np.cos(2 * angle)])
    np.testing.assert_allclose(np.abs((at.direction * rates).sum(axis=0)), np.linalg.norm(rates, axis=0), rtol=1e-14)
    assert not circles(SQUARES)(np.array([[np.nan], [0.0], [0.0]]), border[:, :1]).ok[0]


def test_tracks_side_by_side_go_once_round_and_as_each_does_alone():
    def followed(squares):
        radius = np.sqrt(squares)
        Z = np.array([radius, 0 * radius, 0 * radius])
        tracks = Tracks(CONTROL, Z, unit_tangents(radius), 0.2)
        turned, rounds = np.zeros(len(squares)), []
        for _ in range(140):
            before = tracks.Z.copy()

            def judge(point, guess, error):
                return np.ones(len(error), bool), error

            active = np.arange(len(squares))
            tracks.advance(active, circles(squares), judge)
            turned += np.arctan2(
                before[0] * tracks.Z[1] - before[1] * tracks.Z[0], (before[:2] * tracks.Z[:2]).sum(axis=0)
            )
            rounds.append(tracks.Z.copy())
        return turned, np.array(rounds)

    turned, together = followed(SQUARES)
    assert (turned > 2 * np.pi).all()
    np.testing.assert_allclose((together[:, :2] ** 2).sum(axis=1), SQUARES * np.ones((140, 1)), rtol=1e-14)
    for lane in range(3):
        np.testing.assert_array_equal(followed(SQUARES[lane : lane + 1])[1][..., 0], together[..., lane])


def test_a_step_that_turns_too_far_is_refused_and_halved():
    tracks = Tracks(CONTROL, np.array([[0.5], [0.0], [0.0]]), unit_tangents(np.array([0.5])), 0.4)
    _, fair = tracks.advance(np.array([0]), circles(SQUARES[2:]), lambda p, g, e: (np.ones(1, bool), e))
    assert not fair[0] and tracks.step[0] == 0.2
    np.testing.assert_array_equal(tracks.Z[:, 0], [0.5, 0.0, 0.0])


def test_newtons_method_begins_on_the_cubic_through_the_last_two_points():
    """In the plane of the predicted point, so that the corrected one is the same: only sooner reached."""
    radius = np.sqrt(SQUARES)
    tracks = Tracks(CONTROL, np.array([radius, 0 * radius, 0 * radius]), unit_tangents(radius), 0.15)
    for k in range(3):
        begun, predicted, has_two = [], [], tracks.back > 0
        tracks.advance(
            np.arange(3),
            lambda guess, border, begun=begun: begun.append((guess, border)) or circles(SQUARES)(guess, border),
            lambda point, guess, e, at=predicted: at.append((point.Z, guess)) or (np.ones(3, bool), e),
        )
        ((start, border),), ((reached, guess),) = begun, predicted
        np.testing.assert_allclose(((start - guess) * border).sum(axis=0), 0.0, atol=1e-15)
        near, far = (np.linalg.norm(reached - Z, axis=0) for Z in (start, guess))
        assert (near[has_two] < 0.7 * far[has_two]).all() and (start == guess)[:, ~has_two].all()
        assert has_two.sum() == (0, 2, 3)[k]


def test_hermites_polynomial_is_the_cubic_through_both_points_and_tangents():
    cubic = np.polynomial.Polynomial([0.3, -1.0, 0.7, 0.4])
    a, length = 0.2, 1.7
    rate = cubic.deriv()
    h = np.linspace(0, 1, 9)
    found = hermite(cubic(a) + 0 * h, rate(a) + 0 * h, cubic(a + length) + 0 * h, rate(a + length) + 0 * h, length, h)
    np.testing.assert_allclose(found, cubic(a + length * h), atol=1e-14)


def test_a_curve_that_closes_in_the_step_in_which_it_stops_for_another_reason_is_closed():
    """It had the other reason, and was taken for one with two ends."""

    def followed(most):
        solve = circles(SQUARES[2:])
        tracks = Tracks(CONTROL, np.array([[0.5], [0.0], [0.0]]), unit_tangents(np.array([0.5])), 0.1)
        (track,) = tracks.follow(
            lambda _, guess, border: solve(guess, border),
            lambda _, point, guess, error: (np.ones(1, bool), error),
            lambda *_: np.array(["" if tracks.count[0] < most else "elsewhere"]),
            1000,
        )
        return track.stop_reason, track.Z.shape[1]

    reason, n = followed(1000)
    assert (reason, n > 4) == ("closed", True)
    assert followed(n) == ("closed", n)
    assert followed(n - 1) == ("elsewhere", n - 1)
