"""Steps from any initial state: the times of the strikes, the state after them, and
falls.

The step map needs event times. At a fixed point they are unknowns beside the state;
from any other state they are located here: all lanes advance together by a fixed time
step of Dormand and Prince's fifth-order formula, each monitors its own guard, and a
lane that strikes leaves the batch. The times are accurate to about 1e-8; the exact step
map corrects them and the image to the last digits and adds the Jacobian, which is as
accurate as the times before correction. A lane's bits depend on its initial state
alone.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass

import heyoka as hy
import numpy as np

from gaitsweep.tasks.mechanics.equations import ZERO, Solver, Sym, Symbols, rows
from gaitsweep.tasks.mechanics.impacts import heelstrike
from gaitsweep.tasks.mechanics.kernel import (
    LANES,
    CompiledFunction,
    prepare_compiler,
    whole_groups,
)
from gaitsweep.tasks.mechanics.lumped import Structure
from gaitsweep.tasks.step.crossing import crossing, guard
from gaitsweep.tasks.step.lanes import join_lanes
from gaitsweep.tasks.step.problem import Problem, scale_of
from gaitsweep.tasks.step.symbols import end_of_step, lock_knee

#: Outcomes of a step. All but STRUCK are falls.
STRUCK, BACKWARD, FORWARD, NO_KNEESTRIKE, NO_HEELSTRIKE, LOST = range(6)
CAUSES = (
    "walks",
    "fell backward",
    "fell forward",
    "knee never struck",
    "foot never struck",
    "motion lost",
)
#: Stance angle beyond which a walker has fallen [rad] and its ln, and the longest time
#: a step may take [sqrt(leg/g)].
MAX_LOG_ANGLE = 0.5
MAX_ANGLE, MAX_TIME = float(np.exp(MAX_LOG_ANGLE)), 12.0
#: Time step of the scan [sqrt(leg/g)], by whether there are knees: a free shank swings
#: faster.
_TIME_STEP = {False: 0.125, True: 0.0625}
#: Lanes simulated side by side: their states stay in the cache.
_SIDE_BY_SIDE = 4096
#: Most time steps taken before strikes are looked for: of a lane, and of all lanes
#: together.
_MAX_BLOCK, _BLOCK = 16, 8192
#: Angle, and change of an angle in a time step, at which a block ends [rad].
_WILD = 4.0

#: Dormand and Prince (J. Comput. Appl. Math. 6 (1980) 19-26), fifth order in six
#: stages.
_STAGES = (
    (1 / 5,),
    (3 / 40, 9 / 40),
    (44 / 45, -56 / 15, 32 / 9),
    (19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729),
    (9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656),
    (35 / 384, 0.0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84),
)


@dataclass
class SimulatedSteps:
    """One step of n lanes from any initial state.

    Attributes
    ----------
    image : ndarray, shape (m, n) [rad, rad/sqrt(leg/g)]
        Section coordinates after it, NaN where the walker fell.
    times : ndarray, shape (k, n) [sqrt(leg/g)]
        Kneestrike, for knees, and heelstrike.
    outcome : ndarray of int, shape (n,)
        Index of CAUSES.
    jacobian : ndarray, shape (m, m, n)
        NaN of falls; empty where the steps are not exact.
    """

    image: np.ndarray
    times: np.ndarray
    outcome: np.ndarray
    jacobian: np.ndarray


class Scanner:
    """A structure's compiled time steps and impacts, to integrate many lanes to their
    strikes.
    """

    def __init__(self, structure: Structure):
        self.structure = structure
        self._step = {
            free: self._compile_step(free)
            for free in ((False, True) if structure.kneed else (False,))
        }
        self._lock = self._compile(6, lock_knee) if structure.kneed else None
        self._strike = (
            None
            if structure.kneed
            else self._compile(4, functools.partial(end_of_step, structure))
        )

    def _compile_step(self, free: bool) -> CompiledFunction:
        p = Symbols(self.structure)
        n = 3 if free else 2
        x = list(hy.make_vars(*(f"x{i}" for i in range(2 * n))))
        h = hy.make_vars("h")
        stage, derivatives = x, []
        for weights in _STAGES:
            M, f = rows(p, stage[:n], stage[n:], free)
            derivatives.append([*stage[n:], *Solver(M)(f)])
            terms = [(a, d) for a, d in zip(weights, derivatives, strict=True) if a]
            stage = [
                x[i] + h * sum((a * d[i] for a, d in terms), ZERO) for i in range(2 * n)
            ]
        return CompiledFunction(stage, [*x, h, *p.variables])

    def _compile(
        self, size: int, outputs: Callable[[Symbols, list[Sym]], list[Sym]]
    ) -> CompiledFunction:
        """Compile a function of a state and the parameters."""
        p, x = (
            Symbols(self.structure),
            list(hy.make_vars(*(f"x{i}" for i in range(size)))),
        )
        return CompiledFunction(outputs(p, x), [*x, *p.variables])

    @functools.cached_property
    def _rates_on_uneven_ground(self) -> CompiledFunction:
        """Rates after a heelstrike from two links' state and the parameters, at any two
        angles of the legs.
        """
        prepare_compiler()
        kneed = self.structure.kneed
        return self._compile(
            4, lambda p, x: heelstrike(p, x[1], x[2], x[3], kneed, old_angle=x[0])
        )

    @staticmethod
    def _call(function: CompiledFunction, *inputs: np.ndarray) -> np.ndarray:
        """Call a compiled function on lanes (k, n) padded to whole SIMD groups."""
        return function(whole_groups(np.concatenate(inputs), LANES))[
            :, : inputs[0].shape[1]
        ]

    def _advance(
        self, free: bool, x: np.ndarray, h: np.ndarray, parameters: np.ndarray
    ) -> np.ndarray:
        """States after a time step h (n,) of the formula, of three links or two."""
        return self._call(self._step[free], x, h[None], parameters)

    def lock(self, x: np.ndarray, parameters: np.ndarray) -> np.ndarray:
        """State of two links after kneestrike.

        Parameters
        ----------
        x : ndarray, shape (6, n)
            Scaled state of three links before it.
        parameters : ndarray, shape (n_parameters, n)
            Slope, scale and the structure's constants.

        Returns
        -------
        ndarray, shape (4, n)
        """
        assert self._lock
        return self._call(self._lock, x, parameters)

    def strike(self, x: np.ndarray, parameters: np.ndarray) -> np.ndarray:
        """Section coordinates at heelstrike: just after it for straight legs, just
        before it for knees.

        Parameters
        ----------
        x : ndarray, shape (4, n)
            Scaled state of two links just before it.
        parameters : ndarray, shape (n_parameters, n)
            Slope, scale and the structure's constants.

        Returns
        -------
        ndarray, shape (m, n)
        """
        return (
            x[1:4].copy()
            if self._strike is None
            else self._call(self._strike, x, parameters)
        )

    def land(self, x: np.ndarray, parameters: np.ndarray) -> np.ndarray:
        """State just after a heelstrike on ground of any height, on which the legs
        stand at two different angles.

        Parameters
        ----------
        x : ndarray, shape (4, n)
            Scaled state of two links just before it.
        parameters : ndarray, shape (n_parameters, n)
            Slope, scale and the structure's constants.

        Returns
        -------
        ndarray, shape (4 or 6, n)
        """
        rates = self._call(self._rates_on_uneven_ground, x, parameters)
        return np.vstack([x[1], np.repeat(x[:1], len(rates) - 1, axis=0), rates])

    def to_heelstrike(
        self, x: np.ndarray, parameters: np.ndarray, height: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Integrate every lane from just after a heelstrike to just before the next.

        Parameters
        ----------
        x : ndarray, shape (4 or 6, n)
            Scaled states.
        parameters : ndarray, shape (n_parameters, n)
            Slope, scale and the structure's constants.
        height : ndarray, shape (n,), optional
            By which the ground rises until then, over l.

        Returns
        -------
        lanes : ndarray of int, shape (k,)
            Those that strike.
        state : ndarray, shape (4, k)
            Theirs.
        times : ndarray, shape (phases, n) [sqrt(leg/g)]
            Kneestrike, for knees, and heelstrike; NaN of those that do not strike.
        outcome : ndarray of int, shape (n,)
            Index of CAUSES.
        """
        n, kneed = x.shape[1], self.structure.kneed
        times, outcome = np.full((1 + kneed, n), np.nan), np.full(n, LOST)
        lanes, begin = np.arange(n), np.zeros(n)
        for strike, free in zip(
            times, (True, False) if kneed else (False,), strict=True
        ):
            over = None if free or height is None else height[lanes]
            x, time, outcome[lanes] = self._integrate_to_event(
                free, x, begin, parameters[:, lanes], over
            )
            struck = outcome[lanes] == STRUCK
            lanes, begin, x = lanes[struck], (begin + time)[struck], x[:, struck]
            strike[lanes] = begin
            if free and len(lanes):
                x = self.lock(x, parameters[:, lanes])
        return lanes, x, times, outcome

    def _integrate_to_event(
        self,
        free: bool,
        x: np.ndarray,
        begin: np.ndarray,
        parameters: np.ndarray,
        height: np.ndarray | None = None,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Integrate every lane to its strike.

        Parameters
        ----------
        free : bool
            To kneestrike with the knee free, or to heelstrike with it locked.
        x : ndarray, shape (size, n)
            Scaled states.
        begin : ndarray, shape (n,)
            Time since the step began [sqrt(leg/g)].
        parameters : ndarray, shape (n_parameters, n)
            Slope, scale and the structure's constants.
        height : ndarray, shape (n,), optional
            By which the ground rises until heelstrike, over l.

        Returns
        -------
        state : ndarray, shape (size, n)
            At the strike, NaN where there is none.
        time : ndarray, shape (n,) [sqrt(leg/g)]
            Since the phase began, of those that strike.
        outcome : ndarray of int, shape (n,)
            Index of CAUSES.
        """
        n, h = x.shape[1], _TIME_STEP[self.structure.kneed]
        state, time, outcome = np.full_like(x, np.nan), np.zeros(n), np.full(n, LOST)
        lanes, i, last = np.arange(n), 0, int(MAX_TIME / h)
        ground = None if height is None else np.array([parameters[1], height])
        while len(lanes) and i < last:
            count = min(last - i, max(1, min(_MAX_BLOCK, _BLOCK // len(lanes))))
            X = self._advance_block(free, x, h, parameters, count)
            count = len(X) - 1
            fraction = crossing(free, X, h, ground)
            strikes = fraction >= 0
            angle = X[1:, 0] * parameters[1]
            # In the order in which they count; what follows the first of them in a lane
            # does not.
            ends = {STRUCK: strikes}
            if not np.isfinite(X[-1]).all():  # what is lost remains so
                ends[LOST] = ~np.isfinite(X[1:]).all(axis=1)
            with np.errstate(invalid="ignore"):
                ends |= {FORWARD: angle < -MAX_ANGLE, BACKWARD: angle > MAX_ANGLE}
            if begin[lanes].max() + (i + count) * h > MAX_TIME:
                late = (
                    begin[lanes] + np.arange(i + 1, i + count + 1)[:, None] * h
                    > MAX_TIME
                )
                ends[NO_KNEESTRIKE if free else NO_HEELSTRIKE] = late
            any_end = np.logical_or.reduce([*ends.values()])
            done, first = any_end.any(axis=0), any_end.argmax(axis=0)
            if done.any():
                k = np.flatnonzero(done)
                j = first[k]
                cause = np.full(len(k), LOST)
                for end, when in reversed(ends.items()):
                    cause[when[j, k]] = end
                outcome[lanes[k]] = cause
                k, j = k[cause == STRUCK], j[cause == STRUCK]
                if len(k):
                    on = None if ground is None else ground[:, k]
                    at, final = self._refine(
                        free, X[j, :, k].T, fraction[j, k], h, parameters[:, k], on
                    )
                    state[:, lanes[k]], time[lanes[k]] = final, (i + j) * h + at
                lanes, x, parameters = (
                    lanes[~done],
                    X[-1][:, ~done],
                    parameters[:, ~done],
                )
                ground = None if ground is None else ground[:, ~done]
            else:
                x = X[-1]
            i += count
        outcome[lanes] = NO_KNEESTRIKE if free else NO_HEELSTRIKE
        return state, time, outcome

    def _advance_block(
        self, free: bool, x: np.ndarray, h: float, parameters: np.ndarray, count: int
    ) -> np.ndarray:
        """States (steps + 1, size, n) before and after each of up to `count` time
        steps.

        A lane that strikes or falls on the way is integrated with the others. A block
        ends where the angles of one became so large that in the next step the compiled
        sine might reduce those of its neighbours in another way.
        """
        size, n = x.shape
        width = n + -n % (LANES)
        inputs = np.empty((size + 1 + len(parameters), width))
        inputs[:size, :n], inputs[size], inputs[size + 1 :, :n] = x, h, parameters
        inputs[:, n:] = inputs[:, n - 1 : n]
        X = np.empty((count + 1, size, width))
        X[0] = inputs[:size]
        for k in range(count):
            if k:
                inputs[:size] = X[k]
            self._step[free](inputs, outputs=X[k + 1])
        scale, half = inputs[size + 2], size // 2
        with np.errstate(invalid="ignore"):
            top = np.abs(X[1:-1]).max(axis=(0, 2), initial=0.0) * scale.max()
            if max(top[:half].max(), h * top[half:].max()) < _WILD:
                return X[:, :, :n]
            moved = (
                np.maximum(
                    np.abs(X[1:-1, :half]).max(axis=1),
                    h * np.abs(X[1:-1, half:]).max(axis=1),
                )
                * scale
            )
            wild = ~(moved < _WILD).all(axis=1)
        return X[: 2 + int(wild.argmax()) if wild.any() else None, :, :n]

    def _refine(
        self,
        free: bool,
        x: np.ndarray,
        fraction: np.ndarray,
        h: float,
        parameters: np.ndarray,
        ground: np.ndarray | None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Time within the time step at which the guard vanishes, by Newton on the
        formula, and the state there.
        """
        at = fraction * h
        for _ in range(2):
            final = self._advance(free, x, at, parameters)
            g, rate = guard(free, final, ground)
            at = np.clip(at - g / rate, 0.0, h)
        return at, self._advance(free, x, at, parameters)


@functools.lru_cache(maxsize=16)
def scanner(structure: Structure) -> Scanner:
    """Return the compiled scanner of a structure, one a process."""
    prepare_compiler()
    return Scanner(structure)


def stride(
    problem: Problem, y: np.ndarray, slope: np.ndarray, exact: bool = True
) -> SimulatedSteps:
    """Simulate one step from any state on the section.

    Parameters
    ----------
    problem : Problem
        The walker.
    y : ndarray, shape (m, n)
        Section coordinates [rad, rad/sqrt(leg/g)].
    slope : ndarray, shape (n,) [rad]
    exact : bool
        Correct by the exact step map and give its Jacobian (to about 1e-7); otherwise
        the image is accurate to 1e-8.

    Returns
    -------
    SimulatedSteps
    """
    n = y.shape[1]
    if n > _SIDE_BY_SIDE:
        parts = np.split(np.arange(n), range(_SIDE_BY_SIDE, n, _SIDE_BY_SIDE))
        blocks = [
            stride(problem.some(part), y[:, part], slope[part], exact) for part in parts
        ]
        joined: SimulatedSteps = join_lanes(blocks)
        return joined
    steps, scale, parameters = _scan(problem, y, slope)
    lanes = np.flatnonzero(steps.outcome == STRUCK)
    if exact:
        steps.jacobian = np.full((len(y), *y.shape), np.nan)
    if exact and len(lanes):
        at = problem.step(
            y[:, lanes] / scale[lanes], steps.times[:, lanes], parameters[:, lanes]
        )
        steps.image[:, lanes], steps.times[:, lanes] = at.image * scale[lanes], at.times
        steps.jacobian[:, :, lanes] = at.jacobian
        steps.outcome[lanes[~np.isfinite(at.image).all(axis=0)]] = LOST
    return steps


def step_onto(
    problem: Problem, y: np.ndarray, slope: np.ndarray, height: np.ndarray
) -> SimulatedSteps:
    """Simulate two steps: one that ends on ground of another height, and one on ground
    parallel to the slope.

    Parameters
    ----------
    problem : Problem
        The walker.
    y : ndarray, shape (m, n)
        Section coordinates [rad, rad/sqrt(leg/g)] before them.
    slope : ndarray, shape (n,) [rad]
    height : ndarray, shape (n,)
        By which the ground rises at the end of the first step, over l.

    Returns
    -------
    SimulatedSteps
        The second step, not exact.
    """
    return _scan(problem, y, slope, height)[0]


def _scan(
    problem: Problem, y: np.ndarray, slope: np.ndarray, height: np.ndarray | None = None
) -> tuple[SimulatedSteps, np.ndarray, np.ndarray]:
    """Steps by the scan alone (those after one onto a `height`), with the scales and
    parameters of every lane.
    """
    scan = scanner(problem.structure)
    m, n = y.shape
    valid = np.isfinite(y).all(axis=0) & (y[0] > 0) & (y[0] < MAX_ANGLE)
    scale = scale_of(np.where(valid, y[0], 0.5))
    parameters = problem.parameters(slope, scale)
    image, times, outcome = (
        np.full((m, n), np.nan),
        np.full((problem.phases, n), np.nan),
        np.full(n, LOST),
    )
    # With the new stance leg behind or upright the walker falls back.
    outcome[np.isfinite(y[0]) & (y[0] <= 0)] = BACKWARD
    outcome[y[0] >= MAX_ANGLE] = FORWARD
    lanes = np.flatnonzero(valid)
    x = problem.map.start(y[:, lanes] / scale[lanes], parameters[:, lanes])[
        : problem.map.start_size
    ]
    for ground in (height, None) if height is not None else (None,):
        over = None if ground is None else ground[lanes]
        struck, x, times[:, lanes], outcome[lanes] = scan.to_heelstrike(
            x, parameters[:, lanes], over
        )
        lanes = lanes[struck]
        if ground is not None and len(lanes):
            x = scan.land(x, parameters[:, lanes])
    if len(lanes):
        image[:, lanes] = scan.strike(x, parameters[:, lanes]) * scale[lanes]
    return SimulatedSteps(image, times, outcome, np.empty((0, 0, n))), scale, parameters
