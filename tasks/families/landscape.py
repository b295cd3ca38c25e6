"""The special points of a box of keys, at which the quantities of its designs reach
their extremes.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from gaitsweep.tasks.continuation.atlas import survey_lines
from gaitsweep.tasks.continuation.conditions import (
    foot_radius,
    is_located,
    log_froude,
)
from gaitsweep.tasks.continuation.extremes import (
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
from gaitsweep.tasks.continuation.refine import COARSE
from gaitsweep.tasks.families.box import Box, Refused
from gaitsweep.tasks.families.division import divide
from gaitsweep.tasks.families.family import Family
from gaitsweep.tasks.families.manifold import Manifold
from gaitsweep.tasks.families.manifold_maker import Maker
from gaitsweep.tasks.families.tuning import Tuning
from gaitsweep.tasks.kinds import RIVALS
from gaitsweep.tasks.mechanics.lumped import Structure, common_structure
from gaitsweep.tasks.step.lanes import join_lanes, lanes_of

#: Lines surveyed along each key, and designs along each key at which the manifolds are
#: compared.
_NODES, _LATTICE = (-0.99, 0.0, 0.99), 15
#: Further random lines.
_DRAWN = 2
#: A line this near a node, in coordinates, serves as the one there.
_NEAR_NODE = 0.02
#: Predictions that differ by less are both solved.
_TIE = 1e-3
#: Rivals get a manifold, if one can be made, already where their value comes this near
#: the best of a line: points of other kinds become the best only where another point
#: changes its flags.
_RIVAL = {
    "smallest_slope": 0.05,
    "largest_stable_slope": 0.1,
    "fastest_stable_speed": 0.05,
    **dict.fromkeys(COSTS, 0.0),
}
#: Rounds in which lines are surveyed and manifolds added, and lines of each.
_ROUNDS, _MAX_LINES = 6, 8
#: Share of the lattice whose designs are left to lines instead of halving the box, as a
#: single one is.
_RARE = 0.02
#: Points closer than this are identical.
_SAME = 1e-6
#: Boxes of fewer designs than this are left to lines; most halvings of a box; designs
#: of a box, for each part of it that is tried, from which on that takes less time than
#: their lines.
_MIN_DESIGNS, _MAX_SPLITS, _A_TRY = 64, 8, 100


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
    maker: Maker,
    manifolds: list[Manifold],
    unit: np.ndarray,
    window: tuple[float, float],
    every: bool = False,
) -> tuple[Points, np.ndarray, np.ndarray]:
    """Solve the points of manifolds at designs at which their quantities may have their
    extremes.

    Parameters
    ----------
    maker : Maker
    manifolds : list of Manifold
    unit : ndarray, shape (n, d)
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
    n, problem = len(unit), maker.problem(unit)
    if not manifolds:
        return nothing(problem), np.ones(n, bool), np.zeros((n, 0), np.int8)
    predicted = [manifold.predict(unit)[0] for manifold in manifolds]
    kinds = np.array([manifold.kind for manifold in manifolds])
    froude = [log_froude(Z, foot_radius(problem)) for Z in predicted]
    left = np.column_stack([manifold.region.holds(unit) for manifold in manifolds])
    near = ~np.logical_or.reduce(
        [manifold.region.is_near(unit) for manifold in manifolds]
    )
    flags = np.where(left, -1, 0).astype(np.int8)
    parts = [nothing(problem)]
    served = {name: np.full(n, np.inf) for name in QUANTITIES}
    while left.any():
        due = left.copy() if every else np.zeros_like(left)
        for name in QUANTITIES:
            value = np.column_stack(
                [values(name, Z[-1], v) for Z, v in zip(predicted, froude, strict=True)]
            )
            value[:, ~may_be(name, kinds)] = np.inf
            value[~left] = np.inf
            first = value <= np.minimum(value.min(axis=1), served[name])[:, None] + _TIE
            due |= first & np.isfinite(value) & (value < served[name][:, None] + _TIE)
        if not due.any():
            break
        for k in np.flatnonzero(due.any(axis=0)).tolist():
            lanes = np.flatnonzero(due[:, k])
            points, fine = manifolds[k].polish(problem.some(lanes), unit[lanes])
            points.line, near[lanes], left[lanes, k] = lanes, near[lanes] & fine, False
            flags[lanes, k] = _flags(points, window)
            for name, which in roles(points, window).items():
                value = values(name, points.log_slope, points.log_froude)
                served[name][lanes] = np.minimum(
                    served[name][lanes], np.where(which, value, np.inf)
                )
            parts.append(points)
    return join_lanes(parts), near, flags


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


def _flags(points: Points, window: tuple[float, float]) -> np.ndarray:
    """Quantities of which points may be the extremes, and the side to which the speed
    grows, in bits, shape (n,).
    """
    every = roles(points, window)
    bits = [*every.values(), every["fastest_stable_speed"] & points.faster]
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
    to which its own are added.
    """

    def __init__(self, family: Family, box: Box, sought: Sought, lines: list[_Line]):
        self.structure = common_structure(family.walkers(box.nodes(len(_NODES))))
        self.maker, self.box, self.lines = (
            Maker(family, box, self.structure),
            box,
            lines,
        )
        self.sought, self.window = sought, sought.window
        self.d = len(box.keys)
        self.unit = np.zeros((0, self.d))
        self.points: list[Points] = []
        self.nodes = np.zeros(0, int)  # numbers of the lines at or beside the nodes
        self.manifolds: list[Manifold] = []
        self.tried: set[tuple[str, int, str]] = set()
        #: For each line the share of the lattice that it stands for; lines whose
        #: designs are left to be surveyed.
        self.shares: list[float] = []
        self.left: set[int] = set()
        # Evenly in the keys, and in their logarithms too where these are the
        # coordinates.
        even = np.tile(np.linspace(-1, 1, _LATTICE)[:, None], (1, self.d))
        both = np.vstack(
            [even, box.unit(Box(box.keys, box.low, box.high).at(even))]
        ).round(9)
        axes = [np.unique(both[:, k]) for k in range(self.d)]
        self.lattice = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(
            -1, self.d
        )

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
            found = [
                value for tuning in tunings if (value := tuning.inside()) is not None
            ]
            if len(found) == len(tunings) and np.ptp(found) < _SAME * abs(found[0]):
                raise Refused("tuned walkers inside", axis, found[0])

    def survey(self, unit: np.ndarray, shares: Sequence[float] = ()) -> None:
        """Survey lines, which stand for shares of the lattice, all of it where none are
        given; locate their points.
        """
        problem = self.maker.problem(unit)
        points = find(problem, survey_lines(problem, COARSE), self.sought)
        lines = []
        for i, keys in enumerate(self.box.at(unit)):
            own = lanes_of(points, points.line == i)
            own.line = np.zeros(len(own.line), int)
            lines.append(_Line(self.structure, keys, own))
        self.lines += lines
        self.take(unit, lines, shares)

    def take(
        self, unit: np.ndarray, lines: Sequence[_Line], shares: Sequence[float] = ()
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
            while self.missing(rivals=False):
                pass
            self.missing(rivals=True)
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

    def missing(self, rivals: bool) -> bool:
        """Add a manifold through an extreme of a line that lies on none; or all through
        points that rival extremes.
        """
        own = points_at(self.maker, self.manifolds, self.unit, self.window, every=True)[
            0
        ]
        for i, points in enumerate(self.points):
            for name, (number,) in best(points, 1, self.window).items():
                if number < 0 or points.kind[number] == ANY_SLOPE or i in self.left:
                    continue
                value = values(name, points.log_slope, points.log_froude)
                near = roles(points, self.window)[name] & (
                    value < value[number] + _RIVAL[name] * rivals
                )
                for k in np.flatnonzero(near) if rivals else [number]:
                    kind = str(points.kind[k])
                    on = [
                        _is_same(points, k, own, j)
                        for j in np.flatnonzero(own.line == i)
                    ]
                    if any(on) or (
                        rivals and (kind not in RIVALS or (kind, i, name) in self.tried)
                    ):
                        continue
                    if not is_located(kind):
                        raise Refused(f"a branch ends at {kind}", self.roughest())
                    self.tried.add((kind, i, name))
                    edges = np.array(self.window)
                    edge = float(edges[np.abs(edges - points.log_slope[k]).argmin()])
                    target = {
                        "window": edge,
                        "speed": self.sought.log_speed or 0.0,
                    }.get(kind, 0.0)
                    try:
                        self.manifolds.append(
                            self.maker.manifold(
                                kind, self.unit[i], points.Z[:, k], target
                            )
                        )
                    except Refused:
                        if not rivals and self.shares[i] > max(
                            _RARE, 1 / len(self.lattice)
                        ):
                            raise
                        if not rivals:
                            self.left.add(i)
                        continue
                    if not rivals:
                        return True
                    new, _, _ = points_at(
                        self.maker,
                        self.manifolds[-1:],
                        self.unit,
                        self.window,
                        every=True,
                    )
                    own = join_lanes([own, new])
        return False

    def patterns(self) -> set[bytes]:
        """Flags of the manifolds on lines whose extremes they reproduce, and on none
        whose extremes they do not.
        """
        own, near, flags = points_at(
            self.maker, self.manifolds, self.unit, self.window, every=True
        )
        chosen = best(own, len(self.unit), self.window)
        patterns: set[bytes] = set()
        others: set[bytes] = set()
        for i, points in enumerate(self.points):
            agrees = True
            for name, (number,) in best(points, 1, self.window).items():
                if number >= 0 and points.kind[number] == ANY_SLOPE:
                    continue
                j = chosen[name][i]
                agrees &= (number < 0) == (j < 0) and (
                    number < 0 or _is_same(points, number, own, j)
                )
            if near[i]:
                (patterns if agrees else others).add(flags[i].tobytes())
        return patterns - others

    def unknown(self, patterns: set[bytes]) -> tuple[np.ndarray, list[float]]:
        """Designs (n, d) of the lattice with flags of no line so far, one for each, and
        the share with these.
        """
        _, near, flags = points_at(
            self.maker, self.manifolds, self.lattice, self.window, every=True
        )
        every: dict[bytes, list[int]] = {}
        for i in np.flatnonzero(near).tolist():
            every.setdefault(flags[i].tobytes(), []).append(i)
        known = {row.tobytes() for row in self.unit}
        places, shares = [], []
        for pattern, members in sorted(
            every.items(), key=lambda item: (-len(item[1]), item[1][0])
        ):
            of = self.lattice[members]
            place = of[np.abs(of - of.mean(axis=0)).max(axis=1).argmin()]
            if pattern not in patterns and place.tobytes() not in known:
                places.append(place)
                shares.append(len(members) / len(self.lattice))
        return np.array(places[:_MAX_LINES]).reshape(-1, self.d), shares[:_MAX_LINES]

    def roughest(self) -> int:
        """The key along which the surveyed lines change most, or else the widest."""
        kinds = []
        for points in [self.points[i] for i in self.nodes]:
            kinds.append(
                " ".join(
                    str(points.kind[k])
                    for (k,) in best(points, 1, self.window).values()
                    if k >= 0
                )
            )
        _, number = np.unique(kinds, return_inverse=True)
        number = number.reshape((len(_NODES),) * self.d)
        return int(
            np.argmax([(np.diff(number, axis=k) != 0).sum() for k in range(self.d)])
        )


def _is_same(a: Points, i: Any, b: Points, j: Any) -> bool:
    return a.kind[i] == b.kind[j] and bool(np.abs(a.Z[:, i] - b.Z[:, j]).max() < _SAME)


def make(
    family: Family, box: Box, sought: Sought, count: float, splits: int = _MAX_SPLITS
) -> list[Landscape]:
    """Make the landscapes of a box, or of the parts into which it is divided.

    Parameters
    ----------
    family : Family
    box : Box
    sought : Sought
    count : float
        About how many designs it is for.
    splits : int
        How often it may be halved.
    """
    lines: list[_Line] = []
    tried: list[Box] = []

    def landscape(part: Box, why: str) -> Landscape:
        surveyor = _Surveyor(family, part, sought, lines)
        if why:
            return Landscape(part, surveyor.structure, why=why)
        tried.append(part)
        return surveyor.landscape()

    def is_worth(part: Box) -> bool:
        return box.share(part) * count >= _MIN_DESIGNS and len(tried) * _A_TRY <= count

    return divide(box, landscape, is_worth, splits)
