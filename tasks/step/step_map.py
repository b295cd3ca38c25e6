"""The step map and its exact derivatives, with the event times as unknowns.

A gait is a zero of P(y) - y. The section's coordinates y are, just after heelstrike,
(stance angle, stance rate) for point feet, whose impact leaves no other freedom,
(stance angle, stance rate, swing rate) for straight legs, and, just before heelstrike,
(stance angle, old stance rate, old swing rate) for kneed ones, whose locked legs need
no fourth coordinate. Each phase is a flow over a given time; the value of its guard at
the end is corrected to first order, which gives the saltation terms exactly and makes
the event times converge quadratically. Newton's method has the event times among its
unknowns: where a strike turns tangential its time is no smooth function of the state,
but state and times together are regular. In shapes, n counts lanes, m section
coordinates and k phases.
"""

from __future__ import annotations

import copy
import functools
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import heyoka as hy
import numpy as np

from gaitsweep.tasks.mechanics.equations import ZERO, Solver, Sym, Symbols, rows
from gaitsweep.tasks.mechanics.kernel import (
    LANES,
    CompiledFunction,
    flow,
    prepare_compiler,
    whole_groups,
)
from gaitsweep.tasks.mechanics.lumped import Structure, general_structure, locked
from gaitsweep.tasks.mechanics.sums import matvec
from gaitsweep.tasks.step.lanes import slices
from gaitsweep.tasks.step.symbols import (
    derivatives_along,
    end_of_step,
    flat,
    inverse,
    lock_knee,
    matrix,
    start_of_step,
)

#: Intervals at whose ends the motion is sampled to verify a step.
SAMPLES = 16


@dataclass
class Stride:
    """One step of n lanes, to first order, in scaled angles and rates and times in
    sqrt(leg/g).

    Attributes
    ----------
    y : ndarray, shape (m, n)
        Section coordinates at the start.
    image : ndarray, shape (m, n)
        P(y), the event times corrected.
    jacobian : ndarray, shape (m, m, n)
        dP/dy.
    times : ndarray, shape (k, n)
        Kneestrike, for knees, and heelstrike, corrected.
    by_slope : ndarray, shape (m, n)
        Derivative of P(y) by the slope; zero where not asked for.
    residual : ndarray, shape (m + k, n)
        Of the joint equations: the image less y, at the given durations of the phases,
        and the guards of the strikes.
    derivative : ndarray, shape (m + k, m + k + 1, n)
        Of the residual by y, the event times and the slope.
    inverse : ndarray, shape (m + k, m + k, n)
        How far a residual moves the fixed point's y and its event times.
    newton, newton_times : ndarray, shape (m, n) and (k, n)
        Newton step of P(y) = y, and the event times after it.
    impact, impact_by_y : ndarray, shape (2, n) and (2, m, n)
        Rates just before heelstrike.
    start : ndarray, shape (angles, n)
        State just after heelstrike.
    closing : ndarray, shape (k, n)
        Rates of the guards at the strikes.
    knee, knee_by_y : ndarray, shape (6, n) and (6, m, n)
        State at kneestrike; empty for straight legs.
    motion : list of ndarray, shape (samples + 1, angles, n)
        Samples of each phase; of no samples where not asked for.
    """

    y: np.ndarray
    image: np.ndarray
    jacobian: np.ndarray
    times: np.ndarray
    by_slope: np.ndarray
    residual: np.ndarray
    derivative: np.ndarray
    inverse: np.ndarray
    newton: np.ndarray
    newton_times: np.ndarray
    impact: np.ndarray
    impact_by_y: np.ndarray
    start: np.ndarray
    closing: np.ndarray
    knee: np.ndarray
    knee_by_y: np.ndarray
    motion: list[np.ndarray]

    def scaled_motion(self) -> list[np.ndarray]:
        """Samples of each phase over the stance angle, by which neighbours on a branch
        are compared.

        Returns
        -------
        list of ndarray, shape (samples + 1, angles, n)
        """
        return [phase / self.y[0] for phase in self.motion]

    def mapped(self, change: Callable[[np.ndarray], np.ndarray]) -> Stride:
        """Return a stride of changed arrays."""
        changed = copy.copy(self)
        for name, values in vars(self).items():
            setattr(
                changed,
                name,
                [change(x) for x in values]
                if isinstance(values, list)
                else change(values),
            )
        return changed

    #: Of a single step: see `tasks.step.several_steps.Strides`.
    steps = 1

    @property
    def one(self) -> Stride:
        """The single steps."""
        return self

    singles = one

    def move_impacts(self) -> None:
        """Correct the states at the impacts to the fixed point."""
        self.impact = self.impact + matvec(self.impact_by_y, self.newton)
        self.knee = self.knee + matvec(self.knee_by_y, self.newton)


class StrideMap:
    """The step map of one structure: compiled flows and the compiled algebra between
    them.
    """

    def __init__(self, structure: Structure):
        self.structure, self.m = structure, structure.dimension
        self.kneed = structure.kneed
        self.start_size = 6 if self.kneed else 4
        self._start = self._compile_start()
        if self.kneed:
            self._knee = self._compile_knee()
        self._finish = self._compile_finish()
        self._end = rows_of_end(self.m, 1 + self.kneed)

    def _function(self, outputs: list[Any], variables: list[Any]) -> CompiledFunction:
        """Compile a function; `tests/soak/extended_reference.py` overrides this with
        wider numbers.
        """
        return CompiledFunction(outputs, variables)

    def _compile_start(self) -> CompiledFunction:
        p = Symbols(self.structure)
        y = list(hy.make_vars(*(f"y{i}" for i in range(self.m))))
        state = start_of_step(self.structure, p, y)
        return self._function(
            state + flat([[hy.diff(x, v) for v in y] for x in state]),
            [*y, *p.variables],
        )

    def _compile_knee(self) -> CompiledFunction:
        """From the end of three links to the start of two, with directions (y,
        duration, slope).

        The flow of two links carries its own field and three unit vectors beside it,
        whatever the directions: a part along the field is only a shift of time, which
        the next event takes up. So each direction is given by its four parts, the
        field's first.
        """
        p = Symbols(self.structure)
        m = self.m + 1
        x = list(hy.make_vars(*(f"x{i}" for i in range(6))))
        D = matrix("d", 6, m)
        q, rate = x[:3], x[3:]
        M, f = rows(p, q, rate, True)
        field = [*rate, *Solver(M)(f)]
        guard, closing = q[1] - q[2], rate[1] - rate[2]
        guard_by = [D[1][d] - D[2][d] for d in range(m)]
        lock = lock_knee(p, x)
        by_direction = derivatives_along(
            lock, x, [[*D[i][: self.m], field[i], *D[i][self.m :]] for i in range(6)]
        )
        M, f = rows(p, lock[:2], lock[2:], False)
        after = [lock[2], lock[3], *Solver(M)(f)]
        along = [d / after[0] for d in by_direction[0]]
        parts = [along] + [
            [d - c * after[i] for d, c in zip(by_direction[i], along, strict=True)]
            for i in range(1, 4)
        ]
        strike = [x[i] - field[i] * guard / closing for i in range(6)]
        strike += [
            D[i][d] - field[i] * guard_by[d] / closing
            for i in range(6)
            for d in range(self.m)
        ]
        guards = [guard, *guard_by[: self.m], closing, *guard_by[self.m :]]
        return self._function(
            lock + flat(parts) + guards + strike, [*x, *flat(D), *p.variables]
        )

    def _compile_finish(self) -> CompiledFunction:
        """From the end of two links to the image on the section, its derivatives and
        the Newton step.

        Directions are (y, the duration of the phase with a free knee, slope), the
        second only with knees.
        """
        p = Symbols(self.structure)
        m, k = self.m, 1 + self.kneed
        y = list(hy.make_vars(*(f"y{i}" for i in range(m))))
        x = list(hy.make_vars(*(f"x{i}" for i in range(4))))
        carried = D = matrix("d", 4, 4 if self.kneed else m + 1)
        parts: list[list[Sym]] = matrix("c", 4, m + 2) if self.kneed else []
        knee: list[list[Sym]] = matrix("k", 1, m + 3) if self.kneed else []
        if self.kneed:
            D = [
                [
                    sum(
                        (parts[1 + j][d] * carried[i][j] for j in range(3)),
                        carried[i][3] if d > m else ZERO,
                    )
                    for d in range(m + 2)
                ]
                for i in range(4)
            ]
        M, f = rows(p, x[:2], x[2:], False)
        field = [x[2], x[3], *Solver(M)(f)]
        # By y, durations, slope.
        D = [[*D[i][:-1], field[i], D[i][-1]] for i in range(4)]
        section = end_of_step(self.structure, p, x)
        by = derivatives_along(section, x, D)
        guards = [g[0] for g in knee] + [x[0] + x[1]]
        guards_by = [[*g[1:-1], ZERO, g[-1]] for g in knee] + [
            [D[0][d] + D[1][d] for d in range(m + k + 1)]
        ]
        residual = [*(section[i] - y[i] for i in range(m)), *guards]
        derivative = [
            [by[i][d] - float(i == d) for d in range(m + k + 1)] for i in range(m)
        ] + guards_by
        moves = inverse(
            [[-derivative[i][j] for j in range(m + k)] for i in range(m + k)]
        )
        newton = [
            sum((moves[i][j] * residual[j] for j in range(m + k)), ZERO)
            for i in range(m + k)
        ]
        # The durations by the guards' values, y and the slope, one after another.
        shifts: list[list[Sym]] = []
        for j, (guard, row) in enumerate(zip(guards, guards_by, strict=True)):
            values = [guard, *row[:m], row[-1]]
            for i, earlier in enumerate(shifts):
                values = [
                    v + row[m + i] * e for v, e in zip(values, earlier, strict=True)
                ]
            shifts.append([-v / row[m + j] for v in values])

        def struck(row: list[Sym], d: int, value: Sym) -> Sym:
            """A value with the derivatives `row` where the guards close: itself (d =
            0), or its derivative.
            """
            return sum((row[m + j] * shifts[j][d] for j in range(k)), value)

        outputs = [
            *(struck(by[i], 0, section[i]) for i in range(m)),
            *(struck(by[i], 1 + d, by[i][d]) for i in range(m) for d in range(m)),
            *(struck(by[i], 1 + m, by[i][-1]) for i in range(m)),
            *flat(shifts),
            *residual,
            *flat(derivative),
            *flat(moves),
            *newton,
            *(struck(D[i], 0, x[i]) for i in (2, 3)),
            *(struck(D[i], 1 + d, D[i][d]) for i in (2, 3) for d in range(m)),
        ]
        return self._function(
            outputs, [*y, *x, *flat(carried), *flat(parts), *flat(knee), *p.variables]
        )

    def _apply(self, function: CompiledFunction, inputs: np.ndarray) -> np.ndarray:
        """Call a compiled function on lanes padded to whole SIMD groups, so that every
        lane runs the same code.
        """
        # A register's sines are computed in another way if one of its arguments is not
        # finite.
        lost = ~np.isfinite(inputs).all(axis=0)
        result = function(whole_groups(np.where(lost, 0.0, inputs), LANES))[
            :, : inputs.shape[1]
        ]
        result[:, lost] = np.nan
        return result

    def start(self, y: np.ndarray, parameters: np.ndarray) -> np.ndarray:
        """State just after heelstrike, then its derivatives by y.

        Parameters
        ----------
        y : ndarray, shape (m, n)
            Scaled section coordinates.
        parameters : ndarray, shape (n_parameters, n)
            Slope, scale and the structure's constants.

        Returns
        -------
        ndarray, shape (start_size (1 + m), n)
            Scaled angles and rates; the matrix of derivatives follows row by row.
        """
        return self._apply(self._start, np.vstack([y, parameters]))

    def __call__(
        self,
        y: np.ndarray,
        times: np.ndarray,
        parameters: np.ndarray,
        slope: bool = False,
        samples: int = 0,
        coarse: bool = False,
    ) -> Stride:
        """Evaluate steps and their derivatives.

        Parameters
        ----------
        y : ndarray, shape (m, n)
            Scaled section coordinates.
        times : ndarray, shape (k, n) [sqrt(leg/g)]
            Initial guesses of the heelstrike time, or of (kneestrike, heelstrike).
        parameters : ndarray, shape (n_parameters, n)
            Slope, scale and the structure's constants.
        slope : bool
            Also differentiate by the slope.
        samples : int
            Equal intervals of each phase at whose ends the motion is also returned.
        coarse : bool
            Integrate to the search's tolerance only.

        Returns
        -------
        Stride
            NaN in lanes whose integration failed.
        """
        m, n = y.shape
        size = self.start_size
        start, by_y = _split(self.start(y, parameters), size)
        D = by_y.reshape(size, m, n)
        if slope:
            D = np.concatenate([D, np.zeros((size, 1, n))], axis=1)
        k, motion, strike, parts, knee = (
            len(times),
            [],
            *(np.empty((0, n)) for _ in range(3)),
        )
        times_by = np.zeros((k, m + k + 1, n))
        times_by[:, m + k - 1] = np.arange(k)[:, None] == k - 1
        if self.kneed:
            integrate = flow(self.structure, m + slope, slope, coarse)
            final, phase = integrate(
                np.vstack([start, _lanes(D)]), parameters, times[0], samples
            )
            motion.append(phase)
            out = self._apply(
                self._knee,
                np.vstack([final[:6], _unlanes(final[6:], 6, m + 1), parameters]),
            )
            start2, parts, knee, strike = _split(out, 4, 4 * (m + 2), m + 3)
            D = np.broadcast_to(np.eye(4, 3 + slope, -1)[:, :, None], (4, 3 + slope, n))
            duration = times[1] - times[0]
            # Heelstrike is timed from the start of the step; a part along the field is
            # a shift of time.
            times_by[:, m] = 1.0
            times_by[1, [*range(m + 1), m + 2]] -= parts[: m + 2]
        else:
            start2, duration = start, times[0]
        integrate = flow(
            general_structure(False) if self.kneed else self.structure,
            D.shape[1],
            slope,
            coarse,
        )
        constants = locked(parameters) if self.kneed else parameters
        final, phase = integrate(
            np.vstack([start2, _lanes(D)]), constants, duration, samples
        )
        motion.append(phase)
        directions = _unlanes(final[4:], 4, 4 if self.kneed else m + 1)
        out = self._apply(
            self._finish, np.vstack([y, final[:4], directions, parts, knee, parameters])
        )
        end = {
            name: out[rows].reshape(*shape, n)
            for name, (rows, shape) in self._end.items()
        }
        shifts, moves, newton, derivative = (
            end.pop("shifts"),
            end.pop("moves"),
            end.pop("newton"),
            end["derivative"],
        )
        # A later kneestrike with the same heelstrike shortens the last phase, and so
        # does all else.
        if self.kneed:
            others = [*range(m + 1), m + 2]
            derivative[:, others] -= derivative[:, [m + 1]] * times_by[1, others]
        return Stride(
            **end,
            y=y,
            times=times + matvec(times_by[:, m : m + k], shifts[:, 0]),
            inverse=np.stack(
                [
                    *moves[:m],
                    *(matvec(moves.swapaxes(0, 1), row[: m + k]) for row in times_by),
                ]
            ),
            newton=newton[:m],
            newton_times=times + matvec(times_by[:, : m + k], newton),
            start=start,
            closing=np.stack([derivative[m + j, m + j] for j in range(k)]),
            knee=strike[:6],
            knee_by_y=strike[6:].reshape(len(strike[:6]), m, n),
            motion=motion,
        )


def rows_of_end(m: int, k: int) -> dict[str, tuple[slice, tuple[int, ...]]]:
    """Rows and shape of all that the end of a step gives, for m coordinates and k
    phases.
    """
    shapes: dict[str, tuple[int, ...]] = {
        **{
            "image": (m,),
            "jacobian": (m, m),
            "by_slope": (m,),
            "shifts": (k, m + 2),
            "residual": (m + k,),
        },
        **{
            "derivative": (m + k, m + k + 1),
            "moves": (m + k, m + k),
            "newton": (m + k,),
        },
        **{"impact": (2,), "impact_by_y": (2, m)},
    }
    rows = slices([math.prod(shape) for shape in shapes.values()])
    return {
        name: (own, shape)
        for own, (name, shape) in zip(rows, shapes.items(), strict=True)
    }


def _split(values: np.ndarray, *sizes: int) -> list[np.ndarray]:
    """Parts of so many rows, and the rest."""
    parts, end = [], 0
    for size in sizes:
        parts.append(values[end : (end := end + size)])
    return [*parts, values[end:]]


def _lanes(D: np.ndarray) -> np.ndarray:
    """Directions (size, d, n) in the order of the flow's states: angles, then rates,
    one direction after another.
    """
    return D.transpose(1, 0, 2).reshape(-1, D.shape[2])


def _unlanes(flat: np.ndarray, size: int, directions: int) -> np.ndarray:
    """Back from the flow's order to rows of (size, directions); the slope's direction
    is zero where it has none.
    """
    n = flat.shape[1]
    rows = np.zeros((size, directions, n))
    rows[:, : len(flat) // size] = flat.reshape(-1, size, n).transpose(1, 0, 2)
    return rows.reshape(-1, n)


@functools.lru_cache(maxsize=64)
def stride_map(structure: Structure) -> StrideMap:
    """Return the compiled step map of a structure, one a process."""
    prepare_compiler()
    return StrideMap(structure)
