"""Whether a solved step happens: the signs of the guards along its motion."""

from __future__ import annotations

from dataclasses import dataclass
from types import EllipsisType

import numpy as np

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

    step: np.ndarray
    leg_passes: np.ndarray
    doubt: np.ndarray
    hyperextends: np.ndarray

    def of_all(self, steps: int) -> StepCheck:
        """What the checks of single steps, those of several gaits' first steps before
        the second ones, say of gaits.
        """
        each = {name: values.reshape(steps, -1) for name, values in vars(self).items()}
        return StepCheck(
            each["step"].all(axis=0),
            # Of legs that pass once at every step but one, the number at that.
            np.where(
                (each["leg_passes"] == 1).all(axis=0), 1, each["leg_passes"].max(axis=0)
            ),
            each["doubt"].any(axis=0),
            each["hyperextends"].any(axis=0),
        )

    @property
    def anthropomorphic(self) -> np.ndarray:
        """Lanes whose legs pass exactly once."""
        return self.step & (self.leg_passes == 1)


def _chord_error_bound(g: np.ndarray) -> np.ndarray:
    """Largest distance of a guard from its chord between samples, shape (intervals, n).

    |g - chord| <= h^2/8 max|g''|, with g'' from second differences of the neighbouring samples, doubled.
    """
    second = np.abs(np.diff(g, 2, axis=0))
    padded = np.vstack([second[:1], second, second[-1:]])
    return 2.0 / 8.0 * np.maximum(padded[:-1], padded[1:])


def _cubic_error_bound(rate: np.ndarray) -> np.ndarray:
    """Largest distance of a guard from its cubic between samples, by its rates per
    interval, shape (intervals, n).

    |g - cubic| <= h^4/384 max|g|, with g from third differences of the rates around, doubled. Infinite where
    there are too few samples for these.
    """
    if len(rate) < 4:
        return np.full(rate[1:].shape, np.inf)
    third = np.abs(np.diff(rate, 3, axis=0))
    padded = np.vstack([third[:1], third[:1], third, third[-1:], third[-1:]])
    return 2.0 / 384.0 * np.maximum.reduce([padded[:-2], padded[1:-1], padded[2:]])


def _unclear(g: np.ndarray, rate: np.ndarray, margin: float | np.ndarray) -> np.ndarray:
    """Intervals in which a guard could touch zero undetected, shape (intervals, n).

    It could where it comes nearer zero than the samples resolve, unless the samples'
    signs show every crossing. They do where its rate keeps its sign; and where its rate
    falls all the time, or grows, if both ends of the rate have one sign, or if a sample
    lies on the side to which the guard bends: so they do at strikes that are nearly
    tangential.
    """
    low = np.minimum(np.abs(g[:-1]), np.abs(g[1:]))
    least_rate, change = (
        np.minimum(np.abs(rate[:-1]), np.abs(rate[1:])),
        np.diff(rate, axis=0),
    )
    bends = np.abs(change) > 4 * _chord_error_bound(rate) + 2 * margin
    is_one_sign = np.signbit(rate[:-1]) == np.signbit(rate[1:])
    steady = is_one_sign & (
        least_rate > np.where(bends, 0.0, _chord_error_bound(rate)) + margin
    )
    above, below = (
        np.maximum(g[:-1], g[1:]) >= margin,
        np.minimum(g[:-1], g[1:]) <= -margin,
    )
    arches = bends & np.where(change < 0, above, below)
    return (low < _chord_error_bound(g) + margin) & ~steady & ~arches


def _to_strike(g: np.ndarray) -> np.ndarray:
    """A guard up to the strike solved for, where it is 0: the last sample differs from
    that by rounding.
    """
    return np.vstack([g[:-1], np.zeros_like(g[:1])])


# Where the integration failed the guards have no values.
@np.errstate(invalid="ignore", over="ignore", divide="ignore")
def strike_distance(motion: list[np.ndarray], times: np.ndarray) -> np.ndarray:
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
    sums, behind, upright = [], [], []
    for phase, interval in zip(motion, intervals, strict=True):
        half = phase.shape[1] // 2
        sums.append(
            (
                phase[:, 0] + phase[:, 1],
                interval * (phase[:, half] + phase[:, half + 1]),
            )
        )
        behind.append(phase[:, 0] < 0)
        stance = phase[:, 0], interval * phase[:, half]
        passes, at = (
            ~behind[-1][:-1] & behind[-1][1:],
            np.full(behind[-1][1:].shape, -np.inf),
        )
        at[passes] = _value(_cubics(*sums[-1], passes), _zero(_cubics(*stance, passes)))
        upright.append(at)
    least = _least_distance(sums, behind, upright)
    if len(motion) == 2:
        three = motion[0]
        rate = intervals[0] * (three[:, 4] - three[:, 5])
        # The knee starts straight, and may first move against its stop: only maxima
        # show that it has flexed.
        never, nowhere = np.zeros(rate.shape, bool), np.full(rate[1:].shape, -np.inf)
        knee = _least_distance(
            [(three[:, 1] - three[:, 2], rate)], [never], [nowhere], always=True
        )
        least = np.fmin(least, knee)
    return least


def _intervals(motion: list[np.ndarray], times: np.ndarray) -> list[np.ndarray]:
    """Times between the samples of each phase, shape (n,)."""
    durations = np.diff(times, axis=0, prepend=0)
    return [
        duration / (len(phase) - 1)
        for phase, duration in zip(motion, durations, strict=True)
    ]


def _least_distance(
    phases: list[tuple[np.ndarray, np.ndarray]],
    counts: list[np.ndarray],
    begins: list[np.ndarray],
    always: bool = False,
) -> np.ndarray:
    """Least distance (n,) of a guard from an earlier strike, by its values and rates
    per interval of each phase.

    `counts` says at which samples the guard's values count; with `always` its extrema
    count everywhere. `begins` are its values where, inside an interval, they begin to
    count, elsewhere minus infinity.
    """
    least = np.full(phases[0][0].shape[1], np.inf)
    highest, rate_before = np.full(len(least), -np.inf), None
    for (g, rate), counted, begin in zip(phases, counts, begins, strict=True):
        low, high = _extrema(g, rate)
        if rate_before is not None:
            # Rates jump at kneestrike: a guard may have a minimum there.
            turns = (rate_before < 0) & (rate[0] >= 0) & counted[0]
            least = np.fmin(least, np.where(turns, np.maximum(g[0], -highest), np.inf))
        # A maximum in the interval in which values begin to count may come before they
        # do.
        high_counts = counted[1:] & (begin == -np.inf) | always
        # What counts of each interval before its minimum, and after it.
        before = np.where(counted[:-1], g[:-1], -np.inf)
        after = np.fmax(np.where(high_counts, high, -np.inf), begin)
        before[0] = np.fmax(before[0], highest)
        before[1:] = np.fmax(before[1:], after[:-1])
        so_far = np.fmax.accumulate(before, axis=0)
        distance = np.where(counted[1:] | always, np.maximum(low, -so_far), np.inf)
        least = np.fmin(least, np.fmin.reduce(distance, axis=0))
        highest, rate_before = np.fmax(so_far[-1], after[-1]), rate[-1]
    return least


def _extrema(g: np.ndarray, rate: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Minimum and maximum within each interval, (intervals, n), of the cubic through
    values and rates at its ends.

    Infinite, and minus infinite, where it has none.
    """
    cubic, (da, db) = _cubics(g, rate), (rate[:-1], rate[1:])
    _, _, second, third = cubic
    root = np.sqrt(np.maximum(second**2 - 3 * third * da, 0.0))

    def extremum(sign: float, turns: np.ndarray) -> np.ndarray:
        return np.where(
            turns, _value(cubic, -da / (second + sign * root)), sign * np.inf
        )

    return extremum(1.0, (da < 0) & (db >= 0)), extremum(-1.0, (da > 0) & (db <= 0))


_Cubics = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def _cubics(
    g: np.ndarray, rate: np.ndarray, some: np.ndarray | EllipsisType = ...
) -> _Cubics:
    """Coefficients of the cubics in some intervals through values and rates per
    interval at both ends.
    """
    a, b, da, db = g[:-1][some], g[1:][some], rate[:-1][some], rate[1:][some]
    return a, da, 3 * (b - a) - 2 * da - db, da + db - 2 * (b - a)


def _value(cubic: _Cubics, share: np.ndarray) -> np.ndarray:
    """Values of cubics at shares of their intervals."""
    a, first, second, third = cubic
    return np.asarray(a + share * (first + share * (second + share * third)))


def _zero(cubic: _Cubics) -> np.ndarray:
    """Shares of their intervals at which cubics vanish whose values at both ends have
    different signs.
    """
    a, first, second, third = cubic
    share = np.clip(a / -(first + second + third), 0.0, 1.0)
    for _ in range(_ROUNDS):
        rate = first + share * (2 * second + 3 * share * third)
        better = np.clip(share - _value(cubic, share) / rate, 0.0, 1.0)
        share = np.where(np.isfinite(better), better, share)
    return share


# Where a guard does not change between samples there is no crossing to ask for.
@np.errstate(invalid="ignore", divide="ignore")
def _behind(
    falls: np.ndarray,
    guard: tuple[np.ndarray, np.ndarray],
    stance: tuple[np.ndarray, np.ndarray],
) -> tuple[np.ndarray, np.ndarray]:
    """Whether a guard that falls in some intervals does so with a negative stance
    angle, shape (intervals, n).

    Both are given with their rates per interval. Also returned is whether in one of
    them that angle is so near zero as the guard falls that finer samples tell better,
    shape (n,).
    """
    ahead = stance[0] >= 0
    passes, behind = falls & (ahead[:-1] != ahead[1:]), falls & (stance[0][1:] < 0)
    at_zero = _value(_cubics(*stance, passes), _zero(_cubics(*guard, passes)))
    behind[passes] = at_zero < 0
    # Both cubics err, that of the guard by a time.
    share = (
        _cubic_error_bound(guard[1])[passes]
        / np.abs(guard[0][1:] - guard[0][:-1])[passes]
    )
    angle = np.abs(stance[0][1:] - stance[0][:-1])[passes]
    late = passes & ahead[:-1]
    late[passes] &= ~(
        np.abs(at_zero) > _cubic_error_bound(stance[1])[passes] + share * angle
    )
    return behind, np.asarray(late.any(axis=0))


# Where a strike is tangential to the last digit its rate has no value.
@np.errstate(invalid="ignore")
def strikes_fall_in_order(
    closing: np.ndarray, times: np.ndarray, touch: float | np.ndarray = _TOUCH
) -> np.ndarray:
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
    height = np.diff(times, axis=0, prepend=0) * -closing
    return np.asarray(((closing < 0) & (height > -touch)).all(axis=0) & (times[0] > 0))


# A strike that is tangential to the last digit has no rate.
@np.errstate(divide="ignore", invalid="ignore")
def verify(
    motion: list[np.ndarray],
    closing: np.ndarray,
    times: np.ndarray,
    margin: float | np.ndarray = 0.0,
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
    two = motion[-1]
    a, b = two[:, 0], two[:, 1]
    n = a.shape[1]
    da, db = two[:, len(two[0]) // 2], two[:, len(two[0]) // 2 + 1]
    guard = a + b
    # Between samples i and i + 1: a strike needs the guard at or below zero with the
    # stance angle negative.
    behind = np.minimum(a[:-1], a[1:]) - margin < 0
    # At the strike itself a guard is as far from zero as rounding, which a long step
    # amplifies, has moved it.
    touch = height = np.maximum(_TOUCH, 8 * np.abs(guard[-1]))
    if len(motion) == 2:
        knee = 8 * np.abs(motion[0][-1, 1] - motion[0][-1, 2])
        touch = np.maximum(touch, knee)
        # Until a knee that is late has struck, the foot falls on.
        height = np.fmax(touch, knee * np.abs(closing[1] / closing[0]))
    falls = (guard[1:] < -touch) & (guard[:-1] >= -touch)
    intervals = _intervals(motion, times)
    falls, late = _behind(
        falls, (guard, intervals[-1] * (da + db)), (a, intervals[-1] * da)
    )
    # A guard that falls to zero was positive just before.
    step = (
        strikes_fall_in_order(closing, times, height) & ~falls.any(axis=0) & (a[-1] < 0)
    )
    doubt = (
        (behind & _unclear(_to_strike(guard), da + db, margin)).any(axis=0)
        | late
        | np.isnan(a[0])
    )
    leg_passes, hyperextends = np.zeros(n, int), np.zeros(n, bool)
    for phase in motion:
        half = phase.shape[1] // 2
        apart, rate = phase[:, 0] - phase[:, 1], phase[:, half] - phase[:, half + 1]
        leg_passes += (np.signbit(apart[1:]) != np.signbit(apart[:-1])).sum(axis=0)
        doubt |= _unclear(apart, rate, margin).any(axis=0)
    if len(motion) == 2:
        three = motion[0]
        flexion, rate = three[:, 1] - three[:, 2], three[:, 4] - three[:, 5]
        hyperextends = rate[0] < 0
        inner = flexion[1:-1]
        bent = np.maximum.accumulate(np.vstack([rate[:1] > 0, inner > 0]), axis=0)
        straight_again = (bent[:-1] & (inner < -_STRAIGHT)).any(axis=0)
        # A strike that falls comes from above, if only since the last sample: almost
        # tangential ones do.
        step = step & ~straight_again & (times[0] > _MIN_KNEESTRIKE)
        # The foot could strike before the knee; where both strike together its height
        # at kneestrike is rounding.
        sum_, closing_in = three[:, 0] + three[:, 1], three[:, 3] + three[:, 4]
        down = sum_[1:] <= 0
        down[-1] = sum_[-1] < -height
        stance = three[:, 0], intervals[0] * three[:, 3]
        falls, late = _behind(
            down & (sum_[:-1] > 0), (sum_, intervals[0] * closing_in), stance
        )
        step &= ~falls.any(axis=0)
        doubt |= late
        behind = np.minimum(three[:-1, 0], three[1:, 0]) - margin < 0
        doubt |= (behind & _unclear(sum_, closing_in, margin)).any(axis=0)
        # The knee starts straight: the guard's first zero is no strike.
        unclear = _unclear(_to_strike(flexion), rate, margin)
        doubt |= unclear[1:].any(axis=0) | ((rate[0] > 0) & unclear[0])
    return StepCheck(
        step, leg_passes, doubt & np.isfinite(closing).all(axis=0), hyperextends
    )
