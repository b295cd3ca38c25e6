"""Normal forms of flips and Neimark-Sacker points: against gaits of twice as many steps,
steps one after another, and differences in 113 bits.
"""

import heyoka as hy
import numpy as np
import pytest

from exact_special_points import _precise, exact_slope
from gaitsweep.tasks.branches.conditions import CONDITIONS
from gaitsweep.tasks.branches.equations import Equations, slope_error, solve
from gaitsweep.tasks.branches.flips import doubled
from gaitsweep.tasks.branches.joint import evaluate
from gaitsweep.tasks.branches.normal_forms import NONE, NormalForm, normal_form
from gaitsweep.tasks.branches.special_points import flips, special_points
from gaitsweep.tasks.mechanics.lumped import lump
from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.step.several_steps import from_largest, sections
from gaitsweep.tasks.studies.follow_branches import branch
from gaitsweep.tasks.studies.follow_curves import curve
from gaitsweep.tasks.studies.follow_cycles import cycle_branches
from gaitsweep.tasks.walkers.resolve import resolve
from lines import _atlas, branches, some

SLOW = pytest.mark.thorough
#: A Neimark-Sacker point of C without hip mass, detuned: similarity coordinates, event
#: times and ln slope.
PAIR = [
    -0.5541568812,
    -1.785239014,
    -1.1098439866,
    2.379930935,
    2.418017046,
    -1.4648617,
]
DETUNED = {"m_h": 0.0, "detuning": 1.9}
#: Weights of differences over eight points.
FIRST = 4 / 5, -1 / 5, 4 / 105, -1 / 280
SECOND = 8 / 5, -1 / 5, 8 / 315, -1 / 560


def located(walker, **keys):
    """The walker's problem, and its flips: unknowns Z with their bounds."""
    problem, found = branches(walker, **keys)

    points = []
    for each in found:
        points += special_points(problem, each)
    of_flips = [point for point in points if point["kind"] == "flip"]

    bounded = [(np.array(flip["Z"]), flip["error_bound"]) for flip in of_flips]
    return problem, bounded


def pair():
    """A walker's problem, and a Neimark-Sacker point with its bound."""
    problem = Problem(resolve("C", DETUNED))
    condition = CONDITIONS["neimark_sacker"]
    equations = Equations(problem, [condition])
    guess = np.array(PAIR)[:, None]

    Z = solve(equations, guess).Z[:, 0]
    error = slope_error(problem, condition, Z)
    return problem, Z, error


def at_slope(problem, log_slope, Z):
    """The gait of that ln slope, evaluated, from one beside it."""
    condition = CONDITIONS["window"].equal_to(log_slope)
    equations = Equations(problem, [condition])
    return solve(equations, Z[:, None]).at


def by_doubled(problem, Z):
    """The coefficient of a flip by a gait of twice as many steps beside it, whose halves
    begin at angles that differ by 2 xi: -1 - multiplier = b xi^2; and the largest
    multiplier of that gait.
    """
    flip = evaluate(problem, Z[:, None])
    point, *_ = some([doubled(flip, 1e-5)])[0]
    y, _ = sections(point.at.w, point.at.m, 2 * problem.steps)
    first = y[0, 0, 0]
    second = y[problem.steps, 0, 0]
    xi = (first - second) / (first + second)

    single = at_slope(problem, point.Z[-1, 0], Z).multipliers[0]
    nearest = single[np.abs(single + 1).argmin()].real
    largest = np.abs(point.at.multipliers[0]).max()
    return (-1 - nearest) / xi**2, largest


@pytest.mark.parametrize(
    ("walker", "keys", "expected"),
    [
        ("D", {}, ["supercritical"]),
        ("E", {"foot_mass_ratio": 0.3}, ["subcritical"]),
        pytest.param("A", {}, ["supercritical"], marks=SLOW),
        pytest.param("C", {}, ["supercritical"], marks=SLOW),
        pytest.param(
            "physical",
            {},
            ["subcritical", "supercritical", "supercritical"],
            marks=SLOW,
        ),
    ],
)
def test_gaits_of_two_steps_beside_a_flip_have_the_coefficient(walker, keys, expected):
    """And are stable, if the flip is where the gait becomes unstable, where it is
    supercritical.
    """
    problem, points = located(walker, **keys)

    found = [normal_form(problem, "flip", Z, error) for Z, error in points]

    assert [form.criticality("flip") for form in found] == expected
    for form, (Z, _) in zip(found, points, strict=True):
        b, largest = by_doubled(problem, Z)
        assert form.coefficient == pytest.approx(b, rel=5e-3)
        multipliers = evaluate(problem, Z[:, None]).multipliers[0]
        others = np.sort(np.abs(multipliers))
        if others[-2:].max() < 1 + 1e-6:
            assert (largest < 1) == (form.criticality("flip") == "supercritical")


@SLOW
def test_flips_of_gaits_of_two_steps_have_the_coefficient_of_the_larger_step():
    problem, found = branches("D")
    twice = problem.of_steps(2)
    begun = cycle_branches(problem, found, 2)
    second = []
    for each in begun:
        second += flips(twice, each)

    for each in some(second):
        w = from_largest(each.w, twice.m, 2)
        Z = np.append(w[:, 0], each.q)
        form = normal_form(twice, "flip", each.Z[:, 0], 1e-12)
        b, _ = by_doubled(twice, Z)
        assert form.coefficient == pytest.approx(b, rel=5e-3)


def after_steps(problem, y, Z, count):
    """Sections (m, n) one step after another from y, at the slope of a gait Z."""
    n = y.shape[1]
    _, scale = problem.section(Z[:, None])
    drive = np.full(n, np.exp(Z[-1]))
    parameters = problem.parameters(drive, np.full(n, scale[0]))
    times = np.repeat(Z[problem.m : -1, None], n, axis=1)

    for _ in range(count):
        for _ in range(4):
            stride = problem.map(y, times, parameters)
            times = stride.times
        y = stride.image
        yield y


def vectors_of_pair(A):
    """The upper multiplier's right and left vectors, of amplitudes of the stance angle."""
    values, right = np.linalg.eig(A)
    left = np.linalg.inv(right)

    upper = values.imag.argmax()
    angle = right[0, upper]
    q = right[:, [upper]] / angle
    p = 2 * left[[upper]] * angle
    return q, p


def test_steps_beside_a_pair_recede_as_the_normal_form_has_it():
    """Of r' = r + d r^3 the inverse square of r falls by 2 d each step."""
    problem, Z, error = pair()
    form = normal_form(problem, "neimark_sacker", Z, error)
    A = evaluate(problem, Z[:, None]).jacobians[0]
    q, p = vectors_of_pair(A)
    y, _ = problem.section(Z[:, None])
    phases = np.exp(2j * np.pi * np.arange(24) / 24)
    begins = y + 0.005 * y[0] * (q * phases).real

    inverse = []
    for moved in after_steps(problem, begins, Z, 40):
        r = np.abs(p @ (moved - y)) / y[0]
        inverse.append((1 / r**2).mean())

    falls = np.polyfit(np.arange(40), inverse, 1)[0]
    assert form.coefficient == pytest.approx(-falls / 2, rel=0.02)
    assert form.criticality("neimark_sacker") == "subcritical"


def test_branches_and_curves_have_the_normal_forms_of_flips():
    """Another g changes neither: both are without dimension."""
    line = {"walker": "D", "set": {}}
    known = _atlas("D", ())
    window = {"slope_from": 1e-3, "slope_to": 0.02, "n": 2}
    asked = {
        "slope": np.array([0.01, 0.02]),
        "key": "g",
        "from": 1.0,
        "to": 2.0,
        "kinds": ["flip", "fold"],
    }

    along = branch({"line": line, **window}, [known])
    over = curve({"line": line, **asked}, [known])

    is_flip = along["special_points/kind"] == "flip"
    b = along["special_points/normal_form"]
    assert b[is_flip] == pytest.approx([335.727656883], rel=1e-9)
    assert (~is_flip).any()
    assert np.isnan(b[~is_flip]).all()
    assert over["curves/normal_form"] == pytest.approx(b[is_flip][0], rel=1e-9)
    assert (over["curves/normal_form_error"] < 1e-6).all()
    assert set(along["special_points/criticality"][is_flip]) == {"supercritical"}
    assert set(over["curves/criticality"]) == {"supercritical"}


def exact_form(problem, kind, Z):
    """The coefficient by differences in 113 bits, at the point in as many."""
    number = hy.real128
    m = problem.m
    precise = _precise(problem.structure)

    slope = exact_slope(problem, kind, Z)
    exact = lump(problem.walker, number)
    constants = [exact[name] for name in problem.structure.constants]
    parameters = np.array([slope, number(1.0), *constants], dtype=number)
    section = precise.array(np.exp(Z[0]) * np.append(1.0, Z[1:m]))
    times = precise.array(Z[m:-1])
    y, step = precise.fixed_point(section, times, parameters)
    middle = step["jacobian"]

    def jacobian(shift):
        moved = y + precise.array(shift) * y[0]
        return precise.settled_stride(moved, step["times"], parameters)["jacobian"]

    def along(v):
        h = 2.0**-13
        first = 0
        second = 0
        for j, of_first, of_second in zip((1, 2, 3, 4), FIRST, SECOND, strict=True):
            more = jacobian(j * h * v)
            less = jacobian(-j * h * v)
            bend = more + less - number(2.0) * middle
            first = first + number(of_first) * (more - less)
            second = second + number(of_second) * bend

        B = np.array(first, float) / h
        C = np.array(second, float) / h**2
        return B, C

    A = np.array(middle, float)
    return (_of_flip if kind == "flip" else _of_pair)(A, along)


def _of_flip(A, along):
    values, right = np.linalg.eig(A)
    left = np.linalg.inv(right)
    nearest = np.abs(values + 1).argmin()
    q = right[:, nearest].real
    p = left[nearest].real

    B, C = along(q)
    mean = np.linalg.solve(np.eye(len(A)) - A, B @ q)
    b = p @ (C @ q) / 6 + p @ (B @ mean) / 2
    return b / q[0] ** 2


def _of_pair(A, along):
    values, right = np.linalg.eig(A)
    left = np.linalg.inv(right)
    upper = values.imag.argmax()
    turn = values[upper]
    q = right[:, upper]
    p = left[upper]

    B_real, C_real = along(q.real)
    B_imag, C_imag = along(q.imag)
    B = B_real + 1j * B_imag
    C = C_real + C_imag

    one = np.eye(len(A))
    mean = np.linalg.solve(one - A, B @ q.conj())
    double = np.linalg.solve(turn**2 * one - A, B @ q)
    terms = C @ q + 2 * B @ mean + B.conj() @ double
    return (p @ terms / turn).real / 2 / abs(2 * q[0]) ** 2


@pytest.mark.parametrize(
    ("walker", "keys"),
    [
        ("D", {}),
        pytest.param("E", {"foot_mass_ratio": 0.3}, marks=SLOW),
        pytest.param("B", {}, marks=SLOW),
        pytest.param("C", {}, marks=SLOW),
        pytest.param("physical", {}, marks=pytest.mark.soak),
    ],
)
def test_coefficients_lie_within_their_bounds_of_those_in_113_bits(walker, keys):
    problem, points = located(walker, **keys)

    for Z, error in some(points):
        form = normal_form(problem, "flip", Z, error)
        exact = exact_form(problem, "flip", Z)
        assert abs(form.coefficient - exact) < form.error
        # They are known to seven digits of the largest.
        assert form.error < 1e-7


@SLOW
def test_that_of_a_pair_lies_within_its_bound_of_that_in_113_bits():
    problem, Z, error = pair()

    form = normal_form(problem, "neimark_sacker", Z, error)

    exact = exact_form(problem, "neimark_sacker", Z)
    assert abs(form.coefficient - exact) < form.error < 1e-7


@pytest.mark.parametrize(
    ("coefficient", "error", "of_flip", "of_pair"),
    [
        (2.0, 1.0, "supercritical", "subcritical"),
        (-2.0, 1.0, "subcritical", "supercritical"),
        (1.0, 1.0, "", ""),
        (-1.0, np.inf, "", ""),
        (np.nan, np.nan, "", ""),
    ],
)
def test_a_sign_that_is_not_known_is_not_told(coefficient, error, of_flip, of_pair):
    form = NormalForm(coefficient, error)

    assert form.criticality("flip") == of_flip
    assert form.criticality("neimark_sacker") == of_pair


def test_folds_and_points_with_an_unbounded_error_have_none():
    problem, ((Z, error),) = located("D")

    assert normal_form(problem, "fold", Z, error) is NONE
    assert normal_form(problem, "flip", Z, np.inf) is NONE
