"""Lyapunov exponents from exact Jacobians, lane by lane, for any map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


def orthogonalised(A: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """QR of many small matrices by Gram and Schmidt, twice.

    Parameters
    ----------
    A : ndarray, shape (m, k, n)
        Columns of n lanes.

    Returns
    -------
    Q (m, k, n), and the diagonal of R (k, n), not negative

    Notes
    -----
    Written out in element-wise operations, so a lane's bits depend on that lane alone.
    """
    Q = A.copy()
    diagonal = np.zeros(A.shape[1:])
    for k in range(A.shape[1]):
        v = Q[:, k].copy()
        for _ in range(2):
            for j in range(k):
                v = v - _dot(Q[:, j], v) * Q[:, j]
        size = np.sqrt(_dot(v, v))
        diagonal[k] = size
        # A direction the map destroys has no image: any vector does, and its exponent is minus infinity.
        Q[:, k] = np.where(size > 0, v / np.where(size > 0, size, 1.0), 0.0)
    return Q, diagonal


def _dot(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    total = u[0] * v[0]
    for a, b in zip(u[1:], v[1:], strict=True):
        total = total + a * b
    return total


def applied(J: np.ndarray, Q: np.ndarray) -> np.ndarray:
    """J Q of every lane, shape (m, k, n)."""
    total = J[:, :1] * Q[None, 0]
    for i in range(1, len(Q)):
        total = total + J[:, i : i + 1] * Q[None, i]
    return total


@dataclass
class Exponents:
    """Sums of the logarithms of growth, in blocks of strides."""

    Q: np.ndarray
    blocks: np.ndarray
    counts: np.ndarray
    seen: int = 0

    @classmethod
    def begin(cls, m: int, n: int, blocks: int) -> Exponents:
        """All m directions of n lanes, their growth summed in that many blocks."""
        return cls(np.repeat(np.eye(m)[:, :, None], n, axis=2), np.zeros((blocks, m, n)), np.zeros(blocks, int))

    def step(self, J: np.ndarray, block: int | None) -> None:
        """Carry the directions through one step; `block` None while they still turn to where they belong."""
        self.Q, growth = orthogonalised(applied(J, self.Q))
        if block is not None:
            with np.errstate(divide="ignore"):
                self.blocks[block] += np.log(growth)
            self.counts[block] += 1

    def means(self) -> np.ndarray:
        """Mean growth per step of every block and lane, shape (blocks, m, n)."""
        return self.blocks / np.maximum(self.counts, 1)[:, None, None]


def estimate(means: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Exponents and their standard errors from means over blocks of any number of orbits of one attractor.

    Parameters
    ----------
    means : ndarray, shape (blocks, m, n)

    Notes
    -----
    Blocks are long beside the correlation of a chaotic orbit, so their means are independent.
    """
    flat = np.moveaxis(means, 1, 0).reshape(means.shape[1], -1)
    count = flat.shape[1]
    with np.errstate(invalid="ignore"):
        golden_ratio_order = np.std(flat, axis=1, ddof=1) if count > 1 else np.full(len(flat), np.nan)
        return np.mean(flat, axis=1), golden_ratio_order / np.sqrt(count)
