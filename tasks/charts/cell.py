"""Cells: boxes of keys with patches that predict all gaits in a window of slopes, made
from few lines and checked.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from gaitsweep.tasks.branches.atlas import survey_lines
from gaitsweep.tasks.branches.refine import COARSE
from gaitsweep.tasks.charts.arrays import arrays_of, parts, under, value_of
from gaitsweep.tasks.charts.box import Box, Refused, tensor_nodes
from gaitsweep.tasks.charts.carry import Carried
from gaitsweep.tasks.charts.chart import Chart, fit
from gaitsweep.tasks.charts.family import Family
from gaitsweep.tasks.charts.maker import Maker
from gaitsweep.tasks.charts.manifold_maker import make_ends
from gaitsweep.tasks.charts.patch import (
    Measured,
    Patch,
    measured,
    side_of_fold,
)
from gaitsweep.tasks.charts.patch_ends import BEYOND, CUT, END, EVENTS, FOLD, LOCATED
from gaitsweep.tasks.charts.pieces import FAST, Piece, match, pieces_of
from gaitsweep.tasks.charts.span import Span
from gaitsweep.tasks.charts.tuning import Tuning
from gaitsweep.tasks.contract.kinds import kind_of
from gaitsweep.tasks.gaits.newton import newton, newton_step
from gaitsweep.tasks.gaits.step_check import verify_steps
from gaitsweep.tasks.mechanics.lumped import Structure
from gaitsweep.tasks.step.problem import Lanes

#: Coordinates of lines at the centre of a box, where no constant of a walker vanishes
#: that does not vanish everywhere, and at its corners; a known line this near to one
#: wanted serves as well.
_CENTRE = 1e-3
_CORNER = 0.999
_NEAR_NODE = 0.02
#: Largest Newton correction of a good patch's predictions at random points; a patch
#: that stays worse is used up to the last.
_GOOD = 1e-6
_FAIR = 2e-2
_DRAWN = 48
#: Newton step after which a node is accurate enough.
_ENOUGH = 1e-5
#: Nodes along a piece and along each key with which a patch begins; most along a piece,
#: and along each of one or two keys.
_FIRST = (8, 5)
_MOST = 48
_MOST_OF_KEYS = (33, 13)
#: Nodes for each key from which on no more are added for few points.
_LEAST_NODES = 600
#: Nodes along a piece and along each key at which rounding and the Lipschitz constant
#: are measured.
_MEASURED = (12, 3)
#: A piece that goes on farther than this beyond the window, in ln slope, is cut, at
#: most twice as far.
_CLEAR = 0.03
#: Least width of a piece that is cut at one end, in ln slope.
_WIDTH = 0.1
#: Pieces are predicted to their ends up to this far beyond the window, in ln slope.
_REACH = 4.0
#: The part of a box that is cut off at a face of tuned walkers, the largest slope of
#: balance, over those of the window, that does not matter, and places along keys at
#: which ends are compared.
_SLIVER = 1 / 64
_BALANCED = 0.25
_PLACES = 9
#: Logarithm of the angle of steps at which pieces end along which steps vanish at a
#: finite drive, and how far before that these ends are, over the square of the angle.
_SMALL = -6.0
_BEFORE_VANISHING = 4.0
#: How near a patch is to pieces of lines in a corner, and inside.
_ALIKE = (0.1, 1e-2)
#: First share of the way on which a gait is carried at a time, and the largest distance
#: from its prediction.
_STRIDE = 0.25
_MAX_STRIDE_ERROR = 0.3


@dataclass(eq=False)
class Cell:
    """A box with its patches; where they were refused, `why` says so, and its lines are
    surveyed one by one.
    """

    box: Box
    structure: Structure
    patches: list[Patch] = field(default_factory=list)
    why: str = ""


def to_arrays(cells: Sequence[Cell]) -> dict[str, np.ndarray]:
    """Return cells as plain arrays, but for their structures, which follow from their
    boxes.
    """
    return arrays_of(
        [{"box": cell.box, "patches": cell.patches, "why": cell.why} for cell in cells]
    )


def from_arrays(family: Family, arrays: Mapping[str, np.ndarray]) -> list[Cell]:
    """Return the cells of a family that arrays hold."""
    cells = []
    for of_cell in parts(arrays):
        box = value_of(Box, under("box", of_cell))
        of_patches = parts(under("patches", of_cell))
        patches = [value_of(Patch, of_patch) for of_patch in of_patches]
        why = str(of_cell["why"].item())
        cells.append(Cell(box, structure_of(family, box), patches, why))

    return cells


def structure_of(family: Family, box: Box) -> Structure:
    """Return the structure of all walkers of a box."""
    return family.drive.common_structure(family.walkers(box.nodes(3)))


class Block:
    """Lines of a cell, at values of its keys (n, d) and slopes, or of what else drives
    in the walker's units (s,): n s points.

    `unit` are the coordinates of the keys, `drive` and `q` (n, s) the slopes or other
    drives as `problem`, with a lane for each line, counts them, and their logarithms.
    """

    def __init__(
        self,
        family: Family,
        cell: Cell,
        keys: np.ndarray,
        values: np.ndarray,
    ):
        self.cell = cell
        self.unit = cell.box.unit(keys)
        walkers = family.walkers(keys)
        self.problem = Lanes(walkers, cell.structure, family.drive)
        # In the units of each line.
        drive = values / np.reshape(family.drive.unit(walkers), (-1, 1))
        shape = (len(keys), len(values))
        self.drive = np.broadcast_to(drive, shape)
        self.q = np.broadcast_to(np.log(drive), shape)

    def on(self, patch: Patch) -> np.ndarray:
        """Return the indices of the points between the ends of a patch."""
        low, high = patch.span.ends(self.unit)[:, :, None]
        return np.flatnonzero((low <= self.q) & (self.q <= high))


class Lines:
    """Lines of a family that were surveyed, for one box or for another that holds them."""

    def __init__(self, family: Family):
        self.family = family
        self.keys = np.zeros((0, len(family.keys)))
        self.structures: list[Structure] = []
        self.pieces: list[list[Piece]] = []

    def at(
        self,
        box: Box,
        structure: Structure,
        wanted: np.ndarray,
    ) -> tuple[np.ndarray, list[list[Piece]]]:
        """Return coordinates and pieces of lines at or beside those wanted (n, d), then
        of all others in the box.

        Those that are not known are surveyed.
        """
        inside = [
            k
            for k, known in enumerate(self.structures)
            if known == structure and box.holds(self.keys[k])
        ]
        known = box.unit(self.keys[inside])
        numbers: list[int] = []
        new: list[np.ndarray] = []
        for unit in wanted:
            near = np.abs(known - unit).max(axis=1) < _NEAR_NODE
            if near.any():
                numbers.append(inside[near.argmax()])
            else:
                numbers.append(len(self.pieces) + len(new))
                new.append(unit)

        if new:
            self.survey(box.at(np.array(new)), structure)

        numbers += [k for k in inside if k not in numbers]
        return box.unit(self.keys[numbers]), [self.pieces[k] for k in numbers]

    def survey(self, keys: np.ndarray, structure: Structure) -> None:
        """Survey lines at values of the keys (n, d)."""
        walkers = self.family.walkers(keys)
        lines = Lanes(walkers, structure, self.family.drive)
        surveyed = survey_lines(lines, COARSE)
        self.keys = np.vstack([self.keys, keys])
        self.structures += [structure] * len(keys)
        self.pieces += [pieces_of(branches) for branches in surveyed]


def make_cell(
    family: Family,
    box: Box,
    window: tuple[float, float],
    lines: Lines,
    points: float,
    why: str = "",
) -> Cell:
    """Make the cell of a box for a window of slopes.

    Parameters
    ----------
    family : Family
    box : Box
    window : (float, float)
        Least and largest ln slope.
    lines : Lines
        Those surveyed so far, to which the cell's own are added.
    points : float
        About how many points it is for: good predictions of few are not worth many
        nodes.
    why : str, optional
        Why the cell is to have no patches.

    Raises
    ------
    Refused
        If the gaits in the box cannot be described as one.
    """
    maker = _Maker(family, box, window, lines, points)
    return Cell(box, maker.structure, [] if why else maker.patches(), why)


@dataclass(frozen=True)
class _End:
    """Where a piece ends over the keys: the chart of its ln slope with its error, the
    kind, and where walking ends.

    `kind` is `cut`, `fold`, `end`, a located one, or `beyond`: then the chart ends
    beyond that of walking, at most by `reach`. `vanishing` is as spans have it.
    """

    kind: str
    chart: Chart
    reach: float = 0.0
    vanishing: float = 0.0

    def at(self, unit: np.ndarray) -> np.ndarray:
        """Return ln slopes (n,) at coordinates (n, d)."""
        return self.chart(unit)[0]


class _Maker(Maker):
    """Makes the patches of one box and window."""

    def __init__(
        self,
        family: Family,
        box: Box,
        window: tuple[float, float],
        lines: Lines,
        points: float,
    ):
        super().__init__(family, box, structure_of(family, box))
        self.window = window
        self.known = lines
        self.total = max(_LEAST_NODES * self.d, int(points / 2))
        #: Ends of pieces over the keys, by the point at the centre.
        self.located: dict[bytes, Chart] = {}

    def patches(self) -> list[Patch]:
        self.check_tuning()
        self.begin()
        return self.checked([self.patch(group) for group in self.groups()])

    def begin(self) -> None:
        """Survey the lines at the centre, the corners and a random place; others may be
        known.
        """
        wanted = np.vstack(
            [np.full((1, self.d), _CENTRE), self.box.corners(_CORNER), self.box.lot()]
        )
        self.unit, self.lines = self.known.at(self.box, self.structure, wanted)
        self.few = len(wanted) - 1

    def check_tuning(self) -> None:
        """Refuse a box with tuned walkers, beside which special points move by powers,
        unless they stay off the window.

        Others have them at slopes of the order of that at which the still walker, legs
        together, is balanced.
        """
        middle = self.problem(np.zeros((1, self.d))).walker
        gentlest = self.family.drive.like_slope(middle, float(np.exp(self.window[0])))
        for axis in range(self.d):
            tuning = Tuning(self.family, self.box, axis)
            if tuning.largest < _BALANCED * gentlest:
                continue

            low = self.box.low[axis]
            high = self.box.high[axis]
            for share, face, is_tuned in zip(
                (_SLIVER, 1 - _SLIVER), (low, high), tuning.at_faces(), strict=True
            ):
                if is_tuned:
                    at = low + share * (high - low)
                    raise Refused("tuned walkers at a face", axis, at, face)

            if (value := tuning.inside()) is not None:
                raise Refused("tuned walkers inside", axis, value)

    def groups(self) -> list[list[Piece]]:
        """Pieces that come near the window on any line at the centre and the corners,
        each on all of these.
        """
        low = self.window[0] - _CLEAR
        high = self.window[1] + _CLEAR
        groups: list[list[Piece]] = []
        for group in match(self.lines[: self.few], low, high):
            known = [piece for piece in group if piece is not None]
            if not any(piece.q[1] > low and piece.q[0] < high for piece in known):
                continue
            if len(known) < len(group):
                present = np.array([piece is not None for piece in group], float)
                raise Refused(
                    f"{len(known)} of {len(group)} lines have a piece",
                    self.rougher(present),
                )

            groups.append(known)

        return groups

    def rougher(self, values: np.ndarray) -> int:
        """The key along which values at the centre and the corners (1 + 2^d,) change
        most.
        """
        corners = values[1:].reshape((2,) * self.d)
        changes = [np.abs(np.diff(corners, axis=k)).sum() for k in range(self.d)]
        return int(np.argmax(changes))

    def both_ends(self, group: list[Piece]) -> list[_End]:
        """Both ends of a piece over the box: where it is cut it goes on, and never
        before its other end.
        """
        ends = [self.end(group, k, self.window[k]) for k in (0, 1)]
        for k, sign in enumerate((-1, 1)):
            if ends[k].kind == CUT and ends[1 - k].kind != CUT:
                other = ends[1 - k].at(tensor_nodes((_PLACES,) * self.d))
                least = float((other * sign).max() + _WIDTH) * sign
                if sign * (least - self.window[k]) > 0:
                    ends[k] = self.end(group, k, least)

        return ends

    def end(
        self,
        group: list[Piece],
        k: int,
        edge: float,
    ) -> _End:
        """The lower (0) or upper (1) end of a piece over the box: cut beyond an `edge`
        on all lines, or its own.
        """
        sign = (-1, 1)[k]
        q = np.array([piece.q[k] for piece in group])
        beyond = sign * (q - edge)
        if (beyond > _CLEAR).all():
            cut = edge + sign * min(2 * _CLEAR, 0.5 * float(beyond.min()))
            return _End(CUT, Chart((1,) * self.d, np.array([[cut]]), error=0.0))

        if beyond.max() > _REACH:
            why = "a piece ends in the window or far from it"
            raise Refused(why, self.rougher(np.clip(beyond, -1, _REACH)))

        return self.end_of_piece(group, k, q)

    def end_of_piece(
        self,
        group: list[Piece],
        k: int,
        q: np.ndarray,
    ) -> _End:
        """The lower (0) or upper (1) end of a piece, of which lines have it at ln slopes
        q (n,).
        """
        if all(piece.vanishes(k) for piece in group):
            return self.small_steps(group, k)

        # Near vanishing steps the slope is a smooth function of angle over rate, on
        # whose square the angle depends.
        rate = max(piece.rate_beside(k) for piece in group)
        vanishing = 2 * float(np.log(rate)) if rate > FAST else 0.0
        kinds, number = np.unique(
            [piece.kinds[k] for piece in group], return_inverse=True
        )
        if len(kinds) == 1 and kinds[0] in LOCATED:
            slope = self.located_end(group, k, str(kinds[0]))
            if kind_of(str(kinds[0])).turns_slope:
                return _End(FOLD, slope)
            return _End(END, slope, vanishing=vanishing)

        if EVENTS.issuperset(kinds.tolist()):
            return self.event(q, (-1, 1)[k], vanishing)

        why = f"a piece ends at {' or '.join(kinds)}"
        raise Refused(why, self.rougher(number.astype(float)))

    def small_steps(self, group: list[Piece], k: int) -> _End:
        """An end at steps of a small angle, nearly where they vanish."""
        known = np.column_stack([piece.small_step(k, _SMALL) for piece in group])
        unit = self.unit[: self.few]
        points = make_ends(self, "small_step", unit, known, self.total, _SMALL)
        slope = replace(
            points,
            coefficients=points.coefficients[:, -1:],
            error=max(points.error, _BEFORE_VANISHING * math.exp(2 * _SMALL)),
        )
        angles = group[0].branch.Z[0, group[0].first : group[0].last + 1]
        return _End(END, slope, vanishing=2 * (float(angles.max()) - _SMALL))

    def located_end(
        self,
        group: list[Piece],
        k: int,
        kind: str,
    ) -> Chart:
        """The chart of the ln slopes of an end of one kind."""
        known = np.column_stack([piece.end_point(k) for piece in group])
        name = known[:, 0].tobytes()
        if name not in self.located:  # two pieces meet at a fold
            unit = self.unit[: self.few]
            self.located[name] = make_ends(self, kind, unit, known, self.total)
        points = self.located[name]
        return replace(points, coefficients=points.coefficients[:, -1:])

    def event(
        self,
        q: np.ndarray,
        sign: int,
        vanishing: float,
    ) -> _End:
        """An end beyond that of walking, from ln slopes at the centre and the corners."""
        reach = _CLEAR + 0.02 * float(np.ptp(q))
        chart = Chart.of_corners(self.unit[: self.few], q[None] + sign * reach)
        return _End(BEYOND, replace(chart, error=0.0), 2 * reach, vanishing)

    def patch(self, group: list[Piece]) -> Patch:
        """The patch of a piece."""
        low, high = self.both_ends(group)
        sizes = tuple(np.maximum(low.chart.sizes, high.chart.sizes).tolist())
        nodes = tensor_nodes(sizes)
        span = Span(
            Chart.through(sizes, np.array([low.at(nodes), high.at(nodes)])),
            folds=(low.kind == FOLD, high.kind == FOLD),
            vanishing=(low.vanishing, high.vanishing),
        )
        gaits, side = self.gaits(group, span)

        return Patch(
            lines=self.unit[: self.few],
            numbers=np.array([[piece.number, piece.place] for piece in group]),
            span=span,
            kinds=(low.kind, high.kind),
            end_errors=np.array([low.chart.error, high.chart.error]),
            reach=np.array([low.reach, high.reach]),
            gaits=gaits,
            measured=self.measured(span, gaits),
            side=side,
        )

    def measured(self, span: Span, gaits: Chart) -> Measured:
        """What the error bounds of the gaits of a span need, along it."""
        points = tensor_nodes((_MEASURED[0], *[_MEASURED[1]] * self.d))
        problem = self.problem(points[:, 1:])
        q = span.log_slope(points)
        along = measured(problem, gaits(points), q, _MEASURED[1] ** self.d)
        if any(span.vanishing):
            # Rounding over step size grows from node to node: it is measured at each
            # gait.
            along[-1][:] = np.nan

        return along

    def gaits(self, group: list[Piece], span: Span) -> tuple[Chart, float]:
        """The chart of the gaits of a piece over a span, and the side of a fold on
        which all lie.
        """
        purpose = f"patch {group[0].number} {group[0].place}"
        drawn = self.box.draw(_DRAWN, 1 + self.d, purpose)
        way = _Way(self, group, span)

        def attempt(sizes: tuple[int, ...], before: Chart | None) -> Chart:
            chart = Chart.through(sizes, way.solved(tensor_nodes(sizes), before))
            w = chart(drawn)
            step = np.abs(newton_step(self.stride(span, drawn, w), w)).max(axis=0)
            off = np.nan_to_num(step * span.distance(drawn), nan=np.inf)
            return replace(chart, error=float(off.max()))

        first = (_FIRST[0], *[_FIRST[1]] * self.d)
        most = (_MOST, *[_MOST_OF_KEYS[self.d - 1]] * self.d)
        begun = attempt(first, None)
        gaits = fit(begun, attempt, most, self.total, _GOOD, _FAIR, self.d)
        sides = side_of_fold(self.stride(span, drawn, gaits(drawn)))
        if not (sides == way.side).all():
            raise Refused("a fold lies inside")

        return gaits, way.side

    def stride(
        self,
        span: Span,
        points: np.ndarray,
        w: np.ndarray,
    ) -> Any:
        """Steps from gaits (m + k, n) at points of a span."""
        return self.problem(points[:, 1:]).stride(w, span.log_slope(points))[0]

    def is_near(
        self,
        low: float,
        high: float,
        beyond: float,
    ) -> bool:
        """Whether a range of ln slopes reaches the window, or `beyond` of it."""
        return high > self.window[0] - beyond and low < self.window[1] + beyond

    def checked(self, patches: list[Patch]) -> list[Patch]:
        """Patches that have all pieces of all lines and no others, and whose ends are
        what they should be.
        """
        for number, (unit, line) in enumerate(zip(self.unit, self.lines, strict=True)):
            within = _ALIKE[0 if number < self.few else 1]
            pieces = [piece for piece in line if self.is_near(*piece.q, 0.5 * _CLEAR)]
            for patch in patches:
                self.take_piece(patch, pieces, unit[None], within)
            if any(self.is_near(*piece.q, 0.0) for piece in pieces):
                raise Refused("a line has a further piece")

        for patch in patches:
            self.check_ends(patch)
        return patches

    def take_piece(
        self,
        patch: Patch,
        pieces: list[Piece],
        unit: np.ndarray,
        within: float,
    ) -> None:
        """Take a line's piece that a patch has from those that are left, or refuse the
        patch if there is none and ought to be.
        """
        off = [self.compare(patch, piece, unit) for piece in pieces]
        if off and min(off) < within:
            pieces.pop(int(np.argmin(off)))
            return
        low, high = patch.span.ends(unit)[:, 0] + [1, -1] * patch.reach
        if self.is_near(low, high, 0.5 * _CLEAR):
            raise Refused("a line lacks a piece")

    def check_ends(self, patch: Patch) -> None:
        """Refuse a patch that is cut where gaits are no steps, or beyond whose ends of
        walking they are.
        """
        edges = np.array(list(itertools.product((-1.0, 0.0, 1.0), repeat=self.d)))
        for position, kind in zip((-1.0, 1.0), patch.kinds, strict=True):
            if kind not in (CUT, BEYOND):
                continue

            points = np.column_stack([np.full(len(edges), position), edges])
            q = patch.span.log_slope(points)
            _, check = verify_steps(self.problem(edges), patch.gaits(points), q)
            if check.doubt.any():
                why = "samples do not tell whether gaits at a piece's end are steps"
                raise Refused(why)

            if kind == CUT and not check.step.all():
                raise Refused("a piece ends before it is cut")
            if kind == BEYOND and check.step.any():
                raise Refused("walking goes on beyond its end")

    def compare(
        self,
        patch: Patch,
        piece: Piece,
        unit: np.ndarray,
    ) -> float:
        """How far a patch is from a piece of a line, at three slopes that both have;
        infinite where there is none.
        """
        ends = patch.span.ends(unit)[:, 0]
        low = max(ends[0], piece.q[0])
        high = min(ends[1], piece.q[1])
        if low >= high:
            return np.inf

        q = low + (high - low) * np.array([0.2, 0.5, 0.8])
        w = patch.gaits(patch.span.points(q, np.repeat(unit, 3, axis=0)))
        return float(np.abs(w - piece.gaits(q)).max())


class _Way:
    """Gaits of a piece, of lines at the centre and the corners of a box, carried to
    other points of a span.
    """

    def __init__(
        self,
        maker: _Maker,
        group: list[Piece],
        span: Span,
    ):
        self.maker = maker
        self.group = group
        self.span = span
        self.piece = group[0]
        centre = maker.unit[:1]
        ends = span.points(np.array(self.piece.q), np.repeat(centre, 2, axis=0))
        self.low, self.high = np.clip(ends[:, 0], -1, 1).tolist()
        middle = np.array([[0.5 * (self.low + self.high), *centre[0]]])
        w = self.piece.gaits(span.log_slope(middle))
        self.side = float(side_of_fold(maker.stride(span, middle, w))[0])

    def newton(
        self, points: np.ndarray, guess: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Gaits near guesses (m + k, n), and whether they are on the right side of
        folds, (n,).
        """
        problem = self.maker.problem(points[:, 1:])
        q = self.span.log_slope(points)
        w, converged = newton(problem, guess, q, enough=_ENOUGH)
        off = np.abs(w - guess) / np.maximum(1.0, np.abs(guess) / FAST)
        fair = converged & (off.max(axis=0) < _MAX_STRIDE_ERROR)
        fair &= side_of_fold(problem.stride(w, q)[0]) == self.side
        return w, fair

    def solved(self, points: np.ndarray, before: Chart | None) -> np.ndarray:
        """Gaits at points (n, 1 + d), shape (m + k, n)."""
        guesses = before or self.between
        w, fair = self.newton(points, guesses(points))
        if not fair.all():
            w[:, ~fair] = self.carried(points[~fair], guesses)
        return w

    def between(self, points: np.ndarray) -> np.ndarray:
        """Guesses (m + k, n) between the lines, at the positions of points (n, 1 + d)."""
        lines = self.maker.unit[: self.maker.few]
        position, place = np.unique(points[:, 0], return_inverse=True)
        n = len(position)
        of_lines = []
        for piece, unit in zip(self.group, lines, strict=True):
            on_line = np.column_stack([position, np.tile(unit, (n, 1))])
            of_lines.append(piece.gaits(self.span.log_slope(on_line)).ravel())

        between = Chart.of_corners(lines, np.array(of_lines).T)(points[:, 1:])
        at_all = between.reshape(-1, n, len(points))
        return np.asarray(at_all[:, place, np.arange(len(points))])

    def carried(
        self, points: np.ndarray, guesses: Callable[[np.ndarray], np.ndarray]
    ) -> np.ndarray:
        """Gaits carried to points (n, 1 + d) along straight lines, as what they are off
        guesses.
        """
        centre = np.tile(self.maker.unit[0], (len(points), 1))
        position = np.clip(points[:, 0], self.low, self.high)
        start = np.column_stack([position, centre])
        known = self.piece.gaits(self.span.log_slope(start))
        gaits = Carried(known - guesses(start), _STRIDE)

        def correct(
            active: np.ndarray,
            share: np.ndarray,
            off: np.ndarray,
        ) -> tuple[np.ndarray, np.ndarray]:
            at = start[active] + share[:, None] * (points - start)[active]
            guess = guesses(at)
            w, fair = self.newton(at, guess + off)
            return w - guess, fair

        there = gaits.carry(correct)
        if not there.all():
            lost = np.abs(points - start)[~there, 1:]
            why = f"a gait is lost on its way to {len(lost)} nodes"
            raise Refused(why, int(lost.sum(axis=0).argmax()))

        return gaits.Z + guesses(points)
