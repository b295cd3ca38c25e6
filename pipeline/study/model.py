"""A checked study as plain, frozen data."""

import functools
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

#: Fewest lines over one or two keys that are divided into cells, whose gaits polynomials predict; fewest designs in a
#: cell.
_MIN_LINES, _MIN_DESIGNS = 64, 400
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


@dataclass(frozen=True)
class Plane:
    """One or two axes of keys and into how many equal parts each is divided: a cell is one part of each."""

    axes: tuple[Axis, ...]
    parts: tuple[int, ...]

    def sides(self, axis: Axis, values: np.ndarray) -> tuple[np.ndarray, ...]:
        """Bounds of the cells in which values of an axis lie; none if it is not an axis of the plane.

        Parameters
        ----------
        axis : Axis
        values : ndarray, shape (n,)

        Returns
        -------
        tuple of ndarray, shape (n,)
        """
        for own, parts in zip(self.axes, self.parts, strict=True):
            if own.name == axis.name:
                edges = np.linspace(own.values.min(), own.values.max(), parts + 1)
                part = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, parts - 1)
                return edges[part], edges[part + 1]
        return ()

    def cell(self, values: Mapping[str, float]) -> dict[str, Any]:
        """Return the keys of the cell that holds some values of them, its bounds `low` and `high`, and its `values`."""
        sides = [self.sides(axis, np.array([values[axis.name]])) for axis in self.axes]
        low, high = ([float(side[i][0]) for side in sides] for i in (0, 1))
        inside = [
            axis.values[(axis.values >= a) & (axis.values <= b)]
            for axis, a, b in zip(self.axes, low, high, strict=True)
        ]
        return {"keys": [axis.name for axis in self.axes], "low": low, "high": high, "values": inside}


@dataclass(frozen=True)
class Study:
    """A checked study.

    `walkers` are names or tables and `names` their labels; `axes` keep the order of the file; `walker_axis` is whether
    walkers are a dimension; `checks` holds the properties of each walker that `tasks` reports; `overlay` are the user's
    measurements, columns of shape (n,); `accuracy` is the largest error bound wanted, 0 for as good as doubles give.
    """

    name: str
    text: str
    kind: str
    walkers: tuple[str | dict[str, Any], ...]
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
    accuracy: float = 0.0

    @property
    def slope(self) -> np.ndarray:
        """Values of the slope axis, shape (n,) [rad]."""
        return next(a.values for a in self.axes if a.name == "slope")

    @property
    def steps(self) -> int:
        """Steps after which the gaits of a grid or of branches repeat."""
        return int(self.options.get("steps", 1)) if self.kind in ("grid", "branch") else 1

    @functools.cached_property
    def line_axes(self) -> tuple[Axis, ...]:
        """Every axis but the slope."""
        return tuple(a for a in self.axes if a.name != "slope")

    @property
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
        return self.lines * len(self.slope)

    def line(self, number: int) -> dict[str, Any]:
        """Walker and parameters of a line, numbered in C order of `line_shape`."""
        values: dict[str, float] = {}
        for axis in reversed(self.line_axes):
            number, k = divmod(number, len(axis.values))
            values[axis.name] = axis.values[k].item()  # of `knees` true or false
        return {"walker": self.walkers[number], "set": dict(reversed(values.items()))}

    @functools.cached_property
    def plane(self) -> Plane | None:
        """The longest one or two axes of keys, if they hold enough lines for gaits to be interpolated over them."""
        axes = [
            a for a in self.line_axes if len(a) > 1 and all(a.name in check.get("widths", ()) for check in self.checks)
        ]
        axes = sorted(sorted(axes, key=len)[-2:], key=lambda axis: axis.name)
        of_designs = self.kind == "design"
        if not axes or math.prod(map(len, axes)) < (_MIN_DESIGNS if of_designs else _MIN_LINES):
            return None
        if of_designs:
            return Plane(tuple(axes), (1,) * len(axes))
        widths = [min(check["widths"][axis.name] for check in self.checks) for axis in axes]
        spans = [float(np.ptp(axis.values)) for axis in axes]
        return Plane(tuple(axes), tuple(max(1, math.ceil(s / w)) for s, w in zip(spans, widths, strict=True)))

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
        most = _MAX_CELL_DESIGNS if self.plane else _MAX_SURVEYED_DESIGNS
        places = np.arange(part * most, min((part + 1) * most, self._designs))
        if not self.plane:
            return cell * self._designs + places
        names = [axis.name for axis in self.plane.axes]
        inner = [axis for axis in self.line_axes if axis.name in names]
        outer = [len(self.walkers), *(len(axis) for axis in self.line_axes if axis.name not in names)]
        at = iter(np.unravel_index(cell, outer))
        own = dict(zip((a.name for a in inner), np.unravel_index(places, [len(a) for a in inner]), strict=True))
        indices = [next(at), *(own[axis.name] if axis.name in own else next(at) for axis in self.line_axes)]
        return np.ravel_multi_index(np.broadcast_arrays(*indices), self.line_shape)

    def batch_line(self, number: int) -> dict[str, Any]:
        """Walker and parameters of a job over lines: those of a line, or of designs an array for each."""
        if self.kind != "design":
            return self.line(number)
        walkers, *indices = np.unravel_index(self.batch(number), self.line_shape)
        sets = {axis.name: axis.values[k].astype(float) for axis, k in zip(self.line_axes, indices, strict=True)}
        return {"walker": self.walkers[int(walkers[0])], "set": sets}

    @property
    def _designs(self) -> int:
        """Designs of a cell, or of a walker where there are no cells."""
        if self.plane:
            return math.prod(map(len, self.plane.axes))
        return self.lines // len(self.walkers)

    @property
    def _batches_each(self) -> int:
        return -(-self._designs // (_MAX_CELL_DESIGNS if self.plane else _MAX_SURVEYED_DESIGNS))

    def name_of(self, number: int) -> str:
        """Label of the walker of a line."""
        return self.names[number * len(self.walkers) // self.lines]
