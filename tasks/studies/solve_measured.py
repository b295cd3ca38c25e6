"""The task `measured`: the gaits at the slopes and keys at which somebody measured, with
the bounds of their errors.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from gaitsweep.tasks.branches import atlas as atlases
from gaitsweep.tasks.branches.branch import Branch
from gaitsweep.tasks.contract import status
from gaitsweep.tasks.contract.registry import GAITS, SLOPES
from gaitsweep.tasks.contract.tables import Arrays
from gaitsweep.tasks.studies.request import Request
from gaitsweep.tasks.studies.solve_points import atlas, solve_line, solve_lines
from gaitsweep.tasks.walkers.resolve import walker_of_line
from gaitsweep.tasks.walkers.walker import WalkerError

#: What the error bound of a gait, relative, allows its variables, by their size.
_STATE = ("stance_angle", "period")
_RATES = ("stance_rate", "thigh_rate", "shank_rate")
#: By how much more the errors of others are bounded, relative: by that of the angle, of
#: the period, or of both.
_FOLLOWING = {
    "step_length": 1.0,
    "step_frequency": 1.0,
    "speed": 2.0,
    "froude_speed": 2.0,
    "power": 2.0,
}
#: What bounds need of a gait.
_NEEDED = ("error_bound", "multiplier_error_bound", *_RATES)
#: Lines surveyed side by side.
_SIDE_BY_SIDE = 64

Line = Mapping[str, Any]


def measured(params: Mapping[str, Any], inputs: list[Arrays]) -> Arrays:
    """Solve the gaits at the points at which somebody measured.

    Parameters
    ----------
    params : mapping
        `lines`, sequence of n mappings: walker and keys of each measurement; `slope`,
        ndarray, shape (n,) [rad]; `gait`, sequence of n labels, empty where none is
        named; `values`, ndarray, shape (n,), of each measured variable by name, NaN
        where it was not measured; `gaits`, labels wanted; `steps` after which the gaits
        repeat.
    inputs : list
        Empty.

    Returns
    -------
    dict
        Table `measured_gaits`, a row for each measurement: `gait`, the label of the
        gait that is nearest to all that was measured there, or named; its variables
        that were measured, in the walker's units, each with a bound of its error
        `<variable>_error`, NaN where none is known; and `reason`, why there is none.
    """
    rows = _Rows.of(params)
    solvable = rows.refuse()

    groups: dict[str, list[int]] = {}
    for row in solvable.tolist():
        groups.setdefault(repr(rows.lines[row]), []).append(row)
    numbers = [np.array(group) for group in groups.values()]
    lines = [rows.lines[some[0]] for some in numbers]

    steps = int(params.get("steps", 1))
    for some, line, branches in zip(
        numbers, lines, _surveys(lines, steps), strict=True
    ):
        rows.compare(some, line, branches, steps)

    return rows.table()


def _surveys(lines: Sequence[Line], steps: int) -> Iterator[list[Branch]]:
    """Branches of each line."""
    if steps > 1:
        for line in lines:
            arrays = atlas({"line": line, "steps": steps}, [])
            yield atlases.from_arrays(arrays)
        return

    nothing = Request.of({"slope": [], "want": ()})
    for first in range(0, len(lines), _SIDE_BY_SIDE):
        some = lines[first : first + _SIDE_BY_SIDE]
        for branches, _ in solve_lines(some, nothing):
            yield branches


@dataclass
class _Rows:
    """Measurements, and what is computed of each.

    `values` and `computed` have the measured variables by name, shape (n,); `errors`
    the bounds of the computed ones.
    """

    lines: Sequence[Line]
    slope: np.ndarray
    named: Sequence[str]
    values: Mapping[str, np.ndarray]
    labels: list[str]
    gait: np.ndarray
    reason: np.ndarray
    computed: Arrays
    errors: Arrays

    @classmethod
    def of(cls, params: Mapping[str, Any]) -> _Rows:
        """Read what was measured."""
        slope = np.asarray(params["slope"], float)
        n, values = len(slope), params["values"]
        wanted = params.get("gaits") or GAITS

        return cls(
            lines=params["lines"],
            slope=slope,
            named=[str(label) for label in params["gait"]],
            values=values,
            labels=[label for label in GAITS if label in wanted],
            gait=np.full(n, "", dtype=object),
            reason=np.full(n, "", dtype=object),
            computed={name: np.full(n, np.nan) for name in values},
            errors={name: np.full(n, np.nan) for name in values},
        )

    def refuse(self) -> np.ndarray:
        """Say which rows have no walker or slope; the numbers of the others."""
        low, high = SLOPES
        for row, (line, slope) in enumerate(zip(self.lines, self.slope, strict=True)):
            unknown = [key for key, value in line["set"].items() if value != value]
            if np.isnan(slope):
                unknown.append("slope")
            if unknown:
                self.reason[row] = f"`{unknown[0]}` is not given."
            elif not (low <= slope < high or -high < slope <= 0):
                bound = f"must lie in [{low:g}, {high:g}) rad"
                bound += f", or in (-{high:g}, 0]" * bool(slope <= 0)
                self.reason[row] = f"`slope` {bound}; got {slope:.6g}."
            else:
                self.reason[row] = _wrong(line)

        return np.flatnonzero(self.reason == "")

    def compare(
        self, rows: np.ndarray, line: Line, branches: list[Branch], steps: int
    ) -> None:
        """Solve the gaits of a line at the slopes of some rows, and keep for each the
        nearest.
        """
        slopes, index = np.unique(self.slope[rows], return_inverse=True)
        want = tuple(dict.fromkeys((*self.values, *_NEEDED)))
        asked = {"slope": slopes, "want": want, "gaits": self.labels, "steps": steps}
        points = solve_line(line, branches, Request.of(asked))
        bounds = _bounds(points, self.values)

        for row, place in zip(rows.tolist(), index.tolist(), strict=True):
            gaits = self._candidates(row, points["status"][place])
            if not gaits:
                self.reason[row] = self._absent(row, points, place)
                continue

            gait = min(gaits, key=lambda g: self._distance(row, points, (place, g)))
            self.gait[row] = GAITS[gait]
            for name in self.values:
                self.computed[name][row] = points[name][place, gait]
                self.errors[name][row] = bounds[name][place, gait]

    def _candidates(self, row: int, statuses: np.ndarray) -> list[int]:
        """Places of the labels of gaits with which a row may be compared."""
        return [
            place for place in self._places(row) if statuses[place] in status.SOLVED
        ]

    def _places(self, row: int) -> list[int]:
        """Places of the labels that a row may have."""
        named = self.named[row]
        return [GAITS.index(label) for label in ([named] if named else self.labels)]

    def _distance(self, row: int, points: Arrays, at: tuple[int, int]) -> float:
        """Sum of squares of the relative differences of all that was measured."""
        distance = 0.0
        for name, values in self.values.items():
            computed = points[name][at]
            difference = (values[row] - computed) / (abs(computed) or 1.0)
            distance += 0.0 if np.isnan(difference) else float(difference**2)
        return distance

    def _absent(self, row: int, points: Arrays, place: int) -> str:
        """Why there is no gait with which a row may be compared."""
        some = [g for g in self._places(row) if g < 2] or self._places(row)
        said = [str(points["reasons"][points["reason"][place, g]]) for g in some]
        return " ".join(dict.fromkeys(said))

    def table(self) -> Arrays:
        """What is computed, as the columns of one table."""
        columns = {"gait": self.gait.astype(str)}
        for name in self.values:
            columns[name] = self.computed[name]
            columns[f"{name}_error"] = self.errors[name]
        columns["reason"] = self.reason.astype(str)
        return {f"measured_gaits/{name}": values for name, values in columns.items()}


def _wrong(line: Line) -> str:
    """Why a line has no walker; empty if it has one."""
    try:
        walker_of_line(line)
    except WalkerError as error:
        return str(error)
    return ""


def _bounds(points: Arrays, names: Mapping[str, Any]) -> Arrays:
    """Bounds of the errors of variables, shape (slopes, gaits); NaN where none is
    known.
    """
    bound = points["error_bound"]
    rates = [np.abs(points[name]) for name in _RATES]
    largest_rate = np.fmax.reduce(rates)

    known = {name: bound * np.abs(points[name]) for name in _STATE if name in names}
    known |= {name: bound * largest_rate for name in _RATES if name in names}
    for name, factor in _FOLLOWING.items():
        if name in names:
            known[name] = factor * bound * np.abs(points[name])

    if "spectral_radius" in names:
        known["spectral_radius"] = points["multiplier_error_bound"]
    return {name: known.get(name, np.full(bound.shape, np.nan)) for name in names}
