"""Special points as functions of keys: polynomials that predict a point, and the rows that polish it in one step."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tasks.continuation.defining import Polish, newton_step
from tasks.continuation.extremes import Points, classify
from tasks.families.chart import Chart
from tasks.fixed_points.step_check import verify_steps
from tasks.step.problem import Lanes
from tasks.step.step_map import SAMPLES

#: Factor by which a point may lie farther from its prediction, and err more, than those drawn.
_SAFETY = 8.0
#: Smallest error of predictions: below is rounding.
LEAST = 1e-9
#: Error above which a further Newton step is taken.
_GOAL = 1e-10
#: Distance from an end at which its gaits must be steps.
_INSIDE = 1e-3
#: Share of the way to a turn within which designs are surveyed, and the smallest that counts.
_AT_TURN, _MIN_SHARE = 1e-5, 1e-12


@dataclass(frozen=True)
class Cut:
    """The border of a manifold inside a box: it lies on one side of a curve along the other key.

    Attributes
    ----------
    axis : int
        The key along which it ends.
    side : int
        1 if it ends towards higher values, else -1.
    curve : Chart
        The coordinate at which it ends over that of the other key, if there is one.
    turns : bool
        Whether two sheets meet there: beside it points depend on the root of the distance.
    powers : tuple of float
        Where steps vanish there: the powers of the root of the distance with which the exponentials of the coordinates
        of a point grow, and after them that of the derivatives of its scalar.
    """

    axis: int
    side: int
    curve: Chart
    turns: bool
    powers: tuple[float, ...] = ()

    @property
    def is_root(self) -> bool:
        """Whether points depend on the root of the distance."""
        return self.turns or bool(self.powers)

    def growth(self, unit: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return what is known of points where steps vanish at the curve.

        Parameters
        ----------
        unit : ndarray, shape (n, d)
            Coordinates of keys.

        Returns
        -------
        Z : ndarray, shape (c, n)
            To be added to the smooth part of the points.
        factor : ndarray, shape (n,)
            Multiplies the smooth part of the derivatives of the scalar.
        """
        log_root = 0.5 * np.log(np.maximum(1 - self.share(unit), _MIN_SHARE))
        return np.multiply.outer(np.array(self.powers[:-1]), log_root), np.exp(self.powers[-1] * log_root)

    def at(self, unit: np.ndarray) -> np.ndarray:
        """Return the coordinates at which the manifold ends.

        Parameters
        ----------
        unit : ndarray, shape (n, d)
            Coordinates of keys.

        Returns
        -------
        ndarray, shape (n,)
        """
        return np.asarray(self.curve(np.delete(unit, self.axis, axis=1))[0])

    def own(self, unit: np.ndarray) -> np.ndarray:
        """Return coordinates that run from -1 to 1 over the manifold.

        Parameters
        ----------
        unit : ndarray, shape (n, d)
            Coordinates of keys.

        Returns
        -------
        ndarray, shape (n, d)
        """
        own, share = unit.copy(), self.share(unit)
        if self.is_root:
            share = 1 - np.sqrt(np.maximum(1 - share, 0.0))
        own[:, self.axis] = self.side * (2 * share - 1)
        return own

    def unit(self, own: np.ndarray) -> np.ndarray:
        """Return coordinates of keys, the inverse of `own`.

        Parameters
        ----------
        own : ndarray, shape (n, d)
            Coordinates that run from -1 to 1 over the manifold.

        Returns
        -------
        ndarray, shape (n, d)
        """
        unit, share = own.copy(), 0.5 * (1 + self.side * own[:, self.axis])
        if self.is_root:
            share = 1 - (1 - share) ** 2
        unit[:, self.axis] = self.side * (share * (1 + self.side * self.at(own)) - 1)
        return unit

    def share(self, unit: np.ndarray) -> np.ndarray:
        """Return the share of the way from the box's own border to the curve.

        Parameters
        ----------
        unit : ndarray, shape (n, d)
            Coordinates of keys.

        Returns
        -------
        ndarray, shape (n,)
        """
        return np.asarray((1 + self.side * unit[:, self.axis]) / (1 + self.side * self.at(unit)))


@dataclass(frozen=True)
class Coordinates:
    """Coordinates that run from -1 to 1 over the part of a box that a manifold covers.

    Attributes
    ----------
    cut : Cut or None
        Where it ends inside the box.
    ratio : tuple of float
        For each key how many times faster the coordinate grows at the box's upper end than at its lower: in boxes whose
        coordinates are logarithms some points depend more smoothly on the keys themselves. Empty for the box's own.
    """

    cut: Cut | None = None
    ratio: tuple[float, ...] = ()

    def own(self, unit: np.ndarray) -> np.ndarray:
        """Return the coordinates on the manifold.

        Parameters
        ----------
        unit : ndarray, shape (n, d)
            Coordinates of keys.

        Returns
        -------
        ndarray, shape (n, d)
        """
        own, r = self.cut.own(unit) if self.cut else unit, np.array(self.ratio or 1.0)
        with np.errstate(invalid="ignore"):
            return np.where(r == 1, own, 2 * (r ** (0.5 * (1 + own)) - 1) / (r - 1) - 1)

    def unit(self, own: np.ndarray) -> np.ndarray:
        """Return coordinates of keys, the inverse of `own`.

        Parameters
        ----------
        own : ndarray, shape (n, d)
            Coordinates on the manifold.

        Returns
        -------
        ndarray, shape (n, d)
        """
        r = np.array(self.ratio or 1.0)
        with np.errstate(invalid="ignore", divide="ignore"):
            own = np.where(r == 1, own, 2 * np.log(1 + 0.5 * (r - 1) * (1 + own)) / np.log(r) - 1)
        return self.cut.unit(own) if self.cut else own

    def growth(self, unit: np.ndarray) -> tuple[np.ndarray | float, np.ndarray | float]:
        """Return what `Cut.growth` does; where steps vanish nowhere, 0 and 1.

        Parameters
        ----------
        unit : ndarray, shape (n, d)
            Coordinates of keys.

        Returns
        -------
        Z : ndarray, shape (c, n), or float
        factor : ndarray, shape (n,), or float
        """
        return self.cut.growth(unit) if self.cut and self.cut.powers else (0.0, 1.0)

    def predict(self, chart: Chart, unit: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return points and the derivatives of their scalar, (c, n) each, that a chart over the coordinates has."""
        Z, rows = np.split(chart(self.own(unit)), 2)
        growth, factor = self.growth(unit)
        return Z + growth, rows * factor


@dataclass(frozen=True)
class Manifold:
    """Special points of one kind in a box of keys.

    Attributes
    ----------
    kind : str
    target : float
        As `tasks.continuation.defining.scalar` has it.
    coordinates : Coordinates
    chart : Chart
        Of Z and of the derivatives of the kind's scalar (2 c values); its error is the largest Newton step from
        predictions at random points.
    linear, quadratic : float
        Largest error after a Newton step, over the step and over its square.
    """

    kind: str
    target: float
    coordinates: Coordinates
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
        return self.coordinates.predict(self.chart, unit)

    def there(self, unit: np.ndarray) -> np.ndarray:
        """Return whether designs have a point of the manifold.

        Parameters
        ----------
        unit : ndarray, shape (n, d)
            Coordinates of keys.

        Returns
        -------
        ndarray of bool, shape (n,)
        """
        cut = self.coordinates.cut
        return cut.share(unit) <= 1 if cut else np.ones(len(unit), bool)

    def unsure(self, unit: np.ndarray) -> np.ndarray:
        """Return whether designs lie too near a curve at which two sheets of the manifold meet, or steps vanish.

        Parameters
        ----------
        unit : ndarray, shape (n, d)
            Coordinates of keys.

        Returns
        -------
        ndarray of bool, shape (n,)
        """
        cut = self.coordinates.cut
        return np.abs(cut.share(unit) - 1) < _AT_TURN if cut and cut.is_root else np.zeros(len(unit), bool)

    def polish(self, problem: Lanes, unit: np.ndarray) -> tuple[Points, np.ndarray]:
        """Solve the points of designs that are `there`, by a Newton step from their predictions.

        Parameters
        ----------
        problem : Lanes
            Of n lanes.
        unit : ndarray, shape (n, d)
            Coordinates of keys.

        Returns
        -------
        points : Points
        near : ndarray of bool, shape (n,)
            Whether they are as near their predictions as they should be.
        """
        Z, rows = self.predict(unit)
        step = newton_step(problem, self.kind, Z, rows, self.target, 0 if _is_end(self.kind) else SAMPLES)
        size, change = np.abs(step.change).max(axis=0), step.change
        near = size <= _SAFETY * max(self.chart.error, LEAST)
        walks = _walks(problem, self.kind, step, near)
        error = self._error(size) + step.rounding
        again = np.flatnonzero(near & (error > _GOAL))
        if len(again):
            change = change.copy()
            further = newton_step(problem.some(again), self.kind, (Z + change)[:, again], rows[:, again], self.target)
            change[:, again] += further.change
            error[again] = self._error(np.abs(further.change).max(axis=0)) + further.rounding
        points = classify(self.kind, step.at, np.arange(len(unit)), Z + change, rows, error, walks)
        # Where the speed grows towards the other side of the point, it has a maximum before it.
        points.faster = (step.at.speed_by_Z * step.along).sum(axis=0) > 0
        return points, near

    def _error(self, size: np.ndarray) -> np.ndarray:
        """Error after a Newton step of some size."""
        return np.asarray(_SAFETY * (self.linear * size + self.quadratic * size**2))


def _is_end(kind: str) -> bool:
    return kind.startswith("end_")


def _walks(problem: Lanes, kind: str, step: Polish, near: np.ndarray) -> np.ndarray:
    """Whether special points are steps whose legs pass once, or, of an end, the gaits just before it."""
    m, walks, lanes = problem.m, np.zeros(len(near), bool), np.flatnonzero(near)
    if not len(lanes):
        return walks
    Z, stride = step.at.Z[:, lanes], None
    if _is_end(kind):
        along = step.along[:, lanes]
        # Before the end kneestrike precedes heelstrike; the foot falls as it strikes.
        side = 1 if "kneestrike_at" in kind else -1
        Z = Z + step.change[:, lanes] + side * _INSIDE * along / np.linalg.norm(along, axis=0)
    else:
        stride = step.at.stride.some(lanes)
    _, check = verify_steps(problem.some(lanes), np.delete(Z, m, axis=0), Z[m], stride)
    walks[lanes] = check.anthropomorphic
    return walks
