"""Tables of states that somebody holds for gaits: read from CSV, or taken from Python.

Each number keeps the place of the last digit that was written, by which a table says how
exact it is: to as many decimals, or to as many digits, as any of a column has.
"""

import csv
import io
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np

from gaitsweep.pipeline.dispatch import ask
from gaitsweep.pipeline.errors import StudyError
from gaitsweep.pipeline.study import files
from gaitsweep.pipeline.study.location import Location, clip

#: Most rows of a table, and MiB of a file.
MOST_ROWS, _MOST_MIB = 1_000_000, 256


@dataclass(frozen=True)
class States:
    """Columns of a convention, as they were given: values (n,), the sizes of their last
    digits, and of the last ones that the table would have given; `slope` is among them
    where the table has one.
    """

    values: dict[str, np.ndarray]
    digits: dict[str, np.ndarray]
    sizes: dict[str, np.ndarray]

    @property
    def count(self) -> int:
        """Number of rows."""
        return len(next(iter(self.values.values())))


def from_csv(
    path: Path, convention: str, renamed: Mapping[str, str]
) -> tuple[States, list[dict[str, str]]]:
    """Read states from a CSV file with a head.

    Returns
    -------
    states : States
    rows : list of dict
        The cells as they stand.

    Raises
    ------
    StudyError
        If the file cannot be read, has no rows, or lacks a column or has one twice.
    """
    text = files.read_text(path, path.name, _MOST_MIB)
    lines = [row for row in csv.reader(io.StringIO(text)) if any(map(str.strip, row))]
    if not lines:
        raise StudyError(f"{path.name} is empty.")

    heads = [head.strip() for head in lines[0]]
    for number, row in enumerate(lines[1:], 1):
        if len(row) != len(heads):
            raise StudyError(
                f"Row {number} of {path.name} must have {len(heads)} cells as its head;"
                f" got {len(row)}."
            )

    columns = list(zip(*lines[1:], strict=True)) or [()] * len(heads)
    named = _renamed(heads, renamed)
    _check_once(named)
    table = dict(zip(named, columns, strict=True))

    return _states(table, convention), [
        dict(zip(heads, row, strict=True)) for row in lines[1:]
    ]


def from_python(table: Any, convention: str, renamed: Mapping[str, str]) -> States:
    """Take states from a DataFrame, a Dataset, a mapping of columns, or an array of rows
    with the columns of the convention without the swing leg's angle.

    Raises
    ------
    StudyError
        If it is none of these, has no rows, or lacks a column or has one twice.
    """
    if hasattr(table, "to_dataframe"):  # a Dataset
        table = table.to_dataframe().reset_index()
    if hasattr(table, "columns"):
        names = [str(name) for name in table.columns]
        columns = [table.iloc[:, place].tolist() for place in range(len(names))]
    elif isinstance(table, Mapping):
        names = [str(name) for name in table]
        columns = [
            np.atleast_1d(np.asarray(column)).tolist() for column in table.values()
        ]
    else:
        names, columns = _of_rows(table, convention)

    named = _renamed(names, renamed)
    _check_once(named)
    if len({len(column) for column in columns}) > 1:
        raise StudyError("The columns of `table` must be of one length.")

    return _states(dict(zip(named, columns, strict=True)), convention)


def _of_rows(table: Any, convention: str) -> tuple[list[str], list[list[Any]]]:
    """Names and columns of an array of rows."""
    about = _about(convention)
    names = [name for name in about["columns"] if name not in about["optional"]]
    try:
        rows = np.atleast_2d(np.asarray(table, float))
    except (TypeError, ValueError):
        rows = np.empty((0, 0, 0))

    if rows.ndim != 2 or (rows.size and rows.shape[1] != len(names)):
        shape = "x".join(map(str, np.shape(table))) if rows.ndim == 2 else "no array"
        raise StudyError(
            f"`table` must be a table, or rows of {len(names)} numbers"
            f" ({', '.join(names)}); got {shape}."
        )

    columns = rows.T.tolist() if rows.size else [[] for _ in names]
    return names, columns


def _about(convention: str) -> dict[str, Any]:
    """Columns of a convention.

    Raises
    ------
    StudyError
        If there is no such one.
    """
    about: dict[str, Any] = ask("convention", {"convention": convention})
    Location("", "convention").check_names([convention], about["names"], "convention")
    return about


def _renamed(names: Sequence[str], renamed: Mapping[str, str]) -> list[str]:
    Location("", "map").check_names(renamed, names, "column")
    return [renamed.get(name, name) for name in names]


def _check_once(names: Sequence[str]) -> None:
    for name, count in Counter(names).items():
        if count > 1:
            raise StudyError(
                f"Column `{clip(name)}` must stand once; got it {count} times."
            )


def _states(table: Mapping[str, Sequence[Any]], convention: str) -> States:
    """The convention's columns of a table, and its slopes, as numbers."""
    about = _about(convention)
    for name in about["columns"]:
        if name not in table and name not in about["optional"]:
            raise StudyError(
                f"Column `{name}` is missing, got {clip(', '.join(table) or 'none', 200)};"
                " `map` names columns."
            )

    _check_one_walker(table.get("walker", ()))
    wanted = [name for name in (*about["columns"], "slope") if name in table]
    count = len(table[wanted[0]])
    if not 1 <= count <= MOST_ROWS:
        raise StudyError(f"The table must have 1 to {MOST_ROWS:,} rows; got {count:,}.")

    values, digits, sizes = {}, {}, {}
    for name in wanted:
        read = [_read(name, row, cell) for row, cell in enumerate(table[name], 1)]
        values[name] = np.array([value for value, _ in read], float)
        digits[name] = np.array([digit for _, digit in read], float)
        sizes[name] = _sizes(values[name], digits[name])

    return States(values, digits, sizes)


def _check_one_walker(names: Sequence[Any]) -> None:
    """Check that a column `walker`, as `gaitsweep reference` prints, names one."""
    distinct = list(dict.fromkeys(str(name).strip() for name in names))
    if len(distinct) > 1:
        raise StudyError(
            f"Column `walker` must name one walker; got {clip(', '.join(distinct))}:"
            " `check` compares all rows with `--walker`."
        )


def _sizes(values: np.ndarray, digits: np.ndarray) -> np.ndarray:
    """Sizes (n,) of the last digits that a column gives: that of its most decimals, or of
    its most digits, whichever is larger.
    """
    known = np.isfinite(values) & (digits > 0)
    if not known.any():
        return np.zeros(len(values))

    finest = digits[known].min()
    decade = np.full(len(values), -np.inf)
    some = known & (values != 0)
    decade[some] = np.floor(np.log10(np.abs(values[some])))
    if not some.any():
        return np.full(len(values), finest)

    most = np.max(decade[some] - np.round(np.log10(digits[some])))
    return np.asarray(np.maximum(finest, 10.0 ** (decade - most)))


def _read(name: str, row: int, cell: Any) -> tuple[float, float]:
    """A cell as a number, with the size of its last digit; NaN of an empty one."""
    text = str(cell).strip()
    if not text:
        return math.nan, 0.0

    try:
        if isinstance(cell, bool) or not text.isascii() or "_" in text:
            raise ValueError
        value = float(text)
    except ValueError:
        raise StudyError(
            f"`{name}` must be a number; got {clip(repr(text))} in row {row}."
        ) from None

    if not math.isfinite(value):
        return math.nan, 0.0

    return value, _last_digit(text)


def _last_digit(text: str) -> float:
    """Size of the last digit of a number as it is written."""
    mantissa, _, exponent = text.lower().partition("e")
    decimals = len(mantissa.partition(".")[2])
    # In decimals, since the exponent of 0 may be any.
    return float(Decimal(1).scaleb(int(exponent or 0) - decimals))
