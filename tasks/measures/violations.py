"""Appendix A of the paper: by how much a verified gait violates the assumptions of the
model.

Every item is a flag and an amount, computed on the chain of four links whose stance
knee is free.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy import ndarray
from numpy.polynomial.polynomial import polyder, polyfromroots

from gaitsweep.tasks.contract.registry import VARIABLES, VIOLATIONS
from gaitsweep.tasks.contract.tables import Arrays
from gaitsweep.tasks.measures.drive import PushOff
from gaitsweep.tasks.mechanics.contact import SWING_SHANK, THIGH, Chain
from gaitsweep.tasks.mechanics.sums import total
from gaitsweep.tasks.walkers.walker import Walker

#: Intervals of each phase.
SAMPLES = 96
#: Lanes measured at a time, to bound memory.
_BLOCK = 128
#: A velocity this small relative to its summands counts as zero.
_ROUNDING = 1e-12
#: Peaks of the samples examined besides the highest.
_FURTHER_PEAKS = 2
#: Samples on either side of one, through which a polynomial locates extremes: its error
#: is below 1e-13 on common steps.
_SIDE = 5


def _powers() -> ndarray:
    """Coefficients, in places over `_SIDE`, of the polynomials that are one at one of
    the samples and zero at the others, shape (powers, samples).
    """
    places = np.arange(-_SIDE, _SIDE + 1.0)
    units = _SIDE ** np.arange(len(places))
    columns = []
    for k, place in enumerate(places):
        others = np.delete(places, k)
        columns.append(polyfromroots(others) / np.prod(place - others) * units)
    return np.array(columns).T


_POWERS = _powers()


class _Phase:
    """Samples of one phase: times, shape (samples + 1, n); angles, rates and
    accelerations of the links, (4, ...).
    """

    def __init__(
        self,
        chain: Chain,
        samples: ndarray,
        begin: ndarray,
        end: ndarray,
        slope: ndarray,
    ):
        half = samples.shape[1] // 2
        # Both links of the stance leg move as one, and those of a straight swing leg.
        links = [0, 0, 1, half - 1]
        angles = samples[:, :half]
        rates = samples[:, half:]
        self.q = np.stack([angles[:, link] for link in links])
        self.rate = np.stack([rates[:, link] for link in links])

        self.time = begin + np.linspace(0, 1, len(samples))[:, None] * (end - begin)
        self.free_knee = half == 3
        self.acceleration = chain.accelerations(
            self.q, self.rate, slope, self.free_knee
        )

    @property
    def motion(self) -> tuple[ndarray, ndarray, ndarray]:
        """Angles, rates and accelerations."""
        return self.q, self.rate, self.acceleration


def greatest(
    x: ndarray,
    among: ndarray | None = None,
) -> tuple[ndarray, ndarray]:
    """Find the largest value of sampled functions, by a polynomial through the samples
    around each peak.

    Parameters
    ----------
    x : ndarray, shape (samples + 1, n)
    among : ndarray of bool, same shape
        Samples that may be the largest; all, if absent.

    Returns
    -------
    value, position : ndarray, shape (n,)
        The position is in intervals from the first sample.
    """
    if among is None:
        among = ~np.isnan(x)
    samples = np.where(among, x, -np.inf)
    n = x.shape[1]
    border = np.full((1, n), -np.inf)
    around = np.concatenate([border, samples, border])
    before = around[:-2]
    after = around[2:]
    is_peak = (samples >= before) & (samples >= after)
    is_peak &= samples > -np.inf

    lane = np.arange(n)
    best = np.argmax(samples, axis=0)
    value, position = _peak(x, best)
    # The highest peak may lie between two samples that are lower than another one.
    for _ in range(_FURTHER_PEAKS):
        is_peak[best, lane] = False
        best = np.argmax(np.where(is_peak, samples, -np.inf), axis=0)
        other, at = _peak(x, best)
        is_higher = is_peak[best, lane] & (other > value)
        value = np.where(is_higher, other, value)
        position = np.where(is_higher, at, position)

    return value, position


def _through(x: ndarray, middle: ndarray) -> ndarray:
    """Coefficients of the polynomials through sampled functions around their samples
    `middle`, shape (n,).
    """
    lane = np.arange(x.shape[1])
    values = [x[middle + k, lane] for k in range(-_SIDE, _SIDE + 1)]
    powers = []
    for row in _POWERS.tolist():
        terms = [c * value for c, value in zip(row, values, strict=True)]
        powers.append(total(terms))
    return np.stack(powers)


def _peak(x: ndarray, best: ndarray) -> tuple[ndarray, ndarray]:
    """Largest value and its position within an interval of the sample `best`, shape
    (n,), of sampled functions.
    """
    top = len(x) - 1
    middle = np.clip(best, _SIDE, top - _SIDE)
    around = (np.clip(best + k, 0, top) for k in (-1, 0, 1))
    low, at, high = ((place - middle) / _SIDE for place in around)
    value = x[best, np.arange(x.shape[1])]
    t = at
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        powers = _through(x, middle)
        t = _to_top(powers, t, low, high)
        refined = _polynomial(powers, t)
        # At an end the value is that of a sample; only inside can the polynomial exceed
        # the samples.
        is_larger = (refined > value) & (t > low) & (t < high)

    place = np.where(is_larger, t, at)
    return np.where(is_larger, refined, value), middle + _SIDE * place


def _to_top(powers: ndarray, t: ndarray, low: ndarray, high: ndarray) -> ndarray:
    """Where polynomials are greatest between two places, from a guess, by Newton's
    method.
    """
    first, second = polyder(powers), polyder(powers, 2)
    for _ in range(6):
        slope = _polynomial(first, t)
        curvature = _polynomial(second, t)
        # Uphill in either case: where the polynomial is convex, its greatest value is
        # at an end.
        step = np.where(curvature < 0, -slope / curvature, np.sign(slope))
        t = np.clip(t + np.where(np.isfinite(step), step, 0.0), low, high)

    return t


def _passing(chain: Chain, phase: _Phase) -> ndarray:
    """Greatest depth of a straight swing leg's foot as it passes the stance leg, shape
    (n,) [leg].

    Notes
    -----
    With a and b the leg angles, the foot is below the ground between the zeros of a - b and a + b. On long steps at
    small slopes these lie within one interval of the samples, and the depth is so small
    that only its two factors have digits.
    """
    apart = phase.q[0] - phase.q[2]
    sum_of_angles = phase.q[0] + phase.q[2]
    middle, guess = _first_passing(apart)
    minus = _through(apart, middle)
    plus = _through(sum_of_angles, middle)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        passes = guess
        for _ in range(5):
            passes = passes - _step_to_zero(minus, passes)

        # Depth 2 l sin((a + b)/2) sin((a - b)/2) is greatest halfway between the zeros,
        # to first order.
        t = passes - 0.5 * _step_to_zero(plus, passes)
        for _ in range(5):
            t = t - _step_to_extreme(plus, minus, t)
        of_sum = np.sin(_polynomial(plus, t) / 2)
        of_difference = np.sin(_polynomial(minus, t) / 2)
        depth = 2 * chain.l * of_sum * of_difference
        is_near = _SIDE * np.abs(t - passes) < 1
        return np.where(is_near & (depth > 0), depth, 0.0)


@np.errstate(divide="ignore", invalid="ignore", over="ignore")
def _first_passing(apart: ndarray) -> tuple[ndarray, ndarray]:
    """Sample in the middle of those around the first zero of an angle that falls, and
    that zero from there, over `_SIDE` intervals, by a chord.
    """
    lane = np.arange(apart.shape[1])
    i = np.argmax(apart[1:] <= 0, axis=0)
    middle = np.clip(i, _SIDE, len(apart) - 1 - _SIDE)
    before = apart[i, lane]
    after = apart[i + 1, lane]
    zero = i - middle + before / (before - after)
    return middle, zero / _SIDE


def _step_to_zero(powers: ndarray, t: ndarray) -> ndarray:
    """Newton's step, backwards, to a zero of a polynomial."""
    return np.asarray(_polynomial(powers, t) / _polynomial(powers, t, 1))


def _step_to_extreme(plus: ndarray, minus: ndarray, t: ndarray) -> ndarray:
    """Newton's step, backwards, to where a product of two polynomials is extreme."""
    u, u_t, u_tt = (_polynomial(plus, t, order) for order in range(3))
    v, v_t, v_tt = (_polynomial(minus, t, order) for order in range(3))
    slope = u_t * v + u * v_t
    curvature = u_tt * v + 2 * u_t * v_t + u * v_tt
    return slope / curvature


def _polynomial(powers: ndarray, t: ndarray, order: int = 0) -> ndarray:
    """Values or derivatives of polynomials, one a lane, by Horner's rule: numpy's own
    checks its arguments for longer than it computes.
    """
    powers = polyder(powers, order) if order else powers
    value = powers[-1] + 0.0 * t
    for power in powers[-2::-1]:
        value = power + value * t
    return np.asarray(value)


def _ratio(force: ndarray) -> ndarray:
    """Ratio |tangential|/normal of a force; infinite under contact tension."""
    otherwise = np.where(np.isnan(force.imag), np.nan, np.inf)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.abs(force.real) / force.imag
        return np.where(force.imag > 0, ratio, otherwise)


def _released(chain: Chain, first: _Phase) -> Arrays:
    """Items 4 to 6: motion of the leg just released."""
    q = first.q[:, 0]
    rate = first.rate[:, 0]
    rise = chain.rise(q)
    velocity = total(rise * rate)
    is_still = np.abs(velocity) <= _ROUNDING * total(np.abs(rise * rate))
    lift = chain.lift(q, rate, first.acceleration[:, 0])
    down = np.where(is_still, lift, velocity) < 0

    depth = -chain.height(first.q)
    depth[0] = 0.0
    under = np.logical_and.accumulate(depth >= 0, axis=0)
    sinks = np.where(down, np.maximum(greatest(depth, under)[0], 0.0), 0.0)

    # It would act while the knee is still as it is during heelstrike.
    impulse = np.zeros_like(velocity)
    if not chain.massless:
        compliance = chain.compliance(q, [rise], chain.frees_trailing_knee)[0][0]
        is_pushed = ~is_still & (velocity < 0)
        impulse = np.where(is_pushed, -velocity / compliance, 0.0)

    amounts = {"penetration_depth": sinks, "trailing_impulse": impulse}
    if chain.kneed:
        amounts["hyperextension"] = _hyperextension(first)
    return amounts


def _hyperextension(first: _Phase) -> ndarray:
    """Largest angle by which the knee that is free bends forward."""
    over = first.q[3] - first.q[2]
    over[0] = over[-1] = 0.0
    return greatest(over)[0]


def _before_heelstrike(
    chain: Chain,
    q: ndarray,
    impact: ndarray,
    push: PushOff | None,
) -> tuple[ndarray, ndarray]:
    """Rates of the links just before heelstrike, after a push-off, and the velocity,
    complex, of the point that is about to touch the ground (paper, eq. 12 with the sign
    of its first line corrected).
    """
    rates = np.stack([impact[1], impact[1], impact[0], impact[0]])
    across = -(chain.R + chain.l * np.cos(q[0])) * (impact[0] - impact[1])
    upward = chain.l * np.sin(q[0]) * (impact[0] + impact[1])
    translation = across + 1j * upward
    if push is None:
        return rates, translation
    return rates + push.rates, translation + push.translation


def _heelstrike(
    chain: Chain,
    first: _Phase,
    impact: ndarray,
    push: PushOff | None,
) -> tuple[ndarray, ndarray, ndarray]:
    """Ground impulse (complex) and angular impulses of the new stance knee's lock on its
    thigh, and of the trailing knee's on its shank, at heelstrike.

    Notes
    -----
    Before heelstrike, the walker moves as the new stance leg's chain with the old rates, translating with the velocity
    of the point that is about to touch the ground.
    """
    q = first.q[:, 0]
    after = first.rate[:, 0]
    before, translation = _before_heelstrike(chain, q, impact, push)
    ground = chain.momentum(q, after) - chain.momentum(q, before) - translation
    M = chain.matrix(q)

    jump = after - before

    def on_link(row: int) -> ndarray:
        lever = 1j * chain.S[row] * np.exp(1j * q[row])
        by_translation = (lever.conj() * translation).real

        gained = total(mass * jump[j] for j, mass in enumerate(M[row]))
        return np.asarray(gained - by_translation)

    on_thigh = on_link(THIGH)
    on_shank = on_link(SWING_SHANK)
    return ground, on_thigh, on_shank


def _moving(chain: Chain, phases: list[_Phase], slope: ndarray) -> Arrays:
    """Items 1 to 3 between the impacts."""
    amounts = _of_foot(chain, phases) | _of_ground_force(chain, phases, slope)
    if chain.kneed:
        amounts |= _of_lock(chain, phases, slope)
    return amounts


def _of_foot(chain: Chain, phases: list[_Phase]) -> Arrays:
    """Item 1: how deep the swing foot scuffs, and how little it clears the ground."""
    n = phases[0].q.shape[-1]
    scuff = np.zeros(n)
    clearance = np.full(n, np.nan)
    for phase in phases:
        depth = -chain.height(phase.q)
        # Both feet touch the ground when the step begins and when it ends: the rest is
        # rounding.
        if phase is phases[0]:
            depth[0] = 0.0
        if phase is phases[-1]:
            depth[-1] = 0.0
        scuff = np.maximum(scuff, greatest(depth)[0])
        clearance = np.fmin(clearance, _least_inside(depth))

        if not chain.kneed:
            passing = _passing(chain, phase)
            scuff = np.maximum(scuff, passing)
            clearance = np.where(passing > 0, np.fmin(clearance, -passing), clearance)

    clearance = np.fmin(clearance, _at_kneestrike(chain, phases))
    return {"scuff_depth": scuff, "foot_clearance": clearance}


def _of_ground_force(chain: Chain, phases: list[_Phase], slope: ndarray) -> Arrays:
    """Item 2: the least normal force on the stance foot, and the friction that it needs."""
    least = np.full(len(slope), np.inf)
    friction = np.zeros(len(slope))
    for phase in phases:
        force = chain.ground_force(*phase.motion, slope)
        least = np.minimum(least, -greatest(-force.imag)[0])

        pulls = (force.imag <= 0).any(axis=0)
        # With its sign the ratio is smooth where it changes it.
        demand = np.where(pulls, 0.0, force.real / np.where(pulls, 1.0, force.imag))
        largest = np.maximum(greatest(demand)[0], greatest(-demand)[0])
        friction = np.maximum(friction, np.where(pulls, np.inf, largest))

    return {"least_normal_force": least, "friction_demand": friction}


def _of_lock(chain: Chain, phases: list[_Phase], slope: ndarray) -> Arrays:
    """Item 3: the largest torque that would unlock the stance knee, and when."""
    torque = np.full(len(slope), -np.inf)
    when = np.zeros(len(slope))
    for phase in phases:
        worst, position = greatest(-chain.holding(*phase.motion, slope))
        is_worse = worst > torque
        torque = np.where(is_worse, worst, torque)

        begin = phase.time[0]
        end = phase.time[-1]
        time = begin + position / (len(phase.time) - 1) * (end - begin)
        when = np.where(is_worse, time, when)

    return {"unlocking_torque": torque, "unlocking_torque_time": when}


def _least_inside(depth: ndarray) -> ndarray:
    """Least height of a foot where it is lowest within a phase, by its sampled depth;
    NaN where it is so nowhere.
    """
    is_low = np.zeros(depth.shape, bool)
    is_low[1:-1] = (depth[1:-1] >= depth[:-2]) & (depth[1:-1] > depth[2:])
    return np.where(is_low.any(axis=0), -greatest(depth, is_low)[0], np.nan)


def _at_kneestrike(chain: Chain, phases: list[_Phase]) -> ndarray:
    """Height of the foot at kneestrike if it falls before and rises after it, else NaN."""
    if not chain.kneed:
        return np.full(phases[0].q.shape[-1], np.nan)
    free, locked = phases
    before = total(chain.rise(free.q[:, -1]) * free.rate[:, -1])
    after = total(chain.rise(locked.q[:, 0]) * locked.rate[:, 0])
    height = chain.height(locked.q[:, 0])
    return np.where((before < 0) & (after > 0), height, np.nan)


def _impacts(
    chain: Chain,
    phases: list[_Phase],
    impact: ndarray,
    push: PushOff | None,
) -> Arrays:
    """Items 2 and 3 at the impacts, and what the push-off asks of the ground."""
    ground, lock, trailing_lock = _heelstrike(chain, phases[0], impact, push)
    amounts = {
        "friction_demand_heelstrike": _ratio(ground),
        "least_normal_impulse": ground.imag,
    }
    if push is not None:
        _, translation = _before_heelstrike(chain, phases[0].q[:, 0], impact, push)
        amounts["friction_demand_push_off"] = _ratio(push.direction)
        amounts["strike_velocity"] = -translation.imag

    if chain.kneed:
        q = phases[1].q[:, 0]
        jump = phases[1].rate[:, 0] - phases[0].rate[:, -1]
        at_knee = chain.momentum(q, jump)
        least = np.minimum(ground.imag, at_knee.imag)
        amounts["friction_demand_kneestrike"] = _ratio(at_knee)
        amounts["least_normal_impulse"] = least

        on_thigh = chain.matrix(q)[THIGH]
        gained = total(mass * jump[j] for j, mass in enumerate(on_thigh))
        amounts["unlocking_impulse_heelstrike"] = -lock
        amounts["unlocking_impulse_kneestrike"] = -gained

    if chain.locks_trailing_knee:
        amounts["unlocking_impulse_trailing"] = trailing_lock
    return amounts


def flags(
    amounts: Mapping[str, ndarray],
    limits: Mapping[str, float] | None = None,
) -> ndarray:
    """Bits of the assumptions that gaits violate by more than their limits.

    Parameters
    ----------
    amounts : mapping
        Variables of the group, shape (n,), over the walker's leg, its mass and g; NaN
        is no violation.
    limits : mapping, optional
        Limits other than the registry's, by the names of violations.

    Returns
    -------
    ndarray of int32, shape (n,)
    """
    bits = np.zeros(len(amounts["scuff_depth"]), np.int32)
    for k, violation in enumerate(VIOLATIONS.values()):
        limit = (limits or {}).get(violation.name, violation.limit)
        for name in violation.amounts:
            if name in amounts:
                excess = -amounts[name] if violation.is_least else amounts[name]
                bits |= (excess > limit).astype(np.int32) << k

    return bits


def measure(
    walker: Walker,
    motion: list[ndarray],
    impact: ndarray,
    times: ndarray,
    slope: ndarray,
    limits: Mapping[str, float] | None = None,
    push: PushOff | None = None,
) -> Arrays:
    """Measure every item of Appendix A, in the walker's units.

    Parameters
    ----------
    walker : Walker
    motion : list of ndarray, shape (samples + 1, angles, n)
        Angles and rates of each phase at equal times: stance leg, swing thigh[, swing
        shank]  [rad, sqrt(g/leg)].
    impact : ndarray, shape (2, n)
        Rates of the old stance and swing leg just before the heelstrike with which the
        step begins [sqrt(g/leg)].
    times : ndarray, shape (phases, n) [sqrt(leg/g)]
        Ends of the phases.
    slope : ndarray, shape (n,) [rad]
    limits : mapping, optional
        Limits of violations other than the registry's.
    push : PushOff, optional
        The push-off before that heelstrike, if there is one.

    Returns
    -------
    dict
        The variables of the registry's group `violations`, shape (n,), but for those of
        knees, or of a knee locked at heelstrike, that the walker has not.

    Notes
    -----
    Paper, appendix A. Amounts are positive where the assumption is violated. Torque and impulses of the stance knee
    keep their sign: its stop can provide negative ones. So does the impulse with which the trailing knee is locked at
    heelstrike: where it is positive the shank would fly back, and only a latch holds it. Contact tension may arise from
    the force during the motion or from an impulse; the friction demand is then
    infinite. The trailing impulse is that of the linear complementarity problem in
    which the released foot may be pushed but not pulled, without friction, while the
    new contact holds.
    """
    n = len(slope)
    begins = np.vstack([np.zeros((1, n)), times[:-1]])
    parts: list[Arrays] = []
    for k in range(0, max(n, 1), _BLOCK):
        lanes = slice(k, k + _BLOCK)
        chain = Chain(walker.some(lanes))
        pushed = None if push is None else push.some(lanes)
        with np.errstate(invalid="ignore"):
            phases = [
                _Phase(
                    chain, samples[..., lanes], begin[lanes], end[lanes], slope[lanes]
                )
                for samples, begin, end in zip(motion, begins, times, strict=True)
            ]
            amounts = _amounts(chain, phases, impact[:, lanes], slope[lanes], pushed)

        amounts["violations"] = flags(amounts, limits)
        parts.append(amounts)

    unit = _units(walker)
    measured = {}
    for name in parts[0]:
        values = np.concatenate([part[name] for part in parts])
        if name != "violations":
            values = values * unit[VARIABLES[name].kind]
        measured[name] = values

    return measured


def _amounts(
    chain: Chain,
    phases: list[_Phase],
    impact: ndarray,
    slope: ndarray,
    push: PushOff | None,
) -> Arrays:
    """Every item of Appendix A, over leg, mass and g."""
    between = _moving(chain, phases, slope)
    return between | _impacts(chain, phases, impact, push) | _released(chain, phases[0])


def _units(walker: Walker) -> dict[str, float]:
    """Unit of each kind of quantity inside the solver, in the walker's units."""
    length = walker.leg
    time = walker.time_unit
    mass = walker.total_mass

    return {
        "length": length,
        "time": time,
        "torque": mass * walker.g * length,
        "speed": length / time,
        "impulse": mass * length / time,
        "angular_impulse": mass * length**2 / time,
        "angle": 1.0,
        "number": 1.0,
    }
