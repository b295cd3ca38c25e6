"""Where curves of gaits pass values of a measure: branches over the slope, and gaits at a
fixed slope over a key.

Measures are sampled along a curve's polynomials, so that a value is bracketed wherever
two samples lie on either side of it; their extremes between samples are sampled too.
Newton's method on the gait's equations and the measure together goes on from there.

In shapes, n counts lanes, u the unknowns of a gait on the curve
(`tasks.branches.equations`), s samples and v values.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gaitsweep.tasks.branches.branch import Branch
from gaitsweep.tasks.branches.conditions import Condition
from gaitsweep.tasks.branches.equations import Equations, correct_on_curve, solve
from gaitsweep.tasks.branches.pseudo_arclength import Point
from gaitsweep.tasks.branches.root import bracketed_root, hermite
from gaitsweep.tasks.gaits.step_check import LONG_BELOW, gait_ratio
from gaitsweep.tasks.mechanics.arrays import Coordinates
from gaitsweep.tasks.mechanics.sums import norm
from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.step.sameness import SAME_GAIT, same
from gaitsweep.tasks.step.several_steps import from_largest

#: Samples of a measure between two nodes of a curve.
_PARTS = 4
#: How often extremes between samples are sampled.
_REFINED = 2
#: What a gait that is located may lack of a value, over what the samples that bracket it
#: do: it has no value where the scalar jumps.
_LEFT = 1e-3
#: What a value of a measure, over its size there, or the last unknown differs by from an
#: end of its range that is rounding.
_ROUNDING = 1e-10
#: How far a gait may lie from the samples that bracket it, over their distance.
_NEAR = 1.5


#: Step after which a gait is solved once more, and how often.
_LAST_STEP, _AGAIN = 1e-10, 3


@dataclass(frozen=True)
class Curve:
    """A curve of gaits.

    Attributes
    ----------
    equations : Equations
        Of the gaits, which leave one freedom.
    nodes : int
        Number of its nodes.
    at : callable
        Its points (u, n) at places (n,), numbers of nodes and shares of the way to the
        next, by polynomials.
    """

    equations: Equations
    nodes: int
    at: Callable[[np.ndarray], Coordinates]

    @classmethod
    def of_branch(cls, problem: Problem, branch: Branch) -> Curve:
        """Return a branch of gaits over the slope."""
        return cls(Equations(problem), len(branch.q), branch.at)._from_largest()

    def between(self, first: int, last: int) -> Curve:
        """Return the part of the curve from one of its nodes to another."""
        return replace(
            self, nodes=last - first + 1, at=lambda place: self.at(first + place)
        )

    @classmethod
    def of_points(
        cls, equations: Equations, points: np.ndarray, tangents: np.ndarray
    ) -> Curve:
        """Return a curve by its points and the tangents there, both (p, u)."""
        lengths = np.linalg.norm(np.diff(points, axis=0), axis=1)

        def at(place: np.ndarray) -> Coordinates:
            k = np.minimum(place.astype(int), len(lengths) - 1)
            share = place - k
            before = points[k].T, tangents[k].T
            after = points[k + 1].T, tangents[k + 1].T
            return hermite(before, after, lengths[k], share)

        return cls(equations, len(points), at)._from_largest()

    def _from_largest(self) -> Curve:
        """The curve with every gait begun at the step with the largest stance angle, of
        which those of several steps have some measures.
        """
        problem = self.equations.problem
        joint = problem.m + problem.phases

        def at(place: np.ndarray) -> Coordinates:
            gait, others = np.split(self.at(place), [joint])
            return np.vstack([from_largest(gait, problem.m, problem.steps), others])

        return self if problem.steps == 1 else replace(self, at=at)


@dataclass(frozen=True)
class Sampled:
    """A scalar of gaits along a curve of them, such as a measure.

    Attributes
    ----------
    curve : Curve
    condition : Condition
        That the scalar has a value.
    place, values : ndarray, shape (s,)
        Where it is sampled, in order, and its values.
    is_long : ndarray of bool, shape (s,)
        Whether the gaits there are long ones.
    X : ndarray, shape (u, s)
        Points of the curve's polynomials there.
    """

    curve: Curve
    condition: Condition
    place: np.ndarray
    values: np.ndarray
    is_long: np.ndarray
    X: Coordinates

    @classmethod
    def of(cls, curve: Curve, condition: Condition) -> Sampled:
        """Sample a condition's scalar along a curve, its extremes among the samples."""
        (sampled,) = cls.of_each(curve, [condition])
        return sampled

    @classmethod
    def of_each(cls, curve: Curve, conditions: Sequence[Condition]) -> list[Sampled]:
        """Sample the scalars of several conditions, as `of` does that of one; of none
        nothing is evaluated.
        """
        if not conditions:
            return []

        last = curve.nodes - 1
        place = np.linspace(0.0, last, _PARTS * last + 1)
        return [each._refined() for each in cls._at(curve, conditions, place)]

    @classmethod
    def _at(
        cls, curve: Curve, conditions: Sequence[Condition], place: np.ndarray
    ) -> list[Sampled]:
        """The scalars of conditions at the same places."""
        X = curve.at(place)
        evaluated = curve.equations.evaluate(X)
        is_long = gait_ratio(evaluated.stride) < LONG_BELOW
        return [
            cls(curve, condition, place, condition.value(evaluated), is_long, X)
            for condition in conditions
        ]

    def _refined(self) -> Sampled:
        """The samples with those of extremes between them."""
        sampled = self
        for _ in range(_REFINED):
            vertices = np.setdiff1d(sampled._vertices(), sampled.place)
            if len(vertices):
                (more,) = self._at(self.curve, [self.condition], vertices)
                sampled = sampled._with(more)
        return sampled

    def _with(self, other: Sampled) -> Sampled:
        """The samples of both."""
        place = np.concatenate([self.place, other.place])
        values = np.concatenate([self.values, other.values])
        is_long = np.concatenate([self.is_long, other.is_long])
        X = np.hstack([self.X, other.X])

        both = replace(self, place=place, values=values, is_long=is_long, X=X)
        return both._some(np.argsort(place))

    def _some(self, some: np.ndarray) -> Sampled:
        """Some of the samples, by their numbers or a mask."""
        return replace(
            self,
            place=self.place[some],
            values=self.values[some],
            is_long=self.is_long[some],
            X=self.X[:, some],
        )

    # A measure may be infinite: the friction that a contact needs which would pull.
    @np.errstate(invalid="ignore")
    def _vertices(self) -> np.ndarray:
        """Places of the vertices of parabolas through extreme samples and their
        neighbours.
        """
        step = np.diff(self.place)
        rate = np.diff(self.values) / step
        before = np.flatnonzero(rate[1:] * rate[:-1] < 0)
        after = before + 1

        bend = (rate[after] - rate[before]) / (step[before] + step[after])
        rate_there = rate[before] + bend * step[before]
        vertex = self.place[after] - rate_there / (2 * bend)
        return np.asarray(vertex)

    @property
    def size(self) -> float:
        """Largest size of the measure along the curve."""
        sizes = np.abs(self.values[np.isfinite(self.values)])
        return float(sizes.max(initial=0.0))

    @np.errstate(invalid="ignore")
    def reached(
        self, low: float, high: float, label: str = ""
    ) -> tuple[float, float] | None:
        """Return the least and the largest value.

        Parameters
        ----------
        low, high : float
            Range of the last unknown, which varies along the curve.
        label : str
            `long` or `short` for the values of such gaits only.

        Returns
        -------
        (float, float) or None
            None where there are no such gaits.
        """
        varied = self.X[-1]
        inside = (varied >= low) & (varied <= high)
        values = [self.values[inside]]
        is_long = [self.is_long[inside]]
        for edge in (low, high):
            # Linear between the samples on either side of an edge.
            off = varied - edge
            k = np.flatnonzero(off[1:] * off[:-1] < 0)
            share = off[k] / (off[k] - off[k + 1])
            rise = self.values[k + 1] - self.values[k]
            values.append(self.values[k] + share * rise)
            is_long.append(self.is_long[k])

        every = np.concatenate(values)
        some = np.isfinite(every)
        if label:
            has_label = np.concatenate(is_long) == (label == "long")
            some &= has_label

        if not some.any():
            return None

        every = every[some]
        return float(every.min()), float(every.max())

    def passes(self, wanted: np.ndarray) -> Passed:
        """Return the gaits at which the scalar has some values.

        Parameters
        ----------
        wanted : ndarray, shape (v,)

        Notes
        -----
        Along the curve Newton's method is the secant method, from the two samples that
        bracket a value; across it the gait's equations have exact derivatives.
        """
        # Where the scalar has no value its neighbours are compared.
        numbers = np.flatnonzero(~np.isnan(self.values))
        known = self._some(numbers)
        value, k = known._brackets(wanted)
        if not len(value):
            return Passed(value, np.empty(0), self.X[:, :0])

        place, X, ok = known._solved(k, wanted[value])
        # Newton's method may lead to where it has none.
        ok &= np.diff(numbers)[k] == 1
        for lane in np.flatnonzero(~ok).tolist():
            located = known._locate(k[lane], wanted[value[lane]])
            X[:, lane] = located
            ok[lane] = np.isfinite(located).all()

        ok &= ~_are_twins(value, X, ok)
        return Passed(value[ok], place[ok], X[:, ok])

    def passes_target(self) -> Passed:
        """Return the gaits at which the condition is fulfilled."""
        return self.passes(np.array([self.condition.target]))

    def _solved(
        self, k: np.ndarray, wanted: np.ndarray
    ) -> tuple[np.ndarray, Coordinates, np.ndarray]:
        """About where gaits with values (n,) lie between samples and those that follow
        them, the gaits (u, n), and which are solved.
        """
        chord = self.X[:, k + 1] - self.X[:, k]
        length = norm(chord)
        rise = self.values[k + 1] - self.values[k]
        share = (wanted - self.values[k]) / rise
        step = self.place[k + 1] - self.place[k]
        place = self.place[k] + share * step

        condition = self.condition.equal_to(wanted)
        equations = self.curve.equations.having([condition])
        secant = chord * (rise / length**2)
        X, ok = _solve(equations, self.curve.at(place), secant)
        ok &= self._is_between(k, X, _NEAR * length)
        return place, X, ok

    def _locate(self, k: int, wanted: float) -> np.ndarray:
        """The gait (u,) with a value between a sample and the next, by bisection and
        interpolation along the curve; NaN where corrected gaits do not bracket it, or
        where the measure changes its sign through infinity or jumps.

        Where a measure changes much more across a curve than along it, Newton's method
        fails.
        """
        before = self.X[:, [k]]
        after = self.X[:, [k + 1]]
        chord = after - before

        def corrected(place: float) -> Coordinates:
            guess = self.curve.at(np.array([place]))
            point = correct_on_curve(self.curve.equations, guess, chord)
            return np.where(point.ok, point.Z, np.nan)

        def off(place: float) -> float:
            at = self.curve.equations.evaluate(corrected(place))
            return float(self.condition.value(at)[0]) - wanted

        try:
            place = bracketed_root(off, self.place[k], self.place[k + 1])
        except ValueError:
            return np.full(len(chord), np.nan)

        ends = np.abs(self.values[k : k + 2] - wanted)
        is_near = abs(off(place)) <= _LEFT * ends.max()
        if not is_near:
            return np.full(len(chord), np.nan)

        return corrected(place)[:, 0]

    def _is_between(
        self, k: np.ndarray, X: Coordinates, within: np.ndarray
    ) -> np.ndarray:
        """Whether gaits lie near samples and near those that follow them, shape (n,)."""
        from_before = norm(X - self.X[:, k])
        from_after = norm(X - self.X[:, k + 1])
        farther = np.maximum(from_before, from_after)
        return np.asarray(farther < within)

    def _are_at_ends(self, wanted: np.ndarray) -> np.ndarray:
        """Whether the ends of the curve have values (v,) that they miss by rounding, shape
        (v, 2).
        """
        ends = self.values[[0, -1]]
        beside = self.values[[1, -2]]
        off = ends - wanted[:, None]

        # Over the sizes there: elsewhere the measure may grow without bound.
        sizes = np.abs(np.stack([ends, beside]))
        sizes[np.isinf(sizes)] = 0.0
        there = sizes.max(axis=0)
        size = np.maximum(there, np.abs(wanted)[:, None])

        return np.asarray(np.abs(off) <= _ROUNDING * size)

    def _brackets(self, wanted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Numbers of the values that lie between a sample and the next, and those
        samples.
        """
        if len(self.values) < 2:
            none = np.empty(0, int)
            return none, none

        side = np.sign(self.values - wanted[:, None])
        side[:, [0, -1]] *= ~self._are_at_ends(wanted)

        # A sample that has a value ends two brackets, of which one may lead to it.
        is_passed = side[:, 1:] * side[:, :-1] <= 0
        is_passed &= side[:, 1:] != side[:, :-1]

        is_finite = np.isfinite(self.values)
        is_passed &= is_finite[1:]
        is_passed &= is_finite[:-1]

        value, k = np.nonzero(is_passed)
        return value, k


def _solve(
    equations: Equations, guess: Coordinates, secant: Coordinates
) -> tuple[Coordinates, np.ndarray]:
    """Solve by Newton's method, along curves by the secant method. Returns the gaits
    (u, n), and which are solved.

    Beside extremes of the measure the secant method comes slowly nearer: gaits go on
    from where they are.
    """
    found = solve(equations, guess, secant)
    for _ in range(_AGAIN):
        far = np.flatnonzero(found.ok & (found.last_step > _LAST_STEP))
        if not len(far):
            break

        some = _of_lanes(equations, far)
        again = solve(some, found.Z[:, far], found.rows[:, far])
        # Where a step of rounding fails, the gait is as near as it comes.
        again.last_step[~again.ok] = 0.0
        again.ok[:] = True
        _replace(found, far, again)

    return found.Z, found.ok


def _replace(found: Point, lanes: np.ndarray, other: Point) -> None:
    """Replace what is known of some lanes."""
    found.Z[:, lanes] = other.Z
    found.rows[:, lanes] = other.rows
    found.ok[lanes] = other.ok
    found.last_step[lanes] = other.last_step


def _of_lanes(equations: Equations, lanes: np.ndarray) -> Equations:
    """The equations of some lanes, which have values of their own."""
    (condition,) = equations.conditions
    return equations.some(lanes).having([condition.some(lanes)])


def _are_twins(value: np.ndarray, X: Coordinates, ok: np.ndarray) -> np.ndarray:
    """Which gaits (n,) repeat an earlier one of their value: the one before, or the first
    of a closed curve. Values are sorted.
    """
    n = len(value)
    # Others may lie between the first and the last gait of a closed curve.
    twins = np.zeros(n, bool)
    for lag in range(1, n):
        is_alike = value[lag:] == value[:-lag]
        if not is_alike.any():
            break

        is_alike &= ok[lag:] & ok[:-lag]
        twins[lag:] |= is_alike & same(X[:, lag:], X[:, :-lag], SAME_GAIT)

    return twins


@dataclass(frozen=True)
class Passed:
    """Gaits at which a curve has values of a measure.

    Attributes
    ----------
    value : ndarray of int, shape (n,)
        Numbers of the values.
    place : ndarray, shape (n,)
        About where they lie along the curve.
    X : ndarray, shape (u, n)
    """

    value: np.ndarray
    place: np.ndarray
    X: Coordinates

    def within(self, low: float, high: float) -> Passed:
        """Return those whose last unknown lies in a range, those beyond it by rounding
        moved to its end.
        """
        varied = self.X[-1]
        nearest = np.clip(varied, low, high)
        is_inside = np.abs(varied - nearest) <= _ROUNDING

        X = np.vstack([self.X[:-1], nearest])
        moved = replace(self, X=X)
        return moved.some(is_inside)

    def some(self, some: np.ndarray) -> Passed:
        """Return some of them, by a mask."""
        return Passed(self.value[some], self.place[some], self.X[:, some])
