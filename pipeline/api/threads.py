"""Calls from several threads."""

from __future__ import annotations

import functools
import threading
from collections.abc import Callable
from typing import ParamSpec, TypeVar

_Parameters = ParamSpec("_Parameters")
_Result = TypeVar("_Result")
_TURN = threading.RLock()


def in_turn(function: Callable[_Parameters, _Result]) -> Callable[_Parameters, _Result]:
    """Let one thread at a time call these functions: compiled integrators hold one state, as the HDF5 library does.

    A run closes every worker process at its end.
    """

    @functools.wraps(function)
    def called(*args: _Parameters.args, **kwargs: _Parameters.kwargs) -> _Result:
        with _TURN:
            return function(*args, **kwargs)

    return called
