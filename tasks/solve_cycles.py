"""Gaits that repeat after n steps, at the slopes of a line."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from tasks import status
from tasks.accuracy import always
from tasks.continuation.cycles import Cycle, at_slope, really_walks, system
from tasks.continuation.lockstep import lanes_of
from tasks.fixed_points.labels import places
from tasks.fixed_points.step_check import gait_ratio
from tasks.follow_cycles import MAX_MULTIPLIER, CycleBranch, Guess, is_same
from tasks.measures import violations
from tasks.measures.gaits import to_accuracy
from tasks.measures.kinematics import step_length
from tasks.measures.losses import heelstrike_losses, kneestrike_loss
from tasks.registry import GAITS, VARIABLES
from tasks.step.problem import EPS, Problem, sizes
from tasks.step.step_map import Stride

Arrays = dict[str, np.ndarray]
#: Units in which steps are evaluated again, to see their rounding.
_UNITS = (0.75, 0.625, 0.875)
#: Largest error bound of a converged gait.
_MAX_BOUND = 1e-3
#: Smallest distance between a gait's sections, that of rounding, also beside flips [rad].
_MIN_DISTANCE = 1e-10
#: Iterations across a branch, and the largest last step of a corrected gait.
_MAX_ACROSS, _MAX_STEP = 6, 1e-11


#: How often the largest change of the multipliers is counted in their bound.
_MULTIPLIER_SAFETY = 16.0


def cycle_points(problem: Problem, branches: list[CycleBranch], params: Mapping[str, Any]) -> Arrays:
    """Solve the gaits of period n at the slopes of one line.

    Parameters
    ----------
    problem : Problem
    branches : list of CycleBranch
        The line's, of period n.
    params : mapping
        `steps`, n > 1; `slope`, ndarray, shape (k,) [rad]; `want`, names of variables; `friction_limit`, as for points.

    Returns
    -------
    dict
        As `tasks.solve_points.points` returns it: `stance_angle` and rates at the largest stance angle of the n steps,
        `kneestrike_time` and `heelstrike_rate_ratio` of the step that begins there; `period` and losses of all n;
        speed, power and residual over all n; the multipliers of n steps; violations of any of them, each amount the
        worst.
    """
    n, friction_limit = int(params["steps"]), float(params.get("friction_limit", violations.FRICTION_LIMIT))
    slope = np.asarray(params["slope"], float)
    accuracy = params.get("accuracy", 0.0)
    want = [v for v in VARIABLES if v in params["want"] or v in always(accuracy)]
    width = 4 if problem.walker.knees else 3
    out: Arrays = {}
    for name in want:
        shape = (len(slope), len(GAITS), width) if "multiplier" in VARIABLES[name].dims else (len(slope), len(GAITS))
        out[name] = np.full(shape, VARIABLES[name].absent, VARIABLES[name].dtype)
    out["reason"][:] = [1, 1, 2, 2]
    for k, value in enumerate(slope.tolist()):
        _fill({name: values[k] for name, values in out.items()}, problem, branches, value, want, friction_limit)
    long = _outside(branches, n)
    reasons = status.reasons(long, long)
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


def _fill(
    out: Arrays, problem: Problem, branches: list[CycleBranch], slope: float, want: list[str], friction_limit: float
) -> None:
    """Solve every gait at one slope and store it by its label in `out`, arrays of shape (len(GAITS), ...)."""
    gaits: list[tuple[Cycle, dict[str, Any]]] = []
    for number, branch in enumerate(branches):
        for guess in branch.guesses(float(np.log(slope))):
            cycle = solve_cycle(problem, guess, slope)
            measured: dict[str, Any] = {"branch": number, "piece": guess.piece, "angle": guess.Y[0].max(), "ratio": 0.0}
            if not cycle.ok:
                measured |= {"status": status.NOT_CONVERGED, "reason": 3}
            elif any(is_same(cycle, other) for other, _ in gaits if other.ok):
                continue
            elif not really_walks(problem, cycle):
                measured |= {"status": status.NOT_CONVERGED, "reason": 4}
            else:
                measured |= _measure(problem, _from_largest(cycle), slope, want, friction_limit)
            gaits.append((cycle, measured))
    if not gaits:
        return
    place = places(*(np.array([[m[key]] for _, m in gaits]) for key in ("angle", "ratio")))[:, 0]
    for slot, (_, measured) in zip(place.tolist(), gaits, strict=True):
        if 0 <= slot < len(GAITS):
            for name, values in out.items():
                if name in measured:
                    values[slot] = measured[name]


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
    if not (cycle.ok and _keeps_apart(cycle.Y, guess.Y)):
        cycle = _correct_across(problem, guess, slope)
        cycle.ok &= _keeps_apart(cycle.Y, guess.Y)
    return cycle


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


def _measure(problem: Problem, cycle: Cycle, slope: float, want: list[str], friction_limit: float) -> dict[str, Any]:
    """Variables of a gait in the walker's units, and its `angle` and `ratio`, which determine its label."""
    walker, n = problem.walker, cycle.period
    time_unit, scale = np.sqrt(walker.leg / walker.g), np.exp2(np.floor(np.log2(cycle.Y[0])))
    slopes = np.full(n, slope)
    is_flown = any(VARIABLES[name].group == "violations" for name in want)
    parameters = problem.parameters(slopes, scale)
    step = problem.map(cycle.Y / scale, cycle.times, parameters, samples=violations.SAMPLES if is_flown else 0)
    size = problem.map.start_size
    begin = problem.map.start(cycle.Y / scale, parameters)[:size, 0] * scale[0]
    rates = begin[size // 2 :] / time_unit
    after = np.roll(cycle.Y[0], -1)
    energy = walker.total_mass * walker.g * walker.leg
    normal, tangential = heelstrike_losses(walker, after, step.impact * scale)
    knee = kneestrike_loss(walker, step.knee * scale) if walker.knees else np.zeros(n)
    length, period = float(step_length(walker, cycle.Y[0]).sum()), float(cycle.times[-1].sum()) * time_unit
    drop, speed = length / walker.leg * np.sin(slope), length / period
    losses = [float(x.sum()) for x in (normal, tangential, knee)]
    bound, residual = _error(problem, cycle, slopes, scale)
    multiplied = any(VARIABLES[name].group == "multipliers" for name in want)
    values = np.zeros(4 if walker.knees else 3, complex)
    values[: problem.m] = cycle.multipliers()
    ratio = gait_ratio(step)
    measured = {
        "angle": cycle.Y[0, 0],
        "ratio": ratio[0],
        "stance_angle": begin[0],
        "stance_rate": rates[0],
        "thigh_rate": rates[1],
        "shank_rate": rates[-1],
        "period": period,
        "kneestrike_time": cycle.times[0, 0] * time_unit if walker.knees else np.nan,
        "multiplier_real": values.real,
        "multiplier_imag": values.imag,
        "spectral_radius": np.abs(values).max(),
        "multiplier_error_bound": _multiplier_error(problem, cycle, slopes, scale, bound) if multiplied else np.nan,
        "speed": speed,
        "froude_speed": speed / np.sqrt(walker.g * walker.leg),
        "cost_of_transport": np.sin(slope),
        "power": walker.total_mass * walker.g * speed * np.sin(slope),
        "loss_normal": losses[0] * energy,
        "loss_tangential": losses[1] * energy,
        "loss_kneestrike": losses[2] * energy if walker.knees else np.nan,
        "energy_imbalance": (sum(losses) - drop) / drop,
        "heelstrike_rate_ratio": ratio[0],
        "residual": residual,
        "error_bound": bound,
        "status": status.CONVERGED if bound < _MAX_BOUND else status.NOT_CONVERGED,
        "reason": 0 if bound < _MAX_BOUND else 3,
    }
    if is_flown:
        motion = [m * scale for m in step.motion]
        # Each step begins with the heelstrike that ends the one before it.
        impact = np.roll(step.impact * scale, 1, axis=-1)
        amounts = violations.measure(walker, motion, impact, cycle.times, slopes, friction_limit)
        # Times of a gait count from its first step's start.
        amounts["unlocking_torque_time"] += (np.cumsum(cycle.times[-1]) - cycle.times[-1]) * time_unit
        measured |= _worst(amounts)
    return measured


def _multiplier_error(problem: Problem, cycle: Cycle, slope: np.ndarray, scale: np.ndarray, bound: float) -> float:
    """Bound of the error of every multiplier: how they change in other units, and where states are off by `bound`."""
    values = cycle.multipliers()
    worst = 0.0
    cases = ((1.0, 0.0), *((unit, 0.0) for unit in _UNITS), (1.0, bound), (1.0, -bound))
    for step in _evaluate(problem, cycle, slope, [(scale * unit, cycle.Y * (1 + off)) for unit, off in cases]):
        others = Cycle(cycle.Y, cycle.times, cycle.q, step.jacobian, cycle.tangent, True, 0.0).multipliers()
        apart = np.abs(values[:, None] - others)
        worst = max(worst, float(np.maximum(apart.min(axis=0), apart.min(axis=1)).max()))
    return _MULTIPLIER_SAFETY * worst + EPS * float(np.abs(values).max())


def _evaluate(
    problem: Problem, cycle: Cycle, slope: np.ndarray, cases: list[tuple[np.ndarray, np.ndarray]]
) -> list[Stride]:
    """Steps of a gait with other scales (n,) and sections (m, n), all in one call."""
    n = cycle.period
    Y = np.hstack([Y / scale for scale, Y in cases])
    parameters = np.hstack([problem.parameters(slope, scale) for scale, _ in cases])
    steps = problem.map(Y, np.tile(cycle.times, len(cases)), parameters)
    return [lanes_of(steps, slice(k * n, k * n + n)) for k in range(len(cases))]


def _worst(amounts: Arrays) -> dict[str, Any]:
    """Violations of n steps as those of one gait."""
    worst = {name: float(values.max()) for name, values in amounts.items() if values.dtype == float}
    worst["least_normal_force"] = float(amounts["least_normal_force"].min())
    if np.isfinite(amounts["unlocking_torque"]).all():
        worst["unlocking_torque_time"] = float(amounts["unlocking_torque_time"][amounts["unlocking_torque"].argmax()])
    return {**worst, "violations": int(np.bitwise_or.reduce(amounts["violations"]))}


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


def _error(problem: Problem, cycle: Cycle, slope: np.ndarray, scale: np.ndarray) -> tuple[float, float]:
    """Bound on the relative error of angles, rates and period, and the residual.

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
    moved *= _beside_flip(cycle.Y, moved)
    size = problem.map.start_size
    start, by_y = np.split(problem.map.start(cycle.Y / scale, problem.parameters(slope, scale))[:, 0], [size])
    state = np.abs(start)
    error = (np.abs(by_y.reshape(size, m)) @ moved[:, 0] / scale[0])[[0, *range(size // 2, size)]]
    section = max(error[0] / state[0], (error[1:] / state[size // 2 :].max()).max())
    late = np.abs(times - times[0]).max(axis=0).sum()
    by_section = np.abs(steps[0].times_by_y[-1]) / scale
    duration = (late + (by_section * moved).sum()) / cycle.times[-1].sum()
    return float(max(section, duration)) + 2 * EPS, float((np.abs(residual) / sizes(after)).max())
