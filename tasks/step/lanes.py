"""Lanes of results, which are arrays whose last axis counts them, or dataclasses,
tuples or lists of such.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np


def lanes_of(result: Any, lanes: slice | np.ndarray) -> Any:
    """Return some lanes of a result, or of what itself returns `some` lanes, as
    problems do.

    Parameters
    ----------
    result : ndarray, or a dataclass, tuple or list of such
    lanes : slice, or ndarray of int, shape (k,), or of bool
    """
    if isinstance(result, np.ndarray):
        return result[..., lanes]
    if isinstance(result, tuple | list):
        return type(result)(lanes_of(each, lanes) for each in result)
    if dataclasses.is_dataclass(result) and not isinstance(result, type):
        changed = {
            name: lanes_of(values, lanes) for name, values in _fields(result).items()
        }
        return dataclasses.replace(result, **changed)

    return result.some(lanes)


def replace_lanes(result: Any, lanes: np.ndarray, other: Any) -> None:
    """Replace some lanes of a result, in place, by those of another, and drop what was
    computed from its arrays.

    Parameters
    ----------
    lanes : ndarray of int, shape (k,)
    other : of the same kind
        Of k lanes.
    """
    if isinstance(result, np.ndarray):
        result[..., lanes] = other
    elif isinstance(result, tuple | list):
        for own, new in zip(result, other, strict=True):
            replace_lanes(own, lanes, new)
    elif dataclasses.is_dataclass(result):
        own = _fields(result)
        for name, values in own.items():
            replace_lanes(values, lanes, getattr(other, name))
        for cached in vars(result).keys() - own.keys():
            del vars(result)[cached]


def join_lanes(parts: Sequence[Any]) -> Any:
    """Return the lanes of dataclasses of arrays, one after another."""
    names = _fields(parts[0])
    return type(parts[0])(
        *(
            np.concatenate([getattr(part, name) for part in parts], axis=-1)
            for name in names
        )
    )


def slices(counts: Sequence[int]) -> list[slice]:
    """Return where parts of so many lanes each lie that follow one another, as
    `join_lanes` joins them.
    """
    ends = np.cumsum(counts, dtype=int).tolist()
    return [slice(end - count, end) for count, end in zip(counts, ends, strict=True)]


def parts_of(n: int, most: int) -> list[slice]:
    """Return the parts of n lanes, each of so many at most, and of one at least."""
    size = max(1, most)
    return [slice(first, first + size) for first in range(0, n, size)]


def _fields(result: Any) -> dict[str, Any]:
    return {
        field.name: getattr(result, field.name) for field in dataclasses.fields(result)
    }
