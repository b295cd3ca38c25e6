"""Points of a line's branches at which slope, stability or speed reach their extremes.

The smallest slope, the largest slope of a stable gait and the largest speed of one are
reached where a branch turns or ends, where a multiplier leaves the unit circle, where
the speed is stationary, or at the border of a window. Each of these fulfils a condition
(`tasks.branches.conditions`), by which it is located, whatever led to it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy import ndarray

from gaitsweep.tasks.branches.branch import Branch
from gaitsweep.tasks.branches.conditions import (
    CONDITIONS,
    foot_radius,
    is_located,
    log_froude,
    log_froude_by_Z,
)
from gaitsweep.tasks.branches.joint import Evaluation, evaluate
from gaitsweep.tasks.branches.passings import (
    Guesses,
    Nodes,
    guess_passings,
    locate,
)
from gaitsweep.tasks.branches.special_points import turns_and_ends
from gaitsweep.tasks.contract.kinds import (
    COSTS,
    FASTEST_STABLE_SPEED,
    KINDS,
    LARGEST_STABLE_SLOPE,
    SMALLEST_SLOPE,
    kind_of,
)
from gaitsweep.tasks.gaits.multipliers import other_multipliers
from gaitsweep.tasks.gaits.step_check import LONG_BELOW, gait_ratio
from gaitsweep.tasks.mechanics.arrays import (
    Coordinates,
    LogSlopes,
    Marks,
    Numbers,
    PerLane,
)
from gaitsweep.tasks.mechanics.sums import total
from gaitsweep.tasks.step.lanes import join_lanes
from gaitsweep.tasks.step.problem import EPS, Lanes
from gaitsweep.tasks.walkers.statics import are_tuned

#: A special point is at an end of stability if the magnitudes of its other multipliers
#: are below this.
_STABLE = 1 - 1e-9
#: Kind of a point from which a tuned walker's branch continues to vanishing slopes: an
#: end below such a slope [rad].
ANY_SLOPE, _VANISHING = "any slope", 1e-12


#: Quantities of a design whose extremes are sought.
QUANTITIES: tuple[str, ...] = (
    SMALLEST_SLOPE,
    LARGEST_STABLE_SLOPE,
    FASTEST_STABLE_SPEED,
    *COSTS,
)
#: How far outside the window its own edges may lie, in ln slope; and the error of points
#: that are taken as nodes.
_EDGE, _UNSOLVED = 1e-9, 1e-9


class Sought(NamedTuple):
    """Where extremes are sought: the least and largest ln slope, and at which speed, if
    at any, as its logarithm.
    """

    window: tuple[float, float]
    log_speed: float | None = None


@dataclass
class Points:
    """Points of several lines, n in all.

    Attributes
    ----------
    line : ndarray of int, shape (n,)
    kind : ndarray of str, shape (n,)
        Of KINDS.
    Z, rows : ndarray, shape (c, n)
        Point, and derivatives of its scalar; NaN where the kind has none.
    error : ndarray, shape (n,)
        Bound on the error of Z, ln slope included.
    log_froude : ndarray, shape (n,)
        Logarithm of the speed over sqrt(g leg).
    speed_error : ndarray, shape (n,)
        Bound on the error of that.
    walks, long, stable : ndarray of bool, shape (n,)
        Whether it is a step, or the limit of steps, whose legs pass once; a long one;
        and whether stable gaits are next to it.
    faster : ndarray of bool, shape (n,)
        Whether the speed grows along the branch with the kind's scalar, where that is
        known.
    """

    line: ndarray
    kind: ndarray
    Z: Coordinates
    rows: Coordinates
    error: PerLane
    log_froude: PerLane
    speed_error: PerLane
    walks: Marks
    long: Marks
    stable: Marks
    faster: Marks

    @property
    def log_slope(self) -> ndarray:
        """Values of ln slope, shape (n,)."""
        return self.Z[-1]


def nothing(problem: Lanes) -> Points:
    """Return no points."""
    Z, none, no = (
        np.empty((problem.m + 1 + problem.phases, 0)),
        np.empty(0),
        np.empty(0, bool),
    )
    return Points(
        np.empty(0, int), np.empty(0, "U32"), Z, Z, none, none, none, no, no, no, no
    )


def may_be(name: str, kind: ndarray) -> ndarray:
    """Return whether points of some kinds may be the extremes of a quantity.

    Parameters
    ----------
    name : str
        Of QUANTITIES.
    kind : ndarray of str, shape (n,)

    Returns
    -------
    ndarray of bool, shape (n,)
    """
    named = [other for other, about in KINDS.items() if name in about.extremes]
    present = set(kind.tolist())  # mostly one: texts are compared slowly
    may = present.intersection(named)
    if name not in COSTS:
        # Where a branch ends for a reason of its own, too.
        may |= present.difference(KINDS)
    return np.isin(kind, np.array(sorted(may), kind.dtype))


def in_window(points: Points, window: tuple[float, float]) -> ndarray:
    """Return which points are steps of a window of ln slope, its edges included.

    Returns
    -------
    ndarray of bool, shape (n,)
    """
    q = points.log_slope
    return np.asarray(
        points.walks & (q >= window[0] - _EDGE) & (q <= window[1] + _EDGE)
    )


def roles(points: Points, window: tuple[float, float]) -> dict[str, ndarray]:
    """Return which points may be the extremes of which quantity within a window.

    Parameters
    ----------
    points : Points
    window : (float, float)
        Least and largest ln slope.

    Returns
    -------
    dict of ndarray of bool, shape (n,)
        Of the `smallest_slope` of a long or stable gait, the `largest_stable_slope`,
        the `fastest_stable_speed` and the `least_cost` of transport at a speed, and
        that of stable gaits.
    """
    kind, inside = points.kind, in_window(points, window)
    low = inside | (points.walks & (kind == ANY_SLOPE))
    stable = inside & points.stable
    every = {
        SMALLEST_SLOPE: low & (points.long | points.stable),
        LARGEST_STABLE_SLOPE: stable,
        FASTEST_STABLE_SPEED: stable,
        COSTS[0]: inside,
        COSTS[1]: stable,
    }
    return {name: which & may_be(name, kind) for name, which in every.items()}


def values(name: str, log_slope: LogSlopes, log_froude: PerLane) -> ndarray:
    """Return a number that is least where a quantity has its extreme: a logarithm, or
    minus one.

    Parameters
    ----------
    name : str
        Of the quantity.
    log_slope, log_froude : ndarray

    Returns
    -------
    ndarray
    """
    if name == FASTEST_STABLE_SPEED:
        return -log_froude
    return -log_slope if name == LARGEST_STABLE_SLOPE else log_slope


def best(points: Points, lines: int, window: tuple[float, float]) -> dict[str, ndarray]:
    """Find the points at which quantities reach their extremes within a window.

    Parameters
    ----------
    points : Points
    lines : int
        Number of lines.
    window : (float, float)
        Least and largest ln slope.

    Returns
    -------
    dict of ndarray of int, shape (lines,)
        Numbers of points by the quantities of `roles`, -1 where there is none.
    """
    lowest = np.where(points.kind == ANY_SLOPE, -np.inf, points.log_slope)
    out = {}
    for name, which in roles(points, window).items():
        number, value = np.flatnonzero(which), values(name, lowest, points.log_froude)
        order = number[np.lexsort((value[number], points.line[number]))]
        line, first = np.unique(points.line[order], return_index=True)
        out[name] = np.full(lines, -1)
        out[name][line] = order[first]

    return out


@np.errstate(invalid="ignore", divide="ignore")
def classify(
    kind: str,
    at: Evaluation,
    line: ndarray,
    Z: Coordinates,
    rows: Coordinates,
    error: PerLane,
    walks: Marks,
) -> Points:
    """Describe located points of one kind.

    Parameters
    ----------
    kind : str
    at : Evaluation
        Of steps next to the points.
    line : ndarray of int, shape (n,)
    Z, rows : ndarray, shape (c, n)
    error : ndarray, shape (n,)
    walks : ndarray of bool, shape (n,)
    """
    radius = foot_radius(at.problem)
    return Points(
        line=line,
        kind=np.full(len(line), kind, "U32"),
        Z=Z,
        rows=rows,
        error=error,
        log_froude=log_froude(Z, radius),
        speed_error=total(np.abs(log_froude_by_Z(Z, radius))) * error + 8 * EPS,
        walks=walks,
        long=(gait_ratio(at.stride) < LONG_BELOW) | (kind == "label"),
        stable=other_multipliers(kind, at.stride.jacobian) < _STABLE,
        faster=np.zeros(len(line), bool),
    )


def find(
    problem: Lanes, surveyed: Sequence[Sequence[Branch]], sought: Sought
) -> Points:
    """Locate the points of lines at which slope, stability or speed may reach their
    extremes.

    Parameters
    ----------
    problem : Lanes
        With a lane for each line.
    surveyed : sequence of sequence of Branch
        The branches of each.
    sought : Sought
        A speed is in the walkers' units.
    """
    if not any(surveyed):
        return nothing(problem)

    window, log_speed = sought
    conditions = [CONDITIONS[name] for name, kind in KINDS.items() if kind.is_sought]
    if log_speed is not None:
        conditions.append(CONDITIONS["speed"].equal_to(log_speed))

    nodes = Nodes(problem, surveyed, conditions)
    guesses = [
        guess_passings(problem, nodes, each, each.kind.is_of_stable_gaits)
        for each in conditions
    ]
    guesses += [_at_edge(nodes, edge) for edge in window]
    guesses += _turns_and_ends(nodes, are_tuned(problem.every_walker), window[0])

    parts = [_located(problem, nodes, each) for each in guesses if len(each.node)]
    points: Points = join_lanes(parts)
    return points


def _at_edge(nodes: Nodes, edge: float) -> Guesses:
    """Where branches cross the edge of the window."""
    node = [np.zeros(0, int)]
    Z = [np.zeros((len(nodes.Z), 0))]
    for first, branch in zip(nodes.first.tolist(), nodes.branches, strict=True):
        for _, crossing, segment in branch.guesses(np.array([edge])):
            node.append(first + segment)
            Z.append(crossing)

    condition = CONDITIONS["window"].equal_to(edge)

    return Guesses(
        condition.name, condition, np.concatenate(node), np.concatenate(Z, axis=1)
    )


def _turns_and_ends(nodes: Nodes, tuned: ndarray, low: float) -> list[Guesses]:
    """The folds and the ends of the branches, which are nodes.

    `tuned` says of each line whether its walker is; `low` is the least ln slope of the
    window.
    """
    by_kind: dict[str, list[int]] = {}
    for first, branch in zip(nodes.first.tolist(), nodes.branches, strict=True):
        for kind, node, _ in turns_and_ends(branch):
            is_end = not kind_of(kind).turns_slope
            vanishes = is_end and branch.q[node] <= np.log(_VANISHING)
            is_any = vanishes and tuned[nodes.line[first]] and branch.q.max() >= low
            if is_any or not kind_of(kind).is_edge:
                named = ANY_SLOPE if is_any else kind
                by_kind.setdefault(named, []).append(first + node)

    return [
        Guesses(
            kind,
            CONDITIONS[kind] if is_located(kind) else None,
            np.array(numbers, int),
            nodes.Z[:, numbers],
        )
        for kind, numbers in sorted(by_kind.items())
    ]


def _located(problem: Lanes, nodes: Nodes, guesses: Guesses) -> Points:
    """Solve for points of one kind, or take them as nodes where no condition defines
    them.
    """
    node = guesses.node
    line, inner = nodes.line[node], nodes.inner(node)
    of_lines = problem.some(line)
    # An end is itself a node; its neighbour shows whether its gaits are steps.
    is_end = guesses.condition is None or guesses.condition.walking != 0
    walks = nodes.walks[inner] if is_end else nodes.walks[node] | nodes.walks[inner]

    if guesses.condition is None:
        at = evaluate(of_lines, guesses.Z)
        no_rows = np.full_like(guesses.Z, np.nan)
        error = _UNSOLVED + _end_errors(nodes, node)
        return classify(guesses.kind, at, line, guesses.Z, no_rows, error, walks)

    solved = locate(problem, nodes, guesses)
    at = evaluate(of_lines, solved.Z)
    walks = walks & (is_end | solved.ok)
    return classify(guesses.kind, at, line, solved.Z, solved.rows, solved.error, walks)


def _end_errors(nodes: Nodes, node: Numbers) -> ndarray:
    """Errors of ln slope at nodes that are ends of branches, shape (n,)."""
    errors = []
    for b, number in zip(nodes.branch[node], node, strict=True):
        side = int(number > nodes.first[b])
        errors.append(nodes.branches[b].end_errors[side])
    return np.array(errors)
