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
from numpy import ndarray

#: Every n-th byte is sampled; n is prime so that no dimension aliases.
_SAMPLING = 13
#: Least unevenness of bytes to deflate, and least fraction that repeats at a lag, as
#: across multipliers.
_MIN_UNEVENNESS = 1.1
_MIN_REPETITION = 0.02
_LAGS = (1, 2, 3, 4, 6, 8)


class Packed(NamedTuple):
    """A packed chunk, and the checksum of its values."""

    data: bytes
    checksum: int


def pack_values(values: ndarray, extent: tuple[int, ...]) -> Packed:
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
    value: bytes,
    dtype: str,
    shape: tuple[int, ...],
    extent: tuple[int, ...],
) -> Packed:
    values = np.empty(shape, dtype)
    if value:
        values[...] = np.frombuffer(value, dtype)[0]
    return Packed(pack(values, extent), zlib.crc32(values.tobytes()))


def pack(values: ndarray, extent: tuple[int, ...]) -> bytes:
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
    whole = np.zeros(extent, values.dtype)
    whole[tuple(map(slice, values.shape))] = values
    data = whole.reshape(-1).view(np.uint8)
    checksum = struct.pack("<I", fletcher32(data))
    after = np.frombuffer(checksum, np.uint8)
    data = np.concatenate([data, after])

    # The first bytes of all values, then the second ones, and so on; last what is left
    # of the checksum.
    size = values.itemsize
    n = len(data) // size
    shuffled, rest = np.split(data, [n * size])
    planes = np.ascontiguousarray(shuffled.reshape(n, size).T)

    are_compressible = [True] * size
    if values.dtype.kind == "f":
        are_compressible = _compressible_planes(planes)
    return _deflated(planes, are_compressible, rest.tobytes())


def _deflated(planes: ndarray, are_compressible: list[bool], rest: bytes) -> bytes:
    """Planes of bytes and a rest as one stream, in which those that are not compressible
    are stored.
    """
    checksum = 1
    stream = [b"\x78\x01"]
    pairs = zip(are_compressible, planes, strict=True)
    for is_compressible, run in itertools.groupby(pairs, key=lambda pair: pair[0]):
        deflate = zlib.compressobj(int(is_compressible), zlib.DEFLATED, -15)
        for _, plane in run:
            checksum = zlib.adler32(plane, checksum)
            stream.append(deflate.compress(plane))
        stream.append(deflate.flush(zlib.Z_SYNC_FLUSH))

    last = zlib.compressobj(0, zlib.DEFLATED, -15)
    stream.append(last.compress(rest))
    stream.append(last.flush())

    checksum = zlib.adler32(rest, checksum)
    stream.append(struct.pack(">I", checksum))
    return b"".join(stream)


def unpack(data: bytes | memoryview, dtype: str, extent: tuple[int, ...]) -> ndarray:
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
    planes = unpacked[: n * size].reshape(size, n)
    values = np.ascontiguousarray(planes.T).reshape(-1)
    rest = unpacked[n * size :]
    values = np.concatenate([values, rest])[:-4]
    return values.view(dtype).reshape(extent)


def _compressible_planes(planes: ndarray) -> list[bool]:
    """Planes of bytes that, by a sample, are less even than chance or repeat at a lag."""
    size, length = planes.shape
    last = max(1, length - _LAGS[-1])
    sample = planes[:, :last:_SAMPLING]

    # How often each byte occurs, by plane; the sum of squares is least if all do alike.
    numbers = sample + 256 * np.arange(size)[:, None]
    counts = np.bincount(numbers.ravel(), minlength=256 * size)
    unevenness = np.sum(counts.reshape(size, 256) ** 2, axis=1)
    n = sample.shape[1]
    by_chance = n + n * (n - 1) / 256
    compressible = unevenness > _MIN_UNEVENNESS * by_chance

    if length > _LAGS[-1]:
        for lag in _LAGS:
            later = planes[:, lag : last + lag : _SAMPLING]
            repetition = np.mean(sample == later, axis=1)
            compressible |= repetition > _MIN_REPETITION

    return compressible.tolist()


def fletcher32(data: ndarray) -> int:
    """Fletcher checksum as HDF5 defines it; an odd number of bytes is padded with a
    zero.

    Parameters
    ----------
    data : ndarray of uint8, shape (n,)

    Returns
    -------
    int
    """
    padding = np.zeros(len(data) % 2, np.uint8)
    whole = np.append(data, padding)
    words = whole.view(">u2").astype(np.int64)
    weights = np.arange(len(words), 0, -1)

    low = _ones_complement(int(words.sum()))
    high = _ones_complement(int(words @ weights))
    return high << 16 | low


def _ones_complement(total: int) -> int:
    """A sum of words modulo 65535, of which 65535 stands for 0 unless all are zero."""
    return total % 65535 or 65535 * (total > 0)
