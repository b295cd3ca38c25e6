"""`gaitsweep prove`: checks of its options, and its output."""

from __future__ import annotations

import argparse
import json
import sys

from pipeline.cli import prove
from pipeline.errors import StudyError


def run(options: argparse.Namespace) -> int:
    """Prove what the options request and print it; returns the exit code."""
    if (options.archive is None) == (options.walker is None) or (options.walker is None) != (options.slope is None):
        raise StudyError("Prove either the gaits of an archive, or those of a `--walker` on a `--slope`.")
    for name in ("set", "gait") if options.archive else ("sample",):
        if getattr(options, name):
            raise StudyError(f"`--{name}` goes with {'a `--walker`' if options.archive else 'an archive'}.")
    search: list[str] = []
    if options.archive is None:
        answer = prove.walker(options.walker, options.slope, options.set, options.gait, options.accuracy)
        proofs, search = iter(answer["gaits"]), answer["search"]
    else:
        proofs = prove.archive(options.archive, options.sample, options.accuracy, options.jobs)
    gaits = []
    for gait in proofs:
        gaits.append(gait)
        if not options.json:
            print(prove.shown(gait), flush=True)
    if not gaits:
        print("\n".join(search) or "The archive holds no gait.", file=sys.stderr)
    if options.json:
        print(json.dumps(gaits))
    return 0 if gaits and all(gait["proved"] for gait in gaits) else 1
