"""Boxes in the space of one or two keys, their nodes, and points drawn in them."""

from __future__ import annotations

import hashlib
import itertools
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np


def roots(n: int) -> np.ndarray:
    """Return the roots of the Chebyshev polynomial of degree n, rising.

    Returns
    -------
    ndarray, shape (n,)
    """
    falling = np.arange(n)[::-1]
    angles = (2 * falling + 1) * np.pi / (2 * n)
    return np.cos(angles)


def tensor_nodes(sizes: tuple[int, ...]) -> np.ndarray:
    """Return Chebyshev nodes of the cube from -1 to 1, the last dimension fastest.

    Parameters
    ----------
    sizes : tuple of int
        Along each dimension.

    Returns
    -------
    ndarray, shape (product of sizes, d)
    """
    along = map(roots, sizes)
    return np.array(list(itertools.product(*along)))


@dataclass(frozen=True)
class Box:
    """Values of keys from `low` to `high`, in the walker's units, and how often these
    were `halved` along each key.

    Nodes lie inside, where no constant of a walker vanishes that does not vanish
    everywhere. With `log`, one for all keys or one for each, the coordinates of keys
    whose distance from their origin, 0 unless it is given, grows by more than a factor
    of eight are those of its logarithm.
    """

    keys: tuple[str, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    log: bool | tuple[bool, ...] = False
    origin: tuple[float, ...] = ()
    halved: tuple[int, ...] = ()

    @cached_property
    def _distances(self) -> tuple[np.ndarray, ...]:
        """Of each key the origin, the side of it, 1 or -1, the distances of both faces,
        and whether these are far.
        """
        low = np.array(self.low)
        high = np.array(self.high)
        origin = np.array(self.origin or np.zeros(len(low)))
        side = np.where(low < origin, -1, 1)
        from_origin = side * (np.array([low, high]) - origin)
        near, far = np.sort(from_origin, axis=0)
        is_far = (near > 0) & (8 * near < far)
        return origin, side, near, far, self.log & is_far

    def share(self, part: Box) -> float:
        """Return the share of its coordinates' range that a part has."""
        ends = np.array([part.low, part.high])
        low, high = self.unit(ends)
        shares = 0.5 * (high - low)
        return float(np.prod(shares))

    def holds(self, point: np.ndarray) -> bool:
        """Return whether a point (d,) lies inside or on the border [the walker's
        units].
        """
        is_above = point >= self.low
        is_below = point <= self.high
        return bool((is_above & is_below).all())

    def common(self, other: Box) -> Box:
        """Return the part that another box of the same keys has too; it holds nothing
        if there is none.
        """
        low = np.maximum(self.low, other.low)
        high = np.minimum(self.high, other.high)
        return replace(self, low=tuple(low.tolist()), high=tuple(high.tolist()))

    def nodes(self, n: int | tuple[int, ...]) -> np.ndarray:
        """Return Chebyshev nodes, the last key fastest.

        Parameters
        ----------
        n : int or tuple of int
            Along each key.

        Returns
        -------
        ndarray, shape (product of n, d) [the walker's units]
        """
        if isinstance(n, int):
            n = (n,) * len(self.keys)
        return self.at(tensor_nodes(n))

    def at(self, unit: np.ndarray) -> np.ndarray:
        """Return the values of keys at coordinates that run from -1 to 1.

        Parameters
        ----------
        unit : ndarray, shape (n, d)

        Returns
        -------
        ndarray, shape (n, d) [the walker's units]
        """
        low = np.array(self.low)
        high = np.array(self.high)
        middle = 0.5 * (low + high)
        half = 0.5 * (high - low)
        linear = middle + half * unit
        origin, side, near, far, is_log = self._distances
        if not is_log.any():
            return linear

        with np.errstate(invalid="ignore", divide="ignore"):
            share = 0.5 * (1 + side * unit)
            reach = np.log(far / near)
            distance = near * np.exp(share * reach)
            logarithmic = origin + side * distance

        return np.where(is_log, logarithmic, linear)

    def unit(self, points: np.ndarray) -> np.ndarray:
        """Return the coordinates from -1 to 1 of values of keys.

        Parameters
        ----------
        points : ndarray, shape (n, d) [the walker's units]

        Returns
        -------
        ndarray, shape (n, d)
        """
        low = np.array(self.low)
        high = np.array(self.high)
        linear = (2 * points - low - high) / (high - low)
        origin, side, near, far, is_log = self._distances
        if not is_log.any():
            return linear

        with np.errstate(invalid="ignore", divide="ignore"):
            distance = side * (points - origin)
            reach = np.log(far / near)
            share = np.log(distance / near) / reach
            logarithmic = side * (2 * share - 1)

        return np.where(is_log, logarithmic, linear)

    def corners(self, at: float) -> np.ndarray:
        """Return the coordinates of points near the corners.

        Parameters
        ----------
        at : float
            Size of each coordinate.

        Returns
        -------
        ndarray, shape (2^d, d)
        """
        d = len(self.keys)
        corners = itertools.product((-1.0, 1.0), repeat=d)
        return at * np.array(list(corners))

    def parts(
        self,
        axis: int,
        at: float | None = None,
        origin: float | None = None,
    ) -> tuple[Box, Box]:
        """Return both parts along one key, divided at a value of it, or halved; its
        origin may be another.
        """
        d = len(self.keys)
        halved = self.halved or (0,) * d
        if at is None:
            halved = _with(halved, axis, halved[axis] + 1)
            (middle,) = self.at(np.zeros((1, d)))
            at = float(middle[axis])

        whole = replace(self, halved=halved)
        if origin is not None:
            origins = self.origin or (0.0,) * d
            whole = replace(whole, origin=_with(origins, axis, origin))

        lower = replace(whole, high=_with(self.high, axis, at))
        upper = replace(whole, low=_with(self.low, axis, at))
        return lower, upper

    def draw(
        self,
        n: int,
        d: int,
        purpose: str,
    ) -> np.ndarray:
        """Draw points of the cube from -1 to 1 by a hash of the box and a purpose.

        Parameters
        ----------
        n, d : int
            Number of points and of dimensions.
        purpose : str

        Returns
        -------
        ndarray, shape (n, d)
        """
        ends = [value.hex() for value in (*self.low, *self.high)]
        text = repr((self.keys, ends, purpose))
        digest = hashlib.sha256(text.encode()).digest()
        seed = int.from_bytes(digest[:8], "big")
        generator = np.random.Generator(np.random.PCG64(seed))
        return generator.uniform(-1, 1, (n, d))

    def lot(self) -> np.ndarray:
        """Draw the coordinates of one line.

        Returns
        -------
        ndarray, shape (1, d)
        """
        return self.draw(1, len(self.keys), "line")


def _with(values: tuple[Any, ...], axis: int, value: float) -> tuple[Any, ...]:
    """Values of keys with another one along an axis."""
    return (*values[:axis], value, *values[axis + 1 :])


class Refused(Exception):
    """Why a box cannot be described as one, the key along which, and the value at
    which, it should be divided.

    Beside its `origin`, if there is one, gaits are smooth functions of the logarithm of
    the distance from it.
    """

    def __init__(
        self,
        why: str,
        axis: int = 0,
        at: float | None = None,
        origin: float | None = None,
    ):
        super().__init__(why)
        self.axis = axis
        self.at = at
        self.origin = origin
