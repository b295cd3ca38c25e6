"""Codimension-two points: where a curve of one condition, in two of slope and keys,
fulfils another one too, or where two keys at a fixed slope do.

Along the curve the other condition's scalar changes sign; Newton's method on both
conditions leads to the point. A cusp, which has no scalar of its own, is where both of a
curve of folds turn at once. Names and conditions are those of Y. A. Kuznetsov,
Elements of Applied Bifurcation Theory, chapter 9. In shapes, u counts unknowns X, p the
points of a curve.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy import ndarray

from gaitsweep.tasks.branches.conditions import CONDITIONS, Condition
from gaitsweep.tasks.branches.curves import turning, walks
from gaitsweep.tasks.branches.equations import Equations, errors, solve
from gaitsweep.tasks.branches.root import hermite
from gaitsweep.tasks.mechanics.arrays import Gait
from gaitsweep.tasks.step.problem import EPS

CUSP = "cusp"
#: Conditions that every curve may meet, besides those that a study follows.
_ALWAYS = ("fold", "flip", "neimark_sacker", "end_tangential_heelstrike")
_WITH_KNEES = ("end_kneestrike_at_heelstrike", "end_tangential_kneestrike")
#: Names of meetings whose multipliers coincide.
_NAMES = {
    frozenset({"fold", "flip"}): "fold-flip",
    frozenset({"fold", "neimark_sacker"}): "resonance 1:1",
    frozenset({"flip", "neimark_sacker"}): "resonance 1:2",
}
#: Where heelstrike is tangential the map has no derivative, and no multipliers.
_WITHOUT_MULTIPLIERS = [
    {"end_tangential_heelstrike", kind} for kind in ("flip", "neimark_sacker")
]
#: Multiplier that is double at a resonance with a pair on the unit circle.
_DOUBLE = {"fold": 1.0, "flip": -1.0}
#: How nearly a double multiplier is computed: the root of its rounding, and of the error
#: of what is located.
_SAME_MULTIPLIER = 1e-4
#: Parts of a segment of a curve in which a change of sign is looked for.
_PARTS = 4
#: Distance from the change of sign within which the point lies, over the segment; and
#: that of the turnings of slope and key at a cusp, over a range.
_NEAR, _SAME_TURNING = 1.0, 1e-6


@dataclass(frozen=True)
class Meeting:
    """A point of a curve at which another condition is fulfilled.

    Attributes
    ----------
    name : str
        Of the codimension-two point.
    meets : str
        The other condition; of a cusp, empty.
    X : ndarray, shape (u,)
    error : ndarray, shape (2,)
        Bounds on the errors of its last two unknowns: ln slope and a key, or two keys.
    """

    name: str
    meets: str
    X: Gait
    error: ndarray


def met(conditions: Mapping[str, Condition], has_knees: bool) -> dict[str, Condition]:
    """Return the conditions that curves of a walker may meet, by their names: those
    given, and all that any curve may meet.
    """
    names = _ALWAYS + _WITH_KNEES * has_knees
    return {name: CONDITIONS[name] for name in names} | dict(conditions)


class Turning(NamedTuple):
    """Where one of a curve's last two unknowns turns.

    Attributes
    ----------
    segment : int
        Number of the point before it.
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
    turned = []
    for component in (-1, -2):
        along = itertools.pairwise(zip(points, tangents, strict=True))
        for segment, (a, b) in enumerate(along):
            found = turning(equations, a, b, component)
            if found is not None:
                turned.append(Turning(segment, component, *found))

    (own,) = equations.conditions
    if own.name != "fold":
        return turned, []
    at_once = [
        (one, other)
        for one, other in itertools.combinations(turned, 2)
        if one.segment == other.segment
        and np.linalg.norm(one.X - other.X) <= _SAME_TURNING
    ]
    both = {id(each) for pair in at_once for each in pair}
    alone = [each for each in turned if id(each) not in both]
    return alone, [_cusp(*pair) for pair in at_once]


def _cusp(of_last: Turning, of_other: Turning) -> Meeting:
    """The cusp at which both unknowns turn."""
    X = of_other.X
    apart = np.abs(X - of_last.X)[-2:]
    error = max(of_last.error, of_other.error)
    return Meeting(CUSP, "", X, apart + error + 8 * EPS)


def meetings(
    equations: Equations,
    points: ndarray,
    tangents: ndarray,
    kind: str,
    others: Mapping[str, Condition],
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
        Conditions that it may meet, by their names; its own is passed over.

    Notes
    -----
    Two roads: the other condition's curve has the same point.
    """
    (own,) = equations.conditions
    samples, lengths = _between(points, tangents)
    at = equations.evaluate(samples)
    for name, other in others.items():
        if other.value is own.value or {own.name, name} in _WITHOUT_MULTIPLIERS:
            continue
        off = other.residual(at)
        both = equations.having([own, other])
        for k in np.flatnonzero(off[1:] * off[:-1] < 0).tolist():
            share = off[k] / (off[k] - off[k + 1])
            guess = samples[:, k] + share * (samples[:, k + 1] - samples[:, k])
            found = _solved(both, guess, lengths[k // _PARTS])
            if found is not None:
                named = _name((kind, name), both, found)
                if named:
                    yield Meeting(named, name, found, errors(both, found, 2))


def _between(points: ndarray, tangents: ndarray) -> tuple[ndarray, ndarray]:
    """Points (u, 4 (p - 1) + 1) along a curve, and the lengths (p - 1,) of its
    segments.
    """
    lengths = np.linalg.norm(np.diff(points, axis=0), axis=1)
    along = list(zip(points, tangents, strict=True))
    shares = np.arange(_PARTS) / _PARTS
    samples = [
        hermite(a, b, length, share)
        for (a, b), length in zip(itertools.pairwise(along), lengths, strict=True)
        for share in shares
    ]
    return np.array([*samples, points[-1]]).T, lengths


def _solved(both: Equations, guess: Gait, length: float) -> Gait | None:
    """The point near a guess (u,) that fulfils both conditions and walks; None where
    there is none, as where a scalar changes its sign at a pole.
    """
    found = solve(both, guess[:, None])
    X = found.Z[:, 0]
    is_near = np.linalg.norm(X - guess) < _NEAR * length
    if not found.ok[0] or not is_near or not walks(both, X):
        return None
    return np.asarray(X)


def _name(names: Sequence[str], both: Equations, X: Gait) -> str:
    """Name of the point at which two conditions of these names are fulfilled; empty where
    a pair of multipliers is real and no resonance, which is no bifurcation.
    """
    if "neimark_sacker" in names:
        (other,) = set(names) - {"neimark_sacker"}
        multipliers = both.evaluate(X[:, None]).multipliers[0]
        if other in _DOUBLE:
            off = np.sort(np.abs(multipliers - _DOUBLE[other]))
            if off[1] < _SAME_MULTIPLIER:
                return _NAMES[frozenset(names)]
        if np.abs(multipliers.imag).max() < _SAME_MULTIPLIER:
            return ""
        return f"{other} and neimark_sacker"
    return _NAMES.get(frozenset(names), " and ".join(sorted(names)))
