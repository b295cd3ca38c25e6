"""Lyapunov exponents of any map from its exact Jacobians, lane by lane."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from gaitsweep.tasks.mechanics.sums import total


def orthogonalised(A: ndarray) -> tuple[ndarray, ndarray]:
    """QR decomposition of many small matrices by the Gram-Schmidt process, applied
    twice.

    Parameters
    ----------
    A : ndarray, shape (m, k, n)
        Matrices of n lanes.

    Returns
    -------
    Q : ndarray, shape (m, k, n)
    diagonal : ndarray, shape (k, n)
        Of R, not negative.

    Notes
    -----
    Elementwise operations only, so a lane's bits depend on that lane alone.
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
        # A direction that the map takes to zero has no image: zero stands for it, and
        # its exponent is minus infinity.
        has_image = size > 0
        divisor = np.where(has_image, size, 1.0)
        Q[:, k] = np.where(has_image, v / divisor, 0.0)

    return Q, diagonal


def _dot(u: ndarray, v: ndarray) -> ndarray:
    """Scalar product of every lane."""
    return total(a * b for a, b in zip(u, v, strict=True))


@dataclass
class Exponents:
    """Sums of the logarithms of growth of n lanes, in blocks of steps.

    Attributes
    ----------
    Q : ndarray, shape (m, m, n)
        Orthonormal directions.
    blocks : ndarray, shape (blocks, m, n)
        Sums of the logarithms of their growth.
    counts : ndarray of int, shape (blocks,)
        Steps of each block.
    """

    Q: ndarray
    blocks: ndarray
    counts: ndarray

    @classmethod
    def begin(cls, m: int, n: int, blocks: int) -> Exponents:
        """Begin with all m directions of n lanes, their growth to be summed in so many
        blocks.
        """
        directions = np.eye(m)[:, :, None]
        return cls(
            Q=np.repeat(directions, n, axis=2),
            blocks=np.zeros((blocks, m, n)),
            counts=np.zeros(blocks, int),
        )

    def step(self, J: ndarray, lanes: ndarray, block: int | None) -> None:
        """Map the directions of some lanes by one step.

        Parameters
        ----------
        J : ndarray, shape (m, m, k)
            Jacobians of the step.
        lanes : ndarray of int, shape (k,)
        block : int or None
            Block that counts their growth; None while they still converge.
        """
        Q = self.Q[:, :, lanes]
        image = total(J[:, i : i + 1] * q for i, q in enumerate(Q))
        self.Q[:, :, lanes], growth = orthogonalised(image)
        if block is not None:
            with np.errstate(divide="ignore"):
                self.blocks[block][:, lanes] += np.log(growth)
            self.counts[block] += 1

    def means(self) -> ndarray:
        """Mean growth per step of every block and lane.

        Returns
        -------
        ndarray, shape (blocks, m, n)
        """
        counts = np.maximum(self.counts, 1)
        return self.blocks / counts[:, None, None]


def estimate(means: ndarray) -> tuple[ndarray, ndarray]:
    """Estimate exponents and their standard errors from means over blocks of orbits of
    one attractor.

    Parameters
    ----------
    means : ndarray, shape (blocks, m, n)
        Mean growth per step, of n orbits.

    Returns
    -------
    exponents, errors : ndarray, shape (m,)
        Per step; NaN for errors from a single mean.

    Notes
    -----
    Blocks are much longer than the correlation time of a chaotic orbit, so their means are independent.
    """
    m = means.shape[1]
    flat = np.moveaxis(means, 1, 0).reshape(m, -1)
    count = flat.shape[1]
    deviation = np.full(len(flat), np.nan)
    with np.errstate(invalid="ignore"):
        if count > 1:
            deviation = np.std(flat, axis=1, ddof=1)
        return np.mean(flat, axis=1), deviation / np.sqrt(count)
