"""The data of claims: the gaits of a line, solved once a process, and tables of studies."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Iterable, Mapping
from typing import Any, TypeVar, cast

import numpy as np

from gaitsweep.tasks.continuation import atlas as atlases
from gaitsweep.tasks.continuation.branch import Branch
from gaitsweep.tasks.continuation.root import bracketed_root
from gaitsweep.tasks.continuation.special_points import special_points
from gaitsweep.tasks.continuation.tracking import correct
from gaitsweep.tasks.fixed_points.multipliers import multipliers
from gaitsweep.tasks.fixed_points.step_check import gait_ratio
from gaitsweep.tasks.measures.kinematics import step_length
from gaitsweep.tasks.measures.losses import velocity_ratio
from gaitsweep.tasks.registry import COSTLY, GAITS, VARIABLES
from gaitsweep.tasks.solve_points import atlas, points
from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.walkers.resolve import resolve
from gaitsweep.tasks.walkers.walker import Walker

Arrays = dict[str, np.ndarray]
LONG, SHORT = GAITS.index("long"), GAITS.index("short")
#: Variables that a look-up returns by default.
_USUAL = tuple(v for v in VARIABLES if VARIABLES[v].group not in COSTLY)
#: Special points at which stability may change.
_EXCHANGES = ("fold", "flip", "neimark_sacker", "branch_point")
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

    def at(self, slope: np.ndarray | list[float] | float, want: tuple[str, ...] = _USUAL) -> Arrays:
        """Variables of every gait at given slopes.

        Parameters
        ----------
        slope : ndarray, shape (n,) [rad]
        want : tuple of str
            Names of variables.

        Returns
        -------
        dict
            `slope`, and arrays of shape (n, gaits[, multipliers]) in the walker's units.
        """
        slope = np.atleast_1d(np.asarray(slope, float))
        return {"slope": slope, **points({**self.params, "slope": slope, "want": want, "gaits": GAITS}, [self.arrays])}

    def grid(self, low: float = 1e-8, high: float = 0.2, n: int = 97) -> Arrays:
        """Variables of every gait over a logarithmic grid of slopes.

        Parameters
        ----------
        low, high : float [rad]
        n : int

        Returns
        -------
        dict
            As from `at`; computed once.
        """
        key = (low, high, n)
        if key not in self._grids:
            self._grids[key] = self.at(np.geomspace(low, high, n))
        return self._grids[key]

    def exponent(self, gait: int, slope: float, ordinate: str = "stance_angle", abscissa: str = "slope") -> float:
        """Local exponent d ln ordinate/d ln abscissa, by a difference over slopes 5 % to either side.

        Raises
        ------
        ValueError
            If the gaits at those slopes lie on different curves.
        """
        pair = self.at(slope * np.array([0.95, 1.05]))
        if any(np.diff(pair[name][:, gait])[0] for name in ("branch", "piece")):
            raise ValueError(f"the {GAITS[gait]} gaits around slope {slope:g} lie on two curves")
        x = pair["slope"] if abscissa == "slope" else pair[abscissa][:, gait]
        return float(np.diff(np.log(pair[ordinate][:, gait]))[0] / np.diff(np.log(x))[0])

    def is_short(self, Z: np.ndarray) -> bool:
        """Whether a row of a branch is a short step.

        Parameters
        ----------
        Z : ndarray, shape (m + 1 + phases,)
        """
        stride, _ = self.problem.stride(Z[:-1, None], Z[-1:])
        return not gait_ratio(stride)[0] < 0.5

    def ends(self) -> tuple[float, float]:
        """Smallest and largest slope of any branch [rad]."""
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

    def stable(self) -> list[tuple[dict[str, Any], dict[str, Any]]]:
        """Find the parts of branches whose gaits are stable.

        Returns
        -------
        list of tuple
            The special points between which each part lies, by slope.

        Raises
        ------
        ValueError
            If stability changes where no special point is.
        """
        parts = []
        for k in range(len(self.branches)):
            radius = self.curve(k)["spectral_radius"]
            points = [p for p in self.special if p["branch"] == k]
            bounds = [p for p in points if p["kind"] in _EXCHANGES or p in (points[0], points[-1])]
            for a, b in itertools.pairwise(bounds):
                between = radius[int(np.floor(a["place"])) + 1 : int(np.ceil(b["place"]))] < 1
                if between.any():
                    if not between.all():
                        raise ValueError(f"gaits between slopes {a['slope']:g} and {b['slope']:g} differ in stability")
                    parts.append((a, b) if a["slope"] < b["slope"] else (b, a))
        return sorted(parts, key=lambda part: part[0]["slope"])

    def curve(self, branch: int = 0) -> Arrays:
        """Gaits at the nodes of a branch, in its own order.

        Returns
        -------
        dict of ndarray, shape (nodes,)
            slope, stance_angle, period and speed in the walker's units; knee_share, the kneestrike's time over the
            period; closing, the rate at which the foot meets the ground over the angle; short; spectral_radius.
        """
        return _evaluate_nodes(self.problem, self.branches[branch])


def _evaluate_nodes(problem: Problem, branch: Branch) -> Arrays:
    m, walker, nodes = branch.m, problem.walker, correct(problem, branch.Z, branch.direction)
    time_unit, times = np.sqrt(walker.leg / walker.g), branch.Z[m:-1]
    slope, angle = np.exp(branch.q), np.exp(branch.Z[0])
    return {
        "slope": slope,
        "stance_angle": angle,
        "period": times[-1] * time_unit,
        "knee_share": times[0] / times[-1],
        "closing": nodes.stride.closing[-1] / nodes.stride.y[0],
        "short": ~(gait_ratio(nodes.stride) < 0.5),
        "spectral_radius": np.abs(multipliers(nodes.stride.jacobian, m)).max(axis=1),
        "speed": step_length(walker, angle) / (times[-1] * time_unit),
    }


#: A walker of the catalogue, and the keys that a line sets with their values.
_Key = tuple[str, tuple[tuple[str, float], ...]]
_LINES: dict[_Key, Line] = {}
#: Tables by line: those that the task of the study at hand made of it, and those that claims made themselves.
_STUDY_TABLES: dict[_Key, Arrays] = {}
_MADE_TABLES: dict[_Key, Arrays] = {}


#: Atlases that the task at hand was given, and the memoized functions of claims, which read lines.
_given: list[Any] = []
_MEMOIZED: list[Any] = []
_Function = TypeVar("_Function", bound=Callable[..., Any])


def memoize(function: _Function) -> _Function:
    """Remember the results of a function of claims until a task is given other atlases."""
    _MEMOIZED.append(functools.lru_cache(maxsize=32)(function))
    return cast(_Function, _MEMOIZED[-1])


def line(walker: str, **settings: float) -> Line:
    """Line of a catalogue walker with some keys set; solved once for all that is computed from the same atlases."""
    key = walker, tuple(sorted(settings.items()))
    if key not in _LINES:
        _LINES[key] = Line(walker, settings)
    return _LINES[key]


def use_atlases(known: Iterable[tuple[str, Mapping[str, float], Arrays]]) -> None:
    """Use atlases that are known already, and forget what was computed from others.

    Parameters
    ----------
    known : iterable of (str, mapping, dict)
        Name in the catalogue, values of the keys that the line sets, and the atlas as arrays of task `atlas`.

    Notes
    -----
    A result must not depend on what its process computed before: atlases of other studies may be coarser.
    """
    lines = [(walker, tuple(sorted(settings.items())), arrays) for walker, settings, arrays in known]
    given = [(walker, keys, sorted((k, v.tobytes()) for k, v in arrays.items())) for walker, keys, arrays in lines]
    if given == _given:
        return
    _given[:] = given
    for cache in (_LINES, _MADE_TABLES):
        cache.clear()
    for function in _MEMOIZED:
        function.cache_clear()
    for walker, keys, arrays in lines:
        _LINES.setdefault((walker, keys), Line(walker, dict(keys), arrays))


def set_tables(tables: Iterable[tuple[str, Mapping[str, float], Arrays]]) -> None:
    """Replace the study's tables.

    Parameters
    ----------
    tables : iterable of (str, mapping, dict)
        Walker, values of the keys that the line sets, and columns ("group/column", shape (n,)) of each line.
    """
    _STUDY_TABLES.clear()
    _STUDY_TABLES.update(((walker, tuple(sorted(settings.items()))), columns) for walker, settings, columns in tables)


def table(group: str, walker: str, make: Callable[[], Arrays], **settings: float) -> Arrays:
    """Look up one table of a line.

    Parameters
    ----------
    group, walker : str
        Name of the table, and of the walker in the catalogue.
    make : callable
        Computes tables ("group/column"), once a process, where the study has not this one.
    **settings : float
        Values of the keys that the line sets.

    Returns
    -------
    dict of ndarray, shape (n,)
        By column.
    """
    key = walker, tuple(sorted(settings.items()))

    def columns(tables: Mapping[_Key, Arrays]) -> Arrays:
        named = (name.partition("/") for name in tables.get(key, {}))
        return {column: tables[key][f"{group}/{column}"] for prefix, _, column in named if prefix == group}

    if not columns(_STUDY_TABLES) and not columns(_MADE_TABLES):
        _MADE_TABLES.setdefault(key, {}).update(make())
    return columns(_STUDY_TABLES) or columns(_MADE_TABLES)


def root(function: Callable[[float], float], slope: np.ndarray, values: np.ndarray, last: bool = False) -> float:
    """Find the slope at which a function of slope changes sign.

    Parameters
    ----------
    function : callable
        Of one slope [rad].
    slope, values : ndarray, shape (n,) [rad, any]
        Slopes and the function's values there, between which its sign is followed.
    last : bool
        Take the last change of sign, not the first.

    Returns
    -------
    float [rad]
        NaN where the sign does not change.
    """
    changes = np.nonzero(np.sign(values[1:]) * np.sign(values[:-1]) < 0)[0]
    if not len(changes):
        return float("nan")
    k = changes[-1 if last else 0]
    low, high = (float(np.log(s)) for s in slope[k : k + 2])
    return float(np.exp(bracketed_root(lambda q: function(float(np.exp(q))), low, high, 1e-11)))


def foot_ratio(walker: Walker, data: Arrays) -> np.ndarray:
    """Ratio |x'/y'| of the swing foot's velocities just before heelstrike.

    Parameters
    ----------
    walker : Walker
    data : dict
        `stance_angle` [rad] and `heelstrike_rate_ratio`, shape (n, gaits).

    Returns
    -------
    ndarray, shape (n, gaits)

    """
    return np.abs(velocity_ratio(walker, data["stance_angle"], data["heelstrike_rate_ratio"]))


def numbers(pairs: Mapping[str, float], digits: int = 4) -> str:
    """Format named numbers on one line."""
    return ", ".join(f"{name} {value:.{digits}g}" for name, value in pairs.items())
