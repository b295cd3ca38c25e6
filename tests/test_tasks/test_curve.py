"""Curves in two parameters: against points located line by line, and where two branches
re-pair.
"""

import functools
import itertools
import re
from types import SimpleNamespace

import numpy as np
import pytest

import gaitsweep
from gaitsweep.tasks.branches import curves
from gaitsweep.tasks.branches.conditions import CONDITIONS
from gaitsweep.tasks.branches.curves import (
    at_value,
    follow_both_directions,
    turning,
    walks,
)
from gaitsweep.tasks.branches.equations import (
    Equations,
    Keys,
    System,
    correct_on_curve,
)
from gaitsweep.tasks.branches.joint import rounding_step
from gaitsweep.tasks.branches.special_points import special_points
from gaitsweep.tasks.step.step_map import Stride
from gaitsweep.tasks.studies.follow_curves import _is_ordinary, curve
from gaitsweep.tasks.studies.map_step import map_step
from gaitsweep.tasks.walkers.resolve import from_catalogue, resolve
from gaitsweep.tasks.walkers.walker import WalkerError
from lines import _atlas, branches

LINE = {"walker": "C", "set": {}}
WINDOW = np.array([(-6.0, -1.0), (0.6, 0.8)])
#: A fold of C on the way to the machine: similarity coordinates, event times, ln slope,
#: detuning.
FOLD = np.array(
    [
        -0.76050299,
        -1.55377883,
        -0.47724619,
        1.69557706,
        2.31306058,
        -2.05756334,
        0.76301856,
    ]
)
SLOPE, DETUNING = 5, 6


def folds_of_c():
    detuning = Keys(
        names=("detuning",),
        walker_at=lambda value: resolve("C", {"detuning": value}),
        low=(0.0,),
        high=(1.0,),
        ordinary=(FOLD[DETUNING],),
    )
    return Equations(detuning, [CONDITIONS["fold"]])


def corrected(equations, X, border):
    return correct_on_curve(equations, X.reshape(-1, 1), border.reshape(-1, 1))


def pairs(points, tangents):
    return itertools.pairwise(zip(points, tangents, strict=True))


def test_branches_re_pair_where_the_curve_of_folds_turns(monkeypatch):
    folds = folds_of_c()
    first = corrected(folds, FOLD, np.eye(7)[DETUNING])
    points, tangents, _ = follow_both_directions(folds, first, WINDOW)
    both = [
        (a, b)
        for a, b in pairs(points, tangents)
        if turning(folds, a, b, DETUNING) is not None
    ]
    assert len(both) == 1
    found, error = turning(folds, *both[0], DETUNING)
    # Branches followed at 0.72 and 0.73 show the two pairings, and a fold at 0.0902 on
    # the far side.
    assert found[DETUNING] == pytest.approx(0.72386360373, abs=1e-9)
    assert np.exp(found[SLOPE]) == pytest.approx(0.1001868636, abs=1e-9)
    # A bound that is measured, on the slope; differences over other steps move the
    # turning by less.
    assert 1e-15 < error < 1e-8
    # Over other steps.
    at = Equations.at
    monkeypatch.setattr(curves, "DIFFERENCE", 3e-5)
    monkeypatch.setattr(
        Equations, "at", lambda self, X, step=3e-5, **more: at(self, X, step, **more)
    )
    other, other_error = turning(folds, *both[0], DETUNING)
    assert 0 < abs(other[SLOPE] - found[SLOPE]) < other_error + error
    assert walks(folds, found)


def test_the_equations_of_a_curve_have_the_derivatives_that_differences_have():
    folds, h = folds_of_c(), 1e-6
    derivative = folds.at(FOLD[:, None]).derivative[..., 0]
    for i in range(7):
        move = h * np.eye(7)[:, [i]]
        up, down = (
            folds.at(FOLD[:, None] + sign * move).residual[:, 0] for sign in (1, -1)
        )
        np.testing.assert_allclose(
            derivative[:, i], (up - down) / (2 * h), rtol=1e-5, atol=1e-7
        )


def test_beyond_its_limits_a_curve_has_the_walker_there_and_constants_continued_linearly():
    keys = folds_of_c().keys
    assert keys.values(np.array([[1.5]])) == [[1.0]]
    problem = keys.lanes(np.array([[1.25, 1.0, 0.75]]))
    beyond, at, before = problem.constants[:, problem.lanes].T
    np.testing.assert_allclose(beyond - at, at - before, rtol=1e-12)


@pytest.fixture(scope="module")
def flips_of_c():
    """The flips of walkers near C, over the detuning."""
    asked = {"line": LINE, "slope": np.array([0.01, 0.2]), "key": "detuning"}
    asked |= {"from": -0.02, "to": 0.22, "kinds": ["flip"]}
    return curve(asked, [_atlas("C", ())])


def test_the_walkers_of_a_curve_mix_the_keys_of_both_ends_of_detuning(flips_of_c):
    tuned, physical = from_catalogue("C"), from_catalogue("physical")
    values = flips_of_c["curve_walkers/value"]
    for key in ("w_t", "c_t", "r_s", "m_t"):
        begin, end = getattr(tuned, key), getattr(physical, key)
        mixed = begin + values * (end - begin)
        found = flips_of_c[f"curve_walkers/{key}"]
        np.testing.assert_allclose(found, mixed, rtol=1e-12)

    # Every point has its walker, once.
    points = {*flips_of_c["curves/value"], *flips_of_c["turnings/value"]}
    assert values.tolist() == sorted(points)


def test_flips_agree_with_those_located_line_by_line(flips_of_c):
    found = flips_of_c
    near = np.argsort(np.abs(found["curves/value"] - 0.2))[:5]
    fit = np.polyfit(found["curves/value"][near] - 0.2, found["curves/slope"][near], 4)
    # Brent's method on the branch at detuning 0.2 (test function of the line alone).
    assert fit[-1] == pytest.approx(0.08056144479503541, abs=2e-8)
    assert found["curves/slope"][
        np.argmin(np.abs(found["curves/value"]))
    ] == pytest.approx(0.0768533651, rel=2e-3)
    assert found["curves/walks"].all()
    # The slope of the flip is least a little off the tuned walker.
    assert found["turnings/turn"].tolist() == ["slope"]
    assert found["turnings/value"][0] == pytest.approx(0.053798, abs=1e-5)
    # There the slope changes in the second order only with an error along the curve.
    assert found["turnings/error_bound"][0] < 1e-13


@pytest.mark.parametrize(
    ("walker", "key", "low", "high"),
    [
        pytest.param("C", "m_h", 0.0, 0.4, marks=pytest.mark.thorough),
        ("A", "g", 1.0, 9.81),
    ],
)
def test_a_step_maps_the_states_along_a_curve_onto_themselves(walker, key, low, high):
    found = curve(
        {
            "line": {"walker": walker, "set": {}},
            **{
                "slope": np.array([0.01, 0.2]),
                "key": key,
                "from": low,
                "to": high,
                "kinds": ["flip"],
            },
        },
        [_atlas(walker, ())],
    )

    for k in (0, -1):
        start = [
            found[f"curves/{name}"][k]
            for name in ("stance_angle", "stance_rate", "thigh_rate")
        ]
        line = {"walker": walker, "set": {key: found["curves/value"][k]}}
        mapped = map_step({**line, "slope": found["curves/slope"][k], "state": start})
        np.testing.assert_allclose(mapped["state"], start, rtol=1e-7)
        np.testing.assert_allclose(
            mapped["heelstrike_time"], found["curves/period"][k], rtol=1e-7
        )
    is_locked = found["curves/shank_rate"] == found["curves/thigh_rate"]
    assert is_locked.all() if walker == "A" else not is_locked.any()


def followed(walker, key, low, high, kind, **overrides):
    """One curve of ends: its key values, slopes and whether they are the edge of
    walking.
    """
    line = {"walker": walker, "set": overrides}
    found = curve(
        {
            "line": line,
            "slope": np.array([1e-3, 0.3]),
            "key": key,
            "from": low,
            "to": high,
            "kinds": [kind],
        },
        [_atlas(walker, tuple(overrides.items()))],
    )
    first = found["curves/curve"] == 0
    return tuple(found[f"curves/{k}"][first] for k in ("value", "slope", "walks"))


def end_at(walker, kind, **overrides):
    """The same end located on the branch of one line."""
    problem, found = branches(walker, **overrides)
    return min(
        p["slope"]
        for b in found
        for p in special_points(problem, b)
        if p["kind"] == kind
    )


def at(value, x, y):
    """y at x = value by the polynomial through the six nearest points."""
    near = np.argsort(np.abs(x - value))[:6]
    return np.polyfit(x[near] - value, y[near], 5)[-1]


def test_ends_at_no_rate_are_followed():
    kind = "end_tangential_heelstrike"
    value, slope, walks = followed("physical-straight", "c_t", 0.07, 0.112, kind)
    # Point 2 of figure 6, read off polynomials beside it on the branch of its own line.
    assert at(0.091, value, slope) == pytest.approx(
        end_at("physical-straight", kind), rel=1e-10
    )
    assert at(0.105, value, slope) == pytest.approx(
        end_at("physical-straight", kind, c_t=0.105), rel=1e-8
    )
    # Up to the borders of the range, and not beyond.
    assert (value.min(), value.max()) == (
        pytest.approx(0.07, abs=1e-15),
        pytest.approx(0.112, abs=1e-15),
    )
    assert walks.all()


def test_ends_at_kneestrike_are_followed_past_where_heelstrike_is_at_no_rate():
    """The short step of the detuned walker ends at kneestrike at 0.2, but heelstrike
    turns tangential first at 0.05.
    """
    kind = "end_kneestrike_at_heelstrike"
    value, slope, walks = followed("C", "detuning", 0.0, 1.1, kind, detuning=1.0)
    assert value.min() < 0.05
    # Point 1 of the paper's figure 6.
    assert at(1.0, value, slope) == pytest.approx(end_at("physical", kind), rel=1e-9)
    assert at(0.2, value, slope) == pytest.approx(
        end_at("C", kind, detuning=0.2), rel=1e-7
    )
    assert walks[value > 0.2].all()
    assert not walks[value < 0.06].any()


def test_a_range_that_is_none_is_refused():
    with pytest.raises(WalkerError, match="must be less than"):
        curve({"line": LINE, "slope": np.array([0.1]), "from": 1.0, "to": 0.0}, [{}])
    with pytest.raises(WalkerError, match="not a walker key"):
        curve(
            {
                "line": LINE,
                "slope": np.array([0.1]),
                "key": "l_x",
                "from": 0.0,
                "to": 1.0,
            },
            [{}],
        )


@pytest.mark.parametrize(
    ("walker", "key", "low", "high", "slopes"),
    [
        (
            "E",
            "R",
            0.0,
            0.3,
            (1e-4, 0.1),
        ),  # its own foot is a point; flips are at the other end of the range
        ("B", "R", 0.3, 0.4, (1e-4, 0.1)),  # its own value lies below the range
        (
            "D",
            "foot_mass_ratio",
            0.0,
            0.08,
            (1e-3, 0.1),
        ),  # beside its own value lies no walker
    ],
)
def test_a_curve_begins_where_it_can(walker, key, low, high, slopes):
    line = {"walker": walker, "set": {}}
    found = curve(
        {
            "line": line,
            "slope": np.array(slopes),
            "key": key,
            "from": low,
            "to": high,
            "kinds": ["flip"],
        },
        [_atlas(walker, ())],
    )
    value, slope = found["curves/value"], found["curves/slope"]
    assert len(value) > 8 and found["curves/walks"].all()
    assert (
        low <= value.min()
        and value.max() <= high
        and slope.max() <= slopes[1] * (1 + 1e-14)
    )
    assert (
        max(slope.min() / slopes[0] - 1, value.min() - low - 1e-3 * (high - low))
        > -1e-14
    )
    assert value.max() == pytest.approx(high, abs=1e-15)
    near = 0.31 if key == "R" and low else 0.07 if low == 0.0 and key != "R" else 0.25
    (there,) = {p["slope"] for p in flips(walker, **{key: near})}
    assert at(near, value, slope) == pytest.approx(there, rel=1e-6)


def test_a_curve_begins_at_the_detuning_of_the_walkers_own_table():
    """It was taken for 0, the branches for those of the tuned walker: its folds were
    missed, and others found.
    """
    lines = [
        {"walker": {"base": "A", "detuning": 0.5}, "set": {}},
        {"walker": "A", "set": {"detuning": 0.5}},
    ]
    options = {
        "slope": np.array([1e-3, 0.2]),
        "key": "detuning",
        "from": -0.2,
        "to": 0.7,
        "kinds": ["fold"],
    }
    own, overridden = (
        curve({"line": line, **options}, [_atlas("A", (("detuning", 0.5),))])
        for line in lines
    )
    assert own["curves/value"].max() == pytest.approx(0.7, abs=1e-15)
    for name, column in overridden.items():
        np.testing.assert_array_equal(own[name], column, err_msg=name)


@pytest.mark.thorough
def test_curves_of_each_kind_begin_where_there_are_points_of_it():
    """The tuned walker has flips, and folds only at the other end of the range."""
    options = {
        "line": {"walker": "A", "set": {}},
        "slope": np.array([1e-3, 0.1]),
        "key": "detuning",
        "from": 0.0,
        "to": 0.5,
    }
    of_tuned = [_atlas("A", ())]

    both = curve({**options, "kinds": ["flip", "fold"]}, of_tuned)

    assert both["curves/curve"][0] == 0 and both["curves/kind"][0] == "flip"
    alone = curve({**options, "kinds": ["fold"]}, of_tuned)
    is_fold = both["curves/kind"] == "fold"
    assert is_fold.any()
    for column in ("slope", "value"):
        own = both[f"curves/{column}"][is_fold]
        assert own.tolist() == alone[f"curves/{column}"].tolist()


def test_a_curve_that_returns_to_the_border_it_began_at_is_one():
    """It was followed again from its other end: two curves, and its turning point
    twice.
    """
    line = {"walker": "C", "set": {"detuning": 1.0}}
    options = {
        "slope": np.array([0.05, 0.2]),
        "key": "detuning",
        "from": 0.65,
        "to": 0.73,
        "kinds": ["fold"],
    }
    found = curve({"line": line, **options}, [_atlas("C", (("detuning", 1.0),))])
    assert set(found["curves/curve"]) == {0}
    assert found["curves/value"][[0, -1]] == pytest.approx(0.73, abs=1e-15)
    assert found["turnings/value"] == pytest.approx([0.72386360373], abs=1e-9)


def test_a_curve_begins_where_neighbouring_walkers_have_its_equations():
    def walker_at(ratio):
        return resolve("E", {"foot_mass_ratio": ratio})

    assert _is_ordinary(walker_at, [0.1 - 1e-4, 0.1, 0.1 + 1e-4], 0.2)
    assert _is_ordinary(walker_at, [0.0, 1e-4], 0.2)
    assert not _is_ordinary(walker_at, [-1e-4, 0.0, 1e-4], 0.2)
    assert not _is_ordinary(
        lambda radius: resolve("E", {"R": radius}), [0.0, 1e-4], 0.2
    )  # another dimension


def flips(walker, **overrides):
    """Flips located on the branches of one line."""
    problem, found = branches(walker, **overrides)
    return [p for b in found for p in special_points(problem, b) if p["kind"] == "flip"]


def test_periods_along_a_curve_are_in_the_walkers_time():
    """On a moon the flip is where it was; its step takes longer by the square root of
    gravity.
    """
    found = curve(
        {
            "line": LINE,
            "slope": np.array([0.05, 0.1]),
            "key": "g",
            "from": 1.0,
            "to": 9.81,
            "kinds": ["flip"],
        },
        [_atlas("C", ())],
    )
    tempo = found["curves/period"] * np.sqrt(found["curves/value"])
    assert np.ptp(found["curves/value"]) > 8 and np.ptp(tempo) < 1e-9


def rounding_of(matrix, y, derivative):
    """Largest error that rounding makes in one lane, in units of the last digit."""
    m, size = len(y), len(matrix)
    share = y / y[0]
    inverse = np.linalg.inv(matrix)[[*range(m), -1]]

    error = np.abs(inverse) @ np.r_[share, np.ones(size - m)]
    for k in range(m):
        carried = derivative[:, k] + np.eye(size - 1)[k]
        error += np.abs(inverse[:, :-1] @ carried) * share[k]
    return 6 * error.max()


def test_the_step_that_rounding_makes_counts_every_row_and_direction():
    dice = np.random.default_rng(3)
    m, n, size = 3, 4, 6
    matrix = dice.normal(size=(n, size, size))
    y = dice.uniform(0.1, 1.0, (m, n))
    derivative = dice.normal(size=(size - 1, size - 1, n))
    stride = SimpleNamespace(y=y, derivative=derivative)
    stride.carried = functools.partial(Stride.carried, stride)

    found = rounding_step(matrix, SimpleNamespace(m=m, stride=stride))

    for lane in range(n):
        error = rounding_of(matrix[lane], y[:, lane], derivative[..., lane])
        assert found[lane] / np.finfo(float).eps == pytest.approx(error, rel=1e-9)


class Plane(Equations):
    """A curve of one equation in ln slope and the key, without a gait; `equation` gives
    its value and derivatives.
    """

    size = 3

    def __init__(self, equation):
        self.equation, self.problem = equation, SimpleNamespace(m=0, phases=1, steps=1)

    def some(self, lanes):
        return self

    def at(self, X, difference=None, samples=0):
        residual, derivative = [], []
        for time, q, key in X.T:
            value, by_X = self.equation(q, key)
            # The event time is zero.
            residual.append([time, value])
            derivative.append([[1.0, 0.0, 0.0], [0.0, *by_X]])
        no_gait = np.zeros((0, X.shape[1]))
        by_lane = np.moveaxis(np.array(derivative), 0, -1)
        return System(X, np.array(residual).T, by_lane, no_gait)

    def through(self, q, key):
        return corrected(self, np.array([0.0, q, key]), np.array([0.0, 0.0, 1.0]))


def circle(q, key):
    return q * q + key * key - 1, [2 * q, 2 * key]


def test_a_curve_has_a_value_at_a_point_of_its_own_that_is_no_end():
    """Neither of the segments beside it changed its sign."""
    angle = np.array([-0.5, 0.0, 0.5, np.pi / 2, np.pi - 0.2])
    points = np.column_stack([np.zeros(5), np.cos(angle), np.sin(angle)])

    (node,) = at_value(Plane(circle), points, 0.0)
    first, second = at_value(Plane(circle), points, np.sin(0.5))

    assert node.tolist() == [0.0, 1.0, 0.0]
    q = np.cos(0.5)
    assert [first[1], second[1]] == pytest.approx([q, -q], abs=1e-9)


def ended(key):
    return key if key <= 1.5 else np.nan


@pytest.mark.parametrize("begin", [(0.6, 0.8), (-1.0, 0.0)])
def test_a_closed_curve_is_gone_round_once(begin):
    """It was gone round again and again, in both directions."""
    curve = Plane(circle)
    window = np.array([(-2.0, 2.0), (-2.0, 2.0)])
    Z, tangent, stopped = follow_both_directions(curve, curve.through(*begin), window)
    assert stopped == ("closed", "closed")
    assert Z[0] == pytest.approx(Z[-1], abs=1e-14)
    angles = np.unwrap(np.arctan2(Z[:, 2], Z[:, 1]))
    assert (
        abs(angles[-1] - angles[0]) == pytest.approx(2 * np.pi)
        and len(set(np.sign(np.diff(angles)))) == 1
    )
    # Each turning point once.
    turns = [turning(curve, a, b, 2) for a, b in pairs(Z, tangent)]
    assert sorted(turn[0][2] for turn in turns if turn is not None) == pytest.approx(
        [-1.0, 1.0]
    )
    # One that leaves the window ends there, though it would close.
    arc, _, stopped = follow_both_directions(
        curve, curve.through(*begin), np.array([(-2.0, 0.9), (-2.0, 2.0)])
    )
    assert stopped == ("border", "border")
    assert arc[[0, -1], 1] == pytest.approx([0.9, 0.9])


def test_a_long_curve_is_followed_to_the_border():
    """It ended after 300 points, without a word."""
    curve = Plane(lambda q, key: (key - np.sin(q) / 4, [-np.cos(q) / 4, 1.0]))
    Z, _, stopped = follow_both_directions(
        curve, curve.through(1.0, 0.2), np.array([(-40.0, 40.0), (-1.0, 1.0)])
    )
    assert Z[[0, -1], 1] == pytest.approx([-40.0, 40.0])
    assert stopped == ("border", "border")


def test_a_curve_that_is_lost_says_so():
    curve = Plane(lambda q, key: (ended(key) - q, [-1.0, 1.0]))
    Z, _, stopped = follow_both_directions(
        curve, curve.through(1.0, 1.0), np.array([(0.0, 2.0), (0.0, 2.0)])
    )
    assert stopped == ("border", "no further point")
    assert Z[-1, 2] == pytest.approx(1.5, abs=1e-3)
    # One that begins on the border has its first point there.
    Z, _, stopped = follow_both_directions(
        curve, curve.through(0.0, 0.0), np.array([(0.0, 1.0), (0.0, 2.0)])
    )
    assert stopped == ("border", "border") and Z[0, 2] == 0.0


@pytest.mark.parametrize(
    ("walker", "key", "high", "slope"),
    [
        ("E", "foot_mass_ratio", 0.1, 0.015088437941119463562),
        ("A", "m_h", 1.0, None),
        (
            "D",
            "R",
            0.5,
            0.015088437941119463562,
        ),  # a point foot's map has two dimensions; it raised ValueError
    ],
)
def test_a_curve_reaches_a_border_beyond_which_there_is_no_walker(
    walker, key, high, slope
):
    """Differences over the key need walkers on either side: curves ended before, as if
    they could not be continued.
    """
    line, own = {"walker": walker, "set": {key: 0.5 * high}}, ((key, 0.5 * high),)
    options = {
        "slope": np.array([0.01, 0.1]),
        "key": key,
        "from": 0.0,
        "to": high,
        "kinds": ["flip"],
    }
    curves = curve({"line": line, **options}, [_atlas(walker, own)])
    (end,) = np.flatnonzero(curves["curves/value"] == 0.0)
    assert curves["curves/stopped"][end] == "border" and curves["curves/walks"].all()
    if slope is None:
        problem, found = branches(walker, **{key: 0.0})
        points = [
            point for branch in found for point in special_points(problem, branch)
        ]
        (slope,) = [point["slope"] for point in points if point["kind"] == "flip"]
    assert curves["curves/slope"][end] == pytest.approx(slope, rel=1e-12)


def refused_across_axes(monkeypatch, from_farther_than):
    """Points in planes across an axis are found from very near only."""
    plain = curves.correct_on_curve

    def shy(equations, X, border):
        point = plain(equations, X, border)
        is_far = np.abs(equations.at(X).residual).max() > from_farther_than
        if np.count_nonzero(border) == 1 and is_far:
            point.ok[:] = False
        return point

    monkeypatch.setattr(curves, "correct_on_curve", shy)


def wave(q, key):
    return key - np.sin(3 * q) / 4, [-0.75 * np.cos(3 * q), 1.0]


def test_a_step_beyond_the_window_from_which_the_border_is_not_found_is_shortened(
    monkeypatch,
):
    """The curve ended before the border, as if it could be continued no further."""
    window = np.array([(-2.0, 2.0), (-1.0, 2.0)])
    first = Plane(wave).through(1.0, np.sin(3) / 4)
    plain = follow_both_directions(Plane(wave), first, window)
    with monkeypatch.context() as patched:
        refused_across_axes(patched, 1e-7)
        shy = follow_both_directions(Plane(wave), first, window)
    assert plain[2] == shy[2] == ("border", "border")
    assert len(shy[0]) > len(plain[0])
    np.testing.assert_allclose(shy[0][[0, -1]], plain[0][[0, -1]], atol=1e-12)
    # Where no step finds it, that is said.
    refused_across_axes(monkeypatch, -1.0)
    *_, stopped = follow_both_directions(Plane(wave), first, window)
    assert stopped[1] == "no further point"


@pytest.mark.parametrize("side", [0, 1])
def test_a_turning_point_is_that_end_of_its_bracket_whose_tangent_changes_sign_by_rounding(
    side,
):
    """Corrected anew, both tangents had one sign: it raised."""
    curve = Plane(circle)
    found = [
        corrected(
            curve,
            np.array([0.0, np.cos(a), np.sin(a)]),
            np.array([0.0, -np.sin(a), np.cos(a)]),
        )
        for a in (1e-13, 0.2)
    ]
    ends = [
        (p.Z[:, 0], p.oriented(np.array([[0.0], [-1.0], [1.0]])).direction[:, 0].copy())
        for p in found
    ]
    # Just beyond where q is largest it falls; by rounding it seemed to rise.
    ends[0][1][1] *= -1
    assert ends[0][1][1] > 0 > ends[1][1][1]
    Z, error = turning(curve, *(ends if side == 0 else ends[::-1]), 1)
    assert pytest.approx([0.0, 1.0, 0.0], abs=1e-12) == Z and error < 1e-10


@pytest.mark.parametrize(
    ("measure", "value"), [("froude_speed", 0.15), ("foot_clearance", -0.005)]
)
def test_gaits_on_a_curve_of_a_level_have_that_value(measure, value):
    """Each is solved again as a gait at its slope and value of the key; where a foot
    begins to scuff deeper than a height is such a curve.
    """
    params = {"line": LINE, "slope": np.array([1e-3, 0.1]), "key": "R"}
    params |= {"from": 0.15, "to": 0.25, "kinds": [], "levels": {measure: value}}

    found = curve(params, [_atlas("C", ())])

    walking = np.flatnonzero(found["curves/walks"])
    rows = walking[[0, len(walking) // 2, -1]]
    assert {*found["curves/kind"]} == {f"{measure} = {value:g}"}
    for row in rows.tolist():
        slope, radius = found["curves/slope"][row], found["curves/value"][row]
        solved = gaitsweep.gaits("C", slope, R=radius, variables=[measure])
        off = np.nanmin(np.abs(solved[measure].values - value))
        assert off < 1e-11 * abs(value)
    # At either end the curve meets the window's border.
    assert found["curves/error_bound"][rows].max() < 1e-11


def test_the_bound_on_the_slope_of_a_level_holds_against_a_gait_at_that_value():
    params = {"line": LINE, "slope": np.array([1e-3, 0.1]), "key": "R"}
    params |= {"from": 0.1, "to": 0.3, "kinds": [], "levels": {"speed": 0.4}}
    found = curve(params, [_atlas("C", ())])
    row = len(found["curves/slope"]) // 2

    radius = found["curves/value"][row]
    solved = gaitsweep.solve("C", at={"speed": 0.4}, R=radius)

    off = np.abs(solved["slope"] / found["curves/slope"][row] - 1).min()
    assert off <= found["curves/error_bound"][row]


def test_levels_of_what_is_no_measure_of_the_walker_are_refused():
    params = {"line": {"walker": "B", "set": {}}, "slope": np.array([1e-3, 0.1])}
    params |= {"key": "R", "from": 0.1, "to": 0.3, "kinds": []}
    params |= {"levels": {"kneestrike_time": 1.0}}

    with pytest.raises(WalkerError, match="`levels` must be a measure of its gaits"):
        curve(params, [_atlas("B", ())])


#: A flip of A, at its own R.
FLIP_OF_A = 0.0642752107346758


def curves_of_a(slopes, **options):
    """The tables of curves of A over R."""
    asked = {"line": {"walker": "A", "set": {}}, "slope": np.array(slopes)}
    asked |= {"key": "R", "from": 0.2, "to": 0.3, "kinds": [], **options}
    return curve(asked, [_atlas("A", ())])


def test_a_curve_that_leaves_its_window_at_once_is_its_start():
    """It begins on the borders of slope and key, and leads beyond both."""
    for high in (FLIP_OF_A * (1 + 1e-14), FLIP_OF_A * (1 - 1e-14)):
        found = curves_of_a([0.01, high], kinds=["flip"])

        assert found["curves/value"].tolist() == [0.2]
        assert found["curves/slope"][0] == pytest.approx(FLIP_OF_A, rel=1e-12)
        assert found["curves/stopped"].tolist() == ["border"]


def test_where_no_curve_begins_it_is_told_what_there_is():
    found = curves_of_a(
        [0.01, 0.04],
        kinds=["flip", "neimark_sacker"],
        levels={"froude_speed": 9.0, "stance_angle": 0.3},
        onsets=["stance_knee_unlocks"],
    )

    assert set(found["curves/kind"]) == {"stance_angle = 0.3"}
    (reason,) = found["partly/reason"]
    where = "was found at `R` = 0.2, 0.3 and slopes from 0.01 to 0.04"
    assert f"`flip` to start a curve from {where}: such points are at" in reason
    assert "slopes 0.0642752; 0.11165" in reason
    assert f"`neimark_sacker` to start a curve from {where}." in reason
    assert f"`froude_speed = 9` to start a curve from {where}: values of the" in reason
    speed = re.findall(r"values of the measure are (\S+) to (\S+)\.$", reason)
    slow, fast = map(float, speed[0])
    assert 0.1 < slow < 0.2 < fast < 0.4
    assert reason.startswith("`stance_knee_unlocks` begins nowhere: ")


@pytest.mark.thorough
def test_a_curve_ends_on_a_border_beyond_which_there_is_no_walker_and_in_a_corner():
    """A border was missed by rounding, where a mass is negative: the line was lost."""
    asked = {"line": {"walker": "A", "set": {}}, "slope": np.array([FLIP_OF_A])}
    asked |= {"plane": {"R": [0.2, 0.3], "m_h": [0.0, 1.0]}, "kinds": ["flip"]}

    found = curve(asked, [{}])

    assert found["curves/value"][0] == 0.2
    ends = found["curves/other_value"][[0, -1]]
    # Both borders meet in the corner but for rounding.
    assert ends.tolist() == pytest.approx([0.0, 1.0], abs=1e-12)
    assert ends.min() >= 0
    assert found["curves/stopped"][[0, -1]].tolist() == ["border", "border"]
