"""Where branches pass conditions: brackets between nodes, then Newton's method.

A condition's scalar changes its sign between two nodes where a branch passes it; of
conditions on multipliers it may do so twice, where the scalar comes near zero. Values at
parts of such segments give guesses, from which the equations of the gait and the
condition are solved.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from gaitsweep.tasks.branches.branch import Branch
from gaitsweep.tasks.branches.conditions import Condition
from gaitsweep.tasks.branches.equations import Equations, solve
from gaitsweep.tasks.branches.joint import Evaluation, evaluate
from gaitsweep.tasks.branches.pseudo_arclength import Point
from gaitsweep.tasks.mechanics.arrays import Coordinates, Gait, Numbers
from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.step.sameness import NEAR_POINT, same

#: Parts of a segment at whose ends a scalar is evaluated before Newton's method begins.
_PARTS = 8
_BLOCK = 4096
#: Value of a scalar of stability at a node beside which it may change its sign twice.
_NEAR_ZERO = 0.3


class Nodes:
    """Nodes of all branches of several lines, one after another, and how far each
    condition is from being fulfilled there.

    Parameters
    ----------
    problem : Problem
        Of one walker, or with a lane for each line.
    surveyed : sequence of sequence of Branch
        The branches of each line.
    conditions : sequence of Condition

    Attributes
    ----------
    line, branch : ndarray of int, shape (n,)
        The line and the branch of each node, counted from the first.
    first : ndarray of int, shape (branches,)
        The first node of each branch.
    Z : ndarray, shape (c, n)
    values : dict of ndarray, shape (n,)
        Residuals of the conditions, by their names.
    radius : ndarray, shape (n,)
        Largest magnitude of the multipliers.
    """

    def __init__(
        self,
        problem: Problem,
        surveyed: Sequence[Sequence[Branch]],
        conditions: Sequence[Condition],
    ):
        self.branches = list(itertools.chain(*surveyed))
        counts = [len(branches) for branches in surveyed]
        lines = np.repeat(np.arange(len(surveyed)), counts)
        lengths = [len(branch.q) for branch in self.branches]
        self.line = np.repeat(lines, lengths)
        self.branch = np.repeat(np.arange(len(lines)), lengths)
        self.first = np.cumsum([0, *lengths])[:-1]
        self.Z = np.hstack([branch.Z for branch in self.branches])

        n = len(self.line)
        self.radius = np.full(n, np.nan)
        self.values = {condition.name: np.full(n, np.nan) for condition in conditions}
        for part, at in _in_blocks(problem, self.line, self.Z):
            self.radius[part] = np.abs(at.multipliers[:, 0])
            for condition in conditions:
                self.values[condition.name][part] = condition.residual(at)

    @functools.cached_property
    def walks(self) -> ndarray:
        """Whether legs pass once, bool (n,)."""
        leg_passes = [branch.leg_passes for branch in self.branches]
        return np.concatenate(leg_passes) == 1

    @property
    def stable(self) -> ndarray:
        """Whether gaits are stable whose legs pass once, bool (n,)."""
        return (self.radius < 1) & self.walks

    def interpolate(self, node: Numbers, share: ndarray) -> ndarray:
        """Return points (c, n) of the branches' polynomials at shares of the segments
        after some nodes.
        """
        Z = np.zeros((len(self.Z), len(node)))
        for number in np.unique(self.branch[node]).tolist():
            which = np.flatnonzero(self.branch[node] == number)
            place = node[which] - self.first[number] + share[which]
            Z[:, which] = self.branches[number].at(place)
        return Z

    def inner(self, node: Numbers) -> ndarray:
        """Return neighbours (n,) of nodes: the next, or of a branch's last the one
        before.
        """
        has_next = np.append(self.branch, -1)[node + 1] == self.branch[node]
        return np.where(has_next, node + 1, node - 1)

    def branch_of(self, node: int) -> Branch:
        """Return the branch of a node."""
        return self.branches[self.branch[node]]


def _in_blocks(
    problem: Problem, line: Numbers, Z: Coordinates
) -> Iterator[tuple[slice, Evaluation]]:
    """The steps at points of lines (n,), evaluated so many at a time."""
    for begin in range(0, len(line), _BLOCK):
        part = slice(begin, begin + _BLOCK)
        yield part, evaluate(problem.some(line[part]), Z[:, part])


@dataclass
class Guesses:
    """Guesses of points of one kind.

    Attributes
    ----------
    kind : str
    condition : Condition or None
        What they fulfil; None where only the nodes themselves are known.
    node : ndarray of int, shape (n,)
        The nodes before them.
    Z : ndarray, shape (c, n)
    """

    kind: str
    condition: Condition | None
    node: Numbers
    Z: Coordinates


def guess_passings(
    problem: Problem,
    nodes: Nodes,
    condition: Condition,
    of_stable_gaits: bool = False,
) -> Guesses:
    """Return guesses of where branches pass a condition.

    Parameters
    ----------
    problem : Problem
        That of the nodes.
    nodes : Nodes
        With values of the condition.
    condition : Condition
    of_stable_gaits : bool
        Only where a gait beside it is stable.
    """
    node = _changing(nodes, condition, of_stable_gaits)
    inner_shares = np.linspace(0, 1, _PARTS + 1)[1:-1]
    before = np.repeat(node, len(inner_shares))
    Z = nodes.interpolate(before, np.tile(inner_shares, len(node)))
    between = np.zeros(len(before))
    for part, at in _in_blocks(problem, nodes.line[before], Z):
        between[part] = condition.residual(at)

    inner = between.reshape(len(node), len(inner_shares))
    at_nodes = nodes.values[condition.name]
    values = np.column_stack([at_nodes[node], inner, at_nodes[node + 1]])
    row, share = _roots(values)
    node = node[row]
    return Guesses(condition.name, condition, node, nodes.interpolate(node, share))


def _changing(nodes: Nodes, condition: Condition, of_stable_gaits: bool) -> ndarray:
    """Nodes before the segments on which a condition's scalar may pass its target."""
    values = nodes.values[condition.name]
    signs = np.sign(values)
    finite = np.isfinite(values)
    joined = nodes.branch[1:] == nodes.branch[:-1]
    changes = joined & (signs[1:] != signs[:-1])
    changes &= finite[1:] & finite[:-1]
    if of_stable_gaits:
        stable = nodes.stable
        changes &= stable[1:] | stable[:-1]

    if condition.kind.exchanges_stability:
        # Between nodes it may change twice: beside one where it comes near zero.
        least = _least_near_zero(np.abs(values))
        least &= joined[:-1] & joined[1:]
        changes[:-1] |= least
        changes[1:] |= least

    return np.flatnonzero(changes)


def _least_near_zero(size: ndarray) -> ndarray:
    """Whether magnitudes (n,) are small and no larger than their neighbours, all but the
    first and the last, shape (n - 2,).
    """
    before = size[:-2]
    inner = size[1:-1]
    after = size[2:]
    is_least = (before >= inner) & (inner <= after)
    return is_least & (inner < _NEAR_ZERO)


@np.errstate(invalid="ignore", divide="ignore")
def _roots(values: ndarray) -> tuple[ndarray, ndarray]:
    """Rows and places, as shares of a row, of the roots of functions that have values
    (n, p) at equal distances.

    Between values of one sign two roots are those of the parabola through three of
    them.
    """
    products = values[:, :-1] * values[:, 1:]
    row, left = np.nonzero(products <= 0)
    at_left = values[row, left]
    at_right = values[row, left + 1]
    share = at_left / (at_left - at_right)
    crossed = left + np.nan_to_num(share)

    also, before, after = _parabolas(values)
    rows = np.concatenate([row, also, also])
    places = np.concatenate([crossed, before, after])
    parts = values.shape[1] - 1
    return rows, places / parts


def _parabolas(values: ndarray) -> tuple[ndarray, ndarray, ndarray]:
    """Rows of functions (n, p), and the two roots of parabolas through three of their
    values of one sign, as places.
    """
    a = values[:, :-2]
    b = values[:, 1:-1]
    c = values[:, 2:]
    slope = 0.5 * (c - a)
    bend = 0.5 * (a + c) - b
    root = np.sqrt(slope**2 - 4 * bend * b)
    before = (-root - slope) / (2 * bend)
    after = (root - slope) / (2 * bend)

    is_one_sign = (a * b > 0) & (b * c > 0)
    touches = is_one_sign & np.isfinite(root)
    touches &= np.abs(slope) + root <= np.abs(2 * bend)
    touches &= bend != 0

    row, left = np.nonzero(touches)
    middle = left + 1
    return row, middle + before[touches], middle + after[touches]


def locate(problem: Problem, nodes: Nodes, guesses: Guesses) -> Point:
    """Solve for points from guesses of where branches pass a condition.

    Parameters
    ----------
    problem : Problem
        That of the nodes.
    nodes : Nodes
    guesses : Guesses
        Which have a condition.

    Returns
    -------
    Point
        Of n lanes; not `ok` where Newton's method was lost or led off the branch.
    """
    assert guesses.condition is not None
    of_lines = problem.some(nodes.line[guesses.node])
    solved = solve(Equations(of_lines, [guesses.condition]), guesses.Z)
    # Where a scalar is far from linear, Newton's steps are long: they may lead along
    # the branch, but not off it.
    is_far = solved.ok & ~same(solved.Z, guesses.Z, NEAR_POINT)
    for lane in np.flatnonzero(is_far).tolist():
        branch = nodes.branch_of(guesses.node[lane])
        if not _lies_on(branch, solved.Z[:, lane]):
            solved.ok[lane] = False
            solved.Z[:, lane] = guesses.Z[:, lane]

    return solved


def _lies_on(branch: Branch, Z: Gait) -> bool:
    """Whether a point (c,) lies on a branch."""
    on_pieces = [on[:, 0] for _, on, _ in branch.guesses(Z[-1:])]
    return any(same(on, Z, NEAR_POINT) for on in on_pieces)
