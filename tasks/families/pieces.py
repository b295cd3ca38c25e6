"""Pieces of branches near a range of slopes, and which of neighbouring lines continue
each other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gaitsweep.tasks.continuation.branch import Branch
from gaitsweep.tasks.continuation.tracking import rate_of_steps
from gaitsweep.tasks.fixed_points.polish import Guesses

#: Kinds of ends beyond which the equations of a gait go on and its own step tells that
#: it is none.
EVENTS = {
    f"end_{kind}"
    for kind in (
        "kneestrike_at_heelstrike",
        "tangential_heelstrike",
        "tangential_kneestrike",
        "earlier_strike",
    )
}
#: How far beyond a panel pieces are compared, in ln slope.
_REACH = 1.0
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
        return self.kinds[0] == "fold", self.kinds[1] == "fold"

    @property
    def end_errors(self) -> tuple[float, float]:
        """Errors of `q`, beyond rounding; those of the branch's own ends at folds."""
        low, high = self.branch.end_errors
        return (
            (high, low)
            if self.branch.q[self.first] > self.branch.q[self.last]
            else (low, high)
        )

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
        nodes = nodes if (nodes[-1, 0] == self.q[k]) else nodes[:, ::-1]
        return float(
            rate_of_steps(
                nodes[:, : nodes.shape[1] // 2 + 1], self.branch.m, self.branch.steps
            ).max()
        )

    def end_point(self, k: int) -> np.ndarray:
        """Return its point (c,) at the lower (0) or upper (1) end."""
        first = self.branch.q[self.first] == self.q[k]
        return self.branch.Z[:, self.first if first else self.last]


def pieces_of(branches: list[Branch]) -> list[Piece]:
    """Pieces of all branches of a line."""
    pieces = []
    for number, branch in enumerate(branches):
        spans = branch.pieces()
        for k, (first, last) in enumerate(spans):
            kinds = (
                branch.why[0] if k == 0 else "fold",
                branch.why[1] if k == len(spans) - 1 else "fold",
            )
            q = float(branch.q[first]), float(branch.q[last])
            if q[0] > q[1]:
                kinds, q = kinds[::-1], q[::-1]
            pieces.append(
                Piece(
                    branch,
                    number,
                    int(branch.piece(np.array([first]))[0]),
                    first,
                    last,
                    kinds,
                    q,
                )
            )
    return pieces


def _distance(a: Piece, b: Piece, low: float, high: float) -> float:
    """How far apart two pieces of neighbouring lines are."""
    for end in (0, 1):
        # Ends beyond the range of interest may be of any kind, and so may those where
        # walking ends.
        beyond = (a.q[0] < low and b.q[0] < low, a.q[1] > high and b.q[1] > high)[end]
        kinds = [
            "event" if kind in EVENTS else kind for kind in (a.kinds[end], b.kinds[end])
        ]
        if not beyond and kinds[0] != kinds[1]:
            return _FAR
    spans = [np.clip(piece.q, low - _REACH, high + _REACH) for piece in (a, b)]
    shares = np.array([0.15, 0.5, 0.85])
    gaits = [
        piece.gaits(q[0] + (q[1] - q[0]) * shares)
        for piece, q in zip((a, b), spans, strict=True)
    ]
    return float(np.abs(gaits[0] - gaits[1]).max() + np.abs(spans[0] - spans[1]).max())


def match(
    lines: list[list[Piece]], low: float, high: float
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
        pairs = [
            (distance, row, column)
            for row, first in enumerate(lines[0])
            for column, piece in enumerate(pieces)
            if (distance := _distance(first, piece, low, high)) < _FAR
        ]
        for _, row, column in sorted(pairs):
            if groups[row][i] is None and column in new:
                groups[row][i] = pieces[column]
                new.remove(column)
        for column in sorted(new):
            groups.append([None] * len(lines))
            groups[-1][i] = pieces[column]
    return groups
