"""`gaitsweep diff`: differences between two archives."""

import argparse
from collections.abc import Sequence

from gaitsweep.pipeline import paths
from gaitsweep.pipeline.archive import diff, read
from gaitsweep.pipeline.errors import unwritten


def run(options: argparse.Namespace) -> int:
    """Print the differences; the exit code is 1 if there are any."""
    read.probe([options.a, options.b])
    own = dict(options.rtol)
    differences = diff.diff(options.a, options.b, own.pop("", 0.0), own)
    if options.page:
        _write_page(options, differences)
    print("\n".join(differences) if differences else "They agree.")
    return 1 if differences else 0


def _write_page(options: argparse.Namespace, differences: Sequence[str]) -> None:
    """Write the page on which the differences are drawn."""
    from gaitsweep.pipeline.report import diff_page

    paths.check_own(options.page, rb"(?s)<!doctype html>.*gaitsweep")
    compared = diff.numbers(options.a, options.b)
    text = diff_page.page((options.a, options.b), differences, compared)
    try:
        paths.publish(options.page, text.encode())
    except OSError as error:
        raise unwritten(options.page, error) from error
