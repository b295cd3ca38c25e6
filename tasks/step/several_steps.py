"""Several steps in a row as one map, by multiple shooting: a gait of s steps is its
fixed point.

All s sections are unknowns, so errors do not grow over many steps: a gait of 64 steps
is as well conditioned as one of a single step. Sections follow each other in y, all
over the scale of the first; event times count from the start of the first step. In
shapes, m and k count the section coordinates and the phases of all steps, n lanes.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from gaitsweep.tasks.mechanics.sums import matvec
from gaitsweep.tasks.step.step_map import Stride, StrideMap


@dataclass
class Strides:
    """Steps in a row of n lanes, with what a `Stride` has.

    Attributes
    ----------
    one : Stride
        The single steps, in arrays of shape (..., s, n).
    y : ndarray, shape (m, n)
        Their sections, scaled.
    guessed : ndarray, shape (k, n) [sqrt(leg/g)]
        The event times at which they were evaluated.
    """

    one: Stride
    y: ndarray
    guessed: ndarray

    @property
    def steps(self) -> int:
        """Number of steps."""
        return self.one.y.shape[1]

    @property
    def singles(self) -> Stride:
        """The single steps in s n lanes: the first steps of all gaits, then the second
        ones.
        """
        lanes = self.steps * self.y.shape[1]

        def in_lanes(values: ndarray) -> ndarray:
            return values.reshape(*values.shape[:-2], lanes)

        return self.one.mapped(in_lanes)

    @property
    def closing(self) -> ndarray:
        """Rates of the guards at the strikes, shape (k, n)."""
        return _in_a_row(self.one.closing)

    @property
    def image(self) -> ndarray:
        """Where the steps lead, each at the place of the section after it, shape (m,
        n).
        """
        return np.asarray(self.residual[: len(self.y)] + self.y)

    @functools.cached_property
    def jacobian(self) -> ndarray:
        """Derivative of all steps, one after another, by the first section, shape (m/s,
        m/s, n).
        """
        product = self.one.jacobian[:, :, 0]
        for i in range(1, self.steps):
            product = matvec(self.one.jacobian[:, :, None, i], product)
        return np.asarray(product)

    @functools.cached_property
    def times(self) -> ndarray:
        """Event times, corrected, shape (k, n)."""
        periods = self.one.times[-1]
        begins = np.cumsum(periods, axis=0) - periods
        return _in_a_row(self.one.times + begins)

    @functools.cached_property
    def residual(self) -> ndarray:
        """Of the joint equations: of each section how far the step before it misses it,
        and the guards, (m + k, n).
        """
        m = len(self.one.y)
        image = self.one.residual[:m] + self.one.y
        missed = np.roll(image, 1, axis=1) - self.one.y
        guards = self.one.residual[m:]
        return np.vstack([_in_a_row(missed), _in_a_row(guards)])

    @functools.cached_property
    def derivative(self) -> ndarray:
        """Of the residual by y, the event times and the slope, shape (m + k, m + k + 1,
        n).
        """
        by = self._of_images_and_guards
        m = len(self.one.y)
        before = np.roll(by[:m], 1, axis=2)
        missed = self._in_places(before, 1)
        guards = self._in_places(by[m:], 0)

        parts = [missed, guards]
        out = np.concatenate([_rows_of_steps(part) for part in parts])
        of_all = np.arange(len(self.y))
        out[of_all, of_all] -= 1.0
        return out

    def carried(self, rows: ndarray) -> ndarray:
        """Product of rows (i, m + k, n) with the derivatives of what steps lead to, and
        of their guards, by the sections, shape (i, m, n).

        A section acts on the section after it and on its own step's guards alone.
        """
        m = len(self.one.y)
        s = self.steps
        i, unknowns, n = rows.shape
        k = unknowns // s - m
        of_sections = rows[:, : s * m].reshape(i, s, m, n)
        of_guards = rows[:, s * m :].reshape(i, s, k, n)
        after = np.roll(of_sections, -1, axis=1)
        of_step = np.concatenate([after, of_guards], axis=2)

        by = self._of_images_and_guards[:, :m]
        product = matvec(of_step.swapaxes(1, 2)[:, :, None], by)
        return product.swapaxes(1, 2).reshape(i, s * m, n)

    @property
    def _of_images_and_guards(self) -> ndarray:
        """Derivatives of where each step leads, and of its guards, by its own section,
        event times and the slope, shape (m/s + k/s, m/s + k/s + 1, s, n).
        """
        by = self.one.derivative.copy()
        # A step's equation has its own section; in a gait of several that after it
        # takes its place.
        of_one = np.arange(len(self.one.y))
        by[of_one, of_one] += 1.0
        return by

    def _in_places(self, by: ndarray, before: int) -> ndarray:
        """Derivatives of values of every step by all unknowns, shape (s, i, m + k + 1,
        n).

        They are given (i, j, s, n) by the section, event times and slope of the same
        step, or of one step `before`.
        """
        s = self.steps
        m = len(self.one.y)
        n = by.shape[-1]
        i = len(by)
        k = by.shape[1] - 1 - m
        by = by.transpose(2, 0, 1, 3)
        step = np.arange(s)
        sections = np.zeros((s, i, s, m, n))
        sections[step, :, step - before] = by[:, :, :m]
        times = np.zeros((s, i, s, k, n))
        times[step, :, step - before] = by[:, :, m:-1]
        # A step begins with the last strike of the one before.
        times[:, :, :-1, -1] -= times[:, :, 1:].sum(axis=3)

        by_sections = sections.reshape(s, i, s * m, n)
        by_times = times.reshape(s, i, s * k, n)
        return np.concatenate([by_sections, by_times, by[:, :, -1:]], axis=2)

    @functools.cached_property
    def inverse(self) -> ndarray:
        """How far a residual moves the fixed point's y and its event times, shape (m +
        k, m + k, n).
        """
        return -_inverse(self.derivative[:, :-1])

    @functools.cached_property
    def _moved(self) -> ndarray:
        """Newton step of y and the event times, shape (m + k, n)."""
        return -_solution(self.derivative[:, :-1], self.residual)

    @property
    def newton(self) -> ndarray:
        """Newton step of y, shape (m, n)."""
        return self._moved[: len(self.y)]

    @property
    def newton_times(self) -> ndarray:
        """The event times after it, shape (k, n)."""
        return np.asarray(self.guessed + self._moved[len(self.y) :])

    def move_impacts(self) -> None:
        """Correct the states at the impacts to the fixed point."""
        shape = self.steps, len(self.one.y), self.y.shape[1]
        newton = self.newton.reshape(shape).swapaxes(0, 1)
        one = self.one
        one.impact = one.impact + matvec(one.impact_by_y, newton)
        one.knee = one.knee + matvec(one.knee_by_y, newton)


#: What was evaluated of a gait: its step, or its steps.
AnyStride = Stride | Strides


def side_by_side(values: ndarray, steps: int) -> ndarray:
    """Values (s i, n) of steps in a row in lanes (i, s n): the first steps of all
    gaits, then the second ones.
    """
    i = len(values) // steps
    n = values.shape[1]
    of_steps = values.reshape(steps, i, n)
    return of_steps.swapaxes(0, 1).reshape(i, steps * n)


def _in_a_row(values: ndarray) -> ndarray:
    """Values (i, s, n) of every step, those of one after those of the step before: (s
    i, n).
    """
    return _rows_of_steps(values.swapaxes(0, 1))


def _rows_of_steps(values: ndarray) -> ndarray:
    """Values (s, i, ...) of steps, one step after another: (s i, ...), also of no lanes."""
    s, i, *others = values.shape
    return values.reshape(s * i, *others)


#: What bits of columns are multiplied by, before they are added up: an odd number.
_MIXER = np.uint64(0x9E3779B97F4A7C15)


def _distinct(columns: ndarray) -> tuple[ndarray, ndarray]:
    """The first of every distinct column of an array (i, n), in their order, and of
    each column that one's place among these, shape (n,).
    """
    bits = np.ascontiguousarray(columns).view(np.uint64)
    mixed = np.zeros(columns.shape[1], np.uint64)
    for row in bits:
        mixed = (mixed ^ row) * _MIXER
        mixed ^= mixed >> np.uint64(32)

    _, first, place = np.unique(mixed, return_index=True, return_inverse=True)
    if not (bits[:, first[place]] == bits).all():
        # Different columns were mixed to one number.
        every = np.arange(columns.shape[1])
        return every, every

    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return first[order], rank[place]


def _inverse(matrices: ndarray) -> ndarray:
    """Inverses of matrices (i, i, n); NaN where there is none."""
    each = matrices.transpose(2, 0, 1)
    out = np.full(each.shape, np.nan)
    regular = np.isfinite(each).all(axis=(1, 2))
    regular[regular] = np.linalg.det(each[regular]) != 0
    out[regular] = np.linalg.inv(each[regular])
    return out.transpose(1, 2, 0)


def _solution(matrices: ndarray, right: ndarray) -> ndarray:
    """Solutions (i, n) of systems with matrices (i, i, n); NaN where there is none."""
    each = matrices.transpose(2, 0, 1)
    out = np.full(right.T.shape, np.nan)
    regular = np.isfinite(each).all(axis=(1, 2))
    try:
        out[regular] = _solve(each[regular], right.T[regular])
    except np.linalg.LinAlgError:  # one of them is singular to the last digit
        # By its logarithm: the determinant itself may underflow.
        regular[regular] = np.linalg.slogdet(each[regular])[0] != 0
        out[regular] = _solve(each[regular], right.T[regular])
    return out.T


def _solve(matrices: ndarray, right: ndarray) -> ndarray:
    """Solutions (n, i) of systems with matrices (n, i, i)."""
    return np.linalg.solve(matrices, right[..., None])[..., 0]


class StepSequence:
    """The map of s steps in a row of one structure.

    Parameters
    ----------
    single : StrideMap
    steps : int
    """

    def __init__(self, single: StrideMap, steps: int):
        self.single = single
        self.steps = steps
        self.m = steps * single.m
        #: Of the state just after a heelstrike.
        self.start_size = single.start_size

    def start(self, y: ndarray, parameters: ndarray) -> ndarray:
        """What `StrideMap.start` gives of the first section."""
        return self.single.start(y[: self.single.m], parameters)

    def __call__(
        self,
        y: ndarray,
        times: ndarray,
        parameters: ndarray,
        by_drive: bool = False,
        samples: int = 0,
        coarse: bool = False,
    ) -> Strides:
        """Evaluate steps as `StrideMap` does, of sections (m, n) and event times (k, n)
        of all steps.
        """

        def single(y: ndarray, durations: ndarray, parameters: ndarray) -> Stride:
            return self.single(y, durations, parameters, by_drive, samples, coarse)

        return self._of_single(single, y, times, parameters)

    def without_derivatives(
        self, y: ndarray, times: ndarray, parameters: ndarray, samples: int = 0
    ) -> Strides:
        """Evaluate steps as `StrideMap.without_derivatives` does."""

        def single(y: ndarray, durations: ndarray, parameters: ndarray) -> Stride:
            return self.single.without_derivatives(y, durations, parameters, samples)

        return self._of_single(single, y, times, parameters)

    def _of_single(
        self,
        single: Callable[..., Stride],
        y: ndarray,
        times: ndarray,
        parameters: ndarray,
    ) -> Strides:
        """All steps, by what evaluates single ones."""
        s = self.steps
        n = y.shape[1]
        m = self.single.m
        k = len(times) // s
        last_strikes = times[k - 1 : -1 : k]
        begins = np.concatenate([np.zeros((1, n)), last_strikes])
        durations = times - np.repeat(begins, k, axis=0)
        inputs = np.concatenate(
            [
                side_by_side(y, s),
                side_by_side(durations, s),
                np.tile(parameters, s),
            ]
        )

        # Lanes of differences share most of their steps: each is evaluated once.
        lanes = s * n
        first = place = np.arange(lanes)
        if n > 1:
            first, place = _distinct(inputs)
        if len(first) < lanes:
            inputs = inputs[:, first]

        def every(values: ndarray) -> ndarray:
            values = values if len(first) == lanes else values[..., place]
            return values.reshape(*values.shape[:-1], s, n)

        one = single(inputs[:m], inputs[m : m + k], inputs[m + k :]).mapped(every)
        return Strides(one, y, times.copy())


def sections(w: ndarray, m: int, steps: int) -> tuple[ndarray, ndarray]:
    """Take apart similarity coordinates of gaits of several steps.

    Parameters
    ----------
    w : ndarray, shape (m + k, n)
        ln of the first angle, all other section coordinates over it, and event times.
    m, steps : int

    Returns
    -------
    y : ndarray, shape (s, m/s, n)
        Sections over the first angle.
    durations : ndarray, shape (s, k/s, n) [sqrt(leg/g)]
        Of the phases.
    """
    n = w.shape[1]
    phases = len(w) - m
    y = np.vstack([np.ones((1, n)), w[1:m]])
    durations = np.diff(w[m:], axis=0, prepend=0)

    return (
        y.reshape(steps, m // steps, n),
        durations.reshape(steps, phases // steps, n),
    )


def begun_at(w: ndarray, m: int, steps: int, first: ndarray | int) -> ndarray:
    """Similarity coordinates of the same gaits begun at another of their steps.

    Parameters
    ----------
    w : ndarray, shape (m + k, n)
    m, steps : int
    first : ndarray of int, shape (n,), or int
        Number of that step.

    Returns
    -------
    ndarray, shape (m + k, n)
    """
    places = (np.arange(steps)[:, None, None] + first) % steps
    begun = []
    for values in sections(w, m, steps):
        each = np.broadcast_to(places, values.shape)
        begun.append(np.take_along_axis(values, each, axis=0))
    return joined(w[0], *begun)


def joined(
    log_unit: ndarray | float,
    y: ndarray,
    durations: ndarray,
) -> ndarray:
    """Put together what `sections` takes apart, with y over another angle.

    Parameters
    ----------
    log_unit : ndarray, shape (n,), or float
        ln of what y is divided by.
    y, durations : ndarray, shape (s, m/s, n) and (s, k/s, n)

    Returns
    -------
    ndarray, shape (m + k, n)
    """
    angle = y[0, 0]
    others = _rows_of_steps(y)[1:] / angle
    times = np.cumsum(_rows_of_steps(durations), axis=0)
    return np.vstack([log_unit + np.log(angle), others, times])


def distance(a: ndarray, b: ndarray, m: int, steps: int) -> float:
    """Distance of two gaits (m + k,), whichever of their steps are the first."""
    begun = a[:, None]
    if steps > 1:
        every = np.repeat(begun, steps, axis=1)
        begun = begun_at(every, m, steps, np.arange(steps))
    apart = np.abs(begun - b[:, None])
    return float(apart.max(axis=0).min())


def distances_of_steps(w: ndarray, m: int, steps: int) -> ndarray:
    """How far gaits are from repeating after fewer steps.

    Parameters
    ----------
    w : ndarray, shape (m + k, n)
    m, steps : int

    Returns
    -------
    ndarray, shape (divisors, n)
        For each number of steps that divides all of them the largest distance of
        sections, over the first angle.
    """
    y, _ = sections(w, m, steps)
    sooner = [k for k in range(1, steps) if steps % k == 0]
    distances = np.zeros((len(sooner), w.shape[1]))
    for row, k in zip(distances, sooner, strict=True):
        missed = np.abs(y - np.roll(y, k, axis=0))
        row[:] = missed.max(axis=(0, 1))
    return distances


def from_largest(w: ndarray, m: int, steps: int) -> ndarray:
    """Similarity coordinates (m + k, n) of the same gaits begun at the step with the
    largest stance angle.
    """
    if steps == 1:
        return w
    y, _ = sections(w, m, steps)
    return begun_at(w, m, steps, y[:, 0].argmax(axis=0))
