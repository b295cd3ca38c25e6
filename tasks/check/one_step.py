"""Rules of gaits of branches at the slope of the row."""

from __future__ import annotations

import numpy as np

from gaitsweep.tasks.check.case import CHANGED, Case
from gaitsweep.tasks.check.rows import State, magnitudes
from gaitsweep.tasks.mechanics.arrays import Numbers

#: By how much more a state flown to the section may differ.
_FLOWN = 20.0


def judge_gaits(case: Case) -> None:
    """Tell rows that are the gaits nearest to them."""
    lanes = case.open
    say_gaits(case, lanes[are_gaits(case, case.nearest.state[:, lanes], lanes)])


def are_gaits(case: Case, gait: State, lanes: Numbers) -> np.ndarray:
    """Whether some rows are gaits (3, k), to the tolerance."""
    factors = np.where(case.flown[lanes], _FLOWN, 1.0)
    return case.within(case.states(lanes), gait, lanes, factors)


def say_gaits(case: Case, lanes: Numbers) -> None:
    """Tell rows that are the gaits nearest to them, after as many steps as claimed."""
    is_claimed = case.nearest.steps[lanes] == case.claimed
    case.say_period(lanes[~is_claimed])
    lanes = lanes[is_claimed]
    case.say("gait", lanes)
    _tell_digits(case, lanes)
    _judge_shanks(case, lanes)


def _tell_digits(case: Case, lanes: Numbers) -> None:
    """Say of gaits that are farther off than the tolerance to how many digits."""
    digits = _digits(case, lanes)
    is_rounded = case.distance[lanes] > case.rows.tolerance
    is_rounded &= ~case.flown[lanes] & np.isfinite(digits)
    for lane, count in zip(lanes[is_rounded], digits[is_rounded], strict=True):
        case.reason[lane] = f"A gait, to the {count:.0f} digits given."


def _digits(case: Case, lanes: Numbers) -> np.ndarray:
    """To how many digits a table gives the coarsest coordinate of some rows."""
    sizes = magnitudes(case.states(lanes))
    share = case.rows.table_digit[:, lanes] / sizes
    with np.errstate(divide="ignore"):
        return np.asarray(np.ceil(-np.log10(share.max(axis=0))))


def _judge_shanks(case: Case, lanes: Numbers) -> None:
    """Tell rows that are gaits but for their shank's rate, of straight legs the thigh's."""
    has_rate = np.isfinite(case.rows.shank[1, lanes])
    lanes = lanes[has_rate & ~case.flown[lanes]]
    if not len(lanes):
        return

    state = case.states(lanes)
    given = state[2]
    if case.walker.knees:
        problem = case.general.some(lanes)
        sections = case.sections(lanes, state)
        given = problem.start(sections, case.slopes(lanes))[3]

    found = case.rows.shank[1, lanes]

    size = np.maximum(magnitudes(state)[2], np.abs(given))
    allowed = CHANGED * case.relative_tolerance(lanes) * size
    wrong = np.abs(found - given) > allowed
    unit = case.walker.time_unit
    case.say(
        "shank_rate",
        lanes[wrong],
        found=found[wrong] / unit,
        given=given[wrong] / unit,
    )


def judge_digits(case: Case) -> None:
    """Tell rows that are gaits to fewer digits than the table has."""
    lanes = case.open
    gait = case.nearest.state[:, lanes]
    own_digit = case.rows.own_digit[:, lanes]
    table_digit = case.rows.table_digit[:, lanes]

    sizes = magnitudes(gait)
    digits = np.minimum(own_digit, 0.1 * sizes)
    # In decimals a unit of the last digit is exceeded by rounding.
    allowed = 1.001 * digits + case.rows.tolerance * sizes
    is_near = np.abs(case.states(lanes) - gait) <= allowed
    has_fewer = own_digit > 1.5 * table_digit
    are = is_near.all(axis=0) & has_fewer.any(axis=0)
    case.say("digits", lanes[are])
