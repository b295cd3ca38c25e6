"""The special points of a box of keys, at which the quantities of its designs reach
their extremes.
"""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from gaitsweep.tasks.branches.atlas import survey_lines
from gaitsweep.tasks.branches.conditions import (
    foot_radius,
    is_located,
    log_froude,
)
from gaitsweep.tasks.branches.extremes import (
    ANY_SLOPE,
    COSTS,
    QUANTITIES,
    Points,
    Sought,
    best,
    find,
    may_be,
    nothing,
    roles,
    values,
)
from gaitsweep.tasks.branches.refine import COARSE
from gaitsweep.tasks.charts.box import Box, Refused
from gaitsweep.tasks.charts.division import divide
from gaitsweep.tasks.charts.extension import Extension
from gaitsweep.tasks.charts.family import Family
from gaitsweep.tasks.charts.maker import Maker
from gaitsweep.tasks.charts.manifold import Manifold, Region
from gaitsweep.tasks.charts.manifold_maker import make_manifold
from gaitsweep.tasks.charts.tuning import Tuning
from gaitsweep.tasks.contract.kinds import RIVALS, kind_of
from gaitsweep.tasks.mechanics.lumped import Structure, common_structure
from gaitsweep.tasks.step.lanes import join_lanes, lanes_of
from gaitsweep.tasks.step.problem import Lanes
from gaitsweep.tasks.step.sameness import SAME_GAIT, same

#: Lines surveyed along each key, and designs along each key at which the manifolds are
#: compared.
_NODES = (-0.99, 0.0, 0.99)
_LATTICE = 15
#: Further random lines.
_DRAWN = 2
#: A line this near a node, in coordinates, serves as the one there.
_NEAR_NODE = 0.02
#: Predictions that differ by less are both solved.
_TIE = 1e-3
#: How near the best of a line the values of rivals come, which get a manifold, if one
#: can be made.
_RIVAL = {
    "smallest_slope": 0.05,
    "largest_stable_slope": 0.1,
    "fastest_stable_speed": 0.05,
    **dict.fromkeys(COSTS, 0.0),
}
#: Rounds in which lines are surveyed and manifolds added, and lines of each.
_ROUNDS = 6
_MAX_LINES = 8
#: Share of the lattice whose designs are left to lines instead of halving the box, as a
#: single one is.
_RARE = 0.02
#: Relative difference of the values of a key that are one.
_SAME_VALUE = 1e-6
#: Boxes of fewer designs than this are left to lines; most halvings of a box; designs
#: of a box, for each part of it that is tried, from which on that takes less time than
#: their lines.
_MIN_DESIGNS = 64
_MAX_SPLITS = 8
_A_TRY = 100


@dataclass
class Landscape:
    """A box with the manifolds that hold the extremes of its designs; where it was
    refused, `why` says so.

    Attributes
    ----------
    box : Box
    structure : Structure
    manifolds : list of Manifold
    patterns : set of bytes
        What the flags of all manifolds may be at a design: as on some line that was
        surveyed.
    any_slope : bool
        Whether the gaits of all designs continue to vanishing slopes.
    why : str
    """

    box: Box
    structure: Structure
    manifolds: list[Manifold] = field(default_factory=list)
    patterns: set[bytes] = field(default_factory=set)
    any_slope: bool = False
    why: str = ""


def points_at(
    problem: Lanes,
    manifolds: list[Manifold],
    unit: np.ndarray,
    window: tuple[float, float],
    every: bool = False,
) -> tuple[Points, np.ndarray, np.ndarray]:
    """Solve the points of manifolds at designs at which their quantities may have their
    extremes.

    Parameters
    ----------
    problem : Lanes
        Of the designs.
    manifolds : list of Manifold
    unit : ndarray, shape (n, d)
        Their coordinates of keys.
    window : (float, float)
        Least and largest ln slope.
    every : bool
        All points; otherwise none that the predictions rank behind a usable one.

    Returns
    -------
    points : Points
        `line` counts the designs.
    near : ndarray of bool, shape (n,)
        Designs whose points are all as near their predictions as they should be.
    flags : ndarray of int8, shape (n, manifolds)
        Of which quantities each point may be the extreme, and the side to which the
        speed grows; -1 where it is not solved.
    """
    if not manifolds:
        n = len(unit)
        return nothing(problem), np.ones(n, bool), np.zeros((n, 0), np.int8)

    designs = _Designs(problem, manifolds, unit, window)
    while (due := designs.left if every else designs.due()).any():
        for k in np.flatnonzero(due.any(axis=0)).tolist():
            designs.solve(k, np.flatnonzero(due[:, k]))

    return join_lanes(designs.parts), designs.near, designs.flags


class _Designs:
    """Designs (n, d) whose points on manifolds are solved one manifold after another.

    `left` (n, manifolds) has those points that are not solved, `served` for each
    quantity the best value so far, (n,); the others are as `points_at` returns them.
    """

    def __init__(
        self,
        problem: Lanes,
        manifolds: list[Manifold],
        unit: np.ndarray,
        window: tuple[float, float],
    ):
        self.manifolds = manifolds
        self.window = window
        self.problem = problem
        n = len(unit)
        self.parts = [nothing(problem)]

        regions = [manifold.region for manifold in manifolds]
        self.left = np.column_stack([region.holds(unit) for region in regions])
        self.near = ~np.any([region.is_near(unit) for region in regions], axis=0)
        self.flags = np.where(self.left, -1, 0).astype(np.int8)
        self.served = {name: np.full(n, np.inf) for name in QUANTITIES}

        self.predict(unit)
        kinds = np.array([manifold.kind for manifold in manifolds])
        self.may_be = {name: may_be(name, kinds) for name in QUANTITIES}

    def predict(self, unit: np.ndarray) -> None:
        """Predict the points of manifolds at the designs that have them."""
        self.predicted = [
            _where(held, *manifold.predict(unit[held]))
            for manifold, held in zip(self.manifolds, self.left.T, strict=True)
        ]
        radius = foot_radius(self.problem)
        points = [Z for Z, _ in self.predicted]
        self.log_slope = np.column_stack([Z[-1] for Z in points])
        self.log_froude = np.column_stack([log_froude(Z, radius) for Z in points])

    def due(self) -> np.ndarray:
        """The points that may be the extremes of quantities, as the predictions rank
        them, bool (n, manifolds).
        """
        due = np.zeros_like(self.left)
        for name in QUANTITIES:
            value = values(name, self.log_slope, self.log_froude)
            may_serve = self.left & self.may_be[name]
            value = np.where(may_serve, value, np.inf)
            due |= (
                (value <= value.min(axis=1, keepdims=True) + _TIE)
                & (value < self.served[name][:, None] + _TIE)
                & np.isfinite(value)
            )

        return due

    def solve(self, k: int, lanes: np.ndarray) -> None:
        """Solve the points of some designs on a manifold."""
        problem = self.problem.some(lanes)
        Z, rows = (values[:, lanes] for values in self.predicted[k])
        points, fine = self.manifolds[k].polish(problem, Z, rows)
        points.line = lanes
        self.near[lanes] &= fine
        self.left[lanes, k] = False
        in_roles = roles(points, self.window)
        self.flags[lanes, k] = _flags(points, in_roles)
        for name, which in in_roles.items():
            value = values(name, points.log_slope, points.log_froude)
            served = np.where(which, value, np.inf)
            self.served[name][lanes] = np.minimum(self.served[name][lanes], served)

        self.parts.append(points)


def is_known(flags: np.ndarray, patterns: set[bytes]) -> np.ndarray:
    """Return whether flags, as far as they are known, agree with a pattern.

    Parameters
    ----------
    flags : ndarray of int8, shape (n, manifolds)
        As `points_at` has them.
    patterns : set of bytes

    Returns
    -------
    ndarray of bool, shape (n,)
    """
    known = np.array([np.frombuffer(pattern, np.int8) for pattern in sorted(patterns)])
    known = known.reshape(len(patterns), flags.shape[1])
    return np.asarray(
        ((flags[:, None] == known) | (flags[:, None] < 0)).all(axis=2).any(axis=1)
    )


def _where(held: np.ndarray, *arrays: np.ndarray) -> list[np.ndarray]:
    """Arrays (c, k) of the k of n designs that a manifold holds, as arrays (c, n); NaN of
    the others.
    """
    everywhere = []
    for of_held in arrays:
        of_all = np.full((len(of_held), len(held)), np.nan)
        of_all[:, held] = of_held
        everywhere.append(of_all)
    return everywhere


def _flags(points: Points, in_roles: dict[str, np.ndarray]) -> np.ndarray:
    """Quantities of which points may be the extremes, as `roles` has them, and the side to
    which the speed grows, in bits, shape (n,).
    """
    bits = [*in_roles.values(), in_roles["fastest_stable_speed"] & points.faster]
    return np.asarray(sum(2**k * bit for k, bit in enumerate(bits)), np.int8)


@dataclass(frozen=True)
class _Line:
    """A surveyed line: the structure and keys (d,) [the walker's units] of its walker,
    and its points.
    """

    structure: Structure
    keys: np.ndarray
    points: Points


class _Surveyor:
    """Finds the manifolds of a box; `lines` are those surveyed for boxes that hold it,
    to which its own are added; `count` is about how many designs it has, which lie evenly
    in the coordinates of `spread`.
    """

    def __init__(
        self,
        family: Family,
        box: Box,
        sought: Sought,
        lines: list[_Line],
        spread: Box,
        count: float,
    ):
        self.structure = common_structure(family.walkers(box.nodes(len(_NODES))))
        self.maker = Maker(family, box, self.structure)
        self.box = box
        self.lines = lines
        self.count = count
        self.d = len(box.keys)
        self.sought = sought
        self.window = sought.window
        self.lattice = _lattice(box)
        self.designs = box.unit(spread.at(_evenly(self.d)))

        self.unit = np.zeros((0, self.d))
        self.points: list[Points] = []
        self.nodes = np.zeros(0, int)  # numbers of the lines at or beside the nodes
        #: For each line the share of the lattice that it stands for; lines whose
        #: designs are left to be surveyed.
        self.shares: list[float] = []
        self.left: set[int] = set()
        self.manifolds: list[Manifold] = []
        self.tried: set[tuple[str, int, str]] = set()

    def check_tuning(self) -> None:
        """Refuse a box of two keys in which walkers are tuned at one value of a key,
        whatever the other is.

        Beside it points at the window's edge have ends on both sides, and a region has
        one.
        """
        for axis in range(self.d if self.d == 2 else 0):
            tunings = [
                Tuning(self.maker.family, self.box, axis, others)
                for others in (-1.0, 0.0, 1.0)
            ]
            inside = [tuning.inside() for tuning in tunings]
            found = [value for value in inside if value is not None]
            if len(found) == len(tunings) and np.ptp(found) < _SAME_VALUE * abs(
                found[0]
            ):
                raise Refused("tuned walkers inside", axis, found[0])

    def survey(self, unit: np.ndarray, shares: Sequence[float] = ()) -> None:
        """Survey lines, which stand for shares of the lattice, all of it where none are
        given; locate their points.
        """
        problem = self.maker.problem(unit)
        points = find(problem, survey_lines(problem, COARSE), self.sought)
        lines = []
        for i, keys in enumerate(self.box.at(unit)):
            of_line = lanes_of(points, points.line == i)
            of_line.line = np.zeros(len(of_line.line), int)
            lines.append(_Line(self.structure, keys, of_line))

        self.lines += lines
        self.take(unit, lines, shares)

    def take(
        self,
        unit: np.ndarray,
        lines: Sequence[_Line],
        shares: Sequence[float] = (),
    ) -> None:
        """Take surveyed lines, which stand for shares of the lattice, all of it where
        none are given.
        """
        self.points += [line.points for line in lines]
        self.unit = np.vstack([self.unit, unit])
        self.shares += shares or [1.0] * len(unit)

    def begin(self) -> None:
        """Take the lines that are known, and survey the others at nodes and at random
        designs.
        """
        nodes = np.array(list(itertools.product(_NODES, repeat=self.d)))
        inside = [
            line
            for line in self.lines
            if line.structure == self.structure and self.box.holds(line.keys)
        ]
        if inside:
            self.take(self.box.unit(np.array([line.keys for line in inside])), inside)
        known = np.abs(nodes[:, None] - self.unit).max(axis=2, initial=0.0) < _NEAR_NODE
        missing = nodes[~known.any(axis=1)]
        further = self.box.draw(_DRAWN, self.d, "design")[(~known.any(axis=0)).sum() :]
        self.survey(np.vstack([missing, further]))
        self.nodes = np.abs(nodes[:, None] - self.unit).max(axis=2).argmin(axis=1)

    def landscape(self) -> Landscape:
        """Survey lines and add manifolds until the lattice holds nothing new."""
        self.check_tuning()
        self.begin()
        for _ in range(_ROUNDS):
            while self.add_missing():
                pass
            self.add_rivals()
            patterns = self.patterns()
            new, shares = self.unknown(patterns)
            if not len(new):
                break

            self.survey(new, shares)

        vanishing = [ANY_SLOPE in points.kind[points.walks] for points in self.points]
        if len(set(vanishing)) > 1:
            raise Refused("some designs walk at any slope", self.roughest())

        return Landscape(
            self.box, self.structure, self.manifolds, patterns, vanishing[0]
        )

    def solve(self, manifolds: list[Manifold]) -> Points:
        """The points of manifolds on all lines."""
        return self.points_at(manifolds, self.unit)[0]

    def points_at(
        self, manifolds: list[Manifold], unit: np.ndarray
    ) -> tuple[Points, np.ndarray, np.ndarray]:
        """All points of manifolds at designs (n, d), as `points_at` has them."""
        problem = self.maker.problem(unit)
        return points_at(problem, manifolds, unit, self.window, every=True)

    def designs_in(self, region: Region) -> float:
        """About how many designs have a point of a region."""
        return self.count * float(region.holds(self.designs).mean())

    def extremes(self) -> Iterator[tuple[int, str, int]]:
        """Numbers of lines, the quantities that have an extreme there, and the numbers
        of the points, but for lines that are left to be surveyed.
        """
        for i, points in enumerate(self.points):
            for name, (number,) in best(points, 1, self.window).items():
                exists = number >= 0 and points.kind[number] != ANY_SLOPE
                if exists and i not in self.left:
                    yield i, name, number

    def add_missing(self) -> bool:
        """Add a manifold through an extreme of a line that lies on none, and return
        whether there was one.
        """
        solved = self.solve(self.manifolds)
        for i, name, number in self.extremes():
            if self.lies_on(solved, i, number):
                continue

            kind = self.points[i].kind[number]
            if not is_located(kind):
                raise Refused(f"a branch ends at {kind}", self.roughest())

            try:
                self.add(i, name, number)
            except Refused:
                if self.shares[i] > max(_RARE, 1 / len(self.lattice)):
                    raise
                self.left.add(i)
                continue

            return True

        return False

    def add_rivals(self) -> None:
        """Add manifolds through points that rival extremes, once for each line and
        quantity.
        """
        solved = self.solve(self.manifolds)
        for i, name, number in self.extremes():
            for k in self.rivals(i, name, number):
                kind = str(self.points[i].kind[k])
                if (kind, i, name) in self.tried or self.lies_on(solved, i, k):
                    continue
                with contextlib.suppress(Refused):
                    self.add(i, name, k)
                    solved = join_lanes([solved, self.solve(self.manifolds[-1:])])

    def rivals(
        self,
        i: int,
        name: str,
        number: int,
    ) -> list[int]:
        """Numbers of the points of a line that rival the extreme of a quantity."""
        points = self.points[i]
        value = values(name, points.log_slope, points.log_froude)
        near = value < value[number] + _RIVAL[name]
        near &= roles(points, self.window)[name] & np.isin(points.kind, RIVALS)
        return np.flatnonzero(near).tolist()

    def lies_on(
        self,
        solved: Points,
        i: int,
        k: int,
    ) -> bool:
        """Whether a point of a line is one of those solved."""
        there = np.flatnonzero(solved.line == i).tolist()
        return any(_is_same(self.points[i], k, solved, j) for j in there)

    def add(
        self,
        i: int,
        name: str,
        k: int,
    ) -> None:
        """Add the manifold through a point of a line."""
        points = self.points[i]
        kind = str(points.kind[k])
        target = 0.0
        if kind_of(kind).is_asked_for:
            target = self.sought.log_speed or 0.0
        if kind_of(kind).is_edge:  # the nearer one
            target = min(self.window, key=lambda q: abs(q - points.log_slope[k]))
        self.tried.add((kind, i, name))
        point = self.unit[i], points.Z[:, k]
        extension = Extension(self.maker, kind, target, *point)
        self.manifolds.append(make_manifold(extension, self.designs_in))

    def patterns(self) -> set[bytes]:
        """Flags of the manifolds on lines whose extremes they reproduce, and on none
        whose extremes they do not.
        """
        solved, near, flags = self.points_at(self.manifolds, self.unit)
        chosen = best(solved, len(self.unit), self.window)
        patterns: set[bytes] = set()
        others: set[bytes] = set()
        for i, points in enumerate(self.points):
            agrees = True
            for name, (number,) in best(points, 1, self.window).items():
                j = chosen[name][i]
                if number < 0:
                    agrees &= j < 0
                elif points.kind[number] != ANY_SLOPE:
                    agrees &= j >= 0 and _is_same(points, number, solved, j)

            if near[i]:
                (patterns if agrees else others).add(flags[i].tobytes())

        return patterns - others

    def unknown(self, patterns: set[bytes]) -> tuple[np.ndarray, list[float]]:
        """Designs (n, d) of the lattice with flags of no line so far, one for each, and
        the share with these.
        """
        _, near, flags = self.points_at(self.manifolds, self.lattice)
        by_pattern: dict[bytes, list[int]] = {}
        for i in np.flatnonzero(near).tolist():
            by_pattern.setdefault(flags[i].tobytes(), []).append(i)
        new = [some for key, some in by_pattern.items() if key not in patterns]
        new.sort(key=lambda members: (-len(members), members[0]))

        surveyed = {unit.tobytes() for unit in self.unit}
        places = []
        shares = []
        for members in new:
            designs = self.lattice[members]
            off = np.abs(designs - designs.mean(axis=0)).max(axis=1)
            place = designs[off.argmin()]
            if place.tobytes() not in surveyed:
                places.append(place)
                shares.append(len(members) / len(self.lattice))

        return np.array(places[:_MAX_LINES]).reshape(-1, self.d), shares[:_MAX_LINES]

    def roughest(self) -> int:
        """The key along which the surveyed lines change most, or else the widest."""
        kinds = []
        for i in self.nodes:
            points = self.points[i]
            numbers = np.concatenate([*best(points, 1, self.window).values()])
            kinds.append(" ".join(points.kind[numbers[numbers >= 0]]))

        _, number = np.unique(kinds, return_inverse=True)
        number = number.reshape((len(_NODES),) * self.d)
        changes = [(np.diff(number, axis=k) != 0).sum() for k in range(self.d)]
        return int(np.argmax(changes))


def _lattice(box: Box) -> np.ndarray:
    """Designs (n, d) at which manifolds are compared: evenly in the keys, and in their
    logarithms too where these are the coordinates.
    """
    d = len(box.keys)
    even = np.tile(np.linspace(-1, 1, _LATTICE)[:, None], (1, d))
    in_keys = box.unit(Box(box.keys, box.low, box.high).at(even))
    axes = [np.unique(axis) for axis in np.vstack([even, in_keys]).round(9).T]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, d)


def _evenly(d: int) -> np.ndarray:
    """Points (n, d) that fill the cube from -1 to 1 evenly."""
    middles = (np.arange(_LATTICE) + 0.5) / _LATTICE * 2 - 1
    return np.array(list(itertools.product(middles, repeat=d)))


def _is_same(
    a: Points,
    i: Any,
    b: Points,
    j: Any,
) -> bool:
    return a.kind[i] == b.kind[j] and bool(same(a.Z[:, i], b.Z[:, j], SAME_GAIT))


def make(
    family: Family,
    box: Box,
    sought: Sought,
    count: float,
    log: bool | tuple[bool, ...] = False,
    splits: int = _MAX_SPLITS,
) -> list[Landscape]:
    """Make the landscapes of a box, or of the parts into which it is divided.

    Parameters
    ----------
    family : Family
    box : Box
    sought : Sought
    count : float
        About how many designs it is for.
    log : bool or tuple of bool
        Whether these are spread by the logarithms of keys, for all or for each.
    splits : int
        How often it may be halved.
    """
    lines: list[_Line] = []
    tried: list[Box] = []

    def landscape(part: Box, why: str) -> Landscape:
        spread = replace(part, log=log, origin=())
        number = replace(box, log=log, origin=()).share(part) * count
        surveyor = _Surveyor(family, part, sought, lines, spread, number)
        if why:
            return Landscape(part, surveyor.structure, why=why)
        tried.append(part)
        return surveyor.landscape()

    def is_worth(part: Box) -> bool:
        return box.share(part) * count >= _MIN_DESIGNS and len(tried) * _A_TRY <= count

    return divide(box, landscape, is_worth, splits)
