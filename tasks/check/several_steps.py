"""Steps taken from states, and the rules of gaits that repeat after several."""

from __future__ import annotations

import numpy as np

from gaitsweep.tasks.branches.nearest import described
from gaitsweep.tasks.check.beside_branches import SOLVED_WITHIN
from gaitsweep.tasks.check.case import Case, some_gaits
from gaitsweep.tasks.check.one_step import are_gaits, say_gaits
from gaitsweep.tasks.check.rows import relative_distance
from gaitsweep.tasks.contract.registry import MAX_STEPS_OF_STATES
from gaitsweep.tasks.gaits.newton import newton
from gaitsweep.tasks.gaits.step_check import verify_steps
from gaitsweep.tasks.mechanics.arrays import LogSlopes, Marks, Numbers, Unknowns
from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.step.sameness import SOONER
from gaitsweep.tasks.step.several_steps import distances_of_steps, joined
from gaitsweep.tasks.step.simulate import STRUCK, stride

#: What a state may miss itself by after steps that are not claimed, relative, to be tried
#: as a gait of so many.
_RETURNS = 0.05


def take_steps(case: Case) -> None:
    """Take the steps after which the states are held to repeat, and tell rows that are
    gaits of so many, which are more than one.
    """
    lanes = case.steppable
    if not len(lanes):
        return

    slope = case.slopes(lanes)
    problem = case.general.some(lanes)
    sections = [case.sections(lanes, case.states(lanes))]
    times = list[np.ndarray]()

    outcome = np.full(len(lanes), STRUCK)
    for _ in range(case.claimed):
        steps = stride(problem, sections[-1], slope)
        sections.append(steps.image)
        times.append(steps.times)
        outcome = np.maximum(outcome, steps.outcome)

    start, first, *_ = sections
    case.times[:, lanes] = times[0]
    case.outcome[lanes] = outcome
    case.missed_by_one[lanes] = relative_distance(first, start)
    case.missed[lanes] = relative_distance(sections[-1], start)
    returns = case.missed[lanes] < SOLVED_WITHIN
    if case.claimed > 1 and returns.any():
        _judge_cycles(case, lanes[returns], case.claimed, sections, times, returns)


def judge_several_steps(case: Case) -> None:
    """Tell rows that repeat after several steps, up to the most that are tried."""
    lanes = case.steppable
    lanes = lanes[case.outcome[lanes] == STRUCK]
    if not len(lanes):
        return

    start = case.sections(lanes, case.states(lanes))
    sections, times = [start], list[np.ndarray]()
    for steps in range(1, MAX_STEPS_OF_STATES + 1):
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
    """Tell rows that are gaits of several steps and no fewer, by Newton's method from
    points w (c - 1, k) at values of ln drive.
    """
    steps = problem.steps
    w, converged = newton(problem, w, q)
    sooner = distances_of_steps(w, problem.m, steps)
    solved = np.flatnonzero(converged & (sooner > SOONER).all(axis=0))
    if not len(solved):
        return

    lanes = lanes[solved]
    w = w[:, solved]
    q = q[solved]
    gaits = described(problem, w, q)
    _, check = verify_steps(problem, w, q)
    gaits.passes[:] = check.leg_passes

    is_nearer = (
        relative_distance(case.states(lanes), gaits.state) < case.distance[lanes]
    )
    are = are_gaits(case, gaits.state, lanes)
    told = are | is_nearer if steps == case.claimed else are
    told &= check.step & ~check.doubt
    case.set_nearest(lanes[told], some_gaits(gaits, np.flatnonzero(told)))
    say_gaits(case, lanes[told & are])
