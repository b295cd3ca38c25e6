"""`gaitsweep report`: HTML pages from archives."""

import argparse
import contextlib
from collections.abc import Callable, Iterator

from gaitsweep.pipeline import terminal
from gaitsweep.pipeline.api.reports import write

#: Of the bar, which counts pages; the time to go stands behind it.
_FORMAT = "{bar:20} {n_fmt}/{total_fmt} {unit} [{elapsed}{postfix}]"
#: Of a terminal: one may not know its size.
_ROWS = 20


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
def _pages_counted(total: int) -> Iterator[Callable[[int, float], object]]:
    """Show on a terminal how many pages of a report are made."""
    if not terminal.is_terminal():
        yield lambda made, left: None
        return

    from tqdm import tqdm

    size = {"ncols": terminal.columns() - 1, "nrows": _ROWS}
    how = {"unit": "pages", "leave": False, "bar_format": _FORMAT, **size}
    with tqdm(total=total, **how) as bar:

        def tell(made: int, left: float) -> None:
            if made:
                bar.set_postfix_str(f"{terminal.duration(left)} to go", refresh=False)
            bar.update(made - bar.n)

        yield tell
