"""Charts and what holds them as plain arrays, to be stored and passed between
processes.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping
from typing import Any, get_args, get_type_hints

import numpy as np

from gaitsweep.tasks.contract.tables import Arrays


def arrays_of(value: Any, name: str = "") -> Arrays:
    """Return a value's arrays, whose names begin with its own.

    Parameters
    ----------
    value : ndarray, number, text, or tuple of these; or a dataclass, list, or tuple of arrays
        A dataclass has the arrays of its fields, a list those of its parts 0, 1, ...,
        None has none.
    name : str
    """
    if value is None:
        return {}

    has_arrays = isinstance(value, tuple) and any(
        isinstance(part, np.ndarray) for part in value
    )
    if isinstance(value, list) or has_arrays:
        value = dict(enumerate(value))
    elif dataclasses.is_dataclass(value):
        names = [field.name for field in dataclasses.fields(value)]
        value = {part: getattr(value, part) for part in names}

    if not isinstance(value, dict):
        return {name: np.asarray(value)}

    arrays: Arrays = {}
    for part, of_part in value.items():
        arrays |= arrays_of(of_part, f"{name}/{part}" if name else str(part))
    return arrays


def value_of(kind: Any, arrays: Mapping[str, np.ndarray]) -> Any:
    """Return the dataclass of a kind that arrays hold; what they do not hold has its
    default.
    """
    values: dict[str, Any] = {}
    for name, kinds in _kinds(kind).items():
        array = arrays.get(name)
        if array is None:
            if of_field := under(name, arrays):
                values[name] = _nested(kinds, of_field)
        elif np.ndarray in kinds:
            values[name] = array
        else:
            values[name] = tuple(array.tolist()) if array.ndim else array.item()

    return kind(**values)


def _nested(kinds: tuple[Any, ...], arrays: Arrays) -> Any:
    """The dataclass of one of some kinds, or the tuple of arrays, that arrays hold."""
    for kind in kinds:
        if dataclasses.is_dataclass(kind):
            return value_of(kind, arrays)
    return tuple(arrays[str(i)] for i in range(len(arrays)))


def under(name: str, arrays: Mapping[str, np.ndarray]) -> Arrays:
    """Return the arrays whose names begin with another, by the rest of theirs."""
    return {
        key.removeprefix(f"{name}/"): array
        for key, array in arrays.items()
        if key.startswith(f"{name}/")
    }


def parts(arrays: Mapping[str, np.ndarray]) -> list[Arrays]:
    """Return the arrays of the parts 0, 1, ... of something."""
    by_number: dict[int, Arrays] = {}
    for name, value in arrays.items():
        number, _, rest = name.partition("/")
        if number.isdigit():
            by_number.setdefault(int(number), {})[rest] = value
    return [by_number[number] for number in sorted(by_number)]


@functools.cache
def _kinds(kind: Any) -> dict[str, tuple[Any, ...]]:
    """What the fields of a dataclass may hold, or what their parts are."""
    hints = get_type_hints(kind)
    return {name: get_args(hint) or (hint,) for name, hint in hints.items()}
