"""Rigorous flow: Taylor steps in balls, each over a box that is shown to hold the
motion, with Lagrange's remainder.

On a step of length h from states y0, a box Y with y0 + [0, h] F(Y) inside Y holds every
motion from y0 up to time h (Picard and Lindelof). So y(t) lies in sum_{k<N} y_k t^k +
Y_N t^N, with Y_N the coefficient N over all states of Y. The derivatives V' = A(y) V by
the start are enclosed in the same way.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from flint import arb, arb_mat

from gaitsweep.tasks.proofs.body import Body
from gaitsweep.tasks.proofs.motion import Motion, Series, Variation, evaluate, velocity

#: Attempts at a box before a step is halved, halvings before a phase is given up, and
#: steps of one phase.
MAX_INFLATIONS, MAX_HALVINGS, MAX_STEPS = 12, 20, 400
#: Longest step over sqrt((l + R)/g): beyond it boxes grow faster than the remainder
#: falls.
MAX_STEP = 0.4


class NotProvedError(Exception):
    """Why a proof fails; the message is a sentence."""


#: Angles, then rates.
State = list[arb]


@dataclass(frozen=True)
class Accuracy:
    """How finely a step is enclosed: coefficients of a Taylor step, and the remainder
    over what it is added to.
    """

    order: int
    tolerance: float


@dataclass(frozen=True)
class Piece:
    """Series of the state on one step, remainder included: at t in [start, start + h].

    Coefficients hold every motion from the phase's box of starts.
    """

    start: arb
    h: arb
    series: list[Series]


@dataclass(frozen=True)
class Flow:
    """End of a phase: of the middle's motion, of the whole box's, its derivatives, and
    its pieces.
    """

    middle: State
    state: State
    derivative: arb_mat
    pieces: list[Piece]


def flow(
    body: Body,
    slopes: tuple[arb, arb],
    middle: State,
    box: State,
    derivative: arb_mat,
    duration: tuple[arb, arb],
    accuracy: Accuracy,
    by_slope: arb_mat | None,
    spread: list[arb],
) -> Flow:
    """Carry a box of states and the derivatives by their parameters over a phase.

    Parameters
    ----------
    slopes : (arb, arb) [rad]
        The middle's, and every slope.
    middle, box : list of arb
        States at the start; the box holds the middle.
    derivative : arb_mat, shape (2 n, d)
        Derivatives of the state at the start by d parameters.
    duration : (arb, arb)
        Of the middle's motion, and a ball of all durations.
    accuracy : Accuracy
    by_slope : arb_mat, shape (1, d), optional
        Derivatives of the slope by the parameters.
    spread : list of arb, length d
        How far the parameters lie from the middle's.

    Returns
    -------
    Flow

    Raises
    ------
    NotProvedError
        If no enclosure is found.
    """
    of_middle, of_all = slopes
    order = accuracy.order - 1
    state = box
    time = arb(0)
    end = duration[1].upper()
    longest = MAX_STEP * body.time_unit
    length = longest
    pieces: list[Piece] = []
    while len(pieces) < MAX_STEPS:
        remaining = (end - time).upper()
        h = _next_length(remaining, length)
        thin = Motion(body, of_middle, middle, order)
        wide = Motion(body, of_all, state, order)
        change = Variation(wide, derivative, by_slope, order)
        step = _taylor_step(thin, change, h, accuracy)
        pieces.append(Piece(time, step.h, step.wide))

        if step.h is remaining:
            middle, state, derivative = step.at(*_left(duration, time))
            return Flow(middle, state, derivative, pieces)

        middle, state, derivative = step.at(step.h, step.h)
        state = narrower(state, middle, derivative, spread)
        time = time + step.h
        length = min(longest, step.next_length(accuracy.order))

    raise NotProvedError(f"The phase takes more than {MAX_STEPS} Taylor steps.")


@dataclass(frozen=True)
class _TaylorStep:
    """One step of a phase.

    Attributes
    ----------
    h : arb
        Its length.
    thin, wide : list of series
        Of the middle's motion and of all, remainder included.
    change : list of arb_mat
        Coefficients of the derivatives, remainder included.
    excess : float
        Of the remainder over what it may be.
    """

    h: arb
    thin: list[Series]
    wide: list[Series]
    change: list[arb_mat]
    excess: float

    def at(self, of_middle: arb, of_all: arb) -> tuple[State, State, arb_mat]:
        """The middle's state at a time, and all states, and derivatives, at another."""
        middle = _evaluated(self.thin, of_middle)
        state = _evaluated(self.wide, of_all)
        return middle, state, evaluate(self.change, of_all)

    def next_length(self, order: int) -> float:
        """How long the next step may be, by the excess of this one's remainder."""
        longer = 0.85 * max(self.excess, 1e-9) ** (-1 / order)
        return float(self.h) * min(1.5, longer)


def _taylor_step(
    thin: Motion, change: Variation, h: arb, accuracy: Accuracy
) -> _TaylorStep:
    """A step of the middle's motion and of all, with their derivatives, no longer than
    h.
    """
    h, (rest, rest_derivative), excess = _fitting(change, h, accuracy)
    return _TaylorStep(
        h=h,
        thin=_closed(thin, rest),
        wide=_closed(change.motion, rest),
        change=[*change.terms, rest_derivative],
        excess=excess,
    )


def _next_length(remaining: arb, longest: float) -> arb:
    """Length of the next step: all that remains, if that is no more than the longest.

    The last step holds the whole bracket of the event, so it is no shorter than half the
    others.
    """
    if remaining <= longest:
        return remaining
    return arb(min(longest, float(remaining) / 2))


def _left(duration: tuple[arb, arb], time: arb) -> tuple[arb, arb]:
    """What is left of the durations of a phase after some time."""
    of_middle, of_all = (whole - time for whole in duration)
    if not (of_middle >= 0 and of_all >= 0):
        raise NotProvedError(
            "The bracket of an event's time is wider than a Taylor step."
        )
    return of_middle, of_all


def _fitting(
    change: Variation, h: arb, accuracy: Accuracy
) -> tuple[arb, tuple[State, arb_mat], float]:
    """The given step or a shorter one whose remainder is small enough: its length, the
    remainder and its excess.
    """
    order = accuracy.order
    for _ in range(MAX_HALVINGS):
        remainder = _remainder(change, h, order)
        shrink = 0.5
        if remainder is not None:
            excess = _excess(remainder, change, h, order) / accuracy.tolerance
            if excess <= 1:
                return h, remainder, excess
            shrink = 0.3
            if math.isfinite(excess):
                shrink = max(0.3, 0.85 * excess ** (-1 / order))

        h = arb(float(h) * shrink)

    raise NotProvedError(
        "No box encloses the motion over a step: the enclosures have grown too wide."
    )


def narrower(
    state: State, middle: State, derivative: arb_mat, spread: list[arb]
) -> State:
    """The narrower ball of every coordinate: the one given, or the mean value form
    around the middle's state.

    Parameters
    ----------
    state, middle : list of arb
        Of every motion, and of the middle's.
    derivative : arb_mat, shape (2 n, d)
        Of the state by d parameters, over all of them.
    spread : list of arb, length d
        How far the parameters lie from the middle's.

    Returns
    -------
    list of arb
    """
    away = (derivative * arb_mat([[x] for x in spread])).entries()
    return [
        min(x, c + d, key=lambda ball: float(ball.rad()))
        for x, c, d in zip(state, middle, away, strict=True)
    ]


def _evaluated(series: list[Series], t: arb) -> State:
    """Values of several series."""
    return [evaluate(each, t) for each in series]


def _closed(motion: Motion, rest: State) -> list[Series]:
    """Series with the remainder as their last coefficient."""
    return [[*s, r] for s, r in zip(motion.series, rest, strict=True)]


def _remainder(change: Variation, h: arb, order: int) -> tuple[State, arb_mat] | None:
    """Coefficient `order` over all states up to time h, and the derivatives'; None if
    no box is found.
    """
    body, slope = change.motion.body, change.motion.slope
    start = change.motion.state
    box = enclose(body, slope, start, h)
    if box is None:
        return None

    try:
        motion = Motion(body, slope, box, 1)
        at_start = Variation(motion, change.terms[0], change.by_slope)
        derivatives = enclose_derivative(at_start, h)
        for _ in range(order - 1):
            motion.grow()
    except ZeroDivisionError:
        return None

    whole = Variation(motion, derivatives, change.by_slope, order)
    return [s[order] for s in motion.series], whole.terms[order]


def enclose(body: Body, slope: arb, start: State, h: arb) -> State | None:
    """A box that holds every motion up to time h (Picard and Lindelof).

    Parameters
    ----------
    body : Body
    slope : arb [rad]
    start : list of arb
        Angles [rad], then rates.
    h : arb

    Returns
    -------
    list of arb or None
        Angles, then rates; None if no box is found.
    """
    n, span, box = len(start) // 2, arb(0).union(h), start
    for _ in range(MAX_INFLATIONS):
        try:
            rates = velocity(body, slope, box)
        except ZeroDivisionError:
            return None

        image = [x + span * rate for x, rate in zip(start, rates, strict=True)]
        if all(b.contains(i) for b, i in zip(box, image, strict=True)):
            return image

        # Of angles, and of rates.
        least = [1e-3 * _size(part) for part in (image[:n], image[n:])]
        unions = [b.union(i) for b, i in zip(box, image, strict=True)]
        box = [_inflated(ball, 0.05, least[k // n]) for k, ball in enumerate(unions)]

    return None


def enclose_derivative(change: Variation, h: arb) -> arb_mat:
    """A matrix that holds the derivatives up to time h.

    Parameters
    ----------
    change : Variation
        At the start, of a motion whose leading coefficients hold its states up to time
        h.
    h : arb

    Returns
    -------
    arb_mat, shape (2 n, d)

    Notes
    -----
    V' = A V with |A| <= B by elements gives |V(t)| <= exp(B t) |V(0)| (Gronwall), a first enclosure W; and then
    V(t) = V(0) + int A V lies in V(0) + [0, h] A W, twice over.
    """
    start, span = change.terms[0], arb(0).union(h)
    size = change.growth(h) * _absolute(change.stacked(start))
    sizes = size.entries()[: len(start.entries())]
    balls = [arb(0, x.abs_upper()) for x in sizes]
    enclosure = arb_mat(start.nrows(), start.ncols(), balls)
    for _ in range(2):
        trial = Variation(change.motion, enclosure, change.by_slope, 1)
        enclosure = start + trial.terms[1] * span

    return enclosure


def _absolute(matrix: arb_mat) -> arb_mat:
    sizes = [arb(x.abs_upper()) for x in matrix.entries()]
    return arb_mat(matrix.nrows(), matrix.ncols(), sizes)


def _inflated(x: arb, factor: float, least: float) -> arb:
    return arb(x.mid(), x.rad() * (1 + factor) + least)


def _excess(
    remainder: tuple[State, arb_mat], change: Variation, h: arb, order: int
) -> float:
    """Largest remainder over the size of what it is added to."""
    (rest, rest_derivative), start = remainder, change.motion.state
    n, power = len(start) // 2, float(h) ** order
    sizes = [
        (rest[:n], start[:n]),
        (rest[n:], start[n:]),
        (rest_derivative.entries(), change.terms[0].entries()),
    ]
    return max(_size(a) * power / _size(b) for a, b in sizes)


def _size(values: list[arb]) -> float:
    return max(float(x.abs_upper()) for x in values)
