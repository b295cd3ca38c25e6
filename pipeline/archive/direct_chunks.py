"""Packed chunks of large variables, written unchanged by what HDF5 calls direct chunk
write.
"""

import contextlib
import ctypes
import importlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

_READ_WRITE = 1  # H5F_ACC_RDWR
_ID = ctypes.c_int64  # hid_t


@contextlib.contextmanager
def direct_chunks(
    path: Path,
) -> Iterator[Callable[[str, tuple[int, ...], bytes], None]]:
    """Open a netCDF-4 file that is closed elsewhere, to write packed chunks into.

    Yields
    ------
    callable
        Writes a packed chunk of a named variable, which starts at a corner.

    Raises
    ------
    OSError
        If HDF5 cannot open, write or close it.
    """
    # The HDF5 that netCDF4 is linked to: a second one in the process may have another
    # version.
    hdf5 = ctypes.CDLL(importlib.import_module("netCDF4._netCDF4").__file__)

    def call(name: str, *arguments: Any) -> int:
        function = getattr(hdf5, name)
        function.restype = _ID if "open" in name else ctypes.c_int
        result = function(*arguments)
        if result < 0:
            raise OSError(f"HDF5 fails in {name}")
        return result

    variables: dict[str, ctypes.c_int64] = {}

    def write(name: str, corner: tuple[int, ...], data: bytes) -> None:
        if name not in variables:
            variables[name] = _ID(call("H5Dopen2", file, name.encode(), _ID(0)))
            stack.callback(call, "H5Dclose", variables[name])

        offset, size = (
            (ctypes.c_uint64 * len(corner))(*corner),
            ctypes.c_size_t(len(data)),
        )
        call(
            "H5Dwrite_chunk",
            variables[name],
            _ID(0),
            ctypes.c_uint32(0),
            offset,
            size,
            data,
        )

    with contextlib.ExitStack() as stack:
        file = _ID(call("H5Fopen", bytes(path), ctypes.c_uint(_READ_WRITE), _ID(0)))
        stack.callback(call, "H5Fclose", file)
        yield write
