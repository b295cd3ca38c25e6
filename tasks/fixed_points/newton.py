"""Newton's method on the fixed points of the step map, in batches of lanes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gaitsweep.tasks.fixed_points.multipliers import characteristic
from gaitsweep.tasks.fixed_points.rounding import characteristic_scale, rounding
from gaitsweep.tasks.mechanics.sums import matvec, total
from gaitsweep.tasks.step.problem import Problem, joint_sizes
from gaitsweep.tasks.step.several_steps import AnyStride

#: Mean durations of steps beyond this are a fall: the stance leg nearly comes to rest
#: upright [sqrt(leg/g)].
LONGEST_PERIOD = 12.0
#: Shortest time of a strike of an initial guess [sqrt(leg/g)].
_SHORTEST_PHASE = 0.005
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


def similarity(y: np.ndarray, dy: np.ndarray) -> np.ndarray:
    """Change of (ln angle, rates/angle) for a change dy of scaled coordinates y, to
    first order; all (m, n).
    """
    d = dy / y[0]
    return np.vstack([d[:1], d[1:] - y[1:] / y[0] * d[:1]])


def newton_step(stride: AnyStride, w: np.ndarray) -> np.ndarray:
    """Newton step of P(y) = y in similarity coordinates.

    Parameters
    ----------
    stride : Stride
        The step at w.
    w : ndarray, shape (m + phases, n)
        ln(angle), rates/angle and event times [sqrt(leg/g)].

    Returns
    -------
    ndarray, shape (m + phases, n)
    """
    return np.vstack(
        [similarity(stride.y, stride.newton), stride.newton_times - w[len(stride.y) :]]
    )


def relative_sizes(w: np.ndarray, m: int) -> np.ndarray:
    """How far similarity coordinates and event times move for relative changes by 1 of
    angle, rates and period.

    Parameters
    ----------
    w : ndarray, shape (m + phases, n)
    m : int

    Returns
    -------
    ndarray, shape (m + phases, n)
    """
    sizes = np.ones(w.shape)
    sizes[1:m], sizes[m:] = np.abs(w[1:m]).max(axis=0), w[-1]
    return sizes


# Beside a known solution, or where the step leads away from it at once, deflation
# divides by nothing.
@np.errstate(invalid="ignore", divide="ignore", over="ignore")
def _deflated(
    step: np.ndarray, w: np.ndarray, known: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Newton steps (m + k, n) at iterates w that known solutions repel, and whether
    these are beside the iterates (n,).

    With M the product of 1 + 1/r^2 over the known solutions, Newton's step for M F is
    its step s for F over 1 - s.grad ln M (Sherman-Morrison formula), at no extra
    evaluation.
    """
    offset = w[:, None] - known[:, :, None]
    square = total(offset * offset)
    growth = total(-2 * offset * step[:, None]) / (square**2 + square)
    return step / (1 - total(growth)), np.asarray((square <= _BESIDE**2).any(axis=0))


def newton(
    problem: Problem,
    w: np.ndarray,
    log_slope: np.ndarray,
    coarse: bool = False,
    enough: float = 0.0,
    max_iterations: int = _MAX_ITERATIONS,
    max_step_by_iteration: Sequence[float] = (1e6,),
    merge_cell: float = 0.0,
    group: np.ndarray | None = None,
    known: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Damped Newton on every lane; finished lanes leave the batch.

    Parameters
    ----------
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
    w = w.copy()
    n = w.shape[1]
    converged = np.zeros(n, bool)
    active = np.arange(n)
    last = np.full(n, np.inf)
    for taken in range(max_iterations):
        if not len(active):
            break
        stride, _ = problem.some(active).stride(
            w[:, active], log_slope[active], coarse=coarse
        )
        step = newton_step(stride, w[:, active])
        size = np.abs(step).max(axis=0)
        rounding_std = np.nan_to_num(rounding(stride).max(axis=0), nan=np.inf)
        beside = np.zeros(len(active), bool)
        if known is not None:
            step, beside = _deflated(step, w[:, active], known)
        length = np.abs(step).max(axis=0)
        alive = np.isfinite(length) & (
            size < max_step_by_iteration[min(taken, len(max_step_by_iteration) - 1)]
        )
        step[:, alive] *= np.minimum(1.0, 0.5 / np.maximum(length[alive], 1e-300))
        w[:, active[alive]] += step[:, alive]
        # Done when the step is rounding, or has become small and stopped shrinking.
        done = alive & (
            (size < np.maximum(1e-5 if coarse else rounding_std, enough))
            | ((size < 1e-6) & (size > 0.3 * last[active]))
        )
        brevity = np.minimum(1.0, w[-1, active] / np.pi)
        sane = (np.abs(brevity * w[1 : problem.m, active]) < 50).all(axis=0)
        sane &= (w[problem.m :, active] > _SHORTEST_PHASE).all(axis=0)
        sane &= (w[-1, active] < LONGEST_PERIOD * problem.steps) & (w[0, active] < 0.4)
        converged[active[done & sane & ~beside]] = True
        last[active] = size
        active = active[alive & sane & ~done]
        if merge_cell and group is not None and taken > 1:
            active = active[np.argsort(last[active], kind="stable")]
            cells = np.vstack([group[active], np.round(w[:, active] / merge_cell)])
            active = np.sort(active[np.unique(cells, axis=1, return_index=True)[1]])
    return w, converged


def curvature(
    problem: Problem, w: np.ndarray, log_slope: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """How the derivatives change near solutions, by differences in all directions.

    Directions are those of the section and of the event times, F the joint equations of
    both.

    Parameters
    ----------
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
    lipschitz, lanes = np.full(w.shape[1], np.nan), np.arange(w.shape[1])
    gradient = np.full((problem.structure.dimension, *w.shape), np.nan)
    for h in _DIFFERENCES:
        lipschitz[lanes], gradient[..., lanes], change = _curvature(
            problem.some(lanes), w[:, lanes], log_slope[lanes], h
        )
        # Where derivatives change much over the difference, that must be smaller.
        lanes = lanes[
            ~((lipschitz[lanes] * h < _MAX_CHANGE) & (change < _MAX_STEEPNESS))
        ]
        if not len(lanes):
            break
    return lipschitz, gradient


def _curvature(
    problem: Problem, w: np.ndarray, log_slope: np.ndarray, h: float
) -> tuple[np.ndarray, ...]:
    """What `curvature` returns, at w by differences h, and how much the polynomial
    changes over these, relatively.
    """
    base, _ = problem.stride(w, log_slope)
    worst, gradient = np.zeros(w.shape[1]), np.zeros((len(base.jacobian), *w.shape))
    polynomial = characteristic(base.jacobian)
    # In relative coordinates of the base point; another scale would multiply rows and
    # divide columns by the same.
    size = joint_sizes(base.y, problem.phases)
    for i in range(len(w)):
        moved = w.copy()
        moved[i] += h
        stride, _ = problem.stride(moved, log_slope)
        change = (stride.derivative - base.derivative) / h
        product = matvec(base.inverse[:, :, None], change[:, : len(w)])
        weighted = product * size[None] / size[:, None]
        worst = np.maximum(worst, total(np.abs(weighted).swapaxes(0, 1)).max(axis=0))
        gradient[:, i] = (characteristic(stride.jacobian) - polynomial) / h
    # Multipliers near zero have no size of their own: then 1 is their scale.
    steepness = (
        np.abs(gradient).max(axis=(0, 1))
        * h
        / np.maximum(np.abs(polynomial).max(axis=0), 1.0)
    )
    return worst, gradient / characteristic_scale(base)[:, None], steepness
