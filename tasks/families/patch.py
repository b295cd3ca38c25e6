"""A patch: charts that predict the gaits on one piece of a family's branches, and whether gaits are those predicted."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tasks.families.box import roots
from tasks.families.chart import Chart
from tasks.families.span import Span
from tasks.fixed_points.newton import curvature
from tasks.fixed_points.polish import UNKNOWN, Guesses, Polished
from tasks.fixed_points.rounding import rounding_std
from tasks.step.problem import Problem
from tasks.step.several_steps import AnyStride

#: How far Newton's method may move a prediction, in units of the largest error that was measured.
PREDICTED_WITHIN = 8.0
#: By how much the Lipschitz constant may exceed that at the nearest places where it was measured.
_LIPSCHITZ_SAFETY = 4.0


def side_of_fold(stride: AnyStride) -> np.ndarray:
    """Return a sign that changes where gaits pass a fold: that of the determinant of the equations' derivative.

    Parameters
    ----------
    stride : Stride
        Of n lanes.

    Returns
    -------
    ndarray, shape (n,)
        0 where the derivative is singular or not finite.
    """
    with np.errstate(invalid="ignore"):
        return np.asarray(np.sign(np.linalg.det(np.nan_to_num(stride.inverse).transpose(2, 0, 1))))


@dataclass(frozen=True)
class Patch:
    """The gaits on one piece of a family's branches, in a box of keys and a range of slopes.

    Attributes
    ----------
    lines, numbers : ndarray, shape (l, d) and (l, 2)
        Coordinates of keys of surveyed lines, and on each the numbers of the branch and of the piece on it.
    span : Span
        The piece, or the part of it at which it is cut.
    events : (bool, bool)
        Whether it ends at an event, whose slope depends on the keys; elsewhere it is cut.
    end_errors : ndarray, shape (2,)
        Errors of the span's ends.
    gaits : Chart
        Of the gaits in similarity coordinates; its error is the largest correction that was measured.
    measured : tuple of ndarray
        What `measured` gives at `roots(p)` along the piece.
    side : float
        Of `side_of_fold`, the same on the whole piece.
    """

    lines: np.ndarray
    numbers: np.ndarray
    span: Span
    events: tuple[bool, bool]
    end_errors: np.ndarray
    gaits: Chart
    measured: tuple[np.ndarray, np.ndarray, np.ndarray]
    side: float

    def numbers_at(self, unit: np.ndarray) -> np.ndarray:
        """Return the numbers of branch and piece (n, 2) on the surveyed line nearest to coordinates of keys (n, d)."""
        return self.numbers[np.abs(unit[:, None] - self.lines).max(axis=2).argmin(axis=1)]

    def guesses(self, unit: np.ndarray, slope: np.ndarray) -> Guesses:
        """Predict gaits.

        Parameters
        ----------
        unit : ndarray, shape (n, d)
            Coordinates of keys.
        slope : ndarray, shape (n,) [rad]
        """
        points, (lipschitz, gradient, std) = self.span.points(np.log(slope), unit), self.measured
        last = len(lipschitz) - 1
        node = np.abs(points[:, :1] - roots(last + 1)).argmin(axis=1)
        around = [np.clip(node + i, 0, last) for i in (-1, 0, 1)]
        lipschitz = _LIPSCHITZ_SAFETY * np.max([lipschitz[k] for k in around], axis=0)
        std = np.max([std[:, k] for k in around], axis=0)
        return Guesses(self.gaits(points), slope, lipschitz, gradient[..., node], std, np.full(len(slope), UNKNOWN))


def measured(problem: Problem, w: np.ndarray, q: np.ndarray, each: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Measure what the error bounds of gaits need, for groups of gaits.

    Parameters
    ----------
    problem : Problem
        Of n lanes, or of one walker.
    w : ndarray, shape (m + k, n)
        Gaits in similarity coordinates.
    q : ndarray, shape (n,)
        Their ln slopes.
    each : int
        Gaits of a group, which follow one another.

    Returns
    -------
    lipschitz, gradient, rounding_std : ndarray, shape (g,), (m, m + k, g) and (o + m, g)
        The largest Lipschitz estimate of each group, its mean gradient and the root of its mean variance of rounding,
        as `Guesses` has them.
    """
    lipschitz, gradient = curvature(problem, np.vstack([w[: problem.m], q]), w[problem.m :])
    variance = rounding_std(problem, w, q) ** 2
    gradient, variance = (values.reshape(*values.shape[:-1], -1, each).mean(axis=-1) for values in (gradient, variance))
    return lipschitz.reshape(-1, each).max(axis=1), gradient, np.sqrt(variance)


def similarity(at: Polished) -> np.ndarray:
    """Similarity coordinates of gaits.

    Parameters
    ----------
    at : Polished
        Of n lanes.

    Returns
    -------
    ndarray, shape (m + k, n)
    """
    return np.vstack([np.log(at.y[:1] * at.scale), at.y[1:] / at.y[0], at.times])


def are_predicted(at: Polished, guesses: Guesses, error: np.ndarray | float, side: np.ndarray | float) -> np.ndarray:
    """Whether gaits are converged steps as near their predictions as they should be, on the right side of a fold.

    Parameters
    ----------
    at : Polished
        Of n lanes.
    guesses : Guesses
    error, side : ndarray, shape (n,), or float
        Those of the gaits' patches.

    Returns
    -------
    ndarray of bool, shape (n,)
    """
    with np.errstate(invalid="ignore"):
        moved = np.abs(similarity(at) - guesses.w).max(axis=0)
    fine = at.converged & at.step & (moved < PREDICTED_WITHIN * error)
    return np.asarray(fine & (side_of_fold(at.stride) == side))
