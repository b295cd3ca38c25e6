"""Fixed points to more digits than the step map in doubles resolves.

Near vanishing slope I - DP is singular like slope^(2/3), and the rounding of P in
doubles dominates the error of the gait. There the residual is evaluated in long double
or in 128 bits; Newton keeps the derivative in doubles.
"""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import heyoka as hy
import numpy as np

from gaitsweep.tasks.mechanics.equations import Symbols, system
from gaitsweep.tasks.mechanics.kernel import prepare_compiler
from gaitsweep.tasks.mechanics.lumped import Structure, lump
from gaitsweep.tasks.mechanics.sums import matvec
from gaitsweep.tasks.step.problem import EPS, Problem, joint_sizes
from gaitsweep.tasks.step.several_steps import AnyStride
from gaitsweep.tasks.step.symbols import end_of_step, lock_knee, start_of_step
from gaitsweep.tasks.walkers.walker import Walker

#: Error bounds of a fixed point in doubles from which long double is used, and 128
#: bits.
ESCALATE, ESCALATE_AGAIN = 1e-12, 4e-9
#: Of a gait its scaled section coordinates (m,), event times (k,) [sqrt(leg/g)], rates
#: just before heelstrike (2,) or (2, s) and state just after (angles,), and how
#: accurate they are: relative size of the last Newton step, or a bound.
Wide = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, float]
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
#: Relative size of a step from which Newton is lost: it begins at a gait in doubles.
_MAX_STEP = 1e-2


class _ExtendedStepMap:
    """The map of one step or several of one structure in a wider number, one lane at a
    time, without derivatives.
    """

    def __init__(self, structure: Structure, number: Any, unit: float):
        self.structure, self.number, self.unit = structure, number, unit
        self.m, self.kneed = structure.dimension, structure.kneed
        flows = [True, False] if self.kneed else [False]
        systems = [system(structure, free, 0, False) for free in flows]
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
        self._held = [
            motion.parameters(fp_type=number, compact_mode=True) for motion in systems
        ]
        self._start, self._knee, self._finish = self._compile()

    def array(self, values: Any) -> np.ndarray:
        """Convert to this number."""
        return np.array([self.number(v) for v in values], dtype=self.number)

    def _compile(self) -> tuple[Any, Any, Any]:
        p = Symbols(self.structure)
        y = list(hy.make_vars(*(f"y{i}" for i in range(self.m))))
        x = list(hy.make_vars(*(f"x{i}" for i in range(6))))

        def function(outputs: list[Any], variables: list[Any]) -> Any:
            return hy.cfunc(
                outputs,
                vars=[*variables, *p.variables],
                fp_type=self.number,
                compact_mode=True,
            )

        # Each strike's guard and the state beyond it; the rates just before heelstrike.
        knee = function([x[1] - x[2], *lock_knee(p, x)], x) if self.kneed else None
        two = x[:4]
        finish = [two[0] + two[1], *end_of_step(self.structure, p, two), two[2], two[3]]
        return (
            function(start_of_step(self.structure, p, y), y),
            knee,
            function(finish, two),
        )

    def _integrate(
        self, k: int, state: np.ndarray, parameters: np.ndarray, duration: Any
    ) -> np.ndarray:
        ta = self._flows[k]
        ta.time = self.number(0.0)
        ta.state[:] = state
        ta.pars[:] = self._held[k](parameters)
        ta.propagate_until(duration)
        return ta.state.copy()

    def _call(
        self, function: Any, values: np.ndarray, parameters: np.ndarray
    ) -> np.ndarray:
        return function(np.concatenate([values, parameters]))

    def parameters(self, walker: Walker, slope: float, scale: float) -> np.ndarray:
        """Parameters of the compiled functions."""
        # Long double leaves differences in them too few digits.
        constants = lump(walker, hy.real128)
        wide = [constants[k] for k in self.structure.constants]
        if self.number is not hy.real128:
            wide = [
                self.number(float(v)) + self.number(float(v - float(v))) for v in wide
            ]
        return self.array([slope, scale, *wide])

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
        each = [
            self._step(one, d, parameters)
            for one, d in zip(y.reshape(steps, -1), durations, strict=True)
        ]
        images, guards, impacts = (list(values) for values in zip(*each, strict=True))
        residual = np.concatenate([*images[-1:], *images[:-1]]) - y
        return np.concatenate([residual, *guards]), np.stack(impacts, axis=-1)[
            ..., 0 if steps == 1 else slice(None)
        ]

    def _step(
        self, y: np.ndarray, durations: np.ndarray, parameters: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Image of a section, guards at the strikes and rates before heelstrike of one
        step.
        """
        state = self.start(y, parameters)
        guards = self.array([])
        if self.kneed:
            values = self._call(
                self._knee,
                self._integrate(0, state, parameters, durations[0]),
                parameters,
            )
            guards, state = values[:1], values[1:]
        values = self._call(
            self._finish,
            self._integrate(-1, state, parameters, durations[-1]),
            parameters,
        )
        return (
            values[1 : 1 + self.m],
            np.concatenate([guards, values[:1]]),
            values[1 + self.m :],
        )

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
        unknowns, difference = np.concatenate([y, times]), self.number(self.unit**0.6)
        columns = []
        for i in range(len(unknowns)):
            moved = unknowns.copy()
            moved[i] = moved[i] + difference
            change = (
                self(moved[: len(y)], moved[len(y) :], parameters)[0] - residual
            ) / difference
            columns.append([float(v) for v in change])
        try:
            return -np.linalg.inv(np.array(columns).T)
        except np.linalg.LinAlgError:
            return np.full((len(unknowns), len(unknowns)), np.nan)


@functools.lru_cache(maxsize=16)
def _extended_step_map(structure: Structure, tier: int) -> _ExtendedStepMap:
    prepare_compiler()
    return _ExtendedStepMap(structure, *TIERS[tier])


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
    problem, lane, stride, y, times, slope, scale = start
    exact = _extended_step_map(problem.structure, tier)
    parameters = exact.parameters(problem.walker_of(lane), slope, scale)
    wide, wide_times = exact.array(y), exact.array(times)
    inverse, derivatives = stride.inverse[:, :, lane], 0
    m, measure = len(y), joint_sizes(y[:, None], len(times))[:, 0]
    # A first step larger than the gait leads to motions that may take for ever.
    before, size = 2.0, np.inf
    for _ in range(_MAX_STEPS):
        residual, impact = exact(wide, wide_times, parameters)
        step = matvec(inverse, np.array([float(v) for v in residual]))
        size = float(np.max(np.abs(step / measure)))
        if not size <= 0.5 * before:
            if before < _ROUNDING[tier]:
                break
            if derivatives == _MAX_DERIVATIVES[tier]:
                before = size = np.inf
                break
            # Beside falls, where the step amplifies its start most, the derivative in
            # doubles does not serve.
            derivatives += 1
            inverse = exact.inverse(wide, wide_times, parameters, residual)
            step = matvec(inverse, np.array([float(v) for v in residual]))
            size = float(np.max(np.abs(step / measure)))
            if not size < _MAX_STEP:
                before = size = np.inf
                break
        wide, wide_times = (
            wide + exact.array(step[:m]),
            wide_times + exact.array(step[m:]),
        )
        before = size
        if size < EPS / 64:
            break
    return wide, wide_times, impact, exact.start(wide, parameters), min(before, size)


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
    exact, columns = _extended_step_map(problem.structure, 1), []
    (y, scale), times = problem.section(Z), Z[problem.m : -1]
    for lane, slope in enumerate(np.exp(Z[-1]).tolist()):
        parameters = exact.parameters(problem.walker_of(lane), slope, scale[lane])
        values, _ = exact(
            exact.array(y[:, lane]), exact.array(times[:, lane]), parameters
        )
        columns.append([float(value) for value in values] / y[0, lane])
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

    for tier in (
        (0, 1) if bound < ESCALATE_AGAIN and not 0 < accuracy < rounding(0) else (1,)
    ):
        *gait, last_step = solved(start, tier)
        error = 2 * last_step * max(1.0, amplification) + rounding(tier)
        if error <= accuracy if accuracy else np.isfinite(last_step):
            break
    y, times, impact, state = (np.vectorize(float)(each) for each in gait)
    return y, times, impact, state, error
