"""Appendix A of the paper: by how much a verified gait breaks what the model takes for granted.

Every item is a flag and an amount. The stance knee is opened: foot, stance shank, stance thigh, swing thigh and swing
shank are a chain of four links, whose points are x + iy = -R s + iR + sum_j A_j exp(i q_j) with q the angles of
(stance shank, stance thigh, swing thigh, swing shank), s the stance shank's, and A_j constant. What holds the stance
knee is what its thigh's own equation of motion misses when both stance links move as one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tasks.registry import SI_UNITS, VARIABLES, VIOLATIONS
from tasks.walkers.parameters import Walker

Arrays = dict[str, np.ndarray]
#: Intervals of each phase; with extremes of a quartic through five samples, amounts are good to about 1e-8.
SAMPLES = 96
#: Contact friction above which a gait is flagged (the amount is archived, so any other limit can be applied).
FRICTION_LIMIT = 1.0
#: Lanes measured at a time, to bound memory.
BLOCK = 128
#: A velocity that is this small beside what it is the sum of counts as zero.
ROUNDING = 1e-12
SHANK, THIGH = 0, 1


class Chain:
    """A walker whose stance knee is open, in units of its leg, its mass and g.

    Arrays have the link first where they have one, any shape after it, and the lane last.
    """

    def __init__(self, walker: Walker):
        leg, mass = walker.leg, walker.total_mass
        self.kneed, self.massless = walker.knees, walker.massless_leg
        self.R, self.l = walker.R / leg, walker.l / leg
        knee, thigh, shank = walker.knee / leg, walker.thigh_centre / leg, walker.shank_centre / leg
        #: Foot centre from the knee, in the frame of the extended leg.
        self.foot = -1j * self.l - knee
        m_t, m_s = walker.m_t / mass, walker.m_s / mass
        arms = np.array([[shank - self.foot, 0, 0, 0], [-self.foot, thigh - knee, 0, 0], [-self.foot, -knee, 0, 0],
                         [-self.foot, -knee, thigh, 0], [-self.foot, -knee, knee, shank]])
        masses = np.array([m_s, m_t, walker.m_h / mass, m_t, m_s])
        inertia = np.array([m_s * walker.r_s**2, m_t * walker.r_t**2, m_t * walker.r_t**2, m_s * walker.r_s**2]) / leg**2
        #: First moments and products of the arms; a massless leg's own rows are those of a unit point at its foot.
        self.S = masses @ arms
        self.K = arms.conj().T @ (masses[:, None] * arms) + np.diag(inertia)
        self.S_rows = self.S.copy()
        if self.massless:
            self.K[2:] = np.outer(arms[4].conj(), arms[4])[2:]
            self.S_rows[2:] = arms[4, 2:]

    def groups(self, free_knee: bool) -> list[list[int]]:
        """Links that move as one."""
        return [[0, 1], [2], [3]] if free_knee else [[0, 1], [2, 3]]

    def matrix(self, q: np.ndarray) -> list[list[np.ndarray]]:
        """Mass matrix of the four links, rows of arrays."""
        e = np.exp(1j * q)
        M = [[(self.K[i, j] * e[i].conj() * e[j]).real for j in range(4)] for i in range(4)]
        for j in range(4):
            M[0][j] = M[0][j] + self.R * (self.S[j] * e[j]).imag
            M[j][0] = M[j][0] + self.R * (self.S_rows[j] * e[j]).imag
        M[0][0] = M[0][0] + self.R**2
        return M

    def force(self, q: np.ndarray, rate: np.ndarray, slope: np.ndarray) -> list[np.ndarray]:
        """Right-hand side f of M q'' = f."""
        e = np.exp(1j * q)
        gravity = np.sin(slope) - 1j * np.cos(slope)
        f = [((1j * self.S_rows[i] * e[i]).conj() * gravity).real
             + sum(rate[j] ** 2 * (self.K[i, j] * e[i].conj() * e[j]).imag for j in range(4)) for i in range(4)]
        pull = gravity + sum(rate[j] ** 2 * self.S[j] * e[j] for j in range(4))
        f[0] = f[0] - self.R * pull.real
        return f

    def accelerations(self, q: np.ndarray, rate: np.ndarray, slope: np.ndarray, free_knee: bool) -> np.ndarray:
        """Angular accelerations of the four links with the stance knee locked."""
        M, f, groups = self.matrix(q), self.force(q, rate, slope), self.groups(free_knee)
        A = _grouped(M, groups)
        b = [sum(f[i] for i in g) for g in groups]
        x = _solve(A, b)
        return np.stack([x[k] for k, g in enumerate(groups) for _ in g])

    def momentum(self, q: np.ndarray, rate: np.ndarray) -> np.ndarray:
        """Linear momentum, complex."""
        e = np.exp(1j * q)
        return -self.R * rate[0] + sum(1j * rate[j] * self.S[j] * e[j] for j in range(4))

    def ground_force(self, q: np.ndarray, rate: np.ndarray, acceleration: np.ndarray, slope: np.ndarray) -> np.ndarray:
        """Force of the ground on the stance foot, complex, over weight."""
        e = np.exp(1j * q)
        moved = sum((1j * acceleration[j] - rate[j] ** 2) * self.S[j] * e[j] for j in range(4))
        return moved - self.R * acceleration[0] - np.sin(slope) + 1j * np.cos(slope)

    def holding(self, q: np.ndarray, rate: np.ndarray, acceleration: np.ndarray, slope: np.ndarray) -> np.ndarray:
        """Torque of the stance knee's lock on the thigh; negative where no stop could give it."""
        M, f = self.matrix(q), self.force(q, rate, slope)
        return sum(M[THIGH][j] * acceleration[j] for j in range(4)) - f[THIGH]

    def height(self, q: np.ndarray) -> np.ndarray:
        """Height of the swing foot's lowest point, without cancellation for short steps."""
        a, b, c = q[0], q[2], q[3]
        bent = 2 * np.sin((c - b) / 2) * (self.foot * np.exp(0.5j * (b + c))).real
        return -2 * self.l * np.sin((a + b) / 2) * np.sin((a - b) / 2) + bent

    def rise(self, q: np.ndarray) -> np.ndarray:
        """Derivative of that height by the four angles."""
        knee = -1j * self.l - self.foot
        e = np.exp(1j * q)
        return np.stack([(arm * e[j]).real for j, arm in enumerate((-self.foot, -knee, knee, self.foot))])

    def lift(self, q: np.ndarray, rate: np.ndarray, acceleration: np.ndarray) -> np.ndarray:
        """Second derivative of that height by time."""
        knee = -1j * self.l - self.foot
        e = np.exp(1j * q)
        turning = sum(rate[j] ** 2 * (arm * e[j]).imag for j, arm in enumerate((-self.foot, -knee, knee, self.foot)))
        return (self.rise(q) * acceleration).sum(axis=0) - turning


def _grouped(M: list[list[np.ndarray]], groups: list[list[int]]) -> list[list[np.ndarray]]:
    return [[sum(M[i][j] for i in g for j in h) for h in groups] for g in groups]


def _solve(A: list[list[np.ndarray]], b: list[np.ndarray]) -> list[np.ndarray]:
    """Solve A x = b elementwise. The stance row goes last: a massless leg leaves its coupling zero."""
    A, b, n = [list(row) for row in A], list(b), len(b)
    for k in reversed(range(1, n)):
        for i in range(k):
            factor = A[i][k] / A[k][k]
            b[i] = b[i] - factor * b[k]
            for j in range(k):
                A[i][j] = A[i][j] - factor * A[k][j]
    x: list[np.ndarray] = []
    for i in range(n):
        x.append((b[i] - sum(A[i][j] * x[j] for j in range(i))) / A[i][i])
    return x


@dataclass
class Phase:
    """Samples of one phase: links' angles and rates (4, samples + 1, n), and times (samples + 1, n)."""

    q: np.ndarray
    rate: np.ndarray
    time: np.ndarray
    free_knee: bool


def _phases(motion: list[np.ndarray], times: np.ndarray) -> list[Phase]:
    found, begin = [], np.zeros(times.shape[1])
    for samples, end in zip(motion, times):
        half = samples.shape[1] // 2
        links = [0, 0, 1, half - 1]
        clock = begin + np.linspace(0, 1, len(samples))[:, None] * (end - begin)
        found.append(Phase(np.stack([samples[:, i] for i in links]), np.stack([samples[:, half + i] for i in links]),
                           clock, half == 3))
        begin = end
    return found


def greatest(x: np.ndarray, among: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Largest value of sampled functions and where, in intervals: a quartic through the five samples around it.

    Parameters
    ----------
    x : ndarray, shape (samples + 1, n)
    among : ndarray of bool, same shape
        Samples that may be the largest; all, if absent.
    """
    top = len(x) - 1
    lane = np.arange(x.shape[1])
    best = np.argmax(np.where(np.isnan(x), -np.inf, x) if among is None else np.where(among, x, -np.inf), axis=0)
    first = np.clip(best - 2, 0, top - 4)
    y = np.stack([x[first + k, lane] for k in range(5)])
    with np.errstate(invalid="ignore"):
        # Newton's divided differences at 0..4, gathered into a polynomial in t = position - first.
        powers = np.linalg.inv(np.vander(np.arange(5.0), increasing=True)) @ y
    low, high = np.maximum(best - 1, 0) - first, np.minimum(best + 1, top) - first
    t = (best - first).astype(float)
    value = x[best, lane]
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        for _ in range(6):
            slope = sum(k * powers[k] * t ** (k - 1) for k in range(1, 5))
            bend = sum(k * (k - 1) * powers[k] * t ** (k - 2) for k in range(2, 5))
            # Uphill either way: where the curve bends up, its greatest value is at an end.
            step = np.where(bend < 0, -slope / bend, np.sign(slope))
            t = np.clip(t + np.where(np.isfinite(step), step, 0.0), low, high)
        refined = sum(powers[k] * t**k for k in range(5))
        better = refined > value
    return np.where(better, refined, value), first + np.where(better, t, best - first)


def _ratio(force: np.ndarray) -> np.ndarray:
    """|tangential|/normal; infinite where the contact would have to pull."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(force.imag > 0, np.abs(force.real) / force.imag, np.where(np.isnan(force.imag), np.nan, np.inf))


def _released(chain: Chain, first: Phase, slope: np.ndarray) -> Arrays:
    """Items 4 to 6: what the leg does that has just been let go."""
    q, rate = first.q[:, 0], first.rate[:, 0]
    rise = chain.rise(q)
    velocity = (rise * rate).sum(axis=0)
    still = np.abs(velocity) <= ROUNDING * np.abs(rise * rate).sum(axis=0)
    down = np.where(still, chain.lift(q, rate, chain.accelerations(q, rate, slope, first.free_knee)), velocity) < 0
    depth = -chain.height(first.q)
    depth[0] = 0.0
    under = np.logical_and.accumulate(depth >= 0, axis=0)
    sinks = np.where(down, np.maximum(greatest(depth, under)[0], 0.0), 0.0)
    impulse = np.zeros_like(velocity)
    if not chain.massless:
        groups = chain.groups(first.free_knee)
        row = [sum(rise[i] for i in g) for g in groups]
        yielding = sum(r * x for r, x in zip(row, _solve(_grouped(chain.matrix(q), groups), row)))
        impulse = np.where(~still & (velocity < 0), -velocity / yielding, 0.0)
    found = {"penetration_depth": sinks, "trailing_impulse": impulse, "release_penetrates": down}
    if chain.kneed:
        over = greatest(first.q[3] - first.q[2])[0]
        found["hyperextension"] = np.maximum(over, 0.0)
        found["release_hyperextends"] = rate[2] < rate[3]
    return found


def _heelstrike(chain: Chain, first: Phase, impact: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Ground impulse (complex) and angular impulse of the new stance knee's lock on its thigh.

    Notes
    -----
    Before it, the walker moves as the new stance leg's chain with the old rates does, carried along with the
    velocity of the point that is about to touch the ground (paper, eq. 12 with its sign mended).
    """
    q, after = first.q[:, 0], first.rate[:, 0]
    before = np.stack([impact[1], impact[1], impact[0], impact[0]])
    carried = (-(chain.R + chain.l * np.cos(q[0])) * (impact[0] - impact[1])
               + 1j * chain.l * np.sin(q[0]) * (impact[0] + impact[1]))
    ground = chain.momentum(q, after) - chain.momentum(q, before) - carried
    M = chain.matrix(q)
    lever = 1j * chain.S[THIGH] * np.exp(1j * q[THIGH])
    lock = sum(M[THIGH][j] * (after[j] - before[j]) for j in range(4)) - (lever.conj() * carried).real
    return ground, lock


def _dimensionless(chain: Chain, motion: list[np.ndarray], impact: np.ndarray, times: np.ndarray,
                   slope: np.ndarray) -> Arrays:
    phases = _phases(motion, times)
    n = len(slope)
    least, friction = np.full(n, np.inf), np.zeros(n)
    scuff, torque, when = np.zeros(n), np.full(n, -np.inf), np.zeros(n)
    for phase in phases:
        acceleration = chain.accelerations(phase.q, phase.rate, slope, phase.free_knee)
        force = chain.ground_force(phase.q, phase.rate, acceleration, slope)
        least = np.minimum(least, -greatest(-force.imag)[0])
        demand = _ratio(force)
        pulls = np.isinf(demand).any(axis=0)
        worst = greatest(np.where(pulls, 0.0, demand))[0]
        friction = np.maximum(friction, np.where(pulls, np.inf, worst))
        depth = -chain.height(phase.q)
        if phase is phases[0]:
            depth[0] = 0.0
        if phase is phases[-1]:
            depth[-1] = 0.0
        scuff = np.maximum(scuff, greatest(depth)[0])
        if chain.kneed:
            worst, at = greatest(-chain.holding(phase.q, phase.rate, acceleration, slope))
            later = worst > torque
            torque = np.where(later, worst, torque)
            begin, end = phase.time[0], phase.time[-1]
            when = np.where(later, begin + at / (len(phase.time) - 1) * (end - begin), when)
    ground, lock = _heelstrike(chain, phases[0], impact)
    absent = np.full(n, np.nan)
    found = {"scuff_depth": scuff, "least_normal_force": least, "friction_demand": friction,
             "friction_demand_heelstrike": _ratio(ground), "friction_demand_kneestrike": absent,
             "unlocking_torque": absent, "unlocking_torque_time": absent, "unlocking_impulse_kneestrike": absent,
             "unlocking_impulse_heelstrike": absent, "hyperextension": absent}
    found |= _released(chain, phases[0], slope)
    pulled = (least < 0) | (ground.imag < 0)
    opened = np.zeros(n, bool)
    strikes = found["friction_demand_heelstrike"]
    if chain.kneed:
        q = phases[1].q[:, 0]
        jump = phases[1].rate[:, 0] - phases[0].rate[:, -1]
        M, ground = chain.matrix(q), chain.momentum(q, jump)
        found |= {"unlocking_torque": torque, "unlocking_torque_time": when, "unlocking_impulse_heelstrike": -lock,
                  "unlocking_impulse_kneestrike": -sum(M[THIGH][j] * jump[j] for j in range(4)),
                  "friction_demand_kneestrike": _ratio(ground)}
        pulled |= ground.imag < 0
        opened = ((torque > 0) | (found["unlocking_impulse_kneestrike"] > 0)
                  | (found["unlocking_impulse_heelstrike"] > 0))
        strikes = np.maximum(strikes, found["friction_demand_kneestrike"])
    flags = {"scuff": scuff > 0, "stance_knee_unlocks": opened, "contact_tension": pulled,
             "friction": np.maximum(friction, strikes) > FRICTION_LIMIT,
             "release_hyperextends": found.pop("release_hyperextends", opened & False),
             "release_penetrates": found.pop("release_penetrates"),
             "trailing_foot_pulls": found["trailing_impulse"] > 0}
    found["violations"] = sum(flags[name].astype(np.int32) << k for k, name in enumerate(VIOLATIONS))
    return found
