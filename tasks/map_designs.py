"""The task `design`: the best performance of each walker, so that a grid of walkers
shows the effect of its keys.
"""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Mapping
from typing import Any

import numpy as np

from gaitsweep.tasks import registry
from gaitsweep.tasks.continuation.atlas import survey_lines, to_arrays
from gaitsweep.tasks.continuation.extremes import (
    ANY_SLOPE,
    COSTS,
    QUANTITIES,
    Points,
    Sought,
    best,
    find,
    in_window,
)
from gaitsweep.tasks.continuation.refine import COARSE
from gaitsweep.tasks.disturb_designs import attractors_beside, largest_steps
from gaitsweep.tasks.families.box import Box
from gaitsweep.tasks.families.family import Family
from gaitsweep.tasks.families.landscape import Landscape, is_known, make, points_at
from gaitsweep.tasks.families.manifold_maker import Maker
from gaitsweep.tasks.mechanics.lumped import Structure, alike
from gaitsweep.tasks.registry import GAITS
from gaitsweep.tasks.solve_planes import charts
from gaitsweep.tasks.solve_planes import lines as lines_of_plane
from gaitsweep.tasks.solve_points import points
from gaitsweep.tasks.step.lanes import lanes_of
from gaitsweep.tasks.step.problem import Lanes
from gaitsweep.tasks.tables import Arrays
from gaitsweep.tasks.walkers.resolve import resolve_many
from gaitsweep.tasks.walkers.statics import are_tuned
from gaitsweep.tasks.walkers.walker import Walker, WalkerError
from gaitsweep.tasks.walkers.walker_array import WalkerArray

#: Entries in place of a reason where there is no number.
_NO_WALKER, _NO_GAIT, _NEVER_STABLE = "no walker", "no gait", "never stable"
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
_LINES, _DESIGNS = 32, 2048


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
    The row of a design depends on the design and its cell alone.
    """
    line = params["line"]
    keys = {
        key: np.atleast_1d(np.asarray(value, float))
        for key, value in line.get("set", {}).items()
    }
    n = max((len(value) for value in keys.values()), default=1)
    keys = {key: np.broadcast_to(value, n) for key, value in keys.items()}

    def line_of(i: int) -> dict[str, Any]:
        return {**line, "set": {key: float(value[i]) for key, value in keys.items()}}

    slope = np.asarray(params["slope"], float)
    window = float(np.log(slope.min())), float(np.log(slope.max()))
    walkers = _walkers(line["walker"], keys, n)
    options = registry.options("design", params)
    at_slope = options["at_slope"]
    at_speed = options["at_speed"]
    ground = float(options["ground"])
    sought = Sought(window, None if at_speed is None else float(np.log(at_speed)))
    rows, accepted, gaits = _Rows(n, sought), np.zeros(n, bool), np.full((4, n), np.nan)
    if "plane" in params:
        accepted = _over_plane(line, keys, params["plane"], rows)
        # Invalid designs are not solved.
        possible = sorted(
            i for own in _alike(walkers, np.arange(n)).values() for i in own
        )
        if at_slope is not None and possible:
            each = [line_of(i) for i in possible]
            slopes = {"slope_from": at_slope, "slope_to": at_slope, "slopes": 1}
            request = {
                "line": each[0],
                "lines": each,
                "slope": np.array([at_slope]),
                "want": _GAIT,
                **slopes,
            }
            request |= {"plane": params["plane"], "whole": True}
            gaits[:, possible] = _long(
                lines_of_plane(request, [charts(request, [])])[0][1]
            )
    others = np.flatnonzero(~accepted)
    for structure, numbers in _alike(walkers, others).items():
        for k in range(0, len(numbers), _LINES):
            part = numbers[k : k + _LINES]
            problem = Lanes(walkers.some(part), structure)
            branches = survey_lines(problem, COARSE)
            rows.store(problem, part, find(problem, branches, sought), surveyed=1)
            if at_slope is not None and "plane" not in params:
                for i, of_line in zip(part.tolist(), branches, strict=True):
                    request = {
                        "line": line_of(i),
                        "slope": np.array([at_slope]),
                        "want": _GAIT,
                    }
                    gaits[:, [i]] = _long(points(request, [to_arrays(of_line)]))
    if at_slope is not None:
        _disturb(walkers, gaits, at_slope, ground, rows)
    columns = rows.columns(walkers) | rows.further(options)
    return {f"design/{name}": values for name, values in columns.items()}


def _long(solved: Arrays) -> np.ndarray:
    """Stance angle, both rates and spectral radius of the long gaits of n points, (4,
    n).
    """
    return np.array([solved[name][:, GAITS.index("long")] for name in _GAIT])


def _disturb(
    walkers: WalkerArray, gaits: np.ndarray, slope: float, ground: float, rows: _Rows
) -> None:
    """Store the attractors beside walkers' long gaits at a slope, and the steps of the
    ground that they survive.
    """
    for structure, numbers in _alike(
        walkers, np.flatnonzero(np.isfinite(gaits[0]))
    ).items():
        own = walkers.some(numbers)
        problem, time_unit = Lanes(own, structure), own.time_unit
        angle, stance_rate, thigh_rate, radius = gaits[:, numbers]
        state = np.array([angle, stance_rate * time_unit, thigh_rate * time_unit])
        y = problem.section_of(state, np.full(len(numbers), slope))
        rows.attractor[numbers] = attractors_beside(problem, y, slope)
        stable = np.flatnonzero(radius < 1)
        if ground and len(stable):
            rows.steps[:, numbers[stable]] = largest_steps(
                problem.some(stable), y[:, stable], slope, ground
            )


def _walkers(walker: Any, keys: Mapping[str, np.ndarray], n: int) -> WalkerArray:
    """Walkers of designs; every number is an array."""
    few = resolve_many(walker, {key: np.array(value) for key, value in keys.items()})
    table: dict[str, Any] = {
        key: value if isinstance(value, (bool, str)) else np.broadcast_to(value, n)
        for key, value in few.table().items()
    }
    return WalkerArray(**table)


def _alike(walkers: WalkerArray, numbers: np.ndarray) -> dict[Structure, np.ndarray]:
    """Numbers of the walkers of each structure, without invalid ones."""
    possible: dict[int, Walker] = {}
    for i in numbers.tolist():
        with contextlib.suppress(WalkerError):
            possible[i] = walkers[i]
    numbers = np.array([*possible], int)
    return {
        structure: numbers[own]
        for structure, own in alike([*possible.values()]).items()
    }


def _over_plane(
    line: Mapping[str, Any],
    keys: Mapping[str, np.ndarray],
    cell: Mapping[str, Any],
    rows: _Rows,
) -> np.ndarray:
    """Store the designs of a cell whose points its manifolds predict, and return which
    those are, shape (n,).
    """
    family = Family.of(
        {**line, "set": {k: float(v[0]) for k, v in keys.items()}}, cell["keys"]
    )
    box = Box(family.keys, tuple(cell["low"]), tuple(cell["high"]), log=True)
    at = np.column_stack([keys[key] for key in family.keys])
    accepted, left = np.zeros(len(at), bool), np.ones(len(at), bool)
    for part in _landscapes(family, box, rows.sought, cell["lines"]):
        inside = np.flatnonzero(
            left & (at >= part.box.low).all(axis=1) & (at <= part.box.high).all(axis=1)
        )
        left[inside] = False
        if not part.why:
            for k in range(0, len(inside), _DESIGNS):
                some = inside[k : k + _DESIGNS]
                accepted[some] = _solve(family, part, at[some], some, rows)
    return accepted


@functools.lru_cache(64)
def _landscapes(
    family: Family, box: Box, sought: Sought, count: int
) -> list[Landscape]:
    """Landscapes of a box, for about so many designs."""
    return make(family, box, sought, count)


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
    points, accepted, flags = points_at(
        maker, landscape.manifolds, unit, rows.sought.window
    )
    accepted &= is_known(flags, landscape.patterns)
    if landscape.any_slope:
        accepted &= are_tuned(family.walkers(keys))
    rows.store(maker.problem(unit), numbers, points, 0, landscape.any_slope, accepted)
    return accepted


class _Rows:
    """Rows of the table, one for each of n designs.

    `at` has what is known of the point at which each quantity is reached: logarithms of
    slope and speed, over sqrt(g leg), their errors, its `kind`, or why there is none,
    whether stable gaits are next to it, and the gait.
    """

    def __init__(self, n: int, sought: Sought):
        self.sought = sought
        names = (
            QUANTITIES if sought.log_speed is not None else QUANTITIES[: -len(COSTS)]
        )
        numbers = ("log_slope", "error", "log_froude", "speed_error", "stable", *_STATE)
        self.at: dict[str, Arrays] = {
            name: {column: np.full(n, np.nan) for column in numbers}
            | {"kind": np.full(n, _NO_WALKER, "U32"), "gait": np.full(n, "", "U8")}
            for name in names
        }
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
        n, window = len(numbers), self.sought.window
        chosen = best(points, n, window)
        kept = np.ones(n, bool) if accepted is None else accepted
        self.surveyed[numbers[kept]] = surveyed
        walks = np.zeros(n, bool)
        walks[
            points.line[
                in_window(points, window) | (points.walks & (points.kind == ANY_SLOPE))
            ]
        ] = True
        for name, at in self.at.items():
            point = chosen[name]
            there = np.flatnonzero(kept & (point >= 0))
            if len(there):
                for column, values in _reached(
                    problem.some(there), lanes_of(points, point[there])
                ).items():
                    at[column][numbers[there]] = values
            absent = kept & (point < 0)
            at["kind"][numbers[absent]] = _NO_GAIT
            if name != "smallest_slope":
                at["kind"][numbers[absent & (walks | any_slope)]] = _NEVER_STABLE
        if any_slope:
            self.at["smallest_slope"]["kind"][numbers[kept]] = ANY_SLOPE

    def further(self, options: Mapping[str, Any]) -> Arrays:
        """The columns that options ask for."""
        out: Arrays = {}
        if options["at_speed"] is not None:
            for name in COSTS:
                at, slope = self.at[name], np.exp(self.at[name]["log_slope"])
                out |= {
                    f"{name}_of_transport": np.sin(slope),
                    f"{name}_error": at["error"],
                }
                out |= {f"slope_at_{name}": slope, f"gait_at_{name}": at["gait"]}
            out["stable_at_least_cost"] = self.at["least_cost"]["stable"]
        if options["at_slope"] is not None:
            out["attractor"] = self.attractor
            if options["ground"]:
                out |= dict(
                    zip(
                        ("largest_step_down", "largest_step_up"),
                        self.steps,
                        strict=True,
                    )
                )
        return out

    def columns(self, walkers: WalkerArray) -> Arrays:
        """The table's columns, in the walkers' units."""
        smallest, stable, fastest = (self.at[name] for name in _OF)
        froude, any_slope = np.exp(fastest["log_froude"]), smallest["kind"] == ANY_SLOPE
        unit = [1.0, *3 * [walkers.time_unit]]
        return {
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
            **{
                name + of: self.at[at][name] / by
                for at, of in _OF.items()
                for name, by in zip(_STATE, unit, strict=True)
            },
            "surveyed": self.surveyed,
        }


def _reached(problem: Lanes, points: Points) -> Arrays:
    """What is known of points at which quantities of designs are reached, as `_Rows`
    has it.
    """
    angle, slope = np.exp(points.Z[0]), np.exp(points.log_slope)
    state = problem.start(np.vstack([angle, angle * points.Z[1 : problem.m]]), slope)
    names = ("log_slope", "error", "log_froude", "speed_error", "stable", "kind")
    known = {name: getattr(points, name) for name in names} | {
        "gait": np.where(points.long, *GAITS[:2])
    }
    return known | dict(zip(_STATE, state, strict=True))
