"""How far rounding moves the slope of a flip or fold of gaits of period n.

A flip is a zero of the equations of the n sections together with its test function, det(M + 1) of the product M of the
Jacobians A; at a fold the derivative by the sections is singular. What rounding does to images and Jacobians is
measured in several units, in each of which every operation rounds anew, and carried to the slope by the linearised
equations. In shapes, m counts section coordinates and n steps.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tasks.continuation.cycles import Cycle, system
from tasks.fixed_points.rounding import UNITS, by_fifteen
from tasks.step.problem import EPS, Problem, sizes

#: Relative difference by which Jacobians are differentiated.
_DIFFERENCE = 1e-6
#: Bound in standard deviations of the measured rounding.
_SAFETY = 4.0
#: Rounding of a slope as the exponential of its logarithm.
_MIN_ERROR = 8 * EPS


@dataclass(frozen=True)
class _Steps:
    """Images (m, n) and Jacobians (m, m, n) of the steps of a gait."""

    image: np.ndarray
    A: np.ndarray


def _evaluate(problem: Problem, cycle: Cycle, unit: float = 1.0, Y: np.ndarray | None = None) -> _Steps:
    """Steps of a gait, in another unit or from sections Y."""
    Y = cycle.Y if Y is None else Y
    scale = np.exp2(np.floor(np.log2(cycle.Y[0]))) * unit
    parameters = problem.parameters(np.full(cycle.period, cycle.slope), scale)
    steps = problem.map(Y / scale, cycle.times, parameters)
    # Jacobians depend to first order on how well the strikes are timed.
    steps = problem.map(Y / scale, steps.times, parameters)
    return _Steps(steps.image * scale, steps.jacobian)


def slope_error(problem: Problem, cycle: Cycle, kind: str) -> float:
    """Bound on the relative error of the slope of a flip or fold: what is left to a solution, and rounding.

    Parameters
    ----------
    problem : Problem
    cycle : Cycle
        The gait there.
    kind : str
        `flip` or `fold`.

    Returns
    -------
    float
    """
    m, n = cycle.Y.shape
    _, derivative, _, _ = system(problem, cycle.Y, cycle.times, cycle.q)
    steps = _evaluate(problem, cycle)
    rounded = [_evaluate(problem, cycle, unit, by_fifteen(cycle.Y)) for unit in UNITS]
    residual = (steps.image - np.roll(cycle.Y, -1, axis=1)).T.ravel() / np.sqrt(n)
    images = _deviation([each.image for each in rounded], EPS / 2 * sizes(cycle.Y)).T.ravel() / np.sqrt(n)
    if kind == "fold":
        # To first order the slope does not depend on where along the branch the fold is located.
        across = np.linalg.svd(derivative[:, :-1])[0][:, -1]
        across /= across @ derivative[:, -1]
        return float(abs(across @ residual) + _SAFETY * np.linalg.norm(across * images)) + _MIN_ERROR
    turned = _deviation([each.A for each in rounded], EPS / 2 * np.abs(steps.A))
    test, by_A = _test(steps.A)
    by_section = np.zeros((m, n))
    h = _DIFFERENCE * np.abs(cycle.Y).max()
    for k in range(m):
        # A section changes the Jacobian of its own step alone.
        step = np.zeros((m, 1))
        step[k] = h
        up, down = (_evaluate(problem, cycle, Y=cycle.Y + sign * step).A for sign in (1, -1))
        by_section[k] = (by_A * (up - down)).sum(axis=(0, 1)) / (2 * h)
    row = np.append(by_section.T.ravel() * np.sqrt(n), _by_slope(problem, cycle, by_A))
    matrix = np.vstack([derivative, row])
    moves = np.linalg.solve(matrix.T, np.append(np.zeros(m * n), 1.0))
    off = moves @ np.append(residual, test)
    rounding = np.hypot(np.linalg.norm(moves[:-1] * images), moves[-1] * np.linalg.norm(by_A * turned))
    return float(abs(off) + _SAFETY * rounding) + _MIN_ERROR


def _deviation(values: list[np.ndarray], least: np.ndarray) -> np.ndarray:
    """Standard deviation of what was evaluated in several units, but at least that of one rounding."""
    return np.hypot(np.std(values, axis=0, ddof=1), least)


def _by_slope(problem: Problem, cycle: Cycle, by_A: np.ndarray) -> float:
    """Derivative of the test function by ln slope, where the sections stay."""
    up, down = (
        _evaluate(problem, Cycle(cycle.Y, cycle.times, cycle.q + h, cycle.A, cycle.tangent, True, 0.0)).A
        for h in (_DIFFERENCE, -_DIFFERENCE)
    )
    return float((by_A * (up - down)).sum() / (2 * _DIFFERENCE))


def _test(A: np.ndarray) -> tuple[float, np.ndarray]:
    """The flip's test function of Jacobians A (m, m, n), and its derivative by them, of the same shape."""
    m, _, n = A.shape
    before, after = [np.eye(m)], [np.eye(m)]
    for i in range(n):
        before.append(A[:, :, i] @ before[-1])
        after.append(after[-1] @ A[:, :, n - 1 - i])
    left, values, right = np.linalg.svd(before[-1] + np.eye(m))
    sign = np.linalg.det(left) * np.linalg.det(right)
    # The adjugate, which a singular matrix has too.
    cofactors = np.diag([np.delete(values, k).prod() for k in range(m)])
    adjugate = sign * right.T @ cofactors @ left.T
    by_A = [(before[i] @ adjugate @ after[n - 1 - i]).T for i in range(n)]
    return sign * float(values.prod()), np.stack(by_A, axis=-1)
