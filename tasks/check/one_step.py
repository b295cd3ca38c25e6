"""Rules of gaits of one step at the slope of the row."""

from __future__ import annotations

import numpy as np

from gaitsweep.tasks.check.case import CHANGED, Case
from gaitsweep.tasks.check.rows import magnitudes
from gaitsweep.tasks.mechanics.arrays import Numbers

#: By how much more a state flown to the section may differ.
_FLOWN = 20.0


def judge_gaits(case: Case) -> None:
    """Tell rows that are gaits of one step."""
    lanes = case.open
    factors = np.where(case.flown[lanes], _FLOWN, 1.0)
    gait = case.nearest.state[:, lanes]
    lanes = lanes[case.within(case.states(lanes), gait, lanes, factors)]
    if case.claimed > 1:
        case.say_period(lanes)
        return
    case.say("gait", lanes)
    _tell_digits(case, lanes)
    judge_shanks(case, lanes)


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


def judge_shanks(case: Case, lanes: Numbers) -> None:
    """Tell rows that are gaits but for their free shank's rate."""
    has_rate = np.isfinite(case.rows.shank[1, lanes])
    lanes = lanes[has_rate & ~case.flown[lanes]]
    if not case.walker.knees or not len(lanes):
        return
    state = case.states(lanes)
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
