"""The data of claims: the gaits of a line, solved once a process, and tables of
studies.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Concatenate, ParamSpec, TypeVar, cast

import numpy as np

from gaitsweep.tasks.branches import atlas as atlases
from gaitsweep.tasks.branches.branch import Branch
from gaitsweep.tasks.branches.root import bracketed_root
from gaitsweep.tasks.branches.special_points import special_points
from gaitsweep.tasks.branches.tracking import correct
from gaitsweep.tasks.contract.kinds import kind_of
from gaitsweep.tasks.contract.registry import COSTLY, GAITS, VARIABLES
from gaitsweep.tasks.contract.tables import Arrays
from gaitsweep.tasks.gaits.multipliers import multipliers
from gaitsweep.tasks.gaits.step_check import LONG_BELOW, gait_ratio
from gaitsweep.tasks.measures.kinematics import step_length
from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.studies.solve_points import atlas, lines, points
from gaitsweep.tasks.walkers.resolve import resolve
from gaitsweep.tasks.walkers.walker import Walker

LONG, SHORT = GAITS.index("long"), GAITS.index("short")
BOTH = {"long": LONG, "short": SHORT}
#: Variables that a look-up returns by default.
_USUAL = tuple(v for v in VARIABLES if VARIABLES[v].group not in COSTLY)
#: Ends of the usual grid of slopes [rad].
GRID = (1e-8, 0.2)
#: The walkers that meet the static conditions exactly.
TUNED = ("A", "B", "C", "D", "E", "F")
#: All walkers of the paper, with exact parameters where it has them.
WALKERS = (*TUNED, "physical", "physical-straight")


_Self = TypeVar("_Self", "Line", "Paper")
_Rest = ParamSpec("_Rest")
_Result = TypeVar("_Result")


def memoize(
    function: Callable[Concatenate[_Self, _Rest], _Result],
) -> Callable[Concatenate[_Self, _Rest], _Result]:
    """Remember in its first argument, a paper or a line, what a function gives."""

    def remembered(self: _Self, *rest: _Rest.args, **named: _Rest.kwargs) -> _Result:
        key = function, rest, tuple(sorted(named.items()))
        if key not in self.memory:
            self.memory[key] = function(self, *rest, **named)
        return cast(_Result, self.memory[key])

    return remembered


class Line:
    """The gaits of one walker over slope."""

    def __init__(
        self, walker: str, settings: Mapping[str, float], known: Arrays | None = None
    ):
        self.params = {"line": {"walker": walker, "set": dict(settings)}}
        self.walker: Walker = resolve(walker, settings)
        self.problem = Problem(self.walker)
        self.arrays = atlas(self.params, []) if known is None else known
        self.branches: list[Branch] = atlases.from_arrays(self.arrays)
        self.memory: dict[Any, Any] = {}

    def at(
        self, slope: np.ndarray | list[float] | float, want: tuple[str, ...] = _USUAL
    ) -> Arrays:
        """Variables of every gait at given slopes.

        Parameters
        ----------
        slope : ndarray, shape (n,) [rad]
        want : tuple of str
            Names of variables.

        Returns
        -------
        dict
            `slope`, and arrays of shape (n, gaits[, multipliers]) in the walker's
            units.
        """
        slope = np.atleast_1d(np.asarray(slope, float))
        return {
            "slope": slope,
            **points(
                {**self.params, "slope": slope, "want": want, "gaits": GAITS},
                [self.arrays],
            ),
        }

    @memoize
    def grid(self, low: float = GRID[0], high: float = GRID[1], n: int = 97) -> Arrays:
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
        return self.at(np.geomspace(low, high, n))

    def crossing(
        self, function: Callable[[Arrays], np.ndarray], want: tuple[str, ...]
    ) -> float:
        """Slope at which a function of gaits first changes its sign [rad]; NaN where it
        does not.

        Parameters
        ----------
        function : callable
            Of variables of gaits, as from `at`; shape (n,).
        want : tuple of str
            Those that it reads.
        """
        grid = self.grid()
        slope, values = grid["slope"], function(grid)
        changes = np.nonzero(np.sign(values[1:]) * np.sign(values[:-1]) < 0)[0]
        if not len(changes):
            return float("nan")

        low, high = (float(np.log(s)) for s in slope[changes[0] : changes[0] + 2])
        root = bracketed_root(
            lambda q: float(function(self.at([float(np.exp(q))], want))[0]),
            low,
            high,
            1e-11,
        )
        return float(np.exp(root))

    def exponent(
        self,
        gait: int,
        slope: float,
        ordinate: str = "stance_angle",
        abscissa: str = "slope",
    ) -> float:
        """Local exponent d ln ordinate/d ln abscissa, by a difference over slopes 5 %
        to either side.

        Raises
        ------
        ValueError
            If the gaits at those slopes lie on different curves.
        """
        pair = self.at(slope * np.array([0.95, 1.05]))
        if any(np.diff(pair[name][:, gait])[0] for name in ("branch", "piece")):
            raise ValueError(
                f"the {GAITS[gait]} gaits around slope {slope:g} lie on two curves"
            )

        x = pair["slope"] if abscissa == "slope" else pair[abscissa][:, gait]

        return float(
            np.diff(np.log(pair[ordinate][:, gait]))[0] / np.diff(np.log(x))[0]
        )

    def is_short(self, Z: np.ndarray) -> bool:
        """Whether a row of a branch is a short step.

        Parameters
        ----------
        Z : ndarray, shape (m + 1 + phases,)
        """
        stride, _ = self.problem.stride(Z[:-1, None], Z[-1:])
        return not gait_ratio(stride)[0] < LONG_BELOW

    def exponents(self, slope: float, *of: str) -> dict[str, float]:
        """Local exponents of both gaits, by their labels; `of` names ordinate and
        abscissa.
        """
        return {label: self.exponent(gait, slope, *of) for label, gait in BOTH.items()}

    @property
    def reaches(self) -> np.ndarray:
        """Smallest and largest slope of each branch, shape (2, branches) [rad]."""
        return np.exp(np.array([[b.q.min(), b.q.max()] for b in self.branches]).T)

    @functools.cached_property
    def special(self) -> list[dict[str, Any]]:
        """Special points of every branch, each with the number of its `branch`."""
        return [
            {"branch": k, **point}
            for k, b in enumerate(self.branches)
            for point in special_points(self.problem, b)
        ]

    def special_of(self, kind: str) -> list[dict[str, Any]]:
        """Special points of a kind, by slope."""
        return sorted(
            (p for p in self.special if p["kind"] == kind), key=lambda p: p["slope"]
        )

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
            radius = self.curves[k]["spectral_radius"]
            points = [p for p in self.special if p["branch"] == k]
            bounds = [
                p
                for p in points
                if _exchanges_stability(p["kind"]) or p in (points[0], points[-1])
            ]
            for a, b in itertools.pairwise(bounds):
                between = (
                    radius[int(np.floor(a["place"])) + 1 : int(np.ceil(b["place"]))] < 1
                )
                if between.any():
                    if not between.all():
                        raise ValueError(
                            f"gaits between slopes {a['slope']:g} and {b['slope']:g} differ in stability"
                        )
                    parts.append((a, b) if a["slope"] < b["slope"] else (b, a))

        return sorted(parts, key=lambda part: part[0]["slope"])

    @functools.cached_property
    def curves(self) -> list[Arrays]:
        """Gaits at the nodes of every branch, in its own order.

        Arrays of shape (nodes,): slope, stance_angle, period and speed in the walker's
        units; knee_share, the kneestrike's time over the period; closing, the rate at
        which the foot meets the ground over the angle; short; spectral_radius.
        """
        return [self._nodes(branch) for branch in self.branches]

    def _nodes(self, branch: Branch) -> Arrays:
        walker, m, nodes = (
            self.walker,
            branch.m,
            correct(self.problem, branch.Z, branch.direction),
        )
        times = branch.Z[m:-1]
        period, angle = times[-1] * walker.time_unit, np.exp(branch.Z[0])
        return {
            "slope": np.exp(branch.q),
            "stance_angle": angle,
            "period": period,
            "knee_share": times[0] / times[-1],
            "closing": nodes.at.stride.closing[-1] / nodes.at.stride.y[0],
            "short": ~(gait_ratio(nodes.at.stride) < LONG_BELOW),
            "spectral_radius": np.abs(multipliers(nodes.at.stride.jacobian, m)).max(
                axis=1
            ),
            "speed": step_length(walker, angle) / period,
        }


def _exchanges_stability(kind: str) -> bool:
    return kind_of(kind).exchanges_stability


#: A walker of the catalogue, and the keys that a line sets with their values.
_Key = tuple[str, tuple[tuple[str, float], ...]]


class Paper:
    """What claims are checked with: the gaits of lines and the tables of a study, each
    computed once.

    Parameters
    ----------
    atlases : dict
        Those that are known, by line.

    Attributes
    ----------
    tables : dict
        Those that the study's own tasks made, by line: "group/column", shape (n,).
    """

    def __init__(self, atlases: Mapping[_Key, Arrays]):
        self.tables: dict[_Key, Arrays] = {}
        self.memory: dict[Any, Any] = {}
        self._atlases = atlases
        self._made: dict[_Key, Arrays] = {}

    @memoize
    def line(self, walker: str, **settings: float) -> Line:
        """Line of a catalogue walker with some keys set."""
        return Line(walker, settings, self._atlases.get(_key(walker, settings)))

    def exponents(
        self, walkers: Iterable[str], gait: int, slope: float
    ) -> dict[str, float]:
        """Local exponents of the stance angle in slope, by walker."""
        return {walker: self.line(walker).exponent(gait, slope) for walker in walkers}

    def exponents_of_both(
        self, walkers: Iterable[str], slope: float, *of: str
    ) -> dict[str, float]:
        """Local exponents of both gaits, by walker and gait; `of` names ordinate and
        abscissa.
        """
        return {
            f"{w} {label}": p
            for w in walkers
            for label, p in self.line(w).exponents(slope, *of).items()
        }

    def table(
        self, group: str, walker: str, make: Callable[[], Arrays], **settings: float
    ) -> Arrays:
        """Look up one table of a line.

        Parameters
        ----------
        group, walker : str
            Name of the table, and of the walker in the catalogue.
        make : callable
            Computes tables ("group/column") where the study has not this one.
        **settings : float
            Values of the keys that the line sets.

        Returns
        -------
        dict of ndarray, shape (n,)
            By column.
        """
        key = _key(walker, settings)

        def columns(known: Arrays) -> Arrays:
            return {
                name.removeprefix(f"{group}/"): x
                for name, x in known.items()
                if name.startswith(f"{group}/")
            }

        if given := columns(self.tables.get(key, {})):
            return given

        made = self._made.setdefault(key, {})
        if not columns(made):
            made.update(make())
        return columns(made)


def _key(walker: str, settings: Mapping[str, float]) -> _Key:
    return walker, tuple(sorted(settings.items()))


#: The atlases last used, and what was computed from them.
_last: dict[tuple[Any, ...], Paper] = {}


def paper_of(lines: Sequence[Mapping[str, Any]], inputs: Sequence[Arrays]) -> Paper:
    """What claims about a study's lines are checked with; what was computed from the
    same atlases is there already.

    Parameters
    ----------
    lines : sequence of mapping
        Lines of the study; claims are about walkers of the catalogue, which alone go by
        a name.
    inputs : sequence of dict
        Each line's atlas, and its tables.

    Notes
    -----
    A result must not depend on what its process computed before: atlases of other studies may be coarser.
    """
    known = {
        _key(line["walker"], line["set"]): data
        for line, data in zip(lines, inputs, strict=False)
        if isinstance(line["walker"], str)
    }
    atlases = {
        key: {name: x for name, x in data.items() if _is_of_atlas(name)}
        for key, data in known.items()
    }
    given = tuple(
        (key, name, x.tobytes())
        for key, atlas in atlases.items()
        for name, x in sorted(atlas.items())
    )
    if given not in _last:
        _last.clear()
        _last[given] = Paper({key: atlas for key, atlas in atlases.items() if atlas})

    paper = _last[given]
    paper.tables = {
        key: {name: x for name, x in data.items() if "/" in name}
        for key, data in known.items()
    }
    return paper


def _is_of_atlas(name: str) -> bool:
    return (
        name not in VARIABLES and name not in ("slope", "reasons") and "/" not in name
    )


def coarse_lines(each: Sequence[tuple[str, Mapping[str, float]]]) -> list[Line]:
    """Lines of walkers with some keys set, whose atlases locate folds and ends as fine
    ones do, but are coarse.
    """
    named = [{"walker": walker, "set": settings} for walker, settings in each]
    surveyed = lines({"lines": named, "slope": np.empty(0), "want": ()}, [])
    return [Line(*own, known) for own, (known, _) in zip(each, surveyed, strict=True)]
