"""Special points of branches in 113-bit arithmetic, to some thirty digits, for tests of
their error bounds.

The defining equations are evaluated in 113 bits, with the constants of the walker in as
many; Newton's method takes the derivative in doubles, which only sets how fast it
converges.
"""

from __future__ import annotations

import functools

import heyoka as hy
import numpy as np

from gaitsweep.tasks.branches.conditions import CONDITIONS
from gaitsweep.tasks.branches.joint import evaluate
from gaitsweep.tasks.branches.pseudo_arclength import bordered_matrix
from gaitsweep.tasks.mechanics.lumped import Structure, lump
from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.step.several_steps import sections
from soak.extended_reference import Precise

_MAX_STEPS = 30


@functools.lru_cache
def _precise(structure: Structure) -> Precise:
    return Precise(structure, hy.real128)


def _determinant(rows):
    """By the first column: matrices have at most five rows."""
    if len(rows) == 1:
        return rows[0][0]
    minors = [
        _determinant([r[1:] for j, r in enumerate(rows) if j != i])
        for i in range(len(rows))
    ]
    return sum(
        ((-1) ** i * rows[i][0] * minor for i, minor in enumerate(minors)),
        hy.real128(0.0),
    )


def _less_one(rows, sign=-1.0):
    return [
        [x + hy.real128(sign * (i == j)) for j, x in enumerate(row)]
        for i, row in enumerate(rows)
    ]


def _scalar(kind, step, y, times):
    """The scalar that vanishes at a special point, as `CONDITIONS` has it."""
    m, A, by = len(y), step["jacobian"], step["derivative"]
    if kind == "flip":
        return _determinant(_less_one(A, 1.0))
    if kind == "neimark_sacker" and m == 2:
        return _determinant(list(A)) - hy.real128(1.0)
    if kind == "neimark_sacker":
        pairs = ((0, 1), (0, 2), (1, 2))
        return _determinant(
            _less_one(
                [
                    [A[i, k] * A[j, q] - A[i, q] * A[j, k] for k, q in pairs]
                    for i, j in pairs
                ]
            )
        )
    if kind == "fold":
        rows = [
            [sum(r[j] * y[j] for j in range(m)), *(r[1:m] * y[0]), *r[m:]] for r in by
        ]
        return _determinant([[x / y[0] for x in row] for row in rows])
    if kind == "end_kneestrike_at_heelstrike":
        return times[1] - times[0]
    if kind == "release_hyperextension":
        return (step["start"][4] - step["start"][5]) / y[0]
    at = {"end_tangential_heelstrike": len(by) - 1, "end_tangential_kneestrike": m}[
        kind
    ]
    return by[at, at] / y[0]


def _gradient(problem, kind, Z, h):
    steps = h * np.hstack([np.eye(len(Z)), -np.eye(len(Z))])
    with np.errstate(all="ignore"):
        at = evaluate(problem, Z[:, None] + steps)
        up, down = CONDITIONS[kind].residual(at).reshape(2, -1)
    return (up - down) / (2 * h)


def exact_slope(problem: Problem, kind: str, Z: np.ndarray):
    """Slope of a special point [rad] in 113 bits, or None where Newton's method does
    not converge near Z.

    Z, shape (c,), is the point in doubles: similarity coordinates, event times, ln
    slope.
    """
    found = (_newton(problem, kind, Z, h) for h in (1e-5, 1e-7, 1e-9))
    return next((slope for slope in found if slope is not None), None)


def _newton(problem, kind, Z, h):
    structure, m, number = problem.structure, problem.m, hy.real128

    def wide(values):
        return np.array([number(x) for x in values], dtype=number)

    at, rows = evaluate(problem, Z[:, None]), _gradient(problem, kind, Z, h)
    size = np.linalg.norm(rows)
    matrix = bordered_matrix(at.derivative, rows[:, None] / size)[0]
    exact = lump(problem.walker, number)
    _, scale = problem.section(Z[:, None])
    section = np.append(np.exp(Z[0]), np.exp(Z[0]) * Z[1:m]) / scale
    y, times, slope, last = (
        wide(section),
        wide(Z[m:-1]),
        number(float(np.exp(Z[-1]))),
        1e-3,
    )
    for _ in range(_MAX_STEPS):
        parameters = np.array(
            [slope, number(float(scale[0])), *(exact[k] for k in structure.constants)],
            dtype=number,
        )
        step = _precise(structure).stride(y, times, parameters)
        values = [
            *(step["residual"] / y[0]),
            _scalar(kind, step, y, times) / number(size),
        ]
        change = np.linalg.solve(matrix, [-float(x) for x in values])
        if not np.abs(change).max() < 0.5 * last:
            return None
        dZ, last = wide(change), np.abs(change).max()
        y = np.array(
            [y[0] + dZ[0] * y[0], *(y[1:] + y[0] * dZ[1:m] + dZ[0] * y[1:])],
            dtype=number,
        )
        slope, times = slope + slope * dZ[-1], times + dZ[m:-1]
        if last < 1e-22:
            return slope
    return None


def _mapped(problem: Problem, Z: np.ndarray, times: np.ndarray):
    """Images less the next sections, their derivative by Z = (sections over sqrt(n), ln
    slope), and Jacobians.
    """
    m, n = problem.structure.dimension, times.shape[1]
    Y, slope = Z[:-1].reshape(n, m).T * np.sqrt(n), np.full(n, np.exp(Z[-1]))
    scale = np.exp2(np.floor(np.log2(Y[0])))
    single = problem.of_steps(1)
    for _ in range(2):  # each step's times are corrected for its own Jacobian
        steps = single.map(
            Y / scale, times, single.parameters(slope, scale), by_drive=True
        )
        times = steps.times
    derivative = np.zeros((n, m, n * m + 1))
    for i in range(n):
        derivative[i, :, m * i : m * i + m] += steps.jacobian[..., i]
        after = m * ((i + 1) % n)
        derivative[i, :, after : after + m] -= np.eye(m)
        derivative[i, :, -1] = steps.by_drive[:, i] * scale[i] * slope[i] / np.sqrt(n)
    residual = (steps.image * scale - np.roll(Y, -1, axis=1)).T.ravel() / np.sqrt(n)
    return residual, derivative.reshape(n * m, -1), steps.jacobian


def steps_of(problem: Problem, Z: np.ndarray):
    """Sections (m, n) [rad, rad/sqrt(leg/g)] and event times (k, n) [sqrt(leg/g)] of
    the steps of a gait.
    """
    y, durations = (
        part[..., 0].T for part in sections(Z[:-1, None], problem.m, problem.steps)
    )
    return np.exp(Z[0]) * y, np.cumsum(durations, axis=0)


def exact_cycle_slope(problem: Problem, kind: str, Z: np.ndarray):
    """Slope of a flip or fold of gaits of n steps [rad] in 113 bits, or None where
    Newton's method does not converge.

    `Z` is the gait there in doubles. The derivative of det(M + 1) or det(M - 1) is that
    of differences in doubles.
    """
    m, n, number, sign = (
        problem.structure.dimension,
        problem.steps,
        hy.real128,
        {"flip": 1.0, "fold": -1.0}[kind],
    )
    (Y, times), q = steps_of(problem, Z), Z[-1]
    Z = np.append(Y.T.ravel() / np.sqrt(n), q)

    def determinant(Z):
        _, _, A = _mapped(problem, Z, times)
        M = functools.reduce(lambda M, i: A[..., i] @ M, range(n), np.eye(m))
        return np.linalg.det(M + sign * np.eye(m))

    h = 1e-6
    row = np.array(
        [
            (determinant(Z + h * e) - determinant(Z - h * e)) / (2 * h)
            for e in np.eye(len(Z))
        ]
    )
    size = np.linalg.norm(row)
    matrix = np.vstack([_mapped(problem, Z, times)[1], row / size])
    exact = lump(problem.walker, number)
    constants = [exact[name] for name in problem.structure.constants]
    Y, times = (np.vectorize(number, otypes=[object])(a) for a in (Y, times))
    slope, last = number(float(np.exp(q))), 1e-3
    for _ in range(_MAX_STEPS):
        steps = []
        for i in range(n):
            parameters = np.array([slope, number(1.0), *constants], dtype=number)
            y, at = (
                np.array(list(Y[:, i]), dtype=number),
                np.array(list(times[:, i]), dtype=number),
            )
            for _ in range(2):
                step = _precise(problem.structure).stride(y, at, parameters)
                at = step["times"]
            steps.append(step)
            times[:, i] = list(at)
        residual = np.concatenate(
            [steps[i]["image"] - Y[:, (i + 1) % n] for i in range(n)]
        ).astype(object)
        M = [[number(float(i == j)) for j in range(m)] for i in range(m)]
        for step in steps:
            M = [
                [
                    sum(step["jacobian"][i, k] * M[k][j] for k in range(m))
                    for j in range(m)
                ]
                for i in range(m)
            ]
        value = _determinant(_less_one(M, sign)) / number(size)
        right = [*(-float(x) / np.sqrt(n) for x in residual), -float(value)]
        change = np.linalg.solve(matrix, right)
        if not np.abs(change).max() < 0.5 * last:
            return None
        last = np.abs(change).max()
        Y = Y + np.vectorize(number, otypes=[object])(
            change[:-1].reshape(n, m).T * np.sqrt(n)
        )
        slope = slope + slope * number(float(change[-1]))
        if last < 1e-22:
            return slope
    return None


def _guards(phase):
    """Guards of a phase's motion and their rates: of heelstrike, and of the free knee;
    states along the first axis.
    """
    half = len(phase) // 2
    pairs = [(phase[0] + phase[1], phase[half] + phase[half + 1])]
    return pairs + (
        [(phase[1] - phase[2], phase[half + 1] - phase[half + 2])] if half == 3 else []
    )


def _touched(problem, Z):
    """Phase, number and time within the phase of the guard that touches zero at an
    earlier strike, in doubles.

    At a kneestrike, where rates jump, the guard of heelstrike has a corner: time 0 of
    the second phase.
    """
    count = 1024
    stride, _ = problem.stride(Z[:-1, None], Z[-1:], samples=count)
    durations, found = np.diff(np.append(0.0, Z[problem.m : -1])), []
    motion = stride.scaled_motion()
    if len(motion) == 2 and abs(motion[1][0, 0, 0] + motion[1][0, 1, 0]) < 1e-12:
        return 1, 0, 0.0
    for i, phase in enumerate(motion):
        for number, (guard, rate) in enumerate(
            _guards(np.moveaxis(phase[..., 0], 1, 0))
        ):
            turns = np.flatnonzero(rate[1:-1] * rate[2:] < 0) + 1
            found += [
                (abs(guard[k]), i, number, durations[i] * k / count)
                for k in turns
                if 2 < k < count - 3
            ]
    return min(found)[1:] if found else None


def exact_earlier_strike(problem: Problem, Z: np.ndarray):
    """Slope at which a guard touches zero before a step's strike [rad] in 113 bits;
    None where it is not found near Z.

    Z is as for `exact_slope`; the unknowns are the section, the slope, the event times
    and that of the touch.
    """
    touched = _touched(problem, Z)
    if touched is None:
        return None
    phase, guard, tau = touched
    m, number, precise = problem.m, hy.real128, _precise(problem.structure)
    exact = lump(problem.walker, number)
    constants = [exact[name] for name in problem.structure.constants]
    angle = np.exp(Z[0])

    def wide(values):
        return np.array([number(float(x)) for x in values], dtype=number)

    def equations(z):
        y, times = z[:m], z[m + 1 : m + 1 + problem.phases]
        parameters = np.array([z[m], number(1.0), *constants], dtype=number)
        residual = precise.stride(y, times, parameters)["residual"]
        begin, size = (
            precise.algebra.begin(np.concatenate([y, parameters])),
            precise.algebra.start_size,
        )
        start, D = begin[:size], begin[size:].reshape(size, m)
        if phase:
            final = precise._integrate(precise.free, start, D, parameters, times[0])
            out = precise.algebra.lock(
                np.concatenate([final[:6], precise._padded(final[6:], 6), parameters])
            )
            start, D, size = (
                out[:4],
                precise.array(np.eye(4, m, -1).ravel()).reshape(4, m),
                4,
            )
        if not tau:
            return np.append(residual, start[0] + start[1])
        flow = precise.free if size == 6 else precise.locked
        return np.concatenate(
            [
                residual,
                _guards(precise._integrate(flow, start, D, parameters, z[-1])[:size])[
                    guard
                ],
            ]
        )

    z, last = (
        wide(
            [angle, *(angle * Z[1:m]), np.exp(Z[-1]), *Z[m:-1], *([tau] if tau else [])]
        ),
        1e-2,
    )
    size = np.array([*[abs(angle)] * m, float(z[m]), *[1.0] * (len(z) - m - 1)])
    h = number(1e-9)
    units = [wide(row) for row in np.diag(size)]
    ends = [(equations(z + h * each), equations(z - h * each)) for each in units]
    matrix = np.array(
        [
            [float((a - b) / (number(2.0) * h)) for a, b in zip(*pair, strict=True)]
            for pair in ends
        ]
    ).T
    for _ in range(_MAX_STEPS):
        change = -np.linalg.solve(matrix, [float(x) for x in equations(z)])
        if not np.abs(change).max() < 0.5 * last:
            return None
        z, last = z + wide(size * change), np.abs(change).max()
        if last < 1e-22:
            return z[m]
    return None
