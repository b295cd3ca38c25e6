"""Makes manifolds of special points: carries a point to nodes in the space of the keys,
and finds where they end.
"""

from __future__ import annotations

import contextlib
from dataclasses import replace
from functools import partial

import numpy as np

from gaitsweep.tasks.continuation.conditions import CONDITIONS
from gaitsweep.tasks.continuation.equations import (
    Equations,
    meeting,
    newton_step,
    solve,
)
from gaitsweep.tasks.continuation.joint import evaluate
from gaitsweep.tasks.families.box import Box, Refused, tensor_nodes
from gaitsweep.tasks.families.carry import Carried
from gaitsweep.tasks.families.chart import Chart, fit
from gaitsweep.tasks.families.family import Family
from gaitsweep.tasks.families.manifold import LEAST, Manifold, Region
from gaitsweep.tasks.families.tuning import Tuning
from gaitsweep.tasks.fixed_points.multipliers import other_multipliers
from gaitsweep.tasks.mechanics.lumped import Structure
from gaitsweep.tasks.mechanics.sums import norm
from gaitsweep.tasks.step.problem import Lanes
from gaitsweep.tasks.walkers.statics import leg_moment
from gaitsweep.tasks.walkers.walker import WalkerError
from gaitsweep.tasks.walkers.walker_array import WalkerArray

#: First and most nodes along each key, and the error of predictions below which no more
#: are taken.
_FIRST, _MAX_NODES, _GOOD = 5, 48, 1e-6
#: Error of the ends of pieces below which no more nodes are taken.
_GOOD_ENDS = 1e-9
#: Largest error of the predictions of a useful manifold.
_FAIR = 1e-4
_DRAWN = 24
#: First share of the way in which a point is carried from one design to another, and
#: largest distance from its prediction; first, least and largest step along coordinates
#: in which it is followed, and that distance there.
_STRIDE, _MAX_STRIDE_ERROR = 0.125, 0.3
_FIRST_STRIDE, _LEAST_STRIDE, _LARGEST_STRIDE, _FOLLOWED_WITHIN = 0.02, 1e-4, 0.1, 0.05
#: Displacement that shows how Newton's method converges.
_DISPLACED = 1e-4
#: How far a manifold that does not cover the box is followed along a key, and how far
#: it is kept beyond the place from which no gaits beside it are stable; at how many
#: places along the other key, and the degree of that curve.
_FARTHEST, _BEYOND, _PLACES, _DEGREE = 3.0, 0.1, (13, 21), 4
#: Newton steps to a turn, and largest last coefficient of the curve of turns.
_TURNS, _SMOOTH = 12, 1e-6
#: Coefficients of a curve on which steps vanish, largest Newton step to it, largest
#: distance from it of points that do so there, how much farther the points are whose
#: growth shows the powers, and how far these may be from whole numbers.
_VANISHING, _NEAR, _BESIDE, _FARTHER, _IRREGULAR = 33, 0.1, 0.01, 0.1, 0.2


class Maker:
    """Makes the manifolds of a box.

    Parameters
    ----------
    family : Family
    box : Box
    structure : Structure
        Of all its walkers.
    """

    def __init__(self, family: Family, box: Box, structure: Structure):
        self.family, self.box, self.structure = family, box, structure
        self.d = len(box.keys)

    def problem(self, unit: np.ndarray) -> Lanes:
        """Return the step map of walkers.

        Parameters
        ----------
        unit : ndarray, shape (n, d)
            Coordinates of keys.
        """
        return Lanes(self.walkers(unit), self.structure)

    def walkers(self, unit: np.ndarray) -> WalkerArray:
        """Return walkers.

        Parameters
        ----------
        unit : ndarray, shape (n, d)
            Coordinates of keys.

        Raises
        ------
        Refused
            If one cannot be.
        """
        try:
            return self.family.walkers(self.box.at(unit))
        except WalkerError as error:
            raise Refused(f"special points are followed to where {error}") from None

    def static_moment(self, unit: np.ndarray) -> np.ndarray:
        """Return what vanishes where the smallest slope of straight legs does: the
        moment of a leg about the hip.

        Parameters
        ----------
        unit : ndarray, shape (n, d)
            Coordinates of keys.

        Returns
        -------
        ndarray, shape (n,)
        """
        return np.broadcast_to(leg_moment(self.walkers(unit)).real, len(unit))

    def manifold(
        self, kind: str, unit: np.ndarray, Z: np.ndarray, target: float = 0.0
    ) -> Manifold:
        """Return the manifold through a point.

        Parameters
        ----------
        kind : str
        unit : ndarray, shape (d,)
            Coordinates of keys.
        Z : ndarray, shape (c,)
        target : float

        Raises
        ------
        Refused
            If it is not smooth enough, ends in the box in another way than along a
            curve, or goes on where no walker is valid.
        """
        return _Extension(self, kind, target, unit, Z).manifold()

    def ends(self, kind: str, unit: np.ndarray, Z: np.ndarray, total: int) -> Chart:
        """Return the chart of the special points of a kind through some of them, Z (c,
        1 + 2^d), over the whole box.

        Parameters
        ----------
        kind : str
        unit : ndarray, shape (1 + 2^d, d)
            Coordinates of keys: inside the box, and near its corners.
        Z : ndarray, shape (c, 1 + 2^d)
        total : int
            Nodes from which on no more are added.

        Raises
        ------
        Refused
            If they are not smooth enough, or do not extend over the box.
        """
        condition = CONDITIONS[kind]
        rows = Equations(self.problem(unit)).gradient(condition, Z)
        between = Chart.of_corners(unit, np.vstack([Z, rows]))
        return _Extension(self, kind, 0.0, unit[0], Z[:, 0]).ends(total, between)


class _Points(Carried):
    """Points on their way to other designs, with the derivatives of their scalars,
    `rows` (c, n).

    Both are accurate enough to lead to others.
    """

    def __init__(self, Z: np.ndarray, rows: np.ndarray, stride: float):
        super().__init__(Z, stride)
        self.rows = rows.copy()


class _Extension:
    """The extension of a point over a box: its manifold, and where that ends."""

    def __init__(
        self, maker: Maker, kind: str, target: float, unit: np.ndarray, Z: np.ndarray
    ):
        self.problem, self.box, self.d, self.maker = (
            maker.problem,
            maker.box,
            maker.d,
            maker,
        )
        self.kind, self.target, self.unit, self.Z = kind, target, unit, Z
        self.condition = CONDITIONS[kind].equal_to(target)

    def equations(self, problem: Lanes) -> Equations:
        return Equations(problem, [self.condition])

    def gradient(self, problem: Lanes, Z: np.ndarray) -> np.ndarray:
        return Equations(problem).gradient(self.condition, Z)

    def manifold(self) -> Manifold:
        sizes = (_FIRST,) * self.d
        if region := self.vanishing_beside():
            points = None
        else:
            nodes, region = tensor_nodes(sizes), Region.whole(self.d)
            points, there = self.carried(nodes, region)
            if not there.all():
                region, points = self.cut(nodes[~there]), None
        first = self.chart(region, sizes, points=points)
        return self.measured(region, self.fit(region, first, _GOOD, _MAX_NODES**self.d))

    def fit(self, region: Region, first: Chart, good: float, total: int) -> Chart:
        return fit(
            first,
            partial(self.chart, region),
            (_MAX_NODES,) * self.d,
            total,
            good,
            _FAIR,
            self.d,
        )

    def ends(self, total: int, before: Chart) -> Chart:
        region = Region.whole(self.d)
        chart = self.fit(
            region, self.chart(region, (_FIRST,) * self.d, before), _GOOD_ENDS, total
        )
        nodes = tensor_nodes(chart.sizes)
        guess, rows = np.split(chart(nodes), 2)
        solved = solve(self.equations(self.problem(nodes)), guess, rows)
        chart = self.fitted(chart.sizes, region, nodes, solved.Z, rows)
        if not (chart.error <= _FAIR and solved.ok.all()):
            raise Refused(f"predictions of a {self.kind} err by {chart.error:.1g}")
        return replace(
            chart, coefficients=chart.coefficients[:, : len(self.Z)], size=1.0
        )

    def chart(
        self,
        region: Region,
        sizes: tuple[int, ...],
        before: Chart | None = None,
        points: _Points | None = None,
    ) -> Chart:
        """The chart through points at its nodes: those given, or predicted by the chart
        before, or carried there.
        """
        nodes = region.unit(tensor_nodes(sizes))
        Z, rows, ok = (
            np.zeros((len(self.Z), len(nodes))),
            np.zeros((len(self.Z), len(nodes))),
            np.zeros(len(nodes), bool),
        )
        if points is not None:
            Z, rows, ok = points.Z, points.rows, ~ok
        elif before is not None:
            guess, rows = region.predict(before, nodes)
            solved = solve(self.equations(self.problem(nodes)), guess, rows, quick=True)
            Z, rows, ok = (
                solved.Z,
                solved.rows,
                solved.ok & (np.abs(solved.Z - guess).max(axis=0) < _MAX_STRIDE_ERROR),
            )
        if not ok.all():
            carried, there = self.carried(nodes[~ok], region)
            if not there.all():
                lost = nodes[~ok][~there] - self.unit
                why = f"a {self.kind} is lost on its way to {len(lost)} nodes"
                raise Refused(why, int(np.abs(lost).sum(axis=0).argmax()))
            Z[:, ~ok], rows[:, ~ok] = carried.Z, carried.rows
        return self.fitted(sizes, region, nodes, Z, rows)

    def fitted(
        self,
        sizes: tuple[int, ...],
        region: Region,
        nodes: np.ndarray,
        Z: np.ndarray,
        rows: np.ndarray,
    ) -> Chart:
        """The chart through points Z (c, n) at nodes (n, d) with the derivatives of
        their scalar, `rows` (c, n).
        """
        growth, factor = region.growth(nodes)
        # Nodes are added for the points: it is they that are solved.
        chart = Chart.through(
            sizes,
            np.vstack([Z - growth, rows / factor]),
            np.repeat([1.0, np.inf], len(Z)),
        )
        unit = self.drawn(region, chart)
        equations = self.equations(self.problem(unit))
        step = newton_step(equations, *region.predict(chart, unit))
        return replace(chart, error=float(step.last_step.max()))

    def drawn(self, region: Region, chart: Chart) -> np.ndarray:
        """Coordinates (n, d) of random designs that have a point of the manifold."""
        return region.unit(self.box.draw(_DRAWN, self.d, f"{self.kind} {chart.sizes}"))

    def correct(
        self,
        points: _Points,
        active: np.ndarray,
        problem: Lanes,
        within: float,
        guess: np.ndarray,
        growth: np.ndarray | float = 0.0,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Solve some points, `active`, at other designs: what was solved there, and
        which are accepted.
        """
        solved = solve(
            self.equations(problem),
            guess + growth,
            points.rows[:, active],
            quick=True,
        )
        Z = solved.Z - growth
        fair = solved.ok & (np.abs(Z - guess).max(axis=0) < within)
        points.rows[:, active[fair]] = solved.rows[:, fair]
        return Z, fair

    def carried(self, nodes: np.ndarray, own: Region) -> tuple[_Points, np.ndarray]:
        """The point carried to other designs along straight lines in some coordinates,
        and whether it arrived, (n,).
        """
        n, here, start, ends = (
            len(nodes),
            self.unit[None],
            own.own(self.unit[None]),
            own.own(nodes),
        )
        row, smooth = (
            self.gradient(self.problem(here), self.Z[:, None]),
            self.Z[:, None] - own.growth(here)[0],
        )
        points = _Points(
            np.repeat(smooth, n, axis=1), np.repeat(row, n, axis=1), _STRIDE
        )

        def correct(
            active: np.ndarray, share: np.ndarray, guess: np.ndarray
        ) -> tuple[np.ndarray, np.ndarray]:
            unit = own.unit(start + share[:, None] * (ends[active] - start))
            growth, problem = own.growth(unit)[0], self.problem(unit)
            return self.correct(
                points, active, problem, _MAX_STRIDE_ERROR, guess, growth
            )

        there = points.carry(correct)
        points.Z += own.growth(nodes)[0]
        return points, there

    def vanishing_beside(self) -> Region | None:
        """The region of folds up to tuned walkers at a face, or beside it, where they
        vanish.
        """
        for axis in range(self.d if self.kind == "fold" else 0):
            if side := Tuning(self.maker.family, self.box, axis).beside():
                with contextlib.suppress(Refused):
                    return self.smooth_cut(axis, side)
        return None

    def cut(self, lost: np.ndarray) -> Region:
        """The region of the manifold, which does not extend to some designs, `lost` (n,
        d).
        """
        mean = np.mean(lost - self.unit, axis=0)
        refused = []
        for axis in np.argsort(-np.abs(mean)).tolist():
            try:
                return self.smooth_cut(axis, 1 if mean[axis] > 0 else -1)
            except Refused as why:
                refused.append(why)
        raise refused[0]

    def smooth_cut(self, axis: int, side: int) -> Region:
        """The region up to a curve towards one side of a key, smooth over the other."""
        for places in _PLACES if self.d == 2 else (1,):
            cut = self.cut_along(axis, side, (places,) * (self.d - 1))
            if not cut.turns or (cut.curve.tails(2) < _SMOOTH).all():
                return cut
        raise Refused(
            f"a {self.kind} turns along a curve that is not smooth", self.across(axis)
        )

    def across(self, axis: int) -> int:
        """The other key, or the only one."""
        return self.d - 1 - axis

    def cut_along(self, axis: int, side: int, sizes: tuple[int, ...]) -> Region:
        """The region up to a curve towards one side of a key, by the manifold's ends at
        places along the other.
        """
        others, across = tensor_nodes(sizes), self.across(axis)
        start = np.insert(others, axis, -side, axis=1)
        points, there = self.carried(start, Region.whole(self.d))
        if not there.all():
            raise Refused(
                f"a {self.kind} is lost on its way to {(~there).sum()} designs", across
            )
        points, ends, turned = self.followed(points.Z, start, axis, side)
        curve = Chart.through(sizes, ends[None])
        if turned.all():
            if powers := self.powers(points.Z, start, ends, axis, side):
                more = (_VANISHING,) * len(sizes)
                near = np.insert(
                    tensor_nodes(more), axis, curve(tensor_nodes(more))[0], axis=1
                )
                curve = Chart.through(more, self.vanishing(near, axis)[None])
                if not np.isfinite(curve.coefficients).all():
                    raise Refused(
                        f"a {self.kind} vanishes along a curve that is not smooth",
                        across,
                    )
                return Region(axis, side, curve, powers=powers)
            return Region(
                axis,
                side,
                Chart.through(sizes, self.turns(points.Z, start, ends, axis)[None]),
                True,
            )
        if turned.any():
            raise Refused(f"a {self.kind} ends in two ways", across)
        few = tuple(min(n, _DEGREE + 1) for n in sizes)
        coarse = curve.coefficients[: len(tensor_nodes(few))].copy()
        coarse[0] += side * (
            np.abs(Chart(few, coarse)(others)[0] - ends).max() + _BEYOND
        )
        return Region(axis, side, Chart(few, coarse))

    def followed(
        self, Z: np.ndarray, start: np.ndarray, axis: int, side: int
    ) -> tuple[_Points, np.ndarray, np.ndarray]:
        """Follow points along one key until no gaits beside them are stable any more,
        or two sheets meet.

        Returns
        -------
        points : _Points
        ends : ndarray, shape (n,)
            Coordinates of the key.
        turned : ndarray of bool, shape (n,)
            Where two sheets meet, so that points cannot be followed.
        """
        n, u, active = len(start), start[:, axis].copy(), np.arange(len(start))
        points = _Points(Z, self.gradient(self.problem(start), Z), _FIRST_STRIDE)
        counts, ended, turned = np.zeros(n, bool), np.zeros(n, bool), np.zeros(n, bool)
        while len(active):
            at, stride = start[active].copy(), points.stride[active]
            at[:, axis] = u[active] + side * stride
            problem = self.problem(at)
            correct = partial(self.correct, points, active, problem, _FOLLOWED_WITHIN)
            fair = points.advance(active, stride, correct)
            new = active[fair]
            u[new] = at[fair, axis]
            # Gaits of a speed count whether they are stable or not.
            jacobian = evaluate(problem, points.Z[:, active]).stride.jacobian
            stable = (other_multipliers(self.kind, jacobian)[fair] < 1) | (
                self.kind == "speed"
            )
            ended[new] = counts[new] & ~stable
            counts[new] |= stable
            points.stride[active] = np.minimum(_LARGEST_STRIDE, points.stride[active])
            turned[active] = points.stride[active] < _LEAST_STRIDE
            if (np.abs(u) > _FARTHEST).any():
                raise Refused(
                    f"a {self.kind} counts far beyond the box", self.across(axis)
                )
            active = active[~ended[active] & ~turned[active]]
        return points, u, turned

    def vanishing(self, unit: np.ndarray, axis: int) -> np.ndarray:
        """Coordinates (n,) of a key at which the smallest slope vanishes, by Newton's
        method from designs near them.

        NaN where they are not near.
        """
        at, h = unit.copy(), np.zeros(self.d)
        h[axis] = 1e-6
        for _ in range(_TURNS):
            rate = (
                self.maker.static_moment(at + h) - self.maker.static_moment(at - h)
            ) / 2e-6
            # Where the moment does not depend on the key, or vanishes everywhere, there
            # is none.
            with np.errstate(invalid="ignore", divide="ignore"):
                change = self.maker.static_moment(at) / rate
            if not (np.abs(change) < _NEAR).all():
                return np.full(len(at), np.nan)
            at[:, axis] -= change
        return at[:, axis]

    def powers(
        self, Z: np.ndarray, start: np.ndarray, u: np.ndarray, axis: int, side: int
    ) -> tuple[float, ...]:
        """Powers of the root of the distance to a curve on which steps vanish, as
        `Region` has them, if there is one.

        Of points Z (c, n) beside it, at coordinates u (n,) of one key.
        """
        unit = start.copy()
        unit[:, axis] = u
        off = (
            side * (self.vanishing(unit, axis) - u)
            if not self.maker.structure.kneed
            else np.full(len(u), np.nan)
        )
        if not ((off > 0) & (off < _BESIDE)).all():
            return ()
        sizes = np.log(norm(self.gradient(self.problem(unit), Z)))
        unit[:, axis] -= _FARTHER * side * off
        solved = solve(self.equations(self.problem(unit)), Z)
        farther = np.log(norm(self.gradient(self.problem(unit), solved.Z)))
        growth = np.vstack([solved.Z - Z, farther - sizes]) / (0.5 * np.log1p(_FARTHER))
        powers = np.round(np.median(growth, axis=1))
        if (
            not solved.ok.all()
            or np.abs(growth - powers[:, None]).max() > _IRREGULAR
            or not powers[:-1].any()
        ):
            return ()
        return tuple(powers.tolist())

    def turns(
        self, Z: np.ndarray, start: np.ndarray, u: np.ndarray, axis: int
    ) -> np.ndarray:
        """Coordinates of a key (n,) at which two sheets of the manifold meet, from
        points nearby.

        There the defining equations are singular. Newton's method solves them with
        their determinant, by differences.
        """
        n, c = len(u), len(Z)
        V = np.vstack([Z, u])
        for _ in range(_TURNS):
            h = 1e-6 * np.concatenate([np.zeros((1, c + 1)), np.eye(c + 1)])
            lanes = (V[:, None, :] + h.T[:, :, None]).reshape(c + 1, -1)
            at = np.tile(start, (len(h), 1))
            at[:, axis] = lanes[-1]
            equations = self.equations(self.problem(at))
            values = meeting(equations, lanes[:-1]).reshape(c + 1, len(h), n)
            J = (values[:, 1:] - values[:, :1]) / 1e-6
            change = -np.linalg.solve(J.transpose(2, 0, 1), values[:, 0].T[:, :, None])[
                :, :, 0
            ].T
            if not (np.abs(change) < 0.5).all():
                break
            V = V + change
            if np.abs(change).max() < 1e-8:
                return np.asarray(V[-1])
        raise Refused(f"a {self.kind} is lost where it counts", axis)

    def measured(self, region: Region, chart: Chart) -> Manifold:
        """The manifold through points that are solved to rounding, with what is
        measured at random ones.
        """
        nodes = region.unit(tensor_nodes(chart.sizes))
        problem, (guess, rows) = self.problem(nodes), region.predict(chart, nodes)
        Z = solve(self.equations(problem), guess, rows).Z
        chart = self.fitted(chart.sizes, region, nodes, Z, self.gradient(problem, Z))
        unit = self.drawn(region, chart)
        problem, (guess, rows) = self.problem(unit), region.predict(chart, unit)
        equations = self.equations(problem)
        solved = solve(equations, guess, rows)
        if not (chart.error <= _FAIR and solved.ok.all()):
            raise Refused(f"predictions of a {self.kind} err by {chart.error:.1g}")
        first, Z = newton_step(equations, guess, rows), solved.Z
        displaced = (
            Z + _DISPLACED * np.sign(self.box.draw(Z.shape[1], len(Z), "displaced")).T
        )
        off = newton_step(equations, displaced, rows).Z - Z
        own = np.abs(first.Z - Z).max(axis=0)
        linear, quadratic = (
            (own / np.maximum(first.last_step, LEAST)).max(),
            np.abs(off).max() / _DISPLACED**2,
        )
        return Manifold(
            self.kind, self.target, region, chart, float(linear), float(quadratic)
        )
