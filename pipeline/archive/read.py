"""Reading archives that may be foreign or damaged."""

import contextlib
import itertools
import json
import math
import os
import resource
import signal
import subprocess
import sys
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np

from gaitsweep.pipeline.archive import layout
from gaitsweep.pipeline.companions import default_archive
from gaitsweep.pipeline.errors import ArchiveError, GaitsweepError, WorkerError, unread
from gaitsweep.pipeline.grid import boxes as grid
from gaitsweep.pipeline.paths import kind_of

SCHEMA = 2
# Processor time [s] and speed [byte/s] allowed to read an archive, which may hold much
# in few bytes.
_TIMEOUT, _MIN_SPEED = 30.0, 2e5
_MAX_VALUES = 1 << 20  # read at a time
_MAX_POINTS = 1 << 16  # of a variable, read at a time
_LITTLE_MEMORY = 1 << 23  # numbers, more than any part that is read at a time
_MOST_PACKED = 1100  # bytes into one, more than deflate packs
_MAGIC = b"\x89HDF\r\n\x1a\n"  # the beginning of a netCDF-4 file
_HEADER = 1 << 16  # bytes of it within which its attributes are


@contextlib.contextmanager
def open_netcdf(path: Path, mode: Literal["r", "w", "a"] = "r") -> Iterator[Any]:
    """Open a netCDF-4 file.

    Raises
    ------
    OSError, RuntimeError, ValueError
        If the library cannot open or close it.
    """
    import netCDF4

    # The library drops leading blanks.
    file = netCDF4.Dataset(os.path.join(os.curdir, path), mode)
    try:
        yield file
        if mode != "r":
            file.sync()
    except BaseException:
        if mode != "r":
            # The library crashes when it closes a file that it cannot write; it is left
            # open.
            file._isopen = 0
        raise
    finally:
        if file.isopen():
            file.close()


def is_nameable(path: Path) -> bool:
    """Whether the netCDF library can open a file of that name: no backslash, and no
    bytes that are not UTF-8.
    """
    name = os.fsencode(path).decode(errors="replace")
    return "\\" not in name and "\ufffd" not in name


def size_of(path: Path) -> int:
    """Size of an archive [byte].

    Raises
    ------
    ArchiveError, WorkerError
        If there is no such file, or it cannot be opened.
    """
    try:
        status = path.stat()
        if kind := kind_of(status.st_mode):  # opening it might wait for another program
            raise ArchiveError(f"{path} is {kind}, not an archive.")
        if path.suffix == ".toml":
            raise ArchiveError(
                f"{path} is a study or a walker; an archive NAME.nc is wanted."
            )

        open(path, "rb").close()
    except (FileNotFoundError, NotADirectoryError, ValueError):
        near = default_archive(path.name)
        hint = f"; did you mean {near}?" if near.is_file() else "."
        raise ArchiveError(f"There is no archive {path}{hint}") from None
    except OSError as error:
        raise unread(path, error) from error

    return status.st_size


def _check_limits(path: Path) -> None:
    """Say what the netCDF library does not: that the system opens no more files, or
    gives no more memory.
    """
    size_of(path)
    np.empty(_LITTLE_MEMORY)


@contextlib.contextmanager
def open_archive(path: Path) -> Iterator[Any]:
    """Open an archive of this schema for reading.

    Raises
    ------
    ArchiveError
        If it cannot be read or is not an archive of gaitsweep.
    """
    size_of(path)
    if not is_nameable(path):
        raise ArchiveError(
            f"The netCDF library opens no file of such a name as {path}; name it from its own folder."
        )

    # It imports h5py, which takes longer than most commands.
    from gaitsweep.pipeline.archive import objects

    opened = open_netcdf(path)
    try:
        if fault := objects.fault(path):
            raise ArchiveError(f"{path} is not an archive of gaitsweep: {fault}.")
        file = opened.__enter__()
    except (OSError, RuntimeError, ValueError) as error:
        _check_limits(path)
        raise ArchiveError(f"{path} is no netCDF file that can be read.") from error

    with blamed_if_damaged(path):
        try:
            schema = getattr(file, "gaitsweep_schema", None)
            if not isinstance(schema, np.integer) or schema != SCHEMA:
                raise ArchiveError(
                    f"{path} is not an archive of gaitsweep (schema {SCHEMA})."
                )
            _check_sizes(file, path)
            yield file
        finally:
            with contextlib.suppress(RuntimeError):
                opened.__exit__(None, None, None)


def _check_sizes(file: Any, path: Path) -> None:
    """Check that the variables of an open file are not larger than what may be packed
    into its bytes.
    """
    size, most = 0, _MOST_PACKED * size_of(path)
    for name, variable in layout.variables(file):
        size += math.prod(variable.shape) * variable.dtype.itemsize
        if size > most:
            raise ArchiveError(
                f"{path} is not an archive of gaitsweep: `{name}` is larger than can be packed into it."
            )


@contextlib.contextmanager
def blamed_if_damaged(path: Path) -> Iterator[None]:
    """Say of an error over a damaged archive that this is damaged; any other is raised
    as it is.

    Raises
    ------
    ArchiveError
        If the archive is not as it was written, or not laid out as one.
    """
    try:
        yield
    except (GaitsweepError, MemoryError):
        raise
    except Exception as error:
        if "NetCDF:" in str(error):
            _check_limits(path)
        # Opened anew: who used it may have changed how its variables are read.
        fault = _one_line(error) if "NetCDF:" in str(error) else damage(path)
        if not fault:
            raise
        raise ArchiveError(f"{path} is damaged: {fault.rstrip('.')}.") from error


def changes(file: Any) -> Iterator[str]:
    """Variables that do not match their checksums, one sentence each."""
    sums = json.loads(getattr(file, "checksums", "{}"))
    for name in sums:
        try:
            if _checksum(file[name]) != sums[name]:
                yield f"`{name}` is not as it was written."
        except (IndexError, KeyError):
            yield f"`{name}` is missing."
        except LookupError:  # text of an unknown encoding
            yield f"`{name}` is not as it was written."


def damage(path: Path) -> str:
    """Damage to an archive, or its departure from gaitsweep's layout; empty if there is
    none, though it be incomplete.

    Raises
    ------
    ArchiveError, WorkerError
        If the system does not open it.
    """
    # Only a fault needs its registry tables.
    from gaitsweep.pipeline.archive import structure

    try:
        with open_netcdf(path) as file:
            misfits = (
                misfit
                for misfit in structure.misfits(file)
                if "not_attempted" not in misfit
            )
            try:
                return next(itertools.chain(changes(file), misfits), "")
            except MemoryError:
                raise
            except Exception as error:
                return f"its checksums cannot be checked, {_one_line(error)}."
    except (OSError, RuntimeError) as error:
        _check_limits(path)
        return _one_line(error)


def _checksum(variable: Any) -> int:
    """Checksum of a variable."""
    if not is_over_grid(variable):
        return layout.checksum(np.ma.getdata(variable[...])) % 2**32

    pieces = (
        layout.split(np.ma.getdata(variable[box]), box, _chunk(variable))
        for box in boxes(variable)
    )
    parts = itertools.chain.from_iterable(pieces)

    return (
        sum(
            layout.chunk_checksum(zlib.crc32(part.tobytes()), corner)
            for corner, part in parts
        )
        % 2**32
    )


def is_over_grid(variable: Any) -> bool:
    """Whether a variable is one of points, by gait."""
    return "gait" in variable.dimensions and variable.name != "gait"


def boxes(variable: Any) -> Iterator[grid.Box]:
    """Boxes in which a variable of points is read: whole chunks."""
    points = _points(variable)
    return grid.boxes(points, _chunk(variable)[: len(points)], _MAX_POINTS)


def _points(variable: Any) -> dict[str, int]:
    sizes = dict(zip(variable.dimensions, variable.shape, strict=True))
    return {d: n for d, n in sizes.items() if d not in ("gait", "multiplier", "key")}


def _chunk(variable: Any) -> tuple[int, ...]:
    """Shape of the chunks in which a variable of points was written, even if it was
    rechunked since.
    """
    points = _points(variable)
    inner = variable.shape[len(points) :]
    return (*np.atleast_1d(variable.group().checksum_chunk).tolist(), 1, *inner[1:])


def probe(
    paths: Iterable[Path], meanwhile: Callable[[], object] = lambda: None
) -> None:
    """Read archives completely in another process first: a damaged file can crash or
    hang the netCDF library. `meanwhile` is called while it reads.

    Raises
    ------
    ArchiveError
        If one crashes or hangs it, or is not there.
    WorkerError
        If there is no other process, as where a user may have no more.
    """
    paths = list(paths)
    if len(paths) > 1:
        # To start Python takes longer than to read most; each is tried alone only to
        # find the one that is damaged.
        with contextlib.suppress(ArchiveError, WorkerError):
            _probe(paths, meanwhile)
            return

    for path in paths:
        _probe([path], meanwhile)


def _probe(paths: list[Path], meanwhile: Callable[[], object] = lambda: None) -> None:
    """Read archives in one other process; errors name the first."""
    # Threads of a numerical library are not needed, and may be refused.
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    path, size = paths[0], sum(size_of(path) for path in paths)
    seconds = int(_TIMEOUT + size / _MIN_SPEED)
    command = [
        sys.executable,
        "-P",
        "-m",
        "gaitsweep.pipeline.archive.read",
        str(seconds),
        *map(str, paths),
    ]
    try:
        null = subprocess.DEVNULL
        process = subprocess.Popen(
            command, stdin=null, stdout=null, stderr=null, env=environment
        )
    except OSError as error:
        raise WorkerError(
            f"{path} cannot be tried in another process: {error.strerror}."
        ) from error

    with process:
        meanwhile()
    code = process.returncode
    if code < 0:
        what = "hangs" if code == -signal.SIGXCPU else "crashes"
        raise ArchiveError(f"{path} is damaged: the netCDF library {what} on it.")

    if code:
        raise WorkerError(
            f"{path} cannot be tried in another process: that ended with {code}."
        )


def _read_whole(path: Path) -> None:
    """Read all variables; errors are left to the actual reader."""
    with contextlib.suppress(Exception), open_archive(path) as file:
        file.set_auto_mask(False)  # masking takes longer than reading
        for _, variable in layout.variables(file):
            with contextlib.suppress(Exception):
                stored = variable.chunking()
                chunk = (
                    (1,) * variable.ndim if stored == "contiguous" else tuple(stored)
                )
                sizes = {str(dim): n for dim, n in enumerate(variable.shape)}
                for box in grid.boxes(sizes, chunk, _MAX_VALUES):
                    variable[box or ...]


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())[:200] or type(error).__name__


def check_replaceable(path: Path) -> None:
    """Check that nothing, or an archive of gaitsweep, which may be damaged, stands
    where one is to be written.

    Raises
    ------
    ArchiveError
        If it is another file or cannot be read.
    """
    try:
        path.stat()
    except FileNotFoundError:  # nor what a link points to
        return
    except OSError:
        pass  # which is said below

    size_of(path)
    with open(path, "rb") as file:
        beginning = file.read(_HEADER)
    if beginning.startswith(_MAGIC) and b"gaitsweep_schema" in beginning:
        return

    try:
        probe([path])
        with open_archive(path):
            pass
    except ArchiveError as error:
        raise ArchiveError(f"{str(error).rstrip('.')}; move it away.") from error


def not_attempted(path: Path) -> int | None:
    """Number of points of an archive that were not attempted; None if there is no
    archive.
    """
    try:
        probe([path])
    except (ArchiveError, WorkerError):
        return None
    return _not_attempted(path)


def _not_attempted(path: Path) -> int | None:
    """The same of an archive that was read before."""
    try:
        with open_archive(path) as file:
            return int(file.not_attempted)
    except (ArchiveError, WorkerError, ValueError, TypeError, AttributeError):
        return None


def complete(paths: Sequence[Path]) -> list[Path]:
    """Those of some archives that can be read and have no point that was not attempted."""
    if not paths:
        return []
    try:
        _probe(list(paths))
    except (ArchiveError, WorkerError):
        return [path for path in paths if not_attempted(path) == 0]
    return [path for path in paths if _not_attempted(path) == 0]


def _limit_time(seconds: int) -> None:
    """Let the kernel end this process after so much processor time, which one that is
    suspended does not spend.
    """
    _, most = resource.getrlimit(resource.RLIMIT_CPU)
    limit = seconds if most == resource.RLIM_INFINITY else min(seconds, most)
    resource.setrlimit(resource.RLIMIT_CPU, (limit, most))


if __name__ == "__main__":
    _limit_time(int(sys.argv[1]))
    for _argument in sys.argv[2:]:
        _read_whole(Path(_argument))
