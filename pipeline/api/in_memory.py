"""Gaits of arrays of walkers and slopes, in memory: the tasks of a study, without its files."""

from __future__ import annotations

import functools
import threading
from collections import OrderedDict
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import xarray as xr

from pipeline import dispatch, serialize
from pipeline.api import planes
from pipeline.archive import attributes
from pipeline.archive.citation import PAPER
from pipeline.errors import StudyError
from pipeline.statuses import ALL_STATUSES
from pipeline.study import slopes
from pipeline.study.broadcast import broadcast
from tasks.accuracy import always, is_interpolated
from tasks.registry import GAITS, SHORT_LINE, TASKS, VARIABLES

_MAX_REMEMBERED = 256 << 20  # atlases kept for later calls, and as much of short lines' points [byte]
_BLOCK = 64  # short lines surveyed side by side
#: How strings are stored, as in archives (`pipeline.archive.written`).
_CHARACTERS = {"dtype": "S1"}
Arrays = dict[str, np.ndarray]


class Memory:
    """Results by their bytes of parameters, the least recently used dropped beyond a bound of bytes."""

    def __init__(self, bound: int):
        self.bound, self.size = bound, 0
        self.results: OrderedDict[bytes, tuple[int, Arrays]] = OrderedDict()
        self.lock = threading.Lock()

    def has(self, key: bytes) -> bool:
        """Whether a result is remembered."""
        with self.lock:
            return key in self.results

    def get(self, key: bytes, compute: Callable[[], Arrays]) -> Arrays:
        """A result, computed if it is not remembered.

        Parameters
        ----------
        key : bytes
        compute : callable
            Takes nothing.

        Returns
        -------
        dict of ndarray
        """
        with self.lock:
            if key in self.results:
                self.results.move_to_end(key)
                return self.results[key][1]
        result = compute()
        size = len(key) + sum(np.asarray(v).nbytes for v in result.values())
        with self.lock:
            if key not in self.results:
                self.results[key] = size, result
                self.size += size
            while self.size > self.bound:
                self.size -= self.results.popitem(last=False)[1][0]
        return result


_ATLASES, _POINTS = Memory(_MAX_REMEMBERED), Memory(_MAX_REMEMBERED)


@dataclass
class _Points:
    """Results at n points in the order of the flattened grid, and the sentences that `reason` indexes."""

    values: Arrays
    reason: np.ndarray
    sentences: dict[str, int] = field(default_factory=dict)

    @classmethod
    def empty(cls, n: int, wanted: tuple[str, ...], multipliers: int) -> _Points:
        values = {}
        for name in wanted:
            variable = VARIABLES[name]
            shape = (n, len(GAITS), *([multipliers] if "multiplier" in variable.dims else []))
            values[name] = np.full(shape, variable.absent, variable.dtype)
        return cls(values, np.zeros((n, len(GAITS)), np.int32))

    def number(self, sentence: str) -> int:
        """Number of a sentence."""
        return self.sentences.setdefault(sentence, len(self.sentences))

    def fail(self, at: np.ndarray, sentence: str) -> None:
        """Give points a status and a sentence instead of values."""
        self.values["status"][at], self.reason[at] = ALL_STATUSES["raised"], self.number(sentence)

    def put(self, at: np.ndarray, result: Arrays, row: np.ndarray) -> None:
        """Store rows of a task's result at points."""
        for name, values in self.values.items():
            part = result[name]
            if part.ndim == 3:
                values[at, :, : part.shape[2]] = part[row]
            else:
                values[at] = part[row]
        table = np.array([self.number(str(s)) for s in result["reasons"]], np.int32)
        self.reason[at] = table[result["reason"]][row]


def gaits(
    walker: str | dict[str, Any],
    wanted: tuple[str, ...],
    arguments: Mapping[str, Any],
    steps: int,
    accuracy: float = 0.0,
    limits: Mapping[str, float] | None = None,
) -> xr.Dataset:
    """Solve the gaits of a walker at every point of a grid.

    Parameters
    ----------
    walker : str or dict
        Name or table.
    wanted : tuple of str
        Names of variables.
    arguments : mapping
        `slope` [rad] and keys: numbers, arrays and DataArrays.
    steps : int
        Number of steps after which the gaits repeat.
    accuracy : float
        Largest error bound wanted; 0 for as good as doubles give.
    limits : mapping, optional
        Limits of violations that are not the registry's.

    Returns
    -------
    xarray.Dataset
        Encoded as an archive.

    Raises
    ------
    StudyError
        If the arguments do not broadcast, or no point has a slope and a walker that can be.
    """
    wanted = (*wanted, *(name for name in always(accuracy) if name not in wanted))
    arrays, grid = broadcast(arguments)
    flat = {name: a.values.ravel() for name, a in zip(arrays, grid, strict=True)}
    lines = list(_lines(walker, flat, [name for name, a in arrays.items() if name != "slope" and a.ndim]))
    checks = [_check(line) for line, _ in lines]
    answers = [check for check in checks if not isinstance(check, StudyError)]
    slope = flat["slope"]
    is_slope = slopes.is_slope(slope)
    if len(slope) and not (answers and is_slope.any()):
        raise next(
            (check for check in checks if isinstance(check, StudyError)),
            StudyError(f"`slope` {slopes.BOUND}; got {float(slope[0])!r}."),
        )
    points = _Points.empty(len(slope), wanted, max((c["multipliers"] for c in answers), default=3))
    for k in np.flatnonzero(~is_slope).tolist():
        points.fail(np.array([k]), f"`slope` {slopes.BOUND}; got {float(slope[k])!r}.")
    solvable = []
    for (line, at), check in zip(lines, checks, strict=True):
        at = at[is_slope[at]]
        if isinstance(check, StudyError):
            points.fail(at, str(check))
        elif len(at):
            solvable.append(_Line(line, at, *np.unique(slope[at], return_inverse=True), steps, accuracy, limits or {}))
    solvable = _solve_plane(walker, solvable, wanted, points)
    for k in range(0, len(solvable), _BLOCK):
        if steps == 1:
            short = [line for line in solvable[k : k + _BLOCK] if line.is_short]
            _survey([line for line in short if not _POINTS.has(line.points_key(wanted))])
        for one in solvable[k : k + _BLOCK]:
            _solve(one, wanted, points)
    is_si = bool(answers) and answers[0]["si"]
    varying = {name: a for name, a in arrays.items() if a.ndim or name == "slope"}
    coordinates = {name: a.assign_attrs(attributes.of_axis(name, is_si)) for name, a in varying.items()}
    first = next((line for (line, _), check in zip(lines, checks, strict=True) if check in answers), None)
    constants = _constants(first, answers, varying) if first else {}
    return _dataset(points, grid[0], coordinates, constants, is_si, steps, accuracy, limits)


def _lines(
    walker: str | dict[str, Any], flat: Arrays, varying: list[str]
) -> Iterator[tuple[dict[str, Any], np.ndarray]]:
    """Every line of the grid, in the order of its first point, with its points."""
    n = len(flat["slope"])
    fixed = {name: a[0].item() for name, a in flat.items() if n and name != "slope"}
    if not varying or not n:
        if n:
            yield {"walker": walker, "set": fixed}, np.arange(n)
        return
    # Compared as bytes, so that NaN equals NaN.
    rows = np.ascontiguousarray(np.stack([flat[name].astype(float) for name in varying], axis=1))
    keys = rows.view(np.dtype((np.void, rows.dtype.itemsize * rows.shape[1]))).ravel()
    _, first, inverse = np.unique(keys, return_index=True, return_inverse=True)
    order = np.argsort(inverse, kind="stable")
    groups = np.split(order, np.cumsum(np.bincount(inverse))[:-1])
    for k in np.argsort(first):
        values = {name: flat[name][first[k]].item() for name in varying}
        yield {"walker": walker, "set": {**fixed, **values}}, groups[k]


def _constants(
    line: dict[str, Any], checks: list[dict[str, Any]], varying: Mapping[str, Any]
) -> dict[str, str | float]:
    """Keys that all walkers share, as attributes; for a single line, all that do not vary."""
    table = dispatch.resolve("tasks.walkers.resolve:resolve")(line["walker"], line["set"]).table()
    moved = {key for check in checks for key, axes in check["varied"].items() if any(a in varying for a in axes)}
    constants = {**line["set"], **table, "knees": "true" if table["knees"] else "false"}
    return {key: value for key, value in constants.items() if key not in {*moved, *varying}}


def _check(line: dict[str, Any]) -> dict[str, Any] | StudyError:
    """What `tasks` reports of a line's walker, or why it is invalid."""
    try:
        return dispatch.ask("check_walker", line)
    except StudyError as error:
        return error


@dataclass
class _Line:
    """A line of the grid, its points, their distinct slopes, the slope of each among these, and what is wanted."""

    line: dict[str, Any]
    at: np.ndarray
    slopes: np.ndarray
    row: np.ndarray
    steps: int
    accuracy: float
    limits: Mapping[str, float]

    @property
    def is_short(self) -> bool:
        """Whether it is short, as in a study with as few slopes."""
        return len(self.slopes) <= SHORT_LINE

    def points_params(self, wanted: tuple[str, ...]) -> dict[str, Any]:
        """Parameters of its points."""
        params = {"line": self.line, "slope": self.slopes, "want": wanted, "steps": self.steps}
        params |= {"violation_limits": dict(self.limits)} if self.limits else {}
        return {**params, "accuracy": self.accuracy, "interpolated": self.is_interpolated(wanted)}

    def is_interpolated(self, wanted: tuple[str, ...]) -> bool:
        """Whether polynomials give its points, as in a study with as many slopes."""
        return self.steps == 1 and not self.is_short and is_interpolated(wanted, self.accuracy)

    def points_key(self, wanted: tuple[str, ...]) -> bytes:
        """Key under which its points are remembered."""
        return serialize.dump(self.points_params(wanted))

    def atlas_params(self, coarse: bool, steps: int = 1) -> dict[str, Any]:
        """Parameters of its atlas."""
        return {"line": self.line, "coarse": coarse, **({"steps": steps} if steps > 1 else {})}

    def atlas(self, coarse: bool, steps: int = 1) -> Arrays:
        """Branches of its gaits that repeat after some steps, remembered or followed."""
        params = self.atlas_params(coarse, steps)

        def follow() -> Arrays:
            atlas: Arrays = dispatch.resolve(TASKS["atlas"].function)(params, [self.atlas(False)] if steps > 1 else [])
            return atlas

        return _ATLASES.get(serialize.dump(params), follow)


def _solve_plane(
    walker: str | dict[str, Any], lines: list[_Line], wanted: tuple[str, ...], points: _Points
) -> list[_Line]:
    """Solve lines that form a plane of keys as a study would; returns the remaining lines."""
    if len(lines) < 2 or lines[0].steps > 1 or any(not np.array_equal(x.slopes, lines[0].slopes) for x in lines[1:]):
        return lines
    sets = [one.line["set"] for one in lines]
    fixed = {key: value for key, value in sets[0].items() if all(each[key] == value for each in sets)}
    keys = {key: np.array([each[key] for each in sets]) for key in sets[0] if key not in fixed}
    study = planes.plane_of(walker, fixed, keys, lines[0].slopes, wanted, lines[0].accuracy, lines[0].limits)
    if study is None:
        return lines
    left = np.ones(len(lines), bool)
    try:
        for numbers, result in planes.cells(study, keys, [one.line for one in lines]):
            some = [lines[k] for k in numbers.tolist()]
            rows = [k * len(one.slopes) + one.row for k, one in enumerate(some)]
            points.put(np.concatenate([one.at for one in some]), result, np.concatenate(rows))
            left[numbers] = False
    except Exception:  # as in a study, the lines of a cell that fails are tried one by one
        pass
    return [lines[k] for k in np.flatnonzero(left).tolist()]


def _survey(lines: list[_Line]) -> None:
    """Find the branches of short lines that are not remembered, side by side, and remember them."""
    keys = {id(line): serialize.dump(line.atlas_params(True)) for line in lines}
    unknown = [line for line in lines if not _ATLASES.has(keys[id(line)])]
    if len(unknown) < 2:
        return
    params = {"lines": [line.line for line in unknown], "slope": np.empty(0), "want": ()}
    try:
        results = dispatch.resolve(TASKS["atlas"].side_by_side)(params, [])
    except Exception:  # each is tried alone, and its own error becomes its points' reason
        return
    for line, (atlas, _) in zip(unknown, results, strict=True):
        _ATLASES.get(keys[id(line)], functools.partial(dict, atlas))


def _solve(one: _Line, wanted: tuple[str, ...], points: _Points) -> None:
    """Solve the points of a line, each slope once, from its branches."""

    def solve() -> Arrays:
        coarse = one.steps == 1 and (one.is_short or one.is_interpolated(wanted))
        params, atlas = one.points_params(wanted), one.atlas(coarse, one.steps)
        points: Arrays = dispatch.resolve(TASKS["points"].function)(params, [atlas])
        return points

    try:
        # A slider returns to earlier values; points of long lines are cheaper to recompute than to keep.
        result = _POINTS.get(one.points_key(wanted), solve) if one.is_short else solve()
    except Exception as error:  # as in a study, a task that raises is a status at its points
        points.fail(one.at, f"{type(error).__name__}: {' '.join(str(error).split())[:300]}")
    else:
        points.put(one.at, result, one.row)


def _dataset(
    points: _Points,
    grid: xr.DataArray,
    coordinates: Mapping[str, xr.DataArray],
    constants: Mapping[str, str | float],
    is_si: bool,
    steps: int,
    accuracy: float,
    limits: Mapping[str, float] | None,
) -> xr.Dataset:
    """Results as an archive holds them, the gaits after the dimensions of the grid."""
    used = np.unique(points.reason)
    by_number = {number: sentence for sentence, number in points.sentences.items()}
    order = sorted((k for k in used.tolist() if k in by_number), key=by_number.__getitem__)
    sentences = [by_number[k] for k in order]
    table = np.zeros(max(by_number, default=0) + 1, np.int32)
    table[order] = np.arange(len(order))
    is_wide = len(sentences) > np.iinfo(np.int16).max
    points.values["reason"] = table[points.reason].astype(np.int32 if is_wide else np.int16)
    variables = {}
    for name in (v for v in VARIABLES if v in points.values):
        values = points.values[name]
        dims = (*grid.dims, *VARIABLES[name].dims)
        values = values.reshape((*grid.shape, *values.shape[1:]))
        variables[name] = (dims, values, attributes.of_variable(VARIABLES[name], is_si, steps=steps, limits=limits))
    text = {"long_name": "sentences that `reason` counts from 0", "units": "1"}
    named = {"long_name": "gait by its character", "units": "1"}
    coords = {**grid.coords, "gait": ("gait", np.array(GAITS), named, _CHARACTERS)}
    multipliers = [a.shape[-1] for name, a in points.values.items() if "multiplier" in VARIABLES[name].dims]
    if multipliers:
        named = {"long_name": "number of the eigenvalue, largest magnitude first", "units": "1"}
        coords["multiplier"] = ("multiplier", np.arange(multipliers[0], dtype=np.int32), named)
    source = "gaitsweep: passive dynamic walking in two dimensions, solved numerically"
    described = {"Conventions": "CF-1.11", "source": source, "references": PAPER, **attributes.of_steps(steps)}
    described |= {"accuracy": accuracy} if accuracy else {}
    return xr.Dataset(
        {"reason_text": ("reason_index", np.array(sentences, str), text, _CHARACTERS), **variables},
        {**coords, **coordinates},
        {**described, **constants},
    )
