"""Special points as functions of keys: polynomials that predict a point, and the rows
that polish it in one step.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gaitsweep.tasks.branches.conditions import (
    CONDITIONS,
    Condition,
    foot_radius,
    log_froude_by_Z,
)
from gaitsweep.tasks.branches.equations import Equations, newton_step
from gaitsweep.tasks.branches.extremes import Points, classify
from gaitsweep.tasks.branches.pseudo_arclength import Point
from gaitsweep.tasks.charts.chart import Chart
from gaitsweep.tasks.gaits.step_check import verify_steps
from gaitsweep.tasks.mechanics.sums import total
from gaitsweep.tasks.step.lanes import lanes_of, replace_lanes
from gaitsweep.tasks.step.problem import Lanes
from gaitsweep.tasks.step.step_map import SAMPLES

#: Factor by which a point may lie farther from its prediction, and err more, than those
#: drawn.
_SAFETY = 8.0
#: Distance from a prediction that is near, however well those drawn were predicted:
#: what a step leaves is counted by its own length.
_NEAR = 1e-6
#: Error above which a further Newton step is taken, the most of these, and how many show
#: by how much they shrink.
_GOAL = 1e-10
_FURTHER, _TO_BE_SURE = 3, 2
_TINY = np.finfo(float).tiny
#: Distance from an end at which its gaits must be steps.
_INSIDE = 1e-3
#: Share of the way to a turn within which designs are surveyed, the smallest that
#: counts, and that by which rounding puts designs on the border of a box beyond it.
_AT_TURN = 1e-5
_MIN_SHARE = 1e-12
_BORDER = 1e-12


@dataclass(frozen=True)
class Region:
    """The part of a box that a manifold covers: up to a curve along one key, or all of
    it.

    Attributes
    ----------
    axis : int
        The key along which it ends.
    side : int
        1 if it ends towards higher values, else -1.
    curve : Chart
        The coordinate at which it ends over that of the other key, if there is one.
    turns : bool
        Whether two sheets meet there: beside it points depend on the root of the
        distance.
    powers : tuple of float
        Where steps vanish there: the powers of the root of the distance with which the
        exponentials of the coordinates of a point grow, and after them that of the
        derivatives of its scalar.
    """

    axis: int
    side: int
    curve: Chart
    turns: bool = False
    powers: tuple[float, ...] = ()

    @classmethod
    def whole(cls, d: int) -> Region:
        """Return the whole of a box of d keys: it ends at the border."""
        return cls(0, 1, Chart((1,) * (d - 1), np.ones((1, 1))))

    @property
    def is_root(self) -> bool:
        """Whether points depend on the root of the distance."""
        return self.turns or bool(self.powers)

    def at(self, unit: np.ndarray) -> np.ndarray:
        """Return the coordinates (n,) at which the manifold ends beside designs (n, d)."""
        return np.asarray(self.curve(np.delete(unit, self.axis, axis=1))[0])

    def share(self, unit: np.ndarray) -> np.ndarray:
        """Return the share (n,) of the way from the box's own border to the curve at
        designs (n, d).
        """
        return np.asarray(
            (1 + self.side * unit[:, self.axis]) / (1 + self.side * self.at(unit))
        )

    def smooth(self, unit: np.ndarray) -> np.ndarray:
        """Return coordinates (n, d) that run from -1 to 1 over the manifold, in which
        it is smooth.
        """
        smooth = unit.copy()
        share = self.share(unit)
        if self.is_root:
            share = 1 - np.sqrt(np.maximum(1 - share, 0.0))
        smooth[:, self.axis] = self.side * (2 * share - 1)
        return smooth

    def unit(self, smooth: np.ndarray) -> np.ndarray:
        """Return coordinates of keys (n, d), the inverse of `smooth`."""
        unit = smooth.copy()
        share = 0.5 * (1 + self.side * smooth[:, self.axis])
        if self.is_root:
            share = 1 - (1 - share) ** 2
        width = 1 + self.side * self.at(smooth)
        unit[:, self.axis] = self.side * (share * width - 1)
        return unit

    def growth(self, unit: np.ndarray) -> tuple[np.ndarray | float, np.ndarray | float]:
        """Return what is known of points where steps vanish at the curve; elsewhere 0
        and 1.

        Parameters
        ----------
        unit : ndarray, shape (n, d)
            Coordinates of keys.

        Returns
        -------
        Z : ndarray, shape (c, n), or float
            To be added to the smooth part of the points.
        factor : ndarray, shape (n,), or float
            Multiplies the smooth part of the derivatives of the scalar.
        """
        if not self.powers:
            return 0.0, 1.0
        log_root = 0.5 * np.log(np.maximum(1 - self.share(unit), _MIN_SHARE))
        return np.multiply.outer(np.array(self.powers[:-1]), log_root), np.exp(
            self.powers[-1] * log_root
        )

    def predict(self, chart: Chart, unit: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return points and the derivatives of their scalar, (c, n) each, of a chart
        over it at designs (n, d).
        """
        Z, rows = np.split(chart(self.smooth(unit)), 2)
        growth, factor = self.growth(unit)
        return Z + growth, rows * factor

    def holds(self, unit: np.ndarray) -> np.ndarray:
        """Return whether designs (n, d) have a point of the manifold, bool (n,)."""
        return np.asarray(self.share(unit) <= 1 + _BORDER)

    def is_near(self, unit: np.ndarray) -> np.ndarray:
        """Return whether designs (n, d) lie too near a curve where two sheets meet, or
        steps vanish, bool (n,).
        """
        return np.asarray((np.abs(self.share(unit) - 1) < _AT_TURN) & self.is_root)


@dataclass(frozen=True)
class Manifold:
    """Special points of one kind in a box of keys.

    Attributes
    ----------
    kind : str
    target : float
        The value that the scalar of the kind's condition has.
    region : Region
    chart : Chart
        Of Z and of the derivatives of the kind's scalar (2 c values); its error is the
        largest Newton step from predictions at random points.
    linear, quadratic : float
        Largest error after a Newton step, over the step and over its square.
    """

    kind: str
    target: float
    region: Region
    chart: Chart
    linear: float
    quadratic: float

    def predict(self, unit: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Predict points and the derivatives of their scalar.

        Parameters
        ----------
        unit : ndarray, shape (n, d)
            Coordinates of keys.

        Returns
        -------
        Z, rows : ndarray, shape (c, n)
        """
        return self.region.predict(self.chart, unit)

    def polish(
        self, problem: Lanes, Z: np.ndarray, rows: np.ndarray
    ) -> tuple[Points, np.ndarray]:
        """Solve the points of designs from their predictions, by a Newton step, or more
        where one does not do.

        Parameters
        ----------
        problem : Lanes
            Of n lanes.
        Z, rows : ndarray, shape (c, n)
            As `predict` has them.

        Returns
        -------
        points : Points
        near : ndarray of bool, shape (n,)
            Whether they are as near their predictions as they should be.
        """
        condition = CONDITIONS[self.kind].equal_to(self.target)
        equations = Equations(problem, [condition])
        step = newton_step(equations, Z, rows, _samples(condition))
        near = step.last_step <= max(_SAFETY * self.chart.error, _NEAR)
        error = self._further(equations, step, rows, near, _samples(condition))
        walks = _walks(problem, condition, step, near)
        points = classify(
            self.kind, step.at, np.arange(Z.shape[1]), step.Z, rows, error, walks
        )
        # Where the speed grows towards the other side of the point, it has a maximum
        # before it.
        points.faster = (
            total(log_froude_by_Z(Z, foot_radius(problem)) * step.direction) > 0
        )
        return points, near

    def _further(
        self,
        equations: Equations,
        step: Point,
        rows: np.ndarray,
        near: np.ndarray,
        samples: int,
    ) -> np.ndarray:
        """Take further Newton steps, in place, at points that are near and err too much,
        or lie farther from their predictions than those at which errors were measured;
        return the errors of all, (n,).
        """
        size = step.last_step.copy()
        left = self._error(size)
        rounding = step.rounding.copy()
        shrinks = np.zeros(len(size))
        is_far = size > _SAFETY * self.chart.error
        for number in range(_FURTHER):
            # One step may shrink by chance: the first goes mostly across the branch.
            is_wanted = (left > _GOAL) | (is_far & (number < _TO_BE_SURE))
            again = np.flatnonzero(near & is_wanted)
            if not len(again):
                break

            Z = step.Z[:, again]
            some = equations.some(again)
            further = newton_step(some, Z, rows[:, again], samples)
            step.Z[:, again] = further.Z
            replace_lanes(step.at, again, further.at)

            # How slowly steps shrink shows what the last one leaves.
            last = further.last_step
            by = last / np.maximum(size[again], _TINY)
            by = np.maximum(shrinks[again], by)
            left[again] = np.maximum(self._error(last), _SAFETY * by * last)
            rounding[again] = further.rounding
            shrinks[again], size[again] = by, last

        return left + rounding

    def _error(self, size: np.ndarray) -> np.ndarray:
        """Error after a Newton step of some size."""
        return np.asarray(_SAFETY * (self.linear * size + self.quadratic * size**2))


def _samples(condition: Condition) -> int:
    """Intervals of a motion that tell whether it is a step; none where the gaits before
    it tell.
    """
    return 0 if condition.walking else SAMPLES


def _walks(
    problem: Lanes,
    condition: Condition,
    step: Point,
    near: np.ndarray,
) -> np.ndarray:
    """Whether special points are steps whose legs pass once, or, of an end, the gaits
    just before it.
    """
    walks = np.zeros(len(near), bool)
    lanes = np.flatnonzero(near)
    if not len(lanes):
        return walks

    Z = step.at.Z[:, lanes]
    stride = None
    if condition.walking:
        # Just before the end, where gaits are steps.
        Z = step.Z[:, lanes] + condition.walking * _INSIDE * step.direction[:, lanes]
    else:
        stride = lanes_of(step.at.stride, lanes)

    _, check = verify_steps(problem.some(lanes), Z[:-1], Z[-1], stride)
    walks[lanes] = check.anthropomorphic
    return walks
