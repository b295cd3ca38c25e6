"""Derivatives of the measures of a gait by slope and by the keys of its walker.

The implicit function theorem gives how a gait moves with a key p: of its equations
G(w, p) = 0, dw/dp = -G_w^-1 G_p. A measure M(w, p) then has the derivative M_w dw/dp +
M_p. G_w and the derivative of G by slope are exact; G_p, M_w and M_p are differences
over six points, whose error is of the sixth order.

In shapes, n counts gaits, c the unknowns Z of one (`tasks.branches.joint`), r measures.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from gaitsweep.tasks.branches.conditions import Condition
from gaitsweep.tasks.branches.equations import (
    DIFFERENCE,
    Equations,
    Keys,
    sensitivity,
)
from gaitsweep.tasks.branches.joint import Evaluation
from gaitsweep.tasks.contract.registry import BY_KEY, SENSITIVITIES, VARIABLES
from gaitsweep.tasks.gaits.polish import Polished
from gaitsweep.tasks.measures.levels import measures, measures_at
from gaitsweep.tasks.measures.violations import SAMPLES
from gaitsweep.tasks.mechanics.arrays import Coordinates, Gait
from gaitsweep.tasks.mechanics.lumped import constants_of, general_structure_of
from gaitsweep.tasks.mechanics.sums import matvec, total
from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.walkers.walker import (
    BOUNDS,
    DIFFERENTIATED,
    KEYS,
    OF_PASSIVE,
    ONE_LINK,
    Walker,
    WalkerError,
)
from gaitsweep.tasks.walkers.walker_array import WalkerArray


@dataclass(frozen=True)
class _Stencil:
    """A derivative of a function by its values at multiples of a step: of a gait in its
    unknowns, and of a key over its length.
    """

    places: np.ndarray
    weights: np.ndarray
    step: float

    def finer(self, factor: float) -> _Stencil:
        """Return the stencil with a step so many times as small."""
        return replace(self, step=self.step / factor)


#: Where a function is defined on both sides: gaits may depend on a key a hundred times
#: as much as on its length. And beyond a least value, of a mass or a radius; without
#: that value itself, where measures have other formulas.
_CENTRAL = _Stencil(
    np.array([-3.0, -2.0, -1.0, 1.0, 2.0, 3.0]),
    np.array([-1.0, 9.0, -45.0, 45.0, -9.0, 1.0]) / 60,
    1e-4,
)
_FORWARD = _Stencil(
    np.arange(7.0),
    np.array([-147.0, 360.0, -450.0, 400.0, -225.0, 72.0, -10.0]) / 60,
    1e-3,
)
_BEYOND = _Stencil(
    np.arange(1.0, 7.0),
    np.array([-522.0, 1755.0, -2540.0, 1980.0, -810.0, 137.0]) / 60,
    1e-4,
)
#: Weights of seven values side by side in their sixth difference; the largest of
#: constants that are smooth, and their largest change, over their size but for small
#: ones. Where one is larger, steps are made ten times as small, so often.
_SIXTH = np.array([1.0, -6.0, 15.0, -20.0, 15.0, -6.0, 1.0])
_SMOOTH, _LEAST_CONSTANT = 1e-12, 1e-3
#: The largest error of a derivative that such a difference of a measure tells of, over
#: derivative and measure: where it is larger, two extremes of a motion may be equal.
_KINK = 1e-3
#: How often a step is made ten times as small where that is so.
_TIMES_SMALLER = 2
#: Gaits, for each unknown, that are evaluated side by side: more would need memory.
_MOST_LANES = 512
_CHANGED, _LEAST_CHANGED = 2e-2, 1.0
_TIMES_FINER = 7

SLOPE, _RADIUS = "slope", "spectral_radius"
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
    walkers_at : callable, optional
        The walkers at several, shape (1, n), as an array, unchecked, which takes less
        time.
    """

    name: str
    value: float
    walker_at: Callable[[float], Walker]
    walkers_at: Callable[[np.ndarray], WalkerArray] | None = None

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

    def unknown(self, problem: Problem) -> Keys:
        """The key as an unknown of the gaits of a problem's walker, with a difference
        over which the walkers' constants are smooth.

        Raises
        ------
        WalkerError
            If there is no walker beside its own, those beside it have gaits with other
            unknowns, as feet without mass have, or they do not tend to it.

        Notes
        -----
        A walker enters the equations of motion by its lumped constants alone. Those of
        the swing leg are over its inertia about the hip, so that the limit in which its
        mass vanishes is regular where only the shank's does. Where another key gives
        legs without mass their inertia, or a torque acts between them, constants jump
        there or grow without bound.
        """
        keys = Keys.of_one(self.name, self.walker_at, *self.range)
        keys = replace(keys, walkers_at=self.walkers_at)
        if keys.structure.dimension != problem.structure.dimension:
            why = "is special: gaits of the walkers beside it have other unknowns"
            raise WalkerError(self.name, self.value, why)

        structure = general_structure_of(keys.ordinary_walker)
        for factor in 10.0 ** np.arange(_TIMES_FINER):
            # What is known of the keys already stays known where nothing changes.
            finer = keys
            if factor > 1:
                finer = replace(keys, difference=keys.difference / factor)
            places = np.arange(7.0) if self.is_least(finer) else np.arange(-3.0, 4.0)
            values = self.value + places * self.stencil(finer).step * keys.scale[0]
            constants = constants_of(self._walkers(values), structure)
            if _are_smooth(constants):
                return finer

        why = "is special: walkers beside it, however near, do not tend to its own"
        raise WalkerError(self.name, self.value, why)

    def stencil(self, keys: Keys) -> _Stencil:
        """By which gaits are differentiated by the key."""
        finer = DIFFERENCE / keys.difference
        if not self.is_least(keys):
            return _CENTRAL.finer(finer)
        own, ordinary = self.walker_at(self.value), keys.ordinary_walker
        is_limit = own.massless_leg > ordinary.massless_leg
        return (_BEYOND if is_limit else _FORWARD).finer(finer)

    def is_least(self, keys: Keys) -> bool:
        """Whether walkers below its value are not all there that differences take."""
        step = _CENTRAL.step * keys.difference / DIFFERENCE
        return self.value + _CENTRAL.places[0] * step * keys.scale[0] < keys.low[0]

    def _walkers(self, values: np.ndarray) -> WalkerArray:
        """The walkers at values (n,)."""
        if self.walkers_at is not None:
            return self.walkers_at(values[None])
        return WalkerArray.of([self.walker_at(value) for value in values.tolist()])

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


def _are_smooth(values: np.ndarray) -> bool:
    """Whether functions (c, 7) at places side by side are smooth, and change little."""
    size = np.abs(values).max(axis=1)
    changed = values.max(axis=1) - values.min(axis=1)
    with np.errstate(invalid="ignore", over="ignore"):
        sixth = np.abs(values @ _SIXTH)
    is_smooth = sixth <= _SMOOTH * np.maximum(size, _LEAST_CONSTANT)
    is_near = changed <= _CHANGED * np.maximum(size, _LEAST_CHANGED)
    return bool((is_smooth & is_near).all())


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
class Rows:
    """What is differentiated of gaits, r rows: measures that are smooth and, for the
    spectral radius, whose derivative is not where multipliers meet, the entries of the
    step map's derivative.

    Attributes
    ----------
    names : tuple of str
        Of measures, as `tasks.measures.levels.measures` has them.
    """

    names: tuple[str, ...]

    @property
    def smooth(self) -> list[str]:
        """Names of the measures that are smooth."""
        return [name for name in self.names if name != _RADIUS]

    def beside(self, equations: Equations, X: Coordinates) -> Evaluation:
        """Evaluate steps at points (u, n) for these rows: with derivatives only where
        rows, or what another package measures, may need them; sampled for violations.
        """
        of_names = [VARIABLES[name] for name in self.names]
        has_violations = any(each.group == "violations" for each in of_names)
        samples = SAMPLES if has_violations else 0
        if _RADIUS in self.names or any(each.measure for each in of_names):
            return equations.evaluate(X, samples)
        return equations.evaluate_values(X, samples)

    def at(self, at: Evaluation) -> np.ndarray:
        """Return the rows (r, n) of gaits that are evaluated."""
        measured = measures_at(self.smooth, at)
        rows = [measured[name][None] for name in self.smooth]
        if _RADIUS in self.names:
            rows.append(at.stride.jacobian.reshape(-1, len(at.q)))
        return np.vstack(rows)

    def named(self, derivatives: np.ndarray, jacobian: np.ndarray) -> Measured:
        """Return the derivatives of measures.

        Parameters
        ----------
        derivatives : ndarray, shape (r, keys, n)
            Of the rows.
        jacobian : ndarray, shape (d, d, n)
            Of the step map.

        Returns
        -------
        dict of ndarray, shape (keys, n)
        """
        smooth = self.smooth
        found = dict(zip(smooth, derivatives, strict=False))
        if _RADIUS in self.names:
            of_jacobian = derivatives[len(smooth) :]
            shaped = of_jacobian.reshape(*jacobian.shape[:2], *of_jacobian.shape[1:])
            found[_RADIUS] = _radius_moved(jacobian, shaped)
        return {name: found[name] for name in self.names}

    def sizes(self, values: np.ndarray) -> np.ndarray:
        """Return the sizes of rows, or of their derivatives, shape (r, ...): entries of
        the step map's derivative count by the largest of them, and by one at least.
        """
        sizes = np.abs(values)
        entries = sizes[len(self.smooth) :]
        if len(entries):
            entries[:] = np.maximum(1.0, entries.max(axis=0))
        return sizes

    def of_names(self, rows: np.ndarray) -> dict[str, np.ndarray]:
        """Return whether measures are, where rows, bool (r, ...), are."""
        found = dict(zip(self.smooth, rows, strict=False))
        found[_RADIUS] = rows[len(self.smooth) :].all(axis=0)
        return {name: found[name] for name in self.names}


@np.errstate(invalid="ignore", divide="ignore")
def _radius_moved(jacobian: np.ndarray, moved: np.ndarray) -> np.ndarray:
    """Derivatives (keys, n) of spectral radii by those of matrices (d, d, keys, n): of
    a multiplier m with left and right vectors u, v, dm = u dJ v / u v.
    """
    found = np.full(moved.shape[2:], np.nan)
    matrices = np.moveaxis(jacobian, -1, 0)
    known = np.flatnonzero(np.isfinite(matrices).all(axis=(1, 2)))
    # Real where no gait of a batch has a complex pair, whose bits then were others.
    values, right = (part + 0j for part in np.linalg.eig(matrices[known]))
    left = np.linalg.pinv(right)
    largest = np.abs(values).argmax(axis=1)
    lanes = np.arange(len(known))
    value, u, v = values[lanes, largest], left[lanes, largest], right[lanes, :, largest]

    weights = u.T[:, None] * v.T[None] * value.conj() / np.abs(value)
    terms = weights[:, :, None] * moved[..., known]
    found[:, known] = total(terms.reshape(-1, *found[:, known].shape)).real
    return found


@dataclass(frozen=True)
class _Neighbourhood:
    """Gaits with their measures to first order in their unknowns.

    Attributes
    ----------
    problem : Problem
        Of one walker, over slopes.
    Z : ndarray, shape (c, n)
        The gaits.
    rows : Rows
        What is differentiated.
    of_gait : ndarray, shape (c - 1, c, n)
        Derivative of the gaits' equations by Z.
    own : ndarray, shape (r, n)
        The measures.
    of_measures, kinks : ndarray, shape (r, c, n)
        Their derivatives, and how far off these are where there is none.
    """

    problem: Problem
    Z: Coordinates
    rows: Rows
    of_gait: np.ndarray
    own: np.ndarray
    of_measures: np.ndarray
    kinks: np.ndarray

    @classmethod
    def of(cls, problem: Problem, Z: Coordinates, rows: Rows) -> _Neighbourhood:
        """Differentiate gaits and measures by Z, the latter by differences."""
        equations = Equations(problem)
        system = equations.at(Z)
        own = rows.at(system.gait)
        most = max(1, _MOST_LANES // Z.shape[1])
        unknowns = np.split(np.arange(len(Z)), range(most, len(Z), most))
        parts = [_by_unknowns(rows, equations, Z, some, own) for some in unknowns]
        of_measures, kinks = np.concatenate(parts, axis=2)
        return cls(problem, Z, rows, system.derivative, own, of_measures, kinks)

    def by_slope(self) -> np.ndarray:
        """Derivatives (r, n) of measures by slope [the walker's units, over rad]."""
        by_log_slope = self._in_all(
            self.of_gait[:, -1], self.of_measures[:, -1], self.kinks[:, -1]
        )
        return by_log_slope / np.exp(self.Z[-1])

    def by_key(self, key: KeyOfWalker) -> np.ndarray:
        """Derivatives (r, n) of measures by a key of the walker, at a fixed slope [the
        walker's units, over those of the key].

        Raises
        ------
        WalkerError
            As `KeyOfWalker.unknown` does.
        """
        keys = key.unknown(self.problem)
        equations = Equations(keys).over(self.problem.drive)
        scale = keys.scale[0]
        own = np.full((1, self.Z.shape[1]), key.value / scale)
        joint = len(self.Z) - 1
        both, kinks = _differences(
            self.rows,
            self._equations_and_measures,
            equations,
            np.vstack([self.Z, own]),
            np.full(self.Z.shape[1], len(self.Z)),
            key.stencil(keys),
            self._sizes,
            np.vstack([np.zeros_like(self.Z[1:]), self.own]),
        )
        residual, measures = np.split(both, [joint])
        return self._in_all(residual, measures, kinks[joint:]) / scale

    def _sizes(self, values: np.ndarray) -> np.ndarray:
        """Sizes of the equations' values, one at least, and of measures, or of their
        derivatives.
        """
        residual, measured = np.split(values, [len(self.Z) - 1])
        of_residual = np.maximum(1.0, np.abs(residual))
        return np.vstack([of_residual, self.rows.sizes(measured)])

    def _equations_and_measures(self, at: Evaluation) -> np.ndarray:
        return np.vstack([at.residual, self.rows.at(at)])

    def _in_all(
        self, by_residual: np.ndarray, by_measures: np.ndarray, kinks: np.ndarray
    ) -> np.ndarray:
        """Derivatives (r, n) of measures of gaits by what changes their equations
        (c - 1, n) and, of a gait that does not move, its measures (r, n), with how far
        off these may be; NaN where measures are not smooth.
        """
        moved = _moved(self.of_gait[:, :-1], by_residual)
        found = by_measures + matvec(self.of_measures[:, :-1], moved)
        off = kinks + matvec(self.kinks[:, :-1], np.abs(moved))
        with np.errstate(invalid="ignore"):
            size = self.rows.sizes(found) + self.rows.sizes(self.own)
            is_rough = off > _KINK * size
        return np.where(is_rough, np.nan, found)


def _by_unknowns(
    rows: Rows,
    equations: Equations,
    Z: Coordinates,
    unknowns: np.ndarray,
    own: np.ndarray,
) -> np.ndarray:
    """What `_differences` returns of rows, by some of the unknowns Z (c, n) of one
    walker's gaits, shape (2, r, unknowns, n): all are lanes of one evaluation.
    """
    times = len(unknowns)
    found = _differences(
        rows,
        rows.at,
        equations,
        np.tile(Z, times),
        np.repeat(unknowns, Z.shape[1]),
        _CENTRAL,
        rows.sizes,
        np.tile(own, times),
    )
    return found.reshape(*found.shape[:2], times, -1)


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
    rows: Rows,
    function: Callable[[Evaluation], np.ndarray],
    equations: Equations,
    X: Coordinates,
    unknown: np.ndarray,
    stencil: _Stencil,
    sizes: Callable[[np.ndarray], np.ndarray],
    own: np.ndarray,
) -> np.ndarray:
    """Derivatives of a function (r, n) of steps by one unknown, and how far off they are
    at a kink, shape (2, r, n). Where there is one beside, steps are made smaller.

    Parameters
    ----------
    rows : Rows
        As whose the steps are evaluated.
    unknown : ndarray of int, shape (n,)
        The unknown of each lane.
    sizes : callable
        Sizes of the function's values, over which it may be off.
    own : ndarray, shape (r, n)
        Its values at X.
    """
    found = _by_stencil(rows, function, equations, X, unknown, stencil, own)
    for _ in range(_TIMES_SMALLER):
        derivatives, off = found
        is_rough = off > _KINK * (sizes(derivatives) + sizes(own))
        lanes = np.flatnonzero(is_rough.any(axis=0))
        if not len(lanes):
            break

        stencil = stencil.finer(10)
        finer = _by_stencil(
            rows,
            function,
            equations.some(lanes),
            X[:, lanes],
            unknown[lanes],
            stencil,
            own[:, lanes],
        )
        is_better = finer[1] < off[:, lanes]
        found[:, :, lanes] = np.where(is_better, finer, found[:, :, lanes])

    return found


def _by_stencil(
    rows: Rows,
    function: Callable[[Evaluation], np.ndarray],
    equations: Equations,
    X: Coordinates,
    unknown: np.ndarray,
    stencil: _Stencil,
    own: np.ndarray,
) -> np.ndarray:
    """What `_differences` returns, with one step: the highest difference of the values
    side by side, which vanishes where a function is smooth, tells of a kink.
    """
    n, beside = X.shape[1], len(stencil.places)
    points = np.tile(X, beside)
    shifts = stencil.step * np.repeat(stencil.places, n)
    points[np.tile(unknown, beside), np.arange(n * beside)] += shifts
    lanes = np.tile(np.arange(n), beside)
    values = function(rows.beside(equations.some(lanes), points))
    values = values.reshape(-1, beside, n)
    weighted = (weight * values[:, k] for k, weight in enumerate(stencil.weights))
    derivatives = total(weighted) / stencil.step

    if stencil.places[0] < 0:
        values = np.insert(values, beside // 2, own, axis=1)
    order = values.shape[1] - 1
    highest = np.diff(values, n=order, axis=1)[:, 0]
    off = np.abs(highest) / (math.comb(order, order // 2) * stencil.step)
    return np.stack([derivatives, off])


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
    found = not_differentiated(want, len(drive))
    names = measures_among(want, problem.walker)
    lanes = np.flatnonzero(at.converged & at.step)
    if not len(lanes) or not names:
        return found

    for some, driven, slope in problem.at_slopes(drive[lanes]):
        Z = np.vstack([at.w[:, lanes[some]], np.log(slope)])
        # Its steps are differentiated by the slope, not by what drives there.
        own = Problem(driven.walker, driven.steps, driven.drive)
        rows = Rows(names)
        jacobian = at.stride.jacobian[..., lanes[some]]
        by_keys = rows.named(by_all_keys(own, Z, rows), jacobian)
        for name, values in by_keys.items():
            found[name + BY_KEY][lanes[some]] = values.T

    return found


def not_differentiated(want: Sequence[str], n: int) -> Measured:
    """Return the wanted variables of the group `sensitivities` of n gaits, all NaN."""
    wanted = [name for name in want if VARIABLES[name].group == SENSITIVITIES]
    return {name: np.full((n, len(DIFFERENTIATED)), np.nan) for name in wanted}


def measures_among(want: Sequence[str], walker: Walker) -> tuple[str, ...]:
    """Return the measures of a walker whose derivatives are among wanted variables."""
    of_walker = measures(walker)
    wanted = [name.removesuffix(BY_KEY) for name in not_differentiated(want, 0)]
    return tuple(name for name in wanted if name in of_walker)


def by_all_keys(
    problem: Problem,
    Z: Coordinates,
    rows: Rows,
    names: Sequence[str] = DIFFERENTIATED,
) -> np.ndarray:
    """Return the derivatives of rows by `DIFFERENTIATED`, or some of these, shape (r,
    keys, n); NaN by keys beside whose values walkers are of another kind.
    """
    keys = [key for key in _keys_of(problem.walker) if key.name in names]
    by_keys, _ = _at_gaits(problem, Z, keys, rows)
    some = next(iter(by_keys.values()))
    nowhere = np.full(some.shape, np.nan)
    return np.stack([by_keys.get(name, nowhere) for name in names], axis=1)


def sizes_of_keys(walker: Walker, slope: np.ndarray) -> np.ndarray:
    """Return the slopes and the characteristic sizes of the other keys, shape (keys,
    n), over which the derivatives by them count.
    """
    sizes = [np.full(len(slope), _size(key, walker)) for key in DIFFERENTIATED[1:]]
    return np.stack([slope, *sizes])


def slope_by_keys(problem: Problem, condition: Condition, Z: Gait) -> dict[str, float]:
    """Differentiate the slope of a special point by the keys of its walker.

    Parameters
    ----------
    problem : Problem
        Of one walker and one step, over slopes.
    condition : Condition
        That the point meets.
    Z : ndarray, shape (c,)
        The point.

    Returns
    -------
    dict of float [rad, over the units of the keys]
        By each key of the walker; without keys beside whose values
        walkers are of another kind.

    Notes
    -----
    The implicit function theorem for the gait's equations and the condition; by keys
    these are differentiated by central differences. Beyond a least value of a key the
    walkers' formulas go on.
    """
    found = {}
    for key in _keys_of(problem.walker):
        try:
            keys = key.unknown(problem)
        except WalkerError:
            continue

        equations = Equations(keys, [condition]).over(problem.drive)
        X = np.append(Z, key.value / keys.scale)
        by_key = sensitivity(equations, X)[-1, 0]
        found[key.name] = float(np.exp(Z[-1]) * by_key)

    return found


def _beside(walker: Walker, key: str, values: np.ndarray) -> WalkerArray:
    """The walkers that differ by values (1, n) of a key, valid or not."""
    return WalkerArray(**{**walker.table(), key: values[0]})


def _keys_of(walker: Walker) -> list[KeyOfWalker]:
    """The keys by which a walker's gaits are differentiated, besides the slope."""
    keys = []
    for name in (*OF_PASSIVE[1:], *walker.driving_keys):
        walker_at, beside = partial(walker.having, name), partial(_beside, walker, name)
        keys.append(KeyOfWalker(name, getattr(walker, name), walker_at, beside))
    return keys


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
    rows = Rows(tuple(names))
    by_keys, absent = _at_gaits(problem, Z, keys, rows)
    jacobian = Equations(problem).evaluate(Z).stride.jacobian
    every = rows.named(np.stack([*by_keys.values()], axis=1), jacobian)
    found: dict[str, Measured] = {}
    for place, key in enumerate(by_keys):
        found[key] = {name: values[place] for name, values in every.items()}
    return found, absent


def _at_gaits(
    problem: Problem, Z: Coordinates, keys: Sequence[KeyOfWalker], rows: Rows
) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """Derivatives of rows (r, n) by slope and keys, and why there are none by some."""
    gaits = _Neighbourhood.of(problem, Z, rows)
    derivatives = {SLOPE: gaits.by_slope()}
    absent = {}
    for key in keys:
        try:
            derivatives[key.name] = gaits.by_key(key)
        except WalkerError as error:
            absent[key.name] = str(error)

    return derivatives, absent
