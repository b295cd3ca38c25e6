"""Gaits of period n: fixed points of n steps, by multiple shooting over the step map.

All n sections are unknowns, so errors do not grow over many steps: a gait of 64 steps is as well conditioned as one of
a single step. Z = (sections, q) with q = ln slope; sections are in rad and rad/sqrt(leg/g), divided by sqrt(n), so
lengths along a branch mean the same for every n. The event times follow as functions of Z. In shapes, m counts section
coordinates and k phases of a step, t gaits.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tasks.continuation import pseudo_arclength as engine
from tasks.continuation.root import bracketed_root, hermite
from tasks.step.problem import Problem
from tasks.step.simulate import STRUCK
from tasks.step.simulate import stride as simulate_step

#: Largest change of the monodromy's trace over a continuation step; the next is to make half of it.
_MAX_CHANGE = 0.6
_CONTROL = engine.StepControl(
    shortest=1e-12,
    longest=np.inf,
    min_cosine=0.9,
    target=0.5 * _MAX_CHANGE,
    power=1.0,
    growth=(0.0, 1.6),
    reduction=0.4,
    max_bend=0.2,
)
#: Near the flip where a branch begins the derivative is nearly singular, and rounding makes larger steps.
_NEWTON = engine.Newton(max_iterations=15, max_step=0.3, small=1e-12, shrinking=0.3, stalled=1e-10)
#: Newton step that is rounding.
_ROUNDING_STEP = 2e-16
MAX_POINTS = 400
#: Rates at the start of a step.
RATES = ("stance_rate", "thigh_rate", "shank_rate")
#: Distance from a root at which it is located, over the distance of the points between which it lies.
_LOCATED = 3e-13
Test = Callable[["Cycle"], float]


@dataclass
class Cycle:
    """One gait of period n.

    Attributes
    ----------
    Y : ndarray, shape (m, n) [rad, rad/sqrt(leg/g)]
        Section coordinates of its steps.
    times : ndarray, shape (k, n) [sqrt(leg/g)]
        Event times of each step.
    q : float
        ln slope.
    A : ndarray, shape (m, m, n)
        Jacobians of the steps.
    tangent : ndarray, shape (m n + 1,)
        Of its branch in the coordinates Z.
    ok : bool
        Whether Newton converged.
    error : float
        Size of the last Newton step.
    times_tangent : ndarray, shape (k, n), optional
        How the event times change along the tangent.
    """

    Y: np.ndarray
    times: np.ndarray
    q: float
    A: np.ndarray
    tangent: np.ndarray
    ok: bool
    error: float
    times_tangent: np.ndarray | None = None

    @property
    def period(self) -> int:
        """Number of steps."""
        return self.Y.shape[1]

    @property
    def slope(self) -> float:
        """Slope [rad]."""
        return float(np.exp(self.q))

    @property
    def Z(self) -> np.ndarray:
        """Unknowns of the continuation, shape (m n + 1,)."""
        return np.append(self.Y.T.ravel() / np.sqrt(self.period), self.q)

    @property
    def monodromy(self) -> np.ndarray:
        """Jacobian of the n steps, shape (m, m)."""
        return product(self.A)

    def multipliers(self) -> np.ndarray:
        """Eigenvalues of the monodromy.

        Returns
        -------
        ndarray, shape (m,)
            Largest magnitude first.
        """
        values = np.linalg.eigvals(self.monodromy)
        return values[np.argsort(-np.abs(values), kind="stable")]


def product(A: np.ndarray) -> np.ndarray:
    """Product A_n ... A_1 of matrices (m, m, n)."""
    M = np.eye(A.shape[0])
    for i in range(A.shape[2]):
        M = A[:, :, i] @ M
    return M


@dataclass
class _Steps:
    """Jacobians of the steps of t gaits, shape (m, m, n, t)."""

    A: np.ndarray

    def assign(self, lanes: np.ndarray, other: _Steps) -> None:
        self.A[..., lanes] = other.A


def linearise(problem: Problem, Z: np.ndarray, n: int) -> engine.Linearisation:
    """Linearise the equations of t gaits of period n.

    Parameters
    ----------
    problem : Problem
        Of one walker, or of t lanes.
    Z : ndarray, shape (m n + 1 + k n, t)
        Sections over sqrt(n), ln slope, and event times.
    n : int

    Returns
    -------
    engine.Linearisation
    """
    m, k, t = problem.m, problem.phases, Z.shape[1]
    Y, times = Z[: m * n].reshape(n, m, t).transpose(1, 0, 2) * np.sqrt(n), Z[m * n + 1 :]
    with np.errstate(divide="ignore", invalid="ignore"):
        scale = np.where(Y[0] > 0, np.exp2(np.floor(np.log2(np.abs(Y[0])))), np.nan)
    by_q = np.exp(Z[m * n])
    lanes = problem.some(np.tile(np.arange(t), n))
    parameters = lanes.parameters(np.tile(by_q, n), scale.ravel())
    steps = lanes.map((Y / scale).reshape(m, -1), times.reshape(k, -1), parameters, slope=True)

    def of(values: np.ndarray) -> np.ndarray:
        return values.reshape(*values.shape[:-1], n, t)

    def rows(values: np.ndarray) -> np.ndarray:
        return values.transpose(2, 1, 0).reshape(t, m * n)

    A, by_y, by_slope = of(steps.jacobian), of(steps.times_by_y), of(steps.times_by_slope)
    own, after = np.arange(n), (np.arange(n) + 1) % n
    # By step and coordinate; of a gait of one step the state after it is its own.
    by_states = np.zeros((t, n, m, n, m))
    by_states[:, own, :, own] += A.transpose(2, 3, 0, 1)
    by_states[:, own, :, after] -= np.eye(m)
    derivative = np.zeros((t, m * n, m * n + 1))
    derivative[:, :, :-1] = by_states.reshape(t, m * n, m * n)
    times_by, times_by_states = np.zeros((k, n, m * n + 1, t)), np.zeros((k, n, n, m, t))
    times_by_states[:, own, own] = by_y.transpose(0, 2, 1, 3) * np.sqrt(n) / scale[:, None]
    times_by[:, :, :-1] = times_by_states.reshape(k, n, m * n, t)
    derivative[:, :, -1] = rows(of(steps.by_slope) * scale * by_q) / np.sqrt(n)
    times_by[:, :, -1] = by_slope * by_q
    residual = rows(of(steps.image) * scale - np.roll(Y, -1, axis=1)) / np.sqrt(n)
    late = steps.times.reshape(k * n, t) - times
    return engine.Linearisation(residual, derivative, times_by.reshape(k * n, -1, t), late, _Steps(A))


def system(
    problem: Problem, Y: np.ndarray, times: np.ndarray, q: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, Callable[[np.ndarray], np.ndarray]]:
    """Equations of one cycle.

    Parameters
    ----------
    Y : ndarray, shape (m, n) [rad, rad/sqrt(leg/g)]
    times : ndarray, shape (k, n) [sqrt(leg/g)]
    q : float

    Returns
    -------
    residual : ndarray, shape (m n,)
    derivative : ndarray, shape (m n, m n + 1)
        By Z.
    A : ndarray, shape (m, m, n)
        Jacobians of the steps.
    times_after : callable
        Event times after a change of Z.
    """
    Z = np.append(Y.T.ravel() / np.sqrt(Y.shape[1]), q)
    at = linearise(problem, engine.column(Z, times), Y.shape[1])

    def times_after(dZ: np.ndarray) -> np.ndarray:
        return times + (at.late[:, 0] + at.times_by[:, :, 0] @ dZ).reshape(times.shape)

    return at.residual[0], at.derivative[0], at.evaluation.A[..., 0], times_after


def correct(problem: Problem, Z: np.ndarray, times: np.ndarray, border: np.ndarray) -> Cycle:
    """Correct a cycle in the plane through Z normal to `border`, by Newton with exact derivatives.

    Parameters
    ----------
    Z, border : ndarray, shape (m n + 1,)
    times : ndarray, shape (k, n) [sqrt(leg/g)]
        Event times to begin with.

    Returns
    -------
    Cycle
    """
    n = times.shape[1]
    guess = np.append(Z, times.ravel())[:, None]
    return _cycles(_correct(problem, n, guess, np.pad(border, (0, times.size))[:, None]), n)[0]


def _correct(problem: Problem, n: int, guess: np.ndarray, border: np.ndarray) -> engine.Corrected:
    """Correct t gaits of period n in the planes through their guesses, (m n + 1 + k n, t), normal to `border`."""
    return engine.bordered_newton(
        lambda lanes, Z: linearise(problem.some(lanes), Z, n),
        lambda matrix, at: _ROUNDING_STEP,
        _NEWTON,
        guess,
        border,
        problem.m * n + 1,
    )


def _cycles(point: engine.Corrected, n: int) -> list[Cycle]:
    """Each of t corrected gaits of period n."""
    m, t = len(point.at.evaluation.A), len(point.ok)
    Y = point.Z[: m * n].reshape(n, m, t).transpose(1, 0, 2) * np.sqrt(n)
    times = point.Z[m * n + 1 :].reshape(-1, n, t)
    q, tangent = point.Z[m * n], point.direction[: m * n + 1]
    times_tangent = point.direction[m * n + 1 :].reshape(-1, n, t)
    A = point.at.evaluation.A
    Y, q = np.where(point.ok, Y, np.nan), np.where(point.ok, q, np.nan)
    A = np.where(point.ok, A, 0.0)
    ok, error = point.ok.tolist(), point.error.tolist()
    return [
        Cycle(Y[..., i], times[..., i], float(q[i]), A[..., i], tangent[:, i], ok[i], error[i], times_tangent[..., i])
        for i in range(t)
    ]


def at_slope(problem: Problem, Y: np.ndarray, times: np.ndarray, slope: float) -> Cycle:
    """Solve for the cycle at one slope.

    Parameters
    ----------
    Y : ndarray, shape (m, n) [rad, rad/sqrt(leg/g)]
        Section coordinates to begin with.
    times : ndarray, shape (k, n) [sqrt(leg/g)]
        Event times to begin with.
    slope : float [rad]

    Returns
    -------
    Cycle
    """
    return all_at_slope(problem, Y[..., None], times[..., None], slope)[0]


def all_at_slope(problem: Problem, Y: np.ndarray, times: np.ndarray, slope: float) -> list[Cycle]:
    """Solve for cycles at one slope side by side.

    Parameters
    ----------
    Y, times : ndarray, shape (m, n, t) and (k, n, t)
        To begin with, as for `at_slope`.
    slope : float [rad]

    Returns
    -------
    list of Cycle
        Of t guesses, also of those from which Newton's method fails.
    """
    m, n, t = Y.shape
    sections = Y.transpose(1, 0, 2).reshape(m * n, t) / np.sqrt(n)
    guess = np.vstack([sections, np.full((1, t), np.log(slope)), times.reshape(-1, t)])
    border = np.zeros_like(guess)
    border[m * n] = 1.0
    return _cycles(_correct(problem, n, guess, border), n)


def from_start(problem: Problem, y: np.ndarray, slope: float, n: int) -> Cycle | None:
    """Solve for the n-cycle near the n steps that begin at y; None where the walker falls or Newton fails.

    Parameters
    ----------
    y : ndarray, shape (m,) [rad, rad/sqrt(leg/g)]
    slope : float [rad]
    n : int

    Returns
    -------
    Cycle or None
    """
    Y, times = [y], []
    for _ in range(n):
        step = simulate_step(problem, Y[-1][:, None], np.array([slope]))
        if step.outcome[0] != STRUCK:
            return None
        Y.append(step.image[:, 0])
        times.append(step.times[:, 0])
    cycle = at_slope(problem, np.array(Y[:n]).T, np.array(times).T, slope)
    return cycle if cycle.ok else None


def really_walks(problem: Problem, cycle: Cycle) -> bool:
    """Whether the strikes solved for are the first ones of every step, by simulation."""
    steps = simulate_step(problem, cycle.Y, np.full(cycle.period, cycle.slope), exact=False)
    return bool((steps.outcome == STRUCK).all() and np.abs(steps.times - cycle.times).max() < 1e-4)


def flip_test(cycle: Cycle) -> float:
    """Test function that is zero where a multiplier is -1."""
    return float(np.linalg.det(cycle.monodromy + np.eye(len(cycle.Y))))


def fold_test(cycle: Cycle) -> float:
    """Test function that is zero at a fold in slope, for tangents that point along the branch."""
    return float(cycle.tangent[-1])


def largest(problem: Problem, cycle: Cycle) -> dict[str, float]:
    """Stance angle and rates of the step of a gait with the largest stance angle, in the walker's units.

    Parameters
    ----------
    problem : Problem
    cycle : Cycle
    """
    k, time_unit = int(cycle.Y[0].argmax()), np.sqrt(problem.walker.leg / problem.walker.g)
    rates = problem.start(cycle.Y[:, [k]], np.array([cycle.slope]))[1:, 0] / time_unit
    return {"stance_angle": float(cycle.Y[0, k]), **dict(zip(RATES, rates.tolist(), strict=True))}


class Path:
    """A branch of cycles continued in one direction by pseudo-arclength, a point at each call of `advance`."""

    def __init__(self, problem: Problem, first: Cycle, direction: np.ndarray, step: float):
        self.problem, self.step = problem, step
        self.points = [_orient(first, direction)]

    def advance(self) -> bool:
        """Add a point; False where none can be found."""
        last, alone = self.points[-1], np.array([0])
        Z, tangent = _placed(last)
        track = engine.Tracks(_CONTROL, Z, tangent, self.step, len(last.Z))
        if len(self.points) > 1:
            before = self.points[-2]
            distance = np.linalg.norm(last.Z - before.Z)
            Z_before, tangent_before = _placed(before)
            track.turning = (tangent - tangent_before) / distance
            if before.times_tangent is not None and last.times_tangent is not None:
                track.before, track.back = (Z_before, tangent_before), np.array([distance])

        def correct_track(guess: np.ndarray, border: np.ndarray) -> engine.Corrected:
            return _correct(self.problem, last.period, guess, border)

        def judge(point: engine.Corrected, guess: np.ndarray, error: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            (cycle,) = _cycles(point, last.period)
            change = np.abs(np.trace(cycle.monodromy) - np.trace(last.monodromy))
            return np.array([change < _MAX_CHANGE]), np.array([change])

        while track.step[0] > _CONTROL.shortest:
            point, fair = track.advance(alone, correct_track, judge)
            self.step = float(track.step[0])
            if fair[0]:
                self.points.append(_orient(_cycles(point, last.period)[0], last.tangent))
                return True
        return False

    def locate_root(self, test: Test) -> Cycle:
        """Locate the root of a test function between the last two points, where it changes sign.

        Notes
        -----
        Newton's method begins on the cubic between the nearest points that are known: near the root these are so near
        that a step or two remain.
        """
        a, b = self.points[-2:]
        chord = b.Z - a.Z
        length = float(np.linalg.norm(chord))
        along, known = chord / length, {0.0: a, length: b}

        def at(s: float) -> Cycle:
            if s not in known:
                low, high = max(x for x in known if x < s), min(x for x in known if x > s)
                (Z_low, T_low), (Z_high, T_high) = _placed(known[low]), _placed(known[high])
                distance = float(np.linalg.norm(known[high].Z - known[low].Z))
                guess = hermite(Z_low, T_low, Z_high, T_high, distance, (s - low) / (high - low))
                guess[: len(along), 0] += along * (s - along @ (guess[: len(along), 0] - a.Z))
                border = np.pad(along, (0, a.times.size))[:, None]
                known[s] = _orient(_cycles(_correct(self.problem, a.period, guess, border), a.period)[0], along)
            return known[s]

        return at(bracketed_root(lambda s: test(at(s)), 0.0, length, _LOCATED * length))


def _placed(cycle: Cycle) -> tuple[np.ndarray, np.ndarray]:
    """Unknowns and event times of a cycle as one lane, and the tangent in both; that of times is 0 where unknown."""
    late = 0 * cycle.times if cycle.times_tangent is None else cycle.times_tangent
    return engine.column(cycle.Z, cycle.times), engine.column(cycle.tangent, late)


def _orient(cycle: Cycle, direction: np.ndarray) -> Cycle:
    """Turn the cycle's tangent to the side of a direction."""
    if cycle.tangent @ direction < 0:
        cycle.tangent = -cycle.tangent
        cycle.times_tangent = None if cycle.times_tangent is None else -cycle.times_tangent
    return cycle


def doubled(problem: Problem, flip: Cycle, expected: float) -> Path | None:
    """Begin the branch of twice the period that bifurcates at a flip.

    Parameters
    ----------
    flip : Cycle
        With a multiplier of -1.
    expected : float
        Rough length in ln slope of the branch up to its own flip.

    Returns
    -------
    Path or None
        None where no point of the branch is found.

    Notes
    -----
    Along the branch the sections of the two halves differ from the flip's by +-a v, with v the eigenvector of -1, and
    ln slope by a multiple of a^2. The first point is solved for at fixed a, where the branch of the single period has
    no point.
    """
    n = flip.period
    values, vectors = np.linalg.eig(flip.monodromy)
    v = np.real(vectors[:, np.argmin(np.abs(values + 1))])
    half = []
    for i in range(n):
        half.append(v)
        v = flip.A[:, :, i] @ v
    direction = np.append(np.concatenate([np.ravel(half), -np.ravel(half)]), 0.0)
    direction /= np.linalg.norm(direction)
    base = np.append(np.tile(flip.Y, 2).T.ravel() / np.sqrt(2 * n), flip.q)
    a, farther = np.sqrt(abs(expected)) * 0.01, list[tuple[float, Cycle]]()
    for _ in range(6):
        first = correct(problem, base + a * direction, np.tile(flip.times, 2), direction)
        if first.ok and first.q != flip.q:
            farther.append((a, first))
            distance = abs(first.q - flip.q)
            if 0.02 * abs(expected) < distance < 0.3 * abs(expected):
                return Path(problem, first, direction, 0.3 * a)
            a *= np.sqrt(0.1 * abs(expected) / distance)
        else:  # Newton's steps are rounding this near the flip: between here and the last point
            a *= np.sqrt(farther[-1][0] / a) if farther and farther[-1][0] > a else 0.3
    if not first.ok and farther:
        a, first = farther[-1]
    return Path(problem, first, direction, 0.3 * a) if first.ok else None
