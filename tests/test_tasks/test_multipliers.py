"""Multipliers and their bounds, against random matrices and against 113 bits."""

import itertools

import mpmath
import numpy as np
import pytest

from gaitsweep import gaits
from gaitsweep.tasks.contract.registry import GAITS
from gaitsweep.tasks.gaits.multipliers import (
    characteristic,
    characteristic_errors,
    multiplier_bounds,
    multiplier_changes,
    multipliers,
)
from gaitsweep.tasks.gaits.newton import curvature
from gaitsweep.tasks.gaits.polish import settle, unmeasured
from gaitsweep.tasks.gaits.rounding import characteristic_scale
from gaitsweep.tasks.step.extended_precision import Start, _extended_step_map, solved
from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.studies.follow_cycles import cycle_branches
from gaitsweep.tasks.studies.solve_points import atlas, lines, points
from gaitsweep.tasks.walkers.resolve import resolve
from lines import WANT, branches

RATES = ("stance_rate", "thigh_rate", "shank_rate")


def random_matrices(m, n=400):
    """Of any size; the first fifty have two eigenvalues that nearly meet."""
    draw = np.random.default_rng(4)
    matrices = draw.normal(size=(m, m, n)) * 10.0 ** draw.uniform(-1, 1, n)
    matrices[0, 1, :50], matrices[1, 0, :50] = 1.0, 0.0
    matrices[1, 1, :50] = matrices[0, 0, :50] + 10.0 ** draw.uniform(-9, -3, 50)
    return matrices


@pytest.mark.parametrize("m", [2, 3])
def test_coefficients_are_those_of_the_eigenvalues(m):
    matrices = random_matrices(m)
    expected = [
        np.poly(values).real
        for values in np.linalg.eigvals(np.moveaxis(matrices, -1, 0))
    ]
    signs = (-1.0) ** np.arange(1, m + 1)
    scale = characteristic(np.abs(matrices), 1.0)
    np.testing.assert_array_less(
        np.abs(characteristic(matrices) - (np.array(expected)[:, 1:] * signs).T),
        1e-12 * scale,
    )


@pytest.mark.parametrize("m", [2, 3])
def test_bounds_of_eigenvalues(m):
    """Where two eigenvalues meet they move like the root of the error."""
    draw = np.random.default_rng(4)
    matrices = random_matrices(m)
    error = 10.0 ** draw.uniform(-9, -3, matrices.shape[-1])
    values = multipliers(matrices, 4)
    bound = multiplier_bounds(values, characteristic_errors(matrices, error))
    for _ in range(20):
        change = draw.normal(size=matrices.shape)
        change *= error / np.sqrt((change**2).sum(axis=(0, 1)))
        moved = multipliers(matrices + change, 4)
        apart = np.abs(values[:, :m, None] - moved[:, None, :m]).min(axis=2).max(axis=1)
        assert (apart <= bound * (1 + 1e-9)).all()
    assert np.median(bound / error) < 100


def test_real_multipliers_stay_real_beside_a_complex_pair():
    values = multipliers(random_matrices(3), 3)
    moved = multiplier_changes(values, np.full((3, len(values)), 1e-13))
    beside_pair = (values.imag == 0) & (values.imag != 0).any(axis=1, keepdims=True)
    assert (
        beside_pair.sum() > 10
        and (moved[beside_pair].real != 0).any()
        and (moved[beside_pair].imag == 0).all()
    )


@pytest.mark.parametrize("m", [2, 3])
def test_bounds_of_changed_coefficients_are_sharp(m):
    """A change of one coefficient moves a simple eigenvalue by a fifth less than its
    bound, and a double one within.
    """
    matrices, draw = random_matrices(m), np.random.default_rng(5)
    values, scale = multipliers(matrices, m), np.abs(characteristic(matrices))
    error = np.zeros((m, matrices.shape[-1]))
    for k in range(m):
        error[:] = 0.0
        error[k] = scale[k] * 10.0 ** draw.uniform(-12, -4, len(values))
        bound = multiplier_bounds(values, error)
        coefficients = characteristic(matrices) + error
        signs = (-1.0) ** np.arange(1, m + 1)
        moved = np.array([np.roots([1.0, *c]) for c in (coefficients.T * signs)])
        apart = np.abs(values[:, :, None] - moved[:, None]).min(axis=2).max(axis=1)
        rounding = 1e-13 * np.abs(values).max(axis=1)
        assert (apart[50:] <= bound[50:] + rounding[50:]).all()
        ratio = bound[50:] / np.maximum(apart[50:], 1e-300)
        assert np.median(ratio[apart[50:] > 10 * rounding[50:]]) < 1.3


def number(x):
    return mpmath.mpf(str(x))


def derivative(step, y, times, parameters):
    """Image and derivative of one step in 113 bits: central differences, the event
    times eliminated.
    """
    m, h = step.m, step.number(2.0**-40)
    unknowns, columns = np.concatenate([y, times]), []
    for i in range(len(unknowns)):
        values = []
        for sign in (1, -1):
            moved = unknowns.copy()
            moved[i] = moved[i] + sign * h
            values.append(step(moved[:m], moved[m:], parameters)[0])
        columns.append(
            [number((a - b) / (h + h)) for a, b in zip(*values, strict=True)]
        )
    joint = mpmath.matrix(columns).T
    by_times = joint[:m, m:] * mpmath.inverse(joint[m:, m:])
    return joint[:m, :m] + mpmath.eye(m) - by_times * joint[m:, :m], joint


def eigenvalues(matrix):
    return np.array(
        [complex(value) for value in mpmath.eig(matrix, left=False, right=False)]
    )


def exact_multipliers(problem, found, g, slope):
    """Multipliers (m,) of the gait in 113 bits that Newton's method reaches from one in
    an archive's variables.
    """
    unit = np.sqrt(problem.walker.leg / problem.walker.g)
    angle = found["stance_angle"][g]
    rates = [found[name][g] * unit / angle for name in RATES][: problem.m - 1]
    times = [found[name][g] / unit for name in ("kneestrike_time", "period")][
        -problem.phases :
    ]
    w = np.array([[np.log(angle), *rates, *times]]).T
    at = settle(problem, unmeasured(problem, w, np.array([slope])))
    start = Start(problem, 0, at.stride, at.y[:, 0], at.times[:, 0], slope, at.scale[0])
    y, times, *_, error = solved(start, 1)
    assert error < 1e-15
    step = _extended_step_map(problem.structure, 1)
    with mpmath.workdps(34):
        return eigenvalues(
            derivative(step, y, times, step.parameters(problem, 0, slope, at.scale[0]))[
                0
            ]
        )


def compared(values, found, g):
    """Error of multipliers, their bound, and the size that both are relative to."""
    own = found["multiplier_real"][g] + 1j * found["multiplier_imag"][g]
    error = np.abs(values[:, None] - own).min(axis=1).max()
    return error, found["multiplier_error_bound"][g], max(1.0, np.abs(values).max())


def summed_up(rows, slack=1000):
    """Every bound holds; in the median it is within 1,000 times the error, in nine of
    ten 1e-10.
    """
    error, bound, size = np.array(rows).T
    assert len(error) >= 8
    assert (error <= bound).all()
    assert np.median(bound / np.maximum(error, 1e-16)) < slack
    assert np.quantile(bound / size, 0.9) < 1e-10
    return error / size


def one_at(out, *at):
    return {name: out[name][at] for name in out if name != "reasons"}


def rows_of(problem, slopes, out):
    here = itertools.product(range(len(slopes)), (0, 1))
    return [
        compared(
            exact_multipliers(problem, one_at(out, i), g, slopes[i]), one_at(out, i), g
        )
        for i, g in here
        if out["status"][i, g] == 0
    ]


@pytest.mark.parametrize("walker", ["D", "A", "B", "C", "E", "F"])
def test_multipliers_of_lines_are_as_good_as_their_gaits(walker):
    """On long lines and on short ones."""
    draw = np.random.default_rng(7)
    slopes = np.exp(draw.uniform(np.log(3e-4), np.log(0.05), 8))
    line = {"walker": walker, "set": {}}
    asked = {"slope": slopes, "want": WANT, "gaits": GAITS}
    problem = Problem(resolve(walker))
    long = points({"line": line, **asked}, [atlas({"line": line}, [])])
    ((_, short),) = lines({"lines": [line], **asked}, [])
    for out in (long, short):
        assert (summed_up(rows_of(problem, slopes, out)) < 1e-12).all()


@pytest.mark.parametrize("walker", ["D", "C"])
def test_multipliers_of_vanishing_steps(walker):
    """Whose gaits need more digits than doubles have; their derivatives are better than
    their bounds by far.
    """
    slopes = np.geomspace(1e-13, 1e-7, 5)
    line = {"walker": walker, "set": {}}
    out = points(
        {"line": line, "slope": slopes, "want": WANT, "gaits": GAITS},
        [atlas({"line": line}, [])],
    )
    assert (
        summed_up(rows_of(Problem(resolve(walker)), slopes, out), slack=1e4) < 1e-12
    ).all()


def test_multipliers_over_a_plane():
    slope, mass = 0.01, np.linspace(0.0, 3.0, 41)
    radius = resolve("A").R * np.linspace(0.95, 1.05, 40)
    found = gaits("A", slope, R=radius[:, None], m_h=mass)
    rows = []
    for i, j in ((3, 5), (20, 20), (39, 0), (10, 33), (0, 40)):
        problem = Problem(resolve("A", {"R": radius[i], "m_h": mass[j]}))
        here = {
            name: found[name].values[i, j]
            for name in found.data_vars
            if name != "reason_text"
        }
        some = [g for g in (0, 1) if here["status"][g] == 0]
        rows += [
            compared(exact_multipliers(problem, here, g, slope), here, g) for g in some
        ]
    assert (summed_up(rows) < 1e-12).all()


def exact_multipliers_of(problem, found, g, slope, n):
    """Multipliers of a gait of n steps: Newton's method on its first section, in 113
    bits.
    """
    unit = np.sqrt(problem.walker.leg / problem.walker.g)
    angle = found["stance_angle"][g]
    step, scale = (
        _extended_step_map(problem.structure, 1),
        np.exp2(np.floor(np.log2(angle))),
    )
    parameters = step.parameters(problem, 0, slope, scale)
    rates = [found[name][g] * unit for name in RATES][: problem.m - 1]
    y, guess = (
        step.array(np.array([angle, *rates]) / scale),
        found["period"][g] / unit / n,
    )
    for _ in range(4):
        at, total = y, mpmath.eye(problem.m)
        for _ in range(n):
            doubles = np.array([[float(v)] for v in at]), np.array([[guess]])
            own = problem.parameters(np.array([slope]), np.array([scale]))
            for _ in range(8):
                doubles = doubles[0], problem.map(*doubles, own).times
            times = step.array(doubles[1][:, 0])
            times = struck(step, at, times, parameters)
            D, _ = derivative(step, at, times, parameters)
            at, total = at + step(at, times, parameters)[0][: problem.m], D * total
        off = mpmath.matrix([number(a - b) for a, b in zip(at, y, strict=True)])
        change = mpmath.lu_solve(mpmath.eye(problem.m) - total, off)
        y = y + step.array([float(v) for v in change])
    assert max(abs(v) for v in change) < 1e-18
    return eigenvalues(total)


def struck(step, y, times, parameters):
    """Time of heelstrike, by the secant method on its guard."""
    before = times - step.number(1e-6)
    guards = [step(y, each, parameters)[0][-1] for each in (before, times)]
    for _ in range(5):
        rate = (guards[1] - guards[0]) / (times[0] - before[0])
        before, times = times, times - guards[1] / rate
        guards = [guards[1], step(y, times, parameters)[0][-1]]
        if guards[0] == guards[1]:
            break
    return times


@pytest.mark.parametrize(
    ("steps", "slopes"), [(2, (0.0155, 0.0161, 0.0166, 0.0171)), (4, (0.0178, 0.0179))]
)
def test_multipliers_of_gaits_of_several_steps(steps, slopes):
    problem, rows = Problem(resolve("D")), []
    found = gaits("D", np.array(slopes), steps=steps)
    with mpmath.workdps(34):
        for i, slope in enumerate(slopes):
            here = {
                name: found[name].values[i]
                for name in found.data_vars
                if name != "reason_text"
            }
            some = [g for g in range(len(GAITS)) if here["status"][g] == 0]
            assert some
            rows += [
                compared(exact_multipliers_of(problem, here, g, slope, steps), here, g)
                for g in some
            ]
    error, bound, size = np.array(rows).T
    assert (error <= bound).all()
    # Of two gaits, one may be exact by chance.
    assert bound.max() < 1000 * error.max()
    assert (bound / size < 1e-9).all()


def test_the_polynomial_of_several_steps_changes_with_every_unknown():
    """As its gradient says, of the sections and event times of every step."""
    problem, known = branches("D")
    (branch, *_) = cycle_branches(problem, known, 2)
    several, Z = problem.of_steps(2), branch.Z[:, [len(branch.q) // 2]]
    w, q = Z[:-1], Z[-1]
    _, gradient = curvature(several, w, q)
    stride, _ = several.stride(w, q)
    unit = characteristic_scale(stride)
    for i in range(len(w)):
        ends = [
            several.stride(w + sign * 1e-6 * np.eye(len(w))[:, [i]], q)[0]
            for sign in (1, -1)
        ]
        up, down = (characteristic(end.jacobian) for end in ends)
        np.testing.assert_allclose(
            gradient[:, i], (up - down) / 2e-6 / unit, rtol=2e-3, atol=2e-3
        )
    assert np.abs(gradient).max() > 0.1
