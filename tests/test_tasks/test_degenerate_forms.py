"""Generalised flips and Chenciner points: where flips and Neimark-Sacker points change
from super- to subcritical, against gaits of two steps and differences in 113 bits.
"""

import numpy as np
import pytest

from gaitsweep.tasks.branches import degenerate_forms
from gaitsweep.tasks.branches.conditions import CONDITIONS
from gaitsweep.tasks.branches.curves import across_last
from gaitsweep.tasks.branches.degenerate_forms import Bounded, degeneracies
from gaitsweep.tasks.branches.equations import (
    Equations,
    Keys,
    correct_on_curve,
    slope_error,
    solve,
)
from gaitsweep.tasks.branches.meetings import followed
from gaitsweep.tasks.branches.normal_forms import NormalForm, normal_form
from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.studies.follow_curves import curve
from gaitsweep.tasks.walkers.resolve import resolve
from lines import _atlas
from test_tasks.test_meetings import PAIR
from test_tasks.test_normal_forms import by_doubled, exact_form

SLOW, LONG = pytest.mark.thorough, pytest.mark.soak
#: A flip of E beside its generalised flip: similarity coordinates, event time, ln slope
#: and the foot mass ratio.
FLIP = np.array([-3.399023738, -4.697040962, 1.154867451, -1.818180015, 0.47])


def curve_of(kind, known, walker_at, name, ends, log_slopes):
    """A kind's curve over a key, through a point beside it."""
    keys = Keys.of_one(name, walker_at, *ends)
    equations = Equations(keys, [CONDITIONS[kind]])
    guess = np.append(known[:-1], known[-1] / keys.scale)[:, None]
    first = correct_on_curve(equations, guess, across_last(len(guess)))
    window = np.array([log_slopes, np.array(ends) / keys.scale])
    return followed(equations, kind, first, window, {"flip": CONDITIONS["flip"]})


def beside(found, value):
    """The walker at a value of a curve's key, and its point of the curve."""
    (meeting,) = vanishing(found)
    problem = Problem(found.equations.keys.walker_at(value))
    equations = Equations(problem, found.equations.conditions)
    Z, _ = found.equations.split(meeting.X[:, None])
    return problem, solve(equations, Z).Z[:, 0]


def vanishing(found):
    names = "generalised flip", "Chenciner point"
    return [each for each in found.meetings if each.name in names]


def key_of(found):
    """The key at the point, and the bound on its error."""
    (meeting,) = vanishing(found)
    scale = found.equations.keys.scale[0]
    return meeting.X[-1] * scale, meeting.error[-1] * scale


@pytest.fixture(scope="module")
def flips():
    """Flips of E around the generalised one."""
    return curve_of(
        "flip",
        FLIP,
        lambda value: resolve("E", {"foot_mass_ratio": value}),
        "foot_mass_ratio",
        (0.466, 0.475),
        (-2.2, -1.5),
    )


@pytest.fixture(scope="module")
def pairs():
    """Neimark-Sacker points of C without hip mass, up to the resonance 1:2."""
    return curve_of(
        "neimark_sacker",
        PAIR,
        lambda value: resolve("C", {"m_h": 0.0, "detuning": value}),
        "detuning",
        (1.0, 3.0),
        (-2.0, -1.0),
    )


def test_a_flip_of_e_is_generalised_where_gaits_of_two_steps_change_sides(flips):
    """Their coefficient, along the branches that begin at flips of other walkers,
    vanishes there.
    """
    (meeting,) = vanishing(flips)
    assert meeting.name == "generalised flip" and meeting.meets == ""

    value, error = key_of(flips)
    aside = np.array([-2.0, -1.0, 1.0, 2.0])
    b = [by_doubled(*beside(flips, value + 1e-3 * each))[0] for each in aside]

    roots = np.roots(np.polyfit(aside, b, 3))
    nearest = roots[np.abs(roots).argmin()]
    assert b[0] < 0 < b[-1]
    assert 1e-3 * abs(nearest) < 3e-6
    assert error < 1e-7


@pytest.mark.parametrize("curves", ["flips", pytest.param("pairs", marks=SLOW)])
def test_beyond_its_bound_the_sign_is_that_of_either_side(curves, request):
    found = request.getfixturevalue(curves)
    (condition,) = found.equations.conditions
    value, error = key_of(found)

    signs = []
    for aside in (-4 * error, 4 * error):
        problem, Z = beside(found, value + aside)
        off = slope_error(problem, condition, Z)
        form = normal_form(problem, condition.name, Z, off)
        signs.append(form.criticality(condition.name))

    assert sorted(signs) == ["subcritical", "supercritical"]


@SLOW
@pytest.mark.parametrize("curves", ["flips", pytest.param("pairs", marks=LONG)])
def test_in_113_bits_the_coefficient_changes_its_sign_within_the_bound(curves, request):
    found = request.getfixturevalue(curves)
    (condition,) = found.equations.conditions
    value, error = key_of(found)

    signs = []
    for aside in (-error, error):
        problem, Z = beside(found, value + aside)
        signs.append(np.sign(exact_form(problem, condition.name, Z)))

    assert sorted(signs) == [-1, 1]


@SLOW
def test_before_a_resonance_at_which_a_curve_ends_a_chenciner_point_is_found(pairs):
    (meeting,) = vanishing(pairs)
    resonance = next(each for each in pairs.meetings if each.name == "resonance 1:2")

    assert meeting.name == "Chenciner point"
    assert key_of(pairs)[0] == pytest.approx(2.05231923, abs=1e-8)
    assert meeting.X[-1] < resonance.X[-1]
    # No point of the curve beyond it tells the other sign.
    kinds = {each.form.criticality("neimark_sacker") for each in pairs.bounds}
    assert kinds == {"subcritical", ""}


@LONG
def test_over_two_keys_at_its_slope_lies_the_same_generalised_flip():
    """At the foot's radius that the plane has there."""
    asked = {"line": {"walker": "E", "set": {}}, "slope": np.array([0.165])}
    plane = {"foot_mass_ratio": (0.467, 0.475), "R": (0.0, 0.02)}
    found = curve({**asked, "plane": plane, "kinds": ["flip"]}, [])
    (k,) = np.flatnonzero(found["meetings/point"] == "generalised flip")
    ratio, radius = (found[f"meetings/{c}"][k] for c in ("value", "other_value"))

    own = {"R": float(radius), "foot_mass_ratio": 0.47}
    asked = {"line": {"walker": "E", "set": own}, "slope": np.array([0.1, 0.2])}
    key = {"key": "foot_mass_ratio", "from": 0.467, "to": 0.475}
    other = curve(
        {**asked, **key, "kinds": ["flip"]}, [_atlas("E", tuple(own.items()))]
    )

    (k,) = np.flatnonzero(other["meetings/point"] == "generalised flip")
    assert other["meetings/slope"][k] == pytest.approx(0.165, rel=1e-6)
    assert other["meetings/value"][k] == pytest.approx(ratio, rel=1e-6)


ROOT, GAP = 0.4703, 1e-5
NOWHERE = np.inf, np.inf
LOST = ROOT - GAP, ROOT + 2 * GAP


@pytest.fixture(scope="module")
def between(flips):
    """Two points of the curve of flips on either side of the generalised one, and the
    directions there.
    """
    ends = flips.points[[0, -1]]
    chord = ends[1] - ends[0]
    tangent = chord / np.linalg.norm(chord)
    return flips.equations, ends, np.tile(tangent, (2, 1))


def vanishing_between(between, monkeypatch, coefficient, error=1e-9, lost=NOWHERE):
    """Where a coefficient that depends on the key alone vanishes, and the bound; there
    are no points in part of the range.
    """
    equations, ends, tangents = between
    (scale,) = equations.keys.scale

    def bounded(_, X):
        key = X[-1] * scale
        if lost[0] < key < lost[1]:
            return degenerate_forms.UNKNOWN
        form = NormalForm(coefficient(key), error)
        return Bounded(1e-15, form)

    monkeypatch.setattr(degenerate_forms, "bounded", bounded)
    known = [bounded(equations, X) for X in ends]
    found = degeneracies(equations, ends, tangents, known)
    return [(each.X[-1] * scale, each.error[-1] * scale) for each in found]


@pytest.mark.parametrize("lost", [NOWHERE, LOST])
def test_a_root_where_points_are_lost_lies_within_its_bound(between, monkeypatch, lost):
    """A corrector that fails is no pole."""

    def passing(key):
        return float(key - ROOT)

    ((key, bound),) = vanishing_between(between, monkeypatch, passing, lost=lost)

    assert abs(key - ROOT) <= bound < 1e-4


@pytest.mark.parametrize("lost", [NOWHERE, LOST])
def test_a_pole_where_points_are_lost_is_no_root(between, monkeypatch, lost):
    def pole(key):
        return float(1 / (key - ROOT))

    assert not vanishing_between(between, monkeypatch, pole, lost=lost)


def test_a_jump_where_points_are_lost_is_no_root(between, monkeypatch):
    """It falls a little towards the gap on both sides."""

    def jump(key):
        off = float(key - ROOT)
        return np.sign(off) * (0.99 + abs(off))

    assert not vanishing_between(between, monkeypatch, jump, lost=LOST)


def test_a_root_is_found_beside_a_place_where_points_are_lost(between, monkeypatch):
    root = 0.468
    where_first_sought = 0.4695, 0.472

    def passing(key):
        return float(key - root)

    ((key, bound),) = vanishing_between(
        between,
        monkeypatch,
        passing,
        lost=where_first_sought,
    )

    assert abs(key - root) <= bound < 1e-8


@pytest.mark.timeout(60)
def test_a_coefficient_that_is_zero_without_an_error_is_located(between, monkeypatch):
    """The distance to points of certain sign, in errors of the coefficient, was 0, and
    the search for them had no end.
    """

    def flat(key):
        off = float(key - ROOT)
        return off if abs(off) > 1e-7 else 0.0

    ((key, bound),) = vanishing_between(between, monkeypatch, flat, error=0.0)

    assert abs(key - ROOT) <= bound < 1e-5
