"""How far the rounding of a walker's printed parameters can move a landmark: its
interval (sections 4 and 5).

A landmark solves the equations of a gait and one condition
(`tasks.branches.equations`), G(Z, p) = 0, with Z the gait and ln slope and p the
printed parameters, which the implicit function theorem differentiates. The interval is
the printed walker's value plus or minus the sum of |sensitivity| x half unit.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gaitsweep.tasks.branches.conditions import CONDITIONS
from gaitsweep.tasks.branches.equations import Equations, Keys, sensitivity
from gaitsweep.tasks.branches.special_points import passings
from gaitsweep.tasks.ledger.claim import NOT_PRINTED, PRINTED, Printed
from gaitsweep.tasks.ledger.lines import Line, Paper, memoize
from gaitsweep.tasks.walkers.catalogue import tune_exactly
from gaitsweep.tasks.walkers.walker import KEYS, Walker

#: Step of the central differences by parameters, relative to their size and the gait's
#: angle: what counts is an offset of a mass relative to the angle.
STEP = 1e-5


@dataclass(frozen=True)
class Landmark:
    """A special point of a walker: its kind, as `CONDITIONS` has it, the gait's
    label, and which of several.

    `printed` is the slope as the paper prints it [rad]; `point` is its number in the
    paper's figure 6.
    """

    name: str
    walker: str
    kind: str
    label: str = ""
    which: int = 0
    printed: Printed = NOT_PRINTED
    point: str = ""


#: What the paper prints in figures.
PUBLISHED = tomllib.loads(
    Path(__file__).with_name("published.toml").read_text(encoding="utf-8")
)
#: Half a unit of every rounded key, in the key's unit, by walker.
HALF_UNITS: dict[str, dict[str, float]] = {
    walker: rounded["half_units"]
    for rounded in PUBLISHED["rounded"]
    for walker in rounded["walkers"]
}
#: Landmarks compared with numbers of the paper, and those of figure 6.
LANDMARKS = {
    name: Landmark(
        name,
        **{
            **mark,
            "printed": PRINTED[mark["printed"]] if "printed" in mark else NOT_PRINTED,
        },
    )
    for name, mark in PUBLISHED["landmarks"].items()
}


@dataclass(frozen=True)
class Interval:
    """A landmark's slope and stance angle [rad], its interval of slopes, and its
    sensitivity to each parameter.
    """

    value: float
    angle: float
    low: float
    high: float
    sensitivity: dict[str, float]
    angle_sensitivity: dict[str, float]
    half_unit: dict[str, float]

    def __str__(self) -> str:
        return f"{self.value:.7g} rad (rounding allows {self.low:.4g}-{self.high:.4g}, dominated by {self.most})"

    @property
    def bounds(self) -> tuple[float, float, float]:
        """The slope, and the ends of its interval."""
        return self.value, self.low, self.high

    @property
    def contribution(self) -> dict[str, float]:
        """Contribution of each parameter's rounding to the interval's half width [rad]."""
        return {k: abs(s) * self.half_unit[k] for k, s in self.sensitivity.items()}

    @property
    def most(self) -> str:
        """The parameter that contributes most."""
        return max(self.contribution, key=lambda k: self.contribution[k])


def changed(walker: str, base: Walker, changes: Mapping[str, float]) -> Walker:
    """Change keys of a walker; exact A and C stay on the tuned manifold."""
    values = {key: getattr(base, key) + change for key, change in changes.items()}
    moved = replace(base, **values)
    return tune_exactly(moved) if walker in ("A", "C") else moved


def place(gaits: Line, mark: Landmark) -> np.ndarray:
    """Locate a landmark on the branches of its walker.

    Returns
    -------
    ndarray, shape (c,)
        The gait's similarity coordinates, event times and ln slope.

    Raises
    ------
    ValueError
        If the walker has no such point.
    """
    rows = [np.array(point["Z"]) for point in gaits.special_of(mark.kind)]
    if mark.kind == "exponent_two_thirds":
        for branch in gaits.branches:
            passed = passings(gaits.problem, branch, CONDITIONS[mark.kind])
            rows += [point.Z[:, 0] for _, point in passed]

    if mark.label:
        rows = [
            Z for Z in rows if mark.label == ("short" if gaits.is_short(Z) else "long")
        ]

    rows.sort(key=lambda Z: float(Z[-1]))
    if len(rows) <= mark.which:
        raise ValueError(f"{mark.walker} has no {mark.name}")

    return rows[mark.which]


def sensitivities(
    mark: Landmark, Z: np.ndarray, base: Walker, keys: list[str], step: float = STEP
) -> np.ndarray:
    """Compute the sensitivities dZ/dp of a landmark.

    Parameters
    ----------
    mark : Landmark
    Z : ndarray, shape (c,)
        The landmark, as from `place`.
    base : Walker
    keys : list of str
        Parameters p.
    step : float
        Step of the central differences by parameters.

    Returns
    -------
    ndarray, shape (c, keys)
        Per unit of each key.
    """
    sizes = np.array([_size(base, key) for key in keys])

    def walker_at(*changes: float) -> Walker:
        return changed(mark.walker, base, dict(zip(keys, changes, strict=True)))

    around = Keys(
        names=tuple(keys),
        walker_at=walker_at,
        low=tuple(-0.5 * sizes),
        high=tuple(0.5 * sizes),
        ordinary=(0.0,) * len(keys),
        difference=float(step * np.exp(Z[0])),
    )
    unchanged = np.append(Z, np.zeros(len(keys)))
    return sensitivity(Equations(around, [CONDITIONS[mark.kind]]), unchanged)


def _size(walker: Walker, key: str) -> float:
    """Scale of a key's steps."""
    sizes = {
        "mass": walker.total_mass,
        "length": walker.leg,
        "acceleration": walker.g,
        "angle": 1.0,
    }
    return sizes[KEYS[key]]


@memoize
def interval(paper: Paper, name: str) -> Interval:
    """Compute the interval of a landmark, by its name."""
    mark = LANDMARKS[name]
    gaits = paper.line(mark.walker)
    Z, half = place(gaits, mark), dict(HALF_UNITS[mark.walker])
    keys, slope, angle = list(half), float(np.exp(Z[-1])), float(np.exp(Z[0]))
    by_key = sensitivities(mark, Z, gaits.walker, keys)
    slope_by_key = dict(zip(keys, (slope * by_key[-1]).tolist(), strict=True))
    angle_by_key = dict(zip(keys, (angle * by_key[0]).tolist(), strict=True))
    moved = sum(abs(slope_by_key[key]) * half[key] for key in keys)
    low, high = slope - moved, slope + moved
    return Interval(slope, angle, low, high, slope_by_key, angle_by_key, half)
