"""Processor time of grids of slopes and one key, beyond that of a study of one point."""

from typing import Any

import numpy as np

from benchmarks.harness import solve_study

#: The key of each walker's grid, its range and its spacing; the slopes are spaced logarithmically [rad].
KEYS = {
    "E": ("foot_mass_ratio", 0.001, 0.2, "log"),
    "A": ("detuning", 0.0, 0.5, "linear"),
    "C": ("detuning", 0.0, 0.5, "linear"),
}
SLOPES = (0.001, 0.08)
#: Slopes, and values of the key, of the grids of a full and of a quick run: planes, and lines that are none.
SIZES = {False: ((100, 100), (100, 20)), True: ((100, 20),)}


def table(quick: bool, newton_solve: float) -> list[dict[str, float | str]]:
    """Measure grids, also as multiples of a peer's Newton solve [s]; of walker E alone if quick.

    Times are those of all processes: parent, two workers, archive.
    """
    rows: list[dict[str, float | str]] = []
    for name in list(KEYS)[: 1 if quick else None]:
        solve_study(_study(name, 2, 2), jobs=2)  # compiles
        least, _ = solve_study(_study(name, 1, 1), jobs=2)
        for slopes, values in SIZES[quick]:
            seconds, gaits = solve_study(_study(name, slopes, values), jobs=2)
            further = seconds - least
            rows.append(
                {
                    "walker": name,
                    "grid": f"{slopes} slopes × {values} {KEYS[name][0]}",
                    "gaits": float(gaits),
                    "s of one point": least,
                    "s beyond": further,
                    "in Newton solves": further / newton_solve,
                    "s a gait": further / gaits,
                }
            )
    return rows


def _study(walker: str, slopes: int, values: int) -> dict[str, Any]:
    key, low, high, spacing = KEYS[walker]
    drawn = np.geomspace if spacing == "log" else np.linspace
    axes = {
        # A single value is the one in the middle.
        name: spaced(*ends, n).tolist() if n > 1 else [float(spaced(*ends, 3)[1])]
        for name, spaced, ends, n in (("slope", np.geomspace, SLOPES, slopes), (key, drawn, (low, high), values))
    }
    want = {"variables": ["stance_angle", "period", "multipliers"]}
    return {"name": "grid", "walker": walker, "axes": axes, "want": want}
