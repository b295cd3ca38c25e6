"""Self-contained HTML pages, made from archives and the records of their runs.

`pages` makes the pages: of one archive, as `source` reads it, the page of a study, and
of all the index and the ledger of claims; `figures` draws, `html_tables` and `cells`
write tables, `words` and `paper` hold the sentences; `entry` is what a page carries for
`ledger` and index; `folder` puts pages in place. `templates` and `scripts` are HTML and
JavaScript.
"""

import os
import sys
from importlib.util import find_spec
from pathlib import Path
from unittest import mock


def _import_matplotlib() -> None:
    """Import matplotlib with its own settings.

    It reads a `matplotlibrc` of the current folder or the user's, which may hold
    anything, while it is imported, and first of all one in the current folder.
    """
    spec = find_spec("matplotlib")
    assert spec is not None and spec.origin is not None
    here = os.open(".", os.O_RDONLY)
    try:
        os.chdir(Path(spec.origin).parent / "mpl-data")
        with mock.patch.dict(os.environ):
            os.environ.pop("MPLBACKEND", None)
            import matplotlib  # noqa: F401
    finally:
        os.fchdir(here)
        os.close(here)


if "matplotlib" not in sys.modules:
    _import_matplotlib()
