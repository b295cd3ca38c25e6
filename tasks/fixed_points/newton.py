"""Newton's method on the fixed points of the step map, in batches of lanes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tasks.fixed_points.rounding import rounding
from tasks.step.problem import Problem, sizes
from tasks.step.step_map import Stride, matvec

#: Periods beyond are a fall: the stance leg has all but come to stand upright [sqrt(leg/g)].
LONGEST_PERIOD = 12.0
#: Newton steps a start may take; an honest one takes 2 to 8.
MAX_ITERATIONS = 25
#: The same for a rough flight: what is not near by then hardly ever arrives.
MAX_ROUGH = 10


def similarity(y: np.ndarray, dy: np.ndarray) -> np.ndarray:
    """Change of (ln angle, rates/angle) for a change dy of scaled coordinates y, to first order."""
    d = dy / y[0]
    return np.vstack([d[:1], d[1:] - y[1:] / y[0] * d[:1]])


def newton_step(stride: Stride, w: np.ndarray) -> np.ndarray:
    """The Newton step of a stride in similarity coordinates, shape (m + phases, n)."""
    times = stride.times + matvec(stride.times_by_y, stride.newton)
    return np.vstack([similarity(stride.y, stride.newton), times - w[len(stride.y) :]])


@dataclass
class Solved:
    """Outcome of Newton on n lanes: coordinates, and whether they converged."""

    w: np.ndarray
    converged: np.ndarray


def newton(
    problem: Problem,
    w: np.ndarray,
    log_slope: np.ndarray,
    coarse: bool = False,
    max_step_by_iteration: Sequence[float] = (1e6,),
    merge_cell: float = 0.0,
) -> Solved:
    """Damped Newton on every lane; finished lanes leave the batch.

    Parameters
    ----------
    w : ndarray, shape (m + phases, n)
        Starts, in similarity coordinates.
    log_slope : ndarray, shape (n,)
    rough : bool
        Only to the search's tolerance.
    hopeless : sequence of float
        Size of the first, second, ... step that ends a lane's search; the last holds from there on.
    merge : float
        After three steps, of lanes at one slope that share a cell of this size, only that with the least step goes on.
    """
    w = w.copy()
    n = w.shape[1]
    converged = np.zeros(n, bool)
    active = np.arange(n)
    last = np.full(n, np.inf)
    for taken in range(MAX_ROUGH if coarse else MAX_ITERATIONS):
        if not len(active):
            break
        stride, _ = problem.some(active).stride(w[:, active], log_slope[active], coarse=coarse)
        step = newton_step(stride, w[:, active])
        size = np.abs(step).max(axis=0)
        rounding_std = np.nan_to_num(rounding(stride).max(axis=0), nan=np.inf)
        alive = np.isfinite(size) & (size < max_step_by_iteration[min(taken, len(max_step_by_iteration) - 1)])
        step[:, alive] *= np.minimum(1.0, 0.5 / np.maximum(size[alive], 1e-300))
        w[:, active[alive]] += step[:, alive]
        # Done when the step is rounding, or has become small and stopped shrinking.
        done = alive & ((size < (1e-5 if coarse else rounding_std)) | ((size < 1e-6) & (size > 0.3 * last[active])))
        sane = (np.abs(w[1 : problem.m, active]) < 50).all(axis=0) & (w[problem.m :, active] > 0.05).all(axis=0)
        sane &= (w[-1, active] < LONGEST_PERIOD) & (w[0, active] < 0.4)
        converged[active[done & sane]] = True
        last[active] = size
        active = active[alive & sane & ~done]
        if merge_cell and taken > 1:
            active = active[np.argsort(last[active], kind="stable")]
            cells = np.vstack([log_slope[active], np.round(w[:, active] / merge_cell)])
            active = np.sort(active[np.unique(cells, axis=1, return_index=True)[1]])
    return Solved(w, converged)


def lipschitz(problem: Problem, X: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Lipschitz estimate of the Newton map at solutions: max over directions of |J^-1 dJ|/|dw|, shape (n,)."""
    m = problem.m
    w = np.vstack([X[:m], times])
    base, _ = problem.stride(w, X[m])
    worst = np.zeros(X.shape[1])
    h = 1e-4
    for i in range(m):
        moved = w.copy()
        moved[i] += h
        stride, scale = problem.stride(moved, X[m])
        # Both in the base point's relative coordinates; a changed scale would only rescale rows and columns alike.
        change = (stride.jacobian - base.jacobian) / h
        size = sizes(base.y)
        weighted = np.einsum("ijn,jkn->ikn", base.inverse, change) * size[None] / size[:, None]
        worst = np.maximum(worst, np.abs(weighted).sum(axis=1).max(axis=0))
    return worst
