"""Chunks of large variables, packed by several threads and written to HDF5 unchanged.

HDF5's own filters take longer than solving the points, mostly on bytes of the mantissa that do not compress. Those
bytes are stored, the others deflated; every reader unpacks both.
"""

from __future__ import annotations

import ctypes
import importlib
import itertools
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.archive.layout import Box

#: Every n-th byte is sampled; n is prime so that no dimension aliases.
_SAMPLING = 13
#: Least unevenness of bytes to deflate, and least fraction that repeats at a lag, as across gaits or multipliers.
_MIN_UNEVENNESS, _MIN_REPETITION, _LAGS = 1.1, 0.02, (1, 2, 3, 4, 6, 8)
_READ_WRITE = 1  # H5F_ACC_RDWR
_ID = ctypes.c_int64  # hid_t


def split(values: np.ndarray, box: Box, extent: tuple[int, ...]) -> Iterator[tuple[tuple[int, ...], np.ndarray]]:
    """Split a box that starts at the corner of a chunk into chunks.

    Parameters
    ----------
    values : ndarray
        Values of the box; dimensions beyond those of the box are complete.
    box : Box
    extent : tuple of int
        Shape of a chunk.

    Yields
    ------
    corner : tuple of int
        Start of the chunk in the variable.
    part : ndarray, shape `extent`
        Its values, contiguous; zero outside the variable.
    """
    start = (*(s.start for s in box), *(0,) * (values.ndim - len(box)))
    for corner in itertools.product(*(range(0, n, c) for n, c in zip(values.shape, extent, strict=True))):
        part = values[tuple(slice(i, i + c) for i, c in zip(corner, extent, strict=True))]
        if part.shape != extent:
            padded = np.zeros(extent, values.dtype)
            padded[tuple(map(slice, part.shape))] = part
            part = padded
        yield tuple(a + b for a, b in zip(start, corner, strict=True)), np.ascontiguousarray(part)


def pack(values: np.ndarray) -> bytes:
    """Apply the filters fletcher32, shuffle and deflate, in this order, to a chunk.

    Parameters
    ----------
    values : ndarray
        Values of the chunk, contiguous.

    Returns
    -------
    bytes

    Notes
    -----
    The stream follows RFC 1950 (zlib) and RFC 1951 (deflate).
    """
    data, size = values.reshape(-1).view(np.uint8), values.itemsize
    data = np.concatenate([data, np.frombuffer(struct.pack("<I", fletcher32(data)), np.uint8)])
    n = len(data) // size
    planes = np.ascontiguousarray(data[: n * size].reshape(n, size).T)
    checksum, stream = 1, [b"\x78\x01"]
    compressible_planes = _compressible_planes(planes) if values.dtype.kind == "f" else [True] * size
    for compressible, run in itertools.groupby(zip(compressible_planes, planes, strict=True), key=lambda pair: pair[0]):
        deflate = zlib.compressobj(int(compressible), zlib.DEFLATED, -15)
        for _, plane in run:
            checksum = zlib.adler32(plane, checksum)
            stream.append(deflate.compress(plane))
        stream.append(deflate.flush(zlib.Z_SYNC_FLUSH))
    rest = data[n * size :].tobytes()
    last = zlib.compressobj(0, zlib.DEFLATED, -15)
    return b"".join([*stream, last.compress(rest), last.flush(), struct.pack(">I", zlib.adler32(rest, checksum))])


def _compressible_planes(planes: np.ndarray) -> list[bool]:
    """Planes of bytes that, by a sample, are less even than chance or repeat at a lag."""
    size, last = planes.shape[0], max(1, planes.shape[1] - _LAGS[-1])
    sample = planes[:, :last:_SAMPLING]
    n = sample.shape[1]
    histogram = np.bincount((sample + 256 * np.arange(size)[:, None]).ravel(), minlength=256 * size).reshape(size, 256)
    compressible = np.sum(histogram**2, axis=1) > _MIN_UNEVENNESS * (n + n * (n - 1) / 256)
    for lag in _LAGS if planes.shape[1] > _LAGS[-1] else ():
        compressible |= np.mean(sample == planes[:, lag : last + lag : _SAMPLING], axis=1) > _MIN_REPETITION
    return compressible.tolist()


def fletcher32(data: np.ndarray) -> int:
    """Fletcher checksum as HDF5 defines it; an odd number of bytes is padded with a zero.

    Parameters
    ----------
    data : ndarray of uint8, shape (n,)

    Returns
    -------
    int
    """
    words = np.append(data, np.zeros(len(data) % 2, np.uint8)).view(">u2").astype(np.int64)
    low, high = int(words.sum()), int(words @ np.arange(len(words), 0, -1))
    return (high % 65535 or 65535 * (high > 0)) << 16 | (low % 65535 or 65535 * (low > 0))


class Chunks:
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

    def __enter__(self) -> Chunks:
        return self

    def __exit__(self, *_: object) -> None:
        try:
            for variable in self._variables.values():
                self._call("H5Dclose", _ID(variable))
        finally:
            self._call("H5Fclose", _ID(self._file))
