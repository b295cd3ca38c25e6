"""The rule of gaits that no branch leads to, and how a state is solved for as a gait."""

from __future__ import annotations

import numpy as np

from gaitsweep.tasks.branches.nearest import described
from gaitsweep.tasks.check.case import Case, some_gaits
from gaitsweep.tasks.check.one_step import judge_gaits
from gaitsweep.tasks.check.rows import relative_distance
from gaitsweep.tasks.gaits.newton import newton
from gaitsweep.tasks.gaits.step_check import verify_steps
from gaitsweep.tasks.mechanics.arrays import (
    LogSlopes,
    Marks,
    Numbers,
    Sections,
    Unknowns,
)
from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.step.several_steps import joined
from gaitsweep.tasks.step.simulate import STRUCK, SimulatedSteps

#: States that are solved for as gaits although no branch has one near.
SOLVED_WITHIN, _MOST_ITERATIONS = 0.3, 8


def judge_gaits_beside_branches(case: Case) -> None:
    """Tell rows that are gaits which no branch leads to, as those whose legs pass
    more than once: they return, and Newton's method goes from them to gaits.
    """
    lanes = _returning(case)
    if not len(lanes):
        return
    grounds = case.grounds.of(case.slopes(lanes))
    for some, problem, _, drive in grounds:
        _judge_solved(case, problem, lanes[some], np.log(drive))


def _returning(case: Case) -> Numbers:
    """Numbers of the rows without a verdict that come back to near themselves."""
    lanes = case.steppable
    return lanes[case.missed_by_one[lanes] < SOLVED_WITHIN]


def _judge_solved(case: Case, problem: Problem, lanes: Numbers, q: LogSlopes) -> None:
    """Tell rows near which Newton's method finds gaits, at values of ln drive."""
    y = case.sections(lanes, case.states(lanes))
    w, solved = solved_from(problem, y[None], case.times[None, :, lanes], q)
    lanes, q = lanes[solved], q[solved]
    gaits = described(problem, w, q)
    distance = relative_distance(case.states(lanes), gaits.state)
    is_nearer = distance < 0.999 * case.distance[lanes]
    nearer = np.flatnonzero(is_nearer)
    if not len(nearer):
        return

    _, check = verify_steps(problem, w[:, nearer], q[nearer])
    gaits.passes[nearer] = check.leg_passes
    nearer = nearer[check.step & ~check.doubt]
    case.set_nearest(lanes[nearer], some_gaits(gaits, nearer))
    judge_gaits(case)


def close_returns(steps: SimulatedSteps, start: Sections) -> Numbers:
    """Numbers of the steps that end near where they began."""
    missed = relative_distance(steps.image, start)
    walks = steps.outcome == STRUCK
    return np.flatnonzero(walks & (missed < SOLVED_WITHIN))


def solved_from(
    problem: Problem, y: np.ndarray, times: np.ndarray, q: LogSlopes
) -> tuple[Unknowns, Marks]:
    """Gaits in similarity coordinates to which Newton's method leads from sections
    (steps, 3, k) and event times (steps, phases, k) of steps at values of ln drive, and
    which of them lead to one.
    """
    if not len(q):
        return np.empty((problem.m + problem.phases, 0)), np.empty(0, bool)
    durations = np.diff(times, axis=1, prepend=0)
    w = joined(0.0, y[:, : problem.step.m], durations)
    w, converged = newton(problem, w, q, max_iterations=_MOST_ITERATIONS)
    return w[:, converged], converged
