"""How a box of keys is divided where it cannot be described as one: into cells for panels of slopes, or landscapes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

import numpy as np

from tasks.costs import MAX_SURVEYED
from tasks.families.box import Box, Refused
from tasks.families.cell import FEW, Cell, Family, make_cell

#: Largest excess of halvings along one key over those along another: changes in a box may follow a curve that halving
#: along one key never leaves.
_MAX_UNEVENNESS = 2
#: Most halvings of a box, and fewest lines for which making its patches pays.
_MAX_SPLITS, _MIN_LINES = 6, 24

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
            axis = refused.axis if halved[refused.axis] < halved.min() + _MAX_UNEVENNESS else int(halved.argmin())
            left += [((*place, (i, axis)), half) for i, half in enumerate(part.halves(axis))]
    return [parts[place] for place in sorted(parts)]


class Cells:
    """Makes the cells of a box panel by panel, as long as that takes less than its lines one by one.

    Parameters
    ----------
    family : Family
    box : Box
    values : sequence of sequences of float
        Values of each key in the box that a study has [the walker's units].
    """

    def __init__(self, family: Family, box: Box, values: Sequence[Sequence[float]]):
        self.family, self.box, self.values = family, box, [np.asarray(each) for each in values]
        #: Parts whose lines are surveyed one by one, and what was surveyed so far: parts and nodes along each key.
        self.alone: list[Box] = []
        self.surveyed: set[tuple[Box, int]] = set()

    def make(self, low: float) -> list[Cell]:
        """Make the cells for the panel from ln slope `low` on."""

        def cell(box: Box, why: str) -> Cell:
            return make_cell(self.family, box, low, self.surveyed, why)

        cells = divide(self.box, cell, self._is_worth, _MAX_SPLITS)
        self.alone += [each.box for each in cells if each.why and self._left(each.box)]
        return cells

    def _is_worth(self, part: Box) -> bool:
        """Whether a part has enough lines, and was tried before or may be tried after all that was surveyed."""
        spent = sum(_number_of_lines(len(box.keys), n) for box, n in self.surveyed)
        is_new = (part, FEW) not in self.surveyed
        return self._left(part) >= _MIN_LINES and not (is_new and spent > MAX_SURVEYED * self.box.count(self.values))

    def _left(self, part: Box) -> int:
        """About how many lines of a part are not surveyed one by one for the sake of another panel."""
        return part.count(self.values) - sum(part.common(other).count(self.values) for other in self.alone)


def _number_of_lines(d: int, n: int) -> int:
    """How many lines are surveyed for n nodes along each of d keys."""
    return int(n**d + (1 + 2**d) * (n == FEW))
