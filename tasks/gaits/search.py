"""Fixed points without a known gait to begin with: from a lattice of initial guesses
over the section, and from the gaits of small angles.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from gaitsweep.tasks.gaits.newton import newton
from gaitsweep.tasks.gaits.step_check import verify_steps
from gaitsweep.tasks.mechanics.small_angles import SmallAngles
from gaitsweep.tasks.mechanics.small_gaits import small_gaits
from gaitsweep.tasks.step.problem import Lanes, Problem
from gaitsweep.tasks.step.several_steps import AnyStride
from gaitsweep.tasks.step.verify_step import StepCheck
from gaitsweep.tasks.walkers.walker import Walker

#: Coarse Newton steps of a guess: what is not near a gait by then hardly ever
#: converges.
_MAX_ITERATIONS = 15
#: Guesses whose first, second, ... Newton step is larger are given up: hardly one
#: converges, and others reach its gait. By the number of phases of a step.
_MAX_STEP_BY_ITERATION = {1: (20.0, 20.0, 10.0, 6.0), 2: (20.0, 6.0, 4.0, 3.0)}
#: Guesses in one cell of this size after three steps converge to one gait: the nearest
#: to it continues.
_MERGE_CELL = 0.1
#: Stance angles of the lattice, and its periods over the time in which the leg swings
#: by itself: with straight legs, and with knees. Gaits of random walkers have periods
#: of 0.5 to 1.8 swings.
_ANGLES, _ANGLES_KNEED = 9, 7
_PERIODS, _PERIODS_KNEED = (
    (0.5, 0.65, 0.8, 0.95, 1.1, 1.27, 1.6),
    (0.58, 0.7, 0.8, 0.9, 1.02, 1.18, 1.42),
)
#: Periods farther apart have another between them [sqrt(leg/g)]: a slow leg's steps
#: nearly end upright.
_LARGEST_GAP = 1.25
#: Rates of kneed legs just before heelstrike, the swing leg's over the stance leg's: of
#: long and of short gaits.
_RATIOS = (0.8, 0.0)
#: Periods of the lattice replaced by those in which point feet exchange places.
_EXCHANGED = (2, 3)
#: Largest rate over angle of a guess.
_MAX_RATE = 20.0
#: Largest rate [sqrt(g/leg)] to which linear theory is of use, and the swing leg's over
#: the angle of a guess beyond.
_LINEAR_UP_TO, _PLAIN_SWING = 1.0, -0.5


#: Slope so gentle that gaits of small angles are nearly exact, even of legs that swing
#: faster than this [sqrt(leg/g)]: of several slopes, this has their guesses alone.
VANISHING, _FAST = 1e-6, 1.0
#: Length from the hip to the centre of the foot's arc, over the leg, below which steps
#: are longer.
_ROUND = 0.5
#: What drives guesses at least, as a slope [rad].
_LEAST_DRIVING = 1e-24
#: Largest angle of guesses that a push-off drives, over the root of its impulse.
_BY_PUSH = 2.0
#: Angles of guesses that lose no energy to first order, over the largest.
_OF_LARGEST = (0.12, 0.25, 0.5, 1.0)


def starts(
    walker: Walker, slopes: Sequence[float], shares: int = 1
) -> list[np.ndarray]:
    """Return the initial guesses at some slopes, from a lattice over step length and
    period and, for straight legs, from the gaits of small angles.

    Parameters
    ----------
    walker : Walker
    slopes : sequence of float [rad]
    shares : int
        Slopes that follow each other share the lattice, so many at a time.

    Returns
    -------
    list of ndarray, shape (m + phases, n)
        For each slope, in similarity coordinates.

    Notes
    -----
    Stance angles run from the linear (slope) to the cube-root scaling, periods are
    those of `periods`. The rates are those with which, to first order in the angles,
    the legs exchange places in the period. Where these are too large for linear theory,
    as on steep slopes, only the stance leg reaches the other's place. With knees it
    does so always, but for the rate of an inverted pendulum on steep slopes. With point
    feet heelstrike fixes the ratio of the rates, so that both legs exchange places in
    certain periods only: the two shortest take the place of two of the lattice.

    Knees whose return small angles do not tell have a second guess each, with another
    time of kneestrike (`SmallAngles.kneed_exchange`).
    """
    linear = SmallAngles(walker)
    lattices = _lattices(linear, slopes, shares)
    counts = [lattice.shape[1] for lattice in lattices]
    number = np.repeat(np.arange(len(slopes)), counts)
    log_angle, period, *ratio = np.hstack(lattices)
    at_slope = np.asarray(slopes)[number]

    if walker.knees:
        w, chosen = _kneed_guesses(linear, log_angle, period, ratio[0], at_slope)
        number = number[chosen]
        return [w[:, number == i] for i in range(len(slopes))]

    rows = _straight_guesses(linear, np.exp(log_angle), period, at_slope)
    w = np.vstack([log_angle, *rows])
    small = _small_guesses(linear, slopes)
    return [np.hstack([w[:, number == i], small[i]]) for i in range(len(slopes))]


def _lattices(
    linear: SmallAngles,
    slopes: Sequence[float],
    shares: int,
) -> list[np.ndarray]:
    """The slopes' shares of the lattice: ln angles, periods and, with knees, ratios of
    rates, shape (2 or 3, n).
    """
    periods = _periods(linear)
    angles = _ANGLES_KNEED if linear.has_knees else _ANGLES
    ratios = [_RATIOS] if linear.has_knees else []
    lattices = []
    for i, slope in enumerate(slopes):
        top = _largest_angle(slope, linear)
        bottom = max(0.7 * slope, 0.01 * top)
        log_angles = np.linspace(np.log(bottom), np.log(min(top, 1.2)), angles)

        grid = np.meshgrid(log_angles, periods, *ratios, indexing="ij")
        whole = np.array([axis.ravel() for axis in grid])
        if slope == VANISHING and len(slopes) > 1:
            whole = whole[:, :0]
        lattices.append(whole[:, i % shares :: shares])

    return lattices


def _largest_angle(slope: float, linear: SmallAngles) -> float:
    """Angle of steps that lose more energy than a gentle slope gives, and what else
    drives [rad].

    A torque between the thighs gives in a step what twice as large a slope does over its
    length; a push-off gives half its square. A foot whose arc is rounder than half the
    leg rolls more than it strikes: the angle's cube is the slope over the square of what
    is left of the length (section 4.1).
    """
    rolling = max(1.0, _ROUND / linear.length) ** (2 / 3)
    torque = max(linear.torque, 0.0)
    driving = max(slope + 2 * torque, torque, _LEAST_DRIVING)
    by_push = _BY_PUSH * float(linear.push) ** 0.5
    return float(2.0 * rolling * driving ** (1 / 3)) + by_push


def lattice_size(walker: Walker, slopes: Sequence[float], shares: int) -> int:
    """Number of guesses on the lattice, as for `starts`."""
    lattices = _lattices(SmallAngles(walker), slopes, shares)
    return sum(lattice.shape[1] for lattice in lattices)


@lru_cache(maxsize=64)
def periods(walker: Walker) -> np.ndarray:
    """Periods of the guesses, from that in which the walker's leg swings by itself,
    shape (k,) [sqrt(leg/g)].
    """
    return _periods(SmallAngles(walker))


def _periods(linear: SmallAngles) -> np.ndarray:
    in_swings = _PERIODS_KNEED if linear.has_knees else _PERIODS
    lattice = np.array(in_swings) * linear.swing
    is_wide = np.diff(lattice) > _LARGEST_GAP
    between = (lattice[:-1] + lattice[1:])[is_wide] / 2
    every = np.concatenate([lattice, between])
    return np.sort(every)


def _straight_guesses(
    linear: SmallAngles, angle: np.ndarray, period: np.ndarray, slope: np.ndarray
) -> list[np.ndarray]:
    """Rates over the angle and periods of guesses for straight legs."""
    if linear.point_foot:
        lattice = _periods(linear)
        exchanges = linear.exchange_periods(angle, slope)
        for place, exchange in zip(_EXCHANGED, exchanges, strict=True):
            is_replaced = (period == lattice[place]) & np.isfinite(exchange)
            period = np.where(is_replaced, exchange, period)

    rates = linear.exchange_rates(angle, period, slope)
    swing = np.full(len(period), _PLAIN_SWING)
    stance = linear.stance_rate(angle, period, swing * angle, slope) / angle
    stance = np.clip(stance, -_MAX_RATE, _MAX_RATE)
    plain = np.array([stance, swing])

    # A fast leg swings through small angles at high rates.
    quickness = max(1.0, np.pi / linear.swing)
    limits = _LINEAR_UP_TO * np.array([[1.0], [quickness]])
    is_linear = (np.abs(rates) <= limits).all(axis=0)
    largest = _MAX_RATE * quickness
    by_angle = np.clip(rates / angle, -largest, largest)
    rates = np.where(is_linear, by_angle, plain)
    if linear.point_foot:
        # Heelstrike itself sets the swing leg's rate where its mass is at the foot.
        rates = rates[:1]
    return [*rates, period]


def _small_guesses(linear: SmallAngles, slopes: Sequence[float]) -> list[np.ndarray]:
    """Guesses that are gaits of straight legs to first order, for each slope."""
    is_fast = linear.swing < _FAST
    chosen = list(slopes)
    if not is_fast and len(slopes) > 1:
        chosen = [slope for slope in slopes if slope != VANISHING]
    gaits = dict(zip(chosen, small_gaits(linear, chosen), strict=True))
    none = np.zeros((4, 0))

    fastest = _MAX_RATE * max(1.0, np.pi / linear.swing)
    found = []
    for slope in slopes:
        largest = _largest_angle(slope, linear)
        is_lossless = is_fast and slope == min(slopes)
        scaled = _scaled(gaits.get(slope, none), largest, is_lossless)
        angle, *rates, period = scaled
        used = rates[:1] if linear.point_foot else rates
        w = np.array([np.log(angle), *used, period])
        is_slow = (np.abs(used) < fastest).all(axis=0)
        found.append(w[:, is_slow])

    return found


def _scaled(gaits: np.ndarray, largest: float, with_lossless: bool) -> np.ndarray:
    """Gaits of small angles, and those that lose no energy to first order with angles
    in proportion to the cube root of the slope, since to third they lose a little.
    """
    angle = gaits[0]
    is_small = (angle > 0) & (angle < largest)
    scaled = [gaits[:, is_small]]
    if with_lossless:
        is_large = np.abs(angle) >= largest
        for share in _OF_LARGEST:
            lossless = gaits[:, is_large]
            lossless[0] = share * largest
            scaled.append(lossless)

    return np.hstack(scaled)


def _kneed_guesses(
    linear: SmallAngles,
    log_angle: np.ndarray,
    period: np.ndarray,
    ratio: np.ndarray,
    slope: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Guesses for legs with knees, with rates over the angle just before heelstrike,
    and which of the lattice each belongs to.
    """
    angle = np.exp(log_angle)
    rate, kneestrike = linear.kneed_exchange(angle, period, ratio, slope)
    is_linear = np.abs(rate) <= _LINEAR_UP_TO
    plain = -1.0 / np.tanh(period / 2)
    by_angle = np.clip(rate / angle, -_MAX_RATE, _MAX_RATE)
    rate = np.where(is_linear, by_angle, plain)

    guessed = np.isfinite(kneestrike)
    _, at = np.nonzero(guessed)
    rate = rate[guessed]
    kneestrike = kneestrike[guessed]
    swing_rate = ratio[at] * rate
    w = np.array([log_angle[at], rate, swing_rate, kneestrike, period[at]])
    return w, at


def search(
    problem: Problem, slope: float
) -> tuple[np.ndarray, AnyStride | None, StepCheck | None]:
    """Find the distinct fixed points that the lattice of guesses leads to at one slope,
    in order of the stance angle.

    Parameters
    ----------
    slope : float [rad]

    Returns
    -------
    w : ndarray, shape (m + phases, n)
        In similarity coordinates.
    stride : Stride or None
        Their steps; None where there is no fixed point.
    check : StepCheck or None
        Whether these happen.
    """
    line = Lanes([problem.walker], problem.structure, problem.drive)
    [[w]] = search_lines(line, [slope])
    n = w.shape[1]
    if not n:
        return w, None, None
    log_slope = np.full(n, np.log(slope))
    return w, *verify_steps(problem, w, log_slope)


def search_lines(
    problem: Lanes, slopes: Sequence[float], shares: int = 1
) -> list[list[np.ndarray]]:
    """Find the distinct fixed points that the lattice of guesses leads to, whether they
    are steps or not.

    Parameters
    ----------
    problem : Lanes
        Of one lane for each line.
    slopes : sequence of float [rad]
    shares : int
        As for `starts`.

    Returns
    -------
    list of list of ndarray, shape (m + phases, n)
        In similarity coordinates, for each slope one array a line.
    """
    lines = range(len(problem.lanes))
    lattice: list[np.ndarray] = []
    for line in lines:
        lattice += _starts(problem, line, slopes, shares)

    # A group is a slope of a line.
    counts = [w.shape[1] for w in lattice]
    group = np.repeat(np.arange(len(lattice)), counts)
    w = np.hstack(lattice)
    log_slope = np.log(np.asarray(slopes))

    def solve(
        w: np.ndarray, group: np.ndarray, apart: float, **options: Any
    ) -> tuple[np.ndarray, np.ndarray]:
        line, number = np.divmod(group, len(slopes))
        lanes = problem.some(line)
        w, converged = newton(lanes, w, log_slope[number], group=group, **options)
        w = w[:, converged]
        group = group[converged]
        kept, _ = distinct(w, group, apart)
        return w[:, kept], group[kept]

    limits = {
        "max_iterations": _MAX_ITERATIONS,
        "max_step_by_iteration": _MAX_STEP_BY_ITERATION[problem.phases],
    }
    # Only what converges with coarse integration is integrated exactly.
    w, group = solve(w, group, 1e-3, coarse=True, merge_cell=_MERGE_CELL, **limits)
    w, group = solve(w, group, 1e-5)

    return [
        [w[:, group == i + len(slopes) * line] for line in lines]
        for i in range(len(slopes))
    ]


def _starts(
    problem: Lanes, line: int, drives: Sequence[float], shares: int
) -> list[np.ndarray]:
    """The initial guesses of a line at some values of its drive."""
    walker = problem.walker_of(line)
    if problem.drive.base is None:
        return starts(walker, drives, shares)

    of_each = []
    for i, drive in enumerate(drives):
        pushing, slope = problem.drive.at(walker, drive)
        [guesses] = starts(pushing, [slope])
        of_each.append(guesses[:, i % shares :: shares])

    return of_each


def distinct(
    w: np.ndarray, group: np.ndarray, apart: float
) -> tuple[np.ndarray, np.ndarray]:
    """Which solutions remain, in a fixed order, if those nearer than `apart` to one
    that remains of their group go.

    Parameters
    ----------
    w : ndarray, shape (m + phases, n)
    group : ndarray of int, shape (n,)
    apart : float

    Returns
    -------
    kept : ndarray of int, shape (k,)
        Their numbers.
    same : ndarray of int, shape (n,)
        For each solution the place in `kept` of that which stands for it.
    """
    kept: list[int] = []
    same = np.zeros(w.shape[1], int)
    first = 0
    rounded = np.round(w, 6)
    order = np.lexsort([*rounded[::-1], group])
    for i in order.tolist():
        if kept and group[kept[-1]] != group[i]:
            first = len(kept)

        off = np.abs(w[:, kept[first:]] - w[:, [i]]).max(axis=0)
        is_near = off <= apart
        if is_near.any():
            same[i] = first + is_near.argmax()
        else:
            same[i] = len(kept)
            kept.append(i)

    return np.array(kept, int), same
