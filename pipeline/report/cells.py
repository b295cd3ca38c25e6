"""Cells of tables: texts, each number with the exact value that it rounds."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from gaitsweep.pipeline.report.words import WORDS, phrased, plain, spaced


@dataclass(frozen=True)
class Cell:
    """Text of a table cell, and the number that it rounds (None for words).

    `counted` marks numbers that the report counts, which are not in the archive.
    """

    text: str
    value: float | None = None
    counted: bool = False

    @property
    def long(self) -> bool:
        """Whether the text needs a wide column."""
        return self.value is None and len(self.text) > 24

    @property
    def exact(self) -> str:
        """The number with all its digits; empty for words."""
        return "" if self.value is None else repr(self.value)


def cell(value: Any, counted: bool = False, digits: int = 6) -> Cell:
    """Make a cell of a value: numbers are shown with `digits` significant digits and
    kept exactly.
    """
    if isinstance(value, (bool, np.bool_)):
        return Cell("yes" if value else "no")

    if isinstance(value, (int, np.integer)):
        number = int(value)
        text = str(number).replace("-", "−")
        return Cell(text, number, counted)

    if isinstance(value, (float, np.floating)):
        if np.isnan(value):
            return Cell("–")
        real = float(value)
        text = plain(real, digits)
        return Cell(text, real, counted)

    return Cell(WORDS["names"].get(value) or phrased(str(value)))


#: Names of columns of words, of flags and of errors.
_KINDS = WORDS["kinds"]


def column_cells(name: str, frame: pd.DataFrame) -> list[Cell]:
    """Make the cells of one column of a frame: six digits for each number, or those
    that tell the two numbers of a pair apart.
    """
    column = frame[name]
    if name in _KINDS["coded"]:
        return [Cell(spaced(value)) for value in column]
    if name in _KINDS["flags"] and set(column) <= {0, 1}:
        return [cell(bool(value)) for value in column]
    if column.dtype.kind != "f":
        return [cell(value) for value in column]

    numbers = column.tolist()
    if name in _KINDS["errors"]:
        return [cell(value, digits=2) for value in numbers]

    for pair in _KINDS["pairs"]:
        if name in pair and set(pair) <= set(frame.columns):
            ends = [frame[end].to_numpy() for end in pair]
            digits = _telling_apart(*ends)
            return [
                cell(value, digits=enough)
                for value, enough in zip(numbers, digits, strict=True)
            ]

    decimals = _decimals(column.to_numpy())
    if decimals is None:
        return [cell(value) for value in numbers]

    return [_fixed(value, decimals) for value in numbers]


def _fixed(value: float, decimals: int) -> Cell:
    """The cell of a number with so many decimals; 0 is told as such."""
    if not value or not np.isfinite(value):
        return cell(value)
    text = f"{value:.{decimals}f}"
    return Cell(text.replace("-", "−"), value)


def _telling_apart(x: np.ndarray, y: np.ndarray) -> list[int]:
    """Significant digits with which the two numbers of each pair differ in the last
    two: six at least, and at most those that tell any two numbers apart.
    """
    with np.errstate(invalid="ignore", over="ignore"):  # they may be infinite
        gap = np.abs(x - y)
    differ = np.isfinite(gap) & (gap > 0)
    size = np.maximum(np.abs(x), np.abs(y))
    apart = np.divide(gap, size, out=np.ones(gap.shape), where=differ)
    digits = np.ceil(-np.log10(apart)) + 1
    enough = np.clip(digits, 6, 17)
    return [int(n) for n in enough]


def _decimals(values: np.ndarray) -> int | None:
    """Decimals with which the numbers of a column are comparable; None if they span too
    much.
    """
    sizes = np.abs(values[np.isfinite(values) & (values != 0)])
    if not len(sizes):
        return None

    smallest = sizes.min()
    largest = sizes.max()
    if smallest < 1e-4 or largest >= 1e6 or largest > 2e3 * smallest:
        return None

    # Numbers of a few digits, such as the values of an axis, are shown as they are.
    for decimals in range(7):
        if np.allclose(sizes, np.round(sizes, decimals), rtol=0, atol=1e-12):
            return decimals

    return max(0, 5 - int(np.floor(np.log10(largest))))
