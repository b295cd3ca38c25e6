"""Derivatives of the measures of a gait by slope and by the keys of its walker.

The implicit function theorem gives how a gait moves with a key p: of its equations
G(w, p) = 0, dw/dp = -G_w^-1 G_p. A measure M(w, p) then has the derivative along that
direction, M_w dw/dp + M_p. G_w and the derivative of G by slope are exact; G_p, and
derivatives along directions, are differences over four points, whose error is of the
fourth order.

In shapes, n counts gaits, c the unknowns of one (`tasks.branches.joint`), u those and a
key.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from gaitsweep.tasks.branches.equations import Equations, Keys
from gaitsweep.tasks.branches.joint import Evaluation
from gaitsweep.tasks.contract.registry import BY_KEY, SENSITIVITIES, VARIABLES
from gaitsweep.tasks.gaits.polish import Polished
from gaitsweep.tasks.measures.levels import measures, measures_at
from gaitsweep.tasks.mechanics.arrays import Coordinates
from gaitsweep.tasks.mechanics.sums import norm
from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.walkers.resolve import walkers_over
from gaitsweep.tasks.walkers.walker import (
    BOUNDS,
    DIFFERENTIATED,
    KEYS,
    OF_PASSIVE,
    ONE_LINK,
    Walker,
    WalkerError,
)

#: Derivatives of a function by its values at multiples of a step, with their weights
#: over the step: where it is defined on both sides, and beyond a least value.
_CENTRAL = np.array([-2.0, -1.0, 1.0, 2.0]), np.array([1.0, -8.0, 8.0, -1.0]) / 12
_FORWARD = np.arange(5.0), np.array([-25.0, 48.0, -36.0, 16.0, -3.0]) / 12
_Stencil = tuple[np.ndarray, np.ndarray]
#: The step: of a key over its length, and of a gait in its unknowns.
_STEP = 1e-4
#: Unknowns change by more than that for gaits that hardly depend on a key.
_LEAST_MOVE = 1.0

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


def by_slope(
    problem: Problem, Z: Coordinates, of_gait: np.ndarray, names: Sequence[str]
) -> Measured:
    """Return the derivatives of measures by slope.

    Parameters
    ----------
    problem : Problem
        Of one walker, over slopes.
    Z : ndarray, shape (c, n)
        Its gaits.
    of_gait : ndarray, shape (c - 1, c, n)
        Derivative of their equations by Z.
    names : sequence of str
        Of `tasks.measures.levels.measures`.

    Returns
    -------
    dict of ndarray, shape (n,) [the walker's units, over rad]
        NaN where a gait is at a fold.
    """
    equations = Equations(problem)
    moved = _moved(of_gait[:, :-1], of_gait[:, -1])
    direction = np.vstack([moved, np.ones((1, Z.shape[1]))])
    by_log_slope = _measures_along(equations, Z, direction, names, _CENTRAL)
    return {name: values / np.exp(Z[-1]) for name, values in by_log_slope.items()}


def by_key(
    problem: Problem,
    Z: Coordinates,
    of_gait: np.ndarray,
    key: KeyOfWalker,
    names: Sequence[str],
) -> Measured:
    """Return the derivatives of measures by a key of the walker, at a fixed slope.

    Parameters
    ----------
    problem, Z, of_gait, names
        As for `by_slope`.
    key : KeyOfWalker

    Returns
    -------
    dict of ndarray, shape (n,) [the walker's units, over those of the key]
        NaN where a gait is at a fold.

    Raises
    ------
    WalkerError
        If there is no walker beside its own, or those beside it have gaits with other
        unknowns, as feet without mass have.
    """
    keys = Keys.of_one(key.name, key.walker_at, *key.range)
    equations = Equations(keys).over(problem.drive)
    if equations.problem.m != problem.m:
        why = "is special: gaits of the walkers beside it have other unknowns"
        raise WalkerError(key.name, key.value, why)

    scale = keys.scale[0]
    n = Z.shape[1]
    X = np.vstack([Z, np.full((1, n), key.value / scale)])
    only_key = np.zeros(X.shape)
    only_key[-1] = 1.0
    is_least = key.value - 2 * _STEP * scale < keys.low[0]
    stencil = _FORWARD if is_least else _CENTRAL
    step = np.full(n, _STEP)
    by_value = _along(_residual, equations, X, only_key, step, stencil)

    direction = only_key.copy()
    direction[: len(Z) - 1] = _moved(of_gait[:, :-1], by_value)
    by_share = _measures_along(equations, X, direction, names, stencil)
    return {name: values / scale for name, values in by_share.items()}


def _moved(by_w: np.ndarray, by_other: np.ndarray) -> np.ndarray:
    """How gaits move with another unknown: -G_w^-1 G_p, shape (c - 1, n); NaN where the
    equations are singular.
    """
    moved = np.full(by_other.shape, np.nan)
    for lane in range(by_other.shape[1]):
        try:
            moved[:, lane] = np.linalg.solve(by_w[..., lane], -by_other[:, lane])
        except np.linalg.LinAlgError:
            continue
    return moved


def _measures_along(
    equations: Equations,
    X: Coordinates,
    direction: Coordinates,
    names: Sequence[str],
    stencil: _Stencil,
) -> Measured:
    """Derivatives of measures along directions (u, n)."""

    def values(at: Evaluation) -> np.ndarray:
        measured = measures_at(names, at)
        return np.stack([measured[name] for name in names])

    step = _STEP / np.maximum(_LEAST_MOVE, norm(direction))
    derivatives = _along(values, equations, X, direction, step, stencil)
    return dict(zip(names, derivatives, strict=True))


# A gait beside one at which strikes are tangential may not be.
@np.errstate(invalid="ignore", divide="ignore", over="ignore")
def _along(
    function: Callable[[Evaluation], np.ndarray],
    equations: Equations,
    X: Coordinates,
    direction: Coordinates,
    step: np.ndarray,
    stencil: _Stencil,
) -> np.ndarray:
    """Derivatives (r, n) of a function (r, n) of steps along directions (u, n)."""
    places, weights = stencil
    u, n = X.shape
    shifts = places[None, :, None] * (step * direction)[:, None]
    points = (X[:, None] + shifts).reshape(u, -1)
    lanes = np.tile(np.arange(n), len(places))
    values = function(equations.some(lanes).evaluate(points))
    values = values.reshape(len(values), len(places), n)
    return np.asarray(np.einsum("k,rkn->rn", weights, values) / step)


def _residual(at: Evaluation) -> np.ndarray:
    return at.residual


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
        is no gait, the walkers beside it are of another kind, or it has no such drive.
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
    walker = problem.walker
    line = {"walker": walker.table(), "set": {}}
    keys = [
        KeyOfWalker(key, getattr(walker, key), walkers_over(line, key))
        for key in (*OF_PASSIVE[1:], *walker.driving_keys)
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
    problem, Z, names
        As for `by_slope`.
    keys : sequence of KeyOfWalker
    """
    of_gait = Equations(problem).at(Z).derivative
    derivatives = {SLOPE: by_slope(problem, Z, of_gait, names)}
    absent = {}
    for key in keys:
        try:
            derivatives[key.name] = by_key(problem, Z, of_gait, key, names)
        except WalkerError as error:
            absent[key.name] = str(error)
    return derivatives, absent
