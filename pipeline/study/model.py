"""A checked study as plain, frozen data."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np


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
class Study:
    """A checked study.

    `walkers` are names or tables and `names` their labels; `axes` keep the order of the file; `walker_axis` is whether
    walkers are a dimension; `checks` holds the properties of each walker that `tasks` reports; `overlay` are the user's
    measurements, columns of shape (n,).
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

    @property
    def slope(self) -> np.ndarray:
        """Values of the slope axis, shape (n,) [rad]."""
        return next(a.values for a in self.axes if a.name == "slope")

    @property
    def steps(self) -> int:
        """Steps after which the gaits of a grid or of branches repeat."""
        return int(self.options.get("steps", 1)) if self.kind in ("grid", "branch") else 1

    @property
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
        values = {}
        for axis in reversed(self.line_axes):
            number, k = divmod(number, len(axis))
            values[axis.name] = float(axis.values[k])
        return {"walker": self.walkers[number], "set": {a.name: values[a.name] for a in self.line_axes}}

    def name_of(self, number: int) -> str:
        """Label of the walker of a line."""
        return self.names[number * len(self.walkers) // self.lines]
