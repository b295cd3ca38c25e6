"""Whether states are gaits of a walker, and if not, why.

All states are lanes of one batch. The rules are tried in the order of `_RULES`, and the
first that applies is the verdict, whose sentence contract/verdicts.toml has: a state is
the gait that it is closest to at its slope if every coordinate is nearer than a tolerance,
which adds to a relative one the last digit of what was given. A state is a gait with a
fault if what the fault makes of the gait is as near. What is left may be a gait of another
slope, or of another walker of the catalogue.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from gaitsweep.tasks.branches import atlas as atlases
from gaitsweep.tasks.branches.refine import COARSE
from gaitsweep.tasks.check.answer import answer
from gaitsweep.tasks.check.beside_branches import judge_gaits_beside_branches
from gaitsweep.tasks.check.case import Case
from gaitsweep.tasks.check.faults import judge_faults
from gaitsweep.tasks.check.grounds import Grounds
from gaitsweep.tasks.check.off_section import fly, refuse
from gaitsweep.tasks.check.one_step import judge_digits, judge_gaits
from gaitsweep.tasks.check.other_slopes import judge_rounded_slopes, judge_slopes
from gaitsweep.tasks.check.other_walkers import judge_walkers
from gaitsweep.tasks.check.rows import Rows
from gaitsweep.tasks.check.several_steps import judge_several_steps, take_steps
from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.step.simulate import CAUSES, STRUCK
from gaitsweep.tasks.walkers.resolve import walker_of_line

#: Relative distance up to which a gait is called near.
_NEAR = 0.1


def check_states(params: Mapping[str, Any]) -> dict[str, Any]:
    """Check whether states are gaits of a walker.

    Parameters
    ----------
    params : mapping
        `walker` (name or table), `set` (keys to change), `slope`, ndarray, shape (n,)
        [rad]; `table`, the columns of a `convention`, ndarray, shape (n,), angles in rad;
        `digits`, the same columns and `slope` where the table has it, the size of the last
        digit given; `sizes`, of the last one that the table would have given; `rates`
        ("walker", "scaled", or None for the convention's own); `tolerance`, relative;
        `steps`, after which they are held to repeat.

    Returns
    -------
    dict
        Of n rows: `verdict` and `reason` (str), `is_gait`, `gait` (label of the nearest
        gait at the slope), `distance` (to it, relative), `missed` (after `steps` steps,
        relative; NaN of a fall), `steps` (after which the nearest gait repeats),
        `spectral_radius`, `belongs_to_slope` [rad], `walker` (the name of the one that it
        is a gait of), `flown` (whether the state was flown to the section), the
        `stance_angle`, `stance_rate` and `thigh_rate` that were judged, and those of the
        nearest gait as `nearest_...`, in the walker's units. `curves`, a list of the
        walker's branches: slope and stance angle at their nodes.

    Raises
    ------
    WalkerError
        If the walker is invalid, or cannot have the convention.
    """
    walker = walker_of_line(params)
    rows = Rows.of(walker, params)
    problem = Problem(walker)
    branches = atlases.survey(problem, COARSE)
    grounds = Grounds(problem, branches, int(params.get("steps", 1)))
    case = Case(walker, grounds, rows)
    for rule in _RULES:
        rule(case)
    return answer(case)


def _judge_rest(case: Case) -> None:
    """Say of all other rows how far the nearest gait is, and how steps from them end."""
    lanes, walked = case.open, case.steppable
    near = case.distance[lanes] < _NEAR
    near_lanes = lanes[near]
    case.say("near", near_lanes, distance=case.distance[near_lanes])
    case.say("none", lanes[~near])
    for lane in walked[case.outcome[walked] != STRUCK].tolist():
        cause = CAUSES[case.outcome[lane]]
        case.reason[lane] += f" Walked on, it has no heelstrike: {cause}."


#: What is done with the rows that have no verdict yet, in this order.
_RULES = (
    refuse,
    fly,
    take_steps,
    Case.find_nearest,
    judge_gaits,
    judge_rounded_slopes,
    judge_digits,
    judge_faults,
    judge_slopes,
    judge_gaits_beside_branches,
    judge_several_steps,
    judge_walkers,
    _judge_rest,
)
