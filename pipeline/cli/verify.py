"""`gaitsweep verify`: whether archives are intact, complete and valid."""

import argparse
from pathlib import Path

from gaitsweep.pipeline.archive import read, verify
from gaitsweep.pipeline.cli import kinds
from gaitsweep.pipeline.cli.errors import gravest, say
from gaitsweep.pipeline.errors import ArchiveError, GaitsweepError


def run(options: argparse.Namespace) -> int:
    """Check archives and print the problems of each; returns the gravest exit code."""
    records, lines, codes = [], list[str](), list[int]()
    for archive in options.archives:
        try:
            read.size_of(archive)
            problems = _problems(archive)
        except GaitsweepError as error:
            codes.append(say(error, options.debug))
            continue

        codes.append(int(bool(problems)))
        records.append(
            {"archive": str(archive), "valid": not problems, "problems": problems}
        )
        lines += _lines(archive, problems, is_alone=len(options.archives) == 1)

    if records:
        alone = records[0] if len(options.archives) == 1 else records
        kinds.show(options, alone, lines)

    return gravest(codes)


def _problems(archive: Path) -> list[str]:
    try:
        read.probe([archive])
        return verify.verify(archive)
    except ArchiveError as error:
        return [str(error)]


def _lines(archive: Path, problems: list[str], is_alone: bool) -> list[str]:
    """Problems of an archive, of several with its name where they do not have it."""
    if not problems:
        return [f"{archive} is intact, complete and valid (schema {read.SCHEMA})."]
    if is_alone:
        return problems
    name = str(archive)
    return [said if name in said else f"{name}: {said}" for said in problems]
