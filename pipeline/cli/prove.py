"""`gaitsweep prove`: proofs of a walker's gaits at one slope, or of an archive's."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from pipeline.cli import kinds, proofs
from pipeline.errors import StudyError


def add_arguments(command: argparse.ArgumentParser) -> None:
    """Options of the command."""
    command.add_argument("archive", nargs="?", metavar="ARCHIVE.nc", type=Path)
    command.add_argument("--walker", metavar="NAME|FILE.toml")
    command.add_argument("--slope", type=kinds.decimal, metavar="S", help="rad")
    command.add_argument(
        "--set", action=kinds.Settings, type=kinds.decimal_setting, default={}, metavar="KEY=VALUE", help="a walker key"
    )
    command.add_argument("--gait", metavar="G", help="only the gait of this label")
    command.add_argument(
        "--sample", type=kinds.count, metavar="N", help="only so many gaits of the archive, a fixed draw"
    )
    command.add_argument(
        "--accuracy", type=kinds.number, default=1e-12, metavar="A", help="relative radius (default 1e-12)"
    )
    command.add_argument("--jobs", type=kinds.jobs, default=2, metavar="N", help="processes for an archive (default 2)")
    kinds.add_json(command)


def run(options: argparse.Namespace) -> int:
    """Prove what the options request and print it; returns the exit code."""
    if (options.archive is None) == (options.walker is None) or (options.walker is None) != (options.slope is None):
        raise StudyError("Prove either the gaits of an archive, or those of a `--walker` on a `--slope`.")
    for name in ("set", "gait") if options.archive else ("sample",):
        if getattr(options, name):
            raise StudyError(f"`--{name}` goes with {'a `--walker`' if options.archive else 'an archive'}.")
    search: list[str] = []
    if options.archive is None:
        answer = proofs.of_walker(options.walker, options.slope, options.set, options.gait, options.accuracy)
        made, search = iter(answer["gaits"]), answer["search"]
    else:
        made = proofs.of_archive(options.archive, options.sample, options.accuracy, options.jobs)
    gaits = []
    for gait in made:
        gaits.append(gait)
        if not options.json:
            print(proofs.shown(gait), flush=True)
    if not gaits:
        print("\n".join(search) or "The archive holds no gait.", file=sys.stderr)
    if options.json:
        print(json.dumps(gaits))
    return 0 if gaits and all(gait["proved"] for gait in gaits) else 1
