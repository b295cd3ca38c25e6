"""A branch of gaits: nodes with exact tangents and the polynomials between them."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np


@dataclass
class Branch:
    """One branch: nodes, tangents and Lipschitz estimates.

    `Z` (n, c) holds X = (section, q) in its first m + 1 columns, then the event times; `tangent` its derivative along
    the branch; `why` says what each end is, `end_errors` how far off its ln slope may be beyond rounding. `noise`
    (n, o)
    is the standard deviation that rounding gives angle, rates and period on the segment after each node, over their
    `reach`; `ratio` the gait ratio at the nodes; `safe` says of the segment after each node that every stride on it
    is a
    step whose legs pass `passes` times, by the nodes' own motions.
    """

    m: int
    Z: np.ndarray
    tangent: np.ndarray
    lipschitz: np.ndarray
    why: tuple[str, str]
    end_errors: tuple[float, float] = (0.0, 0.0)
    rounding_std: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    ratio: np.ndarray = field(default_factory=lambda: np.zeros(0))
    leg_passes: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))
    safe: np.ndarray = field(default_factory=lambda: np.zeros(0, bool))

    def __post_init__(self) -> None:
        self._segments()

    @property
    def q(self) -> np.ndarray:
        return self.Z[:, self.m]

    def _segments(self) -> None:
        """Divided differences of every segment's polynomial."""
        n = len(self.Z)
        count = min(4, n)
        left = np.clip(np.arange(n - 1) - 1, 0, n - count)
        window = self.window = left[:, None] + np.arange(count)
        Z, T = self.Z[window], self.tangent[window]
        unit = np.abs(T) / np.linalg.norm(T[..., : self.m + 1], axis=-1, keepdims=True)
        same = (np.sign(T) == np.sign(T[:, :1])).all(axis=1)
        worth = np.where(same, unit.min(axis=1), 0.0)[:, : self.m + 1]
        # Prefer the slope itself: then a slope's place on the segment needs no root.
        worth[:, self.m] *= 3
        self.axis = worth.argmax(axis=1)
        rows = np.arange(n - 1)[:, None]
        x = np.repeat(Z[rows, np.arange(count), self.axis[:, None]], 2, axis=1)
        slope = T / T[rows, np.arange(count), self.axis[:, None]][..., None]
        table = np.repeat(Z, 2, axis=1)
        coefficients = [table[:, 0]]
        for order in range(1, 2 * count):
            dx = (x[:, order:] - x[:, :-order])[..., None]
            with np.errstate(divide="ignore", invalid="ignore"):
                new = (table[:, 1:] - table[:, :-1]) / dx
            if order == 1:
                new[:, ::2] = slope
            table = new
            coefficients.append(table[:, 0])
        self.nodes, self.coefficients = x, np.stack(coefficients, axis=1)

    def inserted(self, at: np.ndarray | int, Z: np.ndarray, tangent: np.ndarray) -> Branch:
        """The branch's nodes with more among them, each before the one at its index; nothing is measured on them
        yet."""
        Z, tangent = np.insert(self.Z, at, Z, axis=0), np.insert(self.tangent, at, tangent, axis=0)
        return Branch(self.m, Z, tangent, np.zeros(len(Z)), self.why, self.end_errors)

    def part(self, first: int, last: int) -> Branch:
        """The nodes from first to last, by themselves."""
        nodes = slice(first, last + 1)
        return Branch(self.m, self.Z[nodes], self.tangent[nodes], np.zeros(last + 1 - first), self.why, self.end_errors)

    def lies_between(self, segment: np.ndarray, X: np.ndarray, times: np.ndarray) -> np.ndarray:
        """True where points lie between their segments' nodes, nearer the chord than half its length, shape (n,).

        Parameters
        ----------
        X, times : ndarray, shape (m + 1, n) and (k, n)
            Event times may besides leave their chord by as much as they change along it.
        """
        a, b = self.Z[segment].T, self.Z[segment + 1].T
        chord, times_chord = np.split(b - a, [self.m + 1])
        length = np.linalg.norm(chord, axis=0)
        along = ((X - a[: self.m + 1]) * chord).sum(axis=0) / length**2
        off = np.linalg.norm(X - a[: self.m + 1] - along * chord, axis=0)
        late = np.abs(times - a[self.m + 1 :] - along * times_chord)
        near = (off < 0.5 * length) & (late < 0.5 * length + np.abs(times_chord)).all(axis=0)
        return (along > 0) & (along < 1) & near

    def evaluate(self, segment: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Z at places x of the segments' own coordinates, shape (n, c)."""
        nodes, c = self.nodes[segment], self.coefficients[segment]
        value = c[:, -1]
        for k in reversed(range(c.shape[1] - 1)):
            value = value * (x - nodes[:, k])[:, None] + c[:, k]
        return value

    def at(self, place: np.ndarray) -> np.ndarray:
        """Z at places along the branch, each a segment and the part of it, shape (n, c)."""
        segment = np.minimum(place.astype(int), len(self.Z) - 2)
        a, b = (self.Z[segment + i, self.axis[segment]] for i in (0, 1))
        return self.evaluate(segment, a + (b - a) * (place - segment))

    def place(self, segment: np.ndarray, q: np.ndarray) -> np.ndarray:
        """Where on their segments the slopes lie, by bisection where the coordinate is not the slope itself."""
        direct = self.axis[segment] == self.m
        x = q.copy()
        if not direct.all():
            s, target = segment[~direct], q[~direct]
            a, b = self.Z[s, self.axis[s]], self.Z[s + 1, self.axis[s]]
            rising = self.q[s + 1] > self.q[s]
            for _ in range(60):
                middle = 0.5 * (a + b)
                above = self.evaluate(s, middle)[:, self.m] > target
                up = above == rising
                b, a = np.where(up, middle, b), np.where(up, a, middle)
            x[~direct] = 0.5 * (a + b)
        return x

    def pieces(self) -> list[tuple[int, int]]:
        """Runs of nodes over which the slope is monotone."""
        # A fold has a node of its own, so near that the next node's slope may differ by rounding only.
        rising = np.sign(np.diff(self.q))
        for i in np.nonzero(np.abs(np.diff(self.q)) < 1e-13)[0]:
            rising[i] = rising[i - 1] if i else rising[min(i + 1, len(rising) - 1)]
        cuts = [0, *(np.nonzero(np.diff(rising))[0] + 1).tolist(), len(self.q) - 1]
        return list(zip(cuts[:-1], cuts[1:]))

    def piece(self, segment: np.ndarray) -> np.ndarray:
        """Numbers of the pieces that segments lie on, counted along the branch from its end at the lower slope."""
        firsts = [first for first, _ in self.pieces()]
        number = np.searchsorted(firsts, segment, side="right") - 1
        return number if self.q[0] <= self.q[-1] else len(firsts) - 1 - number

    def guesses(self, q: np.ndarray) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """For each piece, which slopes it covers: (index into q, Z there, the segments they lie on)."""
        found = []
        for first, last in self.pieces():
            nodes = self.q[first : last + 1]
            rising = nodes[-1] > nodes[0]
            ordered = nodes if rising else nodes[::-1]
            inside = np.nonzero((q >= ordered[0]) & (q <= ordered[-1]))[0]
            if not len(inside):
                continue
            k = np.clip(np.searchsorted(ordered, q[inside], side="right") - 1, 0, len(ordered) - 2)
            segment = first + (k if rising else len(ordered) - 2 - k)
            found.append((inside, self.evaluate(segment, self.place(segment, q[inside])), segment))
        return found
