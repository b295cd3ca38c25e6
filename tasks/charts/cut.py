"""Where a manifold of special points ends within a box: along a curve on which two
sheets of it meet, on which steps vanish, or beyond which its points no longer count.
"""

from __future__ import annotations

import contextlib
from functools import partial

import numpy as np

from gaitsweep.tasks.branches.equations import meeting_residual, solve
from gaitsweep.tasks.branches.joint import evaluate
from gaitsweep.tasks.charts.box import Refused, tensor_nodes
from gaitsweep.tasks.charts.chart import Chart
from gaitsweep.tasks.charts.extension import Extension, Points
from gaitsweep.tasks.charts.manifold import Region
from gaitsweep.tasks.charts.tuning import Tuning
from gaitsweep.tasks.contract.kinds import kind_of
from gaitsweep.tasks.gaits.multipliers import other_multipliers
from gaitsweep.tasks.mechanics.sums import norm

#: First, least and largest step along coordinates in which a point is followed, and
#: largest distance from its prediction.
_FIRST_STRIDE = 0.02
_LEAST_STRIDE = 1e-4
_LARGEST_STRIDE = 0.1
_FOLLOWED_WITHIN = 0.05
#: How far a manifold that does not cover the box is followed along a key, and how far
#: it is kept beyond the place from which no gaits beside it are stable; at how many
#: places along the other key, and the degree of that curve.
_FARTHEST = 3.0
_BEYOND = 0.1
_PLACES = (13, 21)
_DEGREE = 4
#: Newton steps to a turn, the difference by which they are taken, and largest last
#: coefficient of the curve of turns.
_TURNS = 12
_DIFFERENCE = 1e-6
_SMOOTH = 1e-6
#: Coefficients of a curve on which steps vanish, largest Newton step to it, largest
#: distance from it of points that do so there, how much farther the points are whose
#: growth shows the powers, and how far these may be from whole numbers.
_VANISHING = 33
_NEAR = 0.1
_BESIDE = 0.01
_FARTHER = 0.1
_IRREGULAR = 0.2


def vanishing_beside(extension: Extension) -> Region | None:
    """Return the region of folds up to tuned walkers at a face of their box, or beside
    it, where they vanish.
    """
    maker = extension.maker
    if not extension.condition.kind.turns_slope:
        return None

    for axis in range(maker.d):
        if side := Tuning(maker.family, maker.box, axis).beside():
            with contextlib.suppress(Refused):
                return Cut(extension, axis, side).region()
    return None


def cut(extension: Extension, lost: np.ndarray) -> Region:
    """Return the region of a manifold that does not extend to some designs.

    Parameters
    ----------
    extension : Extension
    lost : ndarray, shape (n, d)
        Coordinates of their keys.

    Raises
    ------
    Refused
        If it ends otherwise than along a smooth curve.
    """
    mean = np.mean(lost - extension.unit, axis=0)
    refused = []
    for axis in np.argsort(-np.abs(mean)).tolist():
        try:
            return Cut(extension, axis, 1 if mean[axis] > 0 else -1).region()
        except Refused as why:
            refused.append(why)

    raise refused[0]


class Cut:
    """Where a manifold ends along one key, `axis`, towards its higher (1) or lower (-1)
    values, `side`.
    """

    def __init__(
        self,
        extension: Extension,
        axis: int,
        side: int,
    ):
        self.extension = extension
        self.axis = axis
        self.side = side
        self.maker = extension.maker
        self.problem = extension.problem
        self.kind = extension.kind

    def refused(self, why: str) -> Refused:
        """Why it is none, and the other key, or the only one, along which to divide."""
        return Refused(f"a {self.kind} {why}", self.maker.d - 1 - self.axis)

    def region(self) -> Region:
        """Return the region up to a curve that is smooth over the other key."""
        d = self.maker.d
        for places in _PLACES if d == 2 else (1,):
            region = self.at_places((places,) * (d - 1))
            if not region.turns or (region.curve.tails(2) < _SMOOTH).all():
                return region
        raise self.refused("turns along a curve that is not smooth")

    def at_places(self, sizes: tuple[int, ...]) -> Region:
        """Return the region by the manifold's ends at so many places along the other
        key.
        """
        start = np.insert(
            tensor_nodes(sizes),
            self.axis,
            -self.side,
            axis=1,
        )
        points, there = self.extension.carried(start, Region.whole(self.maker.d))
        if not there.all():
            lost = (~there).sum()
            raise self.refused(f"is lost on its way to {lost} designs")

        Z, unit, turned = self.followed(points.Z, start)
        if not turned.any():
            return self.beyond(sizes, unit[:, self.axis])
        if not turned.all():
            raise self.refused("ends in two ways")
        if powers := self.powers(Z, unit):
            return self.up_to_vanishing(sizes, unit[:, self.axis], powers)

        turns = self.turns(Z, unit)

        return Region(
            self.axis,
            self.side,
            Chart.through(sizes, turns[None]),
            True,
        )

    def followed(
        self, Z: np.ndarray, start: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Follow points until no gaits beside them are stable any more, or two sheets
        meet.

        Parameters
        ----------
        Z : ndarray, shape (c, n)
        start : ndarray, shape (n, d)
            Coordinates of their keys.

        Returns
        -------
        Z, unit : ndarray
            Where they end.
        turned : ndarray of bool, shape (n,)
            Where two sheets meet, so that points cannot be followed.
        """
        unit = start.copy()
        active = np.arange(len(start))
        rows = self.extension.gradient(self.problem(start), Z)
        points = Points(Z, rows, _FIRST_STRIDE)
        counted, ended, turned = np.zeros((3, len(start)), bool)
        while len(active):
            new = self.advance(points, unit, active)
            counts = self.counts(points.Z[:, new], unit[new])
            ended[new] = counted[new] & ~counts
            counted[new] |= counts
            turned[active] = points.stride[active] < _LEAST_STRIDE
            if (np.abs(unit[:, self.axis]) > _FARTHEST).any():
                raise self.refused("counts far beyond the box")

            active = active[~ended[active] & ~turned[active]]

        return points.Z, unit, turned

    def advance(
        self,
        points: Points,
        unit: np.ndarray,
        active: np.ndarray,
    ) -> np.ndarray:
        """Try a step of some points, `active`, in place, and return those that are
        accepted.
        """
        stride = points.stride[active]
        at = unit[active].copy()
        at[:, self.axis] += self.side * stride
        correct = partial(
            self.extension.correct,
            points,
            active,
            self.problem(at),
            _FOLLOWED_WITHIN,
        )
        fair = points.advance(active, stride, correct)
        points.stride[active] = np.minimum(_LARGEST_STRIDE, points.stride[active])
        unit[active[fair]] = at[fair]
        return active[fair]

    def counts(self, Z: np.ndarray, unit: np.ndarray) -> np.ndarray:
        """Whether gaits beside points (c, n) are stable; those of a value that is asked
        for count whether they are or not.
        """
        if kind_of(self.kind).is_asked_for or not len(unit):
            return np.ones(len(unit), bool)
        jacobian = evaluate(self.problem(unit), Z).stride.jacobian
        return other_multipliers(self.kind, jacobian) < 1

    def beyond(self, sizes: tuple[int, ...], ends: np.ndarray) -> Region:
        """The region up to a curve beyond all `ends`, (n,), of points that count no
        more.
        """
        few = tuple(min(n, _DEGREE + 1) for n in sizes)
        curve = Chart.through(sizes, ends[None]).coefficients
        coarse = curve[: len(tensor_nodes(few))].copy()
        off = np.abs(Chart(few, coarse)(tensor_nodes(sizes))[0] - ends).max()
        coarse[0] += self.side * (off + _BEYOND)
        return Region(self.axis, self.side, Chart(few, coarse))

    def up_to_vanishing(
        self,
        sizes: tuple[int, ...],
        ends: np.ndarray,
        powers: tuple[float, ...],
    ) -> Region:
        """The region up to the curve on which steps vanish, beside `ends`, (n,)."""
        more = (_VANISHING,) * len(sizes)
        others = tensor_nodes(more)
        near = Chart.through(sizes, ends[None])(others)[0]
        at = self.vanishing(
            np.insert(
                others,
                self.axis,
                near,
                axis=1,
            )
        )
        curve = Chart.through(more, at[None])
        if not np.isfinite(curve.coefficients).all():
            raise self.refused("vanishes along a curve that is not smooth")

        return Region(
            self.axis,
            self.side,
            curve,
            powers=powers,
        )

    def vanishing(self, unit: np.ndarray) -> np.ndarray:
        """Coordinates (n,) of the key at which the smallest slope vanishes, by Newton's
        method from designs near them.

        NaN where they are not near.
        """
        at = unit.copy()
        h = np.zeros(self.maker.d)
        h[self.axis] = _DIFFERENCE
        moment = self.maker.static_moment
        for _ in range(_TURNS):
            rate = (moment(at + h) - moment(at - h)) / (2 * _DIFFERENCE)
            # Where the moment does not depend on the key, or vanishes everywhere, there
            # is none.
            with np.errstate(invalid="ignore", divide="ignore"):
                change = moment(at) / rate
            if not (np.abs(change) < _NEAR).all():
                return np.full(len(at), np.nan)

            at[:, self.axis] -= change

        return at[:, self.axis]

    def powers(self, Z: np.ndarray, unit: np.ndarray) -> tuple[float, ...]:
        """Powers of the root of the distance to a curve on which steps vanish, as
        `Region` has them, if there is one beside points Z (c, n).
        """
        if self.maker.structure.kneed:
            return ()

        off = self.vanishing(unit) - unit[:, self.axis]
        if not ((off * self.side > 0) & (np.abs(off) < _BESIDE)).all():
            return ()

        problem = self.problem(unit)
        apart = unit.copy()
        apart[:, self.axis] -= _FARTHER * off
        farther = self.problem(apart)
        solved = solve(self.extension.equations(farther), Z)
        sizes = np.log(norm(self.extension.gradient(problem, Z)))
        grown = np.log(norm(self.extension.gradient(farther, solved.Z)))
        growth = np.vstack([solved.Z - Z, grown - sizes]) / (0.5 * np.log1p(_FARTHER))

        powers = np.round(np.median(growth, axis=1))
        off = np.abs(growth - powers[:, None])
        if not solved.ok.all() or off.max() > _IRREGULAR or not powers[:-1].any():
            return ()

        return tuple(powers.tolist())

    def turns(self, Z: np.ndarray, unit: np.ndarray) -> np.ndarray:
        """Coordinates of the key (n,) at which two sheets of the manifold meet, from
        points nearby.

        There the defining equations are singular. Newton's method solves them with
        their determinant, by differences.
        """
        V = np.vstack([Z, unit[:, self.axis]])
        for _ in range(_TURNS):
            values, by_V = self.at_turn(V, unit)
            change = -np.linalg.solve(by_V, values[:, :, None])[:, :, 0].T
            if not (np.abs(change) < 0.5).all():
                break
            V = V + change
            if np.abs(change).max() < 1e-8:
                return np.asarray(V[-1])

        raise Refused(f"a {self.kind} is lost where it counts", self.axis)

    def at_turn(self, V: np.ndarray, unit: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The defining equations and their determinant, (n, c + 1), at points with the
        key's coordinate, (c + 1, n), and the derivatives by these, (n, c + 1, c + 1).
        """
        k, n = V.shape
        moved = _DIFFERENCE * np.vstack([np.zeros((1, k)), np.eye(k)])
        lanes = (V[:, None, :] + moved.T[:, :, None]).reshape(k, -1)
        at = np.tile(unit, (len(moved), 1))
        at[:, self.axis] = lanes[-1]
        equations = self.extension.equations(self.problem(at))
        values = meeting_residual(equations, lanes[:-1])
        values = values.reshape(k, len(moved), n)
        by_V = (values[:, 1:] - values[:, :1]) / _DIFFERENCE
        return values[:, 0].T, by_V.transpose(2, 0, 1)
