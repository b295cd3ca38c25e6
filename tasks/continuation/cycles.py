"""Gaits of period n: fixed points of n strides, by multiple shooting over the stride map.

All n sections are unknowns, so the residual never grows over many strides: a 64-step gait is as well conditioned as a
step. Z = (sections, q) with q = ln slope; sections are in rad and rad/sqrt(leg/g), divided by sqrt(n), so lengths along
a branch mean the same for every n. The event times follow as functions of Z.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tasks.continuation.root import bracketed_root
from tasks.step.problem import Problem
from tasks.step.simulate import STRUCK
from tasks.step.simulate import stride as flown

#: Acceptance of a step along a branch: predictor error relative to the step, and change of the map's trace.
MAX_BEND, MAX_CHANGE = 0.2, 0.6
MAX_POINTS = 400
#: Largest step that rounding may leave of Newton's method.
BORN = 1e-10
Test = Callable[["Cycle"], float]


@dataclass
class Cycle:
    """One gait of period n: `Y` (m, n) sections, `times` (k, n), `q` = ln slope, `A` (m, m, n) Jacobians.

    `tangent` (m n + 1,) along its branch in the coordinates Z; `ok` whether Newton converged, `error` the size of its
    last step.
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
        return self.Y.shape[1]

    @property
    def slope(self) -> float:
        return float(np.exp(self.q))

    @property
    def Z(self) -> np.ndarray:
        return np.append(self.Y.T.ravel() / np.sqrt(self.period), self.q)

    @property
    def monodromy(self) -> np.ndarray:
        """Jacobian of the n strides, shape (m, m)."""
        return product(self.A)

    def multipliers(self) -> np.ndarray:
        """Eigenvalues of the n strides, largest magnitude first."""
        values = np.linalg.eigvals(self.monodromy)
        return values[np.argsort(-np.abs(values), kind="stable")]


def product(A: np.ndarray) -> np.ndarray:
    """A_n ... A_1 of A (m, m, n)."""
    M = np.eye(A.shape[0])
    for i in range(A.shape[2]):
        M = A[:, :, i] @ M
    return M


def _system(
    problem: Problem, Y: np.ndarray, times: np.ndarray, q: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, Callable[[np.ndarray], np.ndarray]]:
    """Residual and derivative by Z, the strides' Jacobians, and new times for a change of Z."""
    m, n = Y.shape
    scale = np.exp2(np.floor(np.log2(np.abs(Y[0]))))
    slope = np.full(n, np.exp(q))
    at = problem.map(Y / scale, times, problem.parameters(slope, scale), slope=True)
    residual = (at.image * scale - np.roll(Y, -1, axis=1)).T.ravel() / np.sqrt(n)
    derivative = np.zeros((m * n, m * n + 1))
    for i in range(n):
        rows = slice(m * i, m * i + m)
        derivative[rows, rows] += at.jacobian[:, :, i]
        after = m * ((i + 1) % n)
        derivative[rows, after : after + m] -= np.eye(m)
    derivative[:, -1] = (at.by_slope * scale).T.ravel() * np.exp(q) / np.sqrt(n)

    def times_after(dZ: np.ndarray) -> np.ndarray:
        dY = dZ[:-1].reshape(n, m).T * np.sqrt(n) / scale
        total = at.times + at.times_by_slope * np.exp(q) * dZ[-1]
        for i in range(m):
            total = total + at.times_by_y[:, i] * dY[i]
        return total

    return residual, derivative, at.jacobian, times_after


def correct(problem: Problem, Z: np.ndarray, times: np.ndarray, border: np.ndarray, most: int = 15) -> Cycle:
    """The cycle in the plane through Z normal to `border`, by Newton with exact derivatives."""
    n = times.shape[1]
    m = problem.m
    Z, start, last, ok, size = Z.copy(), Z, np.inf, False, np.inf
    for _ in range(most):
        Y = Z[:-1].reshape(n, m).T * np.sqrt(n)
        if not (np.isfinite(Z).all() and (Y[0] > 0).all()):
            break
        residual, derivative, A, times_after = _system(problem, Y, times, Z[-1])
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
        # Near a branch's birth the derivative is nearly singular and rounding alone makes larger steps.
        ok = size < BORN
    if not ok:
        return Cycle(np.full((m, n), np.nan), times, np.nan, np.zeros((m, m, n)), border, False, size)
    Y, tangent = Z[:-1].reshape(n, m).T * np.sqrt(n), tangent / np.linalg.norm(tangent)
    return Cycle(Y, times, float(Z[-1]), A, tangent, True, size)


def at_slope(problem: Problem, Y: np.ndarray, times: np.ndarray, slope: float) -> Cycle:
    """The cycle near Y (m, n) at one slope."""
    border = np.zeros(Y.size + 1)
    border[-1] = 1.0
    return correct(problem, np.append(Y.T.ravel() / np.sqrt(Y.shape[1]), np.log(slope)), times, border)


def from_start(problem: Problem, y: np.ndarray, slope: float, n: int) -> Cycle | None:
    """The n-cycle that n strides from y lead to by Newton; None where there is none."""
    Y, times = [y], []
    for _ in range(n):
        now = flown(problem, Y[-1][:, None], np.array([slope]))
        if now.outcome[0] != STRUCK:
            return None
        Y.append(now.image[:, 0])
        times.append(now.times[:, 0])
    found = at_slope(problem, np.array(Y[:n]).T, np.array(times).T, slope)
    return found if found.ok else None


def really_walks(problem: Problem, cycle: Cycle) -> bool:
    """True where the strikes solved for are the first ones of every stride, run forward."""
    now = flown(problem, cycle.Y, np.full(cycle.period, cycle.slope), exact=False)
    return bool((now.outcome == STRUCK).all() and np.abs(now.times - cycle.times).max() < 1e-4)


def flip_test(cycle: Cycle) -> float:
    """Zero where a multiplier is -1."""
    return float(np.linalg.det(cycle.monodromy + np.eye(len(cycle.Y))))


def fold_test(cycle: Cycle) -> float:
    """Zero where the slope turns, for tangents that point along the branch."""
    return float(cycle.tangent[-1])


class Path:
    """A branch of cycles followed one way by pseudo-arclength, growing as it is asked for."""

    def __init__(self, problem: Problem, first: Cycle, way: np.ndarray, step: float):
        self.problem, self.step = problem, step
        self.points = [_along(first, way)]

    def advance(self) -> bool:
        """Add a point; False where none can be found."""
        here = self.points[-1]
        while self.step > 1e-12:
            guess = here.Z + self.step * here.tangent
            if len(self.points) > 1:
                back = np.linalg.norm(here.Z - self.points[-2].Z)
                guess += 0.5 * self.step**2 * (here.tangent - self.points[-2].tangent) / back
            new = correct(self.problem, guess, here.times, here.tangent)
            if new.ok:
                new = _along(new, here.tangent)
                bend = np.linalg.norm(new.Z - guess) / self.step
                change = abs(np.trace(new.monodromy) - np.trace(here.monodromy))
                if bend < MAX_BEND and change < MAX_CHANGE and new.tangent @ here.tangent > 0.9:
                    self.points.append(new)
                    self.step *= min(1.6, 0.5 * MAX_CHANGE / max(change, 1e-9))
                    return True
            self.step *= 0.4
        return False

    def locate_root(self, test: Test) -> Cycle:
        """The root of a test function between the last two points (the corrector in the loop)."""
        a, b = self.points[-2:]
        length = np.linalg.norm(b.Z - a.Z)
        way = (b.Z - a.Z) / length

        def at(s: float) -> Cycle:
            h = s / length
            Z = (
                a.Z * (1 + 2 * h) * (1 - h) ** 2
                + length * a.tangent * h * (1 - h) ** 2
                + b.Z * h * h * (3 - 2 * h)
                + length * b.tangent * h * h * (h - 1)
            )
            return _along(correct(self.problem, Z, a.times * (1 - h) + b.times * h, way), way)

        root = bracketed_root(lambda s: test(at(s)), 0.0, length, 3e-13 * length)
        return at(root)


def _along(cycle: Cycle, way: np.ndarray) -> Cycle:
    if cycle.tangent @ way < 0:
        cycle.tangent = -cycle.tangent
    return cycle


def doubled(problem: Problem, flip: Cycle, expected: float) -> Path | None:
    """The branch of twice the period that is born at a flip.

    Parameters
    ----------
    flip : Cycle
        With a multiplier of -1.
    expected : float
        How far in ln slope the branch goes, roughly, before it flips itself.

    Notes
    -----
    Along the branch the sections of the two halves part by +-a v with v the eigenvector of -1, and the slope moves as
    a^2. The first point is sought at a fixed parting, where the branch of the single period is not.
    """
    n = flip.period
    values, vectors = np.linalg.eig(flip.monodromy)
    v = np.real(vectors[:, np.argmin(np.abs(values + 1))])
    half = []
    for i in range(n):
        half.append(v)
        v = flip.A[:, :, i] @ v
    way = np.append(np.concatenate([np.ravel(half), -np.ravel(half)]), 0.0)
    way /= np.linalg.norm(way)
    base = np.append(np.tile(flip.Y, 2).T.ravel() / np.sqrt(2 * n), flip.q)
    times = np.tile(flip.times, 2)
    a = np.sqrt(abs(expected)) * 0.01
    for _ in range(6):
        first = correct(problem, base + a * way, times, way)
        if first.ok and first.q != flip.q:
            moved = abs(first.q - flip.q)
            if 0.02 * abs(expected) < moved < 0.3 * abs(expected):
                return Path(problem, first, way, 0.3 * a)
            a *= np.sqrt(0.1 * abs(expected) / moved)
        else:
            a *= 0.3
    return Path(problem, first, way, 0.3 * a) if first.ok else None
