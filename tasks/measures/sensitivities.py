"""Derivatives of the measures of a gait by slope and by the keys of its walker.

The implicit function theorem gives how a gait moves with a key p: of its equations
G(w, p) = 0, dw/dp = -G_w^-1 G_p. A measure M(w, p) then has the derivative M_w dw/dp +
M_p. G_w and the derivative of G by slope are exact; G_p, M_w and M_p are differences
over six points, whose error is of the sixth order.

In shapes, n counts gaits, c the unknowns Z of one (`tasks.branches.joint`), r measures.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from gaitsweep.tasks.branches.equations import Equations, Keys
from gaitsweep.tasks.branches.joint import Evaluation
from gaitsweep.tasks.contract.registry import BY_KEY, SENSITIVITIES, VARIABLES
from gaitsweep.tasks.gaits.polish import Polished
from gaitsweep.tasks.measures.levels import measures, measures_at
from gaitsweep.tasks.mechanics.arrays import Coordinates
from gaitsweep.tasks.mechanics.sums import matvec, total
from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.walkers.resolve import walkers_over
from gaitsweep.tasks.walkers.walker import (
    BOUNDS,
    DIFFERENTIATED,
    KEYS,
    ONE_LINK,
    Walker,
    WalkerError,
)

#: Derivatives of a function by its values at multiples of a step, with their weights
#: over the step: where it is defined on both sides, and beyond a least value.
_CENTRAL = (
    np.array([-3.0, -2.0, -1.0, 1.0, 2.0, 3.0]),
    np.array([-1.0, 9.0, -45.0, 45.0, -9.0, 1.0]) / 60,
)
_FORWARD = (
    np.arange(7.0),
    np.array([-147.0, 360.0, -450.0, 400.0, -225.0, 72.0, -10.0]) / 60,
)
_Stencil = tuple[np.ndarray, np.ndarray]
#: The step, of a gait in its unknowns and of a key over its length, on which gaits may
#: depend a hundred times as much.
_STEP = 1e-4

SLOPE = "slope"
Measured = dict[str, np.ndarray]


@dataclass(frozen=True)
class KeyOfWalker:
    """A key by which gaits are differentiated.

    Attributes
    ----------
    name : str
    value : float
        That of the walker [the walker's units].
    walker_at : callable
        The walker at other values of it.
    """

    name: str
    value: float
    walker_at: Callable[[float], Walker]

    @property
    def range(self) -> tuple[float, float]:
        """Values nearby: those within a characteristic length, mass or angle of the
        walker, or a tenth of them where walkers end sooner.

        Raises
        ------
        WalkerError
            If there is no walker beside its own.
        """
        walker = self.walker_at(self.value)
        least = _LEAST.get(self.name, -np.inf)
        reach = _size(self.name, walker)
        for _ in range(_TRIALS):
            low, high = max(least, self.value - reach), self.value + reach
            if self._are_walkers(low, high):
                return low, high
            reach /= 10
        why = f"has no walkers beside {self.value:.6g}"
        raise WalkerError(self.name, self.value, why)

    def _are_walkers(self, low: float, high: float) -> bool:
        try:
            for value in (low, high):
                self.walker_at(value)
        except WalkerError:
            return False
        return True


#: Least values of keys.
_LEAST = {name: least for name, (least, _) in BOUNDS.items()} | {"foot_mass_ratio": 0.0}
#: How often the range of a key is made a tenth.
_TRIALS = 6


def _size(name: str, walker: Walker) -> float:
    """Characteristic size of a kind of key."""
    sizes = {
        "length": walker.leg,
        "mass": walker.total_mass,
        "angle": 1.0,
        "acceleration": walker.g,
    }
    sizes["torque"] = sizes["stiffness"] = walker.total_mass * walker.g * walker.leg
    sizes["damping"] = sizes["torque"] * walker.time_unit
    sizes["impulse"] = walker.total_mass * walker.leg / walker.time_unit
    kind = KEYS.get(name) or ONE_LINK.get(name)
    return 1.0 if kind is None else sizes[kind]


@dataclass(frozen=True)
class _Neighbourhood:
    """Gaits with their measures to first order in their unknowns.

    Attributes
    ----------
    problem : Problem
        Of one walker, over slopes.
    Z : ndarray, shape (c, n)
        The gaits.
    names : sequence of str
        Of r measures.
    of_gait : ndarray, shape (c - 1, c, n)
        Derivative of the gaits' equations by Z.
    of_measures : ndarray, shape (r, c, n)
        That of the measures.
    """

    problem: Problem
    Z: Coordinates
    names: Sequence[str]
    of_gait: np.ndarray
    of_measures: np.ndarray

    @classmethod
    def of(
        cls, problem: Problem, Z: Coordinates, names: Sequence[str]
    ) -> _Neighbourhood:
        """Differentiate gaits and measures by Z, the latter by differences."""
        equations = Equations(problem)
        of_gait = equations.at(Z).derivative
        of_measures = np.empty((len(names), *Z.shape))
        for unknown in range(len(Z)):
            of_measures[:, unknown] = _differences(
                partial(_measured, names), equations, Z, unknown, _CENTRAL
            )
        return cls(problem, Z, names, of_gait, of_measures)

    def by_slope(self) -> Measured:
        """Derivatives of measures by slope [the walker's units, over rad]."""
        by_log_slope = self._in_all(self.of_gait[:, -1], self.of_measures[:, -1])
        return self._named(by_log_slope / np.exp(self.Z[-1]))

    def by_key(self, key: KeyOfWalker) -> Measured:
        """Derivatives of measures by a key of the walker, at a fixed slope [the walker's
        units, over those of the key].

        Raises
        ------
        WalkerError
            If there is no walker beside its own, or those beside it have gaits with
            other unknowns, as feet without mass have.
        """
        keys = Keys.of_one(key.name, key.walker_at, *key.range)
        equations = Equations(keys).over(self.problem.drive)
        if equations.problem.m != self.problem.m:
            why = "is special: gaits of the walkers beside it have other unknowns"
            raise WalkerError(key.name, key.value, why)

        scale = keys.scale[0]
        own = np.full((1, self.Z.shape[1]), key.value / scale)
        is_least = key.value + _CENTRAL[0][0] * _STEP * scale < keys.low[0]
        stencil = _FORWARD if is_least else _CENTRAL
        both = _differences(
            partial(_residual_and_measured, self.names),
            equations,
            np.vstack([self.Z, own]),
            len(self.Z),
            stencil,
        )
        residual, measures = np.split(both, [len(self.Z) - 1])
        return self._named(self._in_all(residual, measures) / scale)

    def _in_all(self, by_residual: np.ndarray, by_measures: np.ndarray) -> np.ndarray:
        """Derivatives (r, n) of measures of gaits by what changes their equations
        (c - 1, n) and, of a gait that does not move, its measures (r, n).
        """
        moved = _moved(self.of_gait[:, :-1], by_residual)
        return by_measures + matvec(self.of_measures[:, :-1], moved)

    def _named(self, values: np.ndarray) -> Measured:
        return dict(zip(self.names, values, strict=True))


def _moved(by_w: np.ndarray, by_other: np.ndarray) -> np.ndarray:
    """How gaits move with another unknown: -G_w^-1 G_p, shape (c - 1, n); NaN where the
    equations are singular.
    """
    matrices, values = np.moveaxis(by_w, -1, 0), by_other.T[..., None]
    try:
        return -np.linalg.solve(matrices, values)[..., 0].T
    except np.linalg.LinAlgError:
        n = len(matrices)
        if n == 1:
            return np.full(by_other.shape, np.nan)
        each = [_moved(by_w[..., [k]], by_other[:, [k]]) for k in range(n)]
        return np.hstack(each)


# A gait beside one at which strikes are tangential may not be.
@np.errstate(invalid="ignore", divide="ignore", over="ignore")
def _differences(
    function: Callable[[Evaluation], np.ndarray],
    equations: Equations,
    X: Coordinates,
    unknown: int,
    stencil: _Stencil,
) -> np.ndarray:
    """Derivatives (r, n) of a function (r, n) of steps by one unknown."""
    places, weights = stencil
    n = X.shape[1]
    points = np.tile(X, len(places))
    points[unknown] += _STEP * np.repeat(places, n)
    lanes = np.tile(np.arange(n), len(places))
    values = function(equations.some(lanes).evaluate(points))
    beside = values.reshape(len(values), len(places), n)
    weighted = (weight * beside[:, k] for k, weight in enumerate(weights))
    return total(weighted) / _STEP


def _measured(names: Sequence[str], at: Evaluation) -> np.ndarray:
    measured = measures_at(names, at)
    return np.stack([measured[name] for name in names])


def _residual_and_measured(names: Sequence[str], at: Evaluation) -> np.ndarray:
    return np.vstack([at.residual, _measured(names, at)])


def differentiated(
    problem: Problem, at: Polished, drive: np.ndarray, want: Sequence[str]
) -> Measured:
    """Return the variables of the group `sensitivities` that are wanted of gaits.

    Parameters
    ----------
    problem : Problem
        Of one walker.
    at : Polished
        The gaits, of n lanes.
    drive : ndarray, shape (n,)
        The slopes [rad], or another drive of a problem over that.
    want : sequence of str
        Names of variables.

    Returns
    -------
    dict of ndarray, shape (n, keys)
        Derivatives by each of `DIFFERENTIATED` [the walker's units]; NaN where there
        is no gait, or the walkers beside it are of another kind.
    """
    wanted = [name for name in want if VARIABLES[name].group == SENSITIVITIES]
    if not wanted:
        return {}
    of_walker = measures(problem.walker)
    names = [name for name in map(_measure_of, wanted) if name in of_walker]
    shape = (len(drive), len(DIFFERENTIATED))
    found = {name: np.full(shape, np.nan) for name in wanted}
    lanes = np.flatnonzero(at.converged & at.step)
    if not len(lanes) or not names:
        return found

    for some, driven, slope in problem.at_slopes(drive[lanes]):
        Z = np.vstack([at.w[:, lanes[some]], np.log(slope)])
        # Its steps are differentiated by the slope, not by what drives there.
        own = Problem(driven.walker, driven.steps, driven.drive)
        for column, name, values in _by_all_keys(own, Z, names):
            found[f"{name}{BY_KEY}"][lanes[some], column] = values
    return found


def _by_all_keys(
    problem: Problem, Z: Coordinates, names: Sequence[str]
) -> Iterator[tuple[int, str, np.ndarray]]:
    """Yield the place of each key, and the derivatives (n,) by it of each measure."""
    line = {"walker": problem.walker.table(), "set": {}}
    keys = [
        KeyOfWalker(key, getattr(problem.walker, key), walkers_over(line, key))
        for key in DIFFERENTIATED[1:]
    ]
    by_keys, _ = at_gaits(problem, Z, keys, names)
    for key, derivatives in by_keys.items():
        for name, values in derivatives.items():
            yield DIFFERENTIATED.index(key), name, values


def _measure_of(derivative: str) -> str:
    """The measure whose derivatives a variable holds."""
    return derivative.removesuffix(BY_KEY)


def at_gaits(
    problem: Problem,
    Z: Coordinates,
    keys: Sequence[KeyOfWalker],
    names: Sequence[str],
) -> tuple[Mapping[str, Measured], Mapping[str, str]]:
    """Return derivatives by slope and by several keys, and why there are none by some.

    Parameters
    ----------
    problem : Problem
        Of one walker, over slopes.
    Z : ndarray, shape (c, n)
        Its gaits.
    keys : sequence of KeyOfWalker
    names : sequence of str
        Of `tasks.measures.levels.measures`.

    Returns
    -------
    derivatives : dict of dict of ndarray, shape (n,)
        By the names of the slope and of keys, those of each measure [the walker's units,
        over rad or those of the key]; NaN where a gait is at a fold.
    absent : dict of str
    """
    gaits = _Neighbourhood.of(problem, Z, names)
    derivatives = {SLOPE: gaits.by_slope()}
    absent = {}
    for key in keys:
        try:
            derivatives[key.name] = gaits.by_key(key)
        except WalkerError as error:
            absent[key.name] = str(error)
    return derivatives, absent
