"""Where the coefficient of the normal form vanishes along a curve of flips or
Neimark-Sacker points, so that they change from super- to subcritical.

The coefficient is known with a bound on its error. Between two points of a curve at
which its sign is certain and not the same, it is sought in a bracket, which needs no
derivative of a coefficient that is itself one of third order. Names are those of
Y. A. Kuznetsov, Elements of Applied Bifurcation Theory, chapter 9.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy import ndarray

from gaitsweep.tasks.branches.equations import (
    Equations,
    correct_on_curve,
    slope_error,
)
from gaitsweep.tasks.branches.normal_forms import (
    NONE,
    NormalForm,
    has_form,
    normal_form,
)
from gaitsweep.tasks.branches.pseudo_arclength import Point
from gaitsweep.tasks.branches.root import bracketed_root, hermite, nearest_to_zero
from gaitsweep.tasks.mechanics.arrays import Gait
from gaitsweep.tasks.step.problem import EPS

#: Names of the points at which the coefficient of a kind vanishes.
_NAMES = {"flip": "generalised flip", "neimark_sacker": "Chenciner point"}
#: How many times the larger coefficient at the ends of a bracket shows a pole in it.
_AT_POLE = 10.0
#: Share of the rise along a bracket that the first distance from the root spans, in
#: errors of the coefficient there; and by how much it grows until signs are certain.
_FIRST, _GROWTH = 2.0, 2.0
#: Shares of the way to a point without a certain sign that are looked at; and of that
#: to a place at which no point is found, within a bracket.
_TOWARDS = 0.25, 0.5, 0.75, 0.875, 0.9375
_TOWARDS_LOST = 1 - 0.5 ** np.arange(1, 13)


class Bounded(NamedTuple):
    """What is known of a point of a curve: a bound on the relative error of its slope,
    and its normal form.
    """

    error: float
    form: NormalForm


#: Of points that are not of the curve's kind.
UNKNOWN = Bounded(np.inf, NONE)


class Degeneracy(NamedTuple):
    """A point at which the coefficient vanishes.

    Attributes
    ----------
    name : str
    X : ndarray, shape (u,)
    error : ndarray, shape (2,)
        Bounds on the errors of its last two unknowns.
    segment : int
        Number of the point before it.
    """

    name: str
    X: Gait
    error: ndarray
    segment: int


def bounded(equations: Equations, X: Gait) -> Bounded:
    """Return what is known of a point of a curve.

    Parameters
    ----------
    equations : Equations
        Of the curve, with one condition.
    X : ndarray, shape (u,)
    """
    (condition,) = equations.conditions
    lane = X[:, None]
    problem = equations.problem_at(lane).alone(0)
    Z, _ = equations.split(lane)
    error = slope_error(problem, condition, Z[:, 0]) + 8 * EPS
    if not has_form(condition.name):
        return Bounded(error, NONE)
    return Bounded(error, normal_form(problem, condition.name, Z[:, 0], error))


def degeneracies(
    equations: Equations,
    points: ndarray,
    tangents: ndarray,
    known: Sequence[Bounded],
) -> Iterator[Degeneracy]:
    """Yield the points at which the coefficient of a curve's normal form vanishes.

    Parameters
    ----------
    equations : Equations
        Of the curve, with one condition.
    points, tangents : ndarray, shape (p, u)
    known : sequence of Bounded
        What is known of the points.

    Notes
    -----
    Between neighbours at which the sign is certain and not the same. Besides the points
    of the curve these are some where the coefficient is nearest to zero without a change
    of sign, and some towards points at which it is not certain, as resonances at which a
    curve ends. At a pole, as beside a fold-flip or a resonance 1:3, the sign changes as
    well: there the coefficient does not become as small as its error. A place at which
    the search finds no point says neither: what the coefficient does beside it does.
    """
    (own,) = equations.conditions
    if own.name not in _NAMES:
        return

    curve = _Curve(equations, points, tangents)
    coefficients = [each.form for each in known]
    samples = [
        _Sample(float(k), X, 0.0, form)
        for k, (X, form) in enumerate(zip(points, coefficients, strict=True))
    ]
    samples += [curve.at(place) for place in _beside_uncertain(samples)]
    samples += [curve.at(place) for place in _nearest_to_zero(_certain(samples))]

    for a, b in itertools.pairwise(_certain(samples)):
        if a.sign != b.sign:
            for place, X, error in _between(curve, a, b):
                yield Degeneracy(_NAMES[own.name], X, error, int(place))


@dataclass(frozen=True)
class _Sample:
    """A point of the curve at a place, which counts segments from its first point."""

    place: float
    X: Gait
    last_step: float
    form: NormalForm

    @property
    def size(self) -> float:
        """Absolute value of the coefficient."""
        return abs(self.form.coefficient)

    @property
    def is_lost(self) -> bool:
        """Whether no point was found there, or none that has a coefficient."""
        return bool(np.isnan(self.form.coefficient))

    @property
    def sign(self) -> float:
        """Sign of the coefficient; 0 where its error leaves that open."""
        is_certain = self.size > self.form.error
        return float(np.sign(self.form.coefficient)) if is_certain else 0.0


def _certain(samples: Sequence[_Sample]) -> list[_Sample]:
    """Those samples whose sign is certain, in their order along the curve."""
    certain = [each for each in samples if each.sign]
    return sorted(certain, key=lambda each: each.place)


def _beside_uncertain(samples: Sequence[_Sample]) -> list[float]:
    """Places ever nearer to points at which the sign is not certain, from neighbours at
    which it is.
    """
    places = []
    for one, other in itertools.pairwise(samples):
        if bool(one.sign) != bool(other.sign):
            begin, end = (one, other) if one.sign else (other, one)
            length = end.place - begin.place
            places += [begin.place + length * share for share in _TOWARDS]
    return places


def _nearest_to_zero(certain: Sequence[_Sample]) -> list[float]:
    """Places at which parabolas through coefficients of one sign are nearest to zero."""
    places = np.array([each.place for each in certain])
    coefficients = np.array([each.form.coefficient for each in certain])
    return [float(place) for place in nearest_to_zero(places, coefficients)]


@dataclass(frozen=True)
class _Curve:
    """Points (p, u) of a curve with the tangents there."""

    equations: Equations
    points: ndarray
    tangents: ndarray

    def at(self, place: float) -> _Sample:
        """The point at a place; its form is `NONE` where there is no such point."""
        k = min(int(place), len(self.points) - 2)
        start = self.points[k], self.tangents[k]
        end = self.points[k + 1], self.tangents[k + 1]
        chord = end[0] - start[0]
        length = float(np.linalg.norm(chord))
        guess = hermite(start, end, length, place - k)

        point = correct_on_curve(
            self.equations, guess[:, None], chord[:, None] / length
        )
        X, last_step = point.Z[:, 0], float(point.last_step[0])
        is_of_kind = point.ok[0] and self._is_genuine(point)
        form = bounded(self.equations, X).form if is_of_kind else NONE
        return _Sample(place, X, last_step, form)

    def _is_genuine(self, point: Point) -> bool:
        """Whether the multipliers of a point are those of its kind."""
        (own,) = self.equations.conditions
        multipliers = point.at.gait.multipliers[0]
        return own.is_genuine is None or bool(own.is_genuine(multipliers))


def _between(
    curve: _Curve, a: _Sample, b: _Sample
) -> Iterator[tuple[float, Gait, ndarray]]:
    """Where the coefficient vanishes between two samples of which the sign changes: the
    place, the point, and bounds on the errors of its last two unknowns.
    """
    bracket = _Bracket(curve, a, b)
    if bracket.holds_root:
        yield bracket.root.place, *bracket.located
        return

    lost = bracket.root
    if not lost.is_lost:
        return

    beside = [
        curve.at(end.place + share * (lost.place - end.place))
        for end in (a, b)
        for share in _TOWARDS_LOST.tolist()
    ]
    certain = [*_certain([a, *beside, b])]
    for k, (c, d) in enumerate(itertools.pairwise(certain)):
        if c.sign == d.sign:
            continue
        if not c.place < lost.place < d.place:
            yield from _between(curve, c, d)
        elif _reaches_zero(certain[: k + 1], d) and _reaches_zero(certain[:k:-1], c):
            yield lost.place, (c.X + d.X) / 2, np.abs(d.X - c.X)[-2:] / 2 + 8 * EPS


def _reaches_zero(side: Sequence[_Sample], other: _Sample) -> bool:
    """Whether the chord through the last two samples of a side of a gap goes on to zero
    before the sample at its other side.
    """
    if len(side) < 2:
        return False
    before, last = side[-2:]
    change = last.form.coefficient - before.form.coefficient
    falls = change * last.form.coefficient < 0
    if not falls:
        return False
    beyond = -last.form.coefficient * (last.place - before.place) / change
    return bool(abs(beyond) <= abs(other.place - last.place))


@dataclass(frozen=True)
class _Bracket:
    """Part of a curve between two samples of which the sign changes."""

    curve: _Curve
    a: _Sample
    b: _Sample

    @cached_property
    def root(self) -> _Sample:
        """Where the sign is not certain, or the search ends: at a pole, or where no point
        is found.
        """
        largest = max(self.a.size, self.b.size)
        found = {each.place: each for each in (self.a, self.b)}

        def value(place: float) -> float:
            if place not in found:
                found[place] = self.curve.at(place)
            sample = found[place]
            is_pole = sample.size >= _AT_POLE * largest
            ends = is_pole or sample.is_lost or not sample.sign
            return 0.0 if ends else sample.form.coefficient

        return found[bracketed_root(value, self.a.place, self.b.place)]

    @property
    def holds_root(self) -> bool:
        """Whether the coefficient is zero within its error at the root, and that error is
        less than the coefficients at the ends.
        """
        root = self.root
        return root.size <= root.form.error < min(self.a.size, self.b.size)

    @property
    def located(self) -> tuple[Gait, ndarray]:
        """The root, and bounds on the errors of its last two unknowns: how far the
        nearest points lie at which the sign is certain.
        """
        rise = (self.a.size + self.b.size) / (self.b.place - self.a.place)
        rounding = 8 * EPS * max(1.0, self.root.place)
        apart = max(_FIRST * self.root.form.error / rise, rounding)
        beside = [self._certain(-apart, self.a), self._certain(apart, self.b)]

        X = self.root.X
        off = np.max([np.abs(each.X - X) for each in beside], axis=0)[-2:]
        return X, off + self.root.last_step + 8 * EPS

    def _certain(self, apart: float, end: _Sample) -> _Sample:
        """The nearest point to the root towards an end, of some that lie ever farther
        apart, at which the sign is that of the end.
        """
        while abs(apart) < abs(end.place - self.root.place):
            sample = self.curve.at(self.root.place + apart)
            if sample.sign == end.sign:
                return sample
            apart *= _GROWTH
        return end
