"""How far rounding moves a fixed point: measured by a change of units, and estimated."""

from __future__ import annotations

import numpy as np
from numpy import ndarray

from gaitsweep.tasks.gaits.multipliers import characteristic
from gaitsweep.tasks.mechanics.arrays import (
    LogSlopes,
    Parameters,
    PerLane,
    Sections,
    Slopes,
    Times,
    Unknowns,
)
from gaitsweep.tasks.mechanics.sums import matvec, norm, total
from gaitsweep.tasks.step.lanes import lanes_of, parts_of
from gaitsweep.tasks.step.problem import EPS, Problem, residual_sizes, scale_of, sizes
from gaitsweep.tasks.step.several_steps import AnyStride


def reported(
    problem: Problem,
    y: Sections,
    times: Times,
    parameters: Parameters,
) -> tuple[ndarray, ndarray, ndarray]:
    """What is reported of gaits: the angle and the rates with which they start, and the
    period.

    Parameters
    ----------
    y : ndarray, shape (m, n)
        Section coordinates.
    times : ndarray, shape (k, n) [sqrt(leg/g)]
        Event times.
    parameters : ndarray, shape (n_parameters, n)

    Returns
    -------
    state : ndarray, shape (angles, n)
        Just after heelstrike.
    values : ndarray, shape (o, n)
        Angle, rates and period.
    by_unknowns : ndarray, shape (o, m + k, n)
        Their derivatives by y and the event times.
    """
    width = problem.map.start_size
    start = problem.map.start(y, parameters)
    state = start[:width]
    by_y = start[width:].reshape(width, -1, y.shape[1])
    rows = [0, *range(width // 2, width)]
    values = np.vstack([state[rows], times[-1:]])

    unknowns = len(y) + len(times)
    shape = len(values), unknowns, y.shape[1]
    coordinates = by_y.shape[1]
    by_unknowns = np.zeros(shape)
    by_unknowns[:-1, :coordinates] = by_y[rows]
    by_unknowns[-1, -1] = 1.0
    return state, values, by_unknowns


def reported_sizes(values: ndarray) -> ndarray:
    """Scales (o, n) of the errors of what is reported: for rates the largest of them,
    which alone cannot vanish.
    """
    return np.vstack([sizes(values[:-1]), np.abs(values[-1:])])


def sensitivity(
    stride: AnyStride,
    values: ndarray,
    by_unknowns: ndarray,
) -> ndarray:
    """How far relative errors of 1 of image and legs' angles at the strikes move what
    is reported, (o, n).
    """
    residual = residual_sizes(stride.y + stride.newton, len(stride.newton_times))
    moved = matvec(np.abs(stride.inverse), residual)
    return reported_sizes(values) + matvec(np.abs(by_unknowns), moved)


@np.errstate(divide="ignore", invalid="ignore", over="ignore")
def characteristic_scale(stride: AnyStride) -> ndarray:
    """How far a relative error of 1 on the way moves the coefficients of the
    derivative's characteristic polynomial.

    Eliminating the event times divides by the rates of the guards, twice: the
    derivative, and their own error.

    Parameters
    ----------
    stride : Stride

    Returns
    -------
    ndarray, shape (d, n)
        d are the coordinates of a section.
    """
    m = len(stride.y)
    d = len(stride.jacobian)
    size = sizes(stride.y)
    relative = stride.jacobian * (size[None, :d] / size[:d, None])
    length = norm(np.concatenate(relative))
    powers = np.cumprod(np.broadcast_to(length, (d, len(length))), axis=0)

    by_times = stride.derivative[:m, m:-1] / size[:, None]
    by_time = norm(np.concatenate(by_times))
    slowest = np.abs(stride.closing).min(axis=0) / np.abs(stride.y[0])
    return np.asarray(powers * (1 + by_time / slowest))


#: Units in which a step is evaluated to see how it rounds; a number divisible by
#: fifteen is exact in each.
UNITS = (1.0, 0.75, 1.25, 0.9375)
#: Steps evaluated at a time, so that many gaits of many steps find room in memory.
_MOST_STEPS = 1 << 14
#: Distance of neighbouring states: enough to round differently, and near enough to the
#: gait even for long steps.
_NEIGHBOUR = 1e-11


def by_fifteen(y: ndarray) -> ndarray:
    """Return numbers near others that are exact in each of the units: divisible by
    fifteen, with few bits.

    Parameters
    ----------
    y : ndarray

    Returns
    -------
    ndarray, same shape
    """
    mantissa, exponent = np.frexp(y / 15)
    whole = np.rint(np.ldexp(mantissa, 45))
    return np.asarray(15 * np.ldexp(whole, exponent - 45))


@np.errstate(invalid="ignore", divide="ignore", over="ignore")
def rounding_std(
    problem: Problem,
    w: Unknowns,
    log_slope: LogSlopes,
    near: int = 1,
) -> ndarray:
    """Standard deviation that rounding gives angle, rates and period of a fixed point,
    over their `sensitivity`.

    And the coefficients of the derivative's characteristic polynomial, over their
    `characteristic_scale`.

    Parameters
    ----------
    w : ndarray, shape (m + phases, n)
        Gaits in similarity coordinates.
    log_slope : ndarray, shape (n,)
        ln of the slope in rad.
    near : int
        Number of neighbouring states over which the variance is averaged.

    Returns
    -------
    ndarray, shape (o + d, n)
        The d coefficients last. NaN where there is no step.

    Notes
    -----
    Measured, not estimated: a step is evaluated in several units, in each of which every operation rounds anew.
    """
    of_each = near * len(UNITS) * problem.steps
    parts = []
    for some in parts_of(w.shape[1], _MOST_STEPS // of_each):
        lanes = problem.some(some)
        part = _rounding_std(lanes, w[:, some], log_slope[some], near)
        parts.append(part)

    return np.hstack(parts)


def _rounding_std(
    problem: Problem, w: Unknowns, log_slope: LogSlopes, near: int
) -> ndarray:
    """What `rounding_std` returns, with all states side by side."""
    n = w.shape[1]
    lanes = np.tile(np.arange(n), near)
    neighbour = np.repeat(np.arange(near), n)
    moved = w[:, lanes]
    moved[0] += _NEIGHBOUR * neighbour

    slope = np.exp(log_slope[lanes])
    of_all = _variance(problem.some(lanes), moved, slope)
    by_state = of_all.reshape(-1, near, n)
    variances = by_state.swapaxes(0, 1)
    known = np.isfinite(variances)
    summed = total(np.where(known, variances, 0.0))
    return np.sqrt(summed / known.sum(axis=0))


def _variance(problem: Problem, w: Unknowns, slope: Slopes) -> ndarray:
    """Variances of what `rounding_std` measures, at one state of each gait."""
    n = w.shape[1]
    stride, values, by_unknowns = _in_all_units(problem, w, slope)
    coefficients = characteristic(stride.jacobian)

    unit = np.repeat(UNITS, n)
    of_all = _in_units(values, unit, coefficients)
    by_unit = of_all.reshape(-1, len(UNITS), n)
    found = by_unit.swapaxes(0, 1)
    mean = total(found) / len(UNITS)
    off = found - mean

    # The sensitivity is the same in all units but for rounding: the last serves.
    last = slice(len(unit) - n, None)
    in_last = lanes_of(stride, last)
    by_image = sensitivity(in_last, values[:, last], by_unknowns[..., last])
    of_coefficients = characteristic_scale(in_last)
    scale = _in_units(by_image, UNITS[-1], of_coefficients)

    variance = total(off * off) / (len(UNITS) - 1)
    return np.asarray(variance / scale**2)


def _in_all_units(
    problem: Problem, w: Unknowns, slope: Slopes
) -> tuple[AnyStride, ndarray, ndarray]:
    """Steps of gaits (m + phases, n) in one unit after another, what is reported of
    them, and its derivatives.
    """
    m = problem.m
    angle = np.exp(w[0])
    power = scale_of(angle)
    section = np.vstack([angle, angle * w[1:m]])
    y = by_fifteen(section / power)

    n = w.shape[1]
    lanes = np.tile(np.arange(n), len(UNITS))
    unit = np.repeat(UNITS, n)
    scale = power[lanes] * unit
    parameters = problem.some(lanes).parameters(slope[lanes], scale)
    stride = problem.map(y[:, lanes] / unit, w[m:, lanes], parameters)

    at_gait = stride.y + stride.newton
    _, values, by_unknowns = reported(problem, at_gait, stride.newton_times, parameters)
    return stride, values, by_unknowns


def _in_units(values: ndarray, unit: float | ndarray, coefficients: ndarray) -> ndarray:
    """Angle and rates in a unit, the period, and coefficients below them."""
    return np.vstack([values[:-1] * unit, values[-1:], coefficients])


def rounding(stride: AnyStride) -> ndarray:
    """Estimate how far rounding of the step map alone can move the fixed point,
    relative to `sizes`.

    Parameters
    ----------
    stride : Stride
        The step at or near the fixed point.

    Returns
    -------
    ndarray, shape (m, n)

    Notes
    -----
    With J = I - DP, rounding of the image moves the fixed point by J^-1, and rounding of the start, carried through
    the step, by J^-1 DP = J^-1 - I, which is far smaller than |J^-1| |DP|. Rounding on
    the way lies between the two. The estimate tells Newton when to stop; bounds measure
    it (`rounding_std`, `equations.slope_error`).
    """
    size = sizes(stride.y)
    beyond = _on_the_way(stride, size)
    # Angles and rates mix on the way, so the rounding of all is that of the largest. A
    # point foot's motion has few constants; that of others many, each of them rounded,
    # and several times the operations.
    m = len(size)
    share = 0.5 if len(stride.jacobian) == 2 else 3.0
    of_image = np.abs(stride.residual[:m] + stride.y)
    largest = (size + of_image).max(axis=0)
    image = np.broadcast_to(share * largest, size.shape)

    inverse = stride.inverse[:m, :m]
    through = np.abs(inverse - np.eye(m)[:, :, None])
    by_image = matvec(np.abs(inverse), image + beyond)
    by_start = matvec(through, size + beyond)
    return EPS * (by_image + by_start) / size


def _on_the_way(stride: AnyStride, size: ndarray) -> PerLane:
    """What rounding accumulates on the way beyond that of sections of some sizes (m, n):
    off balance, a short step has rates that far exceed its section's.

    Where a strike is tangential to the last digit neither the image nor the rates are
    corrected.
    """
    one = stride.one
    n = size.shape[1]
    impact = np.where(np.isfinite(one.impact), np.abs(one.impact), 0.0)
    at_impact = impact.reshape(-1, n).max(axis=0)
    at_start = np.abs(one.start).reshape(-1, n).max(axis=0)
    fastest = np.maximum(at_impact, at_start)
    faster = fastest - 2 * size.max(axis=0)
    return np.asarray(48 * np.maximum(0, faster))
