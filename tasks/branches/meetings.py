"""Codimension-two points: where a curve of one condition, in two of slope and keys,
fulfils another one too, or where two keys at a fixed slope do.

Along the curve the other condition's scalar changes sign; Newton's method on both
conditions leads to the point. A cusp, which has no scalar of its own, is where both of a
curve of folds turn at once; where a coefficient of a normal form vanishes is found in
`tasks.branches.degenerate_forms`. Names and conditions are those of Y. A. Kuznetsov,
Elements of Applied Bifurcation Theory, chapter 9. In shapes, u counts unknowns X, p the
points of a curve.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy import ndarray

from gaitsweep.tasks.branches.conditions import CONDITIONS, DEGENERATE, Condition
from gaitsweep.tasks.branches.curves import (
    AT_BORDER,
    follow_both_directions,
    turning,
    walks,
)
from gaitsweep.tasks.branches.degenerate_forms import (
    UNKNOWN,
    Bounded,
    bounded,
    degeneracies,
)
from gaitsweep.tasks.branches.equations import Equations, errors, solve
from gaitsweep.tasks.branches.pseudo_arclength import CLOSED, Point
from gaitsweep.tasks.branches.root import hermite, nearest_to_zero
from gaitsweep.tasks.contract.kinds import kind_of
from gaitsweep.tasks.mechanics.arrays import Gait, Numbers
from gaitsweep.tasks.step.problem import EPS
from gaitsweep.tasks.step.sameness import SAME_GAIT, same

CUSP = "cusp"
#: Names of meetings whose multipliers coincide: beyond the resonances among them the
#: pair of a curve of Neimark-Sacker points is real.
_NAMES = {
    frozenset({"fold", "flip"}): "fold-flip",
    frozenset({"fold", "neimark_sacker"}): "resonance 1:1",
    frozenset({"flip", "neimark_sacker"}): "resonance 1:2",
}
_RESONANCES = tuple(name for name in _NAMES.values() if name.startswith("resonance"))
#: How nearly a double multiplier is computed: the root of its rounding, and of the error
#: of what is located.
_SAME_MULTIPLIER = 1e-4
#: Parts of a segment of a curve in which a change of sign is looked for, and how often
#: samples are added where a scalar is nearest to zero without one.
_PARTS, _REFINEMENTS = 4, 3
#: Least distance of a sample that is added from others, over the segment.
_APART = 1e-6
#: Difference of a scalar from its target that is rounding: over the target, and that of
#: conditions of this package, which have no units, where their target is 0.
_FULFILLED, _ROUNDING = 1e-8, 1e-12
#: Distance from the change of sign within which the point lies, over the segment; and
#: that of the turnings of slope and key at a cusp, over a range.
_NEAR, _SAME_TURNING = 1.0, 1e-6
#: Why a curve is followed no further where its kind's multipliers are others beyond, and
#: no resonance was found.
_OTHER_MULTIPLIERS = "multipliers"


@dataclass(frozen=True)
class Meeting:
    """A point of a curve at which another condition is fulfilled.

    Attributes
    ----------
    name : str
        Of the codimension-two point.
    meets : str
        The other condition; empty of a cusp, where that is of curves of one kind only,
        and where a coefficient vanishes.
    X : ndarray, shape (u,)
    error : ndarray, shape (2,)
        Bounds on the errors of its last two unknowns: ln slope and a key, or two keys.
    segment : int
        Number of the point before it, of those that were followed.
    """

    name: str
    meets: str
    X: Gait
    error: ndarray
    segment: int


class Turning(NamedTuple):
    """Where one of a curve's last two unknowns turns.

    Attributes
    ----------
    segment : int
        Number of the point before it, of those among which turnings were looked for.
    component : int
        -1 for the last unknown, -2 for the one before.
    X : ndarray, shape (u,)
    error : float
        As `branches.curves.turning` has it.
    """

    segment: int
    component: int
    X: Gait
    error: float


class Followed(NamedTuple):
    """A curve of a condition, and its points of higher codimension.

    Attributes
    ----------
    equations : Equations
        That hold on it.
    kind : str
        The condition's name in tables.
    points : ndarray, shape (p, u)
    bounds : list of Bounded
        What is known of each point.
    stopped : tuple of str
        Why it was followed no further at its first and at its last point.
    turnings : list of Turning
    meetings : list of Meeting
    """

    equations: Equations
    kind: str
    points: ndarray
    bounds: list[Bounded]
    stopped: tuple[str, str]
    turnings: list[Turning]
    meetings: list[Meeting]


def followed(
    equations: Equations,
    kind: str,
    first: Point,
    window: ndarray,
    others: Mapping[str, Condition],
) -> Followed:
    """Follow a curve from a point on it in both directions, and locate its turning and
    codimension-two points. A curve of complex pairs ends at the resonances beyond which
    they are real.

    Parameters
    ----------
    equations : Equations
        Of the curve, with one condition.
    kind : str
        The condition's name in tables.
    first : Point
    window : ndarray
        As for `branches.curves.follow_both_directions`.
    others : mapping
        Conditions that it may meet, by their names; its own is passed over.
    """
    points, tangents, stopped, (low, high) = _genuine(equations, first, window)
    part = slice(low, high)

    every = meetings(equations, points, tangents, kind, others, window)
    within = [each for each in every if low - 1 <= each.segment < high]
    turned, cusps = turnings(equations, points[part], tangents[part])

    known = [UNKNOWN] * len(points)
    known[part] = [bounded(equations, X) for X in points[part]]
    vanishing = degeneracies(equations, points, tangents, known)
    found = [*cusps, *within, *itertools.starmap(_vanishing, vanishing)]

    begin, end, stopped = _ends(points, low, high, stopped, within)
    at_begin = [bounded(equations, X) for X in begin]
    at_end = [bounded(equations, X) for X in end]
    known = [*at_begin, *known[part], *at_end]
    points = np.vstack([begin, points[part], end])
    return Followed(equations, kind, points, known, stopped, turned, found)


def _vanishing(name: str, X: Gait, error: ndarray, segment: int) -> Meeting:
    """The point at which a coefficient vanishes."""
    return Meeting(name, "", X, error, segment)


def _genuine(
    equations: Equations, first: Point, window: ndarray
) -> tuple[ndarray, ndarray, tuple[str, str], tuple[int, int]]:
    """A curve in both directions from a point: its points (p, u), the tangents there, why
    it was followed no further, and the first and one past the last number of those
    points about the first one that are of its kind.
    """
    points, tangents, stopped = follow_both_directions(equations, first, window)
    (own,) = equations.conditions
    if own.kind.critical != "pair":
        return points, tangents, stopped, (0, len(points))

    is_pair = _has_pair(equations, points)
    if stopped[0] == CLOSED and not is_pair.all():
        order = _opened(is_pair)
        points, tangents, is_pair = points[order], tangents[order], is_pair[order]
    place = _place_of(first.Z[:, 0], points)
    return points, tangents, stopped, _run(is_pair, place)


def _has_pair(equations: Equations, points: ndarray) -> ndarray:
    """Whether the multipliers that the curve's condition makes reciprocal are a complex
    pair, at points (p, u), shape (p,).
    """
    (own,) = equations.conditions
    assert own.is_genuine
    multipliers = equations.evaluate(points.T).multipliers
    return np.array([own.is_genuine(each) for each in multipliers])


def _place_of(X: Gait, points: ndarray) -> int:
    """Number of a point (u,) among those of a curve."""
    return int(np.linalg.norm(points - X, axis=1).argmin())


def _opened(is_pair: ndarray) -> ndarray:
    """Order of the points of a closed curve in which it begins where there is no pair."""
    begin = int(np.argmin(is_pair))
    last = len(is_pair) - 1
    return np.r_[begin:last, : begin + 1]


def _run(is_pair: ndarray, start: int) -> tuple[int, int]:
    """First, and one past the last, of the points about one that have a pair."""
    others = np.flatnonzero(~is_pair)
    before, after = others[others < start], others[others > start]
    low = int(before[-1]) + 1 if len(before) else 0
    high = int(after[0]) if len(after) else len(is_pair)
    return low, high


def _ends(
    points: ndarray,
    low: int,
    high: int,
    stopped: tuple[str, str],
    within: Sequence[Meeting],
) -> tuple[ndarray, ndarray, tuple[str, str]]:
    """The resonances at which the part of a curve from `low` to before `high` begins and
    ends, both (0, u) or (1, u), and why it was followed no further.
    """
    resonances = {each.segment: each for each in within if each.name in _RESONANCES}
    reasons = [stopped[0], stopped[1]]
    ends = [points[:0], points[:0]]
    for end, segment in ((0, low - 1), (1, high - 1)):
        if not 0 <= segment < len(points) - 1:
            continue
        reasons[end] = _OTHER_MULTIPLIERS
        if segment in resonances:
            reasons[end] = resonances[segment].name
            ends[end] = resonances[segment].X[None]

    return ends[0], ends[1], (reasons[0], reasons[1])


def met(conditions: Mapping[str, Condition], has_knees: bool) -> dict[str, Condition]:
    """Return the conditions that curves of a walker may meet, by their names: those
    given, and all that any curve may meet.
    """
    always = [
        each
        for each in CONDITIONS.values()
        if each.kind.exchanges_stability or each.kind.ends == "walking"
        if has_knees or not each.kind.needs_knee
    ]
    always.sort(key=lambda each: each.kind.needs_knee)
    return {each.name: each for each in always} | dict(conditions)


def turnings(
    equations: Equations, points: ndarray, tangents: ndarray
) -> tuple[list[Turning], list[Meeting]]:
    """Return where one of a curve's last two unknowns turns alone, the last one's first,
    and its cusps, where both turn at once if it is a curve of folds.

    Parameters
    ----------
    equations : Equations
        Of the curve, with one condition.
    points, tangents : ndarray, shape (p, u)
    """
    along = list(zip(points, tangents, strict=True))
    is_closed = np.array_equal(points[0], points[-1])
    turned = []
    for component in (-1, -2):
        signs = _signs(tangents[:, component], is_closed)
        for segment in np.flatnonzero(signs[1:] * signs[:-1] < 0).tolist():
            found = turning(equations, along[segment], along[segment + 1], component)
            if found is not None:
                turned.append(Turning(segment, component, *found))

    (own,) = equations.conditions
    if not kind_of(own.name).turns_slope:
        return turned, []

    at_once = [
        (one, other)
        for one, other in itertools.combinations(turned, 2)
        if np.linalg.norm(one.X - other.X) <= _SAME_TURNING
    ]
    both = {id(each) for pair in at_once for each in pair}
    alone = [each for each in turned if id(each) not in both]
    return alone, [_cusp(*pair) for pair in at_once]


def _signs(rates: ndarray, is_closed: bool) -> ndarray:
    """Signs of rates (p,) along a curve; those of zeros are the signs before."""
    signs = np.sign(rates)
    others = signs[signs != 0]
    before = others[-1] if is_closed and len(others) else 0.0
    kept = itertools.accumulate(signs, lambda last, sign: sign or last, initial=before)
    return np.array([*kept][1:])


def _cusp(of_last: Turning, of_other: Turning) -> Meeting:
    """The cusp at which both unknowns turn."""
    X = of_other.X
    apart = np.abs(X - of_last.X)[-2:]
    error = max(of_last.error, of_other.error)
    return Meeting(CUSP, "", X, apart + error + 8 * EPS, of_other.segment)


def meetings(
    equations: Equations,
    points: ndarray,
    tangents: ndarray,
    kind: str,
    others: Mapping[str, Condition],
    window: ndarray,
) -> Iterator[Meeting]:
    """Yield the points at which a curve fulfils another condition, in the order of the
    conditions.

    Parameters
    ----------
    equations : Equations
        Of the curve, with one condition.
    points, tangents : ndarray, shape (p, u)
    kind : str
        Its condition's name.
    others : mapping
        Conditions that it may meet besides those that only curves of its kind do, by
        their names; its own is passed over.
    window : ndarray, shape (f, 2)
        Least and largest value of each of the f last unknowns, beyond which there may
        be no walker.

    Notes
    -----
    Two roads: the other condition's curve has the same point. On a segment at both of
    whose ends the other holds, as a spectral radius of 1 does along folds, none is met.
    """
    if len(points) < 2:  # the curve leaves its window at once
        return

    (own,) = equations.conditions
    own_names = DEGENERATE.get(own.name, {})
    curve = _Cubics(points, tangents)
    at = equations.evaluate(curve.at(curve.samples))
    for name, other in {**others, **own_names}.items():
        if other.value is own.value or _is_undefined(own.name, name):
            continue

        def residual(places: ndarray, other: Condition = other) -> ndarray:
            return other.residual(equations.evaluate(curve.at(places)))

        both = equations.having([own, other])
        solved: list[Gait] = []
        for place in _crossings(curve, other, other.residual(at), residual):
            segment = curve.segment(place)
            found = _solved(both, curve.at(place), curve.lengths[segment], window)
            if found is None or any(same(found, X, SAME_GAIT) for X in solved):
                continue

            solved.append(found)
            named = _name((kind, name), both, found)
            if named:
                error = errors(both, found, 2)
                meets = "" if named in own_names else name
                yield Meeting(named, meets, found, error, int(segment))


def _is_undefined(one: str, other: str) -> bool:
    """Whether the scalar of one of two kinds has no value at points of the other."""
    return not (kind_of(one).defines(other) and kind_of(other).defines(one))


class _Cubics:
    """Cubics through the points (p, u) of a curve; places on it count segments from its
    first point.
    """

    def __init__(self, points: ndarray, tangents: ndarray):
        self.points, self.tangents = points, tangents
        self.lengths = np.linalg.norm(np.diff(points, axis=0), axis=1)
        last = len(self.lengths)
        #: Places at which scalars are sampled.
        self.samples = np.linspace(0.0, last, _PARTS * last + 1)

    def segment(self, place: ndarray) -> Numbers:
        """Numbers of the segments in which places lie."""
        return np.minimum(place.astype(int), len(self.lengths) - 1)

    def at(self, place: ndarray) -> ndarray:
        """Points (u, ...) at places (...)."""
        k = self.segment(place)
        a = self.points[k].T, self.tangents[k].T
        b = self.points[k + 1].T, self.tangents[k + 1].T
        return hermite(a, b, self.lengths[k], place - k)


def _crossings(
    curve: _Cubics,
    condition: Condition,
    off: ndarray,
    residual: Callable[[ndarray], ndarray],
) -> ndarray:
    """Places about which a curve fulfils a condition, whose scalar is `off` (n,) from its
    target at the samples; none on segments at both of whose ends it holds: there
    rounding alone tells where.
    """
    within = _FULFILLED * np.max(np.abs(condition.target))
    if condition.name in CONDITIONS:
        within = max(within, _ROUNDING)
    vanishes = np.abs(off[::_PARTS]) <= within
    holds = vanishes[:-1] & vanishes[1:]

    places = _roots(curve.samples, off, residual)
    return np.asarray(places[~holds[curve.segment(places)]])


def _roots(
    places: ndarray, off: ndarray, residual: Callable[[ndarray], ndarray]
) -> ndarray:
    """Where a scalar vanishes along a curve, nearly: between known values `off` (n,) at
    places (n,) that differ in sign or are zero.

    Where the scalar is unknown its neighbours are compared.
    """
    places, off = _refined(places, off, residual)
    apart = off[:-1] - off[1:]
    k = np.flatnonzero((np.sign(off[1:]) * np.sign(off[:-1]) <= 0) & (apart != 0))
    share = off[k] / apart[k]
    # A sample that is zero ends two brackets.
    return np.unique(places[k] + share * np.diff(places)[k])


def _refined(
    places: ndarray, off: ndarray, residual: Callable[[ndarray], ndarray]
) -> tuple[ndarray, ndarray]:
    """Places at which a scalar is known, and its values, with more of both where it may
    have two roots between neighbours of one sign.

    These show in the parabolas through three neighbours, whose nearest points to zero
    are sampled.
    """
    places, off = _known(places, off)
    for _ in range(_REFINEMENTS):
        nearest = nearest_to_zero(places, off)
        gaps = np.abs(nearest[:, None] - places).min(axis=1, initial=np.inf)
        nearest = np.unique(nearest[gaps > _APART])
        if not len(nearest):
            break

        places = np.append(places, nearest)
        off = np.append(off, residual(nearest))
        order = np.argsort(places)
        places, off = _known(places[order], off[order])

    return places, off


def _known(places: ndarray, off: ndarray) -> tuple[ndarray, ndarray]:
    """Places at which a scalar is known, and its values."""
    is_known = np.isfinite(off)
    return places[is_known], off[is_known]


def _solved(
    both: Equations, guess: Gait, length: float, window: ndarray
) -> Gait | None:
    """The point near a guess (u,) that fulfils both conditions and walks, in a window of
    its last unknowns; None where there is none, as where a scalar changes its sign at a
    pole.
    """
    found = solve(both, guess[:, None])
    X = np.array(found.Z[:, 0])
    is_near = np.linalg.norm(X - guess) < _NEAR * length
    last = X[-len(window) :]
    inside = np.clip(last, *window.T)
    is_inside = np.abs(last - inside).max() <= AT_BORDER
    if not found.ok[0] or not is_near or not is_inside:
        return None

    last[:] = inside
    return X if walks(both, X) else None


def _name(names: Sequence[str], both: Equations, X: Gait) -> str:
    """Name of the point at which two conditions of these names are fulfilled; empty where
    a pair of multipliers is real and no resonance, which is no bifurcation.
    """
    pairs = [name for name in names if kind_of(name).critical == "pair"]
    if not pairs:
        return _NAMES.get(frozenset(names), " and ".join(sorted(names)))

    (pair,) = pairs
    (other,) = set(names) - {pair}
    if other in DEGENERATE[pair]:
        return other

    multipliers = both.evaluate(X[:, None]).multipliers[0]
    # At a resonance the pair is one multiplier that is double.
    double = kind_of(other).critical
    if isinstance(double, float):
        off = np.sort(np.abs(multipliers - double))
        if off[1] < _SAME_MULTIPLIER:
            return _NAMES[frozenset(names)]

    if np.abs(multipliers.imag).max() < _SAME_MULTIPLIER:
        return ""

    return f"{other} and {pair}"
