"""Processor time of gaits against their error: studies of each accuracy, beside the
peers at each tolerance.
"""

import functools
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.harness import Case, what_more_take
from benchmarks.planes import PLANES
from gaitsweep import run

#: Walkers and the slopes of their lines.
LINES = {
    "D": (1e-4, 0.015),
    "E": (1e-3, 0.1),
    "B": (1e-3, 0.1),
    "A": (1e-3, 0.05),
    "C": (1e-3, 0.05),
}
#: Accuracies measured; 0 is as good as doubles give.
ACCURACIES = {
    False: (1e-2, 1e-4, 1e-6, 1e-9, 1e-11, 1e-12, 0.0, 1e-15),
    True: (1e-3, 1e-6, 0.0),
}
_OF_PLANES = (1e-4, 1e-6, 0.0)
#: Wanted variables, besides status, labels and error bounds.
WANTED = {
    "two variables": ["stance_angle", "period"],
    "with multipliers": ["stance_angle", "period", "multipliers"],
}
#: Slopes of a line, and lines along each key of a plane: where polynomials give the
#: gaits, where steps are integrated, and where more digits than those of doubles are.
_SLOPES, _ACROSS = (1_000_000, 30_000, 300), (300, 100, 16)
#: Share of a smaller study, whose time is taken off, and of a quick run.
_FEWER, _QUICK = 0.1, 0.3
#: Slopes of a line, and lines along each key of a plane, at which errors are measured.
_COMPARED = {"line": 600, "plane": 10}


def cases(quick: bool, walkers: tuple[str, ...]) -> list[Case]:
    """Time studies of each accuracy."""
    measured = []
    for name in walkers:
        if name in LINES:
            measured += [
                _case(name, "line", words, a, quick)
                for a in ACCURACIES[quick]
                for words in WANTED
            ]
        if name in PLANES and not quick:
            measured += [
                _case(name, "plane", "two variables", a, quick) for a in _OF_PLANES
            ]
    return measured


def _case(name: str, problem: str, words: str, accuracy: float, quick: bool) -> Case:
    tier = 2 if 0 < accuracy < 1e-12 else 1 if accuracy < 1e-11 else 0
    size = (_SLOPES if problem == "line" else _ACROSS)[tier]
    size = int(size * (_QUICK if quick else 1))

    def study(n: int) -> dict[str, Any]:
        table = _study(name, problem, n, WANTED[words])
        return table | {"accuracy": accuracy} if accuracy else table

    fewer = int(size * (_FEWER if problem == "line" else np.sqrt(_FEWER)))
    further = what_more_take(study, fewer, size)
    case = Case(
        name,
        problem,
        f"gaitsweep, {words}",
        accuracy or float(np.finfo(float).eps),
        lambda: np.zeros(0),
    )
    case.seconds = [further.seconds / further.gaits]
    case.error = _error(name, problem, accuracy)
    case.work = float(further.gaits + further.gaits_of_fewer)
    return case


def _study(name: str, problem: str, n: int, want: list[str]) -> dict[str, Any]:
    """A study of a line of n slopes, or of a plane of n values of each key."""
    if problem == "line":
        low, high = LINES[name]
        axes: dict[str, Any] = {
            "slope": {"from": low, "to": high, "n": n, "spacing": "log"}
        }
    else:
        slope, keys = PLANES[name]
        axes = {
            "slope": [slope],
            **{
                key: {"from": low, "to": high, "n": n}
                for key, (low, high) in keys.items()
            },
        }
    return {
        "name": "accuracy",
        "walker": name,
        "axes": axes,
        "want": {"variables": want},
    }


@functools.cache
def _error(name: str, problem: str, accuracy: float) -> float:
    """Largest relative error of stance angles at some of the points."""
    study = _study(name, problem, _COMPARED[problem], ["stance_angle"])
    with tempfile.TemporaryDirectory() as folder:
        archive = Path(folder, "error.nc")
        best = run(study, jobs=1, archive=archive, quiet=True)
        if not accuracy:
            return float(best.error_bound.max())
        own = run(study, jobs=1, archive=archive, accuracy=accuracy, quiet=True)
    return max(
        float(np.abs(own.stance_angle / best.stance_angle - 1).max()),
        float(np.finfo(float).eps) / 2,
    )


def table(measured: list[Case]) -> list[dict[str, float | str]]:
    """Rows of the page: seconds a gait at each accuracy."""
    return [
        {
            "walker": case.family,
            "study": case.problem,
            "wanted": case.method.removeprefix("gaitsweep, "),
            "accuracy": "best" if case.setting < 1e-15 else f"{case.setting:.0e}",
            "s a gait": float(case.seconds[0]),
            "largest error": case.error,
        }
        for case in measured
    ]
