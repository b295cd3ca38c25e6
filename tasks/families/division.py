"""How a box of keys is divided where it cannot be described as one: into cells, or landscapes."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numpy as np

from gaitsweep.tasks.families.box import Box, Refused
from gaitsweep.tasks.families.cell import Cell, Lines, make_cell
from gaitsweep.tasks.families.family import Family

#: Largest excess of halvings along one key over those along another: changes in a box may follow a curve that halving
#: along one key never leaves.
_MAX_UNEVENNESS = 2
#: Most halvings of a box, and fewest lines for which making its patches pays.
_MAX_SPLITS, _MIN_LINES = 8, 12
#: Share of the time of a plane's lines that its charts may take in vain, the time of a surveyed line with all that is
#: made of it, over that of a line, and the least share of their time that lines in described boxes save.
_IN_VAIN, _A_SURVEY, _SAVED = 0.1, 1.5, 0.5
Part = TypeVar("Part")


def divide(box: Box, make: Callable[[Box, str], Part], is_worth: Callable[[Box], bool], splits: int) -> list[Part]:
    """Make the parts into which a box must be divided, the largest first.

    Parameters
    ----------
    box : Box
    make : callable
        Makes a part of a box or raises Refused; with a reason, makes an empty one that gives it.
    is_worth : callable
        Whether making a box pays.
    splits : int
        How often the box may be halved.

    Returns
    -------
    list
        Lower halves before upper ones.
    """
    # The place of a part: for each time that it was halved the half, 0 or 1, and the key.
    parts: dict[tuple[tuple[int, int], ...], Part] = {}
    left: list[tuple[tuple[tuple[int, int], ...], Box]] = [((), box)]
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
            halved = np.bincount([key for _, key in place], minlength=len(box.keys))
            is_even = halved[refused.axis] < halved.min() + _MAX_UNEVENNESS
            axis = refused.axis if is_even or refused.at is not None else int(halved.argmin())
            left += [((*place, (i, axis)), half) for i, half in enumerate(part.parts(axis, refused.at, refused.origin))]
    return [parts[place] for place in sorted(parts)]


def make_cells(family: Family, box: Box, window: tuple[float, float], count: int, slopes: int) -> list[Cell]:
    """Make the cells of a box for a window of slopes, as long as that takes less than its lines one by one.

    Parameters
    ----------
    family : Family
    box : Box
    window : (float, float)
        Least and largest ln slope.
    count, slopes : int
        About how many lines and slopes it is for.
    """
    lines = Lines(family)
    described: list[float] = []  # lines in boxes that were

    def cell(part: Box, why: str) -> Cell:
        inside = box.share(part) * count
        made = make_cell(family, part, window, lines, inside * slopes, why)
        described.append(0.0 if why else inside)
        return made

    def is_worth(part: Box) -> bool:
        is_paid = _A_SURVEY * len(lines.pieces) <= _IN_VAIN * count + _SAVED * sum(described)
        return box.share(part) * count >= _MIN_LINES and is_paid

    return divide(box, cell, is_worth, _MAX_SPLITS)
