"""Rules of gaits with a fault: what undoes each of them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from gaitsweep.tasks.check.case import CHANGED, Case, some_gaits
from gaitsweep.tasks.check.rows import State
from gaitsweep.tasks.mechanics.arrays import Slopes


def judge_faults(case: Case) -> None:
    """Tell rows that are gaits with a fault."""
    times = _Times(case.walker.time_unit, case.rows.rate_unit)
    for verdict, change in _faults():
        lanes = case.open
        if not len(lanes):
            return

        given = case.states(lanes)
        state = change(given, case.slopes(lanes), times)
        numbers = case.match(lanes, state, CHANGED)
        # A walker whose unit of time is 1 has the same rates either way.
        is_same = case.within(state, given, lanes, 2 * CHANGED)
        are = (numbers >= 0) & ~is_same
        case.take_candidates(lanes[are], numbers[are], state[:, are])
        case.say_fault(verdict, lanes[are])

    _judge_before_heelstrike(case)


def _judge_before_heelstrike(case: Case) -> None:
    """Tell rows that are gaits just before heelstrike, by either leg's name."""
    for gaits in case.candidates:
        lanes = case.open
        angle = gaits.state[0, lanes]
        old, swing = gaits.before[:, lanes]
        state = case.states(lanes)
        is_near = case.within(state, gaits.state[:, lanes], lanes, 2 * CHANGED)
        for before in (
            [-angle, old, swing],
            [angle, old, swing],
            [angle, swing, old],
        ):
            are = case.within(state, np.array(before), lanes, CHANGED)
            are &= (case.verdict[lanes] == "") & ~is_near
            # As near as to what the gait is there.
            gait = gaits.state[:, lanes]
            after = gait + state - np.array(before)
            case.set_nearest(lanes[are], some_gaits(gaits, lanes[are]), after[:, are])
            case.say_fault("before_heelstrike", lanes[are])


@dataclass(frozen=True)
class _Times:
    """The walker's unit of time, and that by which the table's rates were multiplied."""

    walker: float
    table: float


_DEGREE = np.pi / 180.0
Change = Callable[[State, Slopes, _Times], State]


def _faults() -> Iterator[tuple[str, Change]]:
    """Faults by name, each with what undoes it in states (3, n), from the slope (n,) and
    units of time.
    """
    yield "sign_of_angle", _scaled(-1, 1, 1)
    yield "sign_of_stance_rate", _scaled(1, -1, 1)
    yield "sign_of_thigh_rate", _scaled(1, 1, -1)
    yield "sign_of_rates", _scaled(1, -1, -1)
    yield "mirrored", _scaled(-1, -1, -1)
    yield "rates_exchanged", _chosen(0, 2, 1)
    yield "legs_exchanged", _with_legs_exchanged
    yield "degrees", _scaled(_DEGREE, _DEGREE, _DEGREE)
    yield "angle_in_degrees", _scaled(_DEGREE, 1, 1)
    yield "rates_in_degrees", _scaled(1, _DEGREE, _DEGREE)
    yield "radians", _scaled(1 / _DEGREE, 1 / _DEGREE, 1 / _DEGREE)
    yield "rates_over_root", lambda state, _, time: state * _rates(1 / time.walker)
    yield "rates_in_units", lambda state, _, time: state * _rates(time.walker)
    yield "reversed", _chosen(2, 1, 0)
    for places in ((1, 0, 2), (1, 2, 0), (2, 0, 1)):
        yield "columns_exchanged", _chosen(*places)
    yield "angle_between_legs", _scaled(0.5, 1, 1)
    yield "rate_between_legs", _with_relative_rate
    yield "from_vertical", _from_vertical
    yield "clockwise_from_vertical", _clockwise_from_vertical


def _scaled(*factors: float) -> Change:
    """A change that multiplies coordinates."""
    column = np.array(factors)[:, None]
    return lambda state, slope, time: state * column


def _chosen(*places: int) -> Change:
    """A change that puts the table's columns into another order."""

    def change(state: State, slope: Slopes, time: _Times) -> np.ndarray:
        rates = _rates(time.table)
        columns = state / rates
        return np.asarray(columns[list(places)] * rates)

    return change


def _with_legs_exchanged(state: State, slope: Slopes, time: _Times) -> State:
    angle, swing, stance = state
    return np.array([-angle, stance, swing])


def _with_relative_rate(state: State, slope: Slopes, time: _Times) -> State:
    angle, stance, relative = state
    return np.array([angle, stance, stance - relative])


def _from_vertical(state: State, slope: Slopes, time: _Times) -> State:
    angle, stance, swing = state
    return np.array([angle + slope, stance, swing])


def _clockwise_from_vertical(state: State, slope: Slopes, time: _Times) -> State:
    angle, stance, swing = state
    return np.array([slope - angle, -stance, -swing])


def _rates(factor: float) -> np.ndarray:
    """Factors (3, 1) of a state that change its rates."""
    return np.array([[1.0], [factor], [factor]])
