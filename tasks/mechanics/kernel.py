"""Compiled flows: a structure's equations of motion, advanced over given times in SIMD lanes."""

from __future__ import annotations

import contextlib
import functools
import os
from pathlib import Path
from typing import Any

import heyoka as hy
import numpy as np

from tasks.mechanics.equations import system
from tasks.mechanics.lumped import Structure

#: Steps a flow may take before it counts as lost; an honest stride takes 5 to 40.
MAX_STEPS = 120
LANES = hy.recommended_simd_size()
#: Tolerance of the exact flows: order 18, whose truncation is fifty times below rounding.
FINE = 1.75e-15
#: Tolerance of a search's flows, which only lead to where the exact ones begin.
COARSE = 1e-7


@functools.cache
def prepare_compiler() -> None:
    """Set heyoka's compile cache and threads for this process; every factory of compiled code calls it first.

    Notes
    -----
    heyoka reads its cache through when it opens it: one of our own, kept small, opens ten times as fast as one shared
    with all its users. On a network disk it is slower than compiling; `GAITSWEEP_CACHE` names a local one.
    """
    named = os.environ.get("GAITSWEEP_CACHE")
    with contextlib.suppress(*() if named else (OSError, RuntimeError)):
        folder = Path(named or Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache", "gaitsweep")).expanduser()
        folder.mkdir(parents=True, exist_ok=True)
        hy.llvm_state.set_diskcache_path(str(folder))
        hy.llvm_state.set_diskcache_limit(256 << 20)
    hy.llvm_state.set_diskcache_enabled(True)
    hy.set_nthreads(1)


def whole_groups(values: np.ndarray, lanes: int) -> np.ndarray:
    """Values with the last lane repeated until the lanes fill whole groups, contiguous."""
    n = values.shape[-1]
    if not n % lanes:
        return np.ascontiguousarray(values)
    padded = np.empty((*values.shape[:-1], n + -n % lanes))
    padded[..., :n], padded[..., n:] = values, values[..., -1:]
    return padded


class Flow:
    """A flow over given times, with its variations, for any number of lanes.

    Work is counted in `evaluations` (lanes advanced) and `idle` (lanes that fill a group). Every lane runs the same
    code at its own pace, so a lane's
    bits do not depend on its neighbours; a group with a lost lane is run again lane by lane to keep that true.
    """

    def __init__(self, structure: Structure, free_knee: bool, directions: int, with_slope: bool, coarse: bool):
        flown = system(structure, free_knee, directions, with_slope)
        self.size, self.angles = len(flown.equations), (6 if free_knee else 4)
        # Without a foot mass the links do not couple: so few terms are left that two registers a step pay.
        self.lanes = 2 * LANES if ("eps", 0.0) in structure.units else LANES
        self.evaluations = self.idle = 0
        self._ta = hy.taylor_adaptive_batch(
            flown.equations, state=np.zeros((self.size, self.lanes)), tol=COARSE if coarse else FINE
        )
        self._parameters = flown.parameters()
        # Views of the integrator's own memory.
        ta: Any = self._ta
        self._state, self._pars, self._time = ta.state, ta.pars, ta.time

    def __call__(
        self, state: np.ndarray, parameters: np.ndarray, duration: np.ndarray, samples: int = 0
    ) -> tuple[np.ndarray, np.ndarray | None]:
        """Advance every lane by its own duration.

        Parameters
        ----------
        state : ndarray, shape (size, n)
            Initial scaled state and variations.
        parameters : ndarray, shape (n_parameters, n)
        duration : ndarray, shape (n,) [sqrt(leg/g)]
        samples : int
            Number of equal intervals at whose ends the motion is also wanted.

        Returns
        -------
        final : ndarray, shape (size, n)
            NaN in lanes whose motion was lost.
        motion : ndarray, shape (samples + 1, angles, n), or None
        """
        n = state.shape[1]
        state, duration = whole_groups(state, self.lanes), whole_groups(duration, self.lanes)
        parameters = self._parameters(whole_groups(parameters, self.lanes))
        flown = len(duration)
        final, reached = np.empty((self.size, flown)), np.full(flown, np.nan)
        motion = np.empty((samples + 1, self.angles, flown)) if samples else None
        fractions = np.linspace(0.0, 1.0, samples + 1)[:, None] if samples else None

        def fly(lanes: slice | list[int], to: slice) -> None:
            """Advance a group; what is put down of it is its lanes `to`."""
            kept = slice(to.stop - to.start)
            self._state[:], self._pars[:] = state[:, lanes], parameters[:, lanes]
            try:
                dense = self._advance(duration[lanes], fractions)
            except ValueError:
                # heyoka refuses durations that are not finite.
                return
            final[:, to], reached[to] = self._state[:, kept], self._time[kept]
            if motion is not None and dense is not None:
                motion[:, :, to] = dense[:, : self.angles, kept]

        for k in range(0, flown, self.lanes):
            fly(slice(k, k + self.lanes), slice(k, k + self.lanes))
        lost = np.nonzero(reached.reshape(-1, self.lanes) != duration.reshape(-1, self.lanes))[0]
        for k in np.unique(lost) * self.lanes:
            for lane in range(k, k + self.lanes):
                reached[lane] = np.nan
                fly([lane] * self.lanes, slice(lane, lane + 1))
                if reached[lane] != duration[lane]:
                    final[:, lane] = np.nan
                    if motion is not None:
                        motion[:, :, lane] = np.nan
        self.evaluations += n
        self.idle += flown - n
        return final[:, :n], motion if motion is None else motion[:, :, :n]

    def _advance(self, duration: np.ndarray, fractions: np.ndarray | None) -> np.ndarray | None:
        """Let heyoka fly a group, all of its time or to fractions of it; the states there."""
        ta: Any = self._ta
        ta.set_time(0.0)
        if fractions is None:
            ta.propagate_until(duration, max_steps=MAX_STEPS)
            return None
        return ta.propagate_grid(fractions * duration, max_steps=MAX_STEPS)[1]


#: Every flow compiled by this process, by what it was compiled for; their counters tell what was flown.
FLOWS: dict[tuple[Any, ...], Flow] = {}


def flow(
    structure: Structure, free_knee: bool = False, directions: int = 0, with_slope: bool = False, coarse: bool = False
) -> Flow:
    """The compiled flow of a structure; compiled once a process, kept on disk between them."""
    key = structure, free_knee, directions, with_slope, coarse
    if key not in FLOWS:
        prepare_compiler()
        FLOWS[key] = Flow(*key)
    return FLOWS[key]
