"""States in the middle of a step, or on other ground: refused, or flown to the section."""

from __future__ import annotations

import numpy as np

from gaitsweep.tasks.check.case import COARSEST, Case
from gaitsweep.tasks.contract.registry import SLOPES
from gaitsweep.tasks.mechanics.arrays import Numbers
from gaitsweep.tasks.step.simulate import CAUSES, STRUCK, fly_on
from gaitsweep.tasks.step.stance import (
    ON_GROUND,
    between_feet,
    ground_under,
    half_between,
)


def refuse(case: Case) -> None:
    """Refuse rows that are no numbers, or whose swing foot is below the ground."""
    rows = case.rows
    links = rows.links(np.arange(case.n))
    case.say("not_a_number", np.flatnonzero(~np.isfinite(links).all(axis=0)))
    lacks_rate = rows.bent & ~np.isfinite(rows.shank[1])
    case.say("not_a_number", np.flatnonzero(lacks_rate))

    lanes = case.open
    way = between_feet(case.walker, *links[:3, lanes])
    tilt = ground_under(way)
    off = (np.abs(tilt) > _on_ground(case, lanes)) | rows.bent[lanes]
    case.depth[lanes] = np.where(off, -way.imag, 0.0)
    case.belongs[lanes] = np.where(off, rows.slope[lanes] - tilt, np.nan)


def _on_ground(case: Case, lanes: Numbers) -> np.ndarray:
    """Half sum of the legs' angles that counts as zero."""
    angle = np.abs(case.rows.state[0, lanes])
    digits = np.minimum(case.rows.table_digit[0, lanes], COARSEST * angle)
    return np.asarray(ON_GROUND + case.rows.tolerance * angle + digits)


def fly(case: Case) -> None:
    """Fly states off the section to the next heelstrike; of those whose feet stand on
    other ground the angle from its normal is judged.
    """
    lanes = case.open[np.isfinite(case.belongs[case.open])]
    if not len(lanes):
        return

    rows, links = case.rows, case.rows.links(lanes)
    is_straight = ~rows.bent[lanes]
    if is_straight.any():
        straight = lanes[is_straight]
        rows.state[0, straight] = half_between(*links[:2, is_straight])
        _judge_ground(case, straight)
        _judge_vertical(case, straight)

    left = case.verdict[lanes] == ""
    lanes, links = lanes[left], links[:, left]
    below = case.depth[lanes] > 0
    case.say(
        "below_ground",
        lanes[below],
        depth=case.depth[lanes[below]],
        belongs=case.belongs[lanes[below]],
    )
    _fly(case, lanes[~below], links[:, ~below])


def _judge_ground(case: Case, lanes: Numbers) -> None:
    """Tell rows that are gaits of the ground on which both feet stand."""
    low, high = SLOPES
    ground = case.belongs[lanes]
    is_level = np.abs(ground) <= _on_ground(case, lanes)
    case.belongs[lanes] = np.where(is_level, 0.0, ground)
    is_slope = is_level | (ground >= low) & (ground < high)
    some = lanes[is_slope & (case.rows.state[0, lanes] > 0)]
    state = case.rows.state[:, some]
    for gaits in case.grounds.gaits_at(case.belongs[some]):
        are = case.within(state, gaits.state, some)
        are &= case.verdict[some] == ""
        known = some[are]
        case.say_slope(known, case.belongs[known])


def _judge_vertical(case: Case, lanes: Numbers) -> None:
    """Tell rows that are gaits by the angle between the legs, at the slope given."""
    lanes = lanes[case.verdict[lanes] == ""]
    case.solve_gaits(lanes)
    state = case.states(lanes)
    numbers = case.match(lanes, state)
    are = numbers >= 0
    case.take_candidates(lanes[are], numbers[are], state[:, are])
    case.say("from_vertical", lanes[are])


def _fly(case: Case, lanes: Numbers, links: np.ndarray) -> None:
    """Fly states of links (6, k) with the swing foot above the ground to the section."""
    if not len(lanes):
        return

    section, outcome = fly_on(
        case.general.some(lanes),
        links,
        case.rows.bent[lanes],
        case.slopes(lanes),
    )
    struck = outcome == STRUCK
    _land(case, lanes[struck], section[:, struck])
    case.outcome[lanes] = outcome
    case.flown[lanes] = True
    case.belongs[lanes] = np.nan
    case.verdict[lanes[~struck]] = "none"
    for lane in lanes[~struck].tolist():
        cause = CAUSES[case.outcome[lane]]
        case.reason[lane] = f"Flown on, the walker has no heelstrike: {cause}."


def _land(case: Case, lanes: Numbers, section: np.ndarray) -> None:
    """Give rows the state with which the step after sections begins."""
    if len(lanes):
        problem = case.general.some(lanes)
        state = problem.start(section, case.slopes(lanes))
        case.rows.state[:, lanes] = state[:3]
