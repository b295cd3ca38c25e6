"""Self-contained HTML reports, made from archives alone."""

import os
import sys
from importlib.util import find_spec
from pathlib import Path
from unittest import mock


def _import_matplotlib() -> None:
    """Import matplotlib with its own settings.

    It reads a `matplotlibrc` of the current folder or the user's, which may hold anything, while it is imported, and
    first of all one in the current folder.
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
