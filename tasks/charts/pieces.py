"""Pieces of branches near a range of slopes, and which of neighbouring lines continue
each other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gaitsweep.tasks.branches.branch import Branch
from gaitsweep.tasks.branches.tracking import rate_of_steps
from gaitsweep.tasks.charts.patch_ends import EVENTS, FOLD
from gaitsweep.tasks.contract.kinds import kind_of
from gaitsweep.tasks.gaits.polish import Guesses

#: How far beyond a panel pieces are compared, in ln slope.
_REACH = 1.0
#: Places along pieces at which they are compared.
_SHARES = np.array([0.15, 0.5, 0.85])
#: Norm of rates over angle at an end from which on steps nearly vanish there, but not
#: their rates [sqrt(g/leg)].
FAST = 4.0
#: Distance of two pieces of neighbouring lines that do not continue each other.
_FAR = 1e6


@dataclass(frozen=True)
class Piece:
    """The part of a branch between two folds or ends: its branch's number, nodes, and
    both ends by rising slope.

    `kinds` are the ends' kinds, `fold` or as `Branch.why` has them; `q` their ln
    slopes.
    """

    branch: Branch
    number: int
    place: int
    first: int
    last: int
    kinds: tuple[str, str]
    q: tuple[float, float]

    @property
    def folds(self) -> tuple[bool, bool]:
        """Whether it begins and ends at a fold."""
        low, high = map(kind_of, self.kinds)
        return low.turns_slope, high.turns_slope

    @property
    def end_errors(self) -> tuple[float, float]:
        """Errors of `q`, beyond rounding; those of the branch's own ends at folds."""
        low, high = self.branch.end_errors
        if self.branch.q[self.first] > self.branch.q[self.last]:
            return high, low
        return low, high

    def covered(self, q: np.ndarray) -> np.ndarray:
        """Return indices of the ln slopes (n,) that it covers."""
        return self.branch.covered(self.first, self.last, q)

    def guesses(self, q: np.ndarray) -> Guesses:
        """Return guesses of its gaits.

        Parameters
        ----------
        q : ndarray, shape (n,)
            Values of ln slope that it covers.
        """
        Z, segment = self.branch.on_piece(self.first, self.last, q)
        return self.branch.known_guesses(Z, segment, np.exp(q))

    def gaits(self, q: np.ndarray) -> np.ndarray:
        """Return gaits by the branch's polynomials; beyond the piece, those at its
        ends.

        Parameters
        ----------
        q : ndarray, shape (n,)
            Values of ln slope.

        Returns
        -------
        ndarray, shape (m + k, n)
        """
        Z = self.branch.on_piece(self.first, self.last, np.clip(q, *self.q))[0]
        return Z[:-1]

    def rate_beside(self, k: int) -> float:
        """Return the largest norm of rates over angle on the half next to the lower (0)
        or upper (1) end.
        """
        nodes = self.branch.Z[:, self.first : self.last + 1]
        if nodes[-1, 0] != self.q[k]:
            nodes = nodes[:, ::-1]
        half = nodes[:, : nodes.shape[1] // 2 + 1]
        return float(rate_of_steps(half, self.branch.m, self.branch.steps).max())

    def vanishes(self, k: int) -> bool:
        """Return whether steps vanish at the lower (0) or upper (1) end, and their rates
        with them: at a finite drive, whose distance from there grows as the square of
        their angle.
        """
        return kind_of(self.kinds[k]).steps_vanish and self.rate_beside(k) < FAST

    @property
    def vanishing(self) -> tuple[float, float]:
        """By how much the logarithm of the distance in ln drive from its lower and upper
        end grows along it, where steps vanish there with their rates; 0 elsewhere.
        """
        angle = self.branch.Z[0, self.first : self.last + 1]
        depth = 2 * float(np.ptp(angle))
        return depth * self.vanishes(0), depth * self.vanishes(1)

    def small_step(self, k: int, log_angle: float) -> np.ndarray:
        """Return a point (c,) near the steps of a small angle on their way to vanishing
        at the lower (0) or upper (1) end: but for their angle such steps are alike.
        """
        nodes = self.branch.Z[:, self.first : self.last + 1]
        half = np.abs(nodes[-1] - self.q[k]) <= 0.5 * (self.q[1] - self.q[0])
        near = np.where(half, np.abs(nodes[0] - log_angle), np.inf)
        Z = nodes[:, int(near.argmin())].copy()
        Z[0] = log_angle
        return Z

    def end_point(self, k: int) -> np.ndarray:
        """Return its point (c,) at the lower (0) or upper (1) end."""
        is_first = self.branch.q[self.first] == self.q[k]
        return self.branch.Z[:, self.first if is_first else self.last]


def pieces_of(branches: list[Branch]) -> list[Piece]:
    """Pieces of all branches of a line."""
    pieces = []
    for number, branch in enumerate(branches):
        nodes = branch.pieces()
        turns = [FOLD] * (len(nodes) - 1)
        begins = [branch.why[0], *turns]
        ends = [*turns, branch.why[1]]
        for (first, last), *kinds in zip(
            nodes,
            begins,
            ends,
            strict=True,
        ):
            q = [float(branch.q[first]), float(branch.q[last])]
            if q[0] > q[1]:
                kinds.reverse()
                q.reverse()
            place = int(branch.piece(np.array([first]))[0])
            of_ends = (kinds[0], kinds[1]), (q[0], q[1])
            pieces.append(Piece(branch, number, place, first, last, *of_ends))

    return pieces


def _distance(
    a: Piece,
    b: Piece,
    low: float,
    high: float,
) -> float:
    """How far apart two pieces of neighbouring lines are."""
    # Ends beyond the range of interest may be of any kind, and so may those where
    # walking ends.
    beyond = max(a.q[0], b.q[0]) < low, min(a.q[1], b.q[1]) > high
    for end in (0, 1):
        kinds = {a.kinds[end], b.kinds[end]}
        if not (beyond[end] or len(kinds) == 1 or kinds <= EVENTS):
            return _FAR

    gaits = []
    spans = []
    for piece in (a, b):
        first, last = np.clip(piece.q, low - _REACH, high + _REACH)
        gaits.append(piece.gaits(first + (last - first) * _SHARES))
        spans.append(np.array([first, last]))

    off = np.abs(gaits[0] - gaits[1]).max() + np.abs(spans[0] - spans[1]).max()
    return float(off)


def match(
    lines: list[list[Piece]],
    low: float,
    high: float,
) -> list[list[Piece | None]]:
    """Group the pieces of lines that continue those of the first: the nearest first.

    Parameters
    ----------
    lines : list of list of Piece
    low, high : float
        The range of ln slopes of interest.

    Returns
    -------
    list of list of Piece or None
        For each group, its piece on every line; None where there is none.
    """
    groups: list[list[Piece | None]] = [
        [piece, *[None] * (len(lines) - 1)] for piece in lines[0]
    ]
    for i, pieces in enumerate(lines[1:], 1):
        new = set(range(len(pieces)))
        pairs = []
        for row, first in enumerate(lines[0]):
            for column, piece in enumerate(pieces):
                pairs.append(
                    (
                        _distance(
                            first,
                            piece,
                            low,
                            high,
                        ),
                        row,
                        column,
                    )
                )

        for distance, row, column in sorted(pairs):
            is_free = groups[row][i] is None and column in new
            if is_free and distance < _FAR:
                groups[row][i] = pieces[column]
                new.remove(column)

        for column in sorted(new):
            groups.append([None] * len(lines))
            groups[-1][i] = pieces[column]

    return groups
