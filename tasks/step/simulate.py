"""Strides from any start: when the strikes come, what the walker does then, and how it falls.

A fixed point knows its event times; any other start does not. Here they are found: all lanes advance together by a
fixed step of Dormand and Prince's fifth-order formula, every lane watches its own guard, and a lane that strikes
leaves the batch. The time found is good to about 1e-8; the exact stride map, given that time, corrects it and the image
to the last digits and adds the Jacobian, which is as good as the time it was given. A lane's bits depend on its start
alone.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import heyoka as hy
import numpy as np

from tasks.mechanics.equations import ZERO, Solver, Symbols, rows
from tasks.mechanics.impacts import heelstrike, kneestrike
from tasks.mechanics.kernel import LANES, prepare_compiler
from tasks.mechanics.lumped import Structure
from tasks.step.problem import Problem
from tasks.step.step_map import Stride

#: What becomes of a stride. Everything but STRUCK is a fall.
STRUCK, BACKWARD, FORWARD, NO_KNEESTRIKE, NO_HEELSTRIKE, LOST = range(6)
CAUSES = ("walks", "fell backward", "fell forward", "knee never struck", "foot never struck", "motion lost")
#: Stance angle beyond which a walker has fallen [rad], and the longest a stride may take [sqrt(leg/g)].
FALLEN, LONGEST = 1.2, 12.0
#: Step of the scan [sqrt(leg/g)]; a free shank swings faster.
STEP = {False: 0.125, True: 0.0625}

#: Dormand and Prince (1980), fifth order in six stages.
_STAGES = (
    (1 / 5,),
    (3 / 40, 9 / 40),
    (44 / 45, -56 / 15, 32 / 9),
    (19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729),
    (9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656),
    (35 / 384, 0.0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84),
)


@dataclass
class Strides:
    """One stride of n lanes from any start.

    `image` (m, n) section coordinates after it, NaN where the walker fell; `times` (k, n) of the strikes
    [sqrt(leg/g)]; `outcome` (n,) an index of CAUSES; `jacobian` (m, m, n) where the strides are exact.
    """

    image: np.ndarray
    times: np.ndarray
    outcome: np.ndarray
    jacobian: np.ndarray | None = None


class Scanner:
    """A structure's compiled steps and impacts, for stepping many lanes to their strikes."""

    def __init__(self, structure: Structure):
        self.structure = structure
        self._step = {free: self._compile_step(free) for free in ((False, True) if structure.kneed else (False,))}
        self._lock = self._compile_lock() if structure.kneed else None
        self._strike = None if structure.kneed else self._compile_strike()

    def _compile_step(self, free: bool) -> hy.cfunc:
        p = Symbols(self.structure)
        n = 3 if free else 2
        x = list(hy.make_vars(*(f"x{i}" for i in range(2 * n))))
        h = hy.make_vars("h")
        now, slopes = x, []
        for weights in _STAGES:
            M, f = rows(p, now[:n], now[n:], free)
            slopes.append([*now[n:], *Solver(M)(f)])
            used = [(a, s) for a, s in zip(weights, slopes, strict=True) if a]
            now = [x[i] + h * sum((a * s[i] for a, s in used), ZERO) for i in range(2 * n)]
        return hy.cfunc(now, vars=[*x, h, *p.variables], compact_mode=False)

    def _compile_lock(self) -> hy.cfunc:
        p = Symbols(self.structure)
        x = list(hy.make_vars(*(f"x{i}" for i in range(6))))
        return hy.cfunc([x[0], x[1], *kneestrike(p, x[:3], x[3:])], vars=[*x, *p.variables], compact_mode=False)

    def _compile_strike(self) -> hy.cfunc:
        p = Symbols(self.structure)
        x = list(hy.make_vars(*(f"x{i}" for i in range(4))))
        rates = heelstrike(p, x[1], x[2], x[3], False)[: self.structure.dimension - 1]
        return hy.cfunc([x[1], *rates], vars=[*x, *p.variables], compact_mode=False)

    @staticmethod
    def call(function: hy.cfunc, *inputs: np.ndarray) -> np.ndarray:
        """Call a compiled function on lanes padded to whole SIMD groups."""
        n = inputs[0].shape[1]
        padded = np.empty((sum(map(len, inputs)), n + -n % (4 * LANES)))
        np.concatenate(inputs, out=padded[:, :n])
        padded[:, n:] = padded[:, n - 1 : n]
        return function(padded)[:, :n]

    def advance(self, free: bool, x: np.ndarray, h: np.ndarray, parameters: np.ndarray) -> np.ndarray:
        """One step of length h (n,) of the formula, two links or three."""
        return self.call(self._step[free], x, h[None], parameters)

    def lock(self, x: np.ndarray, parameters: np.ndarray) -> np.ndarray:
        """State of two links after kneestrike."""
        return self.call(self._lock, x, parameters)

    def strike(self, x: np.ndarray, parameters: np.ndarray) -> np.ndarray:
        """Section coordinates after (straight) or before (kneed) heelstrike."""
        return x[1:4].copy() if self._strike is None else self.call(self._strike, x, parameters)

    def until(
        self, free: bool, x: np.ndarray, begin: np.ndarray, parameters: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Fly every lane to its strike.

        Parameters
        ----------
        free : bool
            To kneestrike with the knee free, or to heelstrike with it locked.
        x : ndarray, shape (size, n)
            Scaled states.
        begin : ndarray, shape (n,)
            Time already spent [sqrt(leg/g)].
        parameters : ndarray, shape (n_parameters, n)

        Returns
        -------
        state (size, n), time (n,) since the phase began, outcome (n,)
        """
        n, h = x.shape[1], STEP[self.structure.kneed]
        state, time, outcome = np.full_like(x, np.nan), np.zeros(n), np.full(n, LOST)
        lanes, now, held, scale = np.arange(n), x, parameters, parameters[1]
        step = np.full(n, h)
        for i in range(int(LONGEST / h)):
            if not len(lanes):
                return state, time, outcome
            new = self.advance(free, now, step[: len(lanes)], held)
            tau = _crossing(free, now, new, h)
            hit = tau >= 0
            if hit.any():
                at, final = self._refined(free, now[:, hit], tau[hit], h, held[:, hit])
                state[:, lanes[hit]], time[lanes[hit]], outcome[lanes[hit]] = final, i * h + at, STRUCK
            angle = new[0] * scale
            with np.errstate(invalid="ignore"):
                gone = {BACKWARD: angle > FALLEN, FORWARD: angle < -FALLEN, LOST: ~np.isfinite(new).all(axis=0)}
            done = hit.copy()
            for cause, which in gone.items():
                which &= ~hit
                outcome[lanes[which]] = cause
                time[lanes[which]] = (i + 1) * h
                done |= which
            late = ~done & (begin[lanes] + (i + 1) * h > LONGEST)
            outcome[lanes[late]] = NO_KNEESTRIKE if free else NO_HEELSTRIKE
            done |= late
            if done.any():
                keep = ~done
                lanes, now, held, scale = lanes[keep], new[:, keep], held[:, keep], scale[keep]
            else:
                now = new
        outcome[lanes] = NO_KNEESTRIKE if free else NO_HEELSTRIKE
        return state, time, outcome

    def _refined(
        self, free: bool, x: np.ndarray, tau: np.ndarray, h: float, parameters: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Time within the step at which the guard vanishes, by Newton on the formula itself, and the state there."""
        at = tau * h
        for _ in range(2):
            final = self.advance(free, x, at, parameters)
            g, rate = guard(free, final)
            at = np.clip(at - g / rate, 0.0, h)
        return at, self.advance(free, x, at, parameters)


def guard(free: bool, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The guard of the next strike and its rate: flexion of the knee, or the sum of the legs' angles."""
    return (x[1] - x[2], x[4] - x[5]) if free else (x[0] + x[1], x[2] + x[3])


def _crossing(free: bool, x: np.ndarray, new: np.ndarray, h: float) -> np.ndarray:
    """Fraction of the step at which the guard falls through zero, shape (n,); -1 where it does not.

    Notes
    -----
    A strike is the guard, once positive, falling to zero; at the start it is exactly zero and so no strike. Between
    steps the guard is its cubic Hermite polynomial, so a dip below zero and back within a step is seen too. Heel
    strikes count only with the stance leg behind.
    """
    (a, da), (b, db) = guard(free, x), guard(free, new)
    da, db = h * da, h * db
    with np.errstate(invalid="ignore"):
        through = (a > 0) & (b <= 0)
        dips = (a > 0) & (b > 0) & (da < 0) & (db > 0)
        if not free:
            through &= new[0] < 0
            dips &= new[0] < 0
    tau = np.full(len(a), -1.0)
    which = np.nonzero(through | dips)[0]
    if not len(which):
        return tau
    a, b, da, db = a[which], b[which], da[which], db[which]
    s = np.linspace(0.0, 1.0, 17)[:, None]
    value = a * (1 + 2 * s) * (1 - s) ** 2 + da * s * (1 - s) ** 2 + b * s * s * (3 - 2 * s) + db * s * s * (s - 1)
    below = value <= 0
    first = np.argmax(below, axis=0)
    lane = np.arange(len(which))
    high, low = value[np.maximum(first - 1, 0), lane], value[first, lane]
    with np.errstate(divide="ignore", invalid="ignore"):
        at = (first - 1 + high / (high - low)) / 16
    tau[which] = np.where(below.any(axis=0), at, -1.0)
    return tau


@functools.lru_cache(maxsize=16)
def scanner(structure: Structure) -> Scanner:
    """The compiled scanner of a structure."""
    prepare_compiler()
    return Scanner(structure)


def stride(problem: Problem, y: np.ndarray, slope: np.ndarray, exact: bool = True) -> Strides:
    """One stride from any section state.

    Parameters
    ----------
    problem : Problem
    y : ndarray, shape (m, n)
        Section coordinates [rad, rad/sqrt(leg/g)].
    slope : ndarray, shape (n,) [rad]
    exact : bool
        Polish with the exact stride map and give its Jacobian (to about 1e-7); otherwise the image is good to 1e-8.
    """
    found, scale, parameters = _found(problem, y, slope)
    walks = np.nonzero(found.outcome == STRUCK)[0]
    if not exact or not len(walks):
        return found
    at = problem.map(y[:, walks] / scale[walks], found.times[:, walks], parameters[:, walks])
    return _polished(found, walks, at, scale)


def _polished(found: Strides, walks: np.ndarray, at: Stride, scale: np.ndarray) -> Strides:
    """The strides with the exact map's images, times and Jacobians in place of the scan's."""
    m = len(found.image)
    found.jacobian = np.full((m, m, len(found.outcome)), np.nan)
    found.image[:, walks], found.times[:, walks] = at.image * scale[walks], at.times
    found.jacobian[:, :, walks] = at.jacobian
    lost = ~np.isfinite(found.image[:, walks]).all(axis=0)
    found.outcome[walks[lost]] = LOST
    return found


def _found(problem: Problem, y: np.ndarray, slope: np.ndarray) -> tuple[Strides, np.ndarray, np.ndarray]:
    """Strides by the scan alone, with the scales and parameters of every lane."""
    scan = scanner(problem.structure)
    m, n = y.shape
    good = np.isfinite(y).all(axis=0) & (y[0] > 0) & (y[0] < FALLEN)
    angle = np.where(good, y[0], 0.5)
    scale = np.exp2(np.floor(np.log2(angle)))
    parameters = problem.parameters(slope, scale)
    image, times, outcome = np.full((m, n), np.nan), np.full((problem.phases, n), np.nan), np.full(n, LOST)
    # A step that ends with the new stance leg behind or level leads nowhere but back.
    outcome[np.isfinite(y[0]) & (y[0] <= 0)] = BACKWARD
    outcome[y[0] >= FALLEN] = FORWARD
    lanes = np.nonzero(good)[0]
    x = problem.map.start(y[:, lanes] / scale[lanes], parameters[:, lanes])[: problem.map.start_size]
    begin = np.zeros(len(lanes))
    if problem.phases == 2:
        x, time, what = scan.until(True, x, begin, parameters[:, lanes])
        outcome[lanes] = what
        times[0, lanes] = np.where(what == STRUCK, time, np.nan)
        on = what == STRUCK
        lanes, begin, x = lanes[on], time[on], x[:, on]
        if len(lanes):
            x = scan.lock(x, parameters[:, lanes])
    if len(lanes):
        x, time, what = scan.until(False, x, begin, parameters[:, lanes])
        outcome[lanes] = what
        on = what == STRUCK
        lanes, x = lanes[on], x[:, on]
        times[-1, lanes] = begin[on] + time[on]
    if len(lanes):
        image[:, lanes] = scan.strike(x, parameters[:, lanes]) * scale[lanes]
    return Strides(image, times, outcome), scale, parameters
