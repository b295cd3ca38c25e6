"""The rule of gaits of another walker of the catalogue."""

from __future__ import annotations

import numpy as np

from gaitsweep.tasks.branches.nearest import described
from gaitsweep.tasks.check.beside_branches import close_returns, solved_from
from gaitsweep.tasks.check.case import CHANGED, Case
from gaitsweep.tasks.check.rows import State
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
    """Tell rows that a catalogue walker takes back to themselves, after one step or those
    claimed.
    """
    general = Lanes([walker], general_structure_of(walker))
    general = general.some(np.zeros(len(lanes), int))
    slope, state = case.slopes(lanes), case.states(lanes).copy()
    state[1:] *= walker.time_unit / case.walker.time_unit
    y = general.section_of(state, slope)
    sections, times = [y], list[np.ndarray]()
    for steps in range(1, case.claimed + 1):
        taken = stride(general, sections[-1], slope, exact=False)
        sections.append(taken.image)
        times.append(taken.times)
        if steps not in (1, case.claimed):
            continue

        returns = close_returns(taken, y)
        y_taken = np.array(sections[:-1])[..., returns]
        ends = np.array(times)[..., returns]

        some = lanes[returns]
        own = state[:, returns]
        known = _are_gaits(case, Problem(walker, steps), some, own, y_taken, ends)
        _say_walker(case, name, known)


def _are_gaits(
    case: Case,
    problem: Problem,
    lanes: Numbers,
    state: State,
    y: np.ndarray,
    times: np.ndarray,
) -> Numbers:
    """The rows, of some with states (3, k), that are gaits of a problem, by the sections
    and event times of their steps.
    """
    q = np.log(case.slopes(lanes))
    w, solved = solved_from(problem, y, times, q)
    lanes = lanes[solved]
    gaits = described(problem, w, q[solved])

    are = case.within(state[:, solved], gaits.state, lanes, CHANGED)
    return lanes[are]


def _say_walker(case: Case, name: str, lanes: Numbers) -> None:
    """Give some rows without a verdict that of gaits of another walker."""
    lanes = lanes[case.verdict[lanes] == ""]
    case.other[lanes] = name
    case.say("walker", lanes, walker=case.other[lanes])
