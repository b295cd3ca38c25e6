"""Measurements of the user's own, shown beside the curves: `[figures.overlay] file =
"measured.csv"`.
"""

import csv
import re
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from gaitsweep.pipeline.study import files, units
from gaitsweep.pipeline.study.location import Location, clip
from gaitsweep.pipeline.study.model import Axis, Lines, Study
from gaitsweep.tasks.contract.registry import GAITS, SI_UNITS, VARIABLES

Columns = dict[str, np.ndarray]
_MAX_MIB, _MAX_ROWS = 4, 20_000
#: Other spellings of units, and factors of units that are converted.
_SPELLINGS = {"": "1", "-": "1", "m/s": "m s-1", "rad/s": "rad s-1", "N*m": "N m"}
_DEGREES = ("deg", "°", "degree", "degrees")
#: Columns of names, and those of numbers beside the axes.
_TEXTS = ("walker", "gait")
_MEASURED = [
    v.name for v in VARIABLES.values() if v.dims == ("gait",) and v.dtype == "f8"
]


def read(name: str, study: Study, location: Location) -> Columns:
    """Read measurements from a CSV file.

    Parameters
    ----------
    name : str
        A file beside the study. Its first row names each column and its
        unit, as `slope [rad]`, `period [s]`, `period_error [s]`; `walker` and `gait`
        hold names. Degrees are converted to radians. Every axis with several values
        needs a column.
    study : Study
    location : Location
        Place of the entry in the study.

    Returns
    -------
    dict of ndarray, shape (n,)
        Columns by name: numbers, in the study's units and NaN where a cell is empty, or
        words.

    Raises
    ------
    StudyError
        If the file cannot be read, or a column, a unit or a cell is wrong.
    """
    shown = clip(name, 200)
    text = location.blamed(files.read_text, study.path.parent / name, shown, _MAX_MIB)
    try:
        rows = list(csv.reader(text.splitlines(), strict=True))
    except csv.Error as error:
        raise location.error(str(files.unreadable(shown, error))) from error

    rows = [row for row in rows if any(cell.strip() for cell in row)]
    if len(rows) < 2 or len(rows) > _MAX_ROWS:
        raise location.error(
            f"{shown} must have a heading and 1 to {_MAX_ROWS:,} rows; it has {max(0, len(rows) - 1)}"
        )

    columns = dict(_columns(rows, shown, study, location))
    for axis in _needed(study):
        if axis not in columns:
            raise location.error(
                f"{shown} needs the column `{axis}`, an axis with several values"
            )

    if not any(column in VARIABLES for column in columns):
        raise location.error(
            f"{shown} has no measured variable, such as `period` or `stance_angle`"
        )

    location.check_names(columns.get("walker", ()), study.names, "walker")
    return columns


def _needed(study: Study) -> list[str]:
    """Axes that need a column: those with several values."""
    needed = []
    for axis in study.axes:
        if len(axis) > 1 and (axis.name == study.along or study.kind == "grid"):
            needed.append(axis.name)
    if len(study.walkers) > 1:
        needed.append("walker")
    return needed


def points(study: Study) -> dict[str, Any]:
    """The points at which a study's measurements were made, and their values.

    Returns
    -------
    dict
        `lines`, their walkers and keys, `slope` [rad] and `gait`, of n measurements
        each, NaN or empty where the file does not say it; `values`, ndarray, shape
        (n,), of each measured variable by name.
    """
    rows = study.overlay
    n = len(next(iter(rows.values())))
    axes = {axis.name: _along(axis, rows, n) for axis in study.axes}
    slope = axes.pop("slope")
    numbers = np.zeros(n, int)
    if "walker" in rows:
        numbers = np.array([study.names.index(name) for name in rows["walker"]])

    lines = Lines([study.walkers[k] for k in numbers.tolist()], axes)

    return {
        "lines": list(lines),
        "slope": slope,
        "gait": rows.get("gait", np.full(n, "")).tolist(),
        "values": {name: rows[name] for name in rows if name in VARIABLES},
    }


def _along(axis: Axis, rows: Mapping[str, np.ndarray], n: int) -> np.ndarray:
    """Values of an axis at n measurements."""
    if axis.name in rows:
        return rows[axis.name]
    return np.full(n, axis.values[0] if len(axis) == 1 else np.nan)


def _columns(
    rows: list[list[str]], shown: str, study: Study, location: Location
) -> Iterator[tuple[str, np.ndarray]]:
    expected = _units(study)
    seen = []
    for k, heading in enumerate(rows[0]):
        name, unit = _name_and_unit(heading)
        base = name.removesuffix("_error")
        if name not in _TEXTS and base not in expected:
            known = [*(axis.name for axis in study.axes), *_TEXTS, *_MEASURED]
            raise location.unknown(name, known, f"column of {shown}")

        if name in seen:
            raise location.error(f"{shown} has two columns `{name}`")

        seen.append(name)

        cells = [row[k].strip() if k < len(row) else "" for row in rows[1:]]
        if name in _TEXTS:
            yield name, _words(name, cells, shown, location)
        else:
            numbers = _numbers(name, cells, shown, location)
            yield name, numbers * _factor(name, unit, expected[base], shown, location)


def _units(study: Study) -> dict[str, str]:
    """Units in which columns of numbers are expected, by name."""
    expected = {}
    for name in _MEASURED:
        expected[name] = units.of_kind(VARIABLES[name].kind, study.checks)
    for axis in study.axes:
        expected[axis.name] = units.axis_units(axis.name, study.checks)
    return expected


def _name_and_unit(heading: str) -> tuple[str, str]:
    """What a heading such as `period [s]` names, and its unit; else all of it."""
    match = re.fullmatch(r"\s*(\w+)\s*(?:\[([^\]]*)\])?\s*", heading)
    if not match:
        return heading, ""
    return match[1], (match[2] or "").strip()


def _factor(
    name: str, unit: str, expected: str, shown: str, location: Location
) -> float:
    """Factor from the unit given to the expected one."""
    given = _SPELLINGS.get(unit, unit)
    if expected == SI_UNITS["angle"] and given in _DEGREES:
        return float(np.pi / 180)
    if given != expected:
        wanted = f"`{name} [{expected}]`"
        if expected == "1":
            wanted = f"`{name}` without a unit, as the walker has none"
        heading = f"{name} [{clip(unit, 20)}]" if unit else name
        raise location.error(f"The column `{heading}` of {shown} must be {wanted}")

    return 1.0


def _numbers(name: str, cells: list[str], shown: str, location: Location) -> np.ndarray:
    values = np.full(len(cells), np.nan)
    for i, cell in enumerate(cells):
        try:
            values[i] = float(cell) if cell else np.nan
        except ValueError:
            values[i] = np.inf

        if np.isinf(values[i]) or (name.endswith("_error") and values[i] < 0):
            bound = "must be a number" if np.isinf(values[i]) else "must be at least 0"
            raise location.error(
                f"`{name}` {bound}; got {clip(cell)!r} ({shown}, row {i + 2})"
            )

    return values


def _words(name: str, cells: list[str], shown: str, location: Location) -> np.ndarray:
    for i, cell in enumerate(cells):
        if name == "gait" and cell and cell not in GAITS:
            raise location.error(
                f"`gait` must be one of {', '.join(GAITS)}; got {clip(cell)!r} ({shown}, row {i + 2})"
            )
    return np.array([clip(cell) for cell in cells], dtype=str)
