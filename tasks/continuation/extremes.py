"""Points of a line's branches at which slope, stability or speed reach their extremes.

The smallest slope, the largest slope of a stable gait and the largest speed of one are
reached where a branch turns or ends, where a multiplier leaves the unit circle, where
the speed is stationary, or at the border of a window. Each of these solves defining
equations (`tasks.continuation.defining`), by which it is located, whatever led to it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from gaitsweep.tasks.continuation.branch import Branch
from gaitsweep.tasks.continuation.defining import (
    SCALARS,
    foot_radius,
    log_froude,
    log_froude_by_Z,
    scalar,
    solve,
)
from gaitsweep.tasks.continuation.joint import Evaluation, evaluate
from gaitsweep.tasks.continuation.special_points import turns_and_ends
from gaitsweep.tasks.fixed_points.multipliers import multipliers, other_multipliers
from gaitsweep.tasks.fixed_points.step_check import LONG_BELOW, gait_ratio
from gaitsweep.tasks.mechanics.sums import total
from gaitsweep.tasks.step.lanes import join_lanes
from gaitsweep.tasks.step.problem import EPS, Lanes
from gaitsweep.tasks.walkers.statics import are_tuned

#: Parts of a segment at whose ends a scalar is evaluated before Newton's method begins.
_PARTS = 8
_BLOCK = 4096
#: Value of a scalar of stability at a node beside which it may change its sign twice.
_NEAR_ZERO = 0.3
#: A special point is at an end of stability if the magnitudes of its other multipliers
#: are below this.
_STABLE = 1 - 1e-9
#: Kind of a point from which a tuned walker's branch continues to vanishing slopes: an
#: end below such a slope [rad].
ANY_SLOPE, _VANISHING = "any slope", 1e-12


#: Kinds of points at which a quantity has no extreme.
_NOT_OF = {
    "smallest_slope": ("flip", "neimark_sacker", "fastest", "speed"),
    "largest_stable_slope": ("label", "fastest", "speed"),
    "fastest_stable_speed": ("label", "speed", ANY_SLOPE),
}
#: Costs are of the points that have the speed asked for: of all, and of the stable
#: ones.
COSTS = ("least_cost", "least_stable_cost")
QUANTITIES = (*_NOT_OF, *COSTS)
#: Distance up to which a located point is the one guessed, or lies on its branch's
#: polynomials.
_NEAR = 1e-2
#: How far outside the window its own edges may lie, in ln slope.
_EDGE = 1e-9


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
        Of SCALARS, another end of walking, or ANY_SLOPE.
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

    line: np.ndarray
    kind: np.ndarray
    Z: np.ndarray
    rows: np.ndarray
    error: np.ndarray
    log_froude: np.ndarray
    speed_error: np.ndarray
    walks: np.ndarray
    long: np.ndarray
    stable: np.ndarray
    faster: np.ndarray

    @property
    def log_slope(self) -> np.ndarray:
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


def may_be(name: str, kind: np.ndarray) -> np.ndarray:
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
    return kind == "speed" if name in COSTS else ~np.isin(kind, _NOT_OF[name])


def in_window(points: Points, window: tuple[float, float]) -> np.ndarray:
    """Return which points are steps of a window of ln slope, its edges included.

    Returns
    -------
    ndarray of bool, shape (n,)
    """
    q = points.log_slope
    return np.asarray(
        points.walks & (q >= window[0] - _EDGE) & (q <= window[1] + _EDGE)
    )


def roles(points: Points, window: tuple[float, float]) -> dict[str, np.ndarray]:
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
        "smallest_slope": low & (points.long | points.stable),
        "largest_stable_slope": stable,
        "fastest_stable_speed": stable,
        "least_cost": inside,
        "least_stable_cost": stable,
    }
    return {name: which & may_be(name, kind) for name, which in every.items()}


def values(name: str, log_slope: np.ndarray, log_froude: np.ndarray) -> np.ndarray:
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
    if name == "fastest_stable_speed":
        return -log_froude
    return -log_slope if name == "largest_stable_slope" else log_slope


def best(
    points: Points, lines: int, window: tuple[float, float]
) -> dict[str, np.ndarray]:
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
    line: np.ndarray,
    Z: np.ndarray,
    rows: np.ndarray,
    error: np.ndarray,
    walks: np.ndarray,
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


class _Nodes:
    """Nodes of all branches of several lines, one after another, and the values of
    scalars there.
    """

    def __init__(
        self,
        problem: Lanes,
        surveyed: Sequence[Sequence[Branch]],
        targets: Mapping[str, float],
    ):
        self.branches = [branch for branches in surveyed for branch in branches]
        lines = [i for i, branches in enumerate(surveyed) for _ in branches]
        lengths = [len(branch.q) for branch in self.branches]
        self.line, self.branch = (
            np.repeat(lines, lengths),
            np.repeat(np.arange(len(lines)), lengths),
        )
        self.first = np.cumsum([0, *lengths])[:-1]
        self.Z = np.hstack([branch.Z for branch in self.branches])
        self.values = {"label": self.of_nodes("ratio") - LONG_BELOW}
        self.walks = self.of_nodes("leg_passes") == 1
        radius, kinds = (
            np.full(len(self.line), np.nan),
            ("flip", "neimark_sacker", "fastest", *targets),
        )
        self.values |= {kind: np.full(len(self.line), np.nan) for kind in kinds}
        for k in range(0, len(self.line), _BLOCK):
            part = slice(k, k + _BLOCK)
            at = evaluate(problem.some(self.line[part]), self.Z[:, part])
            radius[part] = np.abs(multipliers(at.stride.jacobian, problem.m)[:, 0])
            for kind in kinds:
                self.values[kind][part] = scalar(kind, at, targets.get(kind, 0.0))
        self.stable = (radius < 1) & self.walks

    def of_nodes(self, name: str) -> np.ndarray:
        """An attribute of the branches at their nodes."""
        return np.concatenate([getattr(branch, name) for branch in self.branches])

    def evaluate(self, node: np.ndarray, share: np.ndarray) -> np.ndarray:
        """Points (c, n) of the branches' polynomials at shares of the segments after
        some nodes.
        """
        Z = np.zeros((len(self.Z), len(node)))
        for b in np.unique(self.branch[node]).tolist():
            which = np.flatnonzero(self.branch[node] == b)
            Z[:, which] = self.branches[b].at(
                node[which] - self.first[b] + share[which]
            )
        return Z


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
    targets = {} if log_speed is None else {"speed": log_speed}
    nodes = _Nodes(problem, surveyed, targets)
    guesses = [
        _crossings(problem, nodes, kind, targets.get(kind, 0.0))
        for kind in nodes.values
    ]
    guesses += [_at_edge(nodes, edge) for edge in window]
    guesses += _turns_and_ends(nodes, are_tuned(problem.every_walker), window[0])
    parts = [_located(problem, nodes, *guess) for guess in guesses if len(guess[1])]
    points: Points = join_lanes(parts)
    return points


def _crossings(
    problem: Lanes, nodes: _Nodes, kind: str, target: float
) -> tuple[str, np.ndarray, np.ndarray, np.ndarray]:
    """Kind, nodes before, guesses (c, n) and targets of the points where a scalar
    changes its sign on a segment.
    """
    values = nodes.values[kind]
    a, b = values[:-1], values[1:]
    joined = nodes.branch[1:] == nodes.branch[:-1]
    changes = (np.sign(a) != np.sign(b)) & np.isfinite(a) & np.isfinite(b) & joined
    if kind in ("flip", "neimark_sacker", "fastest"):
        changes &= nodes.stable[1:] | nodes.stable[:-1]
    if kind in ("flip", "neimark_sacker"):
        # Between nodes it may change twice: beside one where it comes near zero.
        least = (
            (np.abs(a[:-1]) >= np.abs(b[:-1]))
            & (np.abs(b[:-1]) <= np.abs(b[1:]))
            & joined[:-1]
            & joined[1:]
        )
        least &= np.abs(b[:-1]) < _NEAR_ZERO
        changes[:-1] |= least
        changes[1:] |= least
    node = np.flatnonzero(changes)
    n, shares = len(node), np.linspace(0, 1, _PARTS + 1)
    every, share = np.repeat(node, _PARTS - 1), np.tile(shares[1:-1], n)
    lines, Z = nodes.line[every], nodes.evaluate(every, share)
    between = np.zeros(0)
    for k in range(0, len(every), _BLOCK):
        part = slice(k, k + _BLOCK)
        at = evaluate(problem.some(lines[part]), Z[:, part])
        between = np.append(between, scalar(kind, at, target))
    g = np.column_stack([a[node], between.reshape(n, _PARTS - 1), b[node]])
    i, share = _roots(g)
    node = node[i]
    return kind, node, nodes.evaluate(node, share), np.full(len(node), target)


@np.errstate(invalid="ignore", divide="ignore")
def _roots(g: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows and places, as shares of a row, of the roots of functions that have values g
    (n, p) at equal distances.

    Between values of one sign two roots are those of the parabola through three of
    them.
    """
    i, j = np.nonzero(g[:, :-1] * g[:, 1:] <= 0)
    share = j + np.nan_to_num(g[i, j] / (g[i, j] - g[i, j + 1]))
    a, b, c = g[:, :-2], g[:, 1:-1], g[:, 2:]
    slope, bend = 0.5 * (c - a), 0.5 * (a + c) - b
    root = np.sqrt(slope**2 - 4 * bend * b)
    least = (
        (a * b > 0)
        & (b * c > 0)
        & np.isfinite(root)
        & (np.abs(slope) + root <= np.abs(2 * bend))
        & (bend != 0)
    )
    k, l = np.nonzero(least)
    pair = [l + 1 + (-slope + sign * root)[k, l] / (2 * bend[k, l]) for sign in (-1, 1)]
    return np.concatenate([i, k, k]), np.concatenate([share, *pair]) / (g.shape[1] - 1)


def _at_edge(
    nodes: _Nodes, edge: float
) -> tuple[str, np.ndarray, np.ndarray, np.ndarray]:
    """The points at which branches cross the edge of the window."""
    node, Z = [np.zeros(0, int)], [np.zeros((len(nodes.Z), 0))]
    for first, branch in zip(nodes.first.tolist(), nodes.branches, strict=True):
        for _, crossing, segment in branch.guesses(np.array([edge])):
            node.append(first + segment)
            Z.append(crossing)
    every = np.concatenate(node)
    return "window", every, np.concatenate(Z, axis=1), np.full(len(every), edge)


def _turns_and_ends(
    nodes: _Nodes, tuned: np.ndarray, low: float
) -> list[tuple[str, np.ndarray, np.ndarray, np.ndarray]]:
    """The folds and the ends of the branches, which are nodes.

    `tuned` says of each line whether its walker is; `low` is the least ln slope of the
    window.
    """
    by_kind: dict[str, list[int]] = {}
    for first, branch in zip(nodes.first.tolist(), nodes.branches, strict=True):
        for kind, node, _ in turns_and_ends(branch):
            vanishes = kind != "fold" and branch.q[node] <= np.log(_VANISHING)
            is_any = vanishes and tuned[nodes.line[first]] and branch.q.max() >= low
            by_kind.setdefault(ANY_SLOPE if is_any else kind, []).append(first + node)
    return [
        (kind, np.array(numbers, int), nodes.Z[:, numbers], np.zeros(len(numbers)))
        for kind, numbers in sorted(by_kind.items())
        if kind != "window"
    ]


def _located(
    problem: Lanes,
    nodes: _Nodes,
    kind: str,
    node: np.ndarray,
    guess: np.ndarray,
    target: np.ndarray,
) -> Points:
    """Solve the defining equations of points of one kind, or take them as nodes where
    they have none.
    """
    line = nodes.line[node]
    own = problem.some(line)
    is_end = kind not in SCALARS or kind.startswith("end_")
    # An end is itself a node; its neighbour shows whether its gaits are steps.
    inner = np.where(
        np.append(nodes.branch, -1)[node + 1] == nodes.branch[node], node + 1, node - 1
    )
    walks = nodes.walks[inner] if is_end else nodes.walks[node] | nodes.walks[inner]
    if kind in SCALARS:
        solved = solve(own, kind, guess, target)
        # Where a scalar is far from linear, Newton's steps are long: they may lead
        # along the branch, but not off it.
        far = solved.ok & (np.abs(solved.Z - guess).max(axis=0) > _NEAR)
        off = [
            i
            for i in np.flatnonzero(far)
            if not _lies_on(nodes.branches[nodes.branch[node[i]]], solved.Z[:, i])
        ]
        solved.ok[off], solved.Z[:, off] = False, guess[:, off]
        at = evaluate(own, solved.Z)
        return classify(
            kind,
            at,
            line,
            solved.Z,
            solved.rows,
            solved.error,
            walks & (is_end | solved.ok),
        )
    at, branch = evaluate(own, guess), nodes.branch[node]
    located = [
        nodes.branches[b].end_errors[int(n > nodes.first[b])]
        for b, n in zip(branch, node, strict=True)
    ]
    return classify(
        kind,
        at,
        line,
        guess,
        np.full_like(guess, np.nan),
        1e-9 + np.array(located),
        walks,
    )


def _lies_on(branch: Branch, Z: np.ndarray) -> bool:
    """Whether a point (c,) lies on a branch."""
    return any(
        np.abs(on[:, 0] - Z).max() < _NEAR for _, on, _ in branch.guesses(Z[-1:])
    )
