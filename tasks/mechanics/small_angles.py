"""Steps to first order in the angles, in closed form: what a search for gaits begins
with.

Near q = (stance, swing thigh[, swing shank]) = 0 the equations of motion
(tasks.mechanics.equations) are M q'' = G q - D q' - c, with constant M and G, D of a
damper between the thighs, and c linear in the slope. A push-off adds to the rates after
heelstrike what is linear in the angle. States are followed as linear functions of (stance angle, old stance rate,
old swing rate, 1, slope), so that all angles and slopes share one propagation.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from gaitsweep.tasks.mechanics.lumped import lump
from gaitsweep.tasks.mechanics.sums import matvec, total
from gaitsweep.tasks.walkers.walker import Walker

#: Periods searched for those in which both legs exchange places [sqrt(leg/g)].
_PERIODS = np.linspace(1.0, 6.0, 51)
#: Shortest and longest time taken for a swing of the leg [sqrt(leg/g)]: a leg that is
#: balanced about the hip has none.
_SWINGS = (0.02, 7.0)
#: Longest time taken for it of a leg that stands above the hip, over pi times that in
#: which its fall grows e-fold.
_FALLING = 10.0
#: Times at which the flexion of the knee is looked at, over a swing of the leg, and the
#: largest for its return.
_KNEE_TIMES, _KNEE_UP_TO = 200, 1.6
#: Time of kneestrike over the period, where it is not known, and at most.
_KNEE_GUESS, _KNEE_LATEST = 0.65, 0.93
#: Largest overextension of a knee over its flexion before that may vanish beyond small
#: angles.
_SHALLOW = 0.5
#: Angle between links that hang freely from which the knee may return earlier, and then
#: the time over that of small angles.
_BENT, _EARLIER = 0.3, 0.7


class SmallAngles:
    """A walker's motion and impacts to first order in the angles.

    Parameters
    ----------
    walker : Walker

    Attributes
    ----------
    swing : float [sqrt(leg/g)]
        Time in which the straight leg, hung at the hip, swings from one side to the
        other.
    length : float
        From the hip to the centre of the foot's arc, over the leg.
    """

    def __init__(self, walker: Walker):
        constants = lump(walker)
        self.point_foot = walker.point_foot
        self.has_knees = walker.knees
        self.eps = constants["eps"]
        self.length = 1.0 - constants["R"]
        self.locked, self.free = self._motions(constants)

        S, J = self._straight_leg()
        self.swing = _swing(S - constants["hip_stiffness"], J)
        #: Impulse of the push-off, and torque between the thighs that drives.
        self.push = constants["push"]
        self.torque = self.eps * constants["hip_bias"]

        momentum = self._momentum_before(constants)

        if walker.pushes_off:
            momentum[:, 2:] = self._push_off(constants, walker.frees_trailing_knee)
        rates = self._rates_of(momentum, walker.locks_trailing_knee)
        #: Rates just after heelstrike by both rates before it, and by (angle, 1).
        self.heelstrike = rates[:, :2]
        self.push_off = rates[:, 2:]

    def _straight_leg(self) -> tuple[float, float]:
        """First moment and inertia of the straight swing leg."""
        return self.locked.weights[1], self.locked.M[1, 1]

    def _motions(self, constants: Mapping[str, float]) -> tuple[_Linear, _Linear]:
        """The motion with the knee locked, and with a free one."""
        stance, *swing = (
            complex(constants[f"S_{x}_re"], constants[f"S_{x}_im"])
            for x in ("abc" if self.has_knees else "ab")
        )
        inertia = [constants["C_bb"]]
        between = 0.0

        if self.has_knees:
            inertia.append(constants["C_cc"])
            between = constants["H_re"]

        R = constants["R"]
        rolling = constants["C_aa"] + 2 * R * stance.imag
        carried = rolling, R, self.eps, stance
        whole = sum(inertia) + 2 * between
        locked = _Linear(*carried, [sum(swing)], [whole], 0.0)
        free = _Linear(*carried, swing, inertia, between)

        for motion in (locked, free):
            motion.add_hip_torque(self.eps, constants)
        return locked, free

    def _momentum_before(self, constants: Mapping[str, float]) -> np.ndarray:
        """Momenta of the links before heelstrike with both legs along the normal
        (tasks.mechanics.impacts), by both rates, the angle and 1.
        """
        S, J = self._straight_leg()
        between = constants["H_re"] if self.has_knees else 0.0
        own = np.diag(self.free.M)[1:]

        momentum = np.zeros((len(self.free.M), 4))
        momentum[0, 0] = 1 + 2 * self.eps * S
        momentum[0, 1] = self.eps * (S + J)
        momentum[1:, 0] = self.free.weights[1:] + own + between
        return momentum

    def _push_off(self, constants: Mapping[str, float], frees_knee: bool) -> np.ndarray:
        """Momenta of the links that the push-off gives, by (angle, 1)."""
        push = constants["push"]
        gained = np.zeros((len(self.free.M), 2))
        gained[0, 0] = -2 * self.length * push

        if frees_knee:
            # The knee lies beside the line from the contact to the hip, which leans by
            # the foot's arc.
            knee_x = constants["knee_re"]
            knee_y = constants["knee_im"]
            leaning = knee_y * (self.length - 1.0)
            bending = push / self.eps * np.array([leaning, knee_x])
            gained[1] = bending
            gained[2] = -bending
        return gained

    def _rates_of(self, momentum: np.ndarray, locks_trailing_knee: bool) -> np.ndarray:
        """Rates just after heelstrike from the momenta of the links, by the old rates."""
        if not locks_trailing_knee:
            return np.linalg.solve(self.free.M, momentum)

        stance, thigh, shank = momentum
        of_leg = thigh + shank
        rates = np.linalg.solve(self.locked.M, [stance, of_leg])
        leg = rates[1]
        return np.stack([rates[0], leg, leg])

    def exchange_rates(
        self, angle: np.ndarray, period: np.ndarray, slope: np.ndarray
    ) -> np.ndarray:
        """Rates just after heelstrike with which straight legs exchange places in a
        given time.

        Parameters
        ----------
        angle, period, slope : ndarray, shape (n,) [rad], [sqrt(leg/g)] and [rad]

        Returns
        -------
        ndarray, shape (2, n) [rad/sqrt(leg/g)]
            Of the stance and of the swing leg. A leg whose mass is all at the foot
            starts with the rate that heelstrike gives it; then only the stance leg
            reaches the other's place.
        """
        by_rates, lack = self._exchange(angle, period, slope)

        if self.point_foot:
            along = _rates_along(angle)
            return along * lack[0] / total(by_rates[0] * along)

        # By Cramer's rule, since both rates may do the same to all digits where a leg
        # falls fast.
        (a, b), (c, d) = by_rates
        of_stance = d * lack[0] - b * lack[1]
        of_swing = a * lack[1] - c * lack[0]
        rates = np.stack([of_stance, of_swing])
        determinant = a * d - b * c
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(rates / determinant)

    def stance_rate(
        self,
        angle: np.ndarray,
        period: np.ndarray,
        swing_rate: np.ndarray,
        slope: np.ndarray,
    ) -> np.ndarray:
        """Stance rate just after heelstrike with which the stance leg alone reaches the
        other's place in a given time.

        Parameters
        ----------
        angle, period, swing_rate, slope : ndarray, shape (n,)
            In rad, sqrt(leg/g), rad/sqrt(leg/g) and rad.

        Returns
        -------
        ndarray, shape (n,) [rad/sqrt(leg/g)]
        """
        by_rates, lack = self._exchange(angle, period, slope)
        return (lack[0] - by_rates[0, 1] * swing_rate) / by_rates[0, 0]

    def exchange_periods(self, angle: np.ndarray, slope: np.ndarray) -> np.ndarray:
        """Periods in which both legs exchange places, where their masses are at the
        feet.

        Parameters
        ----------
        angle, slope : ndarray, shape (n,) [rad]

        Returns
        -------
        ndarray, shape (2, n) [sqrt(leg/g)]
            The two shortest, by linear interpolation between periods 0.1 apart; NaN
            where there are fewer.
        """
        motion = self.locked.after(_PERIODS)[:, :2].transpose(1, 2, 0)
        # What both legs lack, and what a rate of the stance leg adds, (2, periods, n).
        reached = total(
            motion[:, j, :, None] * known
            for j, known in enumerate(_known(angle, slope))
        )
        by_rate = total(
            motion[:, 2 + j, :, None] * rate
            for j, rate in enumerate(_rates_along(angle))
        )
        wanted = -np.array([angle, -angle])
        lack = wanted[:, None] - reached
        off = lack[1] * by_rate[0] - lack[0] * by_rate[1]

        crosses = np.diff(np.sign(off), axis=0) != 0
        before = _PERIODS[:-1, None]
        gaps = np.diff(_PERIODS)[:, None]
        with np.errstate(invalid="ignore", divide="ignore"):
            roots = before - off[:-1] * gaps / np.diff(off, axis=0)

        periods = np.where(crosses, roots, np.nan)
        return np.sort(periods, axis=0)[:2]

    def kneed_exchange(
        self,
        angle: np.ndarray,
        period: np.ndarray,
        ratio: np.ndarray,
        slope: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Stance rates and times of kneestrike with which the stance leg reaches the
        other's place in a given time.

        Parameters
        ----------
        angle, period, ratio, slope : ndarray, shape (n,) [rad], [sqrt(leg/g)], 1 and [rad]
            `ratio` is the swing leg's rate just before heelstrike over the stance
            leg's.

        Returns
        -------
        rate : ndarray, shape (2, n) [rad/sqrt(leg/g)]
            Of the old stance leg, just before heelstrike.
        kneestrike : ndarray, shape (2, n) [sqrt(leg/g)]
            The second is NaN where the first will do.

        Notes
        -----
        When the knee returns depends little on the rates. First it is taken to do so
        after `_KNEE_GUESS` of the period, which gives the rates, and these the time;
        that gravity bends links which are no line is left out, since large flexions
        undo much of it.

        A knee that overextends but little before it flexes again may, beyond small
        angles, become straight only after that. Links that hang far from a line are
        thrown so far that the knee may return earlier.
        """
        guess = _KNEE_GUESS * period
        latest = _KNEE_LATEST * period
        asked = angle, period, ratio, slope
        rate = self._rate_before(guess, *asked)
        first, second = self._knee_returns(angle, rate, ratio * rate)

        first = np.where(np.isnan(first), guess, np.minimum(first, latest))

        if self._hangs_bent():
            second = _EARLIER * first
        second = np.where(second < latest, second, np.nan)

        kneestrike = np.stack([first, second])
        rates = [self._rate_before(time, *asked) for time in kneestrike]
        return np.stack(rates), kneestrike

    def _rate_before(
        self,
        kneestrike: np.ndarray,
        angle: np.ndarray,
        period: np.ndarray,
        ratio: np.ndarray,
        slope: np.ndarray,
    ) -> np.ndarray:
        """Stance rate just before heelstrike with which the stance leg reaches the
        other's place, by the time of kneestrike, shape (n,).
        """
        end = self._kneed_end(kneestrike, period)
        by_angle, by_rate, by_swing_rate, rest, by_slope = end
        reached = by_angle * angle + rest + by_slope * slope
        return -(angle + reached) / (by_rate + by_swing_rate * ratio)

    def _hangs_bent(self) -> bool:
        """Whether the swing leg's links, its knee free, hang far from a line."""
        moments = self.free.moments
        _, thigh, shank = moments.tolist()
        between = thigh * shank.conjugate()
        return abs(between.imag) > np.tan(_BENT) * abs(between.real)

    def _exchange(
        self, angle: np.ndarray, period: np.ndarray, slope: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """What rates after heelstrike add to the last angles of a step, (2, 2, n), and
        what these lack, (2, n).
        """
        periods, place = np.unique(period, return_inverse=True)
        motion = self.locked.after(periods)[place, :2].transpose(1, 2, 0)
        wanted = -np.array([angle, -angle])
        reached = matvec(motion, _known(angle, slope))
        return motion[:, 2:4], wanted - reached

    def _start(self) -> np.ndarray:
        """State with a free knee just after heelstrike by (angle, old stance rate, old
        swing rate, 1, slope).
        """
        n = len(self.free.M)
        start = np.zeros((2 * n, 5))
        start[0, 0] = 1.0
        start[1:n, 0] = -1.0
        start[n:, 1:3] = self.heelstrike
        start[n:, [0, 3]] = self.push_off
        return start

    def _knee_returns(
        self, angle: np.ndarray, rate: np.ndarray, swing_rate: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Times at which the knee, once flexed, is straight again and for the second
        time; NaN where it is not, the second also where it overextends much before.
        """
        times = np.linspace(0.0, _KNEE_UP_TO * self.swing, _KNEE_TIMES + 1)
        moved = self.free.moved(self._start(), times)
        by_known = moved[:, 1] - moved[:, 2]
        by_angle, by_rate, by_swing_rate, *_ = by_known.T[:, :, None]
        flexion = by_angle * angle
        flexion += by_rate * rate
        flexion += by_swing_rate * swing_rate
        # Straight at the start, but for rounding.
        flexion[0] = 0.0

        after = flexion[1:]
        returns = (flexion[:-1] > 0) & (after <= 0)
        count = np.cumsum(returns, axis=0)
        is_first = returns & (count == 1)
        is_second = returns & (count == 2)
        first = _crossing(times, flexion, is_first)
        second = _crossing(times, flexion, is_second)

        flexed = np.where(count == 0, after, 0.0).max(axis=0)
        overextended = -np.where(count == 1, after, 0.0).min(axis=0)
        is_shallow = overextended < _SHALLOW * flexed
        return first, np.where(is_shallow, second, np.nan)

    def _kneed_end(self, kneestrike: np.ndarray, period: np.ndarray) -> np.ndarray:
        """The stance leg's angle at the end of kneed steps by (angle, old stance rate,
        old swing rate, 1, slope), shape (5, n).
        """
        struck = self.free.moved(self._start(), kneestrike).transpose(1, 2, 0)
        # The impulse is a torque in the knee.
        stance, thigh, shank = self.free.M
        momentum = np.stack([stance, thigh + shank])
        by_rates = np.linalg.solve(self.locked.M, momentum)
        rates = matvec(by_rates[:, :, None, None], struck[3:])
        locked = np.concatenate([struck[:2], rates])

        lasts = period - kneestrike
        by_locked = self.locked.after(lasts)[:, 0].T
        end = total(by_locked[:4, None] * locked)
        end[3:] += by_locked[4:]
        return end


def _swing(S: float, J: float) -> float:
    """Time in which a leg of first moment S and inertia J swings from one side to the
    other.

    A leg whose centre of mass lies at the hip, or above, has none of its own; beyond
    its fall there is nothing to search for.
    """
    shortest, longest = _SWINGS
    hanging = -S / J
    falling = S / J / _FALLING**2
    slowest = (np.pi / longest) ** 2
    frequency = np.sqrt(max(hanging, falling, slowest))
    return max(float(np.pi / frequency), shortest)


class _Linear:
    """Motion M q'' = G q - D q' - c of some links, with c by (1, slope)."""

    def __init__(
        self,
        rolling: float,
        R: float,
        eps: float,
        stance: complex,
        swing: list[complex],
        inertia: list[float],
        between: float,
    ):
        arms = np.array([stance, *swing])
        self.moments = arms
        self.weights = arms.imag
        self.G = np.diag(arms.imag)
        self.M = np.diag([rolling, *inertia])
        self.M[0, 1:] = eps * self.weights[1:]
        self.M[1:, 0] = self.weights[1:]
        if len(swing) > 1:
            self.M[1, 2] = between
            self.M[2, 1] = between
        self.D = np.zeros_like(self.M)
        self.c = np.stack([arms.real, arms.imag], axis=1)
        self.c[0, 1] += R

    def add_hip_torque(self, eps: float, constants: Mapping[str, float]) -> None:
        """Add a spring and a damper between stance leg and swing thigh, and a constant
        torque.
        """
        on_links = np.array([-eps, 1.0])
        opening = np.outer(on_links, [-1.0, 1.0])
        self.G[:2, :2] -= constants["hip_stiffness"] * opening
        self.D[:2, :2] += constants["hip_damping"] * opening
        self.c[:2, 0] -= constants["hip_bias"] * on_links

    def _damped(self, times: np.ndarray) -> np.ndarray:
        """States after k times as `after` has them, of links that a damper slows, by
        the motion about where they would rest.
        """
        n = len(self.M)
        rates = np.zeros((2 * n, 2 * n))
        rates[:n, n:] = np.eye(n)
        rates[n:, :n] = np.linalg.solve(self.M, self.G)
        rates[n:, n:] = -np.linalg.solve(self.M, self.D)
        growth, modes = np.linalg.eig(rates.astype(complex))
        back = np.linalg.inv(modes)
        of_modes = np.exp(np.multiply.outer(times, growth))
        moved = np.einsum("ij,kj,jl->kil", modes, of_modes, back).real

        rest = np.zeros((2 * n, 2))
        angles, *_ = np.linalg.lstsq(self.G, self.c, rcond=None)
        rest[:n] = angles
        by_force = rest - moved @ rest
        return np.concatenate([moved, by_force], axis=2)

    def after(self, times: np.ndarray) -> np.ndarray:
        """States (angles, rates) after k times by those at the start, then by (1,
        slope), shape (k, 2 n, 2 n + 2).
        """
        if self.D.any():
            return self._damped(times)

        by_angles = np.linalg.solve(self.M, self.G)
        squares, modes = np.linalg.eig(by_angles.astype(complex))
        growth = np.sqrt(squares)[:, None]
        by_angle, by_rate, by_force = _of_modes(growth, times)
        back = np.linalg.inv(modes)
        force = back @ np.linalg.solve(self.M, self.c)

        by_own = squares[:, None] * by_rate
        angles = _of_links(
            modes,
            (by_angle, back),
            (by_rate, back),
            (by_force, force),
        )
        rates = _of_links(
            modes,
            (by_own, back),
            (by_angle, back),
            (-by_rate, force),
        )
        return np.concatenate([angles, rates], axis=1)

    def moved(self, states: np.ndarray, times: np.ndarray) -> np.ndarray:
        """States by (angle, two rates, 1, slope), shape (2 n, 5), after k times, shape
        (k, 2 n, 5).
        """
        motion = self.after(times).transpose(1, 2, 0)
        by_state = motion[:, :-2, None]
        moved = matvec(by_state, states[:, :, None])
        moved[:, 3:] += motion[:, -2:]
        return moved.transpose(2, 0, 1)


def _of_modes(
    growth: np.ndarray, times: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Solutions of z'' = growth^2 z - force for a unit angle, rate and force, of modes (i,
    1) after times (k,), shape (i, k).
    """
    is_free = growth == 0
    own = np.where(is_free, 1, growth)
    angle = growth * times
    moved = np.sinh(angle) / own
    fallen = np.sinh(angle / 2) / own

    by_angle = np.cosh(angle)
    by_rate = np.where(is_free, times, moved)
    root = np.where(is_free, times / 2, fallen)
    by_force = -2 * root**2
    return by_angle, by_rate, by_force


def _of_links(modes: np.ndarray, *parts: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """Motion of the links at all times, side by side for each part: what modes make of
    their sources.
    """
    moved = []

    for of_mode, source in parts:
        by_time = np.einsum("ik,kn,kj->nij", modes, of_mode, source)
        moved.append(by_time.real)
    return np.concatenate(moved, axis=2)


def _crossing(times: np.ndarray, values: np.ndarray, is_it: np.ndarray) -> np.ndarray:
    """Times at which values (k, n) vanish after the time marked in `is_it` (k - 1, n),
    by linear interpolation; NaN where none is marked.
    """
    at = is_it.argmax(axis=0)
    lane = np.arange(values.shape[1])
    before = values[at, lane]
    after = values[at + 1, lane]

    with np.errstate(invalid="ignore", divide="ignore"):
        share = before / (before - after)
    time = times[at] + share * times[1]

    return np.where(is_it.any(axis=0), time, np.nan)


def _known(angle: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """State of straight legs just after heelstrike but for its rates, then (1, slope),
    shape (6, n).
    """
    none = np.zeros_like(angle)

    return np.stack([angle, -angle, none, none, none + 1, slope])


def _rates_along(angle: np.ndarray) -> np.ndarray:
    """Rates just after heelstrike over the stance leg's, where the masses are at the
    feet, shape (2, n).
    """
    return np.array([np.ones_like(angle), np.cos(2 * angle)])
