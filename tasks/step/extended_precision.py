"""Fixed points to more digits than the step map in doubles resolves.

Near vanishing slope I - DP is singular like slope^(2/3), and the rounding of P in
doubles dominates the error of the gait. There the residual is evaluated in long double
or in 128 bits; Newton keeps the derivative in doubles.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import heyoka as hy
import numpy as np

from gaitsweep.tasks.mechanics.arrays import Numbers
from gaitsweep.tasks.mechanics.equations import Symbols, system
from gaitsweep.tasks.mechanics.kernel import compiled
from gaitsweep.tasks.mechanics.lumped import Structure, lump
from gaitsweep.tasks.mechanics.sums import matvec
from gaitsweep.tasks.step.iterate import Ended, iterate
from gaitsweep.tasks.step.problem import EPS, Problem, joint_sizes
from gaitsweep.tasks.step.several_steps import AnyStride
from gaitsweep.tasks.step.symbols import end_of_step, lock_knee, start_of_step

#: Error bounds of a fixed point in doubles from which long double is used, and 128
#: bits.
ESCALATE, ESCALATE_AGAIN = 1e-12, 4e-9
#: Each tier's type of number and its rounding unit.
TIERS: tuple[tuple[Any, float], ...] = (
    (np.longdouble, 1.1e-19),
    (hy.real128, 1.93e-34),
)
#: Newton steps, with one derivative each of at most half the size of the one before,
#: and derivatives by differences in each tier's number: in long double they would be no
#: better than those in doubles.
_MAX_STEPS, _MAX_DERIVATIVES = 20, (0, 4)
#: Size below which steps that no longer shrink are rounding: 128 bits resolve more than
#: is asked for.
_ROUNDING = (ESCALATE, 0.0)
#: Error bound in doubles from which their Newton steps are not trusted: beside folds of
#: small gaits they lead anywhere.
UNTRUSTED = 1e-3
#: Relative size of a step from which Newton is lost: it begins at a gait in doubles. And
#: that from which a first one is: larger than the gait, it leads to motions that may take
#: for ever.
_MAX_STEP, _MAX_FIRST_STEP = 1e-2, 1.0


class Wide(NamedTuple):
    """A gait in a wider number, or rounded from one.

    Attributes
    ----------
    y : ndarray, shape (m,)
        Scaled section coordinates.
    times : ndarray, shape (k,) [sqrt(leg/g)]
    impact : ndarray, shape (2,) or (2, s)
        Rates just before heelstrike.
    state : ndarray, shape (angles,)
        Just after the first heelstrike.
    error : float
        Relative size of the last Newton step, or a bound.
    """

    y: np.ndarray
    times: np.ndarray
    impact: np.ndarray
    state: np.ndarray
    error: float


class _ExtendedStepMap:
    """The map of one step or several of one structure in a wider number, one lane at a
    time, without derivatives.
    """

    def __init__(self, structure: Structure, number: Any, unit: float):
        self.structure = structure
        self.number, self.unit = number, unit
        self.m = structure.dimension
        systems = [system(structure, free, 0, False) for free in structure.phases]
        self._flows = [
            hy.taylor_adaptive(
                motion.equations,
                state=self.array(np.zeros(len(motion.equations))),
                fp_type=number,
                tol=number(2 * unit),
                compact_mode=True,
            )
            for motion in systems
        ]
        self._constants = [
            motion.parameters(fp_type=number, compact_mode=True) for motion in systems
        ]
        self._start, self._knee, self._finish = self._compile()

    def array(self, values: Any) -> np.ndarray:
        """Convert to this number."""
        return np.array([self.number(v) for v in values], dtype=self.number)

    def _compile(self) -> tuple[Any, Any, Any]:
        """The start of a step, its kneestrike and its end; the last two with the
        strike's guard before the state beyond it.
        """
        p = Symbols(self.structure)
        y = list(hy.make_vars(*(f"y{i}" for i in range(self.m))))
        x = list(hy.make_vars(*(f"x{i}" for i in range(6))))
        two = x[:4]
        end = [two[0] + two[1], *end_of_step(self.structure, p, two), two[2], two[3]]

        def function(outputs: list[Any], variables: list[Any]) -> Any:
            return hy.cfunc(
                outputs,
                vars=[*variables, *p.variables],
                fp_type=self.number,
                compact_mode=True,
            )

        knee = None
        if self.structure.kneed:
            knee = function([x[1] - x[2], *lock_knee(p, x)], x)
        start = function(start_of_step(self.structure, p, y), y)
        return start, knee, function(end, two)

    def _integrate(
        self, k: int, state: np.ndarray, parameters: np.ndarray, duration: Any
    ) -> np.ndarray:
        ta = self._flows[k]
        ta.time = self.number(0.0)
        ta.state[:] = state
        ta.pars[:] = self._constants[k](parameters)
        ta.propagate_until(duration)
        return ta.state.copy()

    def _call(
        self, function: Any, values: np.ndarray, parameters: np.ndarray
    ) -> np.ndarray:
        return function(np.concatenate([values, parameters]))

    def parameters(
        self, problem: Problem, lane: int, drive: float, scale: float
    ) -> np.ndarray:
        """Parameters of the compiled functions, for a lane at a value of its drive."""
        # Long double leaves differences in them too few digits.
        constants = lump(problem.walker_of(lane), hy.real128)
        problem.drive.set_exact(constants, drive, hy.real128)
        slope = float(problem.slopes(np.array([drive]))[0])
        values = [constants[name] for name in self.structure.constants]
        if self.number is not hy.real128:
            values = [self._rounded(value) for value in values]
        return self.array([slope, scale, *values])

    def _rounded(self, value: Any) -> Any:
        """A number of 128 bits in this one."""
        double = float(value)
        return self.number(double) + self.number(float(value - double))

    def start(self, y: np.ndarray, parameters: np.ndarray) -> np.ndarray:
        """State just after heelstrike at y, of its first section."""
        return self._call(self._start, y[: self.m], parameters)

    def __call__(
        self, y: np.ndarray, times: np.ndarray, parameters: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Residual of the joint equations at y and the event times of all steps, and
        the rates before heelstrikes.

        Returns
        -------
        residual : ndarray, shape (m + k,)
            The images less the sections after them, and the guards of the strikes, all
            in this number.
        impact : ndarray, shape (2,) or (2, s)
            Rates just before heelstrike, of every step.
        """
        steps = len(y) // self.m
        durations = np.diff(times, prepend=self.number(0.0)).reshape(steps, -1)
        images, guards, impacts = [], [], []
        for section, duration in zip(y.reshape(steps, -1), durations, strict=True):
            image, guard, impact = self._step(section, duration, parameters)
            images.append(image)
            guards.append(guard)
            impacts.append(impact)

        residual = np.concatenate([*images[-1:], *images[:-1]]) - y
        impact = impacts[0] if steps == 1 else np.stack(impacts, axis=-1)
        return np.concatenate([residual, *guards]), impact

    def _step(
        self, y: np.ndarray, durations: np.ndarray, parameters: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Image of a section, guards at the strikes and rates before heelstrike of one
        step.
        """
        state = self.start(y, parameters)
        guards = self.array([])
        if self.structure.kneed:
            state = self._integrate(0, state, parameters, durations[0])
            values = self._call(self._knee, state, parameters)
            guards, state = values[:1], values[1:]

        state = self._integrate(-1, state, parameters, durations[-1])
        values = self._call(self._finish, state, parameters)
        guards = np.concatenate([guards, values[:1]])
        return values[1 : 1 + self.m], guards, values[1 + self.m :]

    def inverse(
        self,
        y: np.ndarray,
        times: np.ndarray,
        parameters: np.ndarray,
        residual: np.ndarray,
    ) -> np.ndarray:
        """How far a residual moves the solution's y and event times, by differences
        from the residual at y and times.

        Returns
        -------
        ndarray, shape (m + k, m + k)
            In doubles.
        """
        # Beside folds its rounding counts over 1e-11, beside falls the step bends
        # within 1e-17.
        difference = self.number(self.unit**0.6)
        unknowns = np.concatenate([y, times])
        columns = []
        for i in range(len(unknowns)):
            moved = unknowns.copy()
            moved[i] = moved[i] + difference
            there, _ = self(moved[: len(y)], moved[len(y) :], parameters)
            columns.append(_doubles((there - residual) / difference))

        try:
            return -np.linalg.inv(np.array(columns).T)
        except np.linalg.LinAlgError:
            return np.full((len(unknowns), len(unknowns)), np.nan)


def _doubles(values: np.ndarray) -> np.ndarray:
    """Numbers of any kind, rounded to doubles."""
    return np.array([float(value) for value in values])


@functools.lru_cache(maxsize=16)
def _extended_step_map(structure: Structure, tier: int) -> _ExtendedStepMap:
    return compiled(_ExtendedStepMap, structure, *TIERS[tier])


class Start(NamedTuple):
    """Where Newton's method begins, in doubles.

    Attributes
    ----------
    problem : Problem
        Gives the walker of the lane.
    lane : int
        Lane of `stride`.
    stride : Stride
        The step, whose derivative Newton keeps.
    y : ndarray, shape (m,)
        Scaled section coordinates.
    times : ndarray, shape (k,) [sqrt(leg/g)]
    slope, scale : float
        [rad], and the power of two by which angles and rates are divided.
    """

    problem: Problem
    lane: int
    stride: AnyStride
    y: np.ndarray
    times: np.ndarray
    slope: float
    scale: float


def solved(start: Start, tier: int) -> Wide:
    """Solve for a gait by Newton's method, its residual in the tier's number, its
    derivative in doubles if it serves.

    Parameters
    ----------
    start : Start
    tier : int
        Index into `TIERS`.

    Returns
    -------
    Wide
        In the tier's number; the last step is infinite where Newton's steps do not
        shrink.
    """
    exact = _extended_step_map(start.problem.structure, tier)
    rule = _WideNewton(
        exact,
        exact.parameters(start.problem, start.lane, start.slope, start.scale),
        tier,
        exact.array(start.y),
        exact.array(start.times),
        start.stride.inverse[:, :, start.lane],
        joint_sizes(start.y[:, None], len(start.times))[:, 0],
    )
    iterate(rule, 1, _MAX_STEPS)
    state = exact.start(rule.y, rule.parameters)
    return Wide(rule.y, rule.times, rule.impact, state, rule.size)


@dataclass
class _WideNewton:
    """Newton's method for a single gait; `size` is the relative size of its last step,
    infinite where these do not shrink.
    """

    exact: _ExtendedStepMap
    parameters: np.ndarray
    tier: int
    y: np.ndarray
    times: np.ndarray
    inverse: np.ndarray
    measure: np.ndarray
    size: float = 2 * _MAX_FIRST_STEP
    derivatives: int = 0
    impact: np.ndarray = field(init=False)

    def step(self, lanes: Numbers, taken: int) -> np.ndarray:
        """Step once more."""
        return np.array([self._step()])

    def _step(self) -> Ended:
        residual, self.impact = self.exact(self.y, self.times, self.parameters)
        step, size = self._newton_step(residual)
        if not size <= 0.5 * self.size:
            if self.size < _ROUNDING[self.tier]:
                self.size = min(self.size, size)
                return Ended.CONVERGED

            if self.derivatives == _MAX_DERIVATIVES[self.tier]:
                self.size = np.inf
                return Ended.STALLED

            # Beside falls, where the step amplifies its start most, the derivative in
            # doubles does not serve.
            self.derivatives += 1
            self.inverse = self.exact.inverse(
                self.y, self.times, self.parameters, residual
            )
            step, size = self._newton_step(residual)
            if not size < _MAX_STEP:
                self.size = np.inf
                return Ended.DIVERGED

        m = len(self.y)
        self.y = self.y + self.exact.array(step[:m])
        self.times = self.times + self.exact.array(step[m:])
        self.size = size
        return Ended.CONVERGED if size < EPS / 64 else Ended.RUNNING

    def _newton_step(self, residual: np.ndarray) -> tuple[np.ndarray, float]:
        """Newton's step in doubles, and its relative size."""
        step = matvec(self.inverse, _doubles(residual))
        return step, float(np.max(np.abs(step / self.measure)))


def residual(problem: Problem, Z: np.ndarray) -> np.ndarray:
    """Residual of the joint equations in 128 bits, at points in doubles.

    Parameters
    ----------
    problem : Problem
    Z : ndarray, shape (m + k + 1, n)
        Similarity coordinates, event times and ln slope.

    Returns
    -------
    ndarray, shape (m + k, n)
        Over the stance angle.
    """
    exact = _extended_step_map(problem.structure, 1)
    y, scale = problem.section(Z)
    columns = []
    for lane, drive in enumerate(np.exp(Z[-1]).tolist()):
        parameters = exact.parameters(problem, lane, drive, scale[lane])
        times = exact.array(Z[problem.m : -1, lane])
        values, _ = exact(exact.array(y[:, lane]), times, parameters)
        columns.append(_doubles(values) / y[0, lane])

    return np.array(columns).T


def refine(
    start: Start, bound: float, amplification: float, accuracy: float = 0.0
) -> Wide:
    """Solve for a gait to the last digits of a double, in long double where that
    suffices, else in 128 bits.

    Parameters
    ----------
    start : Start
    bound : float
        Relative error bound of the gait in doubles.
    amplification : float
        Relative change of its values with a Newton step.
    accuracy : float
        Bound that suffices; 0 for any.

    Returns
    -------
    Wide
        Rounded to doubles, with a bound of the relative error that counts that.
    """

    def rounding(tier: int) -> float:
        return (bound if bound < 1 else 1.0) * TIERS[tier][1] / EPS + 4 * EPS

    # Long double first, where it may reach the accuracy.
    serves = bound < ESCALATE_AGAIN and not 0 < accuracy < rounding(0)
    for tier in (0, 1) if serves else (1,):
        gait = solved(start, tier)
        error = 2 * gait.error * max(1.0, amplification) + rounding(tier)
        if error <= accuracy if accuracy else np.isfinite(gait.error):
            break

    y, times, impact, state = (np.vectorize(float)(values) for values in gait[:4])
    return Wide(y, times, impact, state, error)
