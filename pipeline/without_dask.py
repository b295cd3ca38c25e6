"""Archives read without dask."""

import contextlib
import sys
from collections.abc import Iterator


@contextlib.contextmanager
def without_dask() -> Iterator[None]:
    """Keep xarray from importing dask.array, and so half of SciPy, to find out whether
    an array is one of dask's: a second a process. If it is imported already, it stays.
    """
    is_absent = sys.modules.setdefault("dask.array", None) is None  # type: ignore[arg-type]
    try:
        yield
    finally:
        if is_absent:
            del sys.modules["dask.array"]
