"""`gaitsweep diff`: differences between two archives."""

import argparse
from collections.abc import Mapping

from gaitsweep.pipeline import paths
from gaitsweep.pipeline.archive import diff, read


def run(options: argparse.Namespace) -> int:
    """Print the differences; the exit code is 1 if there are any."""
    read.probe([options.a, options.b])
    if options.page:
        paths.check_page(options.page, "diff")
    own = dict(options.rtol)
    rtol = own.pop("", 0.0)
    compared: list[diff.Numbers] = []
    # Only a page needs the numbers of all variables at once.
    keep = compared.append if options.page else None
    differences = diff.diff(options.a, options.b, rtol, own, keep)
    print("\n".join(differences) if differences else "They agree.")

    if options.page:
        from gaitsweep.pipeline.report import diff_page

        summary = _summary(len(differences), dict(options.rtol))
        archives = options.a, options.b
        text = diff_page.page(archives, summary, differences, compared)
        paths.publish_page(options.page, "diff", text)

    return 1 if differences else 0


def _summary(count: int, tolerances: Mapping[str, float]) -> str:
    """How many differences there are, beyond which tolerances."""
    said = [f"{name} {rtol:g}".strip() for name, rtol in tolerances.items() if rtol]
    if not said:
        return f"Differences: {count}." if count else "They agree."

    limits = ", ".join(said)
    if not count:
        return f"They agree within {limits}."

    return f"Differences beyond {limits}: {count}."
