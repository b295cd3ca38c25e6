"""Calls from several threads."""

import contextlib
import threading


class _Turn(contextlib.ContextDecorator):
    """Lets one thread at a time call functions: compiled integrators hold one state, as
    the HDF5 library does.

    A run closes every worker process at its end.
    """

    _lock = threading.RLock()

    def __enter__(self) -> None:
        self._lock.acquire()

    def __exit__(self, *_: object) -> None:
        self._lock.release()


in_turn = _Turn()
