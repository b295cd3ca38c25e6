"""How far the rounding of a walker's printed parameters can move a landmark: its interval (sections 4 and 5).

A landmark is a zero of G(X, p) = (P(X, p) - X, test(X, p)), with X the gait and ln slope and p the printed parameters.
Implicit differentiation gives dX/dp = -G_X^-1 G_p. G is evaluated with converged event times; the fixed point's
part of G_X comes from the variational equations, G_p and the test's own row from central differences at two step
sizes, extrapolated. The interval is the printed walker's value plus or minus the sum of |sensitivity| x half unit.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import heyoka as hy
import numpy as np

from tasks.continuation.branch import Branch
from tasks.continuation.joint import linearised
from tasks.continuation.locate import locate_root
from tasks.continuation.lockstep import run
from tasks.continuation.tracking import Point
from tasks.mechanics.equations import Symbols
from tasks.mechanics.impacts import heelstrike
from tasks.paper.lines import Line, line, memoize
from tasks.paper.published import HALF_UNITS
from tasks.step.problem import Lanes, Problem
from tasks.step.step_map import Stride
from tasks.walkers.catalogue import tune_exactly
from tasks.walkers.walker import Walker

#: Step of the central differences: of X, and of parameters relative to their size and the gait's angle (what counts is
#: an offset of a mass relative to the angle).
STEP = 2e-4
#: A test function: of a step and X, shape (m + 1, n), to values whose zero is the landmark, shape (n,).
Test = Callable[[Stride, np.ndarray], np.ndarray]


def _square(stride: Stride, X: np.ndarray) -> np.ndarray:
    return linearised(stride, X)[1][:, :, :-1]


def _fold(stride: Stride, X: np.ndarray) -> np.ndarray:
    return np.linalg.det(_square(stride, X))


def _flip(stride: Stride, X: np.ndarray) -> np.ndarray:
    return np.linalg.det(np.moveaxis(stride.jacobian, -1, 0) + np.eye(len(X) - 1))


def _exponent(stride: Stride, X: np.ndarray) -> np.ndarray:
    """Local exponent d ln angle/d ln slope less 2/3."""
    derivative = linearised(stride, X)[1]
    return -np.linalg.solve(derivative[:, :, :-1], derivative[:, :, -1:])[:, 0, 0] - 2 / 3


#: Test functions by kind of landmark.
TESTS: dict[str, Test] = {
    "fold": _fold,
    "flip": _flip,
    "exponent": _exponent,
    "end_kneestrike_at_heelstrike": lambda stride, X: stride.times[-1] - stride.times[0],
    "end_tangential_heelstrike": lambda stride, X: stride.closing[-1] / stride.y[0],
    "release_hyperextension": lambda stride, X: (stride.start[4] - stride.start[5]) / stride.y[0],
}


@dataclass(frozen=True)
class Landmark:
    """A special point of a walker: its test, the gait's label, and which of several.

    `printed` is the slope as the paper prints it and `half_unit` half a unit of its last digit [rad]; `point` is its
    number in the paper's figure 6.
    """

    name: str
    walker: str
    test: str
    label: str = ""
    which: int = 0
    printed: float = float("nan")
    half_unit: float = float("nan")
    point: str = ""


#: Landmarks compared with numbers of the paper, and those of figure 6.
LANDMARKS = {
    mark.name: mark
    for mark in (
        Landmark("smallest slope, kneed", "physical", "fold", printed=0.020, half_unit=5e-4),
        Landmark("smallest slope, straight", "physical-straight", "fold", printed=0.016, half_unit=5e-4),
        Landmark("point 1", "physical", "end_kneestrike_at_heelstrike", point="1"),
        Landmark("point 2", "physical-straight", "end_tangential_heelstrike", point="2"),
        Landmark("point 3", "physical", "release_hyperextension", point="3"),
        Landmark("highest slope, kneed", "physical", "fold", which=1),
        Landmark("C flip", "C", "flip", "long", printed=0.084, half_unit=5e-4),
        Landmark("C-printed flip", "C-printed", "flip", "long", printed=0.084, half_unit=5e-4),
        Landmark("C exponent 2/3", "C", "exponent", "long", printed=0.00015, half_unit=5e-6),
        Landmark("C release, long", "C", "release_hyperextension", "long"),
        Landmark("C release, short", "C", "release_hyperextension", "short"),
    )
}


@dataclass(frozen=True)
class Interval:
    """A landmark's slope and stance angle [rad], its interval of slopes, and its sensitivity to each parameter."""

    value: float
    angle: float
    low: float
    high: float
    sensitivity: dict[str, float]
    angle_sensitivity: dict[str, float]
    half_unit: dict[str, float]

    @property
    def contribution(self) -> dict[str, float]:
        """Contribution of each parameter's rounding to the interval's half width [rad]."""
        return {k: abs(s) * self.half_unit[k] for k, s in self.sensitivity.items()}

    @property
    def most(self) -> str:
        """The parameter that contributes most."""
        return max(self.contribution, key=lambda k: self.contribution[k])


def changed(walker: str, base: Walker, key: str, change: float) -> Walker:
    """Change one key of a walker; exact A and C stay on the tuned manifold."""
    moved = replace(base, **{key: getattr(base, key) + change})
    return tune_exactly(moved) if walker in ("A", "C") else moved


def place(gaits: Line, mark: Landmark) -> tuple[np.ndarray, np.ndarray]:
    """Locate a landmark on the branches of its walker.

    Returns
    -------
    X, times : ndarray, shape (m + 1,) and (phases,)
        The gait with ln slope last, and its event times.

    Raises
    ------
    ValueError
        If the walker has no such point.
    """
    rows = []
    for branch in gaits.branches:
        for Z in _candidates(gaits.problem, branch, mark.test):
            if not mark.label or mark.label == ("short" if gaits.is_short(Z) else "long"):
                rows.append(Z)
    rows.sort(key=lambda Z: Z[gaits.problem.m])
    if len(rows) <= mark.which:
        raise ValueError(f"{mark.walker} has no {mark.name}")
    Z, m = rows[mark.which], gaits.problem.m
    if mark.test == "end_tangential_heelstrike":
        return _locate_grazing(gaits, Z[: m + 1], Z[m + 1 :])
    return Z[: m + 1], Z[m + 1 :]


def _candidates(problem: Problem, branch: Branch, test: str) -> list[np.ndarray]:
    """Rows (X, times) of a branch at which a test vanishes."""
    m = branch.m
    if test == "fold":
        return [branch.Z[first] for first, _ in branch.pieces()[1:]]
    if test.startswith("end_"):
        return [branch.Z[i] for i, why in ((0, branch.why[0]), (-1, branch.why[1])) if why == test]
    X = branch.Z[:, : m + 1].T
    stride, _ = problem.stride(np.delete(branch.Z, m, axis=1).T, X[m], slope=True)
    values = TESTS[test](stride, X)
    # A jump across a pole is no root: values on both sides must be small.
    changes = np.nonzero((np.sign(values[1:]) != np.sign(values[:-1])) & (np.abs(np.diff(values)) < 2))[0]

    def value(point: Point, direction: np.ndarray) -> float:
        return float(TESTS[test](point.stride, point.X)[0])

    points = [run(problem, locate_root(branch, int(k), value))[0] for k in changes]
    return [np.concatenate([p.X[:, 0], p.times[:, 0]]) for p in points if p.ok[0]]


def _values(walkers: list[Walker], X: np.ndarray, times: np.ndarray, test: Test) -> tuple[np.ndarray, np.ndarray]:
    """G at n lanes, shape (m + 1, n), and the fixed point's rows of G_X, shape (n, m, m + 1)."""
    problem, m = Lanes(walkers), len(X) - 1
    for _ in range(3):
        stride, _ = problem.stride(np.vstack([X[:m], times]), X[m], slope=True)
        times = stride.times
    residual, derivative = linearised(stride, X)
    return np.vstack([residual.T, test(stride, X)[None]]), derivative


def _grazing(walkers: list[Walker], Z: np.ndarray) -> np.ndarray:
    """G of a straight-legged gait whose heelstrike is tangential, shape (m + 2, n), with the period an unknown.

    Notes
    -----
    There the period has no derivative by the state, so Z = (ln angle, rates/angle, period, ln slope) and
    G = (heelstrike of the final state - start, height of the foot, its closing rate).
    """
    problem = Lanes(walkers)
    m = problem.m
    angle = np.exp(Z[0])
    scale = np.exp2(np.floor(np.log2(angle)))
    y = np.vstack([angle, angle * Z[1:m]]) / scale
    parameters = problem.parameters(np.exp(Z[m + 1]), scale)
    stride = problem.map(y, Z[m : m + 1], parameters, True, 1)
    a, b, a_rate, b_rate = stride.motion[-1][-1]
    p = Symbols(problem.structure)
    names = hy.make_vars("angle", "stance", "swing")
    strike = hy.cfunc(heelstrike(p, names[0], names[1], names[2], False), vars=[*names, *p.variables])
    rates = strike(np.ascontiguousarray(np.vstack([b, a_rate, b_rate, parameters])))[: m - 1]
    return np.vstack([b - y[0], rates - y[1:], a + b, a_rate + b_rate]) / y[0]


def _locate_grazing(gaits: Line, X: np.ndarray, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """X and the period where heelstrike is tangential, by Newton on G, from a branch's end shortly before it."""
    Z = np.concatenate([X[:-1], times, X[-1:]])
    n = len(Z)
    for _ in range(4):
        places = np.concatenate([Z + factor * STEP * np.eye(n) for factor in (1.0, -1.0, 2.0, -2.0)] + [Z[None]])
        G = _grazing([gaits.walker] * len(places), places.T)
        Z = Z - np.linalg.solve(_central(G[:, :-1], np.full(n, STEP)), G[:, -1])
    return np.concatenate([Z[: len(X) - 1], Z[-1:]]), Z[len(X) - 1 : -1]


def grazing_sensitivities(
    mark: Landmark, X: np.ndarray, times: np.ndarray, base: Walker, keys: list[str], step: float = STEP
) -> np.ndarray:
    """Compute the sensitivities dX/dp of the end where heelstrike becomes tangential.

    Parameters
    ----------
    mark, X, times, base, keys, step
        As for `sensitivities`.

    Returns
    -------
    ndarray, shape (m + 1, keys)
    """
    Z = np.concatenate([X[:-1], times, X[-1:]])
    sizes = np.array([_size(base, k) for k in keys]) * step * np.exp(X[0])
    walkers, places, n = [], [], len(Z)
    for factor in (1.0, -1.0, 2.0, -2.0):
        walkers += [base] * n
        walkers += [changed(mark.walker, base, k, factor * size) for k, size in zip(keys, sizes, strict=True)]
        places += [*(Z + factor * step * np.eye(n)), *([Z] * len(keys))]
    slopes = _central(_grazing(walkers, np.array(places).T), np.concatenate([np.full(n, step), sizes]))
    by_key = -np.linalg.solve(slopes[:, :n], slopes[:, n:])
    return np.vstack([by_key[: len(X) - 1], by_key[-1:]])


def _central(values: np.ndarray, h: np.ndarray) -> np.ndarray:
    """Derivatives from values at +h, -h, +2h, -2h, side by side."""
    plus, minus, plus_2, minus_2 = np.split(values, 4, axis=1)
    return (8 * (plus - minus) - (plus_2 - minus_2)) / (12 * h)


def sensitivities(
    mark: Landmark, X: np.ndarray, times: np.ndarray, base: Walker, keys: list[str], step: float = STEP
) -> np.ndarray:
    """Compute the sensitivities dX/dp of a landmark.

    Parameters
    ----------
    mark : Landmark
    X, times : ndarray, shape (m + 1,) and (phases,)
        The landmark, as from `place`.
    base : Walker
    keys : list of str
        Parameters p.
    step : float
        Step of the central differences.

    Returns
    -------
    ndarray, shape (m + 1, keys)
        Per unit of each key.
    """
    m = len(X) - 1
    sizes = np.array([_size(base, k) for k in keys]) * step * np.exp(X[0])
    walkers, places = [], []
    for factor in (1.0, -1.0, 2.0, -2.0):
        for i in range(m + 1):
            walkers.append(base)
            places.append(X + factor * step * np.eye(m + 1)[i])
        for key, size in zip(keys, sizes, strict=True):
            walkers.append(changed(mark.walker, base, key, factor * size))
            places.append(X)
    walkers.append(base)
    places.append(X)
    lanes = np.array(places).T
    G, derivative = _values(walkers, lanes, np.repeat(times[:, None], lanes.shape[1], axis=1), TESTS[mark.test])
    slopes = _central(G[:, :-1], np.concatenate([np.full(m + 1, step), sizes]))
    G_X = slopes[:, : m + 1]
    G_X[:m] = derivative[-1]
    return -np.linalg.solve(G_X, slopes[:, m + 1 :])


def _size(walker: Walker, key: str) -> float:
    """Scale of a key's steps."""
    if key in ("m_t", "m_s", "m_h"):
        return walker.total_mass
    return {"g": walker.g, "eps_T": 1.0}.get(key, walker.leg)


@memoize
def interval(name: str) -> Interval:
    """Compute the interval of a landmark, by its name."""
    mark = LANDMARKS[name]
    gaits = line(mark.walker)
    X, times = place(gaits, mark)
    half = dict(HALF_UNITS[mark.walker])
    keys = list(half)
    slope, angle = float(np.exp(X[-1])), float(np.exp(X[0]))
    differentiate = grazing_sensitivities if mark.test == "end_tangential_heelstrike" else sensitivities
    by_key = differentiate(mark, X, times, gaits.walker, keys)
    sensitivity = {k: slope * float(d) for k, d in zip(keys, by_key[-1], strict=True)}
    total = sum(abs(sensitivity[k]) * half[k] for k in keys)
    return Interval(
        slope,
        angle,
        slope - total,
        slope + total,
        sensitivity,
        {k: angle * float(d) for k, d in zip(keys, by_key[0], strict=True)},
        half,
    )
