"""The special points of a box of keys, at which the quantities of its designs reach their extremes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from tasks.continuation.atlas import survey_lines
from tasks.continuation.defining import SCALARS
from tasks.continuation.extremes import ANY_SLOPE, Points, best, find, join, roles
from tasks.continuation.refine import COARSE
from tasks.families.box import Box
from tasks.families.cell import Family, Refused
from tasks.families.manifold import Maker, Manifold
from tasks.mechanics.lumped import Structure, common_structure

#: Lines surveyed along each key, and designs along each key at which the manifolds are compared.
_NODES, _LATTICE = 3, 15
#: Rounds in which lines are surveyed and manifolds added, and lines of each.
_ROUNDS, _MOST_LINES = 6, 8
#: Points nearer than this are one.
_SAME = 1e-6
#: Boxes of fewer designs than this are left to lines; a box is halved so often.
_LEAST_DESIGNS, _MOST_SPLITS = 64, 5


@dataclass
class Landscape:
    """A box with the manifolds that hold the extremes of its designs; where it was refused, `why` says so.

    Attributes
    ----------
    box : Box
    structure : Structure
    manifolds : list of Manifold
    patterns : set of bytes
        What the flags of all manifolds may be at a design: as on some line that was surveyed.
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
    maker: Maker, manifolds: list[Manifold], unit: np.ndarray, window: tuple[float, float]
) -> tuple[Points, np.ndarray, np.ndarray]:
    """Solve the points of manifolds at designs.

    Parameters
    ----------
    maker : Maker
    manifolds : list of Manifold
    unit : ndarray, shape (n, d)
    window : (float, float)
        Least and largest ln slope.

    Returns
    -------
    points : Points
        Those of each manifold after another; `line` counts the designs.
    near : ndarray of bool, shape (n,)
        Designs whose points are all as near their predictions as they should be.
    flags : ndarray of int8, shape (n, manifolds)
        Of which quantities each point may be the extreme.
    """
    problem = maker.problem(unit)
    parts = [manifold.polish(problem, unit) for manifold in manifolds]
    near = np.logical_and.reduce([each for _, each in parts])
    counts = [sum(2**k * role for k, role in enumerate(roles(points, window).values())) for points, _ in parts]
    return join([points for points, _ in parts]), near, np.column_stack(counts).astype(np.int8)


class _Surveyor:
    """Finds the manifolds of a box."""

    def __init__(self, family: Family, box: Box, window: tuple[float, float]):
        self.structure = common_structure(family.walkers(box.nodes(_NODES)))
        self.maker, self.window, self.box = Maker(family, box, self.structure), window, box
        self.d = len(box.keys)
        self.unit = np.zeros((0, self.d))
        self.points: list[Points] = []
        self.manifolds: list[Manifold] = []
        axes = [np.linspace(-1, 1, _LATTICE)] * self.d
        self.lattice = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, self.d)

    def survey(self, unit: np.ndarray) -> None:
        """Survey lines, and locate their points."""
        problem = self.maker.problem(unit)
        points = find(problem, survey_lines(problem, COARSE), self.window, {})
        for i in range(len(unit)):
            self.points.append(points.some(points.line == i))
        self.unit = np.vstack([self.unit, unit])

    def landscape(self) -> Landscape:
        nodes = self.box.unit(self.box.nodes(_NODES))
        self.survey(np.vstack([nodes, self.box.draw(1, self.d, "design")]))
        for _ in range(_ROUNDS):
            patterns, unexplained, any_slope = self.explained()
            if unexplained is not None:
                kind, line, Z, target = unexplained
                self.manifolds.append(self.maker.manifold(kind, self.unit[line], Z, target))
                continue
            new = self.unknown(patterns)
            if not len(new):
                break
            self.survey(new)
        else:
            raise Refused("the designs of the box are too different", self.roughest())
        return Landscape(self.box, self.structure, self.manifolds, patterns, any_slope)

    def explained(self) -> tuple[set[bytes], tuple[str, int, np.ndarray, float] | None, bool]:
        """Compare the lines with the manifolds.

        Returns
        -------
        patterns : set of bytes
            Flags of the manifolds on lines whose extremes all lie on them.
        missing : tuple or None
            An extreme on no manifold: its kind, line, Z and target.
        any_slope : bool
        """
        patterns, to_vanishing = set(), 0
        if self.manifolds:
            own, near, flags = points_at(self.maker, self.manifolds, self.unit, self.window)
            chosen = best(own, len(self.unit), self.window)
        for i, points in enumerate(self.points):
            agrees = bool(self.manifolds)
            alone = points.some(points.line >= 0)
            alone.line = np.zeros(len(points.line), int)
            for name, (number,) in best(alone, 1, self.window).items():
                if number >= 0 and points.kind[number] == ANY_SLOPE:
                    to_vanishing += 1
                    continue
                if self.manifolds and (number < 0) == (chosen[name][i] < 0):
                    j = chosen[name][i]
                    if number < 0 or _is_same(points, number, own, j):
                        continue
                agrees = False
                if number < 0:
                    continue
                kind, Z = str(points.kind[number]), points.Z[:, number]
                if kind not in SCALARS:
                    raise Refused(f"a branch ends at {kind}", self.roughest())
                here = np.flatnonzero(own.line == i) if self.manifolds else []
                if not any(_is_same(points, number, own, j) for j in here):
                    edges = np.array(self.window)
                    target = float(edges[np.abs(edges - points.log_slope[number]).argmin()]) if kind == "window" else 0.0
                    return patterns, (kind, i, Z, target), False
            if agrees and near[i]:
                patterns.add(flags[i].tobytes())
        if to_vanishing not in (0, len(self.points)):
            raise Refused("some designs walk at any slope", self.roughest())
        return patterns, None, to_vanishing > 0

    def unknown(self, patterns: set[bytes]) -> np.ndarray:
        """Designs (n, d) of the lattice with flags as on no line so far, one for each of them."""
        if not self.manifolds:
            return np.zeros((0, self.d))
        _, near, flags = points_at(self.maker, self.manifolds, self.lattice, self.window)
        every: dict[bytes, list[int]] = {}
        for i in np.flatnonzero(near).tolist():
            every.setdefault(flags[i].tobytes(), []).append(i)
        places = []
        for pattern, members in sorted(every.items(), key=lambda item: (-len(item[1]), item[1][0])):
            if pattern not in patterns:
                of = self.lattice[members]
                places.append(of[np.abs(of - of.mean(axis=0)).max(axis=1).argmin()])
        known = {row.tobytes() for row in self.unit}
        return np.array([place for place in places if place.tobytes() not in known][:_MOST_LINES]).reshape(-1, self.d)

    def roughest(self) -> int:
        """The key along which what the surveyed lines have changes most, or else the widest."""
        kinds = []
        for points in self.points[: _NODES**self.d]:
            alone = points.some(points.line >= 0)
            alone.line = np.zeros(len(points.line), int)
            kinds.append(tuple(str(points.kind[k]) if k >= 0 else "" for (k,) in best(alone, 1, self.window).values()))
        _, number = np.unique([" ".join(kind) for kind in kinds], return_inverse=True)
        number = number.reshape((_NODES,) * self.d)
        return int(np.argmax([(np.diff(number, axis=k) != 0).sum() for k in range(self.d)]))


def _is_same(a: Points, i: int, b: Points, j: int) -> bool:
    return a.kind[i] == b.kind[j] and bool(np.abs(a.Z[:, i] - b.Z[:, j]).max() < _SAME)


def make(
    family: Family,
    box: Box,
    window: tuple[float, float],
    count: Callable[[Box], int],
    splits: int = _MOST_SPLITS,
) -> list[Landscape]:
    """Make the landscapes of a box, or of the parts into which it is divided.

    Parameters
    ----------
    family : Family
    box : Box
    window : (float, float)
        Least and largest ln slope.
    count : callable
        Number of designs in a box.
    splits : int
        How often it may be halved.
    """
    surveyor = _Surveyor(family, box, window)
    if count(box) < _LEAST_DESIGNS:
        return [Landscape(box, surveyor.structure, why="few designs")]
    try:
        return [surveyor.landscape()]
    except Refused as refused:
        if not splits:
            return [Landscape(box, surveyor.structure, why=str(refused))]
        halves = box.halves(refused.axis)
    return [part for half in halves for part in make(family, half, window, count, splits - 1)]
