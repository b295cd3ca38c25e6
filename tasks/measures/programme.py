"""The best gait over slope and keys as a nonlinear programme, solved by sequential
quadratic programming.

Its variables are all unknowns X of a gait's equations (`tasks.branches.equations`), and
these equations are constraints like others. So a fold, beyond which there is no gait,
is an ordinary optimum, though gaits are no functions of the slope there. Derivatives
are those of the equations: exact by the gait's own unknowns, central differences by
keys and of measures.

The theory is that of Karush, Kuhn and Tucker (Nocedal & Wright, Numerical Optimization,
chapters 12 and 18); the solver is that of D. Kraft, SLSQP, as scipy has it. In shapes,
u counts the unknowns of a gait, k keys, r constraints.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy import ndarray
from scipy.linalg import null_space
from scipy.optimize import minimize, nnls

from gaitsweep.tasks.branches.conditions import CONDITIONS, Condition
from gaitsweep.tasks.branches.equations import Equations
from gaitsweep.tasks.branches.joint import Evaluation, determinants
from gaitsweep.tasks.mechanics.arrays import Coordinates, Gait

#: Most iterations from one start, and the change of the objective that ends them:
#: where everything is smooth, and otherwise.
_SMOOTH, _ROUGH = (200, 1e-13), (60, 1e-8)
#: What an equation is off by where there is no step; iterations turn back there.
_NO_STEP = 1e2
#: Gaits judged side by side.
_BLOCK = 100
#: How nearly constraints are met, and how near its limit an active one is.
MET, _ACTIVE = 1e-8, 1e-6


@dataclass(frozen=True)
class Constraint:
    """A constraint on gaits: a scalar that has a limit.

    Attributes
    ----------
    name : str
    scalar : callable
        Of evaluated steps, shape (n,).
    limit : float
    side : {1, -1, 0}
        Whether the scalar is at least its limit, at most, or equal to it.
    scale : float
        The size of the scalar.
    """

    name: str
    scalar: Callable[[Evaluation], ndarray]
    limit: float
    side: int
    scale: float = 1.0

    @property
    def bound(self) -> str:
        """Its limit in words."""
        words = {1: "at least", -1: "at most", 0: "equal to"}
        return f"{words[self.side]} {self.limit:.6g}"

    @property
    def condition(self) -> Condition:
        """How far the scalar is from its limit, over its size; not negative where an
        inequality is met.
        """
        factor = (self.side or 1) / self.scale

        def excess(at: Evaluation) -> ndarray:
            return np.asarray(factor * (self.scalar(at) - self.limit))

        return Condition("level", excess)

    def missed(self, at: Evaluation) -> ndarray:
        """Return by how much gaits miss it, over its size, shape (n,); 0 where it is
        met.
        """
        excess = np.nan_to_num(self.condition.residual(at), nan=-_NO_STEP)
        excess = np.clip(excess, -_NO_STEP, _NO_STEP)
        return np.abs(excess) if self.side == 0 else np.maximum(-excess, 0.0)


def _no_fold(at: Evaluation) -> ndarray:
    return determinants(np.eye(at.jacobians.shape[-1]) - at.jacobians)


#: What keeps all multipliers within the unit circle, as long as they have not left it:
#: none at 1, none at -1, no pair on it. Each is smooth where multipliers meet, and the
#: largest magnitude is not.
STABLE = (
    Constraint("fold", _no_fold, 0.0, 1),
    Constraint("flip", CONDITIONS["flip"].value, 0.0, 1),
    Constraint("neimark_sacker", CONDITIONS["neimark_sacker"].value, 0.0, -1),
)


def walking(knees: bool) -> tuple[Constraint, ...]:
    """Return what keeps a gait a step: the conditions by which branches end, on the
    side on which they walk.
    """
    ends = [each for each in CONDITIONS.values() if each.walking]
    return tuple(
        Constraint(each.name, each.value, float(each.target), each.walking)
        for each in ends
        if knees or not each.kind.needs_knee
    )


#: Names of the constraints that are special points where they are active.
SPECIAL = tuple(each.name for each in (*STABLE, *walking(knees=True)))


@dataclass(frozen=True)
class Objective:
    """What is made as small as it gets.

    Attributes
    ----------
    name : str
    scalar : callable or None
        Of evaluated steps, shape (n,); None where it is an unknown itself.
    unknown : int
        The place of that unknown among X.
    sign : {1, -1}
        -1 where it is made as large as it gets.
    scale : float
        Its size: iterations are fewer where it varies by about one.
    """

    name: str
    scalar: Callable[[Evaluation], ndarray] | None
    unknown: int = -1
    sign: int = 1
    scale: float = 1.0

    def values(self, at: Evaluation, X: Coordinates) -> ndarray:
        """Return what is minimised at points X (u, n)."""
        raw = X[self.unknown] if self.scalar is None else self.scalar(at)
        return np.asarray(self.sign * raw / self.scale)


class Limit(NamedTuple):
    """What keeps an optimum from being better: a constraint, or an end of a range.

    Attributes
    ----------
    name : str
    limit : float
        Its value, in the unit of what it limits.
    multiplier : float
        The derivative of the objective by it (Lagrange's multiplier).
    """

    name: str
    limit: float
    multiplier: float


@dataclass(frozen=True)
class Optimum:
    """Where iterations from one start ended.

    Attributes
    ----------
    X : ndarray, shape (u,)
    value : float
        What is minimised.
    missed : float
        By how much the equations and constraints are missed.
    stationarity : float
        The part of the objective's gradient that no active constraint balances, over
        its size.
    limits : tuple of Limit
        Those that are active.
    path : ndarray, shape (iterations, u)
        The points that iterations passed, the start first.
    message : str
        Why they ended.
    """

    X: Gait
    value: float
    missed: float
    stationarity: float
    limits: tuple[Limit, ...]
    path: ndarray
    message: str

    @property
    def is_met(self) -> bool:
        """Whether the point fulfils equations and constraints."""
        return self.missed < MET


class _Linear(NamedTuple):
    """A point to first order: the objective with its gradient (u,), and the equations
    and constraints (r,) with theirs (r, u).
    """

    value: float
    gradient: ndarray
    rows: ndarray
    derivative: ndarray


class _Active(NamedTuple):
    """An inequality that is active: its limit, its gradient (u,), and what it changes
    by with the limit.
    """

    name: str
    limit: float
    gradient: ndarray
    change: float


class _Balance(NamedTuple):
    """Multipliers of inequalities and equalities, and what they leave of a gradient."""

    of_inequalities: list[float]
    of_equalities: ndarray
    unbalanced: float


def _balance(
    gradient: ndarray, equalities: ndarray, inequalities: Sequence[ndarray]
) -> _Balance:
    """Balance a gradient (u,) by those of equalities (e, u) and of inequalities, whose
    multipliers are not negative.
    """
    if not inequalities:
        free = null_space(equalities)
        of_equalities = np.linalg.lstsq(equalities.T, gradient, rcond=None)[0]
        unbalanced = float(np.linalg.norm(free.T @ gradient))
        return _Balance([], of_equalities, unbalanced)

    # Along what the equalities leave free only inequalities balance it.
    rows, free = np.array(inequalities), null_space(equalities)
    multipliers, unbalanced = nnls(free.T @ rows.T, free.T @ gradient)
    rest = gradient - rows.T @ multipliers
    of_equalities = np.linalg.lstsq(equalities.T, rest, rcond=None)[0]
    return _Balance(multipliers.tolist(), of_equalities, float(unbalanced))


@dataclass
class Programme:
    """An objective, and what gaits must fulfil.

    Attributes
    ----------
    equations : Equations
        Without conditions, with the keys that are free; with a slope unless that is
        free too.
    objective : Objective
    constraints : sequence of Constraint
    slopes : (float, float), optional
        The window of the slope where it is free [rad].
    is_smooth : bool
        Whether everything is: what is greatest or least over samples of a step is not,
        and known to fewer digits.
    """

    equations: Equations
    objective: Objective
    constraints: Sequence[Constraint]
    slopes: tuple[float, float] | None = None
    is_smooth: bool = True
    _last: tuple[bytes, _Linear] | None = field(default=None, init=False, repr=False)

    @property
    def bounded(self) -> list[str]:
        """Names of the unknowns that have a range, in their order, the last ones."""
        assert self.equations.keys is not None
        slope = [] if self.slopes is None else ["slope"]
        return [*slope, *self.equations.keys.names]

    @property
    def bounds(self) -> ndarray:
        """Least and largest value of each unknown, infinite where it has none, shape
        (u, 2).
        """
        keys = self.equations.keys
        assert keys is not None
        bounds = np.tile([-np.inf, np.inf], (self.equations.size, 1))
        ranges = np.array([keys.low, keys.high]).T / keys.scale[:, None]
        bounds[-len(ranges) :] = ranges
        if self.slopes is not None:
            bounds[-len(ranges) - 1] = np.log(self.slopes)
        return bounds

    def judge(self, X: Coordinates) -> tuple[ndarray, ndarray]:
        """Return the objective, and by how much the constraints are missed together, at
        gaits X (u, n), each of shape (n,).
        """
        values, missed = np.empty((2, X.shape[1]))
        for first in range(0, X.shape[1], _BLOCK):
            block = slice(first, first + _BLOCK)
            at = self.equations.evaluate(X[:, block])
            of_each = [each.missed(at) for each in self.constraints]
            values[block] = self.objective.values(at, X[:, block])
            missed[block] = np.minimum(np.sum(of_each, axis=0), _NO_STEP)

        return values, missed

    def improve(self, guess: Gait) -> Optimum:
        """Return where iterations from a point near a gait end.

        Parameters
        ----------
        guess : ndarray, shape (u,)
        """
        path = [guess]
        most, enough = _SMOOTH if self.is_smooth else _ROUGH
        is_equality = self._is_equality
        found = minimize(
            lambda X: self.linear(X).value,
            guess,
            method="SLSQP",
            jac=lambda X: self.linear(X).gradient,
            bounds=self.bounds,
            constraints=[
                self._rows("eq", is_equality),
                self._rows("ineq", ~is_equality),
            ],
            callback=lambda X: path.append(X.copy()),
            options={"maxiter": most, "ftol": enough},
        )
        return self._judged(found.x, np.array(path), str(found.message))

    @property
    def _is_equality(self) -> ndarray:
        """Whether each equation of a gait, then each constraint, is an equality."""
        of_gait = self.equations.size - self.equations.freedom
        sides = [each.side == 0 for each in self.constraints]
        return np.array([True] * of_gait + sides)

    def _rows(self, kind: str, places: ndarray) -> dict[str, Any]:
        """Some of the constraints as scipy takes them."""
        return {
            "type": kind,
            "fun": lambda X: self.linear(X).rows[places],
            "jac": lambda X: self.linear(X).derivative[places],
        }

    def linear(self, X: Gait) -> _Linear:
        """Return everything at a point (u,) to first order."""
        if self._last is None or self._last[0] != X.tobytes():
            self._last = X.tobytes(), self._linearised(X)
        return self._last[1]

    def _linearised(self, X: Gait) -> _Linear:
        scalar = self.objective.scalar
        own = [] if scalar is None else [Condition("level", scalar)]
        conditions = [*(each.condition for each in self.constraints), *own]
        system = self.equations.having(conditions).at(X[:, None])
        # Beyond the ends of walking nothing has a value.
        rows = np.nan_to_num(system.residual[:, 0], nan=-_NO_STEP)
        rows = np.clip(rows, -_NO_STEP, _NO_STEP)
        derivative = np.nan_to_num(system.derivative[..., 0], posinf=0.0, neginf=0.0)

        factor = self.objective.sign / self.objective.scale
        if scalar is None:
            value = X[self.objective.unknown]
            gradient = np.eye(len(X))[self.objective.unknown]
        else:
            value, gradient = rows[-1], derivative[-1]
            rows, derivative = rows[:-1], derivative[:-1]

        return _Linear(factor * float(value), factor * gradient, rows, derivative)

    def _missed(self, X: Gait) -> ndarray:
        """By how much a point misses each equation and constraint."""
        rows = self.linear(X).rows
        return np.where(self._is_equality, np.abs(rows), np.maximum(-rows, 0.0))

    def worst(self, X: Gait) -> Constraint | None:
        """Return the constraint that a point (u,) misses most; None where it is no
        gait.
        """
        of_constraints = self._missed(X)[-len(self.constraints) :]
        worst = int(of_constraints.argmax())
        return self.constraints[worst] if of_constraints[worst] > MET else None

    def reached(
        self, constraint: Constraint, gaits: Sequence[Coordinates]
    ) -> list[tuple[float, float]]:
        """Return the least and the largest value of a constraint's scalar at gaits X
        (u, n) of several walkers; none where it has no value.
        """
        found = []
        for X in gaits:
            for first in range(0, X.shape[1], _BLOCK):
                at = self.equations.evaluate(X[:, first : first + _BLOCK])
                found.append(np.asarray(constraint.scalar(at), float))

        values = np.concatenate(found)
        known = values[np.isfinite(values)]
        return [(float(known.min()), float(known.max()))] if len(known) else []

    def _judged(self, X: Gait, path: ndarray, message: str) -> Optimum:
        """What is known of the point at which iterations ended."""
        at = self.linear(X)
        equalities = at.derivative[self._is_equality]
        active = [*self._active_constraints(X, at), *self._active_ends(X)]
        balance = _balance(at.gradient, equalities, [each.gradient for each in active])

        unit = self._unit_of_objective(X)
        limits = []
        for each, multiplier in zip(active, balance.of_inequalities, strict=True):
            limits.append(Limit(each.name, each.limit, unit * each.change * multiplier))
        fixed = [each for each in self.constraints if each.side == 0]
        of_fixed = balance.of_equalities[len(equalities) - len(fixed) :]
        for equality, multiplier in zip(fixed, of_fixed, strict=True):
            by_limit = unit * multiplier / equality.scale
            limits.append(Limit(equality.name, equality.limit, float(by_limit)))

        missed = float(self._missed(X).max())
        size = float(np.linalg.norm(at.gradient))
        stationarity = balance.unbalanced / size if size else 0.0
        return Optimum(X, at.value, missed, stationarity, tuple(limits), path, message)

    def _unit_of_objective(self, X: Gait) -> float:
        """The objective's change in its own unit, over that of what is minimised."""
        unit = 1.0
        if self.objective.scalar is None:
            ranged = self.objective.unknown + len(self.bounded)
            unit = float(self._units(X)[ranged])
        return self.objective.sign * self.objective.scale * unit

    def _active_constraints(self, X: Gait, at: _Linear) -> Iterator[_Active]:
        """The inequalities that are active at a point (u,)."""
        of_gait = self.equations.size - self.equations.freedom
        for row, each in enumerate(self.constraints, start=of_gait):
            if each.side and abs(at.rows[row]) < _ACTIVE:
                gradient, change = at.derivative[row], each.side / each.scale
                yield _Active(each.name, each.limit, gradient, change)

    def _active_ends(self, X: Gait) -> Iterator[_Active]:
        """The ends of ranges at which unknowns are at a point (u,)."""
        first = len(X) - len(self.bounded)
        unknowns = zip(self.bounded, self.bounds[first:], self._units(X), strict=True)
        for place, (name, ends, unit) in enumerate(unknowns, start=first):
            for end, side in zip(ends.tolist(), (1, -1), strict=True):
                if abs(X[place] - end) < _ACTIVE:
                    limit = float(np.exp(end)) if name == "slope" else end * float(unit)
                    gradient = side * np.eye(len(X))[place]
                    yield _Active(name, limit, gradient, side / float(unit))

    def _units(self, X: Gait) -> ndarray:
        """What one of each unknown that has a range is in its own unit."""
        keys = self.equations.keys
        assert keys is not None
        slope = [] if self.slopes is None else [np.exp(X[-len(keys.names) - 1])]
        return np.array([*slope, *keys.scale])
