"""Special points of a branch: where a condition is fulfilled along it, evaluated at
corrected points.

Folds, flips, Neimark-Sacker and branch points; the ends of walking, where heelstrike
meets kneestrike, heelstrike turns tangential or an earlier strike occurs; and the
hyperextension of the released knee, beyond which the branch continues.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy import ndarray

from gaitsweep.tasks.branches.branch import LOST, Branch
from gaitsweep.tasks.branches.conditions import (
    CONDITIONS,
    Condition,
    is_located,
)
from gaitsweep.tasks.branches.equations import slope_error
from gaitsweep.tasks.branches.joint import Evaluation, evaluate
from gaitsweep.tasks.branches.lockstep import side_by_side
from gaitsweep.tasks.branches.passings import Nodes, guess_passings, locate
from gaitsweep.tasks.branches.pseudo_arclength import Point
from gaitsweep.tasks.branches.segment import locate_root
from gaitsweep.tasks.branches.tracking import branch_point_determinant, correct
from gaitsweep.tasks.contract.kinds import KINDS, kind_of
from gaitsweep.tasks.gaits.rounding import rounding
from gaitsweep.tasks.step.lanes import lanes_of
from gaitsweep.tasks.step.problem import EPS, Problem
from gaitsweep.tasks.step.sameness import SAME_GAIT, same
from gaitsweep.tasks.step.several_steps import from_largest

#: Rates at the start of a step.
RATES = ("stance_rate", "thigh_rate", "shank_rate")
#: Height of the foot at kneestrike, in angles of order one, that is rounding.
_ON_GROUND = 1e-12
#: Share of a segment by which rounding moves a point beyond its node.
_AT_NODE = 1e-9
#: Error of points where branches cross: beside these two solutions lie so near each
#: other that doubles tell them apart to the root of their rounding.
_AT_CROSSING = (64 * EPS) ** 0.5
#: Points from which the slope of vanishing steps is extrapolated, and how far they
#: reach, over the first's distance.
_EXTRAPOLATION_POINTS, _EXTRAPOLATION_SPAN = 10, 3.0
#: Change of the logarithm of rates over the angle with that of the angle below which
#: both vanish alike.
_ALIKE = 1e-3


# Where heelstrike is tangential to the last digit the map has no derivative.
@np.errstate(invalid="ignore")
def special_points(problem: Problem, branch: Branch) -> list[dict[str, Any]]:
    """Locate every special point of a branch, in order along it, its ends included.

    Returns
    -------
    list of dict
        `kind`, `slope` [rad], `stance_angle` [rad], `rates` of stance leg, thigh and
        shank [sqrt(g/leg)], `period` [sqrt(leg/g)], `error_bound` (relative, of the
        slope), the point `Z`, shape (c,), `place`: the number of its node, or a number
        between those of its neighbours; and `condition`, the name of that which it
        meets, empty without.
    """
    nodes = corrected(problem, branch)
    found = []
    for kind, node, error in turns_and_ends(branch):
        found.append(_Found(float(node), kind, nodes, node, error))
    found += _found_between(problem, branch, nodes)

    records = []
    for each in sorted(found, key=lambda each: each.place):
        error = _error(each.kind, each.point, each.lane, each.error)
        described = record(each.kind, each.point.at, each.lane, error)
        if kind_of(each.kind).steps_vanish:
            described |= _limit_of_short_steps(branch, each.lane)
        condition = _condition(each.kind, each.point, each.lane)
        records.append({**described, "place": each.place, "condition": condition})

    return records


class _Found(NamedTuple):
    """A special point: its place along the branch, kind, the lane of the points that
    are evaluated, and an error of ln slope that is known.
    """

    place: float
    kind: str
    point: Point
    lane: int = 0
    error: float = 0.0


def _found_between(
    problem: Problem,
    branch: Branch,
    nodes: Point,
) -> Iterator[_Found]:
    """Special points that a branch passes between its nodes, kind by kind."""
    has_knees = problem.walker.knees
    kinds = [
        name
        for name, kind in KINDS.items()
        if kind.is_passed and (has_knees or not kind.needs_knee)
    ]
    conditions = [CONDITIONS[kind] for kind in kinds if kind in CONDITIONS]
    raw = Nodes(problem, [[branch]], conditions)
    for kind in kinds:
        if kind in CONDITIONS:
            points = _passings(problem, branch, raw, CONDITIONS[kind])
        else:
            points = _branch_points(problem, branch, nodes)
        for place, point in points:
            yield _Found(place, kind, point)


def turns_and_ends(branch: Branch) -> list[tuple[str, int, float]]:
    """Return the folds and the ends of a branch, which are nodes: their kinds, nodes,
    and known errors of ln slope.
    """
    found = [("fold", node, 0.0) for node in branch.turns()]
    last = len(branch.q) - 1
    ends = [*zip((0, last), branch.why, branch.end_errors, strict=True)]
    # Both ends of a closed branch are one fold.
    if branch.is_loop:
        ends = ends[:1]
    for node, why, error in ends:
        kind = "lost" if why in LOST else why
        found.append((kind, node, error))

    return found


def corrected(problem: Problem, branch: Branch) -> Point:
    """Return the nodes of a branch as points."""
    nodes = correct(problem, branch.Z, branch.direction)
    # A flip is known better than by these equations.
    for node, why in zip((0, -1), branch.why, strict=True):
        if kind_of(why).is_crossing:
            nodes.Z[:, node] = branch.Z[:, node]
    return nodes.oriented(branch.direction)


def flips(problem: Problem, branch: Branch) -> list[Evaluation]:
    """Return the flips of a branch of anthropomorphic gaits.

    Returns
    -------
    list of Evaluation
        Of one lane each.
    """
    found = passings(problem, branch, CONDITIONS["flip"])
    return [point.at for place, point in found if branch.leg_passes[int(place)] == 1]


def passings(
    problem: Problem, branch: Branch, condition: Condition
) -> list[tuple[float, Point]]:
    """Locate where a branch fulfils a condition between its nodes.

    Parameters
    ----------
    problem : Problem
        Of one walker.
    branch : Branch
    condition : Condition

    Returns
    -------
    list of (float, Point)
        Places in their order, numbers of segments plus shares of them, and the points
        there, of one lane, evaluated.
    """
    nodes = Nodes(problem, [[branch]], [condition])
    return _passings(problem, branch, nodes, condition)


def _passings(
    problem: Problem,
    branch: Branch,
    nodes: Nodes,
    condition: Condition,
) -> list[tuple[float, Point]]:
    """What `passings` returns, by the values of the condition at nodes."""
    guesses = guess_passings(problem, nodes, condition)
    if not len(guesses.node):
        return []

    solved = locate(problem, nodes, guesses)
    solved.at = evaluate(problem, solved.Z)
    share = branch.place_of(guesses.node, solved.Z) - guesses.node
    solved.ok &= (share > -_AT_NODE) & (share < 1 + _AT_NODE)
    place = guesses.node + np.clip(share, _AT_NODE, 1 - _AT_NODE)

    found: list[tuple[float, Point]] = []
    for lane in np.flatnonzero(solved.ok).tolist():
        point = lanes_of(solved, np.array([lane]))
        is_known = any(same(point.Z, other.Z, SAME_GAIT)[0] for _, other in found)
        if not is_known and _is_genuine(condition, point):
            found.append((float(place[lane]), point))

    return sorted(found, key=lambda each: each[0])


def _branch_points(
    problem: Problem, branch: Branch, nodes: Point
) -> list[tuple[float, Point]]:
    """Where branches cross: there Newton's equations are singular, and the root of their
    determinant is bracketed between nodes.
    """

    def determinant(point: Point) -> float:
        return float(branch_point_determinant(point, point.direction)[0])

    values = branch_point_determinant(nodes, nodes.direction)
    crosses = np.sign(values[1:]) != np.sign(values[:-1])
    crosses &= np.isfinite(values[1:]) & np.isfinite(values[:-1])
    # Nodes beside an end may lie on either side of it by rounding.
    for segment, end in zip((0, -1), branch.why, strict=True):
        crosses[segment] &= not kind_of(end).is_crossing

    segments = np.flatnonzero(crosses).tolist()
    searches = [locate_root(branch, segment, determinant) for segment in segments]
    points = side_by_side(problem, [0] * len(segments), searches)
    located = zip(segments, points, strict=True)

    return [
        (segment + 0.5, point)
        for segment, point in located
        if point.ok[0] and np.isfinite(point.at.jacobians).all()
    ]


def _limit_of_short_steps(branch: Branch, end: int) -> dict[str, float]:
    """Slope, with its error, at which the steps of a branch's end vanish.

    Notes
    -----
    Where the fastest rate vanishes more slowly than the angle, the slope is a smooth function of angle/rate and is
    extrapolated to zero, by Neville's scheme over Chebyshev's points; where not, the
    angle has vanished in doubles, or what drives is no slope and changes no more.
    """
    order = slice(None) if end == 0 else slice(None, None, -1)
    Z = branch.Z[:, order]
    tangent = branch.tangent[:, order]
    fastest = 1 + int(np.abs(Z[1 : branch.m, 0]).argmax())
    share = 1 / np.abs(Z[fastest])
    slope = np.exp(Z[-1])

    value = float(slope[0])
    left = abs(float(tangent[-1, 0] / tangent[0, 0]))
    count = _near_the_end(share)
    is_smooth = not _vanish_alike(Z[:, 0], tangent[:, 0], fastest)
    if is_smooth and left > EPS and count >= 2 * _EXTRAPOLATION_POINTS:
        values = _extrapolated(share[:count], slope[:count])
        value = float(values[-1])
        # Rounding, which extrapolation enlarges, may be alike in the last three: they
        # were up to 3.6 times as far off.
        left = 4 * float(np.ptp(values[-3:]) / value)

    return {"slope": value, "error_bound": 4 * left + 8 * EPS}


def _near_the_end(share: ndarray) -> int:
    """How many of the first points are extrapolated from."""
    beyond = share > _EXTRAPOLATION_SPAN * share[0]
    return int(beyond.argmax()) if beyond.any() else len(share)


def _vanish_alike(gait: ndarray, tangent: ndarray, fastest: int) -> bool:
    """Whether the fastest rate vanishes as the angle does, at a branch's last gait (c,)."""
    slower = abs(float(tangent[fastest] / gait[fastest]))
    return slower < _ALIKE * abs(float(tangent[0]))


def _extrapolated(x: ndarray, y: ndarray) -> ndarray:
    """Values at zero of polynomials of rising degree through points (n,), by Neville's
    scheme over Chebyshev's points, the first value of y before them.
    """
    angles = np.pi * np.arange(_EXTRAPOLATION_POINTS) / (_EXTRAPOLATION_POINTS - 1)
    wanted = x[0] + (x[-1] - x[0]) * (0.5 - 0.5 * np.cos(angles))
    nearest = np.unique(np.abs(x[:, None] - wanted).argmin(axis=0))

    values = [y[0]]
    x = x[nearest]
    row = y[nearest]
    for k in range(1, len(x)):
        weighted = x[k:] * row[:-1] - x[:-k] * row[1:]
        row = weighted / (x[k:] - x[:-k])
        values.append(row[0])

    return np.array(values)


def _is_genuine(condition: Condition, point: Point) -> bool:
    """Whether a root of a condition's scalar is a point of its kind."""
    jacobian = point.at.jacobians[0]
    if not np.isfinite(jacobian).all():
        return False
    if condition.is_genuine is None:
        return True
    return condition.is_genuine(np.linalg.eigvals(jacobian))


def _strikes_with_knee(point: Point, lane: int) -> bool:
    """Whether the foot is on the ground at kneestrike, where its height has a corner,
    and not in a smooth minimum.
    """
    knee = point.at.stride.one.knee
    if not len(knee):
        return False
    height = knee[0, ..., lane] + knee[1, ..., lane]
    return bool(np.abs(height).min() < _ON_GROUND)


def state_at(point: Evaluation, lane: int) -> dict[str, Any]:
    """State at the start of a point's step, of several that with the largest stance
    angle.

    Returns
    -------
    dict
        `stance_angle` [rad] and `rates` of stance leg, thigh and shank [sqrt(g/leg)].
    """
    problem = point.problem
    w = from_largest(point.w[:, [lane]], problem.m, problem.steps)
    y, scale = problem.section(w)
    state = problem.start(y * scale, np.exp(point.q[[lane]]))[:, 0].tolist()
    return {"stance_angle": state[0], "rates": tuple(state[1:])}


def _condition(kind: str, point: Point, lane: int) -> str:
    """The name of the condition that a special point meets; empty without."""
    if kind == "end_earlier_strike" and _strikes_with_knee(point, lane):
        return "foot_at_kneestrike"
    return kind if is_located(kind) and not KINDS[kind].is_edge else ""


def _error(kind: str, point: Point, lane: int, known: float) -> float:
    """Bound on the relative error of a special point's slope, of which a part is known."""
    problem = point.at.problem
    is_crossing = kind_of(kind).is_crossing
    is_flip_of_others = is_crossing and known
    condition = _condition(kind, point, lane)
    if condition:
        error = slope_error(problem, CONDITIONS[condition], point.Z[:, lane])
    elif is_flip_of_others:
        # The branch begins at it.
        error = 0.0
    else:
        rounded = rounding(point.at.stride)[:, lane]
        error = float(np.nan_to_num(rounded, nan=np.inf).max())
        if is_crossing:
            error = max(error, _AT_CROSSING)

    return known + error + 8 * EPS


def record(
    kind: str,
    point: Evaluation,
    lane: int,
    error_bound: float,
) -> dict[str, Any]:
    """Describe a special point as `special_points` does, but for its place."""
    return {
        "kind": kind,
        "slope": float(np.exp(point.q[lane])),
        **state_at(point, lane),
        "period": float(point.times[-1, lane]),
        "error_bound": error_bound,
        "Z": tuple(point.Z[:, lane].tolist()),
    }
