"""Makes manifolds of special points: carries a point to nodes in the space of the keys, and finds where they end."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.polynomial.chebyshev import chebfit, chebval

from tasks.continuation.defining import defining_system, evaluate, gradient, newton_step, solve
from tasks.families.box import Box, Refused, roots, tensor_nodes
from tasks.families.cell import Family
from tasks.families.manifold import LEAST, Coordinates, Cut, Manifold
from tasks.families.patch import fit, tails
from tasks.fixed_points.multipliers import other_multipliers
from tasks.mechanics.lumped import Structure
from tasks.step.problem import Lanes
from tasks.walkers.statics import leg_moment
from tasks.walkers.walker import WalkerError

#: Nodes along each key, those with which coordinates are compared, and the error of predictions below which no more are
#: taken.
_SIZES, _COMPARED, _GOOD = (5, 7, 9, 13, 17, 25, 33), 9, 1e-6
#: Largest error of the predictions of a useful manifold.
_FAIR = 1e-4
_DRAWN = 24
#: First and smallest share of the way in which a point is carried from one design to another, and largest distance from
#: its prediction.
_STRIDE, _MIN_STRIDE, _MAX_STRIDE_ERROR = 0.125, 1 / 256, 0.3
#: Displacement that shows how Newton's method converges.
_DISPLACED = 1e-4
#: How far a manifold that does not cover the box is followed along a key, and how far it is kept beyond the place from
#: which no gaits beside it are stable; at how many places along the other key, and the degree of that curve.
_FARTHEST, _BEYOND, _PLACES, _DEGREE = 3.0, 0.1, (13, 21), 4
#: Newton steps to a turn, and largest last coefficient of the curve of turns.
_TURNS, _SMOOTH = 12, 1e-6
#: Coefficients of a curve on which steps vanish, largest Newton step to it, largest distance from it of points that do
#: so there, how much farther the points are whose growth shows the powers, and how far these may be from whole
#: numbers.
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
        self.d, self.m = len(box.keys), structure.dimension

    def problem(self, unit: np.ndarray) -> Lanes:
        """Return the step map of walkers.

        Parameters
        ----------
        unit : ndarray, shape (n, d)
            Coordinates of keys.
        """
        return Lanes(self.family.walkers(self.box.at(unit)), self.structure)

    def static_moment(self, unit: np.ndarray) -> np.ndarray:
        """Return what vanishes where the smallest slope of straight legs does: the moment of a leg about the hip.

        Parameters
        ----------
        unit : ndarray, shape (n, d)
            Coordinates of keys.

        Returns
        -------
        ndarray, shape (n,)
        """
        return np.broadcast_to(leg_moment(self.family.walkers(self.box.at(unit))).real, len(unit))

    def manifold(self, kind: str, unit: np.ndarray, Z: np.ndarray, target: float = 0.0) -> Manifold:
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
            If it is not smooth enough, ends in the box in another way than along a curve, or goes on where no walker
            is valid.
        """
        try:
            return _Extension(self, kind, target, unit, Z).manifold()
        except WalkerError as error:
            raise Refused(f"a {kind} counts where {error}") from None


class _Extension:
    """The extension of a point over a box: its manifold, and where that ends."""

    def __init__(self, maker: Maker, kind: str, target: float, unit: np.ndarray, Z: np.ndarray):
        self.problem, self.box, self.d, self.maker = maker.problem, maker.box, maker.d, maker
        self.kind, self.target, self.unit, self.Z = kind, target, unit, Z

    def manifold(self) -> Manifold:
        sizes = (_SIZES[0],) * self.d
        nodes = tensor_nodes(sizes)
        carried = self.carried(nodes)
        cut = None if carried[-1].all() else self.cut(nodes[~carried[-1]])
        tries = []
        for ratio in [(), self.box.ratio] if self.box.ratio else [()]:
            coordinates = Coordinates(cut, ratio)
            manifold = self.through_nodes(sizes, coordinates, points=None if cut or ratio else carried)
            if self.box.ratio:
                # This many nodes show which coordinate is the better one. Beside a turn poor predictions lead to
                # the other sheet.
                more = (_COMPARED,) * self.d
                manifold = self.through_nodes(more, coordinates, None if cut else manifold)
            tries.append(manifold)
        manifold = min(tries, key=lambda one: one.moved)
        while manifold.moved > _GOOD:
            tail = self.tails(manifold)
            larger = tuple(
                _SIZES[min(_SIZES.index(n) + int(t > 0.1 * min(_GOOD, tail.max())), len(_SIZES) - 1)]
                for n, t in zip(manifold.sizes, tail, strict=True)
            )
            if larger == manifold.sizes:
                break
            manifold = self.through_nodes(larger, manifold.coordinates, manifold)
        if manifold.moved < _FAIR:
            manifold = self.measured(self.exact(manifold))
        if not manifold.moved < _FAIR:
            why = f"predictions of a {self.kind} err by {manifold.moved:.1g}"
            raise Refused(why, int(np.argmax(self.tails(manifold))))
        return manifold

    def tails(self, manifold: Manifold) -> np.ndarray:
        """Those of the coefficients of the points, shape (d,)."""
        return tails(manifold.coefficients[:, : len(self.Z)], manifold.sizes)

    def through_nodes(
        self,
        sizes: tuple[int, ...],
        coordinates: Coordinates,
        known: Manifold | None = None,
        points: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None,
    ) -> Manifold:
        """The manifold through points at its nodes: those given, or predicted by a coarser one, or carried there.

        They and the derivatives are accurate enough to lead to others and to show how far predictions are off.
        """
        nodes = coordinates.unit(tensor_nodes(sizes))
        if points is not None:
            Z, rows, ok = points
        elif known is not None:
            guess, rows = known.predict(nodes)
            solved = solve(self.problem(nodes), self.kind, guess, self.target, rows, quick=True)
            Z, rows, ok = solved.Z, solved.rows, solved.ok & (np.abs(solved.Z - guess).max(axis=0) < _MAX_STRIDE_ERROR)
        else:
            Z, rows, ok = *np.zeros((2, len(self.Z), len(nodes))), np.zeros(len(nodes), bool)
        if not ok.all():
            Z[:, ~ok], rows[:, ~ok], ok[~ok] = self.carried(nodes[~ok], coordinates)
        if not ok.all():
            lost = nodes[~ok] - self.unit
            why = f"a {self.kind} is lost on its way to {len(lost)} nodes"
            raise Refused(why, int(np.abs(lost).sum(axis=0).argmax()))
        manifold = self.fitted(sizes, coordinates, nodes, Z, rows)
        unit = self.drawn(manifold)
        off = newton_step(self.problem(unit), self.kind, *manifold.predict(unit), self.target).change
        return replace(manifold, moved=float(np.nan_to_num(np.abs(off), nan=np.inf).max()))

    def fitted(
        self, sizes: tuple[int, ...], coordinates: Coordinates, nodes: np.ndarray, Z: np.ndarray, rows: np.ndarray
    ) -> Manifold:
        """The manifold through points Z (c, n) at nodes (n, d) with the derivatives of their scalar, `rows` (c, n)."""
        growth, factor = coordinates.growth(nodes)
        values = np.vstack([Z - growth, rows / factor])
        return Manifold(self.kind, self.target, coordinates, sizes, fit(values.T, sizes))

    def exact(self, manifold: Manifold) -> Manifold:
        """The manifold through the points at its nodes, solved to rounding, with the derivatives at each."""
        nodes = manifold.coordinates.unit(tensor_nodes(manifold.sizes))
        problem = self.problem(nodes)
        guess, rows = manifold.predict(nodes)
        Z = solve(problem, self.kind, guess, self.target, rows).Z
        return self.fitted(manifold.sizes, manifold.coordinates, nodes, Z, gradient(problem, self.kind, Z))

    def drawn(self, manifold: Manifold) -> np.ndarray:
        """Coordinates (n, d) of random designs that have a point of the manifold."""
        unit, cut = self.box.draw(_DRAWN, self.d, f"{self.kind} {manifold.sizes}"), manifold.coordinates.cut
        return cut.unit(unit) if cut else unit

    def carried(
        self, nodes: np.ndarray, coordinates: Coordinates | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Carry the point to other designs, by continuation along straight lines in the box's or other coordinates.

        Returns
        -------
        Z, rows : ndarray, shape (c, n)
            The points and the derivatives of their scalar, accurate enough to lead to others.
        ok : ndarray of bool, shape (n,)
        """
        own = coordinates or Coordinates()
        n, start, ends = len(nodes), own.own(self.unit[None]), own.own(nodes)
        points, rows = np.repeat(self.Z[:, None], n, axis=1), np.zeros((len(self.Z), n))
        rows[:] = gradient(self.problem(self.unit[None]), self.kind, self.Z[:, None])
        points -= own.growth(self.unit[None])[0]
        rate, share, stride = np.zeros_like(points), np.zeros(n), np.full(n, _STRIDE)
        active = np.arange(n)
        while len(active):
            step = np.minimum(stride[active], 1 - share[active])
            unit = own.unit(start + (share[active] + step)[:, None] * (ends[active] - start))
            guess = points[:, active] + step * rate[:, active]
            growth, _ = own.growth(unit)
            solved = solve(self.problem(unit), self.kind, guess + growth, self.target, rows[:, active], quick=True)
            off = np.abs(solved.Z - growth - guess).max(axis=0)
            fair = solved.ok & (off < _MAX_STRIDE_ERROR)
            new, Z = active[fair], (solved.Z - growth)[:, fair]
            rate[:, new] = (Z - points[:, new]) / step[fair]
            points[:, new], rows[:, new] = Z, solved.rows[:, fair]
            share[new] += step[fair]
            stride[new] *= 1.5
            stride[active[~fair]] *= 0.5
            active = active[(share[active] < 1 - 1e-12) & (stride[active] > _MIN_STRIDE)]
        return points + own.growth(nodes)[0], rows, share >= 1 - 1e-12

    def cut(self, lost: np.ndarray) -> Cut:
        """The curve at which the manifold is cut, which does not extend to some designs, `lost` (n, d)."""
        mean = np.mean(lost - self.unit, axis=0)
        refused = []
        for axis in np.argsort(-np.abs(mean)).tolist():
            try:
                return self.smooth_cut(axis, 1 if mean[axis] > 0 else -1)
            except Refused as why:
                refused.append(why)
        raise refused[0]

    def smooth_cut(self, axis: int, side: int) -> Cut:
        """The curve at which the manifold is cut towards one side of a key, smooth over the other."""
        for places in _PLACES if self.d == 2 else (1,):
            cut = self.cut_along(axis, side, places)
            if not cut.turns or self.d == 1 or np.abs(cut.coefficients[-2:]).max() < _SMOOTH:
                return cut
        raise Refused(f"a {self.kind} turns along a curve that is not smooth", self.across(axis))

    def across(self, axis: int) -> int:
        """The other key, or the only one."""
        return self.d - 1 - axis

    def cut_along(self, axis: int, side: int, places: int) -> Cut:
        """The curve at which the manifold ends towards one side of a key, by its ends at places along the other."""
        start, across = np.zeros((places, self.d)), self.across(axis)
        start[:, across] = roots(places)
        start[:, axis] = -side
        points, _, ok = self.carried(start)
        if not ok.all():
            raise Refused(f"a {self.kind} is lost on its way to {(~ok).sum()} designs", across)
        ends, where, turned = self.followed(points, start, axis, side)
        if turned.all():
            if powers := self.powers(where, start, ends, axis, side):
                other = roots(_VANISHING if self.d == 2 else 1)
                own = np.repeat(other[:, None], self.d, axis=1)
                own[:, axis] = chebval(other, chebfit(start[:, across], ends, len(ends) - 1) if self.d == 2 else ends)
                curve = self.vanishing(own, axis)
                if not np.isfinite(curve).all():
                    raise Refused(f"a {self.kind} vanishes along a curve that is not smooth", across)
                return Cut(axis, side, chebfit(other, curve, len(other) - 1), False, powers)
            ends = self.turns(where, start, ends, axis)
            return Cut(axis, side, chebfit(start[:, across], ends, len(ends) - 1), True)
        if turned.any():
            raise Refused(f"a {self.kind} ends in two ways", across)
        curve = chebfit(start[:, across], ends, min(_DEGREE, len(ends) - 1))
        curve[0] += side * (np.abs(chebval(start[:, across], curve) - ends).max() + _BEYOND)
        return Cut(axis, side, curve, False)

    def followed(
        self, points: np.ndarray, start: np.ndarray, axis: int, side: int
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Follow points along one key until no gaits beside them are stable any more, or two sheets meet.

        Returns
        -------
        ends : ndarray, shape (n,)
            Coordinates of the key.
        Z : ndarray, shape (c, n)
        turned : ndarray of bool, shape (n,)
            Where two sheets meet, so that points cannot be followed.
        """
        n = len(start)
        u, points = start[:, axis].copy(), points.copy()
        rows, rate = gradient(self.problem(start), self.kind, points), np.zeros_like(points)
        stride, counts, ended = np.full(n, 0.02), np.zeros(n, bool), np.zeros(n, bool)
        turned, active = np.zeros(n, bool), np.arange(n)
        while len(active):
            at = start[active].copy()
            at[:, axis] = u[active] + side * stride[active]
            guess = points[:, active] + stride[active] * rate[:, active]
            problem = self.problem(at)
            solved = solve(problem, self.kind, guess, self.target, rows[:, active], quick=True)
            fair = solved.ok & (np.abs(solved.Z - guess).max(axis=0) < 0.05)
            new = active[fair]
            rate[:, new] = (solved.Z[:, fair] - points[:, new]) / stride[new]
            points[:, new], rows[:, new], u[new] = solved.Z[:, fair], solved.rows[:, fair], at[fair, axis]
            # Gaits of a speed count whether they are stable or not.
            jacobian = evaluate(problem, solved.Z).stride.jacobian
            stable = (other_multipliers(self.kind, jacobian)[fair] < 1) | (self.kind == "speed")
            ended[new] = counts[new] & ~stable
            counts[new] |= stable
            stride[new] = np.minimum(0.1, 1.5 * stride[new])
            stride[active[~fair]] *= 0.4
            turned[active] = stride[active] < 1e-4
            if (np.abs(u) > _FARTHEST).any():
                raise Refused(f"a {self.kind} counts far beyond the box", self.across(axis))
            active = active[~ended[active] & ~turned[active]]
        return u, points, turned

    def vanishing(self, unit: np.ndarray, axis: int) -> np.ndarray:
        """Coordinates (n,) of a key at which the smallest slope vanishes, by Newton's method from designs near them.

        NaN where they are not near.
        """
        at, h = unit.copy(), np.zeros(self.d)
        h[axis] = 1e-6
        for _ in range(_TURNS):
            rate = (self.maker.static_moment(at + h) - self.maker.static_moment(at - h)) / 2e-6
            # Where the moment does not depend on the key, or vanishes everywhere, there is none.
            with np.errstate(invalid="ignore", divide="ignore"):
                change = self.maker.static_moment(at) / rate
            if not (np.abs(change) < _NEAR).all():
                return np.full(len(at), np.nan)
            at[:, axis] -= change
        return at[:, axis]

    def powers(self, Z: np.ndarray, start: np.ndarray, u: np.ndarray, axis: int, side: int) -> tuple[float, ...]:
        """Powers of the root of the distance to a curve on which steps vanish, as `Cut` has them, if there is one.

        Of points Z (c, n) beside it, at coordinates u (n,) of one key.
        """
        unit = start.copy()
        unit[:, axis] = u
        off = side * (self.vanishing(unit, axis) - u) if not self.maker.structure.kneed else np.full(len(u), np.nan)
        if not ((off > 0) & (off < _BESIDE)).all():
            return ()
        sizes = np.log(np.linalg.norm(gradient(self.problem(unit), self.kind, Z), axis=0))
        unit[:, axis] -= _FARTHER * side * off
        solved = solve(self.problem(unit), self.kind, Z, self.target)
        farther = np.log(np.linalg.norm(gradient(self.problem(unit), self.kind, solved.Z), axis=0))
        growth = np.vstack([solved.Z - Z, farther - sizes]) / (0.5 * np.log1p(_FARTHER))
        powers = np.round(np.median(growth, axis=1))
        if not solved.ok.all() or np.abs(growth - powers[:, None]).max() > _IRREGULAR or not powers[:-1].any():
            return ()
        return tuple(powers.tolist())

    def turns(self, Z: np.ndarray, start: np.ndarray, u: np.ndarray, axis: int) -> np.ndarray:
        """Coordinates of a key (n,) at which two sheets of the manifold meet, from points nearby.

        There the defining equations are singular. Newton's method solves them with their determinant, by differences.
        """
        n, c = len(u), len(Z)
        V = np.vstack([Z, u])
        for _ in range(_TURNS):
            h = 1e-6 * np.concatenate([np.zeros((1, c + 1)), np.eye(c + 1)])
            lanes = (V[:, None, :] + h.T[:, :, None]).reshape(c + 1, -1)
            at = np.tile(start, (len(h), 1))
            at[:, axis] = lanes[-1]
            values = defining_system(self.problem(at), self.kind, lanes[:-1], self.target).reshape(c + 1, len(h), n)
            J = (values[:, 1:] - values[:, :1]) / 1e-6
            change = -np.linalg.solve(J.transpose(2, 0, 1), values[:, 0].T[:, :, None])[:, :, 0].T
            if not (np.abs(change) < 0.5).all():
                break
            V = V + change
            if np.abs(change).max() < 1e-8:
                return np.asarray(V[-1])
        raise Refused(f"a {self.kind} is lost where it counts", axis)

    def measured(self, manifold: Manifold) -> Manifold:
        """The manifold with what is measured at random points."""
        unit = self.drawn(manifold)
        guess, rows = manifold.predict(unit)
        problem = self.problem(unit)
        first = newton_step(problem, self.kind, guess, rows, self.target).change
        moved = np.abs(first).max(axis=0)
        if not moved.max() < 0.1:
            return manifold
        solved = solve(problem, self.kind, guess, self.target, rows)
        if not solved.ok.all():
            return manifold
        Z = solved.Z
        displaced = Z + _DISPLACED * np.sign(self.box.draw(Z.shape[1], len(Z), "displaced")).T
        off = displaced + newton_step(problem, self.kind, displaced, rows, self.target).change - Z
        own = np.abs(guess + first - Z).max(axis=0)
        return replace(
            manifold,
            moved=float(moved.max()),
            linear=float((own / np.maximum(moved, LEAST)).max()),
            quadratic=float(np.abs(off).max() / _DISPLACED**2),
        )
