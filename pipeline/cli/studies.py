"""The studies that a command names."""

import argparse
import contextlib
from pathlib import Path

from gaitsweep.pipeline.cli.errors import report_errors
from gaitsweep.pipeline.errors import StudyError
from gaitsweep.pipeline.study import parse
from gaitsweep.pipeline.study.model import Study


def archives(
    options: argparse.Namespace, codes: list[int] | None = None
) -> list[tuple[Study, Path]]:
    """Read and check each study and name its archive; with `codes`, invalid studies are
    reported and skipped.
    """
    if options.archive and len(options.studies) > 1:
        raise StudyError("`--archive` names one file, but there are several studies.")
    studies = []
    for path in options.studies:
        with (
            contextlib.nullcontext()
            if codes is None
            else report_errors(codes, options.debug)
        ):
            studies.append(parse.read(path, getattr(options, "accuracy", None)))
    targets = [
        (s, options.archive or Path("data", "archive", f"{s.name}.nc")) for s in studies
    ]
    taken: set[Path] = set()
    for study, path in targets:
        if path in taken:
            raise StudyError(f"Two studies are called {study.name}.")
        taken.add(path)
    return targets
