"""`gaitsweep run`: run studies; the same command again resumes."""

import argparse
import dataclasses
import shlex
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from gaitsweep.pipeline import terminal
from gaitsweep.pipeline.cli import studies
from gaitsweep.pipeline.cli.errors import report_errors
from gaitsweep.pipeline.engine import runner

#: Exit codes of several studies, gravest first: the gravest is that of all.
_EXIT_CODES_BY_SEVERITY = (143, 130, 129, 4, 3, 2, 5, 1, 0)


def run(options: argparse.Namespace) -> int:
    """Run studies; returns the gravest exit code."""
    codes: list[int] = []
    targets = studies.archives(options, codes)
    names = (field.name for field in dataclasses.fields(runner.Options))
    run_options = runner.Options(**{name: getattr(options, name) for name in names})
    start = time.monotonic()

    def report(error: Exception) -> None:
        with report_errors([], options.debug):
            raise error

    ends = runner.run(targets, run_options, report)
    codes += [end.code for end in ends]
    if not options.quiet:
        finished = {end.study.path: end for end in ends if end.code in (0, 1)}
        others = [str(path) for path in options.studies if path not in finished]
        for line in _after(list(finished.values()), others, time.monotonic() - start):
            terminal.say(line)
    return min(codes, key=_EXIT_CODES_BY_SEVERITY.index)


def _after(
    ends: list[runner.StudyRun], unfinished: list[str], seconds: float
) -> Iterator[str]:
    """Closing lines of a run: outcomes of its studies, unfinished ones, and how to see
    the results.
    """
    archives, counts = (
        [end.path for end in ends],
        sum((end.counts for end in ends), Counter[str]()),
    )
    if len(archives) + len(unfinished) > 1:
        count = (
            f"{len(archives)} of {len(archives) + len(unfinished)}"
            if unfinished
            else f"{len(archives)}"
        )
        parts = [", ".join(f"{k} {n:,}" for k, n in counts.items())] if counts else []
        parts += [f"not run to the end: {', '.join(unfinished)}"] if unfinished else []
        yield f"{count} studies in {terminal.duration(seconds)}: {'; '.join(parts)}"
    if archives:
        folder = (
            archives[0].parent / "*.nc"
            if len(archives) > 1 and len({p.parent for p in archives}) == 1
            else None
        )
        shown = (
            str(folder)
            if folder
            else " ".join(shlex.quote(str(path)) for path in archives)
        )
        yield f"To see it: gaitsweep report {shown}  (makes {Path('reports', 'index.html')})"
