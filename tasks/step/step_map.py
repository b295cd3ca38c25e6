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
from typing import Any, NamedTuple

import heyoka as hy
import numpy as np

from gaitsweep.tasks.mechanics.arrays import (
    Motion,
    Parameters,
    PerLane,
    Sections,
    States,
    Times,
)
from gaitsweep.tasks.mechanics.equations import ZERO, Sym, Symbols
from gaitsweep.tasks.mechanics.kernel import (
    LANES,
    CompiledFunction,
    compiled,
    flow,
    is_compact,
    whole_groups,
)
from gaitsweep.tasks.mechanics.lumped import Structure, locked
from gaitsweep.tasks.mechanics.sums import matvec, total
from gaitsweep.tasks.step.lanes import slices
from gaitsweep.tasks.step.symbols import (
    derivatives_along,
    dot,
    end_of_step,
    field,
    flat,
    inverse,
    lock_knee,
    matrix,
    start_of_step,
    vector,
)

#: Intervals at whose ends the motion is sampled to verify a step.
SAMPLES = 16


@dataclass
class Stride:
    """One step of n lanes, to first order, in scaled angles and rates and times in
    sqrt(leg/g).

    Of one that is evaluated without derivatives these are NaN, and so is what they
    correct: it has the event times and, at heelstrike, the rates at the times given.

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
    by_drive : ndarray, shape (m, n)
        Derivative of P(y) by the drive, the slope or what else drives the walker; zero
        where it is not asked for, but in compact code.
    residual : ndarray, shape (m + k, n)
        Of the joint equations: the image less y, at the given durations of the phases,
        and the guards of the strikes.
    derivative : ndarray, shape (m + k, m + k + 1, n)
        Of the residual by y, the event times and the drive.
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

    y: Sections
    image: Sections
    jacobian: np.ndarray
    times: Times
    by_drive: Sections
    residual: np.ndarray
    derivative: np.ndarray
    inverse: np.ndarray
    newton: Sections
    newton_times: Times
    impact: np.ndarray
    impact_by_y: np.ndarray
    start: States
    closing: np.ndarray
    knee: np.ndarray
    knee_by_y: np.ndarray
    motion: Motion

    def scaled_motion(self) -> Motion:
        """Samples of each phase over the stance angle, by which neighbours on a branch
        are compared.
        """
        return [phase / self.y[0] for phase in self.motion]

    def mapped(self, change: Callable[[np.ndarray], np.ndarray]) -> Stride:
        """Return a stride of changed arrays."""
        changed = copy.copy(self)

        for name, values in vars(self).items():
            setattr(changed, name, _changed(values, change))
        return changed

    #: Of a single step: see `tasks.step.several_steps.Strides`.
    steps = 1

    @property
    def one(self) -> Stride:
        """The single steps."""
        return self

    singles = one

    def carried(self, rows: np.ndarray) -> np.ndarray:
        """Product of rows (i, m + k, n) with the derivatives of the image, at the given
        durations, and of the guards by y, shape (i, m, n).
        """
        m = len(self.y)
        by_y = self.derivative[:, :m] + np.eye(len(self.derivative), m)[..., None]
        return matvec(rows[:, :, None], by_y)

    def move_impacts(self) -> None:
        """Correct the states at the impacts to the fixed point."""
        self.impact = self.impact + matvec(self.impact_by_y, self.newton)
        self.knee = self.knee + matvec(self.knee_by_y, self.newton)


def _changed(values: Any, change: Callable[[np.ndarray], np.ndarray]) -> Any:
    """An array changed, or a list of arrays."""
    if isinstance(values, list):
        return [change(array) for array in values]
    return change(values)


class _Phase(NamedTuple):
    """A phase to integrate; D (angles, directions, n) are the directions carried along,
    that by the drive last where it is asked for, of at most `width`.
    """

    structure: Structure
    state: States
    D: np.ndarray
    parameters: Parameters
    duration: PerLane
    width: int


class _Flown(NamedTuple):
    """A phase integrated: the state at its end, then its directions as rows; samples of
    its motion; and, where it is asked for, what a unit damper dissipated.
    """

    end: np.ndarray
    motion: np.ndarray
    dissipated: np.ndarray


class _Kneestrike(NamedTuple):
    """What kneestrike makes of a phase: the state after, (4, n), directions as parts
    along and beside the field, (4 (m + 2), n), the guard with its derivatives and rate,
    (m + 3, n), and the state before with its derivatives by y, (6 (1 + m), n); empty
    for straight legs.
    """

    after: States
    parts: np.ndarray
    guard: np.ndarray
    before: np.ndarray


class StrideMap:
    """The step map of one structure: compiled flows and the compiled algebra between
    them.
    """

    def __init__(self, structure: Structure):
        self.structure = structure
        self.m, self.kneed = structure.dimension, structure.kneed
        self.start_size = 6 if self.kneed else 4
        self._start = self._compile_start()

        if self.kneed:
            self._knee = self._compile_knee()
        self._finish = self._compile_finish()

    @functools.cached_property
    def _end(self) -> CompiledFunction:
        """From the end of two links to the residual of the joint equations and the
        rates just before heelstrike, without derivatives; it has the guard of
        kneestrike.
        """
        return compiled(_end_without_derivatives, self.structure)

    @property
    def by_push(self) -> bool:
        """Whether the drive acts in heelstrike alone, not all along as the slope does."""
        return self.structure.drive == "push_off"

    def _function(self, outputs: list[Any], variables: list[Any]) -> CompiledFunction:
        """Compile a function; `tests/soak/extended_reference.py` overrides this with
        wider numbers.
        """
        return CompiledFunction(outputs, variables)

    def _compile_start(self) -> CompiledFunction:
        p = Symbols(self.structure)
        y = vector("y", self.m)
        state = start_of_step(self.structure, p, y)
        gradients = [[hy.diff(value, v) for v in y] for value in state]
        by_push = [hy.diff(value, p.push) for value in state] if self.by_push else []

        return self._function(state + flat(gradients) + by_push, [*y, *p.variables])

    def _compile_knee(self) -> CompiledFunction:
        """From the end of three links to the start of two, with directions (y,
        duration, drive).

        The flow of two links carries its own field and three unit vectors beside it,
        whatever the directions: a part along the field is only a shift of time, which
        the next event takes up. So each direction is given by its four parts, the
        field's first.
        """
        p, m = Symbols(self.structure), self.m
        x, carried = vector("x", 6), matrix("d", 6, m + 1)
        rates = field(p, x, True)
        D = []

        for row, rate in zip(carried, rates, strict=True):
            D.append([*row[:m], rate, row[m]])
        lock = lock_knee(p, x)
        parts = _parts(derivatives_along(lock, x, D), field(p, lock, False))
        outputs = lock + flat(parts) + _at_kneestrike(x, rates, carried)

        return self._function(outputs, [*x, *flat(carried), *p.variables])

    def _compile_finish(self) -> CompiledFunction:
        """From the end of two links to the image on the section, its derivatives and
        the Newton step, in the order of `rows_of_end`.

        Directions are (y, the durations of the phases, drive).
        """
        p, m = Symbols(self.structure), self.m
        y, x = vector("y", m), vector("x", 4)
        carried = matrix("d", 4, 4 if self.kneed else m + 1)
        parts = matrix("c", 4, m + 2) if self.kneed else []
        knee = matrix("k", 1, m + 3) if self.kneed else []
        variables = [*y, *x, *flat(carried), *flat(parts), *flat(knee), *p.variables]

        D = self._directions(carried, parts, field(p, x, False))
        section = end_of_step(self.structure, p, x)
        section_by = derivatives_along(section, x, D)

        if self.by_push:
            for row, value in zip(section_by, section, strict=True):
                row[-1] = row[-1] + hy.diff(value, p.push)

        outputs = _to_first_order(y, x, D, section, section_by, knee)

        return self._function(outputs, variables)

    def _directions(
        self, carried: list[list[Sym]], parts: list[list[Sym]], rates: list[Sym]
    ) -> list[list[Sym]]:
        """Derivatives of the state at the end by y, the durations and the drive, from
        those that the last flow carried.

        With knees it carried unit vectors, of which `parts` make (y, the duration of
        the phase with a free knee, drive).
        """
        directions = []

        for row, rate in zip(carried, rates, strict=True):
            if self.kneed:
                starts = [ZERO] * (self.m + 1) + [row[3]]
                columns = zip(*parts[1:], strict=True)
                row = [
                    dot(column, row[:3], start)
                    for column, start in zip(columns, starts, strict=True)
                ]

            directions.append([*row[:-1], rate, row[-1]])

        return directions

    def _apply(self, function: CompiledFunction, inputs: np.ndarray) -> np.ndarray:
        """Call a compiled function on lanes padded to whole SIMD groups, so that every
        lane runs the same code.
        """
        # A register's sines are computed in another way if one of its arguments is not
        # finite.
        lost = ~np.isfinite(inputs).all(axis=0)
        padded = whole_groups(np.where(lost, 0.0, inputs), LANES)
        result = function(padded)[:, : inputs.shape[1]]
        result[:, lost] = np.nan

        return result

    def start(self, y: Sections, parameters: Parameters) -> np.ndarray:
        """State just after heelstrike, then the matrix of its derivatives by y row by
        row, shape (start_size (1 + m), n).
        """
        values = self._apply(self._start, np.vstack([y, parameters]))

        return values[: self.start_size * (1 + self.m)]

    def __call__(
        self,
        y: Sections,
        times: Times,
        parameters: Parameters,
        by_drive: bool = False,
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
        by_drive : bool
            Also differentiate by the drive; compact code always does, but for a search.
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
        # Compact code has one flow for steps with and without that derivative: it is
        # sooner compiled and loaded than a second one.
        by_drive = by_drive or (is_compact() and not coarse)
        begin = self._begin(y, parameters, by_drive)
        # Along its motion nothing but the slope or a torque acts.
        in_motion = by_drive and not self.by_push
        fly = functools.partial(
            _integrate, by_drive=in_motion, samples=samples, coarse=coarse
        )
        flown, strike = self._fly(fly, begin, parameters, times, 3 + in_motion)

        end = flown[-1].end
        inputs = np.vstack([y, end, strike.parts, strike.guard, parameters])
        out = self._apply(self._finish, inputs)
        angles = 6 if self.kneed else 0

        return Stride(
            **self._by_times(out, times, strike.parts),
            y=y,
            start=begin[0],
            knee=strike.before[:angles],
            knee_by_y=strike.before[angles:].reshape(angles, m, n),
            motion=[phase.motion for phase in flown],
        )

    def dissipation(self, y: Sections, times: Times, parameters: Parameters) -> PerLane:
        """Integrate over steps the square of the rate at which the thighs open.

        They are flown without derivatives, at a small share of the cost.

        Parameters
        ----------
        y : ndarray, shape (m, n)
            Scaled sections.
        times : ndarray, shape (k, n) [sqrt(leg/g)]
            The heelstrike time, or (kneestrike, heelstrike).
        parameters : ndarray, shape (n_parameters, n)

        Returns
        -------
        ndarray, shape (n,)
            Of scaled rates: what a damper of unit damping dissipates.
        """
        begin = self._begin_alone(y, parameters)
        flown, _ = self._fly(_integrate_dissipation, begin, parameters, times, 0)

        return total(phase.dissipated for phase in flown)

    def without_derivatives(
        self, y: Sections, times: Times, parameters: Parameters, samples: int = 0
    ) -> Stride:
        """Evaluate steps without their derivatives, at a small share of the cost.

        Parameters
        ----------
        y : ndarray, shape (m, n)
            Scaled sections.
        times : ndarray, shape (k, n) [sqrt(leg/g)]
            The heelstrike time, or (kneestrike, heelstrike).
        parameters : ndarray, shape (n_parameters, n)
        samples : int
            Equal intervals of each phase at whose ends the motion is also returned.

        Returns
        -------
        Stride
            NaN in lanes whose integration failed, and for all derivatives.
        """
        begin = self._begin_alone(y, parameters)
        fly = functools.partial(
            _integrate, by_drive=False, samples=samples, coarse=False
        )
        flown, strike = self._fly(fly, begin, parameters, times, 0)

        end = flown[-1].end[:4]
        out = self._apply(self._end, np.vstack([y, end, strike.guard[:1], parameters]))
        motion = [phase.motion for phase in flown]
        return self._of_values(y, times, begin[0], out, strike.before[:6], motion)

    def _begin_alone(
        self, y: Sections, parameters: Parameters
    ) -> tuple[States, np.ndarray]:
        """The first state of steps, and no directions."""
        state, D = self._begin(y, parameters, False)
        return state, D[:, :0]

    def _of_values(
        self,
        y: Sections,
        times: Times,
        start: States,
        out: np.ndarray,
        knee: np.ndarray,
        motion: Motion,
    ) -> Stride:
        """A stride of values without derivatives; `out` is what `_end` gives."""
        m, n = y.shape
        k = len(times)
        residual, impact = np.split(out, [m + k])

        def unknown(*shape: int) -> np.ndarray:
            return np.full((*shape, n), np.nan)

        return Stride(
            y=y,
            image=residual[:m] + y,
            jacobian=unknown(m, m),
            times=times,
            by_drive=unknown(m),
            residual=residual,
            derivative=unknown(m + k, m + k + 1),
            inverse=unknown(m + k, m + k),
            newton=unknown(m),
            newton_times=unknown(k),
            impact=impact,
            impact_by_y=unknown(2, m),
            start=start,
            closing=unknown(k),
            knee=knee,
            knee_by_y=unknown(len(knee), m),
            motion=motion,
        )

    def _fly(
        self,
        fly: Callable[[_Phase], _Flown],
        begin: tuple[States, np.ndarray],
        parameters: Parameters,
        times: Times,
        beside: int,
    ) -> tuple[list[_Flown], _Kneestrike]:
        """Fly the phases of a step, from its first state with its directions, and what
        kneestrike makes of them; so many directions beside the field from there on.
        """
        state, D = begin
        phase = _Phase(self.structure, state, D, parameters, times[0], self.m + 1)
        flown = [fly(phase)]
        none = np.empty((0, state.shape[1]))

        if not self.kneed:
            return flown, _Kneestrike(none, none, none, none)

        strike = self._kneestrike(flown[0].end, parameters)
        phase = self._locked_phase(strike.after, beside, parameters, times)

        return [*flown, fly(phase)], strike

    def _locked_phase(
        self, state: States, directions: int, parameters: Parameters, times: Times
    ) -> _Phase:
        """The phase from kneestrike on, with unit vectors beside the field as
        directions.
        """
        unit = np.eye(4, directions, -1)[:, :, None]
        D = np.broadcast_to(unit, (4, directions, state.shape[1]))
        straight, of_straight = locked(self.structure, parameters)

        return _Phase(straight, state, D, of_straight, times[1] - times[0], 4)

    def _begin(
        self, y: Sections, parameters: Parameters, by_drive: bool
    ) -> tuple[States, np.ndarray]:
        """State just after heelstrike, and its derivatives by y and, where asked for,
        by the drive: it does not depend on the slope.
        """
        m, n = y.shape
        size = self.start_size
        values = self._apply(self._start, np.vstack([y, parameters]))
        D = values[size : size * (1 + m)].reshape(size, m, n)

        if by_drive:
            last = np.zeros((size, n))
            if self.by_push:
                last = values[size * (1 + m) :]
            D = np.concatenate([D, last[:, None]], axis=1)

        return values[:size], D

    def _kneestrike(self, end: np.ndarray, parameters: Parameters) -> _Kneestrike:
        """What kneestrike makes of the end of the first phase."""
        out = self._apply(self._knee, np.vstack([end, parameters]))
        sizes = np.cumsum([4, 4 * (self.m + 2), self.m + 3])

        return _Kneestrike(*np.split(out, sizes))

    def _heelstrike_by(self, parts: np.ndarray) -> np.ndarray:
        """Derivatives of the time of heelstrike, with knees, by y, the durations as the
        equations have them, and the drive, shape (m + 3, n).

        Heelstrike is timed from the start of the step; a part of a direction along the
        field at kneestrike is a shift of time.
        """
        m = self.m
        by = np.zeros((m + 3, parts.shape[1]))
        by[[m, m + 1]] = 1.0
        by[[*range(m + 1), m + 2]] -= parts[: m + 2]
        return by

    def _named(self, out: np.ndarray) -> dict[str, np.ndarray]:
        """Rows that the end of a step gives, by their names and in their shapes."""
        named = {}

        for name, (place, shape) in rows_of_end(self.m, 1 + self.kneed).items():
            named[name] = out[place].reshape(*shape, out.shape[1])
        return named

    def _by_times(
        self, out: np.ndarray, times: Times, parts: np.ndarray
    ) -> dict[str, Any]:
        """What the end of a step gives by the durations, as a stride has it by the
        event times.
        """
        m, k = self.m, 1 + self.kneed
        end = self._named(out)
        shifts, moves, newton = (
            end.pop(name) for name in ("shifts", "moves", "newton")
        )
        derivative = end["derivative"]
        shifted = shifts[:, 0]

        # The time of the first strike is the duration of the first phase.
        if self.kneed:
            by = self._heelstrike_by(parts)
            of_all = by[: m + k]
            # A later kneestrike with the same heelstrike shortens the last phase, and
            # so does all else.
            others = [*range(m + 1), m + 2]
            derivative[:, others] -= derivative[:, [m + 1]] * by[others]

            shifted[1] = matvec(by[None, m : m + k], shifted)[0]
            moves[-1] = matvec(moves.swapaxes(0, 1), of_all)
            newton[-1] = matvec(of_all[None], newton)[0]

        return {
            **end,
            "times": times + shifted,
            "inverse": moves,
            "newton": newton[:m],
            "newton_times": times + newton[m:],
            "closing": np.stack([derivative[m + j, m + j] for j in range(k)]),
        }


def _integrate(phase: _Phase, by_drive: bool, samples: int, coarse: bool) -> _Flown:
    """Integrate a phase with its directions; the last direction is zero where it is not
    asked for.
    """
    size, directions, n = phase.D.shape
    integrate = flow(phase.structure, directions, by_drive, coarse)
    # The flow has one direction after another, in each angles, then rates.
    columns = phase.D.transpose(1, 0, 2).reshape(-1, n)
    start = np.vstack([phase.state, columns])
    final, motion = integrate(start, phase.parameters, phase.duration, samples)

    rows = np.zeros((size, phase.width, n))
    rows[:, :directions] = final[size:].reshape(-1, size, n).transpose(1, 0, 2)
    end = np.vstack([final[:size], rows.reshape(-1, n)])

    return _Flown(end, motion, np.empty(0))


def _integrate_dissipation(phase: _Phase) -> _Flown:
    """Integrate a phase without directions, and what a unit damper dissipates in it."""
    size, n = phase.state.shape
    integrate = flow(phase.structure, 0, False, dissipates=True)
    start = np.vstack([phase.state, np.zeros((1, n))])
    final, motion = integrate(start, phase.parameters, phase.duration)
    end = np.vstack([final[:size], np.zeros((size * phase.width, n))])

    return _Flown(end, motion, final[size])


@functools.cache
def rows_of_end(m: int, k: int) -> dict[str, tuple[slice, tuple[int, ...]]]:
    """Rows and shape of all that the end of a step gives, for m coordinates and k
    phases.
    """
    shapes: dict[str, tuple[int, ...]] = {
        "image": (m,),
        "jacobian": (m, m),
        "by_drive": (m,),
        "shifts": (k, m + 2),
        "residual": (m + k,),
        "derivative": (m + k, m + k + 1),
        "moves": (m + k, m + k),
        "newton": (m + k,),
        "impact": (2,),
        "impact_by_y": (2, m),
    }
    places = slices([math.prod(shape) for shape in shapes.values()])

    return dict(zip(shapes, zip(places, shapes.values(), strict=True), strict=True))


def _to_first_order(
    y: list[Sym],
    x: list[Sym],
    D: list[list[Sym]],
    section: list[Sym],
    section_by: list[list[Sym]],
    knee: list[list[Sym]],
) -> list[Sym]:
    """All that `rows_of_end` names, from a state x at the end of the flow, its
    derivatives D by y, durations and drive, and the section there with its own; `knee`
    has the guard of kneestrike.
    """
    m = len(y)
    guards = [row[0] for row in knee] + [x[0] + x[1]]
    guards_by = [[*row[1:-1], ZERO, row[-1]] for row in knee]
    guards_by.append([a + b for a, b in zip(D[0], D[1], strict=True)])
    residual = [a - b for a, b in zip(section, y, strict=True)] + guards

    shifts = _shifts(guards, guards_by, m)
    image = _at_strikes(section, section_by, shifts, m)
    impact = _at_strikes(x[2:], D[2:], shifts, m)

    return [
        *_values_then_derivatives(image),
        *(row[-1] for row in image),
        *flat(shifts),
        *_joint_equations(residual, section_by, guards_by),
        *_values_then_derivatives(impact),
    ]


def _parts(by_direction: list[list[Sym]], rates: list[Sym]) -> list[list[Sym]]:
    """Parts of directions along the field of two links, whose rates are given, and
    along unit vectors beside it.
    """
    along = [d / rates[0] for d in by_direction[0]]
    parts = [along]

    for row, rate in zip(by_direction[1:], rates[1:], strict=True):
        parts.append([d - c * rate for d, c in zip(row, along, strict=True)])
    return parts


def _at_kneestrike(
    x: list[Sym], rates: list[Sym], carried: list[list[Sym]]
) -> list[Sym]:
    """The guard, its derivatives by y, its rate and its derivative by the drive; then
    the state where it closes, to first order, and that state's derivatives by y.
    """
    guard, closing = x[1] - x[2], x[4] - x[5]
    guard_by = [a - b for a, b in zip(carried[1], carried[2], strict=True)]
    by_y = guard_by[:-1]
    strike = [v - rate * guard / closing for v, rate in zip(x, rates, strict=True)]

    for row, rate in zip(carried, rates, strict=True):
        strike += [d - rate * g / closing for d, g in zip(row, by_y, strict=False)]
    return [guard, *by_y, closing, guard_by[-1], *strike]


def _joint_equations(
    residual: list[Sym], section_by: list[list[Sym]], guards_by: list[list[Sym]]
) -> list[Sym]:
    """Residual of the joint equations, its derivative, the inverse of that, negative,
    and the Newton step, row by row.
    """
    derivative = []

    for i, row in enumerate(section_by):
        derivative.append([v - float(i == d) for d, v in enumerate(row)])
    derivative += guards_by
    moves = inverse([[-v for v in row[:-1]] for row in derivative])
    newton = [dot(row, residual) for row in moves]

    return [*residual, *flat(derivative), *flat(moves), *newton]


def _shifts(guards: list[Sym], guards_by: list[list[Sym]], m: int) -> list[list[Sym]]:
    """Changes of the durations at which the guards close, to first order: for their
    values, y and the drive; one duration after another.
    """
    shifts: list[list[Sym]] = []

    for j, (guard, row) in enumerate(zip(guards, guards_by, strict=True)):
        values = [guard, *row[:m], row[-1]]

        for i, earlier in enumerate(shifts):
            values = [v + row[m + i] * e for v, e in zip(values, earlier, strict=True)]
        shifts.append([-v / row[m + j] for v in values])

    return shifts


def _at_strikes(
    values: list[Sym], by: list[list[Sym]], shifts: list[list[Sym]], m: int
) -> list[list[Sym]]:
    """Each value where the guards close, to first order, with its derivatives by y and
    the drive; given at the end of the flow, by y, durations and drive.
    """
    at_strikes = []

    for value, row in zip(values, by, strict=True):
        at_end = zip(
            [value, *row[:m], row[-1]],
            zip(*shifts, strict=True),
            strict=True,
        )
        at_strikes.append([dot(row[m:-1], shift, start) for start, shift in at_end])

    return at_strikes


def _values_then_derivatives(at_strikes: list[list[Sym]]) -> list[Sym]:
    """All values, then their derivatives by y row by row."""
    return [row[0] for row in at_strikes] + flat([row[1:-1] for row in at_strikes])


def _end_without_derivatives(structure: Structure) -> CompiledFunction:
    """Compile what `StrideMap._end` is."""
    p, y, x = Symbols(structure), vector("y", structure.dimension), vector("x", 4)
    guards = [hy.make_vars("guard")] if structure.kneed else []
    section = end_of_step(structure, p, x)
    missed = [a - b for a, b in zip(section, y, strict=True)]
    outputs = [*missed, *guards, x[0] + x[1], *x[2:]]

    return CompiledFunction(outputs, [*y, *x, *guards, *p.variables])


@functools.lru_cache(maxsize=64)
def stride_map(structure: Structure) -> StrideMap:
    """Return the compiled step map of a structure, one a process."""
    return compiled(StrideMap, structure)
