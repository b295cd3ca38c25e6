"""One run of the bench: build every case, time them in turns, count the work."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from pipeline.bench import FAMILIES, bounds, counted, machine, problems, stress
from pipeline.bench.harness import Case, interleaved
from tasks.walkers.resolve import resolve

#: Random lanes, and random slopes a walker, of a full and of a quick run; `make soak` takes a million and more.
RANDOM_LANES, RANDOM_SLOPES = {False: 20_000, True: 200}, {False: 300, True: 20}


@dataclass
class Found:
    """All a run of the bench has found."""

    machine: dict[str, str]
    cases: list[Case] = field(default_factory=list)
    work: dict[str, dict[str, float]] = field(default_factory=dict)
    flows: dict[str, list[dict[str, float | str]]] = field(default_factory=dict)
    less: dict[str, list[dict[str, float | str]]] = field(default_factory=dict)
    outcomes: list[dict[str, float | str]] = field(default_factory=list)
    bounds: list[dict[str, float | str]] = field(default_factory=list)
    kind: str = ""
    quick: bool = False


def measured(quick: bool, families: Sequence[str], grid: int | None, say: Callable[[str], None]) -> Found:
    """Run the bench for some walkers.

    Parameters
    ----------
    quick : bool
    families : sequence of str
    grid : int or None
        Slopes of the grids; None: 2000 (500 for kneed walkers), a tenth of it if quick.
    say : callable
        Told of progress.
    """
    peak = machine.peak_flops()
    found = Found(machine.described() | {"peak of one core": f"{peak / 1e9:.0f} GFlop/s (matrix product)"}, quick=quick)
    rounds, least = (3, 0.005) if quick else (9, 0.02)
    for name in families:
        say(f"{name}: gaits, references and peers")
        f = problems.family(name, FAMILIES[name])
        found.kind = f.kind
        n = grid or (500 if f.problem.structure.kneed else 2000) // (4 if quick else 1)
        with warnings.catch_warnings():
            # LSODA tells of every failed corrector; what it found is judged by its error.
            warnings.simplefilter("ignore", UserWarning)
            with np.errstate(all="ignore"):
                small = problems.strides(f, quick) + problems.jacobians(f, quick) + problems.fixed_points(f, quick)
                large = problems.grid(f, n) + problems.branches(f)
                say(f"{name}: {len(small) + len(large)} cases, {rounds} rounds")
                interleaved(small, rounds, least)
                interleaved(large, min(rounds, 5), least)
        found.cases += small + large
        found.work[name] = counted.line(f, n)
        found.flows[name] = counted.roofline(f, peak)
        found.less[name] = counted.less_and_less(f, n)
    say("random walkers and bounds")
    found.outcomes = stress.lanes(RANDOM_LANES[quick]).rows()
    each = RANDOM_SLOPES[quick]
    found.bounds = bounds.bounds(each, walkers=[(name, resolve(name, {})) for name in families]).rows()
    return found
