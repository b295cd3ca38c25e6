"""How a box of keys is divided where it cannot be described as one: into cells, or
landscapes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple, TypeVar

from gaitsweep.tasks.charts.box import Box, Refused
from gaitsweep.tasks.charts.cell import Cell, Lines, make_cell
from gaitsweep.tasks.charts.family import Family
from gaitsweep.tasks.charts.tuning import Tuning

#: Largest excess of halvings along one key over those along another: changes in a box
#: may follow a curve that halving along one key never leaves.
_MAX_UNEVENNESS = 2
#: How often a box may be divided, and fewest lines for which making its patches pays.
_MAX_SPLITS = 8
_MIN_LINES = 12
#: Share of the time of a plane's lines that its charts may take in vain, the time of a
#: surveyed line with all that is made of it, over that of a line, and the least share
#: of their time that lines in described boxes save.
_IN_VAIN = 0.1
_A_SURVEY = 1.5
_SAVED = 0.5
Part = TypeVar("Part")


class Cells(NamedTuple):
    """The cells of a box, or its halves, and how many lines were surveyed for it in
    vain.
    """

    made: list[Cell]
    halves: Sequence[Box] = ()
    surveyed: float = 0.0


def divide(
    box: Box,
    make: Callable[[Box, str], Part],
    is_worth: Callable[[Box], bool],
    splits: int,
) -> list[Part]:
    """Make the parts into which a box must be divided, the largest first.

    Parameters
    ----------
    box : Box
    make : callable
        Makes a part of a box or raises Refused; with a reason, makes an empty one that
        gives it.
    is_worth : callable
        Whether making a box pays.
    splits : int
        How often the box may be halved.

    Returns
    -------
    list
        Lower halves before upper ones.
    """
    # The place of a part is for each division the half, 0 or 1.
    parts: dict[tuple[int, ...], Part] = {}
    left: list[tuple[tuple[int, ...], Box]] = [((), box)]
    for place, part in left:  # which grows
        if not is_worth(part):
            parts[place] = make(part, "few walkers")
            continue

        try:
            parts[place] = make(part, "")
        except Refused as refused:
            if len(place) == splits:
                parts[place] = make(part, str(refused))
                continue
            left += [
                ((*place, i), half) for i, half in enumerate(halves(part, refused))
            ]

    return [parts[place] for place in sorted(parts)]


def halves(box: Box, refused: Refused) -> tuple[Box, Box]:
    """Divide a box that was refused: along the key that it tells, or along another that
    was halved too rarely.
    """
    axis = refused.axis
    halved = box.halved or (0,) * len(box.keys)
    if refused.at is None and halved[axis] >= min(halved) + _MAX_UNEVENNESS:
        axis = halved.index(min(halved))
    return box.parts(axis, refused.at, refused.origin)


def make_cells(
    family: Family,
    box: Box,
    window: tuple[float, float],
    lines_in: Callable[[Box], float],
    slopes: int,
    surveyed: float = 0.0,
    many: float = math.inf,
) -> Cells:
    """Make the cells of a box for a window of slopes, as long as that takes less than
    its lines one by one.

    Parameters
    ----------
    family : Family
    box : Box
    window : (float, float)
        Least and largest ln slope.
    lines_in : callable
        About how many lines of those that it is for lie in a part of the box.
    slopes : int
        About how many slopes it is for.
    surveyed : float
        Lines that were surveyed in vain before.
    many : float
        Lines from which on a box that cannot be described whole is halved and its
        halves are left to others.
    """
    if not box.origin:
        tuned = [Tuning(family, box, axis).outside() for axis in range(len(box.keys))]
        box = replace(box, origin=tuple(value or 0.0 for value in tuned))

    lines = Lines(family)
    count = lines_in(box)
    described: list[float] = []  # lines in boxes that were

    def cell(part: Box, why: str) -> Cell:
        inside = lines_in(part)
        made = make_cell(family, part, window, lines, inside * slopes, why)
        described.append(0.0 if why else inside)
        return made

    def is_worth(part: Box) -> bool:
        in_vain = _A_SURVEY * (surveyed + len(lines.pieces))
        return lines_in(
            part
        ) >= _MIN_LINES and in_vain <= _IN_VAIN * count + _SAVED * sum(described)

    if count < many or not is_worth(box):
        return Cells(divide(box, cell, is_worth, _MAX_SPLITS))

    try:
        return Cells([cell(box, "")])
    except Refused as refused:
        return Cells([], halves(box, refused), surveyed + len(lines.pieces))
