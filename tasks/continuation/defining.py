"""Defining equations of special points: the equations of a gait with one scalar beside
them, and Newton's method.

A point is Z (`tasks.continuation.joint`). The joint equations of a gait leave it one
freedom; a scalar that vanishes at the special point takes it. Their derivative is
exact, that of the scalar a row of central differences, which changes so little from
point to point that a row interpolated between neighbours serves as well. All are smooth
where strikes are tangential or the durations of phases vanish. In shapes, n counts
lanes, each with a walker of its own.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from gaitsweep.tasks.continuation.joint import (
    Evaluation,
    determinants,
    evaluate,
    rounding_step,
)
from gaitsweep.tasks.continuation.pseudo_arclength import (
    Newton,
    Point,
    bordered_matrix,
    bordered_newton,
)
from gaitsweep.tasks.continuation.tracking import MOST_RATE, fall_margin, rate_of_steps
from gaitsweep.tasks.fixed_points.rounding import UNITS, by_fifteen
from gaitsweep.tasks.fixed_points.step_check import LONG_BELOW, gait_ratio
from gaitsweep.tasks.mechanics.sums import norm, total
from gaitsweep.tasks.step.problem import EPS, Lanes, Problem

#: Step of the central differences.
_DIFFERENCE = 1e-5
#: A point that moves farther than this is another one. Whoever guesses better, as
#: between nodes of a branch, must look more closely: a predictor along a manifold errs
#: by nearly as much, and leads to the right point.
_MAX_MOVE = 0.5
_NEWTON = Newton(max_iterations=12, max_step=_MAX_MOVE, small=1e-7, shrinking=0.3)
_ONE_STEP = Newton(max_iterations=1, max_step=np.inf, small=0.0, shrinking=1.0)
#: Newton step after which a point that only leads to others is accurate enough.
_ENOUGH = 1e-7
#: Error of a point in estimates of what rounding moves it by.
_ROUNDING_FACTOR = 16.0


def foot_radius(problem: Problem) -> np.ndarray:
    """Return the radius of the foot over the leg, of n lanes (n,), of one walker ()."""
    walkers = problem.every_walker
    return np.asarray(walkers.R / walkers.leg)


def _log_speed(at: Evaluation) -> np.ndarray:
    """Logarithm of the mean speed in the walkers' units."""
    walkers = at.problem.every_walker
    return log_froude(at.Z, foot_radius(at.problem)) + 0.5 * np.log(
        walkers.g * walkers.leg
    )


def log_froude(Z: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """Return the logarithm of the mean speed over sqrt(g leg).

    Parameters
    ----------
    Z : ndarray, shape (c, n)
    radius : ndarray, shape (n,) or ()
        Of the foot, over the leg.

    Returns
    -------
    ndarray, shape (n,)
    """
    angle = np.exp(Z[0])
    return np.asarray(
        np.log(2 * ((1 - radius) * np.sin(angle) + radius * angle) / Z[-2])
    )


def log_froude_by_Z(Z: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """Return the derivatives of `log_froude` by Z.

    Parameters
    ----------
    Z : ndarray, shape (c, n)
    radius : ndarray, shape (n,) or ()
        Of the foot, over the leg.

    Returns
    -------
    ndarray, shape (c, n)
    """
    angle, by_Z = np.exp(Z[0]), np.zeros_like(Z)
    by_Z[0] = (
        angle
        * ((1 - radius) * np.cos(angle) + radius)
        / ((1 - radius) * np.sin(angle) + radius * angle)
    )
    by_Z[-2] = -1 / Z[-2]
    return by_Z


def _flip(at: Evaluation) -> np.ndarray:
    return determinants(at.jacobians + np.eye(at.jacobians.shape[-1]))


def _neimark_sacker(at: Evaluation) -> np.ndarray:
    """Product over i < j of (lambda_i lambda_j - 1): the determinant of the second
    compound matrix less one.
    """
    A = at.jacobians
    if A.shape[-1] == 2:
        return determinants(A) - 1
    minors = np.array(
        [
            [A[:, i, k] * A[:, j, q] - A[:, i, q] * A[:, j, k] for k, q in _PAIRS]
            for i, j in _PAIRS
        ]
    )
    return determinants(np.moveaxis(minors, -1, 0) - np.eye(3))


def _nearest(values: np.ndarray, at: Any) -> np.ndarray:
    """Of the values at each step of gaits, (s, n) or (s n,), those nearest zero, shape
    (n,).
    """
    values = values.reshape(at.stride.steps, -1)
    return np.take_along_axis(
        values, np.nan_to_num(np.abs(values)).argmin(axis=0)[None], axis=0
    )[0]


def _closing(at: Any, strike: int) -> np.ndarray:
    """Rate of the guard of a step's first (0) or last (-1) strike, over the stance
    angle.
    """
    return _nearest(at.stride.singles.closing[strike], at) / at.stride.y[0]


def _last_phase(at: Any) -> np.ndarray:
    """Duration of a step's last phase."""
    durations = np.diff(at.times, axis=0, prepend=0)
    return _nearest(
        durations.reshape(at.stride.steps, -1, durations.shape[1])[:, -1], at
    )


_PAIRS = ((0, 1), (0, 2), (1, 2))


def _fold(at: Evaluation) -> np.ndarray:
    """Determinant of the joint equations at a fixed slope."""
    return determinants(at.derivative[:, :-1].transpose(2, 0, 1))


def _stationary(at: Evaluation, by_Z: np.ndarray) -> np.ndarray:
    """Determinant that vanishes where a quantity is stationary along the branch, by its
    derivatives (c, n).
    """
    return determinants(bordered_matrix(at.derivative, by_Z))


def _less_two_thirds(at: Evaluation) -> np.ndarray:
    """Derivatives of ln angle - 2/3 ln slope by Z: where it is stationary the angle
    grows with that power of slope.
    """
    by_Z = np.zeros_like(at.Z)
    by_Z[0], by_Z[-1] = 1.0, -2 / 3
    return by_Z


#: The scalar that vanishes at a special point, by its kind.
SCALARS: dict[str, Callable[[Any], np.ndarray]] = {
    "fold": _fold,
    "flip": _flip,
    "neimark_sacker": _neimark_sacker,
    "end_kneestrike_at_heelstrike": _last_phase,
    "end_tangential_heelstrike": lambda at: _closing(at, -1),
    "end_tangential_kneestrike": lambda at: _closing(at, 0),
    "foot_at_kneestrike": lambda at: (
        _nearest(at.stride.one.knee[0] + at.stride.one.knee[1], at) / at.stride.y[0]
    ),
    "release_hyperextension": lambda at: (
        _nearest(at.stride.one.start[4] - at.stride.one.start[5], at) / at.stride.y[0]
    ),
    "fastest": lambda at: _stationary(
        at, log_froude_by_Z(at.Z, foot_radius(at.problem))
    ),
    "exponent_two_thirds": lambda at: _stationary(at, _less_two_thirds(at)),
    "label": lambda at: gait_ratio(at.stride) - LONG_BELOW,
    "window": lambda at: at.q,
    "speed": _log_speed,
}
#: The scalar that is positive beyond an end at which gaits are followed no further, by
#: its kind.
LIMITS: dict[str, Callable[[Any], np.ndarray]] = {
    "end_fall": lambda at: fall_margin(at.Z, at.stride.steps),
    "end_zero_step": lambda at: rate_of_steps(at.Z, at.m, at.stride.steps) - MOST_RATE,
}
_EVERY = SCALARS | LIMITS


@np.errstate(invalid="ignore", over="ignore", divide="ignore")
def scalar(kind: str, at: Evaluation, target: np.ndarray | float = 0.0) -> np.ndarray:
    """Return the scalar that vanishes at special points of a kind.

    Parameters
    ----------
    kind : str
        Of SCALARS or LIMITS.
    at : Evaluation
    target : ndarray, shape (n,), or float
        The value that a scalar has at the special point: of ln slope for `window`, of
        ln speed in the walker's units for `speed`.

    Returns
    -------
    ndarray, shape (n,)
    """
    return _EVERY[kind](at) - target


def gradient(problem: Problem, kind: str, Z: np.ndarray) -> np.ndarray:
    """Return the derivatives of a scalar by Z, central differences.

    Parameters
    ----------
    problem : Problem
        Of one walker, or of n lanes.
    kind : str
    Z : ndarray, shape (c, n)

    Returns
    -------
    ndarray, shape (c, n)
    """
    c, n = Z.shape
    steps = _DIFFERENCE * np.concatenate([np.eye(c), -np.eye(c)])
    moved = (Z[:, None, :] + steps.T[:, :, None]).reshape(c, -1)
    values = scalar(
        kind, evaluate(problem.some(np.tile(np.arange(n), 2 * c)), moved)
    ).reshape(2, c, n)
    return np.asarray((values[0] - values[1]) / (2 * _DIFFERENCE))


# Where heelstrike is tangential to the last digit the map has no derivative.
@np.errstate(invalid="ignore", over="ignore", divide="ignore")
def joint_derivative(
    problem: Lanes, kind: str, Z: np.ndarray, steps: np.ndarray, h: float = _DIFFERENCE
) -> tuple[np.ndarray, np.ndarray]:
    """Return the defining equations of one point and their derivative, with keys as
    further unknowns.

    By implicit differentiation the last columns give how the point moves with the keys.

    Parameters
    ----------
    problem : Lanes
        The walker, then for each key walkers with more of it by its step, then with
        less.
    kind : str
    Z : ndarray, shape (c,)
    steps : ndarray, shape (i,)
        Changes of the keys.
    h : float
        Step of the central differences by Z.

    Returns
    -------
    residual : ndarray, shape (c,)
    derivative : ndarray, shape (c, c + i)
        By Z and the keys.
    """
    c, keys = len(Z), len(steps)
    moved = np.hstack(
        [np.zeros((c, 1)), h * np.eye(c), -h * np.eye(c), np.zeros((c, 2 * keys))]
    )
    lanes = np.concatenate([np.zeros(1 + 2 * c, int), np.arange(1, 1 + 2 * keys)])
    at = evaluate(problem.some(lanes), Z[:, None] + moved)
    values = np.vstack([at.residual, scalar(kind, at)])
    up, down = np.split(values[:, 1 + 2 * c :], 2, axis=1)
    row = (values[-1, 1 : 1 + c] - values[-1, 1 + c : 1 + 2 * c]) / (2 * h)
    return values[:, 0], np.hstack(
        [np.vstack([at.derivative[..., 0], row]), (up - down) / (2 * steps)]
    )


def defining_system(
    problem: Lanes, kind: str, Z: np.ndarray, target: float = 0.0
) -> np.ndarray:
    """Return the defining equations and the determinant that vanishes where two special
    points of a kind meet.

    Parameters
    ----------
    problem : Lanes
        Of n lanes.
    kind : str
    Z : ndarray, shape (c, n)
    target : float
        As for `scalar`.

    Returns
    -------
    ndarray, shape (c + 1, n)
    """
    at = evaluate(problem, Z)
    matrix = bordered_matrix(at.derivative, gradient(problem, kind, Z))
    return np.vstack([at.residual, scalar(kind, at, target), determinants(matrix)])


class _Vanishing:
    """The equation that a scalar vanishes, over the size of its derivatives, `rows` (c,
    n).

    Newton steps bring the rows up to date, as in Broyden's method: a gait's own
    equations have their exact derivatives, and along the branch this is the secant
    method. Where a step has grown, they are taken anew.
    """

    def __init__(
        self, problem: Problem, kind: str, rows: np.ndarray, target: np.ndarray | float
    ):
        self.problem, self.kind, self.rows = problem, kind, rows.copy()
        self.target = np.broadcast_to(np.asarray(target, float), rows.shape[1])

    def __call__(
        self, lanes: np.ndarray, at: Evaluation, last: np.ndarray, grown: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        if grown.any():
            self.rows[:, lanes[grown]] = gradient(
                self.problem.some(lanes[grown]), self.kind, at.Z[:, grown]
            )
            last = np.where(grown, 0.0, last)
        value, square = scalar(self.kind, at, self.target[lanes]), total(last * last)
        self.rows[:, lanes] += last * (value / np.where(square > 0, square, np.inf))
        size = norm(self.rows[:, lanes])
        return self.rows[:, lanes] / size, value / size


def _newton(
    vanishing: _Vanishing, guess: np.ndarray, limits: Newton, samples: int = 0
) -> Point:
    """Newton's method on the equations of gaits and one more, from guesses (c, n)."""

    def linearise(lanes: np.ndarray, Z: np.ndarray) -> Evaluation:
        # A lane that wanders off ends here: what it may come back to is another point.
        near = np.abs(Z - guess[:, lanes]).max(axis=0) < _MAX_MOVE
        return evaluate(
            vanishing.problem.some(lanes), np.where(near, Z, np.nan), samples
        )

    def rounding(matrix: np.ndarray, at: Evaluation) -> np.ndarray:
        return _ROUNDING_FACTOR * rounding_step(matrix, at)

    return replace(
        bordered_newton(linearise, rounding, limits, guess, vanishing),
        rows=vanishing.rows,
    )


def newton_step(
    problem: Problem,
    kind: str,
    Z: np.ndarray,
    rows: np.ndarray,
    target: np.ndarray | float = 0.0,
    samples: int = 0,
) -> Point:
    """Evaluate points and take one Newton step on their defining equations.

    Parameters
    ----------
    problem : Lanes
        Of n lanes.
    kind : str
    Z, rows : ndarray, shape (c, n)
        The points, and the derivatives of the scalar there.
    target : ndarray, shape (n,), or float
        As for `scalar`.
    samples : int
        As for `evaluate`.

    Returns
    -------
    Point
        Evaluated before the step.
    """
    return _newton(_Vanishing(problem, kind, rows, target), Z, _ONE_STEP, samples)


def solve(
    problem: Problem,
    kind: str,
    guess: np.ndarray,
    target: np.ndarray | float = 0.0,
    rows: np.ndarray | None = None,
    quick: bool = False,
) -> Point:
    """Solve the defining equations of one kind from guesses, by Newton's method.

    Parameters
    ----------
    problem : Lanes
        Of n lanes.
    kind : str
    guess : ndarray, shape (c, n)
    target : ndarray, shape (n,), or float
        As for `scalar`.
    rows : ndarray, shape (c, n), optional
        Derivatives of the scalar nearby.
    quick : bool
        Whether the points only lead to others and need not be accurate to rounding.

    Returns
    -------
    Point
        With derivatives of the scalar that serve for Newton steps nearby; the guesses
        where it is not `ok`.
    """
    rows = gradient(problem, kind, guess) if rows is None else rows
    found = _newton(
        _Vanishing(problem, kind, rows, target),
        guess,
        replace(_NEWTON, enough=_ENOUGH * quick),
    )
    found.ok &= np.abs(found.Z - guess).max(axis=0) < _MAX_MOVE
    found.Z[:, ~found.ok] = guess[:, ~found.ok]
    return found


#: States side by side over which the variance of rounding is averaged, and how far
#: apart they are, relatively.
_STATES, _APART = 4, 1e-11
#: Bound in standard deviations of the rounding, and the relative difference by which
#: constants are varied.
_SAFETY, _VARIED = 8.0, 1e-6


# Where heelstrike is tangential to the last digit the map has no derivative.
@np.errstate(invalid="ignore", over="ignore", divide="ignore")
def slope_error(problem: Problem, kind: str, Z: np.ndarray) -> float:
    """Return a bound on the relative error of a special point's slope.

    Parameters
    ----------
    problem : Problem
        Of one walker.
    kind : str
        Of SCALARS.
    Z : ndarray, shape (c,)
        The point.

    Returns
    -------
    float
        Infinite where the defining equations are singular.

    Notes
    -----
    To first order the slope is off by what solves the linearised equations for their own values at the point, and by
    as much as rounding changes these values. Beside the residual that is the scalar,
    above all: the determinants of flips add the rounding of every derivative. Rounding
    is measured: in other units every operation rounds anew. That of the walker's
    constants, which no change of units shows, is half a unit in each one's last place.
    """
    column = Z[:, None]
    matrix = bordered_matrix(
        evaluate(problem, column).derivative, gradient(problem, kind, column)
    )[0]
    if not np.isfinite(matrix).all() or not np.linalg.cond(matrix) < 1 / EPS:
        return np.inf
    by_values = np.linalg.solve(matrix.T, np.eye(len(matrix))[-1])

    (y, scale), n = (
        problem.section(column),
        len(problem.parameters(column[-1], column[-1])) - 2,
    )
    # Neighbouring states in every unit, then the point itself with each constant
    # varied, and as it is.
    states = np.repeat(
        by_fifteen(y * (1 + _APART * np.arange(_STATES))), len(UNITS), axis=1
    )
    units = np.append(np.tile(UNITS, _STATES), np.ones(2 * n + 1))
    varied = _VARIED * np.hstack([np.eye(n), -np.eye(n), np.zeros((n, 1))])
    y = np.hstack([states, np.repeat(y, 2 * n + 1, axis=1)]) / units
    points = np.repeat(column, len(units), axis=1)
    parameters = problem.parameters(np.exp(points[-1]), scale * units)
    parameters[2:, -2 * n - 1 :] *= 1 + varied
    at = Evaluation(
        points, problem.map(y, points[problem.m : -1], parameters, slope=True), problem
    )
    off = total(by_values[:, None] * np.vstack([at.residual, scalar(kind, at)]))
    rounded, by_constants = np.split(off[:-1], [_STATES * len(UNITS)])
    std = np.sqrt(rounded.reshape(_STATES, -1).var(axis=1, ddof=1).mean())
    constants = (
        EPS
        / 2
        * np.abs(np.diff(by_constants.reshape(2, n), axis=0) / (2 * _VARIED)).sum()
    )
    return float(np.nan_to_num(abs(off[-1]) + _SAFETY * std + constants, nan=np.inf))
