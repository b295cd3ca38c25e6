"""Special points as functions of keys: polynomials that predict a point, and the rows that polish it in one step."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from numpy.polynomial.chebyshev import chebfit, chebval

from tasks.continuation.defining import Polish, gradient, newton_step, other_multipliers, solve
from tasks.continuation.extremes import Points, classify, join, nothing
from tasks.families.box import Box, roots
from tasks.families.cell import Family, Refused
from tasks.families.patch import basis, fit, tails
from tasks.fixed_points.step_check import verify_steps
from tasks.mechanics.lumped import Structure
from tasks.step.problem import Lanes
from tasks.step.step_map import SAMPLES, matvec

#: Nodes along each key; there are more while predictions of points drawn by lot err by more than what is good.
_SIZES, _GOOD = (5, 7, 9, 13, 17, 25, 33), 1e-6
#: Predictions of a manifold that is of use err by no more.
_FAIR = 1e-4
_DRAWN = 24
#: Newton steps that take drawn points from their predictions to rounding.
_STEPS = 8
#: First and least share of the way in which a point is carried from one design to another, and largest error of a
#: prediction on it.
_STRIDE, _LEAST_STRIDE, _MAX_STRIDE_ERROR = 0.125, 1 / 256, 0.3
#: A point may lie so many times farther from its prediction than any drawn one; its error is so many times theirs.
_SAFETY = 8.0
#: Predictions err by no less: below this is rounding.
_LEAST = 1e-9
#: Distance from an end at which its gaits must be steps, and displacement that shows how Newton's method converges.
_INSIDE, _DISPLACED = 1e-3, 1e-4
#: A manifold that is not on the whole box is followed in such steps of a key until its points are of no account, and a
#: little farther; where along the other key, and the degree of the curve at which it is cut.
_PACE, _BEYOND, _PLACES, _DEGREE = 0.05, 0.1, 9, 4


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
    """

    axis: int
    side: int
    coefficients: np.ndarray

    def at(self, unit: np.ndarray) -> np.ndarray:
        """Coordinates at which the manifold ends, shape (n,), for coordinates of keys (n, d)."""
        other = np.delete(unit, self.axis, axis=1)
        return np.asarray(chebval(other[:, 0] if other.shape[1] else np.zeros(len(unit)), self.coefficients))

    def own(self, unit: np.ndarray) -> np.ndarray:
        """Coordinates that run from -1 to 1 over the manifold, shape (n, d), of coordinates of keys."""
        own = unit.copy()
        own[:, self.axis] = 2 * (unit[:, self.axis] + self.side) / (self.at(unit) + self.side) - self.side
        return own

    def unit(self, own: np.ndarray) -> np.ndarray:
        """Inverse of `own`."""
        unit = own.copy()
        unit[:, self.axis] = 0.5 * (own[:, self.axis] + self.side) * (self.at(own) + self.side) - self.side
        return unit


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
    """

    kind: str
    target: float
    sizes: tuple[int, ...]
    coefficients: np.ndarray
    moved: float = np.inf
    linear: float = 0.0
    quadratic: float = 0.0
    cut: Cut | None = None

    def own(self, unit: np.ndarray) -> np.ndarray:
        """Coordinates of the polynomials, shape (n, d), for coordinates of keys."""
        return self.cut.own(unit) if self.cut else unit

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

    def polish(self, problem: Lanes, unit: np.ndarray) -> tuple[Points, np.ndarray]:
        """Solve the points of designs by one Newton step from their predictions.

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
        if self.cut is not None:
            beyond = np.abs(self.own(unit)[:, self.cut.axis]) > 1 + 1e-9
            if beyond.any():
                return self._within(problem, unit, np.flatnonzero(~beyond))
        Z, rows = self.predict(unit)
        step = newton_step(problem, self.kind, Z, rows, self.target, samples=0 if _is_end(self.kind) else SAMPLES)
        size = np.abs(step.change).max(axis=0)
        near = size <= _SAFETY * max(self.moved, _LEAST)
        error = _SAFETY * (self.linear * size + self.quadratic * size**2) + step.rounding
        walks = _walks(problem, self.kind, step, rows, near)
        points = classify(self.kind, step.at, np.arange(len(unit)), Z + step.change, rows, error, walks)
        return points, near

    def _within(self, problem: Lanes, unit: np.ndarray, there: np.ndarray) -> tuple[Points, np.ndarray]:
        """As `polish` for designs of which only some have a point; those of the others do not walk."""
        near = np.ones(len(unit), bool)
        points = nothing(problem, 0)
        if len(there):
            points, near[there] = self.polish(problem.some(there), unit[there])
            points.line = there[points.line]
        absent = nothing(problem, len(unit) - len(there))
        absent.line = np.setdiff1d(np.arange(len(unit)), there)
        joined = join([points, absent])
        return joined.some(np.argsort(joined.line, kind="stable")), near


def _is_end(kind: str) -> bool:
    return kind.startswith("end_")


def _walks(problem: Lanes, kind: str, step: Polish, rows: np.ndarray, near: np.ndarray) -> np.ndarray:
    """Whether special points are steps whose legs pass once, or, of an end, the gaits just before it."""
    m, walks, lanes = problem.m, np.zeros(len(near), bool), np.flatnonzero(near)
    if not len(lanes):
        return walks
    Z = step.at.Z[:, lanes] + step.change[:, lanes]
    stride = None
    if _is_end(kind):
        _, _, V = np.linalg.svd(step.at.derivative[lanes])
        null = V[:, -1].T
        along = np.vstack([null[: m + 1], matvec(step.at.times_by[:, :, lanes], null)])
        # Before the end kneestrike precedes heelstrike; the foot falls as it strikes.
        inside = np.sign((rows[:, lanes] * along).sum(axis=0)) * (1 if "kneestrike_at" in kind else -1)
        Z = Z + _INSIDE * inside * along / np.linalg.norm(along, axis=0)
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
        self.d = len(box.keys)

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
        sizes = (_SIZES[0],) * self.d
        nodes = self.box.unit(self.box.nodes(sizes))
        at, ok = self.carried(kind, target, unit, Z, nodes)
        cut = None if ok.all() else self.cut(kind, target, unit, Z, nodes[~ok])
        seed = unit, Z
        if cut:
            at = self.at_nodes(kind, target, sizes, cut, seed)
        manifold = self.through(kind, target, sizes, at, cut)
        while manifold.moved > _GOOD:
            tail = tails(manifold.coefficients[:, : len(Z)], sizes)
            larger = tuple(
                _SIZES[min(_SIZES.index(n) + int(t > 0.1 * min(_GOOD, tail.max())), len(_SIZES) - 1)]
                for n, t in zip(sizes, tail, strict=True)
            )
            if larger == sizes:
                break
            sizes = larger
            manifold = self.through(kind, target, sizes, self.at_nodes(kind, target, sizes, cut, seed, manifold), cut)
        if not manifold.moved < _FAIR:
            tail = tails(manifold.coefficients[:, : len(Z)], sizes)
            raise Refused(f"predictions of a {kind} err by {manifold.moved:.1g}", int(np.argmax(tail)))
        return manifold

    def nodes(self, sizes: tuple[int, ...], cut: Cut | None) -> np.ndarray:
        """Coordinates of keys at the nodes of a manifold, shape (n, d)."""
        own = self.box.unit(self.box.nodes(sizes))
        return cut.unit(own) if cut else own

    def at_nodes(
        self,
        kind: str,
        target: float,
        sizes: tuple[int, ...],
        cut: Cut | None,
        seed: tuple[np.ndarray, np.ndarray],
        known: Manifold | None = None,
    ) -> np.ndarray:
        """Points at the nodes, shape (c, n), from a coarser manifold, or else carried from a seed."""
        nodes = self.nodes(sizes, cut)
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
        ends = np.full(len(start), np.nan)
        rows, rate = gradient(self.problem(start), kind, here), np.zeros_like(here)
        active, counts = np.arange(len(start)), np.zeros(len(start), bool)
        for k in range(round(3 / _PACE)):
            at = start[active].copy()
            at[:, axis] += side * k * _PACE
            solved = solve(self.problem(at), kind, here[:, active] + rate[:, active], target, rows[:, active])
            if not solved.ok.all():
                raise Refused(f"a {kind} is lost where it counts", axis)
            stable = other_multipliers(kind, solved.at.stride.jacobian) < 1
            counts[active] |= stable
            rate[:, active] = (solved.Z - here[:, active]) * (k > 0)
            here[:, active], rows[:, active] = solved.Z, solved.rows
            ended = counts[active] & ~stable
            ends[active[ended]] = at[ended, axis]
            active = active[~ended]
            if not len(active):
                break
        else:
            raise Refused(f"a {kind} counts beyond the box", 1 - axis if self.d == 2 else axis)
        degree = min(_DEGREE, len(ends) - 1)
        curve = chebfit(start[:, 1 - axis] if self.d == 2 else start[:, 0], ends, degree)
        values = chebval(start[:, 1 - axis] if self.d == 2 else start[:, 0], curve)
        curve[0] += side * (np.abs(values - ends).max() + _BEYOND)
        return Cut(axis, side, curve)

    def converged(
        self, kind: str, target: float, unit: np.ndarray, Z: np.ndarray, rows: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Points (c, n) to rounding from predictions, and the first Newton step (n,) that leads to them."""
        problem, first, guess = self.problem(unit), None, Z
        for _ in range(_STEPS):
            change = newton_step(problem, kind, Z, rows, target).change
            size = np.abs(change).max(axis=0)
            if not (size < 0.3).all():
                raise Refused(f"a {kind} does not converge at {(~(size < 0.3)).sum()} of {len(unit)} designs")
            Z, first = Z + change, size if first is None else first
            if size.max() < 1e-13:
                break
        if size.max() > 1e-9 or np.abs(Z - guess).max() > 0.3:
            raise Refused(f"a {kind} does not converge")
        assert first is not None
        return Z, first

    def through(self, kind: str, target: float, sizes: tuple[int, ...], Z: np.ndarray, cut: Cut | None) -> Manifold:
        """The manifold through points at its nodes, with what is measured at points drawn by lot."""
        rows = gradient(self.problem(self.nodes(sizes, cut)), kind, Z)
        manifold = Manifold(kind, target, sizes, fit(np.vstack([Z, rows]).T, sizes), cut=cut)
        unit = self.box.draw(_DRAWN, self.d, f"{kind} {sizes}")
        unit = cut.unit(unit) if cut else unit
        guess, rows = manifold.predict(unit)
        problem = self.problem(unit)
        first = newton_step(problem, kind, guess, rows, target).change
        moved = np.abs(first).max(axis=0)
        if not moved.max() < 0.1:
            return replace(manifold, moved=float(np.nan_to_num(moved, nan=np.inf).max()))
        Z, _ = self.converged(kind, target, unit, guess, rows)
        displaced = Z + _DISPLACED * np.sign(self.box.draw(Z.shape[1], len(Z), "displaced")).T
        off = displaced + newton_step(problem, kind, displaced, rows, target).change - Z
        own = np.abs(guess + first - Z).max(axis=0)
        return replace(
            manifold,
            moved=float(moved.max()),
            linear=float((own / np.maximum(moved, _LEAST)).max()),
            quadratic=float(np.abs(off).max() / _DISPLACED**2),
        )
