"""Bounds on the slopes of flips and folds of period n: against 113 bits, and their
linearised equations.
"""

import heyoka as hy
import numpy as np
import pytest

from exact_special_points import exact_cycle_slope, steps_of
from gaitsweep.tasks.branches.conditions import CONDITIONS
from gaitsweep.tasks.branches.equations import slope_error
from gaitsweep.tasks.branches.special_points import special_points
from gaitsweep.tasks.mechanics.lumped import lump
from gaitsweep.tasks.step.extended_precision import _extended_step_map
from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.step.several_steps import joined, sections
from gaitsweep.tasks.studies import locate_cascade
from gaitsweep.tasks.walkers.resolve import resolve
from gaitsweep.tasks.walkers.walker import WalkerError
from lines import _atlas, some
from test_tasks.test_gaits_beside_folds import drawn, followed

R = hy.real128


def family(walker, low, high, longest, first=1):
    problem, slopes = Problem(resolve(walker)), np.linspace(low, high, 3)
    start = locate_cascade._first_gaits(
        problem, problem, _atlas(walker, ()), slopes, first, 200
    )[0]
    window = np.log(low), np.log(high)
    return locate_cascade._follow_family(problem, start, window, longest).events


def wide(values):
    return np.vectorize(R, otypes=[R])(values)


def product(a, b):
    return np.array(
        [
            [sum(x * y for x, y in zip(row, column, strict=True)) for column in b.T]
            for row in a
        ],
        R,
    )


def step(exact, constants, y, times, slope):
    """Image, event times and Jacobian of a step in 113 bits, by differences
    extrapolated to fourth order.
    """
    m, z = len(y), np.concatenate([y, times])
    parameters = np.array([slope, R(1), *constants], R)

    def values(z):
        residual = exact(z[:m], z[m:], parameters)[0]
        return np.concatenate([residual[:m] + z[:m], residual[m:]])

    def difference(i, h):
        ends = [z.copy(), z.copy()]
        ends[0][i], ends[1][i] = z[i] + h, z[i] - h
        return (values(ends[0]) - values(ends[1])) / (R(2) * h)

    h = R(2) ** -30
    J = np.array(
        [
            (R(4) * difference(i, h / R(2)) - difference(i, h)) / R(3)
            for i in range(len(z))
        ],
        R,
    ).T
    base, G = values(z), J[m:, m:]
    if len(times) == 1:
        inverse = np.array([[R(1) / G[0, 0]]], R)
    else:
        inverse = np.array([[G[1, 1], -G[0, 1]], [-G[1, 0], G[0, 0]]], R) / (
            G[0, 0] * G[1, 1] - G[0, 1] * G[1, 0]
        )
    late, by_y = -product(inverse, base[m:, None]), -product(inverse, J[m:, :m])
    image = base[:m] + product(J[:m, m:], late)[:, 0]
    return image, times + late[:, 0], J[:m, :m] + product(J[:m, m:], by_y)


def determinant(a):
    if len(a) == 1:
        return a[0, 0]
    minors = [a[0, j] * determinant(np.delete(a[1:], j, 1)) for j in range(len(a))]
    return sum(x if j % 2 == 0 else -x for j, x in enumerate(minors))


def flip_in_113_bits(event):
    """Slope of a flip: the secant method on det(M + 1), the gait at each slope by
    Newton on all sections.
    """
    problem = event.gait.problem
    exact, constants = _extended_step_map(problem.structure, 1), lump(problem.walker, R)
    constants = [constants[name] for name in problem.structure.constants]
    Y, times = map(wide, steps_of(problem, event.gait.Z[:, 0]))
    m, n = Y.shape

    def test(slope):
        for _ in range(8):
            steps = [
                step(exact, constants, Y[:, i], times[:, i], slope) for i in range(n)
            ]
            matrix, residual = np.zeros((m * n, m * n)), np.zeros(m * n)
            for i, (image, _, A) in enumerate(steps):
                own, after = slice(m * i, m * i + m), m * ((i + 1) % n)
                matrix[own, own] += A.astype(float)
                matrix[own, after : after + m] -= np.eye(m)
                residual[own] = (image - Y[:, (i + 1) % n]).astype(float)
            change = -np.linalg.solve(matrix, residual).reshape(n, m).T
            late = max(
                abs(float(x)) for i in range(n) for x in steps[i][1] - times[:, i]
            )
            Y[:] = Y + wide(change)
            times[:] = np.array([each[1] for each in steps], R).T
            if max(np.abs(change).max(), late) < 1e-22:
                break
        M = wide(np.eye(m))
        for _, _, A in steps:
            M = product(A, M)
        return determinant(M + wide(np.eye(m)))

    a = R(event.slope)
    b = a * (R(1) + R(1e-10))
    at_a, at_b = test(a), test(b)
    while abs(float((b - a) / b)) > 1e-19:
        a, at_a, b = b, at_b, b - at_b * (b - a) / (at_b - at_a)
        at_b = test(b)
    return b


CASES = [
    ("D", 0.0145, 0.0195, 4),
    pytest.param("D", 0.0145, 0.0195, 16, marks=pytest.mark.soak),
    pytest.param("C", 0.07, 0.1, 4, marks=pytest.mark.soak),
    pytest.param("B", 3e-4, 0.03, 4, marks=pytest.mark.soak),
]


@pytest.mark.parametrize(("walker", "low", "high", "longest"), CASES)
def test_the_bound_of_a_flips_slope_holds_against_113_bits(
    walker, low, high, longest, tell
):
    for event in some(family(walker, low, high, longest)):
        slope = flip_in_113_bits(event)
        error = abs(float((R(event.slope) - slope) / slope))
        tell(
            f"{walker}, period {event.gait.problem.steps}: error {error:.1e}, bound {event.error:.1e}"
        )
        assert error < event.error < 1e-11


def shares(seed):
    """Errors over bounds of the folds, flips and births of the branches of a random
    walker's gaits of n steps.
    """
    walker, keys, steps, _ = drawn(seed)
    problem, branches = followed(walker, steps, **keys)
    for branch in branches:
        own = problem.of_steps(branch.steps)
        for record in special_points(own, branch):
            kind, of, Z = record["kind"], own, np.array(record["Z"])
            if kind == "branch_point":
                kind, of, Z = (
                    "flip",
                    problem.of_steps(branch.steps // 2),
                    halved(own, Z),
                )
            elif kind not in ("fold", "flip"):
                continue
            exact = exact_cycle_slope(of, kind, Z)
            slope = R(float(np.exp(Z[-1])))
            error = np.nan if exact is None else abs(float((exact - slope) / exact))
            yield kind, of.steps, error / record["error_bound"]


def halved(problem, Z):
    """A gait that repeats after half its steps as one of so many."""
    half = problem.steps // 2
    y, durations = (
        part[:half] for part in sections(Z[:-1, None], problem.m, problem.steps)
    )
    return np.append(joined(Z[:1], y, durations)[:, 0], Z[-1])


@pytest.mark.parametrize("seed", [2, 13])
def test_folds_flips_and_births_of_random_walkers_lie_within_their_bounds(seed):
    """Births had the bound of a gait's rounding at its slope, which their errors exceed
    by a third.
    """
    found = list(shares(seed))
    assert {kind for kind, *_ in found} == {2: {"flip"}, 13: {"fold", "flip"}}[seed]
    assert all(share < 1 for *_, share in found)


@pytest.mark.soak
def test_folds_flips_and_births_of_many_random_walkers_lie_within_their_bounds(
    resumed, tell
):
    for seed in resumed(60):
        try:
            found = list(shares(seed))
        except WalkerError:
            continue
        resumed.found.update(kind for kind, *_ in found)
        resumed.found["thousandths"] = max(
            resumed.found["thousandths"], *(round(1000 * s) for *_, s in found), 0
        )
        tell(f"{resumed.state}: {dict(resumed.found)}")
        assert all(share < 1 for *_, share in found), (seed, found)


@pytest.mark.parametrize("first", [1, 3])
def test_a_slope_that_is_off_is_told(first):
    """The bound is linear in what is left to a solution: a gait at another slope is off
    by just that.
    """
    window = (0.0145, 0.0195) if first == 1 else (0.0122, 0.0130)
    events = family("D", *window, 2 * first, first)
    assert [e.kind for e in events] == (
        ["flip", "flip"] if first == 1 else ["fold", "flip", "flip"]
    )
    for event in events:
        Z = event.gait.Z[:, 0]
        for off in (1e-9, -3e-8):
            moved = Z + off * np.eye(len(Z))[-1]
            assert slope_error(
                event.gait.problem, CONDITIONS[event.kind], moved
            ) == pytest.approx(abs(off), rel=1e-3)
        assert 0 < slope_error(event.gait.problem, CONDITIONS[event.kind], Z) < 1e-12
