"""The peers: scipy's integrators with their events, DOP853 compiled by numba, and
heyoka's scalar integrator.

Their right-hand side is written in scalars with the lumped constants of
`tasks.mechanics.equations` and compiled by numba, so that it does not slow scipy down.
Angles are not scaled; tolerances are relative to the step's angle.
"""

import math
from collections.abc import Callable
from typing import Any

import heyoka as hy
import numba
import numpy as np
from scipy.integrate import solve_ivp
from scipy.integrate._ivp import dop853_coefficients as dop853

from gaitsweep.tasks.mechanics.equations import Symbols, system
from gaitsweep.tasks.mechanics.impacts import heelstrike, kneestrike
from gaitsweep.tasks.mechanics.lumped import lump
from gaitsweep.tasks.step.problem import Problem

#: Time after the start of a phase from which its guard counts [sqrt(leg/g)].
EARLY = 0.1
#: Time at which an integration without an event is given up [sqrt(leg/g)].
LONGEST = 8.0
_STANCE = ("R", "l", "eps", "C_aa", "S_a_re", "S_a_im")
_SWING = ("S_b_re", "S_b_im", "C_bb", "S_c_re", "S_c_im", "C_cc", "H_re", "H_im")
#: Order of the constants in the right-hand sides.
CONSTANTS = (*_STANCE, *_SWING)


@numba.njit
def _two_links(x: np.ndarray, c: np.ndarray, out: np.ndarray) -> None:
    """Derivatives of x, into `out`, for stance leg and locked swing leg; S_b and C_bb
    in c are those of the leg.
    """
    slope, R, l, eps = c[0], c[1], c[2], c[3]
    a, b, u, v = x[0], x[1], x[2], x[3]
    sa, ca, sb, cb = math.sin(a), math.cos(a), math.sin(b), math.cos(b)
    ta, da, tb, db = (
        math.sin(a - slope),
        math.cos(a - slope),
        math.sin(b - slope),
        math.cos(b - slope),
    )
    sf, cf = math.sin(b - a), math.cos(b - a)
    couple = R * (c[7] * sb + c[8] * cb) + l * (c[8] * cf + c[7] * sf)
    turn = l * (c[8] * sf - c[7] * cf)
    top = c[4] + 2 * R * (c[5] * sa + c[6] * ca)
    f0 = (
        -R * (c[5] * ca - c[6] * sa) * u * u
        - R * math.sin(slope)
        - (c[5] * da - c[6] * ta)
        - eps * (R * (c[7] * cb - c[8] * sb) - turn) * v * v
    )
    f1 = -turn * u * u - (c[7] * db - c[8] * tb)
    stance = (f0 - eps * couple * f1 / c[9]) / (top - eps * couple * couple / c[9])
    out[0], out[1], out[2], out[3] = u, v, stance, (f1 - couple * stance) / c[9]


@numba.njit
def _three_links(x: np.ndarray, c: np.ndarray, out: np.ndarray) -> None:
    """Derivatives of x, into `out`, for stance leg, swing thigh and swing shank; c
    holds slope and `CONSTANTS`.
    """
    slope, R, l, eps = c[0], c[1], c[2], c[3]
    a, u = x[0], x[3]
    sa, ca = math.sin(a), math.cos(a)
    top = c[4] + 2 * R * (c[5] * sa + c[6] * ca)
    f0 = (
        -R * (c[5] * ca - c[6] * sa) * u * u
        - R * math.sin(slope)
        - (c[5] * math.cos(a - slope) - c[6] * math.sin(a - slope))
    )
    re, im, b, v = c[7], c[8], x[1], x[4]
    sf, cf = math.sin(b - a), math.cos(b - a)
    k1 = R * (re * math.sin(b) + im * math.cos(b)) + l * (im * cf + re * sf)
    turn = l * (im * sf - re * cf)
    f0 -= eps * (R * (re * math.cos(b) - im * math.sin(b)) - turn) * v * v
    f1 = -turn * u * u - (re * math.cos(b - slope) - im * math.sin(b - slope))
    re, im, b, w = c[10], c[11], x[2], x[5]
    sf, cf = math.sin(b - a), math.cos(b - a)
    k2 = R * (re * math.sin(b) + im * math.cos(b)) + l * (im * cf + re * sf)
    turn = l * (im * sf - re * cf)
    f0 -= eps * (R * (re * math.cos(b) - im * math.sin(b)) - turn) * w * w
    f2 = -turn * u * u - (re * math.cos(b - slope) - im * math.sin(b - slope))
    sf, cf = math.sin(x[2] - x[1]), math.cos(x[2] - x[1])
    h, spin = c[13] * cf - c[14] * sf, c[13] * sf + c[14] * cf
    f1 += spin * w * w
    f2 -= spin * v * v
    inner = c[9] - h * h / c[12]
    g1, k = f1 - h * f2 / c[12], k1 - h * k2 / c[12]
    stance = (f0 - eps * (k2 * f2 / c[12] + k * g1 / inner)) / (
        top - eps * (k2 * k2 / c[12] + k * k / inner)
    )
    thigh = (g1 - k * stance) / inner
    out[0], out[1], out[2] = u, v, w
    out[3], out[4], out[5] = stance, thigh, (f2 - k2 * stance - h * thigh) / c[12]


class Algebra:
    """Start of a step, kneestrike and the image on the section, compiled for
    gaitsweep's lanes and for the peers.
    """

    def __init__(self, problem: Problem):
        self.problem, self.m, self.kneed = problem, problem.m, problem.structure.kneed
        # The map's own start pads its lanes, which is expensive for one lane.
        self.begin = problem.map._compile_start()
        p = Symbols(problem.structure)
        x = list(hy.make_vars(*(f"x{i}" for i in range(6))))
        image = [x[1], x[2], x[3]]
        if not self.kneed:
            image = [x[1], *heelstrike(p, x[1], x[2], x[3], False)[: self.m - 1]]
        self.image = hy.cfunc(image, vars=[*x[:4], *p.variables])
        if self.kneed:
            self.lock = hy.cfunc(
                [x[0], x[1], *kneestrike(p, x[:3], x[3:])], vars=[*x, *p.variables]
            )

    def start(self, y: np.ndarray, parameters: np.ndarray) -> np.ndarray:
        """State just after heelstrike."""
        return self.begin(np.concatenate([y, parameters]))[: 6 if self.kneed else 4]


class Peer:
    """The step map by a peer's integrator, `integrate(rhs, constants, state, guard,
    tolerance)` -> (time, state).
    """

    def __init__(
        self,
        algebra: Algebra,
        slope: float,
        integrate: Callable[..., tuple[float, np.ndarray]],
        tolerance: float,
    ):
        self.algebra, self.integrate, self.tolerance = algebra, integrate, tolerance
        problem = algebra.problem
        self.parameters = problem.parameters(np.array([slope]), np.array([1.0]))[:, 0]
        lumped = lump(problem.walker)
        self.constants = np.array([slope, *(lumped.get(k, 0.0) for k in CONSTANTS)])
        self.locked = self.constants.copy()
        if algebra.kneed:
            self.locked[7] += self.locked[10]
            self.locked[8] += self.locked[11]
            self.locked[9] += self.locked[12] + 2 * self.locked[13]

    def stride(self, y: np.ndarray) -> np.ndarray:
        """One step, unscaled."""
        state = self.algebra.start(y, self.parameters)
        times = []
        if self.algebra.kneed:
            time, state = self.integrate(
                _three_links, self.constants, state, 1, self.tolerance
            )
            times.append(time)
            state = self.algebra.lock(np.concatenate([state, self.parameters]))
        time, state = self.integrate(_two_links, self.locked, state, 0, self.tolerance)
        times.append(time + sum(times))
        return np.concatenate(
            [self.algebra.image(np.concatenate([state, self.parameters])), times]
        )

    def jacobian(self, y: np.ndarray) -> np.ndarray:
        """Jacobian of the step map by central differences, with increments that suit
        the tolerance.
        """
        m = self.algebra.m
        h = abs(y[0]) * max(self.tolerance, 1e-16) ** (1 / 3)
        columns = []
        for j in range(m):
            change = np.zeros(m)
            change[j] = h
            columns.append(
                (self.stride(y + change)[:m] - self.stride(y - change)[:m]) / (2 * h)
            )
        return np.stack(columns, axis=1)

    def fixed_point(self, y: np.ndarray, most: int = 12) -> np.ndarray:
        """Fixed point and multipliers, by Newton's method with differences."""
        m = self.algebra.m
        size = np.inf
        for _ in range(most):
            J = self.jacobian(y)
            step = np.linalg.solve(np.eye(m) - J, self.stride(y)[:m] - y)
            y = y + step
            last, size = size, np.abs(step).max() / abs(y[0])
            if not size > 10 * self.tolerance or size > 0.5 * last:
                break
        multipliers = (
            np.abs(np.linalg.eigvals(J))
            if np.isfinite(J).all()
            else np.full(m, math.nan)
        )
        return np.concatenate([y, np.sort(multipliers)[::-1]])


def by_scipy(method: str) -> Callable[..., tuple[float, np.ndarray]]:
    """Integration to an event by one of scipy's methods."""

    def integrate(
        rhs: Callable[..., None],
        constants: np.ndarray,
        state: np.ndarray,
        kind: int,
        tolerance: float,
    ) -> tuple[float, np.ndarray]:
        def field(_: float, x: np.ndarray) -> np.ndarray:
            out = np.empty_like(x)
            rhs(x, constants, out)
            return out

        def guard(t: float, x: np.ndarray) -> float:
            # The guards are also zero at the start of a phase; only a later fall to
            # zero ends it.
            if t < EARLY:
                return -1.0
            return x[1] - x[2] if kind else x[0] + x[1]

        if not np.isfinite(state).all():
            return math.nan, state
        guard.terminal, guard.direction = True, -1
        solution = solve_ivp(
            field,
            (0.0, LONGEST),
            state,
            method=method,
            rtol=max(tolerance, 2.3e-14),
            atol=tolerance * abs(state[0]),
            events=guard,
        )
        if not len(solution.t_events[0]):
            return math.nan, np.full_like(state, math.nan)
        return float(solution.t_events[0][0]), solution.y_events[0][0]

    return integrate


class Scalar:
    """heyoka's scalar integrator with terminal events, one for each tolerance and
    number of links.
    """

    def __init__(self, problem: Problem):
        self.problem = problem
        self._integrators: dict[tuple[int, float], Any] = {}

    def _integrator(self, kind: int, tolerance: float) -> Any:
        if (kind, tolerance) not in self._integrators:
            motion = system(self.problem.structure, bool(kind), 0, False)
            q: list[Any] = [name for name, _ in motion.equations]
            guard = q[1] - q[2] if kind else q[0] + q[1]
            # The guard is zero at the start of a phase; only a later fall to zero ends
            # it.
            event = hy.t_event(guard, direction=hy.event_direction.negative)
            flow = hy.taylor_adaptive(
                motion.equations,
                np.zeros(len(q)),
                tol=max(tolerance, 2.3e-16),
                t_events=[event],
            )
            self._integrators[kind, tolerance] = flow, motion.parameters()
        return self._integrators[kind, tolerance]

    def __call__(
        self,
        rhs: Callable[..., None],
        constants: np.ndarray,
        state: np.ndarray,
        kind: int,
        tolerance: float,
    ) -> tuple[float, np.ndarray]:
        """Integrate to the event; right-hand side and constants are the integrator's
        own.
        """
        if not np.isfinite(state).all():
            return math.nan, state
        flow, constants_of = self._integrator(kind, tolerance)
        # States are divided by the step's angle, for the integrator's tolerance is
        # absolute below one.
        scale = 2.0 ** math.floor(math.log2(abs(state[0])))
        parameters = self.problem.parameters(constants[:1], np.array([scale]))[:, 0]
        flow.time = 0.0
        flow.reset_cooldowns()
        flow.state[:] = state / scale
        flow.pars[:] = constants_of(np.ascontiguousarray(parameters))
        while True:
            outcome = flow.propagate_until(
                EARLY if flow.time < EARLY else LONGEST, max_steps=200
            )[0]
            if int(outcome) == -1 and flow.time < EARLY:
                continue
            if int(outcome) == -1:
                return float(flow.time), flow.state * scale
            if outcome != hy.taylor_outcome.time_limit or flow.time >= LONGEST:
                return math.nan, np.full_like(state, math.nan)


_A, _B, _E3, _E5 = (
    table.copy() for table in (dop853.A[:12, :12], dop853.B, dop853.E3, dop853.E5)
)


@numba.njit
def _dop853_step(
    rhs: Any, c: np.ndarray, x: np.ndarray, h: float, K: np.ndarray, new: np.ndarray
) -> None:
    """One step of DOP853 from x, into `new`; the stages go into K, whose first row is
    given.
    """
    for s in range(1, 12):
        for i in range(len(x)):
            total = 0.0
            for r in range(s):
                total += _A[s, r] * K[r, i]
            new[i] = x[i] + h * total
        rhs(new, c, K[s])
    for i in range(len(x)):
        total = 0.0
        for r in range(12):
            total += _B[r] * K[r, i]
        new[i] = x[i] + h * total


@numba.njit
def _dop853_error(
    x: np.ndarray,
    new: np.ndarray,
    h: float,
    K: np.ndarray,
    absolute: float,
    relative: float,
) -> float:
    """Error of a step over its tolerance, from the embedded methods of orders five and
    three.
    """
    five, three = 0.0, 0.0
    for i in range(len(x)):
        scale = absolute + relative * max(abs(x[i]), abs(new[i]))
        e5, e3 = 0.0, 0.0
        for r in range(13):
            e5 += _E5[r] * K[r, i]
            e3 += _E3[r] * K[r, i]
        five += (e5 / scale) ** 2
        three += (e3 / scale) ** 2
    denominator = five + 0.01 * three
    return h * five / math.sqrt(denominator * len(x)) if denominator > 0 else 0.0


@numba.njit
def _guard(kind: int, t: float, x: np.ndarray) -> float:
    """The guard of kneestrike (1) or heelstrike (0), which is negative while it does
    not count yet.
    """
    if t < EARLY:
        return -1.0
    return x[1] - x[2] if kind else x[0] + x[1]


@numba.njit
def _dop853_until_guard(
    rhs: Any, c: np.ndarray, start: np.ndarray, kind: int, tolerance: float
) -> tuple[float, np.ndarray]:
    """Integrate to the guard's fall through zero; Newton's method finds the length of
    the last step.
    """
    n = len(start)
    x, new, t, h = start.copy(), np.empty(n), 0.0, 0.05
    K = np.zeros((13, n))
    rhs(x, c, K[0])
    absolute = tolerance * abs(start[0])
    for _ in range(4000):
        _dop853_step(rhs, c, x, h, K, new)
        rhs(new, c, K[12])
        error = _dop853_error(x, new, h, K, absolute, tolerance)
        factor = min(6.0, max(0.2, 0.9 * error ** (-1 / 8))) if error > 0 else 6.0
        if error > 1:
            h *= factor
            continue
        if _guard(kind, t, x) > 0 and _guard(kind, t + h, new) <= 0:
            step = h
            for _ in range(30):
                gap = new[1] - new[2] if kind else new[0] + new[1]
                rate = new[4] - new[5] if kind else new[2] + new[3]
                step -= gap / rate
                _dop853_step(rhs, c, x, step, K, new)
                if abs(gap) <= 1e-16 * abs(rate):
                    break
            return t + step, new
        t += h
        x[:] = new
        K[0] = K[12]
        h *= factor
        if t > LONGEST:
            break
    return math.nan, np.full(n, math.nan)


def by_numba() -> Callable[..., tuple[float, np.ndarray]]:
    """Integration to an event by DOP853 compiled by numba, called as `by_scipy` does."""
    return _dop853_until_guard
