"""`make bench`: run time against error of gaitsweep and of its peers, as an archive and
a page.
"""

import argparse
import sys
import warnings
from pathlib import Path

import numpy as np

from benchmarks import (
    accuracies,
    counted,
    grids,
    lines,
    machine,
    page,
    planes,
    problems,
    record,
)
from benchmarks.harness import Measurements, time_in_turns
from gaitsweep.tasks.walkers.resolve import resolve
from soak import bounds, missed, stress

#: Slope of each walker's timed gait [rad]; the grid runs from 1e-3 to three times it.
FAMILIES = {"D": 0.005, "E": 0.005, "B": 0.01, "A": 0.01, "C": 0.01}
QUICK = ("D", "B")
#: Random lanes, and random slopes per walker, of a full and of a quick run; `make soak`
#: takes a million and more.
RANDOM_LANES, RANDOM_SLOPES = {False: 20_000, True: 200}, {False: 300, True: 20}
#: Random lines searched densely; `make soak` takes a thousand.
RANDOM_LINES = {False: 100, True: 5}


def main(
    out: Path, quick: bool, families: tuple[str, ...] = (), slopes: int = 0
) -> None:
    """Measure, write `bench.nc` and `bench.html` into a folder, and print the path of
    the page.
    """
    out.mkdir(parents=True, exist_ok=True)
    measured = measure(quick, families or (QUICK if quick else tuple(FAMILIES)), slopes)
    record.write(measured, out / "bench.nc")
    page.write(measured, out / "bench.html")
    print(out / "bench.html")


def measure(quick: bool, families: tuple[str, ...], slopes: int) -> Measurements:
    """Run the bench for some walkers; `slopes` of the line of each, 0: 2000 (500 with
    knees), a quarter if quick.
    """
    peak = machine.peak_flops()
    computer = machine.describe() | {
        "peak of one core": f"{peak / 1e9:.0f} GFlop/s (matrix product)"
    }
    measured = Measurements(computer, quick)
    tables = measured.tables
    rounds, least = (3, 0.005) if quick else (9, 0.02)
    for name in families:
        _say(f"{name}: gaits, references and peers")
        f = problems.family(name, FAMILIES[name])
        measured.kind = f.kind
        n = slopes or (500 if f.problem.structure.kneed else 2000) // (
            4 if quick else 1
        )
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            # LSODA warns of every failed corrector; its result is judged by its error.
            warnings.simplefilter("ignore", UserWarning)
            small = (
                problems.strides(f, quick)
                + problems.jacobians(f, quick)
                + problems.fixed_points(f, quick)
            )
            large = problems.grid(f, n) + problems.branches(f)
            _say(f"{name}: {len(small) + len(large)} cases, {rounds} rounds")
            time_in_turns(small, rounds, least)
            time_in_turns(large, min(rounds, 5), least)
        measured.cases += small + large
        tables["counts"].append({"walker": name, **counted.line(f, n)})
        tables["less"] += [
            {"walker": name, **row} for row in counted.less_and_less(f, n)
        ]
        tables["flows"] += [
            {"walker": name, **row} for row in counted.roofline(f, peak)
        ]
    peers = [
        case
        for case in measured.cases
        if case.family == "D" and case.method.endswith(", differences")
    ]
    # A gait of D by scipy's integrator at its tightest tolerance, to 13 digits.
    solves = [
        case
        for case in peers
        if case.problem == "fixed point" and case.method.startswith("scipy DOP853")
    ]
    solve = float(np.median(min(solves, key=lambda case: case.setting).seconds))
    _say("grids")
    tables["grids"] = grids.table(quick, solve)
    _say("lines")
    tables["lines"] = lines.table(
        quick, [case for case in peers if case.problem == "grid"]
    )
    _say("accuracies")
    further = accuracies.cases(quick, families)
    measured.cases += further
    tables["accuracies"] = accuracies.table(further)
    _say("planes")
    tables["planes"] = planes.table(quick)
    _say("random walkers and bounds")
    tables["missed"] = missed.missed(range(RANDOM_LINES[quick]), missed.built).rows()
    tables["outcomes"] = stress.lanes(RANDOM_LANES[quick]).rows()
    compared = bounds.bounds(
        RANDOM_SLOPES[quick], walkers=[(name, resolve(name, {})) for name in families]
    )
    tables["bounds"], tables["deception"] = compared.rows(), compared.histogram()
    return measured


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(prog="benchmarks", description=__doc__)
    parser.add_argument(
        "--quick",
        action="store_true",
        help="two walkers and fewer repeats, in less than a minute",
    )
    parser.add_argument(
        "-o", dest="out", type=Path, default=Path("reports"), metavar="DIR"
    )
    options = parser.parse_args()
    main(options.out, options.quick)
