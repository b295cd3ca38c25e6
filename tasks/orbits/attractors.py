"""Attractors: the gait that captures an orbit, the period with which it repeats, or
neither.
"""

from __future__ import annotations

import copy
import itertools
from collections.abc import Mapping

import numpy as np
from numpy import ndarray

from gaitsweep.tasks.mechanics.sums import matvec, norm
from gaitsweep.tasks.orbits.walk import Walk, change
from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.step.simulate import CAUSES, STRUCK, SimulatedSteps, stride

#: Longest period identified, and the name of an orbit with none up to it.
LONGEST_PERIOD, WALKS_ON = 32, "walks on"
#: What an orbit is called that repeats after 1, 2, … steps.
_PERIODS = np.array([f"period {p}" for p in range(1, LONGEST_PERIOD + 1)])
#: Relative change after a period up to which an orbit no longer changes, and up to
#: which it repeats if it changes so little after twice the period too.
_AT_REST, _REPEATS = 1e-11, 1e-5
#: Largest distance at which a stable gait captures orbits, in coordinates along its
#: eigenvectors and over its norm; how much larger than measured the curvature of the
#: step map may be; and least volume of the eigenvectors, which have length one, of a
#: gait that captures any.
_NEAR, _SAFETY, _MIN_VOLUME = 1e-4, 8.0, 1e-8


class Neighbourhoods:
    """Where orbits surely converge to their gaits.

    In coordinates c along the eigenvectors of the step map's derivative at a gait, a
    step takes c to something no larger than r |c| + k |c|^2, with the spectral radius
    r, the curvature k, and |c| the largest coordinate. So it shortens all |c| below (1
    - r)/k; half of that distance is taken. The curvature is measured at the sums of
    eigenvectors, which determine a quadratic map. Unstable gaits, and gaits with hardly
    independent eigenvectors, have no neighbourhood.

    Parameters
    ----------
    problem : Problem
        Of n lanes.
    y : ndarray, shape (m, n) [rad, rad/sqrt(leg/g)]
        Section coordinates of gaits.
    slope : ndarray, shape (n,) [rad]
    """

    def __init__(self, problem: Problem, y: ndarray, slope: ndarray):
        m, n = y.shape
        self.y = y
        self.radius = np.zeros(n)
        self._coordinates = np.full((m, m, n), np.nan, complex)

        at = stride(problem, y, slope)
        lanes, values, vectors = _capturing(at)
        size = norm(y[:, lanes])
        vectors = vectors * size[:, None, None]
        inverse = np.linalg.inv(vectors)
        self._coordinates[:, :, lanes] = np.moveaxis(inverse, 0, -1)
        off = _sums_of_eigenvectors(values, vectors)
        curvature = self._curvature(problem, at, slope, lanes, off)

        radius = np.abs(values).max(axis=1)
        shortened = 0.5 * (1 - radius) / (_SAFETY * curvature)
        self.radius[lanes] = np.minimum(np.nan_to_num(shortened), _NEAR)

    def _curvature(
        self,
        problem: Problem,
        at: SimulatedSteps,
        slope: ndarray,
        lanes: ndarray,
        off: ndarray,
    ) -> ndarray:
        """Curvature of the step map at the gaits of some lanes (k,): the largest over
        deviations from each, shape (m, k, deviations), by the step `at` it.
        """
        m, k, count = off.shape
        off = off.reshape(m, -1)
        each = np.repeat(lanes, count)
        start = self.y[:, each] + off
        moved = stride(problem.some(each), start, slope[each], exact=False)

        linear = matvec(at.jacobian[:, :, each], off)
        rest = moved.image - at.image[:, each] - linear
        ratio = self._size(rest, each) / self._size(off, each) ** 2
        largest = ratio.reshape(k, count).max(axis=1)
        return np.asarray(largest)

    def some(self, lanes: ndarray) -> Neighbourhoods:
        """Return those of some lanes (k,)."""
        some = copy.copy(self)
        some.y = self.y[:, lanes]
        some.radius = self.radius[lanes]
        some._coordinates = self._coordinates[:, :, lanes]
        return some

    def hold(self, y: ndarray, lanes: ndarray) -> ndarray:
        """Whether states (m, k) of some lanes (k,) lie in them."""
        return self._distance(y, lanes) < self.radius[lanes]

    def lie_near(self, y: ndarray, lanes: ndarray) -> ndarray:
        """Whether states (m, k) of some lanes (k,) lie as near to stable gaits as any
        neighbourhood extends.
        """
        return self._distance(y, lanes) < _NEAR

    def _distance(self, y: ndarray, lanes: ndarray) -> ndarray:
        return self._size(y - self.y[:, lanes], lanes)

    def _size(self, off: ndarray, lanes: ndarray) -> ndarray:
        """Largest coordinate of deviations (m, k) along the eigenvectors of some lanes
        (k,).
        """
        along = matvec(self._coordinates[:, :, lanes], off)
        return np.asarray(np.abs(along).max(axis=0))


def _capturing(at: SimulatedSteps) -> tuple[ndarray, ndarray, ndarray]:
    """Gaits that capture orbits, by a step at each.

    Returns
    -------
    lanes : ndarray of int, shape (k,)
    values, vectors : ndarray, shape (k, m) and (k, m, m)
        Eigenvalues and eigenvectors of the step map's derivative.
    """
    lanes = np.flatnonzero(at.outcome == STRUCK)
    jacobian = at.jacobian[:, :, lanes]
    values, vectors = np.linalg.eig(np.moveaxis(jacobian, -1, 0))
    radius = np.abs(values).max(axis=1)
    volume = np.abs(np.linalg.det(vectors))
    captures = (radius < 1) & (volume > _MIN_VOLUME)
    return lanes[captures], values[captures], vectors[captures]


def _sums_of_eigenvectors(values: ndarray, vectors: ndarray) -> ndarray:
    """Deviations along the sums of some of the eigenvectors, shape (m, k, 2^m - 1), from
    eigenvalues (k, m) and eigenvectors (k, m, m).
    """
    m = values.shape[1]
    # Real and imaginary part stand for the vectors of a pair.
    is_upper = values.imag[:, None] >= 0
    real = np.where(is_upper, vectors.real, vectors.imag)
    subsets = list(itertools.product((0, 1), repeat=m))
    weights = np.array(subsets[1:]).T
    columns = real.transpose(1, 2, 0)
    sums = matvec(columns[:, :, None], weights[..., None])
    return np.asarray(_NEAR * sums.swapaxes(1, 2))


def attractors(
    walk: Walk,
    homes: Mapping[str, Neighbourhoods],
    steps: int,
) -> ndarray:
    """Find the attractor of each orbit.

    Parameters
    ----------
    walk : Walk
        Of n walkers at their initial states.
    homes : mapping
        Neighbourhoods of gaits by name, one gait for each walker.
    steps : int
        Steps after which the period of an orbit that still changes is told, from the
        steps that follow.

    Returns
    -------
    ndarray of str, shape (n,)
        A name of `homes`, `period k` with k up to LONGEST_PERIOD, WALKS_ON for all that
        repeats less often, or how the walker fell.
    """
    found = np.full(walk.y.shape[1], WALKS_ON, "U24")
    repetition = _Repetition(walk, steps)
    for taken in walk.steps(steps + 2 * LONGEST_PERIOD):
        lanes = walk.lanes
        known = repetition.is_known(taken)
        repeating = lanes[known]
        periods = repetition.period[repeating]
        found[repeating] = _PERIODS[periods - 1]

        for name, home in homes.items():
            held = home.hold(walk.y[:, lanes], lanes)
            found[lanes[held]] = name
            known |= held

        walk.lanes = lanes[~known]
        repetition.renew(taken)

    # Beside a flip a neighbourhood may be too small to hold what settles there.
    for name, home in homes.items():
        single = np.flatnonzero(found == _PERIODS[0])
        is_near = home.lie_near(walk.y[:, single], single)
        found[single[is_near]] = name

    fell = walk.outcome != STRUCK
    causes = np.array(CAUSES)
    found[fell] = causes[walk.outcome[fell]]
    return found


class _Repetition:
    """With which period orbits repeat a state, which is seen anew after every
    LONGEST_PERIOD steps.

    Attributes
    ----------
    period : ndarray of int, shape (n,)
        Steps after which each first came near its state again; 0 where it has not.
    """

    def __init__(self, walk: Walk, steps: int):
        self._walk = walk
        self._steps = steps
        self._see(0)

    def _see(self, taken: int) -> None:
        """Take the states after so many steps for those to come near again."""
        self._seen = self._walk.y.copy()
        self._seen_at = taken
        self.period = np.zeros(self._seen.shape[1], int)

    def is_known(self, taken: int) -> ndarray:
        """Whether the period of those that walk on is known, shape (k,)."""
        lanes = self._walk.lanes
        elapsed = taken - self._seen_at
        moved = change(self._seen[:, lanes], self._walk.y[:, lanes])
        if elapsed <= LONGEST_PERIOD:
            # Beside a flip an orbit alternates while it settles: after twice its period
            # it is at rest much sooner.
            is_first = self.period[lanes] == 0
            comes_near = (moved < _REPEATS) & is_first
            self.period[lanes[comes_near]] = elapsed

        period = self.period[lanes]
        is_twice = elapsed == 2 * period
        is_at_rest = moved < _AT_REST
        repeats = (moved < _REPEATS) & is_twice
        if taken <= self._steps:
            repeats[:] = False
        return (period > 0) & (repeats | is_at_rest)

    def renew(self, taken: int) -> None:
        """See the states anew, if it is time for that; a last time after all steps
        before the period is told of orbits that still change.
        """
        is_due = taken - self._seen_at == LONGEST_PERIOD
        is_before = taken < self._steps
        is_last = taken == self._steps
        if is_last or (is_before and is_due):
            self._see(taken)
