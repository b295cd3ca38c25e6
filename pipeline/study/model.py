"""A checked study as plain, frozen data."""

import functools
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from gaitsweep.tasks.contract.accuracy import is_converted
from gaitsweep.tasks.contract.registry import (
    DRIVES,
    OVER_DRIVE,
    READS,
    TASKS,
    VARIED,
    WINDOWED,
)

#: A walker as studies define it: its name, or the table of its keys.
Definition: TypeAlias = str | dict[str, Any]
#: Fewest lines over one or two keys whose gaits charts predict, fewest values of the
#: second of these, about as many as charts have nodes along it, and fewest designs.
_MIN_LINES, _MIN_ACROSS, _MIN_DESIGNS = 12, 10, 400
#: Most designs that one job computes: of a cell, and of lines surveyed one by one.
_MAX_CELL_DESIGNS, _MAX_SURVEYED_DESIGNS = 1 << 16, 32


@dataclass(frozen=True)
class Limits:
    """Limits of time [s] and memory [byte] for one point."""

    seconds: float = 60.0
    memory: int = 2 << 30


@dataclass(frozen=True)
class Axis:
    """One dimension of the grid: its name and values, shape (n,)."""

    name: str
    values: np.ndarray = field(repr=False)

    def __len__(self) -> int:
        return len(self.values)

    @property
    def is_log(self) -> bool:
        """Whether the middle one of its values is nearer to the geometric than to the
        arithmetic mean of the ends.
        """
        low, high = float(self.values.min()), float(self.values.max())
        return low > 0 and 2 * float(np.median(self.values)) < math.sqrt(
            low * high
        ) + 0.5 * (low + high)


def line_of(walker: Definition, values: Mapping[str, Any]) -> dict[str, Any]:
    """A line of a walker at values of keys, perhaps at a `slope`."""
    keys = {name: value for name, value in values.items() if name != "slope"}
    slope = {"slope": values["slope"]} if "slope" in values else {}
    return {"walker": walker, "set": keys, **slope}


@dataclass(frozen=True)
class Lines:
    """Walkers and parameters of some lines, each put together when it is asked for: a
    request holds them as arrays.

    Attributes
    ----------
    walkers : list
    values : dict of ndarray, shape (n,)
        Of the axes of lines: keys, and the slope of lines along a measure.
    """

    walkers: list[Any]
    values: dict[str, np.ndarray]

    def __len__(self) -> int:
        return len(self.walkers)

    def __getitem__(self, place: int) -> dict[str, Any]:
        values = {name: own.item(place) for name, own in self.values.items()}
        return line_of(self.walkers[place], values)

    def __iter__(self) -> Iterator[dict[str, Any]]:
        return map(self.__getitem__, range(len(self)))


@dataclass(frozen=True)
class Plane:
    """One or two axes of keys, over which charts predict gaits."""

    axes: tuple[Axis, ...]

    @property
    def lines(self) -> int:
        """Number of its lines."""
        return math.prod(map(len, self.axes))

    @functools.cached_property
    def region(self) -> dict[str, Any]:
        """Its keys, their least and largest values `low` and `high`, and about how many
        `lines`.

        `log` is whether the values of a key are spread by their logarithms.
        """
        return {
            "keys": [axis.name for axis in self.axes],
            "low": [float(axis.values.min()) for axis in self.axes],
            "high": [float(axis.values.max()) for axis in self.axes],
            "log": [axis.is_log for axis in self.axes],
            "lines": about(self.lines),
        }

    def lines_in(
        self, box: Mapping[str, Any], spans: Mapping[str, slice] | None = None
    ) -> int:
        """Number of its lines, or of those of a chunk, in a box; those that two boxes
        share belong to the upper one.
        """
        count = 1
        for axis, low, high in zip(self.axes, box["low"], box["high"], strict=True):
            values = axis.values[spans[axis.name]] if spans else axis.values
            is_last = high >= axis.values.max()
            count *= int(
                np.count_nonzero((values >= low) & (is_last | (values < high)))
            )

        return count


def about(n: int) -> int:
    """The power of two nearest to a number, by its logarithm: grids that are refined a
    little share their charts.
    """
    return 1 << round(math.log2(n))


@dataclass(frozen=True)
class Study:
    """A checked study.

    `walkers` are names or tables and `names` their labels; `axes` keep the order of the
    file; `walker_axis` is whether walkers are a dimension; `checks` holds the
    properties of each walker that `tasks` reports; `overlay` are the user's
    measurements, columns of shape (n,); `tolerances` of keys are numbers, or percentages
    as they are written; `accuracy` is the largest error bound wanted, 0 for as good as
    doubles give.
    """

    name: str
    text: str
    kind: str
    walkers: tuple[Definition, ...]
    gaits: tuple[str, ...]
    axes: tuple[Axis, ...]
    variables: tuple[str, ...]
    fits: tuple[str, ...] = ()
    figures: tuple[str, ...] = ()
    claims: tuple[str, ...] = ()
    limits: Limits = Limits()
    options: Mapping[str, Any] = field(default_factory=dict)
    path: Path = Path()
    walker_axis: bool = False
    names: tuple[str, ...] = ("walker",)
    checks: tuple[dict[str, Any], ...] = ()
    overlay: Mapping[str, np.ndarray] = field(default_factory=dict)
    tolerances: Mapping[str, float | str] = field(default_factory=dict)
    accuracy: float = 0.0

    @property
    def at(self) -> Mapping[str, Any]:
        """What gaits are sought at: `measure`, whose axis takes the place of the slope
        along lines, `vary`, and perhaps `between`; empty if they are at slopes.
        """
        at: Mapping[str, Any] = self.options.get("at", {})
        return at

    @property
    def along(self) -> str:
        """Name of the axis along which the points of a line lie: the slope, what else
        drives, or the measure at whose values gaits are sought.
        """
        return str(self.at.get("measure", self.drive or "slope"))

    @functools.cached_property
    def drive(self) -> str:
        """Name of the axis of what drives at each slope, over which gaits are followed
        on level ground and uphill, or where a window of slopes would be one slope;
        empty where the slope drives.
        """
        axes = {axis.name: axis.values for axis in self.axes}
        found = [name for name in DRIVES if name in axes]
        if self.kind == "grid":
            found = [name for name in found if self._is_solved_along(name, axes[name])]
        elif self.kind not in OVER_DRIVE:
            return ""

        if not found or "slope" not in axes:
            return ""

        is_window = self.kind in WINDOWED
        is_fixed = (axes["slope"] <= 0).all() or (is_window and len(axes["slope"]) == 1)
        # Of two the first that has a range.
        found.sort(key=lambda name: len(np.unique(axes[name])) == 1)
        return found[0] if is_fixed else ""

    def _is_solved_along(self, key: str, values: np.ndarray) -> bool:
        """Whether the points of a grid are solved along values of a key that drives, as
        some do: not where anything reads its lines along slopes.
        """
        if not self.may_be_along(key, self.checks):
            return False
        reads = [read for name in self.figures for read in READS.get(name, ())]
        is_read = self.fits or self.claims or not TASKS.keys().isdisjoint(reads)
        return not (self.at or is_read) and len(np.unique(values[values > 0])) > 1

    @staticmethod
    def may_be_along(key: str, checks: Iterable[Mapping[str, Any]]) -> bool:
        """Whether gaits of walkers may be followed over a key that drives: no torque
        moves legs without mass.
        """
        return key != "hip_torque" or not any(check["massless_leg"] for check in checks)

    @property
    def is_driven(self) -> bool:
        """Whether more than gravity drives any of its walkers."""
        return any(check["driven"] for check in self.checks)

    @property
    def values_along(self) -> np.ndarray:
        """Values of the axis along which the points of a line lie, shape (n,): slopes
        [rad], or values of what else drives or of a measure.
        """
        return next(a.values for a in self.axes if a.name == self.along)

    @functools.cached_property
    def is_level(self) -> bool:
        """Whether none of the slopes leads down."""
        return bool((self.values_along <= 0).all())

    def archived(self, variable: str) -> str:
        """Name of a variable in archives: what is varied has its own."""
        return str(self.at["vary"]) if variable == VARIED else variable

    @property
    def steps(self) -> int:
        """Steps after which the gaits of a grid or of branches repeat."""
        return (
            int(self.options.get("steps", 1)) if self.kind in ("grid", "branch") else 1
        )

    @functools.cached_property
    def line_axes(self) -> tuple[Axis, ...]:
        """Every axis but that along which the points of a line lie."""
        return tuple(a for a in self.axes if a.name != self.along)

    @functools.cached_property
    def line_shape(self) -> tuple[int, ...]:
        """Shape of the grid of lines: walkers first, then `line_axes`."""
        return (len(self.walkers), *map(len, self.line_axes))

    @property
    def lines(self) -> int:
        """Number of lines."""
        return math.prod(self.line_shape)

    @property
    def points(self) -> int:
        """Number of grid points."""
        return self.lines * len(self.values_along)

    def line(self, number: int) -> dict[str, Any]:
        """Walker and parameters of a line, numbered in C order of `line_shape`."""
        return self.lines_at(np.array([number]))[0]

    def lines_at(self, numbers: np.ndarray) -> Lines:
        """Walker and parameters of each of some lines."""
        walkers, *indices = np.unravel_index(numbers, self.line_shape)
        axes = zip(self.line_axes, indices, strict=True)
        return Lines(
            [self.walkers[k] for k in walkers.tolist()],
            {axis.name: axis.values[at] for axis, at in axes},
        )

    @functools.cached_property
    def features(self) -> frozenset[str]:
        """What any of its walkers has that some variables are of."""
        return frozenset(name for check in self.checks for name in check["features"])

    @functools.cached_property
    def scaling(self) -> tuple[Axis, ...]:
        """The axes that change nothing but the units of its walkers, if gaits of walkers
        that differ in units are one to the solver.
        """
        if self.at or not is_converted(self.variables, self.accuracy):
            return ()

        keys = [check.get("scaling", ()) for check in self.checks]
        return tuple(
            axis
            for axis in self.line_axes
            if keys and all(axis.name in each for each in keys)
        )

    @property
    def alike(self) -> int:
        """Number of its lines that differ from one only in their units, itself too."""
        return math.prod(map(len, self.scaling))

    @functools.cached_property
    def plane(self) -> Plane | None:
        """The longest one or two axes of keys, if they hold enough lines for gaits to
        be interpolated over them.
        """
        names = [check.get("smooth", ()) for check in self.checks]
        scaling = [axis.name for axis in self.scaling]
        axes = [
            a
            for a in self.line_axes
            if len(a) > 1
            and a.name not in scaling
            and all(a.name in each for each in names)
        ]
        axes = sorted(axes, key=len)[-2:]
        of_designs = self.kind == "design"
        if not of_designs and len(axes) == 2 and len(axes[0]) < _MIN_ACROSS:
            del axes[0]
        plane = Plane(tuple(sorted(axes, key=lambda axis: axis.name)))
        least = _MIN_DESIGNS if of_designs else _MIN_LINES
        return plane if axes and plane.lines >= least else None

    @property
    def batches(self) -> int:
        """Number of jobs of a task over lines: one per line, or one for many designs."""
        if self.kind != "design":
            return self.lines
        return self.lines // self._designs * self._batches_each

    def batch(self, number: int) -> np.ndarray:
        """Numbers of the lines of a job.

        Returns
        -------
        ndarray of int, shape (n,)
        """
        if self.kind != "design":
            return np.array([number])

        cell, part = divmod(number, self._batches_each)
        most = self._most_designs
        numbers = cell * self._designs + np.arange(
            part * most, min((part + 1) * most, self._designs)
        )
        # With the keys of the plane last, the designs of a cell follow each other, and
        # with those that change only units after these, those that are solved once.
        plane = [axis.name for axis in self.plane.axes] if self.plane else []
        depth = dict.fromkeys(plane, 1) | {axis.name: 2 for axis in self.scaling}
        axes = range(1, len(self.line_shape))
        names = [axis.name for axis in self.line_axes]
        order = [0, *sorted(axes, key=lambda k: depth.get(names[k - 1], 0))]
        at = np.unravel_index(numbers, [self.line_shape[k] for k in order])
        return np.ravel_multi_index([at[k] for k in np.argsort(order)], self.line_shape)

    def batch_line(self, number: int) -> dict[str, Any]:
        """Walker and parameters of a job over lines: those of a line, or of designs an
        array for each.
        """
        if self.kind != "design":
            return self.line(number)

        walkers, *indices = np.unravel_index(self.batch(number), self.line_shape)
        sets = {
            axis.name: axis.values[k].astype(float)
            for axis, k in zip(self.line_axes, indices, strict=True)
        }
        return {"walker": self.walkers[int(walkers[0])], "set": sets}

    @property
    def _designs(self) -> int:
        """Designs of a cell, or of a walker where there are no cells."""
        if self.plane:
            return self.plane.lines * self.alike
        return self.lines // len(self.walkers)

    @property
    def _most_designs(self) -> int:
        """Most designs of a job."""
        if self.plane:
            return _MAX_CELL_DESIGNS
        return min(_MAX_SURVEYED_DESIGNS * self.alike, _MAX_CELL_DESIGNS)

    @property
    def _batches_each(self) -> int:
        return -(-self._designs // self._most_designs)

    def name_of(self, number: int) -> str:
        """Label of the walker of a line."""
        return self.names[number * len(self.walkers) // self.lines]
