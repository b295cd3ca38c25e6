"""Spans: the position along a piece of a family's branches in which gaits are smooth."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from gaitsweep.tasks.charts.chart import Chart

#: Least distance from a fold that counts, as a share of the piece.
_NEAREST = 1e-9
#: Narrowest part of a span.
_NARROWEST = 2.0**-12


def along(
    share: np.ndarray,
    folds: tuple[bool, bool],
    vanishing: tuple[float, float] = (0.0, 0.0),
) -> np.ndarray:
    """Return the share of the range of ln slope at a coordinate from 0 to 1 in which
    gaits are smooth.

    Parameters
    ----------
    share : ndarray
    folds : (bool, bool)
        Whether the piece begins and ends at a fold, where gaits depend on the root of
        the distance in ln slope.
    vanishing : (float, float)
        Where it begins or ends at steps that nearly vanish, minus the logarithm of the
        share of the piece that is left: there gaits depend on that logarithm. 0
        elsewhere.

    Returns
    -------
    ndarray
        From 0 to 1.
    """
    if vanishing[0]:
        return 1 - along(1 - share, folds[::-1], vanishing[::-1])

    low, high = folds
    if vanishing[1]:
        return np.expm1(-vanishing[1] * (share**2 if low else share)) / np.expm1(
            -vanishing[1]
        )
    if low and high:
        return 0.5 * (1 - np.cos(np.pi * share))

    return share**2 if low else 1 - (1 - share) ** 2 if high else share


def coordinate(
    share: np.ndarray,
    folds: tuple[bool, bool],
    vanishing: tuple[float, float] = (0.0, 0.0),
) -> np.ndarray:
    """Return the coordinate at a share of the range of ln slope, the inverse of
    `along`.

    Parameters
    ----------
    share : ndarray
    folds : (bool, bool)
    vanishing : (float, float)

    Returns
    -------
    ndarray
        From 0 to 1.
    """
    if vanishing[0]:
        return 1 - coordinate(1 - share, folds[::-1], vanishing[::-1])

    share = np.clip(share, 0.0, 1.0)
    low, high = folds
    if vanishing[1]:
        way = -np.log1p(share * np.expm1(-vanishing[1])) / vanishing[1]
        return np.sqrt(way) if low else way

    if low and high:
        return np.arccos(1 - 2 * share) / np.pi

    return np.sqrt(share) if low else 1 - np.sqrt(1 - share) if high else share


@dataclass(frozen=True)
class Span:
    """Part of a piece of branches, over 0 to 2 keys; points of it are a position from
    -1 to 1 and coordinates of keys.

    Attributes
    ----------
    ends : Chart
        Ln slopes of the piece's two ends over the keys.
    folds : (bool, bool)
        Whether the piece begins and ends at a fold.
    vanishing : (float, float)
        As for `along`.
    part : (float, float)
        The part, in the coordinate of `along`.
    """

    ends: Chart
    folds: tuple[bool, bool] = (False, False)
    vanishing: tuple[float, float] = (0.0, 0.0)
    part: tuple[float, float] = (0.0, 1.0)

    @classmethod
    def between(
        cls,
        ends: np.ndarray,
        keys: int,
        folds: tuple[bool, bool] = (False, False),
        vanishing: tuple[float, float] = (0.0, 0.0),
    ) -> Span:
        """Return the span between two ln slopes (2,), whatever the keys."""
        return cls(Chart((1,) * keys, ends[None]), folds, vanishing)

    def log_slope(self, points: np.ndarray) -> np.ndarray:
        """Return the ln slopes (n,) of points (n, 1 + d)."""
        low, high = self.ends(points[:, 1:])
        start, stop = self.part
        return low + (high - low) * along(
            start + (stop - start) * 0.5 * (1 + points[:, 0]),
            self.folds,
            self.vanishing,
        )

    def points(self, q: np.ndarray, unit: np.ndarray | None = None) -> np.ndarray:
        """Return the points (n, 1 + d) at ln slopes (n,) and coordinates of keys (n,
        d), the inverse of `log_slope`.
        """
        unit = np.zeros((len(q), 0)) if unit is None else unit
        low, high = self.ends(unit)
        start, stop = self.part
        share = coordinate((q - low) / (high - low), self.folds, self.vanishing)
        return np.column_stack([2 * (share - start) / (stop - start) - 1, unit])

    def distance(self, points: np.ndarray) -> np.ndarray:
        """Return how far points (n, 1 + d) are from the piece's folds, as a share of
        the piece, (n,); 1 without.
        """
        start, stop = self.part
        share = start + (stop - start) * 0.5 * (1 + points[:, 0])
        low, high = self.folds

        return np.asarray(
            np.clip(
                np.minimum(share if low else 1.0, 1 - share if high else 1.0),
                _NEAREST,
                1.0,
            )
            * np.ones(len(points))
        )

    def from_folds(self, points: np.ndarray) -> np.ndarray:
        """Return a smooth factor that vanishes at the piece's folds as the derivative
        of ln slope by the position does, at points (n, 1 + d), shape (n,); 1 without.
        """
        start, stop = self.part
        share = start + (stop - start) * 0.5 * (1 + points[:, 0])
        low, high = self.folds
        return np.where(low, share, 1.0) * np.where(high, 1 - share, 1.0)

    @property
    def bounds(self) -> tuple[float, float]:
        """Least and largest ln slope of a span over no keys."""
        low, high = self.log_slope(np.array([[-1.0], [1.0]]))
        return float(low), float(high)

    def drawn(self, nodes: int) -> np.ndarray:
        """Return points between and beyond Chebyshev nodes of a span over no keys,
        drawn by its hash.

        Returns
        -------
        ndarray, shape (nodes + 1, 1)
        """
        numbers = np.array([*self.ends.coefficients[0], *self.folds, *self.part])
        seed = int.from_bytes(hashlib.sha256(numbers.tobytes()).digest()[:8], "little")
        share = np.random.default_rng(seed).random(nodes + 1)
        angle = np.arange(nodes + 1) + share - 0.5

        # Beyond the outermost nodes there is only half a gap, and very near its end a
        # gait beside a fold is rounding.
        angle[0] = 0.4 * angle[0] + 0.3
        angle[-1] = nodes - 0.3 + 0.4 * (angle[-1] - nodes)
        return -np.cos(np.pi * angle / nodes)[:, None]

    def toward_vanishing(self, widest: float, farthest: float) -> Iterator[Span]:
        """Yield parts in each of which the logarithm of the distance from vanishing
        steps changes at most by `widest`, and in all by about `farthest`; the span
        itself where steps do not vanish.
        """
        depth = max(self.vanishing)
        if not depth:
            yield self
            return

        n = math.ceil(min(depth, farthest) / widest)
        edges = np.minimum(1.0, np.arange(n + 1) * widest / depth).tolist()
        for k in range(n):
            near, far = edges[k + 1], edges[k]
            part = (1 - near, 1 - far) if self.vanishing[0] else (far, near)
            yield replace(self, part=part)

    def halves(self) -> Iterator[Span]:
        """Yield both halves, unless they are too narrow."""
        start, stop = self.part
        middle = 0.5 * (start + stop)
        if middle - start >= _NARROWEST:
            yield replace(self, part=(start, middle))
            yield replace(self, part=(middle, stop))
