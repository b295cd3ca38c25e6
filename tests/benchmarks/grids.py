"""Processor time of grids of slopes and keys, beyond that of a study of one point."""

from typing import Any, NamedTuple

import numpy as np

from benchmarks import planes
from benchmarks.harness import solve_study
from gaitsweep.tasks.walkers.resolve import label


class Grid(NamedTuple):
    """A walker, a number of slopes, the keys with range, number of values and spacing,
    and where detuning leads.
    """

    walker: str
    slopes: int
    keys: dict[str, tuple[float, float, int, str]]
    toward: dict[str, Any] | None = None


#: The slopes of all grids, spaced logarithmically [rad].
SLOPES = (0.001, 0.08)
_LIGHTER, _HALF = (0.001, 0.2), (0.0, 0.5)
#: The grids of a full run, the last three of few lines, and that of a quick run.
GRIDS = (
    Grid("E", 100, {"foot_mass_ratio": (*_LIGHTER, 100, "log")}),
    Grid("A", 100, {"detuning": (*_HALF, 100, "linear")}),
    Grid("C", 100, {"detuning": (*_HALF, 100, "linear")}),
    Grid(
        "C", 200, {"detuning": (0.0, 1.0, 7, "linear"), "m_h": (0.0, 6.0, 60, "linear")}
    ),
    Grid(
        *(
            "E",
            100,
            {
                "foot_mass_ratio": (*_LIGHTER, 20, "log"),
                "detuning": (0.0, 1.0, 10, "linear"),
            },
        ),
        toward={"base": "E", "R": 0.3},
    ),
    Grid("E", 100, {"foot_mass_ratio": (*_LIGHTER, 20, "log")}),
    Grid("A", 100, {"detuning": (*_HALF, 20, "linear")}),
    Grid("C", 100, {"detuning": (*_HALF, 20, "linear")}),
)
QUICK = (Grid("E", 50, {"foot_mass_ratio": (*_LIGHTER, 12, "log")}),)


def table(quick: bool, newton_solve: float) -> list[dict[str, float | str]]:
    """Measure grids, also as multiples of a peer's Newton solve [s].

    Times are those of all processes: parent, two workers, archive.
    """
    rows: list[dict[str, float | str]] = []
    for grid in QUICK if quick else GRIDS:
        solve_study(_study(grid, 2), jobs=2)  # compiles
        least, _ = solve_study(_study(grid, 1), jobs=2)
        study = _study(grid)
        seconds, gaits = solve_study(study, jobs=2)
        further = seconds - least
        plane = planes.made(study)
        rows.append(
            {
                "walker": grid.walker
                + (f" toward {label(grid.toward)}" if grid.toward else ""),
                "grid": " × ".join(
                    [
                        f"{grid.slopes} slopes",
                        *(f"{n} {key}" for key, (_, _, n, _) in grid.keys.items()),
                    ]
                ),
                "boxes of a plane": float(plane.boxes),
                "charts of a plane": float(plane.charts),
                "lines surveyed for it": float(plane.surveyed),
                "of its points left to lines": float(plane.fell_back),
                "gaits": float(gaits),
                "s of one point": least,
                "s beyond": further,
                "in Newton solves": further / newton_solve,
                "s a gait": further / gaits,
            }
        )
    return rows


def _study(grid: Grid, most: int | None = None) -> dict[str, Any]:
    """The study of a grid, or of at most so many values of the slope and of each key."""
    axes = {}
    for name, (low, high, n, spacing) in {
        "slope": (*SLOPES, grid.slopes, "log"),
        **grid.keys,
    }.items():
        spaced, n = np.geomspace if spacing == "log" else np.linspace, min(n, most or n)
        # A single value is the one in the middle.
        axes[name] = (
            spaced(low, high, n).tolist() if n > 1 else [float(spaced(low, high, 3)[1])]
        )
    walker = (
        {"base": grid.walker, "toward": grid.toward} if grid.toward else grid.walker
    )
    want = {"variables": ["stance_angle", "period", "multipliers"]}
    return {"name": "grid", "walker": walker, "axes": axes, "want": want}
