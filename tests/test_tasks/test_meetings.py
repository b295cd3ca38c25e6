"""Codimension-two points: from either of the curves that meet there, by multipliers, and
a cusp in closed form.
"""

import types
from functools import partial

import numpy as np
import pytest

import extended
from gaitsweep.tasks.branches import meetings
from gaitsweep.tasks.branches.atlas import survey
from gaitsweep.tasks.branches.conditions import CONDITIONS
from gaitsweep.tasks.branches.curves import across_last
from gaitsweep.tasks.branches.equations import (
    Equations,
    Keys,
    System,
    correct_on_curve,
    solve,
)
from gaitsweep.tasks.branches.meetings import turnings
from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.studies.follow_curves import curve
from gaitsweep.tasks.studies.solve_at_slope import solve_one
from gaitsweep.tasks.walkers.resolve import resolve
from lines import _atlas
from soak.stress import random_walker


def curves_of(walker, ends, kinds, slopes, **keys):
    asked = {
        "line": {"walker": walker, "set": keys},
        "slope": np.array(slopes),
        "key": "detuning",
        "from": ends[0],
        "to": ends[1],
        "kinds": kinds,
    }
    return curve(asked, [_atlas(walker, tuple(keys.items()))])


def meeting(found, kind, point):
    """Slope, key and the bounds of both, of the one meeting of curves of a kind."""
    of_kind = found["meetings/kind"] == kind
    (k,) = np.flatnonzero(of_kind & (found["meetings/point"] == point))

    columns = ("slope", "value", "error_bound", "value_error")
    return [float(found[f"meetings/{column}"][k]) for column in columns]


def agree(one, other):
    """Whether two roads led to the same point within the sum of their bounds."""
    slope, value, slope_error, value_error = one

    assert abs(other[0] / slope - 1) < slope_error + other[2] < 1e-9
    assert abs(other[1] - value) < value_error + other[3] < 1e-9


@pytest.fixture(scope="module")
def near_a():
    kinds = ["fold", "flip"]

    return curves_of("A", (0.41, 0.43), kinds, (4e-3, 8e-3), detuning=0.42)


def test_both_curves_have_the_fold_flip(near_a):
    """Folds that turn out to flip, and flips that turn out to fold."""
    fold, flip = (meeting(near_a, kind, "fold-flip") for kind in ("fold", "flip"))

    assert fold[:2] == pytest.approx((0.005670151823, 0.42045967028), rel=1e-10)
    agree(fold, flip)


def test_a_pole_of_the_coefficient_is_no_generalised_flip(near_a):
    """Which the flips of both sides of a fold-flip have: their sign changes there."""
    is_flip = near_a["curves/kind"] == "flip"
    b = near_a["curves/normal_form"][is_flip]

    assert (np.sign(b[1:]) != np.sign(b[:-1])).sum() == 1
    assert set(near_a["meetings/point"]) == {"fold-flip"}


def test_beside_a_fold_flip_multipliers_are_nearly_1_and_minus_1(near_a):
    """Gaits solved alone, a little above and below."""
    slope, value, *_ = meeting(near_a, "flip", "fold-flip")
    asked = {"walker": "A", "set": {"detuning": value}}
    off = []
    for aside in (1 - 1e-9, 1 + 1e-9):
        solved = solve_one({**asked, "slope": slope * aside})
        for gait in solved["gaits"]:
            real = np.array(gait["multipliers"])[:, 0]
            off.append([np.abs(real - at).min() for at in (1, -1)])
    assert (np.array(off) < 1e-2).all(axis=1).any()


@pytest.mark.thorough
def test_over_two_keys_at_its_slope_lies_the_same_fold_flip(near_a):
    """At the walker's own value of the other key."""
    slope, detuning, *_ = meeting(near_a, "fold", "fold-flip")
    asked = {"line": {"walker": "A", "set": {}}, "slope": np.array([slope])}
    plane = {"detuning": (0.41, 0.43), "R": (0.19, 0.21)}

    found = curve({**asked, "plane": plane, "kinds": ["fold", "flip"]}, [])

    assert list(found["meetings/meets"]) == ["flip", "fold"]
    for column, known in (("value", detuning), ("other_value", 0.2)):
        off = np.abs(found[f"meetings/{column}"] - known)
        # The slope is known to about twelve digits, which moves both keys.
        assert (off < found[f"meetings/{column}_error"] + 1e-9).all()
        assert (found[f"meetings/{column}_error"] < 1e-10).all()


def test_a_curve_that_meets_a_level_says_which():
    asked = {
        "line": {"walker": "A", "set": {"detuning": 0.42}},
        "slope": np.array([4e-3, 8e-3]),
        "key": "detuning",
        "from": 0.415,
        "to": 0.425,
        "kinds": ["fold"],
        "levels": {"period": 0.893},
    }

    found = curve(asked, [_atlas("A", (("detuning", 0.42),))])

    of_fold = found["meetings/meets"] == "period = 0.893"

    assert of_fold.sum() == 1
    assert found["meetings/point"][of_fold] == "fold and period = 0.893"


def test_points_beyond_the_window_are_no_meetings():
    """Beyond it there may be no walker; a point on its border is put there."""

    def walker_at(detuning):
        return resolve("A", {"detuning": detuning})

    keys = Keys.of_one("detuning", walker_at, 0.41, 0.43)
    fold = CONDITIONS["fold"]
    flip = CONDITIONS["flip"]
    both = Equations(keys, [fold, flip])

    branches = survey(Problem(walker_at(0.4204)))
    on_branches = [branch.Z[:, branch.folds()] for branch in branches]
    folds = np.hstack(on_branches)
    off = np.abs(folds[-1] - np.log(0.00567))
    own = 0.4204 / keys.scale
    guess = np.append(folds[:, off.argmin()], own)
    everywhere = (-np.inf, np.inf)

    def solved(*window):
        return meetings._solved(both, guess, 1.0, np.array(window))

    point = solved(everywhere, everywhere)

    assert point[-1] * keys.scale == pytest.approx(0.42045967028, rel=1e-10)

    below = (-np.inf, point[-1] - 1e-9)
    above = (point[-2] + 1e-9, np.inf)

    assert solved(everywhere, below) is None
    assert solved(above, everywhere) is None

    border = point[-1] - 1e-12
    on_border = solved(everywhere, (-np.inf, border))

    assert on_border[-1] == border


@pytest.mark.thorough
def test_two_ends_of_walking_meet():
    """Where kneestrike meets heelstrike, heelstrike turns tangential too: of gaits solved
    alone one begins there, whose strikes coincide and whose multiplier grows as the
    inverse of the distance.
    """
    ends = "end_kneestrike_at_heelstrike", "end_tangential_heelstrike"
    found = curves_of("C", (0.12, 0.2), [ends[0]], (1e-3, 0.02), detuning=0.2)
    slope, value, *bounds = meeting(found, ends[0], " and ".join(ends))

    assert max(bounds) < 1e-9

    asked = {"walker": "C", "set": {"detuning": value}}
    (below,) = solve_one({**asked, "slope": slope * (1 - 1e-6)})["gaits"]

    assert below["kneestrike_time"] < 0.7 * below["period"]
    largest = []
    for distance in (1e-6, 1e-4):
        _, gait = solve_one({**asked, "slope": slope * (1 + distance)})["gaits"]
        late = gait["period"] - gait["kneestrike_time"]
        assert 0 < late < distance * gait["period"]
        largest.append(gait["multipliers"][0][0])
    assert largest[0] / largest[1] == pytest.approx(100, rel=0.01)


@pytest.mark.thorough
def test_curves_of_folds_and_of_complex_pairs_have_the_resonance():
    kinds = ["fold", "neimark_sacker"]
    keys = {"m_h": 0.0, "detuning": 1.21}
    found = curves_of("C", (1.1, 1.25), kinds, (0.1, 0.3), **keys)

    fold, pair = (meeting(found, kind, "resonance 1:1") for kind in kinds)

    assert fold[:2] == pytest.approx((0.172984691440933, 1.19212658779289), rel=1e-11)
    agree(fold, pair)

    # Beyond it the multipliers are real: the curve of pairs ends there.
    of_pairs = found["curves/kind"] == "neimark_sacker"

    assert list(found["curves/stopped"][of_pairs][[0, -1]]) == [
        "resonance 1:1",
        "border",
    ]

    assert found["curves/value"][of_pairs][0] == pair[1]
    assert (found["curves/value"][of_pairs][1:] > pair[1]).all()


#: A Neimark-Sacker point of C without hip mass beyond the machine, between the resonances
#: 1:4 and 1:3: stance angle and rates before heelstrike over it, event times, ln slope,
#: detuning.
PAIR = np.array(
    [
        -0.554156881,
        -1.785239014,
        -1.109843987,
        2.379930935,
        2.418017046,
        -1.4648617,
        1.9,
    ]
)


def pairs_of_c():
    """The curve of Neimark-Sacker points through `PAIR`, between two detunings."""
    ends = 1.78, 1.99
    keys = Keys.of_one(
        "detuning", lambda value: resolve("C", {"m_h": 0.0, "detuning": value}), *ends
    )
    curve = Equations(keys, [CONDITIONS["neimark_sacker"]])
    guess = np.append(PAIR[:-1], PAIR[-1] / keys.scale)[:, None]
    first = correct_on_curve(curve, guess, across_last(len(guess)))
    window = np.array([[-3.0, -1.0], ends / keys.scale])
    return meetings.followed(curve, "neimark_sacker", first, window, {})


@pytest.fixture(scope="module")
def pairs():
    return pairs_of_c()


RESONANCES = pytest.mark.parametrize(
    ("name", "order", "place"),
    [
        ("resonance 1:3", 3, (0.24178078952527, 1.9685639632906)),
        ("resonance 1:4", 4, (0.218533662008902, 1.80762720448207)),
    ],
)


@RESONANCES
def test_at_a_strong_resonance_the_pair_is_a_root_of_one(pairs, name, order, place):
    """The multipliers are those of a gait solved at its slope and detuning."""
    (point,) = [each for each in pairs.meetings if each.name == name]

    log_slope, detuning = point.X[-2:] * [1.0, *pairs.equations.keys.scale]
    assert (np.exp(log_slope), detuning) == pytest.approx(place, rel=1e-11)
    assert (point.error < 1e-12).all() and point.meets == ""
    problem = Problem(resolve("C", {"m_h": 0.0, "detuning": detuning}))
    at_slope = Equations(problem, [CONDITIONS["window"].equal_to(log_slope)])
    alone = solve(at_slope, point.X[:-1, None])
    multipliers = np.linalg.eigvals(alone.at.jacobians[0])
    assert np.abs(multipliers - np.exp(2j * np.pi / order)).min() < 1e-9
    # The pair is complex on both sides: the curve does not end there.
    assert pairs.stopped == ("border", "border")


@RESONANCES
@pytest.mark.thorough
def test_strong_resonances_are_those_of_another_derivation(pairs, name, order, place):
    """In 113 bits, by Lagrange's equations and the momentum of a floating walker."""
    (point,) = [each for each in pairs.meetings if each.name == name]
    slope, detuning = place
    table = resolve("C", {"m_h": 0.0, "detuning": detuning}).table()
    problem = pairs.equations.problem_at(point.X[:, None]).alone(0)
    Z = point.X[:-1]
    y, scale = problem.section(Z[:, None])
    state = problem.start(y * scale, np.exp(Z[-1:]))[:, 0]
    unit = problem.walker.time_unit

    guess = [state[0], *(state[1:] / unit), *(Z[problem.m : -1] * unit)]
    found = extended.gait(table, repr(slope), [repr(float(x)) for x in guess])

    values = [complex(float(re), float(im)) for re, im in found["multipliers"]]
    # Its slope and detuning are known to some thirteen digits.
    assert np.abs(np.array(values) - np.exp(2j * np.pi / order)).min() < 1e-10


def at_tangential_kneestrike():
    """A walker, and the end of a branch of its gaits at which kneestrike is tangential:
    unknowns Z.
    """
    kind = "end_tangential_kneestrike"
    walker = random_walker("kneed, near", 336)
    (branch,) = [each for each in survey(Problem(walker)) if kind in each.why]
    return walker, branch.Z[:, -branch.why.index(kind)]


@pytest.mark.thorough
def test_tangential_kneestrikes_meet_neither_folds_nor_flips_by_rounding():
    """Determinants vanish all along the curve: folds were met at every second sample."""
    walker, Z = at_tangential_kneestrike()
    ends = 0.995 * walker.c_t, 1.005 * walker.c_t
    keys = Keys.of_one("c_t", partial(walker.having, "c_t"), *ends)
    kind = "end_tangential_kneestrike"
    curve = Equations(keys, [CONDITIONS[kind]])
    guess = np.append(Z, walker.c_t / keys.scale)[:, None]
    first = correct_on_curve(curve, guess, across_last(len(guess)))
    window = np.array([[-9.0, 0.0], ends / keys.scale])

    found = meetings.followed(curve, kind, first, window, meetings.met({}, True))

    assert len(found.points) > 5 and found.stopped == ("border", "border")
    assert not found.meetings


def unknown_near(x, at):
    """1, and NaN at the sample at a place."""
    return np.where(np.isclose(x, at), np.nan, 1.0)


@pytest.mark.parametrize(
    ("scalar", "roots"),
    [
        (lambda x: x - 0.3, [0.3]),
        # At a sample, at a point, and at both ends.
        (lambda x: x - 0.25, [0.25]),
        (lambda x: x - 1.0, [1.0]),
        (lambda x: x * (x - 3.0), [0.0, 3.0]),
        # Beside samples that have no value.
        (lambda x: (x - 1.1) * unknown_near(x, 1.25), [1.1]),
        (lambda x: (x - 1.1) * unknown_near(x, 1.0), [1.1]),
        # Two between neighbouring samples, inside and beside an end.
        (lambda x: (x - 1.3) * (x - 1.45), [1.3, 1.45]),
        (lambda x: (x - 1.37) * (x - 1.38) * np.exp(x), [1.37, 1.38]),
        (lambda x: (x - 0.05) * (x - 0.2), [0.05, 0.2]),
        # None: a pair of complex roots, a constant, and what vanishes everywhere.
        (lambda x: (x - 1.3) ** 2 + 0.01, []),
        (lambda x: 0 * x + 1, []),
        (lambda x: 0 * x, []),
        (lambda x: np.nan * x, []),
    ],
)
def test_a_curve_meets_a_condition_wherever_its_scalar_vanishes(
    monkeypatch, scalar, roots
):
    """Of a straight curve of three segments, on which points are what is guessed."""
    points = np.array([[0.0, k] for k in range(4)])
    tangents = np.tile([0.0, 1.0], (4, 1))

    curve = types.SimpleNamespace(
        conditions=(types.SimpleNamespace(name="own", value=None),),
        evaluate=lambda X: X[-1],
        having=lambda conditions: None,
    )
    other = types.SimpleNamespace(
        value=scalar,
        residual=scalar,
        target=0.0,
        name="level",
    )

    monkeypatch.setattr(meetings, "_solved", lambda both, guess, *_: guess)
    monkeypatch.setattr(meetings, "errors", lambda both, X, n: np.zeros(n))

    met = meetings.meetings(curve, points, tangents, "own", {"other": other}, None)
    found = list(met)

    # Guesses are linear between samples.
    places = [each.X[-1] for each in found]
    assert places == pytest.approx(roots, abs=0.05)
    assert [each.segment for each in found] == [min(int(x), 2) for x in roots]


@pytest.mark.parametrize(
    ("name", "target", "size", "count"),
    [
        ("level", 1e-14, 1e-14, 1),
        ("level", 0.0, 1e-14, 1),
        ("level", 1.0, 1e-9, 0),
        ("fold", 0.0, 1e-3, 1),
        ("fold", 0.0, 1e-14, 0),
    ],
)
def test_what_is_rounding_of_a_condition_depends_on_its_units(
    monkeypatch, name, target, size, count
):
    """A level has the walker's; conditions of this package have none."""
    points = np.array([[0.0, k] for k in range(4)])
    tangents = np.tile([0.0, 1.0], (4, 1))

    def off(x):
        return size * (x - 1.4)

    other = types.SimpleNamespace(value=off, residual=off, target=target, name=name)
    curve = types.SimpleNamespace(
        conditions=(types.SimpleNamespace(name="own", value=None),),
        evaluate=lambda X: X[-1],
        having=lambda conditions: None,
    )
    monkeypatch.setattr(meetings, "_solved", lambda both, guess, *_: guess)
    monkeypatch.setattr(meetings, "errors", lambda both, X, n: np.zeros(n))

    met = meetings.meetings(curve, points, tangents, "own", {"other": other}, None)

    assert len(list(met)) == count


def test_a_curve_that_leaves_its_window_at_once_meets_nothing():
    points, tangents = np.array([[0.0, 1.0]]), np.array([[0.0, 1.0]])
    assert not list(meetings.meetings(None, points, tangents, "own", {}, None))


#: Slope of the cusp below, and how it moves with the key.
SLOPE, TILT = -3.0, 0.5


class Cubic:
    """Folds of x^3 + key x = ln slope - SLOPE - TILT key, in X = (x, ln slope, key)."""

    conditions = (types.SimpleNamespace(name="fold"),)
    problem = types.SimpleNamespace(m=1, phases=0)
    size = 3

    def some(self, lanes):
        return self

    def at(self, X, difference=None, samples=0):
        x, q, key = X
        one = np.ones_like(x)
        by_x = 3 * x**2 + key
        off = x**3 + key * x - (q - SLOPE - TILT * key)
        of_gait = [by_x, -one, x + TILT]
        of_fold = [6 * x, 0 * one, one]
        by_X = np.array([of_gait, of_fold])
        return System(X, np.array([off, by_x]), by_X, None)


@pytest.mark.parametrize(
    ("first", "node"),
    [
        pytest.param(-0.7, None, id="between points"),
        pytest.param(-0.75, (0.0, 0.0), id="at a point"),
        # By rounding the slope turns before the point and the key beyond it.
        pytest.param(-0.75, (-1e-16, 1e-16), id="on both sides of a point"),
        pytest.param(-0.75, (0.0, 1e-16), id="at a point and beyond it"),
    ],
)
def test_a_cusp_is_where_a_curve_of_folds_turns_in_slope_and_key(first, node):
    # At x = -TILT the slope turns alone.
    x = np.linspace(first, 0.25, 9 if node else 14)
    key = -3 * x**2
    slope = SLOPE + x**3 + key * x + TILT * key
    slope_by_x = -6 * x**2 - 6 * x * TILT
    points = np.array([x, slope, key]).T
    tangents = np.array([0 * x + 1, slope_by_x, -6 * x]).T
    tangents /= np.linalg.norm(tangents, axis=1)[:, None]
    if node:
        tangents[np.abs(x).argmin(), 1:] = node

    turned, (cusp,) = turnings(Cubic(), points, tangents)

    # The key turns nowhere else.
    (alone,) = turned
    assert alone.component == -2 and alone.X[0] == pytest.approx(-TILT, abs=1e-6)
    assert cusp.name == "cusp"
    off = np.abs(cusp.X - [0.0, SLOPE, 0.0])
    assert off[0] < 1e-9
    assert (off[1:] <= cusp.error).all() and (cusp.error < 1e-9).all()
