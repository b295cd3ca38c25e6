"""`gaitsweep diff`: differences between two archives."""

import argparse

from gaitsweep.pipeline.archive import diff, read


def run(options: argparse.Namespace) -> int:
    """Print the differences; the exit code is 1 if there are any."""
    read.probe([options.a, options.b])
    own = dict(options.rtol)
    differences = diff.diff(options.a, options.b, own.pop("", 0.0), own)
    print("\n".join(differences) if differences else "They agree.")
    return 1 if differences else 0
