"""Gaits that repeat after n steps, at the slopes of a line."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from tasks import status
from tasks.accuracy import always
from tasks.continuation.cycles import Cycle, at_slope, product, really_walks, system
from tasks.continuation.lockstep import lanes_of
from tasks.fixed_points.multipliers import characteristic
from tasks.follow_cycles import MAX_MULTIPLIER, CycleBranch, Guess, is_same
from tasks.measures.gaits import (
    Arrays,
    Part,
    Steps,
    energy_imbalance,
    measured_multipliers,
    nothing_solved,
    store,
    to_accuracy,
    without_knees,
)
from tasks.measures.kinematics import travel
from tasks.registry import GAITS, VARIABLES
from tasks.step.problem import EPS, Problem, sizes
from tasks.step.step_map import Stride

#: Units in which steps are evaluated again, to see their rounding.
_UNITS = (0.75, 0.625, 0.875)
#: Largest error bound of a converged gait.
_MAX_BOUND = 1e-3
#: Smallest distance between a gait's sections, that of rounding, also beside flips [rad].
_MIN_DISTANCE = 1e-10
#: Iterations across a branch, and the largest last step of a corrected gait.
_MAX_ACROSS, _MAX_STEP = 6, 1e-11


#: Place of the sentence on gaits beside a fold among `reasons`.
_UNDECIDED = 7
#: How often the largest change of the multipliers by other units is counted in their bound.
_SAFETY = 16.0
#: Relative change of a section by which the derivative of its step is differentiated.
_DIFFERENCE = 1e-7


def cycle_points(problem: Problem, branches: list[CycleBranch], params: Mapping[str, Any]) -> Arrays:
    """Solve the gaits of period n at the slopes of one line.

    Parameters
    ----------
    problem : Problem
    branches : list of CycleBranch
        The line's, of period n.
    params : mapping
        `steps`, n > 1; `slope`, ndarray, shape (k,) [rad]; `want`, names of variables; `violation_limits`, as for
        points.

    Returns
    -------
    dict
        As `tasks.solve_points.points` returns it: what the registry's `over_steps` says of the n steps' variables, of
        which the first begins at the largest stance angle; frequency, speed, power and residual over all n; the
        multipliers of n steps.
    """
    n, accuracy = int(params["steps"]), params.get("accuracy", 0.0)
    slope = np.asarray(params["slope"], float)
    want = [v for v in VARIABLES if v in params["want"] or v in always(accuracy)]
    out = nothing_solved(want, len(slope), 4 if problem.walker.knees else 3)
    out["reason"][:] = [1, 1, 2, 2]
    for k, value in enumerate(slope.tolist()):
        gaits = _gaits(problem, branches, value, want, params.get("violation_limits"))
        store({name: values[k : k + 1] for name, values in out.items()}, gaits, set(GAITS))
    long = _outside(branches, n)
    reasons = [*status.reasons(long, long), status.BESIDE_FOLD]
    to_accuracy(out, accuracy)
    return {**out, "reasons": np.array(reasons)}


def _outside(branches: list[CycleBranch], n: int) -> str:
    """Why no branch has a gait at some slope."""
    if not branches:
        return f"No gait of period {n} found: no flip of fewer steps begins one."
    q = [[c.q for c in branch.cycles] for branch in branches]
    spans = "; ".join(f"{np.exp(min(x)):.6g} to {np.exp(max(x)):.6g}" for x in q)
    limit = f"followed up to multipliers of {MAX_MULTIPLIER:g}"
    return f"No gait of period {n} at this slope: the branches found span {spans} ({limit})."


def _gaits(
    problem: Problem,
    branches: list[CycleBranch],
    slope: float,
    want: list[str],
    limits: Mapping[str, float] | None,
) -> list[Part]:
    """Every gait at one slope."""
    cycles: list[Cycle] = []
    parts = []
    failed = {name: values[:, 0] for name, values in nothing_solved(want, 1, 4 if problem.walker.knees else 3).items()}
    for number, branch in enumerate(branches):
        for guess in branch.guesses(float(np.log(slope))):
            cycle = solve_cycle(problem, guess, slope)
            if cycle.ok and any(is_same(cycle, other, guess.room) for other in cycles if other.ok):
                continue
            reason = 4 if cycle.ok else 3 if guess.room else _UNDECIDED
            solved = failed | _one(status=status.NOT_CONVERGED, reason=reason)
            angle, ratio = np.array([guess.Y[0].max()]), np.zeros(1)
            if cycle.ok and really_walks(problem, cycle):
                solved = _measure(problem, _from_largest(cycle), slope, want, limits, 2 * guess.room)
                angle, ratio = solved["stance_angle"], solved["heelstrike_rate_ratio"]
                if not np.isfinite(solved["error_bound"][0]):
                    solved = failed | _one(status=status.NOT_CONVERGED, reason=_UNDECIDED)
            parts.append(Part(np.zeros(1, int), angle, ratio, solved | _one(branch=number, piece=guess.piece)))
            cycles.append(cycle)
    return parts


def _one(**values: float) -> Arrays:
    """Values of a single gait."""
    return {name: np.array([value]) for name, value in values.items()}


def solve_cycle(problem: Problem, guess: Guess, slope: float) -> Cycle:
    """Correct a guess to a gait of exactly its period.

    Parameters
    ----------
    problem : Problem
    guess : Guess
    slope : float [rad]

    Returns
    -------
    Cycle
        Not `ok` where it repeats sooner or was not found.
    """
    cycle = at_slope(problem, guess.Y, guess.times, slope)
    if not (cycle.ok and _is_guessed(cycle.Y, guess)):
        cycle = _correct_across(problem, guess, slope)
        cycle.ok &= _is_guessed(cycle.Y, guess)
    return cycle


def _is_guessed(Y: np.ndarray, guess: Guess) -> bool:
    """Whether a gait is the one guessed: neither that of fewer steps nor the other one beside a fold."""
    return _keeps_apart(Y, guess.Y) and bool(np.abs(Y - guess.Y).max() < guess.room)


def _keeps_apart(Y: np.ndarray, guess: np.ndarray) -> bool:
    """Whether the steps of a gait differ, and not by much less than those of its guess."""
    n = Y.shape[1]
    sooner = [k for k in range(1, n) if n % k == 0]
    distances, guessed = ([float(np.abs(x - np.roll(x, k, axis=1)).max()) for k in sooner] for x in (Y, guess))
    return all(a > max(0.5 * b, _MIN_DISTANCE) for a, b in zip(distances, guessed, strict=True))


def _correct_across(problem: Problem, guess: Guess, slope: float) -> Cycle:
    """Correct a guess so near a flip that along the branch Newton's step is rounding, in all other directions.

    There the branch's polynomial, which is exact at the flip, is more accurate than the equations.
    """
    Y, times, q = guess.Y, guess.times, float(np.log(slope))
    m, n = Y.shape
    A, size = np.zeros((m, m, n)), np.inf
    for _ in range(_MAX_ACROSS):
        residual, derivative, A, times_after = system(problem, Y, times, q)
        if not (np.isfinite(residual).all() and np.isfinite(derivative).all()):
            break
        left, values, right = np.linalg.svd(derivative[:, :-1])
        dZ = np.append(-right[:-1].T @ ((left[:, :-1].T @ residual) / values[:-1]), 0.0)
        size = float(np.abs(dZ).max())
        Y, times = Y + dZ[:-1].reshape(n, m).T * np.sqrt(n), times_after(dZ)
    return Cycle(Y, times, q, A, np.zeros(m * n + 1), size < _MAX_STEP, size)


def _from_largest(cycle: Cycle) -> Cycle:
    """The same gait, its steps beginning at the one with the largest stance angle."""
    k = -int(cycle.Y[0].argmax())
    rolled = (np.roll(x, k, axis=-1) for x in (cycle.Y, cycle.times, cycle.A))
    Y, times, A = rolled
    return Cycle(Y, times, cycle.q, A, cycle.tangent, cycle.ok, cycle.error)


def _measure(
    problem: Problem, cycle: Cycle, slope: float, want: list[str], limits: Mapping[str, float] | None, from_fold: float
) -> Arrays:
    """Variables of a gait at some distance from a fold in the walker's units, shape (1[, multipliers])."""
    walker, n = problem.walker, cycle.period
    scale, slopes, at = np.exp2(np.floor(np.log2(cycle.Y[0]))), np.full(n, slope), np.array([slope])
    parameters = problem.parameters(slopes, scale)
    stride = problem.map(cycle.Y / scale, cycle.times, parameters)
    state = problem.map.start(cycle.Y / scale, parameters)[: problem.map.start_size] * scale
    after = np.roll(np.arange(n), -1)
    steps = Steps(problem, walker, stride, cycle.Y, state, cycle.times, scale, slopes, after).measure(want, limits)
    if "unlocking_torque_time" in steps:  # of the step with the worst torque, after those before it
        begins = np.cumsum(steps["period"]) - steps["period"]
        worst = int(steps["unlocking_torque"].argmax())
        steps["unlocking_torque_time"] = (begins + steps["unlocking_torque_time"])[[worst]]
    measured = {name: _OVER_STEPS[VARIABLES[name].over_steps](values) for name, values in steps.items()}
    measured |= travel(walker, at, measured["step_length"], measured["period"], n)
    if "energy_imbalance" in want:
        measured["energy_imbalance"] = energy_imbalance(walker, at, measured, n)
    bound, residual, moved = _error(problem, cycle, slopes, scale, from_fold)
    if any(VARIABLES[name].group == "multipliers" for name in want):
        error = _characteristic_error(problem, cycle, slopes, scale, stride, moved)
        measured |= measured_multipliers(product(stride.jacobian)[..., None], 0.0, error[:, None], walker.knees)
    code, reason = (status.CONVERGED, 0) if bound < _MAX_BOUND else (status.NOT_CONVERGED, 3)
    found = _one(residual=residual, error_bound=bound, status=code, reason=reason)
    return without_knees(want, walker, 1) | measured | found


#: What a gait has of its steps' values, shape (n,), in an array of shape (1,).
_OVER_STEPS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "first": lambda values: values[:1],
    "sum": lambda values: values.sum(keepdims=True),
    "mean": lambda values: values.mean(keepdims=True),
    "greatest": lambda values: values.max(keepdims=True),
    "least": lambda values: np.fmin.reduce(values, keepdims=True),
    "any": lambda values: np.bitwise_or.reduce(values, keepdims=True),
}


def _characteristic_error(
    problem: Problem, cycle: Cycle, slope: np.ndarray, scale: np.ndarray, stride: Stride, moved: np.ndarray
) -> np.ndarray:
    """Bounds of the errors (m,) of the characteristic polynomial of all steps, whose sections err by `moved` (m, n).

    How it changes in other units, and by each section: a section changes only the derivative of its own step.
    """
    Y, A, (m, n) = cycle.Y, stride.jacobian, moved.shape
    shifts = [np.where(np.arange(m)[:, None] == j, _DIFFERENCE * sizes(Y), 0.0) for j in range(m)]
    cases = [(scale * unit, Y) for unit in _UNITS] + [(scale, Y + shift) for shift in shifts]
    steps = _evaluate(problem, cycle, slope, cases)

    # Products of the steps before each and after it.
    before, after = [np.eye(m)], [np.eye(m)]
    for i in range(n):
        before.append(A[:, :, i] @ before[-1])
        after.append(after[-1] @ A[:, :, n - 1 - i])
    whole = characteristic(before[n])
    error = _SAFETY * np.max(
        [np.abs(characteristic(product(s.jacobian)) - whole) for s in steps[: len(_UNITS)]], axis=0
    )
    for shift, row, step in zip(shifts, moved, steps[len(_UNITS) :], strict=True):
        for i in range(n):
            alone = after[n - 1 - i] @ step.jacobian[:, :, i] @ before[i]
            error += np.abs(characteristic(alone) - whole) / shift.max(axis=0)[i] * row[i]
    return np.asarray(error + _SAFETY * EPS * characteristic(np.abs(before[n]), 1.0))


def _evaluate(
    problem: Problem, cycle: Cycle, slope: np.ndarray, cases: list[tuple[np.ndarray, np.ndarray]]
) -> list[Stride]:
    """Steps of a gait with other scales (n,) and sections (m, n), all in one call."""
    n = cycle.period
    Y = np.hstack([Y / scale for scale, Y in cases])
    parameters = np.hstack([problem.parameters(slope, scale) for scale, _ in cases])
    steps = problem.map(Y, np.tile(cycle.times, len(cases)), parameters)
    return [lanes_of(steps, slice(k * n, k * n + n)) for k in range(len(cases))]


def _beside_flip(Y: np.ndarray, moved: np.ndarray) -> float:
    """Factor by which a gait beside a flip may move further than linearised equations say.

    Notes
    -----
    With a the half distance of its halves, the equation along the branch is a (a^2 - a*^2) = noise beside a flip: a
    cubic, whose root a* keeps the sign of a. Its linearisation at a moves by x = noise/(2 a^2); a* lies within
    a - sqrt(a^2 - 2 a x) below, if x < a/2, else within a, and within sqrt(a^2 + 2 a x) - a above.
    """
    n = Y.shape[1]
    half = np.abs(Y - np.roll(Y, n // 2, axis=1)).max() / 2 if n % 2 == 0 else np.inf
    x = float(np.abs(moved).max() / half)
    if x < 1e-6:
        return 1.0 + x
    exact = 1 - np.sqrt(1 - 2 * x) if x <= 0.5 else max(1.0, np.sqrt(1 + 2 * x) - 1)
    return float(exact / x)


def _beside_fold(distance: float, moved: np.ndarray) -> float:
    """Factor by which a gait at some distance from a fold may move further than linearised equations say.

    Notes
    -----
    The equation along the branch is a^2 - a*^2 = noise, with a the distance, of which the linearisation moves by
    x = noise/(2 a); a* lies within a - sqrt(a^2 - 2 a x) below. Beyond a/2 there may be no gait.
    """
    x = float(np.abs(moved).max() / distance)
    if x < 1e-6:
        return 1.0 + x
    return float((1 - np.sqrt(1 - 2 * x)) / x) if x <= 0.5 else np.inf


def _error(
    problem: Problem, cycle: Cycle, slope: np.ndarray, scale: np.ndarray, from_fold: float
) -> tuple[float, float, np.ndarray]:
    """Bound on the relative error of angles, rates and period, the residual, and bounds of the sections (m, n).

    Notes
    -----
    The steps are evaluated again in other units, in which every operation rounds differently. What the largest change
    of their images may do to the sections, all signs the worst, is what rounding may have done to Newton's solution.
    """
    m, n = cycle.Y.shape
    steps = _evaluate(problem, cycle, slope, [(scale * unit, cycle.Y) for unit in (1.0, *_UNITS)])
    images = np.array([step.image * scale * unit for step, unit in zip(steps, (1.0, *_UNITS), strict=True)])
    times = np.array([step.times[-1] for step in steps])
    after = np.roll(cycle.Y, -1, axis=1)
    residual = images[0] - after
    rounding = np.abs(images - images[0]).max(axis=0) + EPS * np.abs(sizes(after))
    matrix = np.zeros((m * n, m * n))
    for i in range(n):
        rows = slice(m * i, m * i + m)
        matrix[rows, rows] += cycle.A[:, :, i]
        k = m * ((i + 1) % n)
        matrix[rows, k : k + m] -= np.eye(m)
    inverse = np.abs(np.linalg.inv(matrix))
    moved = (inverse @ (rounding + np.abs(residual)).T.ravel()).reshape(n, m).T
    moved *= _beside_flip(cycle.Y, moved) * _beside_fold(from_fold, moved)
    size = problem.map.start_size
    start, by_y = np.split(problem.map.start(cycle.Y / scale, problem.parameters(slope, scale))[:, 0], [size])
    state = np.abs(start)
    error = (np.abs(by_y.reshape(size, m)) @ moved[:, 0] / scale[0])[[0, *range(size // 2, size)]]
    section = max(error[0] / state[0], (error[1:] / state[size // 2 :].max()).max())
    late = np.abs(times - times[0]).max(axis=0).sum()
    by_section = np.abs(steps[0].times_by_y[-1]) / scale
    duration = (late + (by_section * moved).sum()) / cycle.times[-1].sum()
    return float(max(section, duration)) + 2 * EPS, float((np.abs(residual) / sizes(after)).max()), moved
