"""The rule of gaits of another walker of the catalogue."""

from __future__ import annotations

import numpy as np

from gaitsweep.tasks.branches.nearest import described
from gaitsweep.tasks.check.beside_branches import close_returns, solved_from
from gaitsweep.tasks.check.case import CHANGED, Case
from gaitsweep.tasks.mechanics.arrays import Numbers
from gaitsweep.tasks.mechanics.lumped import general_structure_of
from gaitsweep.tasks.step.problem import Lanes, Problem
from gaitsweep.tasks.step.simulate import stride
from gaitsweep.tasks.walkers.catalogue import CATALOGUE
from gaitsweep.tasks.walkers.walker import Walker


def judge_walkers(case: Case) -> None:
    """Tell rows that are gaits of another walker of the catalogue at their slope."""
    for name, walker in CATALOGUE.items():
        # They are passive.
        lanes = case.steppable
        lanes = lanes[case.slopes(lanes) > 0]
        if not len(lanes) or walker == case.walker:
            continue
        if walker.knees == case.walker.knees:
            _judge_walker(case, name, walker, lanes)


def _judge_walker(case: Case, name: str, walker: Walker, lanes: Numbers) -> None:
    """Tell rows that a catalogue walker takes back to themselves."""
    general = Lanes([walker], general_structure_of(walker))
    general = general.some(np.zeros(len(lanes), int))
    slope, state = case.slopes(lanes), case.states(lanes).copy()
    state[1:] *= walker.time_unit / case.walker.time_unit
    y = general.section_of(state, slope)
    steps = stride(general, y, slope, exact=False)
    returns = close_returns(steps, y)
    problem = Problem(walker)
    w, solved = solved_from(
        problem,
        y[:, returns],
        steps.times[:, returns],
        np.log(slope[returns]),
    )
    returns = returns[solved]
    gaits = described(problem, w, np.log(slope[returns]))
    are = case.within(state[:, returns], gaits.state, lanes[returns], CHANGED)
    known = lanes[returns[are]]
    case.other[known] = name
    case.say("walker", known, walker=case.other[known])
