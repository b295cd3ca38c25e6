"""What is measured, and timing of methods in turns, so that noise affects all of them
alike.
"""

import json
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from gaitsweep import run
from gaitsweep.pipeline.companions import Companions
from soak.extended_reference import convert

#: Longest tick of a clock of processor time [s].
TICK = 0.01


@dataclass
class Case:
    """One method on one problem.

    `run` does the work once and returns its result; `units` is the number of answers in
    it; `error` is the largest relative error of the result, by extended precision;
    `seconds` holds the processor time of one answer in each round.
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


@dataclass
class Measurements:
    """The results of one run of the bench: cases, tables by name, and the
    floating-point type of the references.
    """

    machine: dict[str, str]
    quick: bool
    kind: str = ""
    cases: list[Case] = field(default_factory=list)
    tables: dict[str, list[dict[str, float | str]]] = field(
        default_factory=lambda: defaultdict(list)
    )


class Difference(NamedTuple):
    """Processor time [s] and gaits by which a larger study exceeds a smaller one, and
    those of the smaller one.
    """

    seconds: float
    gaits: int
    seconds_of_fewer: float
    gaits_of_fewer: int


def time_in_turns(cases: Sequence[Case], rounds: int, least: float) -> None:
    """Take every case's processor time once per round, in turns; a round of a case
    lasts at least `least` seconds.
    """
    calls = []
    for case in cases:
        start, count = time.process_time(), 0
        # Some clocks of processor time tick a hundred times a second only.
        while (seconds := time.process_time() - start) < min(least, TICK):
            case.run()
            count += 1
        calls.append(max(1, int(least * count / seconds)))
    for _ in range(rounds):
        for case, count in zip(cases, calls, strict=True):
            start = time.process_time()
            for _ in range(count):
                case.run()
            case.seconds.append((time.process_time() - start) / (count * case.units))


def solve_study(study: dict[str, Any], jobs: int = 1) -> tuple[float, int]:
    """Processor time of a study by its workers and of writing its archive [s], and the
    number of its gaits.
    """
    with tempfile.TemporaryDirectory() as folder:
        begin = time.process_time()
        path = Path(folder, "study.nc")
        archive = run(study, jobs=jobs, archive=path, quiet=True)
        # From the run's record, as `run` also reads the archive.
        account = json.loads(Companions(path).record.read_text())["account"]
    seconds = account["workers_cpu"] + account["parent_cpu"] - begin
    return seconds, int((archive.status == "converged").sum())


def what_more_take(
    study: Callable[[int], dict[str, Any]], fewer: int, more: int
) -> Difference:
    """Solve two sizes of a study; loading, compiling and whatever else they share
    cancel in the difference.
    """
    (seconds, gaits), (first, known) = (
        solve_study(study(more)),
        solve_study(study(fewer)),
    )
    return Difference(max(seconds - first, 0.0), gaits - known, first, known)


def largest_error(result: np.ndarray, exact: np.ndarray) -> float:
    """Largest error of an array over its largest entry, computed in long double."""
    if result.shape != exact.shape:
        return float("nan")
    difference = convert(result.ravel(), np.longdouble) - convert(
        exact.ravel(), np.longdouble
    )
    return float(np.abs(difference).max() / np.abs(exact.astype(float)).max())
