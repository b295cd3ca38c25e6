"""Charts and what holds them as plain arrays, to be stored and passed between
processes.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping
from typing import Any, get_args, get_type_hints

import numpy as np

from gaitsweep.tasks.tables import Arrays


def arrays_of(value: Any, name: str = "") -> Arrays:
    """Return a value's arrays, whose names begin with its own.

    Parameters
    ----------
    value : ndarray, number, text, or tuple of these; or a dataclass, list, or tuple of arrays
        A dataclass has the arrays of its fields, a list those of its parts 0, 1, ...,
        None has none.
    name : str
    """
    if isinstance(value, list) or (
        isinstance(value, tuple) and any(isinstance(each, np.ndarray) for each in value)
    ):
        value = {str(i): each for i, each in enumerate(value)}
    elif dataclasses.is_dataclass(value):
        value = {
            field.name: getattr(value, field.name)
            for field in dataclasses.fields(value)
        }
    if value is None or not isinstance(value, dict):
        return {} if value is None else {name: np.asarray(value)}
    parts = (
        arrays_of(each, f"{name}/{part}" if name else part)
        for part, each in value.items()
    )
    return {key: array for part in parts for key, array in part.items()}


def value_of(kind: Any, arrays: Mapping[str, np.ndarray]) -> Any:
    """Return the dataclass of a kind that arrays hold; what they do not hold has its
    default.
    """
    values: dict[str, Any] = {}
    for name, kinds in _kinds(kind).items():
        if (array := arrays.get(name)) is not None:
            plain = array.item() if array.ndim == 0 else tuple(array.tolist())
            values[name] = array if np.ndarray in kinds else plain
        elif own := under(name, arrays):
            of = next(filter(dataclasses.is_dataclass, kinds), None)
            values[name] = (
                value_of(of, own) if of else tuple(own[str(i)] for i in range(len(own)))
            )
    return kind(**values)


def under(name: str, arrays: Mapping[str, np.ndarray]) -> Arrays:
    """Return the arrays whose names begin with another, by the rest of theirs."""
    return {
        key.removeprefix(f"{name}/"): array
        for key, array in arrays.items()
        if key.startswith(f"{name}/")
    }


def parts(arrays: Mapping[str, np.ndarray]) -> list[Arrays]:
    """Return the arrays of the parts 0, 1, ... of something."""
    each: dict[int, Arrays] = {}
    for name, value in arrays.items():
        number, _, rest = name.partition("/")
        if number.isdigit():
            each.setdefault(int(number), {})[rest] = value
    return [each[number] for number in sorted(each)]


@functools.cache
def _kinds(kind: Any) -> dict[str, tuple[Any, ...]]:
    """What each field of a dataclass may hold, or what its parts are."""
    return {
        name: get_args(hint) or (hint,) for name, hint in get_type_hints(kind).items()
    }
