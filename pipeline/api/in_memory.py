"""Gaits of arrays of walkers and slopes, in memory: studies without files, computed in
this process by the loop of a run.
"""

from collections.abc import Collection, Generator, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import xarray as xr

from gaitsweep.pipeline import dispatch
from gaitsweep.pipeline.archive import attributes, parameters
from gaitsweep.pipeline.archive.written import Sentences
from gaitsweep.pipeline.engine.engine import InProcess
from gaitsweep.pipeline.engine.loop import run_all
from gaitsweep.pipeline.engine.work import Work
from gaitsweep.pipeline.errors import StudyError
from gaitsweep.pipeline.graph.plan import Plan
from gaitsweep.pipeline.grid.choose_method import method_of
from gaitsweep.pipeline.grid.grid import Chunk
from gaitsweep.pipeline.grid.method import Method
from gaitsweep.pipeline.statuses import of_atlas
from gaitsweep.pipeline.store.memory import Memory
from gaitsweep.pipeline.store.points import (
    Points,
    has_multipliers,
    joined,
    sentence_number,
)
from gaitsweep.pipeline.study import slopes, units
from gaitsweep.pipeline.study.broadcast import broadcast
from gaitsweep.pipeline.study.model import Axis, Definition, Study, line_of
from gaitsweep.tasks.contract.accuracy import always, is_converted
from gaitsweep.tasks.contract.registry import DRIVES, GAITS, VARIABLES

#: Atlases, charts and points of short lines kept for later calls [byte], by whether
#: compact code has computed them: other points are cheaper to compute again.
_REMEMBERED = {is_compact: Memory(256 << 20) for is_compact in (True, False)}
_BLOCK = 64  # short lines surveyed side by side
#: How strings are stored, as in archives (`pipeline.archive.written`).
_CHARACTERS = {"dtype": "S1"}
Arrays = dict[str, np.ndarray]
#: Points, and their places in the grid.
_Found = tuple[np.ndarray, Points]


class _Line:
    """A line of the grid along one of its arguments: the numbers of its points, their
    distinct values, and the value of each among these.

    Where walkers of its points differ in their units it is the line of one of them.
    """

    def __init__(
        self,
        base: Study,
        line: dict[str, Any],
        at: np.ndarray,
        along: np.ndarray,
        check: dict[str, Any],
        name: str = "",
    ):
        self.line, self.at, self.check = line, at, check
        self.along = name or base.along
        self.values, self.row = np.unique(along[at], return_inverse=True)
        self._base = base

    def over(
        self,
        line: dict[str, Any],
        check: dict[str, Any],
        at: np.ndarray,
        along: np.ndarray,
    ) -> "_Line":
        """Another line of the same study."""
        return _Line(self._base, line, at, along, check, self.along)

    @property
    def keys(self) -> dict[str, Any]:
        """What it is a line at: values of keys, and of the slope unless that varies
        along it.
        """
        keys = dict(self.line["set"])
        if "slope" in self.line:
            keys["slope"] = self.line["slope"]
        return keys

    @property
    def study(self) -> Study:
        """A study of this line alone."""
        keys = {key: np.array([value]) for key, value in self.keys.items()}
        return self.study_over(keys)

    def study_over(self, keys: Mapping[str, np.ndarray]) -> Study:
        """A study of lines with the same values along them, over values of keys."""
        axes = [Axis(self.along, self.values)]
        axes += [Axis(name, values) for name, values in keys.items()]
        return replace(self._base, axes=tuple(axes), checks=(self.check,))


def gaits(
    walker: Definition,
    wanted: tuple[str, ...],
    arguments: Mapping[str, Any],
    steps: int,
    accuracy: float = 0.0,
    limits: Mapping[str, float] | None = None,
    at: Mapping[str, Any] | None = None,
    named: Collection[str] = (),
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
    at : mapping, optional
        What gaits are sought at, as `Study.at` has it; `arguments` then hold values of
        the measure, and no slope if that is varied.
    named : collection of str
        Variables that are kept whatever the walkers have.

    Returns
    -------
    xarray.Dataset
        Encoded as an archive.

    Raises
    ------
    StudyError
        If the arguments do not broadcast, or no point has a slope and a walker that can
        be.
    """
    base = _base(walker, wanted, steps, accuracy, limits or {}, at or {})
    arrays, grid = broadcast(arguments)
    flat = {}
    for name, values in zip(arrays, grid, strict=True):
        flat[name] = values.values.ravel()
    lines, unsolvable = _checked(base, flat, arrays)

    slope = flat[base.along]
    _refuse_if_none(base, slope, lines, unsolvable)
    unsolvable += _wrong_slopes(base, slope, lines, unsolvable)

    keys = _keys(base, arrays, lines)
    checks = [line.check for line in lines]
    # A list that becomes shorter while its lines are solved.
    lines = [line for line in lines if len(line.at)]
    with _question(lines):
        found = _solve_all(base, lines, flat)
        points = _in_order(found, unsolvable, base.variables, checks)

    kept = _kept(base, checks, named)
    for name in {*base.variables}.difference(kept):
        points.values.pop(name, None)
    study = replace(base, checks=tuple(checks[:1]), variables=kept)
    return _dataset(points, grid[0], keys, study)


def _question(lines: list[_Line]) -> AbstractContextManager[None]:
    """Let solvers be compiled for what is asked of some lines."""
    points = sum(len(line.at) for line in lines)
    return dispatch.for_question(points, len(lines))


def _base(
    walker: Definition,
    wanted: tuple[str, ...],
    steps: int,
    accuracy: float,
    limits: Mapping[str, float],
    at: Mapping[str, Any],
) -> Study:
    """The study of all points, without axes."""
    others = tuple(name for name in always(accuracy) if name not in wanted)
    variables = (*wanted, *others)
    options: dict[str, Any] = {}
    if steps > 1:
        options["steps"] = steps
    if limits:
        options["violation_limits"] = limits
    if at:
        options["at"] = at

    return Study(
        "",
        "",
        "grid",
        (walker,),
        GAITS,
        (),
        variables,
        options=options,
        accuracy=accuracy,
    )


def _checked(
    base: Study, flat: Arrays, arrays: Mapping[str, xr.DataArray]
) -> tuple[list[_Line], list[tuple[np.ndarray, StudyError]]]:
    """Lines of the grid at their slopes, and the points of those whose walker cannot
    be, with why.
    """
    slope = flat[base.along]
    is_slope = _can_be(base, slope)
    is_level = slopes.is_level(slope) & (not base.at)
    lines = _along_drives(base, flat, arrays, np.flatnonzero(is_level))
    unsolvable: list[tuple[np.ndarray, StudyError]] = []

    is_left = np.ones(len(slope), bool)
    for line_along_drive in lines:
        is_left[line_along_drive.at] = False
    for line, every in _along_slopes(base, flat, arrays, np.flatnonzero(is_left)):
        leads_down, level = is_slope[every], is_level[every]
        try:
            check = _check(base, line, slope[every[leads_down]])
        except StudyError as error:
            unsolvable.append((every[leads_down | level], error))
        else:
            can_be = leads_down | level & check["driven"]
            lines.append(_Line(base, line, every[can_be], slope, check))

    return lines, unsolvable


def _along_drives(
    base: Study,
    flat: Arrays,
    arrays: Mapping[str, xr.DataArray],
    level: np.ndarray,
) -> list[_Line]:
    """Lines along what drives, of points on level ground or uphill of which several
    differ in it alone, as studies have them.
    """
    bounds = dispatch.resolve("gaitsweep.tasks.walkers.walker:BOUNDS")
    lines: list[_Line] = []
    for key in DRIVES:
        if key not in arrays or not arrays[key].ndim:
            continue

        values = flat[key]
        can_be = (values[level] > 0) & (values[level] <= bounds[key][1])
        taken = [level[:0]]
        for line, at in _lines(base, flat, arrays, key, level[can_be]):
            check = _check_along(key, base, line, values[at])
            if check:
                lines.append(_Line(base, line, at, values, check, key))
                taken.append(at)

        level = np.setdiff1d(level, np.concatenate(taken))

    return lines


def _check_along(
    key: str, base: Study, line: dict[str, Any], values: np.ndarray
) -> dict[str, Any] | None:
    """What `tasks` reports of the walker of a line along a key that drives; None where
    its points are to be solved one by one.
    """
    if values.min() == values.max():
        return None
    driven = {**line, "set": {**line["set"], key: values.max().item()}}
    try:
        check = _check(base, driven, values)
    except StudyError:  # which is told of each of its points
        return None

    return check if Study.may_be_along(key, [check]) else None


def _refuse_if_none(
    base: Study,
    slope: np.ndarray,
    lines: list[_Line],
    unsolvable: list[tuple[np.ndarray, StudyError]],
) -> None:
    """Raise the first error of a grid without a point that can be solved: an argument
    that is nowhere right is a mistake, not a result.
    """
    if not len(slope) or any(len(line.at) for line in lines):
        return
    if unsolvable or base.at:
        wrong = [*unsolvable, *_wrong_slopes(base, slope)]
        raise wrong[0][1]

    if slopes.is_level(slope[0]):
        raise slopes.undriven(float(slope[0]))

    slopes.check(float(slope[0]))


def _can_be(base: Study, slope: np.ndarray) -> np.ndarray:
    """Whether slopes, or values of a measure, can be asked for, shape (n,)."""
    if base.at:
        return np.isfinite(slope)
    return np.asarray(slopes.is_slope(slope))


def _check(base: Study, line: dict[str, Any], slope: np.ndarray) -> dict[str, Any]:
    """What `tasks` reports of the walker of a line, with the keys that are varied."""
    if "slope" in line:
        slopes.check(line["slope"], may_be_level=True)
    name = "check_walker"
    if base.at:
        name = "check_target"
    asked = {**line, **base.at, "values": slope}
    check: dict[str, Any] = dispatch.ask(name, asked)
    if slopes.is_level(line.get("slope", 1.0)) and not check["driven"]:
        raise slopes.undriven(line["slope"])

    return check


def _wrong_slopes(
    base: Study,
    slope: np.ndarray,
    lines: Sequence[_Line] = (),
    unsolvable: Sequence[tuple[np.ndarray, StudyError]] = (),
) -> list[tuple[np.ndarray, StudyError]]:
    """The points whose slope, or value of a measure, is none, or none of their walkers',
    beside those that can be asked for, with why.
    """
    is_wrong = ~_can_be(base, slope)
    for line in lines:
        is_wrong[line.at] = False
    for at, _ in unsolvable:
        is_wrong[at] = False

    wrong = np.flatnonzero(is_wrong)
    values, which = np.unique(slope[wrong], return_inverse=True)
    refused = []
    for k, value in enumerate(values.tolist()):
        refused.append((wrong[which == k], _refused(base, value)))

    return refused


def _refused(base: Study, value: float) -> StudyError:
    """Why a slope, or a value of a measure, cannot be asked for."""
    bound = "must be finite"
    if not base.at:
        if slopes.is_level(value):
            return slopes.undriven(value)
        bound = slopes.BOUND

    return StudyError(f"`{base.along}` {bound}; got {value!r}.")


def _in_order(
    found: Iterator[_Found],
    unsolvable: list[tuple[np.ndarray, StudyError]],
    variables: tuple[str, ...],
    checks: list[dict[str, Any]],
) -> Points:
    """All points in the order of the grid: those that are found, and those that cannot
    be solved.
    """
    parts: list[_Found] = []
    for at, error in unsolvable:
        ending = Points.of_ending(len(at), "raised", str(error), variables)
        parts.append((at, ending))

    parts += found
    if not parts:
        none = Points.of_ending(0, "raised", "", variables)
        parts.append((np.empty(0, int), none))

    places, points = zip(*parts, strict=True)
    order = np.argsort(np.concatenate(places))
    multipliers = max((check["multipliers"] for check in checks), default=3)
    return joined(points, len(GAITS), multipliers).take(order)


def _along_slopes(
    base: Study,
    flat: Arrays,
    arrays: Mapping[str, xr.DataArray],
    some: np.ndarray,
) -> Iterator[tuple[dict[str, Any], np.ndarray]]:
    """Every line of some points along slopes, or values of a measure.

    Those that differ only in a `g` that can be are one where gaits are converted.
    """
    (walker,) = base.walkers
    varies = "g" in arrays and arrays["g"].ndim
    if varies and _is_converted(base) and _is_passive(walker, flat):
        flat = {**flat, "g": _one_for_all(flat["g"])}
    return _lines(base, flat, arrays, base.along, some)


def _lines(
    base: Study,
    flat: Arrays,
    arrays: Mapping[str, xr.DataArray],
    along: str,
    some: np.ndarray,
) -> Iterator[tuple[dict[str, Any], np.ndarray]]:
    """Every line of some points along an argument, in the order of its first point, with
    its points.
    """
    if not len(some):
        return

    (walker,) = base.walkers
    others = [name for name in arrays if name != along]
    varying = [name for name in others if arrays[name].ndim]
    fixed = {name: flat[name][some[0]].item() for name in others}
    number = np.zeros(len(some), int)
    if varying:
        groups = pd.DataFrame({name: flat[name][some] for name in varying}).groupby(
            varying, sort=False, dropna=False
        )
        number = groups.ngroup().to_numpy()

    order = some[np.argsort(number, kind="stable")]
    ends = np.cumsum(np.bincount(number))
    for at in np.split(order, ends[:-1]):
        first = {name: flat[name][at[0]].item() for name in varying}
        yield line_of(walker, {**fixed, **first}), at


def _is_converted(base: Study) -> bool:
    """Whether gaits of walkers that differ in units are one to the solver."""
    return not base.at and is_converted(base.variables, base.accuracy)


def _is_passive(walker: Definition, flat: Arrays) -> bool:
    """Whether gravity alone drives the walker, whatever its keys."""
    keys = dispatch.resolve("gaitsweep.tasks.walkers.walker:OF_DRIVE")
    if any(flat[key].any() for key in keys if key in flat):
        return False
    check = dispatch.ask("check_walker", {"walker": walker, "set": {}})
    return "drive" not in check["features"]


def _one_for_all(g: np.ndarray) -> np.ndarray:
    """Values of `g`, of which those that can be are the first of them."""
    low, high = dispatch.resolve("gaitsweep.tasks.walkers.walker:BOUNDS")["g"]
    can_be = (g >= low) & (g <= high)
    if not can_be.any():
        return g

    return np.where(can_be, g[can_be.argmax()], g)


class _Keys(NamedTuple):
    """Keys of the walkers of a grid, as a dataset holds them.

    Attributes
    ----------
    coordinates : dict of DataArray
        The slope, or what it is replaced by, and keys that vary by themselves.
    moved : dict of DataArray
        Keys that vary because others do, such as the masses with `foot_mass_ratio`:
        variables of the dataset.
    constants : dict
        Keys that all walkers share: its attributes.
    """

    coordinates: dict[str, xr.DataArray]
    moved: dict[str, xr.DataArray]
    constants: dict[str, str | float]


def _keys(base: Study, arrays: Mapping[str, xr.DataArray], lines: list[_Line]) -> _Keys:
    """The keys of the walkers of all lines."""
    checks = [line.check for line in lines]
    varying = {name: a for name, a in arrays.items() if a.ndim or name == base.along}
    coordinates = {
        name: values.assign_attrs(attributes.of_axis(name, checks[:1]))
        for name, values in varying.items()
    }
    if not lines:
        return _Keys(coordinates, {}, {})

    line = lines[0].line
    moved = _moved(line, checks, varying)
    return _Keys(coordinates, moved, _constants(line, checks, varying))


def _kept(
    base: Study, checks: list[dict[str, Any]], named: Collection[str]
) -> tuple[str, ...]:
    """Variables that the walkers have, or that are `named`."""
    features: set[str] = set()
    for check in checks:
        features.update(check["features"])

    kept = []
    for name in base.variables:
        if name in named or not VARIABLES[name].is_left_out(features):
            kept.append(name)

    return tuple(kept)


def _constants(
    line: dict[str, Any], checks: list[dict[str, Any]], varying: Mapping[str, Any]
) -> dict[str, str | float]:
    """Keys that all walkers share, as attributes; for a single line, all that do not
    vary.
    """
    resolve = dispatch.resolve("gaitsweep.tasks.walkers.resolve:resolve")
    table = resolve(line["walker"], line["set"]).table()
    constants = {**line["set"], **table, "knees": str(table["knees"]).lower()}

    others = {*_owners(checks, varying), *varying}
    for check in checks:
        others.update(check.get("sought", ()))

    shared = {key: value for key, value in constants.items() if key not in others}
    return shared | parameters.exact_offsets(others, [table])


def _owners(
    checks: list[dict[str, Any]], varying: Mapping[str, Any]
) -> dict[str, list[str]]:
    """Keys that others which vary move, with these."""
    owners: dict[str, dict[str, None]] = {}
    for check in checks:
        for key, movers in check["varied"].items():
            varied = [owner for owner in movers if owner in varying]
            owners.setdefault(key, {}).update(dict.fromkeys(varied))

    return {key: list(found) for key, found in owners.items() if found}


def _moved(
    line: dict[str, Any],
    checks: list[dict[str, Any]],
    varying: Mapping[str, xr.DataArray],
) -> dict[str, xr.DataArray]:
    """Keys that others which vary move, along the dimensions of these."""
    fixed = {key: value for key, value in line["set"].items() if key not in varying}
    owners = _owners(checks, varying)
    moved = {}
    for key in dispatch.resolve("gaitsweep.tasks.walkers.walker:NUMBERS"):
        if key in varying or key not in owners:
            continue

        arrays = xr.broadcast(*(varying[owner] for owner in owners[key]))
        flat = {
            owner: array.values.ravel().astype(float)
            for owner, array in zip(owners[key], arrays, strict=True)
        }
        values = parameters.of_walkers(line["walker"], key, {**fixed, **flat})
        about = parameters.described(key, checks[:1], True)
        moved[key] = xr.DataArray(
            values.reshape(arrays[0].shape), dims=arrays[0].dims, attrs=about
        )

    return moved


class _Units:
    """By how much the units of length, mass and time of the walker of each point are
    larger than those of the line of which its gaits are, and the line's number.
    """

    def __init__(self, n: int):
        self.ratios = np.ones((3, n))
        self.time = np.ones(n)
        self.line = np.zeros(n, int)

    def set(self, line: _Line, found: Mapping[str, Any], flat: Arrays) -> None:
        """Set those of the points of a line, which differs in units from another."""
        length, mass, time = found["units"]
        if "g" in found["keys"]:
            time = np.sqrt(length / flat["g"][line.at])
        self.time[line.at] = time
        pairs = zip((length, mass, time), found["plain_units"], strict=True)
        for row, (own, other) in zip(self.ratios, pairs, strict=True):
            row[line.at] = own / other

    def convert(self, at: np.ndarray, points: Points, lines: list[_Line]) -> Points:
        """Points, at their places in the grid, in the units of their walkers."""
        ratios = self.ratios[:, at]
        if (ratios == 1).all():
            return points

        values = dict(points.values)
        for name, array in points.values.items():
            if array.dtype == float:
                unit = np.broadcast_to(VARIABLES[name].unit(*ratios), len(at))
                values[name] = array * unit.reshape(-1, *[1] * (array.ndim - 1))

        sentences = dict(points.sentences)
        values["reason"] = values["reason"].copy()
        for number in np.unique(self.line[at]).tolist():
            some = np.flatnonzero(self.line[at] == number)
            reason = values["reason"][some]
            times = self.time[at[some]]
            values["reason"][some] = _told_in_time(
                lines[number].line, times, reason, sentences
            )

        return Points(values, sentences)


def _told_in_time(
    line: Mapping[str, Any],
    times: np.ndarray,
    reason: np.ndarray,
    sentences: dict[int, str],
) -> np.ndarray:
    """Numbers of the sentences of points in their walkers' units of time (n,), from
    those, (n, gaits), of their line; new sentences are added.
    """
    used, place = np.unique(reason, return_inverse=True)
    units, which = np.unique(times, return_inverse=True)
    words, *in_unit = dispatch.ask(
        "search_words", {"line": line, "time_units": units.tolist()}
    )
    numbers = np.repeat(used[None], len(units), axis=0)
    for k, number in enumerate(used.tolist()):
        if words not in sentences[number]:
            continue
        for row, own in enumerate(in_unit):
            sentence = sentences[number].replace(words, own)
            numbers[row, k] = sentence_number(sentence)
            sentences[int(numbers[row, k])] = sentence

    return numbers[which[:, None], place.reshape(reason.shape)]


def _solve_all(base: Study, lines: list[_Line], flat: Arrays) -> Iterator[_Found]:
    """Solve the points of lines, those along what drives first."""
    for key in DRIVES:
        yield from _solve([one for one in lines if one.along == key])

    lines[:] = [one for one in lines if one.along == base.along]
    yield from _solve_in_units(base, lines, flat)


def _solve_in_units(base: Study, lines: list[_Line], flat: Arrays) -> Iterator[_Found]:
    """Solve the points of lines, those that differ only in units once, and convert
    them.
    """
    if not _is_converted(base):
        yield from _solve(lines)
        return

    units = _Units(len(flat["slope"]))
    alike: dict[str, list[_Line]] = {}
    plain: dict[str, dict[str, Any]] = {}
    for one in lines:
        found = dispatch.ask("scaled", one.line)
        if not found["possible"]:
            # Nor are those of the others, which set the same keys.
            yield from _solve(lines)
            return

        name = repr(found["plain"])
        alike.setdefault(name, []).append(one)
        if found["keys"]:
            plain[name] = found["plain"]
            units.set(one, found, flat)

    merged = []
    for number, (name, own) in enumerate(alike.items()):
        at = np.concatenate([one.at for one in own])
        units.line[at] = number
        merged.append(_without_keys(own[0], plain.get(name), at, flat["slope"]))

    for at, points in _solve([*merged]):
        yield at, units.convert(at, points, merged)


def _without_keys(
    one: _Line, plain: dict[str, Any] | None, at: np.ndarray, slope: np.ndarray
) -> _Line:
    """A line with the points of several, without the keys that change only units, if it
    has any.
    """
    if plain is None:
        return one.over(one.line, one.check, at, slope)
    return one.over(plain, dispatch.ask("check_walker", plain), at, slope)


def _solve(lines: list[_Line]) -> Iterator[_Found]:
    """Solve the points of lines, as one study if they form a plane of keys, else as one
    study each.
    """
    left = yield from _solve_plane(lines)
    _remembered().trim()
    while left:
        block = left[:_BLOCK]
        del left[:_BLOCK]
        plans = [_plan(one.study) for one in block]
        _compute(plans)
        for one, plan in zip(block, plans, strict=True):
            yield one.at, _points(plan, plan.graph.grid.chunk(0)).take(one.row)
        _remembered().trim()


def _solve_plane(lines: list[_Line]) -> Generator[_Found, None, list[_Line]]:
    """Solve lines that form a plane of keys; returns the lines that are left."""
    plane = _plane(lines)
    if plane is None:
        return lines

    study, in_order = plane
    plan = _plan(study)
    _compute([plan])
    for k in range(plan.graph.grid.chunks):
        chunk = plan.graph.grid.chunk(k)
        own = [in_order[number] for number in chunk.numbers.tolist()]
        rows = [place * len(one.values) + one.row for place, one in enumerate(own)]
        at = np.concatenate([one.at for one in own])
        yield at, _points(plan, chunk).take(np.concatenate(rows))

    return []


def _plane(lines: list[_Line]) -> tuple[Study, list[_Line]] | None:
    """Lines as one study over a plane of keys, and in its order; None if charts over
    keys do not predict their gaits.
    """
    if len(lines) < 2:
        return None

    along, names = lines[0].values, lines[0].keys.keys()
    if not all(np.array_equal(one.values, along) for one in lines):
        return None
    # Keys that changed only units are gone, from some lines and not from others.
    if any(one.keys.keys() != names for one in lines):
        return None

    table = pd.DataFrame([one.keys for one in lines])
    values = {key: table[key].to_numpy() for key in names}
    keys = {key: np.unique(each) for key, each in values.items()}
    if len(lines) != np.prod([len(each) for each in keys.values()]):
        return None

    # The study numbers them by the first key, then the next.
    by_number = np.lexsort([*values.values()][::-1])
    in_order = [lines[number] for number in by_number.tolist()]
    study = in_order[-1].study_over(keys)
    if method_of(study, in_memory=True) is not Method.PLANE:
        return None

    return study, in_order


def _plan(study: Study) -> Plan:
    """Plan of a study in memory; what failed is tried again."""
    return Plan(study, _remembered(), retry=True, in_memory=True)


def _remembered() -> Memory:
    """What is kept of earlier calls that were answered by the same code."""
    is_compact = dispatch.resolve("gaitsweep.tasks.mechanics.kernel:is_compact")()
    return _REMEMBERED[is_compact]


def _compute(plans: list[Plan]) -> None:
    """Compute what some studies lack."""
    works = [Work(plan) for plan in plans]
    run_all(works, InProcess(_BLOCK))
    for work in works:
        if work.error:
            raise work.error


def _points(plan: Plan, chunk: Chunk) -> Points:
    """Points of a chunk that was computed; of one whose atlas failed, why."""
    store, graph = plan.store, plan.graph
    assert isinstance(store, Memory)
    key = graph.chunk_key(chunk)
    if key not in store:
        atlas = plan.outcome_of_line(chunk.line)
        assert atlas
        reason = of_atlas(atlas.reason)
        return Points.of_ending(chunk.points, atlas.status, reason, graph.variables)

    points = store.points(key, graph.variables)
    if graph.method is Method.ALONE:
        # Who asks may change the answer, but not what is remembered.
        return points.copy()

    # They are cheaper to compute again than to keep.
    store.drop(key)
    return points


def _dataset(
    points: Points,
    grid: xr.DataArray,
    keys: _Keys,
    study: Study,
) -> xr.Dataset:
    """Results as an archive holds them, the gaits after the dimensions of the grid."""
    sentences = Sentences(points.sentences)
    variables: dict[str, Any] = dict(keys.moved)
    variables["reason_text"] = (
        "reason_index",
        np.array(sentences.texts, str),
        attributes.REASON_TEXT,
        _CHARACTERS,
    )
    for name in (v for v in VARIABLES if v in points.values):
        values = points.values[name]
        if name == "reason":
            values = sentences.renumbered(values)
        dims = (*grid.dims, *VARIABLES[name].dims)
        values = values.reshape((*grid.shape, *values.shape[1:]))
        about = attributes.of_variable(VARIABLES[name], study)
        variables[study.archived(name)] = (dims, values, about)

    coords: dict[Any, Any] = {**grid.coords}
    coords |= _inner_coordinates(points)
    if "key" in coords:
        variables["key_units"] = _key_units(study, coords["key"][1])

    return xr.Dataset(
        variables,
        {**coords, **keys.coordinates},
        {**attributes.of_dataset(study), **keys.constants},
    )


def _inner_coordinates(points: Points) -> dict[str, Any]:
    """Coordinates of the dimensions that come after those of the grid."""
    coordinates: dict[str, Any] = {
        "gait": ("gait", np.array(GAITS), attributes.GAIT, _CHARACTERS)
    }
    multipliers = [
        a.shape[-1] for name, a in points.values.items() if has_multipliers(name)
    ]
    if multipliers:
        numbers = np.arange(multipliers[0], dtype=np.int32)
        coordinates["multiplier"] = "multiplier", numbers, attributes.MULTIPLIER

    by_key = [a for name, a in points.values.items() if "key" in VARIABLES[name].dims]
    if by_key:
        keys = np.array(attributes.differentiated(by_key[0].shape[-1]))
        coordinates["key"] = "key", keys, attributes.KEY, _CHARACTERS

    return coordinates


def _key_units(study: Study, keys: np.ndarray) -> Any:
    """Units of the keys by which measures are differentiated."""
    of_keys = np.array([units.axis_units(key, study.checks) for key in keys])
    return "key", of_keys, attributes.KEY_UNITS, _CHARACTERS
