"""`gaitsweep tune`: the nearest walker that meets the conditions of walking at
vanishing slope.
"""

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from gaitsweep.pipeline.cli import kinds
from gaitsweep.pipeline.cli.walkers import or_zero, table
from gaitsweep.pipeline.dispatch import ask
from gaitsweep.pipeline.study import files


def run(options: argparse.Namespace) -> int:
    """Print the walker as a table ready to paste."""
    free = {"free": options.free} if options.free else {}
    answer = ask("tune", {"walker": files.walker(options.walker, Path()), **free})
    kinds.show(options, answer, _lines(answer))
    return 0


def _lines(answer: dict[str, Any]) -> Iterator[str]:
    """Nearest tuned walker as a TOML table; changed keys and residuals of the
    conditions precede it as comments.
    """
    if not answer["moved"]:
        yield "# It meets the zero-slope conditions already; no key was changed."
    for key, (old, new) in answer["moved"].items():
        yield f"# {key} changed from {old!r} to {new!r}"
    for name, before in answer["before"].items():
        after = or_zero(answer["after"][name])
        yield f"# {name.replace('_', ' ')}: {or_zero(before):.3g} before, {after:.3g} after"

    yield from table("walker", answer["walker"])
