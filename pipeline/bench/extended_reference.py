"""The stride map and its fixed points in extended precision, from the same symbols as the product's."""

from __future__ import annotations

from typing import Any

import heyoka as hy
import numpy as np

from tasks.mechanics.equations import system
from tasks.mechanics.lumped import Structure
from tasks.step.step_map import StrideMap


class _Algebra(StrideMap):
    """The algebra between flows, compiled for another floating-point type."""

    def __init__(self, structure: Structure, kind: Any):
        self.structure, self.m, self.kneed, self.kind = structure, structure.dimension, structure.kneed, kind
        self.start_size = 6 if self.kneed else 4
        self.begin = self._compile_start()
        self.lock = self._compile_knee() if self.kneed else None
        self.finish = self._compile_finish()

    def _function(self, outputs: list[Any], variables: list[Any]) -> Any:
        return hy.cfunc(outputs, vars=variables, compact_mode=True, fp_type=self.kind)


def best_kind() -> tuple[str, Any]:
    """The widest type heyoka was built with: 113 bits, or 64 where that is missing."""
    if getattr(hy, "real128", None) is not None:
        return "real128", hy.real128
    return "long double", np.longdouble


def converted(values: Any, kind: Any) -> np.ndarray:
    """Values of any floating-point type as another: a double's worth, and a double's worth of what that leaves."""
    found = []
    for x in values:
        leading = float(x)
        found.append(kind(leading) + kind(float(x - type(x)(leading))))
    return np.array(found, dtype=kind)


class Precise:
    """One stride at a time, in a wider floating-point type.

    The walker's constants are the doubles the product uses, taken as exact, so any difference is arithmetic's.
    """

    def __init__(self, structure: Structure, kind: Any):
        self.kind, self.m, self.kneed = kind, structure.dimension, structure.kneed
        self.algebra = _Algebra(structure, kind)
        self.locked = self._integrator(structure, False, self.m)
        self.free = self._integrator(structure, True, self.m) if self.kneed else None

    def _integrator(self, structure: Structure, free: bool, directions: int) -> Any:
        flown = system(structure, free, directions, False)
        flow = hy.taylor_adaptive(
            flown.equations, self.array([0.0] * len(flown.equations)), fp_type=self.kind, compact_mode=True
        )
        return flow, flown.parameters(fp_type=self.kind, compact_mode=True)

    def array(self, values: Any) -> np.ndarray:
        """Values, of any type, as the wider type."""
        return converted(values, self.kind)

    def _fly(
        self, flow: Any, start: np.ndarray, directions: np.ndarray, parameters: np.ndarray, duration: Any
    ) -> np.ndarray:
        flow, held = flow
        flow.time = self.kind(0.0)
        flow.state[:] = np.concatenate([start, np.ascontiguousarray(directions.T).reshape(-1)])
        flow.pars[:] = held(parameters)
        flow.propagate_until(duration)
        return flow.state.copy()

    def _padded(self, flat: np.ndarray, size: int) -> np.ndarray:
        """Directions as the algebra takes them, that of the slope zero."""
        return np.concatenate([flat.reshape(-1, size), [self.array([0.0] * size)]]).T.reshape(-1)

    def stride(self, y: np.ndarray, times: np.ndarray, parameters: np.ndarray) -> dict[str, np.ndarray]:
        """Image, Jacobian, Newton step and corrected event times of one stride, as `tasks.step.step_map` defines
        them."""
        m = self.m
        begin = self.algebra.begin(np.concatenate([y, parameters]))
        size = self.algebra.start_size
        start, D = begin[:size], begin[size:].reshape(size, m)
        duration, first, first_by, parts = times[0], None, None, self.array([])
        if self.kneed:
            final = self._fly(self.free, start, D, parameters, times[0])
            assert self.algebra.lock is not None
            out = self.algebra.lock(np.concatenate([final[:6], self._padded(final[6:], 6), parameters]))
            start, parts, first, first_by, _ = np.split(out, np.cumsum([4, 4 * (m + 2), 1, m + 1]))
            first = first[0]
            D = self.array(np.eye(4, m, -1).ravel()).reshape(4, m)
            duration = times[1] - times[0]
        final = self._fly(self.locked, start, D, parameters, duration)
        out = self.algebra.finish(np.concatenate([y, final[:4], self._padded(final[4:], 4), parts, parameters]))
        cut = np.split(out, np.cumsum([m, m * m, m * m, m, 1, m + 1, 2]))
        after, after_by = times[-1] + cut[4][0], cut[5][None, :m]
        if first is None or first_by is None:
            times, by = np.array([after], dtype=self.kind), after_by
        else:
            times = np.array([times[0] + first, after + first], dtype=self.kind)
            by = np.stack([first_by[:m], after_by[0] + first_by[:m]])
        return {"image": cut[0], "jacobian": cut[1].reshape(m, m), "newton": cut[3], "times": times, "times_by_y": by}

    def settled_stride(
        self, y: np.ndarray, times: np.ndarray, parameters: np.ndarray, turns: int = 4
    ) -> dict[str, np.ndarray]:
        """A stride whose event times are corrected until they are exact."""
        found = self.stride(y, times, parameters)
        for _ in range(turns):
            found = self.stride(y, found["times"], parameters)
        return found

    def fixed_point(
        self, y: np.ndarray, times: np.ndarray, parameters: np.ndarray, turns: int = 5
    ) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Newton's method from a point that double precision has settled."""
        for _ in range(turns):
            found = self.stride(y, times, parameters)
            y = y + found["newton"]
            times = found["times"] + sum(found["times_by_y"][:, j] * found["newton"][j] for j in range(self.m))
        return y, self.stride(y, times, parameters)
