"""`gaitsweep verify`: whether an archive is intact, complete and valid."""

import argparse

from gaitsweep.pipeline.archive import read, verify
from gaitsweep.pipeline.cli import kinds
from gaitsweep.pipeline.errors import ArchiveError


def run(options: argparse.Namespace) -> int:
    """Check an archive and print its problems; returns the exit code.

    Raises
    ------
    ArchiveError
        If there is no such file.
    """
    archive = options.archive
    read.size_of(archive)
    try:
        read.probe([archive])
        problems = verify.verify(archive)
    except ArchiveError as error:
        problems = [str(error)]
    record = {"archive": str(archive), "valid": not problems, "problems": problems}
    kinds.show(
        options,
        record,
        problems
        or [f"{archive} is intact, complete and valid (schema {read.SCHEMA})."],
    )
    return int(bool(problems))
