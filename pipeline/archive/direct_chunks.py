"""Packed chunks of large variables, written unchanged by what HDF5 calls direct chunk write."""

import ctypes
import importlib
from pathlib import Path
from typing import Any

_READ_WRITE = 1  # H5F_ACC_RDWR
_ID = ctypes.c_int64  # hid_t


class DirectChunks:
    """A netCDF-4 file, closed elsewhere, to write packed chunks into.

    Raises
    ------
    OSError
        If HDF5 cannot open, write or close it.
    """

    def __init__(self, path: Path):
        # The HDF5 that netCDF4 is linked to: a second one in the process may have another version.
        self._hdf5 = ctypes.CDLL(importlib.import_module("netCDF4._netCDF4").__file__)
        self._variables: dict[str, int] = {}
        self._file = self._call("H5Fopen", bytes(path), ctypes.c_uint(_READ_WRITE), _ID(0))

    def _call(self, name: str, *arguments: Any) -> int:
        function = getattr(self._hdf5, name)
        function.restype = _ID if "open" in name else ctypes.c_int
        result = function(*arguments)
        if result < 0:
            raise OSError(f"HDF5 fails in {name}")
        return result

    def write(self, name: str, corner: tuple[int, ...], data: bytes) -> None:
        """Write a packed chunk of the named variable, which starts at `corner`."""
        if name not in self._variables:
            self._variables[name] = self._call("H5Dopen2", _ID(self._file), name.encode(), _ID(0))
        offset = (ctypes.c_uint64 * len(corner))(*corner)
        self._call(
            "H5Dwrite_chunk",
            _ID(self._variables[name]),
            _ID(0),
            ctypes.c_uint32(0),
            offset,
            ctypes.c_size_t(len(data)),
            data,
        )

    def __enter__(self) -> "DirectChunks":
        return self

    def __exit__(self, *_: object) -> None:
        try:
            for variable in self._variables.values():
                self._call("H5Dclose", _ID(variable))
        finally:
            self._call("H5Fclose", _ID(self._file))
