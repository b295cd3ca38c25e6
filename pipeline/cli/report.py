"""`gaitsweep report`: HTML pages from archives."""

import argparse
import contextlib
import time
from collections.abc import Callable, Iterator

from gaitsweep.pipeline import terminal
from gaitsweep.pipeline.api.reports import write

#: Time for which a report says nothing [s].
_QUIET = 2.0


def run(options: argparse.Namespace) -> int:
    """Make the pages, and print the path of their index, and then that of the page of a
    single archive.
    """
    with _pages_counted(len(options.archives)) as tell:
        page = write(options.archives, options.out, options.only, options.bundle, tell)
    index = options.out / "index.html"
    print(index, *([page] if page != index else []), sep="\n")
    if options.open:
        import webbrowser

        if not webbrowser.open(index.resolve().as_uri()):
            terminal.say("gaitsweep: No browser could be opened.")
    return 0


@contextlib.contextmanager
def _pages_counted(total: int) -> Iterator[Callable[[int], None]]:
    """Show how many pages of a report are made, if it takes long."""
    begin = said = first = time.monotonic()
    shown = False

    def tell(made: int) -> None:
        nonlocal said, shown, first
        now = time.monotonic()
        if (
            not made
        ):  # what comes before is done once: libraries are loaded, archives read
            first = now
            return
        if now - begin > _QUIET and now - said > (
            0.5 if terminal.is_terminal() else 10
        ):
            said, shown = now, terminal.is_terminal()
            text = f"{made} of {total} pages, {(now - first) / made * (total - made):.0f} s to go"
            terminal.say(
                f"\r\033[K{text}" if shown else text, end="" if shown else "\n"
            )

    try:
        yield tell
    finally:
        if shown:
            terminal.say("\r\033[K", end="")
