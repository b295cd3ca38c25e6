"""A branch of gaits: nodes with exact tangents and the polynomials between them."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TypeVar

import numpy as np
from numpy import ndarray

from gaitsweep.tasks.branches.pseudo_arclength import NO_FURTHER, TOO_MANY, Point
from gaitsweep.tasks.branches.tracking import MAX_SLOPE, MIN_SLOPE, NOT_A_STEP
from gaitsweep.tasks.contract.kinds import kind_of
from gaitsweep.tasks.gaits.polish import UNKNOWN, Guesses
from gaitsweep.tasks.mechanics.arrays import (
    Coordinates,
    Gait,
    LogSlopes,
    Marks,
    Numbers,
    PerLane,
    Slopes,
)
from gaitsweep.tasks.mechanics.sums import norm, total
from gaitsweep.tasks.step.several_steps import from_largest

#: Nodes of the shortest branch.
MIN_NODES = 3
#: Nodes closer than this are the same: a fold's may differ from its neighbour by
#: rounding only.
_COINCIDENT = 1e-8
#: Kinds that are no true ends: continuation was lost, or what lies beyond failed a
#: check.
LOST = (NO_FURTHER, TOO_MANY, NOT_A_STEP)
#: Why a closed branch begins and ends where it is cut.
FOLD = "fold"
#: Weight of the event times as coordinates of segments, relative to other coordinates.
_WORTH_OF_TIMES = 0.02


_Value = TypeVar("_Value")


def _with_end(
    ends: tuple[_Value, _Value], side: int, value: _Value
) -> tuple[_Value, _Value]:
    """What is known of both ends, with another value on one side: 0 or 1."""
    low, high = ends
    return (value, high) if side == 0 else (low, value)


def _divided_differences(x: ndarray, values: ndarray, slope: ndarray) -> ndarray:
    """Coefficients in Newton's form of Hermite polynomials.

    Parameters
    ----------
    x : ndarray, shape (2 k, n)
        Arguments of the k nodes of n polynomials, each twice.
    values, slope : ndarray, shape (c, k, n)

    Returns
    -------
    ndarray, shape (2 k, c, n)
    """
    table = np.repeat(values, 2, axis=1)
    coefficients = [table[:, 0]]
    for order in range(1, len(x)):
        with np.errstate(divide="ignore", invalid="ignore"):
            table = np.diff(table, axis=1) / (x[order:] - x[:-order])
        if order == 1:
            table[:, ::2] = slope
        coefficients.append(table[:, 0])

    return np.array(coefficients)


@dataclass
class Branch:
    """One branch: n nodes, what is measured there, and the polynomials between them.

    Attributes
    ----------
    m : int
        Number of section coordinates, of all steps.
    Z : ndarray, shape (c, n)
        Similarity coordinates and event times, then ln slope.
    tangent : ndarray, shape (c, n)
        Derivative of Z along the branch.
    lipschitz : ndarray, shape (n,)
        Lipschitz estimates of the Newton map.
    why : tuple of str
        Kind of either end; `fold` and `fold` if the branch is closed: it is cut at one
        of its folds.
    end_errors : tuple of float
        Error of ln slope at either end, beyond rounding.
    gradient : ndarray, shape (d, c - 1, n)
        That of the characteristic polynomial, as `curvature` gives it.
    rounding_std : ndarray, shape (o + d, n)
        What `rounding_std` gives on the segment after each node.
    ratio : ndarray, shape (n,)
        Gait ratio.
    leg_passes : ndarray of int, shape (n,)
        How often the swing leg passes the stance leg.
    safe : ndarray of bool, shape (n,)
        Whether, by the motion at the nodes, every gait on the segment after each is a
        step whose legs pass that often.
    steps : int
        Number of steps after which its gaits repeat.
    """

    m: int
    Z: Coordinates
    tangent: Coordinates
    lipschitz: PerLane
    why: tuple[str, str]
    end_errors: tuple[float, float] = (0.0, 0.0)
    gradient: ndarray = field(default_factory=partial(np.zeros, (0, 0, 0)))
    rounding_std: ndarray = field(default_factory=partial(np.zeros, (0, 0)))
    ratio: PerLane = field(default_factory=partial(np.zeros, 0))
    leg_passes: ndarray = field(default_factory=partial(np.zeros, 0, np.int64))
    safe: Marks = field(default_factory=partial(np.zeros, 0, bool))
    steps: int = 1

    def __post_init__(self) -> None:
        self._interpolate()

    @property
    def q(self) -> ndarray:
        """Values of ln slope at the nodes, shape (n,)."""
        return self.Z[-1]

    @property
    def direction(self) -> ndarray:
        """Unit tangents of the branch at the nodes, shape (c, n)."""
        return np.asarray(self.tangent / norm(self.tangent))

    def between(self, segment: Numbers) -> ndarray:
        """Return unit directions (c, k) of segments (k,): the means of those at their
        two nodes.
        """
        mean = self.direction[:, segment] + self.direction[:, segment + 1]
        return np.asarray(mean / norm(mean))

    def ends_of(self, segment: Numbers) -> ndarray:
        """Return the segments' own coordinates (`axis`) at their two nodes, shape (2,
        k).
        """
        axis = self.axis[segment]
        left = self.Z[axis, segment]
        right = self.Z[axis, segment + 1]
        return np.array([left, right])

    def _interpolate(self) -> None:
        """Set the divided differences of every segment's polynomial, and the coordinate
        it runs in.
        """
        n = self.Z.shape[1]
        count = min(4, n)
        segments = np.arange(n - 1)
        left = np.clip(segments - 1, 0, n - count)
        self.window = left + np.arange(count)[:, None]
        Z = self.Z[:, self.window]
        T = self.tangent[:, self.window]
        self.axis = self._best_coordinate(T)

        along_axis = self.axis, slice(None), segments
        x = Z[along_axis].T
        slope = T / T[along_axis].T
        self.nodes = np.repeat(x, 2, axis=0)
        self.coefficients = _divided_differences(self.nodes, Z, slope)

    def _best_coordinate(self, T: ndarray) -> ndarray:
        """Coordinates (n - 1,) that change the most over the nodes of each polynomial,
        by the tangents (c, k, n - 1) there, and are monotone.
        """
        share = np.abs(T) / norm(T)
        sign = np.sign(T)
        is_monotone = (sign == sign[:, :1]).all(axis=1)
        worth = np.where(is_monotone, share.min(axis=1), 0.0)
        # Prefer ln slope itself: locating a slope on the segment then needs no root
        # finding.
        worth[-1] *= 3
        # Event times serve only where hardly anything else changes: beside tangential
        # strikes and falls.
        worth[self.m : -1] *= _WORTH_OF_TIMES
        return worth.argmax(axis=0)

    def insert(self, at: ndarray | int, Z: Coordinates, tangent: Coordinates) -> Branch:
        """Branch with further nodes, each before the one at its index, and nothing
        measured yet.

        Parameters
        ----------
        at : int or ndarray of int, shape (k,)
        Z, tangent : ndarray, shape (c, k), or (c,) for one
        """
        Z = np.insert(self.Z, at, Z, axis=1)
        tangent = np.insert(self.tangent, at, tangent, axis=1)
        return self._of_nodes(Z, tangent, self.why, self.end_errors)

    def with_points(self, segments: Numbers | int, point: Point) -> Branch:
        """Branch with corrected points as further nodes, each on a segment, and nothing
        measured yet.
        """
        after = np.atleast_1d(segments) + 1
        return self.insert(after, point.Z, point.direction)

    def with_nodes_of(self, others: Sequence[tuple[int, Branch]]) -> Branch:
        """Branch with nodes inserted that each of some others has, beyond its own, on one
        segment, and nothing measured yet.

        Parameters
        ----------
        others : sequence of (int, Branch)
            Different segments, rising, and branches that have all of its nodes.
        """
        branch = self
        # From the last on: what is inserted moves nothing before it.
        for segment, other in reversed(others):
            after = segment + 1
            more = len(other.q) - len(self.q)
            new = slice(after, after + more)
            places = np.full(more, after)
            branch = branch.insert(places, other.Z[:, new], other.tangent[:, new])

        return branch

    def _of_nodes(
        self,
        Z: Coordinates,
        tangent: Coordinates,
        why: tuple[str, str],
        errors: tuple[float, float],
    ) -> Branch:
        unmeasured = np.zeros(Z.shape[1])
        return Branch(self.m, Z, tangent, unmeasured, why, errors, steps=self.steps)

    def part(self, nodes: Numbers) -> Branch:
        """Branch of some nodes, with nothing measured yet; where it is cut there is
        NO_FURTHER.

        Parameters
        ----------
        nodes : ndarray of int, shape (k,)
            Rising.
        """
        why = self.why
        errors = self.end_errors
        last = len(self.q) - 1
        for side, is_cut in enumerate((nodes[0] != 0, nodes[-1] != last)):
            if is_cut:
                why = _with_end(why, side, NO_FURTHER)
                errors = _with_end(errors, side, 0.0)

        Z = self.Z[:, nodes]
        tangent = self.tangent[:, nodes]
        return self._of_nodes(Z, tangent, why, errors)

    def ending(self, side: int, kind: str, error: float = 0.0) -> Branch:
        """Branch with another kind of end, and error of its ln slope, on one side: 0 or
        1.
        """
        why = _with_end(self.why, side, kind)
        errors = _with_end(self.end_errors, side, error)
        return replace(self, why=why, end_errors=errors)

    def lost(self) -> list[float]:
        """Return the slopes of ends at which the branch could be continued no further
        [rad].
        """
        slopes = np.exp(self.q[[0, -1]])
        ends = zip(slopes.tolist(), self.why, strict=True)
        return [slope for slope, why in ends if why in LOST]

    def part_of(self, gait: Gait, cuts: ndarray) -> Branch:
        """Branch of the part that has a gait as node, or of the longest if none has or
        it is too short.

        Parameters
        ----------
        gait : ndarray, shape (c,)
            A point.
        cuts : ndarray of int, shape (k,)
            Segments between the parts, rising.
        """
        apart = norm(np.diff(self.Z))

        def worth(nodes: Numbers) -> tuple[bool, float]:
            # Not the number of nodes: a short part that bends has many.
            has_gait = np.isin(self._places(gait), nodes).any()
            is_enough = len(nodes) >= MIN_NODES
            length = apart[nodes[:-1]].sum()
            return bool(has_gait and is_enough), float(length)

        parts = np.split(np.arange(len(self.q)), cuts + 1)
        return self.part(max(parts, key=worth))

    def _places(self, gait: Gait) -> ndarray:
        """Nodes that are a gait (c,)."""
        is_gait = (gait[:, None] == self.Z).all(axis=0)
        return np.flatnonzero(is_gait)

    def in_order(self, gait: Gait) -> Branch:
        """Branch without nodes that do not lie along it, as seen from a gait or its
        middle; not measured yet.

        Neighbours lie along a branch if the chord between them makes less than 60
        degrees with the tangents at both; where rounding moves nodes by more than they
        are apart, they do not.

        Parameters
        ----------
        gait : ndarray, shape (c,)
            A point.
        """
        Z = self.Z
        T = self.direction

        def along(a: ndarray | int, b: ndarray | int) -> ndarray:
            chord = Z[:, b] - Z[:, a]
            length = norm(chord)
            along_a = total(chord * T[:, a])
            along_b = total(chord * T[:, b])
            is_along = np.minimum(along_a, along_b) > 0.5 * length
            return np.asarray(is_along | (length < _COINCIDENT))

        n = len(self.q)
        if along(np.arange(n - 1), np.arange(1, n)).all():
            return self

        first_places = self._places(gait)[:1].tolist()
        for start in (*first_places, n // 2):
            kept = [start]
            for i in range(start + 1, n):
                if along(kept[-1], i):
                    kept.append(i)

            for i in reversed(range(start)):
                if along(i, kept[0]):
                    kept.insert(0, i)

            # A gait whose own tangent is off has no neighbours along it.
            if len(kept) >= MIN_NODES:
                break

        return self.part(np.array(kept))

    def lies_between(self, segment: Numbers, Z: Coordinates) -> ndarray:
        """Whether points lie between their segments' nodes, nearer the chord than half
        its length.

        Parameters
        ----------
        segment : ndarray of int, shape (k,)
        Z : ndarray, shape (c, k)

        Returns
        -------
        ndarray of bool, shape (k,)
        """
        a = self.Z[:, segment]
        chord = self.Z[:, segment + 1] - a
        length = norm(chord)
        along = total((Z - a) * chord) / length**2
        is_between = (along > 0) & (along < 1)
        off = norm(Z - a - along * chord)
        return is_between & (off < 0.5 * length)

    def place_of(self, segment: Numbers, Z: Coordinates) -> ndarray:
        """Return where points lie along the chords of segments: their numbers plus the
        shares of the chords.

        Parameters
        ----------
        segment : ndarray of int, shape (k,)
        Z : ndarray, shape (c, k)

        Returns
        -------
        ndarray, shape (k,)
        """
        a = self.Z[:, segment]
        chord = self.Z[:, segment + 1] - a
        along = total((Z - a) * chord)
        share = along / total(chord**2)
        return np.asarray(segment + share)

    def evaluate(self, segment: Numbers, x: ndarray) -> ndarray:
        """Evaluate the segments' polynomials.

        Parameters
        ----------
        segment : ndarray of int, shape (k,)
        x : ndarray, shape (k,)
            Values of the segments' own coordinates (`axis`).

        Returns
        -------
        ndarray, shape (c, k)
        """
        # `take` is twice as fast as indexing.
        nodes = self.nodes.take(segment, axis=-1)
        coefficients = self.coefficients.take(segment, axis=-1)
        value = coefficients[-1]
        for k in reversed(range(len(coefficients) - 1)):
            value = value * (x - nodes[k]) + coefficients[k]
        return value

    def at(self, place: ndarray) -> ndarray:
        """Evaluate the branch at places along it.

        Parameters
        ----------
        place : ndarray, shape (k,)
            Numbers of segments plus fractions of them.

        Returns
        -------
        ndarray, shape (c, k)
        """
        segment = np.minimum(place.astype(int), len(self.q) - 2)
        a, b = self.ends_of(segment)
        x = a + (b - a) * (place - segment)
        return self.evaluate(segment, x)

    def _coordinate_at(self, segment: Numbers, q: LogSlopes) -> ndarray:
        """Coordinates of ln slopes on their segments, by bisection where the coordinate
        is not ln slope itself.
        """
        direct = self.axis[segment] == len(self.Z) - 1
        if direct.all():
            return q.copy()

        s, target = segment[~direct], q[~direct]
        a, b = self.ends_of(s)
        rising = self.q[s + 1] > self.q[s]
        for _ in range(60):
            middle = 0.5 * (a + b)
            above = self.evaluate(s, middle)[-1] > target
            beyond = above == rising
            a = np.where(beyond, a, middle)
            b = np.where(beyond, middle, b)

        x = q.copy()
        x[~direct] = 0.5 * (a + b)
        return x

    def turns(self) -> list[int]:
        """Nodes between the ends at which the slope turns: folds."""
        # A fold's node may be so near the next that their slopes differ by rounding
        # only; their tangents do not.
        change = np.diff(self.q)
        rate = self.tangent[-1]
        is_rounding = np.abs(change) < 1e-13
        mean_rate = rate[:-1] + rate[1:]
        rising = np.sign(np.where(is_rounding, mean_rate, change))
        segments = np.flatnonzero(np.diff(rising))
        nodes: list[int] = (segments + 1).tolist()
        return nodes

    def pieces(self) -> list[tuple[int, int]]:
        """First and last nodes of the pieces over which the slope is monotone."""
        last = len(self.q) - 1
        return list(itertools.pairwise([0, *self.turns(), last]))

    @property
    def is_loop(self) -> bool:
        """Whether it is closed, and cut at a fold."""
        return self.why == (FOLD, FOLD)

    def folds(self) -> ndarray:
        """Return the nodes that are folds; the one at which a closed branch is cut is
        its first and last.

        So are the flips at which branches of twice the steps begin: their slope turns
        there.

        Returns
        -------
        ndarray of int, shape (k,)
        """
        nodes = self.turns()
        if kind_of(self.why[0]).turns_slope:
            nodes.insert(0, 0)
        if kind_of(self.why[1]).turns_slope:
            nodes.append(len(self.q) - 1)
        return np.array(nodes, int)

    def distance_from_fold(self) -> ndarray:
        """Return how far each segment is from the branch's nearest fold in ln slope.

        Returns
        -------
        ndarray, shape (n - 1,)
            Infinite without a fold.
        """
        folds = self.q[self.folds()]
        apart = np.abs(self.q[:, None] - folds)
        nearest = apart.min(axis=1, initial=np.inf)
        return np.minimum(nearest[1:], nearest[:-1])

    def piece(self, segment: Numbers) -> ndarray:
        """Return the numbers of the pieces on which segments lie.

        Parameters
        ----------
        segment : ndarray of int, shape (n,)

        Returns
        -------
        ndarray of int, shape (n,)
            Counted from the branch's end at the lower slope, or, where both leave the
            window, at the smaller angle.
        """
        firsts = [first for first, _ in self.pieces()]
        number = np.searchsorted(firsts, segment, side="right") - 1
        # How far beyond the window a branch was followed is arbitrary.
        window = np.log(MIN_SLOPE), np.log(MAX_SLOPE)
        first, last = np.clip(self.q[[0, -1]], *window)
        angle, last_angle = self.Z[0, [0, -1]]
        if (first, angle) <= (last, last_angle):
            return number

        return len(firsts) - 1 - number

    def ratio_on(self, segment: Numbers) -> ndarray:
        """Return the gait ratios of segments (n,): the means of those at their two
        nodes.
        """
        both = self.ratio[segment] + self.ratio[segment + 1]
        return np.asarray(0.5 * both)

    def known_guesses(self, Z: Coordinates, segment: Numbers, slope: Slopes) -> Guesses:
        """Guesses with what is known of their segments.

        Parameters
        ----------
        Z : ndarray, shape (c, n)
            Points of the polynomials, as `guesses` gives them.
        segment : ndarray of int, shape (n,)
        slope : ndarray, shape (n,) [rad]
        """
        after = segment + 1
        left = self.gradient.take(segment, axis=-1)
        right = self.gradient.take(after, axis=-1)
        steep = np.maximum(self.lipschitz[segment], self.lipschitz[after])
        is_safe = self.safe[segment]
        leg_passes = np.where(is_safe, self.leg_passes[segment], UNKNOWN)

        # On branches of several steps, of which any may be the first, nothing is
        # measured.
        return Guesses(
            w=from_largest(Z[:-1], self.m, self.steps),
            slope=slope,
            lipschitz=steep,
            gradient=(left + right) / 2,
            rounding_std=self.rounding_std[:, segment],
            leg_passes=leg_passes,
        )

    def guesses(self, q: LogSlopes) -> list[tuple[ndarray, ndarray, ndarray]]:
        """Evaluate every piece at those slopes that it covers.

        Parameters
        ----------
        q : ndarray, shape (n,)
            Values of ln slope.

        Returns
        -------
        list of (index, Z, segment)
            Of each piece: indices into q (k,), the points there (c, k), and their
            segments (k,).
        """
        guesses = []
        for first, last in self.pieces():
            inside = self.covered(first, last, q)
            if len(inside):
                Z, segment = self.on_piece(first, last, q[inside])
                guesses.append((inside, Z, segment))
        return guesses

    def covered(self, first: int, last: int, q: LogSlopes) -> ndarray:
        """Ln slopes that the piece between two nodes covers.

        Parameters
        ----------
        first, last : int
            Of `pieces`.
        q : ndarray, shape (n,)
            Values of ln slope.

        Returns
        -------
        ndarray of int, shape (k,)
            Indices into q.
        """
        low, high = np.sort(self.q[[first, last]])
        is_inside = (q >= low) & (q <= high)
        return np.flatnonzero(is_inside)

    def on_piece(self, first: int, last: int, q: LogSlopes) -> tuple[ndarray, ndarray]:
        """Evaluate the piece between two nodes at slopes that it covers.

        Parameters
        ----------
        first, last : int
            Of `pieces`.
        q : ndarray, shape (k,)
            Values of ln slope.

        Returns
        -------
        Z : ndarray, shape (c, k)
        segment : ndarray of int, shape (k,)
        """
        nodes = self.q[first : last + 1]
        last_segment = len(nodes) - 2
        rising = nodes[-1] > nodes[0]
        ordered = nodes if rising else nodes[::-1]
        k = np.searchsorted(ordered, q, side="right") - 1
        k = np.clip(k, 0, last_segment)
        if not rising:
            k = last_segment - k

        segment = first + k
        x = self._coordinate_at(segment, q)
        return self.evaluate(segment, x), segment
