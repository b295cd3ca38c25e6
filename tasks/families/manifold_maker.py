"""Makes manifolds of special points: carries a point to nodes in the space of the keys, and finds where they end."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
from numpy.polynomial.chebyshev import chebfit, chebval

from tasks.continuation.defining import defining_system, gradient, newton_step, solve
from tasks.families.box import Box, Refused, roots
from tasks.families.cell import Family
from tasks.families.manifold import LEAST, Cut, Manifold
from tasks.families.patch import fit, tails
from tasks.fixed_points.multipliers import other_multipliers
from tasks.mechanics.lumped import Structure
from tasks.step.problem import Lanes

#: Nodes along each key; there are more while predictions of points drawn by lot err by more than what is good.
_SIZES, _COMPARED, _GOOD = (5, 7, 9, 13, 17, 25, 33), 9, 1e-6
#: Predictions of a manifold that is of use err by no more.
_FAIR = 1e-4
_DRAWN = 24
#: First and least share of the way in which a point is carried from one design to another, and largest error of a
#: prediction on it.
_STRIDE, _LEAST_STRIDE, _MAX_STRIDE_ERROR = 0.125, 1 / 256, 0.3
#: Displacement that shows how Newton's method converges.
_DISPLACED = 1e-4
#: How far a manifold that is not on the whole box is followed along a key, and how far it is kept beyond the place from
#: which its points are of no account; at how many places along the other key, and the degree of that curve.
_FARTHEST, _BEYOND, _PLACES, _DEGREE = 3.0, 0.1, (13, 21), 4
#: Newton steps to a turn, and largest last coefficient of the curve of turns.
_TURNS, _SMOOTH = 12, 1e-6


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
            If it is not smooth enough, or ends in the box in another way than along a curve.
        """
        sizes, seed = (_SIZES[0],) * self.d, (unit, Z)
        nodes = self._nodes(sizes)
        _, ok = self._carried(kind, target, unit, Z, nodes)
        cut = None if ok.all() else self._cut(kind, target, unit, Z, nodes[~ok])
        tries = []
        for ratio in [(), self.box.ratio] if self.box.ratio else [()]:
            manifold = self._through(
                kind, target, sizes, self._at_nodes(kind, target, sizes, cut, ratio, seed), cut, ratio
            )
            if self.box.ratio:
                # With so many nodes it shows which coordinate is the better one. Beside a turn poor predictions lead to
                # the other sheet.
                more = (_COMPARED,) * self.d
                at = self._at_nodes(kind, target, more, cut, ratio, seed, None if cut else manifold)
                manifold = self._through(kind, target, more, at, cut, ratio)
            tries.append(manifold)
        manifold = min(tries, key=lambda one: one.moved)
        sizes, ratio = manifold.sizes, manifold.ratio
        while manifold.moved > _GOOD:
            tail = tails(manifold.coefficients[:, : len(Z)], sizes)
            larger = tuple(
                _SIZES[min(_SIZES.index(n) + int(t > 0.1 * min(_GOOD, tail.max())), len(_SIZES) - 1)]
                for n, t in zip(sizes, tail, strict=True)
            )
            if larger == sizes:
                break
            sizes = larger
            at = self._at_nodes(kind, target, sizes, cut, ratio, seed, manifold)
            manifold = self._through(kind, target, sizes, at, cut, ratio)
        if not manifold.moved < _FAIR:
            tail = tails(manifold.coefficients[:, : len(Z)], sizes)
            raise Refused(f"predictions of a {kind} err by {manifold.moved:.1g}", int(np.argmax(tail)))
        return manifold

    def _nodes(self, sizes: tuple[int, ...], cut: Cut | None = None, ratio: tuple[float, ...] = ()) -> np.ndarray:
        """Coordinates of keys at the nodes of a manifold, shape (n, d)."""
        own = np.array(list(itertools.product(*map(roots, sizes))))
        r = np.array(ratio or 1.0)
        with np.errstate(invalid="ignore", divide="ignore"):
            own = np.where(r == 1, own, 2 * np.log(1 + 0.5 * (r - 1) * (1 + own)) / np.log(r) - 1)
        return cut.unit(own) if cut else own

    def _at_nodes(
        self,
        kind: str,
        target: float,
        sizes: tuple[int, ...],
        cut: Cut | None,
        ratio: tuple[float, ...],
        seed: tuple[np.ndarray, np.ndarray],
        known: Manifold | None = None,
    ) -> np.ndarray:
        """Points at the nodes, shape (c, n), from a coarser manifold, or else carried from a seed."""
        nodes = self._nodes(sizes, cut, ratio)
        Z, ok = np.zeros((len(seed[1]), len(nodes))), np.zeros(len(nodes), bool)
        if known is not None:
            guess, rows = known.predict(nodes)
            solved = solve(self.problem(nodes), kind, guess, target, rows)
            Z, ok = solved.Z, solved.ok & (np.abs(solved.Z - guess).max(axis=0) < 0.3)
        if not ok.all():
            Z[:, ~ok], ok[~ok] = self._carried(kind, target, *seed, nodes[~ok])
        if not ok.all():
            lost = nodes[~ok] - seed[0]
            raise Refused(f"a {kind} is lost on its way to {len(lost)} nodes", int(np.abs(lost).sum(axis=0).argmax()))
        return Z

    def _carried(
        self, kind: str, target: float, unit: np.ndarray, Z: np.ndarray, nodes: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Carry a point from one design to others, by continuation along straight lines between the designs.

        Returns
        -------
        Z : ndarray, shape (c, n)
        ok : ndarray of bool, shape (n,)
        """
        n = len(nodes)
        here, rows = np.repeat(Z[:, None], n, axis=1), np.zeros((len(Z), n))
        rows[:] = gradient(self.problem(unit[None]), kind, Z[:, None])
        rate, share, stride = np.zeros_like(here), np.zeros(n), np.full(n, _STRIDE)
        active = np.arange(n)
        while len(active):
            step = np.minimum(stride[active], 1 - share[active])
            problem = self.problem(unit + (share[active] + step)[:, None] * (nodes[active] - unit))
            guess = here[:, active] + step * rate[:, active]
            solved = solve(problem, kind, guess, target, rows[:, active])
            off = np.abs(solved.Z - guess).max(axis=0)
            fair = solved.ok & (off < _MAX_STRIDE_ERROR)
            new = active[fair]
            rate[:, new] = (solved.Z[:, fair] - here[:, new]) / step[fair]
            here[:, new], rows[:, new] = solved.Z[:, fair], solved.rows[:, fair]
            share[new] += step[fair]
            stride[new] *= 1.5
            stride[active[~fair]] *= 0.5
            active = active[(share[active] < 1 - 1e-12) & (stride[active] > _LEAST_STRIDE)]
        return here, share >= 1 - 1e-12

    def _cut(self, kind: str, target: float, unit: np.ndarray, Z: np.ndarray, lost: np.ndarray) -> Cut:
        """The curve at which a manifold is cut, which does not extend to some designs, `lost` (n, d)."""
        axis = int(np.abs(np.mean(lost - unit, axis=0)).argmax())
        side = 1 if np.mean(lost[:, axis]) > unit[axis] else -1
        for places in _PLACES if self.d == 2 else (1,):
            cut = self._cut_along(kind, target, (unit, Z), axis, side, places)
            if not cut.turns or self.d == 1 or np.abs(cut.coefficients[-2:]).max() < _SMOOTH:
                return cut
        raise Refused(f"a {kind} turns along a curve that is not smooth", 1 - axis)

    def _cut_along(
        self, kind: str, target: float, seed: tuple[np.ndarray, np.ndarray], axis: int, side: int, places: int
    ) -> Cut:
        """The curve at which a manifold ends towards one side of a key, by its ends at some places along the other."""
        start = np.zeros((places, self.d))
        if self.d == 2:
            start[:, 1 - axis] = roots(places)
        start[:, axis] = -side
        here, ok = self._carried(kind, target, *seed, start)
        if not ok.all():
            raise Refused(f"a {kind} is lost on its way to {(~ok).sum()} designs", 1 - axis if self.d == 2 else axis)
        other = start[:, 1 - axis] if self.d == 2 else start[:, 0]
        ends, where, turned = self._followed(kind, target, here, start, axis, side)
        if turned.all():
            ends = self._turns(kind, target, where, start, ends, axis)
            return Cut(axis, side, chebfit(other, ends, len(ends) - 1), True)
        if turned.any():
            raise Refused(f"a {kind} ends in two ways", 1 - axis)
        curve = chebfit(other, ends, min(_DEGREE, len(ends) - 1))
        curve[0] += side * (np.abs(chebval(other, curve) - ends).max() + _BEYOND)
        return Cut(axis, side, curve, False)

    def _followed(
        self, kind: str, target: float, here: np.ndarray, start: np.ndarray, axis: int, side: int
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Follow points along one key until they are of no account, or cannot be followed because two sheets meet.

        Returns
        -------
        ends : ndarray, shape (n,)
            Coordinates of the key.
        Z : ndarray, shape (c, n)
        turned : ndarray of bool, shape (n,)
        """
        n = len(start)
        u, here = start[:, axis].copy(), here.copy()
        rows, rate = gradient(self.problem(start), kind, here), np.zeros_like(here)
        stride, counts, ended = np.full(n, 0.02), np.zeros(n, bool), np.zeros(n, bool)
        turned, active = np.zeros(n, bool), np.arange(n)
        while len(active):
            at = start[active].copy()
            at[:, axis] = u[active] + side * stride[active]
            guess = here[:, active] + stride[active] * rate[:, active]
            solved = solve(self.problem(at), kind, guess, target, rows[:, active])
            fair = solved.ok & (np.abs(solved.Z - guess).max(axis=0) < 0.05)
            new = active[fair]
            rate[:, new] = (solved.Z[:, fair] - here[:, new]) / stride[new]
            here[:, new], rows[:, new], u[new] = solved.Z[:, fair], solved.rows[:, fair], at[fair, axis]
            # Gaits of a speed count whether they are stable or not.
            stable = (other_multipliers(kind, solved.at.stride.jacobian)[fair] < 1) | (kind == "speed")
            ended[new] = counts[new] & ~stable
            counts[new] |= stable
            stride[new] = np.minimum(0.1, 1.5 * stride[new])
            stride[active[~fair]] *= 0.4
            turned[active] = stride[active] < 1e-4
            if (np.abs(u) > _FARTHEST).any():
                raise Refused(f"a {kind} counts far beyond the box", 1 - axis if self.d == 2 else axis)
            active = active[~ended[active] & ~turned[active]]
        return u, here, turned

    def _turns(
        self, kind: str, target: float, Z: np.ndarray, start: np.ndarray, u: np.ndarray, axis: int
    ) -> np.ndarray:
        """Coordinates of a key (n,) at which two sheets of a manifold meet, from points nearby.

        There the defining equations are singular. Newton's method solves them with their determinant, by differences.
        """
        n, c = len(u), len(Z)
        V = np.vstack([Z, u])
        for _ in range(_TURNS):
            h = 1e-5 * np.concatenate([np.zeros((1, c + 1)), np.eye(c + 1), -np.eye(c + 1)])
            lanes = (V[:, None, :] + h.T[:, :, None]).reshape(c + 1, -1)
            at = np.tile(start, (len(h), 1))
            at[:, axis] = lanes[-1]
            values = defining_system(self.problem(at), kind, lanes[:-1], target).reshape(c + 1, len(h), n)
            J = (values[:, 1 : c + 2] - values[:, c + 2 :]) / 2e-5
            change = -np.linalg.solve(J.transpose(2, 0, 1), values[:, 0].T[:, :, None])[:, :, 0].T
            if not (np.abs(change) < 0.5).all():
                break
            V = V + change
            if np.abs(change).max() < 1e-8:
                return np.asarray(V[-1])
        raise Refused(f"a {kind} is lost where it counts", axis)

    def _through(
        self,
        kind: str,
        target: float,
        sizes: tuple[int, ...],
        Z: np.ndarray,
        cut: Cut | None = None,
        ratio: tuple[float, ...] = (),
    ) -> Manifold:
        """The manifold through points at its nodes, with what is measured at points drawn by lot."""
        rows = gradient(self.problem(self._nodes(sizes, cut, ratio)), kind, Z)
        manifold = Manifold(kind, target, sizes, fit(np.vstack([Z, rows]).T, sizes), cut=cut, ratio=ratio)
        unit = self.box.draw(_DRAWN, self.d, f"{kind} {sizes}")
        unit = cut.unit(unit) if cut else unit
        guess, rows = manifold.predict(unit)
        problem = self.problem(unit)
        first = newton_step(problem, kind, guess, rows, target).change
        moved = np.abs(first).max(axis=0)
        if not moved.max() < 0.1:
            return manifold
        solved = solve(problem, kind, guess, target, rows)
        if not solved.ok.all():
            return manifold
        Z = solved.Z
        displaced = Z + _DISPLACED * np.sign(self.box.draw(Z.shape[1], len(Z), "displaced")).T
        off = displaced + newton_step(problem, kind, displaced, rows, target).change - Z
        own = np.abs(guess + first - Z).max(axis=0)
        return replace(
            manifold,
            moved=float(moved.max()),
            linear=float((own / np.maximum(moved, LEAST)).max()),
            quadratic=float(np.abs(off).max() / _DISPLACED**2),
        )
