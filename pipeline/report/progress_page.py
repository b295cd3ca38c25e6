"""The page of runs in flight: what is done, by stage and by line, the time to go, and the
figures of what each run has published.
"""

import time
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from gaitsweep.pipeline.archive import read as archives
from gaitsweep.pipeline.errors import GaitsweepError
from gaitsweep.pipeline.report import html_tables
from gaitsweep.pipeline.report.figures.svg import Drawing
from gaitsweep.pipeline.report.pages import drawings, render_template
from gaitsweep.pipeline.report.source import Source, read
from gaitsweep.pipeline.report.words import spaced
from gaitsweep.pipeline.statuses import ALL_STATUSES
from gaitsweep.pipeline.terminal import PAUSE, duration, processor_time

#: Lines that a page lists of a run, those that lack most first.
_MAX_LINES = 40
#: Room for the figures of all runs [byte].
_MAX_FIGURES = 300_000


@dataclass(frozen=True)
class Stage:
    """How many of how many a stage has done, and its time to go in words."""

    name: str
    done: int
    todo: int
    left: str


@dataclass(frozen=True)
class Published:
    """What the archive of a run holds: its outcomes, its figures, and of its lines the
    label, the points done and all points.
    """

    statuses: list[tuple[str, int, float]] = field(default_factory=list)
    figures: list[Drawing] = field(default_factory=list)
    lines: list[tuple[str, int, int]] = field(default_factory=list)
    finished: int = 0
    every: int = 0


class ProgressPage:
    """The page of some runs, whose figures are drawn anew only where an archive has
    changed, and at most in a hundredth of the time that passes.
    """

    def __init__(self) -> None:
        self._published: dict[Path, tuple[int, Published]] = {}
        self._due = 0.0

    def update(self, archives: Iterable[Path], at_once: bool = False) -> None:
        """Read and draw the archives that have changed, if it is time or `at_once`."""
        if time.monotonic() < self._due and not at_once:
            return

        began = processor_time()
        for path in archives:
            changed = _changed(path)
            known, _ = self._published.get(path, (0, None))
            if known != changed:
                self._published[path] = changed, _published(path)

        self._due = time.monotonic() + PAUSE * (processor_time() - began)

    def text(
        self,
        stages: Mapping[Path, Sequence[tuple[str, int, int, float]]],
        said: Mapping[Path, list[str]],
        running: Collection[Path] = (),
        refresh: int = 0,
        began: Mapping[Path, float] | None = None,
    ) -> str:
        """Return the page.

        Parameters
        ----------
        stages : mapping
            Of the run of each archive: name of each stage, how many of how many are
            done, and the time to go [s].
        said : mapping
            Sentences on each of them.
        running : collection of Path
            The runs that are in flight.
        refresh : int [s]
            After which a browser loads the page again; 0 for never.
        began : mapping [s since 1970], optional
            When the runs that are not finished began: what is older is of another run.
        """
        room = _MAX_FIGURES
        runs = []
        for path, of_run in stages.items():
            changed, published = self._published.get(path, (0, Published()))
            figures = []
            for figure in published.figures:
                room -= len(figure.svg)
                if room > 0:
                    figures.append(figure)

            runs.append(
                {
                    "path": path,
                    "said": said[path],
                    "is_running": path in running,
                    "stages": [_stage(*stage) for stage in of_run],
                    "published": replace(published, figures=figures),
                    "is_earlier": 0 < changed < 1e9 * (began or {}).get(path, 0.0),
                }
            )

        return render_template("progress.html", runs=runs, refresh=refresh)


def _changed(path: Path) -> int:
    """When an archive was last written [ns]; 0 where there is none."""
    try:
        return path.stat().st_mtime_ns
    except OSError:
        return 0


def _published(path: Path) -> Published:
    """Read an archive for the page."""
    try:
        archives.probe([path])
        source = read(path)
        figures, _ = drawings(source, source.slug)
    except GaitsweepError:
        return Published()

    lines = _lines(source)
    unfinished = [line for line in lines if line[1] < line[2]]
    unfinished.sort(key=lambda line: line[1] / line[2])

    return Published(
        statuses=html_tables.statuses(source),
        # A page that is loaded again and again makes no gait walk.
        figures=[replace(figure, targets=[], panels=[], axes=[]) for figure in figures],
        lines=unfinished[:_MAX_LINES],
        finished=len(lines) - len(unfinished),
        every=len(lines),
    )


def _lines(source: Source) -> list[tuple[str, int, int]]:
    """Label of each line of a grid, its points done and all its points."""
    status = source.outcomes.get("status")
    if status is None or not {"gait", source.along} <= set(status.dims):
        return []

    across = [name for name in source.axes if name != source.along]
    reached = (status != ALL_STATUSES["not_attempted"]).any("gait")
    done = reached.sum(source.along).transpose(*across).values
    total = status.sizes[source.along]
    walkers = list(source.walkers) or [source.walker]

    lines = []
    for place in np.ndindex(done.shape):
        at: dict[str, Any] = {"walker": walkers[0]}
        for name, i in zip(across, place, strict=True):
            at[name] = walkers[i] if name == "walker" else float(source.grid[name][i])
        label = source.label_among_lines(at) or source.name
        lines.append((label, int(done[place]), total))

    return lines


def _stage(name: str, done: int, todo: int, left: float) -> Stage:
    """A stage in words."""
    return Stage(spaced(name), done, todo, duration(left))
