"""Special points as functions of keys: polynomials that predict a point, and the rows that polish it in one step."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np

from numpy.polynomial.chebyshev import chebfit, chebval

from tasks.continuation.defining import Polish, defining_system, gradient, newton_step, other_multipliers, solve
from tasks.continuation.extremes import Points, classify
from tasks.families.box import Box, roots
from tasks.families.cell import Family, Refused
from tasks.families.patch import basis, fit, tails
from tasks.fixed_points.step_check import verify_steps
from tasks.mechanics.lumped import Structure
from tasks.step.problem import Lanes
from tasks.step.step_map import SAMPLES

#: Nodes along each key; there are more while predictions of points drawn by lot err by more than what is good.
_SIZES, _GOOD = (5, 7, 9, 13, 17, 25, 33), 1e-6
#: Predictions of a manifold that is of use err by no more.
_FAIR = 1e-4
_DRAWN = 24
#: First and least share of the way in which a point is carried from one design to another, and largest error of a
#: prediction on it.
_STRIDE, _LEAST_STRIDE, _MAX_STRIDE_ERROR = 0.125, 1 / 256, 0.3
#: A point may lie so many times farther from its prediction than any drawn one; its error is so many times theirs.
_SAFETY = 8.0
#: Predictions err by no less: below this is rounding.
_LEAST = 1e-9
#: Error above which a further Newton step is taken.
_GOAL = 1e-10
#: Distance from an end at which its gaits must be steps, and displacement that shows how Newton's method converges.
_INSIDE, _DISPLACED = 1e-3, 1e-4
#: A manifold that is not on the whole box is followed in such steps of a key until its points are of no account, and a
#: little farther; where along the other key, and the degree of the curve at which it is cut.
_FARTHEST, _BEYOND, _PLACES, _DEGREE = 3.0, 0.1, 13, 4
#: Newton steps to a turn.
_TURNS = 12
#: Beside a turn designs are surveyed, this share of the way to it.
_AT_TURN = 1e-5


@dataclass(frozen=True)
class Cut:
    """The border of a manifold inside a box: it lies on one side of a curve along the other key.

    Attributes
    ----------
    axis : int
        The key along which it ends.
    side : int
        1 if it ends towards higher values, else -1.
    coefficients : ndarray, shape (n,)
        Chebyshev coefficients of the coordinate at which it ends over that of the other key.
    turns : bool
        Whether two sheets meet there: beside it points depend on the root of the distance.
    """

    axis: int
    side: int
    coefficients: np.ndarray
    turns: bool

    def at(self, unit: np.ndarray) -> np.ndarray:
        """Coordinates at which the manifold ends, shape (n,), for coordinates of keys (n, d)."""
        other = np.delete(unit, self.axis, axis=1)
        return np.asarray(chebval(other[:, 0] if other.shape[1] else np.zeros(len(unit)), self.coefficients))

    def own(self, unit: np.ndarray) -> np.ndarray:
        """Coordinates that run from -1 to 1 over the manifold, shape (n, d), of coordinates of keys."""
        own, share = unit.copy(), self.share(unit)
        if self.turns:
            share = 1 - np.sqrt(np.maximum(1 - share, 0.0))
        own[:, self.axis] = self.side * (2 * share - 1)
        return own

    def unit(self, own: np.ndarray) -> np.ndarray:
        """Inverse of `own`."""
        unit, share = own.copy(), 0.5 * (1 + self.side * own[:, self.axis])
        if self.turns:
            share = 1 - (1 - share) ** 2
        unit[:, self.axis] = self.side * (share * (1 + self.side * self.at(own)) - 1)
        return unit

    def share(self, unit: np.ndarray) -> np.ndarray:
        """Share of the way from the box's own border to the curve, shape (n,), at coordinates of keys (n, d)."""
        return np.asarray((1 + self.side * unit[:, self.axis]) / (1 + self.side * self.at(unit)))


@dataclass(frozen=True)
class Manifold:
    """Special points of one kind in a box of keys.

    Attributes
    ----------
    kind : str
    target : float
        As `tasks.continuation.defining.scalar` has it.
    sizes : tuple of int
        Nodes along each key.
    coefficients : ndarray, shape (product of sizes, 2 c)
        Of Z and of the derivatives of the kind's scalar.
    moved : float
        Largest Newton step from predictions at points drawn by lot.
    linear, quadratic : float
        Largest error after a Newton step, over the step and over its square.
    cut : Cut or None
        Where it ends inside the box.
    ratio : tuple of float
        For each key how many times faster the polynomials' own coordinate grows at the box's upper end than at its
        lower: in boxes whose coordinates are logarithms some points depend more smoothly on the keys themselves.
    """

    kind: str
    target: float
    sizes: tuple[int, ...]
    coefficients: np.ndarray
    moved: float = np.inf
    linear: float = 0.0
    quadratic: float = 0.0
    cut: Cut | None = None
    ratio: tuple[float, ...] = ()

    def own(self, unit: np.ndarray) -> np.ndarray:
        """Coordinates of the polynomials, shape (n, d), for coordinates of keys."""
        own = self.cut.own(unit) if self.cut else unit
        r = np.array(self.ratio or 1.0)
        with np.errstate(invalid="ignore"):
            return np.where(r == 1, own, 2 * (r ** (0.5 * (1 + own)) - 1) / (r - 1) - 1)

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
        both = (basis(self.own(unit), self.sizes) @ self.coefficients).T
        return both[: len(both) // 2], both[len(both) // 2 :]

    def there(self, unit: np.ndarray) -> np.ndarray:
        """Whether designs, coordinates of keys (n, d), have a point of the manifold."""
        return self.cut.share(unit) <= 1 if self.cut else np.ones(len(unit), bool)

    def unsure(self, unit: np.ndarray) -> np.ndarray:
        """Whether designs, coordinates of keys (n, d), lie where two sheets of the manifold meet."""
        turns = self.cut is not None and self.cut.turns
        return np.abs(self.cut.share(unit) - 1) < _AT_TURN if turns and self.cut else np.zeros(len(unit), bool)

    def polish(self, problem: Lanes, unit: np.ndarray) -> tuple[Points, np.ndarray]:
        """Solve the points of designs by a Newton step from their predictions; of each it is `there`.

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
        near = size <= _SAFETY * max(self.moved, _LEAST)
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
        """Walkers at coordinates of keys, shape (n, d)."""
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
        nodes = self.nodes(sizes)
        _, ok = self.carried(kind, target, unit, Z, nodes)
        cut = None if ok.all() else self.cut(kind, target, unit, Z, nodes[~ok])
        ratios = [(), *([self.box.ratio] if self.box.ratio else [])]
        tries = [
            self.through(kind, target, sizes, self.at_nodes(kind, target, sizes, cut, ratio, seed), cut, ratio)
            for ratio in ratios
        ]
        manifold = min(tries, key=lambda one: one.moved)
        ratio = manifold.ratio
        while manifold.moved > _GOOD:
            tail = tails(manifold.coefficients[:, : len(Z)], sizes)
            larger = tuple(
                _SIZES[min(_SIZES.index(n) + int(t > 0.1 * min(_GOOD, tail.max())), len(_SIZES) - 1)]
                for n, t in zip(sizes, tail, strict=True)
            )
            if larger == sizes:
                break
            sizes = larger
            at = self.at_nodes(kind, target, sizes, cut, ratio, seed, manifold)
            manifold = self.through(kind, target, sizes, at, cut, ratio)
        if not manifold.moved < _FAIR:
            tail = tails(manifold.coefficients[:, : len(Z)], sizes)
            raise Refused(f"predictions of a {kind} err by {manifold.moved:.1g}", int(np.argmax(tail)))
        return manifold

    def nodes(self, sizes: tuple[int, ...], cut: Cut | None = None, ratio: tuple[float, ...] = ()) -> np.ndarray:
        """Coordinates of keys at the nodes of a manifold, shape (n, d)."""
        own = np.array(list(itertools.product(*map(roots, sizes))))
        r = np.array(ratio or 1.0)
        with np.errstate(invalid="ignore", divide="ignore"):
            own = np.where(r == 1, own, 2 * np.log(1 + 0.5 * (r - 1) * (1 + own)) / np.log(r) - 1)
        return cut.unit(own) if cut else own

    def at_nodes(
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
        nodes = self.nodes(sizes, cut, ratio)
        Z, ok = np.zeros((len(seed[1]), len(nodes))), np.zeros(len(nodes), bool)
        if known is not None:
            guess, rows = known.predict(nodes)
            solved = solve(self.problem(nodes), kind, guess, target, rows)
            Z, ok = solved.Z, solved.ok & (np.abs(solved.Z - guess).max(axis=0) < 0.3)
        if not ok.all():
            Z[:, ~ok], ok[~ok] = self.carried(kind, target, *seed, nodes[~ok])
        if not ok.all():
            lost = nodes[~ok] - seed[0]
            raise Refused(f"a {kind} is lost on its way to {len(lost)} nodes", int(np.abs(lost).sum(axis=0).argmax()))
        return Z

    def carried(
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

    def cut(self, kind: str, target: float, unit: np.ndarray, Z: np.ndarray, lost: np.ndarray) -> Cut:
        """The curve at which a manifold is cut, which does not extend to some designs, `lost` (n, d)."""
        axis = int(np.abs(np.mean(lost - unit, axis=0)).argmax())
        side = 1 if np.mean(lost[:, axis]) > unit[axis] else -1
        start = np.zeros((_PLACES if self.d == 2 else 1, self.d))
        if self.d == 2:
            start[:, 1 - axis] = roots(_PLACES)
        start[:, axis] = -side
        here, ok = self.carried(kind, target, unit, Z, start)
        if not ok.all():
            raise Refused(f"a {kind} is lost on its way to {(~ok).sum()} designs", 1 - axis if self.d == 2 else axis)
        other = start[:, 1 - axis] if self.d == 2 else start[:, 0]
        ends, where, turned = self.followed(kind, target, here, start, axis, side)
        if turned.all():
            ends = self.turns(kind, target, where, start, ends, axis)
            curve = chebfit(other, ends, len(ends) - 1)
            if np.abs(curve[-2:]).max() > 1e-6 * (len(ends) > 1):
                raise Refused(f"a {kind} turns along a curve that is not smooth", 1 - axis)
            return Cut(axis, side, curve, True)
        if turned.any():
            raise Refused(f"a {kind} ends in two ways", 1 - axis)
        curve = chebfit(other, ends, min(_DEGREE, len(ends) - 1))
        curve[0] += side * (np.abs(chebval(other, curve) - ends).max() + _BEYOND)
        return Cut(axis, side, curve, False)

    def followed(
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
            stable = other_multipliers(kind, solved.at.stride.jacobian)[fair] < 1
            ended[new] = counts[new] & ~stable
            counts[new] |= stable
            stride[new] = np.minimum(0.1, 1.5 * stride[new])
            stride[active[~fair]] *= 0.4
            turned[active] = stride[active] < 1e-4
            if (np.abs(u) > _FARTHEST).any():
                raise Refused(f"a {kind} counts far beyond the box", 1 - axis if self.d == 2 else axis)
            active = active[~ended[active] & ~turned[active]]
        return u, here, turned

    def turns(
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

    def through(
        self,
        kind: str,
        target: float,
        sizes: tuple[int, ...],
        Z: np.ndarray,
        cut: Cut | None = None,
        ratio: tuple[float, ...] = (),
    ) -> Manifold:
        """The manifold through points at its nodes, with what is measured at points drawn by lot."""
        rows = gradient(self.problem(self.nodes(sizes, cut, ratio)), kind, Z)
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
            linear=float((own / np.maximum(moved, _LEAST)).max()),
            quadratic=float(np.abs(off).max() / _DISPLACED**2),
        )
