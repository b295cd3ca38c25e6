"""The equations of a gait, linearised.

Its unknowns are one vector, Z: similarity coordinates w, which are ln angle,
rates/angle and event times, then q = ln slope. In shapes, n counts lanes, m section
coordinates, k event times, and c = m + k + 1 is the length of Z.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from gaitsweep.tasks.gaits.multipliers import multipliers
from gaitsweep.tasks.mechanics.arrays import Coordinates
from gaitsweep.tasks.mechanics.sums import matvec
from gaitsweep.tasks.step.problem import EPS, Problem
from gaitsweep.tasks.step.several_steps import AnyStride


@dataclass
class Evaluation:
    """Steps at n points, and to first order the joint equations of state and event
    times there.

    Attributes
    ----------
    Z : ndarray, shape (c, n)
    stride : Stride or Strides
        Differentiated by the slope too.
    problem : Problem
        Of one walker, or of n lanes.
    """

    Z: Coordinates
    stride: AnyStride
    problem: Problem

    @property
    def m(self) -> int:
        """Number of section coordinates."""
        return len(self.stride.y)

    @property
    def w(self) -> ndarray:
        """Similarity coordinates and event times, shape (m + k, n)."""
        return self.Z[:-1]

    @property
    def q(self) -> ndarray:
        """Values of ln slope, shape (n,)."""
        return self.Z[-1]

    @property
    def times(self) -> ndarray:
        """Event times, shape (k, n) [sqrt(leg/g)]."""
        return self.Z[self.m : -1]

    @property
    def residual(self) -> ndarray:
        """Residual of the joint equations over the stance angle, shape (m + k, n)."""
        return np.asarray(self.stride.residual / self.stride.y[0])

    @functools.cached_property
    def derivative(self) -> ndarray:
        """Its derivative by Z, shape (m + k, c, n)."""
        m = self.m
        y = self.stride.y
        derivative = self.stride.derivative
        by_Z = derivative / y[0]
        by_Z[:, 0] = matvec(by_Z[:, :m], y)
        by_Z[:, 1:m] = derivative[:, 1:m]
        by_Z[:, -1] *= np.exp(self.q)
        return by_Z

    @property
    def jacobians(self) -> ndarray:
        """Jacobians of all steps of a gait, shape (n, d, d)."""
        return np.moveaxis(self.stride.jacobian, -1, 0)

    @property
    def multipliers(self) -> ndarray:
        """Multipliers, largest magnitude first, shape (n, d); NaN where there are none."""
        return multipliers(self.stride.jacobian, len(self.stride.jacobian))


# Where heelstrike is tangential to the last digit the map has no derivative.
@np.errstate(invalid="ignore", over="ignore", divide="ignore")
def evaluate(problem: Problem, Z: Coordinates, samples: int = 0) -> Evaluation:
    """Evaluate the steps at points Z (c, n), with `samples` of their motion as
    `Problem.stride` takes them.
    """
    stride, _ = problem.stride(Z[:-1], Z[-1], by_drive=True, samples=samples)
    return Evaluation(Z, stride, problem)


@np.errstate(invalid="ignore", over="ignore", divide="ignore")
def evaluate_values(problem: Problem, Z: Coordinates, samples: int = 0) -> Evaluation:
    """Evaluate steps as `evaluate` does, but for their derivatives, which are NaN."""
    return Evaluation(Z, problem.without_derivatives(Z[:-1], Z[-1], samples), problem)


def determinants(matrices: ndarray) -> ndarray:
    """Return determinants.

    Parameters
    ----------
    matrices : ndarray, shape (n, i, i)

    Returns
    -------
    ndarray, shape (n,)
        NaN where a matrix is not finite.
    """
    finite = np.isfinite(matrices).all(axis=(1, 2))
    out = np.full(len(matrices), np.nan)
    out[finite] = np.linalg.det(matrices[finite])
    return out


def rounding_step(matrix: ndarray, at: Evaluation) -> ndarray:
    """Size of a bordered Newton step, event times apart, that rounding alone makes.

    Parameters
    ----------
    matrix : ndarray, shape (n, c, c)
        Of the joint equations, and the border.
    at : Evaluation

    Returns
    -------
    ndarray, shape (n,)
    """
    m = at.m
    y = np.abs(at.stride.y) / at.stride.y[0]
    inverse = np.linalg.inv(matrix)[:, but_times(m)].transpose(1, 2, 0)
    of_others = np.ones((matrix.shape[1] - m, y.shape[1]))
    error = matvec(np.abs(inverse), np.vstack([y, of_others]))

    # Rounding of the start, carried through the step; the inverse takes back most of
    # what the step amplifies.
    taken_back = at.stride.carried(inverse[:, :-1])
    error = error + matvec(np.abs(taken_back), y)
    return np.asarray(6 * EPS * np.nan_to_num(error).max(axis=0))


def but_times(m: int) -> list[int]:
    """Return the places in Z of all but the event times, of which Newton's method asks
    only that they are the guards'.

    Parameters
    ----------
    m : int
        Number of section coordinates.
    """
    return [*range(m), -1]
