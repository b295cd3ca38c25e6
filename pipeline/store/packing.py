"""Values as packed chunks of an archive, as HDF5's filters fletcher32, shuffle and
deflate would write them.

HDF5's own filters take longer than solving the points, mostly on bytes of the mantissa
that do not compress. Those bytes are stored, the others deflated; every reader unpacks
both.
"""

import functools
import itertools
import struct
import zlib
from typing import NamedTuple

import numpy as np

#: Every n-th byte is sampled; n is prime so that no dimension aliases.
_SAMPLING = 13
#: Least unevenness of bytes to deflate, and least fraction that repeats at a lag, as
#: across multipliers.
_MIN_UNEVENNESS, _MIN_REPETITION, _LAGS = 1.1, 0.02, (1, 2, 3, 4, 6, 8)


class Packed(NamedTuple):
    """A packed chunk, and the checksum of its values."""

    data: bytes
    checksum: int


def pack_values(values: np.ndarray, extent: tuple[int, ...]) -> Packed:
    """Pack the values of a variable in a chunk, as the archive holds them.

    Parameters
    ----------
    values : ndarray
        Of the variable's type.
    extent : tuple of int
        Shape of a chunk, which is larger than `values` at the end of the grid; the rest
        is zero.

    Returns
    -------
    Packed
    """
    data = values.tobytes()
    first = data[: values.itemsize]
    if first * values.size == data:  # as where there is no gait
        return _pack_constant(first, values.dtype.str, values.shape, extent)
    return Packed(pack(values, extent), zlib.crc32(data))


@functools.lru_cache(256)
def _pack_constant(
    value: bytes, dtype: str, shape: tuple[int, ...], extent: tuple[int, ...]
) -> Packed:
    values = (
        np.full(shape, np.frombuffer(value, dtype)[0])
        if value
        else np.empty(shape, dtype)
    )
    return Packed(pack(values, extent), zlib.crc32(values.tobytes()))


def pack(values: np.ndarray, extent: tuple[int, ...]) -> bytes:
    """Apply the filters fletcher32, shuffle and deflate, in this order, to a chunk,
    whose values zeros make whole.

    Parameters
    ----------
    values : ndarray
    extent : tuple of int

    Returns
    -------
    bytes

    Notes
    -----
    The stream follows RFC 1950 (zlib) and RFC 1951 (deflate).
    """
    whole, size = np.zeros(extent, values.dtype), values.itemsize
    whole[tuple(map(slice, values.shape))] = values
    data = whole.reshape(-1).view(np.uint8)
    data = np.concatenate(
        [data, np.frombuffer(struct.pack("<I", fletcher32(data)), np.uint8)]
    )
    n = len(data) // size
    planes = np.ascontiguousarray(data[: n * size].reshape(n, size).T)
    checksum, stream = 1, [b"\x78\x01"]
    compressible_planes = (
        _compressible_planes(planes) if values.dtype.kind == "f" else [True] * size
    )
    for compressible, run in itertools.groupby(
        zip(compressible_planes, planes, strict=True), key=lambda pair: pair[0]
    ):
        deflate = zlib.compressobj(int(compressible), zlib.DEFLATED, -15)
        for _, plane in run:
            checksum = zlib.adler32(plane, checksum)
            stream.append(deflate.compress(plane))
        stream.append(deflate.flush(zlib.Z_SYNC_FLUSH))
    rest = data[n * size :].tobytes()
    last = zlib.compressobj(0, zlib.DEFLATED, -15)
    return b"".join(
        [
            *stream,
            last.compress(rest),
            last.flush(),
            struct.pack(">I", zlib.adler32(rest, checksum)),
        ]
    )


def unpack(data: bytes | memoryview, dtype: str, extent: tuple[int, ...]) -> np.ndarray:
    """Unpack a chunk.

    Parameters
    ----------
    data : bytes
        As `pack` returns it.
    dtype : str
    extent : tuple of int
        Shape of the chunk.

    Returns
    -------
    ndarray, shape `extent`

    Raises
    ------
    ValueError
        If it was not packed so.
    """
    size = np.dtype(dtype).itemsize
    try:
        unpacked = np.frombuffer(zlib.decompress(data), np.uint8)
    except zlib.error as error:
        raise ValueError(f"not a packed chunk: {error}") from error
    n = len(unpacked) // size
    values = np.ascontiguousarray(unpacked[: n * size].reshape(size, n).T).reshape(-1)
    values = np.concatenate([values, unpacked[n * size :]])[:-4]
    return values.view(dtype).reshape(extent)


def _compressible_planes(planes: np.ndarray) -> list[bool]:
    """Planes of bytes that, by a sample, are less even than chance or repeat at a lag."""
    size, last = planes.shape[0], max(1, planes.shape[1] - _LAGS[-1])
    sample = planes[:, :last:_SAMPLING]
    n = sample.shape[1]
    histogram = np.bincount(
        (sample + 256 * np.arange(size)[:, None]).ravel(), minlength=256 * size
    ).reshape(size, 256)
    compressible = np.sum(histogram**2, axis=1) > _MIN_UNEVENNESS * (
        n + n * (n - 1) / 256
    )
    for lag in _LAGS if planes.shape[1] > _LAGS[-1] else ():
        compressible |= (
            np.mean(sample == planes[:, lag : last + lag : _SAMPLING], axis=1)
            > _MIN_REPETITION
        )
    return compressible.tolist()


def fletcher32(data: np.ndarray) -> int:
    """Fletcher checksum as HDF5 defines it; an odd number of bytes is padded with a
    zero.

    Parameters
    ----------
    data : ndarray of uint8, shape (n,)

    Returns
    -------
    int
    """
    words = (
        np.append(data, np.zeros(len(data) % 2, np.uint8)).view(">u2").astype(np.int64)
    )
    low, high = int(words.sum()), int(words @ np.arange(len(words), 0, -1))
    return (high % 65535 or 65535 * (high > 0)) << 16 | (
        low % 65535 or 65535 * (low > 0)
    )
