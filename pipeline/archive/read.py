"""Read archives with care: is one ours, and can it be read at all?"""

from __future__ import annotations

import contextlib
import json
import subprocess
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.archive import layout
from pipeline.errors import ArchiveError, GaitsweepError

SCHEMA = 1
_PATIENCE, _PACE = 30.0, 5e6  # s, and byte per s, that reading an archive may take
_ROWS = 1 << 20  # values read at a time


@contextlib.contextmanager
def opened(path: Path) -> Iterator[Any]:
    """An archive of this schema, open for reading.

    Raises
    ------
    ArchiveError
        If it cannot be read or is none of ours.
    """
    import netCDF4

    if not path.is_file():
        raise ArchiveError(f"There is no archive {path}.")
    try:
        file = netCDF4.Dataset(path)
    except (OSError, RuntimeError, ValueError) as error:
        raise ArchiveError(f"{path} is no netCDF file that can be read.") from error
    try:
        schema = getattr(file, "gaitsweep_schema", None)
        if not isinstance(schema, np.integer) or schema != SCHEMA:
            raise ArchiveError(f"{path} is not an archive of gaitsweep (schema {SCHEMA}).")
        try:
            yield file
        except GaitsweepError:
            raise
        except Exception as error:
            # Where the file is as it was written, whatever else goes wrong is a bug of ours.
            found = _line(error) if _unread(error) else next(_torn(file), "")
            if not found:
                raise
            raise ArchiveError(f"{path} is damaged: {found.rstrip('.')}.") from error
    finally:
        with contextlib.suppress(RuntimeError):
            file.close()


def _unread(error: Exception) -> bool:
    """Whether an exception is the netCDF library's: it could not read, or what it read is no text."""
    return isinstance(error, OSError | UnicodeDecodeError) or str(error).startswith("NetCDF:")


def _torn(file: Any) -> Iterator[str]:
    """What is not as its checksum says, one sentence each; empty where the file is as it was written."""
    try:
        sums = json.loads(file.checksums)
        for name in sums:
            try:
                if _checksum(file[name]) != sums[name]:
                    yield f"`{name}` is not as it was written."
            except (IndexError, KeyError):
                yield f"`{name}` is missing."
    except Exception as error:
        yield f"its checksums cannot be checked, {_line(error)}."


def _checksum(variable: Any) -> int:
    """Checksum of a variable as the archive keeps it: the sum of its boxes'."""
    sizes = dict(zip(variable.dimensions, variable.shape, strict=True))
    large = "gait" in sizes and len(sizes) > 1
    boxes = layout.boxes({d: n for d, n in sizes.items() if d not in ("gait", "multiplier")}) if large else [()]
    return sum(layout.checksum(np.ma.getdata(variable[box] if large else variable[...]), box) for box in boxes) % 2**32


def tables(place: Any, path: str = "") -> Iterator[str]:
    """Names of the tables in an open archive, as "fits/scaling"."""
    for name, group in place.groups.items():
        if group.variables:
            yield f"{path}{name}"
        yield from tables(group, f"{path}{name}/")


def columns(place: Any) -> Iterator[str]:
    """Names of all columns of tables, as "fits/scaling/exponent"."""
    for name, group in place.groups.items():
        yield from (f"{name}/{column}" for column in (*group.variables, *columns(group)))


def probe(paths: Iterable[Path]) -> None:
    """Let another process read the archives whole first: a mangled file can crash or hang the netCDF library.

    Raises
    ------
    ArchiveError
        If one does.
    """
    for path in paths:
        size = path.stat().st_size if path.is_file() else 0
        command = [sys.executable, "-P", "-m", "pipeline.archive.read", str(path)]
        try:
            done = subprocess.run(
                command,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                timeout=_PATIENCE + size / _PACE,
            )
        except subprocess.TimeoutExpired as error:
            raise ArchiveError(f"{path} is damaged: the netCDF library does not come back from it.") from error
        if done.returncode:
            raise ArchiveError(f"{path} is damaged: the netCDF library does not survive it.")


def _read_whole(path: Path) -> None:
    """Read all there is; what can be caught is left to those who read in earnest."""
    with contextlib.suppress(Exception), opened(path) as file:
        places = [file]
        for place in places:
            for variable in place.variables.values():
                with contextlib.suppress(Exception):
                    rows = max(1, _ROWS // max(1, int(np.prod(variable.shape[1:]))))
                    for start in range(0, variable.shape[0] if variable.shape else 1, rows):
                        variable[start : start + rows] if variable.shape else variable[...]
            places += place.groups.values()


def _line(error: Exception) -> str:
    return " ".join(str(error).split())[:200] or type(error).__name__


def ours(path: Path) -> None:
    """Check that `path` may be replaced by an archive of ours."""
    try:
        with opened(path):
            pass
    except ArchiveError as error:
        raise ArchiveError(f"{str(error).rstrip('.')}; move it away.") from error


def not_attempted(path: Path) -> int | None:
    """How many points of an archive were not come to; None where there is none."""
    try:
        with opened(path) as file:
            return int(file.not_attempted)
    except (ArchiveError, ValueError, TypeError, AttributeError):
        return None


if __name__ == "__main__":
    _read_whole(Path(sys.argv[1]))
