"""Steps taken from states, and the rule of gaits that repeat after several."""

from __future__ import annotations

import numpy as np

from gaitsweep.tasks.branches.nearest import described
from gaitsweep.tasks.check.case import Case, some_gaits
from gaitsweep.tasks.check.rows import relative_distance
from gaitsweep.tasks.gaits.newton import newton
from gaitsweep.tasks.mechanics.arrays import LogSlopes, Marks, Numbers, Unknowns
from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.step.several_steps import joined
from gaitsweep.tasks.step.simulate import STRUCK, stride

#: Most steps after which a state is looked for again.
MOST_STEPS = 8
#: What a state may miss itself by after some steps, relative, to be tried as a gait of
#: so many.
_RETURNS = 0.05


def take_steps(case: Case) -> None:
    """Take the steps after which the states are held to repeat."""
    lanes = case.steppable
    if not len(lanes):
        return
    slope, problem = case.slopes(lanes), case.general.some(lanes)
    start = case.sections(lanes, case.states(lanes))
    steps = stride(problem, start, slope)
    case.times[:, lanes] = steps.times
    image, outcome = steps.image, steps.outcome
    for _ in range(case.claimed - 1):
        steps = stride(problem, image, slope)
        image, outcome = steps.image, np.maximum(outcome, steps.outcome)
    case.outcome[lanes] = outcome
    case.missed[lanes] = relative_distance(image, start)


def judge_several_steps(case: Case) -> None:
    """Tell rows that repeat after several steps, up to the most that are tried."""
    lanes = case.steppable
    lanes = lanes[case.outcome[lanes] == STRUCK]
    if not len(lanes):
        return
    start = case.sections(lanes, case.states(lanes))
    sections, times = [start], list[np.ndarray]()
    for steps in range(1, MOST_STEPS + 1):
        problem, slope = case.general.some(lanes), case.slopes(lanes)
        taken = stride(problem, sections[-1], slope, exact=False)
        sections.append(taken.image)
        times.append(taken.times)

        returns = relative_distance(taken.image, sections[0]) < _RETURNS
        if steps > 1 and returns.any():
            _judge_cycles(case, lanes[returns], steps, sections, times, returns)
        goes_on = (taken.outcome == STRUCK) & (case.verdict[lanes] == "")
        lanes = lanes[goes_on]
        sections = [section[:, goes_on] for section in sections]
        times = [each[:, goes_on] for each in times]
        if not len(lanes):
            return


def _judge_cycles(
    case: Case,
    lanes: Numbers,
    steps: int,
    sections: list[np.ndarray],
    times: list[np.ndarray],
    returns: Marks,
) -> None:
    """Tell rows that are gaits of so many steps, from the steps taken."""
    y = np.array([section[: case.problem.m, returns] for section in sections[:steps]])
    ends = np.array([each[:, returns] for each in times[:steps]])
    w = joined(0.0, y, np.diff(ends, axis=1, prepend=0))
    for some, problem, _, drive in case.grounds.of(case.slopes(lanes)):
        of_steps = problem.of_steps(steps)
        _judge_cycles_of(case, of_steps, lanes[some], w[:, some], np.log(drive))


def _judge_cycles_of(
    case: Case, problem: Problem, lanes: Numbers, w: Unknowns, q: LogSlopes
) -> None:
    """Tell rows that are gaits of several steps, by Newton's method from points w
    (c - 1, k) at values of ln drive.
    """
    steps = problem.steps
    w, converged = newton(problem, w, q)
    lanes = lanes[converged]
    gaits = described(problem, w[:, converged], q[converged])
    are = case.within(case.states(lanes), gaits.state, lanes)
    lanes = lanes[are]
    case.set_nearest(lanes, some_gaits(gaits, np.flatnonzero(are)))
    case.steps[lanes] = steps
    if steps == case.claimed:
        case.say("gait", lanes)
    else:
        case.say_period(lanes)
