"""Cells: the patches of a box of keys for a panel of slopes, checked."""

from __future__ import annotations

import functools
import itertools
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from tasks.continuation.atlas import survey_lines
from tasks.continuation.branch import Branch
from tasks.continuation.refine import COARSE
from tasks.costs import PANEL
from tasks.families.box import Box, Refused, tensor_nodes
from tasks.families.chart import Chart, fit
from tasks.families.patch import Patch, measured, side_of_fold
from tasks.families.pieces import Piece, match, pieces_of, towards_middle
from tasks.families.span import Span
from tasks.fixed_points.newton import newton, newton_step
from tasks.fixed_points.step_check import verify_steps
from tasks.mechanics.lumped import Structure, common_structure
from tasks.step.problem import Lanes
from tasks.step.several_steps import AnyStride
from tasks.walkers.resolve import resolve_many
from tasks.walkers.walker_array import WalkerArray

#: Lines surveyed along each key: always, and where pieces end in the panel.
FEW, _MANY = 3, 5
#: Largest Newton correction of a good patch's predictions at random points, if its nodes are solved and if they are
#: those of surveyed lines; a patch that stays worse is used up to the last.
_GOOD, _COARSE_GOOD, _FAIR = 1e-6, 3e-5, 2e-2
_DRAWN = 48
#: Nodes along a piece with which a patch begins, and most along any dimension; the same of a piece that ends in the
#: panel, along the piece alone.
_FIRST, _MAX_NODES, _FIRST_OF_EVENTS, _MAX_OF_EVENTS = 4, 11, 8, 48
#: Nodes along a piece and along each key at which rounding and the Lipschitz constant are measured.
_MEASURED = (6, 3)
#: A piece that goes on farther than this beyond the panel, in ln slope, is cut, at most twice as far.
_CLEAR = 0.03
#: Ends farther than this from the panel are taken to be this far, in ln slope.
_FAR = 1.0
#: Coordinates of lines at the corners of a box, and how near a patch, which is extrapolated, is to its piece there.
_CORNER, _ALIKE = 0.999, 0.1


@dataclass(frozen=True)
class Family:
    """A walker with free keys: its name or table and the keys that have one value, as JSON, and the free ones."""

    text: str
    keys: tuple[str, ...]

    @classmethod
    def of(cls, line: Mapping[str, Any], keys: Iterable[str]) -> Family:
        """Return the family of a line with some keys free."""
        fixed = {key: value for key, value in (line.get("set") or {}).items() if key not in set(keys)}
        return cls(json.dumps([line["walker"], fixed], sort_keys=True), tuple(keys))

    def walkers(self, points: np.ndarray) -> WalkerArray:
        """Return the walkers at values of the free keys.

        Parameters
        ----------
        points : ndarray, shape (n, d) [the walker's units]
        """
        walker, fixed = json.loads(self.text)
        return resolve_many(walker, {**fixed, **dict(zip(self.keys, points.T.copy(), strict=True))})


@dataclass(eq=False)
class Cell:
    """A box with its patches; where they were refused, `why` says so, and its lines are surveyed one by one."""

    box: Box
    structure: Structure
    patches: list[Patch] = field(default_factory=list)
    why: str = ""


class Block:
    """Lines of a cell, at values of its keys (n, d) and slopes (s,): n s points.

    `unit` are the coordinates of the keys, `q` the ln slopes.
    """

    def __init__(self, family: Family, cell: Cell, keys: np.ndarray, slope: np.ndarray):
        self.cell, self.slope, self.q = cell, slope, np.log(slope)
        self.unit, self.walkers = cell.box.unit(keys), family.walkers(keys)

    def on(self, patch: Patch) -> np.ndarray:
        """Return the indices of the points between the ends of a patch."""
        low, high = patch.span.ends(self.unit)[:, :, None]
        return np.flatnonzero((low <= self.q) & (self.q <= high))


def make_cell(family: Family, box: Box, low: float, surveyed: set[tuple[Box, int]], why: str = "") -> Cell:
    """Make the cell of a box for a panel.

    Parameters
    ----------
    family : Family
    box : Box
    low : float
        Ln slope at which the panel begins.
    surveyed : set of (Box, int)
        Receives the box with the nodes along each key of which lines are surveyed, `FEW` or more.
    why : str, optional
        Why the cell is to have no patches.

    Raises
    ------
    Refused
        If the gaits in the box cannot be described as one.
    """
    maker = _Maker(family, box, low, surveyed)
    return Cell(box, maker.structure, [] if why else maker.patches(), why)


@functools.lru_cache(64)
def _survey(family: Family, box: Box, structure: Structure, n: int) -> tuple[list[Branch], ...]:
    """Branches of n^d node lines, the same for all panels; after the few, those of a random line and of corners."""
    points = np.vstack([box.nodes(n), box.at(box.lot()), box.at(box.corners(_CORNER))]) if n == FEW else box.nodes(n)
    return tuple(survey_lines(Lanes(family.walkers(points), structure), COARSE))


class _Maker:
    """Makes the patches of one box and panel."""

    def __init__(self, family: Family, box: Box, low: float, surveyed: set[tuple[Box, int]]):
        self.family, self.box, self.low, self.high = family, box, low, low + PANEL
        self.d = len(box.keys)
        self.structure = common_structure(family.walkers(box.nodes(FEW)))
        self.surveyed = surveyed

    def survey(self, n: int) -> tuple[list[Branch], ...]:
        self.surveyed.add((self.box, n))
        return _survey(self.family, self.box, self.structure, n)

    def problem(self, unit: np.ndarray) -> Lanes:
        return Lanes(self.family.walkers(self.box.at(unit)), self.structure)

    def patches(self) -> list[Patch]:
        patches = self.of_few_lines()
        if patches is None or self.is_lacking(patches):
            patches = []
            for group in self.groups(_MANY):
                cuts = self.cuts(group)
                patches.append(self.with_events(group) if np.isnan(cuts).any() else self.regular(group, cuts))
            if self.is_lacking(patches):
                raise Refused("a line at a corner has a further piece")
        return self.checked(patches)

    def of_few_lines(self) -> list[Patch] | None:
        """Patches of pieces that end near the panel nowhere in the box, by a few lines; None if more are needed."""
        groups = self.groups(FEW)
        cuts = [self.cuts(group) for group in groups]
        if not np.isnan(cuts).any():
            return [self.regular(group, cut) for group, cut in zip(groups, cuts, strict=True)]
        # A polynomial through few ends may wrongly place one near the panel: gaits at the edges of the box show it.
        cuts = [self.cuts(group, between=False) for group in groups]
        if np.isnan(cuts).any():
            return None
        try:
            patches = [self.regular(group, cut) for group, cut in zip(groups, cuts, strict=True)]
        except Refused:
            return None
        return patches if all(map(self.is_whole, patches)) else None

    def is_whole(self, patch: Patch) -> bool:
        """Whether gaits at both ends of a patch are steps, in the middle, the corners and on the edges of the box."""
        points = np.array([(x, *unit) for *unit, x in itertools.product(*[(-1.0, 0.0, 1.0)] * self.d, (-1.0, 1.0))])
        _, check = verify_steps(self.problem(points[:, 1:]), patch.gaits(points), patch.span.log_slope(points))
        return bool(check.step.all())

    def groups(self, n: int) -> list[list[Piece]]:
        """Pieces that come near the panel on any of n^d node lines, each on all of them."""
        surveyed = self.survey(n)[: n**self.d]
        lines = [pieces_of(branches) for branches in surveyed]
        groups: list[list[Piece]] = []
        for group in match(lines, towards_middle(n, self.d), self.low - _CLEAR, self.high + _CLEAR):
            known = [piece for piece in group if piece is not None]
            ends = self.reach(known, n)
            if ends[1, 1] < self.low - _CLEAR or ends[0, 0] > self.high + _CLEAR:
                continue
            if len(known) < len(group):
                present = np.array([piece is not None for piece in group]).reshape((n,) * self.d)
                changes = [np.abs(np.diff(present.astype(int), axis=k)).sum() for k in range(self.d)]
                raise Refused(f"{len(known)} of {len(group)} node lines have a piece", int(np.argmax(changes)))
            groups.append(known)
        return groups

    def reach(self, known: list[Piece], n: int) -> np.ndarray:
        """Least and largest ln slope of the lower and of the upper end of a piece in the box: (2, 2), ends first.

        By their values on node lines; if the piece is on all n^d, by their polynomial too, up to the edges of the box;
        with n = 0 by their values alone.
        """
        q = np.clip([piece.q for piece in known], self.low - _FAR, self.high + _FAR).T
        extremes = np.array([q.min(axis=1), q.max(axis=1)])
        if len(known) == n**self.d:
            edges = np.array(list(itertools.product(np.linspace(-1, 1, 5), repeat=self.d)))
            q = Chart.through((n,) * self.d, q)(edges)
            extremes = np.array([np.minimum(extremes[0], q.min(axis=1)), np.maximum(extremes[1], q.max(axis=1))])
        return np.asarray(extremes.T)

    def cuts(self, group: list[Piece], between: bool = True) -> np.ndarray:
        """Ln slopes at which a piece is cut, shape (2,); NaN where it ends near the panel.

        On a line of its group, or, with `between`, by the polynomial of its ends anywhere in the box.
        """
        ends = self.reach(group, round(len(group) ** (1 / self.d)) if between else 0)
        beyond = np.array([self.low - ends[0, 1], ends[1, 0] - self.high])
        off = np.where(beyond > _CLEAR, np.minimum(2 * _CLEAR, 0.5 * beyond), np.nan)
        return np.array([self.low - off[0], self.high + off[1]])

    def regular(self, group: list[Piece], cut: np.ndarray) -> Patch:
        """A patch between two ln slopes, on which no piece ends: at more nodes gaits follow from those of the lines."""
        span = Span.between(cut, self.d)
        return self.patch(group, span, (False, False), _FIRST, (_MAX_NODES,) * (1 + self.d))

    def with_events(self, group: list[Piece]) -> Patch:
        """A patch that ends at events, whose slopes and gaits are those of surveyed lines."""
        own, is_event = np.array([piece.q for piece in group]), np.isnan(self.cuts(group))
        q = own.copy()
        if not is_event.all():
            # Cut at one distance from the event on all lines: as a share of it, gaits are smooth over the keys.
            event = int(is_event[1])
            reach = np.abs((self.high + _CLEAR, self.low - _CLEAR)[event] - own[:, event]).max()
            q[:, 1 - event] = own[:, event] + (reach if event == 0 else -reach)
            beyond = (q - own)[:, 1 - event] * (1 if event == 0 else -1) > 0
            if beyond.any():
                q[:, 1 - event], is_event[1 - event] = own[:, 1 - event], True
        for end in (0, 1):
            kinds = {piece.kinds[end] for piece in group}
            if is_event[end] and len(kinds) > 1:
                raise Refused(f"a piece ends at {' or '.join(sorted(kinds))}", self.steeper(own))
        low, high = (kind if event else "" for kind, event in zip(group[0].kinds, is_event, strict=True))
        at_zero = low == "zero step length", high == "zero step length"
        span = Span(Chart.through((_MANY,) * self.d, q.T), (low == "fold", high == "fold"), at_zero)
        events = bool(is_event[0]), bool(is_event[1])
        return self.patch(group, span, events, _FIRST_OF_EVENTS, (_MAX_OF_EVENTS, *[_MANY] * self.d))

    def steeper(self, q: np.ndarray) -> int:
        """The key along which ends, (n^d, 2), vary most."""
        ends = q.reshape(*[_MANY] * self.d, 2)
        return int(np.argmax([np.ptp(ends, axis=k).max() for k in range(self.d)]))

    def patch(
        self, group: list[Piece], span: Span, events: tuple[bool, bool], first: int, most: tuple[int, ...]
    ) -> Patch:
        """The patch of a group of pieces over a span, at whose ends pieces may have `events`.

        With `first` nodes along the piece and those of the surveyed lines, up to `most`.
        """
        numbers = np.array([[piece.number, piece.place] for piece in group])
        drawn = self.box.draw(_DRAWN, 1 + self.d, f"patch {numbers[0]}")
        lines = (round(len(group) ** (1 / self.d)),) * self.d

        def attempt(sizes: tuple[int, ...], before: Chart | None) -> Chart:
            points = tensor_nodes(sizes)
            if before is None or any(events):
                chart = Chart.through(sizes, self.gaits_of(group, span, points))
            else:
                chart = Chart.through(sizes, self.solved(span, points, before))
            w = chart(drawn)
            off = np.abs(newton_step(self.stride(span, drawn, w), w))
            return replace(chart, error=float(np.nan_to_num(off, nan=np.inf).max()))

        good = _COARSE_GOOD if any(events) else _GOOD
        gaits = fit(attempt((first, *lines), None), attempt, most, good, _FAIR, self.d)
        sides = side_of_fold(self.stride(span, drawn, gaits(drawn)))
        if not (sides == sides[0]).all():
            raise Refused("a fold lies inside")
        points = tensor_nodes((_MEASURED[0], *[_MEASURED[1]] * self.d))
        along = measured(self.problem(points[:, 1:]), gaits(points), span.log_slope(points), _MEASURED[1] ** self.d)
        if any(span.vanishing):  # rounding over step size grows from node to node: it is measured at each gait
            along[-1][:] = np.nan
        end_errors = span.ends.tails().max(axis=0) * events
        return Patch(tensor_nodes(lines), numbers, span, events, end_errors, gaits, along, float(sides[0]))

    def stride(self, span: Span, points: np.ndarray, w: np.ndarray) -> AnyStride:
        """Steps from gaits (m + k, n) at points of a span."""
        return self.problem(points[:, 1:]).stride(w, span.log_slope(points))[0]

    def gaits_of(self, group: list[Piece], span: Span, points: np.ndarray) -> np.ndarray:
        """Gaits at points over the surveyed lines by their polynomials, shape (m + k, n); the keys fastest."""
        by_line = span.log_slope(points).reshape(-1, len(group))
        rows = np.stack([piece.at(by_line[:, i]) for i, piece in enumerate(group)], axis=1)
        return np.delete(rows.reshape(len(points), -1), group[0].branch.m, axis=1).T

    def solved(self, span: Span, points: np.ndarray, gaits: Chart) -> np.ndarray:
        """Gaits near those of a chart, shape (m + k, n)."""
        guess = gaits(points)
        result = newton(self.problem(points[:, 1:]), guess, span.log_slope(points))
        moved = np.abs(result.w - guess).max(axis=0)
        if not result.converged.all() or moved.max() > 0.3:
            raise Refused(
                f"{(~result.converged).sum()} of {len(points)} nodes do not converge, or move by {moved.max():.2g}"
            )
        return result.w

    def is_lacking(self, patches: list[Patch]) -> bool:
        """Whether a line at a corner has a piece near the panel of which there is no patch.

        The node lines lie inside: up to the border ends that vary much may come nearer than their polynomial predicts.
        """
        surveyed = self.survey(FEW)[FEW**self.d + 1 :]
        for unit, branches in zip(self.box.corners(_CORNER)[:, None], surveyed, strict=True):
            for piece in self.near_panel(branches, 0.5 * _CLEAR):
                if not min((self.compare(patch, piece, unit) for patch in patches), default=np.inf) < _ALIKE:
                    return True
        return False

    def near_panel(self, branches: list[Branch], beyond: float) -> list[Piece]:
        """Pieces that reach the panel, or `beyond` of it."""
        return [p for p in pieces_of(branches) if p.q[1] > self.low - beyond and p.q[0] < self.high + beyond]

    def checked(self, patches: list[Patch]) -> list[Patch]:
        """Patches with the errors of their ends on a random line, which must have these pieces and no others."""
        unit = self.box.lot()
        branches = self.survey(FEW)[FEW**self.d]
        pieces = self.near_panel(branches, _CLEAR)
        checked = []
        for patch in patches:
            (low,), (high,) = ends = patch.span.ends(unit)
            off = [self.compare(patch, piece, unit) for piece in pieces]
            nearest = int(np.argmin(off)) if off else -1
            if off and off[nearest] < 1e-2:
                own = np.abs(np.array(pieces.pop(nearest).q) - ends[:, 0])
                patch = replace(patch, end_errors=np.where(patch.events, np.maximum(patch.end_errors, own), 0.0))
            elif high > self.low - 0.5 * _CLEAR and low < self.high + 0.5 * _CLEAR:
                raise Refused("a line between the nodes lacks a piece")
            checked.append(patch)
        if any(piece.q[1] > self.low and piece.q[0] < self.high for piece in pieces):
            raise Refused("a line between the nodes has a further piece")
        return checked

    def compare(self, patch: Patch, piece: Piece, unit: np.ndarray) -> float:
        """How far a patch is from a piece of a line, at three slopes that both have; infinite where there is none."""
        ends = patch.span.ends(unit)[:, 0]
        low, high = max(ends[0], piece.q[0]), min(ends[1], piece.q[1])
        if low >= high:
            return np.inf
        q = low + (high - low) * np.array([0.2, 0.5, 0.8])
        w = patch.gaits(patch.span.points(q, np.repeat(unit, 3, axis=0)))
        return float(np.abs(w - np.delete(piece.at(q), piece.branch.m, axis=1).T).max())
