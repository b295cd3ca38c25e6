"""How far rounding moves a fixed point: measured in several units, and estimated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tasks.step.problem import EPS, Problem, sizes
from tasks.step.step_map import Stride, matvec


@dataclass
class NewtonStep:
    """Where a stride's Newton step leads: `y` (m, n) section, `times` (k, n), `state` (a, n) just after heelstrike.

    `values` (o, n) are what a gait is known by, its angle, rates and period, and `by_y` (o, m, n) their derivatives;
    `size` (o, n) is what their errors are measured by: rates by the largest of them, which alone cannot vanish;
    `reach` (o, n) is how far an image wrong by all of itself would move them.
    """

    y: np.ndarray
    times: np.ndarray
    state: np.ndarray
    values: np.ndarray
    size: np.ndarray
    by_y: np.ndarray
    sensitivity: np.ndarray


def apply_newton_step(problem: Problem, stride: Stride, parameters: np.ndarray) -> NewtonStep:
    """Take the Newton step of strides flown with some parameters."""
    y = stride.y + stride.newton
    times = stride.times + matvec(stride.times_by_y, stride.newton)
    size = problem.map.start_size
    begin, shown = problem.map.start(y, parameters), [0, *range(size // 2, size)]
    state, by_y = begin[:size], begin[size:].reshape(size, *y.shape)
    values, by_y = np.vstack([state[shown], times[-1:]]), np.concatenate([by_y[shown], stride.times_by_y[-1:]])
    measure = np.vstack([sizes(values[:-1]), np.abs(values[-1:])])
    sensitivity = measure + matvec(np.abs(by_y), matvec(np.abs(stride.inverse), sizes(y)))
    return NewtonStep(y, times, state, values, measure, by_y, sensitivity)


#: Units a stride is flown in to see how it rounds; a number divisible by fifteen is exact in each.
UNITS = (1.0, 0.75, 1.25, 0.9375)


@np.errstate(invalid="ignore", divide="ignore", over="ignore")
def rounding_std(problem: Problem, w: np.ndarray, log_slope: np.ndarray, near: int = 1) -> np.ndarray:
    """Standard deviation that rounding gives angle, rates and period of a fixed point, over their `reach`, (o, n).

    Measured: one stride is flown in units that round every operation on the way anew, from `near` starts side by side.
    NaN where there is no stride.
    """
    m, slope, variances = problem.m, np.exp(log_slope), []
    for turn in range(near):
        angle = np.exp(w[0] + 1e-8 * turn)
        scale = np.exp2(np.floor(np.log2(angle)))
        mantissa, exponent = np.frexp(np.vstack([angle, angle * w[1:m]]) / scale / 15)
        y = 15 * np.ldexp(np.rint(np.ldexp(mantissa, 45)), exponent - 45)
        seen = []
        for unit in UNITS:
            parameters = problem.parameters(slope, scale * unit)
            found = apply_newton_step(problem, problem.map(y / unit, w[m:], parameters), parameters)
            seen.append(np.vstack([found.values[:-1] * unit, found.values[-1:]]))
        # Units do not change what is measured in them.
        sensitivity = np.vstack([found.sensitivity[:-1] * unit, found.sensitivity[-1:]])
        variances.append(np.var(seen, axis=0, ddof=1) / sensitivity**2)
    known = np.isfinite(variances)
    return np.sqrt(np.where(known, variances, 0.0).sum(axis=0) / known.sum(axis=0))


def rounding(stride: Stride) -> np.ndarray:
    """How far rounding of the stride map alone can move the fixed point, relative, shape (m, n).

    Notes
    -----
    With J = I - DP, rounding of the image moves the fixed point by J^-1, and rounding of the start, carried through
    the stride, by J^-1 DP = J^-1 - I, which is far smaller than |J^-1| |DP|. What is rounded on the way lies between
    the two. An estimate, by which Newton knows that it is done, and of special points; that of gaits is measured
    (`noise`).
    """
    size = sizes(stride.y)
    # Off balance, a short step is flown by forces and rates that dwarf its section; their rounding adds up on the way.
    most = size.max(axis=0)
    beyond = 48 * np.maximum(
        0, np.maximum(np.abs(stride.impact).max(axis=0), np.abs(stride.start).max(axis=0)) - 2 * most
    )
    # Angles become rates on the way and rates angles: the largest of them rounds them all. A point foot's motion has
    # few constants; that of others many, each of them rounded, and several times the operations.
    share = 0.5 if len(size) == 2 else 3.0
    landed = np.broadcast_to(share * (size + np.abs(stride.image)).max(axis=0), size.shape)
    through = np.abs(stride.inverse - np.eye(len(size))[:, :, None])
    return EPS * (matvec(np.abs(stride.inverse), landed + beyond) + matvec(through, size + beyond)) / size
