"""Newton's method on the fixed points of the step map, in batches of lanes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from gaitsweep.tasks.gaits.multipliers import characteristic
from gaitsweep.tasks.gaits.rounding import characteristic_scale, rounding
from gaitsweep.tasks.mechanics.arrays import (
    LogSlopes,
    Marks,
    Numbers,
    PerLane,
    Sections,
    Unknowns,
)
from gaitsweep.tasks.mechanics.sums import matvec, total
from gaitsweep.tasks.step.iterate import Ended, iterate
from gaitsweep.tasks.step.lanes import parts_of
from gaitsweep.tasks.step.problem import Problem, joint_sizes
from gaitsweep.tasks.step.several_steps import AnyStride

#: Mean durations of steps beyond this are a fall: the stance leg nearly comes to rest
#: upright [sqrt(leg/g)].
LONGEST_PERIOD = 12.0
#: Shortest time of a strike of an initial guess [sqrt(leg/g)].
_SHORTEST_PHASE = 0.005
#: Largest rate over angle of an iterate in steps of pi or more [1/sqrt(leg/g)], and ln of
#: its largest angle.
_MAX_RATE, _MAX_LOG_ANGLE = 50, 0.4
#: Newton steps an initial guess may take; one that converges takes 2 to 8.
_MAX_ITERATIONS = 25

#: Smallest distance of a new solution from those that deflation removes.
_BESIDE = 1e-2

#: Differences by which Lipschitz constants are estimated, in turn, until the derivative
#: changes over one by no more than this, relative: steps that almost end in a fall are
#: far more curved than others.
_DIFFERENCES, _MAX_CHANGE = (1e-4, 1e-7, 1e-10), 0.5
#: The same of the characteristic polynomial, whose roots grow without bound beside
#: strikes that turn tangential.
_MAX_STEEPNESS = 0.05
#: Steps evaluated at a time, so that many gaits of many steps find room in memory.
_MOST_STEPS = 1 << 14


def similarity(y: Sections, dy: Sections) -> Sections:
    """Change of (ln angle, rates/angle) for a change dy of section coordinates y, to
    first order.
    """
    d = dy / y[0]
    return np.vstack([d[:1], d[1:] - y[1:] / y[0] * d[:1]])


def newton_step(stride: AnyStride, w: Unknowns) -> Unknowns:
    """Newton step of P(y) = y in similarity coordinates, from the step at w."""
    change = similarity(stride.y, stride.newton)
    return np.vstack([change, stride.newton_times - w[len(change) :]])


def relative_sizes(w: Unknowns, m: int) -> Unknowns:
    """How far similarity coordinates and event times move for relative changes by 1 of
    angle, rates and period.
    """
    sizes = np.ones(w.shape)
    sizes[1:m] = np.abs(w[1:m]).max(axis=0)
    sizes[m:] = w[-1]
    return sizes


def newton(
    problem: Problem,
    w: Unknowns,
    log_slope: LogSlopes,
    coarse: bool = False,
    enough: float = 0.0,
    max_iterations: int = _MAX_ITERATIONS,
    max_step_by_iteration: Sequence[float] = (1e6,),
    merge_cell: float = 0.0,
    group: np.ndarray | None = None,
    known: Unknowns | None = None,
) -> tuple[Unknowns, Marks]:
    """Damped Newton on every lane; finished lanes leave the batch.

    Parameters
    ----------
    problem : Problem
    w : ndarray, shape (m + phases, n)
        Initial guesses in similarity coordinates.
    log_slope : ndarray, shape (n,)
        ln of the slope in rad.
    coarse : bool
        Only to the search's tolerance.
    enough : float
        Size of a Newton step after which a gait that only leads to others is accurate
        enough.
    max_iterations : int
    max_step_by_iteration : sequence of float
        Size of the first, second, ... Newton step that ends a lane's search; the last
        holds for all that follow.
    merge_cell : float
        After three steps, of lanes of one group in one cell of this size, only that
        with the smallest step continues.
    group : ndarray of int, shape (n,), optional
        Of lanes with one walker at one slope.
    known : ndarray, shape (m + phases, j), optional
        Solutions that repel the iterates, which lead to others.

    Returns
    -------
    w : ndarray, shape (m + phases, n)
    converged : ndarray of bool, shape (n,)
    """
    rule = _DampedNewton(
        problem,
        w.copy(),
        log_slope,
        np.full(w.shape[1], np.inf),
        coarse,
        enough,
        max_step_by_iteration,
        merge_cell,
        group,
        known,
    )
    ended = iterate(rule, w.shape[1], max_iterations)
    return rule.w, ended == Ended.CONVERGED


@dataclass
class _DampedNewton:
    """Newton's method with steps cut to length, at iterates `w` with last steps of
    `size`; its options are those of `newton`.
    """

    problem: Problem
    w: Unknowns
    log_slope: LogSlopes
    size: PerLane
    coarse: bool
    enough: float
    max_step_by_iteration: Sequence[float]
    merge_cell: float
    group: np.ndarray | None
    known: Unknowns | None

    def step(self, lanes: Numbers, taken: int) -> np.ndarray:
        """Step once more in some lanes."""
        w = self.w[:, lanes]
        problem = self.problem.some(lanes)
        stride, _ = problem.stride(w, self.log_slope[lanes], coarse=self.coarse)
        step = newton_step(stride, w)
        size = _largest(step)
        step, beside = _deflated(step, w, self.known)

        exists = np.isfinite(step).all(axis=0)
        moves = exists & (size < self._longest(taken))
        w[:, moves] += _shortened(step[:, moves])
        at_rest = self._is_at_rest(stride, size, self.size[lanes])

        self.w[:, lanes], self.size[lanes] = w, size
        ended = np.select(
            [~exists, ~(moves & _may_walk(problem, w)), ~at_rest, beside],
            [Ended.SINGULAR, Ended.DIVERGED, Ended.RUNNING, Ended.KNOWN],
            Ended.CONVERGED,
        )
        if taken > 1:
            ended[self._led_by_others(lanes, ended == Ended.RUNNING)] = Ended.KNOWN
        return ended

    def _longest(self, taken: int) -> float:
        """Size of a step that ends a lane's search."""
        last = len(self.max_step_by_iteration) - 1
        return self.max_step_by_iteration[min(taken, last)]

    def _is_at_rest(self, stride: AnyStride, size: PerLane, before: PerLane) -> Marks:
        """Whether steps suffice, or are rounding: small, and no longer shrinking."""
        of_rounding = np.float64(1e-5)
        if not self.coarse:
            of_rounding = np.nan_to_num(rounding(stride).max(axis=0), nan=np.inf)
        suffices = size < np.maximum(of_rounding, self.enough)
        return suffices | ((size < 1e-6) & (size > 0.3 * before))

    def _led_by_others(self, lanes: Numbers, running: Marks) -> Marks:
        """Which of the lanes that run on lie in a cell with a smaller step's."""
        if not self.merge_cell or self.group is None:
            return np.zeros(len(lanes), bool)

        nearest_first = lanes[running][
            np.argsort(self.size[lanes[running]], kind="stable")
        ]
        w = np.round(self.w[:, nearest_first] / self.merge_cell)
        cells = np.vstack([self.group[nearest_first], w])
        _, first = np.unique(cells, axis=1, return_index=True)
        return running & ~np.isin(lanes, nearest_first[first])


def _shortened(step: Unknowns) -> Unknowns:
    """Steps, cut to half a unit where they are longer."""
    length = np.maximum(_largest(step), 1e-300)
    return step * np.minimum(1.0, 0.5 / length)


# Beside a known solution, or where the step leads away from it at once, deflation
# divides by nothing.
@np.errstate(invalid="ignore", divide="ignore", over="ignore")
def _deflated(
    step: Unknowns, w: Unknowns, known: Unknowns | None
) -> tuple[Unknowns, Marks]:
    """Newton steps at iterates w that known solutions repel, and whether these are
    beside the iterates.

    With M the product of 1 + 1/r^2 over the known solutions, Newton's step for M F is
    its step s for F over 1 - s.grad ln M (Sherman-Morrison formula), at no extra
    evaluation.
    """
    if known is None:
        return step, np.zeros(w.shape[1], bool)
    offset = w[:, None] - known[:, :, None]
    square = total(offset * offset)
    growth = total(-2 * offset * step[:, None]) / (square**2 + square)
    return step / (1 - total(growth)), np.asarray((square <= _BESIDE**2).any(axis=0))


def _may_walk(problem: Problem, w: Unknowns) -> Marks:
    """Whether iterates lie where gaits may: rates, durations and angles of some size."""
    brevity = np.minimum(1.0, w[-1] / np.pi)
    is_slow = (np.abs(brevity * w[1 : problem.m]) < _MAX_RATE).all(axis=0)
    lasts = (w[problem.m :] > _SHORTEST_PHASE).all(axis=0)
    ends = w[-1] < LONGEST_PERIOD * problem.steps
    return is_slow & lasts & ends & (w[0] < _MAX_LOG_ANGLE)


def curvature(
    problem: Problem, w: Unknowns, log_slope: LogSlopes
) -> tuple[PerLane, np.ndarray]:
    """How the derivatives change near solutions, by differences in all directions.

    Directions are those of the section and of the event times, F the joint equations of
    both.

    Parameters
    ----------
    problem : Problem
    w : ndarray, shape (m + phases, n)
        Gaits in similarity coordinates.
    log_slope : ndarray, shape (n,)
        ln of the slope in rad.

    Returns
    -------
    lipschitz : ndarray, shape (n,)
        Estimate for the Newton map: maximum over directions of |F'^-1 dF'|/|dw|.
    gradient : ndarray, shape (d, m + phases, n)
        Derivatives of the coefficients of the characteristic polynomial by w, over
        their `characteristic_scale`.
    """
    lipschitz = np.full(w.shape[1], np.nan)
    gradient = np.full((problem.structure.dimension, *w.shape), np.nan)
    lanes = np.arange(w.shape[1])
    for h in _DIFFERENCES:
        lipschitz[lanes], gradient[..., lanes], change = _curvature(
            problem.some(lanes), w[:, lanes], log_slope[lanes], h
        )
        # Where derivatives change much over the difference, that must be smaller.
        is_small = (lipschitz[lanes] * h < _MAX_CHANGE) & (change < _MAX_STEEPNESS)
        lanes = lanes[~is_small]
        if not len(lanes):
            break

    return lipschitz, gradient


def _curvature(
    problem: Problem, w: Unknowns, log_slope: LogSlopes, h: float
) -> tuple[np.ndarray, ...]:
    """What `curvature` returns, at w by differences h, and how much the polynomial
    changes over these, relatively.
    """
    base, _ = problem.stride(w, log_slope)
    polynomial = characteristic(base.jacobian)
    # In relative coordinates of the base point; another scale would multiply rows and
    # divide columns by the same.
    size = joint_sizes(base.y, problem.phases)

    k, n = w.shape
    lipschitz = np.zeros(n)
    gradient = np.zeros((len(base.jacobian), *w.shape))
    for i, derivative, moved_to in _beside(problem, w, log_slope, h):
        change = (derivative - base.derivative)[:, :k] / h
        moved_by = matvec(base.inverse[:, :, None], change)
        lipschitz = np.maximum(lipschitz, _row_sum_norm(moved_by, size))
        gradient[:, i] = (moved_to - polynomial) / h

    # Multipliers near zero have no size of their own: then 1 is their scale.
    scale = np.maximum(_largest(polynomial), 1.0)
    steepness = _largest(np.concatenate(gradient)) * h / scale
    return lipschitz, gradient / characteristic_scale(base)[:, None], steepness


def _beside(
    problem: Problem, w: Unknowns, log_slope: LogSlopes, h: float
) -> Iterator[tuple[int, np.ndarray, np.ndarray]]:
    """The derivative of the joint equations and the characteristic polynomial at w moved
    by h in each direction, many of these side by side.
    """
    k, n = w.shape
    for part in parts_of(k, _MOST_STEPS // (n * problem.steps)):
        directions = np.arange(k)[part]
        lanes = np.tile(np.arange(n), len(directions))
        moved = w[:, lanes]
        moved[np.repeat(directions, n), np.arange(len(lanes))] += h

        stride, _ = problem.some(lanes).stride(moved, log_slope[lanes])
        polynomials = characteristic(stride.jacobian)
        for place, i in enumerate(directions.tolist()):
            some = slice(place * n, (place + 1) * n)
            yield i, stride.derivative[..., some], polynomials[:, some]


def _row_sum_norm(matrices: np.ndarray, size: np.ndarray) -> PerLane:
    """Largest sum of a row's magnitudes, of matrices (k, k, n) of coordinates over their
    sizes (k, n).
    """
    weighted = np.abs(matrices * size / size[:, None])
    return np.asarray(total(weighted.swapaxes(0, 1)).max(axis=0))


def _largest(values: np.ndarray) -> PerLane:
    """Largest magnitude in every lane, of values (i, n)."""
    return np.asarray(np.abs(values).max(axis=0))
