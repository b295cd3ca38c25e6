"""`gaitsweep bench`: run time against error of gaitsweep and of its peers, as an archive and a page."""

from __future__ import annotations

import sys
from pathlib import Path

from pipeline.errors import unwritten

#: Slope of each walker's timed gait [rad]; the grid runs from 1e-3 to three times it.
FAMILIES = {"D": 0.005, "E": 0.005, "B": 0.01, "A": 0.01, "C": 0.01}
QUICK = ("D", "B")


def main(
    quick: bool, out: Path, families: tuple[str, ...] | None = None, grid: int | None = None, hunts: bool = False
) -> int:
    """Measure, write `bench.nc` and `bench.html` into a folder, and print the path of the page.

    Parameters
    ----------
    quick : bool
        Two walkers and fewer repeats, in less than a minute.
    out : Path
        The folder, created if missing.
    families : tuple of str, optional
        Names of walkers; default: all of `FAMILIES`, or those of `QUICK`.
    grid : int, optional
        Number of slopes of the grids.
    hunts : bool
        Also search for the worst inputs.

    Returns
    -------
    int
        Exit code 0.

    Raises
    ------
    OSError
        If the folder cannot be written.
    """
    from pipeline.bench import bench_page, record, run

    try:
        out.mkdir(parents=True, exist_ok=True)
        measurements = run.measure(quick, families or (QUICK if quick else tuple(FAMILIES)), grid, _say, hunts)
        record.write(measurements, out / "bench.nc")
        bench_page.write(measurements, out / "bench.html")
    except OSError as error:
        raise unwritten(out, error) from error
    print(out / "bench.html")
    return 0


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)
