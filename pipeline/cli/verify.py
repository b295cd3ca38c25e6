"""The command `gaitsweep verify`."""

from __future__ import annotations

import json
from pathlib import Path

from pipeline.archive import read, verify
from pipeline.errors import ArchiveError


def report(archive: Path, as_json: bool) -> int:
    """Check an archive and print its problems; returns the exit code.

    Raises
    ------
    ArchiveError
        If there is no such file.
    """
    read.size_of(archive)
    try:
        read.probe([archive])
        problems = verify.verify(archive)
    except ArchiveError as error:
        problems = [str(error)]
    if as_json:
        print(json.dumps({"archive": str(archive), "valid": not problems, "problems": problems}))
    else:
        print("\n".join(problems) or f"{archive} is intact, complete and valid (schema {read.SCHEMA}).")
    return int(bool(problems))
