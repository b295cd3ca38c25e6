"""A walker's step map with its constants in place, one walker for all lanes or one a lane."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tasks.mechanics.lumped import Structure, constants_of, structure_of
from tasks.step.step_map import Stride, StrideMap, stride_map
from tasks.walkers.walker import Walker

EPS = np.finfo(float).eps


class Problem:
    """One walker's stride map with its constants in place."""

    def __init__(self, walker: Walker):
        self.walker = walker
        self.structure: Structure = structure_of(walker)
        self.map: StrideMap = stride_map(self.structure)
        self.constants = constants_of(walker, self.structure)
        self.m, self.phases = self.map.m, 2 if walker.knees else 1

    def parameters(self, slope: np.ndarray, scale: np.ndarray) -> np.ndarray:
        """Runtime parameters of every lane, shape (n_parameters, n)."""
        return np.vstack([slope, scale, np.broadcast_to(self.constants[:, None], (len(self.constants), len(slope)))])

    def some(self, lanes: np.ndarray) -> Problem:
        """The problem of some lanes: the same, where all lanes share a walker."""
        return self

    def walker_of(self, lane: int) -> Walker:
        """The walker of a lane."""
        return self.walker

    def stride(
        self, w: np.ndarray, log_slope: np.ndarray, slope: bool = False, samples: int = 0, coarse: bool = False
    ) -> tuple[Stride, np.ndarray]:
        """Evaluate strides at similarity coordinates.

        Parameters
        ----------
        w : ndarray, shape (m + phases, n)
            ln(angle), rates/angle, event times: of order one over decades of slope.
        log_slope : ndarray, shape (n,)

        Returns
        -------
        Stride, and the power-of-two scale (n,) its angles and rates are in.
        """
        angle = np.exp(w[0])
        scale = np.exp2(np.floor(np.log2(angle)))
        y = np.vstack([angle, angle * w[1 : self.m]]) / scale
        stride = self.map(y, w[self.m :], self.parameters(np.exp(log_slope), scale), slope, samples, coarse)
        return stride, scale


class Lanes(Problem):
    """The stride map with a walker of its own in every lane; all are of one structure."""

    def __init__(
        self, walkers: Sequence[Walker], structure: Structure | None = None, constants: np.ndarray | None = None
    ):
        self.walkers, self.walker = walkers, walkers[0]
        self.structure = structure or structure_of(walkers[0])
        self.map = stride_map(self.structure)
        self.constants = (
            constants if constants is not None else np.array([constants_of(w, self.structure) for w in walkers]).T
        )
        self.m, self.phases = self.map.m, 2 if self.structure.kneed else 1

    def parameters(self, slope: np.ndarray, scale: np.ndarray) -> np.ndarray:
        return np.vstack([slope, scale, self.constants])

    def some(self, lanes: np.ndarray) -> Lanes:
        return Lanes([self.walkers[i] for i in lanes], self.structure, self.constants[:, lanes])

    def walker_of(self, lane: int) -> Walker:
        return self.walkers[lane]


def sizes(y: np.ndarray) -> np.ndarray:
    """What errors of (angle, rates...) are measured by: the angle, and the largest rate for every rate, shape (m,
    n)."""
    rates = y[1:]
    return np.vstack([np.abs(y[:1]), np.broadcast_to(np.abs(rates).max(axis=0), rates.shape)])
