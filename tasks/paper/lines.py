"""What claims are computed from: the gaits of a line, solved once a process and then looked up."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from scipy.optimize import brentq

from tasks.continuation import atlas as atlases
from tasks.continuation.branch import Branch
from tasks.continuation.special_points import special_points
from tasks.continuation.tracking import correct
from tasks.fixed_points.multipliers import multipliers
from tasks.fixed_points.step_check import gait_ratio
from tasks.measures.kinematics import travel
from tasks.registry import COSTLY, GAITS, VARIABLES
from tasks.solve_points import atlas, points
from tasks.step.problem import Problem
from tasks.walkers.resolve import resolve
from tasks.walkers.walker import Walker

Arrays = dict[str, np.ndarray]
LONG, SHORT = GAITS.index("long"), GAITS.index("short")
#: What a look-up brings along.
USUAL = tuple(v for v in VARIABLES if VARIABLES[v].group not in COSTLY)
#: The walkers that meet the static conditions exactly.
TUNED = ("A", "B", "C", "D", "E", "F")


class Line:
    """The gaits of one walker over slope."""

    def __init__(self, walker: str, settings: Mapping[str, float], known: Arrays | None = None):
        self.params = {"line": {"walker": walker, "set": dict(settings)}}
        self.walker: Walker = resolve(walker, settings)
        self.problem = Problem(self.walker)
        self.arrays = atlas(self.params, []) if known is None else known
        self.branches: list[Branch] = atlases.from_arrays(self.arrays)
        self._grids: dict[tuple[float, float, int], Arrays] = {}

    def at(self, slope: np.ndarray | list[float] | float, want: tuple[str, ...] = USUAL) -> Arrays:
        """Variables of every gait at those slopes, shape (n, gaits[, multipliers])."""
        slope = np.atleast_1d(np.asarray(slope, float))
        found = points({**self.params, "slope": slope, "want": want, "gaits": GAITS}, [self.arrays])
        return {"slope": slope, **found}

    def grid(self, low: float = 1e-8, high: float = 0.2, n: int = 97) -> Arrays:
        """The usual variables over a log grid of slopes."""
        key = (low, high, n)
        if key not in self._grids:
            self._grids[key] = self.at(np.geomspace(low, high, n))
        return self._grids[key]

    def exponent(self, gait: int, slope: float, ordinate: str = "stance_angle", abscissa: str = "slope") -> float:
        """Local exponent d ln ordinate/d ln abscissa, from slopes a twentieth to either side."""
        found = self.at(slope * np.array([0.95, 1.05]))
        if any(np.diff(found[name][:, gait])[0] for name in ("branch", "piece")):
            raise ValueError(f"the {GAITS[gait]} gaits around slope {slope:g} lie on two curves")
        x = found["slope"] if abscissa == "slope" else found[abscissa][:, gait]
        return float(np.diff(np.log(found[ordinate][:, gait]))[0] / np.diff(np.log(x))[0])

    def short(self, Z: np.ndarray) -> bool:
        """Whether a row (X, times) of a branch is a short step."""
        m = self.problem.m
        stride, _ = self.problem.stride(np.delete(Z, m)[:, None], Z[m : m + 1])
        return not gait_ratio(stride)[0] < 0.5

    def ends(self) -> tuple[float, float]:
        """Smallest and largest slope of any branch."""
        q = np.concatenate([b.q for b in self.branches])
        return float(np.exp(q.min())), float(np.exp(q.max()))

    @functools.cached_property
    def special(self) -> list[dict[str, Any]]:
        """Special points of every branch, each with the number of its `branch`."""
        return [
            {"branch": k, **point} for k, b in enumerate(self.branches) for point in special_points(self.problem, b)
        ]

    def special_of(self, kind: str) -> list[dict[str, Any]]:
        """Special points of a kind, by slope."""
        return sorted((p for p in self.special if p["kind"] == kind), key=lambda p: p["slope"])

    def curve(self, branch: int = 0) -> Arrays:
        """A branch at its nodes, in its own order: what a gait is there, in the walker's units."""
        return curve(self.problem, self.branches[branch])


def curve(problem: Problem, found: Branch) -> Arrays:
    """The nodes of a branch: slope, angle, times, speed, stability and label."""
    m, walker = found.m, problem.walker
    X, times = found.Z[:, : m + 1].T, found.Z[:, m + 1 :].T
    nodes = correct(problem, X, times, found.tangent[:, : m + 1].T)
    time_unit = np.sqrt(walker.leg / walker.g)
    slope, angle = np.exp(X[m]), np.exp(X[0])
    return {
        "slope": slope,
        "stance_angle": angle,
        "period": times[-1] * time_unit,
        "knee_share": times[0] / times[-1],
        "closing": nodes.stride.closing / nodes.stride.y[0],
        "short": ~(gait_ratio(nodes.stride) < 0.5),
        "spectral_radius": np.abs(multipliers(nodes.stride.jacobian, m)).max(axis=1),
        "speed": travel(walker, slope, angle, times[-1] * time_unit)["speed"],
    }


_LINES: dict[tuple[str, tuple[tuple[str, float], ...]], Line] = {}
#: Tables that a study's own task made of its lines, by walker: several lines of one walker stand one below the other.
_TABLES: dict[str, Arrays] = {}


def line(walker: str, **settings: float) -> Line:
    """The line of a catalogue walker; solved once a process."""
    key = walker, tuple(sorted(settings.items()))
    if key not in _LINES:
        _LINES[key] = Line(walker, settings)
    return _LINES[key]


def cache_atlas(walker: str, settings: Mapping[str, float], known: Arrays) -> None:
    """Take a line's atlas as solved elsewhere."""
    key = walker, tuple(sorted(settings.items()))
    if key not in _LINES:
        _LINES[key] = Line(walker, settings, known)


def cache_tables(walker: str, tables: Arrays) -> None:
    """Take the tables of a line as made elsewhere."""
    mine = _TABLES.setdefault(walker, {})
    for name, column in tables.items():
        mine[name] = np.concatenate([mine[name], column]) if name in mine else column


def table(group: str, walker: str, make: Callable[[], Arrays]) -> Arrays:
    """Columns of one table of a walker: the study's own, or else what `make` gives."""
    if not any(name.startswith(f"{group}/") for name in _TABLES.get(walker, {})):
        cache_tables(walker, make())
    return {name.partition("/")[2]: column for name, column in _TABLES[walker].items() if name.startswith(f"{group}/")}


def root(function: Callable[[float], float], slope: np.ndarray, values: np.ndarray, last: bool = False) -> float:
    """The slope at which a function of slope, known at some slopes, changes sign; NaN where it does not."""
    turns = np.nonzero(np.sign(values[1:]) * np.sign(values[:-1]) < 0)[0]
    if not len(turns):
        return float("nan")
    k = turns[-1 if last else 0]
    return float(
        np.exp(brentq(lambda q: function(float(np.exp(q))), np.log(slope[k]), np.log(slope[k + 1]), xtol=1e-11))
    )


def foot_ratio(walker: Walker, data: Arrays) -> np.ndarray:
    """|x'/y'| of the swing foot just before heelstrike, shape (n, gaits) (paper, eq. 12, its sign mended).

    Notes
    -----
    With u the rate ratio: x' = (R + l cos angle) u, y' = -l sin angle (2 - u), over the stance rate.
    """
    angle, u = data["stance_angle"], data["heelstrike_rate_ratio"]
    return np.abs((walker.R + walker.l * np.cos(angle)) * u / (walker.l * np.sin(angle) * (2 - u)))


def numbers(pairs: Mapping[str, float], digits: int = 4) -> str:
    """Named numbers on one line."""
    return ", ".join(f"{name} {value:.{digits}g}" for name, value in pairs.items())
