"""The task `design`: the best performance of each walker, so that a grid of walkers
shows the effect of its keys.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from gaitsweep.tasks.branches.atlas import survey_lines
from gaitsweep.tasks.branches.extremes import (
    ANY_SLOPE,
    COSTS,
    QUANTITIES,
    Points,
    Sought,
    best,
    find,
    in_window,
)
from gaitsweep.tasks.branches.refine import COARSE
from gaitsweep.tasks.charts.box import Box
from gaitsweep.tasks.charts.family import Family
from gaitsweep.tasks.charts.landscape import Landscape, is_known, make, points_at
from gaitsweep.tasks.charts.maker import Maker
from gaitsweep.tasks.contract import registry
from gaitsweep.tasks.contract.registry import GAITS
from gaitsweep.tasks.contract.tables import Arrays
from gaitsweep.tasks.mechanics.lumped import Structure, alike
from gaitsweep.tasks.step.lanes import lanes_of
from gaitsweep.tasks.step.problem import Lanes
from gaitsweep.tasks.studies.disturb_designs import attractors_beside, largest_steps
from gaitsweep.tasks.studies.request import Request
from gaitsweep.tasks.studies.solve_planes import Plane, make_charts, solve_plane
from gaitsweep.tasks.studies.solve_points import solve_line
from gaitsweep.tasks.walkers.resolve import resolve_many
from gaitsweep.tasks.walkers.scaling import scaling
from gaitsweep.tasks.walkers.statics import are_tuned
from gaitsweep.tasks.walkers.walker import Walker, WalkerError
from gaitsweep.tasks.walkers.walker_array import WalkerArray

#: Entries in place of a reason where there is no number.
_NO_WALKER = "no walker"
_NO_GAIT = "no gait"
_NEVER_STABLE = "never stable"
#: A gait's state just after heelstrike.
_STATE = ("stance_angle", "stance_rate", "thigh_rate", "shank_rate")
#: What the columns of the state of a quantity's gait are called after the name of the
#: state.
_OF = {
    "smallest_slope": "_at_smallest_slope",
    "largest_stable_slope": "_at_largest_stable_slope",
    "fastest_stable_speed": "",
}
#: Variables that describe gaits at a slope.
_GAIT = ("stance_angle", "stance_rate", "thigh_rate", "spectral_radius")
#: Lines surveyed, and designs solved, at a time.
_LINES = 32
_DESIGNS = 2048


def design(params: Mapping[str, Any], inputs: list[Arrays]) -> Arrays:
    """Find where walkers walk, where they walk stably, and their largest stable speed.

    Parameters
    ----------
    params : mapping
        `line`, of which a key of `set` may hold an array of values, one for each
        design; `slope`, ndarray [rad], whose ends are the window; for designs over a
        plane of keys `plane`, with its `keys`, `low`, `high` and all `values` of each.
    inputs : list
        Empty.

    Returns
    -------
    dict
        Table `design`, one row for each design, in the walker's units: smallest_slope
        of a long gait (0 if it continues to vanishing slopes) and smallest_at, the
        event there; largest_stable_slope and stability_lost_by; fastest_stable_speed,
        its fastest_froude_speed and fastest_slope; the state of the gait of each of the
        three quantities, and a bound on the relative error of each; and surveyed,
        whether the line of the design was. Only gaits in the window count, and its edge
        is called `window`. Numbers are NaN where there is `no gait`, or where it is
        `never stable`.

    Notes
    -----
    The row of a design depends on the design and its cell alone. Of designs that differ
    only in their units one is solved.
    """
    every = _Designs.of(params["line"])
    designs, which = every.alike()
    options = registry.options("design", params)
    at_slope = options["at_slope"]
    sought = _sought(params["slope"], options["at_speed"])
    plane = Plane.of(params["plane"]) if "plane" in params else None
    request = None
    if at_slope is not None:
        request = Request.of({"slope": [at_slope], "want": _GAIT})

    rows = _Rows(designs.n + 1, sought)
    if plane:
        accepted = _over_plane(designs, plane, rows)
        _survey(designs, np.flatnonzero(~accepted), rows)
        gaits = _gaits_over_plane(designs, plane, request)
    else:
        gaits = _survey(designs, np.arange(designs.n), rows, request)

    if request:
        _disturb(designs.walkers, gaits, at_slope, options["ground"], rows)

    columns = rows.some(which).table(every.walkers, options)
    return {f"design/{name}": values for name, values in columns.items()}


def _sought(slopes: Any, speed: float | None) -> Sought:
    """What is sought in the window that slopes span [rad], and at a speed, if any."""
    slope = np.log(np.asarray(slopes, float))
    window = float(slope.min()), float(slope.max())
    return Sought(window, None if speed is None else float(np.log(speed)))


@dataclass(frozen=True)
class _Designs:
    """The designs of a line: n walkers, and its keys with a value for each, (n,)."""

    line: Mapping[str, Any]
    keys: Mapping[str, np.ndarray]
    walkers: WalkerArray
    n: int

    @classmethod
    def of(cls, line: Mapping[str, Any]) -> _Designs:
        """Return the designs of a line, of which a key may hold an array of values."""
        values = {
            key: np.atleast_1d(np.asarray(value, float))
            for key, value in line.get("set", {}).items()
        }
        n = max((len(value) for value in values.values()), default=1)
        keys = {key: np.broadcast_to(value, n) for key, value in values.items()}
        return cls(line, keys, _walkers(line["walker"], keys, n), n)

    def alike(self) -> tuple[_Designs, np.ndarray]:
        """Return the designs without the keys that change only units, each once, and
        the number of each of these walkers among them, (n,): of those that cannot be
        one more than there are.
        """
        which = np.arange(self.n)
        possible = _possible(self.walkers, which)
        first, walker = next(possible, (0, None))
        scales = scaling(walker, self.line_of(first)) if walker else ()
        if not scales:
            return self, which

        keys = [key for key in self.keys if key not in scales]
        valid = np.array([first, *(number for number, _ in possible)])
        values = [np.zeros(len(valid)), *(self.keys[key][valid] for key in keys)]
        distinct, places = np.unique(
            np.column_stack(values), axis=0, return_inverse=True
        )
        which = np.full(self.n, len(distinct))
        which[valid] = places.ravel()
        own = dict(zip(keys, distinct.T[1:], strict=True))
        walkers = _walkers(self.line["walker"], own, len(distinct))
        return _Designs(self.line, own, walkers, len(distinct)), which

    def line_of(self, design: int) -> dict[str, Any]:
        """Return the line of one design."""
        values = {key: float(value[design]) for key, value in self.keys.items()}
        return {**self.line, "set": values}


def _survey(
    designs: _Designs,
    numbers: np.ndarray,
    rows: _Rows,
    request: Request | None = None,
) -> np.ndarray:
    """Store the designs with some numbers by the branches of their lines, and return their long
    gaits at a slope, if one is asked for, as `_long` has them.
    """
    gaits = np.full((len(_GAIT), designs.n), np.nan)
    for structure, some in _alike(designs.walkers, numbers).items():
        for k in range(0, len(some), _LINES):
            part = some[k : k + _LINES]
            problem = Lanes(designs.walkers.some(part), structure)
            branches = survey_lines(problem, COARSE)
            points = find(problem, branches, rows.sought)
            rows.store(problem, part, points, surveyed=1)
            for i, of_line in zip(part.tolist(), branches, strict=True):
                if request:
                    solved = solve_line(designs.line_of(i), of_line, request)
                    gaits[:, [i]] = _long(solved)

    return gaits


def _gaits_over_plane(
    designs: _Designs, plane: Plane, request: Request | None
) -> np.ndarray:
    """The long gaits of designs at a slope, if one is asked for, by charts."""
    gaits = np.full((len(_GAIT), designs.n), np.nan)
    if not request:
        return gaits

    # Invalid designs are not solved.
    every = np.arange(designs.n)
    possible = [number for number, _ in _possible(designs.walkers, every)]
    if possible:
        lines = [designs.line_of(i) for i in possible]
        (slope,) = request.slope
        family = Family.of(lines[0], plane.keys)
        charts = make_charts(family, plane, request.wanted, (slope, slope), 1)
        gaits[:, possible] = _long(solve_plane(lines, plane, request, [charts]))

    return gaits


def _long(solved: Arrays) -> np.ndarray:
    """Stance angle, both rates and spectral radius of the long gaits of n points, (4,
    n).
    """
    return np.array([solved[name][:, GAITS.index("long")] for name in _GAIT])


def _disturb(
    walkers: WalkerArray,
    gaits: np.ndarray,
    slope: float,
    ground: float,
    rows: _Rows,
) -> None:
    """Store the attractors beside walkers' long gaits at a slope, and the steps of the
    ground that they survive.
    """
    walking = np.flatnonzero(np.isfinite(gaits[0]))
    for structure, numbers in _alike(walkers, walking).items():
        some = walkers.some(numbers)
        problem = Lanes(some, structure)
        time_unit = some.time_unit
        angle, stance_rate, thigh_rate, radius = gaits[:, numbers]
        state = np.array([angle, stance_rate * time_unit, thigh_rate * time_unit])
        y = problem.section_of(state, np.full(len(numbers), slope))
        rows.attractor[numbers] = attractors_beside(problem, y, slope)
        stable = np.flatnonzero(radius < 1)
        if ground and len(stable):
            rows.steps[:, numbers[stable]] = largest_steps(
                problem.some(stable), y[:, stable], slope, ground
            )


def _walkers(
    walker: Any,
    keys: Mapping[str, np.ndarray],
    n: int,
) -> WalkerArray:
    """Walkers of designs; every number is an array."""
    few = resolve_many(walker, {key: np.array(value) for key, value in keys.items()})
    table: dict[str, Any] = {
        key: value if isinstance(value, (bool, str)) else np.broadcast_to(value, n)
        for key, value in few.table().items()
    }
    return WalkerArray(**table)


def _possible(
    walkers: WalkerArray, numbers: np.ndarray
) -> Iterator[tuple[int, Walker]]:
    """Yield those of the walkers with some numbers that are valid, and their numbers."""
    for i in numbers.tolist():
        try:
            walker = walkers[i]
        except WalkerError:
            continue
        yield i, walker


def _alike(walkers: WalkerArray, numbers: np.ndarray) -> dict[Structure, np.ndarray]:
    """Numbers of the walkers of each structure, without invalid ones."""
    possible = dict(_possible(walkers, numbers))
    valid = np.array([*possible], int)
    by_structure = alike([*possible.values()])
    return {structure: valid[some] for structure, some in by_structure.items()}


def _over_plane(
    designs: _Designs,
    plane: Plane,
    rows: _Rows,
) -> np.ndarray:
    """Store the designs of a plane whose points its manifolds predict, and return which
    those are, shape (n,).
    """
    family = Family.of(designs.line_of(0), plane.keys)
    values = np.column_stack([designs.keys[key] for key in family.keys])
    accepted = np.zeros(designs.n, bool)
    left = np.ones(designs.n, bool)
    for part in _landscapes(family, plane.box, rows.sought, plane.lines, plane.log):
        is_above = (values >= part.box.low).all(axis=1)
        is_below = (values <= part.box.high).all(axis=1)
        inside = np.flatnonzero(left & is_above & is_below)
        left[inside] = False
        for k in range(0, 0 if part.why else len(inside), _DESIGNS):
            some = inside[k : k + _DESIGNS]
            accepted[some] = _solve(family, part, values[some], some, rows)

    return accepted


@functools.lru_cache(64)
def _landscapes(
    family: Family,
    box: Box,
    sought: Sought,
    count: float,
    log: tuple[bool, ...],
) -> list[Landscape]:
    """Landscapes of a box, for about so many designs, spread by the logarithms of some
    keys.
    """
    return make(family, box, sought, count, log)


def _solve(
    family: Family,
    landscape: Landscape,
    keys: np.ndarray,
    numbers: np.ndarray,
    rows: _Rows,
) -> np.ndarray:
    """Store the designs of a landscape that are accepted, and return which those are.

    Parameters
    ----------
    keys : ndarray, shape (n, d) [the walker's units]
    numbers : ndarray of int, shape (n,)
        Of the designs among the rows.
    """
    maker = Maker(family, landscape.box, landscape.structure)
    unit = landscape.box.unit(keys)
    problem = maker.problem(unit)
    points, accepted, flags = points_at(
        problem, landscape.manifolds, unit, rows.sought.window
    )
    accepted &= is_known(flags, landscape.patterns)
    if landscape.any_slope:
        accepted &= are_tuned(family.walkers(keys))
    rows.store(problem, numbers, points, 0, landscape.any_slope, accepted)
    return accepted


class _Rows:
    """Rows of the table, one for each of n designs, without units.

    `at` has what is known of the point at which each quantity is reached: logarithms of
    slope and speed, over sqrt(g leg), their errors, its `kind`, or why there is none,
    whether stable gaits are next to it, and the gait.
    """

    def __init__(self, n: int, sought: Sought):
        self.sought = sought
        names = QUANTITIES
        if sought.log_speed is None:
            names = QUANTITIES[: -len(COSTS)]
        self.at = {name: _nothing_reached(n) for name in names}
        self.surveyed = np.zeros(n, int)
        self.attractor = np.full(n, _NO_GAIT, "U32")
        self.steps = np.full((2, n), np.nan)

    def store(
        self,
        problem: Lanes,
        numbers: np.ndarray,
        points: Points,
        surveyed: int,
        any_slope: bool = False,
        accepted: np.ndarray | None = None,
    ) -> None:
        """Store what the points of some designs, numbered from 0 in `points`, give."""
        n = len(numbers)
        window = self.sought.window
        chosen = best(points, n, window)
        kept = np.ones(n, bool) if accepted is None else accepted
        self.surveyed[numbers[kept]] = surveyed

        is_any = points.walks & (points.kind == ANY_SLOPE)
        walks = np.full(n, any_slope)
        walks[points.line[in_window(points, window) | is_any]] = True
        for name, at in self.at.items():
            there = np.flatnonzero(kept & (chosen[name] >= 0))
            absent = kept & (chosen[name] < 0)
            at["kind"][numbers[absent]] = _NO_GAIT
            if name != "smallest_slope":
                at["kind"][numbers[absent & walks]] = _NEVER_STABLE
            if len(there):
                reached = lanes_of(points, chosen[name][there])
                for column, values in _reached(problem.some(there), reached).items():
                    at[column][numbers[there]] = values

        if any_slope:
            self.at["smallest_slope"]["kind"][numbers[kept]] = ANY_SLOPE

    def some(self, numbers: np.ndarray) -> _Rows:
        """Return the rows of some designs, (k,)."""
        rows = _Rows(len(numbers), self.sought)
        for name, at in self.at.items():
            rows.at[name] = {column: values[numbers] for column, values in at.items()}
        rows.surveyed = self.surveyed[numbers]
        rows.attractor = self.attractor[numbers]
        rows.steps = self.steps[:, numbers]
        return rows

    def table(self, walkers: WalkerArray, options: Mapping[str, Any]) -> Arrays:
        """All columns of the table, in the walkers' units."""
        with np.errstate(invalid="ignore"):  # of walkers that cannot be
            return self._columns(walkers) | self._further(options)

    def _further(self, options: Mapping[str, Any]) -> Arrays:
        """The columns that options ask for."""
        out: Arrays = {}
        if options["at_speed"] is not None:
            for name in COSTS:
                at = self.at[name]
                slope = np.exp(at["log_slope"])
                out[f"{name}_of_transport"] = np.sin(slope)
                out[f"{name}_error"] = at["error"]
                out[f"slope_at_{name}"] = slope
                out[f"gait_at_{name}"] = at["gait"]

            out["stable_at_least_cost"] = self.at["least_cost"]["stable"]

        if options["at_slope"] is not None:
            out["attractor"] = self.attractor
            if options["ground"]:
                out["largest_step_down"], out["largest_step_up"] = self.steps

        return out

    def _columns(self, walkers: WalkerArray) -> Arrays:
        """The table's columns, in the walkers' units."""
        smallest, stable, fastest = (self.at[name] for name in _OF)
        froude = np.exp(fastest["log_froude"])
        any_slope = smallest["kind"] == ANY_SLOPE
        columns = {
            "smallest_slope": np.where(any_slope, 0.0, np.exp(smallest["log_slope"])),
            "smallest_slope_error": np.where(any_slope, 0.0, smallest["error"]),
            "smallest_at": smallest["kind"],
            "largest_stable_slope": np.exp(stable["log_slope"]),
            "largest_stable_slope_error": stable["error"],
            "stability_lost_by": stable["kind"],
            "fastest_stable_speed": froude * np.sqrt(walkers.g * walkers.leg),
            "fastest_stable_speed_error": fastest["speed_error"],
            "fastest_froude_speed": froude,
            "fastest_slope": np.exp(fastest["log_slope"]),
        }
        for quantity, of in _OF.items():
            angle, *rates = _STATE
            columns[angle + of] = self.at[quantity][angle]
            for rate in rates:
                columns[rate + of] = self.at[quantity][rate] / walkers.time_unit

        columns["surveyed"] = self.surveyed
        return columns


def _nothing_reached(n: int) -> Arrays:
    """What `_Rows` has of a quantity that none of n designs reaches."""
    numbers = ("log_slope", "error", "log_froude", "speed_error", "stable", *_STATE)
    out = {column: np.full(n, np.nan) for column in numbers}
    out["kind"] = np.full(n, _NO_WALKER, "U32")
    out["gait"] = np.full(n, "", "U8")
    return out


def _reached(problem: Lanes, points: Points) -> Arrays:
    """What is known of points at which quantities of designs are reached, as `_Rows`
    has it.
    """
    angle = np.exp(points.Z[0])
    slope = np.exp(points.log_slope)
    state = problem.start(np.vstack([angle, angle * points.Z[1 : problem.m]]), slope)
    names = ("log_slope", "error", "log_froude", "speed_error", "stable", "kind")
    known = {name: getattr(points, name) for name in names} | {
        "gait": np.where(points.long, *GAITS[:2])
    }
    return known | dict(zip(_STATE, state, strict=True))
