"""Gaits of period n: fixed points of n steps, by multiple shooting over the step map.

All n sections are unknowns, so errors do not grow over many steps: a gait of 64 steps is as well conditioned as one of
a single step. Z = (sections, q) with q = ln slope; sections are in rad and rad/sqrt(leg/g), divided by sqrt(n), so
lengths along a branch mean the same for every n. The event times follow as functions of Z. In shapes, m counts section
coordinates and k phases of a step.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tasks.continuation.root import bracketed_root, hermite
from tasks.step.problem import Problem
from tasks.step.simulate import STRUCK
from tasks.step.simulate import stride as simulate_step

#: Acceptance of a continuation step: predictor error relative to its length, and change of the monodromy's trace.
_MAX_BEND, _MAX_CHANGE = 0.2, 0.6
MAX_POINTS = 400
#: Largest Newton step that may be due to rounding, where the derivative is nearly singular.
_MAX_ROUNDING_STEP = 1e-10
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
    """

    Y: np.ndarray
    times: np.ndarray
    q: float
    A: np.ndarray
    tangent: np.ndarray
    ok: bool
    error: float

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
        return _product(self.A)

    def multipliers(self) -> np.ndarray:
        """Eigenvalues of the monodromy.

        Returns
        -------
        ndarray, shape (m,)
            Largest magnitude first.
        """
        values = np.linalg.eigvals(self.monodromy)
        return values[np.argsort(-np.abs(values), kind="stable")]


def _product(A: np.ndarray) -> np.ndarray:
    """Product A_n ... A_1 of matrices (m, m, n)."""
    M = np.eye(A.shape[0])
    for i in range(A.shape[2]):
        M = A[:, :, i] @ M
    return M


def system(
    problem: Problem, Y: np.ndarray, times: np.ndarray, q: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, Callable[[np.ndarray], np.ndarray]]:
    """Equations of a cycle.

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
    m, n = Y.shape
    scale = np.exp2(np.floor(np.log2(np.abs(Y[0]))))
    slope = np.full(n, np.exp(q))
    steps = problem.map(Y / scale, times, problem.parameters(slope, scale), slope=True)
    residual = (steps.image * scale - np.roll(Y, -1, axis=1)).T.ravel() / np.sqrt(n)
    derivative = np.zeros((m * n, m * n + 1))
    for i in range(n):
        rows = slice(m * i, m * i + m)
        derivative[rows, rows] += steps.jacobian[:, :, i]
        after = m * ((i + 1) % n)
        derivative[rows, after : after + m] -= np.eye(m)
    derivative[:, -1] = (steps.by_slope * scale).T.ravel() * np.exp(q) / np.sqrt(n)

    def times_after(dZ: np.ndarray) -> np.ndarray:
        dY = dZ[:-1].reshape(n, m).T * np.sqrt(n) / scale
        total = steps.times + steps.times_by_slope * np.exp(q) * dZ[-1]
        for i in range(m):
            total = total + steps.times_by_y[:, i] * dY[i]
        return total

    return residual, derivative, steps.jacobian, times_after


def correct(problem: Problem, Z: np.ndarray, times: np.ndarray, border: np.ndarray, max_iterations: int = 15) -> Cycle:
    """Correct a cycle in the plane through Z normal to `border`, by Newton with exact derivatives.

    Parameters
    ----------
    Z, border : ndarray, shape (m n + 1,)
    times : ndarray, shape (k, n) [sqrt(leg/g)]
        Event times to begin with.
    max_iterations : int
        Newton steps.

    Returns
    -------
    Cycle
    """
    n = times.shape[1]
    m = problem.m
    Z, start, last, ok, size = Z.copy(), Z, np.inf, False, np.inf
    for _ in range(max_iterations):
        Y = Z[:-1].reshape(n, m).T * np.sqrt(n)
        if not (np.isfinite(Z).all() and (Y[0] > 0).all()):
            break
        residual, derivative, A, times_after = system(problem, Y, times, Z[-1])
        matrix = np.vstack([derivative, border])
        if not (np.isfinite(matrix).all() and np.isfinite(residual).all()):
            break
        try:
            right = np.zeros((len(matrix), 2))
            right[:-1, 0], right[-1] = -residual, (border @ (start - Z), 1.0)
            dZ, tangent = np.linalg.solve(matrix, right).T
        except np.linalg.LinAlgError:
            break
        size = float(np.abs(dZ).max())
        if size > 0.3:
            break
        Z, times = Z + dZ, times_after(dZ)
        # Done when the step is rounding, or small and no longer shrinking.
        if size < 2e-16 or (size < 1e-12 and size > 0.3 * last):
            ok = True
            break
        last = size
    else:
        # Near the flip where a branch begins the derivative is nearly singular, and rounding makes larger steps.
        ok = size < _MAX_ROUNDING_STEP
    if not ok:
        return Cycle(np.full((m, n), np.nan), times, np.nan, np.zeros((m, m, n)), border, False, size)
    Y, tangent = Z[:-1].reshape(n, m).T * np.sqrt(n), tangent / np.linalg.norm(tangent)
    return Cycle(Y, times, float(Z[-1]), A, tangent, True, size)


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
    border = np.zeros(Y.size + 1)
    border[-1] = 1.0
    return correct(problem, np.append(Y.T.ravel() / np.sqrt(Y.shape[1]), np.log(slope)), times, border)


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


class Path:
    """A branch of cycles continued in one direction by pseudo-arclength, a point at each call of `advance`."""

    def __init__(self, problem: Problem, first: Cycle, direction: np.ndarray, step: float):
        self.problem, self.step = problem, step
        self.points = [_orient(first, direction)]

    def advance(self) -> bool:
        """Add a point; False where none can be found."""
        last = self.points[-1]
        while self.step > 1e-12:
            guess = last.Z + self.step * last.tangent
            if len(self.points) > 1:
                back = np.linalg.norm(last.Z - self.points[-2].Z)
                guess += 0.5 * self.step**2 * (last.tangent - self.points[-2].tangent) / back
            new = correct(self.problem, guess, last.times, last.tangent)
            if new.ok:
                new = _orient(new, last.tangent)
                bend = np.linalg.norm(new.Z - guess) / self.step
                change = abs(np.trace(new.monodromy) - np.trace(last.monodromy))
                if bend < _MAX_BEND and change < _MAX_CHANGE and new.tangent @ last.tangent > 0.9:
                    self.points.append(new)
                    self.step *= min(1.6, 0.5 * _MAX_CHANGE / max(change, 1e-9))
                    return True
            self.step *= 0.4
        return False

    def locate_root(self, test: Test) -> Cycle:
        """Locate the root of a test function between the last two points, where it changes sign."""
        a, b = self.points[-2:]
        length = float(np.linalg.norm(b.Z - a.Z))
        direction = (b.Z - a.Z) / length

        def at(s: float) -> Cycle:
            h = s / length
            Z = hermite(a.Z, a.tangent, b.Z, b.tangent, length, h)
            return _orient(correct(self.problem, Z, a.times * (1 - h) + b.times * h, direction), direction)

        root = bracketed_root(lambda s: test(at(s)), 0.0, length, 3e-13 * length)
        return at(root)


def _orient(cycle: Cycle, direction: np.ndarray) -> Cycle:
    """Turn the cycle's tangent to the side of a direction."""
    if cycle.tangent @ direction < 0:
        cycle.tangent = -cycle.tangent
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
    times = np.tile(flip.times, 2)
    a = np.sqrt(abs(expected)) * 0.01
    for _ in range(6):
        first = correct(problem, base + a * direction, times, direction)
        if first.ok and first.q != flip.q:
            distance = abs(first.q - flip.q)
            if 0.02 * abs(expected) < distance < 0.3 * abs(expected):
                return Path(problem, first, direction, 0.3 * a)
            a *= np.sqrt(0.1 * abs(expected) / distance)
        else:
            a *= 0.3
    return Path(problem, first, direction, 0.3 * a) if first.ok else None
