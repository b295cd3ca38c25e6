"""`gaitsweep diff`: differences between two archives."""

import argparse
from pathlib import Path

from pipeline.archive import diff, read
from pipeline.cli import kinds


def add_arguments(command: argparse.ArgumentParser) -> None:
    """Options of the command."""
    command.add_argument("a", type=Path, metavar="A.nc")
    command.add_argument("b", type=Path, metavar="B.nc")
    command.add_argument(
        "--rtol",
        type=kinds.tolerance,
        action="append",
        default=[],
        metavar="R|NAME=R",
        help="relative tolerance (default 0), or that of one variable",
    )


def run(options: argparse.Namespace) -> int:
    """Print the differences; the exit code is 1 if there are any."""
    read.probe([options.a, options.b])
    own = dict(options.rtol)
    differences = diff.diff(options.a, options.b, own.pop("", 0.0), own)
    print("\n".join(differences) if differences else "They agree.")
    return 1 if differences else 0
