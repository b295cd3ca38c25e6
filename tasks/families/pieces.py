"""Pieces of branches near a range of slopes, and which of neighbouring lines continue each other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tasks.continuation.branch import Branch
from tasks.fixed_points.polish import Guesses

#: How far beyond a panel pieces are compared, in ln slope.
_REACH = 1.0
#: Distance of two pieces of neighbouring lines that do not continue each other.
_FAR = 1e6


@dataclass(frozen=True)
class Piece:
    """The part of a branch between two folds or ends: its branch's number, nodes, and both ends by rising slope.

    `kinds` are the ends' kinds, `fold` or as `Branch.why` has them; `q` their ln slopes.
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
        return (high, low) if self.branch.q[self.first] > self.branch.q[self.last] else (low, high)

    def guesses(self, q: np.ndarray) -> Guesses:
        """Return guesses of its gaits.

        Parameters
        ----------
        q : ndarray, shape (n,)
            Values of ln slope that it covers.
        """
        Z, segment = self.branch.on_piece(self.first, self.last, q)
        return self.branch.known_guesses(Z, segment, np.exp(q))

    def at(self, q: np.ndarray) -> np.ndarray:
        """Evaluate the branch's polynomials; beyond the piece, at its ends.

        Parameters
        ----------
        q : ndarray, shape (k,)
            Values of ln slope.

        Returns
        -------
        ndarray, shape (k, c)
            Rows of Z.
        """
        return self.branch.on_piece(self.first, self.last, np.clip(q, *self.q))[0]


def pieces_of(branches: list[Branch]) -> list[Piece]:
    """Pieces of all branches of a line."""
    pieces = []
    for number, branch in enumerate(branches):
        spans = branch.pieces()
        for k, (first, last) in enumerate(spans):
            kinds = (branch.why[0] if k == 0 else "fold", branch.why[1] if k == len(spans) - 1 else "fold")
            q = float(branch.q[first]), float(branch.q[last])
            if q[0] > q[1]:
                kinds, q = kinds[::-1], q[::-1]
            pieces.append(Piece(branch, number, int(branch.piece(np.array([first]))[0]), first, last, kinds, q))
    return pieces


def _distance(a: Piece, b: Piece, low: float, high: float) -> float:
    """How far apart two pieces of neighbouring lines are."""
    for end in (0, 1):
        # Ends beyond the range of interest may be of any kind.
        beyond = (a.q[0] < low and b.q[0] < low, a.q[1] > high and b.q[1] > high)[end]
        if not beyond and a.kinds[end] != b.kinds[end]:
            return _FAR
    spans = [np.clip(piece.q, low - _REACH, high + _REACH) for piece in (a, b)]
    shares = np.array([0.15, 0.5, 0.85])
    rows = [
        np.delete(piece.at(span[0] + (span[1] - span[0]) * shares), piece.branch.m, axis=1)
        for piece, span in zip((a, b), spans, strict=True)
    ]
    return float(np.abs(rows[0] - rows[1]).max() + np.abs(spans[0] - spans[1]).max())


def match(lines: list[list[Piece]], neighbour: list[int], low: float, high: float) -> list[list[Piece | None]]:
    """Group the pieces of node lines that continue each other.

    Parameters
    ----------
    lines : list of list of Piece
    neighbour : list of int
        For each line one nearer to the middle, itself for the middle.
    low, high : float
        The range of ln slopes of interest.

    Returns
    -------
    list of list of Piece or None
        For each group, its piece on every line; None where there is none.
    """
    # This takes as long to import as all other modules that solve points together: only planes need it.
    from scipy.optimize import linear_sum_assignment

    groups: list[list[Piece | None]] = []
    for i in sorted(range(len(lines)), key=lambda i: _depth(neighbour, i)):
        pieces, before = lines[i], neighbour[i]
        new = set(range(len(pieces)))
        known = [g for g, group in enumerate(groups) if before != i and group[before] is not None]
        if pieces and known:
            cost = np.array([[_distance(groups[g][before], piece, low, high) for piece in pieces] for g in known])  # type: ignore[arg-type]
            for row, column in zip(*linear_sum_assignment(cost), strict=True):
                if cost[row, column] < _FAR:
                    groups[known[row]][i] = pieces[column]
                    new.remove(int(column))
        for column in sorted(new):
            groups.append([None] * len(lines))
            groups[-1][i] = pieces[column]
    return groups


def _depth(neighbour: list[int], i: int) -> int:
    depth = 0
    while neighbour[i] != i:
        i, depth = neighbour[i], depth + 1
    return depth


def towards_middle(n: int, d: int) -> list[int]:
    """For each of n^d node lines the one next to it towards the middle, the middle's own for itself."""
    neighbours = []
    for i in range(n**d):
        place = np.array(np.unravel_index(i, (n,) * d))
        off = place - n // 2
        k = int(np.abs(off).argmax())
        place[k] -= np.sign(off[k])
        neighbours.append(int(np.ravel_multi_index(tuple(place), (n,) * d)))
    return neighbours
