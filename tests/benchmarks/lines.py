"""Processor time of whole lines: walkers along a key, 20 slopes each, from nothing to
their archive.
"""

import functools
from typing import Any

import numpy as np

from benchmarks.harness import Case, solve_study, what_more_take

#: Walkers, and the key and its range along which their lines are drawn.
KEYS = {
    "E": ("foot_mass_ratio", 0.03, 0.4),
    "A": ("detuning", 0.05, 1.2),
    "C": ("detuning", 0.05, 0.6),
}
#: Slopes of a line.
SLOPES = np.geomspace(1e-3, 0.15, 20)
#: Lines of the smaller and of the larger study of a full and of a quick run, too few
#: for a plane; their difference is measured.
LINES = {False: (16, 60), True: (4, 12)}
#: Lines that are a plane, whose gaits polynomials over slope and key predict.
MANY = 1200


def table(quick: bool, peers: list[Case]) -> list[dict[str, float | str]]:
    """Measure the processor time of a line, and list it beside the peers' that solve
    gaits of D from their neighbours.

    Two studies differ only in their number of lines, so loading and compiling cancel.
    Times are those of all processes: search, branches with folds and ends, points with
    multipliers and error bounds, journal and archive. Of the many lines of a plane the
    whole study is measured, its cells included.
    """
    rows: list[dict[str, float | str]] = []
    for name, (key, low, high) in KEYS.items():
        few, many = LINES[quick]
        study = functools.partial(_study, name, key, low, high)
        solve_study(study(few))  # compiles
        further = what_more_take(study, few, many)
        each, gaits = further.seconds / (many - few), further.gaits / (many - few)
        rows.append(_row(name, f"gaitsweep, over {key}", each, gaits))
        if not quick:
            seconds, total = solve_study(study(MANY))
            rows.append(
                _row(
                    name,
                    f"gaitsweep, {MANY} lines over {key}",
                    seconds / MANY,
                    total / MANY,
                )
            )
    for case in peers:
        seconds = len(SLOPES) * float(np.median(case.seconds))
        rows.append(
            _row("D", f"{case.method}, long gait only", seconds, float(len(SLOPES)))
        )
    return rows


def _row(
    walker: str, method: str, seconds: float, gaits: float
) -> dict[str, float | str]:
    return {
        "walker": walker,
        "method": method,
        "s a line": seconds,
        "gaits": gaits,
        "s a gait": seconds / gaits,
    }


def _study(walker: str, key: str, low: float, high: float, n: int) -> dict[str, Any]:
    axes = {"slope": SLOPES.tolist(), key: np.linspace(low, high, n).tolist()}
    return {"name": "lines", "walker": walker, "axes": axes}
