"""The step map and its fixed points in extended precision, from the same symbols as
gaitsweep's.
"""

from typing import Any

import heyoka as hy
import numpy as np

from gaitsweep.tasks.mechanics.equations import system
from gaitsweep.tasks.mechanics.lumped import Structure
from gaitsweep.tasks.step.step_map import StrideMap, rows_of_end


class _Algebra(StrideMap):
    """The algebra between flows, compiled for another floating-point type."""

    def __init__(self, structure: Structure, kind: Any):
        self.structure, self.m, self.kneed, self.kind = (
            structure,
            structure.dimension,
            structure.kneed,
            kind,
        )
        self.start_size = 6 if self.kneed else 4
        self.begin = self._compile_start()
        if self.kneed:
            self.lock = self._compile_knee()
        self.finish = self._compile_finish()

    def _function(self, outputs: list[Any], variables: list[Any]) -> Any:
        return hy.cfunc(outputs, vars=variables, compact_mode=True, fp_type=self.kind)


def best_kind() -> tuple[str, Any]:
    """The widest floating-point type of heyoka: 113 bits, or 64 where that is missing."""
    if getattr(hy, "real128", None) is not None:
        return "real128", hy.real128
    return "long double", np.longdouble


def convert(values: Any, kind: Any) -> np.ndarray:
    """Convert values between floating-point types, as the sum of two doubles."""
    sums = []
    for x in values:
        leading = float(x)
        sums.append(kind(leading) + kind(float(x - type(x)(leading))))
    return np.array(sums, dtype=kind)


class Precise:
    """The step map, one step at a time, in a wider floating-point type.

    The walker's constants are those of the double-precision map, taken as exact, so
    differences are due to rounding.
    """

    def __init__(self, structure: Structure, kind: Any):
        self.kind, self.m, self.kneed = kind, structure.dimension, structure.kneed
        self.algebra = _Algebra(structure, kind)
        self.locked = self._integrator(structure, False, self.m)
        self.free = self._integrator(structure, True, self.m) if self.kneed else None

    def _integrator(self, structure: Structure, free: bool, directions: int) -> Any:
        motion = system(structure, free, directions, False)
        flow = hy.taylor_adaptive(
            motion.equations,
            self.array([0.0] * len(motion.equations)),
            fp_type=self.kind,
            compact_mode=True,
        )
        return flow, motion.parameters(fp_type=self.kind, compact_mode=True)

    def array(self, values: Any) -> np.ndarray:
        """Convert values to the wider type."""
        return convert(values, self.kind)

    def _integrate(
        self,
        flow: Any,
        start: np.ndarray,
        directions: np.ndarray,
        parameters: np.ndarray,
        duration: Any,
    ) -> np.ndarray:
        flow, constants_of = flow
        flow.time = self.kind(0.0)
        flow.state[:] = np.concatenate(
            [start, np.ascontiguousarray(directions.T).reshape(-1)]
        )
        flow.pars[:] = constants_of(parameters)
        flow.propagate_until(duration)
        return flow.state.copy()

    def _padded(self, flat: np.ndarray, size: int) -> np.ndarray:
        """Directions in the layout of the algebra, with zeros for that of the slope."""
        return np.concatenate(
            [flat.reshape(-1, size), [self.array([0.0] * size)]]
        ).T.reshape(-1)

    def stride(
        self, y: np.ndarray, times: np.ndarray, parameters: np.ndarray
    ) -> dict[str, np.ndarray]:
        """Image, Jacobian, Newton step and corrected event times of one step, as in
        `tasks.step.step_map`.

        Also the `residual` (m + phases,) of the joint equations at the given times, its
        `derivative` by y and the durations of the phases, and `start` (angles,), the
        state just after heelstrike.
        """
        m = self.m
        begin = self.algebra.begin(np.concatenate([y, parameters]))
        size = self.algebra.start_size
        start, D = after_heelstrike, _ = begin[:size], begin[size:].reshape(size, m)
        duration, parts, knee = times[0], self.array([]), self.array([])
        if self.kneed:
            final = self._integrate(self.free, start, D, parameters, times[0])
            out = self.algebra.lock(
                np.concatenate([final[:6], self._padded(final[6:], 6), parameters])
            )
            start, parts, knee, _ = np.split(out, np.cumsum([4, 4 * (m + 2), m + 3]))
            D = self.array(np.eye(4, m, -1).ravel()).reshape(4, m)
            duration = times[1] - times[0]
        final = self._integrate(self.locked, start, D, parameters, duration)
        directions = self._padded(final[4:], 4)
        out = self.algebra.finish(
            np.concatenate([y, final[:4], directions, parts, knee, parameters])
        )
        k = len(times)
        end = {
            name: out[rows].reshape(shape)
            for name, (rows, shape) in rows_of_end(m, k).items()
        }
        # The durations' shifts and their derivatives by y; heelstrike comes after both,
        # less the shift along the field.
        moved = end["shifts"][:, : m + 1].copy()
        if self.kneed:
            moved[1] += moved[0] - parts[m] * moved[0]
            moved[1, 1:] -= parts[:m]
        times, by = times + moved[:, 0], moved[:, 1:]
        return {
            "image": end["image"],
            "jacobian": end["jacobian"],
            "newton": end["newton"][:m],
            "times": times,
            "times_by_y": by,
            "residual": end["residual"],
            "derivative": end["derivative"][:, :-1],
            "start": after_heelstrike,
        }

    def settled_stride(
        self, y: np.ndarray, times: np.ndarray, parameters: np.ndarray, turns: int = 4
    ) -> dict[str, np.ndarray]:
        """One step, its event times corrected until they are exact."""
        step = self.stride(y, times, parameters)
        for _ in range(turns):
            step = self.stride(y, step["times"], parameters)
        return step

    def fixed_point(
        self, y: np.ndarray, times: np.ndarray, parameters: np.ndarray, turns: int = 5
    ) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Newton's method from a fixed point in double precision."""
        for _ in range(turns):
            step = self.stride(y, times, parameters)
            y = y + step["newton"]
            times = step["times"] + sum(
                step["times_by_y"][:, j] * step["newton"][j] for j in range(self.m)
            )
        return y, self.stride(y, times, parameters)
