"""Timing methods in turns, so that a noisy machine is noisy for all of them alike."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from pipeline.bench.extended_reference import converted


@dataclass
class Case:
    """One method on one problem.

    `run` does the work once and returns what it found; `units` is how many answers that is; `error` is the largest
    relative error of what it found, by extended precision; `seconds` holds one time a round, for one answer.
    """

    family: str
    problem: str
    method: str
    setting: float
    run: Callable[[], np.ndarray]
    units: int = 1
    error: float = np.nan
    work: float = np.nan
    seconds: list[float] = field(default_factory=list)


def interleaved(cases: Sequence[Case], rounds: int, least: float) -> None:
    """Time every case once a round, in turns; a round of a case lasts at least `least` seconds.

    Parameters
    ----------
    cases : sequence of Case
        Each has been run before, so that nothing is compiled while the clock runs.
    rounds : int
    least : float [s]
    """
    calls = []
    for case in cases:
        start = time.perf_counter()
        case.run()
        calls.append(max(1, int(least / max(time.perf_counter() - start, 1e-9))))
    for _ in range(rounds):
        for case, count in zip(cases, calls, strict=True):
            start = time.perf_counter()
            for _ in range(count):
                case.run()
            case.seconds.append((time.perf_counter() - start) / (count * case.units))


def largest_error(found: np.ndarray, exact: np.ndarray) -> float:
    """Largest error of an array over its largest entry, taken in long double; NaN where nothing was found."""
    if found.shape != exact.shape:
        return float("nan")
    difference = converted(found.ravel(), np.longdouble) - converted(exact.ravel(), np.longdouble)
    return float(np.abs(difference).max() / np.abs(exact.astype(float)).max())
