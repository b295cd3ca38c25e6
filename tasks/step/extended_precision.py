"""Fixed points to more digits than a double's stride map resolves.

Near vanishing slope I - DP is singular like slope^(2/3), and the rounding of P in doubles becomes the error of the
gait.
There the residual is evaluated in long double or in 128 bits; Newton keeps the double's derivative.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

import heyoka as hy
import numpy as np

from tasks.mechanics.equations import Symbols, system
from tasks.mechanics.impacts import heelstrike, kneestrike
from tasks.mechanics.kernel import prepare_compiler
from tasks.mechanics.lumped import Structure, lump
from tasks.step.problem import EPS, Problem, sizes
from tasks.step.step_map import Stride

#: Bounds of a double's fixed point above which long double is asked, and 128 bits.
ESCALATE, ESCALATE_AGAIN = 1e-12, 4e-9
#: Each tier's number and its rounding unit.
TIERS: tuple[tuple[Any, float], ...] = ((np.longdouble, 1.1e-19), (hy.real128, 1.93e-34))
MAX_STEPS = 6


class Extended:
    """The stride map of one structure, one lane at a time, in a wider number; no derivatives."""

    def __init__(self, structure: Structure, number: Any, unit: float):
        self.structure, self.number, self.missed = structure, number, 0.1 * unit**0.5
        self.m, self.kneed = structure.dimension, structure.kneed
        flows = [True, False] if self.kneed else [False]
        systems = [system(structure, free, 0, False) for free in flows]
        self._flows = [
            hy.taylor_adaptive(
                flown.equations,
                state=self._array(np.zeros(len(flown.equations))),
                fp_type=number,
                tol=number(2 * unit),
                compact_mode=True,
            )
            for flown in systems
        ]
        self._held = [flown.parameters(fp_type=number, compact_mode=True) for flown in systems]
        self._start, self._knee, self._finish = self._compile()

    def _array(self, values: Any) -> np.ndarray:
        return np.array([self.number(v) for v in values], dtype=self.number)

    def _compile(self) -> tuple[Any, Any, Any]:
        p = Symbols(self.structure)
        y = list(hy.make_vars(*(f"y{i}" for i in range(self.m))))
        x = list(hy.make_vars(*(f"x{i}" for i in range(6))))

        def function(outputs: list[Any], variables: list[Any]) -> Any:
            return hy.cfunc(outputs, vars=[*variables, *p.variables], fp_type=self.number, compact_mode=True)

        knee = None
        if self.kneed:
            start = [y[0], -y[0], -y[0], *heelstrike(p, y[0], y[1], y[2], True)]
            knee = function([x[1] - x[2], x[4] - x[5], x[0], x[1], *kneestrike(p, x[:3], x[3:])], x)
        elif self.structure.point_foot:
            start = [y[0], -y[0], y[1], y[1] * hy.cos(2.0 * p.scale * y[0])]
        else:
            start = [y[0], -y[0], y[1], y[2]]
        two = x[:4]
        image = (
            [two[1], two[2], two[3]]
            if self.kneed
            else [two[1], *heelstrike(p, two[1], two[2], two[3], False)[: self.m - 1]]
        )
        finish = [two[0] + two[1], two[2] + two[3], *image, two[2], two[3]]
        return function(start, y), knee, function(finish, two)

    def _flow(self, k: int, state: np.ndarray, parameters: np.ndarray, duration: Any) -> np.ndarray:
        ta = self._flows[k]
        ta.time = self.number(0.0)
        ta.state[:] = state
        ta.pars[:] = self._held[k](parameters)
        ta.propagate_until(duration)
        return ta.state.copy()

    def _to_guard(
        self, k: int, state: np.ndarray, parameters: np.ndarray, duration: Any, guard: Any
    ) -> tuple[np.ndarray, Any, np.ndarray]:
        """Fly to where a guard closes: the state, its time, and what the guard's function says there."""
        total = duration
        state = self._flow(k, state, parameters, duration)
        said = self._call(guard, state, parameters)
        for _ in range(4):
            shift = -said[0] / said[1]
            state = self._flow(k, state, parameters, shift)
            total = total + shift
            said = self._call(guard, state, parameters)
            # What is left is the square of what was missed.
            if not abs(float(shift)) > self.missed:
                break
        return state, total, said

    def _call(self, function: Any, values: np.ndarray, parameters: np.ndarray) -> np.ndarray:
        return function(np.concatenate([values, parameters]))

    def start(self, y: np.ndarray, parameters: np.ndarray) -> np.ndarray:
        """State just after heelstrike at y."""
        return self._call(self._start, y, parameters)

    def __call__(
        self, y: np.ndarray, times: np.ndarray, parameters: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Image of y, the event times, and the rates just before heelstrike, all in this number."""
        state = self.start(y, parameters)
        begun, ends = self.number(0.0), []
        if self.kneed:
            state, begun, said = self._to_guard(0, state, parameters, times[0], self._knee)
            ends.append(begun)
            state = said[2:]
        _, last, said = self._to_guard(-1, state, parameters, times[-1] - begun, self._finish)
        return said[2 : 2 + self.m], np.array([*ends, begun + last], dtype=self.number), said[2 + self.m :]


@functools.lru_cache(maxsize=16)
def _map(structure: Structure, tier: int) -> Extended:
    prepare_compiler()
    return Extended(structure, *TIERS[tier])


@dataclass
class Wide:
    """One gait in a wider number: scaled section, event times, rates just before heelstrike, state just after.

    `left` is the relative size of the last Newton step, `rounding` the error besides: of the number itself, and of
    narrowing it.
    """

    y: np.ndarray
    times: np.ndarray
    impact: np.ndarray
    state: np.ndarray
    left: float
    rounding: float = 0.0


def solved(
    problem: Problem, lane: int, stride: Stride, y: np.ndarray, times: np.ndarray, slope: float, scale: float, tier: int
) -> Wide:
    """A gait near (y, times) by Newton's method, its residual in the tier's number, its derivative the double's.

    Parameters
    ----------
    stride : Stride
        The double's stride.
    y : ndarray, shape (m,)
    times : ndarray, shape (phases,)
    tier : int
        Index into `TIERS`.
    """
    number, _ = TIERS[tier]
    exact = _map(problem.structure, tier)
    constants = lump(problem.walker_of(lane), number)
    parameters = np.array(
        [number(slope), number(scale), *(constants[k] for k in problem.structure.constants)], dtype=number
    )
    wide, wide_times = (
        np.array([number(v) for v in y], dtype=number),
        np.array([number(v) for v in times], dtype=number),
    )
    inverse = stride.inverse[:, :, lane]
    measure = sizes(y[:, None])[:, 0]
    before = size = np.inf
    for _ in range(MAX_STEPS):
        image, wide_times, impact = exact(wide, wide_times, parameters)
        miss = np.array([float(v) for v in image - wide])
        step = inverse @ miss
        shift = stride.times_by_y[:, :, lane] @ step
        size = float(max(np.max(np.abs(step / measure)), np.max(np.abs(shift / times))))
        if not size <= 0.5 * before:
            break
        wide = wide + np.array([number(v) for v in step], dtype=number)
        wide_times = wide_times + np.array([number(v) for v in shift], dtype=number)
        before = size
        if size < EPS / 64:
            break
    return Wide(wide, wide_times, impact, exact.start(wide, parameters), min(before, size))


def refine(
    problem: Problem,
    lane: int,
    stride: Stride,
    y: np.ndarray,
    times: np.ndarray,
    slope: float,
    scale: float,
    bound: float,
) -> Wide:
    """One gait to a double's last digits, narrowed to doubles; long double where that will do, else 128 bits.

    Parameters
    ----------
    stride : Stride
        The double's stride, whose derivative Newton keeps.
    y : ndarray, shape (m,)
    times : ndarray, shape (phases,)
    bound : float
        The double's error bound.
    """
    tier = 0 if bound < ESCALATE_AGAIN else 1
    found = solved(problem, lane, stride, y, times, slope, scale, tier)

    def narrow(values: np.ndarray) -> np.ndarray:
        return np.array([float(v) for v in values])

    return Wide(
        narrow(found.y),
        narrow(found.times),
        narrow(found.impact),
        narrow(found.state),
        found.left,
        bound * TIERS[tier][1] / EPS + 4 * EPS,
    )
