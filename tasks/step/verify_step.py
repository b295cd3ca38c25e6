"""Whether a solved step happens: the signs of the guards along its motion."""

from __future__ import annotations

from dataclasses import dataclass
from types import EllipsisType
from typing import NamedTuple

import numpy as np

from gaitsweep.tasks.mechanics.arrays import Marks, Motion, PerLane, Times

#: Shortest time to kneestrike [sqrt(leg/g)]: in less the knee flexes by no more than
#: rounding. At time 0, where the knee is straight, its guard has a root that is no
#: strike.
_MIN_KNEESTRIKE = 1e-7
#: Value of a guard, angles being of order one, that may be rounding at a strike, or
#: more where that is farther from 0.
_TOUCH = 1e-12
#: Flexion that may be rounding: a knee that strikes at once hardly flexes.
_STRAIGHT = 1e-14
#: Newton steps to where a cubic between samples vanishes.
_ROUNDS = 4


@dataclass
class StepCheck:
    """What the sampled motion of n lanes shows.

    Attributes
    ----------
    step : ndarray of bool, shape (n,)
        The first heelstrike (and kneestrike) is the one solved for, and its guard
        falls.
    leg_passes : ndarray of int, shape (n,)
        How often the swing leg passes the stance leg.
    doubt : ndarray of bool, shape (n,)
        A guard comes so near zero between samples that finer ones must decide.
    hyperextends : ndarray of bool, shape (n,)
        The released knee first moves against its stop.
    """

    step: Marks
    leg_passes: np.ndarray
    doubt: Marks
    hyperextends: Marks

    def of_all(self, steps: int) -> StepCheck:
        """What the checks of single steps, those of several gaits' first steps before
        the second ones, say of gaits.
        """
        step = self.step.reshape(steps, -1)
        passes = self.leg_passes.reshape(steps, -1)
        doubt = self.doubt.reshape(steps, -1)
        hyperextends = self.hyperextends.reshape(steps, -1)
        # Of legs that pass once at every step but one, the number at that.
        always_once = _all(passes == 1)
        return StepCheck(
            step=_all(step),
            leg_passes=np.where(always_once, 1, passes.max(axis=0)),
            doubt=_any(doubt),
            hyperextends=_any(hyperextends),
        )

    @property
    def anthropomorphic(self) -> np.ndarray:
        """Lanes whose legs pass exactly once."""
        return self.step & (self.leg_passes == 1)


class _Samples(NamedTuple):
    """Samples of a guard or an angle and its rates, both (samples + 1, n)."""

    value: np.ndarray
    rate: np.ndarray

    def per_interval(self, interval: PerLane) -> _Samples:
        """With rates per interval, which take times (n,)."""
        return _Samples(self.value, interval * self.rate)


def _all(marks: np.ndarray) -> Marks:
    """Whether something holds of every interval or step, the first axis."""
    return np.asarray(marks.all(axis=0))


def _any(marks: np.ndarray) -> Marks:
    """Whether something holds of any interval or step, the first axis."""
    return np.asarray(marks.any(axis=0))


def _ends(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Values at the beginning and at the end of each interval."""
    return values[:-1], values[1:]


def _link(phase: np.ndarray, number: int) -> _Samples:
    """A link's angle: of the stance leg (0), the swing thigh or the swing shank."""
    links = phase.shape[1] // 2
    return _Samples(phase[:, number], phase[:, links + number])


def _height(phase: np.ndarray) -> _Samples:
    """The guard of heelstrike: the sum of the legs' angles, the shank as the thigh."""
    stance = _link(phase, 0)
    swing = _link(phase, 1)
    return _Samples(stance.value + swing.value, stance.rate + swing.rate)


def _apart(phase: np.ndarray) -> _Samples:
    """The angle between the legs."""
    return _difference(_link(phase, 0), _link(phase, 1))


def _flexion(three: np.ndarray) -> _Samples:
    """The guard of kneestrike."""
    return _difference(_link(three, 1), _link(three, 2))


def _difference(one: _Samples, other: _Samples) -> _Samples:
    return _Samples(one.value - other.value, one.rate - other.rate)


def _chord_error_bound(g: np.ndarray) -> np.ndarray:
    """Largest distance of a guard from its chord between samples, shape (intervals, n).

    |g - chord| <= h^2/8 max|g''|, with g'' from second differences of the neighbouring samples, doubled.
    """
    second = np.abs(np.diff(g, 2, axis=0))
    padded = np.vstack([second[:1], second, second[-1:]])
    largest = np.maximum(padded[:-1], padded[1:])
    return 2.0 / 8.0 * largest


def _cubic_error_bound(rate: np.ndarray) -> np.ndarray:
    """Largest distance of a guard from its cubic between samples, by its rates per
    interval, shape (intervals, n).

    |g - cubic| <= h^4/384 max|g|, with g from third differences of the rates around, doubled. Infinite where
    there are too few samples for these.
    """
    if len(rate) < 4:
        return np.full(rate[1:].shape, np.inf)
    third = np.abs(np.diff(rate, 3, axis=0))
    first = third[:1]
    last = third[-1:]
    padded = np.vstack([first, first, third, last, last])
    largest = np.maximum.reduce([padded[:-2], padded[1:-1], padded[2:]])
    return 2.0 / 384.0 * largest


def _unclear(g: np.ndarray, rate: np.ndarray, margin: float | np.ndarray) -> np.ndarray:
    """Intervals in which a guard could touch zero undetected, shape (intervals, n).

    It could where it comes nearer zero than the samples resolve, unless the samples'
    signs show every crossing. They do where its rate keeps its sign; and where its rate
    falls all the time, or grows, if both ends of the rate have one sign, or if a sample
    lies on the side to which the guard bends: so they do at strikes that are nearly
    tangential.
    """
    a, b = _ends(g)
    nearest = np.minimum(np.abs(a), np.abs(b))
    is_near = nearest < _chord_error_bound(g) + margin

    change = np.diff(rate, axis=0)
    error = _chord_error_bound(rate)
    bends = np.abs(change) > 4 * error + 2 * margin

    da, db = _ends(rate)
    is_one_sign = np.signbit(da) == np.signbit(db)
    least_rate = np.minimum(np.abs(da), np.abs(db))
    unresolved = np.where(bends, 0.0, error)
    is_steady = is_one_sign & (least_rate > unresolved + margin)

    is_above = np.maximum(a, b) >= margin
    is_below = np.minimum(a, b) <= -margin
    shows = np.where(change < 0, is_above, is_below)
    arches = bends & shows
    return is_near & ~is_steady & ~arches


def _to_strike(g: np.ndarray) -> np.ndarray:
    """A guard up to the strike solved for, where it is 0: the last sample differs from
    that by rounding.
    """
    return np.vstack([g[:-1], np.zeros_like(g[:1])])


# Where the integration failed the guards have no values.
@np.errstate(invalid="ignore", over="ignore", divide="ignore")
def strike_distance(motion: Motion, times: Times) -> PerLane:
    """Distance of a step from an earlier strike: negative where a foot or a knee
    strikes earlier.

    Parameters
    ----------
    motion : list of ndarray, shape (samples + 1, angles, n)
        Each phase's angles and rates at equal times; three links before two.
    times : ndarray, shape (k, n) [sqrt(leg/g)]
        Event times.

    Returns
    -------
    ndarray, shape (n,)
        In the units of the angles; infinite where no guard has an extremum. It is
        continuous as long as the same extrema exist.

    Notes
    -----
    A guard strikes earlier where it falls through zero: where a minimum lies below zero and a maximum before it above.
    So the distance at a minimum is the larger of its value and minus the highest value
    before. Of the foot that is the highest since the stance leg was upright.
    """
    intervals = _intervals(motion, times)
    guards = list(map(_foot, motion, intervals))
    least = _least_distance(guards)
    if len(motion) == 2:
        knee = _knee(motion[0], intervals[0])
        least = np.fmin(least, _least_distance([knee]))

    return least


def _intervals(motion: Motion, times: Times) -> list[PerLane]:
    """Times between the samples of each phase."""
    durations = np.diff(times, axis=0, prepend=0)
    return [
        duration / (len(phase) - 1)
        for phase, duration in zip(motion, durations, strict=True)
    ]


class _Guard(NamedTuple):
    """A guard in one phase: its values and rates per interval at the samples.

    `counts` says at which samples the values count; `always`, that the extrema count
    everywhere. `begin` are the values where, inside an interval, they begin to count,
    elsewhere minus infinity.
    """

    g: np.ndarray
    rate: np.ndarray
    counts: np.ndarray
    begin: np.ndarray
    always: bool = False


def _foot(phase: np.ndarray, interval: PerLane) -> _Guard:
    """The guard of heelstrike in a phase, which counts where the stance leg is behind."""
    height = _height(phase).per_interval(interval)
    stance = _link(phase, 0).per_interval(interval)
    behind = stance.value < 0
    before, after = _ends(behind)
    passes = ~before & after

    upright = _zero(_cubics(stance, passes))
    begin = np.full(passes.shape, -np.inf)
    begin[passes] = _value(_cubics(height, passes), upright)
    return _Guard(height.value, height.rate, behind, begin)


def _knee(three: np.ndarray, interval: PerLane) -> _Guard:
    """The guard of kneestrike."""
    flexion = _flexion(three).per_interval(interval)
    # The knee starts straight, and may first move against its stop: only maxima show
    # that it has flexed.
    never = np.zeros(flexion.value.shape, bool)
    begin = np.full(never[1:].shape, -np.inf)
    return _Guard(flexion.value, flexion.rate, never, begin, always=True)


def _least_distance(phases: list[_Guard]) -> PerLane:
    """Least distance of a guard from an earlier strike, over phases."""
    n = phases[0].g.shape[1]
    least = np.full(n, np.inf)
    highest = np.full(n, -np.inf)
    rate_before = None
    for guard in phases:
        g, rate, counts, *_ = guard
        if rate_before is not None:
            # Rates jump at kneestrike: a guard may have a minimum there.
            turns = (rate_before < 0) & (rate[0] >= 0)
            turns &= counts[0]
            distance = np.maximum(g[0], -highest)
            at_turn = np.where(turns, distance, np.inf)
            least = np.fmin(least, at_turn)

        distance, highest = _distances(guard, highest)
        least = np.fmin(least, np.fmin.reduce(distance, axis=0))
        rate_before = rate[-1]

    return least


def _distances(guard: _Guard, highest: PerLane) -> tuple[np.ndarray, PerLane]:
    """Distances from earlier strikes at the minima in all intervals, (intervals, n),
    and the highest value that counts up to the end, from that up to the start.
    """
    g, rate, counts, begin, always = guard
    low, high = _extrema(g, rate)
    at_start, at_end = _ends(counts)
    low_counts = at_end | always
    # A maximum in the interval in which values begin to count may come before they do.
    all_counts = at_end & (begin == -np.inf)
    high_counts = all_counts | always

    # What counts of each interval before its minimum, and after it.
    before = np.where(at_start, g[:-1], -np.inf)
    maximum = np.where(high_counts, high, -np.inf)
    after = np.fmax(maximum, begin)
    before[0] = np.fmax(before[0], highest)
    before[1:] = np.fmax(before[1:], after[:-1])
    so_far = np.fmax.accumulate(before, axis=0)

    at_minimum = np.maximum(low, -so_far)
    distance = np.where(low_counts, at_minimum, np.inf)
    return distance, np.fmax(so_far[-1], after[-1])


def _extrema(g: np.ndarray, rate: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Minimum and maximum within each interval, (intervals, n), of the cubic through
    values and rates at its ends.

    Infinite, and minus infinite, where it has none.
    """
    cubic = _cubics(_Samples(g, rate))
    da, db = _ends(rate)
    _, _, second, third = cubic
    discriminant = second**2 - 3 * third * da
    root = np.sqrt(np.maximum(discriminant, 0.0))

    at_minimum = _value(cubic, -da / (second + root))
    at_maximum = _value(cubic, -da / (second - root))
    has_minimum = (da < 0) & (db >= 0)
    has_maximum = (da > 0) & (db <= 0)
    minimum = np.where(has_minimum, at_minimum, np.inf)
    maximum = np.where(has_maximum, at_maximum, -np.inf)
    return minimum, maximum


_Cubics = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def _cubics(samples: _Samples, some: np.ndarray | EllipsisType = ...) -> _Cubics:
    """Coefficients of the cubics in some intervals through values and rates per
    interval at both ends.
    """
    left, right = _ends(samples.value)
    rate_left, rate_right = _ends(samples.rate)
    a = left[some]
    da = rate_left[some]
    db = rate_right[some]
    rise = right[some] - a
    second = 3 * rise - 2 * da - db
    third = da + db - 2 * rise
    return a, da, second, third


def _value(cubic: _Cubics, share: np.ndarray) -> np.ndarray:
    """Values of cubics at shares of their intervals."""
    a, first, second, third = cubic
    value = second + share * third
    value = first + share * value
    return np.asarray(a + share * value)


def _zero(cubic: _Cubics) -> np.ndarray:
    """Shares of their intervals at which cubics vanish whose values at both ends have
    different signs.
    """
    a, first, second, third = cubic
    on_chord = a / -(first + second + third)
    share = np.clip(on_chord, 0.0, 1.0)
    for _ in range(_ROUNDS):
        rate = first + share * (2 * second + 3 * share * third)
        newton = share - _value(cubic, share) / rate
        better = np.clip(newton, 0.0, 1.0)
        share = np.where(np.isfinite(better), better, share)

    return share


# Where a guard does not change between samples there is no crossing to ask for.
@np.errstate(invalid="ignore", divide="ignore")
def _falls_behind(
    falls: np.ndarray, guard: _Samples, stance: _Samples
) -> tuple[Marks, Marks]:
    """Whether a guard that falls in some intervals, (intervals, n), does so with a
    negative stance angle.

    Both are given with their rates per interval. Also returned is whether in one of
    them that angle is so near zero as the guard falls that finer samples tell better.
    """
    angle_before, angle_after = _ends(stance.value)
    is_ahead = angle_before >= 0
    passes = falls & (is_ahead != (angle_after >= 0))
    strike = _zero(_cubics(guard, passes))
    angle = _value(_cubics(stance, passes), strike)
    behind = falls & (angle_after < 0)
    behind[passes] = angle < 0

    # Both cubics err, that of the guard by a time.
    fall = np.abs(np.diff(guard.value, axis=0))[passes]
    turn = np.abs(np.diff(stance.value, axis=0))[passes]
    late_by = _cubic_error_bound(guard.rate)[passes] / fall
    error = _cubic_error_bound(stance.rate)[passes] + late_by * turn
    late = passes & is_ahead
    late[passes] &= ~(np.abs(angle) > error)
    return _any(behind), _any(late)


# Where a strike is tangential to the last digit its rate has no value.
@np.errstate(invalid="ignore")
def strikes_fall_in_order(
    closing: np.ndarray, times: Times, touch: float | PerLane = _TOUCH
) -> Marks:
    """Whether solved strikes follow each other, and the guard of each falls.

    Parameters
    ----------
    closing : ndarray, shape (k, n)
        Rates of the guards at the solved times.
    times : ndarray, shape (k, n) [sqrt(leg/g)]
    touch : float or ndarray, shape (n,)
        Value of a guard that may be rounding.

    Returns
    -------
    ndarray of bool, shape (n,)

    Notes
    -----
    Where the foot strikes just after the knee, its height at kneestrike, not the difference of the times, is known to
    rounding: a foot that strikes almost tangentially is late by rounding alone.
    """
    durations = np.diff(times, axis=0, prepend=0)
    height = durations * -closing
    falls = (closing < 0) & (height > -touch)
    is_after_start = times[0] > 0
    return _all(falls) & is_after_start


#: Weights of the second derivative of a polynomial, half of it, at a point where it and
#: its rate vanish, by its values and rates at the next two.
_VALUES = (4.0, 1.75)
_RATES = (-4.0, -0.5)


def hyperextends_at_release(three: np.ndarray, interval: PerLane) -> Marks:
    """Whether a knee, released with the step, first moves against its stop.

    Parameters
    ----------
    three : ndarray, shape (samples + 1, 6, n)
        Angles and rates up to kneestrike.
    interval : ndarray, shape (n,) [sqrt(leg/g)]
        Time between the samples.

    Returns
    -------
    ndarray of bool, shape (n,)

    Notes
    -----
    A knee that was locked during heelstrike begins without a rate: its acceleration
    decides, taken from the polynomial through the first samples.
    """
    flexion, rate = _flexion(three).per_interval(interval)
    first = rate[0]
    at_rest = first == 0
    if at_rest.any():
        one, other = (
            of_value * flexion[k] + of_rate * rate[k]
            for k, of_value, of_rate in zip((1, 2), _VALUES, _RATES, strict=True)
        )
        acceleration = one + other
        first = np.where(at_rest, acceleration, first)

    return np.asarray(first < 0)


# A strike that is tangential to the last digit has no rate.
@np.errstate(divide="ignore", invalid="ignore")
def verify(
    motion: Motion,
    closing: np.ndarray,
    times: Times,
    margin: float | PerLane = 0.0,
) -> StepCheck:
    """Verify that solved steps happen, by samples of their motion.

    Parameters
    ----------
    motion : list of ndarray, shape (samples + 1, angles, n)
        Each phase's angles and rates at equal times; three links before two. NaN where
        they are not known, which leaves a doubt.
    closing : ndarray, shape (k, n)
        Rates of the guards at the solved times.
    times : ndarray, shape (k, n) [sqrt(leg/g)]
        The solved event times, which must follow each other.
    margin : float or ndarray, shape (n,)
        How far the guards may also lie from the samples: leaves a doubt where their
        signs could change.

    Returns
    -------
    StepCheck

    Notes
    -----
    A step ends when stance + swing angle, once positive, falls to zero with the stance angle negative. So this guard,
    once positive, must stay so wherever the stance angle is negative.
    """
    intervals = _intervals(motion, times)
    touch, height = _rounding_at_strikes(motion, closing)
    step, doubt = _verify_locked(motion[-1], intervals[-1], touch, margin)
    step &= strikes_fall_in_order(closing, times, height)

    leg_passes = np.zeros(len(step), int)
    for phase in motion:
        apart, rate = _apart(phase)
        before, after = _ends(np.signbit(apart))
        passes = before != after
        leg_passes += passes.sum(axis=0)
        unclear = _unclear(apart, rate, margin)
        doubt |= _any(unclear)

    hyperextends = np.zeros(len(step), bool)
    if len(motion) == 2:
        free, interval = motion[0], intervals[0]
        strikes_last, in_doubt = _verify_free(free, interval, height, margin)
        step &= strikes_last
        step &= times[0] > _MIN_KNEESTRIKE
        doubt |= in_doubt
        hyperextends = hyperextends_at_release(free, interval)

    doubt &= np.isfinite(closing).all(axis=0)
    return StepCheck(step, leg_passes, doubt, hyperextends)


def _rounding_at_strikes(
    motion: Motion, closing: np.ndarray
) -> tuple[PerLane, PerLane]:
    """How far guards may be from zero by rounding at the strikes, and the foot from the
    ground.

    At the strike itself a guard is as far from zero as rounding, which a long step
    amplifies, has moved it.
    """
    foot = _height(motion[-1]).value[-1]
    height = np.maximum(_TOUCH, 8 * np.abs(foot))
    if len(motion) == 1:
        return height, height

    flexion = _flexion(motion[0]).value[-1]
    knee = 8 * np.abs(flexion)
    touch = np.maximum(height, knee)
    # Until a knee that is late has struck, the foot falls on.
    falls_on = knee * np.abs(closing[1] / closing[0])
    return touch, np.fmax(touch, falls_on)


def _verify_locked(
    two: np.ndarray, interval: PerLane, touch: PerLane, margin: float | PerLane
) -> tuple[Marks, Marks]:
    """Whether the foot of the locked leg strikes at the end only, and whether that is
    in doubt.
    """
    guard, rate = _height(two)
    before, after = _ends(guard)
    falls = (before >= -touch) & (after < -touch)
    struck, late = _foot_strikes(two, interval, falls)
    unclear = _unclear(_to_strike(guard), rate, margin)
    is_unknown = np.isnan(two[0, 0])
    doubt = _behind(two, unclear, margin) | late | is_unknown
    ends_behind = two[-1, 0] < 0
    return ~struck & ends_behind, doubt


def _verify_free(
    three: np.ndarray, interval: PerLane, height: PerLane, margin: float | PerLane
) -> tuple[Marks, Marks]:
    """Whether the knee strikes at the end only, and no foot before it, and whether that
    is in doubt.
    """
    guard, rate = _height(three)
    is_down = guard[1:] <= 0
    # Where both strike together the foot's height at kneestrike is rounding.
    is_down[-1] = guard[-1] < -height
    falls = is_down & (guard[:-1] > 0)
    struck, late = _foot_strikes(three, interval, falls)
    unclear = _unclear(guard, rate, margin)
    doubt = _behind(three, unclear, margin) | late

    # The knee starts straight: the guard's first zero is no strike.
    flexion, rate = _flexion(three)
    unclear = _unclear(_to_strike(flexion), rate, margin)
    doubt |= _any(unclear[1:])
    doubt |= unclear[0] & (rate[0] > 0)
    return ~struck & _flexes_once(flexion, rate), doubt


def _foot_strikes(
    phase: np.ndarray, interval: PerLane, falls: np.ndarray
) -> tuple[Marks, Marks]:
    """Whether the foot's guard, which falls in some intervals, does so at a strike, and
    whether finer samples tell better.
    """
    guard = _height(phase).per_interval(interval)
    stance = _link(phase, 0).per_interval(interval)
    return _falls_behind(falls, guard, stance)


def _behind(phase: np.ndarray, intervals: np.ndarray, margin: float | PerLane) -> Marks:
    """Whether the stance angle may be negative in one of some intervals: a foot strikes
    only then.
    """
    before, after = _ends(phase[:, 0])
    lowest = np.minimum(before, after) - margin
    may_be = lowest < 0
    return _any(may_be & intervals)


def _flexes_once(flexion: np.ndarray, rate: np.ndarray) -> Marks:
    """Whether a knee, once bent, is bent up to its strike.

    A strike that falls comes from above, if only since the last sample: almost
    tangential ones do. Of a knee that is released at rest the guard has a double root at
    time 0, near which Newton's method may end: it has bent where its samples show it.
    """
    inner = flexion[1:-1]
    bends = np.vstack([rate[:1] > 0, inner > 0])
    bent = np.maximum.accumulate(bends, axis=0)
    strikes_before = bent[:-1] & (inner < -_STRAIGHT)
    is_released_moving = rate[0] != 0
    shows_bent = _any(inner > _STRAIGHT)
    return ~_any(strikes_before) & (is_released_moving | shows_bent)
