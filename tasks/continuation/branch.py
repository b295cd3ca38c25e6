"""A branch of gaits: nodes with exact tangents and the polynomials between them."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field, replace

import numpy as np

from gaitsweep.tasks.continuation.pseudo_arclength import NO_FURTHER, TOO_MANY
from gaitsweep.tasks.continuation.tracking import MAX_SLOPE, MIN_SLOPE, NOT_A_STEP
from gaitsweep.tasks.fixed_points.polish import UNKNOWN, Guesses
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
#: Weight of the event times as coordinates of segments, relative to other coordinates.
_WORTH_OF_TIMES = 0.02


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
    Z: np.ndarray
    tangent: np.ndarray
    lipschitz: np.ndarray
    why: tuple[str, str]
    end_errors: tuple[float, float] = (0.0, 0.0)
    gradient: np.ndarray = field(default_factory=lambda: np.zeros((0, 0, 0)))
    rounding_std: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    ratio: np.ndarray = field(default_factory=lambda: np.zeros(0))
    leg_passes: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))
    safe: np.ndarray = field(default_factory=lambda: np.zeros(0, bool))
    steps: int = 1

    def __post_init__(self) -> None:
        self._interpolate()

    @property
    def q(self) -> np.ndarray:
        """Values of ln slope at the nodes, shape (n,)."""
        return self.Z[-1]

    @property
    def direction(self) -> np.ndarray:
        """Unit tangents of the branch at the nodes, shape (c, n)."""
        return np.asarray(self.tangent / norm(self.tangent))

    def between(self, segment: np.ndarray) -> np.ndarray:
        """Return unit directions (c, k) of segments (k,): the means of those at their
        two nodes.
        """
        mean = self.direction[:, segment] + self.direction[:, segment + 1]
        return np.asarray(mean / norm(mean))

    def ends_of(self, segment: np.ndarray) -> np.ndarray:
        """Return the segments' own coordinates (`axis`) at their two nodes, shape (2,
        k).
        """
        return np.array([self.Z[self.axis[segment], segment + i] for i in (0, 1)])

    def _interpolate(self) -> None:
        """Set the divided differences of every segment's polynomial, and the coordinate
        it runs in.
        """
        n = self.Z.shape[1]
        count = min(4, n)
        left = np.clip(np.arange(n - 1) - 1, 0, n - count)
        window = self.window = left + np.arange(count)[:, None]
        Z, T = self.Z[:, window], self.tangent[:, window]
        unit = np.abs(T) / norm(T)
        monotone = (np.sign(T) == np.sign(T[:, :1])).all(axis=1)
        worth = np.where(monotone, unit.min(axis=1), 0.0)
        # Prefer ln slope itself: locating a slope on the segment then needs no root
        # finding.
        worth[-1] *= 3
        # Event times serve only where hardly anything else changes: beside tangential
        # strikes and falls.
        worth[self.m : -1] *= _WORTH_OF_TIMES
        self.axis = worth.argmax(axis=0)
        own = self.axis, slice(None), np.arange(n - 1)
        x = np.repeat(Z[own].T, 2, axis=0)
        slope = T / T[own].T
        table = np.repeat(Z, 2, axis=1)
        coefficients = [table[:, 0]]
        for order in range(1, 2 * count):
            dx = x[order:] - x[:-order]
            with np.errstate(divide="ignore", invalid="ignore"):
                new = (table[:, 1:] - table[:, :-1]) / dx
            if order == 1:
                new[:, ::2] = slope
            table = new
            coefficients.append(table[:, 0])
        self.nodes, self.coefficients = x, np.array(coefficients)

    def insert(
        self, at: np.ndarray | int, Z: np.ndarray, tangent: np.ndarray
    ) -> Branch:
        """Branch with further nodes, each before the one at its index, and nothing
        measured yet.

        Parameters
        ----------
        at : int or ndarray of int, shape (k,)
        Z, tangent : ndarray, shape (c, k), or (c,) for one
        """
        Z, tangent = (
            np.insert(self.Z, at, Z, axis=1),
            np.insert(self.tangent, at, tangent, axis=1),
        )
        return self._of_nodes(Z, tangent, self.why, self.end_errors)

    def _of_nodes(
        self,
        Z: np.ndarray,
        tangent: np.ndarray,
        why: tuple[str, str],
        errors: tuple[float, float],
    ) -> Branch:
        return Branch(
            self.m, Z, tangent, np.zeros(Z.shape[1]), why, errors, steps=self.steps
        )

    def part(self, nodes: np.ndarray) -> Branch:
        """Branch of some nodes, with nothing measured yet; where it is cut there is
        NO_FURTHER.

        Parameters
        ----------
        nodes : ndarray of int, shape (k,)
            Rising.
        """
        ends = zip(
            self.why,
            self.end_errors,
            (nodes[0] == 0, nodes[-1] == len(self.q) - 1),
            strict=True,
        )
        low, high = (
            (why, error) if whole else (NO_FURTHER, 0.0) for why, error, whole in ends
        )
        return self._of_nodes(
            self.Z[:, nodes],
            self.tangent[:, nodes],
            (low[0], high[0]),
            (low[1], high[1]),
        )

    def ending(self, side: int, kind: str, error: float = 0.0) -> Branch:
        """Branch with another kind of end, and error of its ln slope, on one side: 0 or
        1.
        """
        why, errors = list(self.why), list(self.end_errors)
        why[side], errors[side] = kind, error
        return replace(self, why=(why[0], why[1]), end_errors=(errors[0], errors[1]))

    def lost(self) -> list[float]:
        """Return the slopes of ends at which the branch could be continued no further
        [rad].
        """
        return [float(np.exp(self.q[-i])) for i in (0, 1) if self.why[i] in LOST]

    def part_of(self, gait: np.ndarray, cuts: np.ndarray) -> Branch:
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

        def worth(nodes: np.ndarray) -> tuple[bool, float]:
            # Not the number of nodes: a short part that bends has many.
            has_gait = (
                len(nodes) >= MIN_NODES and np.isin(self._places(gait), nodes).any()
            )
            return bool(has_gait), float(apart[nodes[:-1]].sum())

        return self.part(max(np.split(np.arange(len(self.q)), cuts + 1), key=worth))

    def _places(self, gait: np.ndarray) -> np.ndarray:
        """Nodes that are a gait (c,)."""
        return np.flatnonzero((gait[:, None] == self.Z).all(axis=0))

    def in_order(self, gait: np.ndarray) -> Branch:
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
        Z, T = self.Z, self.direction

        def along(a: np.ndarray | int, b: np.ndarray | int) -> np.ndarray:
            chord = Z[:, b] - Z[:, a]
            length = norm(chord)
            least = np.minimum(total(chord * T[:, a]), total(chord * T[:, b]))
            return np.asarray((least > 0.5 * length) | (length < _COINCIDENT))

        n = len(self.q)
        if along(np.arange(n - 1), np.arange(1, n)).all():
            return self
        for start in (*self._places(gait)[:1].tolist(), n // 2):
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

    def lies_between(self, segment: np.ndarray, Z: np.ndarray) -> np.ndarray:
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
        a, b = self.Z[:, segment], self.Z[:, segment + 1]
        chord = b - a
        length = norm(chord)
        along = total((Z - a) * chord) / length**2
        return (along > 0) & (along < 1) & (norm(Z - a - along * chord) < 0.5 * length)

    def place_of(self, segment: np.ndarray, Z: np.ndarray) -> np.ndarray:
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
        chord = self.Z[:, segment + 1] - self.Z[:, segment]
        along = total((Z - self.Z[:, segment]) * chord)
        return np.asarray(segment + along / total(chord**2))

    def evaluate(self, segment: np.ndarray, x: np.ndarray) -> np.ndarray:
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
        nodes, coefficients = (
            each.take(segment, axis=-1) for each in (self.nodes, self.coefficients)
        )
        value = coefficients[-1]
        for k in reversed(range(len(coefficients) - 1)):
            value = value * (x - nodes[k]) + coefficients[k]
        return value

    def at(self, place: np.ndarray) -> np.ndarray:
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
        return self.evaluate(segment, a + (b - a) * (place - segment))

    def _coordinate_at(self, segment: np.ndarray, q: np.ndarray) -> np.ndarray:
        """Coordinates of ln slopes on their segments, by bisection where the coordinate
        is not ln slope itself.
        """
        direct = self.axis[segment] == len(self.Z) - 1
        x = q.copy()
        if not direct.all():
            s, target = segment[~direct], q[~direct]
            a, b = self.ends_of(s)
            rising = self.q[s + 1] > self.q[s]
            for _ in range(60):
                middle = 0.5 * (a + b)
                above = self.evaluate(s, middle)[-1] > target
                beyond = above == rising
                b, a = np.where(beyond, middle, b), np.where(beyond, a, middle)
            x[~direct] = 0.5 * (a + b)
        return x

    def turns(self) -> list[int]:
        """Nodes between the ends at which the slope turns: folds."""
        # A fold's node may be so near the next that their slopes differ by rounding
        # only; their tangents do not.
        change, rate = np.diff(self.q), self.tangent[-1]
        rising = np.sign(np.where(np.abs(change) < 1e-13, rate[:-1] + rate[1:], change))
        return [int(node) for node in np.nonzero(np.diff(rising))[0] + 1]

    def pieces(self) -> list[tuple[int, int]]:
        """First and last nodes of the pieces over which the slope is monotone."""
        return list(itertools.pairwise([0, *self.turns(), len(self.q) - 1]))

    def folds(self) -> np.ndarray:
        """Return the nodes that are folds; the one at which a closed branch is cut is
        its first and last.

        So are the flips at which branches of twice the steps begin: their slope turns
        there.

        Returns
        -------
        ndarray of int, shape (k,)
        """
        ends = [
            i
            for i, why in zip((0, len(self.q) - 1), self.why, strict=True)
            if why in ("fold", "branch_point")
        ]
        return np.array(sorted([*ends, *self.turns()]), int)

    def distance_from_fold(self) -> np.ndarray:
        """Return how far each segment is from the branch's nearest fold in ln slope.

        Returns
        -------
        ndarray, shape (n - 1,)
            Infinite without a fold.
        """
        apart = np.abs(self.q[:, None] - self.q[self.folds()]).min(
            axis=1, initial=np.inf
        )
        return np.minimum(apart[1:], apart[:-1])

    def piece(self, segment: np.ndarray) -> np.ndarray:
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
        first, last = (
            np.clip(self.q[i], np.log(MIN_SLOPE), np.log(MAX_SLOPE)) for i in (0, -1)
        )
        rises = first < last or (first == last and self.Z[0, 0] <= self.Z[0, -1])
        return number if rises else len(firsts) - 1 - number

    def ratio_on(self, segment: np.ndarray) -> np.ndarray:
        """Return the gait ratios of segments (n,): the means of those at their two
        nodes.
        """
        return np.asarray(0.5 * (self.ratio[segment] + self.ratio[segment + 1]))

    def known_guesses(
        self, Z: np.ndarray, segment: np.ndarray, slope: np.ndarray
    ) -> Guesses:
        """Guesses with what is known of their segments.

        Parameters
        ----------
        Z : ndarray, shape (c, n)
            Points of the polynomials, as `guesses` gives them.
        segment : ndarray of int, shape (n,)
        slope : ndarray, shape (n,) [rad]
        """
        lipschitz = np.maximum(self.lipschitz[segment], self.lipschitz[segment + 1])
        leg_passes = np.where(self.safe[segment], self.leg_passes[segment], UNKNOWN)
        gradient = (
            self.gradient.take(segment, axis=-1)
            + self.gradient.take(segment + 1, axis=-1)
        ) / 2
        # On branches of several steps, of which any may be the first, nothing is
        # measured.
        w = from_largest(Z[:-1], self.m, self.steps)
        return Guesses(
            w, slope, lipschitz, gradient, self.rounding_std[:, segment], leg_passes
        )

    def guesses(self, q: np.ndarray) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
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
                guesses.append((inside, *self.on_piece(first, last, q[inside])))
        return guesses

    def covered(self, first: int, last: int, q: np.ndarray) -> np.ndarray:
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
        ends = self.q[[first, last]]
        return np.flatnonzero((q >= ends.min()) & (q <= ends.max()))

    def on_piece(
        self, first: int, last: int, q: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
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
        rising = nodes[-1] > nodes[0]
        ordered = nodes if rising else nodes[::-1]
        k = np.clip(np.searchsorted(ordered, q, side="right") - 1, 0, len(ordered) - 2)
        segment = first + (k if rising else len(ordered) - 2 - k)
        return self.evaluate(segment, self._coordinate_at(segment, q)), segment
