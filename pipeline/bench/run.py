"""One run of the bench: prepare every case, time them in turns, count the work."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from pipeline.bench import FAMILIES, accuracies, bounds, counted, hunt, lines, machine, missed, planes, problems, stress
from pipeline.bench.harness import Case, time_in_turns
from tasks.walkers.resolve import resolve

#: Random lanes, and random slopes per walker, of a full and of a quick run; `make soak` takes a million and more.
RANDOM_LANES, RANDOM_SLOPES = {False: 20_000, True: 200}, {False: 300, True: 20}
#: Random lines searched densely; `make soak` takes a thousand.
RANDOM_LINES = {False: 100, True: 5}


@dataclass
class Measurements:
    """The results of one run of the bench."""

    machine: dict[str, str]
    cases: list[Case] = field(default_factory=list)
    work: dict[str, dict[str, float]] = field(default_factory=dict)
    flows: dict[str, list[dict[str, float | str]]] = field(default_factory=dict)
    less: dict[str, list[dict[str, float | str]]] = field(default_factory=dict)
    outcomes: list[dict[str, float | str]] = field(default_factory=list)
    bounds: list[dict[str, float | str]] = field(default_factory=list)
    lines: list[dict[str, float | str]] = field(default_factory=list)
    planes: list[dict[str, float | str]] = field(default_factory=list)
    missed: list[dict[str, float | str]] = field(default_factory=list)
    deception: list[dict[str, float | str]] = field(default_factory=list)
    hunted: list[dict[str, float | str]] = field(default_factory=list)
    kind: str = ""
    quick: bool = False


def measure(
    quick: bool, families: Sequence[str], grid: int | None, say: Callable[[str], None], hunts: bool = False
) -> Measurements:
    """Run the bench for some walkers.

    Parameters
    ----------
    quick : bool
        Fewer rounds, slopes and random walkers.
    families : sequence of str
        Names of walkers.
    grid : int or None
        Number of slopes of the grids; None: 2000 (500 for kneed walkers), a quarter of it if quick.
    say : callable
        Called with each line of progress.
    hunts : bool
        Also search for the worst inputs.

    Returns
    -------
    Measurements
        Times, errors and counted work.
    """
    peak = machine.peak_flops()
    computer = machine.describe() | {"peak of one core": f"{peak / 1e9:.0f} GFlop/s (matrix product)"}
    measurements = Measurements(computer, quick=quick)
    rounds, least = (3, 0.005) if quick else (9, 0.02)
    for name in families:
        say(f"{name}: gaits, references and peers")
        f = problems.family(name, FAMILIES[name])
        measurements.kind = f.kind
        n = grid or (500 if f.problem.structure.kneed else 2000) // (4 if quick else 1)
        with warnings.catch_warnings():
            # LSODA warns of every failed corrector; its result is judged by its error.
            warnings.simplefilter("ignore", UserWarning)
            with np.errstate(all="ignore"):
                small = problems.strides(f, quick) + problems.jacobians(f, quick) + problems.fixed_points(f, quick)
                large = problems.grid(f, n) + problems.branches(f)
                say(f"{name}: {len(small) + len(large)} cases, {rounds} rounds")
                time_in_turns(small, rounds, least)
                time_in_turns(large, min(rounds, 5), least)
        measurements.cases += small + large
        measurements.work[name] = counted.line(f, n)
        measurements.flows[name] = counted.roofline(f, peak)
        measurements.less[name] = counted.less_and_less(f, n)
    say("lines")
    measurements.lines = lines.table(quick, [case for case in measurements.cases if case.problem == "grid"])
    say("accuracies")
    measurements.cases += accuracies.cases(quick, tuple(families))
    say("planes")
    measurements.planes = planes.table(quick)
    say("random walkers and bounds")
    measurements.outcomes = stress.lanes(RANDOM_LANES[quick]).rows()
    measurements.missed = missed.missed(RANDOM_LINES[quick]).rows()
    each = RANDOM_SLOPES[quick]
    compared = bounds.bounds(each, walkers=[(name, resolve(name, {})) for name in families])
    measurements.bounds, measurements.deception = compared.rows(), compared.histogram()
    if hunts:
        say("hunt for the worst inputs")
        measurements.hunted = hunt.hunt(quick, say=say).rows()
    return measurements
