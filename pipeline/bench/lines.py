"""Processor time of whole lines: walkers along a key, 20 slopes each, from nothing to their archive."""

from __future__ import annotations

import numpy as np

from pipeline.bench.harness import Case, solve_study

#: Walkers, and the key and its range along which their lines are drawn.
KEYS = {"E": ("foot_mass_ratio", 0.03, 0.4), "A": ("detuning", 0.05, 1.2), "C": ("detuning", 0.05, 0.6)}
#: Slopes of a line.
SLOPES = np.geomspace(1e-3, 0.15, 20)
#: Lines of the larger and of the smaller study of a full and of a quick run, too few for a plane; their difference is
#: measured.
LINES = {False: (60, 16), True: (12, 4)}


def table(quick: bool, peers: list[Case]) -> list[dict[str, float | str]]:
    """Measure the processor time of a line, and list it beside that of a peer.

    Parameters
    ----------
    quick : bool
        Fewer lines.
    peers : list of Case
        Of the problem "grid": a gait of walker D by a peer's Newton method, from its neighbour.

    Returns
    -------
    list of dict
        Rows of the table, times in s.

    Notes
    -----
    Two studies differ only in their number of lines, so loading and compiling cancel. Times are those of all processes:
    search, branches with folds and ends, points with multipliers and error bounds, journal and archive.
    """
    rows: list[dict[str, float | str]] = []
    for name, (key, low, high) in KEYS.items():
        many, few = LINES[quick]
        _solve(name, key, np.linspace(low, high, few))  # compiles
        (seconds, gaits), (first, known) = (_solve(name, key, np.linspace(low, high, n)) for n in (many, few))
        each, found = (seconds - first) / (many - few), (gaits - known) / (many - few)
        rows.append(_row(name, f"gaitsweep, over {key}", each, found))
    for case in peers:
        if case.method != "ours" and case.family == "D":
            rows.append(_row("D", f"{case.method}, long gait only", len(SLOPES) * float(np.median(case.seconds)), 20.0))
    return rows


def _row(walker: str, method: str, seconds: float, gaits: float) -> dict[str, float | str]:
    return {"walker": walker, "method": method, "s a line": seconds, "gaits": gaits, "s a gait": seconds / gaits}


def _solve(walker: str, key: str, values: np.ndarray) -> tuple[float, int]:
    """Processor time of lines [s], and the number of their gaits."""
    axes = {"slope": SLOPES.tolist(), key: values.tolist()}
    return solve_study({"name": "lines", "walker": walker, "axes": axes})
