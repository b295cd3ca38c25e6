"""Nested data and arrays as bytes, for the journal.

Not pickle: a header of JSON, in which an array is `{"": [dtype, shape]}`, then the
bytes of the arrays. Untrusted bytes can raise only ValueError.
"""

import functools
import json
import math
import struct
from typing import Any, NamedTuple

import numpy as np

_ALIGN = 16


def dump(tree: Any) -> bytes:
    """Pack nested dicts, lists, strings, numbers and arrays. Equal trees give equal
    bytes.

    Raises
    ------
    TypeError
        If the tree contains an array of objects or another kind of value.
    """
    arrays: list[np.ndarray] = []

    def plain(x: Any) -> Any:
        if isinstance(x, np.ndarray):
            # `ascontiguousarray` would make a list of a number.
            x = np.asarray(x, order="C")
            if x.dtype.kind not in "fiubU":
                raise TypeError(f"an array of {x.dtype} cannot be kept")
            arrays.append(x)
            return {"": [x.dtype.str, list(x.shape)]}

        return x.item()  # a numpy scalar; anything else fails here

    header = json.dumps(tree, default=plain, separators=(",", ":")).encode()
    parts = [struct.pack("<I", len(header)), header, bytes(-(len(header) + 4) % _ALIGN)]
    for a in arrays:
        parts += [a.tobytes(), bytes(-a.nbytes % _ALIGN)]
    return b"".join(parts)


def load(data: bytes) -> Any:
    """Unpack the result of `dump`; arrays are read-only views of `data`.

    Raises
    ------
    ValueError
        If `data` is not a result of `dump`.
    """
    try:
        (size,) = struct.unpack_from("<I", data)
        offset = 4 + size
        offset += -offset % _ALIGN
        return _filled(_parsed(data[4 : 4 + size]), data, offset)
    except (
        struct.error,
        KeyError,
        TypeError,
        RecursionError,
        UnicodeDecodeError,
    ) as error:
        raise ValueError(f"not packed data: {error}") from error


class _Array(NamedTuple):
    """Where the bytes of an array begin, after those of the header, and what they are."""

    begin: int
    dtype: np.dtype[Any]
    shape: tuple[int, ...]

    def of(self, data: bytes, offset: int) -> np.ndarray:
        count = math.prod(self.shape)
        if not count:
            return np.empty(self.shape, self.dtype)
        values = np.frombuffer(data, self.dtype, count, offset + self.begin)
        return values.reshape(self.shape)


@functools.lru_cache(256)
def _parsed(header: bytes) -> Any:
    """The tree of a header, with an `_Array` for each array. Heads of chunks have few
    headers, and take most of their time to parse.
    """
    begin = 0

    def array(x: dict[str, Any]) -> Any:
        nonlocal begin
        if "" not in x:
            return x

        text, shape = x[""]
        dtype = np.dtype(str(text))
        if dtype.kind not in "fiubU" or not all(
            isinstance(n, int) and n >= 0 for n in shape
        ):
            raise ValueError("unknown array")

        found = _Array(begin, dtype, tuple(shape))
        size = math.prod(shape) * dtype.itemsize
        begin += size + -size % _ALIGN
        return found

    return json.loads(header, object_hook=array)


def _filled(tree: Any, data: bytes, offset: int) -> Any:
    """A tree like the one parsed, with its arrays."""
    if isinstance(tree, _Array):
        return tree.of(data, offset)
    if isinstance(tree, dict):
        return {name: _filled(value, data, offset) for name, value in tree.items()}
    if isinstance(tree, list):
        return [_filled(value, data, offset) for value in tree]
    return tree
