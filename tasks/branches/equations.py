"""Equations as objects: those of a gait, conditions beside them, and which unknowns are
free; and Newton's method on them.

A gait's own equations leave its point Z (`tasks.branches.joint`) one freedom, by
which branches run over slope. Each condition takes a freedom, each key of the walker
that is unknown gives one, and a slope that is fixed takes one:

- no condition: a branch of gaits;
- one condition: a special point, or the gait of a given speed;
- one condition and one key: a curve of special points over slope and the key;
- one condition, two keys, a fixed slope: a curve over both keys.

The unknowns X are those of Z, without ln slope where it is fixed, then the keys. Gaits'
equations have exact derivatives by Z; by keys, and of conditions that have no formula,
they are central differences. All are smooth where strikes are tangential or the
durations of phases vanish, though the map of a step alone has no derivative there. In
shapes, n counts lanes, c unknowns of Z, k keys, r conditions, and u unknowns X.
"""

from __future__ import annotations

import copy
import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy import ndarray

from gaitsweep.tasks.branches.conditions import Condition
from gaitsweep.tasks.branches.joint import (
    Evaluation,
    determinants,
    evaluate,
    evaluate_values,
    rounding_step,
)
from gaitsweep.tasks.branches.pseudo_arclength import (
    Newton,
    Point,
    bordered_newton,
)
from gaitsweep.tasks.contract.kinds import kind_of
from gaitsweep.tasks.gaits.rounding import UNITS, by_fifteen
from gaitsweep.tasks.mechanics.arrays import Coordinates, Gait, Numbers
from gaitsweep.tasks.mechanics.lumped import Structure, structure_of
from gaitsweep.tasks.mechanics.sums import norm, total
from gaitsweep.tasks.step.drive import OVER_SLOPE, Drive, over_slopes
from gaitsweep.tasks.step.lanes import lanes_of
from gaitsweep.tasks.step.problem import EPS, Lanes, Problem
from gaitsweep.tasks.walkers.walker import ORDINARY, Walker, WalkerError
from gaitsweep.tasks.walkers.walker_array import WalkerArray

#: Step of the central differences by Z, and by keys over their ranges.
DIFFERENCE = 1e-5
#: A point that moves farther than this is another one. Whoever guesses better, as
#: between nodes of a branch, must look more closely: a predictor along a manifold errs
#: by nearly as much, and leads to the right point.
_MAX_MOVE = 0.5
_NEWTON = Newton(max_iterations=12, max_step=_MAX_MOVE, small=1e-7, shrinking=0.3)
_ONE_STEP = Newton(max_iterations=1, max_step=np.inf, small=0.0, shrinking=1.0)
#: Along a curve points are corrected from farther away, and each is alone.
_ON_CURVE = Newton(max_iterations=14, max_step=0.5, small=1e-8, shrinking=0.3)
#: Newton step after which a point that only leads to others is accurate enough.
_ENOUGH = 1e-7
#: Error of a point in estimates of what rounding moves it by; and a Newton step that is
#: rounding, where keys are unknowns.
_ROUNDING_FACTOR, _ROUNDING_WITH_KEYS = 16.0, 1e-14


@dataclass(frozen=True)
class Keys:
    """Keys of a walker as unknowns of its gaits' equations.

    In X a key is counted in the length of its range, its `scale`.

    Attributes
    ----------
    names : tuple of str, length k
    walker_at : callable
        The walker at values of the keys, one argument for each.
    low, high : tuple of float, length k
        Their ranges [the walker's units].
    ordinary : tuple of float, length k
        Values that are not special: constants of the walker that vanish only at
        special ones stay parameters.
    difference : float
        Step of the central differences, over the range.
    walkers_at : callable, optional
        The walkers at values of all keys, shape (k, n), as an array, of which the first
        is valid: beyond the ranges formulas go on, also those of measures.
    """

    names: tuple[str, ...]
    walker_at: Callable[..., Walker]
    low: tuple[float, ...]
    high: tuple[float, ...]
    ordinary: tuple[float, ...]
    difference: float = DIFFERENCE
    walkers_at: Callable[[ndarray], WalkerArray] | None = None

    @classmethod
    def of_one(
        cls, name: str, walker_at: Callable[[float], Walker], low: float, high: float
    ) -> Keys:
        """Return one key over its range, ordinary a little below the middle.

        Raises
        ------
        WalkerError
            If there is no such walker.
        """
        ordinary = low + ORDINARY * (high - low)
        walker_at(ordinary)
        return cls((name,), walker_at, (low,), (high,), (ordinary,))

    def __post_init__(self) -> None:
        """Check the ranges.

        Raises
        ------
        ValueError
            If no key is named, one twice, or a range is empty.
        """
        if not self.names or len(set(self.names)) < len(self.names):
            raise ValueError(f"keys must be named, each once; got {self.names}")
        for name, low, high in zip(self.names, self.low, self.high, strict=True):
            if not low < high:
                raise ValueError(
                    f"range of `{name}` must rise; got {low!r} to {high!r}"
                )

    @functools.cached_property
    def scale(self) -> ndarray:
        """Lengths of the ranges, shape (k,)."""
        return np.array(self.high) - np.array(self.low)

    @functools.cached_property
    def ordinary_walker(self) -> Walker:
        """The walker at ordinary values."""
        return self.walker_at(*self.ordinary)

    @functools.cached_property
    def structure(self) -> Structure:
        """Structure of the walkers at ordinary values."""
        return structure_of(self.ordinary_walker)

    def values(self, x: ndarray) -> ndarray:
        """Return the values of keys, shape (k, n) [the walker's units], at unknowns of
        that shape; the ends of their ranges where a point lies beyond.
        """
        return self._within(x * self.scale[:, None])

    def _within(self, values: ndarray) -> ndarray:
        low, high = np.reshape([self.low, self.high], (2, -1, 1))
        return np.clip(values, low, high)

    def lanes(self, x: ndarray, drive: Drive = OVER_SLOPE) -> Lanes:
        """Return the step maps at unknowns (k, n), their slopes counted as a drive has
        them.

        Beyond the ranges, where there may be no walker, their numbers and constants are
        continued linearly, or as `walkers_at` has them.
        """
        values = x * self.scale[:, None]
        different, lane = _different(values)
        if self.walkers_at is not None:
            lanes = Lanes(self.walkers_at(different), self.structure)
        else:
            lanes = self._continued(different)
        return lanes.some(lane).over(drive)

    def _continued(self, values: ndarray) -> Lanes:
        """The step maps at values (k, n), continued linearly beyond the ranges."""
        inner = self._within(values)
        lanes = self._of_values(inner)
        if (inner != values).any():
            mirrored = self._of_values(2 * inner - values)
            lanes.walkers = lanes.walkers.beyond(mirrored.walkers)
            lanes.constants = 2 * lanes.constants - mirrored.constants
        return lanes

    def _of_values(self, values: ndarray) -> Lanes:
        """The step maps at values (k, n); NaN where there is no such walker."""
        walkers, missing = [], []
        for number, each in enumerate(values.T.tolist()):
            try:
                walkers.append(self.walker_at(*each))
            except WalkerError:
                walkers.append(self.ordinary_walker)
                missing.append(number)

        lanes = Lanes(walkers, self.structure)
        lanes.constants[:, missing] = np.nan
        return lanes


def _different(values: ndarray) -> tuple[ndarray, ndarray]:
    """The different columns (k, d) of values (k, n), in their order but for those that
    are NaN, which come last, and which of them each is, (n,).
    """
    _, first, which = np.unique(values, axis=1, return_index=True, return_inverse=True)
    is_lost = np.isnan(values[:, first]).any(axis=0)
    order = np.lexsort((first, is_lost))
    return values[:, first[order]], np.argsort(order)[which.ravel()]


@dataclass
class System:
    """Equations at points of n lanes, to first order.

    Attributes
    ----------
    X : ndarray, shape (u, n)
        The points.
    residual : ndarray, shape (e, n)
        Of the gait's equations over the stance angle, then of the conditions.
    derivative : ndarray, shape (e, u, n)
    gait : Evaluation
        The steps there.
    """

    X: Coordinates
    residual: ndarray
    derivative: ndarray
    gait: Evaluation


class Equations:
    """The equations of gaits, conditions beside them, and which unknowns are free.

    Parameters
    ----------
    walkers : Problem or Keys
        The walker, or those of n lanes; or how a walker depends on keys, which are
        unknowns then.
    conditions : sequence of Condition
    slope : float, optional
        The slope where it is no unknown [rad].

    Raises
    ------
    ValueError
        If a condition stands twice, or there are more than unknowns to fulfil them.
    """

    def __init__(
        self,
        walkers: Problem | Keys,
        conditions: Sequence[Condition] = (),
        slope: float | None = None,
    ):
        self.conditions = tuple(conditions)
        self.slope = slope
        drive, counted = OVER_SLOPE, np.nan
        if slope is not None:
            drive, counted = over_slopes(slope)
        #: As branches have it, which count slopes of 0 and below from a lower one.
        self.log_slope = None if slope is None else float(np.log(counted))
        self.keys = walkers if isinstance(walkers, Keys) else None
        if isinstance(walkers, Keys):
            ordinary = [walkers.ordinary_walker]
            self.problem: Problem = Lanes(ordinary, walkers.structure, drive)
        else:
            self.problem = walkers if slope is None else walkers.over(drive)

        self._check()

    def _check(self) -> None:
        names = [condition.name for condition in self.conditions]
        scalars = [condition.value for condition in self.conditions]
        for name, scalar in zip(names, scalars, strict=True):
            if scalars.count(scalar) > 1:
                raise ValueError(f"condition `{name}` stands twice; one would do")

        if len(names) > self.freedom:
            raise ValueError(
                f"{len(names)} conditions ({', '.join(names)}) need as many free "
                f"unknowns; there are {self.freedom}"
            )
        edges = [name for name in names if kind_of(name).is_edge]
        if self.log_slope is not None and edges:
            raise ValueError(f"the slope is fixed; condition `{edges[0]}` sets it too")

    @property
    def freedom(self) -> int:
        """Number of unknowns that the gait's own equations leave free."""
        keys = 0 if self.keys is None else len(self.keys.names)
        return keys + (self.log_slope is None)

    @property
    def size(self) -> int:
        """Number u of unknowns X."""
        return self.problem.m + self.problem.phases + self.freedom

    def some(self, lanes: Numbers) -> Equations:
        """Return the equations of some lanes (j,): where keys are unknowns, each point
        has a walker of its own already.
        """
        if self.keys is not None:
            return self
        some = copy.copy(self)
        some.problem = self.problem.some(lanes)
        return some

    def over(self, drive: Drive) -> Equations:
        """Return the equations of the same gaits, with slopes counted as a drive has
        them.
        """
        other = copy.copy(self)
        other.problem = self.problem.over(drive)
        return other

    def of_steps(self, steps: int) -> Equations:
        """Return the equations of the same walkers' gaits of so many steps."""
        other = copy.copy(self)
        other.problem = self.problem.of_steps(steps)
        return other

    def having(self, conditions: Sequence[Condition]) -> Equations:
        """Return the equations of the same gaits with other conditions."""
        other = copy.copy(self)
        other.conditions = tuple(conditions)
        return other

    def split(self, X: Coordinates) -> tuple[ndarray, ndarray]:
        """Return the gaits Z (c, n) and the unknowns of the keys (k, n) of points X (u,
        n).
        """
        joint = self.problem.m + self.problem.phases
        if self.log_slope is None:
            return X[: joint + 1], X[joint + 1 :]
        q = np.full((1, X.shape[1]), self.log_slope)
        return np.vstack([X[:joint], q]), X[joint:]

    def problem_at(self, X: Coordinates) -> Problem:
        """Return the step map at points X (u, n)."""
        if self.keys is None:
            return self.problem
        lanes = self.keys.lanes(self.split(X)[1], self.problem.drive)
        return lanes.of_steps(self.problem.steps)

    def evaluate(self, X: Coordinates, samples: int = 0) -> Evaluation:
        """Evaluate steps at points X (u, n), with `samples` of their motion as
        `Problem.stride` takes them.
        """
        return evaluate(self.problem_at(X), self.split(X)[0], samples)

    def evaluate_values(self, X: Coordinates, samples: int = 0) -> Evaluation:
        """Evaluate steps as `evaluate` does, but for their derivatives."""
        return evaluate_values(self.problem_at(X), self.split(X)[0], samples)

    # Where heelstrike is tangential to the last digit the map has no derivative.
    @np.errstate(invalid="ignore", over="ignore", divide="ignore")
    def at(
        self, X: Coordinates, difference: float | None = None, samples: int = 0
    ) -> System:
        """Evaluate the equations to first order.

        Parameters
        ----------
        X : ndarray, shape (u, n)
        difference : float, optional
            Step of the central differences by Z and by keys.
        samples : int
            As for `evaluate`.
        """
        n = X.shape[1]
        by = self._by_differences()
        steps = self._steps(difference)[by]
        evaluated = self._evaluate_beside(X, by, steps, samples)

        conditions = [each.residual(evaluated) for each in self.conditions]
        values = np.vstack([evaluated.residual, *conditions])
        values = values.reshape(len(values), -1, n)
        more, less = np.split(values[:, 1:], 2, axis=1)

        here: Evaluation = lanes_of(evaluated, slice(n)) if len(by) else evaluated
        derivative = np.empty((len(values), *X.shape))
        derivative[:, by] = (more - less) / (2 * steps[:, None])
        self._set_exact(derivative, here)
        return System(X, values[:, 0], derivative, here)

    @property
    def _of_gait(self) -> int:
        """Number of unknowns that are the gait's own, not keys."""
        return self.size - (0 if self.keys is None else len(self.keys.names))

    def _by_differences(self) -> ndarray:
        """Unknowns by which derivatives are differences: the keys, and all where a
        condition has no formula.
        """
        has_formulas = all(each.by_Z is not None for each in self.conditions)
        return np.arange(self._of_gait if has_formulas else 0, self.size)

    def _evaluate_beside(
        self, X: Coordinates, by: ndarray, steps: ndarray, samples: int
    ) -> Evaluation:
        """The steps at points (u, n), then at those with more of each unknown, then at
        those with less of it.
        """
        u, n = X.shape
        shifts = np.eye(u)[:, by] * steps
        shifts = np.hstack([np.zeros((u, 1)), shifts, -shifts])
        points = (X[:, None, :] + shifts[:, :, None]).reshape(u, -1)
        lanes = np.tile(np.arange(n), shifts.shape[1])
        return self.some(lanes).evaluate(points, samples)

    def _set_exact(self, derivative: ndarray, here: Evaluation) -> None:
        """Set the derivatives (e, u, n) by the gait's own unknowns that formulas have."""
        of_gait, gait_rows = self._of_gait, len(here.residual)
        derivative[:gait_rows, :of_gait] = here.derivative[:, :of_gait]
        for row, condition in enumerate(self.conditions, start=gait_rows):
            if condition.by_Z is not None:
                derivative[row, :of_gait] = condition.by_Z(here)[:of_gait]

    def _steps(self, difference: float | None) -> ndarray:
        """Steps of the central differences by the unknowns, shape (u,)."""
        if difference is not None:
            return np.full(self.size, difference)
        steps = np.full(self.size, DIFFERENCE)
        if self.keys is not None:
            steps[self._of_gait :] = self.keys.difference
        return steps

    def gradient(self, condition: Condition, X: Coordinates) -> ndarray:
        """Return the derivatives of a condition's scalar by the unknowns.

        Parameters
        ----------
        condition : Condition
        X : ndarray, shape (u, n)

        Returns
        -------
        ndarray, shape (u, n)
        """
        if isinstance(condition.target, ndarray):  # lanes' own, of no effect here
            condition = condition.equal_to(0.0)
        return self.having([condition]).at(X).derivative[-1]


def meeting_residual(equations: Equations, X: Coordinates) -> ndarray:
    """Return the equations, as many as unknowns, and the determinant that vanishes
    where two points that fulfil them meet.

    Parameters
    ----------
    equations : Equations
    X : ndarray, shape (u, n)

    Returns
    -------
    ndarray, shape (u + 1, n)
    """
    system = equations.at(X)
    return np.vstack(
        [system.residual, determinants(system.derivative.transpose(2, 0, 1))]
    )


def sensitivity(equations: Equations, X: Gait) -> ndarray:
    """Return how a point that the conditions fix moves with the keys.

    Parameters
    ----------
    equations : Equations
        With keys, and as many conditions as unknowns are free besides them.
    X : ndarray, shape (u,)

    Returns
    -------
    ndarray, shape (u - k, k)
        Derivatives of the other unknowns by each key, per unit of it.

    Notes
    -----
    The implicit function theorem: of equations G(Z, p) = 0, dZ/dp = -G_Z^-1 G_p.
    """
    assert equations.keys is not None
    by_X = equations.at(X[:, None]).derivative[..., 0]
    by_Z, by_keys = np.split(by_X, [len(by_X)], axis=1)
    return np.asarray(-np.linalg.solve(by_Z, by_keys / equations.keys.scale))


class _LastCondition:
    """The equation that the last of several conditions is fulfilled, over the size of
    its derivatives, `rows` (u, n).

    Newton steps bring the rows up to date, as in Broyden's method: a gait's own
    equations have their exact derivatives, and along the branch this is the secant
    method. Where a step has grown, they are taken anew.
    """

    def __init__(self, equations: Equations, rows: Coordinates):
        self.equations, self.rows = equations, rows.copy()
        self.condition = equations.conditions[-1]

    def __call__(
        self, lanes: Numbers, at: System, last: Coordinates, grown: ndarray
    ) -> tuple[ndarray, ndarray]:
        if grown.any():
            self.rows[:, lanes[grown]] = self.equations.some(lanes[grown]).gradient(
                self.condition, at.X[:, grown]
            )
            last = np.where(grown, 0.0, last)

        value = self.condition.some(lanes).residual(at.gait)
        square = total(last * last)
        self.rows[:, lanes] += last * (value / np.where(square > 0, square, np.inf))
        size = norm(self.rows[:, lanes])
        return self.rows[:, lanes] / size, value / size


def _newton(
    equations: Equations,
    guess: Coordinates,
    rows: Coordinates,
    limits: Newton,
    samples: int = 0,
) -> Point:
    """Newton's method on as many equations as unknowns, from guesses (u, n)."""
    others = equations.having(equations.conditions[:-1])
    last = _LastCondition(equations, rows)

    def linearise(lanes: Numbers, X: Coordinates) -> System:
        # A lane that wanders off ends here: what it may come back to is another point.
        near = np.abs(X - guess[:, lanes]).max(axis=0) < _MAX_MOVE
        return others.some(lanes).at(np.where(near, X, np.nan), samples=samples)

    def rounding(matrix: ndarray, at: System) -> ndarray | float:
        if len(equations.conditions) > 1 or equations.keys is not None:
            return _ROUNDING_WITH_KEYS
        return _ROUNDING_FACTOR * rounding_step(matrix, at.gait)

    found = bordered_newton(linearise, rounding, limits, guess, last)
    return replace(found, at=found.at.gait, rows=last.rows)


def newton_step(
    equations: Equations, X: Coordinates, rows: Coordinates, samples: int = 0
) -> Point:
    """Evaluate points and take one Newton step on their equations.

    Parameters
    ----------
    equations : Equations
        As many as unknowns.
    X, rows : ndarray, shape (u, n)
        The points, and the derivatives of the last condition's scalar there.
    samples : int
        As for `Equations.evaluate`.

    Returns
    -------
    Point
        Evaluated before the step.
    """
    return _newton(equations, X, rows, _ONE_STEP, samples)


def solve(
    equations: Equations,
    guess: Coordinates,
    rows: Coordinates | None = None,
    quick: bool = False,
) -> Point:
    """Solve as many equations as unknowns from guesses, by Newton's method.

    Parameters
    ----------
    equations : Equations
        With a condition for every freedom of the gaits.
    guess : ndarray, shape (u, n)
    rows : ndarray, shape (u, n), optional
        Derivatives of the last condition's scalar nearby.
    quick : bool
        Whether the points only lead to others and need not be accurate to rounding.

    Returns
    -------
    Point
        With derivatives of the last condition's scalar that serve for Newton steps
        nearby; the guesses where it is not `ok`.

    Raises
    ------
    ValueError
        If unknowns are left free, or none is.
    """
    conditions = len(equations.conditions)
    if not conditions or conditions < equations.freedom:
        raise ValueError(
            f"{equations.freedom} unknowns are free and {conditions} conditions given; "
            "solving takes one for each, and one at least"
        )
    if rows is None:
        rows = equations.gradient(equations.conditions[-1], guess)
    limits = replace(_NEWTON, enough=_ENOUGH * quick)
    found = _newton(equations, guess, rows, limits)
    found.ok &= np.abs(found.Z - guess).max(axis=0) < _MAX_MOVE
    found.Z[:, ~found.ok] = guess[:, ~found.ok]
    return found


def correct_on_curve(
    equations: Equations, X: Coordinates, border: Coordinates
) -> Point:
    """Correct points of curves: the solutions in the planes through them normal to some
    directions, by Newton's method.

    Parameters
    ----------
    equations : Equations
        One fewer than unknowns.
    X, border : ndarray, shape (u, n)
        Points nearby, and the directions.

    Returns
    -------
    Point
        Whose `Z` are X; `at` is a `System`. Not `ok` where there is no such walker.
    """
    m, joint = equations.problem.m, equations.problem.m + equations.problem.phases
    sized = [*range(m), *range(joint, equations.size)]

    def linearise(lanes: Numbers, X: Coordinates) -> System:
        return equations.some(lanes).at(X)

    return bordered_newton(
        linearise, lambda *_: _ROUNDING_WITH_KEYS, _ON_CURVE, X, border, sized
    )


#: States side by side over which the variance of rounding is averaged, and how far
#: apart they are, relatively.
_STATES, _APART = 4, 1e-11
#: Bound in standard deviations of the rounding, and the relative difference by which
#: constants are varied.
_SAFETY, _VARIED = 8.0, 1e-6


def slope_error(problem: Problem, condition: Condition, Z: Gait) -> float:
    """Return a bound on the relative error of a special point's slope.

    Parameters
    ----------
    problem : Problem
        Of one walker.
    condition : Condition
    Z : ndarray, shape (c,)
        The point.

    Returns
    -------
    float
        Infinite where the defining equations are singular.
    """
    return float(errors(Equations(problem, [condition]), Z, 1)[0])


# Where heelstrike is tangential to the last digit the map has no derivative.
@np.errstate(invalid="ignore", over="ignore", divide="ignore")
def errors(equations: Equations, X: Gait, last: int) -> ndarray:
    """Return bounds on the errors of a point's last unknowns.

    Parameters
    ----------
    equations : Equations
        As many as unknowns, of one walker or over its keys.
    X : ndarray, shape (u,)
        The point.
    last : int
        Number of unknowns, such as ln slope and a key.

    Returns
    -------
    ndarray, shape (last,)
        Infinite where the defining equations are singular.

    Notes
    -----
    To first order an unknown is off by what solves the linearised equations for their own
    values at the point, and by as much as rounding changes these values. Beside the
    residual that is the scalar, above all: the determinants of flips add the rounding of
    every derivative. Rounding is measured: in other units every operation rounds anew.
    That of the walker's constants, which no change of units shows, is half a unit in
    each one's last place.
    """
    matrix = equations.at(X[:, None]).derivative[..., 0]
    if not np.isfinite(matrix).all() or not np.linalg.cond(matrix) < 1 / EPS:
        return np.full(last, np.inf)

    by_values = np.linalg.solve(matrix.T, np.eye(len(matrix))[:, -last:])

    Z, _ = equations.split(X[:, None])
    at = _in_units_and_varied(equations.problem_at(X[:, None]).alone(0), Z)
    scalars = [condition.residual(at) for condition in equations.conditions]
    values = np.vstack([at.residual, *scalars])
    off = total(by_values[:, :, None] * values[:, None])
    bounds = [_bound_of_unknown(each) for each in off]
    return np.nan_to_num(np.array(bounds), nan=np.inf)


def _bound_of_unknown(off: ndarray) -> float:
    """Bound on the error of an unknown, by how far it is off in other units, with varied
    constants and at the point itself, in the order of `_in_units_and_varied`.
    """
    n_states = _STATES * len(UNITS)
    by_rounding = off[:n_states].reshape(_STATES, -1)
    variance = by_rounding.var(axis=1, ddof=1).mean()
    up, down = np.split(off[n_states:-1], 2)
    by_constants = np.abs((down - up) / (2 * _VARIED)).sum()
    return float(abs(off[-1]) + _SAFETY * np.sqrt(variance) + EPS / 2 * by_constants)


def _in_units_and_varied(problem: Problem, Z: Coordinates) -> Evaluation:
    """The steps at a point Z (c, 1): of neighbouring states in every unit, then of the
    point itself with each constant varied up and down, and as it is.
    """
    n_constants = len(problem.parameters(Z[-1], Z[-1])) - 2
    changes = _VARIED * np.eye(n_constants)
    unchanged = np.zeros((n_constants, 1))
    changes = np.hstack([changes, -changes, unchanged])
    n_varied = changes.shape[1]

    y, scale = problem.section(Z)
    apart = y * (1 + _APART * np.arange(_STATES))
    in_units = np.repeat(by_fifteen(apart), len(UNITS), axis=1)
    as_they_are = np.repeat(y, n_varied, axis=1)
    units = np.append(np.tile(UNITS, _STATES), np.ones(n_varied))

    points = np.repeat(Z, len(units), axis=1)
    parameters = problem.parameters(np.exp(points[-1]), scale * units)
    parameters[2:, -n_varied:] *= 1 + changes
    sections = np.hstack([in_units, as_they_are]) / units
    times = points[problem.m : -1]
    stride = problem.map(sections, times, parameters, by_drive=True)
    return Evaluation(points, stride, problem)
