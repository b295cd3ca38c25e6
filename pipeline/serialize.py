"""Nested data and arrays as bytes, for the journal.

Not pickle: a header of JSON, in which an array is `{"": [dtype, shape]}`, then the
bytes of the arrays. Untrusted bytes can raise only ValueError.
"""

import json
import math
import struct
from typing import Any

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

        def restore(x: dict[str, Any]) -> Any:
            nonlocal offset
            if "" not in x:
                return x

            text, shape = x[""]
            dtype = np.dtype(str(text))
            if dtype.kind not in "fiubU" or not all(
                isinstance(n, int) and n >= 0 for n in shape
            ):
                raise ValueError("unknown array")

            count = math.prod(shape)
            values = np.empty(0, dtype)
            if count:
                values = np.frombuffer(data, dtype, count, offset)
            offset += values.nbytes + -values.nbytes % _ALIGN
            return values.reshape(shape)

        return json.loads(data[4 : 4 + size], object_hook=restore)
    except (
        struct.error,
        KeyError,
        TypeError,
        RecursionError,
        UnicodeDecodeError,
    ) as error:
        raise ValueError(f"not packed data: {error}") from error
