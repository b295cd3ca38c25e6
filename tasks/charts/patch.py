"""A patch: charts that predict the gaits on one piece of a family's branches, and
whether gaits are those predicted.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np

from gaitsweep.tasks.charts.box import roots
from gaitsweep.tasks.charts.chart import Chart
from gaitsweep.tasks.charts.span import Span
from gaitsweep.tasks.gaits.newton import curvature
from gaitsweep.tasks.gaits.polish import UNKNOWN, Guesses, Polished
from gaitsweep.tasks.gaits.rounding import rounding_std
from gaitsweep.tasks.mechanics.sums import total
from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.step.several_steps import AnyStride

#: How far Newton's method may move a prediction, in units of the largest error that was
#: measured.
PREDICTED_WITHIN = 8.0
#: By how much the Lipschitz constant may exceed that at the nearest places where it was
#: measured.
_LIPSCHITZ_SAFETY = 4.0


#: What error bounds need of groups of gaits, as `measured` returns it.
Measured = tuple[np.ndarray, np.ndarray, np.ndarray]


def side_of_fold(stride: AnyStride) -> np.ndarray:
    """Return a sign that changes where gaits pass a fold: that of the determinant of
    the equations' derivative.

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
        matrices = np.nan_to_num(stride.inverse).transpose(2, 0, 1)
        return np.asarray(np.sign(np.linalg.det(matrices)))


@dataclass(frozen=True)
class Patch:
    """The gaits on one piece of a family's branches, in a box of keys and a range of
    slopes.

    Attributes
    ----------
    lines, numbers : ndarray, shape (l, d) and (l, 2)
        Coordinates of keys of surveyed lines, and on each the numbers of the branch and
        of the piece on it.
    span : Span
        The piece, or the part of it at which it is cut.
    kinds : (str, str)
        Of which kind its ends are: `cut`, `fold`, `end` or `beyond`, as
        `tasks.charts.patch_ends` has them.
    end_errors, reach : ndarray, shape (2,)
        Errors of folds and located ends, and how far before an end beyond walking that
        may be, in ln slope.
    gaits : Chart
        Of the gaits in similarity coordinates; its error is the largest correction that
        was measured.
    measured : tuple of ndarray
        What `measured` gives at `roots(p)` along the piece.
    side : float
        Of `side_of_fold`, the same on the whole piece.
    """

    lines: np.ndarray
    numbers: np.ndarray
    span: Span
    kinds: tuple[str, str]
    end_errors: np.ndarray
    reach: np.ndarray
    gaits: Chart
    measured: Measured
    side: float

    @property
    def inside(self) -> Span:
        """The part of the span in which all gaits are steps."""
        if not self.reach.any():
            return self.span

        d = len(self.span.ends.sizes)
        keys = np.array(list(itertools.product((-1.0, 0.0, 1.0), repeat=d)))
        low, high = self.span.ends(keys)
        q = np.concatenate([low + self.reach[0], high - self.reach[1]])
        inner = self.span.points(q, np.vstack([keys, keys]))
        low, high = np.split(0.5 * (1 + inner[:, 0]), 2)
        return replace(self.span, part=(float(low.max()), float(high.min())))

    def numbers_at(self, unit: np.ndarray) -> np.ndarray:
        """Return the numbers of branch and piece (n, 2) on the surveyed line nearest to
        coordinates of keys (n, d).
        """
        distance = np.abs(unit[:, None] - self.lines).max(axis=2)
        return self.numbers[distance.argmin(axis=1)]

    def guesses(self, unit: np.ndarray, slope: np.ndarray) -> Guesses:
        """Predict gaits.

        Parameters
        ----------
        unit : ndarray, shape (n, d)
            Coordinates of keys.
        slope : ndarray, shape (n,) [rad]
        """
        points = self.span.points(np.log(slope), unit)
        lipschitz, gradient, std = self.measured
        last = len(lipschitz) - 1
        node = np.abs(points[:, :1] - roots(last + 1)).argmin(axis=1)
        around = [np.clip(node + i, 0, last) for i in (-1, 0, 1)]
        largest = np.max([lipschitz[k] for k in around], axis=0)

        return Guesses(
            w=self.gaits(points),
            slope=slope,
            lipschitz=_LIPSCHITZ_SAFETY * largest,
            gradient=gradient[..., node],
            rounding_std=np.max([std[:, k] for k in around], axis=0),
            leg_passes=np.full(len(slope), UNKNOWN),
        )

    def judge(
        self,
        at: Polished,
        w: np.ndarray,
        q: np.ndarray,
        unit: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return which gaits are as predicted (steps, or none near an end of walking),
        and which are steps.

        Parameters
        ----------
        at : Polished
            Of n lanes.
        w : ndarray, shape (m + k, n)
            Predictions.
        q : ndarray, shape (n,)
            Ln slopes.
        unit : ndarray, shape (n, d)
            Coordinates of keys.

        Returns
        -------
        fine, is_step : ndarray of bool, shape (n,)
        """
        error = self.gaits.error / self.span.distance(self.span.points(q, unit))
        off = np.abs(self.span.ends(unit) - q)
        may_end = (off < self.reach[:, None]).any(axis=0)
        return near_predictions(at, w, error, self.side) & (at.step | may_end), at.step


def measured(
    problem: Problem,
    w: np.ndarray,
    q: np.ndarray,
    group: int,
) -> Measured:
    """Measure what the error bounds of gaits need, for groups of gaits.

    Parameters
    ----------
    problem : Problem
        Of n lanes, or of one walker.
    w : ndarray, shape (m + k, n)
        Gaits in similarity coordinates.
    q : ndarray, shape (n,)
        Their ln slopes.
    group : int
        Gaits of a group, which follow one another.

    Returns
    -------
    lipschitz, gradient, rounding_std : ndarray, shape (g,), (m, m + k, g) and (o + m, g)
        The largest Lipschitz estimate of each group, its mean gradient and the root of
        its mean variance of rounding, as `Guesses` has them.
    """
    lipschitz, gradient = curvature(problem, w, q)
    variance = rounding_std(problem, w, q) ** 2

    def mean(values: np.ndarray) -> np.ndarray:
        return np.asarray(total(values[..., k::group] for k in range(group)) / group)

    largest = lipschitz.reshape(-1, group).max(axis=1)
    return largest, mean(gradient), np.sqrt(mean(variance))


def near_predictions(
    at: Polished,
    w: np.ndarray,
    error: np.ndarray | float,
    side: float,
) -> np.ndarray:
    """Whether gaits converged as near their predictions as they should, on the right
    side of a fold.

    Parameters
    ----------
    at : Polished
        Of n lanes.
    w : ndarray, shape (m + k, n)
        The predictions.
    error : ndarray, shape (n,), or float
        Of these, as measured elsewhere.
    side : float
        That of the gaits' patch.

    Returns
    -------
    ndarray of bool, shape (n,)
    """
    with np.errstate(invalid="ignore"):
        moved = np.abs(at.w - w).max(axis=0)
    near = at.converged & (moved < PREDICTED_WITHIN * error)
    return np.asarray(near & (side_of_fold(at.stride) == side))
