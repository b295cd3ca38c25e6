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
from gaitsweep.pipeline.cli.errors import gravest, say
from gaitsweep.pipeline.engine import runner


def run(options: argparse.Namespace) -> int:
    """Run studies; returns the gravest exit code."""
    targets, invalid = studies.targets(options)
    names = (field.name for field in dataclasses.fields(runner.Options))
    run_options = runner.Options(**{name: getattr(options, name) for name in names})
    start = time.monotonic()

    ends = runner.run(targets, run_options, lambda error: say(error, options.debug))
    if not options.quiet:
        finished = [end for end in ends if end.code in (0, 1)]
        stopped = {end.study.path for end in ends if end.code not in (0, 1)}
        stopped |= invalid.keys()
        unfinished = [path for path in options.studies if path in stopped]
        for line in _after(finished, unfinished, time.monotonic() - start):
            terminal.say(line)

    return gravest([*(end.code for end in ends), *invalid.values()])


def _after(
    ends: list[runner.StudyRun], unfinished: list[Path], seconds: float
) -> Iterator[str]:
    """Closing lines of a run: outcomes of its studies, unfinished ones, and how to see
    the results.
    """
    archives = [end.path for end in ends]
    counts = sum((end.counts for end in ends), Counter[str]())
    studies = len(archives) + len(unfinished)
    if studies > 1:
        count = f"{len(archives)}"
        parts = []
        if counts:
            parts.append(", ".join(f"{k} {n:,}" for k, n in counts.items()))
        if unfinished:
            count = f"{count} of {studies}"
            parts.append(f"not run to the end: {', '.join(map(str, unfinished))}")

        yield f"{count} studies in {terminal.duration(seconds)}: {'; '.join(parts)}"

    if archives:
        shown = " ".join(shlex.quote(str(path)) for path in archives)
        if len(archives) > 1 and len({path.parent for path in archives}) == 1:
            shown = str(archives[0].parent / "*.nc")
        yield f"To see it: gaitsweep report {shown}  (makes {Path('reports', 'index.html')})"
